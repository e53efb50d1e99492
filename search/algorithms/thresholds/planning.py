"""The candidates of the next generation of `edge@2`: those of open hunts, of new ones, and of exploration."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from brink.search.algorithms.ledger import Ledger, row_keys
from brink.search.algorithms.thresholds.parts import Kind, Parts, free_columns
from brink.search.algorithms.thresholds.stages import (
    APART,
    CHECKS,
    OTHER_CHECKS,
    estimate_of,
    far_row,
    line_of,
    prior_of,
    probe_rows,
)
from brink.search.algorithms.thresholds.state import (
    OPEN,
    Draw,
    Hunt,
    Job,
    Purpose,
    Simulated,
    Stage,
    ThresholdState,
)
from brink.search.exploration import RobustnessSurrogate, proposed_rows
from brink.search.metric import Metric
from brink.search.parameters import Categorical
from brink.search.space import FloatArray, frozen_array
from brink.search.streams import Stream, generator
from brink.search.surrogate import learning_size
from brink.search.thresholds.estimation import next_places
from brink.search.thresholds.line import valid_change

FIRST_BATCH: Final = 8
"""Trials with which the estimation of a threshold begins."""
BATCH: Final = 6
"""Trials of a threshold in flight at a time after that."""
BEFORE_LINE: Final = {Stage.SCREEN: 8.0, Stage.REDUCE: 6.0, Stage.MOVE: 4.0}
"""Simulations that a hunt is expected to take before its unit is known, by stage."""
_ON_LINE: Final = 6
"""Simulations of a line before its curve is estimated, besides those that count for the curve."""
USUAL_TRIALS: Final = 0.7
"""Share of the most trials that a threshold is expected to take."""
FEWEST_EXPLORED: Final = 30
"""Random solutions before the surrogate proposes any."""
_DRAWS: Final = 12
"""Values drawn of each unit that may be moved, besides the ends of its range."""
_OPPOSITES: Final = 20
"""Nearest safe solutions of which one is approached."""
_MOST_PAIRED: Final = 400
"""Latest solutions of each verdict among which hunts may begin, where chance has no part."""
_PARTNERS: Final = 5
"""Nearest solutions of the other verdict that hunts may begin between, where chance has no part."""
_SPARE_PROPOSALS: Final = 3
"""Proposals for each one that is simulated, of which those come last whose scenario may be unsafe alone."""
_COMMON: Final = 0.3
"""Share of unsafe solutions from which on random exploration finds enough of them."""
_ENOUGH: Final = 2
"""Hunts of a kind after which simulations look for other kinds first, where categories tell kinds apart."""
_MOST_EXPLORED: Final = 2.0
"""Most solutions to explore while only hunts of frequent kinds are left, as a multiple of those at the start."""
_VARIATIONS: Final = 0.5
"""Share of the exploration that changes one category of a solution whose deciding unit is known."""
_VARIED: Final = 3
"""Variants of each change, with different numbers; the one most likely to be unsafe is proposed."""
_TRIED: Final = 0.5
"""How much each solution of a kind that was explored in vain lowers its rank, in ranks of robustness."""
_PREFERRED: Final = 0.25
"""Rank of robustness from which on a move to a rarer kind is preferred to a safer one."""


@dataclass(slots=True)
class Plan:
    """The generation that is being planned."""

    wanted: int
    rows: list[FloatArray] = field(default_factory=list)
    seeds: list[int | None] = field(default_factory=list)
    jobs: list[Job] = field(default_factory=list)

    @property
    def room(self) -> int:
        """How many more candidates fit."""
        return self.wanted - len(self.rows)

    def add(self, row: FloatArray, seed: int | None, job: Job) -> None:
        """Add a candidate."""
        self.rows.append(row)
        self.seeds.append(seed)
        self.jobs.append(job)


def planned(state: ThresholdState) -> ThresholdState:
    """Return the state with the next generation queued if there is room in flight, as budget and space allow.

    `in_flight` limits the candidates in flight, as if all generations were full. Those of hunts are often smaller, so
    more than `in_flight` generations may be under way.
    """
    ledger, config = state.ledger, state.config
    if ledger.in_flight > config.generation_size * (config.in_flight - 1) or ledger.left <= 0:
        return state
    plan = Plan(int(min(config.generation_size, ledger.left)))
    for row in ledger.points[: plan.wanted]:
        plan.add(row, None, Job(Purpose.EXPLORE))
    planner = _Planner(with_surrogate(state), plan)
    planner.continue_hunts()
    planner.begin_hunts()
    planner.explore()
    return replace(
        planner.state, ledger=ledger.plan(plan.rows, seed_numbers=plan.seeds), jobs=(*state.jobs, *plan.jobs)
    )


def with_surrogate(state: ThresholdState) -> ThresholdState:
    """Return the state with an up-to-date surrogate, which is refitted whenever there are 10% more solutions."""
    archive, known = state.ledger.archive, state.ledger.known
    size = learning_size(len(known) + len(archive), one_in=10)
    if size < FEWEST_EXPLORED or (state.surrogate is not None and state.surrogate.size == size):
        return state
    rows = np.concatenate([known.rows, archive.vectors])[:size]
    robustness = np.concatenate([known.robustness, archive.robustness])[:size]
    unsafe = np.concatenate([known.unsafe, archive.unsafe])[:size]
    rng = generator(state.ledger.seed, Stream.THRESHOLDS, Draw.SURROGATE, size)
    seed = int(rng.integers(2**32, dtype=np.uint64))
    fitted = RobustnessSurrogate(state.ledger.space, rows, robustness, unsafe, seed=seed)
    return replace(state, surrogate=fitted)


class _Planner:
    """Plans one generation.

    Attributes:
        state: The state, with hunts that begin in this generation.
    """

    def __init__(self, state: ThresholdState, plan: Plan) -> None:
        self.state = state
        self._plan = plan
        self._space = state.ledger.space
        self._parts = Parts(self._space)
        self._simulated = Simulated(state.ledger.archive)
        self._generation = state.ledger.planned_generation
        self._lacks_kinds = False
        self._waiting = self._repeated() if self._may_explore() else set[int]()

    def _rng(self, draw: Draw, *index: int) -> np.random.Generator:
        return generator(self.state.ledger.seed, Stream.THRESHOLDS, draw, *index)

    def continue_hunts(self) -> None:
        """Plan the next simulations of open hunts for which none is in flight, those nearest to their end first.

        If the budget does not suffice for all, those that are farthest from it wait.
        """
        waiting = Counter(job.hunt for job in self.state.jobs if job.purpose is not Purpose.EXPLORE)
        left = self.state.ledger.left + waiting.total()
        costs = {place: self._cost(hunt) for place, hunt in self._going_on()}
        for place in sorted(costs, key=lambda place: (costs[place], place)):
            left -= costs[place]
            if not self._plan.room or (left < 0 and (self._plan.rows or waiting)):
                break
            if not waiting[place]:
                self._continue(place, self.state.hunts[place])

    def _going_on(self) -> list[tuple[int, Hunt]]:
        """Return the open hunts that do not wait, with their places."""
        return [
            (place, hunt)
            for place, hunt in enumerate(self.state.hunts)
            if hunt.stage in OPEN and place not in self._waiting
        ]

    def _may_explore(self) -> bool:
        """Return whether to look for other kinds before further thresholds of frequent ones."""
        are_others = len(self._block_times()) < self._parts.count_contents()
        return are_others and self._explored() < _MOST_EXPLORED * self._to_explore()

    def _repeated(self) -> set[int]:
        """Return the places of hunts that turned out to be of a frequent kind before any unit was moved."""
        anchors: dict[Kind, set[int]] = defaultdict(set)
        repeated: set[int] = set()
        for place, hunt in enumerate(self.state.hunts):
            begins = hunt.stage is Stage.MOVE and not hunt.moved and hunt.opposite < 0
            if hunt.unit < 0 and not begins:
                continue
            content = self._content(hunt.held)
            if begins and content and all(len(anchors[kind] - {hunt.anchor}) >= _ENOUGH for kind in content):
                repeated.add(place)
            else:
                for kind in content:
                    anchors[kind].add(hunt.anchor)
        return repeated

    def _continue(self, place: int, hunt: Hunt) -> None:
        """Plan all simulations of a hunt's stage; where none is valid, go on with the stage after it."""
        parts, simulated, held = self._parts, self._simulated, self._simulated.row(hunt.held)
        active = parts.active(held)
        seed: int | None = hunt.seed
        fresh: list[tuple[FloatArray, Job]] = []
        rows: list[tuple[FloatArray | None, Job]] = []
        match hunt.stage:
            case Stage.SCREEN:
                rows = [(parts.without(held, active), Job(Purpose.SCREEN, place))]
                instead = Stage.REDUCE
            case Stage.REDUCE:
                left = [block for block in active if block not in hunt.needed] if len(active) > 1 else []
                rows = [(parts.without(held, [block]), Job(Purpose.DROP, place, block)) for block in left]
                instead = Stage.MOVE
            case Stage.MOVE:
                self._move(place, hunt)
                return
            case Stage.SPAN | Stage.BRACKET:
                probes = probe_rows(hunt, parts, simulated, self.state.config)
                rows = [(row, Job(Purpose.PROBE, place)) for row in probes]
                if hunt.stage is Stage.SPAN and self.state.config.trials:
                    rows.append((far_row(hunt, parts, simulated), Job(Purpose.FAR, place)))
                    fresh = self._checks(place, hunt)
                instead = Stage.ESTIMATE if self.state.config.trials else Stage.THRESHOLD
            case _:
                rows = [(row, Job(Purpose.TRIAL, place)) for row in self._trials(place, hunt)]
                seed, instead = None, Stage.GIVEN_UP
        valid = [(row, job) for row, job in rows if row is not None]
        self._add(valid, fresh, seed)
        if not valid and not fresh:
            self._replace(place, replace(hunt, stage=instead))

    def _add(
        self,
        rows: Sequence[tuple[FloatArray, Job]],
        fresh: Sequence[tuple[FloatArray, Job]],
        seed: int | None,
    ) -> None:
        """Add all candidates of a stage, if they fit: those of a seed, and those with seeds of their own."""
        if len(rows) + len(fresh) > self._plan.room and self._plan.rows:
            return
        for (row, job), number in [*((one, seed) for one in rows), *((one, None) for one in fresh)]:
            if self._plan.room:
                self._plan.add(row, number, job)

    def _checks(self, place: int, hunt: Hunt) -> list[tuple[FloatArray, Job]]:
        """Return the simulations with fresh seeds of both ends of a hunt's line, or of what it holds without one."""
        if not self.state.config.trials:
            return []
        row, job = self._simulated.row, Job(Purpose.CHECK, place, int(not hunt.from_safe))
        checks = [] if hunt.trials else [(row(hunt.held), job)] * CHECKS
        if hunt.unit < 0:
            return checks
        other = hunt.end if hunt.from_safe else hunt.start
        return checks + [(row(other), job._replace(subject=1 - job.subject))] * OTHER_CHECKS

    def _replace(self, place: int, hunt: Hunt) -> None:
        hunts = list(self.state.hunts)
        hunts[place] = hunt
        self.state = replace(self.state, hunts=tuple(hunts))

    def _trials(self, place: int, hunt: Hunt) -> list[FloatArray]:
        line = line_of(hunt, self._parts, self._simulated)
        found = self.state.estimates.get(place)
        if found is None:
            found = estimate_of(self.state, hunt, self._parts, self._simulated)
            self.state = replace(self.state, estimates={**self.state.estimates, place: found})
        rng = self._rng(Draw.PLACES, hunt.held, hunt.unit, self._generation)
        usual = FIRST_BATCH if len(hunt.trials) <= CHECKS + OTHER_CHECKS else BATCH
        count = min(max(usual, self.state.config.batch), self.state.config.trials - len(hunt.trials))
        places = next_places(prior_of(hunt, line, self._simulated), found, count, rng)
        rows = [line.at(share) for share in places]
        return [line.end if row is None else row for row in rows]

    def _move(self, place: int, hunt: Hunt) -> None:
        """Plan moves, each of one unit, that most probably change the verdict of a hunt's solution, rare kinds first.

        Where no single move is likely to, the solution approaches one of the other verdict, unit by unit.
        """
        held = self._simulated.row(hunt.held)
        units = [unit for unit in self._parts.movable(held) if unit not in hunt.moved]
        rng = self._rng(Draw.MOVE, hunt.held, hunt.seed, len(hunt.moved))
        moves = [(unit, row) for unit in units for row in self._moved_rows(held, unit, rng)]
        safety = self._safety([row for _, row in moves]) * (-1.0 if hunt.from_safe else 1.0)
        if not moves or safety.max() < 0.0 or hunt.opposite >= 0:
            if self._approach(place, hunt, held):
                return
            if hunt.opposite >= 0:
                moves = []
        times = Counter(self._kinds())
        ranks = [
            (times[self._parts.kind(held, unit)] if safe >= _PREFERRED else np.inf, -safe)
            for (unit, _), safe in zip(moves, safety.tolist(), strict=False)
        ]
        chosen: dict[int, FloatArray] = {}
        for index in sorted(range(len(moves)), key=lambda index: (ranks[index], index)):
            unit = moves[index][0]
            if unit in chosen or len(chosen) >= self._at_a_time(hunt):
                continue
            row = valid_change(self._space, held, moves[index][1], self._parts.units[unit])
            if row is not None and self._is_other(row, held, unit):
                chosen[unit] = row
        if chosen:
            rows = [(row, Job(Purpose.MOVE, place, unit)) for unit, row in chosen.items()]
            self._add(rows, self._checks(place, hunt), hunt.seed)
        else:
            self._replace(place, replace(hunt, stage=Stage.FIXED))

    def _at_a_time(self, hunt: Hunt) -> int:
        """Return how many units of a hunt may be moved next; in a space of categories, one."""
        config = self.state.config
        return min(config.units, config.moves - len(hunt.moved)) if self._parts.numeric else 1

    def _safety(self, rows: Sequence[FloatArray]) -> FloatArray:
        """Return the estimated ranks of robustness, 0 without a surrogate, shape ``(n,)``."""
        if self.state.surrogate is None or not rows:
            return np.zeros(len(rows))
        return self.state.surrogate.predict(np.array(rows))[0]

    def _approach(self, place: int, hunt: Hunt, held: FloatArray) -> bool:
        """Plan to set one unit to its value in a solution of the other verdict; return whether there is one."""
        if hunt.opposite < 0:
            hunt = replace(hunt, opposite=self._nearest_other(held, unsafe=hunt.from_safe))
            self._replace(place, hunt)
        if hunt.opposite < 0:
            return False
        other = self._simulated.row(hunt.opposite)
        moves = []
        for index in self._parts.numeric:
            unit, row = self._parts.units[index], np.array(held)
            row[list(unit)] = other[list(unit)]
            changed = valid_change(self._space, held, row, unit)
            if changed is not None and not np.array_equal(changed, held):
                moves.append((index, changed))
        if not moves:
            return False
        safety = self._safety([row for _, row in moves])
        unit_index, row = moves[int(np.argmin(safety) if hunt.from_safe else np.argmax(safety))]
        self._add([(row, Job(Purpose.APPROACH, place, unit_index))], [], hunt.seed)
        return True

    def _nearest_other(self, held: FloatArray, *, unsafe: bool) -> int:
        """Return the number of a solution of a verdict and the same categories, -1 for none.

        Of the nearest ones, it is the one that lies farthest from where other hunts are, so that thresholds spread.
        """
        archive, categorical = self.state.ledger.archive, self._space.categorical
        same = (archive.vectors[:, categorical] == held[categorical]).all(axis=1)
        places = np.flatnonzero(same & (archive.unsafe == unsafe))
        if not places.size:
            return -1
        metric, rows = Metric.of_space(self._space), archive.vectors[places]
        nearest = np.argsort(metric.between(held[None], rows)[0], kind="stable")[:_OPPOSITES]
        others = [self._simulated.row(hunt.safe) for hunt in self.state.hunts if hunt.safe >= 0]
        others += [self._simulated.row(hunt.opposite) for hunt in self.state.hunts if hunt.opposite >= 0]
        if others:
            apart = metric.between(rows[nearest], np.array(others)).min(axis=1)
            nearest = nearest[np.argsort(-apart, kind="stable")]
        return int(archive.numbers[places[nearest[0]]])

    def _moved_rows(self, held: FloatArray, unit: int, rng: np.random.Generator) -> list[FloatArray]:
        """Return solutions, before repair, with a unit at the ends of its range or drawn again."""
        columns = list(self._parts.units[unit])
        rows = np.tile(held, (_DRAWS + 3, 1))
        drawn = self._space.draw_unrepaired(_DRAWS, rng)[:, columns]
        rows[3:, columns] = np.sort(drawn, axis=1)
        for column, resolution in zip(columns, self._space.resolutions(held, columns)[0], strict=True):
            parameter = self._space.parameters[column]
            if not self._space.categorical[column]:
                least, most = parameter.least, parameter.most  # type: ignore[union-attr]
                # All numbers of a block at 0 would read as dormant.
                rows[:3, column] = least, min(least + resolution, most), most
        return list(rows)

    def _is_other(self, row: FloatArray, held: FloatArray, unit: int) -> bool:
        """Return whether people would call a solution with a moved unit another one."""
        columns = list(self._parts.units[unit])
        moved = np.abs(row[columns] - held[columns])
        return bool((moved >= self._space.resolutions(held, columns)[0]).any())

    def _kinds(self) -> Iterable[Kind]:
        """Yield the kind of each hunt whose unit is known and that found, or may find, a threshold."""
        for hunt in self.state.hunts:
            if hunt.unit >= 0 and hunt.stage not in (Stage.CHANCY, Stage.GIVEN_UP, Stage.READY):
                yield self._parts.kind(self._simulated.row(hunt.held), hunt.unit)

    def begin_hunts(self) -> None:
        """Begin hunts of rare kinds, lines that wait and anchors, as far as the budget suffices for all open ones."""
        affordable = self._affordable()
        if affordable < 1:
            return
        exploring = self._explored() < self._to_explore()
        ready = [place for place, hunt in enumerate(self.state.hunts) if hunt.stage is Stage.READY]
        options: list[tuple[Hunt, int | None]] = [(self.state.hunts[place], place) for place in ready]
        options += [(hunt, None) for hunt in self._options(len(ready))]
        times, kinds = self._block_times(), Counter(self._kinds())
        contents = [self._content(hunt.held) if place is None else {} for hunt, place in options]
        apart = self._distances([hunt for hunt, _ in options])

        promise = {from_safe: self._promise(from_safe=from_safe) for from_safe in (False, True)}
        sharpness = self._sharpness({self._position(self.state.hunts[place]) for place in ready})

        def rarity(index: int) -> int:
            hunt = options[index][0]
            if hunt.unit >= 0:
                return kinds[self._parts.kind(self._simulated.row(hunt.held), hunt.unit)]
            return min((times[kind] for kind in contents[index]), default=0)

        def rank(index: int) -> tuple[float, float, int]:
            hunt, waiting = options[index]
            likely = promise[hunt.from_safe] if waiting is None else sharpness[self._position(hunt)]
            return (1 + rarity(index)) / likely, self._length(hunt) - apart[index], index

        may_explore = self._may_explore()
        self._lacks_kinds = may_explore
        while options and self._plan.room and affordable >= 1:
            best = min(range(len(options)), key=rank)
            if exploring and rarity(best) > 0:
                break
            if may_explore and rarity(best) >= _ENOUGH:
                del options[best], contents[best]
                apart = np.delete(apart, best)
                continue
            self._lacks_kinds = False
            (hunt, waiting), content = options.pop(best), contents.pop(best)
            place = len(self.state.hunts) if waiting is None else waiting
            if waiting is None:
                self.state = replace(self.state, hunts=(*self.state.hunts, hunt))
                times.update(content)
            else:
                hunt = replace(hunt, stage=Stage.SPAN)
                self._replace(place, hunt)
                kinds.update([self._parts.kind(self._simulated.row(hunt.held), hunt.unit)])
            self._continue(place, hunt)
            apart = np.minimum(np.delete(apart, best), self._distances([one for one, _ in options], [hunt]))
            affordable -= 1
            if not self.state.config.trials and self._parts.numeric:
                kept = [index for index, distance in enumerate(apart.tolist()) if distance >= APART]
                options, contents, apart = (
                    [options[k] for k in kept],
                    [contents[k] for k in kept],
                    apart[kept],
                )

    def _promise(self, *, from_safe: bool) -> float:
        """Return the share of hunts, of those from safe or from unsafe solutions, whose unit was found."""
        mine = [
            hunt.unit
            for hunt in self.state.hunts
            if hunt.from_safe == from_safe and hunt.stage not in BEFORE_LINE
        ]
        return (1.0 + sum(unit >= 0 for unit in mine)) / (2.0 + len(mine))

    def _sharpness(self, positions: set[tuple[int, int]]) -> dict[tuple[int, int], float]:
        """Return, by position, the share of ended lines whose threshold was known before all trials were used."""
        ended, early = Counter[tuple[int, int]](), Counter[tuple[int, int]]()
        for hunt in self.state.hunts if positions else ():
            if hunt.stage in (Stage.THRESHOLD, Stage.CHANCY):
                position = self._position(hunt)
                ended[position] += 1
                early[position] += (
                    hunt.stage is Stage.THRESHOLD and len(hunt.trials) < self.state.config.trials
                )
        return {one: (1.0 + early[one]) / (1.0 + ended[one]) for one in positions}

    def _position(self, hunt: Hunt) -> tuple[int, int]:
        """Return which number of which kind of block decides, whatever its categories; of others, the unit."""
        block = self._parts.block_of(hunt.unit) if hunt.unit >= 0 else -1
        if block < 0:
            return -1, hunt.unit
        found = self._parts.blocks[block]
        return found.part, found.columns.index(self._parts.units[hunt.unit][0])

    def _explored(self) -> int:
        """Return how many solutions were explored, or are about to be."""
        jobs = (*self.state.jobs, *self._plan.jobs)
        known = len(self.state.ledger.known) + len(self.state.explored)
        return known + sum(job.purpose is Purpose.EXPLORE for job in jobs)

    def _to_explore(self) -> int:
        return round(self.state.config.explore * min(self.state.ledger.budget, self._space.size))

    def _affordable(self) -> float:
        """Return how many more hunts the budget suffices for."""
        left = self.state.ledger.left - len(self._plan.rows) - self._reserved()
        return left / self._cost(None)

    def _reserved(self) -> float:
        """Return how many simulations the open hunts are expected to take, besides those in flight or planned."""
        jobs = (*self.state.jobs, *self._plan.jobs)
        asked = sum(job.purpose is not Purpose.EXPLORE for job in jobs)
        return max(sum(self._cost(hunt) for _, hunt in self._going_on()) - asked, 0.0)

    def _cost(self, hunt: Hunt | None) -> float:
        """Return how many simulations a hunt is still expected to take; None for one that begins.

        Those of its line count by the share of the hunts that have come so far.
        """
        stage = hunt.stage if hunt else Stage.SCREEN if self._parts.blocks else Stage.MOVE
        before = BEFORE_LINE.get(stage, 0)
        if stage not in (Stage.SPAN, Stage.BRACKET, Stage.ESTIMATE):
            screened, bracketed = self._shares
            likely = bracketed * (screened if stage is Stage.SCREEN else 1.0)
            return before + likely * (_ON_LINE + self._line_cost)
        assert hunt
        if self.state.config.trials:
            on_line = {Stage.SPAN: _ON_LINE, Stage.BRACKET: BATCH}.get(stage, 0)
            return max(on_line + self._line_cost - len(hunt.trials), 3.0)
        line = line_of(hunt, self._parts, self._simulated)
        safe, unsafe = (line.place_of(self._simulated.row(number)) for number in (hunt.safe, hunt.unsafe))
        return math.ceil(math.log2(max((unsafe - safe) / line.resolution, 2.0)))

    @cached_property
    def _shares(self) -> tuple[float, float]:
        """The shares of hunts that go on after their screen, and of those of which a line is then bracketed.

        Apart, because hunts that end at their screen are known long before the others.
        """
        hunts = [hunt for hunt in self.state.hunts if hunt.stage is not Stage.SCREEN]
        on = [hunt for hunt in hunts if hunt.stage is not Stage.ALONE]
        ended = [hunt.unit >= 0 for hunt in on if hunt.stage not in BEFORE_LINE]
        return (3.0 + len(on)) / (4.0 + len(hunts)), (3.0 + sum(ended)) / (4.0 + len(ended))

    @cached_property
    def _line_cost(self) -> float:
        """The number of simulations that the estimation of a line, or its bisection, is expected to take."""
        if self.state.config.trials:
            return USUAL_TRIALS * self.state.config.trials
        if not len(self.state.archive) or not self._parts.numeric:
            return 0.0
        row = self._simulated.row(int(self.state.archive.numbers[0]))
        columns = [column for unit in self._parts.numeric for column in self._parts.units[unit]]
        finest = (self._space.resolutions(row, columns)[0] / self._space.ranges[columns]).min()
        return math.log2(max(1.0 / finest, 1.0))

    def _options(self, ready: int) -> list[Hunt]:
        """Return hunts that may begin: near unsafe solutions, otherwise along further units of earlier ones.

        Args:
            ready: Number of lines that wait; only without any, further units are moved.
        """
        if not self.state.config.trials and self._parts.numeric:
            return self._pairs()
        anchors = {hunt.anchor for hunt in self.state.hunts}
        numbers = [number for number in self.state.explored if number not in anchors]
        if self._parts.blocks:
            fresh = self._screened(numbers)
        else:
            unsafe = (number for number in numbers if self._simulated.unsafe(number))
            fresh = [Hunt(anchor=one, seed=one, held=one, stage=Stage.MOVE) for one in unsafe]
        return fresh if fresh or ready else self._further() or self._alone()

    def _pairs(self) -> list[Hunt]:
        """Return hunts between solutions and the nearest ones of the other verdict and the same categories.

        Where chance has no part, a threshold costs a bisection, and any two solutions of both verdicts lead to one.
        What lies close to an earlier one is left out.
        """
        simulated, metric = self._simulated, Metric.of_space(self._space)
        archive = self.state.ledger.archive
        by_verdict = [archive.numbers[archive.unsafe == verdict][-_MOST_PAIRED:] for verdict in (False, True)]
        safe, unsafe = by_verdict
        if not safe.size or not unsafe.size:
            return []
        rows = [np.array([simulated.row(number) for number in numbers.tolist()]) for numbers in by_verdict]
        categories = [some[:, self._space.categorical] for some in rows]
        is_other = (categories[1][:, None] != categories[0][None]).any(axis=2)
        distances = np.where(is_other, np.inf, metric.between(rows[1], rows[0]))
        begun = {(hunt.anchor, hunt.opposite) for hunt in self.state.hunts}
        near = {
            (int(unsafe[i]), int(safe[j]))
            for order, of_safe in (
                (np.argsort(distances, axis=1, kind="stable"), False),
                (np.argsort(distances.T, axis=1, kind="stable"), True),
            )
            for one in range(len(order))
            for other in order[one, :_PARTNERS].tolist()
            for i, j in [(other, one) if of_safe else (one, other)]
            if np.isfinite(distances[i, j])
        }
        hunts = [
            Hunt(anchor=anchor, seed=anchor, held=anchor, stage=Stage.MOVE, opposite=opposite)
            for anchor, opposite in sorted(near - begun)
        ]
        apart = self._distances(hunts)
        return [hunt for hunt, distance in zip(hunts, apart.tolist(), strict=True) if distance >= APART]

    def _has_options(self) -> bool:
        ready = sum(hunt.stage is Stage.READY for hunt in self.state.hunts)
        return bool(ready or self._options(ready))

    def _screened(self, numbers: Sequence[int]) -> list[Hunt]:
        """Return hunts that may begin at explored solutions with active blocks, if these may decide.

        Most safe solutions are safe alone, so of those only the ones begin that are believed or known not to be.
        """
        archive, simulated, parts = self.state.ledger.archive, self._simulated, self._parts
        verdicts = dict(
            zip(row_keys(archive.vectors), archive.unsafe.tolist(), strict=True)
        )  # the last on each
        alone = self.state.alone
        for number in numbers:
            if number not in alone:
                anchor = simulated.row(number)
                active = parts.active(anchor)
                alone[number] = parts.without(anchor, active) if active else None
        rows = {number: row for number in numbers if (row := alone[number]) is not None}
        believed = self._safety(list(rows.values())) < 0.0
        hunts = []
        for (number, row), guess in zip(rows.items(), believed.tolist(), strict=True):
            is_safe = not simulated.unsafe(number)
            alone_unsafe = verdicts.get(row.tobytes(), guess if is_safe else False)
            if alone_unsafe == is_safe:
                hunts.append(
                    Hunt(anchor=number, seed=number, held=number, stage=Stage.SCREEN, from_safe=is_safe)
                )
        return hunts

    def _further(self) -> list[Hunt]:
        """Return hunts along further units of solutions near which a threshold was found."""
        by_anchor = Counter(hunt.anchor for hunt in self.state.hunts)
        found = {hunt.anchor: hunt for hunt in self.state.hunts if hunt.stage is Stage.THRESHOLD}
        options = []
        for anchor, hunt in found.items():
            left = set(self._parts.movable(self._simulated.row(hunt.held))) - set(hunt.moved)
            if left and by_anchor[anchor] < self.state.config.units:
                options.append(
                    Hunt(
                        anchor=anchor,
                        seed=hunt.seed,
                        held=hunt.held,
                        stage=Stage.MOVE,
                        needed=hunt.needed,
                        moved=hunt.moved,
                    )
                )
        return options

    def _alone(self) -> list[Hunt]:
        """Return hunts along the numbers of scenarios that are unsafe without any error."""
        begun = {hunt.held for hunt in self.state.hunts if hunt.stage is not Stage.ALONE}
        alone = [hunt for hunt in self.state.hunts if hunt.stage is Stage.ALONE and not hunt.from_safe]
        unsafe = {hunt.held: hunt.seed for hunt in alone}
        if self._parts.blocks:
            simulated = self._simulated
            unsafe |= {
                number: number
                for number in self.state.explored
                if simulated.unsafe(number) and not self._parts.active(simulated.row(number))
            }
        return [
            Hunt(anchor=number, seed=seed, held=number, stage=Stage.MOVE)
            for number, seed in unsafe.items()
            if number not in begun
            and set(self._parts.movable(self._simulated.row(number))) & set(self._parts.numeric)
        ]

    def _content(self, number: int) -> set[Kind]:
        return self._content_of(self._simulated.row(number))

    def _content_of(self, row: FloatArray) -> set[Kind]:
        return {self._parts.block_kind(row, block) for block in self._parts.active(row)}

    def _block_times(self) -> Counter[Kind]:
        """Return how often hunts were near solutions with each kind of block."""
        times: Counter[Kind] = Counter()
        for hunt in self.state.hunts:
            if hunt.stage not in (Stage.ALONE, Stage.GIVEN_UP, Stage.FIXED):
                times.update(self._content(hunt.held))
        return times

    def _place(self, hunt: Hunt) -> FloatArray:
        """Return where a hunt's threshold is to be expected, shape ``(d,)``."""
        if hunt.unsafe >= 0:
            return self._simulated.row(hunt.unsafe)
        held = self._simulated.row(hunt.held)
        return held if hunt.opposite < 0 else 0.5 * (held + self._simulated.row(hunt.opposite))

    def _length(self, hunt: Hunt) -> float:
        """Return how far a hunt's threshold may be from where it is expected; 0 without an opposite."""
        if hunt.opposite < 0 or hunt.unsafe >= 0:
            return 0.0
        rows = [self._simulated.row(number)[None] for number in (hunt.held, hunt.opposite)]
        return 0.5 * float(Metric.of_space(self._space).between(*rows)[0, 0])

    def _distances(self, hunts: Sequence[Hunt], others: Sequence[Hunt] | None = None) -> FloatArray:
        """Return the distance of each hunt to the nearest of the others, all earlier ones by default."""
        if others is None:
            others = [hunt for hunt in self.state.hunts if hunt.stage not in (Stage.ALONE, Stage.REPEATED)]
        if not hunts or not others:
            return np.full(len(hunts), np.inf)
        rows, earlier = (np.array([self._place(hunt) for hunt in some]) for some in (hunts, others))
        return np.asarray(Metric.of_space(self._space).between(rows, earlier).min(axis=1))

    def explore(self) -> None:
        """Fill the generation with exploration, at random and as the surrogate proposes.

        What the open hunts need is not spent meanwhile.
        """
        plan, state = self._plan, self.state
        share = _MOST_EXPLORED if self._lacks_kinds else 1.0
        wanted = max(round(share * self._to_explore()) - self._explored(), 0)
        if self._going_on():
            spare = state.ledger.left - len(plan.rows) - self._reserved() if not self._has_options() else 0.0
            plan.wanted = len(plan.rows) + min(plan.room, max(wanted, math.floor(max(spare, 0.0))))
        if not plan.rows and not state.ledger.flight:
            plan.wanted = max(plan.wanted, min(state.config.generation_size, int(state.ledger.left)))
        rng = self._rng(Draw.EXPLORE, self._generation)
        if state.surrogate is not None and plan.room:
            count = plan.room - int(rng.binomial(plan.room, state.config.chance))
            varied = self._varied(round(_VARIATIONS * plan.room), rng)
            for row in [*varied, *self._proposed(state.surrogate, count - len(varied), rng)]:
                plan.add(row, None, Job(Purpose.EXPLORE))
        for row in random_rows(state.ledger, plan.room, rng, plan.rows):
            plan.add(row, None, Job(Purpose.EXPLORE))

    def _varied(self, count: int, rng: np.random.Generator) -> list[FloatArray]:
        """Return solutions like those whose deciding unit is known, with one category changed to make another kind.

        Kinds that no hunt has are chosen, those explored least and most likely to be unsafe first.
        """
        parts, simulated = self._parts, self._simulated
        held = {hunt.held for hunt in self.state.hunts if hunt.unit >= 0 and not hunt.from_safe}
        if count <= 0 or not held or not parts.blocks:
            return []
        pool: list[FloatArray] = []
        for row in {(row := simulated.row(number)).tobytes(): row for number in sorted(held)}.values():
            for block in parts.active(row):
                for column in (*parts.choices(block), *parts.scene):
                    category = self._space.parameters[column]
                    assert isinstance(category, Categorical)
                    for code in category.codes:
                        pool += self._variations(row, block, column, float(code), rng)
        times, tried = self._block_times(), Counter[Kind]()
        for number in self.state.explored:
            contents = self._content(number)
            tried.update(contents if len(contents) == 1 else ())
        fresh = [(row, self._content_of(row)) for row in self.state.ledger.unseen(pool)]
        fresh = [(row, content) for row, content in fresh if content and not any(times[k] for k in content)]
        safety = self._safety([row for row, _ in fresh]).tolist()
        chosen: list[FloatArray] = []
        left = list(range(len(fresh)))
        while left and len(chosen) < count:
            best = min(
                left, key=lambda place: safety[place] + _TRIED * max(tried[k] for k in fresh[place][1])
            )
            left.remove(best)
            row, content = fresh[best]
            tried.update(content)
            chosen.append(row)
        return chosen

    def _variations(
        self, row: FloatArray, block: int, column: int, code: float, rng: np.random.Generator
    ) -> list[FloatArray]:
        """Return variants of a solution with a category set: the block's numbers as they are, and drawn again."""
        if row[column] == code:
            return []
        numbers = [one for one in self._parts.blocks[block].columns if not self._space.categorical[one]]
        rows = np.tile(row, (_VARIED, 1))
        rows[1:, numbers] = self._space.draw_unrepaired(_VARIED - 1, rng)[:, numbers]
        rows[:, column] = code
        changed = [column, *numbers]
        repaired = (self._space.repaired_parts(one, changed, rng) for one in rows)
        return [frozen_array(one) for one in repaired if one[column] == code]

    def _proposed(
        self, surrogate: RobustnessSurrogate, count: int, rng: np.random.Generator
    ) -> list[FloatArray]:
        if count <= 0 or not free_columns(self._space).any():
            return []
        archive, known = self.state.ledger.archive, self.state.ledger.known
        alone = [hunt.anchor for hunt in self.state.hunts if hunt.stage is Stage.ALONE and not hunt.from_safe]
        rows = np.concatenate([known.rows, archive.vectors])
        robustness = np.concatenate([known.robustness, archive.robustness])
        wanted = np.concatenate([known.unsafe, archive.unsafe & ~np.isin(archive.numbers, alone)])
        explored = [self._simulated.unsafe(number) for number in self.state.explored]
        if np.mean([*known.unsafe.tolist(), *explored] or [False]) >= _COMMON:
            return []
        more = _SPARE_PROPOSALS if self._parts.blocks else 1
        proposed = proposed_rows(self._space, surrogate, rows, robustness, wanted, more * count, rng)
        if self._parts.blocks:
            # Where the scenario alone is believed to be unsafe, nothing is to be learnt of errors.
            without = [self._parts.without(row, self._parts.active(row)) for row in proposed]
            safety = self._safety(
                [row if one is None else one for row, one in zip(proposed, without, strict=True)]
            )
            proposed = proposed[np.argsort(safety < 0.0, kind="stable")][:count]
        planned_keys = set(row_keys(np.array(self._plan.rows))) if self._plan.rows else set()
        return [row for row in self.state.ledger.unseen(proposed) if row.tobytes() not in planned_keys]


def random_rows(
    ledger: Ledger, count: int, rng: np.random.Generator, others: list[FloatArray]
) -> list[FloatArray]:
    """Return random solutions that were never asked for and are not among others, as far as there are any."""
    keys = {row.tobytes() for row in others}
    rows: tuple[FloatArray, ...] = ()
    for _ in range(200):
        if len(rows) >= count:
            break
        drawn = [ledger.space.join(ledger.space.sample(rng)) for _ in range(count - len(rows))]
        rows = ledger.unseen([*rows, *(row for row in drawn if row.tobytes() not in keys)])
    return list(rows[:count])

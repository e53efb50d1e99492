"""The candidates of the next generation of `edge@2`: those of open hunts, of new ones, and of exploration."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from brink.search.algorithms.ledger import Ledger, row_keys
from brink.search.algorithms.thresholds.parts import Kind, Parts, free_columns
from brink.search.algorithms.thresholds.stages import (
    COARSE,
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
from brink.search.space import FloatArray
from brink.search.streams import Stream, generator
from brink.search.surrogate import learning_size
from brink.search.thresholds.estimation import next_places
from brink.search.thresholds.line import valid_change

FIRST_BATCH: Final = 8
"""Trials with which the estimation of a threshold begins."""
BATCH: Final = 6
"""Trials of a threshold in flight at a time after that."""
BEFORE_BRACKET: Final = 4
"""Simulations that a hunt is expected to take before its bracket is narrowed."""
USUAL_TRIALS: Final = 0.8
"""Share of the most trials that a threshold is expected to take."""
FEWEST_EXPLORED: Final = 30
"""Random solutions before the surrogate proposes any."""
_DRAWS: Final = 12
"""Values drawn of each unit that may be moved, besides the ends of its range."""
_BEFORE_LOST: Final = 5
"""Hunts that count as not ended by a scenario that is unsafe alone, before there are results."""
_OPPOSITES: Final = 20
"""Nearest safe solutions of which one is approached."""
_COMMON: Final = 0.3
"""Share of unsafe solutions from which on random exploration finds enough of them."""
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

    There is room as long as a full generation fits. Those of hunts are often smaller, so there may be more of them.
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
    """Return the state with an up-to-date surrogate, which is refitted whenever there are 10% more solutions.

    Solutions that are unsafe without any error count as safe: there is nothing to look for near them.
    """
    archive, known = state.ledger.archive, state.ledger.known
    size = learning_size(len(known) + len(archive), one_in=10)
    if size < FEWEST_EXPLORED or (state.surrogate is not None and state.surrogate.size == size):
        return state
    rows = np.concatenate([known.rows, archive.vectors])[:size]
    robustness = np.concatenate([known.robustness, archive.robustness])[:size]
    unsafe = np.concatenate([known.unsafe, archive.unsafe])[:size]
    numbers = np.concatenate([-1 - np.arange(len(known)), archive.numbers])[:size]
    # Only what these solutions tell, so that a restored search fits the same.
    last = int(numbers[-1])
    alone = [hunt for hunt in state.hunts if hunt.stage is Stage.ALONE and hunt.held <= last]
    wanted = unsafe & ~np.isin(numbers, [number for hunt in alone for number in (hunt.anchor, hunt.held)])
    rng = generator(state.ledger.seed, Stream.THRESHOLDS, Draw.SURROGATE, size)
    seed = int(rng.integers(2**32, dtype=np.uint64))
    fitted = RobustnessSurrogate(state.ledger.space, rows, robustness, wanted, seed=seed)
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

    def _rng(self, draw: Draw, *index: int) -> np.random.Generator:
        return generator(self.state.ledger.seed, Stream.THRESHOLDS, draw, *index)

    def continue_hunts(self) -> None:
        """Plan the next simulations of open hunts for which none is in flight, those nearest to their end first.

        If the budget does not suffice for all, those that are farthest from it wait.
        """
        waiting = Counter(job.hunt for job in self.state.jobs if job.purpose is not Purpose.EXPLORE)
        full, left = self._usual_cost(), self.state.ledger.left + waiting.total()
        costs = {
            place: max(full - self._simulations(hunt), 1.0)
            for place, hunt in enumerate(self.state.hunts)
            if hunt.stage in OPEN
        }
        for place in sorted(costs, key=lambda place: (costs[place], place)):
            left -= costs[place]
            if not self._plan.room or (left < 0 and (self._plan.rows or waiting)):
                break
            if not waiting[place]:
                self._continue(place, self.state.hunts[place])

    def _continue(self, place: int, hunt: Hunt) -> None:
        """Plan all simulations of a hunt's stage; where none is valid, go on with the stage after it."""
        parts, simulated, held = self._parts, self._simulated, self._simulated.row(hunt.held)
        active = parts.active(held)
        seed: int | None = hunt.seed
        rows: list[tuple[FloatArray | None, Job]] = []
        match hunt.stage:
            case Stage.SCREEN | Stage.REDUCE:
                if hunt.stage is Stage.SCREEN:
                    rows = [(parts.without(held, active), Job(Purpose.SCREEN, place))]
                left = [block for block in active if block not in hunt.needed] if len(active) > 1 else []
                rows += [(parts.without(held, [block]), Job(Purpose.DROP, place, block)) for block in left]
                instead = Stage.MOVE
            case Stage.MOVE:
                self._move(place, hunt)
                return
            case Stage.SPAN | Stage.BRACKET:
                if hunt.stage is Stage.SPAN:
                    rows = [(far_row(hunt, parts, simulated), Job(Purpose.FAR, place))]
                probes = probe_rows(hunt, parts, simulated, self.state.config)
                rows += [(row, Job(Purpose.PROBE, place)) for row in probes]
                instead = Stage.ESTIMATE if self.state.config.trials else Stage.THRESHOLD
            case _:
                rows = [(row, Job(Purpose.TRIAL, place)) for row in self._trials(place, hunt)]
                seed, instead = None, Stage.GIVEN_UP
        valid = [(row, job) for row, job in rows if row is not None]
        if len(valid) > self._plan.room and self._plan.rows:
            return
        for row, job in valid[: self._plan.room]:
            self._plan.add(row, seed, job)
        if not valid:
            self._replace(place, replace(hunt, stage=instead))

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
        count = min(BATCH if hunt.trials else FIRST_BATCH, self.state.config.trials - len(hunt.trials))
        places = next_places(prior_of(hunt, line, self._simulated), found, count, rng)
        rows = [line.at(share) for share in places]
        return [line.end if row is None else row for row in rows]

    def _move(self, place: int, hunt: Hunt) -> None:
        """Plan the move of one unit that most probably makes a hunt's solution safe, rare kinds first.

        Where no single move is likely to, the solution approaches the nearest safe one, one unit after the other.
        """
        held = self._simulated.row(hunt.held)
        units = [unit for unit in self._parts.movable(held) if unit not in hunt.moved]
        rng = self._rng(Draw.MOVE, hunt.held, hunt.seed, len(hunt.moved))
        moves = [(unit, row) for unit in units for row in self._moved_rows(held, unit, rng)]
        safety = self._safety([row for _, row in moves])
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
        for index in sorted(range(len(moves)), key=lambda index: (ranks[index], index)):
            unit = moves[index][0]
            row = valid_change(self._space, held, moves[index][1], self._parts.units[unit])
            if row is not None and self._is_other(row, held, unit):
                self._plan.add(row, hunt.seed, Job(Purpose.MOVE, place, unit))
                return
        self._replace(place, replace(hunt, stage=Stage.FIXED))

    def _safety(self, rows: Sequence[FloatArray]) -> FloatArray:
        """Return the estimated ranks of robustness, 0 without a surrogate, shape ``(n,)``."""
        if self.state.surrogate is None or not rows:
            return np.zeros(len(rows))
        return self.state.surrogate.predict(np.array(rows))[0]

    def _approach(self, place: int, hunt: Hunt, held: FloatArray) -> bool:
        """Plan to set one unit to its value in a safe solution; return whether there is one."""
        if hunt.opposite < 0:
            hunt = replace(hunt, opposite=self._nearest_safe(held))
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
        unit_index, row = moves[int(np.argmax(self._safety([row for _, row in moves])))]
        self._plan.add(row, hunt.seed, Job(Purpose.APPROACH, place, unit_index))
        return True

    def _nearest_safe(self, held: FloatArray) -> int:
        """Return the number of a safe solution of the same categories, -1 for none.

        Of the nearest ones, it is the one that lies farthest from where other hunts are, so that thresholds spread.
        """
        archive, categorical = self.state.ledger.archive, self._space.categorical
        same = (archive.vectors[:, categorical] == held[categorical]).all(axis=1)
        places = np.flatnonzero(same & ~archive.unsafe)
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
        resolutions = self._space.resolutions(held)[0]
        for column in columns:
            parameter = self._space.parameters[column]
            if not self._space.categorical[column]:
                least, most = parameter.least, parameter.most  # type: ignore[union-attr]
                # All numbers of a block at 0 would read as dormant.
                rows[:3, column] = least, min(least + resolutions[column], most), most
        return list(rows)

    def _is_other(self, row: FloatArray, held: FloatArray, unit: int) -> bool:
        """Return whether people would call a solution with a moved unit another one."""
        columns = list(self._parts.units[unit])
        moved = np.abs(row[columns] - held[columns])
        least = np.where(self._space.categorical[columns], 1.0, self._space.resolutions(held)[0][columns])
        return bool((moved >= least).any())

    def _kinds(self) -> Iterable[Kind]:
        """Yield the kind of each hunt whose unit is known and that found, or may find, a threshold."""
        for hunt in self.state.hunts:
            if hunt.unit >= 0 and hunt.stage not in (Stage.CHANCY, Stage.GIVEN_UP):
                yield self._parts.kind(self._simulated.row(hunt.held), hunt.unit)

    def begin_hunts(self) -> None:
        """Begin hunts near unsafe solutions of rare kinds, as far as the budget suffices for all open ones."""
        affordable = self._affordable()
        if affordable < 1:
            return
        exploring = self._explored() < self._to_explore()
        options = self._options()
        contents = [self._content(hunt.held) for hunt in options]
        times, apart = self._block_times(), self._distances(options)
        while options and self._plan.room and affordable >= 1:
            rarest = [min((times[kind] for kind in content), default=0) for content in contents]
            best = min(range(len(options)), key=lambda index: (rarest[index], -apart[index], index))
            if exploring and rarest[best] > 0:
                break
            hunt, content = options.pop(best), contents.pop(best)
            place = len(self.state.hunts)
            self.state = replace(self.state, hunts=(*self.state.hunts, hunt))
            self._continue(place, hunt)
            times.update(content)
            apart = np.minimum(np.delete(apart, best), self._distances(options, [hunt]))
            affordable -= 1

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
        return left / self._usual_cost()

    def _reserved(self) -> float:
        """Return how many simulations the open hunts are expected to take, besides those in flight or planned."""
        jobs = (*self.state.jobs, *self._plan.jobs)
        asked = sum(job.purpose is not Purpose.EXPLORE for job in jobs)
        full = self._usual_cost()
        needed = sum(max(full - self._simulations(h), 1.0) for h in self.state.hunts if h.stage in OPEN)
        begun = [hunt.stage for hunt in self.state.hunts if hunt.stage is not Stage.SCREEN]
        lost = begun.count(Stage.ALONE) / (_BEFORE_LOST + len(begun))
        needed -= lost * full * sum(hunt.stage is Stage.SCREEN for hunt in self.state.hunts)
        return max(needed - asked, 0.0)

    def _usual_cost(self) -> float:
        """Return how many simulations a hunt is expected to take."""
        if self.state.config.trials:
            return BEFORE_BRACKET - math.log2(COARSE) + USUAL_TRIALS * self.state.config.trials
        row = self._simulated.row(int(self.state.archive.numbers[0])) if len(self.state.archive) else None
        if row is None or not self._parts.numeric:
            return BEFORE_BRACKET
        columns = [column for unit in self._parts.numeric for column in self._parts.units[unit]]
        finest = (self._space.resolutions(row)[0] / self._space.ranges)[columns].min()
        return BEFORE_BRACKET + math.log2(max(1.0 / finest, 1.0))

    def _simulations(self, hunt: Hunt) -> float:
        """Return how many of the usual simulations of a hunt are done."""
        if hunt.stage < Stage.BRACKET:
            return float(hunt.stage)
        line = line_of(hunt, self._parts, self._simulated)
        safe, unsafe = (line.place_of(self._simulated.row(number)) for number in (hunt.safe, hunt.unsafe))
        return BEFORE_BRACKET + max(math.log2(line.range / (unsafe - safe)), 0.0) + len(hunt.trials)

    def _options(self) -> list[Hunt]:
        """Return hunts that may begin: near unsafe solutions, otherwise along further units of earlier ones."""
        anchors = {hunt.anchor for hunt in self.state.hunts}
        archive = self.state.ledger.archive
        unsafe = dict(
            zip(row_keys(archive.vectors), archive.unsafe.tolist(), strict=True)
        )  # the last verdict on each
        fresh = []
        for number in self.state.explored:
            if number in anchors or not self._simulated.unsafe(number):
                continue
            hunt = self._first(number, unsafe)
            if hunt is not None:
                fresh.append(hunt)
        return fresh or self._further() or self._alone()

    def _first(self, number: int, unsafe: dict[bytes, bool]) -> Hunt | None:
        """Return the hunt that begins at an explored solution; None if its scenario is known to be unsafe alone."""
        row = self._simulated.row(number)
        hunt = Hunt(anchor=number, seed=number, held=number, stage=Stage.MOVE)
        if not self._parts.blocks:
            return hunt
        active = self._parts.active(row)
        alone = self._parts.without(row, active)
        if not active or (alone is not None and unsafe.get(alone.tobytes(), False)):
            return None
        return replace(hunt, stage=Stage.SCREEN)

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
        unsafe = {hunt.held: hunt.seed for hunt in self.state.hunts if hunt.stage is Stage.ALONE}
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
        row = self._simulated.row(number)
        return {self._parts.block_kind(row, block) for block in self._parts.active(row)}

    def _block_times(self) -> Counter[Kind]:
        """Return how often hunts were near solutions with each kind of block."""
        times: Counter[Kind] = Counter()
        for hunt in self.state.hunts:
            if hunt.stage not in (Stage.ALONE, Stage.GIVEN_UP, Stage.FIXED):
                times.update(self._content(hunt.held))
        return times

    def _distances(self, hunts: Sequence[Hunt], others: Sequence[Hunt] | None = None) -> FloatArray:
        """Return the distance of each hunt's solution to the nearest of the others, all earlier ones by default."""
        if others is None:
            others = [hunt for hunt in self.state.hunts if hunt.stage is not Stage.ALONE]
        if not hunts or not others:
            return np.full(len(hunts), np.inf)
        rows, earlier = (
            np.array([self._simulated.row(hunt.held) for hunt in some]) for some in (hunts, others)
        )
        return np.asarray(Metric.of_space(self._space).between(rows, earlier).min(axis=1))

    def explore(self) -> None:
        """Fill the generation with exploration, at random and as the surrogate proposes.

        What the open hunts need is not spent meanwhile.
        """
        plan, state = self._plan, self.state
        wanted = max(self._to_explore() - self._explored(), 0)
        if any(hunt.stage in OPEN for hunt in state.hunts):
            spare = state.ledger.left - len(plan.rows) - self._reserved() if not self._options() else 0.0
            plan.wanted = len(plan.rows) + min(plan.room, max(wanted, math.floor(max(spare, 0.0))))
        if not plan.rows and not state.ledger.flight:
            plan.wanted = max(plan.wanted, min(state.config.generation_size, int(state.ledger.left)))
        rng = self._rng(Draw.EXPLORE, self._generation)
        if state.surrogate is not None and plan.room:
            count = plan.room - int(rng.binomial(plan.room, state.config.chance))
            for row in self._proposed(state.surrogate, count, rng):
                plan.add(row, None, Job(Purpose.EXPLORE))
        for row in random_rows(state.ledger, plan.room, rng, plan.rows):
            plan.add(row, None, Job(Purpose.EXPLORE))

    def _proposed(
        self, surrogate: RobustnessSurrogate, count: int, rng: np.random.Generator
    ) -> list[FloatArray]:
        if count <= 0 or not free_columns(self._space).any():
            return []
        archive, known = self.state.ledger.archive, self.state.ledger.known
        alone = [hunt.anchor for hunt in self.state.hunts if hunt.stage is Stage.ALONE]
        rows = np.concatenate([known.rows, archive.vectors])
        robustness = np.concatenate([known.robustness, archive.robustness])
        wanted = np.concatenate([known.unsafe, archive.unsafe & ~np.isin(archive.numbers, alone)])
        explored = [self._simulated.unsafe(number) for number in self.state.explored]
        if np.mean([*known.unsafe.tolist(), *explored] or [False]) >= _COMMON:
            return []
        proposed = proposed_rows(self._space, surrogate, rows, robustness, wanted, count, rng)
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

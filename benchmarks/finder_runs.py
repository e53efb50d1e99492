"""Runs of searches in this process, alone or followed by the estimation of thresholds, within one budget.

A followed search spends a share of the budget. The rest brings its pairs to thresholds with `sharpen@1`, as the
follow-up of the product does: the tight pairs first, then unsafe solutions with the nearest safe ones. As many pairs
as the rest is expected to pay for are sharpened at a time, until it is spent.

Thresholds are read from the simulated solutions by the product's own analysis, whatever search simulated them. Their
ends, the 20 and the 80% point moved out by one resolution, are then simulated with fresh seeds, which no budget
includes.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any, Final

import numpy as np

from benchmarks.trials import cached_simulator
from brink.search.algorithm import AnyAlgorithm, Candidate, Evaluation, Failed, Scored, ask_all
from brink.search.algorithms.sharpen import Sharpen, SharpenConfig, moved_units
from brink.search.analysis.pairs import FoundPairs, find_pairs
from brink.search.archive import Archive, Neighbourhood
from brink.search.conclusions import Outcome
from brink.search.metric import Metric
from brink.search.pairs import Steps, midpoints
from brink.search.parameters import Number
from brink.search.sequential import Verdict, verdict_of
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import Stream, episode_seed, generator
from brink.search.surrogate import is_available
from brink.search.thresholds import MOST
from brink.search.thresholds.line import valid_change
from brink.server.campaigns.body import Budget, CampaignBody, PluginChoice
from brink.server.campaigns.outcomes import outcome_of
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.campaigns.thresholds import Threshold, find_thresholds, own_seeds
from brink.server.problems.base import InProcessProblem, Problem
from brink.sim.errors import SimulatorError
from brink.worker.child_protocol import completed_document
from brink.worker.wire import Completed

FRESH: Final = 20
"""Simulations of each end with fresh seeds."""
NARROW: Final = 0.05
"""Share of its range by which the number of a narrow pair differs at most."""
USUAL: Final = 45
"""Simulations that a pair is expected to take until its threshold is estimated."""
USUAL_SHARP: Final = 10
"""The same without chance."""
_FRESH_SEED: Final = 2**40
"""Added to a run's seed for its fresh simulations, so that no campaign has the same ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """The solutions that one search simulated, in the order of their numbers.

    Attributes:
        seed: Seed of the search.
        numbers: Their numbers.
        rows: The solutions.
        seeds: Their episode seeds.
        unsafe: Their verdicts.
        robustness: Their distances to violation.
    """

    seed: int
    numbers: list[int] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)
    seeds: list[int] = field(default_factory=list)
    unsafe: list[bool] = field(default_factory=list)
    robustness: list[float] = field(default_factory=list)

    def archive(self, space: SearchSpace) -> Archive:
        """Return them as an archive."""
        return Archive.empty(space, Neighbourhood()).grown(
            self.numbers,
            np.reshape(self.rows, (-1, space.dimension)),
            self.unsafe,
            self.robustness,
            keep_rows=False,
        )


@dataclass(slots=True, kw_only=True)
class Run:
    """A search, with what it simulated and what it cost.

    Attributes:
        parts: What the search simulated, then each estimation of its pairs.
        simulations: Simulations, failed ones included.
        search_cpu_s: CPU time of the search steps.
        search_s: Their wall-clock time.
        drives_cpu_s: CPU time of the simulations.
    """

    parts: list[Part] = field(default_factory=list)
    simulations: int = 0
    search_cpu_s: float = 0.0
    search_s: float = 0.0
    drives_cpu_s: float = 0.0

    def whole(self) -> Part:
        """Return the solutions of all parts as one, numbered anew."""
        joined = Part(seed=self.parts[0].seed)
        for part in self.parts:
            for name in ("rows", "seeds", "unsafe", "robustness"):
                getattr(joined, name).extend(getattr(part, name))
        joined.numbers.extend(range(len(joined.rows)))
        return joined


@dataclass(frozen=True, slots=True, kw_only=True)
class End:
    """Fresh simulations of one end of a threshold or of a pair.

    Attributes:
        unsafe: Unsafe ones among them.
        drives: All of them; 0 if there is no valid solution at this end.
        holds: Whether the sequential test confirmed the end's verdict, after all or some of them.
    """

    unsafe: int
    drives: int
    holds: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimated:
    """A threshold found in a run. Its values are in the unit of the number that changes.

    Attributes:
        name: The number, as component.parameter.
        columns: Columns of the unit.
        leading: Column of the number.
        kind: What tells its kind.
        row: A solution on the line.
        slopes: How much each column of the unit changes with the number.
        middle: The 50% point.
        low: End of its interval nearer to the safe end.
        high: The other end.
        start: The 20% point.
        end: The 80% point.
        resolution: Resolution of the number.
        range: Its range.
        drives: Simulations that it rests on.
        ends: The safe and the unsafe end, simulated again.
        curve: Values along the line, and the estimated probability with its 90% interval, as four lists.
    """

    name: str
    columns: list[int]
    leading: int
    kind: list[str]
    row: list[float]
    slopes: list[float]
    middle: float
    low: float
    high: float
    start: float
    end: float
    resolution: float
    range: float
    drives: int
    ends: list[End]
    curve: list[list[float]]

    @property
    def holds(self) -> bool:
        """Whether at most 20% of the fresh simulations were unsafe at one end, and at least 80% at the other."""
        return all(0 < end.drives >= 5 * _other(end, place) for place, end in enumerate(self.ends))

    @property
    def confirmed(self) -> bool:
        """Whether the sequential test confirmed both ends."""
        return all(end.holds for end in self.ends)

    def at(self, space: SearchSpace, value: float) -> FloatArray | None:
        """Return the solution with a value of the number; None if it is not valid."""
        row = np.array(self.row)
        for column, slope in zip(self.columns, self.slopes, strict=True):
            parameter = space.parameters[column]
            assert isinstance(parameter, Number)  # a unit of a threshold has no categories
            moved = self.row[column] + slope * (value - self.row[self.leading])
            row[column] = min(max(moved, parameter.least), parameter.most)
        return valid_change(space, np.array(self.row), row, tuple(self.columns))


def _other(end: End, place: int) -> int:
    return end.drives - end.unsafe if place else end.unsafe


class Runner:
    """Runs searches on a problem, and simulates again.

    Args:
        problem_id: Id of the problem.
        params: Its parameters.
    """

    def __init__(self, problem_id: str, params: Mapping[str, Any]) -> None:
        self._choice = PluginChoice(id=problem_id, params=dict(params))
        self.plan = self.plan_of("random@1", {}, 1)
        self.problem: Problem = self.plan.problem
        if is_available():
            import_module("sklearn.ensemble")  # takes seconds, which are not a search's

    def plan_of(self, algorithm: str, params: Mapping[str, Any], budget: int) -> Plan:
        """Return the problem and an algorithm with its settings, as a campaign has them."""
        return make_plan(
            CampaignBody(
                name="finders",
                problem=self._choice,
                algorithm=PluginChoice(id=algorithm, params=dict(params)),
                budget=Budget(simulations=budget),
                seed=1,
            )
        )

    @property
    def is_computed(self) -> bool:
        """Whether chance has no part in verdicts."""
        return self.problem.ignores_seeds

    def outcome(self, row: FloatArray, seed: int) -> tuple[Evaluation, Completed | None]:
        """Return the evaluation of a solution, and what was recorded; nothing where it is computed or fails."""
        vectors = self.problem.space.split(row)
        if isinstance(self.problem, InProcessProblem):
            return self.problem.evaluate(vectors), None
        spec = self.problem.episode(vectors, seed)
        try:
            result = cached_simulator(spec.simulator).run(spec)
        except SimulatorError as error:
            return Failed(reason=str(error)), None
        outcome = Completed.model_validate(completed_document(result))
        return self.problem.evaluation(outcome), outcome

    def search(self, run: Run, algorithm: str, params: Mapping[str, Any], *, seed: int, budget: int) -> Part:
        """Run a search with the problem's and the algorithm's defaults, and add what it simulated to a run."""
        plan = self.plan_of(algorithm, params, budget)
        made: AnyAlgorithm = plan.algorithm
        return self._searched(run, made, plan.config, seed=seed, budget=budget)

    def _searched(self, run: Run, algorithm: AnyAlgorithm, config: Any, *, seed: int, budget: int) -> Part:
        part = Part(seed=seed)
        run.parts.append(part)
        with _timed(run):
            state = algorithm.start(self.problem.space, config, seed=seed, budget=budget)
        while not algorithm.finished(state):
            with _timed(run):
                state, _ = ask_all(algorithm, state)
            evaluations = {one.number: self._simulated(run, part, one) for one in state.pending}
            with _timed(run):
                state = algorithm.tell(state, evaluations)
        return part

    def _simulated(self, run: Run, part: Part, candidate: Candidate) -> Evaluation:
        number = candidate.number if candidate.seed_number is None else candidate.seed_number
        seed, row = episode_seed(part.seed, number), self.problem.space.join(candidate.vectors)
        began_s = time.process_time()
        evaluation, _ = self.outcome(row, seed)
        run.drives_cpu_s += time.process_time() - began_s
        run.simulations += 1
        if isinstance(evaluation, Scored):
            part.numbers.append(candidate.number)
            part.rows.append(row.tolist())
            part.seeds.append(seed)
            part.unsafe.append(evaluation.unsafe)
            part.robustness.append(evaluation.robustness)
        return evaluation

    def sharpen(
        self, run: Run, pairs: Sequence[tuple[FloatArray, FloatArray]], *, seed: int, budget: int
    ) -> None:
        """Bring pairs to thresholds, as many as the budget allows, and add what was simulated to a run."""
        left, spent, usual = list(pairs), 0, USUAL_SHARP if self.is_computed else USUAL
        while left and budget - spent >= usual:
            taken = left[: (budget - spent) // usual]
            left = left[len(taken) :]
            config = SharpenConfig(
                safe=[safe.tolist() for safe, _ in taken],
                unsafe=[unsafe.tolist() for _, unsafe in taken],
                trials=0 if self.is_computed else MOST,
            )
            before = run.simulations
            their_seed = int(generator(seed, Stream.REPEATS, len(run.parts)).integers(2**53))
            self._searched(run, Sharpen(), config, seed=their_seed, budget=budget - spent)
            spent += run.simulations - before

    def fresh(
        self, row: FloatArray, run_seed: int, first: int, count: int
    ) -> Iterator[tuple[Evaluation, Completed | None]]:
        """Yield simulations of a solution with fresh seeds.

        Args:
            row: The solution, shape ``(d,)``.
            run_seed: Seed of its run.
            first: Number of the first one; no two simulations of a run have the same.
            count: How many.
        """
        for number in range(first, first + count):
            yield self.outcome(row, episode_seed(_FRESH_SEED + run_seed, number))

    def end(self, row: FloatArray, run_seed: int, first: int, *, unsafe: bool) -> tuple[End, str]:
        """Simulate an end with fresh seeds; also return how the first unsafe simulation failed, in words."""
        if self.is_computed:
            evaluation, _ = self.outcome(row, 0)
            assert isinstance(evaluation, Scored)
            words = outcome_of(self.problem, None, safe=False, robustness=evaluation.robustness).words()
            return End(unsafe=int(evaluation.unsafe), drives=1, holds=evaluation.unsafe is unsafe), words
        violating, drives, failed, fails, reached = 0, 0, 0, "", Verdict.UNDECIDED
        for evaluation, outcome in self.fresh(row, run_seed, first, FRESH):
            drives += 1
            if not isinstance(evaluation, Scored):
                failed += 1
                continue
            violating += evaluation.unsafe
            if evaluation.unsafe and not fails and outcome is not None:
                result, robustness = outcome.model_dump(mode="json"), evaluation.robustness
                fails = outcome_of(self.problem, result, safe=False, robustness=robustness).words(times=False)
            evaluated = drives - failed
            other = evaluated - violating if unsafe else violating
            if reached is Verdict.UNDECIDED:
                reached = verdict_of(other, evaluated, failed)
        return End(unsafe=violating, drives=drives, holds=reached is Verdict.HOLDS), fails


@contextmanager
def _timed(run: Run) -> Iterator[None]:
    """Add the time within to the search steps of a run."""
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    yield
    run.search_cpu_s += time.process_time() - cpu_s
    run.search_s += time.perf_counter() - wall_s


def found_pairs(space: SearchSpace, part: Part, *, eps: float, d_th: float) -> FoundPairs:
    """Return the distinct pairs among simulated solutions."""
    return find_pairs(part.archive(space), space, eps=eps, d_th=d_th, seeds=np.array(part.seeds, np.int64))


def pairs_to_sharpen(
    space: SearchSpace, part: Part, *, eps: float, d_th: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the pairs that an estimation of thresholds begins with, as safe and unsafe rows of shape ``(d,)``.

    The distinct tight pairs come first. Then each unsafe solution with the nearest safe one, the nearest first, as
    long as no earlier pair is within d_th.
    """
    archive = part.archive(space)
    place_of = {number: place for place, number in enumerate(archive.numbers.tolist())}
    tight = [
        (place_of[pair.safe.number], place_of[pair.unsafe.number])
        for pair in found_pairs(space, part, eps=eps, d_th=d_th).pairs
    ]
    safe, unsafe = np.flatnonzero(~archive.unsafe), np.flatnonzero(archive.unsafe)
    further: list[tuple[int, int]] = []
    if safe.size and unsafe.size:
        distances = archive.distances(unsafe, safe)
        nearest = distances.argmin(axis=1)
        order = np.argsort(distances.min(axis=1), kind="stable")
        further = list(zip(safe[nearest[order]].tolist(), unsafe[order].tolist(), strict=True))
    taken: list[tuple[FloatArray, FloatArray]] = []
    middles: list[FloatArray] = []
    metric = Metric.of_space(space)
    for place, (one, other) in enumerate([*tight, *further]):
        rows = archive.vectors[one], archive.vectors[other]
        middle = midpoints(rows[0][None], rows[1][None], space)
        is_near = bool(middles) and bool((metric.between(middle, np.array(middles)) < d_th).any())
        if moved_units(space, *rows) and (place < len(tight) or not is_near):
            taken.append(rows)
            middles.append(middle[0])
    return taken


def narrow_pairs(space: SearchSpace, part: Part, found: FoundPairs) -> list[tuple[FloatArray, FloatArray]]:
    """Return the pairs of which one unit of numbers alone moves, by at most `NARROW` of its range."""
    archive, steps, narrow = part.archive(space), Steps(space), []
    place_of = {number: place for place, number in enumerate(archive.numbers.tolist())}
    for pair in found.pairs:
        safe, unsafe = (archive.vectors[place_of[side.number]] for side in (pair.safe, pair.unsafe))
        units = steps.differing(safe, unsafe)
        columns = list(units[0])
        if len(units) > 1 or space.categorical[columns].any():
            continue
        if (np.abs(safe - unsafe)[columns] / space.ranges[columns]).max() <= NARROW:
            narrow.append((safe, unsafe))
    return narrow


def estimated_thresholds(runner: Runner, run: Run) -> list[Estimated]:
    """Return the thresholds among the solutions of a run, with their ends simulated again."""
    found: list[Estimated] = []
    plan, space = runner.plan, runner.problem.space
    for part in run.parts:
        archive = part.archive(space)
        own = own_seeds(np.array(part.seeds, np.int64), archive.numbers, part.seed)
        if runner.is_computed:
            own = np.ones(len(archive), np.bool_)
        for one in find_thresholds(archive, plan, own, part.seed, ended=True).of(Outcome.THRESHOLD):
            if np.isfinite([one.start, one.middle, one.end]).all():
                found.append(_checked(runner, run.parts[0].seed, 2 * FRESH * len(found), archive, one))
    return found


def _checked(runner: Runner, seed: int, first: int, archive: Archive, one: Threshold) -> Estimated:
    """Return a threshold with its ends simulated again."""
    space, line = runner.problem.space, one.line
    rows = archive.vectors[line.places[[0, -1]]]
    columns = list(line.unit)
    slopes = (rows[1] - rows[0])[columns] / (line.values[-1] - line.values[0])
    shares = one.shares
    name = space.column_names()[line.leading]
    made = Estimated(
        name=name,
        columns=columns,
        leading=line.leading,
        kind=[],
        row=rows[0].tolist(),
        slopes=slopes.tolist(),
        middle=one.middle,
        low=one.low,
        high=one.high,
        start=one.start,
        end=one.end,
        resolution=one.resolution,
        range=one.range,
        drives=one.drives,
        ends=[],
        curve=[
            np.round(part, 6).tolist() for part in (shares.values, shares.median, shares.low, shares.high)
        ],
    )
    out = 0.0 if runner.is_computed else one.resolution
    sign = 1.0 if line.rises else -1.0
    ends, fails = [], ""
    for place, value in enumerate((one.start - sign * out, one.end + sign * out)):
        row = made.at(space, value)
        if row is None:
            ends.append(End(unsafe=0, drives=0, holds=False))
        else:
            end, fails = runner.end(row, seed, first + place * FRESH, unsafe=bool(place))
            ends.append(end)
    traits = runner.problem.traits(name, space.decode(space.split(rows[0])))
    return replace(made, ends=ends, kind=[*traits, fails])

"""The search for thresholds."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from brink.search import exploration
from brink.search.algorithm import Candidate, Evaluation, Failed, Known, Scored, ask_all
from brink.search.algorithms.thresholds import (
    Job,
    Purpose,
    Stage,
    ThresholdConfig,
    ThresholdSearch,
    ThresholdState,
)
from brink.search.algorithms.thresholds.parts import Parts
from brink.search.algorithms.thresholds.stages import estimate_of, line_of
from brink.search.algorithms.thresholds.state import Simulated
from brink.search.document import Document
from brink.search.errors import DocumentError
from brink.search.problems import MTQ_SPACE, ONEMAX_SPACE, evaluate_mtq, evaluate_onemax, mtq_gap_to_boundary
from brink.search.space import Categorical, Component, Dormant, FloatArray, Real, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.testing import check_algorithm

Answer = Callable[[Candidate], Evaluation]
Ask = tuple[Candidate, Job]


def _errors(number: int) -> tuple[Any, ...]:
    return (
        Categorical(f"error_{number}.type", ("none", "miss", "late")),
        Real(f"error_{number}.severity", 0.0, 1.0, resolution=0.01),
    )


DRIVES = SearchSpace(
    (
        Component(
            "scenario", (Categorical("weather", ("dry", "wet", "ice")), Categorical("road", ("a", "b")))
        ),
        Component(
            "behaviour",
            (*_errors(1), *_errors(2)),
            tuple(Dormant(f"error_{n}.type", "none", (f"error_{n}.severity",)) for n in (1, 2)),
            tuple((f"error_{n}.type", f"error_{n}.severity") for n in (1, 2)),
        ),
    )
)
"""Drives with two errors; on ice, they are unsafe without any."""
STRETCH = 0.04


def threshold(row: FloatArray, kind: float) -> float:
    """Return the severity at which a drive turns."""
    return 0.35 + 0.2 * float(row[0]) + (0.15 if kind == 1 else 0.0)


def drive(candidate: Candidate) -> Scored:
    """Evaluate a drive: its seed decides where it turns, by a logistic function with a stretch of `STRETCH`."""
    row = DRIVES.join(candidate.vectors)
    number = candidate.number if candidate.seed_number is None else candidate.seed_number
    share = float(generator(7, Stream.CONTRACT, number).random())
    shift = STRETCH / (2 * math.log(4)) * math.log(share / (1 - share))
    margins = [threshold(row, row[c]) + shift - row[c + 1] for c in (2, 4) if row[c]]
    robustness = min(margins, default=1.0)
    if row[0] == 2:
        robustness = -1.0
    return Scored(unsafe=robustness < 0, robustness=robustness)


@pytest.fixture(scope="module", autouse=True)
def fewer_trees() -> Iterator[None]:
    """Let the searches grow few trees, of which these small problems do not need more."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(exploration, "TREES", 8)
        yield


def search(
    space: SearchSpace,
    answer: Answer,
    *,
    budget: int,
    seed: int = 1,
    known: Known | None = None,
    **settings: Any,
) -> tuple[ThresholdState, list[Ask]]:
    """Run a search; return its final state and all candidates with what they were for."""
    algorithm, asked, config = ThresholdSearch(), list[Ask](), ThresholdConfig(**settings)
    known = Known.nothing(space.dimension) if known is None else known
    state = algorithm.start_with(space, config, seed=seed, budget=budget, known=known)
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        asked += zip(state.pending, state.jobs, strict=False)
        state = algorithm.tell(state, {c.number: answer(c) for c in state.pending})
    return state, asked


@pytest.fixture(scope="module")
def drives() -> tuple[ThresholdState, list[Ask]]:
    return search(DRIVES, drive, budget=600)


def test_thresholds_lie_where_drives_turn(drives: tuple[ThresholdState, list[Ask]]) -> None:
    state, _ = drives
    parts, simulated = Parts(DRIVES), Simulated(state.archive)
    found = [hunt for hunt in state.hunts if hunt.stage is Stage.THRESHOLD]
    inside = []
    for hunt in found:
        line = line_of(hunt, parts, simulated)
        (column,) = line.unit
        at = estimate_of(state, hunt, parts, simulated)
        low, middle, high = (
            line.start[column] + place * (line.end[column] - line.start[column])
            for place in (at.low, at.middle, at.high)
        )
        turns = threshold(line.end, line.end[column - 1])
        assert middle == pytest.approx(turns, abs=STRETCH)
        assert low - 0.5 * STRETCH <= turns <= high + 0.5 * STRETCH
        inside.append(low <= turns <= high)
    assert len(inside) >= 5
    assert sum(inside) >= 0.5 * len(inside)  # few; test_search_thresholds counts many


def test_a_scenario_that_is_unsafe_alone_costs_one_simulation(
    drives: tuple[ThresholdState, list[Ask]],
) -> None:
    state, asked = drives
    simulated = Simulated(state.archive)
    alone = [
        place for place, hunt in enumerate(state.hunts) if hunt.stage is Stage.ALONE and not hunt.from_safe
    ]
    assert alone
    assert all(simulated.row(state.hunts[place].anchor)[0] == 2 for place in alone)
    purposes = {job.purpose for _, job in asked if job.purpose is not Purpose.EXPLORE and job.hunt in alone}
    assert purposes == {Purpose.SCREEN}
    others = [hunt for hunt in state.hunts if hunt.unit >= 0]
    assert all(simulated.row(hunt.held)[0] != 2 for hunt in others)


def test_errors_that_are_not_needed_are_dropped(drives: tuple[ThresholdState, list[Ask]]) -> None:
    state, _ = drives
    parts, simulated = Parts(DRIVES), Simulated(state.archive)
    for hunt in state.hunts:
        if hunt.unit >= 0:
            assert len(parts.active(simulated.row(hunt.held))) == 1
    kinds = {
        parts.kind(simulated.row(hunt.held), hunt.unit)
        for hunt in state.hunts
        if hunt.stage is Stage.THRESHOLD
    }
    assert len(kinds) == 2


def test_an_archive_says_what_a_line_is(drives: tuple[ThresholdState, list[Ask]]) -> None:
    state, asked = drives
    parts, simulated = Parts(DRIVES), Simulated(state.archive)
    for candidate, job in asked:
        row = DRIVES.join(candidate.vectors)
        if job.purpose is Purpose.EXPLORE:
            assert candidate.seed_number is None
            continue
        hunt = state.hunts[job.hunt]
        fresh = job.purpose in (Purpose.TRIAL, Purpose.CHECK)
        assert candidate.seed_number == (None if fresh else hunt.seed)
        if hunt.unit < 0 or not (fresh or job.purpose in (Purpose.PROBE, Purpose.FAR)):
            continue
        changed = np.flatnonzero(row != simulated.row(hunt.held))
        assert set(changed) <= set(parts.units[hunt.unit])


def test_most_of_the_budget_goes_into_thresholds(drives: tuple[ThresholdState, list[Ask]]) -> None:
    state, asked = drives
    times = Counter(job.purpose for _, job in asked)
    assert len(asked) == 600
    assert times[Purpose.TRIAL] >= 0.35 * len(asked)
    assert all(12 <= len(hunt.trials) <= 45 for hunt in state.hunts if hunt.stage is Stage.THRESHOLD)


def test_each_unit_that_makes_a_drive_safe_may_have_a_threshold() -> None:
    space = SearchSpace((Component("a", tuple(Real(name, 0.0, 1.0) for name in ("x", "y", "z"))),))

    def corner(candidate: Candidate) -> Scored:
        robustness = 0.6 - float(space.join(candidate.vectors).min())
        return Scored(unsafe=robustness < 0, robustness=robustness)

    state, asked = search(space, corner, budget=250)
    found = [hunt for hunt in state.hunts if hunt.stage is Stage.THRESHOLD]
    assert max(Counter(hunt.anchor for hunt in found).values()) >= 2
    assert {hunt.unit for hunt in found} == {0, 1, 2}
    moves = Counter(job.hunt for _, job in asked if job.purpose is Purpose.MOVE)
    assert sum(moves.values()) < 3 * len(moves) + 1  # all units of a solution at a time, and once


def test_what_protects_a_drive_is_varied_where_drives_without_it_are_unsafe() -> None:
    def protected(candidate: Candidate) -> Scored:
        row = DRIVES.join(candidate.vectors)
        robustness = max([row[c + 1] - 0.6 for c in (2, 4) if row[c]], default=-1.0)
        return Scored(unsafe=robustness < 0, robustness=float(robustness))

    state, _ = search(DRIVES, protected, budget=300)
    parts, simulated = Parts(DRIVES), Simulated(state.archive)
    found = [hunt for hunt in state.hunts if hunt.stage is Stage.THRESHOLD]
    assert len(found) >= 3
    for hunt in found:
        assert hunt.from_safe
        (column,) = parts.units[hunt.unit]
        assert simulated.row(hunt.safe)[column] >= 0.6 > simulated.row(hunt.unsafe)[column]


def test_thresholds_are_of_many_kinds() -> None:
    types, roads = ("none", *"abcdef"), ("left", "right", "straight", "crossroad")
    space = SearchSpace(
        (
            Component("scenario", (Categorical("road", roads, tells_kinds=True), Real("speed", 0.0, 1.0))),
            Component(
                "behaviour",
                (Categorical("type", types), Real("severity", 0.0, 1.0, resolution=0.01)),
                (Dormant("type", "none", ("severity",)),),
            ),
        )
    )

    def answer(candidate: Candidate) -> Scored:
        """Evaluate a drive: one type is often unsafe, the others rarely."""
        row = space.join(candidate.vectors)
        turns = 0.3 if row[2] == 1 else 0.9
        robustness = turns + 0.02 * float(row[0]) - row[3] if row[2] else 1.0
        return Scored(unsafe=robustness < 0, robustness=robustness)

    state, _ = search(space, answer, budget=600)
    simulated = Simulated(state.archive)
    found = [simulated.row(hunt.held) for hunt in state.hunts if hunt.stage is Stage.THRESHOLD]
    kinds = Counter((row[2], row[0]) for row in found)
    assert len(kinds) >= 8
    assert max(kinds.values()) <= 2  # so all that remains looks for other kinds


def test_without_chance_thresholds_are_bisected_to_the_resolution() -> None:
    state, asked = search(MTQ_SPACE, lambda c: evaluate_mtq(c.vectors), budget=300, trials=0, in_flight=1)
    simulated = Simulated(state.archive)
    found = [hunt for hunt in state.hunts if hunt.stage is Stage.THRESHOLD]
    assert len(found) >= 10
    for hunt in found:
        safe, unsafe = simulated.row(hunt.safe), simulated.row(hunt.unsafe)
        assert np.abs(safe - unsafe).sum() <= 0.002 + 1e-12
        assert mtq_gap_to_boundary(*(0.5 * (safe + unsafe))) <= 0.002
    assert not {Purpose.TRIAL, Purpose.CHECK, Purpose.FAR} & {job.purpose for _, job in asked}


def test_chance_everywhere_is_no_threshold() -> None:
    def coin(candidate: Candidate) -> Scored:
        number = candidate.number if candidate.seed_number is None else candidate.seed_number
        unsafe = bool(generator(3, Stream.CONTRACT, number, candidate.number).random() < 0.5)
        return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0)

    space = SearchSpace((Component("a", (Real("x", 0.0, 1.0), Real("y", 0.0, 1.0))),))
    state, asked = search(space, coin, budget=200)
    stages = Counter(hunt.stage for hunt in state.hunts)
    assert stages[Stage.CHANCY] >= 8
    assert stages[Stage.THRESHOLD] <= 1
    spent = Counter(job.hunt for _, job in asked if job.purpose is not Purpose.EXPLORE)
    chancy = [spent[place] for place, hunt in enumerate(state.hunts) if hunt.stage is Stage.CHANCY]
    assert np.median(chancy) <= 10  # fresh seeds of both ends tell before a curve is estimated


def test_where_nothing_is_unsafe_all_simulations_explore() -> None:
    state, asked = search(DRIVES, lambda _: Scored(unsafe=False, robustness=1.0), budget=120)
    assert not state.hunts
    assert {job.purpose for _, job in asked} == {Purpose.EXPLORE}
    assert len(asked) == 120


def test_in_a_space_of_categories_the_deciding_category_is_found() -> None:
    state, asked = search(ONEMAX_SPACE, lambda c: evaluate_onemax(c.vectors), budget=200, trials=0)
    simulated = Simulated(state.archive)
    found = [hunt for hunt in state.hunts if hunt.stage is Stage.CATEGORY]
    assert found or Purpose.MOVE not in {job.purpose for _, job in asked}
    for hunt in found:
        assert (simulated.row(hunt.safe) != simulated.row(hunt.unsafe)).sum() == 1


def test_hunts_whose_simulations_fail_are_given_up() -> None:
    def failing(candidate: Candidate) -> Evaluation:
        return drive(candidate) if candidate.seed_number is None else Failed(reason="synthetic")

    state, _ = search(DRIVES, failing, budget=150)
    assert state.hunts
    assert {hunt.stage for hunt in state.hunts} <= {Stage.GIVEN_UP, Stage.SCREEN}


def test_small_generations_leave_room_for_more_of_them() -> None:
    algorithm, config = ThresholdSearch(), ThresholdConfig(generation_size=20, in_flight=3)
    state = algorithm.start(DRIVES, config, seed=1, budget=400)
    flights = []
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        flights.append([len(generation) for generation in state.ledger.flight])
        state = algorithm.tell(state, {c.number: drive(c) for c in state.pending})
    assert max(map(sum, flights)) == 60
    assert max(map(len, flights)) > 3


def test_lines_take_as_many_trials_at_a_time_as_is_set() -> None:
    def most_at_a_time(batch: int) -> int:
        algorithm, config = ThresholdSearch(), ThresholdConfig(batch=batch)
        state, most = algorithm.start(DRIVES, config, seed=1, budget=300), 0
        while not algorithm.finished(state):
            state, generations = ask_all(algorithm, state)
            asked = state.jobs[len(state.jobs) - sum(map(len, generations)) :]
            trials = Counter(job.hunt for job in asked if job.purpose is Purpose.TRIAL)
            most = max(most, *trials.values(), 0)
            state = algorithm.tell(state, {c.number: drive(c) for c in state.pending})
        return most

    assert most_at_a_time(6) == 8
    assert most_at_a_time(20) == 20


def test_rare_unsafe_solutions_are_found() -> None:
    space = SearchSpace((Component("a", tuple(Real(f"x{place}", 0.0, 1.0) for place in range(6))),))

    def corner(candidate: Candidate) -> Scored:
        robustness = float(np.linalg.norm(space.join(candidate.vectors) - 0.8)) - 0.25
        return Scored(unsafe=robustness < 0, robustness=robustness)

    rows = np.random.default_rng(1).random((20_000, 6))
    share = (np.linalg.norm(rows - 0.8, axis=1) < 0.25).mean()
    state, asked = search(space, corner, budget=300, explore=1.0)
    explored = [candidate for candidate, job in asked if job.purpose is Purpose.EXPLORE]
    unsafe = sum(corner(candidate).unsafe for candidate in explored)
    assert share < 0.002
    assert unsafe >= 10
    assert len(state.archive) == 300


def test_known_results_guide_the_search() -> None:
    rng = np.random.default_rng(4)
    rows = np.array([DRIVES.join(DRIVES.sample(rng)) for _ in range(60)])
    told = [drive(Candidate(number=n, vectors=DRIVES.split(row))) for n, row in enumerate(rows)]
    known = Known(
        rows=rows,
        unsafe=np.array([one.unsafe for one in told]),
        robustness=np.array([one.robustness for one in told]),
        points=rows[:0],
    )
    check_algorithm(ThresholdSearch(), DRIVES, budget=120, evaluate=drive, repeats=True, known=known)


@pytest.mark.parametrize(
    ("entry", "wrong"),
    [("hunts", [{"anchor": 0}]), ("jobs", [[0, 0, 0]]), ("explored", [10_000]), ("explored", None)],
)
def test_a_corrupt_document_is_refused(entry: str, wrong: object) -> None:
    algorithm, config = ThresholdSearch(), ThresholdConfig()
    state = algorithm.start(DRIVES, config, seed=1, budget=100)
    stored = algorithm.dump(state)
    broken = Document(
        kind=stored.kind, version=stored.version, header={**stored.header, entry: wrong}, arrays=stored.arrays
    )
    with pytest.raises(DocumentError):
        algorithm.load(DRIVES, config, broken, state.archive)

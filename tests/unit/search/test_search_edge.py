"""The search for pairs across the boundary."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import Candidate, Evaluation, Failed, Scored, ask_all
from brink.search.algorithms.edge import MAX_FAILURES, Bracket, Edge, EdgeConfig, EdgeState, Purpose, Status
from brink.search.algorithms.edge.planning import _hits
from brink.search.analysis.pairs import find_pairs
from brink.search.errors import ConfigError, DocumentError
from brink.search.pairs import Steps, midpoints
from brink.search.problems import MTQ_SPACE, ONEMAX_SPACE, evaluate_mtq, evaluate_onemax, mtq_gap_to_boundary
from brink.search.space import Categorical, Component, Integer, Real, SearchSpace

Answer = Callable[[Candidate], Evaluation]
Ask = tuple[Candidate, tuple[Purpose, int, int]]

ROAD = SearchSpace(
    (
        Component("scenario", (Real("gap", 0.0, 50.0, "m"), Categorical("road", ("a", "b", "c")))),
        Component("behaviour", (Real("delay", 0.0, 2.0, "s"), Integer("frames", 0, 40))),
    )
)


pytestmark = pytest.mark.usefixtures("fewer_trees")


def search(
    space: SearchSpace, answer: Answer, *, budget: int = 400, seed: int = 1, **settings: Any
) -> tuple[EdgeState, list[Ask]]:
    """Run a search; return its final state and all candidates with what they were for."""
    algorithm, asked = Edge(), list[Ask]()
    state = algorithm.start(space, EdgeConfig(**settings), seed=seed, budget=budget)
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        asked += zip(state.pending, state.jobs, strict=False)
        state = algorithm.tell(state, {c.number: answer(c) for c in state.pending})
    return state, asked


def on_the_road(candidate: Candidate) -> Scored:
    """Unsafe if the detector is late for the gap; road b is always safe."""
    row = ROAD.join(candidate.vectors)
    value = row[0] / 50 - row[2] / 2 - row[3] / 80 + 0.25 * row[1] ** 2 * (2 - row[1])
    return Scored(unsafe=bool(value < 0), robustness=float(value))


def chancy_road(candidate: Candidate) -> Scored:
    """As `on_the_road`, but on road c every second episode ends the other way, whatever the solution."""
    scored, row = on_the_road(candidate), ROAD.join(candidate.vectors)
    seed = candidate.number if candidate.seed_number is None else candidate.seed_number
    if row[1] == 2 and seed % 2:
        return Scored(unsafe=not scored.unsafe, robustness=-scored.robustness)
    return scored


def rows_of(state: EdgeState) -> Mapping[int, np.ndarray[Any, Any]]:
    return dict(zip(state.archive.numbers.tolist(), state.archive.vectors, strict=True))


def with_status(state: EdgeState, status: Status) -> list[Bracket]:
    return [bracket for bracket in state.brackets if bracket.status is status]


def search_mtq(budget: int, seed: int = 1) -> EdgeState:
    settings = {"eps": 0.002, "d_th": 0.05, "checks": 0, "margin": 0.0}
    return search(MTQ_SPACE, lambda c: evaluate_mtq(c.vectors), budget=budget, seed=seed, **settings)[0]


@pytest.fixture(scope="module")
def mtq() -> EdgeState:
    return search_mtq(600, seed=2)


@pytest.fixture(scope="module")
def chancy() -> tuple[EdgeState, list[Ask]]:
    return search(ROAD, chancy_road, budget=600, d_th=0.02)


def test_pairs_lie_on_the_true_boundary(mtq: EdgeState) -> None:
    gaps = gaps_to_the_circle(mtq)
    assert len(gaps) >= 6
    assert np.mean(gaps) <= 0.001


@pytest.mark.long("takes seconds for each seed")
@pytest.mark.parametrize("seed", range(2, 6))
def test_1300_simulations_find_nine_distinct_pairs(seed: int) -> None:
    gaps = gaps_to_the_circle(search_mtq(1300, seed))
    assert len(gaps) >= 9
    assert np.mean(gaps) <= 0.001


def gaps_to_the_circle(state: EdgeState) -> list[float]:
    """Return the distance of each distinct pair's midpoint from the true boundary of MTQ."""
    rows = rows_of(state)
    pairs = find_pairs(state.archive, MTQ_SPACE, eps=0.002, d_th=0.05).pairs
    sides = [(rows[pair.safe.number][None], rows[pair.unsafe.number][None]) for pair in pairs]
    return [mtq_gap_to_boundary(*midpoints(safe, unsafe, MTQ_SPACE)[0]) for safe, unsafe in sides]


def test_kept_brackets_are_tight_and_across_the_boundary(mtq: EdgeState) -> None:
    steps, rows = Steps(MTQ_SPACE), rows_of(mtq)
    unsafe = dict(zip(mtq.archive.numbers.tolist(), mtq.archive.unsafe.tolist(), strict=True))
    kept = with_status(mtq, Status.KEPT)
    assert kept
    for bracket in kept:
        assert (unsafe[bracket.safe], unsafe[bracket.unsafe]) == (False, True)
        assert steps.is_tight(rows[bracket.safe], rows[bracket.unsafe], 0.002)


def test_a_bracket_is_narrowed_under_one_episode_seed(chancy: tuple[EdgeState, list[Ask]]) -> None:
    state, asked = chancy
    seeds = {candidate.number: candidate.seed_number for candidate, _ in asked}
    probes = [(candidate, of) for candidate, (purpose, of, _) in asked if purpose is Purpose.PROBE]
    assert probes
    for candidate, of in probes:
        assert candidate.seed_number == state.brackets[of].seed
    for bracket in state.brackets:
        for number in (bracket.safe, bracket.unsafe):
            assert bracket.seed in (number, seeds[number])


def test_probes_lie_between_the_sides_and_keep_the_categories(chancy: tuple[EdgeState, list[Ask]]) -> None:
    state, asked = chancy
    rows = rows_of(state)
    for candidate, (purpose, of, _) in asked:
        if purpose is Purpose.PARTNER:
            anchor, partner = rows[of], ROAD.join(candidate.vectors)
            assert (anchor[ROAD.categorical] == partner[ROAD.categorical]).all()
            assert not np.array_equal(anchor, partner)


def test_checks_repeat_a_side_under_a_seed_of_its_own(chancy: tuple[EdgeState, list[Ask]]) -> None:
    state, asked = chancy
    rows = rows_of(state)
    checks = [(candidate, of, side) for candidate, (purpose, of, side) in asked if purpose is Purpose.CHECK]
    assert checks
    for candidate, of, side in checks:
        bracket = state.brackets[of]
        assert candidate.seed_number is None
        assert np.array_equal(ROAD.join(candidate.vectors), rows[bracket.unsafe if side else bracket.safe])


def test_checks_tell_chancy_places_from_pairs(chancy: tuple[EdgeState, list[Ask]]) -> None:
    state, _ = chancy
    rows = rows_of(state)
    assert with_status(state, Status.CHANCY)
    assert all(rows[bracket.safe][1] == 2 for bracket in with_status(state, Status.CHANCY))
    kept = with_status(state, Status.KEPT)
    assert sum(rows[bracket.safe][1] != 2 for bracket in kept) >= 0.8 * len(kept)


def test_more_checks_leave_fewer_chancy_pairs() -> None:
    state, _ = search(ROAD, chancy_road, budget=600, d_th=0.02, checks=4)
    rows = rows_of(state)
    kept = with_status(state, Status.KEPT)
    assert kept
    assert sum(rows[bracket.safe][1] == 2 for bracket in kept) <= 1


@pytest.mark.parametrize(("budget", "seed"), [(260, 1), (400, 1), (400, 2)])
def test_nearly_all_tight_pairs_are_checked_before_the_budget_ends(budget: int, seed: int) -> None:
    slopes = np.array([1.0, -0.6, 0.4, 0.8, -0.9, 0.3])
    space = SearchSpace((Component("all", tuple(Real(f"x{n}", 0.0, 1.0) for n in range(6))),))

    def answer(candidate: Candidate) -> Scored:
        value = float(slopes @ space.join(candidate.vectors)) - 0.5
        return Scored(unsafe=value < 0, robustness=value)

    state, _ = search(space, answer, budget=budget, seed=seed, d_th=0.15)
    kept, tight, still_open = (
        len(with_status(state, status)) for status in (Status.KEPT, Status.TIGHT, Status.OPEN)
    )
    assert kept >= 8
    assert tight + still_open <= 0.2 * kept, (kept, tight, still_open)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda one: {"unsafe": 10_000}, "brackets: 10000 is none of the solutions"),
        (lambda one: {"seed": -7}, "brackets: -7 is none of the solutions"),
        (lambda one: {"safe": one.unsafe, "unsafe": one.safe}, "does not have the verdict of its side"),
    ],
)
def test_a_stored_state_with_wrong_brackets_is_refused(
    chancy: tuple[EdgeState, list[Ask]], change: Callable[[Bracket], dict[str, Any]], says: str
) -> None:
    algorithm, state = Edge(), chancy[0]
    broken = dataclasses.replace(state.brackets[0], **change(state.brackets[0]))
    stored = algorithm.dump(dataclasses.replace(state, brackets=(broken, *state.brackets[1:])))
    with pytest.raises(DocumentError, match=says):
        algorithm.load(ROAD, state.config, stored, state.archive)


def test_pairs_of_categories_differ_in_one() -> None:
    state, _ = search(ONEMAX_SPACE, lambda c: evaluate_onemax(c.vectors), budget=500, checks=0)
    found = find_pairs(state.archive, ONEMAX_SPACE, eps=1e-6, d_th=0.1)
    assert found.pairs
    assert {len(pair.units) for pair in found.pairs} == {1}


@pytest.mark.parametrize("component", ["scenario", "behaviour"])
def test_pairs_may_differ_in_one_component_only(component: str) -> None:
    state, _ = search(ROAD, on_the_road, vary=component)
    rows, fixed = rows_of(state), ROAD.slices[1 - ROAD.index(component)]
    assert state.brackets
    for bracket in state.brackets:
        assert np.array_equal(rows[bracket.safe][fixed], rows[bracket.unsafe][fixed])


def test_a_bracket_that_cannot_be_simulated_is_given_up() -> None:
    def never_again(candidate: Candidate) -> Evaluation:
        late = candidate.seed_number is not None and candidate.number > 200
        return Failed(reason="crashed") if late else on_the_road(candidate)

    state, asked = search(ROAD, never_again)
    assert len(asked) == 400
    given_up = with_status(state, Status.GIVEN_UP)
    assert given_up
    assert {bracket.failures for bracket in given_up} == {MAX_FAILURES}


def test_without_an_unsafe_solution_it_explores_in_full_generations() -> None:
    state, asked = search(ROAD, lambda _: Scored(unsafe=False, robustness=1.0), generation_size=20)
    assert {purpose for _, (purpose, _, _) in asked} == {Purpose.EXPLORE}
    assert (len(asked), state.ledger.generation) == (400, 20)


def test_missing_scikit_learn_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("brink.search.algorithms.edge.search.is_available", lambda: False)
    with pytest.raises(ConfigError, match=r"needs scikit-learn.*\[analysis\]"):
        Edge().check(ROAD, EdgeConfig(), budget=100)


def test_an_unknown_component_is_named_with_what_was_meant() -> None:
    with pytest.raises(ConfigError, match=r"vary: expected all or the name of a component.*behaviour"):
        Edge().check(ROAD, EdgeConfig(vary="behavior"), budget=100)


def test_a_partner_that_is_known_already_is_no_miss() -> None:
    """In a small space, many draws are; counted as misses, they made the reserve for open brackets too small."""
    space = SearchSpace((Component("all", tuple(Categorical(f"c{i}", ("a", "b", "c")) for i in range(5))),))

    def answer(candidate: Candidate) -> Scored:
        unsafe = int(space.join(candidate.vectors).sum()) > 4
        return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0)

    state, asked = search(space, answer, budget=150, d_th=0.0, eps=0.001, explore=0.2)
    partners = sum(purpose is Purpose.PARTNER for _, (purpose, _, _) in asked)
    assert sum(state.tries.values()) > partners > 0, "else this shows nothing"
    assert _hits(state) == pytest.approx((0.8 * 20 + len(state.brackets)) / (20 + partners))


def test_the_budget_is_spent_exactly_and_few_brackets_are_left_open(mtq: EdgeState) -> None:
    assert len(mtq.archive) == 600
    assert len(with_status(mtq, Status.OPEN)) <= 0.15 * len(mtq.brackets)


def test_settings_are_those_of_the_documented_defaults() -> None:
    given = dataclasses.asdict(EdgeConfig())
    assert {name: given[name] for name in ("eps", "d_th", "explore", "margin", "checks", "vary")} == {
        "eps": 0.02,
        "d_th": 0.2,
        "explore": 0.4,
        "margin": 0.2,
        "checks": 1,
        "vary": "all",
    }

"""The searches that `edge@1` is compared with: DeepJanus, straddle, Bayesian safety validation, nearest opposites."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import AnyAlgorithm, Candidate, Evaluation, Failed, Scored, ask_all
from brink.search.algorithms.bsv import Bsv, BsvConfig, logits, probabilities
from brink.search.algorithms.deepjanus import ACROSS, DeepJanus, DeepJanusConfig, DeepJanusState, _objectives
from brink.search.algorithms.nearest_opposite import (
    NearestOpposite,
    NearestOppositeConfig,
    NearestOppositeState,
    Status,
)
from brink.search.algorithms.random_search import RandomSearch, RandomSearchConfig
from brink.search.algorithms.straddle import Straddle, StraddleConfig
from brink.search.analysis.pairs import find_pairs
from brink.search.archive import Archive
from brink.search.errors import ConfigError, DocumentError
from brink.search.pairs import Steps
from brink.search.problems import MTQ_SPACE, evaluate_mtq, mtq_gap_to_boundary
from brink.search.space import Categorical, Component, Integer, Real, SearchSpace

Answer = Callable[[Candidate], Evaluation]

ROAD = SearchSpace(
    (
        Component("scenario", (Real("gap", 0.0, 50.0, "m"), Categorical("road", ("a", "b", "c")))),
        Component("behaviour", (Real("delay", 0.0, 2.0, "s"), Integer("frames", 0, 40))),
    )
)


def mtq(candidate: Candidate) -> Scored:
    return evaluate_mtq(candidate.vectors)


def rare(candidate: Candidate) -> Scored:
    """As `mtq`, but unsafe inside the circle, which is 10% of the square."""
    value = -mtq(candidate).robustness
    return Scored(unsafe=value < 0, robustness=value)


def on_the_road(candidate: Candidate) -> Scored:
    """Unsafe if the detector is late for the gap."""
    row = ROAD.join(candidate.vectors)
    value = row[0] / 50 - row[2] / 2 - row[3] / 80 + 0.1 * row[1]
    return Scored(unsafe=bool(value < 0), robustness=float(value))


def searched(
    algorithm: AnyAlgorithm,
    config: Any,
    answer: Answer,
    *,
    budget: int,
    space: SearchSpace = MTQ_SPACE,
    seed: int = 1,
) -> tuple[Any, list[Candidate]]:
    """Run a search; return its final state and all candidates."""
    state, asked = algorithm.start(space, config, seed=seed, budget=budget), list[Candidate]()
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        asked += state.pending
        state = algorithm.tell(state, {one.number: answer(one) for one in state.pending})
    return state, asked


def near_the_circle(archive: Archive) -> float:
    """Return the share of solutions of MTQ at most .02 from the boundary; of random ones it is 4.6%."""
    return float(np.mean([mtq_gap_to_boundary(*row) <= 0.02 for row in archive.vectors]))


def distinct_pairs(archive: Archive, eps: float, d_th: float = 0.05) -> int:
    return len(find_pairs(archive, MTQ_SPACE, eps=eps, d_th=d_th).pairs)


def randomly(budget: int, seed: int = 1) -> Archive:
    archive: Archive = searched(RandomSearch(), RandomSearchConfig(), mtq, budget=budget, seed=seed)[
        0
    ].archive
    return archive


# Straddle


def test_straddle_simulates_near_the_circle() -> None:
    state, _ = searched(Straddle(), StraddleConfig(), mtq, budget=300)
    assert near_the_circle(state.archive) > 3 * near_the_circle(randomly(300))


def test_straddle_with_trees_simulates_near_the_boundary() -> None:
    state, _ = searched(Straddle(), StraddleConfig(), on_the_road, budget=300, space=ROAD)
    size = np.abs(state.archive.robustness)
    assert np.median(size[60:]) < 0.5 * np.median(size[:60])


def test_straddle_explores_as_long_as_there_is_nothing_to_learn() -> None:
    def level(candidate: Candidate) -> Evaluation:
        return Scored(unsafe=False, robustness=1.0) if candidate.number % 2 else Failed(reason="test")

    for space in (MTQ_SPACE, ROAD):
        state, asked = searched(Straddle(), StraddleConfig(), level, budget=130, space=space)
        assert len(asked) == 130
        assert len(state.archive) == 65


def test_infinite_robustness_does_not_mislead_straddle() -> None:
    def endless(candidate: Candidate) -> Scored:
        scored = mtq(candidate)
        return replace(scored, robustness=-np.inf) if scored.robustness < -500 else scored

    state, _ = searched(Straddle(), StraddleConfig(), endless, budget=300)
    assert np.isinf(state.archive.robustness).any()
    assert near_the_circle(state.archive) > 0.1


def test_straddle_needs_scikit_learn_for_categories_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("brink.search.algorithms.straddle.is_available", lambda: False)
    Straddle().check(MTQ_SPACE, StraddleConfig(), budget=100)
    with pytest.raises(ConfigError, match="straddle@1 needs scikit-learn where there are categories: "):
        Straddle().check(ROAD, StraddleConfig(), budget=100)


def test_budgets_are_limited_where_a_gaussian_process_learns() -> None:
    Straddle().check(ROAD, StraddleConfig(), budget=50_000)
    for algorithm, config, space in (
        (Straddle(), StraddleConfig(), MTQ_SPACE),
        (Bsv(), BsvConfig(), MTQ_SPACE),
        (Bsv(), BsvConfig(), ROAD),
    ):
        checked: AnyAlgorithm = algorithm
        with pytest.raises(ConfigError, match="expected at most 5,000 simulations"):
            checked.check(space, config, budget=5_001)


# Bayesian safety validation


def test_logits_stand_for_verdicts() -> None:
    values = logits(np.array([False, True]))
    assert values == pytest.approx([-115.129, 115.129], abs=1e-3)  # log(.00001 / .99999) / 0.1
    assert probabilities(np.array([*values, 0.0])) == pytest.approx([0.0, 1.0, 0.5])


def test_acquisitions_take_turns() -> None:
    state, asked = searched(Bsv(), BsvConfig(), rare, budget=300)
    unsafe = dict(zip(state.archive.numbers.tolist(), state.archive.unsafe.tolist(), strict=True))
    gaps = {one.number: mtq_gap_to_boundary(*MTQ_SPACE.join(one.vectors)) for one in asked}
    later = [one.number for one in asked if one.number >= 150]
    explored, refined, sampled = ([number for number in later if number % 3 == turn] for turn in range(3))
    # 10% of the square is unsafe: sampling the region of failure finds it, exploring it does not.
    assert np.mean([unsafe[number] for number in sampled]) > 0.7
    assert np.mean([unsafe[number] for number in explored]) < 0.3
    assert np.median([gaps[one] for one in refined]) < 0.5 * np.median([gaps[one] for one in explored])
    assert near_the_circle(state.archive) > 1.5 * near_the_circle(randomly(300))


# DeepJanus


def janus(seed: int = 1, budget: int = 400, answer: Answer = mtq) -> tuple[DeepJanusState, list[Candidate]]:
    state, asked = searched(DeepJanus(), DeepJanusConfig(d_th=0.05), answer, budget=budget, seed=seed)
    assert isinstance(state, DeepJanusState)
    return state, asked


def test_archived_pairs_are_across_the_frontier_and_share_a_seed() -> None:
    state, asked = janus()
    unsafe = dict(zip(state.archive.numbers.tolist(), state.archive.unsafe.tolist(), strict=True))
    seeds = {one.number: one.number if one.seed_number is None else one.seed_number for one in asked}
    assert len(state.frontier) >= 8
    assert len(set(state.frontier)) == len(state.frontier)
    for pair in state.frontier:
        assert unsafe[pair.first] != unsafe[pair.second]
        assert seeds[pair.first] == seeds[pair.second] == pair.seed
        assert not unsafe[pair.seed]


def test_deepjanus_finds_more_close_pairs_than_random_search() -> None:
    mine = sum(distinct_pairs(janus(seed, budget=600)[0].archive, 0.01) for seed in range(1, 5))
    theirs = sum(distinct_pairs(randomly(600, seed), 0.01) for seed in range(1, 5))
    assert mine > theirs > 0


def test_a_closer_pair_replaces_the_archived_one_nearby() -> None:
    state = DeepJanus().start(MTQ_SPACE, DeepJanusConfig(d_th=0.05), seed=1, budget=600)
    widths: list[float] = []
    while not DeepJanus().finished(state):
        state, _ = ask_all(DeepJanus(), state)
        before = state.frontier
        state = DeepJanus().tell(state, {one.number: mtq(one) for one in state.pending})
        steps = Steps(MTQ_SPACE)
        rows = dict(zip(state.archive.numbers.tolist(), state.archive.vectors, strict=True))
        for old, new in zip(before, state.frontier, strict=False):
            width = [steps.distance(rows[pair.first], rows[pair.second]) for pair in (old, new)]
            assert width[1] <= width[0]
            widths += [width[0] - width[1]] if old != new else []
    assert len(widths) > 3


def test_objectives_are_sparseness_with_closeness_and_nearness_to_the_frontier() -> None:
    state, _ = janus()
    objectives = _objectives(state.population, state.frontier, state.ledger, closeness=0.01)
    robustness = dict(zip(state.archive.numbers.tolist(), state.archive.robustness.tolist(), strict=True))
    for pair, (sparse, near) in zip(state.population, objectives.tolist(), strict=True):
        product = robustness[pair.first] * robustness[pair.second]
        assert near == (pytest.approx(product) if product > 0 else ACROSS)
        assert -1.0 <= sparse <= 0.01
    alone = _objectives(state.population, (), state.ledger, closeness=0.0)
    assert alone[:, 0].tolist() == [-1.0] * len(state.population)


def test_deepjanus_goes_on_when_every_simulation_fails() -> None:
    state, asked = janus(budget=40, answer=lambda _: Failed(reason="test"))
    assert len(asked) == 40
    assert state.population == state.frontier == ()


# Nearest opposite


@pytest.fixture(scope="module")
def bisected() -> tuple[NearestOppositeState, list[Candidate]]:
    config = NearestOppositeConfig(eps=0.002, d_th=0.05)
    state, asked = searched(NearestOpposite(), config, mtq, budget=600)
    assert isinstance(state, NearestOppositeState)
    return state, asked


def test_nearest_opposites_are_bisected_to_pairs_on_the_circle(
    bisected: tuple[NearestOppositeState, list[Candidate]],
) -> None:
    state, _ = bisected
    assert distinct_pairs(state.archive, 0.002) >= 8
    assert distinct_pairs(randomly(600), 0.002) <= 1
    rows = dict(zip(state.archive.numbers.tolist(), state.archive.vectors, strict=True))
    tight = [bracket for bracket in state.brackets if bracket.status is Status.TIGHT]
    middles = [(rows[one.safe] + rows[one.unsafe]) / 2 for one in tight]
    assert max(mtq_gap_to_boundary(*middle) for middle in middles) < 0.004


def test_a_bracket_begins_with_the_nearest_safe_draw_and_has_one_seed(
    bisected: tuple[NearestOppositeState, list[Candidate]],
) -> None:
    state, asked = bisected
    rows = {one.number: MTQ_SPACE.join(one.vectors) for one in asked}
    seeds = {one.number: one.seed_number for one in asked}
    unsafe = dict(zip(state.archive.numbers.tolist(), state.archive.unsafe.tolist(), strict=True))
    drawn_safe = np.array(
        [rows[number] for number in sorted(state.drawn) if not unsafe[number] and number < 240]
    )
    first = state.brackets[0]
    again = next(one for one in asked if one.seed_number == first.seed)
    distances = Steps(MTQ_SPACE).metric.between(rows[first.seed][None], drawn_safe)[0]
    assert np.array_equal(rows[again.number], drawn_safe[int(np.argmin(distances))])
    for bracket in state.brackets:
        if bracket.status in (Status.OPEN, Status.TIGHT):
            assert seeds[bracket.safe] == bracket.seed
            assert bracket.unsafe == bracket.seed or seeds[bracket.unsafe] == bracket.seed
            assert (unsafe[bracket.safe], unsafe[bracket.unsafe]) == (False, True)


def test_a_safe_side_that_is_unsafe_under_the_common_seed_opens_nothing() -> None:
    def chancy(candidate: Candidate) -> Scored:
        scored = mtq(candidate)
        return scored if candidate.seed_number is None else Scored(unsafe=True, robustness=-1.0)

    state, asked = searched(NearestOpposite(), NearestOppositeConfig(), chancy, budget=200)
    assert {bracket.status for bracket in state.brackets} == {Status.CLOSED}
    assert sum(one.seed_number is not None for one in asked) == len(state.brackets)


def test_nothing_but_draws_without_an_unsafe_solution() -> None:
    def safe(_: Candidate) -> Scored:
        return Scored(unsafe=False, robustness=1.0)

    state, asked = searched(NearestOpposite(), NearestOppositeConfig(), safe, budget=100, space=ROAD)
    assert state.brackets == ()
    assert len(asked) == 100


# Stored states


def _stored(algorithm: AnyAlgorithm, config: Any, **changed: Any) -> None:
    """Restore the state of a search after some generations with changed arrays."""
    state = algorithm.start(MTQ_SPACE, config, seed=1, budget=300)
    for _ in range(9):
        state, _ = ask_all(algorithm, state)
        state = algorithm.tell(state, {one.number: mtq(one) for one in state.pending})
    document = algorithm.dump(state)
    arrays = {name: np.array(change(document.arrays[name]), np.float64) for name, change in changed.items()}
    algorithm.load(MTQ_SPACE, config, replace(document, arrays={**document.arrays, **arrays}), state.archive)


@pytest.mark.parametrize(
    ("name", "change", "problem"),
    [
        ("brackets", lambda rows: [[*row[:3], 9] for row in rows], "brackets: 9 is not a valid Status"),
        ("brackets", lambda rows: [[999, *row[1:]] for row in rows], "999 is none of the solutions"),
        ("drawn", lambda rows: rows + 5000, "none of the solutions"),
        ("jobs", lambda rows: rows[:-1], "jobs: expected a bracket, or -1, for each"),
        ("jobs", lambda rows: rows + 1000, "jobs: expected a bracket, or -1, for each"),
    ],
)
def test_corrupt_brackets_are_refused(name: str, change: Any, problem: str) -> None:
    config = NearestOppositeConfig(explore=0.2)
    _stored(NearestOpposite(), config)
    with pytest.raises(DocumentError, match=problem):
        _stored(NearestOpposite(), config, **{name: change})


@pytest.mark.parametrize("name", ["population", "frontier", "sown"])
def test_corrupt_populations_are_refused(name: str) -> None:
    _stored(DeepJanus(), DeepJanusConfig(d_th=0.05))
    with pytest.raises(DocumentError, match=f"{name}: .* is none of the solutions"):
        _stored(DeepJanus(), DeepJanusConfig(d_th=0.05), **{name: lambda rows: rows + 700})

"""`sharpen@1` brings pairs to thresholds, on a ball whose radius depends on the episode seed."""

import numpy as np
import pytest

from brink.search.algorithm import Candidate, Failed, Scored, ask_all
from brink.search.algorithms.sharpen import TRIES, Sharpen, SharpenConfig, SharpenState, most_simulations
from brink.search.analysis.lines import find_lines
from brink.search.conclusions import Outcome
from brink.search.errors import ConfigError
from brink.search.space import Categorical, Component, Real, SearchSpace

SPACE = SearchSpace(
    (
        Component(
            "where", (Real("x", -2.0, 2.0, "m", resolution=0.02), Categorical("ground", ("dry", "wet")))
        ),
        Component("what", (Real("y", -2.0, 2.0, "m", resolution=0.02),)),
    )
)
SPREAD_M = 0.1
PAIRS = SharpenConfig(safe=[[1.4, 0.0, 0.0], [0.2, 0.0, -1.5]], unsafe=[[0.7, 0.0, 0.0], [0.5, 0.0, -0.4]])


def scored(candidate: Candidate) -> Scored:
    """Return whether a solution is within the ball, whose radius is 1 m but for the seed."""
    x, _, y = np.concatenate(candidate.vectors)
    seed = candidate.number if candidate.seed_number is None else candidate.seed_number
    radius = 1.0 + SPREAD_M * np.random.default_rng([7, seed]).uniform(-1.0, 1.0)
    margin = float(np.hypot(x, y) - radius)
    return Scored(unsafe=margin < 0.0, robustness=margin)


def run(config: SharpenConfig, *, budget: int = 300, seed: int = 1, restored: bool = False) -> SharpenState:
    algorithm = Sharpen()
    state = algorithm.start(SPACE, config, seed=seed, budget=budget)
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        if restored:
            stored = algorithm.dump(state)
            state = algorithm.load(SPACE, config, stored, state.ledger.archive)
        state = algorithm.tell(state, {one.number: scored(one) for one in state.ledger.pending})
        if restored:
            stored = algorithm.dump(state)
            state = algorithm.load(SPACE, config, stored, state.ledger.archive)
    return state


@pytest.fixture(scope="module")
def sharpened() -> SharpenState:
    return run(PAIRS)


def test_pairs_become_lines_with_trials_around_the_true_radius(sharpened: SharpenState) -> None:
    assert sharpened.outcomes == (Outcome.THRESHOLD, Outcome.THRESHOLD)
    archive = sharpened.ledger.archive
    own = np.isin(archive.numbers, [number for numbers in sharpened.trials for number in numbers])
    first, second = find_lines(archive, SPACE, own)
    assert (first.unit, first.rises) == ((0,), False)
    assert second.unit in ((0,), (2,)), "of two numbers, the one that decides"
    near = np.abs(first.values[first.own] - 1.0) < 0.25
    assert near.mean() > 0.5


def test_it_takes_no_more_than_it_may(sharpened: SharpenState) -> None:
    assert len(sharpened.ledger.archive) <= most_simulations(2, 3, sharpened.config.trials)
    small = run(PAIRS, budget=20)
    assert len(small.ledger.archive) <= 20


def test_a_restored_search_goes_on_as_if_it_had_not_stopped(sharpened: SharpenState) -> None:
    again = run(PAIRS, restored=True)
    assert np.array_equal(again.ledger.archive.vectors, sharpened.ledger.archive.vectors)
    assert again.trials == sharpened.trials


def test_pairs_that_no_seed_keeps_apart_are_given_up() -> None:
    state = run(
        SharpenConfig(safe=[[0.5, 0.0, 0.0], [1.5, 0.0, 0.0]], unsafe=[[0.4, 0.0, 0.0], [0.6, 0.0, 0.0]])
    )
    assert state.outcomes == (Outcome.THRESHOLD,)
    tried = (state.ledger.archive.vectors == np.array([0.4, 0.0, 0.0])).all(axis=1)
    assert tried.sum() == TRIES


def test_a_pair_within_the_stretch_is_prolonged_to_where_it_is_safe() -> None:
    state = run(SharpenConfig(safe=[[1.05, 0.0, 0.0]], unsafe=[[0.95, 0.0, 0.0]]))
    assert state.outcomes == (Outcome.THRESHOLD,)
    (prepared,) = state.lines or ()
    assert prepared.line.start[0] == 2.0, "the end of the range is safe"
    assert -0.7 < prepared.line.end[0] < 0.95, "the other end of the range is not unsafe"


def test_without_chance_lines_are_bisected_to_the_resolution() -> None:
    config = SharpenConfig(safe=PAIRS.safe, unsafe=PAIRS.unsafe, trials=0)
    state = run(config)
    assert state.trials == ((), ())
    for prepared in state.lines or ():
        assert 0.0 < prepared.unsafe - prepared.safe <= 2 * prepared.line.resolution


@pytest.mark.parametrize(
    ("safe", "unsafe", "words"),
    [
        ([], [], "expected as many as safe ones and at least one, got 0 for 0"),
        ([[1.4, 0.0, 0.0]], [[1.4, 1.0, 0.0]], "expected pairs that differ in a number; pair 1 does not"),
    ],
)
def test_pairs_without_a_number_that_moves_are_refused(
    safe: list[list[float]], unsafe: list[list[float]], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        Sharpen().check(SPACE, SharpenConfig(safe=safe, unsafe=unsafe), budget=100)


def test_failed_simulations_do_not_stop_it() -> None:
    algorithm = Sharpen()
    state = algorithm.start(SPACE, PAIRS, seed=1, budget=200)
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        told = {
            one.number: Failed(reason="crashed") if one.number % 7 == 3 else scored(one)
            for one in state.ledger.pending
        }
        state = algorithm.tell(state, told)
    assert Outcome.THRESHOLD in state.outcomes

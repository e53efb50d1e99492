import math

import numpy as np
import pytest

from brink.search.algorithm import Candidate
from brink.search.algorithms.repeats import Conclusion, Repeats, RepeatsConfig, simulations_to_clear, tallied
from brink.search.document import Document
from brink.search.errors import ConfigError
from brink.search.fitness import wilson_interval
from brink.search.testing import example_spaces, play, synthetic_verdicts

SPACE = example_spaces()["mixed"]
GIVEN = [SPACE.join(SPACE.sample(np.random.default_rng(seed))).tolist() for seed in range(7)]


def test_every_round_has_every_solution() -> None:
    config = RepeatsConfig(solutions=GIVEN, generation_size=16)
    run = play(Repeats(), SPACE, config, synthetic_verdicts(SPACE, failing=0.2), seed=1, budget=7 * 5)
    assert [len(generation) for generation in run.generations] == [14, 14, 7]
    assert [c.number for c in run.candidates] == list(range(35))
    assert [SPACE.join(c.vectors).tolist() for c in run.candidates] == GIVEN * 5
    assert all(c.seed_number is None for c in run.candidates)  # each has its own seed


def test_a_generation_is_at_least_one_round() -> None:
    config = RepeatsConfig(solutions=GIVEN, generation_size=1)
    run = play(Repeats(), SPACE, config, synthetic_verdicts(SPACE), seed=1, budget=16)
    assert [len(generation) for generation in run.generations] == [7, 7, 2]


def test_any_stored_state_can_be_resumed() -> None:
    config = RepeatsConfig(solutions=GIVEN, generation_size=7)
    verdicts = synthetic_verdicts(SPACE, failing=0.3)
    whole = play(Repeats(), SPACE, config, verdicts, seed=3, budget=40)
    repeats = Repeats()
    state = repeats.start(SPACE, config, seed=3, budget=40)
    seen: list[Candidate] = []
    while not repeats.finished(state):
        document = Document.from_bytes(repeats.dump(state).to_bytes())
        state, candidates = repeats.ask(repeats.load(SPACE, config, document, state.archive))
        seen += candidates
        state = repeats.tell(state, {c.number: verdicts(c) for c in candidates})
    assert [c.number for c in seen] == [c.number for c in whole.candidates]
    assert [SPACE.join(c.vectors).tolist() for c in seen] == GIVEN * 5 + GIVEN[:5]


@pytest.mark.parametrize(
    ("config", "budget", "field"),
    [
        (RepeatsConfig(), 10, "solutions"),
        (RepeatsConfig(solutions=[[0.0]]), 10, "solutions"),
        (RepeatsConfig(solutions=[[math.nan] * SPACE.dimension]), 10, "solutions"),
        (RepeatsConfig(solutions=[*GIVEN, [1e9] * SPACE.dimension]), 10, "solutions"),
        (RepeatsConfig(solutions=GIVEN), 6, "budget"),
    ],
)
def test_invalid_solutions_and_budgets_are_rejected(config: RepeatsConfig, budget: int, field: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Repeats().check(SPACE, config, budget=budget)
    assert caught.value.field == field


def test_tallies_are_counted_by_solution() -> None:
    # Solution 0: numbers 0, 3, 6, 9; solution 1: 1, 4, 7 (10 failed); solution 2: none.
    numbers = [0, 1, 3, 4, 6, 7, 9]
    found = tallied(numbers, [True, False, True, False, False, False, False], 3)
    assert found.evaluated.tolist() == [4, 3, 0]
    assert found.unsafe.tolist() == [2, 0, 0]
    assert found.probability[:2].tolist() == [0.5, 0.0]
    assert math.isnan(found.probability[2])
    low, high = wilson_interval([2, 0], [4, 3])
    assert found.low.tolist() == [*low, 0.0]
    assert found.high.tolist() == [*high, 1.0]
    assert found.contains(0.1).tolist() == [False, True, True]


def test_intervals_of_fifty_trials_contain_a_tenth_for_one_to_nine_unsafe() -> None:
    # Wilson's interval of 9 in 50 is .098 to .308, of 10 in 50 .112 to .330, of none in 50 0 to .071.
    for unsafe, holds in ((0, False), (1, True), (9, True), (10, False)):
        verdicts = [place < unsafe for place in range(50)]
        assert tallied(range(50), verdicts, 1).contains(0.1).tolist() == [holds]


@pytest.mark.parametrize(
    ("unsafe", "times", "expected"),
    [
        (0, 10, Conclusion.INCONCLUSIVE), (1, 10, Conclusion.INCONCLUSIVE), (0, 34, Conclusion.INCONCLUSIVE),
        (0, 35, Conclusion.BELOW), (3, 50, Conclusion.NEAR), (100, 1000, Conclusion.NEAR),
        (10, 10, Conclusion.ABOVE), (60, 1000, Conclusion.BELOW), (0, 0, None),
    ],
)  # fmt: skip
def test_an_interval_that_contains_p_th_is_no_evidence_by_itself(
    unsafe: int, times: int, expected: Conclusion | None
) -> None:
    verdicts = [place < unsafe for place in range(times)]
    assert tallied(range(times), verdicts, 1).conclusions(0.1, 0.1) == [expected]


@pytest.mark.parametrize("p_th", [0.02, 0.1, 0.35, 0.5])
def test_a_solution_that_is_never_unsafe_falls_below_p_th_at_the_stated_number(p_th: float) -> None:
    fewest = simulations_to_clear(p_th)
    for times, expected in ((fewest - 1, Conclusion.INCONCLUSIVE), (fewest, Conclusion.BELOW)):
        assert tallied(range(times), [False] * times, 1).conclusions(p_th, 0.1) == [expected]

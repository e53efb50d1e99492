import math

import numpy as np
import pytest
from scipy import stats

from brink.search.algorithm import Candidate, Evaluation, Scored
from brink.search.algorithms.repeats import Repeats, RepeatsConfig, schedule, simulations_to_clear, tallied
from brink.search.conclusions import Conclusion
from brink.search.document import Document
from brink.search.errors import ConfigError
from brink.search.testing import Run, example_spaces, play, synthetic_verdicts

SPACE = example_spaces()["mixed"]
GIVEN = [SPACE.join(SPACE.sample(np.random.default_rng(seed))).tolist() for seed in range(7)]


def test_every_round_has_every_solution() -> None:
    config = RepeatsConfig(solutions=GIVEN, generation_size=16)
    run = play(Repeats(), SPACE, config, synthetic_verdicts(SPACE, failing=0.2), seed=1, budget=7 * 5)
    assert [len(generation) for generation in run.generations] == [14, 14, 7]
    assert [c.number for c in run.candidates] == list(range(35))
    assert [SPACE.join(c.vectors).tolist() for c in run.candidates] == GIVEN * 5
    assert all(c.seed_number is None for c in run.candidates)  # each has its own seed


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


def clear(candidate: Candidate) -> Evaluation:
    """Return a verdict that depends on the solution alone: the first three are unsafe."""
    unsafe = GIVEN.index(SPACE.join(candidate.vectors).tolist()) < 3
    return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0)


def times_simulated(run: Run, solutions: int = len(GIVEN)) -> list[int]:
    rows = [SPACE.join(candidate.vectors).tolist() for candidate in run.candidates]
    return [rows.count(row) for row in GIVEN[:solutions]]


def test_a_solution_is_simulated_until_its_verdict_is_confirmed_or_refuted() -> None:
    keep = [True, False, True, False, False, True, False]  # wrong of the second and of the sixth
    config = RepeatsConfig(solutions=GIVEN, keep=keep, generation_size=7)
    run = play(Repeats(), SPACE, config, clear, seed=1, budget=7 * 30)
    assert times_simulated(run) == [15, 4, 15, 15, 15, 4, 15]
    assert len(run.candidates) == 83, "less than the budget"


def test_no_solution_is_simulated_more_often_than_its_share_of_the_budget() -> None:
    config = RepeatsConfig(solutions=GIVEN, keep=[False] * 7)
    undecided = synthetic_verdicts(SPACE, failing=1.0)
    run = play(Repeats(), SPACE, config, undecided, seed=1, budget=7 * 9 + 3)
    assert times_simulated(run) == [9] * 7


@pytest.mark.parametrize("size", [1, 7, 30, 120])
def test_which_candidate_is_which_solution_follows_from_the_verdicts(size: int) -> None:
    keep = [index < 3 for index in range(7)]
    config = RepeatsConfig(solutions=GIVEN, keep=keep, generation_size=size)
    verdicts = synthetic_verdicts(SPACE, failing=0.1)
    run = play(Repeats(), SPACE, config, verdicts, seed=3, budget=7 * 20)
    ended: dict[int, bool | None] = {one.number: None for one in run.candidates}
    numbers, unsafe = run.archive.numbers.tolist(), run.archive.unsafe.tolist()
    ended |= dict(zip(numbers, unsafe, strict=True))
    rows = [GIVEN.index(SPACE.join(one.vectors).tolist()) for one in run.candidates]
    assert schedule(keep, ended, 7 * 20, size) == rows
    for first in range(0, len(rows), 5):  # as long as some verdicts are missing, those that are known suffice
        known = {number: verdict for number, verdict in ended.items() if number < first}
        planned = schedule(keep, known, 7 * 20, size)
        assert planned[:first] == rows[:first]
        assert planned == rows[: len(planned)]


@pytest.mark.parametrize(
    ("config", "budget", "field"),
    [
        (RepeatsConfig(), 10, "solutions"),
        (RepeatsConfig(solutions=[[0.0]]), 10, "solutions"),
        (RepeatsConfig(solutions=[[math.nan] * SPACE.dimension]), 10, "solutions"),
        (RepeatsConfig(solutions=[*GIVEN, [1e9] * SPACE.dimension]), 10, "solutions"),
        (RepeatsConfig(solutions=GIVEN), 6, "budget"),
        (RepeatsConfig(solutions=GIVEN, keep=[True]), 10, "keep"),
    ],
)
def test_invalid_solutions_and_budgets_are_rejected(config: RepeatsConfig, budget: int, field: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Repeats().check(SPACE, config, budget=budget)
    assert caught.value.field == field


def test_tallies_are_counted_by_solution() -> None:
    # Solution 0: numbers 0, 3, 6, 9; solution 1: 1, 4, 7 (10 failed); solution 2: none.
    which = [number % 3 for number in (0, 1, 3, 4, 6, 7, 9)]
    found = tallied(which, [True, False, True, False, False, False, False], 3)
    assert found.evaluated.tolist() == [4, 3, 0]
    assert found.unsafe.tolist() == [2, 0, 0]
    assert found.probability[:2].tolist() == [0.5, 0.0]
    assert math.isnan(found.probability[2])
    exact = [stats.binomtest(k, n).proportion_ci(method="exact") for k, n in ((2, 4), (0, 3))]
    assert found.low.tolist() == pytest.approx([*(one.low for one in exact), 0.0], abs=1e-4)
    assert found.high.tolist() == pytest.approx([*(one.high for one in exact), 1.0], abs=1e-4)
    assert found.contains(0.05).tolist() == [False, True, True]


@pytest.mark.parametrize("p_th", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("times", [10, 50, 200])
def test_a_solution_at_p_th_is_rarely_called_safer_or_less_safe(p_th: float, times: int) -> None:
    wrong = 0.0
    for unsafe in range(times + 1):
        found = tallied([0] * times, [place < unsafe for place in range(times)], 1)
        wrong += float(stats.binom.pmf(unsafe, times, p_th)) * (not found.contains(p_th)[0])
    assert wrong <= 0.05


def test_intervals_of_fifty_trials_contain_a_tenth_for_one_to_nine_unsafe() -> None:
    # The exact interval of 9 in 50 is .086 to .314, of 10 in 50 .100 to .337, of none in 50 0 to .071.
    for unsafe, holds in ((0, False), (1, True), (9, True), (10, False)):
        verdicts = [place < unsafe for place in range(50)]
        assert tallied([0] * 50, verdicts, 1).contains(0.1).tolist() == [holds]


@pytest.mark.parametrize(
    ("unsafe", "times", "expected"),
    [
        (0, 10, Conclusion.INCONCLUSIVE),
        (1, 10, Conclusion.INCONCLUSIVE),
        (0, 35, Conclusion.INCONCLUSIVE),
        (0, 36, Conclusion.BELOW),
        (3, 50, Conclusion.NEAR),
        (100, 1000, Conclusion.NEAR),
        (10, 10, Conclusion.ABOVE),
        (60, 1000, Conclusion.BELOW),
        (0, 0, None),
    ],
)
def test_an_interval_that_contains_p_th_is_no_evidence_by_itself(
    unsafe: int, times: int, expected: Conclusion | None
) -> None:
    verdicts = [place < unsafe for place in range(times)]
    assert tallied([0] * times, verdicts, 1).conclusions(0.1, 0.1) == [expected]


@pytest.mark.parametrize("p_th", [0.02, 0.1, 0.35, 0.5])
def test_a_solution_that_is_never_unsafe_falls_below_p_th_at_the_stated_number(p_th: float) -> None:
    fewest = simulations_to_clear(p_th)
    for times, expected in ((fewest - 1, Conclusion.INCONCLUSIVE), (fewest, Conclusion.BELOW)):
        assert tallied([0] * times, [False] * times, 1).conclusions(p_th, 0.1) == [expected]

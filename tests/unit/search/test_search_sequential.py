"""The sequential test of a verdict keeps its error rates, whenever it is read."""

import numpy as np
import pytest
from scipy import stats

from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of
from brink.search.sequential import (
    ERROR,
    FIRST,
    INTERVAL,
    LIMIT,
    Verdict,
    drives_to_confirm,
    exact_interval,
    verdict_of,
)

HORIZON = 600
"""Drives after which a side at its limit is practically never decided any more."""


def ever(probability: float, claim: Verdict) -> float:
    """Return the probability that a verdict is ever claimed, exactly, with that probability of the other verdict."""
    left, claimed = {0: 1.0}, 0.0
    for drives in range(1, HORIZON + 1):
        after: dict[int, float] = {}
        for other, weight in left.items():
            for count, chance in ((other, 1 - probability), (other + 1, probability)):
                if verdict_of(count, drives) is claim:
                    claimed += weight * chance
                else:
                    after[count] = after.get(count, 0.0) + weight * chance
        left = {count: weight for count, weight in after.items() if weight > 1e-12}
    return claimed


def test_a_side_beyond_its_limit_is_confirmed_with_the_stated_probability_at_any_time() -> None:
    assert ever(LIMIT, Verdict.HOLDS) == pytest.approx(0.0491, abs=1e-4)
    assert ever(0.3, Verdict.HOLDS) < 0.006 < ERROR


def test_a_side_within_its_limit_is_refuted_with_the_stated_probability_at_any_time() -> None:
    wrong = ever(LIMIT, Verdict.REFUTED)
    assert wrong == pytest.approx(0.0245, abs=1e-4)
    assert 1 - (1 - wrong) ** 2 <= ERROR, "both sides of a pair"


@pytest.mark.parametrize(("risk", "most"), [(0.2, 65), (0.3, 10), (0.5, 0)])
def test_a_pair_that_does_not_hold_is_rarely_confirmed(risk: float, most: int) -> None:
    """By 1,000 repetitions: two of ten drives, the rule before, confirmed 38% of those with a risk of 30%."""
    unsafe = np.random.default_rng(18).random((1_000, 100)) < risk
    sure, confirmed = Share.of(60, 60), 0
    for row in unsafe.cumsum(axis=1).tolist():
        looks = (confirmation_of(Share.of(row[drives - 1], drives), sure) for drives in range(5, 101, 5))
        confirmed += Confirmation.CONFIRMED in looks
    assert confirmed <= most


def test_clear_sides_are_decided_soon() -> None:
    assert [drives_to_confirm(other) for other in range(4)] == [15, 27, 39, 51]
    assert [verdict_of(0, n) for n in (14, 15)] == [Verdict.UNDECIDED, Verdict.HOLDS]
    assert [verdict_of(1, n) for n in (26, 27)] == [Verdict.UNDECIDED, Verdict.HOLDS]
    assert [verdict_of(*of) for of in ((3, 3), (4, 4), (5, 7), (6, 10))] == [
        Verdict.UNDECIDED,
        *[Verdict.REFUTED] * 3,
    ]
    assert verdict_of(3, 10) is Verdict.UNDECIDED
    assert verdict_of(0, 0) is Verdict.UNDECIDED


def test_drives_without_a_verdict_may_have_had_either() -> None:
    assert verdict_of(0, 15, failed=1) is Verdict.UNDECIDED
    assert verdict_of(0, 26, failed=1) is Verdict.HOLDS
    assert verdict_of(4, 4, failed=1) is Verdict.UNDECIDED
    assert verdict_of(5, 5, failed=1) is Verdict.REFUTED


@pytest.mark.parametrize("counts", [(-1, 3, 0), (4, 3, 0), (0, 3, -1)])
def test_impossible_counts_are_rejected(counts: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="expected 0 <= other"):
        verdict_of(*counts)


@pytest.mark.parametrize(("count", "of"), [(0, 15), (1, 27), (4, 4), (9, 10), (5, 10)])
def test_exact_intervals_are_those_of_clopper_and_pearson(count: int, of: int) -> None:
    expected = stats.binomtest(count, of).proportion_ci(confidence_level=INTERVAL, method="exact")
    assert exact_interval(count, of) == pytest.approx((expected.low, expected.high))
    assert exact_interval(0, 0) == (0.0, 1.0)


def test_the_interval_of_a_confirmed_side_lies_within_its_limit() -> None:
    for other in range(30):
        assert exact_interval(other, drives_to_confirm(other))[1] < LIMIT


@pytest.mark.parametrize("risk", [0.01, 0.1, 0.2, 0.5])
@pytest.mark.parametrize("drives", [10, FIRST, 30])
def test_exact_intervals_cover_what_they_say(risk: float, drives: int) -> None:
    covered = 0.0
    for count in range(drives + 1):
        low, high = exact_interval(count, drives)
        covered += float(stats.binom.pmf(count, drives, risk)) * (low <= risk <= high)
    assert covered >= INTERVAL

import pytest
from scipy import stats

from search.statistics import a12, compared, mean_interval


def test_mean_interval_is_students() -> None:
    values = [3.0, 5.0, 4.0, 8.0]
    interval = mean_interval(values)
    low, high = stats.t.interval(0.95, 3, loc=5.0, scale=stats.sem(values))
    assert (interval.mean, interval.low, interval.high) == pytest.approx((5.0, low, high))
    assert interval.repeats == 4


def test_single_value_has_no_interval() -> None:
    interval = mean_interval([2.0])
    assert (interval.mean, interval.low, interval.high) == (2.0, None, None)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [([1, 2, 3], [1, 2, 3], 0.5), ([4, 5], [1, 2, 3], 1.0), ([1], [2], 0.0), ([1, 2], [2, 3], 0.125)],
)
def test_a12_counts_wins_and_half_the_ties(first: list[float], second: list[float], expected: float) -> None:
    assert a12(first, second) == expected


def test_comparison_agrees_with_the_mann_whitney_test() -> None:
    first, second = [12.0, 15.0, 11.0, 19.0, 14.0], [8.0, 9.0, 11.0, 10.0, 7.0]
    comparison = compared(first, second)
    reference = stats.mannwhitneyu(first, second, alternative="two-sided")
    assert comparison.u == reference.statistic
    assert comparison.p_value == pytest.approx(reference.pvalue)
    assert comparison.a12 == pytest.approx(reference.statistic / 25)


def test_equal_values_show_no_difference() -> None:
    comparison = compared([3.0, 3.0], [3.0, 3.0, 3.0])
    assert (comparison.a12, comparison.p_value) == (0.5, 1.0)


def test_nothing_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match="at least one value"):
        compared([], [1.0])
    with pytest.raises(ValueError, match="expected values"):
        mean_interval([])

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from brink.search.statistics import a12, compared, effect_size, holm, mean_interval


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


COUNTS = st.lists(st.integers(0, 6).map(float), min_size=1, max_size=9)


@given(COUNTS, COUNTS)
def test_comparison_follows_the_definitions_whatever_the_ties(
    first: list[float], second: list[float]
) -> None:
    found = compared(first, second)
    wins = sum((a > b) + (a == b) / 2 for a, b in itertools.product(first, second))
    assert found.a12 == pytest.approx(wins / (len(first) * len(second)))
    assert found.u == pytest.approx(wins)
    if len({*first, *second}) > 1:
        reference = stats.mannwhitneyu(first, second, alternative="two-sided")
        assert (found.u, found.p_value) == pytest.approx((reference.statistic, reference.pvalue))
    turned = compared(second, first)
    assert (turned.a12, turned.p_value) == pytest.approx((1 - found.a12, found.p_value))


@pytest.mark.parametrize(
    ("effect", "word"),
    [
        (0.5, "negligible"), (0.559, "negligible"), (0.56, "small"), (0.44, "small"), (0.64, "medium"),
        (0.36, "medium"), (0.71, "large"), (0.29, "large"), (0.0, "large"), (1.0, "large"),
    ],
)  # fmt: skip
def test_effects_are_named_as_by_vargha_and_delaney(effect: float, word: str) -> None:
    assert effect_size(effect) == word


def test_holm_adjusts_as_in_the_textbook() -> None:
    # As R's p.adjust(c(.01, .04, .03, .005), "holm") has it.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []
    assert holm([0.4, 0.9]) == pytest.approx([0.8, 0.9])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_rejects_what_its_steps_reject(p_values: list[float]) -> None:
    adjusted = holm(p_values)
    for alpha in (0.01, 0.05, 0.3):
        rejected = set()
        for step, index in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
            if p_values[index] * (len(p_values) - step) > alpha:
                break
            rejected.add(index)
        assert {i for i, value in enumerate(adjusted) if value <= alpha} == rejected


def test_only_probabilities_are_adjusted() -> None:
    with pytest.raises(ValueError, match=r"in \[0, 1\]"):
        holm([0.5, 1.5])
    with pytest.raises(ValueError, match=r"in \[0, 1\]"):
        effect_size(-0.1)

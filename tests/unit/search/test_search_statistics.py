"""Statistics of repeated campaigns, and classification metrics."""

import itertools
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from brink.search.analysis.monitor_evaluation import (
    classification_metrics,
    fewest_false_alarms,
    operating_points,
)
from brink.search.analysis.statistics import a12, compared, effect_size, holm, mean_interval


def test_mean_has_a_student_interval() -> None:
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


def test_equal_samples_leave_nothing_to_test() -> None:
    comparison = compared([3.0, 3.0], [3.0, 3.0, 3.0])
    assert (comparison.a12, comparison.p_value) == (0.5, None)


def test_empty_samples_are_rejected() -> None:
    with pytest.raises(ValueError, match="at least one value"):
        compared([], [1.0])
    with pytest.raises(ValueError, match="expected at least one value"):
        mean_interval([])


def test_a12_of_many_values_needs_no_table_of_all_pairs() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.integers(0, 50, 10_000).astype(float), rng.integers(0, 60, 10_000).astype(float)
    tracemalloc.start()
    effect = a12(first, second)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    at_first, at_second = np.bincount(first.astype(int), minlength=60), np.bincount(second.astype(int))
    lower = np.concatenate([[0], np.cumsum(at_second)[:-1]])
    assert effect == (at_first @ (2 * lower + at_second)) / (2 * 10_000 * 10_000)
    assert peak < 5e6, "all pairs would need 100 MB a comparison"


def test_values_that_are_not_numbers_have_no_rank() -> None:
    for first, second in (([np.nan], [1.0]), ([1.0], [0.0, np.nan])):
        with pytest.raises(ValueError, match="expected numbers in each sample, got nan"):
            a12(first, second)


COUNTS = st.lists(st.integers(0, 6).map(float), min_size=1, max_size=9)


@given(COUNTS, COUNTS)
def test_comparison_follows_the_definitions_with_ties(first: list[float], second: list[float]) -> None:
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
        (0.5, "negligible"),
        (0.559, "negligible"),
        (0.56, "small"),
        (0.44, "small"),
        (0.64, "medium"),
        (0.36, "medium"),
        (0.71, "large"),
        (0.29, "large"),
        (0.0, "large"),
        (1.0, "large"),
    ],
)
def test_effect_sizes_have_the_names_of_vargha_and_delaney(effect: float, word: str) -> None:
    assert effect_size(effect) == word


def test_holm_matches_r() -> None:
    # The result of R's p.adjust(c(.01, .04, .03, .005), "holm").
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []
    assert holm([0.4, 0.9]) == pytest.approx([0.8, 0.9])


def test_what_was_not_tested_needs_no_correction() -> None:
    assert holm([0.01, None, 0.04]) == [0.02, None, 0.04]
    assert holm([None]) == [None]


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_rejects_the_same_hypotheses_as_the_step_down_procedure(p_values: list[float]) -> None:
    adjusted = holm(p_values)
    for alpha in (0.01, 0.05, 0.3):
        rejected = set()
        for step, index in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
            if p_values[index] * (len(p_values) - step) > alpha:
                break
            rejected.add(index)
        assert {i for i, value in enumerate(adjusted) if value is not None and value <= alpha} == rejected


def test_values_outside_the_unit_interval_are_rejected() -> None:
    with pytest.raises(ValueError, match=r"in \[0, 1\]"):
        holm([0.5, 1.5])
    with pytest.raises(ValueError, match=r"in \[0, 1\]"):
        effect_size(-0.1)


def test_metrics_have_known_answers() -> None:
    probability = np.array([0.1, 0.4, 0.35, 0.8])
    unsafe = np.array([False, False, True, True])
    found = classification_metrics(probability, unsafe)
    assert found.auroc == 0.75  # the textbook example of scikit-learn
    assert found.brier == pytest.approx((0.01 + 0.16 + 0.65**2 + 0.04) / 4)
    assert (found.solutions, found.unsafe) == (4, 2)


def test_calibrated_probabilities_lie_within_their_bins() -> None:
    rng = np.random.default_rng(2)
    probability = rng.random(20_000)
    unsafe = rng.random(20_000) < probability
    found = classification_metrics(probability, unsafe, probability - 0.02, probability + 0.02)
    assert sum(one.solutions for one in found.bins) == 20_000
    assert [one.predicted for one in found.bins] == sorted(one.predicted for one in found.bins)
    assert all(one.observed_low <= one.observed <= one.observed_high for one in found.bins)
    assert sum(one.within for one in found.bins) >= 9
    miscalibrated = classification_metrics(probability**3, unsafe, probability**3, probability**3)
    assert sum(one.within for one in miscalibrated.bins) <= 2
    assert miscalibrated.auroc == pytest.approx(found.auroc)
    assert miscalibrated.brier > found.brier


def test_operating_points_trade_missed_hazards_for_false_alarms() -> None:
    probability = np.array([0.1, 0.2, 0.2, 0.6, 0.9])
    unsafe = np.array([False, False, True, True, True])
    found = {
        alarm.probability: (alarm.missed, alarm.false) for alarm in operating_points(probability, unsafe)
    }
    assert found == {
        0.9: (pytest.approx(2 / 3), 0.0), 0.6: (pytest.approx(1 / 3), 0.0), 0.2: (0.0, 0.5), 0.1: (0.0, 1.0),
    }  # fmt: skip
    assert fewest_false_alarms(operating_points(probability, unsafe), 0.0).probability == 0.2
    assert fewest_false_alarms(operating_points(probability, unsafe), 0.4).false == 0.0
    with pytest.raises(ValueError, match="no threshold misses"):
        fewest_false_alarms(operating_points(probability, unsafe, at=[1.0]), 0.1)


def test_a_single_verdict_is_rejected() -> None:
    with pytest.raises(ValueError, match="safe and unsafe"):
        classification_metrics(np.array([0.2, 0.3]), np.array([True, True]))
    with pytest.raises(ValueError, match="a verdict for each"):
        classification_metrics(np.array([0.2, 0.3]), np.array([True]))

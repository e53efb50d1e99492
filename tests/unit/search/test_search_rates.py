import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.search.conclusions import Decision
from brink.search.rates import (
    SHARES,
    STAKES,
    Wealth,
    betting_bounds,
    betting_interval,
    empirical_bernstein_interval,
    first_decision,
    fixed_interval,
    log_wealth,
)
from brink.search.space import FloatArray


def weighted(
    rng: np.random.Generator, rate: float, count: int, alpha: float
) -> tuple[FloatArray, FloatArray]:
    """Return values and bounds of a defensive mixture: a tenth of all drives has half of the violations."""
    risk, share = np.array([rate * 0.5 / 0.9, rate * 5.0]), np.array([0.9, 0.1])
    tilt = np.sqrt(risk)
    weight = 1 / (alpha + (1 - alpha) * tilt / (share @ tilt))
    kind = rng.choice(2, size=count, p=share / weight)
    unsafe = rng.random(count) < risk[kind]
    return np.where(unsafe, weight[kind], 0.0), np.full(count, 1 / alpha)


def test_fixed_interval_of_unweighted_drives_is_that_of_clopper_and_pearson() -> None:
    values = np.zeros(20)
    values[:4] = 1.0
    # Brown, Cai and DasGupta 2001 and every table: 4 of 20.
    assert fixed_interval(values, np.ones(20)) == pytest.approx((0.0573, 0.4366), abs=1e-4)
    assert fixed_interval(np.zeros(10), np.ones(10))[1] == pytest.approx(1 - 0.025 ** (1 / 10))


def test_fixed_interval_of_equal_weights_is_the_exact_poisson_interval() -> None:
    values = np.zeros(1000)
    values[:7] = (
        2.0  # a weighted count of equal weights is a scaled Poisson count: 7 has [2.814, 14.423] (Garwood)
    )
    low, high = fixed_interval(values, np.full(1000, 2.0))
    assert (low * 500, high * 500) == pytest.approx((2.814, 14.423), abs=1e-3)


def test_wealth_is_that_of_the_bets_one_after_another() -> None:
    values, bounds, mean = np.array([0.0, 2.0, 0.0, 0.5]), np.array([1.0, 2.0, 4.0, 4.0]), 0.3
    below, above = [1.0] * len(SHARES), [1.0] * len(STAKES)
    for value, bound in zip(values.tolist(), bounds.tolist(), strict=True):
        below = [w * (1 + s * (mean - value) / (bound - mean)) for w, s in zip(below, SHARES, strict=True)]
        above = [w * (1 + min(s, 0.99 / mean) * (value - mean)) for w, s in zip(above, STAKES, strict=True)]
    wealth = Wealth.of(mean, 0.95).after(values[:1], bounds[:1]).after(values[1:], bounds[1:])
    assert np.exp(wealth.below) == pytest.approx(below)
    assert np.exp(wealth.above) == pytest.approx(above)
    assert min(below) < math.exp(log_wealth(wealth.below)) < max(below)


def test_limits_are_where_the_wealth_reaches_the_inverse_of_the_error() -> None:
    values, bounds = weighted(np.random.default_rng(3), 0.1, 400, 0.5)
    low, high = betting_bounds(values, bounds, low_error=0.1, high_error=0.02)
    assert log_wealth(Wealth.of(high, 0.5).after(values, bounds).below) == pytest.approx(math.log(50))
    assert log_wealth(Wealth.of(low, 0.5).after(values, bounds).above) == pytest.approx(math.log(10))


def test_empirical_bernstein_interval_is_that_of_theorem_2() -> None:
    values = np.random.default_rng(2).random(50) * 2
    total = weights = errors = 0.0
    mean, variance, seen, squares = 0.5, 0.25, 0.5, 0.25
    for t, x in enumerate((values / 2).tolist(), start=1):
        stake = min(math.sqrt(2 * math.log(2 / 0.1) / (variance * t * math.log(1 + t))), 0.5)
        total, weights = total + stake * x, weights + stake
        errors += 4 * (x - mean) ** 2 * (-math.log(1 - stake) - stake) / 4
        seen += x
        mean = seen / (t + 1)
        squares += (x - mean) ** 2
        variance = squares / (t + 1)
    centre, half = total / weights, (math.log(2 / 0.1) + errors) / weights
    expected = max(0.0, 2 * (centre - half)), min(1.0, 2 * (centre + half))
    assert empirical_bernstein_interval(values, 2.0, 0.9) == pytest.approx(expected)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 0.5, 0.2]), st.integers(1, 300))
def test_interval_contains_the_mean_grows_with_confidence_and_ignores_order(
    seed: int, alpha: float, count: int
) -> None:
    values, bounds = weighted(np.random.default_rng(seed), 0.2, count, alpha)
    low, high = betting_interval(values, bounds)
    assert 0 <= low <= min(values.mean(), 1.0) <= high <= 1
    wide = betting_interval(values[::-1], bounds[::-1], 0.999)
    assert wide[0] <= low <= high <= wide[1]


@pytest.mark.parametrize(("rate", "count", "alpha"), [(0.1, 300, 1.0), (0.1, 300, 0.2), (0.01, 2000, 0.5)])
def test_intervals_cover_the_rate_the_sequence_at_every_look(rate: float, count: int, alpha: float) -> None:
    repetitions, ever_missed, missed = 120, 0, 0
    for seed in range(repetitions):
        values, bounds = weighted(np.random.default_rng(seed), rate, count, alpha)
        # Excluding the rate on either side at any time is a decision on the claim at that limit.
        ever_missed += first_decision(values, bounds, at_most=rate, confidence=0.975).decision != "not shown"
        low, high = fixed_interval(values, bounds)
        missed += not low <= rate <= high
    # With a true coverage of 95%, more than 13 misses of 120 have a probability of 0.4%.
    assert max(ever_missed, missed) <= 13


def test_claims_are_decided_once_and_early_evidence_is_not_forgotten() -> None:
    ones = np.ones(4000)
    shown = first_decision(np.zeros(4000), ones, at_most=0.002)
    refuted = first_decision(np.arange(4000) % 20 == 0, ones, at_most=0.002)
    assert (shown.decision, refuted.decision) == (Decision.SHOWN, Decision.REFUTED)
    assert refuted.after < 200 < 1500 < shown.after < 2600
    assert first_decision(np.zeros(1000), ones[:1000], at_most=0.002).decision is Decision.NOT_SHOWN
    later = np.concatenate([np.zeros(shown.after), np.ones(500)])
    assert first_decision(later, np.ones(len(later)), at_most=0.002) == shown


@pytest.mark.parametrize(
    ("values", "bounds", "confidence"),
    [
        ([2.0], [1.0], 0.95),
        ([-1.0], [1.0], 0.95),
        ([0.5], [0.5], 0.95),
        ([0.0, 1.0], [1.0], 0.9),
        ([1.0], [1.0], 1.0),
    ],
)
def test_values_beyond_their_bounds_are_refused(
    values: list[float], bounds: list[float], confidence: float
) -> None:
    for interval in (betting_interval, fixed_interval):
        with pytest.raises(ValueError, match="expected"):
            interval(np.array(values), np.array(bounds), confidence)

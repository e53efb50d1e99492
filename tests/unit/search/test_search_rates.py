import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.search.conclusions import Decision
from brink.search.rates import (
    STAKES,
    Decided,
    Terms,
    Wealth,
    betting_bounds,
    betting_interval,
    first_decision,
    fixed_interval,
    log_wealth,
)
from brink.search.space import FloatArray


def weighted(rng: np.random.Generator, rate: float, count: int, alpha: float, control: float = 0.0) -> Terms:
    """Return terms of a defensive mixture: a tenth of all drives has half of the violations."""
    risk, share = np.array([rate * 0.5 / 0.9, rate * 5.0]), np.array([0.9, 0.1])
    tilt = np.sqrt(risk)
    weight = 1 / (alpha + (1 - alpha) * tilt / (share @ tilt))
    kind = rng.choice(2, size=count, p=share / weight)
    unsafe = rng.random(count) < risk[kind]
    predicted = 2.0 * risk  # a control variate may be wrong
    return Terms(
        values=weight[kind] * (unsafe - control * predicted[kind]) + control * (share @ predicted),
        low=np.full(count, -control),
        high=np.full(count, 1 / alpha + control),
        pace=np.where(np.arange(count) < count // 5, 1.0, 2.0) if control else np.ones(count),
    )


def test_fixed_interval_of_unweighted_drives_is_that_of_clopper_and_pearson() -> None:
    values = np.zeros(20)
    values[:4] = 1.0
    # Brown, Cai and DasGupta 2001 and every table: 4 of 20.
    assert fixed_interval(Terms.of(values, np.ones(20))) == pytest.approx((0.0573, 0.4366), abs=1e-4)
    assert fixed_interval(Terms.of(np.zeros(10), np.ones(10)))[1] == pytest.approx(1 - 0.025 ** (1 / 10))


def test_fixed_interval_of_equal_weights_is_the_exact_poisson_interval() -> None:
    values = np.zeros(1000)
    values[:7] = (
        2.0  # a weighted count of equal weights is a scaled Poisson count: 7 has [2.814, 14.423] (Garwood)
    )
    low, high = fixed_interval(Terms.of(values, np.full(1000, 2.0)))
    assert (low * 500, high * 500) == pytest.approx((2.814, 14.423), abs=1e-3)


def test_wealth_is_that_of_the_bets_one_after_another() -> None:
    terms, mean = (
        Terms(
            values=np.array([0.0, 2.0, -0.4, 0.5]),
            low=np.array([0.0, 0.0, -0.5, -0.5]),
            high=np.array([1.0, 2.0, 4.0, 4.0]),
            pace=np.array([1.0, 1.0, 2.0, 4.0]),
        ),
        0.3,
    )
    below, above = [1.0] * len(STAKES), [1.0] * len(STAKES)
    for value, low, high, pace in zip(terms.values, terms.low, terms.high, terms.pace, strict=True):
        most_below, most_above = 0.99 / (high - mean), 0.99 / (mean - low)
        below = [
            w * (1 + min(s * pace, most_below) * (mean - value)) for w, s in zip(below, STAKES, strict=True)
        ]
        above = [
            w * (1 + min(s * pace, most_above) * (value - mean)) for w, s in zip(above, STAKES, strict=True)
        ]
    first, rest = (
        Terms(values=terms.values[one], low=terms.low[one], high=terms.high[one], pace=terms.pace[one])
        for one in (slice(1), slice(1, None))
    )
    wealth = Wealth.of(mean, 0.95).after(first).after(rest)
    assert np.exp(wealth.below) == pytest.approx(below)
    assert np.exp(wealth.above) == pytest.approx(above)
    assert min(below) < math.exp(log_wealth(wealth.below, below=True)) < max(below)


def test_limits_are_where_the_wealth_reaches_the_inverse_of_the_error() -> None:
    for control in (0.0, 1.0):
        terms = weighted(np.random.default_rng(3), 0.1, 400, 0.5, control)
        low, high = betting_bounds(terms, low_error=0.1, high_error=0.02)
        below, above = (Wealth.of(one, 0.5).after(terms) for one in (high, low))
        # Outside by rounding, never inside.
        assert 0 <= log_wealth(below.below, below=True) - math.log(50) < 3e-3
        assert 0 <= log_wealth(above.above, below=False) - math.log(10) < 3e-3
    for constant in (0.0, 1.0):
        terms = Terms.of(np.full(5, constant), np.ones(5))
        assert betting_bounds(terms, low_error=0.1, high_error=0.02)[int(constant)] == constant


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1.0, 0.5, 0.2]),
    st.integers(1, 300),
    st.sampled_from([0.0, 1.0]),
)
def test_interval_contains_the_mean_grows_with_confidence_and_ignores_order(
    seed: int, alpha: float, count: int, control: float
) -> None:
    terms = weighted(np.random.default_rng(seed), 0.2, count, alpha, control)
    low, high = betting_interval(terms)
    assert 0 <= low <= min(max(terms.mean(), low), 1.0) <= high <= 1
    backwards = Terms(
        values=terms.values[::-1], low=terms.low[::-1], high=terms.high[::-1], pace=terms.pace[::-1]
    )
    wide = betting_interval(backwards, 0.999)
    assert wide[0] <= low <= high <= wide[1]


@pytest.mark.parametrize(
    ("rate", "count", "alpha", "control"),
    [(0.1, 300, 1.0, 0.0), (0.1, 300, 0.2, 0.0), (0.01, 2000, 0.5, 0.0), (0.1, 300, 0.5, 1.0)],
)
def test_intervals_cover_the_rate_the_sequence_at_every_look(
    rate: float, count: int, alpha: float, control: float
) -> None:
    repetitions, ever_missed, missed = 120, 0, 0
    for seed in range(repetitions):
        terms = weighted(np.random.default_rng(seed), rate, count, alpha, control)
        # Excluding the rate on either side at any time is a decision on the claim at that limit.
        ever_missed += first_decision(terms, at_most=rate, confidence=0.975).decision != "not shown"
        low, high = fixed_interval(terms)
        missed += not low <= rate <= high
    # With a true coverage of 95%, more than 13 misses of 120 have a probability of 0.4%.
    assert max(ever_missed, missed) <= 13


def test_claims_are_decided_once_and_early_evidence_is_not_forgotten() -> None:
    def decided(values: FloatArray) -> Decided:
        return first_decision(Terms.of(values, np.ones(len(values))), at_most=0.002)

    shown, refuted = decided(np.zeros(4000)), decided(np.arange(4000) % 20 == 0)
    assert (shown.decision, refuted.decision) == (Decision.SHOWN, Decision.REFUTED)
    assert refuted.after < 200 < 1500 < shown.after < 2600
    assert decided(np.zeros(1000)).decision is Decision.NOT_SHOWN
    later = np.concatenate([np.zeros(shown.after), np.ones(500)])
    assert decided(later) == shown


@pytest.mark.parametrize(
    ("values", "high", "low", "pace"),
    [
        ([2.0], [1.0], [0.0], [1.0]),
        ([-1.0], [1.0], [-0.5], [1.0]),
        ([0.5], [0.5], [0.0], [1.0]),
        ([0.5], [1.0], [0.1], [1.0]),
        ([0.0, 1.0], [1.0], [0.0], [1.0]),
        ([0.0], [1.0], [0.0], [0.0]),
    ],
)
def test_terms_beyond_their_limits_are_refused(
    values: list[float], high: list[float], low: list[float], pace: list[float]
) -> None:
    with pytest.raises(ValueError, match="expected"):
        Terms(values=np.array(values), low=np.array(low), high=np.array(high), pace=np.array(pace))


def test_confidences_of_1_are_refused() -> None:
    for interval in (betting_interval, fixed_interval):
        with pytest.raises(ValueError, match="expected a confidence"):
            interval(Terms.of(np.zeros(2), np.ones(2)), 1.0)

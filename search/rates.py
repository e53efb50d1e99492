"""The mean of bounded values, with intervals that hold: how often something happens, from weighted simulations.

Simulation i adds a value X_i in [0, B_i] whose expectation, given all earlier ones, is the rate p: its importance
weight if it is unsafe, else 0. The bound B_i, the largest weight possible, must be fixed before the simulation is
chosen. Nothing else is assumed: neither independence nor a distribution.

- `betting_interval` is a confidence sequence: with the stated probability it contains p at every number of
  simulations at once, so that one may look at any time and stop when the answer is good enough. `first_decision`
  decides a claim ``p <= limit`` in the same way.
- `empirical_bernstein_interval` is another one, in closed form and wider.
- `fixed_interval` is narrower, and holds only if the number of simulations was fixed beforehand. It is that of
  Clopper and Pearson if all weights are 1.

Betting: somebody who bets a share of their wealth on p < m, in a game that is fair if p = m, becomes K times as rich
with a probability of at most 1 / K (Ville's inequality). So every m at which a bettor would have become rich is left
out. Our bettors divide their wealth among stakes in a geometric sequence and never change them, which costs little
more than to know the best of them beforehand, and makes the wealth monotonic in m, so that what is left is an
interval.

Sources: Waudby-Smith and Ramdas 2024, "Estimating means of bounded random variables by betting" (capital processes,
theorem 2 for empirical Bernstein); Fay and Feuer 1997 (weighted counts); Clopper and Pearson 1934.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from brink.search.conclusions import Decision
from brink.search.errors import DocumentError
from brink.search.sequential import exact_interval
from brink.search.space import FloatArray, IntArray

MOST_STAKED: Final = 0.99
"""The largest share of the wealth that one value may cost."""
SHARES: Final = np.geomspace(0.01, MOST_STAKED, 16)
"""Bets on a rate below a mean: the share of the wealth that the largest value would cost."""
STAKES: Final = np.geomspace(0.01, 32.0, 24)
"""Bets on a rate above a mean: what is staked for each unit that a value is above it, as far as the wealth allows."""
_SPLIT: Final = {
    len(SHARES): np.append(np.full(len(SHARES) - 1, 0.8 / (len(SHARES) - 1)), 0.2),
    len(STAKES): (split := np.where(STAKES <= 2.0, 1.0, 0.25)) / split.sum(),
}
"""How bettors divide their wealth. To stake nearly all pays where nothing is unsafe; large stakes on a higher rate
pay where a mean is several times too small."""
_HALVINGS: Final = 48


@dataclass(frozen=True, slots=True, kw_only=True)
class Decided:
    """A decision on a claim.

    Attributes:
        decision: The decision.
        after: Number of simulations that it took; all of them if nothing was decided.
    """

    decision: Decision
    after: int


def _checked(values: FloatArray, bounds: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    values, bounds = np.asarray(values, np.float64), np.asarray(bounds, np.float64)
    if values.ndim != 1 or values.shape != bounds.shape:
        raise ValueError(f"expected one bound for each value, got shapes {values.shape} and {bounds.shape}")
    if not ((bounds >= 1) & np.isfinite(bounds)).all() or not ((values >= 0) & (values <= bounds)).all():
        raise ValueError("expected values from 0 to their bounds, which are finite and at least 1")
    if not 0 < confidence < 1:
        raise ValueError(f"expected a confidence between 0 and 1, got {confidence!r}")
    return values, bounds


def _grouped(values: FloatArray, bounds: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the distinct pairs of value and bound, and how often each occurs."""
    pairs, counts = np.unique(np.stack([values, bounds], axis=1), axis=0, return_counts=True)
    return pairs[:, 0], pairs[:, 1], counts


def _growth_below(values: FloatArray, bounds: FloatArray, mean: float) -> FloatArray:
    """Return the log factors by which values change the wealth of bets on a rate below `mean`, shape ``(n, k)``."""
    growth: FloatArray = np.log1p(SHARES * ((mean - values) / (bounds - mean))[:, None])
    return growth


def _growth_above(values: FloatArray, mean: float) -> FloatArray:
    """Return the log factors by which values change the wealth of bets on a rate above `mean`, shape ``(n, k)``."""
    growth: FloatArray = np.log1p(np.minimum(STAKES, MOST_STAKED / mean) * (values[:, None] - mean))
    return growth


def best_growth(values: FloatArray, chances: FloatArray, bound: float, mean: float, *, below: bool) -> float:
    """Return the expected log growth, in one simulation, of the wealth of a bettor who knows the best stake.

    The number of simulations that exclude a mean is about inversely proportional to it.

    Args:
        values: Positive values that a simulation may have, shape ``(n,)``.
        chances: Their probabilities, which leave the rest to the value 0, shape ``(n,)``.
        bound: The largest possible value.
        mean: The mean that is bet against, in (0, 1).
        below: Whether bets are on a rate below it.
    """
    every = np.append(values, 0.0)
    odds = np.append(chances, max(0.0, 1.0 - float(chances.sum())))
    growth = _growth_below(every, np.full(len(every), bound), mean) if below else _growth_above(every, mean)
    return float((odds @ growth).max())


def log_wealth(log_capital: FloatArray) -> FloatArray:
    """Return the logarithm of the wealth, shape ``(…)``, that capitals of shape ``(…, k)`` are together."""
    most = log_capital.max(axis=-1, keepdims=True)
    split = _SPLIT[log_capital.shape[-1]]
    wealth: FloatArray = most[..., 0] + np.log(np.exp(log_capital - most) @ split)
    return wealth


def _root(is_excluded_near: bool, excluded: "_Excluded") -> float:
    """Return the end of an interval in (0, 1), by halving; on its outer side, so that it never is too narrow.

    Args:
        is_excluded_near: Whether means near 1 are excluded, and not those near 0.
        excluded: Whether a mean is excluded.
    """
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if excluded(middle) == is_excluded_near:
            high = middle
        else:
            low = middle
    return high if is_excluded_near else low


class _Excluded:
    """Whether bets against a mean made somebody so rich that it is excluded.

    Args:
        values: Values, shape ``(n,)``.
        bounds: Their bounds, shape ``(n,)``.
        below: Whether bets are on a rate below the mean.
        error: Probability with which the true rate may be excluded.
    """

    def __init__(self, values: FloatArray, bounds: FloatArray, *, below: bool, error: float) -> None:
        self._values, self._bounds, self._counts = _grouped(values, bounds)
        self._below, self._rich = below, float(-np.log(error))

    def __call__(self, mean: float) -> bool:
        growth = (
            _growth_below(self._values, self._bounds, mean)
            if self._below
            else _growth_above(self._values, mean)
        )
        return bool(log_wealth(self._counts @ growth) >= self._rich)


def betting_bounds(
    values: FloatArray, bounds: FloatArray, *, low_error: float, high_error: float
) -> tuple[float, float]:
    """Return a lower and an upper limit of the rate, each of which holds at every number of simulations at once.

    Args:
        values: In the order of the simulations, shape ``(n,)``.
        bounds: The largest value that each could have had, fixed beforehand, >= 1, shape ``(n,)``.
        low_error: Probability with which the rate may ever be below the lower limit.
        high_error: Probability with which the rate may ever be above the upper limit.

    Returns:
        Limits in [0, 1]; 0 and 1 without values.

    Raises:
        ValueError: A value is not within its bounds, or a probability not between 0 and 1.
    """
    values, bounds = _checked(values, bounds, 1 - low_error)
    _checked(values, bounds, 1 - high_error)
    if not len(values):
        return 0.0, 1.0
    low = _root(False, _Excluded(values, bounds, below=False, error=low_error)) if values.any() else 0.0
    return low, _root(True, _Excluded(values, bounds, below=True, error=high_error))


def betting_interval(values: FloatArray, bounds: FloatArray, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval of the rate that holds at every number of simulations at once; see `betting_bounds`.

    Args:
        values: In the order of the simulations, shape ``(n,)``.
        bounds: The largest value that each could have had, fixed beforehand, >= 1, shape ``(n,)``.
        confidence: Probability, in (0, 1), with which all intervals together contain the rate.
    """
    error = (1 - confidence) / 2
    return betting_bounds(values, bounds, low_error=error, high_error=error)


def first_decision(
    values: FloatArray, bounds: FloatArray, *, at_most: float, confidence: float = 0.95
) -> Decided:
    """Return when the claim that the rate is at most a limit was decided for the first time.

    Either error, a claim shown that is wrong or one refuted that is right, has a probability of at most 1 -
    `confidence`, however many simulations there may be.

    Args:
        values: In the order of the simulations, shape ``(n,)``.
        bounds: The largest value that each could have had, fixed beforehand, >= 1, shape ``(n,)``.
        at_most: The limit, in (0, 1).
        confidence: Confidence, in (0, 1).

    Raises:
        ValueError: A value is not within its bounds, or a probability not between 0 and 1.
    """
    return Wealth.of(at_most, confidence).after(values, bounds).decided


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wealth:
    """The bettors on both sides of a claim, who may be shown more and more values.

    Attributes:
        at_most: The limit of the claim, in (0, 1).
        confidence: Confidence, in (0, 1).
        below: Log capital of bets on a rate below the limit, shape ``(len(SHARES),)``.
        above: Log capital of bets on a rate above it, shape ``(len(STAKES),)``.
        simulations: Number of values so far.
        decided: The first decision.
    """

    at_most: float
    confidence: float
    below: FloatArray
    above: FloatArray
    simulations: int
    decided: Decided

    @classmethod
    def of(cls, at_most: float, confidence: float) -> "Wealth":
        """Return the bettors before the first value.

        Raises:
            ValueError: A number is not between 0 and 1.
        """
        for number in (at_most, confidence):
            if not 0 < number < 1:
                raise ValueError(f"expected a limit and a confidence between 0 and 1, got {number!r}")
        return cls(
            at_most=at_most,
            confidence=confidence,
            below=np.zeros(len(SHARES)),
            above=np.zeros(len(STAKES)),
            simulations=0,
            decided=Decided(decision=Decision.NOT_SHOWN, after=0),
        )

    @classmethod
    def restored(
        cls,
        at_most: float,
        confidence: float,
        simulations: int,
        header: Mapping[str, Any],
        arrays: Mapping[str, NDArray[Any]],
    ) -> "Wealth":
        """Return the bettors that a document holds: ``below`` and ``above``, ``decision`` and ``after``.

        Raises:
            DocumentError: Something is missing or wrong.
        """
        fresh = cls.of(at_most, confidence)
        below, above = arrays.get("below"), arrays.get("above")
        if below is None or above is None or (below.shape, above.shape) != (SHARES.shape, STAKES.shape):
            raise DocumentError(f"below and above: expected {len(SHARES)} and {len(STAKES)} numbers")
        if header.get("decision") not in set(Decision) or not isinstance(header.get("after"), int):
            raise DocumentError("decision and after: expected a decision and a number of simulations")
        decided = Decided(decision=Decision(header["decision"]), after=header["after"])
        return replace(fresh, below=below, above=above, simulations=simulations, decided=decided)

    def after(self, values: FloatArray, bounds: FloatArray, least: FloatArray | None = None) -> "Wealth":
        """Return the bettors after further values; see `first_decision`.

        Args:
            values: Shape ``(n,)``.
            bounds: The largest value that each could have had, shape ``(n,)``.
            least: What values are at least, if some are not known; `values` is then what they are at most.
        """
        values, bounds = _checked(values, bounds, self.confidence)
        least = values if least is None else least
        if not len(values):
            return self
        below = np.cumsum(
            np.concatenate([self.below[None], _growth_below(values, bounds, self.at_most)]), axis=0
        )
        above = np.cumsum(np.concatenate([self.above[None], _growth_above(least, self.at_most)]), axis=0)
        decided = self.decided
        if decided.decision is Decision.NOT_SHOWN:
            decided = Decided(decision=Decision.NOT_SHOWN, after=self.simulations + len(values))
            rich = -np.log(1 - self.confidence)
            first = {
                decision: int(np.argmax(reached))
                for decision, capital in ((Decision.SHOWN, below), (Decision.REFUTED, above))
                if (reached := log_wealth(capital[1:]) >= rich).any()
            }
            if first:
                decision = min(first, key=lambda one: first[one])
                decided = Decided(decision=decision, after=self.simulations + first[decision] + 1)
        return Wealth(
            at_most=self.at_most,
            confidence=self.confidence,
            below=below[-1],
            above=above[-1],
            simulations=self.simulations + len(values),
            decided=decided,
        )


def empirical_bernstein_interval(
    values: FloatArray, bound: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Return the empirical Bernstein interval, which holds at every number of simulations at once.

    Args:
        values: In the order of the simulations, in [0, bound], shape ``(n,)``.
        bound: The largest possible value.
        confidence: Probability, in (0, 1), with which all intervals together contain the rate.

    References:
        Waudby-Smith and Ramdas 2024, theorem 2, with the truncation c = 1/2.
    """
    scaled, _ = _checked(values, np.full(len(values), bound), confidence)
    count = len(scaled)
    if not count:
        return 0.0, 1.0
    scaled, number, error = scaled / bound, np.arange(1, count + 1), np.log(2 / (1 - confidence))
    means = (0.5 + np.cumsum(scaled)) / (number + 1)
    variances = (0.25 + np.cumsum((scaled - means) ** 2)) / (number + 1)
    mean_before, variance_before = np.append(0.5, means[:-1]), np.append(0.25, variances[:-1])
    stakes = np.minimum(np.sqrt(2 * error / (variance_before * number * np.log(number + 1))), 0.5)
    exponent = -np.log1p(-stakes) - stakes  # 4 psi_E, with v_i = 4 (X_i - mean)^2
    total = stakes.sum()
    centre = float(stakes @ scaled / total)
    half = float((error + ((scaled - mean_before) ** 2) @ exponent) / total)
    return max(0.0, bound * (centre - half)), min(1.0, bound * (centre + half))


def fixed_interval(values: FloatArray, bounds: FloatArray, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval of the rate for a number of simulations that was fixed beforehand.

    It is that of Clopper and Pearson if all bounds are 1 and all values 0 or 1. Otherwise it is Fay and Feuer's: the
    weighted count has a gamma distribution of the same mean and variance, and one more event of the largest weight
    may have been missed.

    Args:
        values: Shape ``(n,)``.
        bounds: The largest value that each could have had, >= 1, shape ``(n,)``.
        confidence: Probability, in (0, 1), with which the interval contains the rate.

    Raises:
        ValueError: A value is not within its bounds, or the confidence not between 0 and 1.
    """
    from scipy.special import gammaincinv  # slow to import

    values, bounds = _checked(values, bounds, confidence)
    count = len(values)
    if not count:
        return 0.0, 1.0
    if (bounds == 1).all() and ((values == 0) | (values == 1)).all():
        return exact_interval(int(values.sum()), count, confidence)
    tail, mean, variance = (1 - confidence) / 2, float(values.mean()), float(values @ values) / count**2
    most = float(bounds.max()) / count
    low = 0.0
    if mean > 0:
        low = float(gammaincinv(mean**2 / variance, tail)) * variance / mean
    above, spread = mean + most, variance + most**2
    high = float(gammaincinv(above**2 / spread, 1 - tail)) * spread / above
    return low, min(1.0, high)

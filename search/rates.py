"""The mean of bounded terms, with intervals that hold: how often something happens, from weighted simulations.

Simulation i adds a term X_i, known to lie in [low_i, high_i], whose expectation, given all earlier ones, is the rate
p: for example its importance weight if it is unsafe, else 0. Its limits, and the pace at which bettors stake on it,
must be fixed before the simulation is chosen. Nothing else is assumed: neither independence nor a distribution.

- `betting_interval` is a confidence sequence: with the stated probability it contains p at every number of
  simulations at once, so that one may look at any time and stop when the answer is good enough. `first_decision`
  decides a claim ``p <= limit`` in the same way.
- `fixed_interval` is narrower, and holds only if the number of simulations was fixed beforehand. It is that of
  Clopper and Pearson if all weights are 1.

Betting: somebody who bets a share of their wealth on p < m, in a game that is fair if p = m, becomes K times as rich
with a probability of at most 1 / K (Ville's inequality). So every m at which a bettor would have become rich is left
out. Our bettors divide their wealth among stakes in a geometric sequence and do not learn, which costs little more
than to know the best stake beforehand, and makes the wealth monotonic in m, so that what is left is an interval. The
pace says how many times as much they all stake on terms that are expected to vary less.

Sources: Waudby-Smith and Ramdas 2024, "Estimating means of bounded random variables by betting" (capital processes);
Fay and Feuer 1997 (weighted counts); Clopper and Pearson 1934.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from brink.search.conclusions import Decision
from brink.search.errors import DocumentError
from brink.search.sequential import exact_interval
from brink.search.space import FloatArray

MOST_STAKED: Final = 0.99
"""The largest share of the wealth that one term may cost."""
STAKES: Final = np.geomspace(0.01, 32.0, 24)
"""What bettors stake for each unit by which a term differs from the mean, as far as the wealth allows."""
_BELOW: Final = np.append(np.where(STAKES[:-1] <= 2.0, 1.0, 0.02), 0.0)
_SPLIT: Final = {
    True: np.append(0.8 * _BELOW[:-1] / _BELOW.sum(), 0.2),
    False: (split := np.where(STAKES <= 2.0, 1.0, 0.25)) / split.sum(),
}
"""How bettors on a rate below a mean, and above it, divide their wealth. To stake nearly all pays where nothing is
unsafe; large stakes on a higher rate pay where a mean is several times too small."""
_SEEN: Final = 50
_EDGE: Final = 1e-12
"""Means as near as this to 0 or 1 are not tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Decided:
    """A decision on a claim.

    Attributes:
        decision: The decision.
        after: Number of simulations that it took; all of them if nothing was decided.
    """

    decision: Decision
    after: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Terms:
    """Terms whose expectation, given all earlier ones, is the rate; in the order of the simulations.

    Attributes:
        values: The terms, shape ``(n,)``.
        low: The smallest that each could have been, at most 0, shape ``(n,)``.
        high: The largest that each could have been, at least 1, shape ``(n,)``.
        pace: How many times as much bettors stake on each as on a plain simulation, > 0, shape ``(n,)``.
    """

    values: FloatArray
    low: FloatArray
    high: FloatArray
    pace: FloatArray

    def __post_init__(self) -> None:
        shapes = {one.shape for one in (self.values, self.low, self.high, self.pace)}
        if len(shapes) != 1 or self.values.ndim != 1:
            raise ValueError(f"expected limits and a pace for each term, got shapes {sorted(shapes)}")
        if not ((self.high >= 1) & np.isfinite(self.high) & (self.low <= 0) & np.isfinite(self.low)).all():
            raise ValueError("expected finite limits, at most 0 and at least 1")
        slack = 1e-9 * self.high  # of rounding
        if not ((self.values >= self.low - slack) & (self.values <= self.high + slack)).all():
            raise ValueError("expected terms within their limits")
        if not ((self.pace > 0) & np.isfinite(self.pace)).all():
            raise ValueError("expected paces above 0")

    @classmethod
    def of(cls, values: FloatArray, high: FloatArray) -> "Terms":
        """Return terms from 0 to `high`, on all of which the same is staked."""
        values, high = np.asarray(values, np.float64), np.asarray(high, np.float64)
        return cls(values=values, low=np.zeros_like(high), high=high, pace=np.ones_like(high))

    def __len__(self) -> int:
        """Return the number of terms."""
        return len(self.values)

    def mean(self) -> float:
        """Return the mean of the terms, weighted by their paces; not limited to [0, 1]."""
        return float(self.pace @ self.values / self.pace.sum())

    def variance(self) -> float:
        """Return the estimated variance of `mean`."""
        apart = self.pace * (self.values - self.mean())
        return float(apart @ apart / self.pace.sum() ** 2)


def _checked(*confidences: float) -> None:
    for confidence in confidences:
        if not 0 < confidence < 1:
            raise ValueError(f"expected a confidence between 0 and 1, got {confidence!r}")


def _growth(terms: Terms, mean: float, *, below: bool) -> FloatArray:
    """Return the log factors by which terms change the wealth of bets against `mean`, shape ``(n, k)``."""
    apart = (mean - terms.values if below else terms.values - mean)[:, None]
    most = MOST_STAKED / (terms.high - mean if below else mean - terms.low)
    growth: FloatArray = np.log1p(np.minimum(STAKES * terms.pace[:, None], most[:, None]) * apart)
    return growth


def best_growth(terms: Terms, chances: FloatArray, mean: float, *, below: bool) -> float:
    """Return the expected log growth, in one simulation, of the wealth of a bettor who knows the best stake.

    The number of simulations that exclude a mean is about inversely proportional to it.

    Args:
        terms: Terms that a simulation may have.
        chances: Their probabilities, shape ``(n,)``.
        mean: The mean that is bet against, in (0, 1).
        below: Whether bets are on a rate below it.
    """
    return float((chances @ _growth(terms, mean, below=below)).max())


def log_wealth(log_capital: FloatArray, *, below: bool) -> FloatArray:
    """Return the logarithm of the wealth, shape ``(…)``, that capitals of shape ``(…, k)`` are together.

    Args:
        log_capital: Log capital of bets at each of `STAKES`.
        below: Whether bets are on a rate below the mean.
    """
    most = log_capital.max(axis=-1, keepdims=True)
    wealth: FloatArray = most[..., 0] + np.log(np.exp(log_capital - most) @ _SPLIT[below])
    return wealth


def _limit(terms: Terms, *, below: bool, error: float) -> float:
    """Return the mean at which bets on a rate below or above it make somebody so rich that it is excluded.

    Returns:
        The mean, or one outside by less than 0.3% of a simulation; 1 or 0 if none is excluded on that side.
    """
    from scipy.optimize import brentq  # slow to import

    columns, counts = np.unique(
        np.stack([terms.values, terms.low, terms.high, terms.pace]), axis=1, return_counts=True
    )
    distinct, rich = (
        Terms(**dict(zip(("values", "low", "high", "pace"), columns, strict=True))),
        -np.log(error),
    )

    def excess(mean: float) -> float:
        return float(log_wealth(counts @ _growth(distinct, mean, below=below), below=below) - rich)

    outer, inner = (1 - _EDGE, _EDGE) if below else (_EDGE, 1 - _EDGE)
    if excess(outer) < 0:
        return float(below)
    if excess(inner) >= 0:  # all means are excluded: an event of a probability of at most `error`
        return inner
    wide = 1e-3 / len(terms)
    found = float(brentq(excess, inner, outer, xtol=wide))
    return min(found + 2 * wide, 1.0) if below else max(found - 2 * wide, 0.0)


def betting_bounds(terms: Terms, *, low_error: float, high_error: float) -> tuple[float, float]:
    """Return a lower and an upper limit of the rate, each of which holds at every number of simulations at once.

    Args:
        terms: The terms.
        low_error: Probability with which the rate may ever be below the lower limit.
        high_error: Probability with which the rate may ever be above the upper limit.

    Returns:
        Limits in [0, 1]; 0 and 1 without terms.

    Raises:
        ValueError: A probability is not between 0 and 1.
    """
    _checked(1 - low_error, 1 - high_error)
    if not len(terms):
        return 0.0, 1.0
    return _limit(terms, below=False, error=low_error), _limit(terms, below=True, error=high_error)


def betting_interval(terms: Terms, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval of the rate that holds at every number of simulations at once; see `betting_bounds`.

    Args:
        terms: The terms.
        confidence: Probability, in (0, 1), with which all intervals together contain the rate.
    """
    error = (1 - confidence) / 2
    return betting_bounds(terms, low_error=error, high_error=error)


def first_decision(terms: Terms, *, at_most: float, confidence: float = 0.95) -> Decided:
    """Return when the claim that the rate is at most a limit was decided for the first time.

    Either error, a claim shown that is wrong or one refuted that is right, has a probability of at most 1 -
    `confidence`, however many simulations there may be.

    Args:
        terms: The terms.
        at_most: The limit, in (0, 1).
        confidence: Confidence, in (0, 1).

    Raises:
        ValueError: A probability is not between 0 and 1.
    """
    return Wealth.of(at_most, confidence).after(terms).decided


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wealth:
    """The bettors on both sides of a claim, who may be shown more and more terms.

    Attributes:
        at_most: The limit of the claim, in (0, 1).
        confidence: Confidence, in (0, 1).
        below: Log capital of bets on a rate below the limit, shape ``(len(STAKES),)``.
        above: Log capital of bets on a rate above it, shape ``(len(STAKES),)``.
        simulations: Number of terms so far.
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
        """Return the bettors before the first term.

        Raises:
            ValueError: A number is not between 0 and 1.
        """
        for number in (at_most, confidence):
            if not 0 < number < 1:
                raise ValueError(f"expected a limit and a confidence between 0 and 1, got {number!r}")
        return cls(
            at_most=at_most,
            confidence=confidence,
            below=np.zeros(len(STAKES)),
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
        if below is None or above is None or (below.shape, above.shape) != (STAKES.shape, STAKES.shape):
            raise DocumentError(f"below and above: expected {len(STAKES)} numbers each")
        if header.get("decision") not in set(Decision) or not isinstance(header.get("after"), int):
            raise DocumentError("decision and after: expected a decision and a number of simulations")
        decided = Decided(decision=Decision(header["decision"]), after=header["after"])
        return replace(fresh, below=below, above=above, simulations=simulations, decided=decided)

    def after(self, terms: Terms, least: Terms | None = None) -> "Wealth":
        """Return the bettors after further terms; see `first_decision`.

        Args:
            terms: The terms.
            least: What terms are at least, if some are not known; `terms` is then what they are at most.
        """
        least = terms if least is None else least
        if not len(terms):
            return self
        below, above = (
            np.cumsum(np.concatenate([capital[None], _growth(one, self.at_most, below=side)]), axis=0)
            for capital, one, side in ((self.below, terms, True), (self.above, least, False))
        )
        decided = self.decided
        if decided.decision is Decision.NOT_SHOWN:
            decided = Decided(decision=Decision.NOT_SHOWN, after=self.simulations + len(terms))
            rich = -np.log(1 - self.confidence)
            first = {
                decision: int(np.argmax(reached))
                for decision, capital, side in (
                    (Decision.SHOWN, below, True),
                    (Decision.REFUTED, above, False),
                )
                if (reached := log_wealth(capital[1:], below=side) >= rich).any()
            }
            if first:
                decision = min(first, key=lambda one: first[one])
                decided = Decided(decision=decision, after=self.simulations + first[decision] + 1)
        return Wealth(
            at_most=self.at_most,
            confidence=self.confidence,
            below=below[-1],
            above=above[-1],
            simulations=self.simulations + len(terms),
            decided=decided,
        )


def fixed_interval(terms: Terms, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval of the rate for a number of simulations that was fixed beforehand.

    It is that of Clopper and Pearson if all terms are 0 or 1, and could not have been anything else. Otherwise it is
    Fay and Feuer's: the mean has a gamma distribution with its variance, and one more term may have been missed. That
    is as large as any could be, or, once there are `_SEEN` positive ones and a control variate, as any was.

    Args:
        terms: The terms.
        confidence: Probability, in (0, 1), with which the interval contains the rate.

    Raises:
        ValueError: The confidence is not between 0 and 1.
    """
    from scipy.special import gammaincinv  # slow to import

    _checked(confidence)
    values, pace = terms.values, terms.pace
    if not len(terms):
        return 0.0, 1.0
    if (terms.high == 1).all() and ((values == 0) | (values == 1)).all() and (pace == pace[0]).all():
        return exact_interval(int(values.sum()), len(terms), confidence)
    tail, mean = (1 - confidence) / 2, max(terms.mean(), 0.0)
    shares = pace / pace.sum()
    # Counts have the variance of Poisson's, which is slightly larger than that of their terms.
    counted = (terms.low == 0).all()
    variance = float((shares * values) @ (shares * values)) if counted else terms.variance()
    seen = not counted and np.count_nonzero(values > 0) >= _SEEN
    most = float((shares * (values if seen else terms.high)).max())
    low = 0.0
    if mean > 0 and variance > 0:
        low = float(gammaincinv(mean**2 / variance, tail)) * variance / mean
    above, spread = mean + most, variance + most**2
    high = float(gammaincinv(above**2 / spread, 1 - tail)) * spread / above
    return low, min(1.0, high)

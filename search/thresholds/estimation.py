"""Estimates where a drive turns along a unit, from simulations at places that it chooses itself.

Each simulation has an episode seed of its own. The posterior of curves (`CurvePrior`) gives the 50% point with an
interval and the stretch from 20 to 80%. The next places are those whose verdicts would tell most about both. The
estimation ends when half of the interval is within the resolution or a third of the stretch, when the place is
*chancy*, or when the simulations are used up. A curve that does not pass from 20 to 80% on the line, or takes more
than a fifth of the unit's range to do so, is chancy.

Source: ours. Choice of places by mutual information, as in Kontsevich and Tyler 1999 for psychometric functions.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.conclusions import Outcome
from brink.search.space import BoolArray, FloatArray, frozen_array
from brink.search.tempering import effective_size, posterior_draws, resampled
from brink.search.thresholds.prior import DIMENSION, CurvePrior

LOW: Final = 0.2
"""Largest probability of a violation on the safe side of a threshold."""
HIGH: Final = 0.8
"""Smallest probability of a violation on its unsafe side."""
CHANCY_STRETCH: Final = 0.2
"""Stretch from which a place is chancy, as a share of the unit's range."""
CONFIDENCE: Final = 0.9
"""Probability that the interval contains the 50% point."""
SURE: Final = 0.95
"""Probability from which an estimation ends early because the place is chancy."""
FEWEST: Final = 12
"""Simulations before an estimation may end."""
FEWEST_CHANCY: Final = 18
"""Simulations before it may end because the place is chancy."""
MOST: Final = 40
"""Simulations after which it ends."""
DRAWS: Final = 512
"""Curves that stand for the posterior."""
_LIBRARY: Final = 4096
_PLACES: Final = 48
_GROUPS: Final = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trials:
    """Simulations along a line, each with an episode seed of its own.

    Attributes:
        places: Where on the line, 0 at its safe and 1 at its unsafe end, shape ``(n,)``.
        unsafe: Their verdicts, shape ``(n,)``.
    """

    places: FloatArray
    unsafe: BoolArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "places", frozen_array(self.places))
        object.__setattr__(self, "unsafe", frozen_array(self.unsafe, np.bool_))
        if self.places.ndim != 1 or self.places.shape != self.unsafe.shape:
            raise ValueError(
                f"expected one verdict for each place, got {self.places.shape} and {self.unsafe.shape}"
            )

    def __len__(self) -> int:
        """Return the number of simulations."""
        return len(self.places)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """What simulations say about a threshold; all places are shares of the line.

    Attributes:
        outcome: The conclusion.
        middle: Posterior median of the place with a probability of 50%; infinite if it is probably beyond the line.
        low: Lower end of its 90% interval.
        high: Upper end of it.
        start: Posterior median of the place with a probability of 20%.
        end: Posterior median of the place with a probability of 80%.
        stretch: Posterior median of the distance between these two; infinite if one is probably beyond the line.
        chancy: Probability that the place is chancy.
        trials: Number of simulations.
        draws: Curves drawn from the posterior, as points of the unit cube of the prior, shape ``(DRAWS, DIMENSION)``.
        crossings: Where each reaches 20, 50 and 80%, shape ``(3, DRAWS)``.
    """

    outcome: Outcome
    middle: float
    low: float
    high: float
    start: float
    end: float
    stretch: float
    chancy: float
    trials: int
    draws: FloatArray
    crossings: FloatArray


def estimate(prior: CurvePrior, trials: Trials, rng: np.random.Generator, *, most: int = MOST) -> Estimate:
    """Return the estimate from simulations along a line.

    Args:
        prior: Curves of the line.
        trials: The simulations, possibly none.
        rng: Draws curves.
        most: Simulations after which the estimation ends.
    """
    draws = _posterior(prior, trials, rng)
    crossings = prior.crossings(draws, (LOW, 0.5, HIGH))
    start, middle, end = crossings
    stretch = _stretches(crossings)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, median, high = np.quantile(middle, [tail, 0.5, 1.0 - tail], method="inverted_cdf").tolist()
    usual = float(np.quantile(stretch, 0.5, method="inverted_cdf"))
    chancy = float((stretch > CHANCY_STRETCH * prior.range).mean())
    known = 0.5 * (high - low) <= max(prior.resolution, usual / 3.0) if math.isfinite(high - low) else False
    outcome = Outcome.OPEN
    if len(trials) >= min(FEWEST_CHANCY, most) and chancy >= SURE:
        outcome = Outcome.CHANCY
    elif len(trials) >= most or (len(trials) >= FEWEST and known and chancy <= 0.1):
        outcome = Outcome.CHANCY if chancy > 0.5 else Outcome.THRESHOLD
    return Estimate(
        outcome=outcome,
        middle=median,
        low=low,
        high=high,
        start=float(np.quantile(start, 0.5, method="inverted_cdf")),
        end=float(np.quantile(end, 0.5, method="inverted_cdf")),
        stretch=usual,
        chancy=chancy,
        trials=len(trials),
        draws=draws,
        crossings=crossings,
    )


def _stretches(crossings: FloatArray) -> FloatArray:
    """Return the stretch of each curve, infinite if it does not pass from 20 to 80% on the line."""
    start, _, end = crossings
    reached = np.isfinite(start) & np.isfinite(end)
    return np.where(reached, np.where(reached, end, 0.0) - np.where(reached, start, 0.0), np.inf)


def _posterior(prior: CurvePrior, trials: Trials, rng: np.random.Generator) -> FloatArray:
    """Return curves drawn from the posterior, shape ``(DRAWS, DIMENSION)``."""
    library = rng.random((_LIBRARY, DIMENSION))
    if not len(trials):
        return library[:DRAWS]
    # Many trials are at the same place, with the same verdict.
    told = np.stack([trials.places, trials.unsafe], axis=1)
    distinct, which = np.unique(told, axis=0, return_inverse=True)
    places, unsafe = distinct.T
    safe, sign = 1.0 - unsafe, 2.0 * unsafe - 1.0

    def log_likelihood(points: FloatArray) -> FloatArray:
        likely = safe + sign * prior.shares(points, places)
        terms = np.log(np.clip(likely, 1e-4, 1.0))
        return np.asarray(np.take(terms, which.reshape(-1), axis=1).sum(axis=1))

    likely = log_likelihood(library)
    if effective_size(likely) >= DRAWS:
        return library[resampled(likely, DRAWS)]
    return posterior_draws(lambda places: library[places], likely, log_likelihood, DRAWS, rng)


def next_places(prior: CurvePrior, found: Estimate, count: int, rng: np.random.Generator) -> list[float]:
    """Return the places whose verdicts would tell most about the 50% point and the stretch.

    Each further place is chosen as if the verdict of the one before were drawn from the posterior.

    Args:
        prior: Curves of the line.
        found: The estimate so far.
        count: Number of places.
        rng: Draws these verdicts.
    """
    draws = found.draws
    places = _candidates(found.crossings, prior)
    shares = np.clip(prior.shares(draws, places), 1e-4, 1.0 - 1e-4)
    groups = (_groups(found.crossings[1]), _groups(_stretches(found.crossings)))
    weights = np.full(len(draws), 1.0 / len(draws))
    chosen: list[float] = []
    for _ in range(count):
        told = _information(shares, weights, groups[0]) + 0.5 * _information(shares, weights, groups[1])
        best = int(np.argmax(told))
        chosen.append(float(places[best]))
        unsafe = rng.random() < float((weights * shares[:, best]).sum())
        weights = weights * (shares[:, best] if unsafe else 1.0 - shares[:, best])
        weights = weights / weights.sum()
    return chosen


def _candidates(crossings: FloatArray, prior: CurvePrior) -> FloatArray:
    """Return places on the line among which the next ones are chosen: quantiles of where curves cross the levels."""
    at = (np.arange(_PLACES // 3) + 0.5) / (_PLACES // 3)
    parts = [np.linspace(0.0, 1.0, 9), np.array([prior.safe, prior.unsafe])]
    for crossing in crossings:
        within = crossing[np.isfinite(crossing)]
        if within.size:
            parts.append(np.quantile(within, at))
    return np.unique(np.clip(np.concatenate(parts), 0.0, 1.0))


def _groups(values: FloatArray) -> FloatArray:
    """Return which of equally likely groups each value is in, as indicators of shape ``(_GROUPS, n)``."""
    order = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return np.asarray(np.arange(_GROUPS)[:, None] == order * _GROUPS // len(values), np.float64)


def _information(shares: FloatArray, weights: FloatArray, groups: FloatArray) -> FloatArray:
    """Return the mutual information of a verdict at each place and the group of the curve, shape ``(m,)``."""
    weighted = groups * weights
    mass = weighted.sum(axis=1)
    # Sums in the order of the draws, whatever the number of threads of a matrix product.
    within = np.einsum("gn,nm->gm", weighted, shares) / np.maximum(mass, 1e-12)[:, None]
    overall = np.einsum("n,nm->m", weights, shares)
    return np.asarray(_entropy(overall) - (mass[:, None] * _entropy(within)).sum(axis=0))


def _entropy(share: FloatArray) -> FloatArray:
    share = np.clip(share, 1e-9, 1.0 - 1e-9)
    return np.asarray(-share * np.log(share) - (1.0 - share) * np.log1p(-share))

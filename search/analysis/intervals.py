"""Intervals of shares and of ratios of sums over simulations, also where some of these depend on each other.

A share has Wilson's interval. Where simulations are alike (`brink.search.analysis.folds`), they count as fewer: as
many independent ones as give the same variance (Korn and Graubard 1998), with the quantile of Student's t for the
number of clusters.

A ratio of two sums, such as alarms an hour, has a gamma interval, whose variance is that of the linearised ratio over
simulations. It stays above zero and holds if few events, or none, were seen (Fay and Feuer 1997).
"""

from collections.abc import Sequence
from statistics import NormalDist
from typing import Final

import numpy as np

from brink.search.space import FloatArray, IntArray

CONFIDENCE: Final = 0.95
LEAST_FREEDOM: Final = 3.0
"""With 20 replicates of 100 simulations, the intervals cover 94% or more; without a bound from below, 82% or more."""


def share_interval(
    share: float,
    trials: int,
    influence: FloatArray,
    kinds: Sequence[IntArray],
    confidence: float = CONFIDENCE,
) -> tuple[float, float]:
    """Return the interval of a share.

    Args:
        share: The share, in [0, 1].
        trials: Number of simulations that it is a share of, >= 1.
        influence: By how much each simulation moves the share, with sum zero, shape ``(n,)``.
        kinds: Labels of the simulations, from 0, shape ``(n,)`` each: those with a label in common are dependent.
        confidence: Level, in (0, 1).
    """
    from scipy import stats  # slow to import

    z, effective = NormalDist().inv_cdf(0.5 + 0.5 * confidence), float(trials)
    clusters = min((np.unique(kind).size for kind in kinds), default=influence.size)
    variance = float(influence @ influence)
    if clusters < influence.size:
        variance = max(variance, float(clustered(influence[:, None], kinds)[0, 0]))
        effective *= clusters / influence.size
    if variance > 0.0:
        effective = min(float(trials), share * (1.0 - share) / variance)
    if clusters < influence.size:
        effective *= (z / float(stats.t.ppf(0.5 + 0.5 * confidence, max(clusters - 1, 1)))) ** 2
    return _wilson(share, effective, z)


def replicated_interval(
    counts: IntArray | FloatArray, of: IntArray | FloatArray, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Return the interval of a share that was simulated with several replicates of an uncertain model.

    More replicates make the share more exact that a fit predicts, but the fit itself no more certain. So the variance
    between replicates, less what chance within them explains, counts once and is not divided by their number (Rubin
    1987). It is known from few replicates, so the quantile is that of Student's t with Satterthwaite's degrees of
    freedom, at least `LEAST_FREEDOM`.

    Args:
        counts: Simulations counted with each replicate, which need not be whole numbers, shape ``(b,)``.
        of: Simulations with each replicate, of which some are positive, shape ``(b,)``.
        confidence: Level, in (0, 1).
    """
    from scipy import stats  # slow to import

    counts, of = counts[of > 0], of[of > 0]
    total, replicates = float(of.sum()), of.size
    share = float(counts.sum()) / total
    z, by_chance = NormalDist().inv_cdf(0.5 + 0.5 * confidence), share * (1.0 - share)
    if replicates == 1 or by_chance == 0.0:
        return _wilson(share, total, z)
    each = (total - float(of @ of) / total) / (replicates - 1)  # simulations of a replicate
    spread = float(of @ (counts / of - share) ** 2) / (replicates - 1)  # by_chance if replicates are alike
    more = (1.0 + 1.0 / replicates) / each
    variance = by_chance / total + more * max(spread - by_chance, 0.0)
    freedom = max(variance**2 * (replicates - 1) / max(more * spread, variance) ** 2, LEAST_FREEDOM)
    t = float(stats.t.ppf(0.5 + 0.5 * confidence, freedom))
    return _wilson(share, by_chance / variance * (z / t) ** 2, z)


def _wilson(share: float, trials: float, z: float) -> tuple[float, float]:
    """Return Wilson's interval of a share of a number of independent trials, which need not be whole."""
    spread = z * z / max(trials, 1e-9)
    centre = (share + spread / 2.0) / (1.0 + spread)
    half = np.sqrt(spread * (share * (1.0 - share) + spread / 4.0)) / (1.0 + spread)
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def ratio_interval(
    above: FloatArray, below: FloatArray, *, step: float, confidence: float = CONFIDENCE
) -> tuple[float, float] | None:
    """Return the interval of a ratio of two sums over independent simulations; None if fewer than two add to them.

    Args:
        above: Terms of the upper sum, >= 0, shape ``(n,)``.
        below: Terms of the lower sum, >= 0, one of them positive, shape ``(n,)``.
        step: The largest that a single simulation adds to a sum of events; 0 for amounts, to which all of them add.
        confidence: Level, in (0, 1).
    """
    from scipy import stats  # slow to import

    counted = (above > 0.0) | (below > 0.0)
    above, below = above[counted], below[counted]
    count, total, divisor = above.size, float(above.sum()), float(below.sum())
    if count < 2:
        return None
    tail = 0.5 * (1.0 - confidence)
    t, z = float(stats.t.ppf(1.0 - tail, count - 1)), NormalDist().inv_cdf(1.0 - tail)
    apart = above - total / divisor * below
    variance = (t / z) ** 2 * count / (count - 1) * float(apart @ apart)
    low, high = total, total + step
    if total > 0.0 and variance > 0.0:
        low = float(stats.gamma.ppf(tail, total**2 / variance, scale=variance / total))
    if (more := variance + step**2) > 0.0:
        high = float(stats.gamma.ppf(1.0 - tail, high**2 / more, scale=more / high))
    return low / divisor, high / divisor


def clustered(influence: FloatArray, kinds: Sequence[IntArray]) -> FloatArray:
    """Return the covariance of the sum of values, treating those with a common label as dependent, shape ``(p, p)``.

    Args:
        influence: Values with mean zero, shape ``(n, p)``.
        kinds: Labels of the values, from 0, shape ``(n,)`` each, at least one kind.

    References:
        Cameron, Gelbach and Miller 2011 (clusters of several kinds; negative eigenvalues become zero).
    """

    def of(label: IntArray) -> FloatArray:
        count = int(label.max()) + 1
        sums = np.stack([np.bincount(label, column, count) for column in influence.T], axis=1)
        product: FloatArray = sums.T @ sums * count / max(count - 1, 1)
        return product

    common = np.unique(np.stack(kinds, axis=1), axis=0, return_inverse=True)[1].ravel()
    total = sum((of(kind) for kind in kinds), -(len(kinds) - 1) * of(common))
    values, vectors = np.linalg.eigh(total)
    covariance: FloatArray = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return covariance

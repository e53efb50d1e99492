"""Draws from a posterior whose prior is uniform on the unit cube: sequential Monte Carlo with tempering.

Importance sampling from the prior fails once the data are many: few draws fit them, and these stand for all others.
So the likelihood is raised to a power that is low at first. Draws of the prior are resampled by it, then moved by
Metropolis steps, which leave the tempered posterior as it is; and the power rises as far as half of the draws still
count, until it is 1.

Sources: Del Moral, Doucet and Jasra 2006 (sequential Monte Carlo samplers) and 2012 (choice of the powers); ter Braak
2006 (steps along differences of draws).
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from brink.search.space import FloatArray, IntArray

MOVES: Final = 8
"""Metropolis steps at each power."""
LEAST_KEPT: Final = 0.5
"""Share of the draws that count after the power has risen, as an effective sample size."""
_HALVINGS: Final = 20
_SCALES: Final = (0.3, 1.0)
"""Lengths of steps along a difference of two draws, in shares of it."""
_MOVED: Final = 0.5
"""Share of the columns that a step along a difference changes."""
_JITTER: Final = 1e-4
_REDRAWN: Final = 0.05
"""Share of the columns that a step draws anew, which matters for those that the data say nothing about."""


def effective_size(log_weights: FloatArray) -> float:
    """Return the effective sample size of weighted draws, from 1 to their number.

    Args:
        log_weights: Logarithms of the weights, up to a constant, shape ``(n,)``.

    References:
        Kish 1965.
    """
    weights = np.exp(log_weights - log_weights.max())
    return float(weights.sum() ** 2 / (weights**2).sum())


def resampled(log_weights: FloatArray, count: int) -> IntArray:
    """Return the indices of draws that represent weighted ones (systematic resampling), shape ``(count,)``.

    Args:
        log_weights: Logarithms of the weights, up to a constant, shape ``(n,)``.
        count: Number of places.
    """
    sums = np.cumsum(np.exp(log_weights - log_weights.max()))
    steps = (np.arange(count) + 0.5) / count * sums[-1]
    places: IntArray = np.minimum(np.searchsorted(sums, steps), len(log_weights) - 1).astype(np.int64)
    return places


def posterior_draws(
    prior: Callable[[IntArray], FloatArray],
    log_likelihoods: FloatArray,
    log_likelihood: Callable[[FloatArray], FloatArray],
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Return draws from a posterior, points of the unit cube, shape ``(count, d)``.

    Args:
        prior: Given places, returns these draws of the prior, uniform in the unit cube, shape ``(count, d)``.
        log_likelihoods: Log-likelihood of each draw of the prior, shape ``(n,)``, n much larger than the count.
        log_likelihood: Given points of the unit cube, shape ``(count, d)``, returns the log-likelihood of each.
        count: Number of draws.
        rng: Chooses the steps.
    """
    power = _raised(log_likelihoods, 0.0, count)
    points = prior(resampled(power * log_likelihoods, count))
    values = log_likelihood(points)
    points, values = _moved(points, values, power, log_likelihood, rng)
    while power < 1.0:
        before, power = power, _raised(values, power, LEAST_KEPT * count)
        places = resampled((power - before) * values, count)
        points, values = _moved(points[places], values[places], power, log_likelihood, rng)
    return points


def _raised(values: FloatArray, power: float, least: float) -> float:
    """Return the highest power, at most 1, at which the effective sample size is still large enough."""
    low, high = power, 1.0
    if effective_size((high - power) * values) >= least:
        return high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if effective_size((middle - power) * values) >= least:
            low = middle
        else:
            high = middle
    return high


def _moved(
    points: FloatArray,
    values: FloatArray,
    power: float,
    log_likelihood: Callable[[FloatArray], FloatArray],
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return points after Metropolis steps at one power, and their log-likelihoods."""
    count = len(points)
    for _ in range(MOVES):
        # Each draw steps along the difference of two others, so that steps have the shape of the posterior.
        first, second = rng.choice(np.arange(1, count), 2, replace=False).tolist()
        difference = np.roll(points, first, axis=0) - np.roll(points, second, axis=0)
        scale = rng.choice(_SCALES, (count, 1)) * (rng.random(points.shape) < _MOVED)
        proposed = _reflected(points + scale * difference + rng.normal(0.0, _JITTER, points.shape))
        redrawn = rng.random(points.shape) < _REDRAWN
        proposed[redrawn] = rng.random(int(redrawn.sum()))
        likely = log_likelihood(proposed)
        accepted = np.log(rng.random(count)) < power * (likely - values)
        points = np.where(accepted[:, None], proposed, points)
        values = np.where(accepted, likely, values)
    return points, values


def _reflected(points: FloatArray) -> FloatArray:
    """Return points reflected at the faces of the unit cube, which keeps steps symmetric."""
    return np.abs(1.0 - np.abs(1.0 - np.abs(points)))  # steps are hardly longer than the cube

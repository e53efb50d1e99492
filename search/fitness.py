"""Boundary fitness: how far a neighbourhood is from the boundary of the p_th-unsafe region.

Source: Sharifi et al. 2023, eqs. 3-5 (Wilson interval of the unsafe share, boundary fitness).
"""

import numpy as np
from numpy.typing import ArrayLike

from brink.search.space import FloatArray, IntArray

Z_95 = 1.96
"""Quantile of the standard normal for a 95% interval, with the digits used in the paper."""


def _counts(unsafe: ArrayLike, evaluated: ArrayLike) -> tuple[IntArray, IntArray]:
    k, n = np.broadcast_arrays(np.asarray(unsafe), np.asarray(evaluated))
    for name, counts in (("unsafe", k), ("evaluated", n)):
        if counts.dtype.kind not in "iu":
            raise ValueError(f"{name}: expected integer counts, got {counts.dtype}")
    if (n < 1).any() or (k < 0).any() or (k > n).any():
        raise ValueError("expected 0 <= unsafe <= evaluated and evaluated >= 1 in every neighbourhood")
    return k.astype(np.int64), n.astype(np.int64)


def wilson_interval(
    unsafe: ArrayLike, evaluated: ArrayLike, z: float = Z_95
) -> tuple[FloatArray, FloatArray]:
    """Return the Wilson score interval of each neighbourhood's unsafe probability.

    The lower limit is exactly 0 without any unsafe solution, and the upper limit exactly 1 without any safe one, so
    that the fitness of all-safe neighbourhoods of one size does not depend on rounding.

    Args:
        unsafe: Unsafe solutions in each neighbourhood, integers, shape ``(n,)``.
        evaluated: Evaluated solutions in each neighbourhood, integers >= 1, shape ``(n,)``.
        z: Quantile of the standard normal, > 0.

    Returns:
        Lower and upper limits, each in [0, 1] and of shape ``(n,)``.

    Raises:
        ValueError: A count is negative, an ``unsafe`` exceeds its ``evaluated``, or z is not positive.

    References:
        Sharifi et al. 2023, eqs. 3-4.
    """
    if not (np.isfinite(z) and z > 0):
        raise ValueError(f"z: expected a number > 0, got {z!r}")
    k, n = _counts(unsafe, evaluated)
    p = k / n
    g = z * z / n
    centre = (p + g / 2) / (1 + g)
    half = z / (1 + g) * np.sqrt(p * (1 - p) / n + g / (4 * n))
    # With k = 0, centre and half width are equal, and with k = n they add up to 1, but for rounding.
    lower = np.where(k == 0, 0.0, np.clip(centre - half, 0.0, 1.0))
    upper = np.where(k == n, 1.0, np.clip(centre + half, 0.0, 1.0))
    return lower, upper


def boundary_fitness(unsafe: ArrayLike, evaluated: ArrayLike, p_th: float, z: float = Z_95) -> FloatArray:
    """Return how far each neighbourhood is from the boundary of the p_th-unsafe region, in [0, 1].

    Args:
        unsafe: Unsafe solutions in each neighbourhood, integers, shape ``(n,)``.
        evaluated: Evaluated solutions in each neighbourhood, integers >= 1, shape ``(n,)``.
        p_th: Threshold probability of the unsafe region, in (0, 1).
        z: Quantile of the standard normal, > 0.

    Returns:
        Fitness, shape ``(n,)``; 0 on the boundary.

    Raises:
        ValueError: A count is negative, an ``unsafe`` exceeds its ``evaluated``, or p_th or z is out of range.

    References:
        Sharifi et al. 2023, eq. 5.
    """
    if not 0 < p_th < 1:
        raise ValueError(f"p_th: expected a probability in (0, 1), got {p_th!r}")
    return fitness_of_interval(*wilson_interval(unsafe, evaluated, z), p_th)


def fitness_of_interval(lower: FloatArray, upper: FloatArray, p_th: float) -> FloatArray:
    """Return the boundary fitness of given intervals (eq. 5).

    Args:
        lower: Lower limits, shape ``(n,)``.
        upper: Upper limits, shape ``(n,)``.
        p_th: Threshold probability of the unsafe region, in (0, 1).
    """
    furthest: FloatArray = np.maximum(np.abs(upper - p_th), np.abs(lower - p_th))
    return furthest / max(p_th, 1 - p_th)

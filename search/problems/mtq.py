"""MTQ (maximum of two quadratics): a cooperative co-evolution benchmark whose boundary is known exactly.

f(x, y) = max(150 (1 - 10 ((x - 3/4)^2 + (y - 3/4)^2)), 50 (1 - 512 ((x - 1/4)^2 + (y - 1/4)^2))) - 100 on the
unit square; unsafe if f < 0. The second peak stays below 0, so the safe region is the disc of radius
sqrt(1/30) = 0.183 around (3/4, 3/4), 10.5% of the square.

Source: Sharifi et al. 2023, benchmark problems; the function is that of Popovici and De Jong (2006).
"""

import math
from collections.abc import Sequence

from brink.search.algorithm import Scored
from brink.search.component import FloatArray
from brink.search.space import Component, Real, SearchSpace

SPACE = SearchSpace((Component("x", (Real("x", 0.0, 1.0),)), Component("y", (Real("y", 0.0, 1.0),))))

RADIUS = 0.05
"""Radius of a neighbourhood, as in the paper."""

SAFE_CENTRE = 0.75
SAFE_RADIUS = math.sqrt(1 / 30)


def robustness(x: float, y: float) -> float:
    """Return f(x, y): negative if unsafe."""
    wide = 150.0 * (1.0 - 10.0 * ((x - 0.75) * (x - 0.75) + (y - 0.75) * (y - 0.75)))
    narrow = 50.0 * (1.0 - 512.0 * ((x - 0.25) * (x - 0.25) + (y - 0.25) * (y - 0.25)))
    return max(wide, narrow) - 100.0


def evaluate(vectors: Sequence[FloatArray]) -> Scored:
    """Return the verdict on a complete solution."""
    value = robustness(float(vectors[0][0]), float(vectors[1][0]))
    return Scored(unsafe=value < 0, robustness=value)


def gap_to_boundary(x: float, y: float) -> float:
    """Return how far a point lies from the circle on which f = 0: the known answer."""
    return abs(math.hypot(x - SAFE_CENTRE, y - SAFE_CENTRE) - SAFE_RADIUS)

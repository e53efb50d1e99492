"""Benchmark problems with known boundaries: MTQ and Onemax.

MTQ (maximum of two quadratics) is a cooperative co-evolution benchmark on the unit square,
f(x, y) = max(150 (1 - 10 ((x - 3/4)^2 + (y - 3/4)^2)), 50 (1 - 512 ((x - 1/4)^2 + (y - 1/4)^2))) - 100, unsafe if
f < 0. The second peak stays below 0, so the safe region is the disc of radius sqrt(1/30) = 0.183 around (3/4, 3/4),
10.5% of the square.

Onemax has ten plus ten bits, unsafe if fewer than five of the twenty are set. All its parameters are categorical.

Source: Sharifi et al. 2023, benchmark problems; the function of MTQ is that of Popovici and De Jong (2006).
"""

import math
from collections.abc import Sequence

from brink.search.algorithm import Scored
from brink.search.space import Categorical, Component, FloatArray, Real, SearchSpace

MTQ_SPACE = SearchSpace(
    tuple(Component(name, (Real(name, 0.0, 1.0, resolution=0.002),)) for name in ("x", "y"))
)

MTQ_RADIUS = 0.05
"""Neighbourhood radius for MTQ, as in the authors' code."""

MTQ_SAFE_CENTRE = 0.75
MTQ_SAFE_RADIUS = math.sqrt(1 / 30)


def mtq_robustness(x: float, y: float) -> float:
    """Return f(x, y) of MTQ, negative if unsafe."""
    wide = 150.0 * (1.0 - 10.0 * ((x - 0.75) * (x - 0.75) + (y - 0.75) * (y - 0.75)))
    narrow = 50.0 * (1.0 - 512.0 * ((x - 0.25) * (x - 0.25) + (y - 0.25) * (y - 0.25)))
    return max(wide, narrow) - 100.0


def evaluate_mtq(vectors: Sequence[FloatArray]) -> Scored:
    """Return the verdict of MTQ on a complete solution."""
    value = mtq_robustness(float(vectors[0][0]), float(vectors[1][0]))
    return Scored(unsafe=value < 0, robustness=value)


def mtq_gap_to_boundary(x: float, y: float) -> float:
    """Return the distance of a point from the circle f = 0, the exact boundary of MTQ."""
    return abs(math.hypot(x - MTQ_SAFE_CENTRE, y - MTQ_SAFE_CENTRE) - MTQ_SAFE_RADIUS)


ONEMAX_BITS = 10
"""Number of bits in each of the two components."""

ONEMAX_THRESHOLD = 5
"""Smallest number of set bits in a safe solution."""

ONEMAX_RADIUS = 0.1
"""Neighbourhood radius for Onemax, as in the authors' code: neighbours differ in at most two bits."""


def _bits(name: str) -> Component:
    return Component(name, tuple(Categorical(f"bit_{i}", ("0", "1")) for i in range(ONEMAX_BITS)))


ONEMAX_SPACE = SearchSpace((_bits("left"), _bits("right")))


def evaluate_onemax(vectors: Sequence[FloatArray]) -> Scored:
    """Return the verdict of Onemax on a complete solution."""
    value = float(sum(vector.sum() for vector in vectors)) - ONEMAX_THRESHOLD
    return Scored(unsafe=value < 0, robustness=value)

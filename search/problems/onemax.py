"""Onemax: ten and ten bits, unsafe if fewer than five of the twenty are set. All parameters are categorical.

Source: Sharifi et al. 2023, benchmark problems.
"""

from collections.abc import Sequence

from brink.search.algorithm import Scored
from brink.search.component import FloatArray
from brink.search.space import Categorical, Component, SearchSpace

BITS = 10
"""Bits in each of the two components."""

THRESHOLD = 5
"""Fewest set bits of a safe solution."""

RADIUS = 0.1
"""Radius of a neighbourhood, as in the paper: solutions that differ in at most two bits."""


def _bits(name: str) -> Component:
    return Component(name, tuple(Categorical(f"bit_{i}", ("0", "1")) for i in range(BITS)))


SPACE = SearchSpace((_bits("left"), _bits("right")))


def evaluate(vectors: Sequence[FloatArray]) -> Scored:
    """Return the verdict on a complete solution."""
    value = float(sum(vector.sum() for vector in vectors)) - THRESHOLD
    return Scored(unsafe=value < 0, robustness=value)

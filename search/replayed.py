"""Draws from a recorded list of uniform numbers, so that any sampler is a function of a point in the unit cube.

A small move of the point that is reversible for the uniform distribution is then a move of the solution that is
reversible for the distribution from which it is drawn, whatever that is: with repairs, constraints and observations.

Source: Kelemen, Szirmay-Kalos, Antal and Csonka 2002 (primary sample space).
"""

import math
from typing import Any, cast

import numpy as np
from scipy.special import ndtri

from brink.search.space import FloatArray, SearchSpace

_INSIDE = 1e-12


class _Replayed:
    """Has the methods of a generator that samplers call; each number takes one from the list, or a fresh one."""

    def __init__(self, given: FloatArray, fresh: np.random.Generator) -> None:
        self.used: list[float] = []
        self._given, self._fresh = given, fresh

    def _next(self) -> float:
        place = len(self.used)
        self.used.append(float(self._given[place]) if place < len(self._given) else self._fresh.random())
        return self.used[-1]

    def random(self, size: Any = None) -> Any:
        if size is None:
            return self._next()
        return np.array([self._next() for _ in range(math.prod(np.atleast_1d(size)))]).reshape(size)

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        shape = np.broadcast_shapes(np.shape(low), np.shape(high)) if size is None else size
        return low + (np.subtract(high, low)) * (self.random(shape) if shape != () else self._next())

    def integers(self, low: int, high: int | None = None, size: Any = None, *, endpoint: bool = False) -> Any:
        first, last = (0, low) if high is None else (low, high)
        count = last - first + int(endpoint)
        if count <= 0:
            raise ValueError("low >= high")
        drawn = (
            np.minimum(np.floor(np.asarray(self.random(size)) * count), count - 1).astype(np.int64) + first
        )
        return drawn if size is not None else np.int64(drawn)

    def choice(self, a: Any, size: Any = None, replace: bool = True, p: Any = None) -> Any:
        if size is not None or not replace:
            raise NotImplementedError("choice of several")
        values = np.arange(a) if isinstance(a, int | np.integer) else np.asarray(a)
        chances = np.full(len(values), 1 / len(values)) if p is None else np.asarray(p)
        return values[min(int(np.searchsorted(np.cumsum(chances), self._next(), "right")), len(values) - 1)]

    def permutation(self, x: Any) -> Any:
        values = np.arange(x) if isinstance(x, int | np.integer) else np.asarray(x)
        return values[np.argsort([self._next() for _ in values], kind="stable")]

    def standard_normal(self, size: Any = None) -> Any:
        return ndtri(np.clip(self.random(size), _INSIDE, 1 - _INSIDE))

    def normal(self, loc: float = 0.0, scale: float = 1.0, size: Any = None) -> Any:
        return loc + scale * self.standard_normal(size)


def draw_from(
    space: SearchSpace, numbers: FloatArray, fresh: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draw a solution as it occurs in operation, from a list of uniform numbers.

    Args:
        space: The space.
        numbers: Numbers in [0, 1), shape ``(k,)``; not all of them need be used.
        fresh: Source of further ones.

    Returns:
        The solution as a row, and all numbers: those given, followed by the further ones that it took.

    Raises:
        AttributeError: The space draws numbers of a kind that are not made from uniform ones here.
        NotImplementedError: Likewise.
    """
    replayed = _Replayed(numbers, fresh)
    row = space.join(space.draw(cast("np.random.Generator", replayed)))
    return row, np.append(numbers, replayed.used[len(numbers) :])


def moved(numbers: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return numbers after a move that is reversible for the uniform distribution.

    Half of the moves are small steps of all numbers, reflected at 0 and 1; half draw some numbers anew.

    Args:
        numbers: Numbers in [0, 1), shape ``(k,)``.
        rng: Source of the move.
    """
    if rng.random() < 0.5:
        step = float(rng.choice([0.02, 0.1, 0.3]))
        walked = np.abs(numbers + step * rng.standard_normal(len(numbers))) % 2.0
        return np.minimum(np.where(walked > 1.0, 2.0 - walked, walked), 1.0 - 2.0**-53)
    anew = rng.random(len(numbers)) < float(rng.choice([0.1, 0.3]))
    return np.where(anew, rng.random(len(numbers)), numbers)

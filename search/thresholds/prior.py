"""The prior of curves of thresholds: how the probability of a violation may rise along a unit.

A curve has a step, or two on top of each other, between a lower and an upper level. A step is a power of the
logistic function, so that it may be steeper on either side, and is described by its median and by the stretch from 20
to 80% of its height. The stretch is log-uniform; half of the curves begin at 0, and half end at 1.

Where one seed turned from safe to unsafe says where to expect the step: if seeds differ in nothing but where they
turn, it is a draw from the step itself. Because that need not be so, the tails are heavy, and a share of the curves
turn anywhere.

Curves are points of the unit cube, in which the prior is uniform, as `brink.search.tempering` takes them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from brink.search.space import FloatArray

DIMENSION: Final = 7
"""Numbers that describe a curve."""
WIDEST: Final = 0.7
"""Largest stretch of a step, as a share of the unit's range."""
NARROWEST: Final = 0.25
"""Smallest stretch of a step, in resolutions."""
ANYWHERE: Final = 0.15
"""Share of the curves whose step is anywhere, whatever the bracket."""
TWO_STEPS: Final = 0.3
"""Share of the curves with two steps."""
_SPREAD: Final = 0.5
_SKEWED: Final = 3.0
_APART: Final = 30.0
_LOWEST: Final = 0.6
_HALVINGS: Final = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePrior:
    """Curves along a line from a safe end, at 0, to an unsafe one, at 1.

    Attributes:
        safe: Where the line was last safe under one seed, in [0, 1].
        unsafe: Where it was first unsafe under the same seed, > `safe`, at most 1.
        resolution: Resolution of the unit, as a share of the line, > 0.
        range: Range of the unit, as a share of the line, > 0.
    """

    safe: float
    unsafe: float
    resolution: float
    range: float

    def __post_init__(self) -> None:
        if not (0.0 <= self.safe < self.unsafe <= 1.0 and self.resolution > 0.0 and self.range > 0.0):
            raise ValueError(
                f"expected 0 <= safe < unsafe <= 1 and a resolution and range > 0, got {self.safe}, {self.unsafe}, "
                f"{self.resolution} and {self.range}"
            )

    def shares(self, points: FloatArray, places: FloatArray) -> FloatArray:
        """Return the probabilities of a violation, shape ``(n, m)``.

        Args:
            points: Curves as points of the unit cube, shape ``(n, DIMENSION)``.
            places: Places on the line, shape ``(m,)``.
        """
        return np.ascontiguousarray(self._curves(points).shares(places[:, None]).T)

    def crossings(self, points: FloatArray, levels: Sequence[float]) -> FloatArray:
        """Return where curves reach levels, shape ``(m, n)``; infinite if beyond the line, on the side where it is.

        Args:
            points: Curves as points of the unit cube, shape ``(n, DIMENSION)``.
            levels: Probabilities in (0, 1), m of them.
        """
        curves, wanted = self._curves(points), np.array(levels)[:, None]
        low, high = np.zeros((len(levels), len(points))), np.ones((len(levels), len(points)))
        ends = curves.shares(np.array([[0.0], [1.0]]))
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            below = curves.shares(middle) < wanted
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        reached = np.where(ends[0] >= wanted, -np.inf, 0.5 * (low + high))
        return np.where(ends[1] < wanted, np.inf, reached)

    def _curves(self, points: FloatArray) -> "_Curves":
        where, how_wide, power, low, high, second, apart = np.ascontiguousarray(points.T)
        least, most = math.log(NARROWEST * self.resolution), math.log(WIDEST * self.range)
        stretch = np.exp(min(least, most - 1.0) + (most - min(least, most - 1.0)) * how_wide)
        exponent = np.exp((2.0 * power - 1.0) * math.log(_SKEWED))
        height = np.clip((second - (1.0 - TWO_STEPS)) / TWO_STEPS, 0.0, None)
        two = np.flatnonzero(height > 0.0)
        distance = np.sign(apart - 0.5) * stretch * _APART ** np.abs(2.0 * apart - 1.0)
        lower = _LOWEST * np.clip(2.0 * low - 1.0, 0.0, None) ** 2
        upper = 1.0 - _LOWEST * np.clip(2.0 * high - 1.0, 0.0, None) ** 2
        steps = _Steps.of(self._middles(where, stretch), stretch, exponent)
        return _Curves(
            first=steps,
            two=two,
            second=_Steps(steps.middle[two] + distance[two], *(part[two] for part in steps[1:])),
            share=0.1 + 0.8 * height[two],
            lower=lower,
            rise=np.clip(upper - lower, 0.0, None),
        )

    def _middles(self, where: FloatArray, stretch: FloatArray) -> FloatArray:
        """Return where steps rise to half of their height: anywhere, or near the bracket."""
        share = np.clip((where - ANYWHERE) / (1.0 - ANYWHERE), 1e-4, 1.0 - 1e-4)
        student = (2.0 * share - 1.0) / np.sqrt(2.0 * share * (1.0 - share))  # two degrees of freedom
        within = self.safe + (self.unsafe - self.safe) * share
        near = within + _SPREAD * stretch * student
        return np.where(where < ANYWHERE, -0.05 + 1.1 * where / ANYWHERE, near)


class _Steps(NamedTuple):
    """Steps from 0 to 1: powers of the logistic function, each array of shape ``(n,)``.

    Attributes:
        middle: Their medians.
        stretch: Their stretches from 20 to 80%.
        power: Their powers.
        half: Argument at which the power of the logistic function is a half.
        width: Difference of its arguments at 20 and 80%.
    """

    middle: FloatArray
    stretch: FloatArray
    power: FloatArray
    half: FloatArray
    width: FloatArray

    @classmethod
    def of(cls, middle: FloatArray, stretch: FloatArray, power: FloatArray) -> Self:
        """Return steps with given medians, stretches and powers."""

        def at(level: float) -> FloatArray:
            return np.asarray(-np.log(level ** (-1.0 / power) - 1.0))

        return cls(middle, stretch, power, at(0.5), at(0.8) - at(0.2))

    def at(self, places: FloatArray) -> FloatArray:
        """Return the heights at places of shape ``(m, n)`` or ``(m, 1)``, shape ``(m, n)``."""
        scaled = self.half + (places - self.middle) / self.stretch * self.width
        return np.asarray((1.0 + np.exp(np.clip(-scaled, -40.0, 40.0))) ** -self.power)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Curves:
    """Curves, each array of shape ``(n,)``, or ``(k,)`` for those with two steps.

    Attributes:
        first: The first step of each.
        two: Indices of the curves with two steps.
        second: Their second steps.
        share: Height of these, as a share of the rise.
        lower: Lower level of each curve.
        rise: Difference to the upper level.
    """

    first: _Steps
    two: NDArray[np.intp]
    second: _Steps
    share: FloatArray
    lower: FloatArray
    rise: FloatArray

    def shares(self, places: FloatArray) -> FloatArray:
        """Return the probabilities at places of shape ``(m, n)`` or ``(m, 1)``, shape ``(m, n)``."""
        step = self.first.at(places)
        first = step[:, self.two]
        own = places if places.shape[1] == 1 else places[:, self.two]
        step[:, self.two] = first + self.share * (self.second.at(own) - first)
        return self.lower + self.rise * step

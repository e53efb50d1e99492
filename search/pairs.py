"""Pairs across the boundary: a safe and an unsafe solution, and the steps between them.

Two solutions differ in *units*: a number, a category, or two numbers that a constraint ties together, such as the
left and right edge of a box, which are only ever changed together. A pair is *tight* if its distance is at most eps,
or if it differs in one category and nothing else, or in one number with no valid value in between.

`Steps.between` narrows a pair without leaving the lines between its two solutions: while several units differ, some
of them are taken over from the unsafe side, so that few differ in the end; the last one is halved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from brink.search.features import Unit, units_of
from brink.search.metric import Metric
from brink.search.space import Categorical, FloatArray, IntArray, SearchSpace, frozen_array

_WITHIN: Final = 1 - 1e-9
"""Keeps a distance of eps from exceeding it by rounding."""
_BESIDE: Final = tuple(place / 16 for place in (4, 12, 2, 6, 10, 14, 1, 3, 5, 7, 9, 11, 13, 15))
_ORDERS: Final = 8
"""Orders of units tried for a step, in case repair undoes the first ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The geometry of pairs in a space.

    Attributes:
        space: The space.
        units: Its units.
        metric: Distance between complete solutions.
    """

    space: SearchSpace
    units: tuple[Unit, ...] = field(init=False)
    metric: Metric = field(init=False)
    _share: FloatArray = field(init=False, repr=False)
    _unit_of_column: IntArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "units", units_of(self.space))
        unit_of = {column: place for place, unit in enumerate(self.units) for column in unit}
        places = np.array([unit_of[column] for column in range(self.space.dimension)], np.int64)
        object.__setattr__(self, "_unit_of_column", frozen_array(places, np.int64))
        object.__setattr__(self, "metric", Metric.of_space(self.space))
        categorical = self.space.categorical
        halves = 2.0 if 0 < categorical.sum() < categorical.size else 1.0
        counts = np.where(categorical, max(1, categorical.sum()), max(1, (~categorical).sum()))
        object.__setattr__(self, "_share", frozen_array(1.0 / (halves * counts)))

    def differing(self, a: FloatArray, b: FloatArray) -> list[Unit]:
        """Return the units in which two rows of shape ``(d,)`` differ."""
        places = set(self._unit_of_column[a != b].tolist())
        return [self.units[place] for place in sorted(places)]

    def distance(self, a: FloatArray, b: FloatArray) -> float:
        """Return the distance between two rows of shape ``(d,)``."""
        return float(self.metric.between(a[None], b[None])[0, 0])

    def apart(self, rows: FloatArray, others: FloatArray) -> FloatArray:
        """Return the distance of each row from the other row at its place, shapes ``(n, d)`` to ``(n,)``."""
        gaps = np.minimum(np.abs(rows - others) / self.space.ranges, 1.0)  # 1 if one of two is absent
        distances: FloatArray = (np.where(self.space.categorical, rows != others, gaps) * self._share).sum(
            axis=1
        )
        return distances

    def lengths(self, a: FloatArray, b: FloatArray, units: Sequence[Unit]) -> FloatArray:
        """Return how much each unit adds to the distance between two rows, shape ``(len(units),)``."""
        gaps = np.minimum(np.abs(a - b) / self.space.ranges, 1.0)
        gaps = np.where(self.space.categorical, (a != b).astype(float), gaps) * self._share
        return np.array([gaps[list(unit)].sum() for unit in units])

    def is_tight(self, a: FloatArray, b: FloatArray, eps: float) -> bool:
        """Return whether two rows of shape ``(d,)`` are a tight pair; equal rows are not.

        Args:
            a: A valid complete solution.
            b: Another one.
            eps: Largest distance of a tight pair.
        """
        if np.array_equal(a, b):
            return False
        return self.distance(a, b) <= eps or self.are_one_step_apart(a, b)

    def are_one_step_apart(self, a: FloatArray, b: FloatArray) -> bool:
        """Return whether two rows of shape ``(d,)`` differ in one unit alone, with no valid value in between."""
        units = self.differing(a, b)
        return len(units) == 1 and self._halfway(a, b, units[0]) is None

    def largest_tight(self, eps: float) -> float:
        """Return a distance that no tight pair exceeds.

        Args:
            eps: Largest distance of a tight pair that differs in more than one step.
        """
        parameters = self.space.parameters
        steps = [
            share if isinstance(p, Categorical) else share * p.spacing / p.range
            for p, share in zip(parameters, self._share.tolist(), strict=True)
            if isinstance(p, Categorical) or p.spacing
        ]
        widest = max((len(unit) for unit in self.units), default=1)
        return float(max([eps, *(widest * step for step in steps)]))

    def between(
        self, safe: FloatArray, unsafe: FloatArray, rng: np.random.Generator, *, eps: float = 0.0
    ) -> FloatArray | None:
        """Return a valid row between two others, about half-way; None if there is none.

        While more than one unit differs, the row is the safe one with some units of the unsafe one, in random order;
        otherwise it is the middle. Two solutions that are less than twice `eps` apart are divided at `eps` instead:
        then they are a tight pair in any case, and the wider of two such pairs depends less on chance.

        Args:
            safe: A valid complete solution, shape ``(d,)``.
            unsafe: Another one.
            rng: Orders the units.
            eps: Largest distance of a tight pair.
        """
        units = self.differing(safe, unsafe)
        if not units:
            return None
        for _ in range(_ORDERS if len(units) > 1 else 0):
            order = [units[place] for place in rng.permutation(len(units))]
            lengths = self.lengths(safe, unsafe, order)
            cut = int(np.argmin(np.abs(np.cumsum(lengths)[:-1] - 0.5 * lengths.sum()))) + 1
            columns = [column for unit in order[:cut] for column in unit]
            row = np.array(safe)
            row[columns] = unsafe[columns]
            middle = self._valid_between(row, safe, unsafe)
            if middle is not None:
                return middle
        length = self.distance(safe, unsafe) if len(units) == 1 else 0.0
        share = _WITHIN * eps / length if eps < length < 2 * eps else 0.5
        for place in rng.permutation(len(units)):
            middle = self._halfway(safe, unsafe, units[place], share)
            if middle is not None:
                return middle
        return None

    def _halfway(
        self, safe: FloatArray, unsafe: FloatArray, unit: Unit, share: float = 0.5
    ) -> FloatArray | None:
        """Return the safe row with one unit part of the way to the unsafe one; None if no valid row is in between."""
        columns = list(unit)
        if self.space.categorical[columns].any():
            return None
        # A formula may rule out the middle and leave what is beside it.
        for part in (share, *(_BESIDE if self.space.constraints else ())):
            row = np.array(safe)
            row[columns] = safe[columns] + part * (unsafe[columns] - safe[columns])
            middle = self._valid_between(row, safe, unsafe)
            if middle is not None:
                return middle
        if len(columns) == 1:
            return None
        for column in columns:  # whole numbers that are tied together may be one step apart each
            row = np.array(safe)
            row[column] = unsafe[column]
            middle = self._valid_between(row, safe, unsafe)
            if middle is not None:
                return middle
        return None

    def _valid_between(self, row: FloatArray, safe: FloatArray, unsafe: FloatArray) -> FloatArray | None:
        """Return the repaired row if it lies between two others and differs from both."""
        rng = np.random.Generator(np.random.PCG64(0))  # not drawn from: no number is missing
        repaired = self.space.join(self.space.repair(self.space.split(row), rng))
        if np.array_equal(repaired, safe) or np.array_equal(repaired, unsafe):
            return None
        inside = (np.minimum(safe, unsafe) <= repaired) & (repaired <= np.maximum(safe, unsafe))
        return (
            repaired
            if inside[~self.space.categorical].all() and self._labels_of(repaired, safe, unsafe)
            else None
        )

    def _labels_of(self, row: FloatArray, safe: FloatArray, unsafe: FloatArray) -> bool:
        categorical = self.space.categorical
        return bool(((row == safe) | (row == unsafe))[categorical].all())


def midpoints(rows: FloatArray, others: FloatArray, space: SearchSpace) -> FloatArray:
    """Return the points half-way between rows, both shape ``(n, d)``; of two categories, those of `rows`."""
    return np.where(space.categorical, rows, 0.5 * (rows + others))

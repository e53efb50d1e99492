"""The distance between complete solutions, or between vectors of one component.

The distance is half the mean share of range by which numbers differ plus half the share of categories that
differ; where there are only numbers or only categories, that term alone. In [0, 1] for values in their ranges.

The value of a pair depends on nothing but the pair: not on the other rows of the call nor on block sizes, and it
is the same both ways round, bit for bit. So every sum runs one parameter after the other in the order of the
vector (a matrix product would not do: its order of summation changes with the shape).

Source: Sharifi et al. 2023, heterogeneous distance of complete solutions.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from search.component import BoolArray, FloatArray, frozen_array
from search.errors import SpaceError
from search.space import SearchSpace

METRIC_VERSION = 1
"""Version of the distance; stored beside every block of distances, to be raised with any change of a bit."""

CodeArray: TypeAlias = NDArray[np.int16]

BLOCK_ROWS = 64
BLOCK_COLUMNS = 1024
"""Pairs a block: three float64 blocks of this size stay in a core's second-level cache."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """Rows made ready for a metric, one array row a parameter.

    Attributes:
        numbers: Numbers in units of their range, shape ``(numeric, n)``.
        codes: Categories, shape ``(categorical, n)``.
    """

    numbers: FloatArray
    codes: CodeArray

    def __len__(self) -> int:
        return int(self.numbers.shape[1])

    def followed_by(self, other: "Points") -> "Points":
        """Return these points and then the others."""
        return Points(
            numbers=np.concatenate([self.numbers, other.numbers], axis=1),
            codes=np.concatenate([self.codes, other.codes], axis=1),
        )

    def take(self, positions: NDArray[np.intp] | slice) -> "Points":
        """Return the points at some positions."""
        return Points(numbers=self.numbers[:, positions], codes=self.codes[:, positions])


@dataclass(frozen=True, slots=True, eq=False)
class Metric:
    """A heterogeneous distance.

    Attributes:
        ranges: Range of each parameter, > 0 where it is a number, shape ``(d,)``.
        categorical: Which parameters are categorical, shape ``(d,)``.
    """

    ranges: FloatArray
    categorical: BoolArray
    _numeric: NDArray[np.intp] = field(init=False, repr=False)
    _categories: NDArray[np.intp] = field(init=False, repr=False)

    def __init__(self, ranges: ArrayLike, categorical: ArrayLike) -> None:
        object.__setattr__(self, "ranges", frozen_array(ranges))
        object.__setattr__(self, "categorical", frozen_array(categorical, np.bool_))
        if self.ranges.ndim != 1 or self.ranges.shape != self.categorical.shape or not self.ranges.size:
            raise SpaceError(
                f"expected one range and one mark a parameter, got {self.ranges.shape}, {self.categorical.shape}"
            )
        widths = self.ranges[~self.categorical]
        if not (np.isfinite(widths).all() and (widths > 0).all()):
            raise SpaceError(f"expected ranges > 0 for all numbers, got {widths.tolist()}")
        object.__setattr__(self, "_numeric", np.flatnonzero(~self.categorical))
        object.__setattr__(self, "_categories", np.flatnonzero(self.categorical))

    @classmethod
    def of_space(cls, space: SearchSpace) -> Self:
        """Return the distance between complete solutions."""
        return cls(space.ranges, space.categorical)

    @classmethod
    def of_component(cls, space: SearchSpace, index: int) -> Self:
        """Return the distance inside one component's population."""
        part = space.slices[index]
        return cls(space.ranges[part], space.categorical[part])

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return int(self.ranges.size)

    def points(self, rows: FloatArray) -> Points:
        """Make rows ready to be measured; do it once for rows that are measured often.

        Args:
            rows: Shape ``(n, d)``.

        Raises:
            SpaceError: The shape is wrong, or a category is no small whole number.
        """
        if rows.ndim != 2 or rows.shape[1] != self.dimension:
            raise SpaceError(f"expected rows of {self.dimension} numbers, got shape {rows.shape}")
        raw = rows[:, self._categories]
        if not (np.isfinite(raw).all() and (np.abs(raw) < 2**15).all() and (raw == np.rint(raw)).all()):
            raise SpaceError("expected categories as whole numbers within ±32,767")
        return Points(
            numbers=np.ascontiguousarray((rows[:, self._numeric] / self.ranges[self._numeric]).T),
            codes=np.ascontiguousarray(raw.astype(np.int16).T),
        )

    def between(self, a_rows: FloatArray, b_rows: FloatArray) -> FloatArray:
        """Return the distance of each row to each other row, shape ``(len(a_rows), len(b_rows))``.

        Works in blocks: besides the result it holds under 2 MB.

        Args:
            a_rows: Shape ``(m, d)``.
            b_rows: Shape ``(n, d)``.
        """
        a, b = self.points(a_rows), self.points(b_rows)
        distances = np.empty((len(a), len(b)))
        for rows, columns, block in self.blocks(a, b):
            distances[rows, columns] = block
        return distances

    def blocks(self, a: Points, b: Points) -> Iterator[tuple[slice, slice, FloatArray]]:
        """Yield all distances in blocks: which rows, which columns, and the distances between them.

        The block's memory is used again for the next one: copy what should stay.
        """
        height, width = min(BLOCK_ROWS, len(a)), min(BLOCK_COLUMNS, len(b))
        total, step = np.empty((height, width)), np.empty((height, width))
        differ = np.empty((height, width), np.bool_)
        count = np.empty((height, width), np.uint8 if self._categories.size < 256 else np.uint16)
        for top in range(0, len(a), BLOCK_ROWS):
            rows = slice(top, min(top + BLOCK_ROWS, len(a)))
            for left in range(0, len(b), BLOCK_COLUMNS):
                columns = slice(left, min(left + BLOCK_COLUMNS, len(b)))
                shape = (slice(rows.stop - top), slice(columns.stop - left))
                self._measure(a, b, rows, columns, total[shape], step[shape], differ[shape], count[shape])
                yield rows, columns, total[shape]

    def _measure(
        self,
        a: Points,
        b: Points,
        rows: slice,
        columns: slice,
        total: FloatArray,
        step: FloatArray,
        differ: BoolArray,
        count: NDArray[np.unsignedinteger],
    ) -> None:
        """Fill `total` with the distances of one block."""
        for position in range(self._numeric.size):
            target = step if position else total
            np.subtract(a.numbers[position, rows, None], b.numbers[position, columns], out=target)
            np.abs(target, out=target)
            if position:
                np.add(total, step, out=total)
        if self._numeric.size:
            np.divide(total, self._numeric.size, out=total)
        if not self._categories.size:
            return
        count.fill(0)
        for position in range(self._categories.size):
            np.not_equal(a.codes[position, rows, None], b.codes[position, columns], out=differ)
            np.add(count, differ.view(np.uint8), out=count)
        share = step if self._numeric.size else total
        np.divide(count, float(self._categories.size), out=share)
        if self._numeric.size:
            np.add(total, share, out=total)
            np.multiply(total, 0.5, out=total)

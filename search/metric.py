"""The distance between complete solutions, or between vectors of one component.

The distance is half the mean share of range by which numbers differ plus half the share of categories that
differ; where there are only numbers or only categories, that term alone. In [0, 1] for values in their ranges.

The value of a pair depends on nothing but the pair: not on the other rows of the call nor on block sizes, and it
is the same both ways round, bit for bit. So every sum runs one parameter after the other in the order of the
vector. scipy's city-block kernel does just that (a test compares it with a plain loop, bit for bit); a matrix
product would not do, since its order of summation changes with the shape.

Source: Sharifi et al. 2023, heterogeneous distance of complete solutions.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from brink.search.component import BoolArray, FloatArray, frozen_array
from brink.search.errors import SpaceError
from brink.search.space import SearchSpace

METRIC_VERSION = 1
"""Version of the distance; stored beside every block of distances, to be raised with any change of a bit."""

CodeArray: TypeAlias = NDArray[np.int16]

BLOCK_ROWS = 64
BLOCK_COLUMNS = 1024
"""Pairs a block: a float64 block of this size (512 KB) stays in a core's second-level cache."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """Rows made ready for a metric.

    Attributes:
        numbers: Numbers in units of their range, a row a point, shape ``(n, numeric)``.
        codes: Categories, a row a parameter, shape ``(categorical, n)``.
    """

    numbers: FloatArray
    codes: CodeArray

    def __len__(self) -> int:
        return int(self.numbers.shape[0])

    def followed_by(self, other: "Points") -> "Points":
        """Return these points and then the others."""
        return Points(
            numbers=np.concatenate([self.numbers, other.numbers]),
            codes=np.concatenate([self.codes, other.codes], axis=1),
        )

    def take(self, positions: NDArray[np.intp] | slice) -> "Points":
        """Return the points at some positions."""
        return Points(numbers=self.numbers[positions], codes=self.codes[:, positions])


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
            numbers=np.ascontiguousarray(rows[:, self._numeric] / self.ranges[self._numeric]),
            codes=np.ascontiguousarray(raw.astype(np.int16).T),
        )

    def between(self, a_rows: FloatArray, b_rows: FloatArray) -> FloatArray:
        """Return the distance of each row to each other row, shape ``(len(a_rows), len(b_rows))``.

        Works in blocks: besides the result and the prepared rows it holds under 2 MB.

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
        """Yield all distances in blocks: which rows, which columns, and the distances between them."""
        for top in range(0, len(a), BLOCK_ROWS):
            rows = slice(top, min(top + BLOCK_ROWS, len(a)))
            part = a.take(rows)
            for left in range(0, len(b), BLOCK_COLUMNS):
                columns = slice(left, min(left + BLOCK_COLUMNS, len(b)))
                yield rows, columns, self._block(part, b.take(columns))

    def _block(self, a: Points, b: Points) -> FloatArray:
        if not self._categories.size:
            return self._numeric_share(a, b)
        differing = np.zeros((len(a), len(b)), np.uint8 if self._categories.size < 256 else np.uint16)
        for mine, theirs in zip(a.codes, b.codes, strict=True):
            np.add(differing, (mine[:, None] != theirs).view(np.uint8), out=differing)
        # A true division: a share of 3 in 10 must compare as 0.3 does.
        share: FloatArray = differing / float(self._categories.size)
        if self._numeric.size:
            share += self._numeric_share(a, b)
            share *= 0.5
        return share

    def _numeric_share(self, a: Points, b: Points) -> FloatArray:
        share: FloatArray = cdist(a.numbers, b.numbers, "cityblock")
        share /= self._numeric.size
        return share

"""The distance between complete solutions, or between vectors of one component.

The distance has two terms of equal weight: the mean difference of the numbers, each divided by its range, and the
share of categories that differ. If there are only numbers or only categories, it is that term alone. It lies in
[0, 1] for values in their ranges. A parameter that only one of two solutions has differs by its whole range.

The distance of a pair is symmetric and depends on that pair alone, bit for bit: not on the other rows of the call,
nor on block sizes. Every sum therefore adds the parameters in the order of the vector. scipy's city-block kernel
does so (a test compares it with a plain loop); a matrix product does not, as its order of summation depends on the
shape.

Source: Sharifi et al. 2023, heterogeneous distance of complete solutions.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brink.search.deadline import check_time
from brink.search.errors import SpaceError
from brink.search.space import BoolArray, FloatArray, SearchSpace, frozen_array

METRIC_VERSION = 1
"""Version of the distance, stored with every block of distances. Increment it with any change, even of one bit."""

CodeArray: TypeAlias = NDArray[np.int16]

BLOCK_ROWS = 64
BLOCK_COLUMNS = 1024
"""Block size: 64 x 1024 float64 distances (512 KB) fit into a core's second-level cache."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """Rows preprocessed for a metric.

    Attributes:
        numbers: Numbers divided by their ranges, one row per point, shape ``(n, numeric)``.
        codes: Categories, one row per parameter, shape ``(categorical, n)``.
    """

    numbers: FloatArray
    codes: CodeArray

    def __len__(self) -> int:
        return int(self.numbers.shape[0])

    def followed_by(self, other: "Points") -> "Points":
        """Return these points followed by the others."""
        return Points(
            numbers=np.concatenate([self.numbers, other.numbers]),
            codes=np.concatenate([self.codes, other.codes], axis=1),
        )

    def take(self, positions: NDArray[np.intp] | slice) -> "Points":
        """Return the points at the given positions."""
        return Points(numbers=self.numbers[positions], codes=self.codes[:, positions])


@dataclass(frozen=True, slots=True, eq=False)
class Metric:
    """A distance over numeric and categorical parameters.

    Attributes:
        ranges: Range of each parameter, > 0 for numbers, shape ``(d,)``.
        categorical: Which parameters are categorical, shape ``(d,)``.
        absent: What is stored for each parameter where it is absent, NaN if it is always present, shape ``(d,)``.
    """

    ranges: FloatArray
    categorical: BoolArray
    absent: FloatArray
    _numeric: NDArray[np.intp] = field(init=False, repr=False)
    _categories: NDArray[np.intp] = field(init=False, repr=False)

    def __init__(self, ranges: ArrayLike, categorical: ArrayLike, absent: ArrayLike | None = None) -> None:
        object.__setattr__(self, "ranges", frozen_array(ranges))
        object.__setattr__(self, "categorical", frozen_array(categorical, np.bool_))
        always = np.full(self.ranges.shape, np.nan)
        object.__setattr__(self, "absent", always if absent is None else frozen_array(absent))
        if self.ranges.ndim != 1 or self.ranges.shape != self.categorical.shape or not self.ranges.size:
            raise SpaceError(
                f"expected one range and one flag per parameter, got {self.ranges.shape}, {self.categorical.shape}"
            )
        widths = self.ranges[~self.categorical]
        if not (np.isfinite(widths).all() and (widths > 0).all()):
            raise SpaceError(f"expected ranges > 0 for all numbers, got {widths.tolist()}")
        object.__setattr__(self, "_numeric", np.flatnonzero(~self.categorical))
        object.__setattr__(self, "_categories", np.flatnonzero(self.categorical))

    @classmethod
    def of_space(cls, space: SearchSpace) -> Self:
        """Return the metric for complete solutions."""
        return cls(space.ranges, space.categorical, space.absent)

    @classmethod
    def of_component(cls, space: SearchSpace, index: int) -> Self:
        """Return the metric for vectors of one component."""
        part = space.slices[index]
        return cls(space.ranges[part], space.categorical[part], space.absent[part])

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return int(self.ranges.size)

    def points(self, rows: FloatArray) -> Points:
        """Preprocess rows of shape ``(n, d)``; do it once for rows that are compared repeatedly.

        Raises:
            SpaceError: The shape is wrong, or a category is not a small integer.
        """
        if rows.ndim != 2 or rows.shape[1] != self.dimension:
            raise SpaceError(f"expected rows of {self.dimension} numbers, got shape {rows.shape}")
        raw = rows[:, self._categories]
        if not (np.isfinite(raw).all() and (np.abs(raw) < 2**15).all() and (raw == np.rint(raw)).all()):
            raise SpaceError("expected categories as whole numbers within ±32,767")
        return Points(
            numbers=np.ascontiguousarray(self._numbers(rows)),
            codes=np.ascontiguousarray(raw.astype(np.int16).T),
        )

    def _numbers(self, rows: FloatArray) -> FloatArray:
        """Return numbers divided by their ranges, with three columns in place of one that may be absent.

        The city-block distance of ``(x, 1 - x, 1) / 2`` and the same of y is ``|x - y|``; that of either and of
        zeros, for an absent number, is 1. So absence is a category of its own.
        """
        numbers: FloatArray = rows[:, self._numeric] / self.ranges[self._numeric]
        absent = self.absent[self._numeric]
        may_be = np.flatnonzero(~np.isnan(absent))
        if not may_be.size:
            return numbers
        shares = numbers[:, may_be] - (absent / self.ranges[self._numeric])[may_be] - 1.0
        present = rows[:, self._numeric[may_be]] != absent[may_be]
        columns = [0.5 * np.where(present, one, 0.0) for one in (shares, 1.0 - shares, np.ones_like(shares))]
        return np.concatenate([np.delete(numbers, may_be, axis=1), *columns], axis=1)

    def between(self, a_rows: FloatArray, b_rows: FloatArray) -> FloatArray:
        """Return the distances between two sets of rows, shapes ``(m, d)`` and ``(n, d)`` to ``(m, n)``.

        Works in blocks: besides the result and the preprocessed rows it needs less than 2 MB.
        """
        a, b = self.points(a_rows), self.points(b_rows)
        distances = np.empty((len(a), len(b)))
        for rows, columns, block in self.blocks(a, b):
            distances[rows, columns] = block
        return distances

    def blocks(self, a: Points, b: Points) -> Iterator[tuple[slice, slice, FloatArray]]:
        """Yield all distances in blocks: rows, columns, and the distances between them.

        Raises:
            OutOfTime: The `time_limit` around it is up.
        """
        for top in range(0, len(a), BLOCK_ROWS):
            rows = slice(top, min(top + BLOCK_ROWS, len(a)))
            part = a.take(rows)
            for left in range(0, len(b), BLOCK_COLUMNS):
                check_time()
                columns = slice(left, min(left + BLOCK_COLUMNS, len(b)))
                yield rows, columns, self._block(part, b.take(columns))

    def _block(self, a: Points, b: Points) -> FloatArray:
        if not self._categories.size:
            return self._numeric_share(a, b)
        differing = np.zeros((len(a), len(b)), np.uint8 if self._categories.size < 256 else np.uint16)
        for mine, theirs in zip(a.codes, b.codes, strict=True):
            np.add(differing, (mine[:, None] != theirs).view(np.uint8), out=differing)
        # A true division, not a product with 1 / size: 3 of 10 must equal 0.3.
        share: FloatArray = differing / float(self._categories.size)
        if self._numeric.size:
            share += self._numeric_share(a, b)
            share *= 0.5
        return share

    def _numeric_share(self, a: Points, b: Points) -> FloatArray:
        from scipy.spatial.distance import cdist  # slow to import

        share: FloatArray = cdist(a.numbers, b.numbers, "cityblock")
        share /= self._numeric.size
        return share

"""All evaluated complete solutions of a campaign, with neighbour counts and fitness, updated incrementally.

An archive is immutable: `Archive.grown` returns a new one. Adding m solutions to n computes only the m x (n + m) new
distances; no matrix of all distances is kept. The neighbourhood of a solution holds all solutions at a distance of at
most the radius, including itself. The comparison uses the float64 distance.

Source: Sharifi et al. 2023, section on fitness (the whole archive is rescored each generation).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brink.search.fitness import Z_95, fitness_of_interval, wilson_interval
from brink.search.metric import Metric, Points
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace, frozen_array

Float32Array: TypeAlias = NDArray[np.float32]


ARRAYS: Final = ("numbers", "vectors", "unsafe", "robustness", "neighbours", "unsafe_neighbours")
"""Names of the stored arrays from which `Archive.restore` restores an archive."""


class HasNeighbourhood(Protocol):
    """A configuration that includes the settings of a neighbourhood."""

    @property
    def radius(self) -> float: ...  # noqa: D102  (see Neighbourhood)
    @property
    def p_th(self) -> float: ...  # noqa: D102
    @property
    def z(self) -> float: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """Settings of neighbourhoods and of the boundary.

    Attributes:
        radius: Maximum distance of a neighbour (delta), >= 0.
        p_th: Threshold probability of the unsafe region, in (0, 1).
        z: Quantile of the standard normal for the Wilson interval, > 0.
    """

    radius: float
    p_th: float
    z: float = Z_95

    def __post_init__(self) -> None:
        if not (np.isfinite(self.radius) and self.radius >= 0):
            raise ValueError(f"radius: expected a number >= 0, got {self.radius!r}")
        if not 0 < self.p_th < 1:
            raise ValueError(f"p_th: expected a probability in (0, 1), got {self.p_th!r}")
        if not (np.isfinite(self.z) and self.z > 0):
            raise ValueError(f"z: expected a number > 0, got {self.z!r}")

    @classmethod
    def of(cls, config: HasNeighbourhood) -> Self:
        """Return the neighbourhood settings of a configuration."""
        return cls(radius=config.radius, p_th=config.p_th, z=config.z)


def _metric(of: SearchSpace | Metric) -> Metric:
    return of if isinstance(of, Metric) else Metric.of_space(of)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Archive:
    """Evaluated complete solutions in the order of insertion; all arrays are read-only.

    Attributes:
        metric: Distance between complete solutions.
        neighbourhood: Radius and threshold.
        numbers: Candidate numbers, all different, int64, shape ``(n,)``.
        vectors: Complete solutions as rows, shape ``(n, d)``.
        unsafe: Verdicts, shape ``(n,)``.
        robustness: Distance to violation, shape ``(n,)``.
        neighbours: Solutions in each neighbourhood, including the solution itself, int64, shape ``(n,)``.
        unsafe_neighbours: Unsafe solutions in each neighbourhood, int64, shape ``(n,)``.
        interval: Wilson interval of the unsafe share in each neighbourhood, shape ``(n, 2)``.
        fitness: Boundary fitness in [0, 1], shape ``(n,)``.
        latest_rows: Distances of the m solutions added last to all n, float32, shape ``(m, n)``; None in an archive
            that was restored or grown with ``keep_rows=False``.
    """

    metric: Metric
    neighbourhood: Neighbourhood
    numbers: IntArray
    vectors: FloatArray
    unsafe: BoolArray
    robustness: FloatArray
    neighbours: IntArray
    unsafe_neighbours: IntArray
    interval: FloatArray
    fitness: FloatArray
    latest_rows: Float32Array | None
    _points: Points = field(repr=False)

    def __len__(self) -> int:
        return int(self.numbers.size)

    @classmethod
    def empty(cls, of: SearchSpace | Metric, neighbourhood: Neighbourhood) -> Self:
        """Return an empty archive."""
        metric = _metric(of)
        nothing = np.empty(0)
        return cls.restore(
            metric,
            neighbourhood,
            numbers=nothing,
            vectors=np.empty((0, metric.dimension)),
            unsafe=nothing,
            robustness=nothing,
            neighbours=nothing,
            unsafe_neighbours=nothing,
        )

    @classmethod
    def restore(
        cls,
        of: SearchSpace | Metric,
        neighbourhood: Neighbourhood,
        *,
        numbers: ArrayLike,
        vectors: FloatArray,
        unsafe: ArrayLike,
        robustness: ArrayLike,
        neighbours: ArrayLike,
        unsafe_neighbours: ArrayLike,
    ) -> Self:
        """Restore an archive from its stored arrays, without computing any distance.

        Args:
            of: The archive's space, or its metric.
            neighbourhood: Settings of the neighbourhood.
            numbers: Candidate numbers, shape ``(n,)``.
            vectors: Complete solutions as rows, shape ``(n, d)``.
            unsafe: Verdicts, shape ``(n,)``.
            robustness: Distances to violation, shape ``(n,)``.
            neighbours: Solutions in each neighbourhood, shape ``(n,)``.
            unsafe_neighbours: Unsafe solutions in each neighbourhood, shape ``(n,)``.

        Raises:
            ValueError: The shapes differ, or a count exceeds n.
        """
        metric = _metric(of)
        rows = frozen_array(vectors)
        columns: dict[str, NDArray[Any]] = {
            "numbers": frozen_array(numbers, np.int64),
            "unsafe": frozen_array(unsafe, np.bool_),
            "robustness": frozen_array(robustness),
            "neighbours": frozen_array(neighbours, np.int64),
            "unsafe_neighbours": frozen_array(unsafe_neighbours, np.int64),
        }
        for name, column in columns.items():
            if column.shape != rows.shape[:1]:
                raise ValueError(f"{name}: expected shape {rows.shape[:1]}, got {column.shape}")
        if (columns["neighbours"] > len(rows)).any():
            most = int(columns["neighbours"].max())
            raise ValueError(
                f"neighbours: expected counts of at most {len(rows)}, the number of solutions; got {most}"
            )
        interval, fitness = _scores(columns["unsafe_neighbours"], columns["neighbours"], neighbourhood)
        return cls(
            metric=metric,
            neighbourhood=neighbourhood,
            vectors=rows,
            interval=interval,
            fitness=fitness,
            latest_rows=None,
            _points=metric.points(rows),
            **columns,
        )

    def grown(
        self,
        numbers: ArrayLike,
        vectors: FloatArray,
        unsafe: ArrayLike,
        robustness: ArrayLike,
        *,
        keep_rows: bool = True,
    ) -> "Archive":
        """Return an archive with m more solutions and with all counts and fitness updated.

        Args:
            numbers: Candidate numbers, shape ``(m,)``.
            vectors: Rows, shape ``(m, d)``.
            unsafe: Verdicts, shape ``(m,)``.
            robustness: Distances to violation, shape ``(m,)``.
            keep_rows: Whether to keep the new distances in `latest_rows`; pass False for large m.

        Raises:
            ValueError: The shapes differ, or a number is already in the archive.
            SpaceError: The rows do not fit the metric.
        """
        new_numbers = np.asarray(numbers, np.int64)
        new_unsafe = np.asarray(unsafe, np.bool_)
        new_robustness = np.asarray(robustness, np.float64)
        rows = np.asarray(vectors, np.float64)
        if {new_numbers.shape, new_unsafe.shape, new_robustness.shape} != {rows.shape[:1]}:
            raise ValueError(
                f"expected one number, verdict and robustness per row, got {new_numbers.shape}, "
                f"{new_unsafe.shape}, {new_robustness.shape} for {rows.shape}"
            )
        all_numbers = np.concatenate([self.numbers, new_numbers])
        if np.unique(new_numbers).size < new_numbers.size or np.isin(new_numbers, self.numbers).any():
            raise ValueError(
                "numbers: expected each candidate once; some are repeated or already in the archive"
            )
        all_unsafe = np.concatenate([self.unsafe, new_unsafe])
        new_points = self.metric.points(rows)
        points = self._points.followed_by(new_points)
        kept = np.empty((len(new_points), len(points)), np.float32) if keep_rows else None
        neighbours, unsafe_neighbours = self._neighbour_counts(new_points, points, all_unsafe, kept)
        interval, fitness = _scores(unsafe_neighbours, neighbours, self.neighbourhood)
        if kept is not None:
            kept.flags.writeable = False
        return Archive(
            metric=self.metric,
            neighbourhood=self.neighbourhood,
            numbers=_sealed(all_numbers),
            vectors=_sealed(np.concatenate([self.vectors, rows])),
            unsafe=_sealed(all_unsafe),
            robustness=_sealed(np.concatenate([self.robustness, new_robustness])),
            neighbours=_sealed(neighbours),
            unsafe_neighbours=_sealed(unsafe_neighbours),
            interval=interval,
            fitness=fitness,
            latest_rows=kept,
            _points=points,
        )

    def _neighbour_counts(
        self, new: Points, everything: Points, unsafe: BoolArray, kept: Float32Array | None
    ) -> tuple[IntArray, IntArray]:
        """Return how many neighbours, and unsafe neighbours, every point has; store the new distances in `kept`."""
        known = len(self)
        totals = np.zeros((len(everything), 2), np.int64)
        totals[:known] = np.stack([self.neighbours, self.unsafe_neighbours], axis=1)
        # The first column counts all solutions, the second the unsafe ones. Products of zeros and ones in float32 are
        # exact, whatever the order of summation, as long as no count within a block exceeds 2**24.
        weights = np.stack([np.ones(len(everything)), unsafe], axis=1).astype(np.float32)
        for rows, columns, block in self.metric.blocks(new, everything):
            near = (block <= self.neighbourhood.radius).astype(np.float32)
            if kept is not None:
                kept[rows, columns] = block
            added = slice(known + rows.start, known + rows.stop)
            totals[added] += (near @ weights[columns]).astype(np.int64)
            old = slice(columns.start, min(columns.stop, known))
            if old.stop > old.start:
                totals[old] += (near[:, : old.stop - old.start].T @ weights[added]).astype(np.int64)
        return np.ascontiguousarray(totals[:, 0]), np.ascontiguousarray(totals[:, 1])

    def distances(
        self, rows: Sequence[int] | NDArray[np.intp], columns: Sequence[int] | NDArray[np.intp]
    ) -> FloatArray:
        """Return the distances between the solutions at `rows` and those at `columns`, shape ``(rows, columns)``."""
        return self.metric.between(
            self.vectors[np.asarray(rows, np.intp)], self.vectors[np.asarray(columns, np.intp)]
        )

    def first(self, count: int) -> "Archive":
        """Return the archive as it was after its first `count` solutions."""
        if 2 * count < len(self):
            return self._rebuilt(slice(count), self.unsafe[:count], self.robustness[:count])
        # Few solutions are left out: subtracting them takes fewer distances than counting all others again.
        kept = np.arange(min(count, len(self)))
        left_out = np.arange(len(kept), len(self))
        counts = np.stack([self.neighbours, self.unsafe_neighbours], axis=1)[kept]
        weights = np.stack([np.ones(len(left_out)), self.unsafe[left_out]], axis=1).astype(np.float32)
        points = self._points
        for rows, columns, block in self.metric.blocks(points.take(left_out), points.take(kept)):
            near = (block <= self.neighbourhood.radius).astype(np.float32)
            counts[columns] -= (near.T @ weights[rows]).astype(np.int64)
        return Archive.restore(
            self.metric,
            self.neighbourhood,
            numbers=self.numbers[kept],
            vectors=self.vectors[kept],
            unsafe=self.unsafe[kept],
            robustness=self.robustness[kept],
            neighbours=counts[:, 0],
            unsafe_neighbours=counts[:, 1],
        )

    def with_verdicts(self, unsafe: ArrayLike, robustness: ArrayLike) -> "Archive":
        """Return an archive of the same solutions with other verdicts and robustness, both shape ``(n,)``."""
        return self._rebuilt(slice(None), unsafe, robustness)

    def _rebuilt(self, part: slice, unsafe: ArrayLike, robustness: ArrayLike) -> "Archive":
        return Archive.empty(self.metric, self.neighbourhood).grown(
            self.numbers[part], self.vectors[part], unsafe, robustness, keep_rows=False
        )


def _sealed(array: NDArray[Any]) -> NDArray[Any]:
    """Make a newly created array read-only, and return it."""
    array.flags.writeable = False
    return array


def _scores(
    unsafe_neighbours: IntArray, neighbours: IntArray, neighbourhood: Neighbourhood
) -> tuple[FloatArray, FloatArray]:
    """Return the intervals, shape ``(n, 2)``, and the fitness, shape ``(n,)``, of all solutions."""
    lower, upper = wilson_interval(unsafe_neighbours, neighbours, neighbourhood.z)
    fitness = fitness_of_interval(lower, upper, neighbourhood.p_th)
    return _sealed(np.stack([lower, upper], axis=1)), _sealed(fitness)


def archive_digest(archive: Archive) -> str:
    """Return the SHA-256 of an archive's candidate numbers, solutions, verdicts and fitness, as hexadecimal digits.

    The hash covers, in this order and little-endian: the text ``brink-archive-1`` and a newline; the numbers of
    solutions n and of parameters d, each int64; the candidate numbers, n int64; the vectors, n x d float64 row by
    row; the verdicts, n bytes, 1 for unsafe; the fitness, n float64. Counts are left out because they determine the
    fitness, and robustness because the search does not use it.
    """
    rows, columns = archive.vectors.shape
    digest = hashlib.sha256(b"brink-archive-1\n")
    digest.update(np.array([rows, columns], "<i8").tobytes())
    digest.update(archive.numbers.astype("<i8").tobytes())
    digest.update(archive.vectors.astype("<f8").tobytes())
    digest.update(archive.unsafe.astype("u1").tobytes())
    digest.update(archive.fitness.astype("<f8").tobytes())
    return digest.hexdigest()

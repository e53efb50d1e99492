"""All evaluated complete solutions of a campaign, with neighbour counts and fitness where these are asked for.

An archive is immutable: `Archive.grown` returns a new one. The neighbourhood of a solution holds all solutions at a
distance of at most the radius, including itself. The comparison uses the float64 distance.

Neighbours are counted when they are first asked for, so a search that never asks, as it does not follow boundary
fitness, never pays. An archive that grew from a counted one by m solutions to n computes only the m x n new
distances; no matrix of all distances is kept.

Source: Sharifi et al. 2023, section on fitness (the whole archive is rescored each generation).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brink.search.fitness import Z_95, fitness_of_interval, wilson_interval
from brink.search.metric import Metric, Points
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace, frozen_array

Float32Array: TypeAlias = NDArray[np.float32]


ARRAYS: Final = ("numbers", "vectors", "unsafe", "robustness", "neighbours", "unsafe_neighbours")
"""Names of the stored arrays from which `Archive.restore` restores an archive."""
_COUNTED_AT_ONCE: Final = 1_024
"""Solutions whose neighbours are counted at a time, among those before them and themselves."""


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """Settings of neighbourhoods and of the boundary.

    Attributes:
        radius: Maximum distance of a neighbour (delta), >= 0.
        p_th: Threshold probability of the unsafe region, in (0, 1).
        z: Quantile of the standard normal for the Wilson interval, > 0.
    """

    radius: float = 0.3
    p_th: float = 0.1
    z: float = Z_95

    def __post_init__(self) -> None:
        if not (np.isfinite(self.radius) and self.radius >= 0):
            raise ValueError(f"radius: expected a number >= 0, got {self.radius!r}")
        if not 0 < self.p_th < 1:
            raise ValueError(f"p_th: expected a probability in (0, 1), got {self.p_th!r}")
        if not (np.isfinite(self.z) and self.z > 0):
            raise ValueError(f"z: expected a number > 0, got {self.z!r}")

    @classmethod
    def of(cls, config: object) -> Self:
        """Return the neighbourhood settings of an algorithm's configuration; the defaults for those it lacks."""
        return cls(**{name: getattr(config, name) for name in cls.__slots__ if hasattr(config, name)})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NeighbourCounts:
    """How many neighbours solutions have, and their boundary fitness; all arrays are read-only.

    Attributes:
        neighbours: Solutions in each neighbourhood, including the solution itself, int64, shape ``(n,)``.
        unsafe_neighbours: Unsafe solutions in each neighbourhood, int64, shape ``(n,)``.
        interval: Wilson interval of the unsafe share in each neighbourhood, shape ``(n, 2)``.
        fitness: Boundary fitness in [0, 1], shape ``(n,)``.
        latest_rows: Distances of the m solutions added last to all n, float32, shape ``(m, n)``; None unless they
            were counted by themselves, and were to be kept.
    """

    neighbours: IntArray
    unsafe_neighbours: IntArray
    interval: FloatArray
    fitness: FloatArray
    latest_rows: Float32Array | None = None

    @classmethod
    def of(
        cls,
        neighbours: IntArray,
        unsafe_neighbours: IntArray,
        neighbourhood: Neighbourhood,
        latest_rows: Float32Array | None = None,
    ) -> Self:
        """Return the counts, with intervals and fitness."""
        lower, upper = wilson_interval(unsafe_neighbours, neighbours, neighbourhood.z)
        return cls(
            neighbours=_sealed(neighbours),
            unsafe_neighbours=_sealed(unsafe_neighbours),
            interval=_sealed(np.stack([lower, upper], axis=1)),
            fitness=_sealed(fitness_of_interval(lower, upper, neighbourhood.p_th)),
            latest_rows=latest_rows if latest_rows is None else _sealed(latest_rows),
        )

    def __len__(self) -> int:
        return int(self.neighbours.size)


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
    """

    metric: Metric
    neighbourhood: Neighbourhood
    numbers: IntArray
    vectors: FloatArray
    unsafe: BoolArray
    robustness: FloatArray
    _points: Points = field(repr=False)
    _counts: NeighbourCounts = field(repr=False)
    """Those of the first solutions, as counted so far."""
    _kept_from: int | None = field(default=None, repr=False)
    """Position of the first solution whose distances are kept in `latest_rows`; None to keep none."""

    def __len__(self) -> int:
        return int(self.numbers.size)

    @classmethod
    def empty(cls, of: SearchSpace | Metric, neighbourhood: Neighbourhood) -> Self:
        """Return an empty archive."""
        metric, nothing = _metric(of), np.empty(0)
        return cls.restore(
            metric,
            neighbourhood,
            numbers=nothing,
            vectors=np.empty((0, metric.dimension)),
            unsafe=nothing,
            robustness=nothing,
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
        neighbours: ArrayLike = (),
        unsafe_neighbours: ArrayLike = (),
    ) -> Self:
        """Restore an archive from its stored arrays, without computing any distance.

        Args:
            of: The archive's space, or its metric.
            neighbourhood: Settings of the neighbourhood.
            numbers: Candidate numbers, shape ``(n,)``.
            vectors: Complete solutions as rows, shape ``(n, d)``.
            unsafe: Verdicts, shape ``(n,)``.
            robustness: Distances to violation, shape ``(n,)``.
            neighbours: Solutions in each neighbourhood, shape ``(n,)``; none if they were not counted.
            unsafe_neighbours: Unsafe solutions in each neighbourhood, as many.

        Raises:
            ValueError: The shapes differ, or a count exceeds n.
        """
        metric = _metric(of)
        rows = frozen_array(vectors)
        columns: dict[str, NDArray[Any]] = {
            "numbers": frozen_array(numbers, np.int64),
            "unsafe": frozen_array(unsafe, np.bool_),
            "robustness": frozen_array(robustness),
        }
        counts: dict[str, NDArray[Any]] = {
            "neighbours": frozen_array(neighbours, np.int64),
            "unsafe_neighbours": frozen_array(unsafe_neighbours, np.int64),
        }
        counted = rows.shape[:1] if any(column.size for column in counts.values()) else (0,)
        for name, column in (columns | counts).items():
            expected = counted if name in counts else rows.shape[:1]
            if column.shape != expected:
                raise ValueError(f"{name}: expected shape {expected}, got {column.shape}")
        if (counts["neighbours"] > len(rows)).any():
            most = int(counts["neighbours"].max())
            raise ValueError(
                f"neighbours: expected counts of at most {len(rows)}, the number of solutions; got {most}"
            )
        return cls(
            metric=metric,
            neighbourhood=neighbourhood,
            numbers=columns["numbers"],
            vectors=rows,
            unsafe=columns["unsafe"],
            robustness=columns["robustness"],
            _points=metric.points(rows),
            _counts=NeighbourCounts.of(counts["neighbours"], counts["unsafe_neighbours"], neighbourhood),
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
        """Return an archive with m more solutions; neighbours are counted when they are asked for.

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
        return Archive(
            metric=self.metric,
            neighbourhood=self.neighbourhood,
            numbers=_sealed(all_numbers),
            vectors=_sealed(np.concatenate([self.vectors, rows])),
            unsafe=_sealed(np.concatenate([self.unsafe, new_unsafe])),
            robustness=_sealed(np.concatenate([self.robustness, new_robustness])),
            _points=self._points.followed_by(self.metric.points(rows)),
            _counts=self._counts,
            _kept_from=len(self) if keep_rows else None,
        )

    @property
    def counts(self) -> NeighbourCounts:
        """The neighbours of all solutions, counted now unless they were before."""
        if not self.is_counted:
            object.__setattr__(self, "_counts", self._counted())
        return self._counts

    @property
    def is_counted(self) -> bool:
        """Whether the neighbours of all solutions have been counted."""
        return len(self._counts) == len(self)

    @property
    def neighbours(self) -> IntArray:
        """Solutions in each neighbourhood; see `NeighbourCounts`."""
        return self.counts.neighbours

    @property
    def unsafe_neighbours(self) -> IntArray:
        """Unsafe solutions in each neighbourhood; see `NeighbourCounts`."""
        return self.counts.unsafe_neighbours

    @property
    def interval(self) -> FloatArray:
        """Intervals of the unsafe shares; see `NeighbourCounts`."""
        return self.counts.interval

    @property
    def fitness(self) -> FloatArray:
        """Boundary fitness; see `NeighbourCounts`."""
        return self.counts.fitness

    def _counted(self) -> NeighbourCounts:
        """Return the counts of all solutions: those counted before, and the neighbours of the others."""
        first, size = len(self._counts), len(self)
        totals = np.zeros((size, 2), np.int64)
        totals[:first] = np.stack([self._counts.neighbours, self._counts.unsafe_neighbours], axis=1)
        kept = np.empty((size - first, size), np.float32) if self._kept_from == first else None
        step = _COUNTED_AT_ONCE if kept is None else size
        for start in range(first, size, step):
            self._count(start, min(start + step, size), totals, kept)
        neighbours, unsafe_neighbours = np.ascontiguousarray(totals.T)
        return NeighbourCounts.of(neighbours, unsafe_neighbours, self.neighbourhood, kept)

    def _count(self, start: int, stop: int, totals: IntArray, kept: Float32Array | None) -> None:
        """Add the neighbours of the solutions from `start` to `stop` to the counts of all solutions up to `stop`.

        Args:
            start: Position of the first solution.
            stop: Position after the last one.
            totals: Neighbours and unsafe neighbours of all solutions, shape ``(n, 2)``.
            kept: Where to store the distances, shape ``(stop - start, n)``.
        """
        points = self._points
        # The first column counts all solutions, the second the unsafe ones. Products of zeros and ones in float32 are
        # exact, whatever the order of summation, as long as no count within a block exceeds 2**24.
        weights = np.stack([np.ones(stop), self.unsafe[:stop]], axis=1).astype(np.float32)
        for rows, columns, block in self.metric.blocks(
            points.take(slice(start, stop)), points.take(slice(stop))
        ):
            near = (block <= self.neighbourhood.radius).astype(np.float32)
            if kept is not None:
                kept[rows, columns] = block
            added = slice(start + rows.start, start + rows.stop)
            totals[added] += (near @ weights[columns]).astype(np.int64)
            old = slice(columns.start, min(columns.stop, start))
            if old.stop > old.start:
                totals[old] += (near[:, : old.stop - old.start].T @ weights[added]).astype(np.int64)

    def distances(
        self, rows: Sequence[int] | NDArray[np.intp], columns: Sequence[int] | NDArray[np.intp]
    ) -> FloatArray:
        """Return the distances between the solutions at `rows` and those at `columns`, shape ``(rows, columns)``."""
        return self.metric.between(
            self.vectors[np.asarray(rows, np.intp)], self.vectors[np.asarray(columns, np.intp)]
        )

    def first(self, count: int) -> "Archive":
        """Return the archive as it was after its first `count` solutions."""
        if 2 * count < len(self) or not self.is_counted:
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


def archive_digest(archive: Archive) -> str:
    """Return the SHA-256 of an archive's candidate numbers, solutions, verdicts and fitness, as hexadecimal digits.

    The hash covers, in this order and little-endian: the text ``brink-archive-1`` and a newline; the numbers of
    solutions n and of parameters d, each int64; the candidate numbers, n int64; the vectors, n x d float64 row by
    row; the verdicts, n bytes, 1 for unsafe; the fitness, n float64. Counts are left out because they determine the
    fitness, and robustness because the search does not use it. The fitness is computed for the digest if the search
    does not use it.
    """
    rows, columns = archive.vectors.shape
    digest = hashlib.sha256(b"brink-archive-1\n")
    digest.update(np.array([rows, columns], "<i8").tobytes())
    digest.update(archive.numbers.astype("<i8").tobytes())
    digest.update(archive.vectors.astype("<f8").tobytes())
    digest.update(archive.unsafe.astype("u1").tobytes())
    digest.update(archive.fitness.astype("<f8").tobytes())
    return digest.hexdigest()

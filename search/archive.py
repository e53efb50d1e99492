"""All evaluated complete solutions of a campaign, with neighbour counts and fitness, grown incrementally.

An archive is immutable: growing returns a new one. Adding m solutions to n costs the m x (n + m) distances that
are new and nothing else; no matrix of all distances is kept. A neighbourhood holds the solutions at a distance of
at most the radius, itself included, decided on the float64 distance.

Source: Sharifi et al. 2023, section on fitness; re-scoring of the whole archive each generation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brink.search.component import BoolArray, FloatArray, frozen_array
from brink.search.fitness import Z_95, IntArray, fitness_of_interval, wilson_interval
from brink.search.metric import Metric, Points
from brink.search.space import SearchSpace

Float32Array: TypeAlias = NDArray[np.float32]


class HasNeighbourhood(Protocol):
    """A configuration with the settings of a neighbourhood."""

    @property
    def radius(self) -> float: ...  # noqa: D102  (see Neighbourhood)
    @property
    def p_th(self) -> float: ...  # noqa: D102
    @property
    def z(self) -> float: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """What counts as near, and which boundary is sought.

    Attributes:
        radius: Largest distance of a neighbour (delta), >= 0.
        p_th: Threshold probability of the unsafe region, in (0, 1).
        z: Quantile of the standard normal for the interval, > 0.
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
        """Return the neighbourhood that a configuration sets."""
        return cls(radius=config.radius, p_th=config.p_th, z=config.z)


def _metric(of: SearchSpace | Metric) -> Metric:
    return of if isinstance(of, Metric) else Metric.of_space(of)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Archive:
    """Evaluated complete solutions, in the order in which they were added. All arrays are read-only.

    Attributes:
        metric: Distance between complete solutions.
        neighbourhood: Radius and threshold.
        numbers: Candidate numbers, all different, int64, shape ``(n,)``.
        vectors: Complete solutions as rows, shape ``(n, d)``.
        unsafe: Verdicts, shape ``(n,)``.
        robustness: Distance to violation, shape ``(n,)``.
        neighbours: Solutions in each neighbourhood, itself included, int64, shape ``(n,)``.
        unsafe_neighbours: Unsafe ones among them, int64, shape ``(n,)``.
        interval: Wilson interval of the unsafe share in each neighbourhood, shape ``(n, 2)``.
        fitness: Distance to the boundary in [0, 1], shape ``(n,)``.
        latest_rows: Distances that the last growth computed: a row for each of its m solutions, a column for each
            of all n, float32, shape ``(m, n)``; None in an archive that was not just grown.
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
        """Return an archive without solutions."""
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
        """Return the archive that was stored as these arrays, without measuring a distance.

        Raises:
            ValueError: The arrays do not belong together.
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
            raise ValueError("neighbours: expected no more than there are solutions")
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
        """Return this archive with m more solutions, all counts and all fitness up to date.

        Args:
            numbers: Candidate numbers, shape ``(m,)``.
            vectors: Rows, shape ``(m, d)``.
            unsafe: Verdicts, shape ``(m,)``.
            robustness: Distances to violation, shape ``(m,)``.
            keep_rows: Whether `latest_rows` keeps the distances; leave it out for large m.

        Raises:
            ValueError: The shapes do not belong together, or a number is there already.
            SpaceError: The rows do not fit the metric.
        """
        new_numbers = np.asarray(numbers, np.int64)
        new_unsafe = np.asarray(unsafe, np.bool_)
        new_robustness = np.asarray(robustness, np.float64)
        rows = np.asarray(vectors, np.float64)
        if {new_numbers.shape, new_unsafe.shape, new_robustness.shape} != {rows.shape[:1]}:
            raise ValueError(
                f"expected one number, verdict and robustness a row, got {new_numbers.shape}, "
                f"{new_unsafe.shape}, {new_robustness.shape} for {rows.shape}"
            )
        all_numbers = np.concatenate([self.numbers, new_numbers])
        if np.unique(new_numbers).size < new_numbers.size or np.isin(new_numbers, self.numbers).any():
            raise ValueError("numbers: expected each candidate once; some are in the archive already")
        all_unsafe = np.concatenate([self.unsafe, new_unsafe])
        new_points = self.metric.points(rows)
        points = self._points.followed_by(new_points)
        kept = np.empty((len(new_points), len(points)), np.float32) if keep_rows else None
        neighbours, unsafe_neighbours = self._counted(new_points, points, all_unsafe, kept)
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

    def _counted(
        self, new: Points, everything: Points, unsafe: BoolArray, kept: Float32Array | None
    ) -> tuple[IntArray, IntArray]:
        """Return all neighbour counts after the new points came, and file the distances in `kept`."""
        known = len(self)
        totals = np.zeros((len(everything), 2), np.int64)
        totals[:known] = np.stack([self.neighbours, self.unsafe_neighbours], axis=1)
        # One column counts everybody, the other the unsafe. A product of zeros and ones in float32 is exact as
        # long as no count of a block exceeds 2**24, whatever the order of summation.
        weights = np.stack([np.ones(len(everything)), unsafe], axis=1).astype(np.float32)
        for rows, columns, block in self.metric.blocks(new, everything):
            near = (block <= self.neighbourhood.radius).astype(np.float32)
            if kept is not None:
                kept[rows, columns] = block
            mine = slice(known + rows.start, known + rows.stop)
            totals[mine] += (near @ weights[columns]).astype(np.int64)
            old = slice(columns.start, min(columns.stop, known))
            if old.stop > old.start:
                totals[old] += (near[:, : old.stop - old.start].T @ weights[mine]).astype(np.int64)
        return np.ascontiguousarray(totals[:, 0]), np.ascontiguousarray(totals[:, 1])

    def distances(
        self, rows: Sequence[int] | NDArray[np.intp], columns: Sequence[int] | NDArray[np.intp]
    ) -> FloatArray:
        """Return the distances between solutions at some positions and at others, shape ``(rows, columns)``."""
        return self.metric.between(
            self.vectors[np.asarray(rows, np.intp)], self.vectors[np.asarray(columns, np.intp)]
        )

    def first(self, count: int) -> "Archive":
        """Return the archive as it was when it held its first `count` solutions: what was known then."""
        return self._rebuilt(slice(count), self.unsafe[:count], self.robustness[:count])

    def judged(self, unsafe: ArrayLike, robustness: ArrayLike) -> "Archive":
        """Return the archive of the same solutions with other verdicts."""
        return self._rebuilt(slice(None), unsafe, robustness)

    def _rebuilt(self, part: slice, unsafe: ArrayLike, robustness: ArrayLike) -> "Archive":
        return Archive.empty(self.metric, self.neighbourhood).grown(
            self.numbers[part], self.vectors[part], unsafe, robustness, keep_rows=False
        )


def _sealed(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array that nobody else holds read-only."""
    array.flags.writeable = False
    return array


def _scores(
    unsafe_neighbours: IntArray, neighbours: IntArray, neighbourhood: Neighbourhood
) -> tuple[FloatArray, FloatArray]:
    """Return the intervals, shape ``(n, 2)``, and the fitness of all solutions."""
    lower, upper = wilson_interval(unsafe_neighbours, neighbours, neighbourhood.z)
    fitness = fitness_of_interval(lower, upper, neighbourhood.p_th)
    return _sealed(np.stack([lower, upper], axis=1)), _sealed(fitness)

"""A map of an archive, with similar solutions close together, and the solutions nearest to a given one.

The map is a classical (Torgerson) scaling of the distances. For more than `EXACT_POINTS` solutions it is fitted to
landmarks, spread evenly over the archive, and all solutions are placed by their distances to these. A fitted map can
therefore also place later solutions, without moving the earlier ones.

A problem with two numerical parameters needs no scaling: `own_plane` draws it in its own coordinates.

Source: Torgerson 1952; de Silva and Tenenbaum 2004, landmark multidimensional scaling.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from brink.search.archive import Archive
from brink.search.metric import Metric
from brink.search.parameters import Number
from brink.search.space import FloatArray, SearchSpace

EXACT_POINTS = 2_000
LANDMARKS = 1_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projection:
    """A fitted map, which can place any solution.

    Attributes:
        metric: Distance between complete solutions.
        landmarks: Solutions from whose distances all others are placed, shape ``(k, d)``.
        centre: Mean squared distance from the landmarks to each of them, shape ``(k,)``.
        scale: Shift along each axis per squared distance to each landmark, shape ``(k, 2)``.
        explained: Share of the squared distances shown by the map, in [0, 1]; the rest is outside the plane.
    """

    metric: Metric
    landmarks: FloatArray
    centre: FloatArray
    scale: FloatArray
    explained: float

    @classmethod
    def fitted(
        cls,
        metric: Metric,
        vectors: FloatArray,
        *,
        exact_points: int = EXACT_POINTS,
        landmarks: int = LANDMARKS,
    ) -> Self:
        """Fit a map to solutions, wider than it is high; each axis points towards its most distant landmark.

        Args:
            metric: Distance between complete solutions.
            vectors: Solutions as rows, shape ``(n, d)``.
            exact_points: Largest number of solutions for which all distances are used.
            landmarks: Number of landmarks for more solutions, >= 3.
        """
        count = len(vectors)
        if count < 2:
            return cls(
                metric=metric,
                landmarks=np.empty((0, metric.dimension)),
                centre=np.empty(0),
                scale=np.empty((0, 2)),
                explained=1.0,
            )
        chosen = (
            np.arange(count)
            if count <= exact_points
            else np.linspace(0, count - 1, landmarks).astype(np.intp)
        )
        squared = metric.between(vectors[chosen], vectors[chosen]) ** 2
        values, axes, total = _principal_axes(squared)
        scale = np.divide(axes, np.sqrt(values), out=np.zeros_like(axes), where=values > 0)
        centre = squared.mean(axis=0)
        points = -0.5 * (squared - centre) @ scale
        wide = np.argsort(-np.ptp(points, axis=0), kind="stable")
        points, scale = points[:, wide], scale[:, wide]
        furthest = points[np.abs(points).argmax(axis=0), [0, 1]]
        explained = float(values.sum() / total) if total > 0 else 1.0
        return cls(
            metric=metric,
            landmarks=vectors[chosen],
            centre=centre,
            scale=scale * np.where(furthest < 0, -1.0, 1.0),
            explained=min(explained, 1.0),
        )

    def placed(self, vectors: FloatArray) -> FloatArray:
        """Return the positions of solutions on the map, in units of the metric, shape ``(n, d)`` to ``(n, 2)``."""
        points = np.zeros((len(vectors), 2))
        if not len(self.landmarks):
            return points
        for top in range(0, len(vectors), EXACT_POINTS):
            rows = slice(top, top + EXACT_POINTS)
            squared = self.metric.between(vectors[rows], self.landmarks) ** 2
            points[rows] = -0.5 * (squared - self.centre) @ self.scale
        return points + 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plane:
    """The two numerical parameters of a problem as the axes of a map, drawn with equal scales.

    Attributes:
        names: Names of the parameters with their units, across and up.
        low: Stored values at the drawn coordinate 0, shape ``(2,)``.
        scale: Difference in stored value per drawn unit, shape ``(2,)``. Equal if the parameters are comparable, so
            that a circle looks like one; otherwise the range of each parameter, so that the map is a square.
        extent: Drawn size of the whole search space, shape ``(2,)``.
        numbers: The parameters.
    """

    names: tuple[str, str]
    low: FloatArray
    scale: FloatArray
    extent: FloatArray
    numbers: tuple[Number, Number]

    def placed(self, vectors: FloatArray) -> FloatArray:
        """Return the positions of solutions on the map, shape ``(n, 2)`` to ``(n, 2)``."""
        return np.asarray((vectors - self.low) / self.scale)

    def value(self, axis: int, drawn: float) -> float:
        """Return the parameter's value at a drawn coordinate of an axis, 0 or 1."""
        return float(self.numbers[axis].shown(self.low[axis] + drawn * self.scale[axis]))


COMPARABLE = 10.0
"""Two parameters of one unit are drawn to the same scale if their ranges differ by at most this factor."""


def own_plane(space: SearchSpace) -> Plane | None:
    """Return the plane of a problem with exactly two parameters, both numbers; None for any other problem."""
    parameters = space.parameters
    numbers = [parameter for parameter in parameters if isinstance(parameter, Number)]
    if len(parameters) != 2 or len(numbers) != 2:
        return None
    low = np.array([number.stored(number.low) for number in numbers], np.float64)
    ranges = np.array([number.range for number in numbers], np.float64)
    comparable = numbers[0].unit == numbers[1].unit and numbers[0].log == numbers[1].log
    same = comparable and ranges.max() <= COMPARABLE * ranges.min()
    scale = np.full(2, ranges.max()) if same else ranges
    across, up = (f"{one.name} ({one.unit})" if one.unit else one.name for one in numbers)
    return Plane(
        names=(across, up), low=low, scale=scale, extent=ranges / scale, numbers=(numbers[0], numbers[1])
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Embedding:
    """The map of an archive.

    Attributes:
        points: One point per solution, in the archive's order and in units of the metric, shape ``(n, 2)``.
        explained: Share of the squared distances shown by the map, in [0, 1]; the rest is outside the plane.
    """

    points: FloatArray
    explained: float


def embedded(archive: Archive, *, exact_points: int = EXACT_POINTS, landmarks: int = LANDMARKS) -> Embedding:
    """Return the map of an archive.

    Args:
        archive: The archive.
        exact_points: Largest number of solutions for which all distances are used.
        landmarks: Number of landmarks for more solutions, >= 3.
    """
    projection = Projection.fitted(
        archive.metric, archive.vectors, exact_points=exact_points, landmarks=landmarks
    )
    return Embedding(points=projection.placed(archive.vectors), explained=projection.explained)


def _principal_axes(squared: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return the two largest eigenvalues of the doubly centred matrix, their eigenvectors, and the trace."""
    from scipy import linalg  # slow to import

    centred = -0.5 * (squared - squared.mean(axis=0) - squared.mean(axis=1)[:, None] + squared.mean())
    size = len(centred)
    values, vectors = linalg.eigh(centred, subset_by_index=(size - 2, size - 1))
    # If all points lie on a line, the second axis is mere rounding error.
    values = np.where(values > 1e-12 * max(float(values[-1]), 0.0), values, 0.0)
    return values[::-1], vectors[:, ::-1], float(np.trace(centred))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nearest:
    """The nearest neighbours of a solution, nearest first.

    Attributes:
        positions: Positions in the archive, shape ``(k,)``.
        distances: Distances to the solution, shape ``(k,)``.
    """

    positions: NDArray[np.intp]
    distances: FloatArray


def nearest_solutions(archive: Archive, position: int, count: int) -> Nearest:
    """Return the solutions nearest to a given one, excluding itself; ties are in ascending order of number.

    This computes one row of distances: a tenth of a second for 100,000 solutions.

    Args:
        archive: The evaluated solutions.
        position: Position of the solution in the archive.
        count: Maximum number of solutions to return, >= 0.
    """
    distances = archive.distances([position], np.arange(len(archive)))[0]
    others = np.flatnonzero(np.arange(len(archive)) != position)
    if 0 < count < others.size:
        farthest = np.partition(distances[others], count - 1)[count - 1]
        others = others[distances[others] <= farthest]
    order = others[np.lexsort((archive.numbers[others], distances[others]))][:count]
    return Nearest(positions=order, distances=distances[order])


def nearest_opposite(archive: Archive, position: int) -> tuple[int, float] | None:
    """Return the nearest solution with the other verdict, as its position and its distance; None if there is none.

    Args:
        archive: The evaluated solutions.
        position: Position of the solution in the archive.
    """
    others = np.flatnonzero(archive.unsafe != archive.unsafe[position])
    if not others.size:
        return None
    distances = archive.distances([position], others)[0]
    best = int(np.lexsort((archive.numbers[others], distances))[0])
    return int(others[best]), float(distances[best])

"""A map of an archive: complete solutions as points in the plane, near each other if they are alike.

Classical (Torgerson) scaling of the distances; above `EXACT_POINTS` solutions by landmarks: the map is made for
some of them, evenly spread over the archive, and all are placed by their distances to these. A map that was made once
can so take in solutions that came later, without moving those that it has.

Source: Torgerson 1952; de Silva and Tenenbaum 2004, landmark multidimensional scaling.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy.linalg

from brink.search.archive import Archive
from brink.search.component import FloatArray
from brink.search.metric import Metric

EXACT_POINTS = 2_000
LANDMARKS = 1_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projection:
    """How solutions are placed on a map.

    Attributes:
        metric: Distance between complete solutions.
        landmarks: Solutions whose distances decide where another one lies, shape ``(k, d)``.
        centre: Mean squared distance of the landmarks to each of them, shape ``(k,)``.
        scale: What a squared distance to each landmark moves along each axis, shape ``(k, 2)``.
        explained: Share of the squared distances that the map shows, in [0, 1]; the rest lies off the plane.
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
        """Return a map of solutions; each axis points to where its furthest landmark is.

        Args:
            metric: Distance between complete solutions.
            vectors: Any number of them as rows, shape ``(n, d)``.
            exact_points: Most solutions of which all distances are taken.
            landmarks: How many are mapped first where there are more, >= 3.
        """
        count = len(vectors)
        if count < 2:
            return cls(
                metric=metric, landmarks=np.empty((0, metric.dimension)),
                centre=np.empty(0), scale=np.empty((0, 2)), explained=1.0,
            )  # fmt: skip
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
        """Return where solutions lie on the map, in units of the metric.

        Args:
            vectors: Complete solutions as rows, shape ``(n, d)``.

        Returns:
            Points, shape ``(n, 2)``.
        """
        points = np.zeros((len(vectors), 2))
        if not len(self.landmarks):
            return points
        for top in range(0, len(vectors), EXACT_POINTS):
            rows = slice(top, top + EXACT_POINTS)
            squared = self.metric.between(vectors[rows], self.landmarks) ** 2
            points[rows] = -0.5 * (squared - self.centre) @ self.scale
        return points + 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Embedding:
    """A map with the solutions that it was made for.

    Attributes:
        points: One a solution, in the archive's order, shape ``(n, 2)``; distances are in units of the metric.
        explained: Share of the squared distances that the map shows, in [0, 1]; the rest lies off the plane.
    """

    points: FloatArray
    explained: float


def embedded(archive: Archive, *, exact_points: int = EXACT_POINTS, landmarks: int = LANDMARKS) -> Embedding:
    """Return the map of an archive; see `Projection.fitted`."""
    projection = Projection.fitted(
        archive.metric, archive.vectors, exact_points=exact_points, landmarks=landmarks
    )
    return Embedding(points=projection.placed(archive.vectors), explained=projection.explained)


def _principal_axes(squared: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return the two largest eigenvalues of the doubly centred matrix, their vectors, and its trace."""
    centred = -0.5 * (squared - squared.mean(axis=0) - squared.mean(axis=1)[:, None] + squared.mean())
    size = len(centred)
    values, vectors = scipy.linalg.eigh(centred, subset_by_index=(size - 2, size - 1))
    # A third point may lie on a line with the others: its axis is rounding, not extent.
    values = np.where(values > 1e-12 * max(float(values[-1]), 0.0), values, 0.0)
    return values[::-1], vectors[:, ::-1], float(np.trace(centred))

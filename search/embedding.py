"""A map of an archive: complete solutions as points in the plane, near each other if they are alike.

Classical (Torgerson) scaling of the distances; above `EXACT_POINTS` solutions by landmarks: the map is made for
some of them, evenly spread over the archive, and all are placed by their distances to these.

Source: Torgerson 1952; de Silva and Tenenbaum 2004, landmark multidimensional scaling.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from search.archive import Archive
from search.component import FloatArray

EXACT_POINTS = 2_000
LANDMARKS = 1_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Embedding:
    """A map.

    Attributes:
        points: One a solution, in the archive's order, shape ``(n, 2)``; distances are in units of the metric.
        explained: Share of the squared distances that the map shows, in [0, 1]; the rest lies off the plane.
    """

    points: FloatArray
    explained: float


def embedded(archive: Archive, *, exact_points: int = EXACT_POINTS, landmarks: int = LANDMARKS) -> Embedding:
    """Return the map of an archive; each axis points to where its furthest solution is.

    Args:
        archive: Any number of solutions.
        exact_points: Most solutions of which all distances are taken.
        landmarks: How many are mapped first where there are more, >= 3.
    """
    count = len(archive)
    if count < 2:
        return Embedding(points=np.zeros((count, 2)), explained=1.0)
    chosen = (
        np.arange(count) if count <= exact_points else np.linspace(0, count - 1, landmarks).astype(np.intp)
    )
    squared = archive.distances(chosen, chosen) ** 2
    values, vectors, total = _principal_axes(squared)
    points = np.zeros((count, 2))
    scale = np.divide(vectors, np.sqrt(values), out=np.zeros_like(vectors), where=values > 0)
    centre = squared.mean(axis=0)
    for top in range(0, count, EXACT_POINTS):
        rows = np.arange(top, min(top + EXACT_POINTS, count))
        to_landmarks = archive.distances(rows, chosen) ** 2
        points[rows] = -0.5 * (to_landmarks - centre) @ scale
    furthest = points[np.abs(points).argmax(axis=0), [0, 1]]
    points *= np.where(furthest < 0, -1.0, 1.0)
    explained = float(values.sum() / total) if total > 0 else 1.0
    return Embedding(points=points + 0.0, explained=min(explained, 1.0))


def _principal_axes(squared: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return the two largest eigenvalues of the doubly centred matrix, their vectors, and its trace."""
    centred = -0.5 * (squared - squared.mean(axis=0) - squared.mean(axis=1)[:, None] + squared.mean())
    size = len(centred)
    values, vectors = scipy.linalg.eigh(centred, subset_by_index=(size - 2, size - 1))
    # A third point may lie on a line with the others: its axis is rounding, not extent.
    values = np.where(values > 1e-12 * max(float(values[-1]), 0.0), values, 0.0)
    return values[::-1], vectors[:, ::-1], float(np.trace(centred))

"""Flat geometry of replays: outlines of road users, the shortest line between two of them, dashed lines."""

from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Points: TypeAlias = NDArray[np.float64]
"""Corners, shape ``(k, 2)``."""

TIED_M: Final = 0.02
"""Distances this close count as equal."""


def outline(x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float) -> Points:
    """Return a rectangle's corners: front left, front right, rear right, rear left, shape ``(4, 2)``."""
    return placed(
        x_m, y_m, yaw_rad, np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (length_m / 2, width_m / 2)
    )


def placed(x_m: float, y_m: float, yaw_rad: float, local: Points) -> Points:
    """Return points given ahead and to the left of a pose in world coordinates, shape ``(k, 2)``."""
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    world: Points = local @ np.array([[cosine, sine], [-sine, cosine]]) + (x_m, y_m)
    return world


def closest_points(one: Points, other: Points) -> tuple[Points, Points, float]:
    """Return the nearest points of two convex polygons and their distance.

    Where parallel edges face each other, the points are in the middle of what they share.

    Args:
        one: Corners in order, shape ``(k, 2)``.
        other: Corners in order, shape ``(l, 2)``.

    Returns:
        A point of each, shape ``(2,)``, and the distance between them; 0 if the polygons overlap.
    """
    if _overlap(one, other):
        middle = (one.mean(axis=0) + other.mean(axis=0)) / 2
        return middle, middle, 0.0
    from_one, on_other, distance = _corners_to_edges(one, other)
    from_other, on_one, back = _corners_to_edges(other, one)
    starts = np.vstack([from_one, on_one])
    ends = np.vstack([on_other, from_other])
    distances = np.concatenate([distance, back])
    least = float(distances.min())
    tied = distances <= least + TIED_M
    return starts[tied].mean(axis=0), ends[tied].mean(axis=0), least


def _corners_to_edges(corners: Points, polygon: Points) -> tuple[Points, Points, Points]:
    """Return each corner with its nearest point on each edge: points ``(k * l, 2)`` twice, distances ``(k * l,)``."""
    along = np.roll(polygon, -1, axis=0) - polygon
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    offset = corners[:, None, :] - polygon[None, :, :]
    fraction = np.clip((offset * along).sum(axis=2) / square, 0.0, 1.0)
    foot = (polygon + fraction[..., None] * along).reshape(-1, 2)
    start = np.repeat(corners, len(polygon), axis=0)
    return start, foot, np.hypot(*(start - foot).T)


def _overlap(one: Points, other: Points) -> bool:
    for polygon in (one, other):
        edges = np.roll(polygon, -1, axis=0) - polygon
        for normal in np.column_stack([-edges[:, 1], edges[:, 0]]):
            a, b = one @ normal, other @ normal
            if a.max() < b.min() or b.max() < a.min():
                return False
    return True


def dashes(points: Points, dash: float, gap: float, *, closed: bool = False) -> list[Points]:
    """Cut a line into dashes of a given length, each of shape ``(2, 2)``; dashes do not run around corners."""
    corners = np.vstack([points, points[:1]]) if closed else points
    pieces: list[Points] = []
    for start, end in pairwise(corners):
        length = float(np.hypot(*(end - start)))
        if length < 1e-9:
            continue
        for at in np.arange(0.0, length, dash + gap):
            ends = np.array([at, min(at + dash, length)]) / length
            pieces.append(start + ends[:, None] * (end - start))
    return pieces

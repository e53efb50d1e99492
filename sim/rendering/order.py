"""Owns the painter's order: what must be painted before what, from planes that separate bodies.

If a plane separates two bodies, the one on the camera's side can never be hidden by the other. So a body is painted
before another exactly if the other may hide it: no plane says that it cannot. Upright planes through the edges of the
footprints and level planes between heights are tried; if two planes disagree, neither body hides the other and
nothing is demanded. Bodies that no plane separates overlap: then the one whose centre is nearer is painted later.
"""

import heapq

import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.scene import FloatArray

_SLACK_M = 0.03


def paint_order(
    corners_m: FloatArray,
    heights_m: FloatArray,
    columns_px: FloatArray,
    eye_m: tuple[float, float, float],
) -> list[int]:
    """Return the order in which bodies are painted, first to last.

    Args:
        corners_m: Footprints, convex and counter-clockwise, shape ``(n, 4, 2)``.
        heights_m: Bottom and top of each, shape ``(n, 2)``.
        columns_px: First and last column of the picture that each may touch, shape ``(n, 2)``.
        eye_m: The camera's place.

    Returns:
        Indices; ties go to the farther, then to the lower index.
    """
    count = len(corners_m)
    if count < 2:
        return list(range(count))
    distance = np.hypot(*(corners_m.mean(axis=1) - eye_m[:2]).T)
    hides = _may_hide(corners_m, heights_m, columns_px, eye_m)
    both = hides & hides.T
    nearer = (distance[:, None] < distance[None, :]) | (
        (distance[:, None] == distance[None, :]) & (np.arange(count)[:, None] > np.arange(count)[None, :])
    )
    hides &= ~both | nearer
    return _sorted(hides, distance.tolist())


def _may_hide(
    corners_m: FloatArray, heights_m: FloatArray, columns_px: FloatArray, eye_m: tuple[float, float, float]
) -> NDArray[np.bool_]:
    """Return whether a may hide b, shape ``(a, b)``."""
    count = len(corners_m)
    edges = np.roll(corners_m, -1, axis=1) - corners_m
    normals = np.stack((edges[..., 1], -edges[..., 0]), axis=-1)
    normals /= np.maximum(np.hypot(normals[..., 0], normals[..., 1]), 1e-9)[..., None]
    offsets = np.einsum("aek,aek->ae", normals, corners_m)
    # Written out: a threaded matrix product costs more than it saves at these sizes.
    x_m, y_m = corners_m[..., 0], corners_m[..., 1]
    normal_x, normal_y = normals[..., 0][..., None], normals[..., 1][..., None]
    nearest = normal_x * x_m[:, 0] + normal_y * y_m[:, 0]
    for corner in (1, 2, 3):
        np.minimum(nearest, normal_x * x_m[:, corner] + normal_y * y_m[:, corner], out=nearest)
    nearest -= offsets[:, :, None]
    apart = nearest >= -_SLACK_M
    eye_outside = normals[..., 0] * eye_m[0] + normals[..., 1] * eye_m[1] > offsets
    hides = np.ones((count, count), dtype=bool)
    hides &= ~(apart & eye_outside[:, :, None]).any(axis=1)
    hides &= ~(apart & ~eye_outside[:, :, None]).any(axis=1).T
    below = heights_m[:, 1][:, None] <= heights_m[:, 0][None, :] + _SLACK_M
    hides &= ~(below & (eye_m[2] >= heights_m[:, 1])[:, None])
    hides &= ~(below & (eye_m[2] <= heights_m[:, 0])[None, :]).T
    hides &= columns_px[:, 0][:, None] <= columns_px[:, 1][None, :]
    hides &= columns_px[:, 0][None, :] <= columns_px[:, 1][:, None]
    np.fill_diagonal(hides, False)
    return hides


def _sorted(hides: NDArray[np.bool_], distance: list[float]) -> list[int]:
    """Sort topologically, hidden before hiding; a ring is broken at its farthest member."""
    count = len(distance)
    waits = hides.sum(axis=1).tolist()
    behind: list[list[int]] = [[] for _ in range(count)]
    for hiding, hidden in zip(*(axis.tolist() for axis in np.nonzero(hides)), strict=True):
        behind[hidden].append(hiding)
    ready = [(-distance[i], i) for i in range(count) if waits[i] == 0]
    heapq.heapify(ready)
    done = [False] * count
    order: list[int] = []
    while len(order) < count:
        if ready:
            index = heapq.heappop(ready)[1]
        else:
            index = min((i for i in range(count) if not done[i]), key=lambda i: (-distance[i], i))
        if done[index]:
            continue
        done[index] = True
        order.append(index)
        for hiding in behind[index]:
            waits[hiding] -= 1
            if waits[hiding] == 0 and not done[hiding]:
                heapq.heappush(ready, (-distance[hiding], hiding))
    return order

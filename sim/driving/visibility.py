"""Visible shares: how much of a body's silhouette in the image is not hidden by what stands in between.

Bodies are upright prisms on level ground. A point of the ground at depth ``d`` and ``l`` metres to the left of the
optical axis appears in direction ``u = l / d``; ``w = 1 / d`` says how near it is. Straight edges stay straight in
(u, w). In a column of the image, a body covers everything that is farther away and lower than its own top. The share
is summed over columns, so it is exact up to the width of a column.
"""

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.plane import Rectangle

COLUMNS: Final = 16
"""Columns in which a body that something may hide is compared with what stands in between."""

_MIDDLES: Final = (np.arange(COLUMNS) + 0.5) / COLUMNS
_AROUND: Final = np.array([[0], [1], [2], [3], [0]])
"""The corners, back to the first one."""

FloatArray: TypeAlias = NDArray[np.float64]


class Screens:
    """Prisms that never move and hide others, prepared once.

    Args:
        footprints: Their footprints.
        heights_m: Their heights.
    """

    def __init__(self, footprints: Sequence[Rectangle], heights_m: Sequence[float]) -> None:
        corners = np.array([footprint.corners() for footprint in footprints], np.float64).reshape(-1, 4, 2)
        self._x_m, self._y_m = np.ascontiguousarray(corners.T)
        self.heights_m = np.array(heights_m, np.float64)

    def seen_from(self, x_m: float, y_m: float, yaw_rad: float) -> tuple[FloatArray, FloatArray]:
        """Return the depths of all corners and how far left they are of the optical axis, each of shape ``(4, n)``.

        Args:
            x_m: The camera.
            y_m: The camera.
            yaw_rad: Its heading.
        """
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        dx, dy = self._x_m - x_m, self._y_m - y_m
        return dx * cos_yaw + dy * sin_yaw, dy * cos_yaw - dx * sin_yaw


class Silhouettes:
    """Prisms as a camera sees them.

    Args:
        depths_m: Depths of their corners, in order around the footprint, shape ``(4, n)``.
        lefts_m: How far their corners are to the left of the optical axis, shape ``(4, n)``.
        heights_m: Their heights, shape ``(n,)``.
        camera_m: Height of the camera above the ground.
        near_m: Corners that are nearer, or behind the camera, count as this near.
    """

    def __init__(
        self,
        depths_m: FloatArray,
        lefts_m: FloatArray,
        heights_m: FloatArray,
        *,
        camera_m: float,
        near_m: float,
    ) -> None:
        self._w = w = 1.0 / np.maximum(depths_m, near_m)
        self._u = u = lefts_m * w
        self._right, self._left = u.min(axis=0), u.max(axis=0)
        self._nearest, self._farthest = w.max(axis=0), w.min(axis=0)
        self._nearest[self._farthest >= 1.0 / near_m] = 0.0
        self._rise_m = heights_m - camera_m
        self._camera_m = camera_m

    def visible_shares(self, right: FloatArray, left: FloatArray, half_tan: float) -> list[float]:
        """Return the visible shares of the first prisms, in [0, 1].

        Args:
            right: The smallest u of each in the image, shape ``(m,)``.
            left: The largest u of each in the image, shape ``(m,)``.
            half_tan: Tangent of half the vertical field of view; what lies above or below the image does not count.
        """
        shares = [1.0] * len(right)
        right, left = right[:, None], left[:, None]
        farthest = self._farthest[: len(right), None]
        between = (self._left > right) & (self._right < left) & (self._nearest > farthest)
        bodies, others = between.nonzero()
        hidden: list[int] = []
        pairs: list[tuple[int, int, int]] = []
        starts: list[int] = []
        # There are about ten pairs: lists are faster than arrays.
        for body, other in zip(bodies.tolist(), others.tolist(), strict=True):
            if body != other:
                if not hidden or hidden[-1] != body:
                    hidden.append(body)
                    starts.append(len(pairs))
                pairs.append((body, other, len(hidden) - 1))
        if not pairs:
            return shares
        count = len(hidden)
        whose, prisms, rows = np.array([(body, body, row) for row, body in enumerate(hidden)] + pairs).T
        columns = right + (left - right) * _MIDDLES
        near, top = self._sides(prisms, columns.take(whose, axis=0))
        own, own_top = near[:count], np.maximum(top[:count], -half_tan)
        bottom = np.minimum(self._camera_m * own, half_tan)
        limit = np.where(near[count:] > own.take(rows[count:], axis=0), top[count:], np.inf)
        shown = np.maximum(np.minimum(np.minimum.reduceat(limit, starts), bottom) - own_top, 0.0)
        sums = shown.sum(axis=1).tolist(), (bottom - own_top).sum(axis=1).tolist()
        for body, visible, whole in zip(hidden, *sums, strict=True):
            shares[body] = visible / max(whole, 1e-12)
        return shares

    def _sides(self, prisms: NDArray[np.intp], columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how near prisms are in columns of the image, and their upper edges.

        Args:
            prisms: Numbers of the prisms, shape ``(k,)``.
            columns: Values of u, shape ``(k, COLUMNS)``.

        Returns:
            The largest w of each in each column, minus infinity where it is not; and the upper edge as a tangent
            below the optical axis: the front edge of a roof above the camera, the back edge of a roof below it.
        """
        u, w = self._u[_AROUND, prisms], self._w[_AROUND, prisms]
        width = u[1:] - u[:-1]
        slope = (w[1:] - w[:-1]) / np.where(width == 0.0, np.inf, width)
        along = columns - u[:, :, None]
        inside = along[:-1] * along[1:] <= 0.0
        at = w[:-1, :, None] + along[:-1] * slope[:, :, None]
        near = np.where(inside, at, -np.inf).max(axis=0)
        far = np.where(inside, at, np.inf).min(axis=0)
        rise_m = self._rise_m[prisms, None]
        return near, -rise_m * np.where(rise_m > 0.0, near, far)

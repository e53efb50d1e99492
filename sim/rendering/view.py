"""Owns the perspective: world to camera, camera to pixels, and the cut at the near plane.

Camera coordinates are (depth along the axis, left, up). Pixel centres have whole coordinates, as OpenCV has it, so
that the left edge of the picture is at -0.5. Polygons go to OpenCV as whole sixteenths of a pixel.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.scene import FloatArray, PictureCamera, Viewpoint

NEAR_M = 0.12
SHIFT = 4
_SUBPIXELS = float(1 << SHIFT)
_REACH_PX = 60000.0

IntArray = NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A camera at a place."""

    width_px: int
    height_px: int
    focal_px: float
    x_m: float
    y_m: float
    height_m: float
    yaw_rad: float
    cos_yaw: float
    sin_yaw: float
    cos_pitch: float
    sin_pitch: float

    @property
    def horizon_px(self) -> float:
        """Row of the horizon, measured from the top edge."""
        return self.height_px / 2 + self.focal_px * self.sin_pitch / self.cos_pitch

    def to_camera(self, points_m: FloatArray) -> FloatArray:
        """Return world points, shape ``(n, 3)``, as (depth, left, up) in m, shape ``(n, 3)``."""
        dx, dy = points_m[:, 0] - self.x_m, points_m[:, 1] - self.y_m
        ahead = dx * self.cos_yaw + dy * self.sin_yaw
        left = dy * self.cos_yaw - dx * self.sin_yaw
        return self.pitched(ahead, left, points_m[:, 2] - self.height_m)

    def place(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
        """Return one world point as (depth, left, up) in m."""
        dx, dy = x_m - self.x_m, y_m - self.y_m
        ahead = dx * self.cos_yaw + dy * self.sin_yaw
        up = z_m - self.height_m
        return (
            ahead * self.cos_pitch + up * self.sin_pitch,
            dy * self.cos_yaw - dx * self.sin_yaw,
            up * self.cos_pitch - ahead * self.sin_pitch,
        )

    def ground_to_camera(self, points_m: FloatArray) -> FloatArray:
        """Return points of the ground, shape ``(n, 2)``, as (depth, left, up) in m, shape ``(n, 3)``."""
        dx, dy = points_m[:, 0] - self.x_m, points_m[:, 1] - self.y_m
        ahead = dx * self.cos_yaw + dy * self.sin_yaw
        left = dy * self.cos_yaw - dx * self.sin_yaw
        return self.pitched(ahead, left, np.full(len(points_m), -self.height_m))

    def pitched(self, ahead: FloatArray, left: FloatArray, up: FloatArray) -> FloatArray:
        """Return level camera coordinates in the frame of the pitched camera, shape ``(n, 3)``."""
        seen = np.empty((len(ahead), 3))
        seen[:, 1] = left
        if self.sin_pitch == 0.0:
            seen[:, 0], seen[:, 2] = ahead, up
        else:
            seen[:, 0] = ahead * self.cos_pitch + up * self.sin_pitch
            seen[:, 2] = up * self.cos_pitch - ahead * self.sin_pitch
        return seen

    def pixels(self, seen: FloatArray) -> FloatArray:
        """Return camera coordinates as pixels, shape ``(n, 2)``; depths below the near plane count as it."""
        scale = self.focal_px / np.maximum(seen[:, 0], NEAR_M)
        out = np.empty((len(seen), 2))
        out[:, 0] = self.width_px / 2 - 0.5 - seen[:, 1] * scale
        out[:, 1] = self.height_px / 2 - 0.5 - seen[:, 2] * scale
        return out

    def polygon(self, seen: FloatArray) -> IntArray:
        """Return the part of a polygon before the near plane, in sixteenths of a pixel, shape ``(k, 2)``."""
        return fixed_point(self.pixels(beyond_near(seen)))


def view_from(camera: PictureCamera, viewpoint: Viewpoint) -> View:
    """Return the view of a camera that an ego carries."""
    cos_yaw, sin_yaw = math.cos(viewpoint.yaw_rad), math.sin(viewpoint.yaw_rad)
    return View(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=camera.focal_px,
        x_m=viewpoint.x_m + camera.forward_m * cos_yaw,
        y_m=viewpoint.y_m + camera.forward_m * sin_yaw,
        height_m=camera.height_m,
        yaw_rad=viewpoint.yaw_rad,
        cos_yaw=cos_yaw,
        sin_yaw=sin_yaw,
        cos_pitch=math.cos(viewpoint.pitch_rad),
        sin_pitch=math.sin(viewpoint.pitch_rad),
    )


def fixed_point(pixels: FloatArray) -> IntArray:
    """Return pixels in whole sixteenths, as OpenCV takes them."""
    bounded = np.clip(pixels, -_REACH_PX, _REACH_PX)
    whole: IntArray = np.rint(bounded * _SUBPIXELS).astype(np.int32)
    return whole


def beyond_near(seen: FloatArray, near_m: float = NEAR_M) -> FloatArray:
    """Return the part of a polygon of camera coordinates, shape ``(k, 3)``, beyond the near plane.

    A polygon that is not convex may come back with edges that run along the plane and back: filling ignores them.
    """
    inside = seen[:, 0] >= near_m
    if inside.all():
        return seen
    if not inside.any():
        return seen[:0]
    following = np.roll(seen, -1, axis=0)
    crossing = inside != np.roll(inside, -1)
    step = np.where(crossing, following[:, 0] - seen[:, 0], 1.0)
    share = (near_m - seen[:, 0]) / step
    cut = seen + share[:, None] * (following - seen)
    both = np.stack((seen, cut), axis=1).reshape(-1, 3)
    kept: FloatArray = both[np.stack((inside, crossing), axis=1).ravel()]
    return kept

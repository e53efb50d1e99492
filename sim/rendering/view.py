"""Perspective projection: from world to camera to pixels, with clipping at the near plane.

Camera coordinates are (depth along the axis, left, up) in m. Pixel centres have integer coordinates, as in OpenCV, so
the left edge of the image is at -0.5. OpenCV receives polygons in integer sixteenths of a pixel.
"""

import math
from dataclasses import dataclass

import numpy as np

from brink.sim.rendering.scene import FloatArray, IntArray, PictureCamera, Viewpoint

NEAR_M = 0.12
SHIFT = 4
_SUBPIXELS = float(1 << SHIFT)
_REACH_PX = 60000.0
PITCHES_KEPT = 24
"""Pitches whose tables a renderer keeps; each is worked out from the pitch alone, and the oldest is dropped first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A camera at a fixed pose."""

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
    def pitch_rad(self) -> float:
        """Pitch of the camera, positive if it looks up."""
        return math.atan2(self.sin_pitch, self.cos_pitch)

    @property
    def horizon_px(self) -> float:
        """Row of the horizon, measured from the top edge."""
        return self.height_px / 2 + self.focal_px * self.sin_pitch / self.cos_pitch

    def to_camera(self, points_m: FloatArray) -> FloatArray:
        """Convert world points, shape ``(n, 3)``, to camera coordinates, shape ``(n, 3)``."""
        dx, dy = points_m[:, 0] - self.x_m, points_m[:, 1] - self.y_m
        ahead = dx * self.cos_yaw + dy * self.sin_yaw
        left = dy * self.cos_yaw - dx * self.sin_yaw
        return self.apply_pitch(ahead, left, points_m[:, 2] - self.height_m)

    def point_to_camera(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
        """Convert one world point to camera coordinates.

        Args:
            x_m: World position.
            y_m: World position.
            z_m: Height above the ground.
        """
        dx, dy = x_m - self.x_m, y_m - self.y_m
        ahead = dx * self.cos_yaw + dy * self.sin_yaw
        up = z_m - self.height_m
        return (
            ahead * self.cos_pitch + up * self.sin_pitch,
            dy * self.cos_yaw - dx * self.sin_yaw,
            up * self.cos_pitch - ahead * self.sin_pitch,
        )

    def ground_to_camera(self, points_m: FloatArray) -> FloatArray:
        """Convert points on the ground, shape ``(n, 2)``, to camera coordinates, shape ``(n, 3)``."""
        dx, dy = points_m[:, 0] - self.x_m, points_m[:, 1] - self.y_m
        ahead = dx * self.cos_yaw + dy * self.sin_yaw
        left = dy * self.cos_yaw - dx * self.sin_yaw
        return self.apply_pitch(ahead, left, np.full(len(points_m), -self.height_m))

    def apply_pitch(self, ahead: FloatArray, left: FloatArray, up: FloatArray) -> FloatArray:
        """Rotate coordinates of a level camera into the pitched camera.

        Args:
            ahead: Shape ``(n,)``.
            left: Shape ``(n,)``.
            up: Shape ``(n,)``.

        Returns:
            Camera coordinates, shape ``(n, 3)``.
        """
        seen = np.empty((len(ahead), 3))
        seen[:, 1] = left
        if self.sin_pitch == 0.0:
            seen[:, 0], seen[:, 2] = ahead, up
        else:
            seen[:, 0] = ahead * self.cos_pitch + up * self.sin_pitch
            seen[:, 2] = up * self.cos_pitch - ahead * self.sin_pitch
        return seen

    def project(self, points_m: FloatArray) -> FloatArray:
        """Project camera coordinates to pixels; depths nearer than the near plane are clamped to it."""
        scale = self.focal_px / np.maximum(points_m[:, 0], NEAR_M)
        out = np.empty((len(points_m), 2))
        out[:, 0] = self.width_px / 2 - 0.5 - points_m[:, 1] * scale
        out[:, 1] = self.height_px / 2 - 0.5 - points_m[:, 2] * scale
        return out

    def project_polygon(self, points_m: FloatArray) -> IntArray:
        """Clip a polygon in camera coordinates and project it to fixed point, shape ``(k, 2)``."""
        return to_fixed_point(self.project(clip_near(points_m)))


def make_view(camera: PictureCamera, viewpoint: Viewpoint) -> View:
    """Return the view of a camera mounted on an ego."""
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


def to_fixed_point(pixels: FloatArray) -> IntArray:
    """Convert pixels to integer sixteenths of a pixel."""
    bounded = np.clip(pixels, -_REACH_PX, _REACH_PX)
    whole: IntArray = np.rint(bounded * _SUBPIXELS).astype(np.int32)
    return whole


def clip_near(points_m: FloatArray, near_m: float = NEAR_M) -> FloatArray:
    """Clip a polygon at the near plane and return the part beyond it.

    A concave polygon may come back with edges that run back and forth along the plane; filling ignores them.

    Args:
        points_m: Polygon in camera coordinates, shape ``(k, 3)``.
        near_m: Depth of the near plane.
    """
    # Plain numbers, because most polygons have few corners and arrays that small cost more to handle.
    corners: list[list[float]] = points_m.tolist()
    if all(corner[0] >= near_m for corner in corners):
        return points_m
    kept: list[tuple[float, float, float]] = []
    for (depth, left, up), (depth_2, left_2, up_2) in zip(corners, [*corners[1:], *corners[:1]], strict=True):
        if depth >= near_m:
            kept.append((depth, left, up))
        if (depth >= near_m) != (depth_2 >= near_m):
            share = (near_m - depth) / (depth_2 - depth)
            kept.append(
                (depth + share * (depth_2 - depth), left + share * (left_2 - left), up + share * (up_2 - up))
            )
    return np.array(kept).reshape(-1, 3)

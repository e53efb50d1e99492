"""The pinhole camera: bodies to image boxes, and image rows back to the ground.

The image is 800 x 600 with a horizontal field of view of 90 degrees, so the focal length is 400 px in both axes and
the horizon is row 300. The camera sits 1.7 m above the ground and 1.3 m ahead of the ego's centre (behind the
windscreen), and looks along the ego's yaw without pitch or roll. The nearest visible ground is therefore 400 * 1.7 /
300 = 2.27 m ahead of the camera, which is 1.32 m ahead of the bumper of a 4.5 m car.

A body is an upright prism over an oriented rectangle. Its box is exact: the footprint is clipped by the near plane
and by the sides of the field of view before it is projected. So the bottom edge of a box is always the *nearest
visible* ground point of the body. A body is hidden if one nearer box covers most of its box: cheap to compute, and
right for the cases that matter (a person or a car behind a van).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.plane import Rectangle


class Solid(NamedTuple):
    """An upright prism that stands on the ground; `x_m`, `y_m` are the centre of its footprint."""

    label: ObstacleLabel
    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float


class Sighting(NamedTuple):
    """A visible body: its index in the list of bodies, its box, and the depth of its nearest point."""

    body: int
    box: Box
    depth_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """The ego's camera.

    Attributes:
        width_px: Image width.
        height_px: Image height.
        fov_deg: Horizontal field of view, in (0, 180).
        height_m: Height of the camera above the ground, > 0.
        forward_m: Distance of the camera ahead of the ego's centre.
        near_m: Depth of the near plane; nothing closer is projected.
        far_m: Bodies whose nearest point is farther away are not visible.
        min_width_px: Bodies with narrower boxes are not visible.
        min_height_px: Bodies with lower boxes are not visible.
        hidden_fraction: A box is hidden if a nearer one covers at least this share of it.
        focal_px: Focal length, derived.
        centre_x_px: Column of the optical axis, derived.
        horizon_px: Row of the horizon, derived.
    """

    width_px: int = 800
    height_px: int = 600
    fov_deg: float = 90.0
    height_m: float = 1.7
    forward_m: float = 1.3
    near_m: float = 0.2
    far_m: float = 110.0
    min_width_px: float = 3.0
    min_height_px: float = 6.0
    hidden_fraction: float = 0.75
    focal_px: float = field(init=False)
    centre_x_px: float = field(init=False)
    horizon_px: float = field(init=False)

    def __post_init__(self) -> None:
        if not 0 < self.fov_deg < 180:
            raise ValueError(f"fov_deg: expected an angle in (0, 180), got {self.fov_deg!r}")
        if self.height_m <= 0 or self.near_m <= 0:
            raise ValueError("height_m and near_m: expected positive lengths")
        object.__setattr__(self, "focal_px", self.width_px / 2 / math.tan(math.radians(self.fov_deg) / 2))
        object.__setattr__(self, "centre_x_px", self.width_px / 2)
        object.__setattr__(self, "horizon_px", self.height_px / 2)

    def ground_depth_m(self, y_px: float) -> float | None:
        """Return the depth along the optical axis of the ground in row `y_px`; None at and above the horizon."""
        below_px = y_px - self.horizon_px
        if below_px <= 0:
            return None
        return self.focal_px * self.height_m / below_px

    def left_m(self, x_px: float, depth_m: float) -> float:
        """Return how far left of the optical axis a point at a depth lies if it appears in column `x_px`."""
        return (self.centre_x_px - x_px) * depth_m / self.focal_px

    def project(self, x_m: float, y_m: float, yaw_rad: float, body: Solid) -> tuple[Box, float] | None:
        """Return the image box of a body and the depth of its nearest visible point.

        Args:
            x_m: The ego's centre.
            y_m: The ego's centre.
            yaw_rad: The ego's yaw.
            body: The body to project.

        Returns:
            None if the body is outside the image or too small in it.
        """
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        dx, dy = body.x_m - x_m, body.y_m - y_m
        depth = dx * cos_yaw + dy * sin_yaw - self.forward_m
        left = dy * cos_yaw - dx * sin_yaw
        reach = body.length_m + body.width_m
        half_tan = self.centre_x_px / self.focal_px
        if (
            depth < -reach
            or depth > self.far_m + reach
            or abs(left) > half_tan * depth + reach * (1 + half_tan)
        ):
            return None
        turn_rad = body.yaw_rad - yaw_rad
        footprint = Rectangle(depth, left, turn_rad, 0.5 * body.length_m, 0.5 * body.width_m).corners()
        near = self.near_m
        for corner_depth, corner_left in footprint:
            if corner_depth < near or abs(corner_left) > half_tan * corner_depth:
                footprint = _clipped(footprint, near, half_tan)
                break
        return self._box(footprint, body) if footprint else None

    def _box(self, footprint: Sequence[tuple[float, float]], body: Solid) -> tuple[Box, float] | None:
        focal, centre_x = self.focal_px, self.centre_x_px
        depths = [depth for depth, _ in footprint]
        nearest, farthest = min(depths), max(depths)
        if nearest > self.far_m:
            return None
        columns = [centre_x - focal * left / depth for depth, left in footprint]
        x_min, x_max = max(0.0, min(columns)), min(float(self.width_px), max(columns))
        # The top edge is highest where it is nearest if it is above the camera, else where it is farthest.
        top_m = self.height_m - body.height_m
        y_min = max(0.0, self.horizon_px + focal * top_m / (nearest if top_m < 0 else farthest))
        y_max = min(float(self.height_px), self.horizon_px + focal * self.height_m / nearest)
        if x_max - x_min < self.min_width_px or y_max - y_min < self.min_height_px:
            return None
        return Box(label=body.label, x_min_px=x_min, x_max_px=x_max, y_min_px=y_min, y_max_px=y_max), nearest

    def look(self, x_m: float, y_m: float, yaw_rad: float, bodies: Iterable[Solid]) -> list[Sighting]:
        """Return what a perfect detector sees, nearest first: bodies in the image, large enough and not hidden.

        Args:
            x_m: The ego's centre.
            y_m: The ego's centre.
            yaw_rad: The ego's yaw.
            bodies: All bodies around the ego, without the ego.
        """
        sights = []
        for index, body in enumerate(bodies):
            seen = self.project(x_m, y_m, yaw_rad, body)
            if seen is not None:
                sights.append(Sighting(body=index, box=seen[0], depth_m=seen[1]))
        sights.sort(key=_by_depth)
        visible: list[Sighting] = []
        for sight in sights:
            _, x_min, x_max, y_min, y_max = sight.box
            needed = self.hidden_fraction * (x_max - x_min) * (y_max - y_min)
            for nearer in visible:
                _, left, right, top, bottom = nearer.box
                wide = (x_max if x_max < right else right) - (x_min if x_min > left else left)
                if wide > 0:
                    high = (y_max if y_max < bottom else bottom) - (y_min if y_min > top else top)
                    if high > 0 and wide * high >= needed:
                        break
            else:
                visible.append(sight)
        return visible


def _by_depth(sight: Sighting) -> tuple[float, int]:
    return sight.depth_m, sight.body


def _clipped(polygon: list[tuple[float, float]], near: float, half_tan: float) -> list[tuple[float, float]]:
    """Clip a convex polygon to the near plane and the field of view (Sutherland-Hodgman)."""
    # Each half plane is depth * a + left * b + c >= 0.
    for a, b, c in ((1.0, 0.0, -near), (half_tan, -1.0, 0.0), (half_tan, 1.0, 0.0)):
        kept: list[tuple[float, float]] = []
        if not polygon:
            break
        before = polygon[-1]
        inside_before = before[0] * a + before[1] * b + c
        for corner in polygon:
            inside = corner[0] * a + corner[1] * b + c
            if (inside >= 0) != (inside_before >= 0):
                share = inside_before / (inside_before - inside)
                kept.append(
                    (before[0] + share * (corner[0] - before[0]), before[1] + share * (corner[1] - before[1]))
                )
            if inside >= 0:
                kept.append(corner)
            before, inside_before = corner, inside
        polygon = kept
    return polygon

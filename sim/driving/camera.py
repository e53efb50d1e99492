"""The pinhole camera: bodies to image boxes, and image rows back to the ground.

The image is 800 x 600 with a horizontal field of view of 90 degrees, so the focal length is 400 px in both axes and
the horizon is row 300. The camera sits 1.7 m above the ground and 1.3 m ahead of the ego's centre (behind the
windscreen), looks along the ego's yaw, and pitches with its body. Level, the nearest visible ground is therefore
400 * 1.7 / 300 = 2.27 m ahead of the camera, which is 1.32 m ahead of the bumper of a 4.5 m car.

A body is an upright prism over an oriented rectangle. Its box is exact: the footprint is clipped by the near plane
and by the sides of the field of view before it is projected. So the bottom edge of a box is always the *nearest*
ground point of the body in view. A body is hidden if less than a set share of its silhouette is visible: everything
that stands in between counts, road users as well as buildings, parked cars and trees
(`brink.sim.driving.visibility`). The box of a body that is partly hidden is that of the whole body.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.driving.visibility import Screens, Silhouettes

LEAST_VISIBLE: Final = 0.25
"""Of road users that count as visible, at least this share is."""


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
    """A body in the image.

    Attributes:
        body: Its index in the list of bodies.
        box: Its box, including what is hidden.
        depth_m: Depth of its nearest point.
        visible: Visible share of its silhouette.
    """

    body: int
    box: Box
    depth_m: float
    visible: float


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
        least_visible: Bodies of which a smaller share is visible are hidden.
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
    least_visible: float = LEAST_VISIBLE
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
        """Return the image box of a body and the depth of its nearest point in view, whatever stands in between.

        Args:
            x_m: The ego's centre.
            y_m: The ego's centre.
            yaw_rad: The ego's yaw.
            body: The body to project.

        Returns:
            None if the body is outside the image or too small in it.
        """
        footprint = self._footprint((x_m, y_m, yaw_rad, math.cos(yaw_rad), math.sin(yaw_rad)), body)
        return self._box(footprint, body) if footprint else None

    def _footprint(
        self, pose: tuple[float, float, float, float, float], body: Solid
    ) -> tuple[float, ...] | None:
        """Return the corners of a body's footprint: the depth of each, then the left of each.

        Args:
            pose: The ego's x, y and yaw, and the cosine and sine of its yaw.
            body: The body.

        Returns:
            None if it is clearly out of view.
        """
        x_m, y_m, yaw_rad, cos_yaw, sin_yaw = pose
        _, body_x_m, body_y_m, body_yaw_rad, length_m, width_m, _ = body
        dx, dy = body_x_m - x_m, body_y_m - y_m
        depth = dx * cos_yaw + dy * sin_yaw - self.forward_m
        left = dy * cos_yaw - dx * sin_yaw
        reach = length_m + width_m
        half_tan = self.centre_x_px / self.focal_px
        if (
            depth < -reach
            or depth > self.far_m + reach
            or abs(left) > half_tan * depth + reach * (1 + half_tan)
        ):
            return None
        # The corners of a Rectangle; a call and an object for each body would take a quarter of the time.
        turn_rad = body_yaw_rad - yaw_rad
        cos_turn, sin_turn = math.cos(turn_rad), math.sin(turn_rad)
        half_length_m, half_width_m = 0.5 * length_m, 0.5 * width_m
        along_x, along_y = half_length_m * cos_turn, half_length_m * sin_turn
        left_x, left_y = -half_width_m * sin_turn, half_width_m * cos_turn
        return (
            depth + along_x + left_x,
            depth + along_x - left_x,
            depth - along_x - left_x,
            depth - along_x + left_x,
            left + along_y + left_y,
            left + along_y - left_y,
            left - along_y - left_y,
            left - along_y + left_y,
        )

    def _box(self, footprint: tuple[float, ...], body: Solid) -> tuple[Box, float] | None:
        """Return the box of a footprint's part in view, and the depth of its nearest point."""
        d1, d2, d3, d4, l1, l2, l3, l4 = footprint
        focal, centre_x, near = self.focal_px, self.centre_x_px, self.near_m
        half_tan = centre_x / focal
        nearest, farthest = min(d1, d2, d3, d4), max(d1, d2, d3, d4)
        if (
            nearest >= near
            and abs(l1) <= half_tan * d1
            and abs(l2) <= half_tan * d2
            and abs(l3) <= half_tan * d3
            and abs(l4) <= half_tan * d4
        ):
            lefts_px = [focal * l1 / d1, focal * l2 / d2, focal * l3 / d3, focal * l4 / d4]
        else:
            polygon = _clipped([(d1, l1), (d2, l2), (d3, l3), (d4, l4)], near, half_tan)
            if not polygon:
                return None
            depths = [depth for depth, _ in polygon]
            nearest, farthest = min(depths), max(depths)
            lefts_px = [focal * left / depth for depth, left in polygon]
        if nearest > self.far_m:
            return None
        x_min, x_max = max(0.0, centre_x - max(lefts_px)), min(float(self.width_px), centre_x - min(lefts_px))
        # The top edge is highest where it is nearest if it is above the camera, else where it is farthest.
        top_m = self.height_m - body.height_m
        top, bottom = top_m / (nearest if top_m < 0 else farthest), self.height_m / nearest
        y_min = max(0.0, self.horizon_px + focal * top)
        y_max = min(float(self.height_px), self.horizon_px + focal * bottom)
        if x_max - x_min < self.min_width_px or y_max - y_min < self.min_height_px:
            return None
        return Box(body.label, x_min, x_max, y_min, y_max), nearest

    def tilted(self, box: Box, pitch_rad: float) -> Box | None:
        """Return where a box of a level camera is in the image of a pitched one; None if hardly any is left in it.

        Pitch moves rows, and hardly anything else: columns stay to within 1% at the image's lower corners.

        Args:
            box: The box.
            pitch_rad: The camera's pitch, negative if it looks down; the opposite leads back to the level camera.
        """
        if pitch_rad == 0.0:
            return box
        label, x_min, x_max, y_min, y_max = box
        horizon, focal, tan_pitch = self.horizon_px, self.focal_px, math.tan(pitch_rad)
        top, bottom = (y_min - horizon) / focal, (y_max - horizon) / focal
        y_min = max(0.0, horizon + focal * ((top + tan_pitch) / (1.0 - top * tan_pitch)))
        y_max = min(
            float(self.height_px), horizon + focal * ((bottom + tan_pitch) / (1.0 - bottom * tan_pitch))
        )
        if y_max - y_min < self.min_height_px:
            return None
        return Box(label, x_min, x_max, y_min, y_max)

    def all_tilted(self, boxes: Iterable[Box], pitch_rad: float) -> tuple[Box, ...]:
        """Return those of some boxes that are in the image of a pitched camera; see `tilted`."""
        return tuple(box for level in boxes if (box := self.tilted(level, pitch_rad)) is not None)

    def look(
        self, x_m: float, y_m: float, yaw_rad: float, bodies: Iterable[Solid], screens: Screens | None = None
    ) -> list[Sighting]:
        """Return what a perfect detector sees, nearest first: bodies in the image, large enough and not hidden.

        Args:
            x_m: The ego's centre.
            y_m: The ego's centre.
            yaw_rad: The ego's yaw.
            bodies: All bodies around the ego that are detected, without the ego. They hide each other.
            screens: What else hides them.
        """
        sights = self.sights(x_m, y_m, yaw_rad, bodies, screens)
        return [sight for sight in sights if sight.visible >= self.least_visible]

    def sights(
        self, x_m: float, y_m: float, yaw_rad: float, bodies: Iterable[Solid], screens: Screens | None = None
    ) -> list[Sighting]:
        """Return all bodies in the image that are large enough, hidden or not, nearest first; see `look`."""
        seen: list[tuple[int, Box, float]] = []
        corners: list[float] = []
        extents: list[tuple[float, float, float]] = []
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        pose = x_m, y_m, yaw_rad, cos_yaw, sin_yaw
        focal, centre_x = self.focal_px, self.centre_x_px
        for index, body in enumerate(bodies):
            footprint = self._footprint(pose, body)
            projected = self._box(footprint, body) if footprint else None
            if footprint and projected:
                box, depth_m = projected
                seen.append((index, box, depth_m))
                corners += footprint
                extents.append(
                    (body.height_m, (centre_x - box.x_max_px) / focal, (centre_x - box.x_min_px) / focal)
                )
        if not seen:
            return []
        depths_m, lefts_m = np.array(corners).reshape(-1, 2, 4).transpose(1, 2, 0)
        heights_m, right, left = np.array(extents).T
        if screens is not None:
            more_m, aside_m = screens.seen_from(
                x_m + self.forward_m * cos_yaw, y_m + self.forward_m * sin_yaw, yaw_rad
            )
            depths_m = np.concatenate((depths_m, more_m), axis=1)
            lefts_m = np.concatenate((lefts_m, aside_m), axis=1)
            heights_m = np.concatenate((heights_m, screens.heights_m))
        silhouettes = Silhouettes(depths_m, lefts_m, heights_m, camera_m=self.height_m, near_m=self.near_m)
        shares = silhouettes.visible_shares(right, left, self.horizon_px / focal)
        sights = [
            Sighting(index, box, depth_m, share)
            for (index, box, depth_m), share in zip(seen, shares, strict=True)
        ]
        sights.sort(key=_by_depth)
        return sights


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

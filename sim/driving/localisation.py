"""Localisation: where on the ground a detected box stands, and how wide it is.

What of a box says what:

- **Bottom edge**: the distance. It is taken for the nearest ground point of the obstacle and projected back.
- **Height**: the distance of a box whose bottom edge does not reach below the horizon (or so little that it would
  be farther than `max_ground_range_m`, where a pixel is worth ten metres): such a box is placed where something of
  its label's assumed height would look that tall.
- **Left and right edges**: the lateral extent at that distance, and so whether it stands in the lane, at its edge,
  or outside. A box beside the axis that is wider than what its label stands for shows a side as well: then its
  inner edge is the far corner of that side, and the extent shrinks outwards, but never below the usual width. A
  box cut by the image's border begins beside the ego, so the border is no outer edge.
- **Label**: the assumed height, length and width.
"""

import math
from typing import NamedTuple, Protocol

from sim.driving.camera import Camera
from sim.driving.interface import Box, EgoState, ObstacleLabel
from sim.driving.settings import LocalisationSettings


class Place(NamedTuple):
    """Where a box stands.

    `x_m`, `y_m` is the middle of the side that faces the camera, `width_m` the extent of that side across the view,
    `length_m` the assumed extent away from the camera, `sigma_m` the standard deviation of the distance,
    `is_cut` whether the box may go on beyond the image's left or right border.
    """

    label: ObstacleLabel
    x_m: float
    y_m: float
    width_m: float
    length_m: float
    sigma_m: float
    is_cut: bool
    box: Box


class Localiser(Protocol):
    """Places boxes on the ground."""

    def locate(self, ego: EgoState, boxes: tuple[Box, ...]) -> list[Place]:
        """Return one place a box that can be placed, in the order of the boxes."""
        ...


class GroundPlaneLocaliser:
    """Places boxes by back-projection on flat ground."""

    __slots__ = ("_camera", "_settings")

    def __init__(self, camera: Camera, settings: LocalisationSettings) -> None:
        self._camera = camera
        self._settings = settings

    def locate(self, ego: EgoState, boxes: tuple[Box, ...]) -> list[Place]:
        """Return one place a box of positive, finite extent, in the order of the boxes."""
        if not boxes:
            return []
        settings, camera = self._settings, self._camera
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        camera_x = ego.x_m + camera.forward_m * cos_yaw
        camera_y = ego.y_m + camera.forward_m * sin_yaw
        last_px = camera.width_px - settings.border_px
        noise = settings.pixel_noise_px / (camera.focal_px * camera.height_m)
        places = []
        for box in boxes:
            depth = self.depth_m(box)
            if depth is None:
                continue
            left, right, length = self._extent(box, depth)
            middle = 0.5 * (left + right)
            places.append(
                Place(
                    box.label,
                    camera_x + depth * cos_yaw - middle * sin_yaw,
                    camera_y + depth * sin_yaw + middle * cos_yaw,
                    left - right,
                    length,
                    noise * depth * depth,
                    box.x_min_px <= settings.border_px or box.x_max_px >= last_px,
                    box,
                )
            )
        return places

    def depth_m(self, box: Box) -> float | None:
        """Return how far ahead of the camera a box begins; None if it has no extent or is no picture of anything."""
        settings, camera = self._settings, self._camera
        label, x_min, x_max, y_min, y_max = box
        height = y_max - y_min
        # Written so that a NaN fails.
        if not (height > 0 and x_max > x_min and math.isfinite(height + x_max - x_min + y_max + x_max)):
            return None
        depth = camera.ground_depth_m(y_max)
        if depth is None or depth > settings.max_ground_range_m:
            is_person = label is ObstacleLabel.PERSON
            tall = settings.person_height_m if is_person else settings.vehicle_height_m
            depth = min(camera.focal_px * tall / height, settings.max_ground_range_m)
        return max(depth, settings.min_range_m)

    def _extent(self, box: Box, depth: float) -> tuple[float, float, float]:
        """Return the left and right end of the near side, left of the camera's axis, and the length behind it."""
        settings, camera = self._settings, self._camera
        label, x_min, x_max, _, _ = box
        per_px = depth / camera.focal_px
        left = (camera.centre_x_px - x_min) * per_px
        right = (camera.centre_x_px - x_max) * per_px
        if label is ObstacleLabel.PERSON:
            typical = length = settings.person_size_m
        else:
            typical, length = settings.vehicle_width_m, settings.vehicle_length_m
        # Seen from its side, a vehicle is as deep as it is wide from behind.
        depth_behind = min(length, max(typical, length - (left - right - typical)))
        deepen = (depth + length) / depth
        border = settings.border_px
        if right > 0:
            if x_min <= border:
                right = min(right * deepen, left)
                left = max(left, right + typical)
            elif left - right > typical:
                right = max(right, min(right * deepen, left - typical))
        elif left < 0:
            if x_max >= camera.width_px - border:
                left = max(left * deepen, right)
                right = min(right, left - typical)
            elif left - right > typical:
                left = min(left, max(left * deepen, right + typical))
        return left, right, depth_behind

"""Localisation: where on the ground a detected box stands, and how wide it is.

What of a box says what:

- **Bottom edge**: the distance. It is taken for the nearest ground point of the obstacle and projected back.
- **Height**: the distance of a box whose bottom edge does not reach below the horizon (or so little that it would
  be farther than `max_ground_range_m`, where a pixel is worth ten metres): such a box is placed where something of
  its label's assumed height would look that tall.
- **Left and right edges**: the lateral place and extent at that distance, and so whether it stands in the lane, at
  its edge, or outside. A body of the label's usual size that points along the lane (the map knows it) is moved
  sideways until its picture lies as the box does; so the side that a vehicle shows is not taken for its width. What
  the box is wider or narrower than that picture, the obstacle is taken to be wider or narrower.
- **Label**: the assumed height, length and width.

A box that the image's border cuts on one side says nothing on that side: it is placed by its inner edge alone.
"""

import math
from typing import NamedTuple, Protocol

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, EgoState, ObstacleLabel, Route
from brink.sim.driving.settings import LocalisationSettings


class Place(NamedTuple):
    """Where a box stands.

    `x_m`, `y_m` is the centre of the body that it is taken for, `width_m` and `length_m` its extents across and along
    the lane, `sigma_m` the standard deviation of the distance, `is_cut` whether the box may go on beyond the image's
    left or right border.
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
    """Places boxes by back-projection on flat ground, with the map's lane directions."""

    __slots__ = ("_camera", "_route", "_settings")

    def __init__(self, route: Route, camera: Camera, settings: LocalisationSettings) -> None:
        self._route = route
        self._camera = camera
        self._settings = settings

    def locate(self, ego: EgoState, boxes: tuple[Box, ...]) -> list[Place]:
        """Return one place a box of positive, finite extent, in the order of the boxes."""
        if not boxes:
            return []
        settings, camera, route = self._settings, self._camera, self._route
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        camera_x = ego.x_m + camera.forward_m * cos_yaw
        camera_y = ego.y_m + camera.forward_m * sin_yaw
        noise = settings.pixel_noise_px / (camera.focal_px * camera.height_m)
        first_px, last_px = settings.border_px, camera.width_px - settings.border_px
        places = []
        for box in boxes:
            near = self.depth_m(box)
            if near is None:
                continue
            label, x_min, x_max, _, _ = box
            # Tangents of the directions to the box's edges, positive to the left.
            left = (camera.centre_x_px - x_min) / camera.focal_px
            right = (camera.centre_x_px - x_max) / camera.focal_px
            if label is ObstacleLabel.PERSON:
                length = width = settings.person_size_m
                turn_rad = 0.0
            else:
                length, width = settings.vehicle_length_m, settings.vehicle_width_m
                ahead, aside = near + 0.5 * length, 0.5 * (left + right) * near
                station_m, _ = route.project(
                    camera_x + ahead * cos_yaw - aside * sin_yaw,
                    camera_y + ahead * sin_yaw + aside * cos_yaw,
                    ego.station_m + near,
                )
                turn_rad = route.pose_at(station_m)[2] - ego.yaw_rad
            is_cut = x_min <= first_px or x_max >= last_px
            if is_cut and right > 0.0:
                depth, aside = _from_inner_edge(near, right, left, length, width)
            elif is_cut and left < 0.0:
                depth, aside = _from_inner_edge(near, -left, -right, length, width)
                aside = -aside
            else:
                depth, aside, width, length = _fitted(near, left, right, length, width, turn_rad)
            places.append(
                Place(
                    label,
                    camera_x + depth * cos_yaw - aside * sin_yaw,
                    camera_y + depth * sin_yaw + aside * cos_yaw,
                    max(width, settings.min_extent_m),
                    max(length, settings.min_extent_m),
                    noise * near * near,
                    is_cut,
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


def _fitted(
    near: float, left: float, right: float, length: float, width: float, turn_rad: float
) -> tuple[float, float, float, float]:
    """Fit a body to the edges of its picture.

    Args:
        near: Depth of its nearest point.
        left: Tangent of the direction to its picture's left edge.
        right: The same of the right edge.
        length: Its usual length.
        width: Its usual width.
        turn_rad: Direction of its lane, relative to the camera's axis.

    Returns:
        Depth and left of its centre, and its width and length across and along its lane.
    """
    cos_turn, sin_turn = math.cos(turn_rad), math.sin(turn_rad)
    ahead_1, aside_1 = 0.5 * length * cos_turn, 0.5 * length * sin_turn
    ahead_2, aside_2 = -0.5 * width * sin_turn, 0.5 * width * cos_turn
    depth = near + abs(ahead_1) + abs(ahead_2)
    middle = 0.5 * (left + right)
    aside = middle * depth
    near_1, near_2 = ahead_1 + ahead_2, ahead_1 - ahead_2
    side_1, side_2 = aside_1 + aside_2, aside_1 - aside_2
    depth_1, depth_2, depth_3, depth_4 = depth + near_1, depth - near_1, depth + near_2, depth - near_2
    seen_left = seen_right = 0.0
    # The picture's middle moves almost in proportion to the body: two steps leave less than a centimetre.
    for _ in range(2):
        tangents = (
            (aside + side_1) / depth_1,
            (aside - side_1) / depth_2,
            (aside + side_2) / depth_3,
            (aside - side_2) / depth_4,
        )
        seen_left, seen_right = max(tangents), min(tangents)
        aside += (middle - 0.5 * (seen_left + seen_right)) * depth
    wider = (left - right - seen_left + seen_right) * near
    return depth, aside, width + wider * abs(cos_turn), length + wider * abs(sin_turn)


def _from_inner_edge(
    near: float, inner: float, border: float, length: float, width: float
) -> tuple[float, float]:
    """Return depth and aside of the centre of a body whose picture is cut on its outer side.

    Its inner edge is the far end of its inner side. If that side would be out of the picture at the nearest depth,
    the nearest visible point is not the body's near end but where its inner side enters the picture.

    Args:
        near: Depth of the nearest visible point.
        inner: Tangent of the direction to the inner edge, >= 0.
        border: The same of the image's border, > inner.
        length: The body's usual length.
        width: The body's usual width.
    """
    aside, far = inner * (near + length), near + length
    if aside > border * near:
        aside, far = border * near, border * near / inner
    return far - 0.5 * length, aside + 0.5 * width

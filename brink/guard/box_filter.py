"""Detects boxes that cannot be real: they contradict the ground plane or the ego's motion, or come out of nowhere.

A body that stands on level ground has a bottom edge below the horizon, and its distance and its height in the image
give its height in metres. What it does in the world follows from how its box moves and from the ego's own motion.
And a body comes into view at the side of the image, far away, or from behind another one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, EgoState, ObstacleLabel
from brink.sim.driving.obstacles import overlap
from brink.sim.guard.setting import ranged

_HEIGHTS_M: Final = {ObstacleLabel.VEHICLE: (0.9, 4.5), ObstacleLabel.PERSON: (0.7, 2.4)}
"""Lowest and highest body of each label."""
_BORDER_PX: Final = 2.0
_SIDE_PX: Final = 60.0
"""What comes into view at the side was outside the image a moment ago."""
_SAME_OVERLAP: Final = 0.3
"""Boxes of one label that overlap by at least this intersection over union show the same body."""
_BEHIND_OVERLAP: Final = 0.02
"""A box that another one overlaps by this much may have come from behind it."""
_FORGOTTEN_S: Final = 0.55
"""A body that is not reported for this long is a new one when it is reported again; tracks of the driving system
last as long."""
_WINDOW_S: Final = 0.5
"""Speeds are measured over this time..."""
_LEAST_WINDOW_S: Final = 0.3
"""...and over this at least."""
_SIGMAS: Final = 3.0


@dataclass(frozen=True, kw_only=True)  # without slots, so that a class can inherit from it and another one
class BoxFilterSettings:
    """The limits within which a box counts as plausible.

    Attributes:
        vehicle_speed_mps: Fastest vehicle.
        person_speed_mps: Fastest person.
        appears_beyond_m: What appears in the middle of the image nearer than this appears from nothing...
        doubted_s: ...and is doubted for this long.
        pixel_noise_px: Standard deviation of a bottom edge.
    """

    vehicle_speed_mps: float = ranged(20.0, low=1.0, high=100.0, unit="m/s")
    person_speed_mps: float = ranged(4.0, low=1.0, high=15.0, unit="m/s")
    appears_beyond_m: float = ranged(25.0, low=0.0, high=120.0, unit="m")
    doubted_s: float = ranged(2.0, low=0.0, high=60.0, unit="s")
    pixel_noise_px: float = ranged(1.0, low=0.0, high=20.0, unit="px")


class _Seen:
    """A body that is reported, over time."""

    __slots__ = ("box", "doubted_until_s", "places", "seen_s")

    def __init__(self, box: Box, doubted_until_s: float) -> None:
        self.box = box
        self.doubted_until_s = doubted_until_s
        self.seen_s = 0.0
        self.places: list[tuple[float, float, float, float]] = []


class BoxFilter:
    """Tells plausible boxes from implausible ones. Create a new one for each drive.

    Args:
        settings: What is plausible.
        camera: The camera that the boxes come from.
    """

    def __init__(self, settings: BoxFilterSettings, camera: Camera | None = None) -> None:
        self._settings = settings
        self._camera = camera or Camera()
        self._bodies: list[_Seen] = []
        self._began_s: float | None = None

    def plausible(self, time_s: float, ego: EgoState, boxes: Sequence[Box]) -> tuple[Box, ...]:
        """Return the boxes that may be real, in their order; called once at each perception step.

        Args:
            time_s: Simulated time.
            ego: State of the ego.
            boxes: What is reported.
        """
        if self._began_s is None:
            self._began_s = time_s
        before = [body for body in self._bodies if time_s - body.seen_s < _FORGOTTEN_S]
        unmatched = list(before)
        kept = []
        for box in boxes:
            body = _same(box, unmatched)
            if body is None:
                others = [*(one for one in boxes if one is not box), *(one.box for one in before)]
                body = _Seen(box, self._doubted_until_s(time_s, box, others))
                self._bodies.append(body)
            else:
                unmatched.remove(body)
            body.box, body.seen_s = box, time_s
            moves = self._moves_plausibly(body, time_s, ego)
            if moves and self._stands_on_ground(box) and time_s >= body.doubted_until_s:
                kept.append(box)
        self._bodies = [body for body in self._bodies if time_s - body.seen_s < _FORGOTTEN_S]
        return tuple(kept)

    def _stands_on_ground(self, box: Box) -> bool:
        """Return whether a box is consistent with a body of its label that stands on level ground."""
        camera = self._camera
        depth_m = camera.ground_depth_m(box.y_max_px)
        if depth_m is None or depth_m > camera.far_m:
            return False
        low_m, high_m = _HEIGHTS_M[box.label]
        noise = self._settings.pixel_noise_px / (box.y_max_px - camera.horizon_px)
        height_m = depth_m * (box.y_max_px - box.y_min_px) / camera.focal_px
        # The upper border may hide part of the body, and the lower one how near it is: its height is then a bound.
        is_cut_above = box.y_min_px <= _BORDER_PX
        is_cut_below = box.y_max_px >= camera.height_px - _BORDER_PX
        too_low = height_m * (1.0 + _SIGMAS * noise) < low_m and not is_cut_above
        too_high = height_m * (1.0 - _SIGMAS * noise) > high_m and not is_cut_below
        return not (too_low or too_high)

    def _doubted_until_s(self, time_s: float, box: Box, others: Sequence[Box]) -> float:
        """Return until when a box that appears now is doubted; minus infinity if it may just have come into view."""
        settings, camera = self._settings, self._camera
        depth_m = camera.ground_depth_m(box.y_max_px)
        at_side = box.x_min_px < _SIDE_PX or box.x_max_px > camera.width_px - _SIDE_PX
        is_far = depth_m is None or depth_m >= settings.appears_beyond_m
        from_behind = any(overlap(box, other) > _BEHIND_OVERLAP for other in others)
        # At the beginning of a drive, everything is new.
        if at_side or is_far or from_behind or time_s == self._began_s:
            return -math.inf
        return time_s + settings.doubted_s

    def _moves_plausibly(self, body: _Seen, time_s: float, ego: EgoState) -> bool:
        """Record the position of a body, and return whether it can have moved there."""
        settings, camera, box = self._settings, self._camera, body.box
        depth_m = camera.ground_depth_m(box.y_max_px)
        is_cut = (
            box.x_min_px <= _BORDER_PX
            or box.x_max_px >= camera.width_px - _BORDER_PX
            or box.y_max_px >= camera.height_px - _BORDER_PX
        )
        if depth_m is None or is_cut:  # what is cut by the border moves with the border
            body.places.clear()
            return True
        left_m = camera.left_m(0.5 * (box.x_min_px + box.x_max_px), depth_m)
        ahead_m = depth_m + camera.forward_m
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        x_m = ego.x_m + ahead_m * cos_yaw - left_m * sin_yaw
        y_m = ego.y_m + ahead_m * sin_yaw + left_m * cos_yaw
        noise_m = settings.pixel_noise_px * depth_m * depth_m / (camera.focal_px * camera.height_m)
        body.places.append((time_s, x_m, y_m, noise_m))
        while time_s - body.places[0][0] > _WINDOW_S + 1e-6:
            body.places.pop(0)
        since_s, since_x_m, since_y_m, since_noise_m = body.places[0]
        elapsed_s = time_s - since_s
        if elapsed_s < _LEAST_WINDOW_S - 1e-6:
            return True
        is_person = box.label is ObstacleLabel.PERSON
        most_mps = settings.person_speed_mps if is_person else settings.vehicle_speed_mps
        moved_m = math.hypot(x_m - since_x_m, y_m - since_y_m)
        return moved_m <= most_mps * elapsed_s + _SIGMAS * math.hypot(noise_m, since_noise_m)


def _same(box: Box, bodies: Sequence[_Seen]) -> _Seen | None:
    """Return the body that a box shows: the one of its label that it overlaps most; None if it is new."""
    best, most = None, _SAME_OVERLAP
    for body in bodies:
        if body.box.label is box.label and (shared := overlap(box, body.box)) >= most:
            best, most = body, shared
    return best

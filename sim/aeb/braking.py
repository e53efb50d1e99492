"""The emergency brake, a driving system: two trigger regions in the image, and a latch that keeps braking.

The regions are trapezoids, defined for an image of 1280 x 720 and scaled with it. A person in the *warning* region
triggers the brake, and so does a vehicle in the smaller *danger* region. A person is confirmed by overlapping boxes
in two of the last three frames, because a detector sometimes reports a person for a single frame where there is
nobody. It is enough that the last box intersects the region, or will by the time at which the brakes bite if the
person walks on as between two frames. For a vehicle the middle of the box's lower edge must lie in the region for
several consecutive frames, because the box of a long vehicle parked beside the lane extends far into the image.
Otherwise the car cruises straight on.

The regions reach as far as the car needs to stop on the most slippery road that it is meant for: what it drives until
somebody is confirmed, while detections are on their way and while the brakes build up, its braking distance, and a
metre to spare. The paper's, which reach 9.9 m, are the smallest; with a latency of 0.1 s the ego needs 10.9 m for a
person.

Source: Ferreira et al. 2022, automatic emergency braking. Boxes are tested against the trapezoid, not against its
bounding rectangle.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import (
    CONTROL_STEP_S,
    LATENCY_S,
    Box,
    Command,
    Observation,
    ObstacleLabel,
    PerceivedObstacle,
    PlanMode,
    PlanState,
)
from brink.sim.world.ego import EGO_CAR, GRAVITY_MPS2, CarModel

REFERENCE_PX: Final = (1280, 720)
TOP_ROW_PX: Final = 470.0
HOLD_S: Final = 0.5
PERSON_FRAMES: Final = 2
"""A person in this many of the last `PERSON_WINDOW` frames, the current one included, is confirmed; 1 in the
paper."""
PERSON_WINDOW: Final = 3
VEHICLE_FRAMES: Final = 3
"""Consecutive frames with a vehicle in its region that trigger the brake; duplicate boxes of parked
vehicles last only one or two frames."""

_Rows = TypeVar("_Rows", float, NDArray[np.floating])

CRUISE_MPS: Final = 8.0
FULL_BRAKE_MPS2: Final = -12.0
SPEEDS_UP_MPS2: Final = 2.5
SLOWS_DOWN_MPS2: Final = 3.0
_WARNING_PX: Final = (730.0, 230.0)
_DANGER_PX: Final = (510.0, 180.0)
"""Widths of the regions in the reference image, at its lower edge and at `TOP_ROW_PX`."""
_DRIVING_PX: Final = (800, 450, 75)
"""The reference image in the driving system's: its width and height, and the rows above it."""
_CAMERA: Final = Camera()
LEAST_FRICTION: Final = 0.55
"""Of the roads that the brake is designed for: in soft rain."""
TO_SPARE_M: Final = 1.0
"""Clearance at which the car is meant to stop."""


def bite_s(car: CarModel, braking_mps2: float) -> float:
    """Return by how much a car stops later than one whose brakes reach a deceleration at once."""
    return car.delay_s + 0.5 * braking_mps2 / car.brake_rate_mps3


def needed_reach_m(car: CarModel, *, latency_s: float, frames: int) -> float:
    """Return how far ahead of the camera somebody must trigger the brake so that the car stops a metre before.

    Args:
        car: The car.
        latency_s: Time from an image to the arrival of what was detected in it.
        frames: Number of frames in which they are reported before the brake is triggered.
    """
    braking_mps2 = min(LEAST_FRICTION * GRAVITY_MPS2, car.brake_mps2)
    until_bite_s = frames * CONTROL_STEP_S + latency_s + bite_s(car, braking_mps2)
    stopping_m = CRUISE_MPS * until_bite_s + 0.5 * CRUISE_MPS**2 / braking_mps2
    return 0.5 * car.length_m - _CAMERA.forward_m + stopping_m + TO_SPARE_M


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A trapezoid on the lower edge of the image, symmetric about the image's vertical centre line.

    Attributes:
        width_px: Width of the image.
        height_px: Row of its lower edge.
        base_px: Width at the lower edge.
        top_px: Width at `top_row_px`.
        top_row_px: Row of the upper edge.
    """

    width_px: int
    height_px: int
    base_px: float
    top_px: float
    top_row_px: float

    @classmethod
    def from_reference(cls, width_px: int, height_px: int, *, warning: bool) -> "Region":
        """Scale a region of the reference image to an image of another size.

        Args:
            width_px: Width of the image.
            height_px: Height of the image.
            warning: Whether to return the warning region; otherwise the danger region.
        """
        base_px, top_px = _WARNING_PX if warning else _DANGER_PX
        across, down = width_px / REFERENCE_PX[0], height_px / REFERENCE_PX[1]
        return cls(
            width_px=width_px,
            height_px=height_px,
            base_px=base_px * across,
            top_px=top_px * across,
            top_row_px=TOP_ROW_PX * down,
        )

    @classmethod
    def in_driving_image(cls, *, warning: bool, reach_m: float = 0.0) -> "Region":
        """Return a region in the driving system's image, which shows more above and below than the reference.

        Args:
            warning: Whether to return the warning region; otherwise the danger region.
            reach_m: How far ahead of the camera the region reaches at least; its sides are extended upwards.
        """
        width_px, height_px, above_px = _DRIVING_PX
        region = cls.from_reference(width_px, height_px, warning=warning)
        region = replace(region, height_px=height_px + above_px, top_row_px=region.top_row_px + above_px)
        row_px = _CAMERA.horizon_px + _CAMERA.focal_px * _CAMERA.height_m / max(reach_m, _CAMERA.near_m)
        if row_px >= region.top_row_px:
            return region
        return replace(region, top_px=2.0 * region._half_px(row_px), top_row_px=row_px)

    def corners(self) -> tuple[tuple[float, float], ...]:
        """Return the corners, clockwise from the upper left, in pixels."""
        middle, bottom = 0.5 * self.width_px, float(self.height_px)
        return (
            (middle - 0.5 * self.top_px, self.top_row_px),
            (middle + 0.5 * self.top_px, self.top_row_px),
            (middle + 0.5 * self.base_px, bottom),
            (middle - 0.5 * self.base_px, bottom),
        )

    def intersects(self, box: Box) -> bool:
        """Return whether a box and the trapezoid intersect.

        Their common rows form an interval; the trapezoid is widest at the lowest of them, so that row decides.
        """
        return bool(
            self.intersects_each(np.array([[box.x_min_px, box.y_min_px, box.x_max_px, box.y_max_px]]))[0]
        )

    def intersects_each(self, boxes: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return which boxes intersect the trapezoid, shape ``(n,)``.

        Args:
            boxes: x_min, y_min, x_max, y_max in px, shape ``(n, 4)``.
        """
        low = np.minimum(boxes[:, 3], self.height_px)
        high_enough = low >= np.maximum(boxes[:, 1], self.top_row_px)
        middle, half = 0.5 * self.width_px, self._half_px(low)
        met: NDArray[np.bool_] = high_enough & (boxes[:, 0] <= middle + half) & (boxes[:, 2] >= middle - half)
        return met

    def contains_bottom_centre(self, box: Box) -> bool:
        """Return whether the middle of a box's lower edge lies in the trapezoid."""
        low = min(box.y_max_px, float(self.height_px))
        aside = abs(0.5 * (box.x_min_px + box.x_max_px) - 0.5 * self.width_px)
        return low >= self.top_row_px and aside <= self._half_px(low)

    def _half_px(self, row_px: _Rows) -> _Rows:
        """Return half the trapezoid's width at a row."""
        depth = (row_px - self.top_row_px) / (self.height_px - self.top_row_px)
        return 0.5 * (self.top_px + depth * (self.base_px - self.top_px))


_ROUNDING_S: Final = 1e-6
"""Times of frames are rounded: without a margin, some holds would last a frame longer than others."""


class EmergencyBrake:
    """Brakes in response to the detector's reports, and cruises otherwise. Create a new one for each episode.

    Args:
        hold_s: How long braking continues without a trigger.
        enabled: Whether the brake is enabled at all.
        person_frames: Number of the last three frames in which a person must be reported to trigger it, 1 to 3.
        latency_s: The longest time from an image to the arrival of what was detected in it.
        car: The car that it brakes.

    Attributes:
        person_seen_s: Time of the first frame in which a person was reported; None if there was none.
        braked_at_s: When the brake was first applied; None if it never was.
        obstacles: Empty: it has no tracks.
    """

    def __init__(
        self,
        *,
        hold_s: float = HOLD_S,
        enabled: bool = True,
        person_frames: int = PERSON_FRAMES,
        latency_s: float = LATENCY_S,
        car: CarModel = EGO_CAR,
    ) -> None:
        self.person_seen_s: float | None = None
        self.braked_at_s: float | None = None
        self.obstacles: tuple[PerceivedObstacle, ...] = ()
        self._warning, self._danger = (
            Region.in_driving_image(
                warning=warning, reach_m=needed_reach_m(car, latency_s=latency_s, frames=frames)
            )
            for warning, frames in ((True, person_frames), (False, VEHICLE_FRAMES))
        )
        self._bite_s = bite_s(car, min(LEAST_FRICTION * GRAVITY_MPS2, car.brake_mps2))
        self._hold_s = hold_s
        self._enabled = enabled
        self._person_frames = person_frames
        self._until_s = -math.inf
        self._brakes = False
        self._vehicle_frames = 0
        self._people: deque[list[Box]] = deque(maxlen=PERSON_WINDOW - 1)

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command."""
        time_s, boxes = observation.time_s, observation.boxes
        if boxes is not None:
            seen_s = time_s if observation.seen_s is None else observation.seen_s
            if self.person_seen_s is None and any(box.label is ObstacleLabel.PERSON for box in boxes):
                self.person_seen_s = seen_s
            if self._triggers(boxes, time_s - seen_s + self._bite_s, observation.ego.speed_mps):
                self._until_s = time_s + self._hold_s
        self._brakes = time_s < self._until_s - _ROUNDING_S
        if not self._brakes:
            faster_mps = CRUISE_MPS - observation.ego.speed_mps
            return Command(accel_mps2=min(max(faster_mps, -SLOWS_DOWN_MPS2), SPEEDS_UP_MPS2), steer_rad=0.0)
        if self.braked_at_s is None:
            self.braked_at_s = time_s
        return Command(accel_mps2=FULL_BRAKE_MPS2, steer_rad=0.0, emergency=True)

    def _triggers(self, boxes: Sequence[Box], bites_after_s: float, speed_mps: float) -> bool:
        """Return whether the boxes of a frame trigger the brake.

        Args:
            boxes: The boxes.
            bites_after_s: Time from the image to when braking would take effect.
            speed_mps: The car's speed.
        """
        people = [box for box in boxes if box.label is ObstacleLabel.PERSON]
        person = any(self._calls_for_brake(box, bites_after_s, speed_mps) for box in people)
        self._people.append(people)
        vehicle = any(
            box.label is ObstacleLabel.VEHICLE and self._danger.contains_bottom_centre(box) for box in boxes
        )
        self._vehicle_frames = self._vehicle_frames + 1 if vehicle else 0
        return self._enabled and (person or self._vehicle_frames >= VEHICLE_FRAMES)

    def _calls_for_brake(self, person: Box, bites_after_s: float, speed_mps: float) -> bool:
        """Return whether a person is confirmed by earlier frames, and in the warning region or soon will be."""
        before = [next((box for box in frame if _overlap(box, person)), None) for frame in self._people]
        if 1 + sum(box is not None for box in before) < self._person_frames:
            return False
        last = before[-1] if before else None
        if self._warning.intersects(person) or last is None:
            return self._warning.intersects(person)
        walked = _walked_on(last, person, bites_after_s / CONTROL_STEP_S, speed_mps * CONTROL_STEP_S)
        return self._warning.intersects(walked)

    @property
    def plan(self) -> PlanState:
        """Whether the car cruises or stops."""
        if self._brakes:
            return PlanState(mode=PlanMode.STOP, target_speed_mps=0.0, target_offset_m=0.0)
        return PlanState(mode=PlanMode.CRUISE, target_speed_mps=CRUISE_MPS, target_offset_m=0.0)


def _overlap(a: Box, b: Box) -> bool:
    return (
        a.x_min_px < b.x_max_px
        and b.x_min_px < a.x_max_px
        and a.y_min_px < b.y_max_px
        and b.y_min_px < a.y_max_px
    )


_FAST_WALK_MPS: Final = 2.5


def _walked_on(before: Box, box: Box, frames: float, approach_m: float) -> Box:
    """Return where a person at the same depth would be if they had walked across the image for some more frames.

    Args:
        before: Their box in the frame before.
        box: Their box.
        frames: Number of frames, as long as between the two.
        approach_m: What the car drove between the two, which moves whoever stands still towards the image's sides.
            What sticks to the lens would have to run to stay where it is.
    """
    depth_m = _CAMERA.ground_depth_m(box.y_max_px)
    if depth_m is None:
        return box
    grows = 1.0 + approach_m / depth_m
    most_px = _FAST_WALK_MPS * CONTROL_STEP_S * _CAMERA.focal_px / depth_m
    edges = []
    for was_px, now_px in ((before.x_min_px, box.x_min_px), (before.x_max_px, box.x_max_px)):
        walked_px = now_px - _CAMERA.centre_x_px - grows * (was_px - _CAMERA.centre_x_px)
        edges.append(now_px + frames * min(max(walked_px, -most_px), most_px))
    return box._replace(x_min_px=edges[0], x_max_px=edges[1])

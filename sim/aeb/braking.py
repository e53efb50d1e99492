"""The emergency brake, a driving system: two trigger regions in the image, and a latch that keeps braking.

The regions are trapezoids, defined for an image of 1280 x 720 and scaled with it. A person in the *warning* region
triggers the brake, and so does a vehicle in the smaller *danger* region. A person is confirmed by overlapping boxes
in two of the last three frames, because a detector sometimes reports a person for a single frame where there is
nobody. It is enough that the last box intersects the region, or does by the time it arrives if it moves on as it did
between two frames: at 2 m/s, a person is 0.2 m nearer to the lane by then. For a vehicle the middle of the box's
lower edge must lie in the region for several consecutive frames, because the box of a long vehicle parked beside the
lane extends far into the image. Otherwise the car cruises straight on.

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

from brink.sim.driving.interface import (
    CONTROL_STEP_S,
    Box,
    Command,
    Observation,
    ObstacleLabel,
    PerceivedObstacle,
    PlanMode,
    PlanState,
)

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
    def in_driving_image(cls, *, warning: bool) -> "Region":
        """Return a region in the driving system's image, which shows more above and below than the reference."""
        width_px, height_px, above_px = _DRIVING_PX
        region = cls.from_reference(width_px, height_px, warning=warning)
        return replace(region, height_px=height_px + above_px, top_row_px=region.top_row_px + above_px)

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

    Attributes:
        person_seen_s: Time of the first frame in which a person was reported; None if there was none.
        braked_at_s: When the brake was first applied; None if it never was.
        obstacles: Empty: it has no tracks.
    """

    def __init__(
        self, *, hold_s: float = HOLD_S, enabled: bool = True, person_frames: int = PERSON_FRAMES
    ) -> None:
        self.person_seen_s: float | None = None
        self.braked_at_s: float | None = None
        self.obstacles: tuple[PerceivedObstacle, ...] = ()
        self._warning = Region.in_driving_image(warning=True)
        self._danger = Region.in_driving_image(warning=False)
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
            if self._triggers(boxes, time_s - seen_s):
                self._until_s = time_s + self._hold_s
        self._brakes = time_s < self._until_s - _ROUNDING_S
        if not self._brakes:
            faster_mps = CRUISE_MPS - observation.ego.speed_mps
            return Command(accel_mps2=min(max(faster_mps, -SLOWS_DOWN_MPS2), SPEEDS_UP_MPS2), steer_rad=0.0)
        if self.braked_at_s is None:
            self.braked_at_s = time_s
        return Command(accel_mps2=FULL_BRAKE_MPS2, steer_rad=0.0, emergency=True)

    def _triggers(self, boxes: Sequence[Box], age_s: float) -> bool:
        """Return whether the boxes of a frame trigger the brake, given the time since its image."""
        people = [box for box in boxes if box.label is ObstacleLabel.PERSON]
        person = any(self._calls_for_brake(box, age_s) for box in people)
        self._people.append(people)
        vehicle = any(
            box.label is ObstacleLabel.VEHICLE and self._danger.contains_bottom_centre(box) for box in boxes
        )
        self._vehicle_frames = self._vehicle_frames + 1 if vehicle else 0
        return self._enabled and (person or self._vehicle_frames >= VEHICLE_FRAMES)

    def _calls_for_brake(self, person: Box, age_s: float) -> bool:
        """Return whether a person is confirmed by earlier frames, and was in the warning region or is by now."""
        before = [next((box for box in frame if _overlap(box, person)), None) for frame in self._people]
        if 1 + sum(box is not None for box in before) < self._person_frames:
            return False
        last = before[-1] if before else None
        now = person if last is None else _moved_on(last, person, age_s / CONTROL_STEP_S)
        return self._warning.intersects(person) or self._warning.intersects(now)

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


def _moved_on(before: Box, box: Box, frames: float) -> Box:
    """Return where a box is after some frames in which it moves as since the frame before."""
    edges = [edge + frames * (edge - was) for was, edge in zip(before[1:], box[1:], strict=True)]
    return Box(box.label, *edges)

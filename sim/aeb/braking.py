"""The emergency brake: two trigger regions in the image, and a latch that keeps braking.

The regions are trapezoids, defined for an image of 1280 x 720 and scaled with it. A person in the *warning* region
triggers the brake, and so does a vehicle in the smaller *danger* region. For a person it is enough that the box
intersects the region in two of the last three frames, because a detector sometimes reports a person for a single
frame where there is nobody. For a vehicle the middle of the box's lower edge must lie in the region for several
consecutive frames, because the box of a long vehicle parked beside the lane extends far into the image.

Source: Ferreira et al. 2022, automatic emergency braking. Boxes are tested against the trapezoid, not against its
bounding rectangle.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

REFERENCE_PX: Final = (1280, 720)
TOP_ROW_PX: Final = 470.0
HOLD_S: Final = 0.5
PERSON_FRAMES: Final = 2
"""A person in the region in this many of the last `PERSON_WINDOW` frames, the current one included, triggers the
brake; 1 in the paper."""
PERSON_WINDOW: Final = 3
VEHICLE_FRAMES: Final = 3
"""Consecutive frames with a vehicle in its region that trigger the brake; duplicate boxes of parked
vehicles last only one or two frames."""

_Rows = TypeVar("_Rows", float, NDArray[np.floating])

PERSON, VEHICLE = "person", "vehicle"


class Detection(NamedTuple):
    """A box in an image, in pixels, with its label and score."""

    label: str
    x_min_px: float
    y_min_px: float
    x_max_px: float
    y_max_px: float
    score: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A trapezoid on the lower edge of the image, symmetric about the image's vertical centre line.

    Attributes:
        width_px: Width of the image.
        height_px: Height of the image.
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
    def from_reference(cls, base_px: float, top_px: float, width_px: int, height_px: int) -> "Region":
        """Scale a region of the reference image to an image of another size.

        Args:
            base_px: Width at the lower edge, in the reference image.
            top_px: Width at the upper edge, in the reference image.
            width_px: Width of the image.
            height_px: Height of the image.
        """
        across, down = width_px / REFERENCE_PX[0], height_px / REFERENCE_PX[1]
        return cls(
            width_px=width_px,
            height_px=height_px,
            base_px=base_px * across,
            top_px=top_px * across,
            top_row_px=TOP_ROW_PX * down,
        )

    def corners(self) -> tuple[tuple[float, float], ...]:
        """Return the corners, clockwise from the upper left, in pixels."""
        middle, bottom = 0.5 * self.width_px, float(self.height_px)
        return (
            (middle - 0.5 * self.top_px, self.top_row_px),
            (middle + 0.5 * self.top_px, self.top_row_px),
            (middle + 0.5 * self.base_px, bottom),
            (middle - 0.5 * self.base_px, bottom),
        )

    def intersects(self, box: Detection) -> bool:
        """Return whether a box and the trapezoid intersect.

        Their common rows form an interval; the trapezoid is widest at the lowest of them, so that row decides.
        """
        return bool(self.intersects_each(np.array([box[1:5]], np.float64))[0])

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

    def contains_bottom_centre(self, box: Detection) -> bool:
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


@dataclass(slots=True)
class EmergencyBrake:
    """Brakes in response to the detector's reports. Stateful: every episode needs its own instance.

    Attributes:
        warning: A person who intersects this region triggers the brake.
        danger: A vehicle that stands in this region triggers the brake.
        hold_s: How long braking continues without a trigger.
        enabled: Whether the brake is enabled at all.
        person_frames: Number of the last three frames in which a person must be reported to trigger it, 1 to 3.
    """

    warning: Region
    danger: Region
    hold_s: float = HOLD_S
    enabled: bool = True
    person_frames: int = PERSON_FRAMES
    _until_s: float = field(default=float("-inf"))
    _vehicle_frames: int = 0
    _people: deque[bool] = field(default_factory=lambda: deque(maxlen=PERSON_WINDOW))

    @classmethod
    def for_picture(
        cls,
        width_px: int,
        height_px: int,
        *,
        hold_s: float = HOLD_S,
        enabled: bool = True,
        person_frames: int = PERSON_FRAMES,
    ) -> "EmergencyBrake":
        """Create the brake for camera images of a given size.

        Args:
            width_px: Width of the image.
            height_px: Height of the image.
            hold_s: How long braking continues without a trigger.
            enabled: Whether the brake is enabled at all.
            person_frames: Number of the last three frames in which a person must be reported to trigger it, 1 to 3.
        """
        return cls(
            warning=Region.from_reference(730.0, 230.0, width_px, height_px),
            danger=Region.from_reference(510.0, 180.0, width_px, height_px),
            hold_s=hold_s,
            enabled=enabled,
            person_frames=person_frames,
        )

    def decide(self, time_s: float, detections: Sequence[Detection]) -> bool:
        """Return whether to brake, given the time and the detections of a frame."""
        self._people.append(any(box.label == PERSON and self.warning.intersects(box) for box in detections))
        person = self._people[-1] and sum(self._people) >= self.person_frames
        vehicle = any(box.label == VEHICLE and self.danger.contains_bottom_centre(box) for box in detections)
        self._vehicle_frames = self._vehicle_frames + 1 if vehicle else 0
        if self.enabled and (person or self._vehicle_frames >= VEHICLE_FRAMES):
            self._until_s = time_s + self.hold_s
        return time_s < self._until_s - _ROUNDING_S

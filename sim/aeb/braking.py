"""Owns the brake: two regions of the picture, and a latch.

The regions are trapezoids, given for a picture of 1280 x 720 and scaled with it: *warning*, in which a person brakes
the car, and inside it *danger*, in which a vehicle does. A person's box need only meet its region. A vehicle must
stand in its own with the middle of the box's lower edge: the rectangle around a long vehicle that is parked beside
the lane reaches far into the picture. It must stand there for a few frames in a row.

Source: Ferreira et al. 2022, automatic emergency braking; the test is against the trapezoid, not against the
rectangle around it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

REFERENCE_PX: Final = (1280, 720)
TOP_ROW_PX: Final = 470.0
HOLD_S: Final = 0.5
VEHICLE_FRAMES: Final = 3
"""Frames in a row in which a vehicle must stand in its region: a doubled box of a parked one lasts for one or two."""

_Rows = TypeVar("_Rows", float, NDArray[np.floating])

PERSON, VEHICLE = "person", "vehicle"


class Detection(NamedTuple):
    """A box in a picture, in pixels, with what the detector takes it for and how sure it is."""

    label: str
    x_min_px: float
    y_min_px: float
    x_max_px: float
    y_max_px: float
    score: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """An upright trapezoid that stands on the lower edge of a picture, symmetric to its middle.

    Attributes:
        width_px: Of the picture.
        height_px: Of the picture.
        base_px: Width at the lower edge.
        top_px: Width at `top_row_px`.
        top_row_px: Row of its upper edge.
    """

    width_px: int
    height_px: int
    base_px: float
    top_px: float
    top_row_px: float

    @classmethod
    def scaled(cls, base_px: float, top_px: float, width_px: int, height_px: int) -> "Region":
        """Return a region of the reference picture for a picture of another size."""
        across, down = width_px / REFERENCE_PX[0], height_px / REFERENCE_PX[1]
        return cls(
            width_px=width_px,
            height_px=height_px,
            base_px=base_px * across,
            top_px=top_px * across,
            top_row_px=TOP_ROW_PX * down,
        )

    def corners(self) -> tuple[tuple[float, float], ...]:
        """Return its corners, clockwise from the upper left, in pixels."""
        middle, bottom = 0.5 * self.width_px, float(self.height_px)
        return (
            (middle - 0.5 * self.top_px, self.top_row_px),
            (middle + 0.5 * self.top_px, self.top_row_px),
            (middle + 0.5 * self.base_px, bottom),
            (middle - 0.5 * self.base_px, bottom),
        )

    def meets(self, box: Detection) -> bool:
        """Return whether a box and the trapezoid share a point.

        Rows that both have are an interval; since the trapezoid is widest at its lowest row, the lowest common row
        decides.
        """
        return bool(self.met_by(np.array([box[1:5]], np.float64))[0])

    def met_by(self, boxes: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return which boxes share a point with the trapezoid.

        Args:
            boxes: x_min, y_min, x_max, y_max in px, shape ``(n, 4)``.
        """
        low = np.minimum(boxes[:, 3], self.height_px)
        high_enough = low >= np.maximum(boxes[:, 1], self.top_row_px)
        middle, half = 0.5 * self.width_px, self._half_px(low)
        met: NDArray[np.bool_] = high_enough & (boxes[:, 0] <= middle + half) & (boxes[:, 2] >= middle - half)
        return met

    def holds(self, box: Detection) -> bool:
        """Return whether the middle of a box's lower edge lies in the trapezoid."""
        low = min(box.y_max_px, float(self.height_px))
        aside = abs(0.5 * (box.x_min_px + box.x_max_px) - 0.5 * self.width_px)
        return low >= self.top_row_px and aside <= self._half_px(low)

    def _half_px(self, row_px: _Rows) -> _Rows:
        """Return half the width at a row."""
        depth = (row_px - self.top_row_px) / (self.height_px - self.top_row_px)
        return 0.5 * (self.top_px + depth * (self.base_px - self.top_px))


@dataclass(slots=True)
class EmergencyBrake:
    """Brakes for what the detector reports. Changes in place: one is made for every episode.

    Attributes:
        warning: A person who meets it brakes the car.
        danger: So does a vehicle that stands in this one.
        hold_s: How long it brakes on without a trigger.
        enabled: Whether it brakes at all.
    """

    warning: Region
    danger: Region
    hold_s: float = HOLD_S
    enabled: bool = True
    _until_s: float = field(default=float("-inf"))
    _vehicle_frames: int = 0

    @classmethod
    def for_picture(
        cls, width_px: int, height_px: int, *, hold_s: float = HOLD_S, enabled: bool = True
    ) -> "EmergencyBrake":
        """Return the brake of a camera with pictures of that size."""
        return cls(
            warning=Region.scaled(730.0, 230.0, width_px, height_px),
            danger=Region.scaled(510.0, 180.0, width_px, height_px),
            hold_s=hold_s,
            enabled=enabled,
        )

    def decide(self, time_s: float, detections: Sequence[Detection]) -> bool:
        """Return whether to brake at a time, given what is detected in its frame."""
        person = any(box.label == PERSON and self.warning.meets(box) for box in detections)
        vehicle = any(box.label == VEHICLE and self.danger.holds(box) for box in detections)
        self._vehicle_frames = self._vehicle_frames + 1 if vehicle else 0
        if self.enabled and (person or self._vehicle_frames >= VEHICLE_FRAMES):
            self._until_s = time_s + self.hold_s
        return time_s < self._until_s

"""What the encoding of participants knows of a road: stations and offsets, lanes and edges.

Stations run along the centre line of the lane on which the ego starts, 0 at its middle; offsets run to the left, 0 on
that line. Traffic keeps to the right: the oncoming lane is one lane width to the left.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from brink.search.errors import SpaceError

REACH_M = 55.0
"""Participants start within this distance of the ego, along and across the road: as far as the nearest crossroads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadLimits:
    """Where participants may be. The carriageway has two lanes; a pavement lies on each side of it.

    Attributes:
        lane_width_m: Of each lane.
        strip_m: Width of what lies between a lane and the pavement, such as parked cars.
        pavement_m: Width of each pavement.
        streets_m: Stations of the middles of streets that cross the road, ascending.
        clear_behind_m: Nobody starts on the ego's lane nearer behind its middle.
        clear_ahead_m: Nobody starts on the ego's lane nearer ahead of its middle.
    """

    lane_width_m: float = 3.5
    strip_m: float = 0.3
    pavement_m: float = 2.6
    streets_m: tuple[float, ...] = ()
    clear_behind_m: float = 9.0
    clear_ahead_m: float = 14.0

    def __post_init__(self) -> None:
        if not self.lane_width_m >= 2.5 or self.strip_m < 0 or not self.pavement_m >= 1.0:
            raise SpaceError(
                "RoadLimits: expected lanes of 2.5 m or more, a strip of 0 or more, pavements of 1 or more"
            )

    @property
    def right_kerb_m(self) -> float:
        """Offset at which the right pavement begins."""
        return -0.5 * self.lane_width_m - self.strip_m

    @property
    def left_kerb_m(self) -> float:
        """Offset at which the left pavement begins."""
        return 1.5 * self.lane_width_m + self.strip_m

    def on_carriageway(self, offset_m: float) -> bool:
        """Return whether an offset lies between the kerbs."""
        return self.right_kerb_m < offset_m < self.left_kerb_m

    def street_lane(self, station_m: float, offset_m: float) -> float | None:
        """Return the station of the lane that leads to the road, in the nearest crossing street.

        None if there is none within the reach of participants.
        """
        half_m = (-0.5 if offset_m > 0 else 0.5) * self.lane_width_m
        lanes_m = [middle_m + half_m for middle_m in self.streets_m if abs(middle_m + half_m) <= REACH_M]
        return min(lanes_m, key=lambda lane_m: abs(lane_m - station_m), default=None)

    def describe(self) -> Mapping[str, Any]:
        """Return it as a JSON object."""
        return {
            field.name: list(value) if isinstance(value := getattr(self, field.name), tuple) else value
            for field in fields(self)
        }

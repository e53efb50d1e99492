"""Where participants may start: on a lane, on a pavement, in a side street; never on each other."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from brink.search.actions.participants import SIZES_M, Kind
from brink.search.actions.road import REACH_M, RoadLimits

ALONG_M = 1.0
ACROSS_M = 0.3
"""Room that participants keep from each other when they start."""

KERB_ROOM_M = 0.35
"""People keep this far from the edges of a pavement."""

WAITS_M = 5.0
"""Who comes out of a side street starts at least this far before the kerb line."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where somebody starts, on the road.

    Attributes:
        ds_m: Station.
        dd_m: Offset.
        dyaw_rad: Heading: 0 or pi along the road, half of pi to its left, minus half of pi to its right.
    """

    ds_m: float
    dd_m: float
    dyaw_rad: float

    @property
    def across(self) -> bool:
        """Whether it heads across the road."""
        return abs(math.cos(self.dyaw_rad)) < 0.5


def placed(kind: Kind, start: Start, road: RoadLimits) -> Start:
    """Return the nearest start that the road has for somebody; a start that it has stays as it is."""
    ds_m = min(max(start.ds_m, -REACH_M), REACH_M)
    dd_m = min(max(start.dd_m, -REACH_M), REACH_M)
    if kind is Kind.PEDESTRIAN:
        return Start(ds_m, _on_pavement(dd_m, road), 0.0 if math.cos(start.dyaw_rad) >= 0 else math.pi)
    if not road.on_carriageway(dd_m):
        station_m = road.street_lane(ds_m, dd_m)
        if station_m is not None:
            return _in_street(dd_m, station_m, road)
    own = dd_m < 0.5 * road.lane_width_m
    middle_m = 0.0 if own else road.lane_width_m
    room_m = 0.5 * (road.lane_width_m - SIZES_M[kind][1])
    # On the oncoming lane somebody may be overtaking; nobody begins as a wrong-way driver on the ego's.
    ahead = own or math.cos(start.dyaw_rad) > 0
    return Start(ds_m, min(max(dd_m, middle_m - room_m), middle_m + room_m), 0.0 if ahead else math.pi)


def _on_pavement(dd_m: float, road: RoadLimits) -> float:
    if dd_m < 0.5 * (road.left_kerb_m + road.right_kerb_m):
        kerb_m = road.right_kerb_m
        return min(max(dd_m, kerb_m - road.pavement_m + KERB_ROOM_M), kerb_m - KERB_ROOM_M)
    kerb_m = road.left_kerb_m
    return min(max(dd_m, kerb_m + KERB_ROOM_M), kerb_m + road.pavement_m - KERB_ROOM_M)


def _in_street(dd_m: float, station_m: float, road: RoadLimits) -> Start:
    if dd_m > 0:
        return Start(station_m, max(dd_m, road.left_kerb_m + WAITS_M), -0.5 * math.pi)
    return Start(station_m, min(dd_m, road.right_kerb_m - WAITS_M), 0.5 * math.pi)


@dataclass(frozen=True, slots=True)
class Box:
    """What somebody fills, along and across the road."""

    low_s_m: float
    high_s_m: float
    low_d_m: float
    high_d_m: float

    @classmethod
    def of(cls, kind: Kind, start: Start) -> "Box":
        """Return the box of somebody, with half of the room that it keeps."""
        length_m, width_m = SIZES_M[kind]
        along_m, across_m = (width_m, length_m) if start.across else (length_m, width_m)
        half_s, half_d = 0.5 * (along_m + ALONG_M), 0.5 * (across_m + ACROSS_M)
        return cls(start.ds_m - half_s, start.ds_m + half_s, start.dd_m - half_d, start.dd_m + half_d)

    def meets(self, other: "Box") -> bool:
        """Return whether two boxes overlap."""
        return (
            self.low_s_m < other.high_s_m
            and other.low_s_m < self.high_s_m
            and self.low_d_m < other.high_d_m
            and other.low_d_m < self.high_d_m
        )


def ego_box(road: RoadLimits) -> Box:
    """Return the stretch of the ego's lane on which nobody starts."""
    half_m = 0.5 * road.lane_width_m
    return Box(-road.clear_behind_m, road.clear_ahead_m, -half_m, half_m)


def freed(kind: Kind, start: Start, taken: Iterable[Box], road: RoadLimits) -> Start | None:
    """Return the nearest start of the same kind that meets nobody, or None if there is none."""
    boxes = list(taken)
    for candidate in _moved(kind, start, road):
        box = Box.of(kind, candidate)
        if not any(box.meets(other) for other in boxes):
            return candidate
    return None


def _moved(kind: Kind, start: Start, road: RoadLimits) -> Iterator[Start]:
    """Yield a start, and then ever farther ones: along the road, or back along the side street."""
    yield start
    step_m = SIZES_M[kind][0] + ALONG_M
    for count in range(1, math.ceil(2.0 * REACH_M / step_m)):
        for sign in (1.0, -1.0):
            if start.across:
                moved = Start(start.ds_m, start.dd_m + sign * count * step_m, start.dyaw_rad)
            else:
                moved = Start(start.ds_m + sign * count * step_m, start.dd_m, start.dyaw_rad)
            if placed(kind, moved, road) == moved:
                yield moved

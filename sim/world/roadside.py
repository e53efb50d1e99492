"""Owns what stands along a road and never moves: buildings, parked cars, trees.

The same road always looks the same: nothing here comes from chance.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

from brink.sim.world.road import PARKING_STRIP_M, Road
from brink.sim.world.vehicle import CAR

BUILDING_EVERY_M = 17.0
PARKED_EVERY_M = 6.6
TREE_EVERY_M = 13.0
_FREE_PLACES = frozenset((1, 4, 5, 9, 12, 16, 18, 23))
"""Places of the parking strip that nobody took, counted along both sides."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fixture:
    """A body that never moves.

    Attributes:
        kind: ``building``, ``parked-car`` or ``tree``.
        length_m: Extent along its heading.
        width_m: Extent across its heading.
        height_m: Its height.
        x_m: Middle of its footprint.
        y_m: The same.
        yaw_rad: Its heading.
    """

    kind: str
    length_m: float
    width_m: float
    height_m: float
    x_m: float
    y_m: float
    yaw_rad: float


@lru_cache(maxsize=64)
def fixtures(road: Road) -> tuple[Fixture, ...]:
    """Return everything that stands along a road."""
    return (*_buildings(road), *_parked_cars(road), *_trees(road))


def _at(
    road: Road, kind: str, size: tuple[float, float, float], station_m: float, offset_m: float
) -> Fixture:
    x_m, y_m, yaw_rad = road.centre.pose_at(station_m, offset_m)
    length_m, width_m, height_m = size
    return Fixture(
        kind=kind,
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
    )


def _near_side_street(road: Road, station_m: float, side: float, margin_m: float) -> bool:
    return any(
        abs(station_m - junction.station_m) < margin_m and (junction.left if side > 0 else junction.right)
        for junction in road.junctions
    )


def _in_side_street(road: Road, x_m: float, y_m: float, margin_m: float) -> bool:
    """Return whether a point lies in the way of a side street, however the road bends."""
    for junction in road.junctions:
        dx, dy = x_m - junction.x_m, y_m - junction.y_m
        along = dx * math.cos(junction.yaw_rad) + dy * math.sin(junction.yaw_rad)
        across = dy * math.cos(junction.yaw_rad) - dx * math.sin(junction.yaw_rad)
        wide = road.kerb_m + road.style.pavement_m + margin_m
        if abs(along) < wide and (
            (junction.left and 0 < across < road.side_street_m)
            or (junction.right and -road.side_street_m < across < 0)
        ):
            return True
    return False


def _buildings(road: Road) -> list[Fixture]:
    found = []
    depth_m = 8.0
    for side in (1.0, -1.0):
        offset_m = side * (road.kerb_m + road.style.pavement_m + 1.5 + 0.5 * depth_m)
        for number in range(math.ceil((road.length_m + 40.0) / BUILDING_EVERY_M)):
            station_m = -14.0 + BUILDING_EVERY_M * number + (6.0 if side < 0 else 0.0)
            bend = road.centre.curvature_at(station_m)
            length_m = (12.0 + (number % 3)) * min(max(1.0 - bend * offset_m, 0.4), 1.0)
            fixture = _at(
                road, "building", (length_m, depth_m, 7.0 + 3.0 * (number % 4)), station_m, offset_m
            )
            if not _in_side_street(road, fixture.x_m, fixture.y_m, 0.5 * length_m + 1.0):
                found.append(fixture)
    return found


def _parked_cars(road: Road) -> list[Fixture]:
    if not road.style.parking:
        return []
    found = []
    pulls_out_m = 0.62 * road.length_m
    place = 0
    for side in (-1.0, 1.0):
        offset_m = side * (road.style.lane_width_m + 0.5 * PARKING_STRIP_M + 0.05)
        for number in range(int(road.length_m / PARKED_EVERY_M)):
            station_m = 4.0 + PARKED_EVERY_M * number
            place += 1
            if place % 26 in _FREE_PLACES or abs(station_m - road.crossing_m) < 8.0:
                continue
            if side < 0 and -7.0 < station_m - pulls_out_m < 14.0:
                continue
            if not _near_side_street(road, station_m, side, 13.0):
                size = (CAR.length_m, CAR.width_m, CAR.height_m)
                found.append(_at(road, "parked-car", size, station_m, offset_m))
    return found


def _trees(road: Road) -> list[Fixture]:
    if not road.style.trees:
        return []
    found = []
    for side in (1.0, -1.0):
        for number in range(int(road.length_m / TREE_EVERY_M)):
            station_m = 5.0 + TREE_EVERY_M * number
            fixture = _at(road, "tree", (0.4, 0.4, 5.0), station_m, side * (road.kerb_m + 0.5))
            clear_of_crossing = abs(station_m - road.crossing_m) > 4.0
            if clear_of_crossing and not _in_side_street(road, fixture.x_m, fixture.y_m, 2.0):
                found.append(fixture)
    return found

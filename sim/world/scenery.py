"""The static scenery of a road: buildings, parked cars, trees, and the surfaces of the scene in drawing order.

The same road always has the same scenery; nothing here is random.
"""

import math
from functools import lru_cache

import numpy as np

from brink.sim.plane import Rectangle
from brink.sim.trace import FloatArray, Surface
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import (
    CROSSING_WIDTH_M,
    PARKING_STRIP_M,
    STOP_LINE_BEFORE_CROSSING_M,
    Fixture,
    Junction,
    Road,
)
from brink.sim.world.vehicle import CAR

BUILDING_EVERY_M = 17.0
PARKED = "parked-car"
"""Kind of the fixtures that are parked cars."""
PARKED_EVERY_M = 6.6
TREE_EVERY_M = 13.0
_FREE_PLACES = frozenset((1, 4, 5, 9, 12, 16, 18, 23))
"""Indices of the parking spaces left empty, counted along both sides of the road."""

BEFORE_M = 25.0
BEYOND_M = 45.0
DASH_M = 3.0
STRIPE_M = 0.5
_RING = 8


@lru_cache(maxsize=64)
def fixtures(road: Road) -> tuple[Fixture, ...]:
    """Return all fixtures along a road."""
    if road.scenery is not None:
        return road.scenery.fixtures
    return (*_buildings(road), *_parked_cars(road), *_trees(road))


def _at(
    road: Road, kind: str, size: tuple[float, float, float], station_m: float, offset_m: float
) -> Fixture:
    x_m, y_m, yaw_rad = road.centre.pose_at(station_m, offset_m)
    length_m, width_m, height_m = size
    return Fixture(
        kind=kind, length_m=length_m, width_m=width_m, height_m=height_m, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad
    )


def _near_side_street(road: Road, station_m: float, side: float, margin_m: float) -> bool:
    return any(
        abs(station_m - junction.station_m) < margin_m and (junction.left if side > 0 else junction.right)
        for junction in road.junctions
    )


def _in_side_street(road: Road, x_m: float, y_m: float, margin_m: float) -> bool:
    """Return whether a point lies in a side street or within a margin of it."""
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
                found.append(_at(road, PARKED, size, station_m, offset_m))
    return found


def _trees(road: Road) -> list[Fixture]:
    if road.style.parking:
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


def scene_surfaces(road: Road) -> tuple[Surface, ...]:
    """Return the surfaces of a road in drawing order."""
    if road.scenery is not None:
        return (*road.scenery.surfaces, *map(_footprint, road.scenery.fixtures))
    kerb_m, walk_m = road.kerb_m, road.kerb_m + road.style.pavement_m
    streets = [street for junction in road.junctions for street in _streets(road, junction)]
    first_m, last_m = -BEFORE_M, road.length_m + BEYOND_M
    surfaces = [_strip(road.centre, "pavement", first_m, last_m, -walk_m, walk_m)]
    surfaces += [_strip(street, "pavement", kerb_m, street.length_m, -walk_m, walk_m) for street in streets]
    surfaces.append(_strip(road.centre, "road", first_m, last_m, -kerb_m, kerb_m))
    surfaces += [_strip(street, "road", 0.0, street.length_m, -kerb_m, kerb_m) for street in streets]
    surfaces += _markings(road, streets, first_m, last_m)
    surfaces += _crossing(road)
    surfaces += [_footprint(fixture) for fixture in fixtures(road)]
    return tuple(surfaces)


def _streets(road: Road, junction: Junction) -> list[ReferenceLine]:
    """Return the centre lines of a junction's side streets, leading away from its middle."""
    sides = [turn for turn, there in ((-0.5, junction.right), (0.5, junction.left)) if there]
    return [
        ReferenceLine(
            junction.x_m, junction.y_m, junction.yaw_rad + turn * math.pi, (Piece(road.side_street_m),)
        )
        for turn in sides
    ]


def _points(line: ReferenceLine, from_m: float, to_m: float, offset_m: float) -> list[tuple[float, float]]:
    count = max(int((to_m - from_m) / 2.0), 1)
    return [line.pose_at(from_m + (to_m - from_m) * i / count, offset_m)[:2] for i in range(count + 1)]


def _array(points: list[tuple[float, float]]) -> FloatArray:
    return np.array(points, dtype=np.float32)


def _strip(
    line: ReferenceLine, kind: str, from_m: float, to_m: float, right_m: float, left_m: float
) -> Surface:
    edge = _points(line, from_m, to_m, left_m) + _points(line, from_m, to_m, right_m)[::-1]
    return Surface(kind=kind, points=_array(edge), closed=True, width_m=0.0)


def _line(
    line: ReferenceLine, kind: str, from_m: float, to_m: float, offset_m: float, width_m: float
) -> Surface:
    points = _array(_points(line, from_m, to_m, offset_m))
    return Surface(kind=kind, points=points, closed=False, width_m=width_m)


def _markings(road: Road, streets: list[ReferenceLine], first_m: float, last_m: float) -> list[Surface]:
    lit = any(junction.lit for junction in road.junctions)
    clear_m = road.stop_line_before_junction_m if lit else road.kerb_m + 1.0

    def is_free(dash_m: float) -> bool:
        """Return whether a dash lies neither on the crossing nor in a junction, from stop line to stop line."""
        if abs(dash_m + 0.5 * DASH_M - road.crossing_m) < 0.5 * (DASH_M + CROSSING_WIDTH_M):
            return False
        ends_m = (dash_m, dash_m + DASH_M)
        return all(abs(end_m - one.station_m) >= clear_m for end_m in ends_m for one in road.junctions)

    surfaces = []
    lines = [(road.centre, first_m, last_m, True)]
    begins_m = clear_m if lit else road.kerb_m + 3.0
    lines += [(street, begins_m, street.length_m, False) for street in streets]
    for line, from_m, to_m, main in lines:
        for number in range(int((to_m - from_m) / (2.0 * DASH_M))):
            dash_m = from_m + 2.0 * DASH_M * number
            if not main or is_free(dash_m):
                surfaces.append(_line(line, "marking", dash_m, dash_m + DASH_M, 0.0, 0.15))
    return surfaces


def _crossing(road: Road) -> list[Surface]:
    half_m = 0.5 * CROSSING_WIDTH_M
    from_m, to_m = road.crossing_m - half_m, road.crossing_m + half_m
    count = int(2.0 * road.kerb_m / (2.0 * STRIPE_M))
    surfaces = [
        _strip(
            road.centre,
            "crossing",
            from_m,
            to_m,
            -road.kerb_m + 2.0 * STRIPE_M * number + 0.25,
            -road.kerb_m + 2.0 * STRIPE_M * number + 0.25 + STRIPE_M,
        )
        for number in range(count)
    ]
    if road.junctions[0].lit:
        stop_m = from_m - STOP_LINE_BEFORE_CROSSING_M
        surfaces.append(
            _strip(road.centre, "stop-line", stop_m - 0.15, stop_m + 0.15, -road.style.lane_width_m, -0.1)
        )
        surfaces += _stop_lines_of_others(road, road.junctions[0])
    return surfaces


def _stop_lines_of_others(road: Road, junction: Junction) -> list[Surface]:
    """Return the stop lines of a lit junction at which the ego does not arrive; ``stop-line`` is the ego's alone."""
    out_m = road.stop_line_before_junction_m
    arms = [(road.centre, junction.station_m + out_m)]
    arms += [(street, out_m) for street in _streets(road, junction)]
    return [
        _strip(arm, "marking", at_m - 0.15, at_m + 0.15, 0.1, road.style.lane_width_m) for arm, at_m in arms
    ]


def _footprint(fixture: Fixture) -> Surface:
    if fixture.kind == "tree":
        angles = [2.0 * math.pi * i / _RING for i in range(_RING)]
        points = [(fixture.x_m + 1.5 * math.cos(a), fixture.y_m + 1.5 * math.sin(a)) for a in angles]
    else:
        points = Rectangle.of(fixture).polygon()
    return Surface(kind=fixture.kind, points=_array(points), closed=True, width_m=0.0)

"""Owns the picture of what does not move: the surfaces of a road, in drawing order, for traces."""

import math

import numpy as np

from brink.sim.trace import FloatArray, Surface
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import (
    CROSSING_WIDTH_M,
    STOP_LINE_BEFORE_CROSSING_M,
    Junction,
    Road,
)
from brink.sim.world.roadside import Fixture, fixtures

BEFORE_M = 25.0
BEYOND_M = 45.0
DASH_M = 3.0
STRIPE_M = 0.5
_RING = 8


def scene_surfaces(road: Road) -> tuple[Surface, ...]:
    """Return the surfaces of a road, to be drawn in this order."""
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
    """Return the centre lines of a junction's side streets, outward from its middle."""
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
    def in_junction(station_m: float) -> bool:
        return any(abs(station_m - junction.station_m) < road.kerb_m + 1.0 for junction in road.junctions)

    surfaces = []
    lines = [(road.centre, first_m, last_m, True)]
    lines += [(street, road.kerb_m + 3.0, street.length_m, False) for street in streets]
    for line, from_m, to_m, main in lines:
        for number in range(int((to_m - from_m) / (2.0 * DASH_M))):
            dash_m = from_m + 2.0 * DASH_M * number
            if not (main and (in_junction(dash_m) or in_junction(dash_m + DASH_M))):
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
    return surfaces


def _footprint(fixture: Fixture) -> Surface:
    if fixture.kind == "tree":
        angles = [2.0 * math.pi * i / _RING for i in range(_RING)]
        points = [(fixture.x_m + 1.5 * math.cos(a), fixture.y_m + 1.5 * math.sin(a)) for a in angles]
    else:
        cos_yaw, sin_yaw = math.cos(fixture.yaw_rad), math.sin(fixture.yaw_rad)
        half_l, half_w = 0.5 * fixture.length_m, 0.5 * fixture.width_m
        points = [
            (fixture.x_m + a * cos_yaw - b * sin_yaw, fixture.y_m + a * sin_yaw + b * cos_yaw)
            for a, b in ((half_l, half_w), (-half_l, half_w), (-half_l, -half_w), (half_l, -half_w))
        ]
    return Surface(kind=fixture.kind, points=_array(points), closed=True, width_m=0.0)

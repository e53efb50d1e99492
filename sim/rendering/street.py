"""Converts a road of the simulator to a scene that can be rendered."""

import math
from typing import Final

import numpy as np

from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    Building,
    FloatArray,
    Ground,
    Lamp,
    Material,
    SignalGroup,
    StreetScene,
    TrafficLight,
    Tree,
    choose,
    choose_fraction,
)
from brink.sim.trace import Surface
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import Fixture, Junction, Road
from brink.sim.world.scenery import BEFORE_M, BEYOND_M, fixtures, scene_surfaces

FIRST_PARKED_ID: Final = 1_000_001
"""Id of the first parked vehicle; the others follow in the order of the road's fixtures."""
_MATERIALS: Final = {
    "pavement": Material.PAVEMENT,
    "road": Material.ASPHALT,
    "marking": Material.MARKING,
    "crossing": Material.CROSSING,
    "stop-line": Material.MARKING,
}
_KERB_M: Final = 0.18
_GUTTER_M: Final = 0.12
_LAMP_EVERY_M: Final = 24.0
_POST_FROM_KERB_M: Final = 0.5
_CROWN_M: Final = 3.2
_STEP_M: Final = 2.0
_CAR_LOOKS: Final = 64
_HOUSE_LOOKS: Final = 24
"""Number of different appearances: small, so that streets share models and textures, which are expensive to make."""


def street_from_road(road: Road, *, seed: int = 0) -> StreetScene:
    """Convert a road to a scene with its surfaces, kerbs, buildings, trees, parked vehicles and lights.

    Args:
        road: The road.
        seed: Selects the appearance of buildings, trees and parked vehicles; the road fixes their positions.
    """
    surfaces = _road_surfaces(road)
    beside = [surface for surface in surfaces if surface.material is Material.PAVEMENT]
    upon = [surface for surface in surfaces if surface.material is not Material.PAVEMENT]
    still = [(fixture, choose(seed, 1000 + index, 1 << 20)) for index, fixture in enumerate(fixtures(road))]
    parked = [(fixture, look) for fixture, look in still if fixture.kind == "parked-car"]
    return StreetScene(
        ground=(*beside, *_kerbs(road), *upon),
        buildings=tuple(_building(one, look % _HOUSE_LOOKS) for one, look in still if one.kind == "building"),
        trees=tuple(
            _tree(one, look, one.height_m * (1.0 + 0.3 * choose_fraction(look, 1)), _CROWN_M)
            for one, look in still
            if one.kind == "tree"
        ),
        parked=tuple(
            _parked(one, FIRST_PARKED_ID + index, look % _CAR_LOOKS, one.yaw_rad + _turn_rad(road, one))
            for index, (one, look) in enumerate(parked)
        ),
        lamps=tuple(_lamps(road)),
        traffic_lights=tuple(_traffic_lights(road)),
    )


def _road_surfaces(road: Road) -> list[Ground]:
    """Return the ground surfaces of a road, in painting order."""
    return [_ground(surface) for surface in scene_surfaces(road) if surface.kind in _MATERIALS]


def _ground(surface: Surface) -> Ground:
    points = surface.points.astype(np.float64)
    if not surface.closed:
        points = _widened(points, surface.width_m)
    return Ground(material=_MATERIALS[surface.kind], points=points)


def _widened(points: FloatArray, width_m: float) -> FloatArray:
    """Return the outline of a polyline with a given width."""
    along = np.gradient(points, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    across *= 0.5 * width_m / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return np.concatenate([points + across, (points - across)[::-1]])


def _kerbs(road: Road) -> list[Ground]:
    """Return kerbs and gutters as strips that are wider than the asphalt painted over them."""
    lines = [(road.centre, -BEFORE_M, road.length_m + BEYOND_M)]
    for junction in road.junctions:
        for turn, exists in ((-0.5, junction.right), (0.5, junction.left)):
            if exists:
                yaw_rad = junction.yaw_rad + turn * math.pi
                street = ReferenceLine(junction.x_m, junction.y_m, yaw_rad, (Piece(road.side_street_m),))
                lines.append((street, 0.0, street.length_m))
    kerbs = [_strip(*line, road.kerb_m + _KERB_M, Material.KERB) for line in lines]
    return (
        kerbs
        + [_strip(*line, road.kerb_m, Material.GUTTER) for line in lines]
        + [_strip(*line, road.kerb_m - _GUTTER_M, Material.ASPHALT) for line in lines]
    )


def _strip(line: ReferenceLine, from_m: float, to_m: float, half_m: float, material: Material) -> Ground:
    stations = np.linspace(from_m, to_m, max(int((to_m - from_m) / _STEP_M), 1) + 1).tolist()
    left = [line.pose_at(station, half_m)[:2] for station in stations]
    right = [line.pose_at(station, -half_m)[:2] for station in stations]
    return Ground(material=material, points=np.array(left + right[::-1]))


def _building(fixture: Fixture, look: int) -> Building:
    return Building(
        x_m=fixture.x_m,
        y_m=fixture.y_m,
        yaw_rad=fixture.yaw_rad,
        length_m=fixture.length_m,
        width_m=fixture.width_m,
        height_m=fixture.height_m,
        look=look,
    )


def _tree(fixture: Fixture, look: int, height_m: float, crown_m: float) -> Tree:
    return Tree(x_m=fixture.x_m, y_m=fixture.y_m, height_m=height_m, crown_m=crown_m, look=look)


def _parked(fixture: Fixture, number: int, look: int, yaw_rad: float) -> Body:
    return Body(
        id=number,
        kind=BodyKind.VEHICLE,
        x_m=fixture.x_m,
        y_m=fixture.y_m,
        yaw_rad=yaw_rad,
        length_m=fixture.length_m,
        width_m=fixture.width_m,
        height_m=fixture.height_m,
        look=look,
    )


def _turn_rad(road: Road, fixture: Fixture) -> float:
    """Return the angle that turns a parked vehicle in the direction of traffic on its side."""
    nearest_m = min(
        np.arange(0.0, road.length_m + _STEP_M, _STEP_M).tolist(),
        key=lambda station_m: math.dist(road.centre.pose_at(station_m)[:2], (fixture.x_m, fixture.y_m)),
    )
    return math.pi if road.centre.project(fixture.x_m, fixture.y_m, nearest_m)[1] > 0 else 0.0


def _lamps(road: Road) -> list[Lamp]:
    """Return lamps on alternating sides, away from side streets and the crossing."""
    found = []
    for number in range(int((road.length_m + BEYOND_M) / _LAMP_EVERY_M)):
        station_m, side = 8.0 + _LAMP_EVERY_M * number, 1.0 if number % 2 else -1.0
        if abs(station_m - road.crossing_m) < 3.0 or any(
            abs(station_m - junction.station_m) < road.kerb_m + 3.0 for junction in road.junctions
        ):
            continue
        x_m, y_m, yaw_rad = road.centre.pose_at(station_m, side * (road.kerb_m + 0.4))
        found.append(Lamp(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad - side * math.pi / 2))
    return found


def _traffic_lights(road: Road) -> list[TrafficLight]:
    """Return the traffic lights: at each stop line, to the right of the traffic that stops there."""
    return [light for junction in road.junctions if junction.lit for light in _lights_of(road, junction)]


def _lights_of(road: Road, junction: Junction) -> list[TrafficLight]:
    lights = []
    arms = (
        (math.pi, True, SignalGroup.MAIN),
        (0.0, True, SignalGroup.MAIN),
        (-math.pi / 2, junction.right, SignalGroup.SIDE),
        (math.pi / 2, junction.left, SignalGroup.SIDE),
    )
    out_m, aside_m = road.stop_line_before_junction_m, road.kerb_m + _POST_FROM_KERB_M
    for turn_rad, exists, group in arms:
        if exists:
            yaw_rad = junction.yaw_rad + turn_rad
            cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
            # Who comes in has the direction out of the junction behind, and its left on the right.
            x_m = junction.x_m + out_m * cosine - aside_m * sine
            y_m = junction.y_m + out_m * sine + aside_m * cosine
            lights.append(TrafficLight(group=group, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad))
    return lights

"""The worlds whose drives can be exported, rebuilt from the drive's specification where the trace is incomplete.

A trace has the motion of all road users. Heights of bodies, lanes, lights and weather follow from the specification.
Bodies whose axles the world does not model have a wheelbase of 60% of their length, as the ego has.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate, pairwise
from typing import Final, TypeAlias

import numpy as np

from brink.scenarios.exportable import ENCOUNTER_SIMULATORS, STREET_SIMULATORS, check_exportable
from brink.scenarios.network import FlatGround, Ground, RoadNetwork
from brink.scenarios.street_network import street_network
from brink.scenarios.urban_network import UrbanGround, reach_of, urban_network
from brink.sim.aeb.specification import AebScenario
from brink.sim.aeb.street import END_M, LANE_Y_M, Actor, make_street
from brink.sim.encounter.specification import EncounterScenario
from brink.sim.episode import EpisodeSpec
from brink.sim.rendering.scene import BodyKind as RenderedKind
from brink.sim.trace import Trace
from brink.sim.world.ego import EGO_CAR
from brink.sim.world.line import ReferenceLine
from brink.sim.world.pedestrians import PERSON_HEIGHT_M
from brink.sim.world.road import Road, SignalPlan, build_road, ego_route
from brink.sim.world.scenario import TimeOfDay, UrbanScenario, Weather
from brink.sim.world.scenery import fixtures
from brink.sim.world.vehicle import CAR, VAN
from brink.sim.world.world import signal_plan

WHEELBASE_SHARE: Final = EGO_CAR.wheelbase_m / EGO_CAR.length_m
WAYPOINT_EVERY_M: Final = 20.0

Pose: TypeAlias = tuple[float, float, float]
"""x_m, y_m and yaw_rad."""


class BodyKind(StrEnum):
    """Kind of a body."""

    CAR = "car"
    VAN = "van"
    PEDESTRIAN = "pedestrian"
    OBSTACLE = "obstacle"


@dataclass(frozen=True, slots=True, kw_only=True)
class Dimensions:
    """The dimensions of a road user or an obstacle."""

    kind: BodyKind
    length_m: float
    width_m: float
    height_m: float

    @property
    def wheelbase_m(self) -> float:
        """Distance between the axles; 0 if it has none."""
        return WHEELBASE_SHARE * self.length_m if self.kind in (BodyKind.CAR, BodyKind.VAN) else 0.0

    @property
    def reference_m(self) -> float:
        """Distance from the standard's reference point, a vehicle's rear axle, forward to the body's centre."""
        return 0.5 * self.wheelbase_m


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportWorld:
    """The world of a drive.

    Attributes:
        network: The roads.
        ground: The height of the ground.
        time_of_day: Time of day.
        weather: Weather.
        signals: The traffic lights; None without any.
        route: Points along the ego's route, the goal last.
        bodies: Bodies of the road users, by their names in the trace.
        parked: Parked vehicles, by name.
    """

    network: RoadNetwork
    ground: Ground
    time_of_day: TimeOfDay
    weather: Weather
    signals: SignalPlan | None
    route: tuple[Pose, ...]
    bodies: Mapping[str, Dimensions]
    parked: Mapping[str, tuple[Dimensions, Pose]]


def spec_of(trace: Trace) -> EpisodeSpec:
    """Return the specification of a recorded drive.

    Raises:
        NotExportable: Its world has no roads that can be exported.
    """
    document = trace.about.get("spec")
    simulator = document.get("simulator") if isinstance(document, Mapping) else None
    check_exportable(simulator if isinstance(simulator, str) else None)
    assert isinstance(document, Mapping)
    return EpisodeSpec.from_json(document)


def world_of(trace: Trace) -> ExportWorld:
    """Return the world of a recorded drive.

    Raises:
        NotExportable: It has no roads that can be exported.
        InvalidEpisode: The specification in the trace is invalid.
    """
    spec = spec_of(trace)
    if spec.simulator in STREET_SIMULATORS:
        return _street_world(AebScenario.from_json(spec.scenario), spec.seed, trace)
    if spec.simulator in ENCOUNTER_SIMULATORS:
        return _urban_world(EncounterScenario.from_json(spec.scenario).place, spec.seed, trace)
    return _urban_world(UrbanScenario.from_json(spec.scenario), spec.seed, trace)


def _positions(trace: Trace) -> list[tuple[float, float]]:
    """Return all positions of all road users."""
    places = np.concatenate([trace.ego[:, :2], *(actor.motion[:, :2] for actor in trace.actors)])
    return [(x_m, y_m) for x_m, y_m in places[np.isfinite(places).all(axis=1)].tolist()]


def _urban_world(scenario: UrbanScenario, seed: int, trace: Trace) -> ExportWorld:
    road = build_road(scenario.road_curve, scenario.road_id, scenario.road_length)
    return ExportWorld(
        network=urban_network(road, reach_of(road, _positions(trace))),
        ground=UrbanGround(road),
        time_of_day=scenario.time_of_day,
        weather=scenario.weather,
        signals=signal_plan(scenario, seed) if road.junctions[0].lit else None,
        route=waypoints(ego_route(road, scenario.driving_task).line),
        bodies={actor.name: _urban_body(actor.kind, actor.length_m, actor.width_m) for actor in trace.actors},
        parked=_parked_cars(road),
    )


def _urban_body(kind: str, length_m: float, width_m: float) -> Dimensions:
    if kind == "pedestrian":
        return Dimensions(
            kind=BodyKind.PEDESTRIAN, length_m=length_m, width_m=width_m, height_m=PERSON_HEIGHT_M
        )
    van = length_m > 0.5 * (CAR.length_m + VAN.length_m)
    return Dimensions(
        kind=BodyKind.VAN if van else BodyKind.CAR,
        length_m=length_m,
        width_m=width_m,
        height_m=(VAN if van else CAR).height_m,
    )


def _parked_cars(road: Road) -> Mapping[str, tuple[Dimensions, Pose]]:
    cars = [one for one in fixtures(road) if one.kind == "parked-car"]
    return {
        f"parked-{index}": (
            Dimensions(kind=BodyKind.CAR, length_m=one.length_m, width_m=one.width_m, height_m=one.height_m),
            (one.x_m, one.y_m, one.yaw_rad),
        )
        for index, one in enumerate(cars, start=1)
    }


def waypoints(line: ReferenceLine) -> tuple[Pose, ...]:
    """Return the ends of a line's straights and arcs, and points between them at most `WAYPOINT_EVERY_M` apart."""
    ends_m = [0.0, *accumulate(piece.length_m for piece in line.pieces)]
    stations_m = [0.0]
    for from_m, to_m in pairwise(ends_m):
        count = max(1, int(np.ceil((to_m - from_m) / WAYPOINT_EVERY_M)))
        stations_m += [from_m + (to_m - from_m) * index / count for index in range(1, count + 1)]
    apart = [at_m for at_m, next_m in pairwise(stations_m) if next_m - at_m > 0.1]
    return tuple(line.pose_at(station_m) for station_m in (*apart, stations_m[-1]))


def _street_world(scenario: AebScenario, seed: int, trace: Trace) -> ExportWorld:
    street = make_street(scenario, seed)
    along_m = [x_m for x_m, _ in _positions(trace)]
    parked = {
        f"parked-{index}": (
            _vehicle(one.length_m, one.width_m, one.height_m),
            (one.x_m, one.y_m, one.yaw_rad),
        )
        for index, one in enumerate(street.scene.parked, start=1)
    }
    return ExportWorld(
        network=street_network(street, min(along_m), max(along_m)),
        ground=FlatGround(),
        time_of_day=scenario.time_of_day,
        weather=scenario.weather,
        signals=None,
        route=((0.0, LANE_Y_M, 0.0), (END_M, LANE_Y_M, 0.0)),
        bodies=_street_bodies(street.actors),
        parked=parked,
    )


def _street_bodies(actors: Sequence[Actor]) -> Mapping[str, Dimensions]:
    return {
        actor.name: _vehicle(actor.body.length_m, actor.body.width_m, actor.body.height_m)
        if actor.body.kind is RenderedKind.VEHICLE
        else Dimensions(
            kind=BodyKind.PEDESTRIAN if actor.body.kind is RenderedKind.PERSON else BodyKind.OBSTACLE,
            length_m=actor.body.length_m,
            width_m=actor.body.width_m,
            height_m=actor.body.height_m,
        )
        for actor in actors
    }


def _vehicle(length_m: float, width_m: float, height_m: float) -> Dimensions:
    kind = BodyKind.VAN if length_m >= VAN.length_m else BodyKind.CAR
    return Dimensions(kind=kind, length_m=length_m, width_m=width_m, height_m=height_m)

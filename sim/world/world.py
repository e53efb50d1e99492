"""The world of one episode: the road, all road users except the ego, and their common clock."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

from brink.sim.driving.camera import Solid
from brink.sim.driving.interface import CONTROL_STEP_S, ObstacleLabel
from brink.sim.driving.visibility import Screens
from brink.sim.plane import Rectangle
from brink.sim.world.ego import EgoCar, EgoMotion, MakeEgo
from brink.sim.world.pedestrians import PERSON_HEIGHT_M, Phase, Walker, make_people
from brink.sim.world.road import (
    CYCLE_S,
    LaneRoute,
    Road,
    SignalPlan,
    build_road,
    ego_route,
    exit_junction,
    turn_begins_m,
)
from brink.sim.world.scenario import DrivingTask, UrbanScenario
from brink.sim.world.scenery import fixtures
from brink.sim.world.streams import Stream, generator
from brink.sim.world.traffic import Surroundings, make_traffic
from brink.sim.world.vehicle import Mover, Vehicle, VehicleSize
from brink.sim.world.weather import Conditions, conditions

START_SPEED_MPS = 6.0
EGO_STEPS = 5
"""100 Hz steps of the ego per step of the world."""


class RoadUser(Mover, Protocol):
    """A road user other than the ego. Mutable."""

    name: str


class OtherVehicle(RoadUser, Protocol):
    """A vehicle with its dimensions and its acceleration along its heading in the last step, or another body."""

    size: VehicleSize
    accel_mps2: float

    @property
    def is_vehicle(self) -> bool:
        """Whether it is a vehicle."""


class World(Protocol):
    """The world of an episode as the loop, the camera and the recorder see it. Its members are mutable."""

    @property
    def road(self) -> Road:
        """The road."""

    @property
    def route(self) -> LaneRoute:
        """The ego's route."""

    @property
    def weather(self) -> Conditions:
        """The driving conditions."""

    @property
    def signals(self) -> SignalPlan | None:
        """The traffic lights; None except at a crossroads."""

    @property
    def ego(self) -> EgoMotion:
        """The car under test."""

    @property
    def vehicles(self) -> Sequence[OtherVehicle]:
        """All other vehicles."""

    @property
    def walkers(self) -> Sequence[RoadUser]:
        """All pedestrians."""

    @property
    def leaves_road_m(self) -> float:
        """Station at which the ego's route leaves the road."""

    def advance(self, step: int) -> None:
        """Advance all road users except the ego by `CONTROL_STEP_S`; steps count from 0."""

    def grade_at(self, station_m: float) -> float:
        """Return the slope of the ego's route at a station."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanWorld:
    """The world of an urban episode.

    Attributes:
        road: The road.
        route: The ego's route.
        weather: The driving conditions.
        signals: The traffic lights; None except at a crossroads.
        ego: The car under test.
        vehicles: All other vehicles, the lead vehicle first.
        walkers: All pedestrians.
        movers: The ego and the vehicles.
        leaves_road_m: Station at which the ego's route leaves the road.
    """

    road: Road
    route: LaneRoute
    weather: Conditions
    signals: SignalPlan | None
    ego: EgoMotion
    vehicles: tuple[Vehicle, ...]
    walkers: tuple[Walker, ...]
    movers: tuple[Mover, ...]
    leaves_road_m: float

    def advance(self, step: int) -> None:
        """Advance all road users except the ego by `CONTROL_STEP_S`.

        Args:
            step: Number of the step, from 0.
        """
        time_s = step * CONTROL_STEP_S
        in_the_way: list[Mover] | None = None
        for vehicle in self.vehicles:
            if vehicle.looks_at(step):
                if in_the_way is None:
                    crossing = [walker for walker in self.walkers if walker.phase is Phase.CROSSING]
                    in_the_way = [*self.movers, *crossing]
                vehicle.look(time_s, in_the_way)
        for vehicle in self.vehicles:
            vehicle.move(time_s, CONTROL_STEP_S)
        if step % 2 == 0:
            turn = step // 2 % 2
            for index, walker in enumerate(self.walkers):
                if index % 2 == turn:
                    walker.look(time_s, self.movers)
                walker.move()

    def grade_at(self, station_m: float) -> float:
        """Return the slope of the ego's route at a station; the road may slope, its side streets are level."""
        return self.road.style.grade if station_m < self.leaves_road_m else 0.0


def make_world(scenario: UrbanScenario, seed: int, make_ego: MakeEgo = EgoCar) -> UrbanWorld:
    """Return the world of an episode at time 0.

    Args:
        scenario: Parameters of the world.
        seed: The episode's seed.
        make_ego: Creates the ego, and so selects its motion model.
    """
    road = build_road(scenario.road_curve, scenario.road_id, scenario.road_length)
    route = ego_route(road, scenario.driving_task)
    weather = conditions(scenario.time_of_day, scenario.weather)
    signals = signal_plan(scenario, seed) if road.junctions[0].lit else None
    start = generator(seed, Stream.START)
    ego = make_ego(
        route.pose_at(0.0, float(start.normal(0.0, 0.05))), START_SPEED_MPS, friction=weather.friction
    )
    around = Surroundings(signals=signals, movers=[], walkers=[])
    task = scenario.driving_task
    exit_right = None if task is DrivingTask.FOLLOW_ROAD else task is DrivingTask.FIRST_EXIT
    vehicles = tuple(make_traffic(road, weather, around, seed=seed, exit_right=exit_right))
    walkers = make_people(road, weather, signals, count=scenario.pedestrians, seed=seed, task=task)
    movers: tuple[Mover, ...] = (ego, *vehicles)
    around.movers.extend(movers)
    around.walkers.extend(walkers)
    return UrbanWorld(
        road=road,
        route=route,
        weather=weather,
        signals=signals,
        ego=ego,
        vehicles=vehicles,
        walkers=tuple(walkers),
        movers=movers,
        leaves_road_m=leaves_road_m(road, task),
    )


def leaves_road_m(road: Road, task: DrivingTask) -> float:
    """Return the station at which the ego's route leaves the road; infinite if it stays on it."""
    if task is DrivingTask.FOLLOW_ROAD:
        return math.inf
    right = task is DrivingTask.FIRST_EXIT
    return turn_begins_m(exit_junction(road, right=right).forward_m, road.style.lane_width_m, right=right)


def signal_plan(scenario: UrbanScenario, seed: int) -> SignalPlan:
    """Return the traffic-light plan; each crossroads has its own cycle offset, which the seed varies slightly."""
    offset_s = 0.19 * CYCLE_S * (3 * scenario.road_id + scenario.road_length)
    drift_s = float(generator(seed, Stream.SIGNALS).normal(0.0, 0.6))
    return SignalPlan(phase_s=(offset_s + drift_s) % CYCLE_S)


@lru_cache(maxsize=64)
def screens_of(road: Road) -> Screens:
    """Return the buildings, parked cars and trees of a road, which hide road users from the camera."""
    still = fixtures(road)
    return Screens([Rectangle.of(fixture) for fixture in still], [fixture.height_m for fixture in still])


def bodies_of(world: World) -> list[Solid]:
    """Return the bodies of all vehicles, then of all pedestrians, as the camera sees them."""
    bodies = [
        Solid(
            ObstacleLabel.VEHICLE,
            vehicle.x_m,
            vehicle.y_m,
            vehicle.yaw_rad,
            vehicle.length_m,
            vehicle.width_m,
            vehicle.size.height_m,
        )
        for vehicle in world.vehicles
    ]
    bodies += [
        Solid(
            ObstacleLabel.PERSON,
            walker.x_m,
            walker.y_m,
            walker.yaw_rad,
            walker.length_m,
            walker.width_m,
            PERSON_HEIGHT_M,
        )
        for walker in world.walkers
    ]
    return bodies

"""The world of an encounter: an urban road with its lights, the ego, and scripted road users.

Scripted road users do not react to the ego. A vehicle that would hit another scripted vehicle or a person proceeds
through its script more slowly until there is room again: its actions stay the same, their timing changes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from brink.sim.driving.interface import CONTROL_STEP_S
from brink.sim.encounter.specification import EncounterScenario, Kind, Script, Stretch
from brink.sim.world.ego import EGO_CAR, CarModel, EgoCar, EgoMotion
from brink.sim.world.line import ReferenceLine
from brink.sim.world.pedestrians import PERSON_LENGTH_M, PERSON_WIDTH_M
from brink.sim.world.road import LaneRoute, Road, SignalPlan, build_road, ego_route
from brink.sim.world.scenario import DrivingTask
from brink.sim.world.streams import Stream, generator
from brink.sim.world.vehicle import CAR, VAN, VehicleSize
from brink.sim.world.weather import Conditions, conditions
from brink.sim.world.world import START_SPEED_MPS, RoadUser, leaves_road_m, signal_plan

SIZES: Final = {
    Kind.CAR: CAR,
    Kind.VAN: VAN,
    Kind.PEDESTRIAN: VehicleSize(PERSON_LENGTH_M, PERSON_WIDTH_M, 1.75),
}
STANDSTILL_M: Final = 1.5
HEADWAY_S: Final = 0.7
BRAKES_MPS2: Final = 6.0
PULLS_AWAY_MPS2: Final = 2.5
SIDE_M: Final = 0.3
_LOOKS_EVERY_STEPS: Final = 2


class ScriptedUser:
    """A road user that follows a script. Stateful; created for each episode.

    Args:
        name: Unique in the episode.
        script: Its script.
        line: Centre line of the ego's first lane, along which stations run.
    """

    is_vehicle: ClassVar = True
    __slots__ = (
        "_line",
        "_pace",
        "_script",
        "_script_s",
        "accel_mps2",
        "kind",
        "length_m",
        "name",
        "size",
        "speed_mps",
        "width_m",
        "x_m",
        "y_m",
        "yaw_rad",
    )

    def __init__(self, name: str, script: Script, line: ReferenceLine) -> None:
        self.name = name
        self.kind = script.kind
        self.size = SIZES[script.kind]
        self.length_m = self.size.length_m
        self.width_m = self.size.width_m
        self._script = script
        self._line = line
        self._script_s = 0.0
        self._pace = 1.0
        self.accel_mps2 = 0.0
        self._place()

    @property
    def stretch(self) -> Stretch:
        """The current stretch of the script."""
        return self._script.stretch_at(self._script_s)

    def _place(self) -> None:
        s_m, d_m, heading_rad, speed_mps = self.stretch.at(self._script_s)
        self.x_m, self.y_m, along_rad = self._line.pose_at(s_m, d_m)
        self.yaw_rad = along_rad + heading_rad
        self.speed_mps = speed_mps * self._pace

    def advance(self, step: int, dt_s: float, others: Sequence[RoadUser]) -> None:
        """Advance by one step; only vehicles react to others.

        Args:
            step: Number of the step.
            dt_s: Length of the step.
            others: All scripted road users.
        """
        if self.kind is not Kind.PEDESTRIAN:
            self._adapt_pace(step, dt_s, others)
        self._script_s += self._pace * dt_s
        before_mps = self.speed_mps
        self._place()
        self.accel_mps2 = (self.speed_mps - before_mps) / dt_s

    def _adapt_pace(self, step: int, dt_s: float, others: Sequence[RoadUser]) -> None:
        scripted_mps = self.stretch.at(self._script_s)[3]
        if scripted_mps < 0.1:
            self._pace = 1.0
            return
        if step % _LOOKS_EVERY_STEPS:
            return
        blocked = any(self._must_slow_for(other) for other in others if other is not self)
        change = _LOOKS_EVERY_STEPS * dt_s / scripted_mps
        if blocked:
            self._pace = max(0.0, self._pace - BRAKES_MPS2 * change)
        else:
            self._pace = min(1.0, self._pace + PULLS_AWAY_MPS2 * change)

    def _must_slow_for(self, other: RoadUser) -> bool:
        """Return whether another road user is so close ahead in this vehicle's path that it must slow down."""
        dx, dy = other.x_m - self.x_m, other.y_m - self.y_m
        cos_yaw, sin_yaw = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        ahead_m = dx * cos_yaw + dy * sin_yaw
        if ahead_m <= 0.0:
            return False
        turn = other.yaw_rad - self.yaw_rad
        cos_turn, sin_turn = abs(math.cos(turn)), abs(math.sin(turn))
        across_m = abs(dy * cos_yaw - dx * sin_yaw)
        half_across_m = 0.5 * (self.width_m + cos_turn * other.width_m + sin_turn * other.length_m)
        if across_m > half_across_m + SIDE_M:
            return False
        half_along_m = 0.5 * (self.length_m + cos_turn * other.length_m + sin_turn * other.width_m)
        slower_mps = max(0.0, self.speed_mps - other.speed_mps * math.cos(turn))
        room_m = (
            STANDSTILL_M + HEADWAY_S * self.speed_mps * 0.5 + slower_mps * slower_mps / (2.0 * BRAKES_MPS2)
        )
        return ahead_m - half_along_m < room_m


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterWorld:
    """The world of an encounter; its members are stateful.

    Attributes:
        road: The road.
        route: The ego's route.
        weather: Effects of time of day and weather.
        signals: The traffic lights at a crossroad.
        ego: The car under test.
        vehicles: Scripted vehicles.
        walkers: Scripted people.
        road_users: All scripted road users, in the order of their scripts.
        leaves_road_m: Station at which the ego's route leaves the road.
    """

    road: Road
    route: LaneRoute
    weather: Conditions
    signals: SignalPlan | None
    ego: EgoMotion
    vehicles: Sequence[ScriptedUser]
    walkers: Sequence[ScriptedUser]
    road_users: Sequence[ScriptedUser]
    leaves_road_m: float

    def advance(self, step: int) -> None:
        """Advance all scripted road users by one step."""
        for user in self.road_users:
            user.advance(step, CONTROL_STEP_S, self.road_users)

    def grade_at(self, station_m: float) -> float:
        """Return the grade of the ego's route at a station; only the main road slopes."""
        return self.road.style.grade if station_m < self.leaves_road_m else 0.0


def make_encounter(scenario: EncounterScenario, seed: int, car: CarModel = EGO_CAR) -> EncounterWorld:
    """Return the world of an encounter at time 0.

    Args:
        scenario: The scenario.
        seed: The episode's seed, for the ego's initial offset and the traffic lights.
        car: The ego's car.
    """
    place = scenario.place
    road = build_road(place.road_curve, place.road_id, place.road_length)
    route = ego_route(road, DrivingTask(place.driving_task))
    weather = conditions(place.time_of_day, place.weather)
    start = generator(seed, Stream.START)
    road_users = tuple(
        ScriptedUser(f"{script.kind.value}-{index}", script, road.forward)
        for index, script in enumerate(scenario.road_users, start=1)
    )
    return EncounterWorld(
        road=road,
        route=route,
        weather=weather,
        signals=signal_plan(place, seed) if road.junctions[0].lit else None,
        ego=EgoCar(
            route.pose_at(0.0, float(start.normal(0.0, 0.05))),
            START_SPEED_MPS,
            friction=weather.friction,
            model=car,
        ),
        vehicles=tuple(user for user in road_users if user.kind is not Kind.PEDESTRIAN),
        walkers=tuple(user for user in road_users if user.kind is Kind.PEDESTRIAN),
        road_users=road_users,
        leaves_road_m=leaves_road_m(road, place.driving_task),
    )

"""Owns the world of an encounter: an urban road with its lights, the ego, and scripted road users."""

from collections.abc import Sequence
from dataclasses import dataclass

from brink.sim.encounter.road_users import ScriptedUser
from brink.sim.encounter.scenario import EncounterScenario
from brink.sim.encounter.script import Kind
from brink.sim.world.ego import EgoCar, EgoMotion
from brink.sim.world.road import LaneRoute, Road, SignalPlan, build_road, ego_route
from brink.sim.world.scenario import DrivingTask
from brink.sim.world.streams import Stream, generator
from brink.sim.world.weather import Conditions, conditions
from brink.sim.world.world import START_SPEED_MPS, STEP_S, leaves_road_m, signal_plan


@dataclass(frozen=True, slots=True, kw_only=True)
class EncounterWorld:
    """Everything that an encounter is about. Its members change in place.

    Attributes:
        road: Where it is.
        route: Where the ego is to go.
        weather: What time of day and weather amount to.
        signals: The traffic lights, at a crossroad.
        ego: The car under test.
        vehicles: Scripted vehicles.
        walkers: Scripted people.
        everybody: Both, in the order of their scripts.
        leaves_road_m: Station at which the ego's route leaves the road.
    """

    road: Road
    route: LaneRoute
    weather: Conditions
    signals: SignalPlan | None
    ego: EgoMotion
    vehicles: Sequence[ScriptedUser]
    walkers: Sequence[ScriptedUser]
    everybody: Sequence[ScriptedUser]
    leaves_road_m: float

    def advance(self, step: int) -> None:
        """Let everybody but the ego go on by one step of the world."""
        for user in self.everybody:
            user.advance(step, STEP_S, self.everybody)

    def grade_at(self, station_m: float) -> float:
        """Return how steep the ego's route is; the road slopes, its side streets do not."""
        return self.road.style.grade if station_m < self.leaves_road_m else 0.0


def make_encounter(scenario: EncounterScenario, seed: int) -> EncounterWorld:
    """Return the world of an encounter at time 0.

    Args:
        scenario: What it is.
        seed: The episode's seed: where in its lane the ego starts, and when lights change.
    """
    place = scenario.place
    road = build_road(place.road_curve, place.road_id, place.road_length)
    route = ego_route(road, DrivingTask(place.driving_task))
    weather = conditions(place.time_of_day, place.weather)
    start = generator(seed, Stream.START)
    everybody = tuple(
        ScriptedUser(f"{script.kind.value}-{index}", script, road.forward)
        for index, script in enumerate(scenario.road_users, start=1)
    )
    return EncounterWorld(
        road=road,
        route=route,
        weather=weather,
        signals=signal_plan(place, seed) if road.junctions[0].lit else None,
        ego=EgoCar(
            route.pose_at(0.0, float(start.normal(0.0, 0.05))), START_SPEED_MPS, friction=weather.friction
        ),
        vehicles=tuple(user for user in everybody if user.kind is not Kind.PEDESTRIAN),
        walkers=tuple(user for user in everybody if user.kind is Kind.PEDESTRIAN),
        everybody=everybody,
        leaves_road_m=leaves_road_m(road, place.driving_task),
    )

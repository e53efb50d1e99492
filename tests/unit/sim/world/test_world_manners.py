"""How road users treat each other in whole worlds."""

import itertools
import math
from dataclasses import replace

import pytest

from brink.sim.driving.interface import LightState
from brink.sim.urban.scenario import DrivingTask, RoadCurve, TimeOfDay, UrbanScenario, Weather
from brink.sim.world.traffic import lane_is_free
from brink.sim.world.vehicle import CAR, Manner, Vehicle
from brink.sim.world.walker import Phase
from brink.sim.world.world import STEP_S, UrbanWorld, make_world

SCENARIO = UrbanScenario(
    time_of_day=TimeOfDay.NOON,
    weather=Weather.CLEAR,
    pedestrians=18,
    road_curve=RoadCurve.STRAIGHT,
    road_id=1,
    road_length=2,
    driving_task=DrivingTask.FOLLOW_ROAD,
)


def far_away_ego(world: UrbanWorld) -> None:
    """Take the ego out of everybody's way."""
    world.ego.x_m -= 1000.0
    world.ego.speed_mps = 0.0


def parked(x_m: float, y_m: float, speed_mps: float = 0.0, yaw_rad: float = 0.0) -> Vehicle:
    manner = Manner(speed_mps=8.0, headway_s=1.2, firmness_mps2=2.8, friction=0.9)
    world = make_world(SCENARIO, 1)
    one = Vehicle(
        name="x", size=CAR, path=world.road.forward, station_m=0.0, speed_mps=speed_mps, manner=manner
    )
    one.x_m, one.y_m, one.yaw_rad = x_m, y_m, yaw_rad
    return one


def test_nobody_drives_over_the_crossing_while_somebody_walks_there() -> None:
    for seed, road_id in itertools.product(range(2), range(3)):
        world = make_world(replace(SCENARIO, road_id=road_id), seed)
        far_away_ego(world)
        waited = False
        for step in range(600):
            world.advance(step)
            on_zebra = [w for w in world.walkers if w.on_zebra and w.phase is Phase.CROSSING]
            for vehicle, person in itertools.product(world.vehicles, on_zebra):
                apart_m = math.hypot(vehicle.x_m - person.x_m, vehicle.y_m - person.y_m)
                assert apart_m > 1.0 or vehicle.speed_mps < 1.0, (vehicle.name, person.name, step)
                waited = waited or (apart_m < 12.0 and vehicle.speed_mps < 0.1)
        assert waited


def test_people_without_a_light_reach_the_other_side() -> None:
    world = make_world(SCENARIO, 2)
    far_away_ego(world)
    sides = {walker.name: math.copysign(1.0, walker.offset_m) for walker in world.walkers}
    for step in range(600):
        world.advance(step)
    crossed = [walker for walker in world.walkers if walker.offset_m * sides[walker.name] < -3.0]
    assert len(crossed) >= 4


def test_drivers_at_lights_enter_only_on_green_or_amber() -> None:
    for seed, road_id in itertools.product(range(2), range(3)):
        world = make_world(
            replace(SCENARIO, road_curve=RoadCurve.CROSSROAD, road_id=road_id, pedestrians=0), seed
        )
        far_away_ego(world)
        assert world.signals is not None
        fronts: dict[str, float] = {}
        for step in range(600):
            world.advance(step)
            for vehicle in world.vehicles:
                if vehicle.name == "local" or not vehicle.stops:
                    continue
                line_m = vehicle.stops[0].station_m
                front_m = vehicle.station_m + 0.5 * vehicle.length_m
                before_m = fronts.get(vehicle.name, front_m)
                fronts[vehicle.name] = front_m
                if before_m <= line_m + 1.0 < front_m and vehicle.name.startswith(("oncoming", "crossing")):
                    on_side = vehicle.name.startswith("crossing")
                    state = world.signals.side_at if on_side else world.signals.main_at
                    assert state(step * STEP_S) is not LightState.RED, (vehicle.name, step * STEP_S)


def test_a_car_joins_only_where_there_is_a_gap() -> None:
    for seed in range(4):
        world = make_world(replace(SCENARIO, pedestrians=0), seed)
        joining = next(v for v in world.vehicles if v.name == "joining")
        lane_y = world.road.forward.pose_at(0.0)[1]
        joined = False
        for step in range(600):
            world.ego.x_m += world.ego.speed_mps * STEP_S
            world.advance(step)
            if not joined and abs(joining.y_m - lane_y) < 0.5 * CAR.width_m:
                joined = True
                behind = [
                    (joining.x_m - other.x_m, other.speed_mps)
                    for other in world.movers
                    if other is not joining and abs(other.y_m - lane_y) < 1.0 and other.x_m < joining.x_m
                ]
                assert all(gap_m > 4.5 + 0.5 * speed for gap_m, speed in behind), (seed, behind)
        assert joined


@pytest.mark.parametrize(
    ("other", "free"),
    [
        (parked(-30.0, 0.0, 8.0), False),
        (parked(-50.0, 0.0, 8.0), True),
        (parked(-30.0, 0.0, 0.0), True),
        (parked(3.0, 0.0), False),
        (parked(3.0, 3.2), True),
        (parked(30.0, 0.0, 8.0), True),
        (parked(20.0, 3.2, 8.0, math.pi), True),
    ],
    ids=["coming", "too far", "standing", "there", "on the other lane", "gone", "oncoming"],
)
def test_a_lane_is_free_unless_somebody_on_it_is_about_to_be_there(other: Vehicle, free: bool) -> None:
    asking = parked(0.0, -6.0)
    assert lane_is_free([other, asking], asking, 0.0, 0.0, 0.0) is free


def test_the_lead_slows_down_again_and_again() -> None:
    world = make_world(replace(SCENARIO, road_id=0, pedestrians=0), 4)
    lead = world.vehicles[0]
    speeds = []
    for step in range(560):
        world.advance(step)
        speeds.append(lead.speed_mps)
    assert max(speeds) > 7.5
    dips = sum(a >= 6.0 > b for a, b in itertools.pairwise(speeds))
    assert dips >= 2

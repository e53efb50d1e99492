import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.bullet.engine import Block, Engine, process_engine
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.requirements import CollisionKind
from brink.sim.urban.facts import Facts
from brink.sim.world.pedestrians import Phase
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, UrbanScenario, Weather
from brink.sim.world.world import UrbanWorld, make_world

SCENARIO = UrbanScenario(
    time_of_day=TimeOfDay.NOON,
    weather=Weather.CLEAR,
    pedestrians=18,
    road_curve=RoadCurve.STRAIGHT,
    road_id=1,
    road_length=1,
    driving_task=DrivingTask.FOLLOW_ROAD,
)


@pytest.fixture(name="engine")
def _engine() -> Engine:
    engine = process_engine()
    engine.reset()
    return engine


@pytest.fixture(name="world")
def _world() -> UrbanWorld:
    """Return a world in which everybody except the ego is far away."""
    world = make_world(SCENARIO, seed=1)
    for vehicle in world.vehicles:
        vehicle.x_m, vehicle.speed_mps = vehicle.x_m + 5000.0, 0.0
    for walker in world.walkers:
        walker.x_m, walker.speed_mps = walker.x_m + 5000.0, 0.0
    return world


def car(x_m: float, y_m: float = 0.0, yaw_rad: float = 0.0) -> Block:
    return Block(length_m=4.0, width_m=2.0, height_m=1.5, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)


def test_clearances_are_exact(engine: Engine) -> None:
    one, ahead, beside, turned, over = engine.add_blocks(
        [car(0.0), car(9.0), car(0.0, 3.5), car(8.0, 0.0, 0.5 * math.pi), car(3.5)]
    )
    for other, expected_m in ((ahead, 5.0), (beside, 1.5), (turned, 5.0), (over, -0.5)):
        found = engine.closest(one, other, 50.0)
        assert found is not None
        assert found.clearance_m == pytest.approx(expected_m, abs=1e-6)
    assert engine.closest(one, ahead, 4.9) is None


@settings(max_examples=40)
@given(st.floats(-6, 6), st.floats(-6, 6), st.floats(-math.pi, math.pi))
def test_clearance_agrees_with_rectangle_geometry(x_m: float, y_m: float, yaw_rad: float) -> None:
    engine = process_engine()
    engine.reset()
    one, other = engine.add_blocks([car(0.0), car(0.0)])
    engine.move(other, x_m, y_m, yaw_rad, 1.5)
    found = engine.closest(one, other, 50.0)
    assert found is not None
    expected_m = signed_gap_m(Rectangle(0.0, 0.0, 0.0, 2.0, 1.0), Rectangle(x_m, y_m, yaw_rad, 2.0, 1.0))
    if expected_m > 1e-3:
        assert found.clearance_m == pytest.approx(expected_m, abs=2e-3)
    else:
        assert found.clearance_m < 2e-3


def test_front_gap_is_the_bumper_to_bumper_distance_in_corridor(world: UrbanWorld, engine: Engine) -> None:
    ego, lead, oncoming = world.ego, world.vehicles[0], world.vehicles[1]
    facts = Facts(world, engine)
    lead.x_m, lead.y_m, lead.yaw_rad = ego.x_m + 14.0, ego.y_m, 0.0
    oncoming.x_m, oncoming.y_m, oncoming.yaw_rad = ego.x_m + 9.0, ego.y_m + 3.2, math.pi
    sample = facts.measure(0.0)
    assert sample.front_gap_m == pytest.approx(14.0 - 0.5 * (ego.length_m + lead.length_m), abs=1e-4)
    assert sample.collision is None


def test_vehicles_behind_or_beside_the_ego_are_not_ahead(world: UrbanWorld, engine: Engine) -> None:
    ego, one, other = world.ego, world.vehicles[0], world.vehicles[1]
    facts = Facts(world, engine)
    one.x_m, one.y_m, one.yaw_rad = ego.x_m - 8.0, ego.y_m, 0.0
    other.x_m, other.y_m, other.yaw_rad = ego.x_m + 1.0, ego.y_m + 2.5, math.pi
    sample = facts.measure(0.0)
    assert sample.front_gap_m is None
    assert sample.nearest_gap_m == pytest.approx(2.5 - 1.8, abs=1e-4)


def test_a_car_that_passes_beside_an_ego_waiting_to_turn_left_is_not_ahead(engine: Engine) -> None:
    turning = replace(
        SCENARIO, road_curve=RoadCurve.CROSSROAD, driving_task=DrivingTask.SECOND_EXIT, pedestrians=0
    )
    world = make_world(turning, seed=1)
    for vehicle in world.vehicles:
        vehicle.x_m, vehicle.speed_mps = vehicle.x_m + 5000.0, 0.0
    facts = Facts(world, engine)
    ego, oncoming = world.ego, world.vehicles[1]
    turn_m = world.leaves_road_m
    ego.x_m, ego.y_m, ego.yaw_rad = world.route.pose_at(turn_m - 1.0)
    for back_m in (3.0, 0.0, -3.0):
        oncoming.x_m, oncoming.y_m = ego.x_m + 2.25 + 1.0 + back_m, ego.y_m + 3.3
        oncoming.yaw_rad = math.pi
        front_m = facts.measure(0.0).front_gap_m
        assert front_m is None or front_m > 1.5
    oncoming.x_m, oncoming.y_m = ego.x_m + 2.25 + 3.0, ego.y_m + 1.0
    front_m = facts.measure(0.0).front_gap_m
    assert front_m is not None
    assert front_m < 1.5


def test_a_rear_end_collision_counts_for_the_ego(world: UrbanWorld, engine: Engine) -> None:
    ego, lead = world.ego, world.vehicles[0]
    facts = Facts(world, engine)
    ego.speed_mps, lead.speed_mps = 6.0, 2.0
    lead.x_m, lead.y_m, lead.yaw_rad = ego.x_m + 4.4, ego.y_m, 0.0
    sample = facts.measure(0.0)
    assert sample.collision is not None
    assert sample.collision.kind is CollisionKind.VEHICLE
    assert sample.collision.impact_speed_mps == pytest.approx(4.0, abs=0.05)
    assert sample.front_gap_m == 0.0


def test_a_person_walking_into_a_standing_ego_is_no_ego_collision(world: UrbanWorld, engine: Engine) -> None:
    ego, person = world.ego, world.walkers[0]
    facts = Facts(world, engine)
    person.x_m, person.y_m, person.phase, person.speed_mps = ego.x_m, ego.y_m + 1.0, Phase.CROSSING, 1.4
    ego.speed_mps = 0.0
    sample = facts.measure(0.0)
    assert sample.collision is None
    assert sample.pedestrian_gap_m == 0.0
    person.x_m, person.y_m, ego.speed_mps = ego.x_m + 2.3, ego.y_m, 3.0
    sample = facts.measure(0.05)
    assert sample.collision is not None
    assert sample.collision.kind is CollisionKind.PEDESTRIAN


@pytest.mark.parametrize("overlap_m", [0.02, 0.1, 0.3, 0.9])
@pytest.mark.parametrize("phase_m", [0.0, 0.1, 0.2, 0.3, 0.39])
def test_contact_in_motion_is_a_collision(
    world: UrbanWorld, engine: Engine, overlap_m: float, phase_m: float
) -> None:
    """Contact with a person at the corner, a person walking into the side, and a car from the side."""
    ego, person, car = world.ego, world.walkers[0], world.vehicles[0]
    facts = Facts(world, engine)
    ego.speed_mps = 8.0
    at_corner = (
        ego.x_m + 0.5 * ego.length_m + 0.225 - phase_m,
        ego.y_m + 0.5 * ego.width_m + 0.275 - overlap_m,
    )
    person.x_m, person.y_m, person.yaw_rad, person.phase = *at_corner, 0.0, Phase.CROSSING
    hit = facts.measure(0.0).collision
    assert (hit is not None) == (phase_m > 0.0)
    person.x_m, person.y_m, person.speed_mps = ego.x_m, ego.y_m + 0.5 * ego.width_m + 0.2, 1.4
    hit = facts.measure(0.05).collision
    assert hit is not None
    assert hit.kind is CollisionKind.PEDESTRIAN
    person.x_m += 500.0
    car.yaw_rad, car.speed_mps = -0.5 * math.pi, 8.0
    car.x_m, car.y_m = ego.x_m + phase_m, ego.y_m + 0.5 * ego.width_m + 0.5 * car.length_m - overlap_m
    hit = facts.measure(0.1).collision
    assert hit is not None
    assert hit.impact_speed_mps == pytest.approx(8.0 * math.sqrt(2.0), abs=0.01)


@pytest.mark.parametrize("sunk_m", [0.05, 0.2, 0.31, 0.39])
def test_a_vehicle_hit_by_the_ego_is_still_ahead(world: UrbanWorld, engine: Engine, sunk_m: float) -> None:
    ego, lead = world.ego, world.vehicles[0]
    facts = Facts(world, engine)
    ego.speed_mps, lead.speed_mps = 8.0, 0.0
    lead.x_m, lead.y_m = ego.x_m + 0.5 * (ego.length_m + lead.length_m) - sunk_m, ego.y_m
    lead.yaw_rad = 0.0
    sample = facts.measure(0.0)
    assert sample.collision is not None
    assert sample.front_gap_m == 0.0


def test_only_a_person_in_the_way_allows_waiting(world: UrbanWorld, engine: Engine) -> None:
    ego, person = world.ego, world.walkers[0]
    facts = Facts(world, engine)
    for ahead_m, aside_m, waits in (
        (6.0, 1.0, True),
        (-5.0, 1.0, False),
        (6.0, 4.0, False),
        (25.0, 0.0, False),
    ):
        person.x_m, person.y_m = ego.x_m + ahead_m, ego.y_m + aside_m
        assert facts.measure(0.0).may_wait is waits


def test_a_side_street_beyond_the_junction_is_not_a_conflict_area(engine: Engine) -> None:
    turning = replace(SCENARIO, driving_task=DrivingTask.FIRST_EXIT, pedestrians=0)
    world = make_world(turning, seed=1)
    facts = Facts(world, engine)
    ego, in_the_way = world.ego, []
    stations_m = np.arange(world.leaves_road_m, world.route.length_m - 5.0, 1.0)
    for station_m in stations_m:
        ego.x_m, ego.y_m, ego.yaw_rad = world.route.pose_at(float(station_m))
        in_the_way.append(facts.measure(0.0).in_conflict_area)
    assert any(in_the_way[:10])
    assert not any(in_the_way[15:])


def test_an_ego_that_leaves_the_road_hits_an_object(world: UrbanWorld, engine: Engine) -> None:
    ego = world.ego
    facts = Facts(world, engine)
    ego.yaw_rad = -0.5
    hit = None
    for step in range(200):
        ego.speed_mps = 6.0
        ego.drive(0.5, 0.0, 5)
        hit = facts.measure(0.05 * (step + 1)).collision
        if hit is not None:
            break
    assert hit is not None
    assert hit.kind is CollisionKind.OBJECT
    assert hit.counterpart in ("parked-car", "building", "tree")


def test_goal_and_stop_line_are_measured_from_the_front_bumper(engine: Engine) -> None:
    crossroad = replace(SCENARIO, road_curve=RoadCurve.CROSSROAD, pedestrians=0)
    world = make_world(crossroad, seed=1)
    facts = Facts(world, engine)
    (line_m,) = world.route.stop_line_stations_m
    ego = world.ego
    for station_m, expected_m in ((line_m - 10.0, 7.75), (line_m + 1.0, -3.25)):
        ego.x_m, ego.y_m, ego.yaw_rad = world.route.pose_at(station_m)
        sample = facts.measure(0.0)
        assert sample.light is not None
        assert sample.stop_line_gap_m == pytest.approx(expected_m, abs=1e-3)
    ego.x_m, ego.y_m, ego.yaw_rad = world.route.pose_at(line_m + 3.0)
    assert facts.measure(0.0).stop_line_gap_m is None
    ego.x_m, ego.y_m, ego.yaw_rad = world.route.pose_at(world.route.length_m - 2.0)
    assert facts.measure(0.0).goal_reached

"""Single road users, and how they interact in whole worlds."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from brink.sim.driving.interface import CONTROL_STEP_S, LightState
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.pedestrians import (
    HURRY_SHARE,
    KERB_SETBACK_M,
    WALK_ACCEL_MPS2,
    WALKER_STEP_S,
    Phase,
    Walker,
)
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, UrbanScenario, Weather
from brink.sim.world.traffic import lane_is_free
from brink.sim.world.vehicle import CAR, CORNERING_MPS2, DrivingStyle, Mover, StopPoint, Vehicle
from brink.sim.world.world import UrbanWorld, make_world

ROAD = ReferenceLine(0.0, 0.0, 0.0, [Piece(300.0)])
STYLE = DrivingStyle(speed_mps=8.0, headway_s=1.2, braking_mps2=2.8, friction=0.9)
SCENARIO = UrbanScenario(
    time_of_day=TimeOfDay.NOON,
    weather=Weather.CLEAR,
    pedestrians=18,
    road_curve=RoadCurve.STRAIGHT,
    road_id=1,
    road_length=2,
    driving_task=DrivingTask.FOLLOW_ROAD,
)


def vehicle(station_m: float, *, speed_mps: float = 8.0, stops: tuple[StopPoint, ...] = ()) -> Vehicle:
    return Vehicle(
        name=f"at-{station_m}",
        size=CAR,
        path=ROAD,
        station_m=station_m,
        speed_mps=speed_mps,
        style=STYLE,
        stops=stops,
    )


def drive(vehicles: list[Vehicle], seconds: float, others: tuple[Mover, ...] = ()) -> None:
    for step in range(round(seconds / CONTROL_STEP_S)):
        for one in vehicles:
            if one.looks_at(step):
                one.look(step * CONTROL_STEP_S, [*vehicles, *others])
        for one in vehicles:
            one.move(step * CONTROL_STEP_S, CONTROL_STEP_S)


def walker(
    crosses_at_m: float | None,
    *,
    patience_s: float = 1.0,
    on_zebra: bool = False,
    speed_mps: float = 1.3,
    offset_m: float = 5.0,
) -> Walker:
    return Walker(
        name="walker",
        centre=ROAD,
        station_m=40.0,
        offset_m=offset_m,
        speed_mps=speed_mps,
        ahead=True,
        crosses_at_m=crosses_at_m,
        kerb_m=3.5,
        patience_s=patience_s,
        on_zebra=on_zebra,
    )


def test_a_vehicle_stops_behind_a_standing_one() -> None:
    standing = vehicle(80.0, speed_mps=0.0)
    standing.starts_s = 1e9
    behind = vehicle(10.0)
    drive([behind, standing], 30.0)
    gap_m = standing.station_m - behind.station_m - CAR.length_m
    assert behind.speed_mps < 0.1
    assert 1.0 < gap_m < 5.0


def test_a_vehicle_waits_at_its_stop_point_as_long_as_it_has_to() -> None:
    waiting = vehicle(10.0, stops=(StopPoint(60.0, lambda _, time_s: time_s < 20.0),))
    drive([waiting], 19.0)
    front_m = waiting.station_m + 0.5 * CAR.length_m
    assert waiting.speed_mps < 0.1
    assert 57.0 < front_m <= 60.6
    drive([waiting], 40.0)
    assert waiting.station_m > 80.0


def test_a_vehicle_slows_down_before_a_bend() -> None:
    bend = ReferenceLine(0.0, 0.0, 0.0, [Piece(60.0), Piece(10.0, 1 / 7), Piece(60.0)])
    turning = Vehicle(name="t", size=CAR, path=bend, station_m=5.0, speed_mps=8.0, style=STYLE)
    speeds = []
    for step in range(200):
        turning.look(step * CONTROL_STEP_S, [turning])
        turning.move(step * CONTROL_STEP_S, CONTROL_STEP_S)
        if 60.0 <= turning.station_m <= 70.0:
            speeds.append(turning.speed_mps)
    assert speeds
    assert max(speeds) < 5.0


def test_a_walker_walks_to_the_kerb_before_it_waits() -> None:
    on_foot = walker(40.5, patience_s=99.0)
    standing = vehicle(41.0, speed_mps=5.0)
    offsets = [on_foot.offset_m]
    for _ in range(40):
        on_foot.look(0.0, [standing])
        on_foot.move()
        offsets.append(on_foot.offset_m)
    steps = [before_m - after_m for before_m, after_m in itertools.pairwise(offsets)]
    assert max(steps) == pytest.approx(1.3 * WALKER_STEP_S)
    assert min(steps) == 0.0
    assert (on_foot.phase, on_foot.speed_mps) == (Phase.WAITING, 0.0)
    assert on_foot.offset_m == pytest.approx(on_foot.kerb_m + KERB_SETBACK_M)
    assert on_foot.station_m - 40.5 == pytest.approx(0.0, abs=1.3 * WALKER_STEP_S)


@pytest.mark.parametrize("speed_mps", [1.0, 1.3, 1.6])
@pytest.mark.parametrize("to_go_m", [0.15, 0.3, 0.5, 0.77, 1.2])
def test_a_walker_brakes_for_the_kerb_as_hard_as_people_can_at_most(speed_mps: float, to_go_m: float) -> None:
    on_foot = walker(41.0, patience_s=99.0, speed_mps=speed_mps, offset_m=3.5 + KERB_SETBACK_M + to_go_m)
    car = vehicle(41.0, speed_mps=5.0)
    speeds = [on_foot.speed_mps]
    for _ in range(40):
        on_foot.look(0.0, [car])
        on_foot.move()
        speeds.append(on_foot.speed_mps)
    changes = [abs(after - before) for before, after in itertools.pairwise(speeds)]
    assert max(changes) <= WALK_ACCEL_MPS2 * WALKER_STEP_S + 1e-9
    assert (on_foot.phase, on_foot.speed_mps) == (Phase.WAITING, 0.0)
    # Who has too little room for that stops nearer to the kerb, but not on the road.
    assert on_foot.kerb_m < on_foot.offset_m < on_foot.kerb_m + KERB_SETBACK_M + 1e-9
    if to_go_m > 0.6:
        assert on_foot.offset_m == pytest.approx(on_foot.kerb_m + KERB_SETBACK_M)


def crossing_walker(offset_m: float, *, on_zebra: bool = False) -> Walker:
    """Return somebody who walks across the road, from the left to the right."""
    on_foot = walker(40.0, on_zebra=on_zebra)
    on_foot.phase, on_foot.offset_m, on_foot.speed_mps = Phase.CROSSING, offset_m, 1.43
    on_foot.look(0.0, [])
    return on_foot


def meet(on_foot: Walker, car: Vehicle, seconds: float) -> list[tuple[float, float]]:
    """Return the walker's offset and speed at each of its steps, while a car drives on at its speed."""
    seen = [(on_foot.offset_m, on_foot.speed_mps)]
    for step in range(round(seconds / CONTROL_STEP_S)):
        car.move(step * CONTROL_STEP_S, CONTROL_STEP_S)
        if step % 2 == 0:
            if step % 4 == 0:
                on_foot.look(step * CONTROL_STEP_S, [car])
            on_foot.move()
            seen.append((on_foot.offset_m, on_foot.speed_mps))
            assert not touches(car, on_foot), step
    return seen


def touches(car: Vehicle, on_foot: Walker) -> bool:
    return signed_gap_m(Rectangle.of(car), Rectangle.of(on_foot)) <= 0.0


def test_a_person_who_crosses_stops_before_the_path_of_a_car_that_would_hit_it_and_then_goes_on() -> None:
    on_foot, car = crossing_walker(3.4), vehicle(22.0)
    seen = meet(on_foot, car, 2.0)
    assert min(speed for _, speed in seen) == 0.0
    assert 0.5 * CAR.width_m < min(offset for offset, _ in seen) < 2.0
    seen += meet(on_foot, car, 5.0)
    assert on_foot.offset_m == pytest.approx(-5.0, abs=0.5)
    speeds = [speed for _, speed in seen]
    assert max(abs(b - a) for a, b in itertools.pairwise(speeds)) <= WALK_ACCEL_MPS2 * WALKER_STEP_S + 1e-9


def test_a_person_in_the_path_of_a_car_hurries_out_of_it() -> None:
    on_foot, car = crossing_walker(0.4), vehicle(24.5)
    speeds = [speed for _, speed in meet(on_foot, car, 2.5)]
    assert max(speeds) == pytest.approx(1.3 * 1.1 * HURRY_SHARE)
    assert min(speeds) >= 1.43
    assert max(abs(b - a) for a, b in itertools.pairwise(speeds)) <= WALK_ACCEL_MPS2 * WALKER_STEP_S + 1e-9


def test_a_person_on_a_zebra_relies_on_drivers_who_can_still_stop_and_on_no_others() -> None:
    for ahead_m, goes_on in ((28.0, True), (9.0, False)):
        on_foot, car = crossing_walker(1.9, on_zebra=True), vehicle(40.0 - ahead_m - 2.2)
        on_foot.look(0.0, [car])
        for _ in range(3):
            on_foot.move()
        assert (on_foot.speed_mps > 1.3) is goes_on


def test_a_person_who_crosses_does_not_mind_a_car_that_passes_behind_or_stands() -> None:
    for car in (vehicle(28.0), vehicle(37.0, speed_mps=0.0)):
        on_foot = crossing_walker(-1.5)
        on_foot.look(0.0, [car])
        on_foot.move()
        assert on_foot.speed_mps == pytest.approx(1.43)


def test_a_walker_keeps_its_speed_on_the_pavement_of_a_bend() -> None:
    bend = ReferenceLine(0.0, 0.0, 0.0, [Piece(10.0), Piece(20.0, -1 / 22), Piece(60.0)])
    outside = Walker(
        name="walker",
        centre=bend,
        station_m=5.0,
        offset_m=6.5,
        speed_mps=1.3,
        ahead=True,
        crosses_at_m=None,
        kerb_m=5.0,
        patience_s=1.0,
    )
    for _ in range(280):
        before = outside.x_m, outside.y_m
        outside.look(0.0, [])
        outside.move()
        assert math.dist(before, (outside.x_m, outside.y_m)) == pytest.approx(1.3 * WALKER_STEP_S, abs=1e-3)
    assert outside.station_m == pytest.approx(30.0 + 280 * 0.13 - 5.0 - 20.0 * (1.0 + 6.5 / 22))


def test_a_walker_lets_a_car_pass_and_then_crosses() -> None:
    on_foot = walker(41.0, patience_s=99.0)
    car = vehicle(20.0)
    crossed_with_car_at = []
    for step in range(200):
        car.move(step * CONTROL_STEP_S, CONTROL_STEP_S)
        if step % 2 == 0:
            on_foot.look(step * CONTROL_STEP_S, [car])
            on_foot.move()
        if on_foot.phase is Phase.CROSSING:
            crossed_with_car_at.append(car.station_m)
    assert min(crossed_with_car_at) > 42.0
    assert on_foot.offset_m == pytest.approx(-5.0, abs=1.6)
    assert on_foot.phase is Phase.ALONG


def test_every_scenario_has_a_lead_vehicle_and_uniquely_named_road_users() -> None:
    for curve, road_id, task in itertools.product(RoadCurve, range(3), DrivingTask):
        world = make_world(
            replace(SCENARIO, road_curve=curve, road_id=road_id, road_length=1, driving_task=task), seed=3
        )
        assert len(world.walkers) == 18
        assert world.vehicles[0].name == "lead"
        assert 20.0 < world.vehicles[0].x_m - world.ego.x_m < 30.0
        names = [one.name for one in world.vehicles] + [one.name for one in world.walkers]
        assert len(set(names)) == len(names)


def test_other_vehicles_do_not_drive_through_each_other() -> None:
    for seed, curve in itertools.product(range(3), RoadCurve):
        rainy_night = replace(SCENARIO, time_of_day=TimeOfDay.NIGHT, weather=Weather.MEDIUM_RAIN)
        world = make_world(replace(rainy_night, road_curve=curve, road_id=seed, road_length=1), seed)
        for step in range(400):
            world.advance(step)
            for a, b in itertools.combinations(world.vehicles, 2):
                if (a.x_m - b.x_m) ** 2 + (a.y_m - b.y_m) ** 2 < 1.6**2:
                    pytest.fail(f"{curve} {seed}: {a.name} and {b.name} at {step * CONTROL_STEP_S} s")


def far_away_ego(world: UrbanWorld) -> None:
    """Move the ego far away from everybody."""
    world.ego.x_m -= 1000.0
    world.ego.speed_mps = 0.0


def parked(x_m: float, y_m: float, speed_mps: float = 0.0, yaw_rad: float = 0.0) -> Vehicle:
    style = DrivingStyle(speed_mps=8.0, headway_s=1.2, braking_mps2=2.8, friction=0.9)
    world = make_world(SCENARIO, 1)
    one = Vehicle(
        name="x", size=CAR, path=world.road.forward, station_m=0.0, speed_mps=speed_mps, style=style
    )
    one.x_m, one.y_m, one.yaw_rad = x_m, y_m, yaw_rad
    return one


NEAR_M = 2.5
"""Drivers stop for persons on a zebra crossing who are this close to their lane."""


@pytest.mark.parametrize(
    ("beside_m", "phase", "stops"),
    [
        (-0.5, Phase.CROSSING, True),
        (1.0, Phase.CROSSING, True),
        (NEAR_M - 0.1, Phase.WAITING, True),
        (NEAR_M + 0.1, Phase.WAITING, False),
        (-1.0, Phase.ALONG, False),
    ],
    ids=["in the lane", "beside it", "at the kerb", "farther away", "passes by"],
)
def test_drivers_stop_for_persons_in_or_near_their_lane_on_a_zebra_and_for_no_others(
    beside_m: float, phase: Phase, stops: bool
) -> None:
    # The person stands on the left of the road, from where the oncoming cars come.
    assert stands_before_zebra(lambda half_lane_m: 2.0 * half_lane_m + beside_m, phase) is stops


@pytest.mark.parametrize("beside_m", [0.1, 1.0, NEAR_M])
def test_drivers_do_not_stop_for_persons_who_have_left_their_lane(beside_m: float) -> None:
    # From the left, they have walked on into the ego's lane.
    assert not stands_before_zebra(lambda _: -beside_m, Phase.CROSSING)
    assert stands_before_zebra(lambda _: 0.1, Phase.CROSSING)


def stands_before_zebra(offset_m: Callable[[float], float], phase: Phase) -> bool:
    """Return whether an oncoming car stands before the zebra while one person stays at an offset; else it is past."""
    world = make_world(replace(SCENARIO, pedestrians=3, road_id=0), 1)
    (on_foot,) = [one for one in world.walkers if one.on_zebra]
    assert on_foot.offset_m > 0.0
    car = world.vehicles[1]
    assert car.name == "oncoming-1"
    line_m = car.stops[0].station_m
    car.station_m = line_m - 40.0
    on_foot.phase, on_foot.offset_m = phase, offset_m(0.5 * world.road.style.lane_width_m)
    drive([car], 10.0)
    front_m = car.station_m + 0.5 * car.length_m
    if car.speed_mps < 0.05:
        assert line_m - 3.0 < front_m < line_m + 0.5
        return True
    assert front_m > line_m + 20.0
    return False


@pytest.mark.parametrize("curve", [RoadCurve.STRAIGHT, RoadCurve.LEFT])
def test_vehicles_give_way_to_people_on_the_crossing(curve: RoadCurve) -> None:
    for seed, road_id in itertools.product(range(3), range(3)):
        world = make_world(replace(SCENARIO, road_id=road_id, road_curve=curve), seed)
        far_away_ego(world)
        fronts: dict[str, float] = {}
        obliged: dict[str, float] = {}
        slowest = math.inf
        for step in range(600):
            world.advance(step)
            for one in oncoming(world):
                line_m = one.stops[0].station_m
                front_m = one.station_m + 0.5 * one.length_m
                before_m = fronts.get(one.name, front_m)
                fronts[one.name] = front_m
                if not any(has_priority(world, person) for person in world.walkers):
                    obliged.pop(one.name, None)
                    continue
                room_m = line_m - front_m
                obliged.setdefault(one.name, one.speed_mps**2 / (2.0 * max(room_m, 0.1)))
                if 0.0 < room_m < 20.0:
                    slowest = min(slowest, one.speed_mps / one.style.speed_mps)
                if before_m <= line_m + 1.0 < front_m:
                    # Nobody passes who could have stopped when a person came near.
                    assert obliged[one.name] > one.style.braking_mps2, (one.name, seed, road_id, step)
            for one, person in itertools.product(world.vehicles, world.walkers):
                if person.on_zebra and person.phase is Phase.CROSSING:
                    apart_m = math.hypot(one.x_m - person.x_m, one.y_m - person.y_m)
                    assert apart_m > 1.0 or one.speed_mps < 1.0, (one.name, person.name, step)
        assert slowest < 0.6


def oncoming(world: UrbanWorld) -> list[Vehicle]:
    return [one for one in world.vehicles if one.name.startswith("oncoming")]


def has_priority(world: UrbanWorld, person: Walker) -> bool:
    """Return whether oncoming drivers must stop for a person on the zebra: in their lane, or near and not leaving."""
    if not person.on_zebra or person.phase is Phase.ALONG:
        return False
    lane_width_m = world.road.style.lane_width_m
    if 0.0 < person.offset_m < lane_width_m:
        return True
    comes_from_left = math.sin(person.yaw_rad - world.road.centre.pose_at(person.station_m)[2]) < 0.0
    if person.offset_m >= lane_width_m:
        return person.offset_m < lane_width_m + NEAR_M and (
            comes_from_left or person.phase is not Phase.CROSSING
        )
    return person.offset_m > -NEAR_M and not comes_from_left


def test_pedestrians_reach_the_other_side_without_a_light() -> None:
    world = make_world(SCENARIO, 2)
    far_away_ego(world)
    sides = {walker.name: math.copysign(1.0, walker.offset_m) for walker in world.walkers}
    for step in range(600):
        world.advance(step)
    crossed = [walker for walker in world.walkers if walker.offset_m * sides[walker.name] < -3.0]
    assert len(crossed) >= 4


def test_vehicles_enter_a_junction_only_on_green_or_amber() -> None:
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
                    assert state(step * CONTROL_STEP_S) is not LightState.RED, (
                        vehicle.name,
                        step * CONTROL_STEP_S,
                    )


def test_a_car_joins_a_lane_only_in_a_gap() -> None:
    for seed in range(4):
        world = make_world(replace(SCENARIO, pedestrians=0), seed)
        joining = next(v for v in world.vehicles if v.name == "joining")
        lane_y = world.road.forward.pose_at(0.0)[1]
        joined = False
        for step in range(600):
            world.ego.x_m += world.ego.speed_mps * CONTROL_STEP_S
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
def test_a_lane_is_free_unless_somebody_on_it_is_about_to_arrive(other: Vehicle, free: bool) -> None:
    asking = parked(0.0, -6.0)
    assert lane_is_free([other, asking], asking, 0.0, 0.0, 0.0) is free


def test_a_vehicle_starts_slowly_in_a_bend_and_close_before_one() -> None:
    bend = ReferenceLine(0.0, 0.0, 0.0, [Piece(60.0), Piece(10.0, 1 / 7), Piece(60.0)])
    speeds = [
        Vehicle(name="t", size=CAR, path=bend, station_m=at_m, speed_mps=8.0, style=STYLE).speed_mps
        for at_m in (20.0, 55.0, 62.0, 75.0)
    ]
    in_bend_mps = math.sqrt(CORNERING_MPS2 * 7.0)
    assert speeds == [8.0, pytest.approx(math.hypot(in_bend_mps, 4.0)), pytest.approx(in_bend_mps), 8.0]


def test_a_walker_stays_on_the_pavement() -> None:
    on_foot = walker(None)
    for _ in range(300):
        on_foot.look(0.0, [])
        on_foot.move()
    assert on_foot.offset_m == 5.0
    assert on_foot.station_m == pytest.approx(40.0 + 300 * 0.13)

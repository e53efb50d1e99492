import itertools

import pytest

from brink.sim.urban.scenario import DrivingTask, RoadCurve, TimeOfDay, UrbanScenario, Weather
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.vehicle import CAR, Manner, Mover, StopPoint, Vehicle
from brink.sim.world.walker import Phase, Walker
from brink.sim.world.world import STEP_S, make_world

ROAD = ReferenceLine(0.0, 0.0, 0.0, [Piece(300.0)])
MANNER = Manner(speed_mps=8.0, headway_s=1.2, firmness_mps2=2.8, friction=0.9)


def vehicle(station_m: float, *, speed_mps: float = 8.0, stops: tuple[StopPoint, ...] = ()) -> Vehicle:
    return Vehicle(
        name=f"at-{station_m}",
        size=CAR,
        path=ROAD,
        station_m=station_m,
        speed_mps=speed_mps,
        manner=MANNER,
        stops=stops,
    )


def drive(vehicles: list[Vehicle], seconds: float, others: tuple[Mover, ...] = ()) -> None:
    for step in range(round(seconds / STEP_S)):
        for one in vehicles:
            if one.looks_at(step):
                one.look(step * STEP_S, [*vehicles, *others])
        for one in vehicles:
            one.move(step * STEP_S, STEP_S)


def walker(crosses_at_m: float | None, *, patience_s: float = 1.0, on_zebra: bool = False) -> Walker:
    return Walker(
        name="walker",
        centre=ROAD,
        station_m=40.0,
        offset_m=5.0,
        speed_mps=1.3,
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


def test_a_free_vehicle_reaches_its_own_speed() -> None:
    free = vehicle(0.0, speed_mps=0.0)
    drive([free], 25.0)
    assert free.speed_mps == pytest.approx(MANNER.speed_mps, rel=0.02)


def test_a_vehicle_waits_at_its_line_for_as_long_as_it_must() -> None:
    waiting = vehicle(10.0, stops=(StopPoint(60.0, lambda _, time_s: time_s < 20.0),))
    drive([waiting], 19.0)
    front_m = waiting.station_m + 0.5 * CAR.length_m
    assert waiting.speed_mps < 0.1
    assert 57.0 < front_m <= 60.6
    drive([waiting], 40.0)
    assert waiting.station_m > 80.0


def test_a_vehicle_slows_down_before_a_bend() -> None:
    bend = ReferenceLine(0.0, 0.0, 0.0, [Piece(60.0), Piece(10.0, 1 / 7), Piece(60.0)])
    turning = Vehicle(name="t", size=CAR, path=bend, station_m=5.0, speed_mps=8.0, manner=MANNER)
    speeds = []
    for step in range(200):
        turning.look(step * STEP_S, [turning])
        turning.move(step * STEP_S, STEP_S)
        if 60.0 <= turning.station_m <= 70.0:
            speeds.append(turning.speed_mps)
    assert speeds
    assert max(speeds) < 5.0


def test_a_walker_lets_a_car_pass_and_then_crosses() -> None:
    on_foot = walker(41.0, patience_s=99.0)
    car = vehicle(20.0)
    crossed_with_car_at = []
    for step in range(200):
        car.move(step * STEP_S, STEP_S)
        if step % 2 == 0:
            on_foot.look(step * STEP_S, [car])
            on_foot.move()
        if on_foot.phase is Phase.CROSSING:
            crossed_with_car_at.append(car.station_m)
    assert min(crossed_with_car_at) > 42.0
    assert on_foot.offset_m == pytest.approx(-5.0, abs=1.6)
    assert on_foot.phase is Phase.ALONG


def test_a_walker_on_the_pavement_keeps_to_it() -> None:
    on_foot = walker(None)
    for _ in range(300):
        on_foot.look(0.0, [])
        on_foot.move()
    assert on_foot.offset_m == 5.0
    assert on_foot.station_m == pytest.approx(40.0 + 300 * 0.13)


def test_every_scenario_has_a_lead_ahead_and_others_at_other_places() -> None:
    for curve, road_id, task in itertools.product(RoadCurve, range(3), DrivingTask):
        scenario = UrbanScenario(
            time_of_day=TimeOfDay.NOON,
            weather=Weather.CLEAR,
            pedestrians=18,
            road_curve=curve,
            road_id=road_id,
            road_length=1,
            driving_task=task,
        )
        world = make_world(scenario, seed=3)
        assert len(world.walkers) == 18
        assert world.vehicles[0].name == "lead"
        assert 20.0 < world.vehicles[0].x_m - world.ego.x_m < 30.0
        names = [one.name for one in world.vehicles] + [one.name for one in world.walkers]
        assert len(set(names)) == len(names)


def test_other_vehicles_do_not_drive_through_each_other() -> None:
    for seed, curve in itertools.product(range(3), RoadCurve):
        scenario = UrbanScenario(
            time_of_day=TimeOfDay.NIGHT,
            weather=Weather.MEDIUM_RAIN,
            pedestrians=18,
            road_curve=curve,
            road_id=seed,
            road_length=1,
            driving_task=DrivingTask.FOLLOW_ROAD,
        )
        world = make_world(scenario, seed)
        for step in range(400):
            world.advance(step)
            for a, b in itertools.combinations(world.vehicles, 2):
                if (a.x_m - b.x_m) ** 2 + (a.y_m - b.y_m) ** 2 < 1.6**2:
                    pytest.fail(f"{curve} {seed}: {a.name} and {b.name} at {step * STEP_S} s")


@pytest.mark.parametrize("curve", list(RoadCurve))
@pytest.mark.parametrize("road_id", [0, 1, 2])
def test_every_vehicle_has_a_temper_of_its_own(curve: RoadCurve, road_id: int) -> None:
    scenario = UrbanScenario(
        time_of_day=TimeOfDay.NOON, weather=Weather.CLEAR, pedestrians=0, road_curve=curve, road_id=road_id,
        road_length=1, driving_task=DrivingTask.FIRST_EXIT,
    )  # fmt: skip
    for seed in range(3):
        vehicles = make_world(scenario, seed).vehicles
        shares = {"joining": 0.8, "pulling-out": 0.7, "local": 0.55}
        tempers = [vehicle.manner.speed_mps / shares.get(vehicle.name, 1.0) for vehicle in vehicles]
        assert len({round(temper, 9) for temper in tempers}) == len(vehicles)

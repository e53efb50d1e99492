"""The driving system in a closed loop with a road, a car, and a perfect detector or ghosts."""

import math

import pytest
from driving_loop import Actor, Drive, drive, person, road, vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import (
    Box,
    Crossing,
    EgoState,
    LightState,
    Observation,
    ObstacleLabel,
    PlanMode,
)
from brink.sim.driving.system import ModularDriving
from brink.sim.world.line import Piece

STOPS_BETWEEN_M = (3.5, 5.2)
DRY, WET = 0.9, 0.4
STRAIGHT = road(oncoming=False)
LEFT_BEND = road(Piece(60.0), Piece(60.0, 1 / 25), Piece(200.0), oncoming=False)
RIGHT_BEND = road(Piece(60.0), Piece(60.0, -1 / 25), Piece(200.0), oncoming=False)


def standing(station_m: float, offset_m: float = 0.0) -> Actor:
    return vehicle(lambda _: (station_m, offset_m))


def comes(station_m: float) -> Actor:
    return vehicle(lambda t: (station_m - 8.0 * t, 3.5))


def ghost(label: ObstacleLabel, x_min: float, x_max: float, y_min: float, y_max: float) -> Box:
    return Box(label=label, x_min_px=x_min, x_max_px=x_max, y_min_px=y_min, y_max_px=y_max)


def final_gap_m(done: Drive, rear_m: float) -> float:
    return rear_m - done.station_m[-1] - 2.25


@pytest.mark.parametrize(
    "route",
    [
        STRAIGHT,
        LEFT_BEND,
        RIGHT_BEND,
        road(Piece(50.0), Piece(12.5, -1 / 8), Piece(100.0)),
        road(Piece(50.0), Piece(18.8, 1 / 12), Piece(100.0)),
    ],
)
@pytest.mark.parametrize("friction", [DRY, WET])
def test_a_free_road_is_followed_within_the_lane(route: object, friction: float) -> None:
    assert isinstance(route, type(STRAIGHT))
    done = drive(route, friction=friction, duration_s=25.0)
    assert max(map(abs, done.offset_m)) < 0.3
    assert max(done.speed_mps) < 8.4
    assert done.speed_mps[-1] > 7.5
    assert done.modes() == {PlanMode.CRUISE}


@pytest.mark.parametrize("friction", [DRY, WET])
@pytest.mark.parametrize("route", [STRAIGHT, LEFT_BEND, RIGHT_BEND])
def test_stops_about_four_metres_behind_a_standing_vehicle(route: object, friction: float) -> None:
    assert isinstance(route, type(STRAIGHT))
    done = drive(route, [standing(100.0)], friction=friction, duration_s=25.0)
    assert done.speed_mps[-1] == 0.0
    assert STOPS_BETWEEN_M[0] < final_gap_m(done, 100.0 - 2.25) < STOPS_BETWEEN_M[1]
    assert min(done.accel_mps2) > -3.0


@pytest.mark.parametrize("friction", [DRY, WET])
@pytest.mark.parametrize("decel", [2.0, 4.0, 6.0])
def test_keeps_clear_of_a_lead_vehicle_that_brakes_to_a_standstill(friction: float, decel: float) -> None:
    decel = min(decel, 9.81 * friction)

    def lead(time_s: float) -> tuple[float, float]:
        braked_s = min(max(time_s - 6.0, 0.0), 8.0 / decel)
        return 22.0 + 8.0 * min(time_s, 6.0) + 8.0 * braked_s - decel * braked_s**2 / 2, 0.0

    done = drive(STRAIGHT, [vehicle(lead)], friction=friction, duration_s=18.0)
    assert min(done.front_gap_m) > 2.5
    assert done.speed_mps[-1] == 0.0


def test_follows_a_slower_vehicle_at_its_speed_with_a_time_gap() -> None:
    done = drive(STRAIGHT, [vehicle(lambda t: (30.0 + 5.0 * t, 0.0))], duration_s=28.0)
    assert done.speed_mps[-1] == pytest.approx(5.0, abs=0.1)
    assert done.front_gap_m[-1] == pytest.approx(4.0 + 1.3 * 5.0, abs=1.0)
    assert done.mode[-1] is PlanMode.FOLLOW


def test_nudges_around_an_obstacle_at_the_lane_edge_without_leaving_the_lane() -> None:
    done = drive(STRAIGHT, [standing(80.0, -1.95)], duration_s=20.0)
    assert PlanMode.NUDGE in done.modes()
    assert 0.2 < max(done.offset_m) < 0.85
    assert min(done.clearance_m) > 0.3
    assert done.station_m[-1] > 120.0
    assert done.offset_m[-1] == pytest.approx(0.0, abs=0.05)


def test_ignores_parked_vehicles_outside_the_lane() -> None:
    parked = [standing(60.0 + 7.0 * n, -3.2) for n in range(5)]
    done = drive(STRAIGHT, parked, duration_s=18.0)
    assert max(map(abs, done.offset_m)) < 0.05
    assert min(done.speed_mps) > 7.5


def test_ignores_an_oncoming_vehicle_in_its_own_lane() -> None:
    for route in (STRAIGHT, LEFT_BEND):
        done = drive(route, [comes(180.0)], duration_s=18.0)
        assert min(done.speed_mps) > 6.0
        assert max(map(abs, done.offset_m)) < 0.3


def test_overtakes_a_standing_vehicle_when_the_oncoming_lane_is_clear() -> None:
    done = drive(road(), [standing(80.0)], duration_s=25.0)
    assert PlanMode.OVERTAKE in done.modes()
    assert done.station_m[-1] > 120.0
    assert done.offset_m[-1] == pytest.approx(0.0, abs=0.1)
    assert min(done.clearance_m) > 0.4
    assert max(done.offset_m) < 4.2


def test_overtakes_only_after_oncoming_traffic_has_passed() -> None:
    oncoming = [comes(130.0 + 35.0 * n) for n in range(3)]
    done = drive(road(), [standing(60.0), *oncoming], duration_s=35.0)
    last_passes_s = next(t for t in done.time_s if 200.0 - 8.0 * t < 45.0)
    out_s = [t for t, d in zip(done.time_s, done.offset_m, strict=True) if d > 1.0]
    assert min(out_s) > last_passes_s
    assert done.station_m[-1] > 75.0
    assert min(done.clearance_m) > 1.0


@pytest.mark.parametrize(
    "route",
    [road(oncoming=False), road(stop_lines_m=(95.0,))],
    ids=["no oncoming lane", "a queue at a light"],
)
def test_does_not_overtake_where_it_is_forbidden(route: object) -> None:
    assert isinstance(route, type(STRAIGHT))
    done = drive(route, [standing(80.0)], duration_s=25.0)
    assert PlanMode.OVERTAKE not in done.modes()
    assert done.speed_mps[-1] == 0.0


def test_stops_at_the_line_on_red_and_continues_on_green() -> None:
    route = road(stop_lines_m=(90.0,))
    done = drive(route, light=lambda t: LightState.RED if t < 18.0 else LightState.GREEN, duration_s=30.0)
    waiting = [
        s + 2.25 for s, v, t in zip(done.station_m, done.speed_mps, done.time_s, strict=True) if 15 < t < 18
    ]
    assert 88.0 < max(waiting) < 90.0
    assert done.station_m[-1] > 120.0
    assert min(done.accel_mps2) > -3.0


ZEBRA = Crossing(from_m=60.0, to_m=64.0, right_kerb_m=-1.75, left_kerb_m=5.25)


@pytest.mark.parametrize(
    ("offset_m", "across_mps", "yields"),
    [
        (0.0, 0.0, True),
        (-2.4, 0.0, True),
        (3.2, 0.0, True),
        (6.4, -0.6, True),
        (1.8, 0.4, False),
        (5.9, 0.0, False),
    ],
    ids=[
        "in the lane",
        "at the kerb",
        "beside the lane",
        "on the way to the lane",
        "leaves",
        "on the other side",
    ],
)
def test_gives_way_at_a_zebra_to_persons_in_or_near_its_way_and_to_no_others(
    offset_m: float, across_mps: float, yields: bool
) -> None:
    stands_m = 3.2
    stays_s = math.inf if across_mps >= 0.0 else (offset_m - stands_m) / -across_mps
    on_foot = person(lambda t: (62.0, offset_m + across_mps * min(t, stays_s)))
    done = drive(road(crossings=(ZEBRA,)), [on_foot], duration_s=12.0)
    fronts_m = [station_m + 2.25 for station_m in done.station_m]
    if yields:
        assert min(done.speed_mps) < 0.1
        assert ZEBRA.from_m - 4.0 < max(fronts_m) < ZEBRA.from_m
    else:
        assert min(done.speed_mps) > 6.0
        assert max(fronts_m) > ZEBRA.to_m


def test_passes_a_person_beside_its_lane_where_there_is_no_zebra() -> None:
    done = drive(road(), [person(lambda _: (62.0, 3.2))], duration_s=12.0)
    assert min(done.speed_mps) > 6.0


def test_stops_for_a_crossing_person_and_then_continues() -> None:
    done = drive(STRAIGHT, [person(lambda t: (60.0, -6.0 + max(0.0, t - 2.0) * 1.3))], duration_s=20.0)
    assert PlanMode.YIELD in done.modes()
    assert min(done.clearance_m) > 1.5
    assert done.station_m[-1] > 90.0


def test_waits_for_a_person_standing_in_the_lane() -> None:
    done = drive(road(), [person(lambda _: (60.0, 0.0))], duration_s=25.0)
    assert done.speed_mps[-1] == 0.0
    assert 2.5 < final_gap_m(done, 59.75) < 5.0
    assert PlanMode.OVERTAKE not in done.modes()


def test_does_not_slow_down_for_a_person_on_the_pavement() -> None:
    done = drive(STRAIGHT, [person(lambda t: (40.0 + 1.3 * t, -3.2))], duration_s=15.0)
    assert min(done.speed_mps) > 7.5


def reaction(box: Box | None, *, until_s: float = 99.0, route: object = STRAIGHT) -> Drive:
    assert isinstance(route, type(STRAIGHT))
    return drive(
        route,
        oracle=False,
        duration_s=14.0,
        ghosts=lambda t: (box,) if box is not None and 2.0 <= t <= until_s else (),
    )


def test_the_bottom_edge_of_a_followed_ghost_determines_its_distance() -> None:
    ends = [
        reaction(ghost(ObstacleLabel.VEHICLE, 370.0, 430.0, 280.0, y_px)).station_m[-1]
        for y_px in (320.0, 360.0, 400.0, 480.0)
    ]
    free = reaction(None).station_m[-1]
    assert [free, *ends] == sorted([free, *ends], reverse=True)
    assert ends[-1] < free - 30.0


def test_the_image_position_of_a_ghost_decides_between_stopping_nudging_and_ignoring_it() -> None:
    # 80 px below the horizon is 8.5 m; 47 px are a metre there.
    blocking = reaction(ghost(ObstacleLabel.VEHICLE, 360.0, 440.0, 300.0, 380.0))
    at_edge = drive(STRAIGHT, ghosts=lambda t: approaching(t, -2.0), oracle=False, duration_s=14.0)
    outside = reaction(ghost(ObstacleLabel.VEHICLE, 540.0, 640.0, 300.0, 380.0))
    free = reaction(None)
    assert blocking.station_m[-1] < free.station_m[-1] - 20.0
    assert PlanMode.NUDGE in at_edge.modes()
    assert max(at_edge.offset_m) > 0.2
    assert outside.station_m == free.station_m


def approaching(time_s: float, middle_m: float) -> tuple[Box, ...]:
    """Return the box of a car standing 60 m ahead of the start, seen by an ego at a constant 8 m/s."""
    seen = Camera().project(
        8.0 * time_s, 0.0, 0.0, Solid(ObstacleLabel.VEHICLE, 60.0, middle_m, 0.0, 4.5, 1.8, 1.5)
    )
    return () if seen is None else (seen[0],)


def test_equal_observations_give_equal_commands() -> None:
    first, again = (drive(road(), [standing(80.0)], duration_s=20.0) for _ in range(2))
    assert first == again


coordinates = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-100.0, 900.0)
any_box = st.builds(
    Box,
    label=st.sampled_from(ObstacleLabel),
    x_min_px=coordinates,
    x_max_px=coordinates,
    y_min_px=coordinates,
    y_max_px=coordinates,
)


@settings(max_examples=60)
@given(frames=st.lists(st.lists(any_box, max_size=4), min_size=3, max_size=12), repeat=st.integers(1, 4))
def test_commands_are_finite_and_bounded_for_arbitrary_boxes(frames: list[list[Box]], repeat: int) -> None:
    route = road()
    system = ModularDriving(route)
    station_m = 10.0
    shown = [frame for frame in frames for _ in range(repeat)]
    for step, frame in enumerate(shown):
        x_m, y_m, yaw_rad = route.pose_at(station_m)
        ego = EgoState(
            x_m=x_m,
            y_m=y_m,
            yaw_rad=yaw_rad,
            speed_mps=6.0,
            accel_mps2=0.0,
            station_m=station_m,
            offset_m=0.0,
        )
        observation = Observation(time_s=0.1 * step, ego=ego, boxes=tuple(frame), light=None)
        command = system.step(observation)
        assert math.isfinite(command.accel_mps2)
        assert -8.0 <= command.accel_mps2 <= 2.0
        assert abs(command.steer_rad) <= 0.6
        assert all(math.isfinite(value) for obstacle in system.obstacles for value in obstacle[2:])
        assert system.plan.target_speed_mps >= 0.0
        station_m += 0.6


def test_reacts_only_to_perceived_obstacles() -> None:
    done = drive(STRAIGHT, [standing(80.0)], oracle=False, duration_s=15.0)
    assert min(done.clearance_m) == 0.0


def test_continues_when_a_ghost_disappears() -> None:
    stays = reaction(ghost(ObstacleLabel.PERSON, 360.0, 440.0, 250.0, 480.0))
    goes = reaction(ghost(ObstacleLabel.PERSON, 360.0, 440.0, 250.0, 480.0), until_s=7.0)
    assert stays.speed_mps[-1] == 0.0
    assert goes.speed_mps[-1] > 5.0

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.world.ego import EGO_CAR, GRAVITY_MPS2, EgoCar

FULL_BRAKES = -EGO_CAR.brake_mps2


def stopping_distance_m(speed_mps: float, friction: float, grade: float = 0.0) -> float:
    car = EgoCar((0.0, 0.0, 0.0), speed_mps, friction=friction)
    car.set_grade(grade)
    for _ in range(10_000):
        if car.speed_mps == 0.0:
            return car.x_m
        car.drive(FULL_BRAKES, 0.0, 1)
    pytest.fail("the car never stopped")


@pytest.mark.parametrize("friction", [0.9, 0.6, 0.55, 0.5, 0.4])
@pytest.mark.parametrize("speed_mps", [14.0, 20.0, 28.0])
def test_braking_distance_is_that_of_the_friction(friction: float, speed_mps: float) -> None:
    expected_m = speed_mps**2 / (2 * friction * GRAVITY_MPS2)
    assert stopping_distance_m(speed_mps, friction) == pytest.approx(expected_m, rel=0.05)


@pytest.mark.parametrize("friction", [0.9, 0.6, 0.4])
def test_cornering_is_that_of_the_friction(friction: float) -> None:
    speed_mps, best = 15.0, 0.0
    for steer_rad in (0.05, 0.1, 0.2, 0.3, 0.4, 0.5):
        car = EgoCar((0.0, 0.0, 0.0), speed_mps, friction=friction)
        for _ in range(100):
            car.speed_mps = speed_mps
            car.drive(0.0, steer_rad, 1)
        best = max(best, abs(car.yaw_rate_radps) * car.speed_mps)
    assert best == pytest.approx(friction * GRAVITY_MPS2, rel=0.05)


def test_uphill_stops_sooner_and_downhill_later() -> None:
    flat_m = stopping_distance_m(15.0, 0.6)
    assert stopping_distance_m(15.0, 0.6, grade=0.05) < flat_m < stopping_distance_m(15.0, 0.6, grade=-0.05)


def test_slow_driving_follows_the_steering_angle() -> None:
    car = EgoCar((0.0, 0.0, 0.0), 3.0, friction=0.9)
    for _ in range(400):
        car.speed_mps = 3.0
        car.drive(0.0, 0.2, 1)
    assert car.yaw_rate_radps == pytest.approx(3.0 * math.tan(0.2) / EGO_CAR.wheelbase_m, rel=0.01)


def test_a_standing_car_does_not_roll_backwards_on_a_hill() -> None:
    car = EgoCar((1.0, 2.0, 0.3), 0.0, friction=0.9)
    car.set_grade(0.06)
    car.drive(-1.0, 0.1, 500)
    assert (car.x_m, car.y_m, car.yaw_rad, car.speed_mps) == (1.0, 2.0, 0.3, 0.0)


@settings(max_examples=60)
@given(
    st.floats(0, 25),
    st.floats(0.3, 1.0),
    st.lists(st.tuples(st.floats(-20, 20), st.floats(-2, 2)), min_size=1, max_size=8),
)
def test_no_command_gets_more_out_of_the_tyres_than_friction_gives(
    speed_mps: float, friction: float, commands: list[tuple[float, float]]
) -> None:
    car = EgoCar((0.0, 0.0, 0.0), speed_mps, friction=friction)
    most = friction * GRAVITY_MPS2
    for accel, steer in commands:
        for _ in range(10):
            before = car.speed_mps
            car.drive(accel, steer, 1)
            along = (car.speed_mps - before) / 0.01
            drag = EGO_CAR.drag_1pm * before * before
            side = car.yaw_rate_radps * before
            assert car.speed_mps >= 0.0
            assert abs(side) <= most * 1.001
            assert along <= EGO_CAR.engine_mps2 + 1e-6
            assert math.hypot(min(along + drag, 0.0), side) <= most * 1.02 + 1e-6

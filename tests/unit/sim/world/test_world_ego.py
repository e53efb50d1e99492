"""Both motion models of the ego against the laws of friction, and against each other."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.bullet.engine import process_engine
from brink.sim.bullet.wheels import WheeledCar
from brink.sim.episode import EpisodeSpec
from brink.sim.trace import Trace
from brink.sim.urban.simulator import BrinkDrive
from brink.sim.world.ego import EGO_CAR, GRAVITY_MPS2, PHYSICS_STEP_S, PROMPT_CAR, CarModel, EgoCar, EgoMotion
from brink.sim.world.world import EGO_STEPS

FULL_BRAKES = -EGO_CAR.brake_mps2


def stopping_distance_m(speed_mps: float, friction: float, grade: float = 0.0) -> float:
    car = EgoCar((0.0, 0.0, 0.0), speed_mps, friction=friction, model=PROMPT_CAR)
    car.set_grade(grade)
    for _ in range(10_000):
        if car.speed_mps == 0.0:
            return car.x_m
        car.drive(FULL_BRAKES, 0.0, 1)
    pytest.fail("the car never stopped")


@pytest.mark.parametrize("friction", [0.9, 0.6, 0.55, 0.5, 0.4])
@pytest.mark.parametrize("speed_mps", [14.0, 20.0, 28.0])
def test_braking_distance_follows_from_friction(friction: float, speed_mps: float) -> None:
    expected_m = speed_mps**2 / (2 * friction * GRAVITY_MPS2)
    assert stopping_distance_m(speed_mps, friction) == pytest.approx(expected_m, rel=0.05)


def test_the_car_stops_sooner_uphill_and_later_downhill() -> None:
    flat_m = stopping_distance_m(15.0, 0.6)
    assert stopping_distance_m(15.0, 0.6, grade=0.05) < flat_m < stopping_distance_m(15.0, 0.6, grade=-0.05)


@settings(max_examples=60)
@given(
    st.floats(0, 25),
    st.floats(0.3, 1.0),
    st.lists(st.tuples(st.floats(-20, 20), st.floats(-2, 2)), min_size=1, max_size=8),
)
def test_friction_circle_holds(
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


FIDELITIES = ("bicycle", "wheels")
SPEC = EpisodeSpec(
    simulator="brink-drive@3",
    scenario={
        "time_of_day": "noon",
        "weather": "wet",
        "pedestrians": 0,
        "road_curve": "left",
        "road_id": 1,
        "road_length": 0,
        "driving_task": "follow_road",
    },
    behaviour={"mode": "injected", "trajectories": []},
    requirements=("front-gap@1", "lane-keeping@1"),
    seed=3,
    duration_s=8.0,
)


def car(fidelity: str, speed_mps: float, friction: float, model: CarModel = PROMPT_CAR) -> EgoMotion:
    if fidelity == "bicycle":
        return EgoCar((0.0, 0.0, 0.0), speed_mps, friction=friction, model=model)
    engine = process_engine()
    engine.reset()
    return WheeledCar(engine, (0.0, 0.0, 0.0), speed_mps, friction=friction, model=model)


def braking_distance_m(fidelity: str, speed_mps: float, friction: float, steps: int) -> float:
    one = car(fidelity, speed_mps, friction)
    for _ in range(1500):
        if one.speed_mps < 0.02:
            return one.x_m
        one.drive(-EGO_CAR.brake_mps2, 0.0, steps)
    pytest.fail("the car never stopped")


def cornering_mps2(fidelity: str, speed_mps: float, friction: float, steps: int) -> float:
    """Return the largest lateral acceleration of the path, averaged over a second of steady turning."""
    best = 0.0
    for steer_rad in (0.08, 0.12, 0.16):
        one = car(fidelity, speed_mps, friction)
        sideways, points = [], [(one.x_m, one.y_m)]
        for _ in range(200 // steps):
            one.drive(0.2, steer_rad, steps)  # accelerating costs grip, but this costs hardly any
            points.append((one.x_m, one.y_m))
        for before, here, after in itertools.islice(triples(points), 100 // steps, None):
            course_rad, next_rad = direction_rad(before, here), direction_rad(here, after)
            turned_rad = math.remainder(next_rad - course_rad, math.tau)
            sideways.append(abs(turned_rad) * math.dist(here, after) / (steps * PHYSICS_STEP_S) ** 2)
        best = max(best, sum(sideways) / len(sideways))
    return best


def direction_rad(one: tuple[float, float], other: tuple[float, float]) -> float:
    return math.atan2(other[1] - one[1], other[0] - one[0])


def triples(
    points: list[tuple[float, float]],
) -> Iterator[tuple[tuple[float, float], tuple[float, float], tuple[float, float]]]:
    return zip(points, points[1:], points[2:], strict=False)


STEPS = (1, EGO_STEPS)
"""Steps of 10 ms in a call; an episode makes `EGO_STEPS`, for which the engine of the wheels takes larger ones."""


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("friction", [0.9, 0.6, 0.4])
@pytest.mark.parametrize("speed_mps", [15.0, 20.0])
def test_both_models_brake_within_the_distance_friction_allows(
    speed_mps: float, friction: float, steps: int
) -> None:
    expected_m = speed_mps**2 / (2 * friction * GRAVITY_MPS2)
    bicycle, wheels = (braking_distance_m(fidelity, speed_mps, friction, steps) for fidelity in FIDELITIES)
    assert bicycle == pytest.approx(expected_m, rel=0.05)
    assert wheels == pytest.approx(expected_m, rel=0.05)
    assert wheels == pytest.approx(bicycle, rel=0.05)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_full_braking_builds_up_as_fast_as_in_a_passenger_car(fidelity: str) -> None:
    one = car(fidelity, 15.0, 0.9, EGO_CAR)
    begins_s, built_up_s = math.inf, math.inf
    for step in range(1, 100):
        one.drive(FULL_BRAKES, 0.0, 1)
        if one.accel_mps2 < -0.5:
            begins_s = min(begins_s, step * PHYSICS_STEP_S)
        if one.accel_mps2 < -0.75 * 0.9 * GRAVITY_MPS2:
            built_up_s = min(built_up_s, step * PHYSICS_STEP_S)
    assert begins_s > EGO_CAR.delay_s
    assert built_up_s == pytest.approx(0.36, abs=0.06)  # Directive 71/320/EEC: M1 vehicles


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_delay_and_build_up_lengthen_the_stopping_distance(fidelity: str) -> None:
    prompt_m, real_m = (stopping_m(car(fidelity, 10.0, 0.9, model), -6.0) for model in (PROMPT_CAR, EGO_CAR))
    # The rate limits the braking until it is within rate times lag of what is wanted; then the lag does.
    rest_mps2 = EGO_CAR.brake_rate_mps3 * EGO_CAR.brake_lag_s
    ramp_s = (6.0 - rest_mps2) / EGO_CAR.brake_rate_mps3
    lost_s = ramp_s * (1.0 - 0.5 * (6.0 - rest_mps2) / 6.0) + rest_mps2 / 6.0 * EGO_CAR.brake_lag_s
    longer_m = 10.0 * (EGO_CAR.delay_s + lost_s - PROMPT_CAR.brake_lag_s)
    assert real_m - prompt_m == pytest.approx(longer_m, rel=0.1)


def stopping_m(one: EgoMotion, accel_mps2: float) -> float:
    for _ in range(1500):
        if one.speed_mps < 0.02:
            return one.x_m
        one.drive(accel_mps2, 0.0, 1)
    pytest.fail("the car never stopped")


def test_the_body_pitches_with_its_acceleration_and_swings_back() -> None:
    one = car("bicycle", 20.0, 0.9, EGO_CAR)
    pitches = []
    for _ in range(40):
        one.drive(-5.0, 0.0, 5)
        pitches.append(math.degrees(one.pitch_rad))
    settled = math.degrees(-5.0 * EGO_CAR.pitch_rad_per_mps2)
    assert pitches[-1] == pytest.approx(settled, rel=0.1)
    assert settled == pytest.approx(-1.8 * 5.0 / GRAVITY_MPS2, rel=0.05)
    assert min(pitches) < 1.1 * settled, "a damped oscillator overshoots"


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("friction", [0.9, 0.6, 0.4])
def test_both_models_corner_as_friction_allows(friction: float, steps: int) -> None:
    bicycle, wheels = (cornering_mps2(fidelity, 15.0, friction, steps) for fidelity in FIDELITIES)
    assert bicycle == pytest.approx(friction * GRAVITY_MPS2, rel=0.05)
    assert wheels == pytest.approx(friction * GRAVITY_MPS2, rel=0.05)
    assert wheels == pytest.approx(bicycle, rel=0.05)


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_both_models_follow_the_steering_angle_in_a_gentle_turn(fidelity: str, steps: int) -> None:
    one = car(fidelity, 5.0, 0.9)
    for _ in range(200 // steps):
        one.drive(0.15, 0.1, steps)
    expected = one.speed_mps * math.tan(0.1) / EGO_CAR.wheelbase_m
    assert one.yaw_rate_radps == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_both_models_turn_as_soon_as_the_steering_does(fidelity: str) -> None:
    one = car(fidelity, 5.0, 0.9)
    one.drive(0.15, 0.05, EGO_STEPS)
    for _ in range(2):
        one.drive(0.15, 0.05, EGO_STEPS)
    expected = one.speed_mps * math.tan(0.05) / EGO_CAR.wheelbase_m
    assert one.yaw_rate_radps == pytest.approx(expected, rel=0.05)


# Without traction control, a front wheel on wheels span and the car turned at .40 of the rate.
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_both_models_stay_on_course_when_they_accelerate_out_of_a_bend_on_a_wet_road(fidelity: str) -> None:
    one = car(fidelity, 3.0, 0.4, EGO_CAR)
    for _ in range(40):
        one.drive(0.25, 0.3, EGO_STEPS)
    for _ in range(20):
        one.drive(2.5, 0.15, EGO_STEPS)
    expected = one.speed_mps * math.tan(0.15) / EGO_CAR.wheelbase_m
    assert one.yaw_rate_radps == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("accel_mps2", [-1.0, 0.0, 0.3])
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_both_models_hold_on_a_hill(fidelity: str, accel_mps2: float) -> None:
    one = car(fidelity, 0.0, 0.6)
    one.set_grade(0.06)
    for _ in range(60):
        one.drive(accel_mps2, 0.0, EGO_STEPS)
    assert (one.x_m, one.y_m, one.speed_mps) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("accel_mps2", [1.0, 3.0])
def test_both_models_start_alike_on_a_hill(accel_mps2: float) -> None:
    bicycle, wheels = (car(fidelity, 0.0, 0.6, EGO_CAR) for fidelity in FIDELITIES)
    for one in (bicycle, wheels):
        one.set_grade(0.06)
        for _ in range(60):
            one.drive(accel_mps2, 0.0, EGO_STEPS)
    assert wheels.x_m == pytest.approx(bicycle.x_m, rel=0.05)


def test_an_episode_is_repeatable_and_similar_at_both_fidelities() -> None:
    simulator = BrinkDrive()
    on_wheels = replace(SPEC, options={"fidelity": "wheels"})
    results = [simulator.run(spec, record=True) for spec in (SPEC, on_wheels, SPEC, on_wheels)]
    bicycle, wheels = (Trace.from_bytes(result.trace or b"") for result in results[:2])
    count = min(len(bicycle.time_s), len(wheels.time_s))
    assert count > 60
    apart_m = ((bicycle.ego[:count, :2] - wheels.ego[:count, :2]) ** 2).sum(axis=1) ** 0.5
    assert apart_m.max() < 1.5
    assert results[0].trace == results[2].trace
    assert results[1].trace == results[3].trace
    for name, verdict in results[0].verdicts.items():
        assert results[1].verdicts[name].violated == verdict.violated


@pytest.mark.parametrize("friction", [0.9, 0.6, 0.4])
def test_cornering_is_limited_by_friction(friction: float) -> None:
    speed_mps, best = 15.0, 0.0
    for steer_rad in (0.05, 0.1, 0.2, 0.3, 0.4, 0.5):
        car = EgoCar((0.0, 0.0, 0.0), speed_mps, friction=friction)
        for _ in range(100):
            car.speed_mps = speed_mps
            car.drive(0.0, steer_rad, 1)
        best = max(best, abs(car.yaw_rate_radps) * car.speed_mps)
    assert best == pytest.approx(friction * GRAVITY_MPS2, rel=0.05)


def test_a_standing_car_does_not_roll_backwards_on_a_hill() -> None:
    car = EgoCar((1.0, 2.0, 0.3), 0.0, friction=0.9)
    car.set_grade(0.06)
    car.drive(-1.0, 0.1, 500)
    assert (car.x_m, car.y_m, car.yaw_rad, car.speed_mps) == (1.0, 2.0, 0.3, 0.0)

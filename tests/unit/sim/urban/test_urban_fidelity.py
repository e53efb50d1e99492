"""Both models of the ego against the laws of friction, and against each other."""

import math
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from brink.sim.bullet.engine import process_engine
from brink.sim.bullet.wheels import WheeledCar, car_urdf
from brink.sim.episode import EpisodeSpec
from brink.sim.trace import Trace
from brink.sim.urban.simulator import BrinkDrive
from brink.sim.world.ego import EGO_CAR, GRAVITY_MPS2, EgoCar, EgoMotion

FIDELITIES = ("bicycle", "wheels")
SPEC = EpisodeSpec(
    simulator="brink-drive@1",
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


def car(fidelity: str, speed_mps: float, friction: float) -> EgoMotion:
    if fidelity == "bicycle":
        return EgoCar((0.0, 0.0, 0.0), speed_mps, friction=friction)
    engine = process_engine()
    engine.reset()
    return WheeledCar(engine, (0.0, 0.0, 0.0), speed_mps, friction=friction)


def braking_distance_m(fidelity: str, speed_mps: float, friction: float) -> float:
    one = car(fidelity, speed_mps, friction)
    for _ in range(1500):
        if one.speed_mps < 0.02:
            return one.x_m
        one.drive(-EGO_CAR.brake_mps2, 0.0, 1)
    pytest.fail("it never stopped")


def cornering_mps2(fidelity: str, speed_mps: float, friction: float) -> float:
    """Return the best lateral acceleration over a second of steady turning."""
    best = 0.0
    for steer_rad in (0.08, 0.12, 0.16):
        one = car(fidelity, speed_mps, friction)
        sideways = []
        for step in range(200):
            one.drive(0.2, steer_rad, 1)  # what drives takes grip from cornering: hardly any
            if step >= 100:
                sideways.append(abs(one.yaw_rate_radps) * one.speed_mps)
        best = max(best, sum(sideways) / len(sideways))
    return best


@pytest.mark.parametrize("friction", [0.9, 0.6, 0.4])
@pytest.mark.parametrize("speed_mps", [15.0, 20.0])
def test_braking_distances_are_those_of_friction_and_agree(speed_mps: float, friction: float) -> None:
    expected_m = speed_mps**2 / (2 * friction * GRAVITY_MPS2)
    bicycle, wheels = (braking_distance_m(fidelity, speed_mps, friction) for fidelity in FIDELITIES)
    assert bicycle == pytest.approx(expected_m, rel=0.05)
    assert wheels == pytest.approx(expected_m, rel=0.05)
    assert wheels == pytest.approx(bicycle, rel=0.05)


@pytest.mark.parametrize("friction", [0.9, 0.6, 0.4])
def test_cornering_is_that_of_friction_and_agrees(friction: float) -> None:
    bicycle, wheels = (cornering_mps2(fidelity, 15.0, friction) for fidelity in FIDELITIES)
    assert bicycle == pytest.approx(friction * GRAVITY_MPS2, rel=0.05)
    assert wheels == pytest.approx(friction * GRAVITY_MPS2, rel=0.05)
    assert wheels == pytest.approx(bicycle, rel=0.05)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_a_gentle_turn_follows_the_steering_angle(fidelity: str) -> None:
    one = car(fidelity, 5.0, 0.9)
    for _ in range(200):
        one.drive(0.15, 0.1, 1)
    expected = one.speed_mps * math.tan(0.1) / EGO_CAR.wheelbase_m
    assert one.yaw_rate_radps == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_the_brakes_hold_on_a_hill(fidelity: str) -> None:
    one = car(fidelity, 0.0, 0.6)
    one.set_grade(0.06)
    one.drive(-1.0, 0.0, 300)
    assert math.hypot(one.x_m, one.y_m) < 0.02


def test_the_car_weighs_what_the_model_says() -> None:
    masses = [float(node.attrib["value"]) for node in ElementTree.fromstring(car_urdf(EGO_CAR)).iter("mass")]
    assert sum(masses) == pytest.approx(EGO_CAR.mass_kg)
    assert min(masses) > 0


def test_an_episode_goes_the_same_way_at_both_fidelities_and_repeats() -> None:
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

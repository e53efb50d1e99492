"""Encounters: scripts are followed, gaps are exact, violations come with their circumstances."""

import math
from dataclasses import replace

import numpy as np
import pytest

from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.encounter.witness import bearing_rad
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, JsonObject
from brink.sim.errors import InvalidEpisode
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.trace import Trace

PLACE: JsonObject = {
    "time_of_day": "noon",
    "weather": "clear",
    "road_curve": "straight",
    "road_id": 0,
    "road_length": 2,
    "driving_task": "follow_road",
}
ORACLES = ("no-collision@1", "front-gap@1", "lane-keeping@1", "red-light@1", "speed-limit@1", "progress@1")


def stretch(action: str, from_s: float, lasts_s: float, **changes: float) -> JsonObject:
    base: JsonObject = {
        "action": action,
        "from_s": from_s,
        "lasts_s": lasts_s,
        "s_m": 0.0,
        "d_m": 0.0,
        "heading_rad": 0.0,
        "speed_mps": 0.0,
        "accel_mps2": 0.0,
        "aside_m": 0.0,
    }
    return {**base, **changes}


def user(kind: str, *stretches: JsonObject) -> JsonObject:
    steps: list[Json] = list(stretches)
    return {"kind": kind, "stretches": steps}


def spec(*users: JsonObject, seed: int = 3, duration_s: float = 25.0, **place: Json) -> EpisodeSpec:
    everybody: list[Json] = list(users)
    return EpisodeSpec(
        simulator="brink-encounter@2",
        scenario={**PLACE, **place, "road_users": everybody},
        behaviour={"mode": "oracle"},
        requirements=ORACLES,
        seed=seed,
        duration_s=duration_s,
    )


def facts(value: Json) -> JsonObject:
    """Return a JSON value that must be an object."""
    assert isinstance(value, dict)
    return value


def told(result: EpisodeResult) -> list[JsonObject]:
    violations = result.features["violations"]
    assert isinstance(violations, list)
    return [facts(violation) for violation in violations]


def number(value: Json) -> float:
    assert isinstance(value, int | float)
    return float(value)


@pytest.fixture(name="simulator", scope="module")
def _simulator() -> BrinkEncounter:
    return BrinkEncounter()


BRAKES = user(
    "car",
    stretch("keep", 0.0, 2.0, s_m=20.0, speed_mps=8.0),
    stretch("brake", 2.0, 1.0, s_m=36.0, speed_mps=8.0, accel_mps2=-8.0),
    stretch("keep", 3.0, 30.0, s_m=40.0, speed_mps=0.0),
)
FROM_BEHIND = user("car", stretch("keep", 0.0, 30.0, s_m=-25.0, speed_mps=14.0))


@pytest.mark.parametrize("task", ["follow_road", "first_exit", "second_exit"])
@pytest.mark.parametrize("curve", ["straight", "left", "right", "crossroad"])
def test_ego_arrives_safely_on_an_empty_road(simulator: BrinkEncounter, curve: str, task: str) -> None:
    result = simulator.run(spec(duration_s=60.0, road_curve=curve, driving_task=task, road_length=0))
    assert result.features["ended"] == "goal"
    assert told(result) == []
    assert result.objectives["criticality_m"] == 200.0
    assert not any(verdict.violated for verdict in result.verdicts.values())


def test_a_script_is_followed_to_the_centimetre(simulator: BrinkEncounter) -> None:
    away = user(
        "van",
        stretch("accelerate", 0.0, 3.0, s_m=40.0, speed_mps=9.0, accel_mps2=1.0),
        stretch("change_left", 3.0, 2.0, s_m=71.5, speed_mps=12.0, aside_m=3.5),
        stretch("keep", 5.0, 30.0, s_m=95.5, d_m=3.5, speed_mps=12.0),
    )
    result = simulator.run(spec(away, duration_s=8.0), record=True)
    assert result.trace is not None
    trace = Trace.from_bytes(result.trace)
    (van,) = trace.actors
    s_of = {round(float(t), 1): row for t, row in zip(trace.time_s, van.motion, strict=True)}
    start_x = float(s_of[0.0][0]) - 40.0
    assert float(s_of[3.0][0]) - start_x == pytest.approx(71.5, abs=0.01)
    assert float(s_of[4.0][1]) - float(s_of[0.0][1]) == pytest.approx(1.75, abs=0.01)
    assert float(s_of[4.0][2]) > 0.1
    assert float(s_of[7.0][0]) - start_x == pytest.approx(95.5 + 24.0, abs=0.01)
    assert (van.kind, van.name) == ("vehicle", "van-1")


def test_the_ego_stops_for_visible_road_users_and_gaps_are_reported(simulator: BrinkEncounter) -> None:
    far = user("pedestrian", stretch("keep", 0.0, 30.0, s_m=60.0, d_m=-4.0, speed_mps=0.0))
    result = simulator.run(spec(BRAKES, far, duration_s=9.0))
    assert result.features["collision"] is None
    assert 0.0 < result.objectives["gap_1_m"] < 8.0
    assert result.objectives["criticality_m"] == result.objectives["gap_1_m"]
    assert result.objectives["gap_2_m"] > result.objectives["gap_1_m"]


def test_a_scripted_car_can_hit_the_ego_from_behind(simulator: BrinkEncounter) -> None:
    result = simulator.run(spec(FROM_BEHIND))
    assert result.features["collided_with"] == "car-1"
    (violation,) = told(result)
    other, ego = facts(violation["other"]), facts(violation["ego"])
    assert violation["requirement"] == "no-collision@1"
    assert (other["kind"], other["action"], other["index"]) == ("car", "keep", 1)
    assert abs(number(other["bearing_rad"])) > 2.9
    assert number(ego["speed_mps"]) > 5.0
    assert result.objectives["criticality_m"] <= 0.0
    assert facts(violation["place"])["element"] == "straight"


def test_scripted_vehicles_brake_for_each_other(simulator: BrinkEncounter) -> None:
    stands = user("car", stretch("keep", 0.0, 30.0, s_m=80.0, d_m=3.5, heading_rad=math.pi, speed_mps=0.0))
    comes = user("van", stretch("keep", 0.0, 30.0, s_m=140.0, d_m=3.5, heading_rad=math.pi, speed_mps=10.0))
    result = simulator.run(spec(stands, comes, duration_s=15.0), record=True)
    assert result.trace is not None
    car, van = Trace.from_bytes(result.trace).actors
    gap_m = np.abs(van.motion[:, 0] - car.motion[:, 0]) - 5.0
    assert gap_m.min() > 0.5
    assert van.motion[-1, 3] == pytest.approx(0.0, abs=0.05)


def test_only_the_first_violation_of_a_requirement_is_reported(simulator: BrinkEncounter) -> None:
    stands = user("car", stretch("keep", 0.0, 30.0, s_m=30.0, d_m=1.6, speed_mps=0.0))
    result = simulator.run(spec(stands, duration_s=20.0))
    requirements = [violation["requirement"] for violation in told(result)]
    assert len(requirements) == len(set(requirements))
    for violation in told(result):
        verdict = result.verdicts[str(violation["requirement"])]
        assert number(violation["time_s"]) == pytest.approx(verdict.violated_at_s)


def test_latency_pitch_and_the_least_visible_share_are_options(simulator: BrinkEncounter) -> None:
    behind_van = user("pedestrian", stretch("keep", 0.0, 30.0, s_m=24.0, d_m=-0.3, speed_mps=0.0))
    van = user("van", stretch("keep", 0.0, 30.0, s_m=18.0, speed_mps=0.0))

    def drive(**options: Json) -> Trace:
        trace = simulator.run(replace(spec(van, behind_van), options=options), record=True).trace
        assert trace is not None
        return Trace.from_bytes(trace)

    usual = drive()
    assert usual.pitch_rad is not None
    assert np.abs(usual.pitch_rad).max() > 0.001
    level = drive(pitch=False).pitch_rad
    assert level is not None
    assert not level.any()

    def brakes_at_s(trace: Trace) -> float:
        return float(trace.time_s[trace.ego[:, 4] < -1.0][0])

    assert brakes_at_s(drive(latency_s=0.6)) == pytest.approx(brakes_at_s(usual) + 0.5, abs=0.11)
    seen = [len(drive(least_visible=share).seen_boxes.at(0)) for share in (0.0, 0.25)]
    assert seen == [2, 1]


KEEPS = stretch("keep", 0.0, 5.0)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"scenario": {**PLACE}}, "road_users: missing"),
        ({"scenario": {**PLACE, "road_users": [], "pedestrians": 18}}, "list people as road_users"),
        ({"scenario": {**PLACE, "road_users": [user("car", KEEPS)] * 7}}, "at most 6"),
        ({"scenario": {**PLACE, "road_users": [user("tank", KEEPS)]}}, "one of car, van, pedestrian"),
        ({"scenario": {**PLACE, "road_users": [user("car")]}}, "1 to 64"),
        (
            {"scenario": {**PLACE, "road_users": [user("car", {**KEEPS, "speed_mps": math.nan})]}},
            r"speed_mps: expected a number in \[0, 40\]",
        ),
        ({"scenario": {**PLACE, "road_users": [user("car", {**KEEPS, "from_s": 1.0})]}}, "the first 0"),
        (
            {"scenario": {**PLACE, "road_users": [user("car", {**KEEPS, "jump": 1.0})]}},
            "unknown field 'jump'",
        ),
        ({"behaviour": {"mode": "detector"}}, "behaviour.mode: expected oracle"),
        ({"behaviour": {"mode": "oracle", "threshold": 0.5}}, "unknown field 'threshold'"),
        ({"options": {"reference": 1}}, "options.reference: expected true or false"),
        (
            {"options": {"fidelity": "wheels"}},
            "options: unknown field 'fidelity'; expected reference, latency_s, pitch, least_visible",
        ),
        ({"options": {"latency_s": 2.0}}, r"options.latency_s: expected a number in \[0, 1\]"),
        ({"duration_s": 500.0}, "at most 120"),
        ({"simulator": "brink-drive@3"}, "simulator: expected brink-encounter@2, got"),
    ],
)
def test_an_invalid_specification_is_refused(
    simulator: BrinkEncounter, changed: dict[str, object], message: str
) -> None:
    with pytest.raises(InvalidEpisode, match=message):
        simulator.run(replace(spec(), **changed))  # type: ignore[arg-type]


CAR = Rectangle(0.0, 0.0, 0.0, 2.0, 1.0)


@pytest.mark.parametrize(
    ("other", "gap_m"),
    [
        (Rectangle(7.0, 0.0, 0.0, 2.0, 1.0), 3.0),
        (Rectangle(7.0, 6.0, 0.0, 2.0, 1.0), 5.0),
        (Rectangle(0.0, 5.0, 0.5 * math.pi, 2.0, 1.0), 2.0),
        (Rectangle(3.5, 0.0, 0.0, 2.0, 1.0), -0.5),
        (Rectangle(2.0 + math.sqrt(2.0), 0.0, 0.25 * math.pi, 0.5, 0.5), 0.5 * math.sqrt(2.0)),
    ],
)
def test_gaps_of_rectangles(other: Rectangle, gap_m: float) -> None:
    assert signed_gap_m(CAR, other) == pytest.approx(gap_m)
    assert signed_gap_m(other, CAR) == pytest.approx(gap_m)


@pytest.mark.parametrize(
    ("x_m", "y_m", "degrees"),
    [(6.0, 0.0, 0.0), (6.0, 3.0, 45.0), (0.0, 4.0, 90.0), (-6.0, 0.0, 180.0), (6.0, -3.0, -45.0)],
)
def test_bearings_place_the_egos_corners_at_45_degrees(x_m: float, y_m: float, degrees: float) -> None:
    point = Rectangle(x_m, y_m, 0.0, 1e-6, 1e-6)
    expected = math.degrees(math.atan2(y_m / CAR.half_width_m, x_m / CAR.half_length_m))
    assert math.degrees(bearing_rad(CAR, point)) == pytest.approx(expected, abs=1e-3)
    assert math.degrees(bearing_rad(CAR, Rectangle(2.5, 1.5, 0.0, 0.5, 0.5))) == pytest.approx(45.0)
    assert abs(math.degrees(bearing_rad(CAR, point)) - degrees) < 25.0

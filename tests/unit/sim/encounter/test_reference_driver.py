"""Reference drivers: known stopping distances, empty roads, and what a careful driver does or does not avoid."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.sim.encounter.reference import (
    Driver,
    ObservedUser,
    avoidance,
    avoids,
    braking_mps2,
    is_risk,
    stopping_distance_m,
)
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.encounter.specification import EncounterScenario, Kind
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, JsonObject, Verdict
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import Trace

PROBLEM = NpcActions(NpcActionsParams())
CAR = (4.5, 1.8)


def with_driver(spec: EpisodeSpec, driver: Driver) -> EpisodeSpec:
    behaviour = {"mode": "reference", "driver": driver.value}
    return replace(spec, behaviour=behaviour)


def encounter(*road_users: Any, seed: int = 1) -> EpisodeSpec:
    rng = np.random.default_rng(0)
    spec = PROBLEM.episode(PROBLEM.space.sample(rng), seed)
    return replace(spec, scenario={**spec.scenario, "road_users": list(road_users)})


def road_user(kind: str, **motion: float) -> dict[str, Any]:
    stretch = {
        "action": "keep",
        "from_s": 0.0,
        "lasts_s": 60.0,
        "s_m": 0.0,
        "d_m": 0.0,
        "heading_rad": 0.0,
        "speed_mps": 0.0,
        "accel_mps2": 0.0,
        "aside_m": 0.0,
        **motion,
    }
    return {"kind": kind, "stretches": [stretch]}


def facts(value: Json) -> JsonObject:
    """Return a JSON value that must be an object."""
    assert isinstance(value, dict)
    return value


def collides(result: EpisodeResult) -> bool:
    return result.verdicts["no-collision@1"].robustness < 0.0


def test_the_careful_driver_stops_as_the_regulation_says() -> None:
    # 60 km/h: 1.45 s unbraked, 24.2 m, then 18.3 m at 0.774 g; and 2 m are left.
    assert stopping_distance_m(60 / 3.6) == pytest.approx(24.17 + 18.29 + 2.0, abs=0.01)
    assert stopping_distance_m(15.0, 15.0) == pytest.approx(15.0 * 1.45 + 2.0)
    assert stopping_distance_m(10.0, -5.0) > stopping_distance_m(10.0)


def test_a_vehicle_beside_is_a_risk_once_it_has_left_its_course() -> None:
    beside = ObservedUser(
        kind=Kind.CAR,
        gap_m=8.0,
        length_m=4.5,
        aside_m=1.5,
        width_m=1.8,
        along_mps=8.0,
        towards_mps=1.0,
        strayed_m=0.3,
    )
    assert not is_risk(beside, 12.0, CAR)
    assert is_risk(beside._replace(strayed_m=0.4), 12.0, CAR)
    assert is_risk(beside._replace(kind=Kind.PEDESTRIAN, along_mps=0.0), 12.0, CAR)
    assert not is_risk(beside._replace(strayed_m=0.4, towards_mps=-1.0), 12.0, CAR)


@pytest.mark.parametrize("driver", Driver)
def test_nobody_is_hit_on_an_empty_road_nor_behind_a_standing_car(driver: Driver) -> None:
    simulator = BrinkEncounter()
    empty = simulator.run(with_driver(encounter(), driver))
    assert not collides(empty)
    assert empty.verdicts["progress@1"].robustness > 0.0
    standing = simulator.run(with_driver(encounter(road_user("car", s_m=60.0)), driver))
    assert not collides(standing)
    assert standing.verdicts["front-gap@2"].robustness >= 0.0


@pytest.mark.parametrize("weather", ["wet", "soft_rain", "hard_rain"])
def test_the_careful_driver_knows_that_a_wet_road_needs_more_room(weather: str) -> None:
    spec = encounter(road_user("car", s_m=60.0))
    spec = with_driver(replace(spec, scenario={**spec.scenario, "weather": weather}), Driver.CAREFUL)
    result = BrinkEncounter().run(spec)
    assert not collides(result)
    assert result.verdicts["front-gap@2"].robustness >= 0.0


def test_tyres_limit_the_braking_that_a_driver_reckons_with() -> None:
    assert braking_mps2(0.9) == pytest.approx(0.774 * 9.81, rel=1e-3)
    assert braking_mps2(0.4) == pytest.approx(0.4 * 9.81, rel=1e-3)
    assert stopping_distance_m(10.0, hardest_mps2=braking_mps2(0.4)) > stopping_distance_m(10.0)


@pytest.mark.parametrize("driver", Driver)
def test_a_driver_who_has_stopped_behind_a_standing_car_stays(driver: Driver) -> None:
    result = BrinkEncounter().run(with_driver(encounter(road_user("car", s_m=40.0)), driver), record=True)
    assert result.trace is not None
    speed_mps = np.abs(Trace.from_bytes(result.trace).ego[:, 3])
    starts = np.count_nonzero((speed_mps[1:] >= 0.1) & (speed_mps[:-1] < 0.1))
    assert speed_mps[-1] < 0.1
    assert starts <= 3, "it may creep up, but does not lurch"


def test_a_car_that_drives_into_the_standing_ego_is_no_violation_and_no_near_miss_of_a_moving_ego() -> None:
    ahead, behind = road_user("car", s_m=40.0), road_user("car", s_m=-30.0, speed_mps=4.0)
    result = BrinkEncounter().run(encounter(ahead, behind))
    contact_m, moving_m = (result.objectives[name] for name in ("criticality_m", "moving_criticality_m"))
    assert contact_m < 0.0 < 1.0 < moving_m
    near = facts(result.features["closest_moving"])
    assert abs(float(str(facts(near["ego"])["speed_mps"]))) >= 0.3
    assert facts(result.features["closest"]) != near


def test_a_standing_driver_who_is_driven_into_has_not_avoided_anything() -> None:
    """The contact with a standing ego is no collision of its own, but it counts against the reference driver."""
    rammed = encounter(road_user("car", s_m=40.0), road_user("car", s_m=-30.0, speed_mps=4.0))
    drive = BrinkEncounter()._drive(
        with_driver(rammed, Driver.CAREFUL), EncounterScenario.from_json(rammed.scenario), record=False
    )
    assert not collides(drive.result)
    assert drive.contact_at_s is not None
    moment_s, verdicts = drive.contact_at_s - 1.0, drive.result.verdicts
    assert not avoids("front-gap@2", moment_s, verdicts, drive.contact_at_s)


@pytest.mark.parametrize(("s_m", "hits"), [(12.0, True), (18.0, True), (24.0, False), (60.0, False)])
def test_who_steps_out_close_ahead_is_hit_by_the_careful_driver_alone(s_m: float, hits: bool) -> None:
    simulator = BrinkEncounter()
    person = road_user("pedestrian", s_m=s_m, d_m=-3.5, heading_rad=1.57, speed_mps=1.6)
    results = {driver: simulator.run(with_driver(encounter(person), driver)) for driver in Driver}
    assert {driver: collides(result) for driver, result in results.items()} == {
        Driver.CAREFUL: hits,
        Driver.IDEAL: False,
    }


LANE_M = 3.5
BODY_M = (4.5, 1.8)


def cut_in(
    gap_m: float, speed_mps: float, lasts_s: float, ego_m: float, from_s: float = 3.0
) -> dict[str, Any]:
    """Return a car that is `gap_m` ahead on the left when it begins to cut in.

    Args:
        gap_m: Distance between the bumpers at that time.
        speed_mps: Its speed.
        lasts_s: How long it takes to cross into the ego's lane.
        ego_m: Station of the ego at that time.
        from_s: That time.
    """
    start_m = ego_m + BODY_M[0] + gap_m
    motion = {"s_m": start_m - speed_mps * from_s, "d_m": LANE_M, "speed_mps": speed_mps}
    across = {"from_s": from_s, "lasts_s": lasts_s, "s_m": start_m, "d_m": LANE_M, "aside_m": -LANE_M}
    done_s = from_s + lasts_s
    after = {"from_s": done_s, "s_m": start_m + speed_mps * lasts_s, "speed_mps": speed_mps}
    return {
        "kind": "car",
        "stretches": [
            *road_user("car", **motion, lasts_s=from_s)["stretches"],
            *road_user("car", **across, speed_mps=speed_mps)["stretches"],
            *road_user("car", **after)["stretches"],
        ],
    }


def regulation_avoids_cut_in(gap_m: float, speed_mps: float, lasts_s: float, ego_mps: float) -> bool:
    """Return whether the driver of UN R157, Annex 3, avoids a collision with a vehicle that cuts in.

    Integrates the regulation's figures on a line: the driver perceives a cut-in 0.4 s after the other has moved
    0.375 m sideways, and brakes 0.75 s after the time to collision is at most 2 s, up to 0.774 g within 0.6 s.
    """
    dt_s, time_s, speed = 0.01, 0.0, ego_mps
    perceived_s = brakes_s = math.inf
    while True:
        share = min(1.0, time_s / lasts_s)
        aside_m = LANE_M * (1.0 - share * share * (3.0 - 2.0 * share))
        if LANE_M - aside_m > 0.375:
            perceived_s = min(perceived_s, time_s + 0.4)
        if time_s >= perceived_s and gap_m <= 2.0 * (speed - speed_mps):
            brakes_s = min(brakes_s, time_s + 0.75)
        speed -= dt_s * 0.774 * 9.81 * min(1.0, max(0.0, (time_s - brakes_s) / 0.6))
        gap_m += dt_s * (speed_mps - speed)
        time_s += dt_s
        if -2.0 * BODY_M[0] < gap_m <= 0.0 and aside_m < BODY_M[1]:
            return False
        if speed <= speed_mps and share == 1.0:
            return True


@pytest.mark.parametrize(
    ("gaps_m", "speeds_mps", "durations_s", "differ"),
    [
        ((2.0, 6.0, 10.0, 15.0), (1.0, 4.0, 7.0), (1.5,), 1),
        pytest.param(
            (2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0),
            (1.0, 2.5, 4.0, 5.5, 7.0),
            (1.5, 2.5, 4.0),
            5,
            marks=pytest.mark.long,
        ),
    ],
)
def test_the_careful_driver_avoids_the_cut_ins_that_the_driver_of_the_regulation_avoids(
    gaps_m: tuple[float, ...], speeds_mps: tuple[float, ...], durations_s: tuple[float, ...], differ: int
) -> None:
    simulator = BrinkEncounter()
    alone = simulator.run(with_driver(encounter(), Driver.CAREFUL), record=True)
    assert alone.trace is not None
    trace = Trace.from_bytes(alone.trace)
    at = int(np.argmin(np.abs(trace.time_s - 3.0)))
    ego_m, ego_mps = float(np.hypot(*(trace.ego[at, :2] - trace.ego[0, :2]))), float(trace.ego[at, 3])
    avoided, disagree = [], 0
    for gap_m, speed_mps, lasts_s in itertools.product(gaps_m, speeds_mps, durations_s):
        avoided.append(regulation_avoids_cut_in(gap_m, speed_mps, lasts_s, ego_mps))
        spec = with_driver(encounter(cut_in(gap_m, speed_mps, lasts_s, ego_m)), Driver.CAREFUL)
        disagree += collides(simulator.run(spec)) is avoided[-1]
    assert 0.2 < np.mean(avoided) < 0.8
    assert disagree <= differ


def test_a_violation_says_who_would_have_avoided_it() -> None:
    simulator = BrinkEncounter()
    spec = encounter(cut_in(6.0, 1.0, 1.5, 21.4))
    plain, compared = simulator.run(replace(spec, options={})), simulator.run(spec, record=True)
    assert plain.verdicts == compared.verdicts
    assert "reference" not in plain.features
    violations, reference = compared.features["violations"], compared.features["reference"]
    assert isinstance(violations, list)
    assert isinstance(reference, dict)
    hit = next(one for one in violations if isinstance(one, dict) and one["requirement"] == "no-collision@1")
    assert (hit["avoidable"], hit["avoided_by"]) == ("ideal", "braking")
    before = plain.features["violations"]
    assert isinstance(before, list)
    assert {key: value for key, value in hit.items() if key not in ("avoidable", "avoided_by")} in before
    assert list(reference) == ["careful", "ideal"]
    careful, ideal = facts(reference["careful"]), facts(reference["ideal"])
    assert "no-collision@1" in facts(careful["violated_at_s"])
    assert careful["contact_at_s"] == facts(careful["violated_at_s"])["no-collision@1"]
    assert (ideal["violated_at_s"], ideal["contact_at_s"]) == ({}, None)
    assert 0.0 < float(str(ideal["brakes_at_s"])) < float(str(hit["time_s"]))
    assert careful["brakes_at_s"] is None, "it is hit before it reaches the brake"
    assert float(str(compared.provenance["reference_cpu_s"])) > 0.0
    assert compared.trace is not None
    trace = Trace.from_bytes(compared.trace)
    assert trace.reference is not None
    assert facts(trace.reference.about["spec"])["behaviour"] == {"mode": "reference", "driver": "ideal"}
    assert trace.reference.time_s[-1] == pytest.approx(float(str(hit["time_s"])) + 5.0, abs=0.11)
    again = simulator.run(spec, record=True)
    assert (again.features, again.trace) == (compared.features, compared.trace)


@pytest.mark.parametrize(
    ("brakes_at_s", "how"), [(None, "driving on"), (9.9, "braking"), (10.0, "braking"), (10.1, "driving on")]
)
def test_a_violation_is_avoided_by_braking_if_the_driver_brakes_before_it(
    brakes_at_s: float | None, how: str
) -> None:
    assert avoidance(10.0, brakes_at_s) == how


def test_a_driver_who_has_passed_before_a_car_moves_off_avoids_the_collision_by_driving_on() -> None:
    # The system gives way to a van and passes late, as the car that stood beside the way moves off.
    across = {"s_m": 47.75, "heading_rad": -math.pi / 2}
    van = road_user("van", **across, d_m=36.0, speed_mps=5.0)
    car = road_user("car", **across, d_m=4.5, lasts_s=10.5)
    off = road_user("car", **across, d_m=4.5, from_s=10.5, accel_mps2=2.35)
    result = BrinkEncounter().run(encounter({**car, "stretches": car["stretches"] + off["stretches"]}, van))
    violations, reference = result.features["violations"], facts(result.features["reference"])
    assert isinstance(violations, list)
    found = [facts(one) for one in violations]
    assert [(one["requirement"], one["avoidable"], one["avoided_by"]) for one in found] == [
        ("no-collision@1", "careful", "driving on")
    ]
    assert facts(reference["careful"])["brakes_at_s"] is None


def test_a_drive_without_a_violation_is_not_driven_again() -> None:
    found = BrinkEncounter().run(encounter(), record=True)
    assert "reference" not in found.features
    assert found.trace is not None
    assert Trace.from_bytes(found.trace).reference is None
    assert found.features["closest"] is None


@pytest.mark.parametrize(
    ("moments", "contact_at_s", "avoided"),
    [
        ({}, None, True),
        ({"front-gap@2": 9.0}, None, False),
        ({"front-gap@2": 15.1}, None, True),
        ({"no-collision@1": 4.0}, 4.0, False),
        ({"progress@1": 4.0}, None, True),
        ({}, 14.0, False),
        ({}, 15.1, True),
    ],
)
def test_what_counts_as_avoided(moments: dict[str, float], contact_at_s: float | None, avoided: bool) -> None:
    verdicts = {
        name: Verdict(robustness=-1.0 if name in moments else 1.0, unit="m", violated_at_s=moments.get(name))
        for name in ("front-gap@2", "no-collision@1", "progress@1")
    }
    assert avoids("front-gap@2", 10.0, verdicts, contact_at_s) is avoided


@pytest.mark.parametrize(
    ("weather", "candidates", "most"),
    [
        ("clear", 24, 2),
        pytest.param("clear", 80, 4, marks=pytest.mark.long),
        pytest.param("hard_rain", 80, 6, marks=pytest.mark.long),
    ],
)
def test_reference_drivers_cope_where_the_driving_system_does(
    weather: str, candidates: int, most: int
) -> None:
    rng = np.random.default_rng(0)
    simulator = BrinkEncounter()
    safe, hit = 0, dict.fromkeys(Driver, 0)
    for seed in range(candidates):
        spec = PROBLEM.episode(PROBLEM.space.sample(rng), 1000 + seed)
        spec = replace(spec, scenario={**spec.scenario, "weather": weather})
        if any(verdict.robustness < 0.0 for verdict in simulator.run(spec).verdicts.values()):
            continue
        safe += 1
        for driver in Driver:
            hit[driver] += collides(simulator.run(with_driver(spec, driver)))
    assert safe >= 0.75 * candidates
    assert hit[Driver.CAREFUL] <= most
    assert hit[Driver.IDEAL] == 0


@pytest.mark.parametrize("behaviour", [{"mode": "detector"}, {"mode": "reference", "driver": "reckless"}])
def test_other_behaviours_are_refused(behaviour: dict[str, Any]) -> None:
    spec = replace(encounter(), behaviour=behaviour)
    with pytest.raises(InvalidEpisode, match="behaviour"):
        BrinkEncounter().run(spec)

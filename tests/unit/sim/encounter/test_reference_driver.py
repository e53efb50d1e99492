"""Reference drivers: known stopping distances, empty roads, and what a careful driver does or does not avoid."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.sim.encounter.reference import Driver, Sight, is_risk, stopping_distance_m
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.encounter.specification import Kind
from brink.sim.episode import EpisodeResult, EpisodeSpec
from brink.sim.errors import InvalidEpisode

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
        "action": "keep", "from_s": 0.0, "lasts_s": 60.0, "s_m": 0.0, "d_m": 0.0, "heading_rad": 0.0,
        "speed_mps": 0.0, "accel_mps2": 0.0, "aside_m": 0.0, **motion,
    }  # fmt: skip
    return {"kind": kind, "stretches": [stretch]}


def collides(result: EpisodeResult) -> bool:
    return result.verdicts["no-collision@1"].robustness < 0.0


def test_the_careful_driver_stops_as_the_regulation_says() -> None:
    # 60 km/h: 1.45 s unbraked, 24.2 m, then 18.3 m at 0.774 g; and 2 m are left.
    assert stopping_distance_m(60 / 3.6) == pytest.approx(24.17 + 18.29 + 2.0, abs=0.01)
    assert stopping_distance_m(15.0, 15.0) == pytest.approx(15.0 * 1.45 + 2.0)
    assert stopping_distance_m(10.0, -5.0) > stopping_distance_m(10.0)


def test_a_vehicle_beside_is_a_risk_once_it_has_left_its_course() -> None:
    beside = Sight(
        kind=Kind.CAR, gap_m=8.0, length_m=4.5, aside_m=1.5, width_m=1.8, along_mps=8.0, towards_mps=1.0,
        strayed_m=0.3,
    )  # fmt: skip
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


@pytest.mark.parametrize(("s_m", "hits"), [(12.0, True), (18.0, True), (24.0, False), (60.0, False)])
def test_who_steps_out_close_ahead_is_hit_by_the_careful_driver_alone(s_m: float, hits: bool) -> None:
    simulator = BrinkEncounter()
    person = road_user("pedestrian", s_m=s_m, d_m=-3.5, heading_rad=1.57, speed_mps=1.6)
    results = {driver: simulator.run(with_driver(encounter(person), driver)) for driver in Driver}
    assert {driver: collides(result) for driver, result in results.items()} == {
        Driver.CAREFUL: hits, Driver.IDEAL: False,
    }  # fmt: skip


def test_reference_drivers_cope_where_the_driving_system_does() -> None:
    rng = np.random.default_rng(0)
    simulator = BrinkEncounter()
    safe, hit = 0, dict.fromkeys(Driver, 0)
    for seed in range(40):
        spec = PROBLEM.episode(PROBLEM.space.sample(rng), 1000 + seed)
        if any(verdict.robustness < 0.0 for verdict in simulator.run(spec).verdicts.values()):
            continue
        safe += 1
        for driver in Driver:
            hit[driver] += collides(simulator.run(with_driver(spec, driver)))
    assert safe >= 30
    assert hit[Driver.CAREFUL] <= 2
    assert hit[Driver.IDEAL] == 0


def test_equal_specifications_give_equal_results() -> None:
    person = road_user("pedestrian", s_m=40.0, d_m=-3.5, heading_rad=1.57, speed_mps=1.2)
    spec = with_driver(encounter(person), Driver.CAREFUL)
    first, second = BrinkEncounter().run(spec), BrinkEncounter().run(spec)
    assert (first.verdicts, first.features) == (second.verdicts, second.features)


@pytest.mark.parametrize("behaviour", [{"mode": "detector"}, {"mode": "reference", "driver": "reckless"}])
def test_other_behaviours_are_refused(behaviour: dict[str, Any]) -> None:
    spec = replace(encounter(), behaviour=behaviour)
    with pytest.raises(InvalidEpisode, match="behaviour"):
        BrinkEncounter().run(spec)

"""Encounters with a camera in the loop: the driving system gets the detector's boxes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.marks import mostly_long
from test_encounter_simulator import BRAKES, KEEPS, spec, stretch, user

from brink.server.problems.npc_actions import NpcActionsParams
from brink.sim.driving.camera import Camera
from brink.sim.encounter.camera import BrinkEncounterCamera
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.encounter.specification import EncounterScenario
from brink.sim.encounter.world import make_encounter
from brink.sim.episode import EpisodeSpec, Json, JsonObject
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.detector import find_detector
from brink.sim.rendering.scene import Light
from brink.sim.rendering.street import street_from_road
from brink.sim.trace import Trace
from brink.sim.urban.camera import RoadCamera
from brink.sim.world.road import build_road
from brink.sim.world.scenario import RoadCurve

DETECTOR: JsonObject = {"mode": "detector", "detector": "brink-det@2", "threshold": 0.5}


def seen(*users: JsonObject, duration_s: float = 4.0) -> EpisodeSpec:
    told = spec(*users, duration_s=duration_s)
    return replace(told, simulator="brink-encounter-camera@3", behaviour=DETECTOR)


def eyes_of(scenario: EncounterScenario, seed: int) -> RoadCamera:
    return RoadCamera(
        make_encounter(scenario, seed),
        Light(time_of_day=scenario.place.time_of_day, weather=scenario.place.weather),
        seed=seed,
        detector=find_detector("brink-det@2"),
        threshold=0.5,
        camera=Camera(),
    )


def test_the_ego_stops_for_detected_road_users() -> None:
    simulator = BrinkEncounterCamera()
    stands = user("car", stretch("keep", 0.0, 30.0, s_m=16.0))
    drive = seen(stands, duration_s=8.0)
    result = simulator.run(replace(drive, behaviour={**DETECTOR, "threshold": 0.4}), record=True)
    assert result.features["collision"] is None
    assert 0.0 < result.objectives["gap_1_m"] < 8.0
    assert result.trace is not None
    trace = Trace.from_bytes(result.trace)
    assert len(trace.seen_boxes.rows)
    assert float(trace.ego[-1, 3]) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("duration_s", mostly_long([0.5, 9.0], [0.5], "drives with a camera"))
def test_the_same_pictures_give_the_same_trace(duration_s: float) -> None:
    simulator = BrinkEncounterCamera()
    first, again = (simulator.run(seen(BRAKES, duration_s=duration_s), record=True) for _ in range(2))
    assert first.trace == again.trace


def test_boxes_are_converted_to_the_driving_systems_image() -> None:
    ahead = user("car", {**KEEPS, "s_m": 15.0})
    person = user("pedestrian", {**KEEPS, "s_m": 14.0, "d_m": -3.0})
    scenario = EncounterScenario.from_json(spec(ahead, person).scenario)
    eyes = eyes_of(scenario, seed=3)
    found = [(box.label.value, 0.5 * (box.x_min_px + box.x_max_px), box) for box in eyes.boxes(0.0)]
    # The car's rear is at 15 - 2.2 - 1.3 = 11.5 m: 1.7 m below and 1.8 m wide at a focal length of 400 px.
    (car,) = [box for label, middle, box in found if label == "vehicle" and abs(middle - 400) < 10]
    assert car.y_max_px == pytest.approx(300 + 400 * 1.7 / 11.5, abs=8)
    assert car.x_max_px - car.x_min_px == pytest.approx(400 * 1.8 / 11.5, abs=10)
    persons = [middle for label, middle, _ in found if label == "person"]
    assert any(middle == pytest.approx(400 + 400 * 3.0 / 12.7, abs=12) for middle in persons)


@pytest.mark.parametrize("curve", list(RoadCurve))
@pytest.mark.parametrize("road_id", mostly_long([0, 1, 2], [1], "draws many pictures"))
def test_every_road_can_be_rendered(curve: RoadCurve, road_id: int) -> None:
    scene = street_from_road(build_road(curve, road_id, 0))
    assert scene.buildings
    assert scene.parked or scene.trees
    assert all(np.isfinite(ground.points).all() for ground in scene.ground)
    place: dict[str, Json] = {"road_curve": curve.value, "road_id": road_id, "road_length": 0}
    scenario = EncounterScenario.from_json({**spec().scenario, **place})
    eyes = eyes_of(scenario, seed=1)
    assert all(math.isfinite(number) for box in eyes.boxes(0.0) for number in box[1:])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mode": "oracle"}, "behaviour.mode: expected detector"),
        ({"threshold": 1.5}, r"threshold: expected a number in \(0, 1\)"),
        ({"detector": 3}, "expected an id such as brink-det@2"),
        ({"weights": "0" * 64}, "differs from the file that the campaign was submitted with"),
        ({"sharpness": 1}, "unknown field 'sharpness'"),
    ],
)
def test_an_invalid_specification_is_refused(changes: JsonObject, message: str) -> None:
    wrong = replace(seen(), behaviour={**DETECTOR, **changes})
    with pytest.raises(InvalidEpisode, match=message):
        BrinkEncounterCamera().run(wrong)


def test_each_simulator_runs_only_its_own_episodes() -> None:
    with pytest.raises(InvalidEpisode, match="simulator: expected brink-encounter@2, got"):
        BrinkEncounter().run(seen())
    with pytest.raises(InvalidEpisode, match="simulator: expected brink-encounter-camera@3, got"):
        BrinkEncounterCamera().run(spec())


@pytest.mark.parametrize("curve", mostly_long(RoadCurve, [], "drives with a camera"))
def test_an_empty_road_causes_no_violation_at_the_default_threshold(curve: RoadCurve) -> None:
    away = user("pedestrian", {**KEEPS, "d_m": 45.0})
    told = seen(away, duration_s=20.0)
    place: dict[str, Json] = {"road_curve": curve.value, "road_id": 1, "road_length": 0}
    threshold = NpcActionsParams().threshold
    there = replace(told, scenario={**told.scenario, **place}, behaviour={**DETECTOR, "threshold": threshold})
    verdicts = BrinkEncounterCamera().run(there).verdicts
    assert [name for name, verdict in verdicts.items() if verdict.robustness < 0] == []

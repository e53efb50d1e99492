"""The model of a guard: its probabilities, its file, its alarm, and files that are none."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.guards import stump_guard

from brink.guard.choices import Sensor
from brink.guard.model import AlarmRule, GuardModel, feature_names
from brink.guard.monitor import Alarm, ModelGuard
from brink.sim.driving.interface import Command, EgoState, Observation
from brink.sim.errors import GuardFileError
from brink.sim.guard.interface import KnownConditions
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import LaneRoute

DRY = KnownConditions(rain=0.0, wet=0.0, dark=0.0)


def logistic(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-log_odds))


def rows(*speeds_mps: float, sensor: Sensor = Sensor.BOXES) -> np.ndarray:
    found = np.zeros((len(speeds_mps), len(feature_names(sensor))), np.float32)
    found[:, 0] = speeds_mps
    return found


def test_probabilities_are_those_of_the_trees_and_their_calibration() -> None:
    found = stump_guard().probabilities(rows(4.0, 6.0))
    assert found[0] == pytest.approx([logistic(-2.0)] * 3)
    assert found[1] == pytest.approx([logistic(2.0), logistic(3.0), logistic(4.0)])
    document = json.loads(stump_guard().to_json())
    document["calibration"] = [[1.0, 0.5], [0.0, 0.0], [-9.0, 1.0]]
    changed = GuardModel.from_json(json.dumps(document)).probabilities(rows(6.0))
    assert changed[0] == pytest.approx([logistic(2.0)] * 3), "a longer horizon is never less likely"


@pytest.mark.parametrize("sensor", list(Sensor))
def test_a_file_gives_the_same_guard(sensor: Sensor, tmp_path: Path) -> None:
    model, file = stump_guard(sensor=sensor), tmp_path / "guard.json"
    file.write_text(model.to_json(), encoding="utf-8")
    read = GuardModel.load(file)
    assert read.to_json() == model.to_json()
    assert (read.sensor, read.requirements, read.horizons_s, read.alarm) == (
        sensor,
        ("front-gap@1",),
        (1.0, 2.0, 3.0),
        model.alarm,
    )
    given = rows(1.0, 5.0, 9.0, sensor=sensor)
    assert (read.probabilities(given) == model.probabilities(given)).all()


def spoiled(path: str, value: Any) -> str:
    document = json.loads(stump_guard().to_json())
    *parents, last = path.split(".")
    place = document
    for one in parents:
        place = place[one]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return json.dumps(document)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected a guard"),
        ("[]", "format 'brink guard'"),
        ("[" * 100_000, "expected a guard"),
        (spoiled("format", "brink monitor"), "format 'brink guard'"),
        (spoiled("version", 2), "fit the guard again"),
        (spoiled("features.id", "guard-features@0"), "fit the guard again"),
        (spoiled("features.names", ["speed_mps"]), "fit the guard again"),
        (spoiled("sensor", "lidar"), "lidar"),
        (spoiled("sensor", "range"), "fit the guard again"),
        (spoiled("horizons_s", [3.0, 2.0, 1.0]), "ascending"),
        (spoiled("horizons_s", [1.0, 2.0]), "one model"),
        (spoiled("horizons_s", []), "ascending"),
        (spoiled("requirements", []), "requirements"),
        (spoiled("requirements", "front-gap@1"), "requirements"),
        (spoiled("forest", ...), "forest"),
        (spoiled("forest.right", [1, 0, 0, 5, 0, 0, 8, 0, 0]), "consistent"),
        (spoiled("forest.feature", [10**6] * 9), "consistent"),
        (spoiled("forest.value", ["x"] * 9), "ValueError"),
        (spoiled("calibration", [[0.0, 1.0]]), "calibration"),
        (spoiled("calibration", [[0.0, -1.0]] * 3), "slopes"),
        (spoiled("calibration", [[None, 1.0]] * 3), "calibration"),
        (spoiled("alarm.threshold", 1.5), "threshold"),
        (spoiled("alarm.release", 0.9), "release"),
        (spoiled("alarm.confirm_steps", 0), "confirm_steps"),
        (spoiled("alarm.confirm_steps", 2.5), "confirm_steps"),
        (spoiled("alarm.hold_s", -1.0), "hold_s"),
        (spoiled("alarm.hold_s", 1e308), "hold_s"),
        (spoiled("alarm.horizon_s", 1.5), "horizon_s"),
        (spoiled("alarm.code", "import os"), "code"),
        (spoiled("about", ...), "about"),
    ],
)
def test_what_is_no_guard_is_refused(text: str, words: str) -> None:
    with pytest.raises(GuardFileError, match=words):
        GuardModel.from_json(text)


def test_a_file_that_is_no_guard_is_named(tmp_path: Path) -> None:
    file = tmp_path / "picture.png"
    file.write_bytes(b"\x89PNG\xff\x00")
    with pytest.raises(GuardFileError, match=r"picture\.png.*binary"):
        GuardModel.load(file)
    file.write_text("{}")
    with pytest.raises(GuardFileError, match=r"picture\.png.*format"):
        GuardModel.load(file)
    with pytest.raises(FileNotFoundError):
        GuardModel.load(tmp_path / "missing.json")


def states(rule: AlarmRule, probabilities: list[float]) -> str:
    alarm = Alarm(rule)
    return "".join("x" if alarm.step(one) else "." for one in probabilities)


def test_an_alarm_is_confirmed_and_held() -> None:
    rule = AlarmRule(horizon_s=3.0, threshold=0.5, release=0.2, confirm_steps=2, hold_s=0.2)
    low, middle, high = 0.1, 0.3, 0.6
    assert states(rule, [high, low, high, high, low]) == "...xx"
    assert states(rule, [high, high, middle, middle, middle, middle]) == ".xxxxx", (
        "between release and threshold"
    )
    assert states(rule, [high, high, low, low, low, low]) == ".xxx..", "after more than 0.2 s"
    assert states(rule, [high, high, low, low, high, low, low, low]) == ".xxxxxx."
    at_once = AlarmRule(horizon_s=3.0, threshold=0.5, release=0.5, confirm_steps=1, hold_s=0.0)
    assert states(at_once, [0.5, 0.49, 0.5]) == "x.x"


@pytest.mark.parametrize("confirm_steps", [1, 2, 3])
def test_the_peak_is_the_highest_threshold_that_raises_an_alarm(confirm_steps: int) -> None:
    values = np.random.default_rng(confirm_steps).random(50).tolist()
    rule = AlarmRule(horizon_s=3.0, threshold=1.0, release=0.0, confirm_steps=confirm_steps)
    watching = Alarm(rule)
    for value in values:
        watching.step(value)
    for threshold, raises in ((watching.peak, True), (float(np.nextafter(watching.peak, 1.0)), False)):
        alarm = Alarm(replace(rule, threshold=threshold))
        assert any(alarm.step(value) for value in values) is raises
    assert Alarm(rule).peak == 0.0


def test_a_fitted_guard_must_know_the_conditions() -> None:
    """It has met no drive in which they were unknown."""
    route = LaneRoute(
        line=ReferenceLine(0.0, 0.0, 0.0, (Piece(100.0),)),
        lane_width_m=3.5,
        speed_limit_mps=14.0,
        stop_line_stations_m=(),
        oncoming=(),
    )
    with pytest.raises(ValueError, match="expected rain, wetness and darkness"):
        ModelGuard(stump_guard(), route, KnownConditions(rain=0.0, wet=0.0))


def test_a_file_is_replaced_only_by_a_whole_guard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "guard.json"
    stump_guard().save(file)
    before = file.read_text(encoding="utf-8")
    assert GuardModel.load(file).to_json() == stump_guard().to_json()
    monkeypatch.setattr(Path, "replace", lambda *_: pytest.fail("interrupted"))
    with pytest.raises(pytest.fail.Exception):
        stump_guard(above=9.0).save(file)
    assert file.read_text(encoding="utf-8") == before


def test_a_guard_answers_at_every_step_and_changes_at_perception_steps() -> None:
    route = LaneRoute(
        line=ReferenceLine(0.0, 0.0, 0.0, (Piece(100.0),)),
        lane_width_m=3.5,
        speed_limit_mps=14.0,
        stop_line_stations_m=(),
        oncoming=(),
    )
    guard = ModelGuard(stump_guard(), route, DRY)
    command = Command(accel_mps2=0.0, steer_rad=0.0)

    def step(number: int, speed_mps: float) -> tuple[tuple[float, ...], bool]:
        ego = EgoState(
            x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=speed_mps, accel_mps2=0.0, station_m=0.0, offset_m=0.0
        )
        boxes = None if number % 2 else ()
        return guard.step(Observation(time_s=0.05 * number, ego=ego, boxes=boxes, light=None), command)

    assert guard.horizons_s == (1.0, 2.0, 3.0)
    readings = [step(number, 6.0) for number in range(6)]
    assert readings[0][0] == pytest.approx([logistic(2.0), logistic(3.0), logistic(4.0)])
    assert [alarm for _, alarm in readings] == [False, False, True, True, True, True]
    assert step(7, 0.0) == readings[-1], "between perception steps"
    assert step(8, 0.0)[0] == pytest.approx([logistic(-2.0)] * 3)

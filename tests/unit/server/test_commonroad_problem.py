"""The problem of recorded traffic: parameters that are refused, episodes and words."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from brink.search.errors import ConfigError
from brink.search.parameters import Categorical
from brink.server.problems.base import describe_candidate
from brink.server.problems.commonroad import CommonRoad, CommonRoadParams
from brink.sim.commonroad.files import document_of, read_files
from brink.sim.commonroad.recording import Recording, packed
from brink.sim.commonroad.simulator import CommonRoadDrive
from brink.sim.driving_systems.interface import Decision, Start
from brink.sim.urban.detection_errors import errors_from_json

FOLDER = Path(__file__).parents[3] / "examples" / "commonroad"
BEND = (FOLDER / "bend.xml").read_text(encoding="utf-8")
FILES = read_files({"scenarios": str(FOLDER)}, FOLDER)["scenarios"]


def choices(problem: CommonRoad, name: str) -> tuple[str, ...]:
    parameter = next(one for one in problem.space.parameters if one.name == name)
    assert isinstance(parameter, Categorical)
    return parameter.choices


def test_files_are_a_category_of_the_space() -> None:
    problem = CommonRoad(CommonRoadParams(scenarios={**FILES, "as xml": BEND}))
    assert choices(problem, "file") == ("bend", "cut-in", "as xml")
    assert problem.params.scenarios["as xml"] == FILES["bend"]
    assert "pedestrian" in choices(problem, "error_1.target")  # there is one in cut-in
    alone = CommonRoad(CommonRoadParams(scenarios={"bend": BEND}))
    assert "pedestrian" not in choices(alone, "error_1.target")
    assert alone.usual_cells["target"] == ["lead"]


def short(seconds: int) -> str:
    document = document_of(BEND)
    document["goals"] = [{**document["goals"][0], "steps": [0, seconds * 5]}]
    return packed(document)


def test_errors_begin_within_the_drive_of_their_file() -> None:
    problem = CommonRoad(CommonRoadParams(scenarios={"long": BEND, "short": short(3)}, errors=3))
    rng = np.random.default_rng(2)
    durations = set()
    for seed in range(60):
        spec = problem.episode(problem.space.sample(rng), seed)
        durations.add((spec.scenario["file"], spec.duration_s))
        errors_from_json(spec.behaviour, spec.duration_s)
    assert durations == {("long", 10.0), ("short", 3.0)}


@pytest.mark.parametrize(
    ("given", "field", "message"),
    [
        ({"scenarios": {}}, "scenarios", "expected 1 to 200 files, got 0"),
        ({"scenarios": {"a": 1}}, "scenarios", "a: expected the content of a CommonRoad file as text"),
        ({"scenarios": {"a": "bend.xml"}}, "scenarios", "a: expected a packed recording"),
        ({"scenarios": {"a": BEND.replace("2018b", "2000a")}}, "scenarios", "a: commonRoadVersion"),
        ({"scenarios": {"a": BEND.replace("planningProblem", "x")}}, "scenarios", "<planningProblem>"),
        ({"requirement": "red-light@1"}, "requirement", "red-light@1"),
        (
            {"requirement": {"stop": {"stl": "always stop_line_gap_m > 1", "unit": "m"}}},
            "requirement",
            "no signal",
        ),
        ({"driving_settings": {"a": 1}}, "driving_settings", "other than modular@1"),
    ],
)
def test_refuses(given: dict[str, Any], field: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        CommonRoadParams(**given)
    assert error.value.field == field


def test_a_recording_that_is_too_short_is_refused() -> None:
    assert Recording.of(document_of(BEND)).duration_s == 10.0
    document = document_of(BEND)
    document["goals"] = [{**document["goals"][0], "steps": [0, 2]}]
    with pytest.raises(ConfigError, match=r"at least 1 s, got 0\.4 s"):
        CommonRoadParams(scenarios={"a": packed(document)})


def test_words_name_the_file() -> None:
    problem = CommonRoad(CommonRoadParams(scenarios=FILES))
    words = describe_candidate(problem, problem.space.sample(np.random.default_rng(4)))
    assert words.startswith(("bend, starts at", "cut-in, starts at"))


class Recorder:
    """A driving system that notes what it gets, and coasts."""

    needs = "objects"
    starts: list[Start]
    seen: list[Any]

    def __init__(self, start: Start) -> None:
        self.starts.append(start)

    def step(self, observation: Any) -> Decision:
        if observation.objects is not None:
            self.seen.append(observation.objects)
        return Decision(accel_mps2=0.0, steer_rad=0.0)


def test_a_driving_system_gets_the_route_and_the_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    Recorder.starts, Recorder.seen = [], []
    monkeypatch.setattr("brink.sim.driving_systems.option.factory_of", lambda *_: Recorder)
    problem = CommonRoad(CommonRoadParams(scenarios={"bend": BEND}, driving="mine@1"))
    truth = problem.with_truth()
    assert truth is not None
    spec = truth.episode(problem.space.sample(np.random.default_rng(1)), 1)
    result = CommonRoadDrive().run(spec)
    json.dumps(dict(result.features), allow_nan=False)
    (start,) = Recorder.starts
    assert start.route.speed_limit_mps == 13.89
    first = {one.id: one for one in Recorder.seen[0]}
    assert first[0].x_m == pytest.approx(16.0, abs=1.5)  # the car 16 m ahead, seen .1 s ago
    assert first[0].vx_mps == pytest.approx(8.0, abs=0.1)

"""Replays of drives in which the detector reports the truth with errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from brink.pictures import render
from brink.pictures.scene import (
    EpisodeScene,
    astray_words,
    count_wrong,
    ghost_words,
    has_errors,
    is_injected,
    wrong_boxes,
)
from brink.pictures.story import error_words
from brink.sim.episode import EpisodeSpec, Json, JsonObject
from brink.sim.trace import Trace
from brink.sim.urban.simulator import BrinkDriveErrors

SPEC = EpisodeSpec(
    simulator="brink-drive-errors@2",
    scenario={
        "time_of_day": "noon",
        "weather": "clear",
        "pedestrians": 0,
        "road_curve": "straight",
        "road_id": 0,
        "road_length": 0,
        "driving_task": "follow_road",
    },
    behaviour={
        "mode": "errors",
        "errors": [
            {
                "type": "left",
                "target": "lead",
                "magnitude": 1.0,
                "onset": "time",
                "onset_s": 1.0,
                "duration_s": 1.5,
            }
        ],
    },
    requirements=("front-gap@1",),
    seed=3,
    duration_s=4.0,
    options={"fidelity": "bicycle"},
)


@pytest.fixture(scope="module")
def trace() -> Trace:
    recorded = BrinkDriveErrors().run(SPEC, record=True).trace
    assert recorded is not None
    return Trace.from_bytes(recorded)


def test_only_what_is_wrong_is_shown_as_reported(trace: Trace) -> None:
    assert has_errors(trace)
    assert not is_injected(trace)
    counts = count_wrong(trace)
    assert np.flatnonzero(counts).tolist() == list(range(10, 25))
    assert set(counts.tolist()) == {0, 1}
    assert [len(wrong_boxes(trace, sample)) for sample in (5, 12, 30)] == [0, 1, 0]


@pytest.mark.parametrize(
    ("errors", "ghosts", "astray", "caption"),
    [
        ([], False, False, ""),
        (["miss"], False, False, ""),
        (["late"], False, False, ""),
        (["too_far"], False, True, "misplaced vehicle"),
        (["wrong_label"], False, True, "mislabelled vehicle"),
        (["too_far", "wrong_label"], False, True, "misplaced or mislabelled vehicle"),
        (["ghost_on_road"], True, False, "ghost vehicle"),
        (["miss", "ghost_on_road"], True, False, "ghost vehicle"),
        (["too_far", "ghost_on_road"], True, False, "ghost or misplaced vehicle"),
    ],
)
def test_only_errors_that_report_what_is_not_there_make_ghosts(
    errors: list[str], ghosts: bool, astray: bool, caption: str
) -> None:
    found: list[Json] = []
    for kind in errors:
        error: JsonObject = {"type": kind, "target": "lead", "magnitude": 1.0 if kind == "too_far" else 3.0}
        if kind != "late":
            error |= {"onset": "time", "onset_s": 1.0}
        if kind == "too_far":
            error["duration_s"] = 3.0
        found.append(error)
    behaviour: JsonObject = {"mode": "errors", "errors": found}
    recorded = BrinkDriveErrors().run(replace(SPEC, behaviour=behaviour), record=True).trace
    assert recorded is not None
    scene = EpisodeScene.of(Trace.from_bytes(recorded))
    assert bool(scene.obstacles.ghost.any()) is ghosts
    assert bool(scene.obstacles.astray.any()) is astray
    if caption:
        words = ghost_words if ghosts else astray_words
        assert words(scene.trace, 0) == caption


def test_a_trace_with_errors_that_cannot_be_read_is_drawn_all_the_same(trace: Trace) -> None:
    spoilt = replace(
        trace, about={"spec": {**SPEC.to_json(), "behaviour": {"mode": "errors", "errors": [3]}}}
    )
    assert error_words(spoilt) == "unknown errors"


def test_a_drive_with_errors_is_drawn(trace: Trace, tmp_path: Path) -> None:
    file = tmp_path / "drive.png"
    render(trace, file, requirement=("front-gap@1",))
    assert file.stat().st_size > 20_000

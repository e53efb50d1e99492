"""The camera in the loop and the data set, with detectors whose answers are known."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from aeb_episodes import spec
from numpy.typing import NDArray

from brink.sim import catalogue
from brink.sim.aeb.dataset import DatasetEvaluator
from brink.sim.aeb.pictures import LabelledFrame, Split, labelled_frames
from brink.sim.aeb.simulator import BrinkAeb
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.coco import read_coco
from brink.sim.perception.quality import Found
from brink.sim.perception.registry import DETECTORS
from brink.sim.perturbations import Pipeline, parse_perturbations
from brink.sim.trace import Trace

SIMULATOR, EVALUATOR = BrinkAeb(), DatasetEvaluator()
NOTHING = Found(
    labels=np.empty(0, np.int64), boxes=np.empty((0, 4), np.float32), scores=np.empty(0, np.float32)
)
FLARE: list[Json] = [{"gene": "sun_flare", "level": 6}, {"gene": "rain", "level": 2}]


class Known:
    """Finds what it was told to find, and keeps what it was shown."""

    def __init__(self) -> None:
        self.shown: list[NDArray[np.uint8]] = []
        self.found = NOTHING

    def detect(self, picture: NDArray[np.uint8]) -> Found:
        """Return what was told."""
        self.shown.append(picture.copy())
        return self.found


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> Known:
    detector = Known()
    monkeypatch.setitem(catalogue._registered, DETECTORS, {"known@1": lambda: detector})
    return detector


def person(score: float) -> Found:
    box = np.array([[300.0, 150.0, 340.0, 320.0]], np.float32)
    return Found(labels=np.array([1]), boxes=box, scores=np.array([score], np.float32))


def seen_by(seed: int, **behaviour: Any) -> EpisodeSpec:
    base = spec(seed)
    return replace(base, behaviour={"mode": "detector", "detector": "known@1", **behaviour})


def test_who_finds_nobody_hits_the_pedestrian(known: Known) -> None:
    result = SIMULATOR.run(seen_by(1))
    assert result.features["collided_with"] == "pedestrian"
    assert result.objectives["alpha"] == 0.0
    assert len(known.shown) == result.features["frames"]
    assert known.shown[0].shape == (360, 640, 3)


@pytest.mark.parametrize(("score", "stops"), [(0.9, 1), (0.2, 0)])
def test_a_person_who_is_not_there_is_a_dangerous_stop_if_the_detector_is_sure(
    known: Known, score: float, stops: int
) -> None:
    known.found = person(score)
    result = SIMULATOR.run(replace(seen_by(1), duration_s=3.0))
    assert result.features["no-dangerous-stop@1:dangerous_stops"] == stops
    assert result.verdicts["no-dangerous-stop@1"].violated is bool(stops)


def test_the_detector_is_shown_the_perturbed_pictures(known: Known) -> None:
    short = replace(seen_by(2), duration_s=0.3)
    SIMULATOR.run(short)
    clean, known.shown = known.shown, []
    SIMULATOR.run(replace(seen_by(2, perturbations=FLARE), duration_s=0.3))
    pipeline = Pipeline(parse_perturbations(FLARE), seed=short.seed)
    for index, (picture, shown) in enumerate(zip(clean, known.shown, strict=True)):
        assert np.array_equal(pipeline(picture, index), shown)
        assert not np.array_equal(picture, shown)


def test_the_same_specification_gives_the_same_pictures_and_trace(known: Known) -> None:
    short = replace(seen_by(3, perturbations=FLARE), duration_s=0.5)
    first = SIMULATOR.run(short, record=True)
    shown, known.shown = known.shown, []
    SIMULATOR.run(replace(seen_by(4), duration_s=0.2))
    known.shown = []
    again = SIMULATOR.run(short, record=True)
    assert first.trace == again.trace
    assert all(np.array_equal(a, b) for a, b in zip(shown, known.shown, strict=True))
    assert first.trace is not None
    assert len(Trace.from_bytes(first.trace).seen_boxes.rows) > 0


def test_pictures_are_labelled_the_same_each_time_and_differ_between_splits() -> None:
    first, again = list(labelled_frames(Split.TRAIN, 3)), list(labelled_frames(Split.TRAIN, 3))
    other = list(labelled_frames(Split.TEST, 3))
    assert all(np.array_equal(a.picture, b.picture) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(a.picture, b.picture) for a, b in zip(first, other, strict=True))
    for frame in first:
        assert len(frame.truth.boxes) == len(frame.truth.labels) == len(frame.depths_m)
        assert (frame.truth.boxes[:, 2:] > frame.truth.boxes[:, :2]).all()


def evaluation(*, frames: int = 12, **behaviour: Any) -> EpisodeSpec:
    return EpisodeSpec(
        simulator="brink-dataset@1", scenario={"dataset": "simulator", "frames": frames},
        behaviour={"detector": "known@1", **behaviour}, requirements=(), seed=0, duration_s=1.0,
    )  # fmt: skip


class Cheating(Known):
    """Finds the truth of the pictures in their order."""

    def __init__(self, frames: list[LabelledFrame]) -> None:
        super().__init__()
        self.frames = iter(frames)

    def detect(self, picture: NDArray[np.uint8]) -> Found:
        """Return the truth of the next picture."""
        truth = next(self.frames).truth
        return Found(labels=truth.labels, boxes=truth.boxes, scores=np.ones(len(truth.labels), np.float32))


def test_alpha_is_one_for_the_truth_and_nothing_for_nothing(
    monkeypatch: pytest.MonkeyPatch, known: Known
) -> None:
    assert EVALUATOR.run(evaluation()).objectives == {"alpha": 0.0}
    cheat = Cheating(list(labelled_frames(Split.VALIDATION, 12, seed=1)))
    monkeypatch.setitem(catalogue._registered, DETECTORS, {"known@1": lambda: cheat})
    result = EVALUATOR.run(evaluation())
    assert result.objectives["alpha"] == pytest.approx(1.0)
    assert result.verdicts == {}


def test_the_second_gene_works_on_what_the_first_one_left(known: Known) -> None:
    EVALUATOR.run(evaluation(perturbations=FLARE))
    both, known.shown = known.shown, []
    EVALUATOR.run(evaluation(perturbations=FLARE[1:]))
    assert not any(np.array_equal(a, b) for a, b in zip(both, known.shown, strict=True))
    frames = list(labelled_frames(Split.VALIDATION, 12, seed=1))
    pipeline = Pipeline(parse_perturbations(FLARE), seed=0)
    assert all(
        np.array_equal(pipeline(f.picture, i), s) for i, (f, s) in enumerate(zip(frames, both, strict=True))
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenario": {"dataset": "elsewhere", "frames": 3}}, "scenario.dataset: elsewhere: No such file"),
        ({"scenario": {"frames": 0}}, r"scenario.frames: expected a whole number in \[1, 5000\]"),
        ({"scenario": {"frames": 3, "size": 3}}, "unknown field 'size'"),
        ({"behaviour": {"detector": "unknown@1"}}, "detector: expected one of"),
        ({"behaviour": {"perturbations": [{"gene": "snwo", "level": 1}]}}, "snow"),
        ({"behaviour": {"perturbations": [{"gene": "snow", "level": 9}]}}, "behaviour.perturbations"),
        ({"simulator": "brink-aeb@1"}, "this is brink-dataset@1"),
    ],
)
def test_what_can_never_be_evaluated_is_told(known: Known, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidEpisode, match=message):
        EVALUATOR.run(replace(evaluation(), **changes))


def test_a_user_s_own_pictures_are_measured(known: Known, tmp_path: Path) -> None:
    picture = np.full((180, 320, 3), 90, np.uint8)
    for name in ("a.png", "b.png", "c.png"):
        cv2.imwrite(str(tmp_path / name), picture)
    document = {
        "images": [
            {"id": i, "file_name": name, "width": 320, "height": 180}
            for i, name in enumerate(("a.png", "b.png", "c.png"))
        ],
        "annotations": [
            {"id": i, "image_id": i, "category_id": 1, "bbox": [300 - 10 * i, 150, 20, 30]} for i in range(3)
        ],
        "categories": [{"id": 1, "name": "person"}],
    }
    file = tmp_path / "labels.json"
    file.write_text(json.dumps(document))
    known.found = person(0.9)
    data: dict[str, Json] = {"dataset": str(file), "frames": 2, "digest": read_coco(file).digest}
    result = EVALUATOR.run(replace(evaluation(), scenario=data))
    assert [shown.shape for shown in known.shown] == [(180, 320, 3)] * 2
    assert 0.0 <= result.objectives["alpha"] <= 1.0
    file.write_text(json.dumps({**document, "info": {}}))
    with pytest.raises(InvalidEpisode, match="not the one that the campaign was submitted with"):
        EVALUATOR.run(replace(evaluation(), scenario={**data, "seed": 1}))
    file.write_text(json.dumps(document))
    cv2.imwrite(str(tmp_path / "a.png"), picture[:90])
    with pytest.raises(InvalidEpisode, match="expected 320 x 180 px"):
        EVALUATOR.run(replace(evaluation(), scenario={**data, "seed": 2}))

"""The camera in the loop and the data-set evaluator, with fake detectors."""

import json
import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from aeb_episodes import spec
from numpy.typing import NDArray
from support.marks import mostly_long

from benchmarks.training.images import render_frames
from brink.sim import catalogue
from brink.sim.aeb import dataset
from brink.sim.aeb.dataset import DatasetEvaluator, Split, labelled_frames
from brink.sim.aeb.film import MAX_PICTURE_BYTES, CameraShot, FilmRecorder
from brink.sim.aeb.scores import rescore
from brink.sim.aeb.simulator import BrinkAeb
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.boxes import Detections, GroundTruth, LabelledFrame
from brink.sim.perception.detector import DETECTORS
from brink.sim.perception.user_files import read_coco
from brink.sim.perturbations import Pipeline, parse_perturbations
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.rendering.scene import Body, BodyKind, Frame, StreetScene, Viewpoint
from brink.sim.trace import MAX_TRACE_BYTES, Trace
from brink.sim.world.ego import EGO_CAR
from brink.worker.wire import Completed

SIMULATOR, EVALUATOR = BrinkAeb(), DatasetEvaluator()
NOTHING = Detections(
    labels=np.empty(0, np.int64), boxes=np.empty((0, 4), np.float32), scores=np.empty(0, np.float32)
)
FLARE: list[Json] = [{"gene": "sun_flare", "level": 6}, {"gene": "rain", "level": 2}]


class Known:
    """Returns fixed detections and records the pictures that it was shown."""

    def __init__(self) -> None:
        self.shown: list[NDArray[np.uint8]] = []
        self.found = NOTHING

    def detect(self, picture: NDArray[np.uint8]) -> Detections:
        """Return the fixed detections."""
        self.shown.append(picture.copy())
        return self.found


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> Known:
    detector = Known()
    monkeypatch.setitem(catalogue._registered, DETECTORS, {"known@1": lambda: detector})
    return detector


def person(score: float) -> Detections:
    box = np.array([[300.0, 150.0, 340.0, 320.0]], np.float32)
    return Detections(labels=np.array([1]), boxes=box, scores=np.array([score], np.float32))


def seen_by(seed: int, **behaviour: Any) -> EpisodeSpec:
    base = spec(seed)
    return replace(base, behaviour={"mode": "detector", "detector": "known@1", **behaviour})


@pytest.mark.long("drives with a camera")
def test_a_detector_that_finds_nothing_hits_the_pedestrian(known: Known) -> None:
    result = SIMULATOR.run(seen_by(1))
    assert result.features["collided_with"] == "pedestrian"
    assert result.objectives["alpha"] == 0.0
    assert len(known.shown) == result.features["frames"]
    assert known.shown[0].shape == (360, 640, 3)


@pytest.mark.parametrize(("score", "stops"), mostly_long([(0.9, 1), (0.2, 0)], [], "drives with a camera"))
def test_a_confident_false_positive_causes_a_dangerous_stop(known: Known, score: float, stops: int) -> None:
    known.found = person(score)
    result = SIMULATOR.run(replace(seen_by(1), duration_s=3.0))
    assert result.features["no-dangerous-stop@1:dangerous_stops"] == stops
    assert result.verdicts["no-dangerous-stop@1"].violated is bool(stops)


@pytest.mark.parametrize(
    ("box", "label", "brakes"),
    [
        ((300, 348, 340, 359), 0, False),
        ((300, 320, 340, 360), 0, True),
        ((300, 331, 340, 360), 0, False),
        ((318, 300, 323, 340), 1, False),
        ((318, 300, 326, 340), 1, True),
        ((300, 349, 340, 360), 1, False),
    ],
)
def test_the_brake_gets_no_box_that_is_too_small_or_a_vehicle_too_flat(
    known: Known, box: tuple[int, ...], label: int, brakes: bool
) -> None:
    """Boxes of less than 12 x 6 px count nowhere; a vehicle of 29 px at the lower edge would be .27 m high."""
    known.found = Detections(
        labels=np.array([label], np.int64),
        boxes=np.array([box], np.float32),
        scores=np.array([0.9], np.float32),
    )
    result = SIMULATOR.run(replace(seen_by(1), duration_s=0.5), record=True)
    assert (result.features["braked_at_s"] is not None) is brakes
    assert result.trace is not None
    film = Trace.from_bytes(result.trace).film
    assert film is not None
    assert len(film.found.at(0)) == 1, "the film shows all of them"


def test_the_detector_is_shown_the_perturbed_pictures_the_same_each_time(known: Known) -> None:
    clean = replace(seen_by(3), duration_s=0.15)
    perturbed = replace(seen_by(3, perturbations=FLARE), duration_s=0.15)
    first = SIMULATOR.run(perturbed, record=True)
    shown, known.shown = known.shown, []
    SIMULATOR.run(clean)
    seen, known.shown = known.shown, []
    again = SIMULATOR.run(perturbed, record=True)
    assert first.trace == again.trace
    assert len(shown) == 3
    assert all(np.array_equal(a, b) for a, b in zip(shown, known.shown, strict=True))
    pipeline = Pipeline(parse_perturbations(FLARE), seed=clean.seed)
    for index, (picture, changed) in enumerate(zip(seen, shown, strict=True)):
        assert np.array_equal(pipeline(picture, index), changed)
        assert not np.array_equal(picture, changed)
    assert first.trace is not None
    assert len(Trace.from_bytes(first.trace).seen_boxes.rows) > 0


@pytest.mark.long("draws many pictures")
def test_labelled_pictures_are_reproducible_and_differ_between_splits() -> None:
    first, again = list(labelled_frames(Split.TRAIN, 3)), list(labelled_frames(Split.TRAIN, 3))
    other = list(labelled_frames(Split.TEST, 3))
    assert all(np.array_equal(a.picture, b.picture) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(a.picture, b.picture) for a, b in zip(first, other, strict=True))
    for frame in first:
        assert len(frame.truth.boxes) == len(frame.truth.labels) == len(frame.depths_m)
        assert (frame.truth.boxes[:, 2:] > frame.truth.boxes[:, :2]).all()


@pytest.mark.parametrize("split", list(Split))
def test_bodies_in_labelled_pictures_stand_away_from_the_ego_car_and_people_in_no_vehicle(
    monkeypatch: pytest.MonkeyPatch, split: Split
) -> None:
    """Street and people are as in real pictures; only the painting is left out."""
    views: list[tuple[Viewpoint, list[Body]]] = []

    def gap_m(one: Rectangle, other: Rectangle) -> float:
        """Return the gap of two rectangles; that of the circles around them, which is less, if it is above 1 m."""
        reach_m = sum(math.hypot(each.half_length_m, each.half_width_m) for each in (one, other))
        least_m = math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) - reach_m
        return least_m if least_m > 1.0 else signed_gap_m(one, other)

    class Unpainted:
        def __init__(self, scene: StreetScene, *_: object) -> None:
            self.parked = scene.parked

        def frame(self, view: Viewpoint, bodies: list[Body], _: float) -> Frame:
            views.append((view, [*self.parked, *bodies]))
            image, ids = np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.int32)
            return Frame(image=image, ids=ids, outlines={})

    monkeypatch.setattr(dataset, "Renderer", Unpainted)
    assert len(list(labelled_frames(split, 200))) == len(views) == 200
    for view, bodies in views:
        ego = Rectangle(view.x_m, view.y_m, view.yaw_rad, 0.5 * EGO_CAR.length_m, 0.5 * EGO_CAR.width_m)
        assert all(gap_m(ego, Rectangle.of(body)) > 0.5 for body in bodies)
        people = [body for body in bodies if body.kind is BodyKind.PERSON]
        for person, vehicle in product(people, (body for body in bodies if body.kind is BodyKind.VEHICLE)):
            assert gap_m(Rectangle.of(person), Rectangle.of(vehicle)) > 0.0
    assert sum(len(bodies) for _, bodies in views) > 200 * 10


def test_several_processes_render_the_pictures_of_a_single_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def of_a_street(split: Split, rng: np.random.Generator, width_px: int) -> Iterator[tuple[int, float]]:
        for _ in range(dataset.FRAMES_A_STREET):
            yield width_px, rng.random()

    monkeypatch.setattr(dataset, "_street_frames", of_a_street)
    with ThreadPoolExecutor(3) as pool:
        found = list(render_frames(pool, Split.TEST, 45))
    large = list(labelled_frames(Split.TEST, 34))
    assert found == large + list(labelled_frames(Split.TEST, 11, seed=1, width_px=320))


FRAMES = 4


@cache
def frames() -> list[LabelledFrame]:
    """Return the labelled pictures that `evaluation` shows."""
    return list(labelled_frames(Split.VALIDATION, FRAMES, seed=1))


def evaluation(**behaviour: Any) -> EpisodeSpec:
    return EpisodeSpec(
        simulator="brink-dataset@2",
        scenario={"dataset": "simulator", "frames": FRAMES},
        behaviour={"detector": "known@1", **behaviour},
        requirements=(),
        seed=0,
        duration_s=1.0,
    )


class Cheating(Known):
    """Returns the ground truth of each picture in turn."""

    def __init__(self, frames: list[LabelledFrame]) -> None:
        super().__init__()
        self.frames = iter(frames)

    def detect(self, picture: NDArray[np.uint8]) -> Detections:
        """Return the ground truth of the next picture."""
        truth = next(self.frames).truth
        return Detections(
            labels=truth.labels, boxes=truth.boxes, scores=np.ones(len(truth.labels), np.float32)
        )


def test_alpha_is_one_for_truth_and_zero_for_nothing(monkeypatch: pytest.MonkeyPatch, known: Known) -> None:
    assert EVALUATOR.run(evaluation()).objectives["alpha"] == 0.0
    cheat = Cheating(frames())
    monkeypatch.setitem(catalogue._registered, DETECTORS, {"known@1": lambda: cheat})
    result = EVALUATOR.run(evaluation())
    assert result.objectives == {"alpha": pytest.approx(1.0), "decision_accuracy": 1.0}
    assert result.verdicts == {}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenario": {"dataset": "elsewhere", "frames": 3}}, "scenario.dataset: elsewhere: No such file"),
        ({"scenario": {"frames": 0}}, r"scenario.frames: expected an integer in \[1, 5000\]"),
        ({"scenario": {"frames": 3, "size": 3}}, "unknown field 'size'"),
        ({"behaviour": {"detector": "unknown@1"}}, "detector: expected one of"),
        ({"behaviour": {"perturbations": [{"gene": "snwo", "level": 1}]}}, "snow"),
        ({"behaviour": {"perturbations": [{"gene": "snow", "level": 9}]}}, "behaviour.perturbations"),
        ({"simulator": "brink-aeb@3"}, "simulator: expected brink-dataset@2, got"),
    ],
)
def test_an_invalid_evaluation_is_refused(known: Known, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidEpisode, match=message):
        EVALUATOR.run(replace(evaluation(), **changes))


def test_users_pictures_are_evaluated(known: Known, tmp_path: Path) -> None:
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
    with pytest.raises(
        InvalidEpisode, match="differs from the data set that the campaign was submitted with"
    ):
        EVALUATOR.run(replace(evaluation(), scenario={**data, "seed": 1}))
    file.write_text(json.dumps(document))
    cv2.imwrite(str(tmp_path / "a.png"), picture[:90])
    with pytest.raises(InvalidEpisode, match="expected 320 x 180 px"):
        EVALUATOR.run(replace(evaluation(), scenario={**data, "seed": 2}))


class Half:
    """Finds a person in the lane with high confidence in every second picture, and a vehicle that does not exist."""

    def __init__(self) -> None:
        self.looks = 0

    def detect(self, picture: NDArray[np.uint8]) -> Detections:
        """Return two boxes."""
        self.looks += 1
        boxes = np.array([[300, 150, 340, 320], [20, 20, 80, 60]], np.float32)
        scores = np.array([0.9 if self.looks % 2 else 0.1, 0.5], np.float32)
        return Detections(labels=np.array([1, 0]), boxes=boxes, scores=scores)


@pytest.fixture(scope="module")
def trace() -> Trace:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue._registered, DETECTORS, {"half@1": Half})
        behaviour: dict[str, Json] = {
            "mode": "detector",
            "detector": "half@1",
            "threshold": 0.4,
            "perturbations": [{"gene": "snow", "level": 3}],
        }
        result = BrinkAeb().run(replace(spec(3), behaviour=behaviour, duration_s=1.0), record=True)
    assert result.trace is not None
    kept = Trace.from_bytes(result.trace)
    assert kept.film is not None
    again = rescore(kept.film, 0.4)
    assert again.recall_inside == pytest.approx(result.features["recall_inside"])
    assert again.precision == pytest.approx(result.features["precision"])
    assert again.alpha == pytest.approx(result.objectives["alpha"])
    return kept


@pytest.mark.parametrize(("noise", "every"), [(0, 2), (255, 8)])
def test_a_film_that_would_be_too_large_has_fewer_images_a_second(noise: int, every: int) -> None:
    film = FilmRecorder()
    grains = np.random.default_rng(1).integers(0, noise + 1, (360, 640, 3), dtype=np.uint8)
    truth = GroundTruth(labels=NOTHING.labels, boxes=NOTHING.boxes, ignored=np.zeros(0, np.bool_))
    for sample in range(400):
        film.append(sample, CameraShot(picture=grains, truth=truth, found=NOTHING))
    made = film.film(401, (640, 360))
    assert made is not None
    assert sum(map(len, made.pictures)) <= MAX_PICTURE_BYTES
    assert made.samples.tolist() == list(range(0, 400, every)), "at even intervals, no longer than necessary"
    assert len(made.judged.first) == 402, "the boxes of all frames are kept"


def test_a_worker_may_send_the_largest_trace() -> None:
    (in_base64, _) = Completed.model_json_schema()["properties"]["trace"]["anyOf"]
    assert in_base64["maxLength"] * 3 // 4 >= MAX_TRACE_BYTES > MAX_PICTURE_BYTES

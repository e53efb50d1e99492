"""Labelled images of the emergency-braking street, and the evaluator `brink-dataset@2`.

The images show streets at all times of day and in all weather. Training, validation and test use disjoint seeds and
disjoint `look` values: the same shapes and textures occur in all three, in other combinations. People stand and
walk where the emergency-braking episode places them, and elsewhere at all distances. Unusual bodies and
perturbations never occur, so that both remain unknown to the detector; see `benchmarks/training/augmentation.py` for
what training does to the images.

The evaluator measures a detector on a data set seen through perturbations. It has the interface of a simulator, so
data-set evaluations are jobs like any other. Perturbations are applied to each frame in order, and the same
specification gives the same result.
"""

import math
import time
from collections.abc import Iterator
from dataclasses import replace
from enum import IntEnum
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np

from brink.sim.aeb.braking import CRUISE_MPS, Region
from brink.sim.aeb.labels import label_frame
from brink.sim.aeb.scores import decision_accuracy
from brink.sim.aeb.specification import (
    ARRIVAL_S,
    CROSSING_M,
    ONCOMING_M,
    AebScenario,
    Behaviour,
    Occluder,
    SightMode,
    check_weights,
)
from brink.sim.aeb.street import KERB_M, LANE_M, LANE_Y_M, PERSON_SIZE_M, STRIP_M, make_street
from brink.sim.bullet.engine import bullet_versions
from brink.sim.episode import EpisodeResult, EpisodeSpec, parse_integer
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.perception.boxes import GroundTruth, LabelledFrame, curves
from brink.sim.perception.detector import LABELS, Picture, find_detector
from brink.sim.perception.user_files import CocoPicture, DatasetError, read_coco, sample_evenly
from brink.sim.perturbations import Pipeline
from brink.sim.plane import Rectangle, signed_gap_m
from brink.sim.provenance import provenance
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import Body, BodyKind, Light, PictureCamera, StreetScene, Viewpoint
from brink.sim.world.ego import EGO_CAR
from brink.sim.world.scenario import TimeOfDay, Weather

SIZE_PX: Final = (640, 360)
FRAMES_A_STREET: Final = 10
CLEAR_M: Final = 0.5
"""No body stands nearer to the body of the ego car: at such a gap an image shows a crash, not a street."""
_MAX_YAW_RAD: Final = 0.05
"""Keeps the corners of the ego car away from the parked vehicles."""
_DRAWS: Final = 6
_CHILDREN: Final = 0.12
"""Share of the people who are as small as children."""


class Split(IntEnum):
    """Split that an image belongs to; its value also offsets the image's seeds and `look` values."""

    TRAIN = 1
    VALIDATION = 2
    TEST = 3


def labelled_frames(
    split: Split, count: int, seed: int = 0, *, width_px: int = SIZE_PX[0], first_street: int = 0
) -> Iterator[LabelledFrame]:
    """Yield labelled images; the same arguments always give the same images.

    Args:
        split: One of the three disjoint sets.
        count: Number of images.
        seed: Selects the images within the set.
        width_px: Width of the images, which are 16:9.
        first_street: Number of streets to leave out, each of `FRAMES_A_STREET` images.
    """
    for street in range(-(-count // FRAMES_A_STREET)):
        rng = np.random.default_rng(
            np.random.SeedSequence(seed, spawn_key=(int(split), first_street + street))
        )
        yield from islice(_street_frames(split, rng, width_px), count - street * FRAMES_A_STREET)


def example_picture() -> Picture:
    """Return an image of a street at noon with vehicles and people, shape ``(720, 1280, 3)``."""
    *_, frame = labelled_frames(Split.TEST, 6, seed=8, width_px=1280)
    return frame.picture


def _street_frames(split: Split, rng: np.random.Generator, width_px: int) -> Iterator[LabelledFrame]:
    scenario = AebScenario(
        time_of_day=list(TimeOfDay)[int(rng.integers(len(TimeOfDay)))],
        weather=list(Weather)[int(rng.integers(len(Weather)))],
        occluder=list(Occluder)[int(rng.integers(len(Occluder)))],
        crossing_m=float(rng.uniform(*CROSSING_M)),
        arrival_s=float(rng.uniform(*ARRIVAL_S)),
        oncoming_m=float(rng.uniform(*ONCOMING_M)),
    )
    street = make_street(scenario, int(split) * 10**6 + int(rng.integers(10**6)))
    scene = _with_looks(street.scene, split)
    renderer = Renderer(
        scene,
        Light(time_of_day=scenario.time_of_day, weather=scenario.weather),
        PictureCamera(width_px=width_px, height_px=width_px * SIZE_PX[1] // SIZE_PX[0]),
        int(split) * 10**6 + int(rng.integers(10**6)),
    )
    standing = [*map(Rectangle.of, scene.parked), *map(Rectangle.of, scene.furniture)]
    people_from = 10_000
    for time_s in np.sort(rng.uniform(0.0, 12.0, FRAMES_A_STREET)).tolist():
        x_m = CRUISE_MPS * time_s
        actors = [_with_look(actor.current_body(), split) for actor in street.actors]
        moved = [replace(body, x_m=x_m + float(rng.uniform(-5.0, 60.0))) for body in actors]
        view = Viewpoint(
            x_m=x_m,
            y_m=LANE_Y_M + float(rng.uniform(-0.3, 0.3)),
            yaw_rad=float(np.clip(rng.normal(0.0, 0.02), -_MAX_YAW_RAD, _MAX_YAW_RAD)),
            pitch_rad=float(rng.normal(0.0, 0.01)),
        )
        ego = Rectangle(view.x_m, view.y_m, view.yaw_rad, 0.5 * EGO_CAR.length_m, 0.5 * EGO_CAR.width_m)
        bodies = _without_overlaps(
            [body for body in moved if _stands_free(Rectangle.of(body), ego, standing)]
        )
        for index in range(int(rng.integers(3, 11))):
            taken = [*standing, *(Rectangle.of(body) for body in bodies)]
            person = _person_in_free_space(people_from + index, ego, taken, split, rng)
            bodies += [] if person is None else [person]
        yield label_frame(renderer.frame(view, bodies, time_s))


def _without_overlaps(bodies: list[Body]) -> list[Body]:
    """Return the bodies without those that overlap an earlier one."""
    kept: list[Body] = []
    for body in bodies:
        reach = [0.5 * (body.length_m + other.length_m) for other in kept]
        if all(
            abs(body.x_m - other.x_m) > far or abs(body.y_m - other.y_m) > 2.0
            for other, far in zip(kept, reach, strict=True)
        ):
            kept.append(body)
    return kept


def _with_looks(scene: StreetScene, split: Split) -> StreetScene:
    return replace(
        scene,
        buildings=tuple(replace(b, look=b.look + 1000 * split) for b in scene.buildings),
        trees=tuple(replace(t, look=t.look + 1000 * split) for t in scene.trees),
        parked=tuple(_with_look(b, split) for b in scene.parked),
        furniture=tuple(replace(f, look=f.look + 1000 * split) for f in scene.furniture),
    )


def _with_look(body: Body, split: Split) -> Body:
    return replace(body, look=body.look % 1000 + 1000 * int(split))


def _person_in_free_space(
    number: int, ego: Rectangle, taken: list[Rectangle], split: Split, rng: np.random.Generator
) -> Body | None:
    """Return a person who overlaps nothing, or None if several draws find no free position."""
    for _ in range(_DRAWS):
        person = _person(number, ego.x_m, split, rng)
        place = Rectangle.of(person)
        if _stands_free(place, ego, taken):
            return person
    return None


def _stands_free(place: Rectangle, ego: Rectangle, taken: list[Rectangle]) -> bool:
    """Return whether a body would be clear of the ego car and of everything else."""
    near = [
        other
        for other in taken
        if abs(other.x_m - place.x_m) < other.half_length_m + place.half_length_m + 1.0
    ]
    return signed_gap_m(ego, place) > CLEAR_M and all(signed_gap_m(other, place) > 0.1 for other in near)


def _person(number: int, ego_x_m: float, split: Split, rng: np.random.Generator) -> Body:
    """Return a person on a pavement, between parked vehicles or on the road, usually nearby."""
    ahead_m = 3.5 + 35.0 * float(rng.random()) ** 1.8
    place = rng.random()
    if place < 0.4:
        y_m = float(rng.choice([-1.0, 1.0])) * (KERB_M + float(rng.uniform(0.5, 2.7)))
    elif place < 0.6:
        y_m = float(rng.choice([-1.0, 1.0])) * (LANE_M + float(rng.uniform(0.0, STRIP_M)))
    else:
        y_m = float(rng.uniform(-LANE_M, LANE_M))
    length_m, width_m, height_m = PERSON_SIZE_M
    low_m, high_m = (-0.65, -0.3) if rng.random() < _CHILDREN else (-0.25, 0.15)
    return Body(
        id=number,
        kind=BodyKind.PERSON,
        x_m=ego_x_m + ahead_m,
        y_m=y_m,
        yaw_rad=float(rng.uniform(-math.pi, math.pi)),
        length_m=length_m,
        width_m=width_m,
        height_m=height_m + float(rng.uniform(low_m, high_m)),
        look=int(rng.integers(1000)) + 1000 * int(split),
        phase=float(rng.uniform(0.0, 2.0 * math.pi)),
    )


EVALUATOR_ID: Final = "brink-dataset@2"
SIMULATOR_DATA: Final = "simulator"
MAX_FRAMES: Final = 5000


class DatasetEvaluator:
    """Evaluates a detector on a data set. One instance per process is enough; it caches the last data set."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Evaluate the detector; the objective ``alpha`` is its mAP at an IoU of 0.5.

        `brink.sim.aeb.scores.decision_accuracy` is an objective, too, unless the data set lacks what it needs.

        Args:
            spec: `scenario` names the data set and the number of images, `behaviour` the detector and
                perturbations.
            record: Ignored, because there is no trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: All true boxes are ignored, or there are none.
        """
        cpu_s = time.process_time()
        if spec.simulator != EVALUATOR_ID:
            raise InvalidEpisode(f"simulator: expected {EVALUATOR_ID}, got {spec.simulator!r}")
        behaviour = Behaviour.from_json({"mode": SightMode.DETECTOR.value, **spec.behaviour})
        check_weights(behaviour)
        cv2.setNumThreads(1)
        frames = _frames(_parse_request(spec))
        detector = find_detector(behaviour.detector)
        pipeline = Pipeline(behaviour.perturbations, seed=spec.seed, mode=behaviour.fields)
        detections = [detector.detect(pipeline(picture, index)) for index, (picture, _) in enumerate(frames)]
        by_class = {
            LABELS[curve.label]: curve.average_precision
            for curve in curves([truth for _, truth in frames], detections)
        }
        if not by_class:
            raise SimulationCrashed(
                "expected at least one true box that is not ignored in the data set, got none"
            )
        objectives = {"alpha": math.fsum(by_class.values()) / len(by_class)}
        decisions = decision_accuracy(
            [truth for _, truth in frames],
            detections,
            [Region.from_reference(*picture.shape[1::-1], warning=True) for picture, _ in frames],
            behaviour.threshold,
        )
        if math.isfinite(decisions):
            objectives["decision_accuracy"] = decisions
        return EpisodeResult(
            verdicts={},
            objectives=objectives,
            features={f"average_precision:{name}": value for name, value in by_class.items()},
            provenance=provenance(EVALUATOR_ID, cpu_s, bullet_versions(), frames=len(frames)),
        )


class _Request(NamedTuple):
    """What to evaluate on.

    Attributes:
        dataset: A name or an annotations file.
        frames: Number of images.
        seed: Selects the simulator's images.
        digest: Expected digest of the annotations.
        width_px: Width of the simulator's images.
    """

    dataset: str
    frames: int
    seed: int
    digest: str
    width_px: int


def _parse_request(spec: EpisodeSpec) -> _Request:
    """Parse the data set and sampling options from a specification."""
    known = ("dataset", "frames", "seed", "digest", "width_px")
    for name in spec.scenario:
        if name not in known:
            raise InvalidEpisode(f"scenario: unknown field {name!r}; expected {', '.join(known)}")
    dataset, digest = spec.scenario.get("dataset", SIMULATOR_DATA), spec.scenario.get("digest", "")
    if not isinstance(dataset, str) or not isinstance(digest, str):
        raise InvalidEpisode(
            f"scenario.dataset: expected {SIMULATOR_DATA!r} or the path of an annotations file, got {dataset!r}"
        )
    frames = parse_integer("scenario.frames", spec.scenario.get("frames"), 1, MAX_FRAMES)
    seed = parse_integer("scenario.seed", spec.scenario.get("seed", 0), 0, 2**31)
    width_px = parse_integer("scenario.width_px", spec.scenario.get("width_px", SIZE_PX[0]), 64, 4096)
    return _Request(dataset, frames, seed, digest, width_px)


@lru_cache(maxsize=1)
def _frames(request: _Request) -> tuple[tuple[Picture, GroundTruth], ...]:
    """Return the images of a data set; the last data set is cached, as rendering an image takes about 50 ms."""
    if request.dataset == SIMULATOR_DATA:
        frames = labelled_frames(
            Split.VALIDATION, request.frames, seed=request.seed + 1, width_px=request.width_px
        )
        return tuple((frame.picture, frame.truth) for frame in frames)
    try:
        data = read_coco(Path(request.dataset))
    except DatasetError as error:
        raise InvalidEpisode(f"scenario.dataset: {error}") from None
    if request.digest and data.digest != request.digest:
        raise InvalidEpisode(
            f"scenario.dataset: {request.dataset} differs from the data set that the campaign was submitted with"
        )
    chosen = sample_evenly(data.pictures, request.frames)
    return tuple((_read_picture(one), one.truth) for one in chosen)


def _read_picture(one: CocoPicture) -> Picture:
    picture = cv2.imread(str(one.file), cv2.IMREAD_COLOR_RGB)
    if picture is None:
        raise InvalidEpisode(f"scenario.dataset: {one.file} cannot be read as an image")
    if picture.shape[:2] != (one.height_px, one.width_px):
        raise InvalidEpisode(
            f"scenario.dataset: {one.file}: expected {one.width_px} x {one.height_px} px according to the "
            f"annotations, got {picture.shape[1]} x {picture.shape[0]}"
        )
    return np.asarray(picture, np.uint8)

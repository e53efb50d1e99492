"""Owns the evaluator `brink-dataset@1`: how well a detector does on a data set seen through perturbations.

It is run as a simulator is, so that data-set evaluations are jobs like others. Each perturbation is applied to what
the one before it left, frame by frame; the same specification gives the same figure.
"""

import math
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np

from brink.sim.aeb.behaviour import Behaviour, SightMode, check_weights
from brink.sim.aeb.pictures import Split, labelled_frames
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.perception.coco import CocoPicture, read_coco
from brink.sim.perception.detector import Picture
from brink.sim.perception.errors import DatasetError
from brink.sim.perception.quality import Truth, curves
from brink.sim.perception.registry import find_detector
from brink.sim.perturbations import Pipeline
from brink.sim.urban.simulator import instruction_set, versions

EVALUATOR_ID: Final = "brink-dataset@1"
SIMULATOR_DATA: Final = "simulator"
MAX_FRAMES: Final = 5000
LABELS: Final = ("vehicle", "person")


class DatasetEvaluator:
    """Evaluates a detector on a data set. One a process is enough; it keeps the pictures of the last data set."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Evaluate once; the objective ``alpha`` is the mAP at an overlap of one half.

        Args:
            spec: `scenario` names the data set and how many of its pictures, `behaviour` detector and perturbations.
            record: Makes no difference: there is no trace.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: There was nothing to find in the pictures.
        """
        cpu_s = time.process_time()
        if spec.simulator != EVALUATOR_ID:
            raise InvalidEpisode(f"simulator: this is {EVALUATOR_ID}, the job asks for {spec.simulator!r}")
        behaviour = Behaviour.from_json({"mode": SightMode.DETECTOR.value, **spec.behaviour})
        check_weights(behaviour)
        frames = _frames(_wanted(spec))
        cv2.setNumThreads(1)
        detector = find_detector(behaviour.detector)
        pipeline = Pipeline(behaviour.perturbations, seed=spec.seed, mode=behaviour.fields)
        found = [detector.detect(pipeline(frame.picture, index)) for index, frame in enumerate(frames)]
        by_class = {
            LABELS[curve.label]: curve.average_precision
            for curve in curves([frame.truth for frame in frames], found)
        }
        if not by_class:
            raise SimulationCrashed("the data set has nothing to find")
        alpha = math.fsum(by_class.values()) / len(by_class)
        return EpisodeResult(
            verdicts={},
            objectives={"alpha": alpha},
            features={f"average_precision:{name}": value for name, value in by_class.items()},
            provenance={
                "simulator": EVALUATOR_ID,
                **versions(),
                "instruction_set": instruction_set(),
                "cpu_s": time.process_time() - cpu_s,
                "frames": len(frames),
            },
        )


class _Wanted(NamedTuple):
    """Which data set: its name or annotations, how many of its pictures, its seed, the digest of its annotations."""

    dataset: str
    frames: int
    seed: int
    digest: str


def _wanted(spec: EpisodeSpec) -> _Wanted:
    """Return which data set a specification asks for."""
    known = ("dataset", "frames", "seed", "digest")
    for name in spec.scenario:
        if name not in known:
            raise InvalidEpisode(f"scenario: unknown field {name!r}; expected {', '.join(known)}")
    dataset, digest = spec.scenario.get("dataset", SIMULATOR_DATA), spec.scenario.get("digest", "")
    if not isinstance(dataset, str) or not isinstance(digest, str):
        raise InvalidEpisode(f"scenario.dataset: expected {SIMULATOR_DATA!r} or a file, got {dataset!r}")
    frames = _whole("frames", spec.scenario.get("frames"), 1, MAX_FRAMES)
    return _Wanted(dataset, frames, _whole("seed", spec.scenario.get("seed", 0), 0, 2**31), digest)


def _whole(name: str, value: Json, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InvalidEpisode(f"scenario.{name}: expected a whole number in [{low}, {high}], got {value!r}")
    return value


class _Labelled(NamedTuple):
    picture: Picture
    truth: Truth


@lru_cache(maxsize=1)
def _frames(wanted: _Wanted) -> tuple[_Labelled, ...]:
    """Return the pictures of a data set; making or reading them takes some 50 ms each, so the last one is kept."""
    if wanted.dataset == SIMULATOR_DATA:
        made = labelled_frames(Split.VALIDATION, wanted.frames, seed=wanted.seed + 1)
        return tuple(_Labelled(frame.picture, frame.truth) for frame in made)
    try:
        data = read_coco(Path(wanted.dataset))
    except DatasetError as error:
        raise InvalidEpisode(f"scenario.dataset: {error}") from None
    if wanted.digest and data.digest != wanted.digest:
        raise InvalidEpisode(
            f"scenario.dataset: {wanted.dataset} here is not the one that the campaign was submitted with"
        )
    chosen = spread(data.pictures, wanted.frames)
    return tuple(_Labelled(_read_picture(one), one.truth) for one in chosen)


def spread(pictures: Sequence[CocoPicture], count: int) -> list[CocoPicture]:
    """Return so many pictures of a data set, evenly over it; all if there are no more."""
    if count >= len(pictures):
        return list(pictures)
    return [pictures[index * len(pictures) // count] for index in range(count)]


def _read_picture(one: CocoPicture) -> Picture:
    picture = cv2.imread(str(one.file), cv2.IMREAD_COLOR_RGB)
    if picture is None:
        raise InvalidEpisode(f"scenario.dataset: {one.file} is no picture")
    if picture.shape[:2] != (one.height_px, one.width_px):
        raise InvalidEpisode(
            f"scenario.dataset: {one.file}: expected {one.width_px} x {one.height_px} px as its annotations say, "
            f"got {picture.shape[1]} x {picture.shape[0]}"
        )
    return np.asarray(picture, np.uint8)

"""Owns the evaluator `brink-dataset@1`: how well a detector does on a data set seen through perturbations.

It is run as a simulator is, so that data-set evaluations are jobs like others. Each perturbation is applied to what
the one before it left, frame by frame; the same specification gives the same figure.
"""

import math
import time
from functools import lru_cache
from typing import Final

import cv2

from sim.aeb.behaviour import Behaviour, SightMode
from sim.aeb.pictures import LabelledFrame, Split, labelled_frames
from sim.episode import EpisodeResult, EpisodeSpec, Json
from sim.errors import InvalidEpisode, SimulationCrashed
from sim.perception.quality import curves
from sim.perception.registry import find_detector
from sim.perturbations import Pipeline
from sim.urban.simulator import instruction_set, versions

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
        frames = _frames(*_wanted(spec))
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


def _wanted(spec: EpisodeSpec) -> tuple[str, int, int]:
    """Return which data set, how many pictures, and its seed."""
    for name in spec.scenario:
        if name not in ("dataset", "frames", "seed"):
            raise InvalidEpisode(f"scenario: unknown field {name!r}; expected dataset, frames, seed")
    dataset = spec.scenario.get("dataset", SIMULATOR_DATA)
    if dataset != SIMULATOR_DATA:
        raise InvalidEpisode(f"scenario.dataset: expected {SIMULATOR_DATA!r}, got {dataset!r}")
    frames = _whole("frames", spec.scenario.get("frames"), 1, MAX_FRAMES)
    return SIMULATOR_DATA, frames, _whole("seed", spec.scenario.get("seed", 0), 0, 2**31)


def _whole(name: str, value: Json, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InvalidEpisode(f"scenario.{name}: expected a whole number in [{low}, {high}], got {value!r}")
    return value


@lru_cache(maxsize=1)
def _frames(dataset: str, count: int, seed: int) -> tuple[LabelledFrame, ...]:
    """Return the pictures of a data set; making them takes some 70 ms each, so the last one is kept."""
    assert dataset == SIMULATOR_DATA
    return tuple(labelled_frames(Split.VALIDATION, count, seed=seed + 1))

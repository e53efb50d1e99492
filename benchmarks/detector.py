"""How well a detector sees: on fresh images of the emergency-braking street, as they are and perturbed.

Each of the 15 perturbations is applied alone, at three of its levels. Processes render the images and run the
detector; this process keeps only boxes and computes all figures from them. Average precision is at an IoU of 0.5, and
`brink.sim.aeb.labels` decides which boxes count. Training uses none of the images: they have other seeds and looks.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from functools import cache
from statistics import fmean
from typing import Any, Final, NamedTuple

import cv2

from benchmarks.measurement import Progress, Row, at_least
from benchmarks.trials import mapped
from brink.server.errors import InvalidInput
from brink.sim.aeb.dataset import FRAMES_A_STREET, Split, labelled_frames
from brink.sim.perception.boxes import (
    BoolArray,
    Curve,
    Detections,
    FloatArray,
    GroundTruth,
    LabelledFrame,
    curves,
)
from brink.sim.perception.detector import LABELS, Detector, find_detector
from brink.sim.perturbations import CATALOGUE, Gene, Perturbation, Pipeline

PERSON: Final = "person"

LEAST_CLEAN_MAP: Final = 0.80
LEAST_VISIBLE_MAP: Final = 0.85
LEAST_FIRST_MAP: Final = 0.72
LEAST_MIDDLE_MAP: Final = 0.60
LEAST_PERSON_PRECISION: Final = 0.80
LEAST_PERSON_RECALL: Final = 0.60


class Bin(NamedTuple):
    """A range of distances or visible shares: from `low`, below `high`."""

    name: str
    low: float
    high: float


DISTANCES_M: Final = tuple(
    Bin(f"{low} to {high} m", low, high) for low, high in ((0, 5), (5, 10), (10, 20), (20, 40), (40, 80))
)
MOSTLY_VISIBLE: Final = Bin("at least 75%", 0.75, math.inf)
VISIBLE_SHARES: Final = (
    Bin("25% to 50%", 0.25, 0.5),
    Bin("50% to 75%", 0.5, 0.75),
    Bin("75% to 95%", 0.75, 0.95),
    Bin("at least 95%", 0.95, math.inf),
    MOSTLY_VISIBLE,
)


class Step(StrEnum):
    """One of the three levels at which a perturbation is applied."""

    FIRST = "first"
    MIDDLE = "middle"
    HIGHEST = "highest"

    def of(self, gene: Gene) -> Perturbation:
        """Return a gene at this level; short genes have the same level twice."""
        level = {Step.FIRST: 1, Step.MIDDLE: gene.levels // 2, Step.HIGHEST: gene.levels - 1}[self]
        return Perturbation(gene.name, level)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObservedImage:
    """The content of an image, and the detector's output for it.

    Attributes:
        truth: The true boxes.
        depths_m: Distance of each true box, shape ``(n,)``.
        visible: Visible share of each body, in [0, 1], shape ``(n,)``.
        clean: Detections in the image as it is.
        perturbed: Detections in the perturbed image.
    """

    truth: GroundTruth
    depths_m: FloatArray
    visible: FloatArray
    clean: Detections
    perturbed: Mapping[Perturbation, Detections]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassAccuracy:
    """How well one class is detected.

    Attributes:
        boxes: Number of true boxes that count.
        average_precision: At an IoU of 0.5, in [0, 1].
        precision: At the threshold; 1 if nothing is detected.
        recall: At the threshold.
    """

    boxes: int
    average_precision: float
    precision: float
    recall: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """How well a detector sees under one condition.

    Attributes:
        classes: Accuracy of each class of which at least one box counts.
    """

    classes: Mapping[str, ClassAccuracy]

    @property
    def map(self) -> float | None:
        """Mean average precision; None if no box counts."""
        return fmean(one.average_precision for one in self.classes.values()) if self.classes else None

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain JSON values."""
        return {"map": self.map, "classes": {name: asdict(one) for name, one in self.classes.items()}}


@dataclass(frozen=True, slots=True, kw_only=True)
class StepAccuracy:
    """How well a detector sees under a perturbation, or the mean over all perturbations.

    Attributes:
        map: Mean average precision.
        person_precision: Precision of people at the threshold.
        person_recall: Their recall.
    """

    map: float
    person_precision: float
    person_recall: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DetectorAccuracy:
    """The measurement of a detector.

    Attributes:
        detector: Id of the detector.
        images: Number of images.
        seed: Seed of the images and of the perturbations.
        threshold: Minimum score of the detections that the brake receives.
        clean: Accuracy on the images as they are.
        curves: Precision and recall on them over all thresholds, for each class.
        by_distance: Accuracy for each range of distances; bodies elsewhere are ignored. A false detection belongs to
            no range and counts in all, so recall can be compared between ranges, and average precision cannot: it
            is the lower, the fewer boxes a range has.
        by_visible_share: The same for visible shares.
        genes: Accuracy at each step, by name of the gene.
    """

    detector: str
    images: int
    seed: int
    threshold: float
    clean: Accuracy
    curves: Sequence[Curve]
    by_distance: Mapping[Bin, Accuracy]
    by_visible_share: Mapping[Bin, Accuracy]
    genes: Mapping[str, Mapping[Step, StepAccuracy]]

    @property
    def over_genes(self) -> dict[Step, StepAccuracy]:
        """The mean over genes at each step."""
        steps = {step: [by_step[step] for by_step in self.genes.values()] for step in Step}
        return {
            step: StepAccuracy(
                map=fmean(one.map for one in found),
                person_precision=fmean(one.person_precision for one in found),
                person_recall=fmean(one.person_recall for one in found),
            )
            for step, found in steps.items()
        }

    @property
    def rows(self) -> list[Row]:
        """The figures that have a target."""
        means = self.over_genes
        visible = self.by_visible_share[MOSTLY_VISIBLE]
        people = f"at a score of {self.threshold:g}, mean over {len(self.genes)} perturbations"
        over = f"mean over {len(self.genes)} perturbations"
        return [
            at_least("mAP", _map(self.clean), LEAST_CLEAN_MAP, _counts(self.clean)),
            at_least(
                "mAP of bodies at least 75% visible", _map(visible), LEAST_VISIBLE_MAP, _counts(visible)
            ),
            at_least("mAP at the first level", means[Step.FIRST].map, LEAST_FIRST_MAP, over),
            at_least("mAP at the middle level", means[Step.MIDDLE].map, LEAST_MIDDLE_MAP, over),
            at_least(
                "precision of people, first level",
                means[Step.FIRST].person_precision,
                LEAST_PERSON_PRECISION,
                people,
            ),
            at_least(
                "recall of people, first level", means[Step.FIRST].person_recall, LEAST_PERSON_RECALL, people
            ),
        ]

    def to_json(self) -> dict[str, Any]:
        """Return all figures as one JSON document; the curves are left out."""
        return {
            "detector": self.detector,
            "images": self.images,
            "seed": self.seed,
            "threshold": self.threshold,
            "rows": [asdict(row) for row in self.rows],
            "clean": {
                "map": self.clean.map,
                "person_precision": self.clean.classes[PERSON].precision,
                "person_recall": self.clean.classes[PERSON].recall,
            },
            "by_class": self.clean.to_json()["classes"],
            "by_distance": _bins_json(self.by_distance),
            "by_visible_share": _bins_json(self.by_visible_share),
            "genes": [
                {
                    "gene": gene,
                    **{
                        step: {"level": step.of(CATALOGUE[gene]).level, **asdict(one)}
                        for step, one in steps.items()
                    },
                }
                for gene, steps in self.genes.items()
            ],
            "mean_over_genes": {step: asdict(one) for step, one in self.over_genes.items()},
        }


def _map(accuracy: Accuracy) -> float:
    """Return the mAP under a condition in which boxes count."""
    return fmean(one.average_precision for one in accuracy.classes.values())


def _counts(accuracy: Accuracy) -> str:
    return ", ".join(f"{name} boxes: {one.boxes:,}" for name, one in accuracy.classes.items())


def _bins_json(bins: Mapping[Bin, Accuracy]) -> list[dict[str, Any]]:
    return [
        {
            "name": one.name,
            "low": one.low,
            "high": one.high if one.high < math.inf else None,
            **_without_precision(found.to_json()),
        }
        for one, found in bins.items()
    ]


def _without_precision(document: dict[str, Any]) -> dict[str, Any]:
    """Return the accuracy in a range without its precision, which would count the false detections of all ranges."""
    for one in document["classes"].values():
        del one["precision"]
    return document


def measure_detector(
    detector_id: str,
    *,
    images: int,
    seed: int,
    threshold: float,
    processes: int,
    progress: Progress,
    genes: Sequence[Gene] = tuple(CATALOGUE.values()),
) -> DetectorAccuracy:
    """Measure a detector.

    Args:
        detector_id: Id of the detector, or a user's file.
        images: Number of images.
        seed: Seed of the images and of the perturbations.
        threshold: Minimum score of the detections that the brake receives.
        processes: Number of processes; 1 runs everything in this process.
        progress: Progress callback.
        genes: Perturbations of the catalogue.

    Raises:
        InvalidEpisode: There is no such detector.
        DetectorError: The detector cannot be loaded, or cannot process an image.
        InvalidInput: No image shows a person, or none a vehicle, at least 75% visible.
    """
    perturbations = _perturbations(genes)
    jobs = [
        Job(detector_id, seed, start // FRAMES_A_STREET, min(FRAMES_A_STREET, images - start), perturbations)
        for start in range(0, images, FRAMES_A_STREET)
    ]
    streets = mapped(observe_street, jobs, processes=processes, part="streets", progress=progress)
    observed = list(itertools.chain.from_iterable(streets))
    return evaluate(detector_id, observed, seed=seed, threshold=threshold, genes=genes)


def _perturbations(genes: Iterable[Gene]) -> tuple[Perturbation, ...]:
    """Return all genes at their three levels, without duplicates."""
    return tuple(dict.fromkeys(step.of(gene) for gene in genes for step in Step))


class Job(NamedTuple):
    """The images of one street, the detector, and the perturbations to apply one at a time."""

    detector_id: str
    seed: int
    street: int
    images: int
    perturbations: tuple[Perturbation, ...]


@cache
def _loaded(detector_id: str) -> Detector:
    return find_detector(detector_id)


def observe_street(job: Job) -> list[ObservedImage]:
    """Render the images of a street and run the detector on each, as it is and perturbed."""
    cv2.setNumThreads(1)
    detector = _loaded(job.detector_id)
    pipelines = [Pipeline((perturbation,), seed=job.seed) for perturbation in job.perturbations]
    frames = labelled_frames(Split.TEST, job.images, job.seed, first_street=job.street)
    first = job.street * FRAMES_A_STREET
    return [_observe(frame, index, detector, pipelines) for index, frame in enumerate(frames, first)]


def _observe(
    frame: LabelledFrame, index: int, detector: Detector, pipelines: Iterable[Pipeline]
) -> ObservedImage:
    return ObservedImage(
        truth=frame.truth,
        depths_m=frame.depths_m,
        visible=frame.visible,
        clean=detector.detect(frame.picture),
        perturbed={
            pipeline.perturbations[0]: detector.detect(pipeline(frame.picture, index))
            for pipeline in pipelines
        },
    )


def evaluate(
    detector_id: str,
    observed: Sequence[ObservedImage],
    *,
    seed: int,
    threshold: float,
    genes: Sequence[Gene] = tuple(CATALOGUE.values()),
) -> DetectorAccuracy:
    """Compute all figures from the detections in each image.

    Args:
        detector_id: Id of the detector.
        observed: The images, perturbed by each gene at all three steps.
        seed: Seed of the images and of the perturbations.
        threshold: Minimum score of the detections that the brake receives.
        genes: The perturbations.

    Raises:
        InvalidInput: No image shows a person, or none a vehicle, at least 75% visible.
    """
    truths = [one.truth for one in observed]
    found = [one.clean for one in observed]
    by_visible_share = {
        one: _accuracy(curves(_within(one, truths, [o.visible for o in observed]), found), threshold)
        for one in VISIBLE_SHARES
    }
    if missing := [name for name in LABELS if name not in by_visible_share[MOSTLY_VISIBLE].classes]:
        raise InvalidInput.at(
            "--images", f"none of the {len(observed)} images shows a {missing[0]} clearly; use more images"
        )
    clean = curves(truths, found)
    perturbed = {
        one: _step_accuracy(truths, [o.perturbed[one] for o in observed], threshold)
        for one in _perturbations(genes)
    }
    return DetectorAccuracy(
        detector=detector_id,
        images=len(observed),
        seed=seed,
        threshold=threshold,
        clean=_accuracy(clean, threshold),
        curves=clean,
        by_distance={
            one: _accuracy(curves(_within(one, truths, [o.depths_m for o in observed]), found), threshold)
            for one in DISTANCES_M
        },
        by_visible_share=by_visible_share,
        genes={gene.name: {step: perturbed[step.of(gene)] for step in Step} for gene in genes},
    )


def _within(one: Bin, truths: Sequence[GroundTruth], values: Sequence[FloatArray]) -> list[GroundTruth]:
    """Return the true boxes, those outside a range ignored."""
    outside: list[BoolArray] = [(of_boxes < one.low) | (of_boxes >= one.high) for of_boxes in values]
    return [replace(truth, ignored=truth.ignored | far) for truth, far in zip(truths, outside, strict=True)]


def _accuracy(by_class: Sequence[Curve], threshold: float) -> Accuracy:
    classes = {}
    for curve in by_class:
        precision, recall = curve.at_score(threshold)
        classes[LABELS[curve.label]] = ClassAccuracy(
            boxes=curve.positives,
            average_precision=curve.average_precision,
            precision=precision,
            recall=recall,
        )
    return Accuracy(classes=classes)


def _step_accuracy(
    truths: Sequence[GroundTruth], found: Sequence[Detections], threshold: float
) -> StepAccuracy:
    accuracy = _accuracy(curves(truths, found), threshold)
    person = accuracy.classes[PERSON]
    return StepAccuracy(map=_map(accuracy), person_precision=person.precision, person_recall=person.recall)

"""Detection scores of an episode: overall, and separately inside and outside the warning region.

A box is inside if it intersects the region. Boxes on the other side are ignored in scoring.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.sim.aeb.braking import Region
from brink.sim.perception.boxes import (
    BoolArray,
    Detections,
    GroundTruth,
    mean_average_precision,
    precision_and_recall,
    too_small,
)
from brink.sim.perception.detector import LABELS
from brink.sim.rendering.scene import PictureCamera
from brink.sim.trace import Film

MIN_VEHICLE_HEIGHT_M: Final = 0.3
"""Lower than any vehicle and than a fallen tree."""
_PERSON, _VEHICLE = LABELS.index("person"), LABELS.index("vehicle")


@dataclass(frozen=True, slots=True, kw_only=True)
class Scores:
    """Scores of one episode at one threshold; NaN where there was nothing to detect.

    Attributes:
        alpha: mAP at an IoU of 0.5.
        alpha_inside: mAP inside the warning region.
        alpha_outside: mAP outside the warning region.
        precision: Share of correct detections among those above the threshold.
        recall: Share of the true boxes found by detections above the threshold.
        precision_inside: Precision inside the warning region.
        recall_inside: Recall inside the warning region.
        precision_outside: Precision outside the warning region.
        recall_outside: Recall outside the warning region.
    """

    alpha: float
    alpha_inside: float
    alpha_outside: float
    precision: float
    recall: float
    precision_inside: float
    recall_inside: float
    precision_outside: float
    recall_outside: float


def reported(found: Detections, threshold: float, width_px: int, height_px: int) -> BoolArray:
    """Return which detections reach the brake: confident, large enough, and not a flat vehicle; shape ``(n,)``.

    A vehicle's box touches the road with its lower edge, which says how far away it is and, with the camera's height,
    how high. Under perturbations the detector finds vehicles a few centimetres high at the lower edge of the image.

    Args:
        found: All detections in an image.
        threshold: Minimum score.
        width_px: Width of the image.
        height_px: Height of the image.
    """
    heights_px = found.boxes[:, 3] - found.boxes[:, 1]
    camera = PictureCamera(width_px=width_px, height_px=height_px)
    lowest_px = MIN_VEHICLE_HEIGHT_M / camera.height_m * (found.boxes[:, 3] - 0.5 * height_px)
    flat = (found.labels == _VEHICLE) & (heights_px < lowest_px)
    too_little = too_small(found.boxes, width_px, height_px) | flat
    return np.asarray((found.scores >= threshold) & ~too_little, np.bool_)


def score_episode(
    truths: Sequence[GroundTruth], detections: Sequence[Detections], threshold: float, warning: Region
) -> Scores:
    """Return the scores of an episode.

    Args:
        truths: Ground truth of each frame.
        detections: Detections in the same frames.
        threshold: Minimum score of a detection for precision and recall.
        warning: The warning region.
    """
    sides = [_side(truths, detections, warning, inside=inside) for inside in (True, False)]
    (precision, recall), inside, outside = (
        precision_and_recall(*pair, threshold) for pair in ((truths, detections), *sides)
    )
    return Scores(
        alpha=mean_average_precision(truths, detections),
        alpha_inside=mean_average_precision(*sides[0]),
        alpha_outside=mean_average_precision(*sides[1]),
        precision=precision,
        recall=recall,
        precision_inside=inside[0],
        recall_inside=inside[1],
        precision_outside=outside[0],
        recall_outside=outside[1],
    )


def decision_accuracy(
    truths: Sequence[GroundTruth],
    detections: Sequence[Detections],
    warnings: Sequence[Region],
    threshold: float,
) -> float:
    """Return how often single images lead to the right braking decision: the balanced accuracy, in [0, 1].

    An image calls for the brake if a person meets the warning region. The value is the mean of two shares: of images
    that call for the brake, those in which a person is reported there; of the others, those in which nobody is.
    Images in which only an ignored person meets the region do not count. If one kind of image is missing, the other
    decides; NaN if both are.

    Args:
        truths: Ground truth of each image.
        detections: Detections in the same images.
        warnings: Warning region of each image.
        threshold: Minimum score of a detection that is passed to the brake.
    """
    right: dict[bool, list[bool]] = {True: [], False: []}
    for truth, found, warning in zip(truths, detections, warnings, strict=True):
        there = (truth.labels == _PERSON) & warning.intersects_each(truth.boxes)
        if there.any() and truth.ignored[there].all():
            continue
        people = (found.labels == _PERSON) & reported(found, threshold, warning.width_px, warning.height_px)
        calls = bool(there.any())
        right[calls].append(bool(warning.intersects_each(found.boxes[people]).any()) == calls)
    shares = [float(np.mean(answers)) for answers in right.values() if answers]
    return sum(shares) / len(shares) if shares else float("nan")


def rescore(film: Film, threshold: float) -> Scores:
    """Return the scores of a recorded episode at any threshold, without simulating it again."""
    truths, detections = [], []
    for sample in range(len(film.judged.first) - 1):
        judged, detected = film.judged.at(sample), film.found.at(sample)
        order = [1, 3, 2, 4]  # x_min, y_min, x_max, y_max
        truths.append(
            GroundTruth(
                labels=judged[:, 0].astype(np.int64),
                boxes=np.ascontiguousarray(judged[:, order]),
                ignored=judged[:, 5] > 0,
            )
        )
        detections.append(
            Detections(
                labels=detected[:, 0].astype(np.int64),
                boxes=np.ascontiguousarray(detected[:, order]),
                scores=np.ascontiguousarray(detected[:, 5]),
            )
        )
    return score_episode(truths, detections, threshold, Region.from_reference(*film.size_px, warning=True))


def _side(
    truths: Sequence[GroundTruth], detections: Sequence[Detections], warning: Region, *, inside: bool
) -> tuple[list[GroundTruth], list[Detections]]:
    """Restrict the frames to one side of the region: ignore other true boxes, drop other detections."""
    kept_truths, kept_found = [], []
    for truth, detected in zip(truths, detections, strict=True):
        on_side = warning.intersects_each(truth.boxes) == inside
        kept_truths.append(
            GroundTruth(labels=truth.labels, boxes=truth.boxes, ignored=truth.ignored | ~on_side)
        )
        kept = warning.intersects_each(detected.boxes) == inside
        kept_found.append(
            Detections(labels=detected.labels[kept], boxes=detected.boxes[kept], scores=detected.scores[kept])
        )
    return kept_truths, kept_found

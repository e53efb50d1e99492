"""Bounding boxes in images: overlap (IoU), non-maximum suppression, and evaluation against the ground truth.

A box is a row x_min, y_min, x_max, y_max in pixels; the maxima are exclusive. Average precision is computed at an
IoU of 0.5 from the precision at 101 recall levels, over the classes that occur. Ignored ground truth (too small,
almost hidden) is neutral: a detection on it counts neither for nor against the detector.

Source: the evaluation of the COCO data set, at its IoU threshold of .5.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float32]
IndexArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]


def overlaps(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the intersection over union of all pairs of boxes.

    Args:
        one: Shape ``(n, 4)``.
        other: Shape ``(m, 4)``.

    Returns:
        Shape ``(n, m)``.
    """
    low = np.maximum(one[:, None, :2], other[None, :, :2])
    high = np.minimum(one[:, None, 2:], other[None, :, 2:])
    shared = np.prod(np.clip(high - low, 0.0, None), axis=2)
    area = _area(one)[:, None] + _area(other)[None, :] - shared
    return np.asarray(np.where(area > 0, shared / np.where(area > 0, area, 1.0), 0.0), dtype=np.float32)


def _area(boxes: FloatArray) -> FloatArray:
    return np.asarray(np.prod(np.clip(boxes[:, 2:] - boxes[:, :2], 0.0, None), axis=1), dtype=np.float32)


def non_maximum_suppression(
    boxes: FloatArray, scores: FloatArray, labels: NDArray[np.int64], max_overlap: float
) -> IndexArray:
    """Return the indices of the boxes that survive non-maximum suppression, best score first.

    Args:
        boxes: Shape ``(n, 4)``.
        scores: Shape ``(n,)``.
        labels: Shape ``(n,)``; only boxes with equal labels remove each other.
        max_overlap: Largest IoU of two boxes that both remain, in [0, 1].
    """
    order = np.argsort(-scores, kind="stable")
    overlap = overlaps(boxes, boxes)
    kept: list[int] = []
    removed = np.zeros(len(boxes), np.bool_)
    for index in order.tolist():
        if removed[index]:
            continue
        kept.append(index)
        removed |= (overlap[index] > max_overlap) & (labels == labels[index])
    return np.array(kept, dtype=np.intp)


MATCH_IOU: Final = 0.5
RECALLS: Final = np.linspace(0.0, 1.0, 101)


MIN_HEIGHT_SHARE: Final = 12.0 / 360.0
"""Boxes lower than this share of the image's height are ignored: 8.4 px in the input of `brink-det@2`."""
MIN_WIDTH_SHARE: Final = 6.0 / 640.0
"""Boxes narrower than this share of the image's width are ignored: 4.2 px in the input of `brink-det@2`."""


def too_small(boxes: FloatArray, width_px: int, height_px: int) -> BoolArray:
    """Return which boxes are too low or too narrow to count, shape ``(n,)``.

    Args:
        boxes: Shape ``(n, 4)``, in px.
        width_px: Width of the image.
        height_px: Height of the image.
    """
    sides = boxes[:, 2:] - boxes[:, :2]
    return np.asarray(
        (sides[:, 0] < MIN_WIDTH_SHARE * width_px) | (sides[:, 1] < MIN_HEIGHT_SHARE * height_px), np.bool_
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundTruth:
    """The true boxes of an image.

    Attributes:
        labels: Class of each box, shape ``(n,)``.
        boxes: Shape ``(n, 4)``, in px.
        ignored: Whether a box is neutral in scoring, shape ``(n,)``.
    """

    labels: NDArray[np.int64]
    boxes: FloatArray
    ignored: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detections:
    """A detector's boxes for an image.

    Attributes:
        labels: Class of each box, shape ``(n,)``.
        boxes: Shape ``(n, 4)``, in px.
        scores: Confidence in [0, 1], shape ``(n,)``.
    """

    labels: NDArray[np.int64]
    boxes: FloatArray
    scores: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledFrame:
    """An image with its ground truth.

    Attributes:
        picture: RGB, shape ``(h, w, 3)``.
        truth: Labels 0 (vehicle) and 1 (person).
        depths_m: Distance of each box, shape ``(n,)``.
        visible: Visible share of each body, in [0, 1], shape ``(n,)``.
    """

    picture: NDArray[np.uint8]
    truth: GroundTruth
    depths_m: FloatArray
    visible: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """Precision and recall of one class over all score thresholds.

    Attributes:
        label: The class.
        positives: Number of true boxes that count.
        scores: Scores of the detections that count, in descending order.
        hits: Whether each detection is correct.
    """

    label: int
    positives: int
    scores: FloatArray
    hits: BoolArray

    @property
    def precision(self) -> NDArray[np.float64]:
        """Precision of the 1, 2, … detections with the highest scores."""
        return np.asarray(np.cumsum(self.hits) / np.arange(1, len(self.hits) + 1))

    @property
    def recall(self) -> NDArray[np.float64]:
        """Recall of the 1, 2, … detections with the highest scores."""
        return np.asarray(np.cumsum(self.hits) / max(1, self.positives))

    @property
    def average_precision(self) -> float:
        """Mean, over 101 recall levels, of the best precision at or above the level; 0 where it is never reached."""
        if not len(self.hits):
            return 0.0
        best_beyond = np.maximum.accumulate(self.precision[::-1])[::-1]
        place = np.searchsorted(self.recall, RECALLS - 1e-12, side="left")
        reached = place < len(best_beyond)
        return float(np.sum(best_beyond[place[reached]]) / len(RECALLS))

    def at_score(self, score: float) -> tuple[float, float]:
        """Return precision and recall at a minimum score; precision is 1 if no detection reaches it."""
        count = int(np.count_nonzero(self.scores >= score))
        correct = int(np.count_nonzero(self.hits[:count]))
        return (correct / count if count else 1.0), correct / max(1, self.positives)


def curves(truths: Sequence[GroundTruth], detections: Sequence[Detections]) -> list[Curve]:
    """Return the curve of each class with at least one true box that is not ignored, in ascending order of class.

    Args:
        truths: Ground truth of each image.
        detections: Detections in the same images, in the same order.

    Raises:
        ValueError: The numbers of images differ.
    """
    if len(truths) != len(detections):
        raise ValueError(
            f"expected one set of detections per image, got {len(detections)} for {len(truths)} images"
        )
    occurring = np.unique(
        np.concatenate([truth.labels[~truth.ignored] for truth in truths] or [np.empty(0, int)])
    )
    return [_curve(int(label), truths, detections) for label in occurring]


def mean_average_precision(truths: Sequence[GroundTruth], detections: Sequence[Detections]) -> float:
    """Return the mAP at an IoU of 0.5, in [0, 1]; NaN if there are no true boxes, or all are ignored."""
    values = [curve.average_precision for curve in curves(truths, detections)]
    return float(np.mean(values)) if values else float("nan")


def precision_and_recall(
    truths: Sequence[GroundTruth], detections: Sequence[Detections], score: float
) -> tuple[float, float]:
    """Return precision and recall over all classes, counting only detections with at least the given score.

    Unlike mAP, precision counts detections of a class that does not occur: all of them are wrong.

    Args:
        truths: Ground truth of each image.
        detections: Detections in the same images.
        score: Minimum score.

    Returns:
        Precision and recall, NaN where the denominator is zero.
    """
    found = [*(one.labels for one in truths), *(one.labels for one in detections)]
    labels = np.unique(np.concatenate([np.empty(0, int), *found]))
    by_class = [_curve(int(label), truths, detections) for label in labels]
    counted = [curve.hits[curve.scores >= score] for curve in by_class]
    reported = sum(len(hits) for hits in counted)
    correct = sum(int(np.count_nonzero(hits)) for hits in counted)
    positives = sum(curve.positives for curve in by_class)
    return correct / reported if reported else np.nan, correct / positives if positives else np.nan


def _curve(label: int, truths: Sequence[GroundTruth], detections: Sequence[Detections]) -> Curve:
    positives = 0
    scores: list[FloatArray] = []
    hits: list[BoolArray] = []
    for truth, detected in zip(truths, detections, strict=True):
        of_label = truth.labels == label
        positives += int(np.count_nonzero(of_label & ~truth.ignored))
        own = np.flatnonzero(detected.labels == label)
        own = own[np.argsort(-detected.scores[own], kind="stable")]
        correct, counts = _match(detected.boxes[own], truth.boxes[of_label], truth.ignored[of_label])
        scores.append(detected.scores[own][counts])
        hits.append(correct[counts])
    all_scores = np.concatenate(scores) if scores else np.empty(0, np.float32)
    all_hits = np.concatenate(hits) if hits else np.empty(0, np.bool_)
    order = np.argsort(-all_scores, kind="stable")
    return Curve(label=label, positives=positives, scores=all_scores[order], hits=all_hits[order])


def _match(boxes: FloatArray, truth: FloatArray, ignored: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Return which detections are correct, and which count; the boxes must be sorted by descending score.

    Each detection is matched to the unmatched true box that it overlaps most. One that matches only an ignored box
    does not count.
    """
    correct, counts = np.zeros(len(boxes), np.bool_), np.ones(len(boxes), np.bool_)
    if not len(truth):
        return correct, counts
    overlap = overlaps(boxes, truth)
    free = ~ignored
    for index in np.flatnonzero(overlap.max(axis=1) >= MATCH_IOU).tolist():  # all others are wrong
        candidates = np.where(free, overlap[index], -1.0)
        best = int(np.argmax(candidates))
        if candidates[best] >= MATCH_IOU:
            correct[index] = True
            free[best] = False
        elif np.any(overlap[index][ignored] >= MATCH_IOU):
            counts[index] = False
    return correct, counts

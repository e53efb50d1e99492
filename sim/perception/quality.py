"""How well a detector does: mean average precision, precision and recall at a score, calibration.

Average precision is taken at an overlap of one half, with the precision at 101 recalls, over the classes that occur.
Ground truth that is marked to be ignored (too small, nearly hidden) costs nobody anything: a box on it counts neither
for nor against the detector. Source: the evaluation of the COCO data set, at its IoU threshold of .5.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.perception.boxes import BoolArray, FloatArray, overlaps

MATCH_OVERLAP: Final = 0.5
RECALLS: Final = np.linspace(0.0, 1.0, 101)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What is in a picture.

    Attributes:
        labels: Class of each box, shape ``(n,)``.
        boxes: Shape ``(n, 4)``, in px.
        ignored: Which do not count, shape ``(n,)``.
    """

    labels: NDArray[np.int64]
    boxes: FloatArray
    ignored: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """What a detector says is in a picture.

    Attributes:
        labels: Class of each box, shape ``(n,)``.
        boxes: Shape ``(n, 4)``, in px.
        scores: How sure it is, in [0, 1], shape ``(n,)``.
    """

    labels: NDArray[np.int64]
    boxes: FloatArray
    scores: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """How one class is found, over all scores.

    Attributes:
        label: The class.
        positives: Boxes of it that count.
        scores: Of its detections that count, falling.
        hits: Which of them are right.
    """

    label: int
    positives: int
    scores: FloatArray
    hits: BoolArray

    @property
    def precision(self) -> NDArray[np.float64]:
        """Share of right ones among the first 1, 2, … detections."""
        return np.asarray(np.cumsum(self.hits) / np.arange(1, len(self.hits) + 1))

    @property
    def recall(self) -> NDArray[np.float64]:
        """Share of all boxes that the first 1, 2, … detections find."""
        return np.asarray(np.cumsum(self.hits) / max(1, self.positives))

    @property
    def average_precision(self) -> float:
        """Mean of the best precision at each of 101 recalls or beyond; 0 where a recall is never reached."""
        if not len(self.hits):
            return 0.0
        best_beyond = np.maximum.accumulate(self.precision[::-1])[::-1]
        place = np.searchsorted(self.recall, RECALLS - 1e-12, side="left")
        reached = place < len(best_beyond)
        return float(np.sum(best_beyond[place[reached]]) / len(RECALLS))

    def at_score(self, score: float) -> tuple[float, float]:
        """Return precision and recall of the detections with at least that score; a precision of 1 if none has it."""
        count = int(np.count_nonzero(self.scores >= score))
        right = int(np.count_nonzero(self.hits[:count]))
        return (right / count if count else 1.0), right / max(1, self.positives)


def curves(truths: Sequence[Truth], found: Sequence[Found]) -> list[Curve]:
    """Return a curve for each class that occurs among boxes that count, ascending by class.

    Args:
        truths: One a picture.
        found: The same pictures in the same order.

    Raises:
        ValueError: There are not as many of one as of the other.
    """
    if len(truths) != len(found):
        raise ValueError(f"expected as many pictures in both, got {len(truths)} and {len(found)}")
    occurring = np.unique(
        np.concatenate([truth.labels[~truth.ignored] for truth in truths] or [np.empty(0, int)])
    )
    return [_curve(int(label), truths, found) for label in occurring]


def mean_average_precision(truths: Sequence[Truth], found: Sequence[Found]) -> float:
    """Return mAP at an overlap of one half, in [0, 1]; NaN if there is nothing to find."""
    values = [curve.average_precision for curve in curves(truths, found)]
    return float(np.mean(values)) if values else float("nan")


def precision_and_recall(
    truths: Sequence[Truth], found: Sequence[Found], score: float
) -> tuple[float, float]:
    """Return precision and recall of all detections with at least a score, classes together; NaN of nothing."""
    by_class = curves(truths, found)
    counted = [curve.scores >= score for curve in by_class]
    said = sum(int(np.count_nonzero(sure)) for sure in counted)
    right = sum(
        int(np.count_nonzero(curve.hits[sure])) for curve, sure in zip(by_class, counted, strict=True)
    )
    positives = sum(curve.positives for curve in by_class)
    return (right / said if said else float("nan")), (right / positives if positives else float("nan"))


def _curve(label: int, truths: Sequence[Truth], found: Sequence[Found]) -> Curve:
    positives = 0
    scores: list[FloatArray] = []
    hits: list[BoolArray] = []
    for truth, said in zip(truths, found, strict=True):
        of_label = truth.labels == label
        positives += int(np.count_nonzero(of_label & ~truth.ignored))
        mine = np.flatnonzero(said.labels == label)
        mine = mine[np.argsort(-said.scores[mine], kind="stable")]
        right, counts = _matched(said.boxes[mine], truth.boxes[of_label], truth.ignored[of_label])
        scores.append(said.scores[mine][counts])
        hits.append(right[counts])
    all_scores = np.concatenate(scores) if scores else np.empty(0, np.float32)
    all_hits = np.concatenate(hits) if hits else np.empty(0, np.bool_)
    order = np.argsort(-all_scores, kind="stable")
    return Curve(label=label, positives=positives, scores=all_scores[order], hits=all_hits[order])


def _matched(boxes: FloatArray, truth: FloatArray, ignored: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Return which boxes, best first, are right, and which count at all.

    Each takes the free truth that it overlaps most; only where it overlaps none that counts, an ignored one.
    """
    right, counts = np.zeros(len(boxes), np.bool_), np.ones(len(boxes), np.bool_)
    if not len(truth):
        return right, counts
    overlap = overlaps(boxes, truth)
    free = ~ignored
    for index in np.flatnonzero(
        overlap.max(axis=1) >= MATCH_OVERLAP
    ).tolist():  # the others are wrong at once
        candidates = np.where(free, overlap[index], -1.0)
        best = int(np.argmax(candidates))
        if candidates[best] >= MATCH_OVERLAP:
            right[index] = True
            free[best] = False
        elif np.any(overlap[index][ignored] >= MATCH_OVERLAP):
            counts[index] = False
    return right, counts


def calibration(curve: Curve, bins: int = 10) -> list[tuple[float, float, int]]:
    """Return mean score, share of right ones and number of detections in equal bins of score that hold any."""
    edges = np.linspace(0.0, 1.0, bins + 1)
    place = np.clip(np.digitize(curve.scores, edges) - 1, 0, bins - 1)
    rows = []
    for number in np.unique(place).tolist():
        inside = place == number
        rows.append(
            (
                float(curve.scores[inside].mean()),
                float(curve.hits[inside].mean()),
                int(np.count_nonzero(inside)),
            )
        )
    return rows

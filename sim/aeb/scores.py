"""How well a detector did in an episode: everywhere, and apart inside and outside of the warning region.

A box is inside if it meets the region. What lies on the other side is left out, neither for nor against the detector.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from brink.sim.aeb.braking import EmergencyBrake, Region
from brink.sim.perception.quality import Found, Truth, mean_average_precision, precision_and_recall
from brink.sim.trace import Film


@dataclass(frozen=True, slots=True, kw_only=True)
class Scores:
    """Figures of one episode at one threshold; NaN where there was nothing to find.

    Attributes:
        alpha: mAP at an overlap of one half.
        precision: Share of right detections among those with at least the threshold's score.
        recall: Share of what is there that they find.
        precision_inside: The same inside the warning region.
        recall_inside: The same inside the warning region.
        precision_outside: The same outside of it.
        recall_outside: The same outside of it.
    """

    alpha: float
    precision: float
    recall: float
    precision_inside: float
    recall_inside: float
    precision_outside: float
    recall_outside: float


def scored(truths: Sequence[Truth], found: Sequence[Found], threshold: float, warning: Region) -> Scores:
    """Return the figures of an episode.

    Args:
        truths: What is there, one a frame.
        found: What was found in the same frames.
        threshold: Least score of a detection that counts for precision and recall.
        warning: The region.
    """
    sides = [_side(truths, found, warning, inside=inside) for inside in (True, False)]
    (precision, recall), inside, outside = (
        precision_and_recall(*pair, threshold) for pair in ((truths, found), *sides)
    )
    return Scores(
        alpha=mean_average_precision(truths, found),
        precision=precision,
        recall=recall,
        precision_inside=inside[0],
        recall_inside=inside[1],
        precision_outside=outside[0],
        recall_outside=outside[1],
    )


def rescored(film: Film, threshold: float) -> Scores:
    """Return the figures of a recorded episode at any threshold, without simulating."""
    truths, found = [], []
    for sample in range(len(film.judged.first) - 1):
        judged, said = film.judged.at(sample), film.found.at(sample)
        order = [1, 3, 2, 4]  # x_min, y_min, x_max, y_max
        truths.append(
            Truth(
                labels=judged[:, 0].astype(np.int64),
                boxes=np.ascontiguousarray(judged[:, order]),
                ignored=judged[:, 5] > 0,
            )
        )
        found.append(
            Found(
                labels=said[:, 0].astype(np.int64),
                boxes=np.ascontiguousarray(said[:, order]),
                scores=np.ascontiguousarray(said[:, 5]),
            )
        )
    return scored(truths, found, threshold, EmergencyBrake.for_picture(*film.size_px).warning)


def _side(
    truths: Sequence[Truth], found: Sequence[Found], warning: Region, *, inside: bool
) -> tuple[list[Truth], list[Found]]:
    """Return the frames with what lies on one side: truth beyond is ignored, what is found beyond dropped."""
    kept_truths, kept_found = [], []
    for truth, said in zip(truths, found, strict=True):
        there = warning.met_by(truth.boxes) == inside
        kept_truths.append(Truth(labels=truth.labels, boxes=truth.boxes, ignored=truth.ignored | ~there))
        kept = warning.met_by(said.boxes) == inside
        kept_found.append(Found(labels=said.labels[kept], boxes=said.boxes[kept], scores=said.scores[kept]))
    return kept_truths, kept_found

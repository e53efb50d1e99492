"""Detections of a component against the ground truth in one episode, box by box.

Detections are the boxes that the driving system received: injected by the search, or found by a detector in a
perturbed image. In tables, ground truth is called ``seen``, detections ``said``, and false positives ``invented``.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.server.csv_text import csv_text
from brink.sim.perception.boxes import overlaps
from brink.sim.trace import Trace

LABELS: Final = {0: "vehicle", 1: "person"}
MIN_OVERLAP: Final = 0.5
"""Minimum intersection over union of a detection and the ground truth that it matches."""
COLUMNS: Final = ("time_s", "which", "label", "x_min_px", "x_max_px", "y_min_px", "y_max_px")


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionCounts:
    """Numbers of true, detected and matched boxes over all samples of an episode.

    Attributes:
        truth: Boxes of the ground truth.
        detected: Detections.
        matched: Detections that match the ground truth: same label, overlap of at least `MIN_OVERLAP`.
    """

    truth: int
    detected: int
    matched: int

    def to_columns(self) -> dict[str, int]:
        """Return the counts, including missed objects and false positives, by column name."""
        return {
            "seen": self.truth,
            "said": self.detected,
            "matched": self.matched,
            "missed": self.truth - self.matched,
            "invented": self.detected - self.matched,
        }


def count_detections(trace: Trace) -> DetectionCounts:
    """Count the detections of an episode that match its ground truth."""
    matched = sum(
        _count_matches(trace.seen_boxes.at(sample), trace.given_boxes.at(sample))
        for sample in range(len(trace.time_s))
    )
    return DetectionCounts(
        truth=len(trace.seen_boxes.rows), detected=len(trace.given_boxes.rows), matched=matched
    )


def _count_matches(truth: NDArray[np.float32], detected: NDArray[np.float32]) -> int:
    """Return the number of matched pairs in one sample; the largest overlaps are matched first."""
    if not len(truth) or not len(detected):
        return 0
    # Boxes in traces are x_min, x_max, y_min, y_max.
    overlap = overlaps(truth[:, [1, 3, 2, 4]], detected[:, [1, 3, 2, 4]])
    overlap = np.where(truth[:, :1] == detected[None, :, 0], overlap, 0.0)
    pairs = 0
    while overlap.size and (best := float(overlap.max())) >= MIN_OVERLAP:
        row, column = np.argwhere(overlap == best)[0]
        overlap = np.delete(np.delete(overlap, row, axis=0), column, axis=1)
        pairs += 1
    return pairs


def box_rows(trace: Trace) -> Iterator[tuple[float | str, ...]]:
    """Yield a row of `COLUMNS` for each box of an episode: by time, ground truth before detections."""
    for sample, time_s in enumerate(trace.time_s.tolist()):
        for which, boxes in (("seen", trace.seen_boxes), ("said", trace.given_boxes)):
            for label, *corners in boxes.at(sample).tolist():
                yield (
                    round(time_s, 3),
                    which,
                    LABELS.get(int(label), str(int(label))),
                    *(round(corner, 2) for corner in corners),
                )


def write_boxes(trace: Trace, file: Path) -> None:
    """Write the boxes of an episode as CSV."""
    file.write_text(csv_text([COLUMNS, *box_rows(trace)]), encoding="utf-8", newline="")

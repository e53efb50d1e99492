"""What the component saw beside what it said, in one episode: its inputs and outputs, box by box.

What it saw is the ground truth of the picture; what it said is what the driving system was given: injected by the
search, or found by a detector in a perturbed picture.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.sim.perception.boxes import overlaps
from brink.sim.trace import Trace

LABELS: Final = {0: "vehicle", 1: "person"}
SAME: Final = 0.5
"""Least overlap (intersection over union) of a box that was said with the one that was seen."""
COLUMNS: Final = ("time_s", "which", "label", "x_min_px", "x_max_px", "y_min_px", "y_max_px")


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenAndSaid:
    """How far a component's outputs were from its inputs.

    Attributes:
        seen: Boxes of ground truth, over all samples.
        said: Boxes that the driving system was given.
        matched: Boxes that were both: the same label, and an overlap of at least `SAME`.
    """

    seen: int
    said: int
    matched: int

    @property
    def missed(self) -> int:
        """Boxes that were seen and not said."""
        return self.seen - self.matched

    @property
    def invented(self) -> int:
        """Boxes that were said and not seen."""
        return self.said - self.matched


def seen_and_said(trace: Trace) -> SeenAndSaid:
    """Return how far a component's outputs were from its inputs in an episode."""
    matched = 0
    for sample in range(len(trace.time_s)):
        seen, said = trace.seen_boxes.at(sample), trace.given_boxes.at(sample)
        matched += _matched(seen, said)
    return SeenAndSaid(seen=len(trace.seen_boxes.rows), said=len(trace.given_boxes.rows), matched=matched)


def _matched(seen: NDArray[np.float32], said: NDArray[np.float32]) -> int:
    """Return how many boxes can be paired, the largest overlaps first."""
    if not len(seen) or not len(said):
        return 0
    # Boxes in traces are x_min, x_max, y_min, y_max.
    overlap = overlaps(seen[:, [1, 3, 2, 4]], said[:, [1, 3, 2, 4]])
    overlap = np.where(seen[:, :1] == said[None, :, 0], overlap, 0.0)
    pairs = 0
    while overlap.size and (best := float(overlap.max())) >= SAME:
        row, column = np.argwhere(overlap == best)[0]
        overlap = np.delete(np.delete(overlap, row, axis=0), column, axis=1)
        pairs += 1
    return pairs


def box_rows(trace: Trace) -> Iterator[tuple[float | str, ...]]:
    """Yield every box of an episode with the columns `COLUMNS`: by time, what was seen before what was said."""
    for sample, time_s in enumerate(trace.time_s.tolist()):
        for which, boxes in (("seen", trace.seen_boxes), ("said", trace.given_boxes)):
            for label, *corners in boxes.at(sample).tolist():
                yield (
                    round(time_s, 3), which, LABELS.get(int(label), str(int(label))),
                    *(round(corner, 2) for corner in corners),
                )  # fmt: skip


def write_boxes(trace: Trace, file: Path) -> None:
    """Write every box of an episode as CSV."""
    with file.open("w", encoding="utf-8", newline="") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(box_rows(trace))

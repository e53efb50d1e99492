"""What a component saw beside what it said."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.traces import make_trace

from brink.report.component import COLUMNS, box_rows, seen_and_said, write_boxes
from brink.sim.trace import BOX_COLUMNS, Ragged, Trace

Box = tuple[float, float, float, float, float]
CAR: Box = (0.0, 100.0, 200.0, 300.0, 400.0)
NEARLY: Box = (0.0, 110.0, 210.0, 310.0, 410.0)
FAR: Box = (0.0, 160.0, 260.0, 360.0, 460.0)
PERSON: Box = (1.0, 100.0, 200.0, 300.0, 400.0)


def boxes(samples: list[list[Box]]) -> Ragged:
    first = np.cumsum([0, *map(len, samples)]).astype(np.int32)
    rows = np.array([box for sample in samples for box in sample], np.float32).reshape(-1, 5)
    return Ragged(columns=BOX_COLUMNS, first=first, rows=rows)


def trace(seen: list[list[Box]], said: list[list[Box]]) -> Trace:
    return replace(make_trace(samples=len(seen)), seen_boxes=boxes(seen), given_boxes=boxes(said))


@pytest.mark.parametrize(
    ("seen", "said", "matched"),
    [
        ([CAR], [CAR], 1),
        ([CAR], [NEARLY], 1),  # 90 x 90 of 100 x 100 twice: .68
        ([CAR], [FAR], 0),  # 40 x 40: .09
        ([CAR], [PERSON], 0),  # the same place, another label
        ([CAR], [], 0),
        ([], [CAR], 0),
        ([CAR, NEARLY], [CAR], 1),  # one box that is said stands for one that is seen
        ([NEARLY, CAR], [CAR, NEARLY], 2),
    ],
)
def test_a_box_that_is_said_matches_one_of_its_label_that_it_overlaps(
    seen: list[Box], said: list[Box], matched: int
) -> None:
    found = seen_and_said(trace([seen, []], [said, []]))
    assert (found.seen, found.said, found.matched) == (len(seen), len(said), matched)
    assert (found.missed, found.invented) == (len(seen) - matched, len(said) - matched)


def test_boxes_of_different_moments_do_not_match() -> None:
    assert seen_and_said(trace([[CAR], []], [[], [CAR]])).matched == 0


def test_every_box_is_written_with_its_time(tmp_path: Path) -> None:
    shown = trace([[CAR], [PERSON]], [[], [NEARLY]])
    assert list(box_rows(shown)) == [
        (0.0, "seen", "vehicle", 100.0, 200.0, 300.0, 400.0),
        (0.1, "seen", "person", 100.0, 200.0, 300.0, 400.0),
        (0.1, "said", "vehicle", 110.0, 210.0, 310.0, 410.0),
    ]
    file = tmp_path / "boxes.csv"
    write_boxes(shown, file)
    with file.open(newline="") as text:
        rows = list(csv.reader(text))
    assert tuple(rows[0]) == COLUMNS
    assert [row[:3] for row in rows[1:]] == [
        ["0.0", "seen", "vehicle"], ["0.1", "seen", "person"], ["0.1", "said", "vehicle"],
    ]  # fmt: skip

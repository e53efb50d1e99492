"""Lines of an archive: solutions that differ in one unit alone, with episode seeds of their own."""

import numpy as np
import pytest

from brink.search.analysis.lines import FEWEST, Line, find_lines
from brink.search.archive import Archive, Neighbourhood
from brink.search.space import BoolArray, Categorical, Component, Extent, FloatArray, Real, SearchSpace

SPACE = SearchSpace(
    (
        Component(
            "scenario", (Real("gap", 0.0, 100.0, unit="m"), Categorical("road", ("straight", "curved")))
        ),
        Component(
            "behaviour",
            (Real("left", 0.0, 10.0), Real("right", 0.0, 10.0)),
            (Extent(low="left", high="right", minimum=1.0, size=10.0),),
        ),
    )
)
GAP, ROAD, LEFT, RIGHT = range(4)


def rows(**columns: list[float]) -> FloatArray:
    """Return solutions that differ in the given columns alone."""
    count = len(next(iter(columns.values())))
    made = np.tile([50.0, 0.0, 3.0, 6.0], (count, 1))
    for name, values in columns.items():
        made[:, {"gap": GAP, "road": ROAD, "left": LEFT, "right": RIGHT}[name]] = values
    return made


def archive_of(vectors: FloatArray, unsafe: BoolArray) -> Archive:
    empty = Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1, z=1.96))
    return empty.grown(np.arange(len(vectors)), vectors, unsafe, np.where(unsafe, -1.0, 1.0))


def lines_of(vectors: FloatArray, unsafe: BoolArray, own: BoolArray | None = None) -> list[Line]:
    return find_lines(
        archive_of(vectors, unsafe), SPACE, np.ones(len(vectors), np.bool_) if own is None else own
    )


GAPS = [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0]


def test_solutions_that_differ_in_one_number_are_a_line() -> None:
    vectors = rows(gap=GAPS[::-1])
    (line,) = lines_of(vectors, vectors[:, GAP] > 45.0)
    assert (line.unit, line.leading, line.rises) == ((GAP,), GAP, True)
    assert line.values.tolist() == GAPS
    assert line.places.tolist() == [7, 6, 5, 4, 3, 2, 1, 0]
    assert line.ends == (10.0, 80.0)


def test_a_line_may_be_unsafe_at_its_lower_end() -> None:
    vectors = rows(gap=GAPS)
    (line,) = lines_of(vectors, vectors[:, GAP] < 45.0)
    assert not line.rises
    assert line.ends == (80.0, 10.0)


@pytest.mark.parametrize(
    ("vectors", "reason"),
    [
        (rows(gap=GAPS[: FEWEST - 1]), "too few"),
        (rows(gap=[10.0, 80.0] * 4), "two places"),
        (rows(gap=GAPS, road=[0.0, 1.0] * 4), "a category differs, too"),
        (rows(gap=GAPS, left=[2.0, 2.5] * 4), "another number differs, too"),
    ],
)
def test_other_solutions_are_no_line(vectors: FloatArray, reason: str) -> None:
    assert lines_of(vectors, vectors[:, GAP] > 45.0) == [], reason


def test_solutions_with_one_verdict_are_no_line() -> None:
    assert lines_of(rows(gap=GAPS), np.zeros(8, np.bool_)) == []


def test_solutions_under_a_shared_seed_do_not_count_but_bracket_the_change() -> None:
    shared = [0.0, 100.0, 44.0, 52.0]
    vectors = rows(gap=GAPS + shared)
    own = np.arange(len(vectors)) < len(GAPS)
    unsafe = vectors[:, GAP] > 45.0
    (line,) = lines_of(vectors, unsafe, own)
    assert (int(line.own.sum()), len(line.values)) == (8, 12)
    assert line.bracket() == (44.0, 52.0)
    assert lines_of(vectors, unsafe, own & (vectors[:, GAP] != 10.0)) == [], "seven are too few"


def test_a_drive_under_a_shared_seed_that_is_safe_again_is_beyond_the_line() -> None:
    vectors = rows(gap=[*GAPS, 0.0, 95.0, 100.0])
    own = np.arange(len(vectors)) < len(GAPS)
    unsafe = (vectors[:, GAP] > 45.0) & (vectors[:, GAP] < 90.0)
    (line,) = lines_of(vectors, unsafe, own)
    assert (line.ends, line.safe_beyond) == ((0.0, 80.0), 95.0)
    assert line.bracket() == (0.0, 80.0)


def test_two_numbers_that_move_together_are_one_line() -> None:
    moved = [0.5 * step for step in range(8)]
    vectors = rows(left=[1.0 + one for one in moved], right=[4.0 + 1.5 * one for one in moved])
    (line,) = lines_of(vectors, vectors[:, LEFT] > 2.0)
    assert (line.unit, line.leading) == ((LEFT, RIGHT), RIGHT), "read by the number that moves further"
    bent = np.concatenate([vectors, rows(left=[0.0, 0.0], right=[3.0, 9.0])])
    own = np.arange(len(bent)) < len(vectors)
    (same,) = lines_of(bent, bent[:, LEFT] > 2.0, own)
    assert len(same.values) == len(vectors), "what a shared seed moved in another direction is on no line"
    crooked = rows(
        left=[1.0, 1.0, 1.0, 1.0, 2.0, 2.5, 3.0, 3.5], right=[4.0, 4.5, 5.0, 5.5, 5.5, 5.5, 5.5, 5.5]
    )
    assert lines_of(crooked, crooked[:, LEFT] > 2.0) == []


def test_a_solution_may_be_on_several_lines() -> None:
    vectors = np.concatenate(
        [rows(gap=GAPS), rows(left=[0.5 * step for step in range(1, 9)][:5], right=[9.0] * 5)]
    )
    vectors = np.concatenate([vectors, rows(left=[3.2, 3.4, 3.6, 3.8])])
    found = lines_of(vectors, (vectors[:, GAP] > 45.0) & (vectors[:, LEFT] > 2.9))
    assert [line.unit for line in found] == [(GAP,)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_line_that_is_safe_again_further_on_turns_back(sign: float) -> None:
    gaps = np.arange(5.0, 100.0, 5.0)
    verdicts = (gaps > 30.0) & (gaps < 70.0)
    vectors = rows(gap=(gaps if sign > 0 else 100.0 - gaps).tolist())
    more = rows(gap=[31.0 if sign > 0 else 69.0] * 3)
    (line,) = lines_of(np.concatenate([vectors, more]), np.concatenate([verdicts, [False, False, False]]))
    assert line.rises == (sign > 0)
    assert line.turns_back() == (70.0 if sign > 0 else 30.0)


def test_a_single_safe_solution_further_on_is_chance() -> None:
    gaps = np.arange(5.0, 100.0, 5.0)
    (line,) = lines_of(rows(gap=gaps.tolist()), (gaps > 30.0) & (gaps != 90.0))
    assert line.turns_back() is None


def test_each_change_of_the_verdict_is_a_part_of_a_line() -> None:
    vectors = rows(gap=[*GAPS, 90.0])
    (line,) = lines_of(vectors, (vectors[:, GAP] > 25.0) & (vectors[:, GAP] < 65.0))
    first, second = line.parts()
    assert (first.values.tolist(), first.rises, first.safe_beyond) == (GAPS[:6], True, 70.0)
    assert (second.values.tolist(), second.rises, second.safe_beyond) == ([*GAPS[2:], 90.0], False, 20.0)
    assert first.places.tolist() == list(range(6))
    assert second.unsafe.tolist() == [True] * 4 + [False] * 3

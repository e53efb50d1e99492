import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.world.line import Piece, ReferenceLine

curvatures = st.one_of(st.just(0.0), st.floats(1 / 60, 1 / 8), st.floats(-1 / 8, -1 / 60))
pieces = st.lists(
    st.builds(Piece, st.floats(0.5, 11.0), curvatures), min_size=1, max_size=5
)  # at most a quarter circle each
lines = st.builds(ReferenceLine, st.floats(-50, 50), st.floats(-50, 50), st.floats(-math.pi, math.pi), pieces)


@given(lines, st.floats(-40, 80), st.floats(-3, 3), st.floats(-3, 3))
def test_projecting_a_placed_point_gives_its_coordinates_back(
    line: ReferenceLine, station_m: float, offset_m: float, hint_m: float
) -> None:
    x_m, y_m, _ = line.pose_at(station_m, offset_m)
    found = line.project(x_m, y_m, station_m + hint_m)
    assert found == pytest.approx((station_m, offset_m), abs=1e-6)


@given(lines)
def test_a_line_has_no_gaps_and_no_kinks(line: ReferenceLine) -> None:
    at_m = 0.0
    for piece in line.pieces:
        before, after = line.pose_at(at_m - 1e-7), line.pose_at(at_m + 1e-7)
        assert math.dist(before[:2], after[:2]) < 1e-6
        assert math.cos(before[2] - after[2]) > 1 - 1e-9
        at_m += piece.length_m


@given(lines, st.floats(-3, 3), st.floats(0, 1))
def test_a_parallel_runs_at_its_distance(line: ReferenceLine, offset_m: float, share: float) -> None:
    beside = line.parallel(offset_m)
    x_m, y_m, yaw_rad = beside.pose_at(share * beside.length_m)
    station_m, found_m = line.project(x_m, y_m, share * line.length_m)
    assert found_m == pytest.approx(offset_m, abs=1e-6)
    assert math.cos(line.pose_at(station_m)[2] - yaw_rad) == pytest.approx(1.0)


@given(lines, st.floats(0, 1))
def test_backwards_is_the_same_curve_in_the_other_direction(line: ReferenceLine, share: float) -> None:
    station_m = share * line.length_m
    there = line.pose_at(station_m, 1.0)
    back = line.backwards().pose_at(line.length_m - station_m, -1.0)
    assert there[:2] == pytest.approx(back[:2], abs=1e-6)
    assert math.cos(there[2] - back[2]) == pytest.approx(-1.0)


@given(lines, st.floats(0.1, 1.5))
def test_the_head_and_the_tail_of_a_line_make_the_line(line: ReferenceLine, share: float) -> None:
    cut_m = share * line.length_m
    whole = line.up_to(cut_m, *line.pieces_from(cut_m))
    for station_m in (0.0, 0.5 * cut_m, cut_m, 0.5 * (cut_m + line.length_m)):
        assert whole.pose_at(station_m) == pytest.approx(line.pose_at(station_m), abs=1e-6)


def test_a_line_without_extent_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        ReferenceLine(0.0, 0.0, 0.0, [])


def test_a_parallel_beyond_the_centre_of_an_arc_is_refused() -> None:
    with pytest.raises(ValueError, match="centre of an arc"):
        ReferenceLine(0.0, 0.0, 0.0, [Piece(5.0, 0.1)]).parallel(10.0)

"""Outlines, shortest lines and dashes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.replay.geometry import closest_points, dashes, outline

metres = st.floats(-50, 50)
sides = st.floats(0.5, 10)
angles = st.floats(-7, 7)


def test_outline_starts_at_the_front_left_corner() -> None:
    np.testing.assert_allclose(outline(10, 5, np.pi / 2, 4, 2)[0], (9, 7), atol=1e-12)


def test_facing_bumpers_are_measured_in_the_middle() -> None:
    start, end, gap_m = closest_points(outline(0, 0, 0, 4, 2), outline(10, 0, 0, 4, 2))
    assert gap_m == pytest.approx(6)
    np.testing.assert_allclose(start, (2, 0))
    np.testing.assert_allclose(end, (8, 0))


@given(metres, metres, angles, sides, sides, metres, metres, angles, sides, sides)
def test_shortest_line_is_as_long_one_way_as_the_other_and_never_longer_than_between_corners(
    x: float, y: float, yaw: float, a: float, b: float, u: float, v: float, turn: float, c: float, d: float
) -> None:
    one, other = outline(x, y, yaw, a, b), outline(u, v, turn, c, d)
    start, end, gap_m = closest_points(one, other)
    assert gap_m == pytest.approx(closest_points(other, one)[2], abs=1e-9)
    assert gap_m <= np.hypot(*(one[:, None] - other).T).min() + 1e-9
    # The ends are averages of points whose distances differ by at most two centimetres.
    assert np.hypot(*(start - end)) <= gap_m + 0.03 or gap_m == 0


@given(metres, metres, angles)
def test_bodies_that_share_a_point_have_no_gap(x: float, y: float, yaw: float) -> None:
    assert closest_points(outline(x, y, yaw, 4, 2), outline(x + 0.5, y, yaw + 1, 3, 1))[2] == 0


def test_dashes_cover_a_closed_line_and_stay_on_it() -> None:
    square = np.array([(0.0, 0), (10, 0), (10, 10), (0, 10)])
    pieces = dashes(square, 2, 3, closed=True)
    assert len(pieces) == 8
    assert sum(float(np.hypot(*(piece[1] - piece[0]))) for piece in pieces) == pytest.approx(16)
    assert dashes(np.zeros((2, 2)), 1, 1) == []

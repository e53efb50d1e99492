"""Plane geometry: two ways to measure the distance of rectangles agree with each other, and with closest points."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.pictures.scene import closest_points
from brink.sim.plane import Rectangle, clearance_m, half_extents_m, signed_gap_m

POSE = st.tuples(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0), st.floats(-8.0, 8.0))


@given(POSE, POSE)
def test_the_distance_of_outlines_is_the_gap_of_rectangles(
    one: tuple[float, float, float], other: tuple[float, float, float]
) -> None:
    first, second = Rectangle(*one, 2.5, 1.0), Rectangle(*other, 2.0, 0.9)
    wanted_m = max(0.0, signed_gap_m(first, second))

    assert clearance_m(first.corners(), second.corners()) == pytest.approx(wanted_m, abs=1e-9)

    start, end, apart_m = closest_points(np.array(first.corners()), np.array(second.corners()))
    assert apart_m == pytest.approx(wanted_m, abs=1e-9)
    assert math.dist(start, end) == pytest.approx(wanted_m, abs=0.05)


@given(POSE)
def test_a_turned_rectangle_takes_up_what_its_corners_span(pose: tuple[float, float, float]) -> None:
    x_m, y_m, yaw_rad = pose
    spans_m = np.ptp(Rectangle(x_m, y_m, yaw_rad, 2.5, 1.0).corners(), axis=0)

    assert half_extents_m(5.0, 2.0, yaw_rad) == pytest.approx(0.5 * spans_m, abs=1e-9)

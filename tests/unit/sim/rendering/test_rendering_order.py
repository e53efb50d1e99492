"""Painter's order: nearer bodies are painted later, and every body exactly once."""

import math
from typing import TypeAlias

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.rendering.order import paint_order
from brink.sim.rendering.scene import footprint

EVERYWHERE = (0.0, 640.0)
Rectangle: TypeAlias = tuple[float, float, float, float, float]
"""Middle, yaw, length and width."""


def order_of(rectangles: list[Rectangle], eye: tuple[float, float, float]) -> list[int]:
    corners = np.array([footprint(*rectangle) for rectangle in rectangles])
    heights = np.array([(0.0, 2.0)] * len(rectangles))
    return paint_order(corners, heights, np.array([EVERYWHERE] * len(rectangles)), eye)


def hits(rectangle: Rectangle, angle_rad: float) -> float | None:
    """Return the distance from the origin at which a ray enters a rectangle."""
    x_m, y_m, yaw_rad, length_m, width_m = rectangle
    nearest, farthest = 0.0, math.inf
    for turn, half in ((yaw_rad, length_m / 2), (yaw_rad + math.pi / 2, width_m / 2)):
        across = math.cos(turn) * x_m + math.sin(turn) * y_m
        speed = math.cos(angle_rad - turn)
        if abs(speed) < 1e-9:
            if abs(across) > half:
                return None
            continue
        ends = sorted(((across - half) / speed, (across + half) / speed))
        nearest, farthest = max(nearest, ends[0]), min(farthest, ends[1])
    return nearest if nearest < farthest else None


def separate(a: Rectangle, b: Rectangle) -> bool:
    for yaw_rad in (a[2], b[2]):
        for turn in (yaw_rad, yaw_rad + math.pi / 2):
            axis = np.array([math.cos(turn), math.sin(turn)])
            first, second = footprint(*a) @ axis, footprint(*b) @ axis
            if first.max() < second.min() - 0.05 or second.max() < first.min() - 0.05:
                return True
    return False


rectangles = st.tuples(
    st.floats(3, 40), st.floats(-15, 15), st.floats(-3, 3), st.floats(0.4, 14), st.floats(0.4, 3)
)


@settings(max_examples=300, deadline=None)
@given(rectangles, rectangles, st.floats(-1.2, 1.2))
def test_along_any_line_of_sight_the_nearer_of_two_bodies_is_painted_last(
    first: Rectangle, second: Rectangle, angle_rad: float
) -> None:
    entered = (hits(first, angle_rad), hits(second, angle_rad))
    if not separate(first, second) or entered[0] is None or entered[1] is None:
        return
    if min(entered[0], entered[1]) <= 0:
        return
    nearer = 0 if entered[0] < entered[1] else 1
    assert order_of([first, second], (0.0, 0.0, 1.7))[-1] == nearer


@settings(max_examples=60, deadline=None)
@given(st.lists(rectangles, min_size=0, max_size=9))
def test_every_body_is_painted_once(bodies: list[Rectangle]) -> None:
    if not bodies:
        assert paint_order(np.zeros((0, 4, 2)), np.zeros((0, 2)), np.zeros((0, 2)), (0.0, 0.0, 1.7)) == []
        return
    assert sorted(order_of(bodies, (0.0, 0.0, 1.7))) == list(range(len(bodies)))


def test_three_bodies_that_hide_each_other_in_a_cycle_are_all_painted() -> None:
    # A pinwheel around a point ahead: each long side is in front of the next one's end.
    ring = [
        (20.0 + 3.0 * math.cos(turn), 3.0 * math.sin(turn), turn + math.pi / 2 + 0.55, 9.0, 0.5)
        for turn in (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
    ]
    assert sorted(order_of(ring, (0.0, 0.0, 1.7))) == [0, 1, 2]


def test_an_overhanging_crown_is_painted_before_a_van_in_front_of_it() -> None:
    crown, van = footprint(10.0, 0.0, 0.0, 4.0, 4.0), footprint(11.0, 0.5, 0.0, 4.4, 1.8)
    heights = np.array([(2.6, 7.0), (0.0, 2.4)])
    order = paint_order(np.array([crown, van]), heights, np.array([EVERYWHERE] * 2), (0.0, 0.0, 1.7))
    assert order == [0, 1]

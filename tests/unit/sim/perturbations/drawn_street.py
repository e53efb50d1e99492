"""A street drawn with a few polygons: a picture for tests that no change of the renderer alters."""

from collections.abc import Sequence
from typing import TypeAlias, cast

import cv2
import numpy as np

from brink.sim.perturbations import Frame

WIDTH_PX, HEIGHT_PX = 1280, 720
HORIZON_PX = 340

Colour: TypeAlias = tuple[int, int, int]


def draw_street(height: int = HEIGHT_PX) -> Frame:
    """Draw a daytime street with houses, cars and people as a 16:9 RGB image, the same for every call.

    Args:
        height: Height in px, at least 16.
    """
    frame = np.zeros((HEIGHT_PX, WIDTH_PX, 3), dtype=np.uint8)
    _draw_ground(frame)
    for left, right, height_px, colour in (
        (0, 210, 300, (151, 111, 90)),
        (210, 330, 220, (176, 164, 140)),
        (330, 430, 150, (120, 128, 134)),
        (860, 960, 160, (164, 132, 104)),
        (960, 1100, 240, (138, 146, 150)),
        (1100, 1280, 310, (170, 150, 128)),
    ):
        _draw_house(frame, left, right, height_px, colour)
    _draw_tree(frame, 455, 372, 1.0)
    _draw_tree(frame, 835, 368, 0.9)
    _draw_car(frame, 300, 470, 1.25, (150, 32, 36))
    _draw_car(frame, 545, 384, 0.55, (52, 84, 142))
    _draw_person(frame, 735, 560, 1.5, (36, 74, 132), (44, 44, 52))
    _draw_person(frame, 1010, 455, 0.95, (188, 140, 44), (66, 56, 52))
    grain = np.random.default_rng(3).normal(0, 4, frame.shape)  # sensor noise
    picture = np.clip(cv2.GaussianBlur(frame, (3, 3), 0.7) + grain, 0, 255).astype(np.uint8)
    size = (round(height * WIDTH_PX / HEIGHT_PX), height)
    return (
        picture
        if height == HEIGHT_PX
        else cast(Frame, cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    )


def _draw_ground(frame: Frame) -> None:
    sky = np.linspace((96, 146, 208), (206, 220, 232), HORIZON_PX)
    frame[:HORIZON_PX] = sky[:, None, :].astype(np.uint8)
    frame[HORIZON_PX:] = (104, 122, 80)
    _polygon(frame, [(600, 340), (680, 340), (1500, 720), (-220, 720)], (168, 162, 152))
    _polygon(frame, [(608, 340), (672, 340), (1300, 720), (-20, 720)], (84, 86, 90))
    for near, far in ((720, 640), (585, 535), (500, 468), (445, 424), (408, 394), (381, 372)):
        half = [(y - HORIZON_PX) * 0.016 for y in (near, far)]
        _polygon(
            frame,
            [(640 - half[0], near), (640 + half[0], near), (640 + half[1], far), (640 - half[1], far)],
            (222, 222, 214),
        )


def _draw_house(frame: Frame, left: int, right: int, height_px: int, colour: Colour) -> None:
    base = HORIZON_PX + 30
    cv2.rectangle(frame, (left, base - height_px), (right, base), colour, -1)
    dark = (colour[0] // 3, colour[1] // 3, colour[2] // 3)
    for x in range(left + 14, right - 20, 34):
        for y in range(base - height_px + 16, base - 34, 44):
            cv2.rectangle(frame, (x, y), (x + 15, y + 24), dark, -1)


def _draw_tree(frame: Frame, x: int, base: int, size: float) -> None:
    cv2.rectangle(
        frame, (x - round(5 * size), base - round(80 * size)), (x + round(5 * size), base), (74, 56, 40), -1
    )
    for dx, dy, radius, green in ((0, 120, 42, 92), (-24, 96, 30, 80), (24, 98, 30, 104)):
        middle = (x + round(dx * size), base - round(dy * size))
        cv2.circle(frame, middle, round(radius * size), (48, green, 44), -1, cv2.LINE_AA)


def _draw_car(frame: Frame, x: int, base: int, size: float, colour: Colour) -> None:
    """Draw a car from behind; `x` and `base` are the middle of its lower edge in px."""

    def at(*points: tuple[float, float]) -> list[tuple[float, float]]:
        return [(x + px * size, base - py * size) for px, py in points]

    _polygon(frame, at((-84, -4), (84, -4), (74, 6), (-74, 6)), (48, 48, 50))
    for side in (-1, 1):
        _polygon(frame, at((side * 72, -2), (side * 46, -2), (side * 46, 30), (side * 72, 30)), (24, 24, 26))
    _polygon(frame, at((-78, 14), (78, 14), (80, 62), (58, 74), (-58, 74), (-80, 62)), colour)
    _polygon(frame, at((-60, 72), (60, 72), (44, 116), (-44, 116)), colour)
    _polygon(frame, at((-51, 76), (51, 76), (38, 109), (-38, 109)), (44, 56, 66))
    for side in (-1, 1):
        _polygon(frame, at((side * 76, 46), (side * 54, 46), (side * 54, 62), (side * 77, 60)), (226, 52, 44))
    _polygon(frame, at((-20, 30), (20, 30), (20, 42), (-20, 42)), (232, 230, 216))


def _draw_person(frame: Frame, x: int, base: int, size: float, coat: Colour, trousers: Colour) -> None:
    """Draw a walking person; `x` and `base` are the point between the feet in px."""

    def at(*points: tuple[float, float]) -> list[tuple[float, float]]:
        return [(x + px * size, base - py * size) for px, py in points]

    for foot, hip in ((-17, -5), (15, 5)):
        _polygon(frame, at((foot - 5, 0), (foot + 6, 0), (hip + 7, 56), (hip - 7, 56)), trousers)
    _polygon(frame, at((-14, 52), (14, 52), (16, 104), (-16, 104)), coat)
    for hand, shoulder in ((-26, -14), (25, 14)):
        _polygon(frame, at((hand - 4, 60), (hand + 4, 60), (shoulder + 5, 102), (shoulder - 5, 102)), coat)
    ((hx, hy),) = at((0, 119))
    cv2.circle(frame, (round(hx), round(hy)), round(12 * size), (206, 160, 132), -1, cv2.LINE_AA)
    cv2.ellipse(
        frame, (round(hx), round(hy)), (round(12 * size),) * 2, 0, 180, 360, (58, 42, 34), -1, cv2.LINE_AA
    )


def _polygon(frame: Frame, corners: Sequence[tuple[float, float]], colour: Colour) -> None:
    cv2.fillPoly(frame, [np.array(corners).round().astype(np.int32)], colour, cv2.LINE_AA)

"""The sun in the lens: a glaring disc, and its ghosts on the line through the middle of the picture.

The glare is n concentric white discs laid over each other, the smaller the more opaque. What is left of a pixel at
the distance r is the product of ``1 - beta_i`` over the discs that reach it: a table of distances makes the picture.
"""

from functools import lru_cache
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.gene import Frame
from brink.sim.perturbations.layers import Layer, lay_white_over, pixels, scale_of

RING_PX = 10
GHOST_TINTS = ((255, 190, 120), (150, 255, 180), (130, 180, 255), (255, 140, 200), (255, 245, 170))


def sun_flare(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame with a flare of `value` px in its upper half and 6 to 10 ghosts."""
    height, width = frame.shape[:2]
    source = np.array([rng.uniform(0, width), rng.uniform(0, height / 2)])
    glare = _glare(value, height)
    radius = glare.shape[0] // 2
    x, y = (round(c) for c in source.tolist())
    top, left = max(0, y - radius), max(0, x - radius)
    bottom, right = min(height, y + radius + 1), min(width, x + radius + 1)
    reach = glare[
        top - y + radius : bottom - y + radius,
        left - x + radius : right - x + radius,
    ]
    flared = frame.copy()
    flared[top:bottom, left:right] = lay_white_over(flared[top:bottom, left:right], reach)
    strength = 0.5 + 0.5 * value / 900
    _draw_ghosts(flared, source, strength, rng)
    return flared


def transmission(
    radius_px: float, distance_px: npt.NDArray[np.float64], rings: int
) -> npt.NDArray[np.float64]:
    """Return which share of a pixel the glare leaves at some distances from its middle.

    ``T(r)`` is the product of ``1 - (1 - i / (n - 1))^3`` over the rings with ``r_i >= r``; the n rings are evenly
    spaced from 1 px (at the scale of 1280x720) to the radius.

    Args:
        radius_px: Radius of the largest ring.
        distance_px: Distances, any shape.
        rings: Their number n, >= 2.
    """
    ring_px = np.linspace(radius_px / (RING_PX * rings), radius_px, rings)
    left = 1 - (1 - np.arange(rings) / (rings - 1)) ** 3
    outwards = np.append(np.cumprod(left[::-1])[::-1], 1.0)  # the product from ring i on, and of none
    return cast(npt.NDArray[np.float64], outwards[np.searchsorted(ring_px, distance_px, side="left")])


@lru_cache(maxsize=2)
def _glare(value: float, height: int) -> Layer:
    """Return the transmission around the source times 255, a square of ``2 radius + 1`` px."""
    scale = height / 720
    radius = pixels(value, scale)
    offset = np.arange(-radius, radius + 1, dtype=np.float64)
    distance = np.hypot(offset[:, None], offset[None, :])
    left = transmission(value * scale, distance, max(2, int(value / RING_PX)))
    return np.rint(255 * left).astype(np.uint8)


def _draw_ghosts(
    frame: Frame, source: npt.NDArray[np.float64], strength: float, rng: np.random.Generator
) -> None:
    """Draw tinted discs, and rings, on the line from the source through the middle of the frame, and beyond it."""
    height, width = frame.shape[:2]
    scale = scale_of(frame)
    to_centre = np.array([width / 2, height / 2]) - source
    for _ in range(int(rng.integers(6, 11))):
        x, y = (source + rng.uniform(0.3, 2.1) * to_centre).tolist()
        radius = pixels(rng.uniform(8, 60), scale, at_least=2)
        tint = np.array(GHOST_TINTS[int(rng.integers(len(GHOST_TINTS)))]) / 255
        opacity = strength * rng.uniform(0.25, 0.6)
        top, left = max(0, int(y) - radius - 1), max(0, int(x) - radius - 1)
        bottom, right = min(height, int(y) + radius + 2), min(width, int(x) + radius + 2)
        if top >= bottom or left >= right:
            continue
        shape = np.zeros((bottom - top, right - left), dtype=np.uint8)
        middle = (int(x) - left, int(y) - top)
        cv2.circle(shape, middle, radius, 170, -1, cv2.LINE_AA)
        cv2.circle(shape, middle, radius, 255, pixels(2, scale), cv2.LINE_AA)
        part = frame[top:bottom, left:right]
        screen = np.rint(255 - shape[..., None] * (opacity * tint)).astype(np.uint8)
        frame[top:bottom, left:right] = lay_white_over(part, screen)

"""What is lost on the way: squares of the picture, or whole colour channels."""

from functools import lru_cache
from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.gene import Frame
from brink.sim.perturbations.layers import REFERENCE_HEIGHT_PX, pixels, scale_of

GRID_PX = 10.0
MORE_SQUARES = 5


def grid_dropout(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame with a black square at the top left of each cell of ``10 value`` px."""
    return cast(Frame, cv2.bitwise_and(frame, _grid(frame.shape[0], frame.shape[1], value)))


@lru_cache(maxsize=2)
def _grid(height: int, width: int, value: float) -> Frame:
    """Return 0 in the squares and 255 elsewhere, shape ``(height, width, 3)``."""
    cell_px = max(2.0, GRID_PX * value * height / REFERENCE_HEIGHT_PX)
    side = max(1, round(cell_px / 2))
    inside = [
        np.arange(size) - np.floor(np.arange(size) / cell_px) * cell_px < side for size in (height, width)
    ]
    mask = np.where(inside[0][:, None] & inside[1][None, :], 0, 255).astype(np.uint8)
    return cast(Frame, cv2.cvtColor(mask, cv2.COLOR_GRAY2RGB))


def coarse_dropout(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame with ``value + 5`` black squares of `value` px at random places, all of them inside."""
    height, width = frame.shape[:2]
    side = min(pixels(value, scale_of(frame)), height, width)
    count = int(value) + MORE_SQUARES
    left = rng.integers(0, width - side + 1, size=count).tolist()
    top = rng.integers(0, height - side + 1, size=count).tolist()
    dropped = frame.copy()
    for x, y in zip(left, top, strict=True):
        dropped[y : y + side, x : x + side] = 0
    return dropped


def channel_dropout(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame with `value` random channels at 0."""
    lost = rng.choice(3, size=int(value), replace=False)
    row = np.full(frame.shape[1:], 255, dtype=np.uint8)
    row[:, lost] = 0
    return frame & row

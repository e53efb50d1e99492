"""Weather: snow that whitens what is dark, rain."""

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.droplets import wet_lens
from brink.sim.perturbations.gene import Frame
from brink.sim.perturbations.layers import Layer, pixels, scale_lightness, scale_of

SNOW_THRESHOLD = 85.0
SNOW_THRESHOLD_MORE = 127.5
RAIN_BLUR_PX = 7
RAIN_LIGHTNESS = 0.7
DROP_GREY = 200
DROP_WIDTH_PX = 2
STEEPEST_SLANT = 0.3
"""Sideways over down."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rain:
    """A kind of rain, at 1280x720.

    Attributes:
        area_px: Pixels of the frame for each drop.
        length_px: Length of a drop.
        wet: Whether water stands on the lens.
    """

    area_px: float
    length_px: float
    wet: bool = False


_RAIN = {
    1: _Rain(area_px=770, length_px=10),
    2: _Rain(area_px=600, length_px=30),
    3: _Rain(area_px=500, length_px=60),
    4: _Rain(area_px=600, length_px=30, wet=True),
    5: _Rain(area_px=500, length_px=60, wet=True),
}


def snow(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame with the lightness below a threshold scaled by `value`.

    The threshold is ``85 + 127.5 U(0, 0.5)`` of 255.
    """
    threshold = SNOW_THRESHOLD + SNOW_THRESHOLD_MORE * rng.uniform(0, 0.5)
    return scale_lightness(frame, value, below=threshold)


def rain(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame in rain: slanted drops, all of it blurred and darkened, water on the lens for kinds 4 and 5.

    The number of drops goes by the frame's area in reference pixels, so a smaller frame shows the same rain.
    """
    kind = _RAIN[int(value)]
    drops = _draw_drops(frame, kind, rng)
    rainy = cast(Frame, cv2.copyTo(np.full_like(frame, DROP_GREY), drops, frame.copy()))
    side = 2 * round((RAIN_BLUR_PX - 1) / 2 * scale_of(frame)) + 1
    rainy = cast(Frame, cv2.blur(rainy, (side, side)))
    rainy = scale_lightness(rainy, RAIN_LIGHTNESS)
    return wet_lens(rainy, rng) if kind.wet else rainy


def _draw_drops(frame: Frame, kind: _Rain, rng: np.random.Generator) -> Layer:
    """Return 255 where a drop falls and 0 elsewhere, drawn in pixels as wide as a drop."""
    height, width = frame.shape[:2]
    scale = scale_of(frame)
    width_px = pixels(DROP_WIDTH_PX, scale)
    rows, columns = -(-height // width_px), -(-width // width_px)
    length = pixels(kind.length_px / width_px, scale)
    slant = round(length * rng.uniform(-STEEPEST_SLANT, STEEPEST_SLANT))
    count = max(1, round(height * width / scale**2 / kind.area_px))
    # All drops have one shape. A margin as wide as a drop takes those that reach over the edge.
    down = np.arange(length + 1)
    across = np.rint(down * slant / length).astype(np.int64)
    beside = 2 * abs(slant)
    left = rng.integers(-abs(slant), columns + abs(slant), size=count) + beside
    top = rng.integers(-length, rows, size=count) + length
    drops = np.zeros((rows + 2 * length, columns + 2 * beside), dtype=np.uint8)
    drops.reshape(-1)[(top * drops.shape[1] + left)[:, None] + down * drops.shape[1] + across] = 255
    seen = drops[length : length + rows, beside : beside + columns]
    return cast(Layer, cv2.resize(seen, (width, height), interpolation=cv2.INTER_NEAREST))

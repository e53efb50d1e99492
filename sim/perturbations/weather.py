"""Weather: rain and smoke.

Compositing n smoke discs of opacity a over a pixel leaves ``(1 - a)^n`` of it, so it is enough to count the discs
over each pixel. Each disc adds 1 at the left end of every row that it covers and subtracts 1 after the right end;
cumulative sums along the rows are the counts.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.catalogue import Frame
from brink.sim.perturbations.layers import (
    Field,
    Layer,
    composite_white,
    darken_complement,
    reference_scale,
    resize_field,
    to_layer,
    to_pixels,
)
from brink.sim.perturbations.lens import wet_lens

RAIN_BLUR_PX = 7
RAIN_LIGHTNESS = 0.7
DROP_GREY = 200
DROP_WIDTH_PX = 2
MAX_SLANT = 0.3
"""Horizontal over vertical distance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rain:
    """A kind of rain, at 1280x720.

    Attributes:
        area_px: Frame area per drop, in px.
        length_px: Length of a drop.
        wet: Whether there is water on the lens.
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


def rain(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Draw slanted drops, blur and darken the frame, and, for kinds 4 and 5, add water on the lens.

    The number of drops follows the frame's area in reference pixels, so a smaller frame shows the same rain.

    Args:
        frame: The frame.
        value: Kind of rain, 1 to 5.
        rng: Draws the drops.
    """
    kind = _RAIN[int(value)]
    drops = _draw_drops(frame, kind, rng)
    # The complement of the frame is blurred, because that is what is darkened.
    rainy = cv2.bitwise_not(frame)
    cv2.copyTo(_drop_light(rainy.shape), drops, rainy)
    side = 2 * round((RAIN_BLUR_PX - 1) / 2 * reference_scale(frame)) + 1
    darkened = darken_complement(cast(Frame, cv2.blur(rainy, (side, side))), RAIN_LIGHTNESS)
    return wet_lens(darkened, rng) if kind.wet else darkened


@lru_cache(maxsize=2)
def _drop_light(shape: tuple[int, ...]) -> Frame:
    """Return a uniform frame of 255 minus the drops' grey."""
    return np.full(shape, 255 - DROP_GREY, dtype=np.uint8)


def _draw_drops(frame: Frame, kind: _Rain, rng: np.random.Generator) -> Layer:
    """Return a mask that is 255 in the drops and 0 elsewhere, drawn at the resolution of a drop's width."""
    height, width = frame.shape[:2]
    scale = reference_scale(frame)
    width_px = to_pixels(DROP_WIDTH_PX, scale)
    rows, columns = -(-height // width_px), -(-width // width_px)
    length = to_pixels(kind.length_px / width_px, scale)
    slant = round(length * rng.uniform(-MAX_SLANT, MAX_SLANT))
    count = max(1, round(height * width / scale**2 / kind.area_px))
    # All drops have the same shape. A margin as wide as a drop holds those that cross the edge.
    down = np.arange(length + 1)
    across = np.rint(down * slant / length).astype(np.int64)
    beside = 2 * abs(slant)
    left = rng.integers(-abs(slant), columns + abs(slant), size=count) + beside
    top = rng.integers(-length, rows, size=count) + length
    drops = np.zeros((rows + 2 * length, columns + 2 * beside), dtype=np.uint8)
    drops.reshape(-1)[(top * drops.shape[1] + left)[:, None] + down * drops.shape[1] + across] = 255
    seen = drops[length : length + rows, beside : beside + columns]
    if (height, width) == (2 * rows, 2 * columns):  # doubling bytes is faster than OpenCV's resizing
        pairs = seen.astype(np.uint16) * 257
        return pairs.view(np.uint8).repeat(2, axis=0)
    return cast(Layer, cv2.resize(seen, (width, height), interpolation=cv2.INTER_NEAREST))


DISCS = 110
MIN_RADIUS, MAX_RADIUS = 0.05, 0.22
"""Radius of a disc in frame widths, before scaling by the density c."""
MIN_DENSITY, MAX_DENSITY = 0.3, 1.0
GRID_PX = 4
"""Discs are counted on a grid of this step; their edges are blurred over about two steps."""

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]


def smoke(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return ``frame T + 255 (1 - T)`` with ``T = (1 - value c)^N``, where N discs cover a pixel.

    Args:
        frame: The frame.
        value: Opacity of a disc at density c = 1.
        rng: Draws the density c from [0.3, 1], and the discs.
    """
    density = rng.uniform(MIN_DENSITY, MAX_DENSITY)
    height, width = frame.shape[:2]
    centres, radii = draw_discs(height, width, density, rng)
    step = max(1, round(GRID_PX * reference_scale(frame)))
    grid = (-(-height // step), -(-width // step))
    counts = count_discs(grid, centres / step, radii / step)
    through = ((1 - value * density) ** np.arange(counts.max() + 1)).astype(np.float32)[counts]
    soft = cast(Field, cv2.GaussianBlur(through, (0, 0), 2.0))
    return composite_white(frame, to_layer(resize_field(soft, (height, width))))


def draw_discs(
    height: int, width: int, density: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Sample the centres and radii of the smoke discs.

    Args:
        height: Height of the frame in px.
        width: Width of the frame in px.
        density: Density c; denser smoke has larger discs.
        rng: Draws the discs. Products of two uniform numbers concentrate them at the centre.

    Returns:
        Centres as x and y, shape ``(n, 2)``, and radii, shape ``(n,)``, in px.
    """
    spread = rng.uniform(-1, 1, size=(DISCS, 2)) * rng.uniform(0.2, 1, size=(DISCS, 1))
    centres = (0.5 + 0.6 * spread) * (width, height)
    radii = rng.uniform(MIN_RADIUS, MAX_RADIUS, size=DISCS) * width * (0.4 + 0.6 * density)
    return centres, radii


def count_discs(shape: tuple[int, int], centres: FloatArray, radii: FloatArray) -> IntArray:
    """Count the discs that cover each pixel of a grid.

    Args:
        shape: ``(height, width)`` of the grid.
        centres: x and y of the discs, shape ``(n, 2)``.
        radii: Radii of the discs, shape ``(n,)``.

    Returns:
        Counts, shape ``(height, width)``. A disc covers the pixels of a row that lie within its chord in that row.
    """
    height, width = shape
    rows = np.arange(height)
    half_squared = radii[:, None] ** 2 - (rows[None, :] - centres[:, 1:]) ** 2
    disc, row = np.nonzero(half_squared >= 0)
    half = np.sqrt(half_squared[disc, row])
    begin = np.clip(np.ceil(centres[disc, 0] - half), 0, width).astype(np.int64)
    end = np.clip(np.floor(centres[disc, 0] + half) + 1, 0, width).astype(np.int64)
    end = np.maximum(begin, end)
    size = height * (width + 1)
    change = np.bincount(row * (width + 1) + begin, minlength=size)
    change -= np.bincount(row * (width + 1) + end, minlength=size)
    return np.cumsum(change.reshape(height, width + 1), axis=1)[:, :width]

"""Building blocks of the transforms: pixel scale, compositing, lightness, and smooth noise.

A layer consists of two images: the transmission of the frame behind it, and the light that it adds.
"""

from functools import cache
from typing import TypeAlias, cast

import cv2
import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.catalogue import Frame

Layer: TypeAlias = npt.NDArray[np.uint8]
"""One uint8 value per pixel, shape ``(height, width)``."""
Field: TypeAlias = npt.NDArray[np.float32]
"""One float32 value per pixel, shape ``(height, width)``, usually in [0, 1]."""

REFERENCE_HEIGHT_PX = 720


def reference_scale(frame: Frame) -> float:
    """Return the size of a reference pixel (of a frame 720 px high) in pixels of this frame."""
    return len(frame) / REFERENCE_HEIGHT_PX


def to_pixels(reference_px: float, scale: float, at_least: int = 1) -> int:
    """Convert a reference length to whole pixels of a frame.

    Args:
        reference_px: Length in a frame 720 px high.
        scale: Size of a reference pixel in the frame.
        at_least: Lower bound of the result.
    """
    return max(at_least, round(reference_px * scale))


def composite(frame: Frame, transmission: Layer | Frame, light: Layer | Frame) -> Frame:
    """Return ``frame * transmission / 255 + light``, rounded and clipped.

    Args:
        frame: Shape ``(height, width, 3)``.
        transmission: 255 is transparent; shape ``(height, width)`` or ``(height, width, 3)``.
        light: Light that the layer adds; shape ``(height, width)`` or ``(height, width, 3)``.
    """
    through = cv2.multiply(frame, _to_rgb(transmission), scale=1 / 255)
    return cast(Frame, cv2.add(through, _to_rgb(light), dst=through))


def composite_white(frame: Frame, transmission: Layer | Frame) -> Frame:
    """Return ``frame * T + 255 (1 - T)`` for a transmission ``T`` stored as ``255 T``."""
    return composite(frame, transmission, cast(Frame, cv2.bitwise_not(transmission)))


def _to_rgb(layer: Layer | Frame) -> Frame:
    return cast(Frame, layer if layer.ndim == 3 else cv2.cvtColor(layer, cv2.COLOR_GRAY2RGB))


def to_layer(field: Field) -> Layer:
    """Convert a field in [0, 1] to integers from 0 to 255."""
    return cast(Layer, cv2.convertScaleAbs(field, alpha=255))


GAIN_STEPS = 45
"""Integer that stands for the gain of dark pixels in `darken_complement`; the largest gain is 255 / 45 of it."""


def darken_complement(complement: Frame, factor: float) -> Frame:
    """Multiply the lightness of a smooth frame by a factor below 1, without converting to HLS.

    With hue and saturation fixed, the complement y of a channel becomes ``a y + c``, where a and c only depend on the
    pixel's lightness. They vary smoothly, so they are looked up at a quarter of the resolution. Saturated colours
    that are almost white become less saturated.

    Args:
        complement: 255 minus the frame, shape ``(height, width, 3)``, without details of a few pixels; changed.
        factor: Factor on the lightness, in [.5, 1).

    Returns:
        The darkened frame, not its complement.
    """
    height, width = complement.shape[:2]
    quarter = (-(-width // 4), -(-height // 4))
    red, green, blue = cv2.split(cv2.resize(complement, quarter, interpolation=cv2.INTER_AREA))
    most, least = (pick(pick(red, green), blue) for pick in (cv2.max, cv2.min))
    darkness = cv2.addWeighted(most, 0.5, least, 0.5, 0)
    gain, offset = (
        cast(Layer, cv2.resize(cv2.LUT(darkness, table), (width, height), interpolation=cv2.INTER_LINEAR))
        for table in _darkening(factor)
    )
    cv2.multiply(complement, _to_rgb(gain), dst=complement, scale=factor / GAIN_STEPS)
    cv2.add(complement, _to_rgb(offset), dst=complement)
    return cast(Frame, cv2.bitwise_not(complement, dst=complement))


@cache
def _darkening(factor: float) -> tuple[Layer, Layer]:
    """Return the gain, in units of ``factor / GAIN_STEPS``, and the offset for each darkness, 255 minus lightness."""
    before = 1 - np.arange(256) / 255
    after = factor * before
    # Chroma is the saturation times 2 L for dark colours and times 2 (1 - L) for light ones.
    room_before, room_after = (np.minimum(light, 1 - light) for light in (before, after))
    gain = np.divide(room_after, room_before, out=np.full(256, factor), where=room_before > 0)
    gain = np.minimum(gain, factor * 255 / GAIN_STEPS)
    offset = (1 - after) - gain * (1 - before)
    return np.rint(gain * GAIN_STEPS / factor).astype(np.uint8), np.rint(255 * offset).astype(np.uint8)


def clouds(shape: tuple[int, int], cell_px: float, octaves: int, rng: np.random.Generator) -> Field:
    """Return smooth noise with mean about 0.5 and standard deviation about 0.15.

    Args:
        shape: ``(height, width)`` in px.
        cell_px: Size of the largest blobs.
        octaves: Number of blob sizes, each half as large and half as strong as the previous one.
        rng: Draws the blobs.
    """
    height, width = shape
    total = np.full((2, 2), 0.5, dtype=np.float32)
    for octave in range(octaves):
        cell = cell_px / 2**octave
        grid = rng.random((round(height / cell) + 2, round(width / cell) + 2), dtype=np.float32) - 0.5
        coarser = cv2.resize(total, (grid.shape[1], grid.shape[0]), interpolation=cv2.INTER_CUBIC)
        total = coarser + grid * np.float32(0.75 * 0.5**octave)
    return cast(Field, cv2.resize(total, (width, height), interpolation=cv2.INTER_CUBIC))


def resize_field(field: Field, shape: tuple[int, int]) -> Field:
    """Resize a field to ``(height, width)`` by linear interpolation."""
    return cast(Field, cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))

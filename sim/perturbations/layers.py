"""What the transforms share: pixel sizes, laying light over a frame, lightness, and slow noise.

A layer is two pictures: how much of the frame it lets through, and the light that it adds itself.
"""

from typing import TypeAlias, cast

import cv2
import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.gene import Frame

Layer: TypeAlias = npt.NDArray[np.uint8]
"""One number a pixel, uint8, shape ``(height, width)``."""
Field: TypeAlias = npt.NDArray[np.float32]
"""One number a pixel, float32, shape ``(height, width)``, mostly in [0, 1]."""

REFERENCE_HEIGHT_PX = 720


def scale_of(frame: Frame) -> float:
    """Return the size of a reference pixel (of a frame 720 px high) in pixels of this frame."""
    return len(frame) / REFERENCE_HEIGHT_PX


def pixels(reference_px: float, scale: float, at_least: int = 1) -> int:
    """Return a length in whole pixels of a frame."""
    return max(at_least, round(reference_px * scale))


def lay_over(frame: Frame, transmission: Layer | Frame, light: Layer | Frame) -> Frame:
    """Return ``frame * transmission / 255 + light``, rounded and clipped.

    Args:
        frame: Shape ``(height, width, 3)``.
        transmission: 255 lets all through; shape ``(height, width)``, or with three channels.
        light: What the layer adds; shape ``(height, width)``, or with three channels.
    """
    through = cv2.multiply(frame, _three(transmission), scale=1 / 255)
    return cast(Frame, cv2.add(through, _three(light), dst=through))


def lay_white_over(frame: Frame, transmission: Layer | Frame) -> Frame:
    """Return ``frame * T + 255 (1 - T)`` for a transmission ``T`` that is stored as ``255 T``."""
    return lay_over(frame, transmission, cast(Frame, cv2.bitwise_not(transmission)))


def _three(layer: Layer | Frame) -> Frame:
    return cast(Frame, layer if layer.ndim == 3 else cv2.cvtColor(layer, cv2.COLOR_GRAY2RGB))


def to_layer(field: Field) -> Layer:
    """Return a field in [0, 1] as whole numbers from 0 to 255."""
    return cast(Layer, cv2.convertScaleAbs(field, alpha=255))


def scale_lightness(frame: Frame, factor: float, below: float = 256.0) -> Frame:
    """Return the frame with its lightness (L of HLS, 0 to 255) multiplied and clipped; hue and saturation stay.

    Args:
        frame: Shape ``(height, width, 3)``.
        factor: By what to multiply.
        below: Pixels that are at least as light keep their bytes.
    """
    hls = cv2.cvtColor(frame, cv2.COLOR_RGB2HLS)
    lightness = cv2.extractChannel(hls, 1)
    cv2.insertChannel(cv2.convertScaleAbs(lightness, alpha=factor), hls, 1)
    scaled = cast(Frame, cv2.cvtColor(hls, cv2.COLOR_HLS2RGB, dst=hls))
    if below > 255:
        return scaled
    # To HLS and back costs a few grey values, which a pixel that keeps its lightness must not lose.
    _, kept = cv2.threshold(lightness, np.ceil(below) - 1, 255, cv2.THRESH_BINARY)
    return cast(Frame, cv2.copyTo(frame, kept, scaled))


def clouds(shape: tuple[int, int], cell_px: float, octaves: int, rng: np.random.Generator) -> Field:
    """Return smooth noise with mean about 0.5 and standard deviation about 0.15.

    Args:
        shape: ``(height, width)`` in px.
        cell_px: Size of the largest blobs.
        octaves: How many sizes of blobs, each half as large and half as strong as the one before.
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


def enlarge(field: Field, shape: tuple[int, int]) -> Field:
    """Return a field in another size ``(height, width)``, linear between its points."""
    return cast(Field, cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))

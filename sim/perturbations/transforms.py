"""The transforms of the catalogue's genes; those for sensor, transmission and exposure are defined here.

Importing this module loads OpenCV; importing the catalogue does not. Every transform maps (frame, value of the level,
generator) to a new frame.
"""

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.catalogue import Frame, Transform
from brink.sim.perturbations.layers import REFERENCE_HEIGHT_PX, Layer, reference_scale, to_pixels
from brink.sim.perturbations.lens import broken_lens, condensation, dirty, sun_flare
from brink.sim.perturbations.snow import snow
from brink.sim.perturbations.weather import rain, smoke

SHIFT_PX = 3.0
NOISE_SEED = 20220928
NOISE_SPARE = 2**20
"""Number of positions of a frame in the noise pool; the random sign doubles the patterns."""


def _shifted_pixels(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Shift each row cyclically to the left by a random 0 to ``int(3 / value)`` px.

    The largest shift scales with the frame's height and is at least 1 px.
    """
    height, width, channels = frame.shape
    most = min(width - 1, to_pixels(int(SHIFT_PX / value), reference_scale(frame)))
    shifts = rng.integers(0, most + 1, size=height)
    # With each row repeated to its right, a cyclic shift is a window of consecutive bytes.
    twice = np.concatenate([frame, frame[:, :most]], axis=1).reshape(height, -1)
    windows = np.lib.stride_tricks.sliding_window_view(twice, width * channels, axis=1)
    return cast(Frame, windows[np.arange(height), channels * shifts].reshape(frame.shape))


def _gaussian_noise(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Add noise with a standard deviation of ``sqrt(value)`` of full scale to every channel of every pixel.

    The noise is a window at a random position, with a random sign, into a fixed pool of normally distributed noise.
    """
    above, below = _noise_pool(value, frame.size)
    start = int(rng.integers(NOISE_SPARE))
    if rng.random() < 0.5:
        above, below = below, above
    window = slice(start, start + frame.size)
    noisy = cv2.add(frame, above[window].reshape(frame.shape))
    # One of the two parts is zero at every pixel, so two clipped operations have the same effect as one.
    return cast(Frame, cv2.subtract(noisy, below[window].reshape(frame.shape), dst=noisy))


@lru_cache(maxsize=2)
def _noise_pool(variance: float, size: int) -> tuple[Layer, Layer]:
    """Return the positive and negative parts of a fixed sequence of Gaussian noise, in grey levels, as uint8."""
    normal = np.random.default_rng(NOISE_SEED).standard_normal(size + NOISE_SPARE, dtype=np.float32)
    noise = np.rint(normal * np.float32(255 * np.sqrt(variance)))
    return np.clip(noise, 0, 255).astype(np.uint8), np.clip(-noise, 0, 255).astype(np.uint8)


HALVED_FROM_PX = 2.9
"""Standard deviation from which a blur is computed at half the resolution."""
PYRAMID_VARIANCE = 2.0
"""Variance in px^2 of halving and doubling a frame, by a kernel of 1 4 6 4 1 each."""


def _gaussian_blur(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Blur with a Gaussian kernel of `value` px, at least 3.

    The standard deviation is ``0.3 ((k - 1) / 2 - 1) + 0.8`` px for the scaled `k`: 0.5 px for a kernel of 1.
    """
    kernel_px = value * reference_scale(frame)
    sigma_px = 0.3 * ((kernel_px - 1) / 2 - 1) + 0.8
    radius = max(1, round((kernel_px - 1) / 2))
    if sigma_px >= HALVED_FROM_PX:
        return _blur_halved(frame, radius, sigma_px)
    side = 2 * radius + 1
    return cast(Frame, cv2.GaussianBlur(frame, (side, side), sigma_px))


def _blur_halved(frame: Frame, radius: int, sigma_px: float) -> Frame:
    """Blur at half the resolution, which takes less than half the time and is as close to the exact result.

    Halving, blurring and doubling are convolutions with almost Gaussian kernels, whose variances add up. The result
    differs from the exact one by up to 2 grey levels, as does that of OpenCV's own filter with integer weights.
    """
    height, width = frame.shape[:2]
    offsets = np.arange(-radius, radius + 1)
    weights = np.exp(-(offsets**2) / (2 * sigma_px**2))
    variance = float((weights * offsets**2).sum() / weights.sum())  # of the truncated kernel
    sigma = ((variance - PYRAMID_VARIANCE) / 4) ** 0.5
    side = 2 * int(np.ceil(3.2 * sigma)) + 1
    # The last row and column may lie between those of the halved frame, which cannot mirror at them.
    margin = 2 * (radius // 2 + 1)
    wide = cv2.copyMakeBorder(frame, 0, margin, 0, margin, cv2.BORDER_REFLECT_101)
    small = cv2.GaussianBlur(cv2.pyrDown(wide), (side, side), sigma)
    blurred = cv2.pyrUp(small, dstsize=(width + margin, height + margin))
    return np.ascontiguousarray(blurred[:height, :width])


GRID_PX = 10.0
EXTRA_SQUARES = 5


def _grid_dropout(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Draw a black square at the top left of each cell of a grid with a step of ``10 * value`` px."""
    return cast(Frame, cv2.bitwise_and(frame, _grid(frame.shape[0], frame.shape[1], value)))


@lru_cache(maxsize=2)
def _grid(height: int, width: int, value: float) -> Frame:
    """Return a mask that is 0 in the squares and 255 elsewhere, shape ``(height, width, 3)``."""
    cell_px = max(2.0, GRID_PX * value * height / REFERENCE_HEIGHT_PX)
    side = max(1, round(cell_px / 2))
    inside = [
        np.arange(size) - np.floor(np.arange(size) / cell_px) * cell_px < side for size in (height, width)
    ]
    mask = np.where(inside[0][:, None] & inside[1][None, :], 0, 255).astype(np.uint8)
    return cast(Frame, cv2.cvtColor(mask, cv2.COLOR_GRAY2RGB))


def _coarse_dropout(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Draw ``value + 5`` black squares of `value` px at random positions within the frame."""
    height, width = frame.shape[:2]
    side = min(to_pixels(value, reference_scale(frame)), height, width)
    count = int(value) + EXTRA_SQUARES
    left = rng.integers(0, width - side + 1, size=count).tolist()
    top = rng.integers(0, height - side + 1, size=count).tolist()
    dropped = frame.copy()
    for x, y in zip(left, top, strict=True):
        dropped[y : y + side, x : x + side] = 0
    return dropped


def _channel_dropout(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Set `value` random channels to 0."""
    lost = rng.choice(3, size=int(value), replace=False)
    row = np.full(frame.shape[1:], 255, dtype=np.uint8)
    row[:, lost] = 0
    return frame & row


def _brightness(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Add ``255 * value`` to every channel and clip."""
    added = round(255 * value)
    return cast(Frame, cv2.add(frame, np.full(4, added, dtype=np.float64)))


def _contrast(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Multiply every channel by ``1 + value``, round and clip."""
    return cast(Frame, cv2.convertScaleAbs(frame, alpha=1 + value))


TRANSFORMS: Mapping[str, Transform] = MappingProxyType(
    {
        "shifted_pixels": _shifted_pixels,
        "gaussian_noise": _gaussian_noise,
        "gaussian_blur": _gaussian_blur,
        "grid_dropout": _grid_dropout,
        "coarse_dropout": _coarse_dropout,
        "channel_dropout": _channel_dropout,
        "snow": snow,
        "broken_lens": broken_lens,
        "dirty": dirty,
        "condensation": condensation,
        "sun_flare": sun_flare,
        "brightness": _brightness,
        "contrast": _contrast,
        "rain": rain,
        "smoke": smoke,
    }
)

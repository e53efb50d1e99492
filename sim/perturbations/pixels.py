"""Faults of the sensor: rows out of place, noise, blur."""

from functools import lru_cache
from typing import cast

import cv2
import numpy as np

from brink.sim.perturbations.gene import Frame
from brink.sim.perturbations.layers import Layer, pixels, scale_of

SHIFT_PX = 3.0
NOISE_SEED = 20220928
NOISE_SPARE = 2**20
"""By how many numbers the pool is longer than a frame: in so many ways noise can fall on it, times two."""


def shifted_pixels(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame with each row moved left in a circle by 0 to ``int(3 / value)`` px.

    A small value moves far. The largest shift scales with the frame's height and is at least 1 px.
    """
    height, width, channels = frame.shape
    most = min(width - 1, pixels(int(SHIFT_PX / value), scale_of(frame)))
    shifts = rng.integers(0, most + 1, size=height)
    # Each row again to the right of itself: a circular shift is then a window of consecutive bytes.
    twice = np.concatenate([frame, frame[:, :most]], axis=1).reshape(height, -1)
    windows = np.lib.stride_tricks.sliding_window_view(twice, width * channels, axis=1)
    return cast(Frame, windows[np.arange(height), channels * shifts].reshape(frame.shape))


def gaussian_noise(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame with N(0, sqrt(value)), of full scale, added to every channel of every pixel.

    The noise is a window at a random place, and of a random sign, into a fixed pool of normal numbers.
    """
    above, below = _noise_pool(value, frame.size)
    start = int(rng.integers(NOISE_SPARE))
    if rng.random() < 0.5:
        above, below = below, above
    window = slice(start, start + frame.size)
    noisy = cv2.add(frame, above[window].reshape(frame.shape))
    # Where one part is positive the other is zero: two clipped steps clip like one.
    return cast(Frame, cv2.subtract(noisy, below[window].reshape(frame.shape), dst=noisy))


@lru_cache(maxsize=2)
def _noise_pool(variance: float, size: int) -> tuple[Layer, Layer]:
    """Return the positive and the negative part of a fixed row of normal numbers, in grey values, uint8."""
    normal = np.random.default_rng(NOISE_SEED).standard_normal(size + NOISE_SPARE, dtype=np.float32)
    noise = np.rint(normal * np.float32(255 * np.sqrt(variance)))
    return np.clip(noise, 0, 255).astype(np.uint8), np.clip(-noise, 0, 255).astype(np.uint8)


def gaussian_blur(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame blurred with a Gaussian kernel of `value` px, of at least 3.

    The standard deviation is ``0.3 ((k - 1) / 2 - 1) + 0.8`` px for the scaled `k`: 0.5 px for the kernel of 1.
    """
    kernel_px = value * scale_of(frame)
    sigma_px = 0.3 * ((kernel_px - 1) / 2 - 1) + 0.8
    side = 2 * max(1, round((kernel_px - 1) / 2)) + 1
    return cast(Frame, cv2.GaussianBlur(frame, (side, side), sigma_px))

"""Snowfall: flakes at several depths, the veil of the many that are too far to be seen, and snow that has settled.

A flake is a stamp: a soft streak in the direction of the wind. The nearer a flake, the larger, longer and more out of
focus it is, and the more of the scene shows through it. Far flakes are by far the most. How this departs from the
published technique, which only scales lightness, is recorded in docs/adr/0022.
"""

from dataclasses import dataclass
from typing import Final, cast

import cv2
import numpy as np

from brink.sim.perturbations.catalogue import Frame
from brink.sim.perturbations.layers import Field, Layer, composite, reference_scale, to_pixels

THRESHOLD: Final = 85.0
THRESHOLD_MORE: Final = 127.5
STRONGEST: Final = 5.0
"""Value of the highest level."""
SETTLED: Final = 0.25
"""Share of the lightness that the published technique adds to a dark pixel."""
EDGE: Final = 24.0
"""Grey levels over which the threshold fades out."""
VEIL: Final = 0.5
"""Opacity of the veil at the highest level."""
MAX_TILT_RAD: Final = 0.7
"""Largest angle between the flakes' path and the vertical."""
STAMPS: Final = 3
"""Sizes of flakes at one depth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Depth:
    """Flakes at one distance, in a frame of 1280x720.

    Attributes:
        count: Number of flakes at the highest level.
        radius_px: Radii of the smallest and the largest flakes.
        streak_px: Distance that the largest flakes fall during an exposure.
        opacity: Opacity in the middle of a flake.
        step: Size of a pixel of the grid on which they are drawn; blurred flakes need no finer one.
    """

    count: int
    radius_px: tuple[float, float]
    streak_px: float
    opacity: float
    step: int


_DEPTHS: Final = (
    _Depth(count=6500, radius_px=(0.7, 1.2), streak_px=3.0, opacity=0.6, step=1),
    _Depth(count=1100, radius_px=(1.3, 2.3), streak_px=8.0, opacity=0.85, step=1),
    _Depth(count=150, radius_px=(2.8, 4.8), streak_px=20.0, opacity=0.7, step=2),
    _Depth(count=16, radius_px=(9.0, 17.0), streak_px=42.0, opacity=0.4, step=4),
)
"""From far to near."""


def snow(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Add settled snow, a veil and falling flakes.

    Args:
        frame: The frame.
        value: Factor on the lightness of pixels below a threshold, of which settled snow takes a share. The amount of
            falling snow grows with ``(value - 1) / 4``.
        rng: Draws the threshold, ``85 + 127.5 U(0, 0.5)`` of 255, the wind and the flakes.
    """
    amount = (value - 1) / (STRONGEST - 1)
    threshold = THRESHOLD + THRESHOLD_MORE * rng.uniform(0, 0.5)
    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
    ambient = float(cv2.mean(grey)[0])
    flakes = _fall(frame, amount, rng)
    # Snow is as light as what falls on it, so at night it is darker.
    veil, flake = min(215, 70 + 1.1 * ambient), min(248, 170 + 0.6 * ambient)
    opacity = VEIL * amount
    settled = cv2.LUT(grey, _settling(value, threshold, opacity * veil, 1 - opacity))
    # Composited from back to front: the settled scene, the veil, the flakes.
    clear = cv2.bitwise_not(flakes)
    light = cv2.add(
        cv2.multiply(settled, clear, scale=1 / 255), cv2.convertScaleAbs(flakes, alpha=flake / 255)
    )
    return composite(frame, cast(Layer, cv2.convertScaleAbs(clear, alpha=1 - opacity)), cast(Layer, light))


def _settling(value: float, threshold: float, veil: float, through: float) -> Layer:
    """Return the light that settled snow and the veil add to a pixel of each lightness, shape ``(256,)``."""
    before = np.arange(256.0)
    added = SETTLED * (np.minimum(255, value * before) - before)
    covered = np.clip((threshold - before) / EDGE + 0.5, 0, 1)
    light: Layer = np.rint(np.clip(veil + through * covered * added, 0, 255)).astype(np.uint8)
    return light


def _fall(frame: Frame, amount: float, rng: np.random.Generator) -> Layer:
    """Return the opacity of the falling flakes."""
    height, width = frame.shape[:2]
    tilt_rad = rng.uniform(-MAX_TILT_RAD, MAX_TILT_RAD)
    seen = np.zeros((height, width), dtype=np.uint8)
    for depth in _DEPTHS:
        layer = _draw_flakes(frame, depth, amount, tilt_rad, rng)
        if layer.shape != seen.shape:
            layer = cast(Layer, cv2.resize(layer, (width, height), interpolation=cv2.INTER_LINEAR))
        cv2.max(seen, layer, dst=seen)
    return seen


def _draw_flakes(
    frame: Frame, depth: _Depth, amount: float, tilt_rad: float, rng: np.random.Generator
) -> Layer:
    """Return the opacity of the flakes at one depth, on its grid."""
    scale = reference_scale(frame)
    step = to_pixels(depth.step, scale)
    rows, columns = (-(-side // step) for side in frame.shape[:2])
    area = frame.shape[0] * frame.shape[1] / scale**2 / (1280 * 720)
    count = max(1, round(depth.count * area * amount / STAMPS))
    stamps = [
        _stamp(
            radius_px * scale / step, depth.streak_px * share * scale / step, tilt_rad + turn, depth.opacity
        )
        for radius_px, share, turn in zip(
            np.linspace(*depth.radius_px, STAMPS),
            np.linspace(0.5, 1, STAMPS),
            rng.normal(0, 0.12, STAMPS),
            strict=True,
        )
    ]
    margin = max(max(stamp.shape) for stamp in stamps)
    layer = np.zeros((rows + 2 * margin, columns + 2 * margin), dtype=np.uint8)
    for stamp in stamps:
        down, across = np.nonzero(stamp)
        top = rng.integers(0, rows + margin, size=count)
        left = rng.integers(0, columns + margin, size=count)
        places = (top * layer.shape[1] + left)[:, None] + (down * layer.shape[1] + across)
        flat = layer.reshape(-1)
        # A faint rim leaves the cores of other stamps' flakes. Where flakes of one stamp overlap, the last counts.
        flat[places] = np.maximum(flat[places], stamp[down, across])
    return layer[margin : margin + rows, margin : margin + columns]


def _stamp(radius: float, streak: float, tilt_rad: float, opacity: float) -> Layer:
    """Return the opacity of a flake that falls `streak` px during an exposure, in a square."""
    radius = max(radius, 0.55)
    reach = int(np.ceil(2 * radius + streak / 2))
    x = np.arange(-reach, reach + 1, dtype=np.float32)
    y = x[:, None]
    sine, cosine = np.float32(np.sin(tilt_rad)), np.float32(np.cos(tilt_rad))
    beyond = np.maximum(np.abs(x * sine + y * cosine) - np.float32(streak / 2), 0)
    across = x * cosine - y * sine
    soft: Field = np.exp((beyond * beyond + across * across) / np.float32(-(radius**2)))
    # The faint rims of small flakes would cost more than all the rest.
    return np.where(soft > (0.1 if radius < 2 else 0.03), np.rint(255 * opacity * soft), 0).astype(np.uint8)

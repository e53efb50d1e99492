"""Water on the lens: the film, droplets and streaks of condensation, and the drops that rain leaves."""

from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.gene import Frame
from brink.sim.perturbations.layers import (
    REFERENCE_HEIGHT_PX,
    Layer,
    clouds,
    lay_over,
    pixels,
    scale_of,
    to_layer,
)

FILM_GREY = 205
FILM_CELL_PX = 220
DROPLETS = 200
STREAKS = (4, 9)
WET_OPACITY = 0.15
WET_DROPS = 45


def condensation(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame behind a misted lens, of opacity `value` where the mist is thickest."""
    opacity, light = _film(frame, 0.55, 1.0, rng)
    scale = scale_of(frame)
    for _ in range(int(rng.integers(*STREAKS))):
        _draw_streak(opacity, light, scale, rng)
    _draw_drops(opacity, light, rng.gamma(2.0, 1.6, DROPLETS) + 1.5, rng)
    return _behind(frame, opacity, light, value)


def wet_lens(frame: Frame, rng: np.random.Generator) -> Frame:
    """Return the frame behind a film of water with large drops, of opacity 0.15."""
    opacity, light = _film(frame, 0.3, 0.8, rng)
    _draw_drops(opacity, light, rng.gamma(2.5, 5.0, WET_DROPS) + 3, rng, edge=cv2.LINE_8)
    return _behind(frame, opacity, light, WET_OPACITY)


def _film(frame: Frame, least: float, most: float, rng: np.random.Generator) -> tuple[Layer, Layer]:
    """Return the opacity of an uneven film, about from `least` to `most`, and its light."""
    height, width = frame.shape[:2]
    coarse = clouds((max(2, height // 4), max(2, width // 4)), FILM_CELL_PX * scale_of(frame) / 4, 2, rng)
    film = np.clip(least + (most - least) * (coarse * 1.6 - 0.3), 0, 1).astype(np.float32)
    opacity = cv2.resize(to_layer(film), (width, height), interpolation=cv2.INTER_LINEAR)
    return cast(Layer, opacity), np.full((height, width), FILM_GREY, dtype=np.uint8)


def _draw_streak(opacity: Layer, light: Layer, scale: float, rng: np.random.Generator) -> None:
    """Draw the track of a drop that ran down: clear glass, with the drop at its lower end."""
    height, width = opacity.shape
    steps = 14
    x = rng.uniform(0, width) + np.cumsum(rng.normal(0, 3.0 * scale, steps))
    top = rng.uniform(-0.1, 0.5) * height
    y = np.linspace(top, top + rng.uniform(0.2, 0.6) * height, steps)
    track = np.stack([x, y], axis=1).round().astype(np.int32)
    radius = rng.uniform(5, 9)
    cv2.polylines(opacity, [track], False, 90, pixels(2.2 * radius, scale), cv2.LINE_AA)
    cv2.polylines(opacity, [track], False, 25, pixels(1.5 * radius, scale), cv2.LINE_AA)
    _draw_drop(opacity, light, (int(track[-1, 0]), int(track[-1, 1])), pixels(radius, scale))


def _draw_drops(
    opacity: Layer,
    light: Layer,
    radii_px: npt.NDArray[np.float64],
    rng: np.random.Generator,
    edge: int = cv2.LINE_AA,
) -> None:
    height, width = opacity.shape
    scale = height / REFERENCE_HEIGHT_PX
    xs = rng.integers(0, width, size=len(radii_px)).tolist()
    ys = rng.integers(0, height, size=len(radii_px)).tolist()
    for x, y, radius in zip(xs, ys, radii_px.tolist(), strict=True):
        _draw_drop(opacity, light, (x, y), pixels(radius, scale), edge)


def _draw_drop(
    opacity: Layer, light: Layer, middle: tuple[int, int], radius: int, edge: int = cv2.LINE_AA
) -> None:
    """Draw a drop: dark above and bright below, for it turns the scene upside down, with a glint."""
    x, y = middle
    # Smooth edges cost more than the rest of the drop, and do not show on small ones.
    line = edge if radius > 4 else cv2.LINE_8
    cv2.circle(opacity, middle, radius, 255, -1, line)
    cv2.circle(light, middle, radius, 70, -1, line)
    if radius < 2:
        return
    cv2.circle(light, (x, y + max(1, radius // 4)), max(1, round(0.75 * radius)), 185, -1, line)
    if radius > 4:
        cv2.circle(light, (x - radius // 3, y - radius // 3), max(1, radius // 5), 255, -1, line)


def _behind(frame: Frame, opacity: Layer, light: Layer, value: float) -> Frame:
    scaled = cv2.convertScaleAbs(opacity, alpha=value)
    added = cv2.multiply(scaled, light, scale=1 / 255)
    return lay_over(frame, cast(Layer, cv2.bitwise_not(scaled)), cast(Layer, added))

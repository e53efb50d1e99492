"""A lens that was hit, and one that is dirty."""

from functools import cache
from typing import TypeAlias, cast

import cv2
import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.gene import Frame
from brink.sim.perturbations.layers import Layer, clouds, lay_over, lay_white_over, pixels, scale_of, to_layer

Points: TypeAlias = npt.NDArray[np.float64]

CRACK_POINTS = 10
DIRT_RGB = (58, 47, 33)
DIRT_CELL_PX = 330
SMEAR_FROM, SMEAR_FULL = 0.5, 0.72
"""Where smooth noise becomes a smear, and where the smear is thickest."""
SPECKS = (70, 150)


def broken_lens(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame behind a lens with 1 to 3 points of impact, its cracks of opacity `value`."""
    height, width = frame.shape[:2]
    cracks = np.zeros((height, width), dtype=np.uint8)
    for _ in range(int(rng.integers(1, 4))):
        impact = np.array([rng.uniform(0.1, 0.9) * width, rng.uniform(0.1, 0.9) * height])
        _draw_impact(cracks, impact, scale_of(frame), rng)
    transmission = cv2.bitwise_not(cv2.convertScaleAbs(cracks, alpha=value))
    return lay_white_over(frame, cast(Layer, transmission))


def _draw_impact(cracks: Layer, impact: Points, scale: float, rng: np.random.Generator) -> None:
    """Draw radial cracks around a point, rings that join them, and splinters that shine between them."""
    count = int(rng.integers(12, 25))
    spacing = 2 * np.pi / count
    angles = spacing * (np.arange(count) + rng.uniform(-0.35, 0.35, count))
    # From the impact outwards, in steps that grow: dense in the middle, long straight ends.
    reach = rng.uniform(0.15, 0.9, count) * cracks.shape[0]
    steps = np.linspace(0, 1, CRACK_POINTS) ** 1.6
    bend = np.cumsum(rng.normal(0, 0.035, (count, CRACK_POINTS)), axis=1)
    turned = angles[:, None] + bend
    rays = np.stack([np.cos(turned), np.sin(turned)], axis=2) * (reach[:, None] * steps)[..., None] + impact

    rings = int(rng.integers(3, 7))
    radii = np.geomspace(12, rng.uniform(120, 220), rings) * scale
    jittered = radii[:, None] * rng.uniform(0.8, 1.2, (rings, count))
    knots = np.stack([np.cos(angles), np.sin(angles)], axis=1) * jittered[..., None] + impact

    _draw_splinters(cracks, knots, rng)
    for ray, bright in zip(rays, rng.integers(170, 256, count).tolist(), strict=True):
        _draw_lines(cracks, ray[None], bright, pixels(2, scale))
    _draw_lines(cracks, rays[:, : CRACK_POINTS // 2], 255, pixels(3, scale))
    whole = rng.random((rings, count)) >= 0.25
    joints = np.stack([knots, np.roll(knots, -1, axis=1)], axis=2)
    _draw_lines(cracks, joints[whole], 200, pixels(1.5, scale))
    _fill(cracks, knots[0], 230)


def _draw_splinters(cracks: Layer, knots: Points, rng: np.random.Generator) -> None:
    """Fill some of the fields between neighbouring cracks and rings with a faint reflection."""
    shining = rng.random((knots.shape[0] - 1, knots.shape[1])) < 0.3
    brightness = rng.integers(20, 80, shining.shape)
    for ring, ray in np.argwhere(shining).tolist():
        following = (ray + 1) % knots.shape[1]
        corners = [knots[ring, ray], knots[ring, following], knots[ring + 1, following], knots[ring + 1, ray]]
        _fill(cracks, np.array(corners), int(brightness[ring, ray]))


def _draw_lines(cracks: Layer, lines: Points, bright: int, thickness: int) -> None:
    """Draw lines through points, shape ``(lines, points, 2)``."""
    cv2.polylines(cracks, list(lines.round().astype(np.int32)), False, bright, thickness, cv2.LINE_AA)


def _fill(cracks: Layer, corners: Points, bright: int) -> None:
    cv2.fillPoly(cracks, [corners.round().astype(np.int32)], bright, cv2.LINE_AA)


def dirty(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return the frame behind a dirty lens: brown smears and specks, of opacity `value` where they are thickest."""
    height, width = frame.shape[:2]
    scale = scale_of(frame)
    half = (max(2, height // 2), max(2, width // 2))
    noise = to_layer(clouds(half, DIRT_CELL_PX * scale / 2, 5, rng))
    dirt = cv2.LUT(noise, _smears())
    specks = np.zeros(half, dtype=np.uint8)
    for _ in range(int(rng.integers(*SPECKS))):
        _draw_speck(specks, scale / 2, rng)
    dirt = cast(Layer, cv2.max(dirt, cv2.blur(specks, (3, 3))))
    opacity = cv2.convertScaleAbs(cast(Layer, cv2.resize(dirt, (width, height))), alpha=value)
    light = cv2.merge([cv2.convertScaleAbs(opacity, alpha=part / 255) for part in DIRT_RGB])
    return lay_over(frame, cast(Layer, cv2.bitwise_not(opacity)), cast(Frame, light))


@cache
def _smears() -> Layer:
    """Return how thick the dirt is for each grey value of the noise, shape ``(256,)``."""
    rise = np.clip((np.arange(256) / 255 - SMEAR_FROM) / (SMEAR_FULL - SMEAR_FROM), 0, 1)
    return np.rint(255 * rise * rise * (3 - 2 * rise)).astype(np.uint8)


def _draw_speck(specks: Layer, scale: float, rng: np.random.Generator) -> None:
    height, width = specks.shape
    middle = (int(rng.integers(width)), int(rng.integers(height)))
    size = rng.gamma(1.5, 4.0) + 2
    axes = (pixels(size, scale), pixels(size * rng.uniform(0.4, 1), scale))
    turn, opacity = rng.uniform(0, 180), int(rng.integers(130, 256))
    cv2.ellipse(specks, middle, axes, turn, 0, 360, opacity, -1)

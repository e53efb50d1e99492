"""Effects on the lens: cracks, dirt, condensation and water drops, and sun flare.

A flare's glare consists of n concentric white discs, the smaller the more opaque. The transmission at distance r is
the product of ``1 - beta_i`` over the discs that reach r, so a table over distances is enough to draw it.
"""

from functools import cache, lru_cache
from typing import TypeAlias, cast

import cv2
import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.catalogue import Frame
from brink.sim.perturbations.layers import (
    REFERENCE_HEIGHT_PX,
    Layer,
    clouds,
    composite,
    composite_white,
    reference_scale,
    to_layer,
    to_pixels,
)

Points: TypeAlias = npt.NDArray[np.float64]

CRACK_POINTS = 10
DIRT_RGB = (58, 47, 33)
DIRT_CELL_PX = 330
SMEAR_FROM, SMEAR_FULL = 0.5, 0.72
"""Noise values at which a smear begins and at which it is thickest."""
SPECKS = (70, 150)


def broken_lens(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Apply cracks around 1 to 3 points of impact.

    Args:
        frame: The frame.
        value: Opacity of the cracks.
        rng: Draws the cracks.
    """
    height, width = frame.shape[:2]
    cracks = np.zeros((height, width), dtype=np.uint8)
    for _ in range(int(rng.integers(1, 4))):
        impact = np.array([rng.uniform(0.1, 0.9) * width, rng.uniform(0.1, 0.9) * height])
        _draw_impact(cracks, impact, reference_scale(frame), rng)
    transmission = cv2.bitwise_not(cv2.convertScaleAbs(cracks, alpha=value))
    return composite_white(frame, cast(Layer, transmission))


def _draw_impact(cracks: Layer, impact: Points, scale: float, rng: np.random.Generator) -> None:
    """Draw radial cracks around a point, rings that connect them, and bright splinters in between."""
    count = int(rng.integers(12, 25))
    spacing = 2 * np.pi / count
    angles = spacing * (np.arange(count) + rng.uniform(-0.35, 0.35, count))
    # Steps grow outwards from the impact, which makes the middle dense and the ends long and straight.
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
        _draw_lines(cracks, ray[None], bright, to_pixels(2, scale))
    _draw_lines(cracks, rays[:, : CRACK_POINTS // 2], 255, to_pixels(3, scale))
    whole = rng.random((rings, count)) >= 0.25
    joints = np.stack([knots, np.roll(knots, -1, axis=1)], axis=2)
    _draw_lines(cracks, joints[whole], 200, to_pixels(1.5, scale))
    _fill(cracks, knots[0], 230)


def _draw_splinters(cracks: Layer, knots: Points, rng: np.random.Generator) -> None:
    """Fill some of the cells between neighbouring cracks and rings with a faint reflection."""
    shining = rng.random((knots.shape[0] - 1, knots.shape[1])) < 0.3
    brightness = rng.integers(20, 80, shining.shape)
    for ring, ray in np.argwhere(shining).tolist():
        following = (ray + 1) % knots.shape[1]
        corners = [knots[ring, ray], knots[ring, following], knots[ring + 1, following], knots[ring + 1, ray]]
        _fill(cracks, np.array(corners), int(brightness[ring, ray]))


def _draw_lines(cracks: Layer, lines: Points, bright: int, thickness: int) -> None:
    """Draw polylines, shape ``(lines, points, 2)``."""
    cv2.polylines(cracks, list(lines.round().astype(np.int32)), False, bright, thickness, cv2.LINE_AA)


def _fill(cracks: Layer, corners: Points, bright: int) -> None:
    cv2.fillPoly(cracks, [corners.round().astype(np.int32)], bright, cv2.LINE_AA)


def dirty(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Apply brown smears and specks of dirt.

    Args:
        frame: The frame.
        value: Opacity where the dirt is thickest.
        rng: Draws smears and specks.
    """
    height, width = frame.shape[:2]
    scale = reference_scale(frame)
    half = (max(2, height // 2), max(2, width // 2))
    noise = to_layer(clouds(half, DIRT_CELL_PX * scale / 2, 5, rng))
    dirt = cv2.LUT(noise, _smear_table())
    specks = np.zeros(half, dtype=np.uint8)
    for _ in range(int(rng.integers(*SPECKS))):
        _draw_speck(specks, scale / 2, rng)
    dirt = cast(Layer, cv2.max(dirt, cv2.blur(specks, (3, 3))))
    opacity = cv2.convertScaleAbs(cast(Layer, cv2.resize(dirt, (width, height))), alpha=value)
    light = cv2.merge([cv2.convertScaleAbs(opacity, alpha=part / 255) for part in DIRT_RGB])
    return composite(frame, cast(Layer, cv2.bitwise_not(opacity)), cast(Frame, light))


@cache
def _smear_table() -> Layer:
    """Return the thickness of the dirt for each grey value of the noise, shape ``(256,)``."""
    rise = np.clip((np.arange(256) / 255 - SMEAR_FROM) / (SMEAR_FULL - SMEAR_FROM), 0, 1)
    return np.rint(255 * rise * rise * (3 - 2 * rise)).astype(np.uint8)


def _draw_speck(specks: Layer, scale: float, rng: np.random.Generator) -> None:
    height, width = specks.shape
    middle = (int(rng.integers(width)), int(rng.integers(height)))
    size = rng.gamma(1.5, 4.0) + 2
    axes = (to_pixels(size, scale), to_pixels(size * rng.uniform(0.4, 1), scale))
    turn, opacity = rng.uniform(0, 180), int(rng.integers(130, 256))
    cv2.ellipse(specks, middle, axes, turn, 0, 360, opacity, -1)


FILM_GREY = 205
FILM_CELL_PX = 220
DROPLETS = 200
STREAKS = (4, 9)
WET_OPACITY = 0.15
WET_DROPS = 45


def condensation(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Apply a mist film with droplets and streaks.

    Args:
        frame: The frame.
        value: Opacity where the mist is thickest.
        rng: Draws film, streaks and droplets.
    """
    opacity, light = _film(frame, 0.55, 1.0, rng)
    scale = reference_scale(frame)
    for _ in range(int(rng.integers(*STREAKS))):
        _draw_streak(opacity, light, scale, rng)
    _draw_drops(opacity, light, rng.gamma(2.0, 1.6, DROPLETS) + 1.5, rng)
    return _composite_film(frame, opacity, light, value)


def wet_lens(frame: Frame, rng: np.random.Generator) -> Frame:
    """Apply a film of water with large drops, both with an opacity of 0.15."""
    opacity, light = _film(frame, 0.3, 0.8, rng)
    _draw_drops(opacity, light, rng.gamma(2.5, 5.0, WET_DROPS) + 3, rng, edge=cv2.LINE_8)
    return _composite_film(frame, opacity, light, WET_OPACITY)


def _film(frame: Frame, least: float, most: float, rng: np.random.Generator) -> tuple[Layer, Layer]:
    """Return the opacity (roughly between `least` and `most`) and the light of an uneven film of mist or water."""
    height, width = frame.shape[:2]
    coarse = clouds(
        (max(2, height // 4), max(2, width // 4)), FILM_CELL_PX * reference_scale(frame) / 4, 2, rng
    )
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
    cv2.polylines(opacity, [track], False, 90, to_pixels(2.2 * radius, scale), cv2.LINE_AA)
    cv2.polylines(opacity, [track], False, 25, to_pixels(1.5 * radius, scale), cv2.LINE_AA)
    _draw_drop(opacity, light, (int(track[-1, 0]), int(track[-1, 1])), to_pixels(radius, scale))


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
        _draw_drop(opacity, light, (x, y), to_pixels(radius, scale), edge)


def _draw_drop(
    opacity: Layer, light: Layer, middle: tuple[int, int], radius: int, edge: int = cv2.LINE_AA
) -> None:
    """Draw a drop: dark at the top and bright at the bottom, as it inverts the scene, with a highlight."""
    x, y = middle
    # Antialiasing costs more than the rest of the drop and is invisible on small drops.
    line = edge if radius > 4 else cv2.LINE_8
    cv2.circle(opacity, middle, radius, 255, -1, line)
    cv2.circle(light, middle, radius, 70, -1, line)
    if radius < 2:
        return
    cv2.circle(light, (x, y + max(1, radius // 4)), max(1, round(0.75 * radius)), 185, -1, line)
    if radius > 4:
        cv2.circle(light, (x - radius // 3, y - radius // 3), max(1, radius // 5), 255, -1, line)


def _composite_film(frame: Frame, opacity: Layer, light: Layer, value: float) -> Frame:
    scaled = cv2.convertScaleAbs(opacity, alpha=value)
    added = cv2.multiply(scaled, light, scale=1 / 255)
    return composite(frame, cast(Layer, cv2.bitwise_not(scaled)), cast(Layer, added))


RING_PX = 10
GHOST_TINTS = ((255, 190, 120), (150, 255, 180), (130, 180, 255), (255, 140, 200), (255, 245, 170))


def sun_flare(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Apply a glare in the upper half and 6 to 10 ghosts.

    Args:
        frame: The frame.
        value: Radius of the glare in reference px.
        rng: Draws the source and the ghosts.
    """
    height, width = frame.shape[:2]
    source = np.array([rng.uniform(0, width), rng.uniform(0, height / 2)])
    glare = _glare(value, height)
    radius = glare.shape[0] // 2
    x, y = (round(c) for c in source.tolist())
    top, left = max(0, y - radius), max(0, x - radius)
    bottom, right = min(height, y + radius + 1), min(width, x + radius + 1)
    reach = glare[top - y + radius : bottom - y + radius, left - x + radius : right - x + radius]
    flared = frame.copy()
    flared[top:bottom, left:right] = composite_white(flared[top:bottom, left:right], reach)
    strength = 0.5 + 0.5 * value / 900
    _draw_ghosts(flared, source, strength, rng)
    return flared


def transmission(
    radius_px: float, distance_px: npt.NDArray[np.float64], rings: int
) -> npt.NDArray[np.float64]:
    """Return the transmission of the glare at given distances from its centre.

    ``T(r)`` is the product of ``1 - (1 - i / (n - 1))^3`` over the rings with ``r_i >= r``. The n rings are evenly
    spaced from 1 px (at the scale of 1280x720) to the radius.

    Args:
        radius_px: Radius of the largest ring.
        distance_px: Distances, any shape.
        rings: Number of rings n, >= 2.

    Returns:
        Shares in [0, 1], in the shape of `distance_px`.
    """
    ring_px = np.linspace(radius_px / (RING_PX * rings), radius_px, rings)
    left = 1 - (1 - np.arange(rings) / (rings - 1)) ** 3
    outwards = np.append(
        np.cumprod(left[::-1])[::-1], 1.0
    )  # products over the rings from i on; 1 beyond the last
    return cast(npt.NDArray[np.float64], outwards[np.searchsorted(ring_px, distance_px, side="left")])


@lru_cache(maxsize=2)
def _glare(value: float, height: int) -> Layer:
    """Return 255 times the transmission around the source, in a square with sides of ``2 radius + 1`` px."""
    scale = height / 720
    radius = to_pixels(value, scale)
    offset = np.arange(-radius, radius + 1, dtype=np.float64)
    distance = np.hypot(offset[:, None], offset[None, :])
    left = transmission(value * scale, distance, max(2, int(value / RING_PX)))
    return np.rint(255 * left).astype(np.uint8)


def _draw_ghosts(
    frame: Frame, source: npt.NDArray[np.float64], strength: float, rng: np.random.Generator
) -> None:
    """Draw tinted discs and rings on the line from the source through the centre of the frame and beyond."""
    height, width = frame.shape[:2]
    scale = reference_scale(frame)
    to_centre = np.array([width / 2, height / 2]) - source
    for _ in range(int(rng.integers(6, 11))):
        x, y = (source + rng.uniform(0.3, 2.1) * to_centre).tolist()
        radius = to_pixels(rng.uniform(8, 60), scale, at_least=2)
        tint = np.array(GHOST_TINTS[int(rng.integers(len(GHOST_TINTS)))]) / 255
        opacity = strength * rng.uniform(0.25, 0.6)
        top, left = max(0, int(y) - radius - 1), max(0, int(x) - radius - 1)
        bottom, right = min(height, int(y) + radius + 2), min(width, int(x) + radius + 2)
        if top >= bottom or left >= right:
            continue
        shape = np.zeros((bottom - top, right - left), dtype=np.uint8)
        middle = (int(x) - left, int(y) - top)
        cv2.circle(shape, middle, radius, 170, -1, cv2.LINE_AA)
        cv2.circle(shape, middle, radius, 255, to_pixels(2, scale), cv2.LINE_AA)
        part = frame[top:bottom, left:right]
        screen = np.rint(255 - shape[..., None] * (opacity * tint)).astype(np.uint8)
        frame[top:bottom, left:right] = composite_white(part, screen)

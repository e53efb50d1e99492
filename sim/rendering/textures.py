"""Seeded textures that are drawn once: noise, ground tiles and leaves.

Ground tiles repeat without a seam and hold brightness, where 128 is the plain colour of the surface.
"""

from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.scene import Coverage, Picture

TILE_PX: Final = 512
TILE_PX_PER_M: Final = 32.0
TILE_M: Final = TILE_PX / TILE_PX_PER_M
_SLAB_PX: Final = 16
_LEAVES_PX: Final = 256
_GROUND_STREAM: Final = 72
_LEAVES_STREAM: Final = 73

Noise = NDArray[np.float32]


def smooth_noise(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[int, int], octaves: int
) -> Noise:
    """Return noise with zero mean and unit variance that repeats along both axes.

    Args:
        rng: Draws the noise.
        shape: Shape of the result.
        cells: Number of cells of the coarsest octave along each axis.
        octaves: Number of octaves, each twice as fine as the previous one.
    """
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        rows, columns = (min(side << octave, full) for side, full in zip(cells, shape, strict=True))
        grid = rng.standard_normal((rows, columns)).astype(np.float32)
        wrapped = np.pad(grid, 2, mode="wrap")
        scale_y, scale_x = shape[0] / rows, shape[1] / columns
        size = (round((columns + 4) * scale_x), round((rows + 4) * scale_y))
        large = cv2.resize(wrapped, size, interpolation=cv2.INTER_CUBIC)
        top, left = round(2 * scale_y), round(2 * scale_x)
        total += large[top : top + shape[0], left : left + shape[1]] * 0.55**octave
    spread: Noise = ((total - total.mean()) / max(float(total.std()), 1e-6)).astype(np.float32)
    return spread


@lru_cache(maxsize=16)
def ground_tiles(seed: int, *, wet: bool) -> tuple[Picture, ...]:
    """Return the mipmap levels of the ground tile, largest first, each of shape ``(side, side, 4)``.

    The channels are asphalt, pavement, grass, and reflectivity (255 is a puddle).
    """
    rng = np.random.default_rng((seed, _GROUND_STREAM))
    shape = (TILE_PX, TILE_PX)
    grain = rng.standard_normal(shape).astype(np.float32)
    mottle = smooth_noise(rng, shape, (6, 6), 4)
    asphalt = 128 + 10.0 * grain + 7.0 * mottle + 9.0 * _mended(rng) - _cracks(rng)
    asphalt += 26.0 * (rng.random(shape) > 0.985) - _spots(rng, 26, (4, 16), 26.0)
    pavement = 128 + 6.0 * grain + 6.0 * smooth_noise(rng, shape, (5, 5), 4) + _slabs(rng)
    pavement -= _spots(rng, 60, (1, 2), 30.0) + _spots(rng, 10, (8, 24), 22.0)
    grass = 128 + 17.0 * grain + 13.0 * smooth_noise(rng, shape, (9, 9), 5)
    puddles = 90 + 62.0 * smooth_noise(rng, shape, (3, 3), 3)
    if wet:
        asphalt = 128 + 0.6 * (asphalt - 128) - 0.10 * np.clip(puddles, 0, 255)
    tile = np.clip(np.stack((asphalt, pavement, grass, puddles), axis=-1), 0, 255).astype(np.uint8)
    tiles: list[Picture] = [tile]
    while tiles[-1].shape[0] > 4:
        side = tiles[-1].shape[0] // 2
        tiles.append(cv2.resize(tiles[-1], (side, side), interpolation=cv2.INTER_AREA).astype(np.uint8))
    return tuple(tiles)


def _mended(rng: np.random.Generator) -> Noise:
    """Return the patches of newer asphalt where the road was repaired."""
    field = np.zeros((TILE_PX, TILE_PX), np.float32)
    for _ in range(5):
        x, y = rng.integers(20, TILE_PX - 160, 2).tolist()
        wide, high = rng.integers(40, 140, 2).tolist()
        shade = float(rng.choice((-1.6, -1.0, 0.8)))
        cv2.rectangle(field, (x, y), (x + wide, y + high), shade, -1)
        cv2.rectangle(field, (x, y), (x + wide, y + high), -3.0, 1)  # the seam is sealed with tar
    return field


def _spots(rng: np.random.Generator, count: int, radii_px: tuple[int, int], depth: float) -> Noise:
    """Return soft dark spots, such as oil on a road or trodden gum on a pavement."""
    field = np.zeros((TILE_PX, TILE_PX), np.float32)
    for _ in range(count):
        x, y = rng.integers(30, TILE_PX - 30, 2).tolist()
        radius = int(rng.integers(*radii_px, endpoint=True))
        axes = (radius, max(round(radius * float(rng.uniform(0.5, 1.0))), 1))
        cv2.ellipse(
            field, (x, y), axes, float(rng.uniform(0, 180)), 0, 360, depth * float(rng.uniform(0.3, 1)), -1
        )
    return np.asarray(cv2.GaussianBlur(field, (5, 5), 0), np.float32)


def _cracks(rng: np.random.Generator) -> Noise:
    field = np.zeros((TILE_PX, TILE_PX), np.float32)
    for _ in range(11):
        start = rng.integers(60, TILE_PX - 60, 2)
        steps = rng.normal(0.0, 7.0, (14, 2)) + rng.normal(0.0, 5.0, 2)
        path = np.clip(start + np.cumsum(steps, axis=0), 1, TILE_PX - 2).astype(np.int32)
        cv2.polylines(field, [path], False, 44.0, 1, cv2.LINE_AA)
    return field


def _slabs(rng: np.random.Generator) -> Noise:
    count = TILE_PX // _SLAB_PX
    shades = rng.normal(0.0, 8.0, (count, count)).astype(np.float32)
    field = np.kron(shades, np.ones((_SLAB_PX, _SLAB_PX), np.float32)).astype(np.float32)
    field[::_SLAB_PX] -= 26.0
    field[:, ::_SLAB_PX] -= 26.0
    return field


@lru_cache(maxsize=24)
def draw_leaves(look: int, *, fallen: bool) -> list[tuple[Picture, Coverage]]:
    """Draw a crown of leaves and return its mipmap levels, largest first.

    Args:
        look: Selects the colour.
        fallen: Whether the crown is browner and ragged.

    Returns:
        Colours, shape ``(side, side, 3)``, and coverage, shape ``(side, side)``, 0 or 255, for each size.
    """
    rng = np.random.default_rng((look & 0xFFFFFFFF, _LEAVES_STREAM, int(fallen)))
    side = _LEAVES_PX
    colour = np.zeros((side, side, 3), np.float32)
    cover = np.zeros((side, side), np.uint8)
    hue = np.array([(68, 88, 42), (82, 98, 46), (60, 82, 50), (94, 98, 54)][look % 4], np.float32)
    if fallen:
        hue = np.array([(96, 104, 44), (112, 100, 48)][look % 2], np.float32)
    clumps = 90 if fallen else 150
    radius = 0.44 if fallen else 0.40
    flat = 0.85 if fallen else 0.92
    angle, reach = rng.uniform(0, 2 * np.pi, clumps), radius * np.sqrt(rng.random(clumps))
    x, y = 0.5 + reach * np.cos(angle), 0.5 + reach * np.sin(angle) * flat
    size, shade = rng.uniform(0.035, 0.085, clumps), rng.normal(0.0, 0.09, clumps)
    for clump in np.argsort(0.25 * x - y).tolist():
        centre = (round(float(x[clump]) * side), round(float(y[clump]) * side))
        light = 0.46 + 0.80 * (1.0 - float(y[clump])) - 0.22 * float(x[clump]) + float(shade[clump])
        wide = round(float(size[clump]) * side)
        cv2.circle(cover, centre, wide, 255, -1)
        cv2.circle(colour, centre, wide, (0.80 * light * hue).tolist(), -1)
        lit = (centre[0] - wide // 4, centre[1] - wide // 3)
        cv2.circle(colour, lit, max(wide * 2 // 3, 1), (1.06 * light * hue).tolist(), -1)
    return _leafy(rng, colour, cover, hue)


def _leafy(
    rng: np.random.Generator, colour: Noise, cover: Coverage, hue: Noise
) -> list[tuple[Picture, Coverage]]:
    """Break clumps up into leaves with ragged edges and gaps, and return the mipmap levels."""
    side = cover.shape[0]
    leaves = smooth_noise(rng, (side, side), (52, 52), 2)
    soft = cv2.GaussianBlur(cover, (15, 15), 0).astype(np.float32)
    gaps = smooth_noise(rng, (side, side), (24, 24), 2)
    ragged = np.where((soft + 62.0 * leaves > 118) & (gaps > -2.1) & (soft > 30), 255, 0).astype(np.uint8)
    spread = cv2.GaussianBlur(colour, (9, 9), 0)
    weight = cv2.GaussianBlur((cover > 0).astype(np.float32), (9, 9), 0)
    outside = np.where((weight > 0.02)[..., None], spread / np.maximum(weight, 0.02)[..., None], 0.7 * hue)
    colour = np.where((cover > 0)[..., None], colour, outside)
    tips = smooth_noise(rng, (side, side), (64, 64), 1)
    colour *= (1.0 + 0.17 * leaves + 0.10 * tips)[..., None]
    image = np.clip(colour, 0, 255).astype(np.uint8)
    levels: list[tuple[Picture, Coverage]] = [(image, ragged)]
    while levels[-1][1].shape[0] > 16:
        levels.append(_halved(*levels[-1]))
    return levels


def _halved(image: Picture, cover: Coverage) -> tuple[Picture, Coverage]:
    side = cover.shape[0] // 2
    weight = (cover > 0).astype(np.float32)
    summed = cv2.resize(
        image.astype(np.float32) * weight[..., None], (side, side), interpolation=cv2.INTER_AREA
    )
    share = cv2.resize(weight, (side, side), interpolation=cv2.INTER_AREA)
    colour = np.clip(summed / np.maximum(share, 1e-3)[..., None], 0, 255).astype(np.uint8)
    return colour, np.where(share >= 0.5, 255, 0).astype(np.uint8)

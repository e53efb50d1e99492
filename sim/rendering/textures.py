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
    asphalt = 128 + 8.0 * grain + 5.0 * mottle + 7.0 * _mended(rng) - _cracks(rng)
    asphalt += 22.0 * (rng.random(shape) > 0.985)
    pavement = 128 + 5.0 * grain + 5.0 * smooth_noise(rng, shape, (5, 5), 4) + _slabs(rng)
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
    for _ in range(4):
        x, y = rng.integers(20, TILE_PX - 160, 2).tolist()
        wide, high = rng.integers(40, 140, 2).tolist()
        shade = float(rng.choice((-1.6, -1.0, 0.8)))
        cv2.rectangle(field, (x, y), (x + wide, y + high), shade, -1)
    return field


def _cracks(rng: np.random.Generator) -> Noise:
    field = np.zeros((TILE_PX, TILE_PX), np.float32)
    for _ in range(7):
        start = rng.integers(60, TILE_PX - 60, 2)
        steps = rng.normal(0.0, 7.0, (14, 2)) + rng.normal(0.0, 5.0, 2)
        path = np.clip(start + np.cumsum(steps, axis=0), 1, TILE_PX - 2).astype(np.int32)
        cv2.polylines(field, [path], False, 30.0, 1, cv2.LINE_AA)
    return field


def _slabs(rng: np.random.Generator) -> Noise:
    count = TILE_PX // _SLAB_PX
    shades = rng.normal(0.0, 5.0, (count, count)).astype(np.float32)
    field = np.kron(shades, np.ones((_SLAB_PX, _SLAB_PX), np.float32)).astype(np.float32)
    field[::_SLAB_PX] -= 26.0
    field[:, ::_SLAB_PX] -= 26.0
    return field


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
    hue = np.array([(66, 92, 40), (84, 104, 44), (58, 84, 48), (96, 104, 50)][look % 4], np.float32)
    if fallen:
        hue = np.array([(96, 104, 44), (112, 100, 48)][look % 2], np.float32)
    clumps = 90 if fallen else 130
    radius = 0.44 if fallen else 0.40
    places = []
    for _ in range(clumps):
        angle, reach = rng.uniform(0, 2 * np.pi), radius * np.sqrt(rng.random())
        x, y = 0.5 + reach * np.cos(angle), 0.5 + reach * np.sin(angle) * (0.92 if not fallen else 0.85)
        places.append((x, y, float(rng.uniform(0.035, 0.085))))
    places.sort(key=lambda place: -place[1] + 0.25 * place[0])
    for x, y, size in places:
        light = 0.58 + 0.75 * (1.0 - y) + float(rng.normal(0.0, 0.07))
        rgb = hue * light
        centre = (round(x * side), round(y * side))
        cv2.circle(cover, centre, round(size * side), 255, -1)
        cv2.circle(colour, centre, round(size * side), rgb.tolist(), -1)
    _speckle(rng, colour, cover, hue)
    image = np.clip(colour, 0, 255).astype(np.uint8)
    levels: list[tuple[Picture, Coverage]] = [(image, cover)]
    while levels[-1][1].shape[0] > 16:
        levels.append(_halved(*levels[-1]))
    return levels


def _speckle(rng: np.random.Generator, colour: Noise, cover: Coverage, hue: Noise) -> None:
    """Roughen a crown with light and dark leaves, and with holes through which the background shows."""
    side = cover.shape[0]
    for _ in range(2600):
        x, y = rng.integers(3, side - 3, 2).tolist()
        if not cover[y, x]:
            rng.random()  # unused, but the textures depend on how many numbers are drawn
            continue
        base = colour[y, x]
        if not base.any():
            continue
        turn = float(rng.uniform(0, 180))
        shade = (base * float(rng.uniform(0.62, 1.42))).tolist()
        cv2.ellipse(colour, (x, y), (4, 2), turn, 0, 360, shade, -1)
        cv2.ellipse(cover, (x, y), (4, 2), turn, 0, 360, 255, -1)
    holes = rng.integers(3, side - 3, (110, 2))
    for x, y in holes.tolist():
        cv2.ellipse(cover, (x, y), (4, 3), float(rng.uniform(0, 180)), 0, 360, 0, -1)
    missing = (cover > 0) & ~colour.any(axis=2)
    colour[missing] = hue


def _halved(image: Picture, cover: Coverage) -> tuple[Picture, Coverage]:
    side = cover.shape[0] // 2
    weight = (cover > 0).astype(np.float32)
    summed = cv2.resize(
        image.astype(np.float32) * weight[..., None], (side, side), interpolation=cv2.INTER_AREA
    )
    share = cv2.resize(weight, (side, side), interpolation=cv2.INTER_AREA)
    colour = np.clip(summed / np.maximum(share, 1e-3)[..., None], 0, 255).astype(np.uint8)
    return colour, np.where(share >= 0.5, 255, 0).astype(np.uint8)

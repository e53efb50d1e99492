"""Owns the faces of houses: a texture for each look and size, by day or by night, and its halvings.

A texture is drawn once at `PX_PER_M` and halved separately along and up as the picture needs it: a wall that runs
away from the camera shrinks sideways only.
"""

from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from brink.sim.rendering.looks import choice
from brink.sim.rendering.scene import Picture
from brink.sim.rendering.textures import Noise, smooth_noise

PX_PER_M: Final = 22.0
_MAX_SIDE_PX: Final = 1400
_FACADE_STREAM: Final = 76
_WALLS: Final = (
    (176, 104, 82),
    (206, 190, 160),
    (188, 184, 178),
    (214, 204, 188),
    (150, 92, 74),
    (196, 168, 128),
    (164, 168, 172),
    (222, 214, 196),
    (178, 152, 132),
)
_BRICK: Final = (0, 4)
_FRAMES: Final = ((236, 234, 228), (70, 66, 62), (226, 220, 206), (52, 72, 66))
_DOORS: Final = ((84, 52, 36), (40, 62, 84), (44, 72, 52), (120, 34, 32))
_SHOPS: Final = ((40, 84, 64), (148, 40, 38), (44, 54, 92), (196, 152, 60))
_LIT: Final = ((255, 214, 140), (250, 226, 176), (232, 190, 118))


@lru_cache(maxsize=96)
def facade(look: int, length_m: float, height_m: float, night: bool, front: bool) -> Picture:
    """Return the face of a house, shape ``(up, along, 3)``, row 0 at the eaves.

    Args:
        look: Of the house.
        length_m: Of the wall.
        height_m: Of the wall.
        night: Whether windows are lit and walls dark.
        front: Whether it has doors and shops; else few windows.
    """
    scale = min(PX_PER_M, _MAX_SIDE_PX / length_m, _MAX_SIDE_PX / height_m)
    wide, high = max(round(length_m * scale), 8), max(round(height_m * scale), 8)
    rng = np.random.default_rng((look & 0xFFFFFFFF, _FACADE_STREAM, round(length_m * 100), int(front)))
    style = choice(look, 41, len(_WALLS))
    wall = np.empty((high, wide, 3), np.float32)
    wall[:] = _WALLS[style]
    grain: Noise = rng.standard_normal((high, wide)).astype(np.float32)
    wall *= (1 + 0.025 * grain + 0.045 * smooth_noise(rng, (high, wide), (5, 5), 4))[..., None]
    if style in _BRICK:
        _bricks(wall, scale, rng)
    weather = np.linspace(0.04, -0.06, high, dtype=np.float32)
    wall *= (1 + weather)[:, None, None]
    glow = np.zeros((high, wide, 3), np.float32)
    _trim(wall, scale)
    _windows(wall, glow, rng, look, scale, front=front)
    if night:
        foot = np.exp(-np.arange(high)[::-1] / (4.0 * scale)).astype(np.float32)[:, None, None]
        wall = wall * (0.085 + 0.16 * foot) * np.array((1.0, 0.93, 0.88), np.float32) + glow
    return np.clip(wall, 0, 255).astype(np.uint8)


@lru_cache(maxsize=384)
def shrunk(
    look: int, length_m: float, height_m: float, night: bool, front: bool, along: int, up: int
) -> Picture:
    """Return a face of a house, halved `along` times sideways and `up` times upwards."""
    if along == 0 and up == 0:
        return facade(look, length_m, height_m, night, front)
    full = facade(look, length_m, height_m, night, front)
    size = (max(full.shape[1] >> along, 2), max(full.shape[0] >> up, 2))
    return cv2.resize(full, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


@lru_cache(maxsize=192)
def mean_colour(
    look: int, length_m: float, height_m: float, night: bool, front: bool
) -> tuple[float, float, float]:
    """Return the colour of a face of a house from afar."""
    full = facade(look, length_m, height_m, night, front)
    red, green, blue = full.reshape(-1, 3).mean(axis=0).tolist()
    return red, green, blue


def _bricks(wall: Noise, scale: float, rng: np.random.Generator) -> None:
    high, wide = wall.shape[:2]
    course, brick = max(round(0.16 * scale), 2), max(round(0.42 * scale), 4)
    rows, columns = high // course + 1, wide // brick + 2
    shades = (1 + 0.07 * rng.standard_normal((rows, columns))).astype(np.float32)
    field = np.kron(shades, np.ones((course, brick), np.float32)).astype(np.float32)[:high, :wide]
    wall *= field[..., None]
    wall[::course] *= 1.10
    for row in range(rows):
        start = (row % 2) * (brick // 2)
        wall[row * course : (row + 1) * course, start::brick] *= 1.08


def _trim(wall: Noise, scale: float) -> None:
    """Draw the eaves and the plinth."""
    high = wall.shape[0]
    eaves = max(round(0.35 * scale), 2)
    wall[:eaves] = wall[:eaves] * 0.35 + 0.65 * 208
    wall[eaves : eaves + max(round(0.10 * scale), 1)] *= 0.55
    plinth = high - round(0.55 * scale)
    wall[plinth:] *= 0.68


def _windows(
    wall: Noise, glow: Noise, rng: np.random.Generator, look: int, scale: float, *, front: bool
) -> None:
    high, wide = wall.shape[:2]
    length_m, height_m = wide / scale, high / scale
    floors = max(round((height_m - 0.8) / 3.0), 1)
    bays = max(round((length_m - 0.8) / (2.3 + 0.3 * choice(look, 42, 4))), 1)
    if not front:
        bays = max(bays // 2, 1)
    storey, bay = (height_m - 0.9) / floors, (length_m - 0.6) / bays
    window_w = min(1.15 + 0.2 * choice(look, 43, 3), 0.66 * bay)
    window_h = min(1.45 + 0.15 * choice(look, 44, 3), 0.62 * storey)
    shop = front and choice(look, 45, 3) == 0
    door_bay = choice(look, 46, bays)
    for floor in range(floors):
        for number in range(bays):
            x = 0.3 + (number + 0.5) * bay
            foot = height_m - 0.25 - floor * storey
            if floor == 0 and front and number == door_bay:
                _door(wall, look, scale, x, foot, height_m)
            elif floor == 0 and shop:
                pane_w, pane_h = 0.86 * bay, min(2.3, 0.8 * storey)
                _pane(wall, glow, rng, look, scale, (x, foot - 0.35, pane_w, pane_h), chance=0.75)
                _box(
                    wall,
                    scale,
                    (x, foot - 0.4 - pane_h, 0.92 * bay, 0.5),
                    _SHOPS[choice(look, 47, len(_SHOPS))],
                )
            else:
                sill = foot - 0.95 if floor == 0 else foot - 0.8
                _pane(wall, glow, rng, look, scale, (x, sill, window_w, window_h), chance=0.36)


_Rect = tuple[float, float, float, float]
"""Middle along the wall, bottom edge measured from the top, width, height; m."""


def _box(wall: Noise, scale: float, rect: _Rect, rgb: tuple[float, float, float]) -> None:
    x, bottom, wide, high = rect
    corner = (round((x - wide / 2) * scale), round((bottom - high) * scale))
    cv2.rectangle(wall, corner, (round((x + wide / 2) * scale) - 1, round(bottom * scale) - 1), rgb, -1)


def _pane(
    wall: Noise, glow: Noise, rng: np.random.Generator, look: int, scale: float, rect: _Rect, *, chance: float
) -> None:
    x, bottom, wide, high = rect
    frame = _FRAMES[choice(look, 48, len(_FRAMES))]
    _box(wall, scale, (x, bottom + 0.12, wide + 0.24, 0.12), (200, 196, 188))
    _box(wall, scale, (x, bottom + 0.02, wide + 0.06, high + 0.06), (60, 56, 52))
    _box(wall, scale, (x, bottom, wide, high), frame)
    sky = 0.7 + 0.6 * float(rng.random())
    upper, lower = (92 * sky, 112 * sky, 130 * sky), (46 * sky, 54 * sky, 62 * sky)
    leaf_w, leaf_h = (wide - 0.18) / 2, high - 0.12
    lit = float(rng.random()) < chance
    drawn = float(rng.random())
    colour = _LIT[int(rng.integers(0, len(_LIT)))]
    strength = float(rng.uniform(0.55, 0.95))
    for side in (-0.5, 0.5):
        centre = x + side * (leaf_w + 0.06)
        _box(wall, scale, (centre, bottom - 0.06, leaf_w, leaf_h), lower)
        _box(wall, scale, (centre, bottom - 0.06 - 0.45 * leaf_h, leaf_w, 0.55 * leaf_h), upper)
        if drawn < 0.4:
            _box(
                wall,
                scale,
                (centre + side * 0.22 * wide, bottom - 0.06, 0.34 * leaf_w, leaf_h),
                (206, 200, 190),
            )
        if lit:
            shine = (colour[0] * strength, colour[1] * strength, colour[2] * strength)
            _box(glow, scale, (centre, bottom - 0.06, leaf_w, leaf_h), shine)
            if drawn < 0.4:
                dim = (shine[0] * 0.7, shine[1] * 0.66, shine[2] * 0.6)
                _box(glow, scale, (centre + side * 0.22 * wide, bottom - 0.06, 0.34 * leaf_w, leaf_h), dim)


def _door(wall: Noise, look: int, scale: float, x: float, foot: float, height_m: float) -> None:
    rgb = _DOORS[choice(look, 49, len(_DOORS))]
    _box(wall, scale, (x, height_m, 1.36, height_m - foot + 2.42), (196, 190, 180))
    _box(wall, scale, (x, height_m, 1.08, height_m - foot + 2.22), rgb)
    _box(wall, scale, (x, foot - 1.65, 0.9, 0.45), (70, 82, 92))
    for side in (-0.25, 0.25):
        dark = (rgb[0] * 0.75, rgb[1] * 0.75, rgb[2] * 0.75)
        _box(wall, scale, (x + side, foot - 0.3, 0.36, 1.0), dark)

"""Facade textures: walls of brick, plaster or stone with windows, doors, shops, balconies, signs and posters.

A facade is assembled from tiles: a wall that repeats, and a few variants of each window, so that drawing one takes
about a millisecond. At night, lit windows and shops shine and the wall is dark.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, TypeAlias

import cv2
import numpy as np

from brink.sim.rendering.scene import Picture, Rgb, choose, scaled
from brink.sim.rendering.textures import Noise, smooth_noise

PX_PER_M: Final = 22.0
_MAX_SIDE_PX: Final = 1400
_FACADE_STREAM: Final = 76
_WALL_TILE_PX: Final = 288
_PLAIN: Final = 200
_WALLS: Final = (
    (158, 92, 72), (206, 190, 160), (188, 184, 178), (214, 204, 188), (138, 84, 66), (196, 168, 128),
    (164, 168, 172), (222, 214, 196), (178, 152, 132), (196, 178, 168), (172, 176, 160), (186, 150, 112),
)  # fmt: skip
_SHADES: Final = (1.0, 0.9, 1.08)
_BRICK: Final = (0, 4, 11)
_STONE: Final = (2, 6)
_FRAMES: Final = ((236, 234, 228), (70, 66, 62), (226, 220, 206), (52, 72, 66), (104, 74, 52))
_DOORS: Final = ((84, 52, 36), (40, 62, 84), (44, 72, 52), (120, 34, 32), (58, 56, 58))
_SHOPS: Final = ((40, 84, 64), (128, 40, 38), (44, 54, 92), (176, 136, 60), (58, 56, 54), (206, 202, 190))
_GOODS: Final = (
    (168, 92, 70),
    (190, 170, 120),
    (92, 120, 110),
    (150, 140, 130),
    (200, 190, 180),
    (70, 80, 110),
)
_POSTERS: Final = ((198, 60, 52), (58, 96, 150), (222, 186, 70), (232, 228, 218), (66, 120, 84))
_WORDS: Final = (
    "CAFE",
    "BAKERY",
    "BOOKS",
    "FLOWERS",
    "PHARMACY",
    "HOTEL",
    "BANK",
    "OPTICS",
    "BAR",
    "SHOES",
    "DELI",
    "RADIO",
)
_LIT: Final = ((255, 214, 140), (250, 226, 176), (232, 190, 118), (216, 226, 236))
_STONE_RGB: Final = (200, 196, 188)
_VARIANTS: Final = 6
_FINE: Final = 3
"""Windows are drawn this many times larger and then reduced, so that their thin frames are smooth."""

_Rect: TypeAlias = tuple[float, float, float, float]
"""A rectangle on a wall: left and top edge, width and height, in m from the upper left corner."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Wall:
    """A facade while it is being drawn.

    Attributes:
        day: The facade by day, shape ``(up, along, 3)``.
        glow: Light of windows and shops at night, same shape.
        scale: Pixels per metre.
        rng: Draws what differs from window to window.
        look: Selects style and colours.
    """

    day: Picture
    glow: Picture
    scale: float
    rng: np.random.Generator
    look: int

    def pick(self, question: int, options: tuple[Rgb, ...]) -> Rgb:
        """Return one of several colours, always the same for a look and a question."""
        return options[choose(self.look, question, len(options))]

    def box(self, rect: _Rect, rgb: Rgb) -> None:
        """Fill a rectangle."""
        _fill(self.day, rect, self.scale, rgb)

    def shade(self, rect: _Rect, share: float) -> None:
        """Darken or brighten a rectangle."""
        region = self.day[self._rows(rect), self._columns(rect)]
        if region.size:
            cv2.convertScaleAbs(region, dst=region, alpha=share)

    def paste(self, left_m: float, top_m: float, tile: Picture, light: Picture | None = None) -> None:
        """Paste a tile, and the light that it emits at night."""
        row, column = max(round(top_m * self.scale), 0), max(round(left_m * self.scale), 0)
        region = self.day[row : row + tile.shape[0], column : column + tile.shape[1]]
        rows, columns = region.shape[:2]
        region[:] = tile[:rows, :columns]
        if light is not None:
            self.glow[row : row + rows, column : column + columns] = light[:rows, :columns]

    def _rows(self, rect: _Rect) -> slice:
        return slice(max(round(rect[1] * self.scale), 0), max(round((rect[1] + rect[3]) * self.scale), 0))

    def _columns(self, rect: _Rect) -> slice:
        return slice(max(round(rect[0] * self.scale), 0), max(round((rect[0] + rect[2]) * self.scale), 0))


def _fill(image: Picture, rect: _Rect, scale: float, rgb: Rgb) -> None:
    left, top, wide, high = rect
    corner = (round(left * scale), round(top * scale))
    opposite = (round((left + wide) * scale) - 1, round((top + high) * scale) - 1)
    if opposite[0] >= corner[0] and opposite[1] >= corner[1]:
        cv2.rectangle(image, corner, opposite, rgb, -1)


@lru_cache(maxsize=160)
def draw_facade(look: int, length_m: float, height_m: float, night: bool, front: bool) -> Picture:
    """Draw one side of a building as an image of shape ``(up, along, 3)``, with row 0 at the eaves.

    Args:
        look: Selects style and colours.
        length_m: Length of the wall.
        height_m: Height of the wall.
        night: Whether windows are lit and walls are dark.
        front: Whether the side has doors and shops; other sides have fewer windows.
    """
    scale = min(PX_PER_M, _MAX_SIDE_PX / length_m, _MAX_SIDE_PX / height_m)
    wide, high = max(round(length_m * scale), 8), max(round(height_m * scale), 8)
    rng = np.random.default_rng((look & 0xFFFFFFFF, _FACADE_STREAM, round(length_m * 100), int(front)))
    style = choose(look, 41, len(_WALLS))
    day = _cropped(_wall_tile(style, choose(look, 50, 3)), rng, high, wide)
    wall = _Wall(day=day, glow=np.zeros_like(day), scale=scale, rng=rng, look=look)
    _storeys(wall, front=front)
    rise = np.linspace(1.05, 0.90, high)
    rise[: max(round(0.9 * scale), 1)] *= 0.93  # the eaves shade the wall below them
    share = np.repeat(rise[:, None], 3, axis=1)
    if night:
        foot = np.exp(-np.arange(high)[::-1] / (4.0 * scale))[:, None]
        share = share * (0.095 + 0.22 * foot) * (1.0, 0.92, 0.84)
    most = 220 / float(share.max())
    rows = cv2.repeat((share * most).astype(np.uint8)[:, None], 1, wide)
    stains = cv2.cvtColor(_cropped(_stains(), rng, high, wide), cv2.COLOR_GRAY2RGB)
    factor = cv2.multiply(rows, stains, scale=1 / _PLAIN)
    painted = cv2.multiply(day, factor, scale=1 / most)
    return (
        cv2.add(painted, wall.glow).astype(np.uint8, copy=False)
        if night
        else painted.astype(np.uint8, copy=False)
    )


@lru_cache(maxsize=512)
def shrink_facade(
    look: int, length_m: float, height_m: float, night: bool, front: bool, along: int, up: int
) -> Picture:
    """Return a facade halved `along` times horizontally and `up` times vertically."""
    full = draw_facade(look, length_m, height_m, night, front)
    if along == 0 and up == 0:
        return full
    size = (max(full.shape[1] >> along, 2), max(full.shape[0] >> up, 2))
    return cv2.resize(full, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


def plain_colour(look: int, night: bool) -> Rgb:
    """Return the approximate mean colour of a facade, for walls too small to show more, without drawing it."""
    shade = _SHADES[choose(look, 50, 3)]
    red, green, blue = _WALLS[choose(look, 41, len(_WALLS))]
    if night:
        return 0.12 * red * shade + 17, 0.11 * green * shade + 16, 0.10 * blue * shade + 14
    return 0.60 * red * shade + 22, 0.60 * green * shade + 25, 0.60 * blue * shade + 29


def _cropped(tile: Picture, rng: np.random.Generator, high: int, wide: int) -> Picture:
    """Return a crop of a repeating tile at a random position."""
    side = tile.shape[0]
    out = np.empty((high, wide, *tile.shape[2:]), np.uint8)
    first_row, first_column = rng.integers(0, side, 2).tolist()
    for top in range(-first_row, high, side):
        for left in range(-first_column, wide, side):
            rows, columns = slice(max(top, 0), top + side), slice(max(left, 0), left + side)
            region = out[rows, columns]
            below, beside = max(-top, 0), max(-left, 0)
            region[:] = tile[below : below + region.shape[0], beside : beside + region.shape[1]]
    return out


@lru_cache(maxsize=1)
def _stains() -> Picture:
    """Return the brightness of dirt on walls, where `_PLAIN` is clean: blotches, and streaks of rain."""
    rng = np.random.default_rng((_FACADE_STREAM, 1))
    shape = (512, 512)
    streaks = cv2.blur(smooth_noise(rng, shape, (4, 90), 2), (1, 61), borderType=cv2.BORDER_REFLECT)
    field = 1.0 + 0.035 * smooth_noise(rng, shape, (5, 5), 4) + 0.05 * np.minimum(streaks, 0.2)
    return np.clip(_PLAIN * field, 0, 255).astype(np.uint8)


@lru_cache(maxsize=48)
def _wall_tile(style: int, shade: int) -> Picture:
    """Return a repeating tile of bare wall, shape ``(side, side, 3)``."""
    rng = np.random.default_rng((_FACADE_STREAM, 2, style, shade))
    side = _WALL_TILE_PX
    colour = np.empty((side, side, 3), np.float32)
    colour[:] = np.array(_WALLS[style]) * _SHADES[shade]
    if style in _BRICK:
        _bricks(colour, rng, course=3, brick=8, mortar=(182, 172, 160))
    elif style in _STONE:
        _bricks(colour, rng, course=12, brick=24, mortar=scaled(_WALLS[style], 0.78))
    colour *= _plaster()
    return np.clip(colour, 0, 255).astype(np.uint8)


@lru_cache(maxsize=1)
def _plaster() -> Noise:
    """Return the brightness of a repeating tile of rough plaster, shape ``(side, side, 1)``."""
    rng = np.random.default_rng((_FACADE_STREAM, 4))
    shape = (_WALL_TILE_PX, _WALL_TILE_PX)
    light = 1.0 + 0.022 * rng.standard_normal(shape, dtype=np.float32)
    light += 0.03 * smooth_noise(rng, shape, (6, 6), 4)
    return light[..., None].astype(np.float32)


def _bricks(colour: Noise, rng: np.random.Generator, *, course: int, brick: int, mortar: Rgb) -> None:
    """Lay a running bond; sizes are in pixels and divide the side of the tile, so that it repeats."""
    side = colour.shape[0]
    spread = 0.11 if course < 6 else 0.05
    for row in range(side // course):
        shades = (
            1
            + spread * rng.standard_normal((side // brick, 1))
            + 0.012 * rng.standard_normal((side // brick, 3))
        )
        line = np.repeat(shades, brick, axis=0)
        shift = (row % 2) * (brick // 2)
        rows = slice(row * course, (row + 1) * course)
        colour[rows] *= np.roll(line, shift, axis=0).astype(np.float32)
        colour[rows, shift::brick] = colour[rows, shift::brick] * 0.45 + 0.55 * np.array(mortar, np.float32)
    colour[::course] = colour[::course] * 0.5 + 0.5 * np.array(mortar, np.float32)


def _storeys(wall: _Wall, *, front: bool) -> None:
    high, wide = wall.day.shape[:2]
    length_m, height_m = wide / wall.scale, high / wall.scale
    look = wall.look
    floors = max(round((height_m - 0.8) / 3.0), 1)
    bays = max(round((length_m - 0.8) / (2.3 + 0.3 * choose(look, 42, 4))), 1)
    if not front:
        bays = max(bays // 2, 1)
    storey_m, bay_m = (height_m - 0.9) / floors, (length_m - 0.6) / bays
    shop = front and choose(look, 45, 5) < 2
    ground_m = height_m - storey_m - 0.15
    _trim(wall, length_m, height_m, ground_m, front=front)
    panes = _Panes(wall, bay_m, storey_m)
    door = choose(look, 46, bays) if front else -1
    for floor in range(floors):
        foot_m = height_m - 0.25 - floor * storey_m
        for number in range(bays):
            x_m = 0.3 + (number + 0.5) * bay_m
            if floor == 0 and number == door:
                _door(wall, x_m, foot_m, height_m)
            elif floor == 0 and shop:
                _shop(wall, x_m, foot_m, 0.9 * bay_m, min(2.3, 0.78 * storey_m))
            else:
                panes.paste(x_m, foot_m - (0.95 if floor == 0 else 0.8), floor, front=front)
    if shop:
        _fascia(wall, length_m, height_m - 0.25 - min(2.3, 0.78 * storey_m) - 0.95)
    elif front:
        _clutter(wall, length_m, height_m)
    elif float(wall.rng.random()) < 0.25 and length_m > 6.0:
        _billboard(wall, length_m, height_m)


def _trim(wall: _Wall, length_m: float, height_m: float, ground_m: float, *, front: bool) -> None:
    """Draw a coloured ground floor, string courses, eaves, plinth and a drainpipe."""
    look = wall.look
    if front and choose(look, 51, 3) == 0:
        base = wall.pick(52, _WALLS)
        wall.box((0.0, ground_m, length_m, height_m - ground_m), scaled(base, 0.88))
        for row in range(1, 6):
            wall.shade((0.0, ground_m + 0.5 * row, length_m, 0.06), 0.84)
    if choose(look, 53, 2) == 0:
        wall.box((0.0, ground_m, length_m, 0.16), _STONE_RGB)
        wall.shade((0.0, ground_m + 0.16, length_m, 0.09), 0.62)
    wall.box((0.0, 0.0, length_m, 0.35), scaled(_STONE_RGB, 0.96))
    wall.box((0.0, 0.0, length_m, 0.10), (84, 78, 74))
    wall.shade((0.0, 0.35, length_m, 0.22), 0.66)
    wall.shade((0.0, height_m - 0.55, length_m, 0.55), 0.66)
    wall.shade((0.0, height_m - 0.12, length_m, 0.12), 0.72)
    pipe_m = 0.12 if choose(look, 54, 2) else length_m - 0.22
    wall.box((pipe_m, 0.3, 0.1, height_m), (108, 110, 112))
    wall.shade((pipe_m + 0.1, 0.35, 0.08, height_m), 0.78)


class _Panes:
    """The windows of one facade.

    Args:
        wall: The facade.
        bay_m: Width of a bay.
        storey_m: Height of a storey.
    """

    def __init__(self, wall: _Wall, bay_m: float, storey_m: float) -> None:
        look = wall.look
        self._wall = wall
        # Whole quarters of a metre, so that buildings share the windows drawn.
        self._wide_m = max(round(min(1.05 + 0.2 * choose(look, 43, 3), 0.62 * bay_m) * 4), 1) / 4
        self._high_m = max(round(min(1.45 + 0.15 * choose(look, 44, 3), 0.62 * storey_m) * 4), 1) / 4
        self._kind = choose(look, 55, 4)
        self._balconies = choose(look, 56, 4) == 0
        size = (
            max(round((self._wide_m + 0.3) * wall.scale), 4),
            max(round((self._high_m + 0.3) * wall.scale), 4),
        )
        self._day, self._glow = _windows(
            size, choose(look, 48, len(_FRAMES)), self._kind, round(wall.scale, 2)
        )

    def paste(self, x_m: float, sill_m: float, floor: int, *, front: bool) -> None:
        """Draw a window whose sill is at a distance below the eaves."""
        wall = self._wall
        variant = int(wall.rng.integers(_VARIANTS))
        lit = float(wall.rng.random()) < 0.36
        glow = self._glow[variant] if lit else None
        wall.paste(x_m - self._wide_m / 2 - 0.15, sill_m - self._high_m - 0.15, self._day[variant], glow)
        if self._balconies and front and floor > 0 and float(wall.rng.random()) < 0.7:
            self._balcony(x_m, sill_m)

    def _balcony(self, x_m: float, sill_m: float) -> None:
        wall, half_m = self._wall, 0.5 * self._wide_m + 0.35
        left, foot = x_m - half_m, sill_m + 0.45
        wall.shade((left, foot + 0.12, 2 * half_m, 0.5), 0.72)
        wall.shade((left, foot - 0.95, 2 * half_m, 0.95), 0.80)
        wall.box((left, foot, 2 * half_m, 0.13), scaled(_STONE_RGB, 0.9))
        rail = wall.pick(57, ((46, 46, 48), (196, 196, 194), (92, 74, 60)))
        for number in range(int(2 * half_m / 0.16) + 1):
            wall.box((left + 0.16 * number, foot - 0.95, 0.05, 0.95), rail)
        wall.box((left, foot - 0.98, 2 * half_m, 0.07), rail)
        if float(wall.rng.random()) < 0.4:
            wall.box((left + 0.1, foot - 0.75, 0.9, 0.22), (112, 70, 52))
            wall.box((left + 0.1, foot - 1.0, 0.9, 0.28), (72, 104, 50))


@lru_cache(maxsize=96)
def _windows(
    size: tuple[int, int], frame: int, kind: int, scale: float
) -> tuple[list[Picture], list[Picture]]:
    """Return variants of a window with its surround, and the light that each emits at night.

    Args:
        size: Width and height with 0.15 m of wall on each side, in px.
        frame: Selects the frame's colour.
        kind: Selects the division into panes.
        scale: Pixels per metre.
    """
    rng = np.random.default_rng((_FACADE_STREAM, 3, *size, frame, kind))
    drawn = [_window(rng, size, frame, kind, scale, variant) for variant in range(_VARIANTS)]
    return [day for day, _ in drawn], [glow for _, glow in drawn]


def _window(
    rng: np.random.Generator, size: tuple[int, int], frame: int, kind: int, scale: float, variant: int
) -> tuple[Picture, Picture]:
    fine = scale * _FINE
    image = np.empty((size[1] * _FINE, size[0] * _FINE, 3), np.uint8)
    image[:] = scaled(_STONE_RGB, 0.94)
    glow = np.zeros_like(image)
    wide_m, high_m = size[0] / scale - 0.3, size[1] / scale - 0.3
    rgb = _FRAMES[frame]
    _fill(image, (0.10, 0.10, wide_m + 0.10, high_m + 0.08), fine, (52, 48, 46))
    _fill(image, (0.15, 0.19, wide_m, high_m - 0.06), fine, rgb)
    _fill(image, (0.0, high_m + 0.14, wide_m + 0.3, 0.09), fine, (214, 210, 202))
    _fill(image, (0.0, high_m + 0.23, wide_m + 0.3, 0.07), fine, (96, 92, 88))
    light = scaled(_LIT[int(rng.integers(len(_LIT)))], float(rng.uniform(0.5, 0.95)))
    left, top, right, bottom = (
        round(edge * fine) for edge in (0.22, 0.25, 0.22 + wide_m - 0.14, 0.25 + high_m - 0.19)
    )
    _glaze(image[top:bottom, left:right], glow[top:bottom, left:right], rng, variant, light)
    columns, rows = ((2, 1), (2, 2), (1, 1), (1, 2))[kind]
    bars = [(0.15 + wide_m * bar / columns - 0.035, 0.25, 0.07, high_m - 0.19) for bar in range(1, columns)]
    bars += [
        (0.22, 0.19 + (high_m - 0.06) * bar / rows - 0.03, wide_m - 0.14, 0.06) for bar in range(1, rows)
    ]
    for bar in bars:
        _fill(image, bar, fine, rgb)
        _fill(glow, bar, fine, (0, 0, 0))
    _fill(image, (0.15, 0.19, wide_m, 0.07), fine, scaled(rgb, 0.5))  # the lintel's shadow
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
    return small, cv2.resize(glow, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


def _glaze(region: Picture, shine: Picture, rng: np.random.Generator, variant: int, light: Rgb) -> None:
    """Draw the glass: reflected sky above, the dark room below, and curtains or a blind."""
    high, wide = region.shape[:2]
    if region.size == 0:
        return
    sky, level = float(rng.uniform(0.55, 1.25)), float(rng.uniform(0.3, 0.75))
    fall = np.linspace(0.0, 1.0, high, dtype=np.float32)[:, None]
    slope = fall + 0.25 * np.linspace(-1.0, 1.0, wide, dtype=np.float32)[None, :]
    edge = np.clip(0.5 - (slope - level) * 4.0, 0, 1)
    for channel, (room, high_sky, lamp) in enumerate(zip((40, 46, 52), (68, 84, 100), light, strict=True)):
        region[..., channel] = room + edge * (high_sky * sky)
        shine[..., channel] = lamp * (1.0 - 0.28 * fall)
    cloth = np.array((196, 190, 178) if variant % 2 else (170, 150, 132), np.uint8)
    if variant in (1, 2):
        part = max(round(wide * (0.25 if variant == 1 else 0.16)), 1)
        for strip in (slice(0, part), slice(wide - part, wide)):
            region[:, strip] = region[:, strip] // 3 + (cloth // 3) * 2
            shine[:, strip] = shine[:, strip] // 4 * 3
    elif variant in (3, 4):
        part = max(round(high * (0.45 if variant == 3 else 0.25)), 1)
        region[:part] = cloth
        region[:part:4] = cloth // 4 * 3
        shine[:part] //= 2


def _door(wall: _Wall, x_m: float, foot_m: float, height_m: float) -> None:
    rgb = wall.pick(49, _DOORS)
    top = foot_m - 2.42
    wall.box((x_m - 0.72, top, 1.44, height_m), scaled(_STONE_RGB, 0.98))
    wall.shade((x_m - 0.55, top + 0.16, 1.1, 0.05), 0.5)
    wall.box((x_m - 0.54, top + 0.2, 1.08, height_m), scaled(rgb, 0.55))
    wall.box((x_m - 0.5, top + 0.62, 1.0, height_m), rgb)
    wall.box((x_m - 0.46, top + 0.24, 0.92, 0.34), (74, 88, 98))
    _fill(wall.glow, (x_m - 0.46, top + 0.24, 0.92, 0.34), wall.scale, (150, 126, 84))
    for side in (-0.42, 0.06):
        wall.box((x_m + side, top + 0.8, 0.36, 0.6), scaled(rgb, 0.76))
        wall.box((x_m + side, top + 1.55, 0.36, 0.7), scaled(rgb, 0.76))
    wall.box((x_m + 0.40, top + 1.45, 0.06, 0.1), (206, 190, 140))
    wall.box((x_m - 0.85, foot_m + 0.02, 1.7, 0.25), (150, 148, 142))
    wall.shade((x_m - 0.85, foot_m + 0.12, 1.7, 0.14), 0.72)


def _shop(wall: _Wall, x_m: float, foot_m: float, wide_m: float, high_m: float) -> None:
    """Draw a shop window with goods behind its glass."""
    left, top = x_m - wide_m / 2, foot_m - 0.35 - high_m
    rng = wall.rng
    wall.box((left - 0.08, top - 0.08, wide_m + 0.16, high_m + 0.16), scaled(wall.pick(47, _SHOPS), 0.7))
    wall.box((left, top, wide_m, high_m), (56, 62, 66))
    wall.box((left, top, wide_m, 0.45 * high_m), (88, 102, 114))
    light = scaled(_LIT[int(rng.integers(len(_LIT)))], float(rng.uniform(0.5, 0.85)))
    lit = float(rng.random()) < 0.75
    if lit:
        _fill(wall.glow, (left, top, wide_m, high_m), wall.scale, light)
    for _ in range(int(rng.integers(3, 8))):
        high, wide = float(rng.uniform(0.25, 0.8)), float(rng.uniform(0.15, 0.5))
        at = left + float(rng.uniform(0.05, max(wide_m - wide - 0.05, 0.06)))
        rgb = _GOODS[int(rng.integers(len(_GOODS)))]
        wall.box((at, top + high_m - high, wide, high), scaled(rgb, 0.62))
        if lit:
            _fill(wall.glow, (at, top + high_m - high, wide, high), wall.scale, scaled(rgb, 0.8))
    wall.box((left + 0.48 * wide_m, top, 0.05, high_m), scaled(wall.pick(47, _SHOPS), 0.8))
    wall.box((left, foot_m - 0.33, wide_m, 0.3), scaled(wall.pick(47, _SHOPS), 0.85))


def _fascia(wall: _Wall, length_m: float, top_m: float) -> None:
    """Draw the sign above a shop, and an awning above some."""
    rgb = wall.pick(47, _SHOPS)
    wall.box((0.25, top_m, length_m - 0.5, 0.55), rgb)
    wall.shade((0.25, top_m + 0.55, length_m - 0.5, 0.16), 0.6)
    light = sum(rgb) > 420
    text: Rgb = (60, 52, 46) if light else (240, 234, 214)
    word = _WORDS[choose(wall.look, 58, len(_WORDS))]
    size = 0.42 * wall.scale / 22.0
    for place in np.arange(0.8, length_m - 2.6, 6.5).tolist():
        corner = (round(place * wall.scale), round((top_m + 0.43) * wall.scale))
        cv2.putText(wall.day, word, corner, cv2.FONT_HERSHEY_DUPLEX, size, text, 1, cv2.LINE_AA)
        cv2.putText(wall.glow, word, corner, cv2.FONT_HERSHEY_DUPLEX, size, (210, 196, 160), 1, cv2.LINE_AA)
    if choose(wall.look, 59, 2) == 0:
        for number in range(int((length_m - 0.6) / 0.3)):
            cloth = rgb if number % 2 else (226, 222, 212)
            wall.box((0.3 + 0.3 * number, top_m + 0.52, 0.3, 0.48), scaled(cloth, 0.92))
        wall.shade((0.3, top_m + 1.0, length_m - 0.6, 0.22), 0.55)


def _clutter(wall: _Wall, length_m: float, height_m: float) -> None:
    """Draw posters, meter boxes, plaques and scribbles along the foot of a wall."""
    rng = wall.rng
    for _ in range(int(rng.integers(0, 4))):
        x_m = float(rng.uniform(0.4, max(length_m - 1.4, 0.5)))
        kind = int(rng.integers(4))
        if kind == 0:
            wall.box((x_m, height_m - 1.1, 0.5, 0.7), (168, 170, 168))
            wall.shade((x_m, height_m - 0.75, 0.5, 0.35), 0.9)
        elif kind == 3:
            path = np.cumsum(rng.normal(0.0, 0.22, (9, 2)), axis=0) * (1.0, 0.5) + (x_m + 0.3, height_m - 1.0)
            points = np.rint(path * wall.scale).astype(np.int32)
            cv2.polylines(wall.day, [points], False, _POSTERS[int(rng.integers(5))], 2, cv2.LINE_AA)
        else:
            _poster(wall, (x_m, height_m - 2.0, 0.55, 0.8))


def _poster(wall: _Wall, rect: _Rect) -> None:
    left, top, wide, high = rect
    rng = wall.rng
    wall.box(rect, scaled(_POSTERS[int(rng.integers(len(_POSTERS)))], 0.9))
    wall.box(
        (left + 0.1 * wide, top + 0.12 * high, 0.8 * wide, 0.4 * high), _GOODS[int(rng.integers(len(_GOODS)))]
    )
    for line in (0.62, 0.74, 0.86):
        wall.box((left + 0.12 * wide, top + line * high, 0.7 * wide, 0.05 * high), (236, 232, 222))


def _billboard(wall: _Wall, length_m: float, height_m: float) -> None:
    wide_m = min(0.55 * length_m, 4.2)
    rect = (0.5 * (length_m - wide_m), max(0.3 * height_m, 1.0), wide_m, 0.62 * wide_m)
    wall.box((rect[0] - 0.1, rect[1] - 0.1, rect[2] + 0.2, rect[3] + 0.2), (58, 58, 60))
    _poster(wall, rect)

"""Buildings: facade textures by day and by night, and the visible walls, drawn in perspective.

A facade is drawn once at `PX_PER_M` and then halved separately in length and height, because a wall in perspective
shrinks more sideways. All walls are placed once per frame; each building is painted when its turn comes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.canvas import Canvas
from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import Building, FloatArray, IntArray, Picture, Rgb, choose, footprint
from brink.sim.rendering.textures import Noise, smooth_noise
from brink.sim.rendering.view import NEAR_M, SHIFT, View, clip_near, to_fixed_point

_MAX_HALVINGS: Final = 5
_COARSE_FROM: Final = 2.6
"""A wall is drawn at half size if it is more than this many times as high in the image as its texture."""
_PLAIN_BELOW_PX: Final = 7.0
"""A wall narrower than this is painted in a single colour."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedWalls:
    """The walls of all buildings, seen from one viewpoint.

    Attributes:
        seen: Top left, top right, bottom right, bottom left in camera coordinates, shape ``(walls, 4, 3)``.
        pixels: The same corners in pixels, shape ``(walls, 4, 2)``.
        to_wall: Homographies from image pixels to a wall's unit square, up to scale, shape ``(walls, 3, 3)``.
        shown: Whether a wall faces the camera and extends beyond the near plane, shape ``(walls,)``.
        near: Whether a wall must be clipped at the near plane, shape ``(walls,)``.
        haze: Share of haze, shape ``(walls,)``.
    """

    seen: FloatArray
    pixels: FloatArray
    to_wall: FloatArray
    shown: NDArray[np.bool_]
    near: NDArray[np.bool_]
    haze: FloatArray


class BuildingPainter:
    """Paints buildings under fixed lighting.

    Args:
        buildings: All buildings of the scene.
        lighting: The light.
        width_px: Width of the image.
        height_px: Height of the image.
    """

    def __init__(
        self, buildings: Sequence[Building], lighting: Lighting, width_px: int, height_px: int
    ) -> None:
        self._buildings = list(buildings)
        self._lighting = lighting
        self._veil: Picture = np.empty((height_px, width_px, 3), np.uint8)
        self._veil[:] = np.array(lighting.haze_rgb).astype(np.uint8)
        rectangles = [footprint(b.x_m, b.y_m, b.yaw_rad, b.length_m, b.width_m) for b in buildings]
        outlines = np.array(rectangles).reshape(-1, 4, 2)
        # A counter-clockwise outline runs from left to right when seen from outside.
        start, end = outlines.reshape(-1, 2), np.roll(outlines, -1, axis=1).reshape(-1, 2)
        heights = np.repeat([b.height_m for b in buildings], 4)
        self._corners = np.zeros((len(start), 4, 3))
        self._corners[:, (0, 3), :2] = start[:, None]
        self._corners[:, (1, 2), :2] = end[:, None]
        self._corners[:, :2, 2] = heights[:, None]
        length = np.hypot(*(end - start).T)
        self._normals = np.stack((end[:, 1] - start[:, 1], start[:, 0] - end[:, 0]), axis=1) / length[:, None]
        self._sizes = [
            (_quarters(a), _quarters(h)) for a, h in zip(length.tolist(), heights.tolist(), strict=True)
        ]
        self._light = self._light_on_walls()

    def _light_on_walls(self) -> list[float]:
        """Return the brightness of each wall as a factor on its texture; night textures are already dark."""
        light = self._lighting
        if light.night:
            return [1.0] * len(self._normals)
        to_sun = self._normals[:, 0] * light.sun[0] + self._normals[:, 1] * light.sun[1]
        share: list[float] = (light.ambient_strength + light.sun_strength * np.maximum(to_sun, 0.0)).tolist()
        return share

    def place_walls(self, view: View) -> PlacedWalls:
        """Place all walls for a view."""
        count = len(self._corners)
        seen = view.to_camera(self._corners.reshape(-1, 3)).reshape(count, 4, 3)
        pixels = view.project(seen.reshape(-1, 3)).reshape(count, 4, 2)
        outward = self._normals[:, 0] * (view.x_m - self._corners[:, 0, 0])
        outward += self._normals[:, 1] * (view.y_m - self._corners[:, 0, 1])
        depth = seen[..., 0]
        middle = seen.mean(axis=1)
        columns = np.stack((seen[:, 1] - seen[:, 0], seen[:, 3] - seen[:, 0], seen[:, 0]), axis=2)
        to_picture = np.empty_like(columns)
        to_picture[:, 0] = (view.width_px / 2 - 0.5) * columns[:, 0] - view.focal_px * columns[:, 1]
        to_picture[:, 1] = (view.height_px / 2 - 0.5) * columns[:, 0] - view.focal_px * columns[:, 2]
        to_picture[:, 2] = columns[:, 0]
        return PlacedWalls(
            seen,
            pixels,
            _inverses(to_picture),
            (outward > 1e-3) & (depth.max(axis=1) > NEAR_M),
            depth.min(axis=1) < NEAR_M,
            self._lighting.haze(np.hypot(middle[:, 0], middle[:, 1])),
        )

    def paint(self, number: int, walls: PlacedWalls, canvas: Canvas, view: View) -> None:
        """Paint the walls of a building that face the camera.

        Args:
            number: Index of the building.
            walls: All walls, placed for this view.
            canvas: Painted on.
            view: The camera.
        """
        for wall in range(4 * number, 4 * number + 4):
            if walls.shown[wall]:
                self._paint_wall(wall, walls, canvas, view)

    def mirrored(self, walls: PlacedWalls, view: View) -> list[list[tuple[IntArray, Rgb]]]:
        """Return each building's visible walls reflected below the ground, in one colour per wall."""
        below = walls.seen.copy()
        below[:, :2] = 2 * below[:, (3, 2)] - below[:, :2]
        polygons = to_fixed_point(view.project(below.reshape(-1, 3))).reshape(-1, 4, 2)
        found: list[list[tuple[IntArray, Rgb]]] = [[] for _ in self._buildings]
        for wall in np.flatnonzero(walls.shown).tolist():
            polygon = view.project_polygon(below[wall]) if walls.near[wall] else polygons[wall]
            found[wall // 4].append((polygon, self._plain(wall, 0.0)))
        return found

    def _plain(self, wall: int, haze: float) -> Rgb:
        """Return a wall's mean colour as seen through haze."""
        share = self._light[wall] * (1 - haze)
        building = self._buildings[wall // 4]
        rgb = _mean_colour(building.look, *self._sizes[wall], self._lighting.night, wall % 2 == 0)
        veil = self._lighting.haze_rgb
        return (
            rgb[0] * share + veil[0] * haze,
            rgb[1] * share + veil[1] * haze,
            rgb[2] * share + veil[2] * haze,
        )

    def _texture(self, wall: int, along: int, up: int) -> Picture:
        building = self._buildings[wall // 4]
        return _shrink_facade(
            building.look, *self._sizes[wall], self._lighting.night, wall % 2 == 0, along, up
        )

    def _paint_wall(self, wall: int, walls: PlacedWalls, canvas: Canvas, view: View) -> None:
        pixels = walls.pixels[wall]
        if walls.near[wall]:
            pixels = view.project(clip_near(walls.seen[wall]))
        low_x, low_y = pixels.min(axis=0).tolist()
        high_x, high_y = pixels.max(axis=0).tolist()
        left, top = max(math.floor(low_x), 0), max(math.floor(low_y), 0)
        right, bottom = min(math.ceil(high_x) + 1, view.width_px), min(math.ceil(high_y) + 1, view.height_px)
        if right <= left or bottom <= top:
            return
        outline = to_fixed_point(pixels)
        haze = float(walls.haze[wall])
        cv2.fillConvexPoly(canvas.ids, outline, (0,), cv2.LINE_8, SHIFT)
        if high_x - low_x < _PLAIN_BELOW_PX:
            cv2.fillConvexPoly(canvas.image, outline, self._plain(wall, haze), cv2.LINE_AA, SHIFT)
            return
        texture = self._fitting_texture(wall, high_x - low_x, high_y - low_y)
        size = (right - left, bottom - top)
        to_texture = _to_texture(walls.to_wall[wall], texture.shape[1], texture.shape[0], left, top)
        coarse = high_y - low_y > _COARSE_FROM * texture.shape[0] and min(size) > 8
        warped = _warp(texture, to_texture, size, coarse=coarse)
        veil = self._veil[: size[1], : size[0]]
        cv2.addWeighted(warped, self._light[wall] * (1 - haze), veil, haze, 0.0, dst=warped)
        mask = np.zeros((size[1], size[0]), np.uint8)
        cv2.fillConvexPoly(
            mask, outline - np.array((left << SHIFT, top << SHIFT), np.int32), (255,), cv2.LINE_8, SHIFT
        )
        cv2.copyTo(warped, mask, canvas.image[top:bottom, left:right])

    def _fitting_texture(self, wall: int, wide_px: float, high_px: float) -> Picture:
        """Return the wall's texture, halved until about one texture pixel falls on one image pixel."""
        building = self._buildings[wall // 4]
        full = _draw_facade(building.look, *self._sizes[wall], self._lighting.night, wall % 2 == 0)
        along = math.log2(max(full.shape[1] / max(wide_px, 1.0), 1.0))
        up = math.log2(max(full.shape[0] / max(high_px, 1.0), 1.0))
        return self._texture(wall, min(int(along + 0.3), _MAX_HALVINGS), min(int(up + 0.3), _MAX_HALVINGS))


def _quarters(length_m: float) -> float:
    """Round a length to quarter metres, so that walls of nearly the same size share a texture."""
    return max(round(length_m * 4) / 4, 0.25)


def _to_texture(to_wall: FloatArray, wide: int, high: int, left: int, top: int) -> FloatArray:
    """Return the homography from pixels of a region at (left, top) to pixels of a wall's texture."""
    moved = to_wall.copy()
    moved[:, 2] += left * to_wall[:, 0] + top * to_wall[:, 1]
    moved[0] = wide * moved[0] - 0.5 * moved[2]
    moved[1] = high * moved[1] - 0.5 * moved[2]
    return moved


def _warp(texture: Picture, to_texture: FloatArray, size: tuple[int, int], *, coarse: bool) -> Picture:
    """Warp a texture into a region of the image; with `coarse`, at half size and then enlarged."""
    drawn = size
    if coarse:
        drawn = ((size[0] + 1) // 2, (size[1] + 1) // 2)
        grow_x, grow_y = size[0] / drawn[0], size[1] / drawn[1]
        moved = np.array(
            [[grow_x, 0.0, 0.5 * grow_x - 0.5], [0.0, grow_y, 0.5 * grow_y - 0.5], [0.0, 0.0, 1.0]]
        )
        to_texture = np.einsum("ij,jk->ik", to_texture, moved)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(texture, to_texture, drawn, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    if coarse:
        warped = cv2.resize(warped, size, interpolation=cv2.INTER_LINEAR)
    return warped.astype(np.uint8, copy=False)


def _inverses(matrices: FloatArray) -> FloatArray:
    """Invert 3 x 3 matrices up to a scale factor, which homographies ignore; shape ``(n, 3, 3)``."""
    a, b, c = matrices[:, :, 0], matrices[:, :, 1], matrices[:, :, 2]
    return np.stack((np.cross(b, c), np.cross(c, a), np.cross(a, b)), axis=1)


PX_PER_M: Final = 22.0
_MAX_SIDE_PX: Final = 1400
_FACADE_STREAM: Final = 76
_WALLS: Final = (
    (176, 104, 82), (206, 190, 160), (188, 184, 178), (214, 204, 188), (150, 92, 74), (196, 168, 128),
    (164, 168, 172), (222, 214, 196), (178, 152, 132),
)  # fmt: skip
_BRICK: Final = (0, 4)
_FRAMES: Final = ((236, 234, 228), (70, 66, 62), (226, 220, 206), (52, 72, 66))
_DOORS: Final = ((84, 52, 36), (40, 62, 84), (44, 72, 52), (120, 34, 32))
_SHOPS: Final = ((40, 84, 64), (148, 40, 38), (44, 54, 92), (196, 152, 60))
_LIT: Final = ((255, 214, 140), (250, 226, 176), (232, 190, 118))


@lru_cache(maxsize=96)
def _draw_facade(look: int, length_m: float, height_m: float, night: bool, front: bool) -> Picture:
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
def _shrink_facade(
    look: int, length_m: float, height_m: float, night: bool, front: bool, along: int, up: int
) -> Picture:
    """Return a facade halved `along` times horizontally and `up` times vertically."""
    if along == 0 and up == 0:
        return _draw_facade(look, length_m, height_m, night, front)
    full = _draw_facade(look, length_m, height_m, night, front)
    size = (max(full.shape[1] >> along, 2), max(full.shape[0] >> up, 2))
    return cv2.resize(full, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


@lru_cache(maxsize=192)
def _mean_colour(
    look: int, length_m: float, height_m: float, night: bool, front: bool
) -> tuple[float, float, float]:
    """Return the mean colour of a facade."""
    full = _draw_facade(look, length_m, height_m, night, front)
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
    bays = max(round((length_m - 0.8) / (2.3 + 0.3 * choose(look, 42, 4))), 1)
    if not front:
        bays = max(bays // 2, 1)
    storey, bay = (height_m - 0.9) / floors, (length_m - 0.6) / bays
    window_w = min(1.15 + 0.2 * choose(look, 43, 3), 0.66 * bay)
    window_h = min(1.45 + 0.15 * choose(look, 44, 3), 0.62 * storey)
    shop = front and choose(look, 45, 3) == 0
    door_bay = choose(look, 46, bays)
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
                    _SHOPS[choose(look, 47, len(_SHOPS))],
                )
            else:
                sill = foot - 0.95 if floor == 0 else foot - 0.8
                _pane(wall, glow, rng, look, scale, (x, sill, window_w, window_h), chance=0.36)


_Rect = tuple[float, float, float, float]
"""A rectangle on a wall: middle along the wall, bottom edge measured from the top, width and height, in m."""


def _box(wall: Noise, scale: float, rect: _Rect, rgb: tuple[float, float, float]) -> None:
    x, bottom, wide, high = rect
    corner = (round((x - wide / 2) * scale), round((bottom - high) * scale))
    cv2.rectangle(wall, corner, (round((x + wide / 2) * scale) - 1, round(bottom * scale) - 1), rgb, -1)


def _pane(
    wall: Noise, glow: Noise, rng: np.random.Generator, look: int, scale: float, rect: _Rect, *, chance: float
) -> None:
    x, bottom, wide, high = rect
    frame = _FRAMES[choose(look, 48, len(_FRAMES))]
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
    rgb = _DOORS[choose(look, 49, len(_DOORS))]
    _box(wall, scale, (x, height_m, 1.36, height_m - foot + 2.42), (196, 190, 180))
    _box(wall, scale, (x, height_m, 1.08, height_m - foot + 2.22), rgb)
    _box(wall, scale, (x, foot - 1.65, 0.9, 0.45), (70, 82, 92))
    for side in (-0.25, 0.25):
        dark = (rgb[0] * 0.75, rgb[1] * 0.75, rgb[2] * 0.75)
        _box(wall, scale, (x + side, foot - 0.3, 0.36, 1.0), dark)

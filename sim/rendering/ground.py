"""Owns the ground: surfaces, their texture, the shadows and the light that lie on them, and what a wet road mirrors.

Surfaces are painted flat, in order; then one map of brightness (texture times shadow times light) is laid over all of
them, and haze over that. Rows of the picture are lines of equal depth, so each row knows its texture's scale.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.canvas import Rgb
from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import FloatArray, Ground, Material, Picture, PictureCamera
from brink.sim.rendering.textures import TILE_M, TILE_PX_PER_M, ground_tiles
from brink.sim.rendering.view import SHIFT, IntArray, View, beyond_near, fixed_point

_NEAR_M: Final = 0.4
_FAR_M: Final = 220.0
_PLAIN: Final = 128
_RGB: Final = {
    Material.ASPHALT: (92, 92, 94),
    Material.PAVEMENT: (156, 151, 144),
    Material.GRASS: (92, 114, 62),
    Material.EARTH: (124, 108, 86),
    Material.MARKING: (222, 222, 216),
    Material.CROSSING: (222, 222, 216),
    Material.KERB: (182, 179, 172),
    Material.GUTTER: (74, 74, 75),
}
_CHANNEL: Final = {Material.PAVEMENT: 1, Material.KERB: 1, Material.GRASS: 2, Material.EARTH: 2}
_ON_ASPHALT: Final = (Material.MARKING, Material.CROSSING, Material.GUTTER)
_WET: Final = {0: 0.62, 1: 0.74, 2: 0.86}
_BACKDROP: Final = Material.GRASS
_TILE_SEEDS: Final = 8
"""Few, so that streets share the tiles of their ground."""

Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundCover:
    """What lies on the ground this frame, as polygons in sixteenths of a pixel of the half-size picture.

    Attributes:
        shadows: Polygons and how bright the ground in them still is, 0 to 255, in order.
        pools: Polygons of lamp light and how much they add, 0 to 255.
        mirrored: What a wet road shows upside down, in order.
    """

    shadows: list[tuple[IntArray, int]]
    pools: list[tuple[IntArray, int]]
    mirrored: list[tuple[IntArray, Rgb]]


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """What the rows below the horizon know, for one pitch.

    Bands are runs of rows of one level of the texture: first, last, level; -1 is finer than the texture.
    """

    first_px: int
    ahead_m: FloatArray
    spread_m: FloatArray
    bands: tuple[tuple[int, int, int], ...]
    light: Picture
    haze: Picture
    mirror: Picture


class GroundPainter:
    """Paints the ground.

    Args:
        ground: The surfaces, in order.
        lighting: The light.
        camera: Whose picture.
        seed: Of the texture.
    """

    def __init__(
        self, ground: tuple[Ground, ...], lighting: Lighting, camera: PictureCamera, seed: int
    ) -> None:
        self._lighting = lighting
        self._camera = camera
        self._tiles = list(ground_tiles(seed % _TILE_SEEDS, wet=lighting.wet))
        if not lighting.wet:
            self._tiles = [np.ascontiguousarray(tile[..., :3]) for tile in self._tiles]
        self._materials = [surface.material for surface in ground]
        self._points = np.concatenate([np.zeros((0, 2)), *(surface.points for surface in ground)])
        self._starts = np.cumsum([0, *(len(surface.points) for surface in ground)])
        self._rgb = {material: self._lit(material) for material in Material}
        self._backdrop = np.empty((camera.height_px, camera.width_px, 3), np.uint8)
        self._backdrop[:] = np.array(self._rgb[_BACKDROP]).astype(np.uint8)
        self._rows: dict[float, _Rows] = {}

    def _lit(self, material: Material) -> Rgb:
        light = self._lighting
        share = 1.0 if light.night else light.ambient_share + light.sun_share * float(light.sun[2]) ** 0.6
        wet = _WET[_CHANNEL.get(material, 0)] if light.wet else 1.0
        if material in (Material.MARKING, Material.CROSSING) and light.wet:
            wet = 0.85
        red, green, blue = (np.array(_RGB[material]) * light.tint * share * wet).tolist()
        return red, green, blue

    def paint(self, image: Picture, view: View, cover: GroundCover) -> None:
        """Paint everything below the horizon; `image` already shows the sky above it."""
        rows = self._rows_of(view)
        if rows.first_px >= view.height_px:
            return
        region = image[rows.first_px :]
        mirror = self._mirror(image, rows, cover) if self._lighting.wet else None
        channels = np.full(region.shape[:2], _CHANNEL[_BACKDROP], np.uint8)
        np.copyto(region, self._backdrop[: len(region)])
        self._surfaces(region, channels, view, rows.first_px)
        texture = self._texture(view, rows)
        bright = cv2.extractChannel(texture, 0)
        for channel in (1, 2):
            cv2.copyTo(
                cv2.extractChannel(texture, channel), cv2.inRange(channels, (channel,), (channel,)), bright
            )
        if cover.shadows:
            bright = cv2.multiply(bright, self._shadow(cover, rows, region.shape[:2]), scale=1 / 255)
        light = self._pools(cover, rows, region.shape[:2]) if cover.pools else rows.light
        bright = cv2.multiply(bright, light, scale=1 / 255)
        cv2.multiply(region, cv2.cvtColor(bright, cv2.COLOR_GRAY2RGB), dst=region, scale=1 / _PLAIN)
        if mirror is not None:
            self._lay_mirror(region, mirror, texture, channels, rows)
        cv2.add(region, rows.haze, dst=region)

    def _surfaces(self, region: Picture, channels: Picture, view: View, first_px: int) -> None:
        if not self._materials:
            return
        seen = view.ground_to_camera(self._points)
        starts = self._starts[:-1]
        nearest = np.minimum.reduceat(seen[:, 0], starts)
        farthest = np.maximum.reduceat(seen[:, 0], starts)
        half = view.width_px / 2 / view.focal_px
        right_of = np.minimum.reduceat(seen[:, 1] - half * seen[:, 0], starts) > 0
        left_of = np.maximum.reduceat(seen[:, 1] + half * seen[:, 0], starts) < 0
        drawn = (farthest > _NEAR_M) & (nearest < _FAR_M) & ~right_of & ~left_of
        whole = (nearest >= _NEAR_M).tolist()
        pixels = fixed_point(view.pixels(seen) - (0, first_px))
        bounds = self._starts.tolist()
        pending: list[IntArray] = []
        pending_material = Material.ASPHALT
        for index in np.flatnonzero(drawn).tolist():
            first, last = bounds[index], bounds[index + 1]
            if whole[index]:
                points = pixels[first:last]
            else:
                cut = beyond_near(seen[first:last], _NEAR_M)
                points = fixed_point(view.pixels(cut) - (0, first_px))
            material = self._materials[index]
            joined = material in _ON_ASPHALT and material is pending_material
            if not joined:
                self._fill(region, channels, pending, pending_material)
                pending = []
            pending.append(points)
            pending_material = material
        self._fill(region, channels, pending, pending_material)

    def _fill(self, region: Picture, channels: Picture, polygons: list[IntArray], material: Material) -> None:
        if not polygons:
            return
        cv2.fillPoly(region, polygons, self._rgb[material], cv2.LINE_AA, SHIFT)
        if material not in _ON_ASPHALT:
            cv2.fillPoly(channels, polygons, (_CHANNEL.get(material, 0),), cv2.LINE_8, SHIFT)

    def _texture(self, view: View, rows: _Rows) -> Picture:
        """Return the texture as the camera sees it, shape ``(rows, columns, channels)``."""
        out = np.empty((len(rows.ahead_m), view.width_px, self._tiles[0].shape[2]), np.uint8)
        for first, last, level in rows.bands:
            if level >= 0:
                self._texture_band(view, rows, (first, last, level, 1), out[first:last])
                continue
            # So near, a pixel of the texture covers several of the picture: half of them are enough.
            half = np.empty(((last - first + 1) // 2, (view.width_px + 1) // 2, out.shape[2]), np.uint8)
            self._texture_band(view, rows, (first, last, 0, 2), half)
            cv2.resize(
                half, (view.width_px, last - first), dst=out[first:last], interpolation=cv2.INTER_LINEAR
            )
        return out

    def _texture_band(self, view: View, rows: _Rows, band: tuple[int, int, int, int], out: Picture) -> None:
        """Draw some rows of the texture: first and last, level of the tile, and every how many pixels."""
        first, last, level, step = band
        ahead, spread = rows.ahead_m[first:last:step], rows.spread_m[first:last:step]
        across = (view.width_px / 2 - 0.5 - np.arange(0, view.width_px, step)) / view.focal_px
        row = across.astype(np.float32)
        scale = TILE_PX_PER_M * 0.5**level
        maps = []
        for origin_m, along, aside in (
            (view.x_m % TILE_M, view.cos_yaw, -view.sin_yaw),
            (view.y_m % TILE_M, view.sin_yaw, view.cos_yaw),
        ):
            slope = (spread * (aside * scale)).astype(np.float32)[:, None]
            offset = ((origin_m + ahead * along) * scale - 0.5).astype(np.float32)[:, None]
            maps.append(slope * row + offset)
        cv2.remap(self._tiles[level], maps[0], maps[1], cv2.INTER_LINEAR, dst=out, borderMode=cv2.BORDER_WRAP)

    def _shadow(self, cover: GroundCover, rows: _Rows, shape: tuple[int, int]) -> Picture:
        mask = self._half_sheet(rows, shape, 255)
        for points, value in cover.shadows:
            cv2.fillConvexPoly(mask, points, (value,), cv2.LINE_8, SHIFT)
        return self._full_size(cv2.GaussianBlur(mask, (5, 5), 0).astype(np.uint8), shape)

    def _pools(self, cover: GroundCover, rows: _Rows, shape: tuple[int, int]) -> Picture:
        mask = self._half_sheet(rows, shape, 0)
        for points, value in cover.pools:
            cv2.fillConvexPoly(mask, points, (value,), cv2.LINE_8, SHIFT)
        soft = cv2.blur(mask, (9, 5)).astype(np.uint8)
        return cv2.add(rows.light, self._full_size(soft, shape)).astype(np.uint8)

    def _half_sheet(self, rows: _Rows, shape: tuple[int, int], value: int) -> Picture:
        return np.full(((shape[0] + 1) // 2, (shape[1] + 1) // 2), value, np.uint8)

    def _full_size(self, half: Picture, shape: tuple[int, int]) -> Picture:
        full = cv2.resize(half, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
        return full.astype(np.uint8, copy=False)

    def _mirror(self, image: Picture, rows: _Rows, cover: GroundCover) -> Picture:
        """Return what a perfect mirror would show below the horizon, smeared, at half size."""
        height, width = image.shape[0] - rows.first_px, image.shape[1]
        above = image[max(rows.first_px - height, 0) : rows.first_px]
        half_size = ((width + 1) // 2, (height + 1) // 2)
        if above.size == 0:
            flipped = np.zeros((half_size[1], half_size[0], 3), np.uint8)
        else:
            flipped = cv2.resize(above, half_size, interpolation=cv2.INTER_NEAREST)[::-1].copy()
        for points, rgb in cover.mirrored:
            cv2.fillConvexPoly(flipped, points, rgb, cv2.LINE_8, SHIFT)
        tall = max(half_size[1] // 9, 3) | 1
        smeared = cv2.blur(flipped, (3, tall))
        return cv2.resize(smeared, (width, height), interpolation=cv2.INTER_LINEAR).astype(np.uint8)

    def _lay_mirror(
        self, region: Picture, mirror: Picture, texture: Picture, channels: Picture, rows: _Rows
    ) -> None:
        weight = cv2.multiply(cv2.extractChannel(texture, 3), rows.mirror, scale=1 / 255)
        weight[channels == _CHANNEL[Material.GRASS]] = 0
        weights = cv2.cvtColor(weight, cv2.COLOR_GRAY2RGB)
        cv2.subtract(region, cv2.multiply(region, weights, scale=1 / 255), dst=region)
        cv2.add(region, cv2.multiply(mirror, weights, scale=1 / 255), dst=region)

    def _rows_of(self, view: View) -> _Rows:
        pitch = math.atan2(view.sin_pitch, view.cos_pitch)
        rows = self._rows.get(pitch)
        if rows is None:
            if len(self._rows) > 8:
                self._rows.clear()
            rows = self._rows[pitch] = self._make_rows(view)
        return rows

    def _make_rows(self, view: View) -> _Rows:
        first = min(max(math.ceil(view.horizon_px), 0), view.height_px)
        up = (view.height_px / 2 - 0.5 - np.arange(first, view.height_px)) / view.focal_px
        fall = np.maximum(-(view.sin_pitch + up * view.cos_pitch), 1e-4)
        reach = view.height_m / fall
        ahead = reach * (view.cos_pitch - up * view.sin_pitch)
        footprint_m = np.sqrt(reach / view.focal_px * (ahead * reach / (view.focal_px * view.height_m)))
        wanted = np.log2(np.maximum(footprint_m * TILE_PX_PER_M, 1e-6)) + 0.2
        levels = np.clip(np.floor(wanted), -1, len(self._tiles) - 1).astype(int)
        breaks = [0, *(np.flatnonzero(np.diff(levels)) + 1).tolist(), len(levels)]
        bands = tuple((a, b, int(levels[a])) for a, b in itertools.pairwise(breaks) if b > a)
        haze = self._lighting.haze(ahead)
        columns = (view.width_px / 2 - 0.5 - np.arange(view.width_px)) / view.focal_px
        share = np.ones((len(ahead), view.width_px))
        if self._lighting.night:
            share = self._lighting.ambient_share + headlight_share(ahead[:, None], reach[:, None] * columns)
        light = np.clip(share, 0, 1) * (1 - haze)[:, None] * 255
        veil = np.repeat(
            (haze[:, None] * np.array(self._lighting.haze_rgb))[:, None, :], view.width_px, axis=1
        )
        mirror = np.clip(0.16 + 0.9 * np.exp(-fall / 0.16), 0, 0.85) * (1 - haze) * 255
        return _Rows(
            first_px=first,
            ahead_m=ahead,
            spread_m=reach,
            bands=bands,
            light=light.astype(np.uint8),
            haze=veil.astype(np.uint8),
            mirror=np.repeat(mirror[:, None], view.width_px, axis=1).astype(np.uint8),
        )


def headlight_share(ahead_m: FloatArray, left_m: FloatArray) -> FloatArray:
    """Return how strongly the ego's headlights light a place, 0 to 1, from where it lies to the camera."""
    ahead = np.maximum(ahead_m, 0.0)
    wide = 1.6 + 0.34 * ahead
    across = np.exp(-((left_m / wide) ** 2))
    along = np.clip((ahead_m - 0.8) / 3.5, 0, 1) * np.exp(-ahead / 24.0)
    share: FloatArray = np.clip(0.72 * across * along, 0, 1)
    return share

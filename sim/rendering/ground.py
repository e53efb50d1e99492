"""The ground: surfaces with texture, the shadows and lamp light on them, and reflections on a wet road.

Surfaces are painted flat, in order. A brightness map (texture times shadow times light) is multiplied over all of
them, and haze is added. An image row is a line of constant depth, so each row has one texture scale.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.lamps import lamp_head_position, vehicle_light_positions
from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    FloatArray,
    Ground,
    IntArray,
    Lamp,
    Material,
    Picture,
    PictureCamera,
    Rgb,
    Tree,
    footprint,
)
from brink.sim.rendering.textures import TILE_M, TILE_PX_PER_M, ground_tiles
from brink.sim.rendering.view import NEAR_M, PITCHES_KEPT, SHIFT, View, clip_near, to_fixed_point

_NEAR_M: Final = 0.4
_FAR_M: Final = 220.0
_PLAIN: Final = 128
_RGB: Final = {
    Material.ASPHALT: (92, 92, 94),
    Material.PAVEMENT: (164, 159, 152),
    Material.GRASS: (92, 114, 62),
    Material.EARTH: (124, 108, 86),
    Material.MARKING: (222, 222, 216),
    Material.CROSSING: (222, 222, 216),
    Material.KERB: (182, 179, 172),
    Material.GUTTER: (74, 74, 75),
}
_CHANNEL: Final = {Material.PAVEMENT: 1, Material.KERB: 1, Material.GRASS: 2, Material.EARTH: 2}
_PAINTED: Final = 3
"""Channel of painted markings, whose texture is the asphalt's, with more contrast."""
_WEAR: Final = np.clip(
    np.where(np.arange(256) < 122, 122 - 3.2 * (122.0 - np.arange(256)), np.arange(256)), 62, 255
).astype(np.uint8)
"""Brightness of a marking for each brightness of the asphalt below: where it is dark, the paint is worn away."""
_WEAR_WET: Final = np.clip(np.arange(256) + 10, 0, 255).astype(np.uint8)
_ON_ASPHALT: Final = (Material.MARKING, Material.CROSSING, Material.GUTTER)
_WET: Final = {0: 0.62, 1: 0.74, 2: 0.86}
_BACKDROP: Final = Material.GRASS
_TILE_SEEDS: Final = 8
"""Number of different seeds: small, so that streets share their ground tiles."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundCover:
    """Shadows, lamp light and reflections, as polygons in sixteenths of a pixel of the half-size image.

    Attributes:
        shadows: Polygons with the remaining brightness of the ground, 0 to 255, in order.
        pools: Polygons of lamp light with the brightness that they add, 0 to 255.
        mirrored: Reflections on a wet road, in order.
    """

    shadows: list[tuple[IntArray, int]]
    pools: list[tuple[IntArray, int]]
    mirrored: list[tuple[IntArray, Rgb]]


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Precomputed values of the rows below the horizon for one pitch.

    Bands are runs of rows with the same texture level: first, last, level; level -1 is finer than the texture. Levels
    become finer downwards. `scale` is the resolution of each row's texture in px per m.
    """

    first_px: int
    ahead_m: FloatArray
    spread_m: FloatArray
    scale: FloatArray
    bands: tuple[tuple[int, int, int], ...]
    light: Picture
    haze: Picture
    mirror: Picture


class GroundPainter:
    """Paints the ground.

    Args:
        ground: The surfaces, in order.
        lighting: The light.
        camera: The camera.
        seed: Seed of the texture.
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
        share = (
            1.0 if light.night else light.ambient_strength + light.sun_strength * float(light.sun[2]) ** 0.6
        )
        wet = _WET[_CHANNEL.get(material, 0)] if light.wet else 1.0
        if material in (Material.MARKING, Material.CROSSING) and light.wet:
            wet = 0.85
        red, green, blue = (np.array(_RGB[material]) * light.tint * share * wet).tolist()
        return red, green, blue

    def paint(self, image: Picture, view: View, cover: GroundCover) -> None:
        """Paint everything below the horizon.

        Args:
            image: The image, with the sky already painted above the horizon.
            view: The camera.
            cover: Shadows, lamp light and reflections.
        """
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
        worn = cv2.LUT(cv2.extractChannel(texture, 0), _WEAR_WET if self._lighting.wet else _WEAR)
        cv2.copyTo(worn, cv2.inRange(channels, (_PAINTED,), (_PAINTED,)), bright)
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
        pixels = to_fixed_point(view.project(seen) - (0, first_px))
        bounds = self._starts.tolist()
        pending: list[IntArray] = []
        pending_material = Material.ASPHALT
        for index in np.flatnonzero(drawn).tolist():
            first, last = bounds[index], bounds[index + 1]
            if whole[index]:
                points = pixels[first:last]
            else:
                cut = clip_near(seen[first:last], _NEAR_M)
                points = to_fixed_point(view.project(cut) - (0, first_px))
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
        if material in (Material.MARKING, Material.CROSSING):
            cv2.fillPoly(channels, polygons, (_PAINTED,), cv2.LINE_8, SHIFT)
        elif material is not Material.GUTTER:
            cv2.fillPoly(channels, polygons, (_CHANNEL.get(material, 0),), cv2.LINE_8, SHIFT)

    def _texture(self, view: View, rows: _Rows) -> Picture:
        """Return the texture as seen by the camera, shape ``(rows, columns, channels)``."""
        count = len(rows.ahead_m)
        out = np.empty((count, view.width_px, self._tiles[0].shape[2]), np.uint8)
        close = next((first for first, _, level in rows.bands if level < 0), count)
        maps = self._maps(view, rows, slice(0, close), 1)
        for first, last, level in rows.bands:
            if level >= 0:
                self._look_up(level, maps, slice(first, last), out[first:last])
                continue
            # A texture pixel this close covers several image pixels, so half the resolution is enough.
            half = np.empty(((last - first + 1) // 2, (view.width_px + 1) // 2, out.shape[2]), np.uint8)
            self._look_up(0, self._maps(view, rows, slice(first, last, 2), 2), slice(None), half)
            cv2.resize(
                half, (view.width_px, last - first), dst=out[first:last], interpolation=cv2.INTER_LINEAR
            )
        return out

    def _maps(self, view: View, rows: _Rows, part: slice, step: int) -> list[NDArray[np.float32]]:
        """Return the columns and the rows of the texture that some rows of the image show."""
        ahead, spread, scale = rows.ahead_m[part], rows.spread_m[part], rows.scale[part]
        across = (view.width_px / 2 - 0.5 - np.arange(0, view.width_px, step)) / view.focal_px
        row = across.astype(np.float32)
        maps = []
        for origin_m, along, aside in (
            (view.x_m % TILE_M, view.cos_yaw, -view.sin_yaw),
            (view.y_m % TILE_M, view.sin_yaw, view.cos_yaw),
        ):
            slope = (spread * (aside * scale)).astype(np.float32)[:, None]
            offset = ((origin_m + ahead * along) * scale - 0.5).astype(np.float32)[:, None]
            maps.append(slope * row + offset)
        return maps

    def _look_up(self, level: int, maps: list[NDArray[np.float32]], part: slice, out: Picture) -> None:
        columns, rows = maps[0][part], maps[1][part]
        cv2.remap(self._tiles[level], columns, rows, cv2.INTER_LINEAR, dst=out, borderMode=cv2.BORDER_WRAP)

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
        """Return the blurred reflection that a perfect mirror would show below the horizon."""
        height, width = image.shape[0] - rows.first_px, image.shape[1]
        above = image[max(rows.first_px - height, 0) : rows.first_px]
        size = ((width + 1) // 2, (height + 1) // 2)
        if above.size == 0:
            flipped = np.zeros((size[1], size[0], 3), np.uint8)
        else:
            flipped = cv2.resize(above, size, interpolation=cv2.INTER_NEAREST)[::-1].copy()
        for points, rgb in cover.mirrored:
            cv2.fillConvexPoly(flipped, points, rgb, cv2.LINE_8, SHIFT)
        tall = max(size[1] // 9, 3) | 1
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
        rows = self._rows.get(view.pitch_rad)
        if rows is None:
            if len(self._rows) == PITCHES_KEPT:
                del self._rows[next(iter(self._rows))]
            rows = self._rows[view.pitch_rad] = self._make_rows(view)
        return rows

    def _make_rows(self, view: View) -> _Rows:
        first = min(max(math.ceil(view.horizon_px), 0), view.height_px)
        up = (view.height_px / 2 - 0.5 - np.arange(first, view.height_px)) / view.focal_px
        fall = np.maximum(-(view.sin_pitch + up * view.cos_pitch), 1e-4)
        reach = view.height_m / fall
        ahead = reach * (view.cos_pitch - up * view.sin_pitch)
        footprint_m = np.sqrt(reach / view.focal_px * (ahead * reach / (view.focal_px * view.height_m)))
        exact_level = np.log2(np.maximum(footprint_m * TILE_PX_PER_M, 1e-6)) + 0.2
        levels = np.clip(np.floor(exact_level), -1, len(self._tiles) - 1).astype(int)
        breaks = [0, *(np.flatnonzero(np.diff(levels)) + 1).tolist(), len(levels)]
        bands = tuple((a, b, int(levels[a])) for a, b in itertools.pairwise(breaks) if b > a)
        haze = self._lighting.haze(ahead)
        columns = (view.width_px / 2 - 0.5 - np.arange(view.width_px)) / view.focal_px
        share = np.ones((len(ahead), view.width_px))
        if self._lighting.night:
            share = self._lighting.ambient_strength + headlight_strength(
                ahead[:, None], reach[:, None] * columns
            )
        light = np.clip(share, 0, 1) * (1 - haze)[:, None] * 255
        veil = np.repeat(
            (haze[:, None] * np.array(self._lighting.haze_rgb))[:, None, :], view.width_px, axis=1
        )
        mirror = np.clip(0.16 + 0.9 * np.exp(-fall / 0.16), 0, 0.85) * (1 - haze) * 255
        return _Rows(
            first_px=first,
            ahead_m=ahead,
            spread_m=reach,
            scale=TILE_PX_PER_M * 0.5 ** np.maximum(levels, 0),
            bands=bands,
            light=light.astype(np.uint8),
            haze=veil.astype(np.uint8),
            mirror=np.repeat(mirror[:, None], view.width_px, axis=1).astype(np.uint8),
        )


def headlight_strength(ahead_m: FloatArray, left_m: FloatArray) -> FloatArray:
    """Return the strength of the ego's headlights, in [0, 1], at positions relative to the camera."""
    ahead = np.maximum(ahead_m, 0.0)
    wide = 1.6 + 0.34 * ahead
    across = np.exp(-((left_m / wide) ** 2))
    along = np.clip((ahead_m - 0.8) / 3.5, 0, 1) * np.exp(-ahead / 24.0)
    share: FloatArray = np.clip(0.72 * across * along, 0, 1)
    return share


_LONGEST: Final = 3.2
"""Upper bound of a shadow's length, in heights of the object that casts it."""
_OCTAGON: Final = np.stack(
    (np.cos(np.arange(8) * np.pi / 4 + 0.39), np.sin(np.arange(8) * np.pi / 4 + 0.39)), axis=1
)
_CONTACT: Final = 128
_WHITE: Final = (255.0, 246.0, 224.0)
_RED: Final = (220.0, 30.0, 26.0)
_BRAKE: Final = (255.0, 40.0, 32.0)

Shadow: TypeAlias = tuple[FloatArray, int]
"""An area of the ground, shape ``(k, 2)``, and its remaining brightness, 0 to 255."""


class ShadowCaster:
    """Computes shadows under fixed lighting.

    Args:
        lighting: The light.
    """

    def __init__(self, lighting: Lighting) -> None:
        self._left = round(255 * (1 - lighting.shadow_strength))
        self._contact = _CONTACT if lighting.shadow_strength < 0.3 else 90
        rise = max(float(lighting.sun[2]), 1e-3)
        shift = -lighting.sun[:2] / rise
        self._shift = shift * min(_LONGEST / max(float(np.hypot(*shift)), 1e-9), 1.0)
        self._casts = lighting.shadow_strength > 0.3

    def box_shadows(self, corners_m: FloatArray, height_m: float, *, contact: bool) -> list[Shadow]:
        """Return the cast shadow of an upright box, then its contact shadow.

        Args:
            corners_m: Footprint, shape ``(4, 2)``.
            height_m: Height of the box.
            contact: Whether to darken the ground directly below the box.
        """
        found: list[Shadow] = []
        if self._casts:
            found.append((self._hull(corners_m, corners_m + self._shift * height_m), self._left))
        if contact:
            middle = corners_m.mean(axis=0)
            found.append((middle + (corners_m - middle) * 1.04, self._contact))
        return found

    def tree_shadows(self, tree: Tree, low_m: float) -> list[Shadow]:
        """Return the shadows of a tree's crown, whose lower end is at `low_m`, and of its trunk."""
        if not self._casts:
            return []
        place = np.array([tree.x_m, tree.y_m])
        ring = place + 0.46 * tree.crown_m * _OCTAGON
        near, far = low_m + 0.15 * tree.crown_m, tree.height_m - 0.15 * tree.crown_m
        trunk = place + 0.02 * tree.height_m * _OCTAGON
        return [
            (self._hull(ring + self._shift * near, ring + self._shift * far), self._left),
            (self._hull(trunk, trunk + self._shift * near), self._left),
        ]

    def _hull(self, first: FloatArray, second: FloatArray) -> FloatArray:
        points = np.concatenate((first, second)).astype(np.float32)
        return cv2.convexHull(points)[:, 0].astype(np.float64)


def to_half_size(polygon: IntArray, first_row_px: int) -> IntArray:
    """Convert a polygon to the coordinates of a half-size image that begins at a given row."""
    moved: IntArray = (polygon - np.array([0, first_row_px << SHIFT], np.int32)) >> 1
    return moved


def project_areas(areas: Sequence[Shadow], view: View, first_row_px: int) -> list[tuple[IntArray, int]]:
    """Project visible areas of the ground to polygons of a half-size image.

    Args:
        areas: Areas and their values.
        view: The camera.
        first_row_px: Row at which the half-size image begins.
    """
    if not areas:
        return []
    seen = view.ground_to_camera(np.concatenate([points for points, _ in areas]))
    ends = np.cumsum([0, *(len(points) for points, _ in areas)])
    nearest = np.minimum.reduceat(seen[:, 0], ends[:-1])
    half = view.width_px / 2 / view.focal_px
    beside = np.minimum.reduceat(np.abs(seen[:, 1]) - half * seen[:, 0], ends[:-1]) > 0
    left = np.minimum.reduceat(seen[:, 1], ends[:-1]) > 0
    right = np.maximum.reduceat(seen[:, 1], ends[:-1]) < 0
    gone = (np.maximum.reduceat(seen[:, 0], ends[:-1]) < _NEAR_M) | (beside & (left | right))
    pixels = to_half_size(to_fixed_point(view.project(seen)), first_row_px)
    bounds = ends.tolist()
    found: list[tuple[IntArray, int]] = []
    for index, ((_, value), near) in enumerate(zip(areas, nearest.tolist(), strict=True)):
        if gone[index]:
            continue
        first, last = bounds[index], bounds[index + 1]
        if near >= _NEAR_M:
            found.append((pixels[first:last], value))
        else:
            cut = to_fixed_point(view.project(clip_near(seen[first:last], _NEAR_M)))
            found.append((to_half_size(cut, first_row_px), value))
    return found


def lamp_light_pools(lamp: Lamp) -> list[Shadow]:
    """Return the discs of light below a lamp and the brightness that each adds, the widest first."""
    x_m, y_m = lamp_head_position(lamp)
    return [
        (np.array([x_m, y_m]) + radius * lamp.height_m * _OCTAGON, value)
        for radius, value in ((1.25, 16), (0.95, 34), (0.7, 56), (0.45, 78), (0.22, 94))
    ]


def body_reflections(
    bodies: Sequence[Body], colours: Sequence[Rgb], lit: Sequence[bool], view: View
) -> list[list[tuple[IntArray, Rgb]]]:
    """Return the reflections of each body and its lights on a wet road, as polygons of one colour each.

    Args:
        bodies: The bodies.
        colours: Colour of each reflection.
        lit: Whether each body drives with its lights on.
        view: The camera.
    """
    box = np.zeros((len(bodies), 8, 3))
    for row, body in enumerate(bodies):
        box[row, :4, :2] = box[row, 4:, :2] = footprint(
            body.x_m, body.y_m, body.yaw_rad, body.length_m, body.width_m
        )
        box[row, 4:, 2] = -body.height_m
    seen = view.to_camera(box.reshape(-1, 3))
    before: list[bool] = np.all(seen[:, 0].reshape(-1, 8) > _NEAR_M, axis=1).tolist()
    pixels = to_fixed_point(view.project(seen)).reshape(-1, 8, 2)
    found: list[list[tuple[IntArray, Rgb]]] = [[] for _ in bodies]
    quads: list[list[tuple[float, float, float]]] = []
    owners: list[tuple[int, Rgb]] = []
    for row, (body, rgb, lights) in enumerate(zip(bodies, colours, lit, strict=True)):
        if before[row]:
            found[row].append((cv2.convexHull(pixels[row])[:, 0].astype(np.int32, copy=False), rgb))
            if body.kind is BodyKind.VEHICLE and (lights or body.braking):
                for quad, light in _light_quads(body, view, lights=lights):
                    quads.append(quad)
                    owners.append((row, light))
    if quads:
        places = view.to_camera(np.array(quads).reshape(-1, 3))
        polygons = to_fixed_point(view.project(places)).reshape(-1, 4, 2)
        near: list[bool] = np.any(places[:, 0].reshape(-1, 4) < NEAR_M, axis=1).tolist()
        for number, (row, light) in enumerate(owners):
            cut = (
                view.project_polygon(places[4 * number : 4 * number + 4])
                if near[number]
                else polygons[number]
            )
            found[row].append((cut, light))
    return found


def _light_quads(
    body: Body, view: View, *, lights: bool
) -> list[tuple[list[tuple[float, float, float]], Rgb]]:
    """Return the reflections of a vehicle's lights that face the camera: corners in the world, and colours."""
    found: list[tuple[list[tuple[float, float, float]], Rgb]] = []
    cosine, sine = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    ahead_m = (view.x_m - body.x_m) * cosine + (view.y_m - body.y_m) * sine
    across_x, across_y = -0.16 * view.sin_yaw, 0.16 * view.cos_yaw
    for (x, y, z), end in vehicle_light_positions(body):
        if ahead_m * end <= 0 or (end > 0 and not lights):
            continue
        corners = ((-1, -z - 0.5), (1, -z - 0.5), (1, -z + 0.35), (-1, -z + 0.35))
        rgb = _WHITE if end > 0 else (_BRAKE if body.braking else _RED)
        found.append(([(x + side * across_x, y + side * across_y, up) for side, up in corners], rgb))
    return found

"""Buildings: the visible walls, drawn in perspective.

A facade is drawn once at full size and then halved separately in length and height, because a wall in perspective
shrinks more sideways. All walls are placed once per frame; each building is painted when its turn comes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from brink.sim.rendering.canvas import Canvas
from brink.sim.rendering.facades import draw_facade, plain_colour, shrink_facade
from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import Building, FloatArray, IntArray, Picture, Rgb, footprint
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
        outlines: The same corners in sixteenths of a pixel, shape ``(walls, 4, 2)``.
        bounds: Left, top, right and bottom edge in pixels of each wall.
        to_wall: Homographies from image pixels to a wall's unit square, up to scale, shape ``(walls, 3, 3)``.
        shown: Whether each wall faces the camera and extends beyond the near plane.
        near: Whether each wall must be clipped at the near plane.
        haze: Share of haze of each wall.
    """

    seen: FloatArray
    outlines: IntArray
    bounds: list[list[float]]
    to_wall: FloatArray
    shown: list[bool]
    near: list[bool]
    haze: list[float]


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
        self._mask: Picture = np.zeros((height_px, width_px), np.uint8)
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
        haze: list[float] = self._lighting.haze(np.hypot(middle[:, 0], middle[:, 1])).tolist()
        shown: list[bool] = ((outward > 1e-3) & (depth.max(axis=1) > NEAR_M)).tolist()
        near: list[bool] = (depth.min(axis=1) < NEAR_M).tolist()
        return PlacedWalls(
            seen,
            to_fixed_point(pixels.reshape(-1, 2)).reshape(count, 4, 2),
            np.concatenate((pixels.min(axis=1), pixels.max(axis=1)), axis=1).tolist(),
            _inverses(to_picture),
            shown,
            near,
            haze,
        )

    def _facing(self, house: int, walls: PlacedWalls) -> list[int]:
        """Return the walls of a house that face the camera, the narrower in the image first."""
        facing = [wall for wall in range(4 * house, 4 * house + 4) if walls.shown[wall]]
        facing.sort(key=lambda wall: walls.bounds[wall][2] - walls.bounds[wall][0])
        return facing

    def paint(self, number: int, walls: PlacedWalls, canvas: Canvas, view: View) -> None:
        """Paint the walls of a building that face the camera.

        Args:
            number: Index of the building.
            walls: All walls, placed for this view.
            canvas: Painted on.
            view: The camera.
        """
        for wall in self._facing(number, walls):
            self._paint_wall(wall, walls, canvas, view)

    def mirrored(
        self, numbers: Sequence[int], walls: PlacedWalls, view: View
    ) -> dict[int, list[tuple[IntArray, Rgb]]]:
        """Return the visible walls of some buildings reflected below the ground, in one colour per wall.

        Args:
            numbers: Indices of the buildings.
            walls: All walls.
            view: The camera.
        """
        below = walls.seen.copy()
        below[:, :2] = 2 * below[:, (3, 2)] - below[:, :2]
        polygons = to_fixed_point(view.project(below.reshape(-1, 3))).reshape(-1, 4, 2)
        found: dict[int, list[tuple[IntArray, Rgb]]] = {}
        for number in numbers:
            found[number] = []
            for wall in range(4 * number, 4 * number + 4):
                if walls.shown[wall]:
                    polygon = view.project_polygon(below[wall]) if walls.near[wall] else polygons[wall]
                    found[number].append((polygon, self._plain(wall, 0.0)))
        return found

    def _plain(self, wall: int, haze: float) -> Rgb:
        """Return a wall's colour as seen through haze."""
        share = self._light[wall] * (1 - haze)
        building = self._buildings[wall // 4]
        rgb = plain_colour(building.look, self._lighting.night)
        veil = self._lighting.haze_rgb
        return (
            rgb[0] * share + veil[0] * haze,
            rgb[1] * share + veil[1] * haze,
            rgb[2] * share + veil[2] * haze,
        )

    def _texture(self, wall: int, along: int, up: int) -> Picture:
        building = self._buildings[wall // 4]
        return shrink_facade(
            building.look, *self._sizes[wall], self._lighting.night, wall % 2 == 0, along, up
        )

    def _paint_wall(self, wall: int, walls: PlacedWalls, canvas: Canvas, view: View) -> None:
        low_x, low_y, high_x, high_y = walls.bounds[wall]
        outline = walls.outlines[wall]
        if walls.near[wall]:
            pixels = view.project(clip_near(walls.seen[wall]))
            (low_x, low_y), (high_x, high_y) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
            outline = to_fixed_point(pixels)
        left, top = max(math.floor(low_x), 0), max(math.floor(low_y), 0)
        right, bottom = min(math.ceil(high_x) + 1, view.width_px), min(math.ceil(high_y) + 1, view.height_px)
        if right <= left or bottom <= top:
            return
        haze = walls.haze[wall]
        cv2.fillConvexPoly(canvas.ids, outline, (0,), cv2.LINE_8, SHIFT)
        if high_x - low_x < _PLAIN_BELOW_PX:
            cv2.fillConvexPoly(canvas.image, outline, self._plain(wall, haze), cv2.LINE_AA, SHIFT)
            return
        fit = self._fit(walls.outlines[wall], view)
        wide_px, high_px = min(high_x - low_x, 2.0 * view.width_px), min(high_y - low_y, 2.0 * view.height_px)
        texture = self._fitting_texture(wall, wide_px * fit, high_px * fit)
        size = (right - left, bottom - top)
        to_texture = _to_texture(walls.to_wall[wall].tolist(), texture.shape[1], texture.shape[0], left, top)
        coarse = high_y - low_y > _COARSE_FROM * texture.shape[0] and min(size) > 8
        warped = _warp(texture, to_texture, size, coarse=coarse)
        veil = self._veil[: size[1], : size[0]]
        cv2.addWeighted(warped, self._light[wall] * (1 - haze), veil, haze, 0.0, dst=warped)
        cv2.fillConvexPoly(self._mask, outline, (255,), cv2.LINE_8, SHIFT)
        mask = self._mask[top:bottom, left:right]
        cv2.copyTo(warped, mask, canvas.image[top:bottom, left:right])
        mask[:] = 0

    def _fit(self, outline: IntArray, view: View) -> float:
        """Return by how much finer a wall's far end is than its near end, as a factor on its size in the image.

        One texture size has to do for the whole wall. One that suits the near end would flicker at the far end.
        """
        (_, top), (_, end_top), (_, end_bottom), (_, bottom) = outline.tolist()
        near_px = min(max(bottom - top, end_bottom - end_top), (2 * view.height_px) << SHIFT)
        far_px = max(min(bottom - top, end_bottom - end_top), 1)
        return float(min(far_px / near_px, 1.0) ** 0.35) if near_px > 0 else 1.0

    def _fitting_texture(self, wall: int, wide_px: float, high_px: float) -> Picture:
        """Return the wall's texture, halved until about one texture pixel falls on one image pixel."""
        building = self._buildings[wall // 4]
        full = draw_facade(building.look, *self._sizes[wall], self._lighting.night, wall % 2 == 0)
        along = math.log2(max(full.shape[1] / max(wide_px, 1.0), 1.0))
        up = math.log2(max(full.shape[0] / max(high_px, 1.0), 1.0))
        return self._texture(wall, min(int(along + 0.3), _MAX_HALVINGS), min(int(up + 0.3), _MAX_HALVINGS))


def _quarters(length_m: float) -> float:
    """Round a length to quarter metres, so that walls of nearly the same size share a texture."""
    return max(round(length_m * 4) / 4, 0.25)


def _to_texture(to_wall: list[list[float]], wide: int, high: int, left: int, top: int) -> FloatArray:
    """Return the homography from pixels of a region at (left, top) to pixels of a wall's texture."""
    # Plain numbers, because arrays this small cost more to handle than to compute.
    (a, b, c), (d, e, f), (g, h, i) = to_wall
    c, f, i = c + left * a + top * b, f + left * d + top * e, i + left * g + top * h
    return np.array(
        [
            [wide * a - 0.5 * g, wide * b - 0.5 * h, wide * c - 0.5 * i],
            [high * d - 0.5 * g, high * e - 0.5 * h, high * f - 0.5 * i],
            [g, h, i],
        ]
    )


def _warp(texture: Picture, to_texture: FloatArray, size: tuple[int, int], *, coarse: bool) -> Picture:
    """Warp a texture into a region of the image; with `coarse`, at half size and then enlarged."""
    drawn = size
    if coarse:
        drawn = ((size[0] + 1) // 2, (size[1] + 1) // 2)
        grow_x, grow_y = size[0] / drawn[0], size[1] / drawn[1]
        to_texture[:, 2] += to_texture[:, 0] * (0.5 * grow_x - 0.5) + to_texture[:, 1] * (0.5 * grow_y - 0.5)
        to_texture[:, 0] *= grow_x
        to_texture[:, 1] *= grow_y
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(texture, to_texture, drawn, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    if coarse:
        warped = cv2.resize(warped, size, interpolation=cv2.INTER_LINEAR)
    return warped.astype(np.uint8, copy=False)


def _inverses(matrices: FloatArray) -> FloatArray:
    """Invert 3 x 3 matrices up to a scale factor, which homographies ignore; shape ``(n, 3, 3)``."""
    a, b, c = matrices[:, :, 0], matrices[:, :, 1], matrices[:, :, 2]
    return np.stack((np.cross(b, c), np.cross(c, a), np.cross(a, b)), axis=1)

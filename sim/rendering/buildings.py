"""Owns how a house comes into the picture: its visible walls, as textures in perspective."""

import math
from typing import Final, NamedTuple

import cv2
import numpy as np

from sim.rendering.canvas import Canvas, Rgb
from sim.rendering.facades import facade, shrunk
from sim.rendering.light import Lighting
from sim.rendering.scene import Building, FloatArray, Picture
from sim.rendering.view import SHIFT, IntArray, View, beyond_near, fixed_point

_MAX_HALVINGS: Final = 5
_EDGE_NEAR_M: Final = 0.3


class Wall(NamedTuple):
    """One face of a house: from start to end as seen from outside, left to right."""

    start: FloatArray
    end: FloatArray
    length_m: float
    normal: tuple[float, float]
    front: bool


def footprint(x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float) -> FloatArray:
    """Return the corners of an oriented rectangle, counter-clockwise, shape ``(4, 2)``."""
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    half_l, half_w = length_m / 2, width_m / 2
    corners = np.array([(half_l, half_w), (-half_l, half_w), (-half_l, -half_w), (half_l, -half_w)])
    return corners @ np.array([[cosine, sine], [-sine, cosine]]) + (x_m, y_m)


def walls_of(building: Building) -> list[Wall]:
    """Return the four walls of a house."""
    corners = footprint(building.x_m, building.y_m, building.yaw_rad, building.length_m, building.width_m)
    walls = []
    for number in range(4):
        # Seen from outside, a counter-clockwise outline runs from left to right.
        start, end = corners[number], corners[(number + 1) % 4]
        length = float(np.hypot(*(end - start)))
        normal = (float(end[1] - start[1]) / length, float(start[0] - end[0]) / length)
        walls.append(Wall(start, end, length, normal, number % 2 == 0))
    return walls


class Facades:
    """Paints houses under one light.

    Args:
        lighting: The light.
        width_px: Of the picture.
        height_px: Of the picture.
    """

    def __init__(self, lighting: Lighting, width_px: int, height_px: int) -> None:
        self._lighting = lighting
        self._veil: Picture = np.empty((height_px, width_px, 3), np.uint8)
        self._veil[:] = np.array(lighting.haze_rgb).astype(np.uint8)

    def paint(self, building: Building, canvas: Canvas, view: View) -> None:
        """Paint the walls that look at the camera."""
        for wall in walls_of(building):
            if (view.x_m - wall.start[0]) * wall.normal[0] + (view.y_m - wall.start[1]) * wall.normal[1] > 0:
                self._paint_wall(building, wall, canvas, view)

    def light_on(self, wall: Wall) -> float:
        """Return how bright a wall is, as a share of its texture."""
        light = self._lighting
        if light.night:
            return 1.0
        to_sun = wall.normal[0] * float(light.sun[0]) + wall.normal[1] * float(light.sun[1])
        return light.ambient_share + light.sun_share * max(to_sun, 0.0)

    def mirrored(self, building: Building, view: View) -> list[tuple[IntArray, Rgb]]:
        """Return the visible walls upside down, below the ground, in one colour each."""
        found = []
        for wall in walls_of(building):
            if (view.x_m - wall.start[0]) * wall.normal[0] + (view.y_m - wall.start[1]) * wall.normal[1] > 0:
                polygon = view.polygon(view.to_camera(_corners(wall, -building.height_m)))
                night = self._lighting.night
                mean = facade(
                    building.look, _size(wall.length_m), _size(building.height_m), night, wall.front
                )
                rgb = mean[::8, ::8].reshape(-1, 3).mean(axis=0) * self.light_on(wall)
                red, green, blue = rgb.tolist()
                found.append((polygon, (red, green, blue)))
        return found

    def _paint_wall(self, building: Building, wall: Wall, canvas: Canvas, view: View) -> None:
        seen = view.to_camera(_corners(wall, building.height_m))
        kept = beyond_near(seen)
        if len(kept) < 3:
            return
        pixels = view.pixels(kept)
        low = np.floor(pixels.min(axis=0)).astype(int)
        high = np.ceil(pixels.max(axis=0)).astype(int)
        left, top = max(int(low[0]), 0), max(int(low[1]), 0)
        right, bottom = min(int(high[0]) + 1, view.width_px), min(int(high[1]) + 1, view.height_px)
        if right <= left or bottom <= top:
            return
        texture = self._texture(building, wall, pixels)
        size = (right - left, bottom - top)
        to_texture = _to_texture(seen, texture.shape[1], texture.shape[0], view, left, top)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpPerspective(texture, to_texture, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        middle = seen.mean(axis=0)
        haze = float(self._lighting.haze(np.hypot(*np.maximum(np.abs(middle[:2]), 0.0))))
        veil = self._veil[: size[1], : size[0]]
        cv2.addWeighted(warped, self.light_on(wall) * (1 - haze), veil, haze, 0.0, dst=warped)
        mask = np.zeros((size[1], size[0]), np.uint8)
        outline = fixed_point(pixels - (left, top))
        cv2.fillConvexPoly(mask, outline, 255, cv2.LINE_8, SHIFT)
        cv2.copyTo(warped, mask, canvas.image[top:bottom, left:right])
        cv2.fillConvexPoly(canvas.ids, fixed_point(pixels), 0, cv2.LINE_8, SHIFT)

    def _texture(self, building: Building, wall: Wall, pixels: FloatArray) -> Picture:
        """Return the wall's texture, halved until about one of its pixels falls on one of the picture."""
        length, height = _size(wall.length_m), _size(building.height_m)
        night = self._lighting.night
        full = facade(building.look, length, height, night, wall.front)
        spread = pixels.max(axis=0) - pixels.min(axis=0)
        along = math.log2(max(full.shape[1] / max(float(spread[0]), 1.0), 1.0))
        up = math.log2(max(full.shape[0] / max(float(spread[1]), 1.0), 1.0))
        halvings = (min(int(along + 0.3), _MAX_HALVINGS), min(int(up + 0.3), _MAX_HALVINGS))
        return shrunk(building.look, length, height, night, wall.front, *halvings)


def _size(length_m: float) -> float:
    """Return a length to a quarter of a metre, so that walls of nearly the same size share a texture."""
    return max(round(length_m * 4) / 4, 0.25)


def _corners(wall: Wall, top_m: float) -> FloatArray:
    """Return top left, top right, bottom right, bottom left of a wall, shape ``(4, 3)``."""
    corners = np.zeros((4, 3))
    corners[0, :2] = corners[3, :2] = wall.start
    corners[1, :2] = corners[2, :2] = wall.end
    corners[:2, 2] = top_m
    return corners


def _to_texture(seen: FloatArray, wide: int, high: int, view: View, left: int, top: int) -> FloatArray:
    """Return the homography from pixels of a region at (left, top) to pixels of the wall's texture."""
    along, down, origin = (seen[1] - seen[0]) / wide, (seen[3] - seen[0]) / high, seen[0]
    corner = origin + 0.5 * (along + down)
    columns = np.stack((along, down, corner), axis=1)
    centre_x, centre_y = view.width_px / 2 - 0.5 - left, view.height_px / 2 - 0.5 - top
    lens = np.array([[centre_x, -view.focal_px, 0.0], [centre_y, 0.0, -view.focal_px], [1.0, 0.0, 0.0]])
    inverse: FloatArray = np.linalg.inv(lens @ columns)
    return inverse

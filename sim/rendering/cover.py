"""Owns what bodies do to the ground around them: shadows, the light of lamps, and their images in a wet road."""

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

import cv2
import numpy as np

from brink.sim.rendering.buildings import footprint
from brink.sim.rendering.canvas import Rgb
from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import Body, BodyKind, FloatArray, Lamp, Tree
from brink.sim.rendering.view import SHIFT, IntArray, View, beyond_near, fixed_point

_GROUND_NEAR_M: Final = 0.4
_LONGEST: Final = 3.2
"""Shadows are at most this many times as long as what casts them is high."""
_OCTAGON: Final = np.stack(
    (np.cos(np.arange(8) * np.pi / 4 + 0.39), np.sin(np.arange(8) * np.pi / 4 + 0.39)), axis=1
)
_CONTACT: Final = 128
_ARM_M: Final = 1.6
_WHITE: Final = (255.0, 246.0, 224.0)
_RED: Final = (220.0, 30.0, 26.0)
_BRAKE: Final = (255.0, 40.0, 32.0)

Shadow: TypeAlias = tuple[FloatArray, int]
"""An area of the ground, shape ``(k, 2)``, and how bright the ground in it still is, 0 to 255."""


class Caster:
    """Makes shadows of one light.

    Args:
        lighting: The light.
    """

    def __init__(self, lighting: Lighting) -> None:
        self._left = round(255 * (1 - lighting.shadow_share))
        self._contact = _CONTACT if lighting.shadow_share < 0.3 else 90
        rise = max(float(lighting.sun[2]), 1e-3)
        shift = -lighting.sun[:2] / rise
        self._shift = shift * min(_LONGEST / max(float(np.hypot(*shift)), 1e-9), 1.0)
        self._casts = lighting.shadow_share > 0.3

    def of_box(self, corners_m: FloatArray, height_m: float, *, contact: bool) -> list[Shadow]:
        """Return the shadow of an upright box, on the ground, and the dark below it, at last."""
        found: list[Shadow] = []
        if self._casts:
            found.append((self._hull(corners_m, corners_m + self._shift * height_m), self._left))
        if contact:
            middle = corners_m.mean(axis=0)
            found.append((middle + (corners_m - middle) * 1.04, self._contact))
        return found

    def of_tree(self, tree: Tree, low_m: float) -> list[Shadow]:
        """Return the shadow of a crown."""
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


def half_size(polygon: IntArray, first_row_px: int) -> IntArray:
    """Return a polygon of the picture on a sheet of half its size that begins at a row."""
    moved: IntArray = (polygon - np.array([0, first_row_px << SHIFT], np.int32)) >> 1
    return moved


def on_half_sheet(areas: Sequence[Shadow], view: View, first_row_px: int) -> list[tuple[IntArray, int]]:
    """Return the areas of the ground that are seen, as polygons of a half-size sheet that begins at a row."""
    if not areas:
        return []
    seen = view.ground_to_camera(np.concatenate([points for points, _ in areas]))
    ends = np.cumsum([0, *(len(points) for points, _ in areas)])
    nearest = np.minimum.reduceat(seen[:, 0], ends[:-1])
    half = view.width_px / 2 / view.focal_px
    beside = np.minimum.reduceat(np.abs(seen[:, 1]) - half * seen[:, 0], ends[:-1]) > 0
    left = np.minimum.reduceat(seen[:, 1], ends[:-1]) > 0
    right = np.maximum.reduceat(seen[:, 1], ends[:-1]) < 0
    gone = (np.maximum.reduceat(seen[:, 0], ends[:-1]) < _GROUND_NEAR_M) | (beside & (left | right))
    pixels = half_size(fixed_point(view.pixels(seen)), first_row_px)
    bounds = ends.tolist()
    found: list[tuple[IntArray, int]] = []
    for index, ((_, value), near) in enumerate(zip(areas, nearest.tolist(), strict=True)):
        if gone[index]:
            continue
        first, last = bounds[index], bounds[index + 1]
        if near >= _GROUND_NEAR_M:
            found.append((pixels[first:last], value))
        else:
            cut = fixed_point(view.pixels(beyond_near(seen[first:last], _GROUND_NEAR_M)))
            found.append((half_size(cut, first_row_px), value))
    return found


def lamp_pools(lamp: Lamp) -> list[Shadow]:
    """Return rings of light below a lamp and what each adds, the widest first."""
    x_m, y_m = lamp_head(lamp)
    return [
        (np.array([x_m, y_m]) + radius * lamp.height_m * _OCTAGON, value)
        for radius, value in ((1.25, 16), (0.95, 34), (0.7, 56), (0.45, 78), (0.22, 94))
    ]


def lamp_head(lamp: Lamp) -> tuple[float, float]:
    """Return where a lamp hangs."""
    return lamp.x_m + _ARM_M * float(np.cos(lamp.yaw_rad)), lamp.y_m + _ARM_M * float(np.sin(lamp.yaw_rad))


def mirrored_bodies(
    bodies: Sequence[Body], colours: Sequence[Rgb], lit: Sequence[bool], view: View
) -> list[list[tuple[IntArray, Rgb]]]:
    """Return the image of each body below the ground, plain, and those of its lights.

    Args:
        bodies: Which.
        colours: Of each.
        lit: Whether each drives with its lights on.
        view: Whence they are seen.
    """
    box = np.zeros((len(bodies), 8, 3))
    for row, body in enumerate(bodies):
        box[row, :4, :2] = box[row, 4:, :2] = footprint(
            body.x_m, body.y_m, body.yaw_rad, body.length_m, body.width_m
        )
        box[row, 4:, 2] = -body.height_m
    seen = view.to_camera(box.reshape(-1, 3))
    before: list[bool] = np.all(seen[:, 0].reshape(-1, 8) > _GROUND_NEAR_M, axis=1).tolist()
    pixels = fixed_point(view.pixels(seen)).reshape(-1, 8, 2)
    found: list[list[tuple[IntArray, Rgb]]] = []
    for row, (body, rgb, lights) in enumerate(zip(bodies, colours, lit, strict=True)):
        mine: list[tuple[IntArray, Rgb]] = []
        if before[row]:
            mine.append((cv2.convexHull(pixels[row])[:, 0].astype(np.int32, copy=False), rgb))
            if body.kind is BodyKind.VEHICLE and (lights or body.braking):
                mine += _mirrored_lights(body, view, lights=lights)
        found.append(mine)
    return found


def _mirrored_lights(body: Body, view: View, *, lights: bool) -> list[tuple[IntArray, Rgb]]:
    found: list[tuple[IntArray, Rgb]] = []
    cosine, sine = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    ahead_m = (view.x_m - body.x_m) * cosine + (view.y_m - body.y_m) * sine
    across_x, across_y = -0.16 * view.sin_yaw, 0.16 * view.cos_yaw
    for (x, y, z), end in light_places(body):
        if ahead_m * end <= 0 or (end > 0 and not lights):
            continue
        corners = ((-1, -z - 0.5), (1, -z - 0.5), (1, -z + 0.35), (-1, -z + 0.35))
        quad = np.array([(x + side * across_x, y + side * across_y, up) for side, up in corners])
        rgb = _WHITE if end > 0 else (_BRAKE if body.braking else _RED)
        found.append((view.polygon(view.to_camera(quad)), rgb))
    return found


def light_places(body: Body) -> list[tuple[tuple[float, float, float], float]]:
    """Return a vehicle's four lights: the place in the world, and 1.0 for ahead or -1.0 for behind."""
    cosine, sine = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    up = min(0.46 * body.height_m, 0.8)
    places = []
    for end, side in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        along, across = end * body.length_m / 2, side * 0.36 * body.width_m
        x_m, y_m = body.x_m + along * cosine - across * sine, body.y_m + along * sine + across * cosine
        places.append(((x_m, y_m, up), end))
    return places

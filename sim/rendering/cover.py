"""Owns what bodies do to the ground around them: shadows, the light of lamps, and their images in a wet road."""

from typing import Final

import cv2
import numpy as np

from sim.rendering.buildings import footprint
from sim.rendering.canvas import Rgb
from sim.rendering.light import Lighting
from sim.rendering.scene import Body, BodyKind, FloatArray, Lamp, Tree
from sim.rendering.view import SHIFT, IntArray, View, beyond_near, fixed_point

_GROUND_NEAR_M: Final = 0.4
_LONGEST: Final = 3.2
"""Shadows are at most this many times as long as what casts them is high."""
_OCTAGON: Final = np.stack(
    (np.cos(np.arange(8) * np.pi / 4 + 0.39), np.sin(np.arange(8) * np.pi / 4 + 0.39)), axis=1
)
_CONTACT: Final = 128
_ARM_M: Final = 1.6


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

    def of_box(
        self, corners_m: FloatArray, height_m: float, *, contact: bool
    ) -> list[tuple[FloatArray, int]]:
        """Return the shadow of an upright box, on the ground, and the dark below it, at last."""
        found: list[tuple[FloatArray, int]] = []
        if self._casts:
            found.append((self._hull(corners_m, corners_m + self._shift * height_m), self._left))
        if contact:
            middle = corners_m.mean(axis=0)
            found.append((middle + (corners_m - middle) * 1.04, self._contact))
        return found

    def of_tree(self, tree: Tree, low_m: float) -> list[tuple[FloatArray, int]]:
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


def on_ground(points_m: FloatArray, view: View) -> IntArray:
    """Return a polygon of the ground, shape ``(k, 2)``, in sixteenths of a pixel; empty if behind the camera."""
    return fixed_point(view.pixels(beyond_near(view.ground_to_camera(points_m), _GROUND_NEAR_M)))


def lamp_pools(lamp: Lamp) -> list[tuple[FloatArray, int]]:
    """Return rings of light below a lamp and what each adds, the widest first."""
    x_m, y_m = lamp_head(lamp)
    return [
        (np.array([x_m, y_m]) + radius * lamp.height_m * _OCTAGON, value)
        for radius, value in ((1.25, 16), (0.95, 34), (0.7, 56), (0.45, 78), (0.22, 94))
    ]


def lamp_head(lamp: Lamp) -> tuple[float, float]:
    """Return where a lamp hangs."""
    return lamp.x_m + _ARM_M * float(np.cos(lamp.yaw_rad)), lamp.y_m + _ARM_M * float(np.sin(lamp.yaw_rad))


def mirrored_body(body: Body, rgb: Rgb, lighting: Lighting, view: View) -> list[tuple[IntArray, Rgb]]:
    """Return a body's image below the ground, plain, and those of its lights."""
    corners = footprint(body.x_m, body.y_m, body.yaw_rad, body.length_m, body.width_m)
    box = np.zeros((8, 3))
    box[:4, :2] = box[4:, :2] = corners
    box[4:, 2] = -body.height_m
    seen = view.to_camera(box)
    if (seen[:, 0] < _GROUND_NEAR_M).any():
        return []
    hull = cv2.convexHull(view.pixels(seen).astype(np.float32))[:, 0].astype(np.float64)
    found = [(fixed_point(hull), rgb)]
    if body.kind is BodyKind.VEHICLE and (lighting.lights_on or body.braking):
        found += _mirrored_lights(body, lighting, view)
    return found


def _mirrored_lights(body: Body, lighting: Lighting, view: View) -> list[tuple[IntArray, Rgb]]:
    found: list[tuple[IntArray, Rgb]] = []
    for place, (x, y, z), front in light_places(body):
        if (view.x_m - body.x_m) * np.cos(body.yaw_rad) * front + (view.y_m - body.y_m) * np.sin(
            body.yaw_rad
        ) * front <= 0 or (front > 0 and not lighting.lights_on):
            continue
        del place
        half = 0.16
        across = (-float(np.sin(view.yaw_rad)) * half, float(np.cos(view.yaw_rad)) * half)
        quad = np.array(
            [
                (x - across[0], y - across[1], -z - 0.5),
                (x + across[0], y + across[1], -z - 0.5),
                (x + across[0], y + across[1], -z + 0.35),
                (x - across[0], y - across[1], -z + 0.35),
            ]
        )
        rgb = (
            (255.0, 246.0, 224.0)
            if front > 0
            else ((255.0, 40.0, 32.0) if body.braking else (220.0, 30.0, 26.0))
        )
        found.append((view.polygon(view.to_camera(quad)), rgb))
    return found


def light_places(body: Body) -> list[tuple[int, tuple[float, float, float], float]]:
    """Return a vehicle's four lights: number, place in the world, and 1.0 for ahead or -1.0 for behind."""
    cosine, sine = float(np.cos(body.yaw_rad)), float(np.sin(body.yaw_rad))
    places = []
    for number, (end, side) in enumerate(((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))):
        along, across = end * body.length_m / 2, side * 0.36 * body.width_m
        place = (
            body.x_m + along * cosine - across * sine,
            body.y_m + along * sine + across * cosine,
            min(0.46 * body.height_m, 0.8),
        )
        places.append((number, place, end))
    return places

"""Trees: trunks, crowns of leaves, and a fallen tree."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from brink.sim.rendering.light import Lighting
from brink.sim.rendering.scene import (
    TRUNK_SHARE,
    Body,
    Coverage,
    FloatArray,
    Mark,
    Picture,
    Stamp,
    Tree,
    choose,
)
from brink.sim.rendering.solids import draw_limbs
from brink.sim.rendering.textures import draw_leaves
from brink.sim.rendering.view import View

_CROWN_FILL: Final = 0.47
"""Radius of the crown in its texture, as a share of the texture's side."""
_BARK: Final = ((92, 74, 58), (108, 92, 74), (76, 64, 54))
_NEAREST_M: Final = 0.6
_FALLEN_STREAM: Final = 75


@lru_cache(maxsize=32)
def _tinted_leaves(
    kind: int, fallen: bool, tint: tuple[float, float, float]
) -> list[tuple[Picture, Coverage]]:
    levels = []
    for image, cover in draw_leaves(kind, fallen=fallen):
        tinted = np.clip(image * np.array(tint), 0, 255).astype(np.uint8)
        levels.append((tinted, cover))
    return levels


class TreePainter:
    """Makes the marks of trees under fixed lighting.

    Args:
        lighting: The light.
    """

    def __init__(self, lighting: Lighting) -> None:
        self._lighting = lighting
        red, green, blue = lighting.tint.tolist()
        self._tint = (red, green, blue)
        self._haze: Picture = np.empty((0, 0, 3), np.uint8)

    def trunks(self, trees: Sequence[Tree], view: View, lit: FloatArray) -> list[list[Mark]]:
        """Return the marks of each trunk, which extends a little into the crown.

        Args:
            trees: The trees.
            view: The camera.
            lit: Artificial light on each tree, in [0, 1], shape ``(n,)``.
        """
        joints = np.array([_trunk(tree) for tree in trees]).reshape(-1, 2, 3)
        radii = np.array([(0.035 * tree.height_m, 0.021 * tree.height_m) for tree in trees]).reshape(-1, 2)
        bark = np.array([_BARK[choose(tree.look, 31, len(_BARK))] for tree in trees]).reshape(-1, 3)
        colours = self._lighting.shade(bark, joints[:, 0], view, lit)
        return draw_limbs(joints, radii, colours, view, flat_feet=True)

    def crown(self, tree: Tree, view: View, lit: float) -> list[Mark]:
        """Return the marks of a tree's crown.

        Args:
            tree: The tree.
            view: The camera.
            lit: Artificial light on the crown, in [0, 1].
        """
        low = TRUNK_SHARE * tree.height_m
        tall = tree.height_m - low
        centre = (tree.x_m, tree.y_m, low + 0.5 * tall)
        levels = _tinted_leaves(choose(tree.look, 32, 8), False, self._tint)
        stamp = self._stamp(levels, centre, (tree.crown_m / 2, tall / 2), view, lit)
        return [] if stamp is None else [stamp]

    def fallen(self, body: Body, view: View, lit: float) -> list[Mark]:
        """Return the marks of a fallen tree; its crown points along the body's heading.

        Args:
            body: A body of kind `FALLEN_TREE`.
            view: The camera.
            lit: Artificial light on the tree, in [0, 1].
        """
        joints, radii, rgb, blobs = _fallen_shape(body.look, body.length_m, body.width_m, body.height_m)
        cosine, sine = math.cos(body.yaw_rad), math.sin(body.yaw_rad)

        def world(points: FloatArray) -> FloatArray:
            turned = points.copy()
            turned[..., 0] = body.x_m + cosine * points[..., 0] - sine * points[..., 1]
            turned[..., 1] = body.y_m + sine * points[..., 0] + cosine * points[..., 1]
            return turned

        parts: list[tuple[float, list[Mark]]] = []
        placed = world(joints)
        bark = np.repeat(np.array([rgb]), len(joints), axis=0)
        colours = self._lighting.shade(bark, placed.mean(axis=1), view, np.full(len(joints), lit))
        depths = view.to_camera(placed.mean(axis=1))[:, 0].tolist()
        parts += zip(depths, draw_limbs(placed, radii, colours, view, flat_feet=False), strict=True)
        levels = _tinted_leaves(choose(body.look, 33, 4), True, self._tint)
        for centre, half in zip(world(blobs[:, :3]), blobs[:, 3:], strict=True):
            place = (float(centre[0]), float(centre[1]), float(centre[2]))
            stamp = self._stamp(levels, place, (float(half[0]), float(half[1])), view, lit)
            if stamp is not None:
                parts.append((float(view.to_camera(centre[None])[0, 0]), [stamp]))
        parts.sort(key=lambda part: -part[0])
        return [mark for _, marks in parts for mark in marks]

    def _stamp(
        self,
        levels: list[tuple[Picture, Coverage]],
        centre_m: tuple[float, float, float],
        half_m: tuple[float, float],
        view: View,
        lit: float,
    ) -> Stamp | None:
        """Return the leaves that fill an upright ellipse, cropped to the image; None if out of view."""
        depth, left_m, up_m = view.point_to_camera(*centre_m)
        if depth < _NEAREST_M:
            return None
        column = view.width_px / 2 - 0.5 - left_m * view.focal_px / depth
        row = view.height_px / 2 - 0.5 - up_m * view.focal_px / depth
        scale = view.focal_px / depth / (2 * _CROWN_FILL)
        wide, high = 2 * half_m[0] * scale, 2 * half_m[1] * scale
        left, top = max(math.floor(column - wide / 2), 0), max(math.floor(row - high / 2), 0)
        right = min(math.ceil(column + wide / 2) + 1, view.width_px)
        bottom = min(math.ceil(row + high / 2) + 1, view.height_px)
        if right - left < 1 or bottom - top < 1:
            return None
        image, cover = next(
            (level for level in reversed(levels) if level[1].shape[0] >= 0.8 * max(wide, high)), levels[0]
        )
        side = cover.shape[0]
        per_x, per_y = side / wide, side / high
        to_texture = np.array(
            [
                [per_x, 0.0, (left - column + wide / 2 + 0.5) * per_x - 0.5],
                [0.0, per_y, (top - row + high / 2 + 0.5) * per_y - 0.5],
            ]
        )
        size = (right - left, bottom - top)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        pixels = cv2.warpAffine(image, to_texture, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        covered = cv2.warpAffine(cover, to_texture, size, flags=flags, borderMode=cv2.BORDER_CONSTANT)
        light = self._lighting
        haze = 1.0 - math.exp(-math.hypot(depth, left_m) / light.haze_m)
        share = light.ambient_strength + 0.55 * light.sun_strength + 0.7 * lit
        veil = self._veil(size)
        mixed = cv2.addWeighted(pixels, share * (1 - haze), veil, haze, 0.0)
        mask = cv2.threshold(covered, 127, 255, cv2.THRESH_BINARY)[1]
        return Stamp(left, top, mixed.astype(np.uint8, copy=False), mask.astype(np.uint8, copy=False))

    def _veil(self, size: tuple[int, int]) -> Picture:
        """Return a plain haze-coloured image of the given size (width, height)."""
        rows, columns = max(size[1], self._haze.shape[0]), max(size[0], self._haze.shape[1])
        if (rows, columns) != self._haze.shape[:2]:
            self._haze = np.empty((rows, columns, 3), np.uint8)
            self._haze[:] = np.array(self._lighting.haze_rgb).astype(np.uint8)
        return self._haze[: size[1], : size[0]]


def _trunk(tree: Tree) -> list[tuple[float, float, float]]:
    return [(tree.x_m, tree.y_m, 0.0), (tree.x_m, tree.y_m, 0.6 * tree.height_m)]


@lru_cache(maxsize=64)
def _fallen_shape(
    look: int, length_m: float, width_m: float, height_m: float
) -> tuple[FloatArray, FloatArray, tuple[float, float, float], FloatArray]:
    """Return limbs, their radii, the bark colour, and the leaves of a fallen tree.

    Returns:
        Limbs, shape ``(n, 2, 3)``; radii, shape ``(n, 2)``; colour; centres and half sizes of leaves, ``(m, 5)``.
    """
    rng = np.random.default_rng((look & 0xFFFFFFFF, _FALLEN_STREAM))
    thick = min(0.17 * height_m, 0.045 * length_m)
    root, tip = -0.5 * length_m + thick, 0.42 * length_m
    lift = thick + 0.01
    limbs = []
    for number in range(3):
        a, b = number / 3, (number + 1) / 3
        bend = 0.03 * width_m * np.sin(3.0 * np.array([a, b]))
        start = (root + a * (tip - root), bend[0], lift * (1 + 0.6 * a))
        end = (root + b * (tip - root), bend[1], lift * (1 + 0.6 * b))
        limbs.append((start, end, thick * (1 - 0.55 * a), thick * (1 - 0.55 * b)))
    for _ in range(6):
        angle, reach = rng.uniform(0, 2 * math.pi), rng.uniform(0.6, 0.95)
        side = np.clip(0.5 * height_m * reach * np.sin(angle) + lift, 0.03, 0.9 * height_m)
        limbs.append(
            (
                (root, 0.0, lift),
                (root - 0.4 * thick, 0.34 * width_m * reach * np.cos(angle), side),
                0.42 * thick,
                0.16 * thick,
            )
        )
    for _ in range(4):
        x = rng.uniform(-0.1, 0.3) * length_m
        out = rng.uniform(0.25, 0.46) * width_m * rng.choice((-1.0, 1.0))
        top = rng.uniform(0.2, 0.9) * height_m
        limbs.append(((x, 0.0, lift), (x + 0.12 * length_m, out, top), 0.26 * thick, 0.10 * thick))
    blobs = []
    for _ in range(20):
        x = rng.uniform(-0.06, 0.38) * length_m
        half = rng.uniform(0.24, 0.40) * height_m
        wide = min(half * rng.uniform(1.0, 1.4), 0.12 * length_m, 0.4 * width_m)
        y = rng.uniform(-1.0, 1.0) * max(0.5 * width_m - wide, 0.0)
        z = rng.uniform(half, max(height_m - half, half + 1e-6))
        blobs.append((x, y, z, wide, half))
    joints = np.array([(start, end) for start, end, _, _ in limbs], dtype=np.float64)
    radii = np.array([(a, b) for _, _, a, b in limbs], dtype=np.float64)
    return joints, radii, _BARK[choose(look, 34, len(_BARK))], np.array(blobs)

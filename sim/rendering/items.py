"""Owns what stands in a street as items of the painter's order: footprint, height, and from where it is drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.buildings import footprint
from brink.sim.rendering.foliage import TRUNK_SHARE
from brink.sim.rendering.order import paint_order
from brink.sim.rendering.scene import Body, Building, FloatArray, Lamp, StreetScene, Tree
from brink.sim.rendering.view import NEAR_M, View

_BODY_FAR_M: Final = 140.0
_HOUSE_FAR_M: Final = 260.0
_TRUNK_WIDTH: Final = 0.07
_LAMP_WIDTH_M: Final = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class House:
    """A building and its place in the scene's list."""

    number: int
    building: Building


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crown:
    """The upper part of a tree: it takes its own place in the order."""

    tree: Tree


Thing: TypeAlias = Body | House | Tree | Crown | Lamp


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Items:
    """Things with where they stand.

    Attributes:
        things: What they are.
        corners: Footprints, counter-clockwise, shape ``(n, 4, 2)``.
        heights: Bottom and top, shape ``(n, 2)``.
        far_m: From which distance they are left out, shape ``(n,)``.
    """

    things: tuple[Thing, ...]
    corners: FloatArray
    heights: FloatArray
    far_m: FloatArray

    def joined(self, other: "Items") -> "Items":
        """Return these and then others."""
        return Items(
            things=self.things + other.things,
            corners=np.concatenate((self.corners, other.corners)),
            heights=np.concatenate((self.heights, other.heights)),
            far_m=np.concatenate((self.far_m, other.far_m)),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenItems:
    """What may be seen from one place, in painting order.

    Attributes:
        things: What they are.
        centres: Of their footprints, shape ``(n, 2)``.
        depths: Of their nearest corners, shape ``(n,)``; negative where they reach behind the camera.
    """

    things: tuple[Thing, ...]
    centres: FloatArray
    depths: FloatArray


_Row: TypeAlias = tuple[Thing, FloatArray, float, float, float]


def items_of(scene: StreetScene) -> Items:
    """Return all that stands and never moves."""
    rows: list[_Row] = []
    for number, house in enumerate(scene.buildings):
        corners = footprint(house.x_m, house.y_m, house.yaw_rad, house.length_m, house.width_m)
        rows.append((House(number=number, building=house), corners, 0.0, house.height_m, _HOUSE_FAR_M))
    for tree in scene.trees:
        low, thick = TRUNK_SHARE * tree.height_m, _TRUNK_WIDTH * tree.height_m
        trunk = footprint(tree.x_m, tree.y_m, 0.0, thick, thick)
        crown = footprint(tree.x_m, tree.y_m, 0.0, tree.crown_m, tree.crown_m)
        rows.append((tree, trunk, 0.0, low, _BODY_FAR_M))
        rows.append((Crown(tree=tree), crown, low, tree.height_m, _HOUSE_FAR_M))
    for lamp in scene.lamps:
        post = footprint(lamp.x_m, lamp.y_m, 0.0, _LAMP_WIDTH_M, _LAMP_WIDTH_M)
        rows.append((lamp, post, 0.0, lamp.height_m, _BODY_FAR_M))
    return _stacked(rows).joined(body_items(scene.parked))


def body_items(bodies: Sequence[Body]) -> Items:
    """Return bodies as items, by id: the order in which they are given must not matter."""
    ordered = sorted(bodies, key=lambda body: body.id)
    return _stacked(
        [
            (
                body,
                footprint(body.x_m, body.y_m, body.yaw_rad, body.length_m, body.width_m),
                0.0,
                body.height_m,
                _BODY_FAR_M,
            )
            for body in ordered
        ]
    )


def _stacked(rows: list[_Row]) -> Items:
    return Items(
        things=tuple(row[0] for row in rows),
        corners=np.array([row[1] for row in rows]).reshape(-1, 4, 2),
        heights=np.array([row[2:4] for row in rows]).reshape(-1, 2),
        far_m=np.array([row[4] for row in rows]),
    )


def in_order(items: Items, view: View) -> SeenItems:
    """Return what may be seen, in painting order."""
    if not items.things:
        return SeenItems(things=(), centres=np.zeros((0, 2)), depths=np.zeros(0))
    rows, columns, nearest = _in_view(items, view)
    eye = (view.x_m, view.y_m, view.height_m)
    order = rows[paint_order(items.corners[rows], items.heights[rows], columns, eye)]
    return SeenItems(
        things=tuple(items.things[row] for row in order.tolist()),
        centres=items.corners[order].mean(axis=1),
        depths=nearest[order],
    )


def _in_view(items: Items, view: View) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return which items may be seen, the columns each of them may touch, ``(k, 2)``, and all nearest depths."""
    count = len(items.things)
    points = np.empty((count, 8, 3))
    points[:, :4, :2] = points[:, 4:, :2] = items.corners
    points[:, :4, 2] = items.heights[:, 0, None]
    points[:, 4:, 2] = items.heights[:, 1, None]
    seen = view.to_camera(points.reshape(-1, 3))
    pixels = view.pixels(seen)[:, 0].reshape(count, 8)
    depth, left = seen[:, 0].reshape(count, 8), seen[:, 1].reshape(count, 8)
    nearest, farthest = depth.min(axis=1), depth.max(axis=1)
    crosses = nearest < NEAR_M
    first = np.where(crosses, -1.0, pixels.min(axis=1) - 2)
    last = np.where(crosses, view.width_px, pixels.max(axis=1) + 2)
    half = view.width_px / 2 / view.focal_px
    beside = (left > half * depth).all(axis=1) | (left < -half * depth).all(axis=1)
    seen_at_all = (farthest > NEAR_M) & (nearest < items.far_m) & (first < view.width_px) & (last > 0)
    # A lamp's arm and a crown's leaves may reach beyond their footprints: only what is far outside is dropped.
    rows = np.flatnonzero(seen_at_all & ~(beside & (first < last)))
    return rows, np.stack((first, last), axis=1)[rows], nearest

"""Painter's order: which objects may be in view, and in which order they are painted.

If a plane separates two objects, the one on the camera's side can never be hidden by the other. An object is painted
before another exactly if the other may hide it, that is, if no plane rules that out. Vertical planes through the
edges of the footprints and horizontal planes between heights are tried. If two planes disagree, neither object hides
the other and their order is free. Objects that no plane separates overlap; the one with the nearer centre is then
painted later.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.scene import (
    TRUNK_SHARE,
    Body,
    Building,
    FloatArray,
    Furniture,
    Lamp,
    StreetScene,
    TrafficLight,
    Tree,
    footprint,
)
from brink.sim.rendering.view import NEAR_M, View

_BODY_FAR_M: Final = 140.0
_HOUSE_FAR_M: Final = 260.0
_FURNITURE_FAR_M: Final = 50.0
_TRUNK_WIDTH: Final = 0.07
_LAMP_WIDTH_M: Final = 0.2
_TRAFFIC_LIGHT_WIDTH_M: Final = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class House:
    """A building and its index in the scene."""

    number: int
    building: Building


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crown:
    """The upper part of a tree, which is ordered separately from its trunk."""

    tree: Tree


Separated: TypeAlias = NDArray[np.bool_]
"""For each edge of each object, whether another object lies outside it, shape ``(n, 4, m)``."""

Thing: TypeAlias = Body | House | Tree | Crown | Lamp | TrafficLight | Furniture


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Items:
    """Objects and their positions.

    Attributes:
        things: The objects.
        corners: Footprints, counter-clockwise, shape ``(n, 4, 2)``.
        heights: Bottom and top, shape ``(n, 2)``.
        far_m: Distance beyond which an object is not drawn, shape ``(n,)``.
    """

    things: tuple[Thing, ...]
    corners: FloatArray
    heights: FloatArray
    far_m: FloatArray

    def joined(self, other: "Items") -> "Items":
        """Return these items followed by the other items."""
        return Items(
            things=self.things + other.things,
            corners=np.concatenate((self.corners, other.corners)),
            heights=np.concatenate((self.heights, other.heights)),
            far_m=np.concatenate((self.far_m, other.far_m)),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VisibleItems:
    """Objects that may be visible from one viewpoint, in painting order.

    Attributes:
        things: The objects.
        centres: Centres of their footprints, shape ``(n, 2)``.
        depths: Depths of their nearest corners, shape ``(n,)``; negative behind the camera.
    """

    things: tuple[Thing, ...]
    centres: FloatArray
    depths: FloatArray


_Row: TypeAlias = tuple[Thing, FloatArray, float, float, float]


def make_static_items(scene: StreetScene) -> Items:
    """Return the items for all static objects."""
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
    for light in scene.traffic_lights:
        post = footprint(light.x_m, light.y_m, light.yaw_rad, _TRAFFIC_LIGHT_WIDTH_M, _TRAFFIC_LIGHT_WIDTH_M)
        rows.append((light, post, 0.0, light.height_m, _BODY_FAR_M))
    for item in scene.furniture:
        corners = footprint(item.x_m, item.y_m, item.yaw_rad, item.length_m, item.width_m)
        rows.append((item, corners, 0.0, item.height_m, _FURNITURE_FAR_M))
    return _stacked(rows).joined(make_body_items(scene.parked))


def make_body_items(bodies: Sequence[Body]) -> Items:
    """Return the items for bodies, sorted by id so that the order of the input does not matter."""
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


def cull_and_sort(items: Items, view: View, apart: Separated) -> VisibleItems:
    """Return the items that may be visible, in painting order.

    Args:
        items: The items.
        view: The camera.
        apart: Which edges separate the first of the items, those that never move, from each other.
    """
    if not items.things:
        return VisibleItems(things=(), centres=np.zeros((0, 2)), depths=np.zeros(0))
    rows, columns, nearest = _in_view(items, view)
    eye = (view.x_m, view.y_m, view.height_m)
    corners = items.corners[rows]
    still = rows[: np.searchsorted(rows, len(apart))]
    moving = corners[len(still) :]
    edges = np.empty((len(rows), 4, len(rows)), dtype=bool)
    edges[: len(still), :, : len(still)] = apart[still][:, :, still]
    edges[len(still) :] = separated(moving, corners)
    edges[: len(still), :, len(still) :] = separated(corners[: len(still)], moving)
    order = rows[paint_order(corners, items.heights[rows], columns, eye, edges)]
    return VisibleItems(
        things=tuple(items.things[row] for row in order.tolist()),
        centres=items.corners[order].mean(axis=1),
        depths=nearest[order],
    )


def _in_view(items: Items, view: View) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Find the items that may be visible.

    Returns:
        Indices of these items, shape ``(k,)``; their column ranges, shape ``(k, 2)``; nearest depths of all items.
    """
    count = len(items.things)
    points = np.empty((count, 8, 3))
    points[:, :4, :2] = points[:, 4:, :2] = items.corners
    points[:, :4, 2] = items.heights[:, 0, None]
    points[:, 4:, 2] = items.heights[:, 1, None]
    seen = view.to_camera(points.reshape(-1, 3))
    pixels = view.project(seen)[:, 0].reshape(count, 8)
    depth, left = seen[:, 0].reshape(count, 8), seen[:, 1].reshape(count, 8)
    nearest, farthest = depth.min(axis=1), depth.max(axis=1)
    crosses = nearest < NEAR_M
    first = np.where(crosses, -1.0, pixels.min(axis=1) - 2)
    last = np.where(crosses, view.width_px, pixels.max(axis=1) + 2)
    half = view.width_px / 2 / view.focal_px
    beside = (left > half * depth).all(axis=1) | (left < -half * depth).all(axis=1)
    in_range = (farthest > NEAR_M) & (nearest < items.far_m) & (first < view.width_px) & (last > 0)
    # A lamp's arm and a crown's leaves may extend beyond the footprint, so only items well outside are dropped.
    rows = np.flatnonzero(in_range & ~(beside & (first < last)))
    return rows, np.stack((first, last), axis=1)[rows], nearest


_SLACK_M = 0.03


def paint_order(
    corners_m: FloatArray,
    heights_m: FloatArray,
    columns_px: FloatArray,
    eye_m: tuple[float, float, float],
    apart: Separated | None = None,
) -> list[int]:
    """Return the order in which objects are painted, first to last.

    Args:
        corners_m: Footprints, convex and counter-clockwise, shape ``(n, 4, 2)``.
        heights_m: Bottom and top of each object, shape ``(n, 2)``.
        columns_px: First and last image column that each object may touch, shape ``(n, 2)``.
        eye_m: Position of the camera.
        apart: Which edges separate the objects, shape ``(n, 4, n)``; computed if it is left out.

    Returns:
        Indices; objects with no required order are painted farthest first, and ties by index.
    """
    count = len(corners_m)
    if count < 2:
        return list(range(count))
    distance = np.hypot(*(corners_m.mean(axis=1) - eye_m[:2]).T)
    hides = _may_hide(
        corners_m, heights_m, columns_px, eye_m, separated(corners_m, corners_m) if apart is None else apart
    )
    both = hides & hides.T
    nearer = (distance[:, None] < distance[None, :]) | (
        (distance[:, None] == distance[None, :]) & (np.arange(count)[:, None] > np.arange(count)[None, :])
    )
    hides &= ~both | nearer
    return _sort_topologically(hides, distance.tolist())


def separated(corners_m: FloatArray, others_m: FloatArray) -> Separated:
    """Return for each edge of each object whether another object lies entirely outside it.

    Args:
        corners_m: Footprints of the objects, convex and counter-clockwise, shape ``(n, 4, 2)``.
        others_m: Footprints of the other objects, shape ``(m, 4, 2)``.

    Returns:
        Shape ``(n, 4, m)``.
    """
    normals, offsets = _edges(corners_m)
    # Written out because a threaded matrix product costs more than it saves at these sizes.
    x_m, y_m = others_m[..., 0], others_m[..., 1]
    normal_x, normal_y = normals[..., 0][..., None], normals[..., 1][..., None]
    nearest = normal_x * x_m[:, 0] + normal_y * y_m[:, 0]
    for corner in (1, 2, 3):
        np.minimum(nearest, normal_x * x_m[:, corner] + normal_y * y_m[:, corner], out=nearest)
    nearest -= offsets[:, :, None]
    apart: Separated = nearest >= -_SLACK_M
    return apart


def _edges(corners_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the outward normals of all edges, shape ``(n, 4, 2)``, and their offsets, shape ``(n, 4)``."""
    edges = np.roll(corners_m, -1, axis=1) - corners_m
    normals = np.stack((edges[..., 1], -edges[..., 0]), axis=-1)
    normals /= np.maximum(np.hypot(normals[..., 0], normals[..., 1]), 1e-9)[..., None]
    return normals, np.einsum("aek,aek->ae", normals, corners_m)


def _may_hide(
    corners_m: FloatArray,
    heights_m: FloatArray,
    columns_px: FloatArray,
    eye_m: tuple[float, float, float],
    apart: Separated,
) -> NDArray[np.bool_]:
    """Return for each pair of objects whether the first may hide the second, shape ``(n, n)``."""
    count = len(corners_m)
    normals, offsets = _edges(corners_m)
    eye_outside = normals[..., 0] * eye_m[0] + normals[..., 1] * eye_m[1] > offsets
    hides = np.ones((count, count), dtype=bool)
    hides &= ~(apart & eye_outside[:, :, None]).any(axis=1)
    hides &= ~(apart & ~eye_outside[:, :, None]).any(axis=1).T
    below = heights_m[:, 1][:, None] <= heights_m[:, 0][None, :] + _SLACK_M
    hides &= ~(below & (eye_m[2] >= heights_m[:, 1])[:, None])
    hides &= ~(below & (eye_m[2] <= heights_m[:, 0])[None, :]).T
    hides &= columns_px[:, 0][:, None] <= columns_px[:, 1][None, :]
    hides &= columns_px[:, 0][None, :] <= columns_px[:, 1][:, None]
    np.fill_diagonal(hides, False)
    return hides


def _sort_topologically(hides: NDArray[np.bool_], distance: list[float]) -> list[int]:
    """Sort hidden objects before those that hide them; a cycle is broken at its farthest member."""
    count = len(distance)
    waits = hides.sum(axis=1).tolist()
    hidden, hiding = np.nonzero(hides.T)
    ends = np.searchsorted(hidden, np.arange(count + 1)).tolist()
    in_front: list[int] = hiding.tolist()
    ready = [(-distance[i], i) for i in range(count) if waits[i] == 0]
    heapq.heapify(ready)
    done = [False] * count
    order: list[int] = []
    while len(order) < count:
        if ready:
            index = heapq.heappop(ready)[1]
        else:
            index = min((i for i in range(count) if not done[i]), key=lambda i: (-distance[i], i))
        if done[index]:
            continue
        done[index] = True
        order.append(index)
        for nearer in in_front[ends[index] : ends[index + 1]]:
            waits[nearer] -= 1
            if waits[nearer] == 0 and not done[nearer]:
                heapq.heappush(ready, (-distance[nearer], nearer))
    return order

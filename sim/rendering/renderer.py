"""Owns a frame: from a street, a light and a place to the picture and the id mask.

Ground and sky are painted first; then everything that stands, statics and bodies alike, in painter's order; at last
glows, rain and grain, which change the picture and never the mask.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import cv2
import numpy as np

from sim.rendering.buildings import Facades, footprint
from sim.rendering.canvas import Canvas, Mark, Outline, Rgb, Stroke
from sim.rendering.cover import (
    Caster,
    half_size,
    lamp_head,
    lamp_pools,
    light_places,
    mirrored_body,
    on_ground,
)
from sim.rendering.foliage import TRUNK_SHARE, Foliage
from sim.rendering.ground import GroundCover, GroundPainter, headlight_share
from sim.rendering.light import lighting_of
from sim.rendering.meshes import Placed, mesh_marks
from sim.rendering.order import paint_order
from sim.rendering.people import person_marks
from sim.rendering.rain import Air
from sim.rendering.scene import (
    Body,
    BodyKind,
    Building,
    FloatArray,
    Frame,
    Lamp,
    Light,
    Picture,
    PictureCamera,
    StreetScene,
    Tree,
    Viewpoint,
    check_unique,
)
from sim.rendering.sky import Sky
from sim.rendering.vehicles import overturned_mesh, paint_of, vehicle_mesh
from sim.rendering.view import NEAR_M, IntArray, View, view_from

_BODY_FAR_M: Final = 150.0
_HOUSE_FAR_M: Final = 260.0
_SHADOW_FAR_M: Final = 60.0
_MESHES: Final = {BodyKind.VEHICLE: vehicle_mesh, BodyKind.OVERTURNED_VEHICLE: overturned_mesh}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Crown:
    """The upper part of a tree: it takes its own place in the order."""

    tree: Tree


_Thing: TypeAlias = Body | Building | Tree | _Crown | Lamp


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Item:
    """Something that stands: footprint (4, 2), bottom and top, and how far away it is drawn."""

    thing: _Thing
    corners: FloatArray
    low_m: float
    high_m: float
    far_m: float


class Renderer:
    """Makes pictures of one street under one light.

    Args:
        scene: All that does not move.
        light: Sun and sky.
        camera: The ego's.
        seed: Of textures, clouds, rain and where the sun stands.

    Raises:
        InvalidScene: An id occurs twice.
    """

    def __init__(self, scene: StreetScene, light: Light, camera: PictureCamera, seed: int) -> None:
        self.camera = camera
        self._lighting = lighting_of(light, seed)
        self._sky = Sky(self._lighting, camera, seed)
        self._ground = GroundPainter(scene.ground, self._lighting, camera, seed)
        self._facades = Facades(self._lighting, camera.width_px, camera.height_px)
        self._foliage = Foliage(self._lighting)
        self._air = Air(self._lighting, camera, seed)
        self._caster = Caster(self._lighting)
        self._parked_ids = tuple(body.id for body in scene.parked)
        self._statics = _static_items(scene)
        self._lamps = scene.lamps if self._lighting.night else ()
        self._glow = _glow_texture()

    def frame(self, viewpoint: Viewpoint, bodies: Sequence[Body], time_s: float) -> Frame:
        """Return what the camera sees.

        Args:
            viewpoint: Where the ego is.
            bodies: All that moves, the ego not included, in any order.
            time_s: Time in the episode: it moves the rain.

        Raises:
            InvalidScene: An id occurs twice, parked vehicles included.
        """
        check_unique((*self._parked_ids, *(body.id for body in bodies)))
        view = view_from(self.camera, viewpoint)
        moving = [_body_item(body) for body in sorted(bodies, key=lambda body: body.id)]
        items, columns, depths = _in_view([*self._statics, *moving], view)
        shape = (self.camera.height_px, self.camera.width_px)
        canvas = Canvas(image=np.empty((*shape, 3), np.uint8), ids=np.zeros(shape, np.int32))
        self._sky.paint(canvas.image, view)
        order = _ordered(items, columns, view)
        shadowed = _near([*self._statics, *moving], view)
        self._ground.paint(canvas.image, view, self._cover(shadowed, [items[i] for i in order], view))
        outlines = self._paint_items(canvas, items, depths, order, view)
        self._paint_glows(canvas, [items[i] for i in order], view)
        self._air.lay(canvas.image, time_s)
        return Frame(image=canvas.image, ids=canvas.ids, outlines=outlines)

    def _paint_items(
        self, canvas: Canvas, items: list[_Item], depths: FloatArray, order: list[int], view: View
    ) -> dict[int, Outline]:
        lit = self._lit(items, view)
        marks = self._marks(items, lit, view)
        outlines: dict[int, Outline] = {}
        for index in order:
            thing = items[index].thing
            if isinstance(thing, Building):
                self._facades.paint(thing, canvas, view)
            elif isinstance(thing, Body):
                canvas.paint(marks[index], thing.id)
                outlines[thing.id] = Outline(
                    kind=thing.kind, depth_m=max(float(depths[index]), 0.0), marks=tuple(marks[index])
                )
            else:
                canvas.paint(marks[index], 0)
        return outlines

    def _marks(self, items: list[_Item], lit: FloatArray, view: View) -> dict[int, list[Mark]]:
        """Return the marks of everything but houses, by its place in `items`."""
        marks: dict[int, list[Mark]] = {}
        solids: list[tuple[int, Placed]] = []
        people: list[tuple[int, Body]] = []
        for index, item in enumerate(items):
            thing = item.thing
            if isinstance(thing, Tree):
                marks[index] = self._foliage.trunk(thing, view, float(lit[index]))
            elif isinstance(thing, _Crown):
                marks[index] = self._foliage.crown(thing.tree, view, float(lit[index]))
            elif isinstance(thing, Lamp):
                marks[index] = self._lamp_marks(thing, float(lit[index]), view)
            elif isinstance(thing, Body):
                if thing.kind is BodyKind.PERSON:
                    people.append((index, thing))
                elif thing.kind is BodyKind.FALLEN_TREE:
                    marks[index] = self._foliage.fallen(thing, view, float(lit[index]))
                else:
                    solids.append((index, _placed(thing)))
        rows = [index for index, _ in solids]
        placed = [model for _, model in solids]
        marks.update(zip(rows, mesh_marks(placed, view, self._lighting, lit[rows]), strict=True))
        rows = [index for index, _ in people]
        persons = [body for _, body in people]
        marks.update(zip(rows, person_marks(persons, view, self._lighting, lit[rows]), strict=True))
        return marks

    def _lit(self, items: list[_Item], view: View) -> FloatArray:
        """Return how strongly each item is lit by the ego's headlights and by street lamps."""
        if not self._lighting.night or not items:
            return np.zeros(len(items))
        places = np.array([item.corners.mean(axis=0) for item in items])
        dx, dy = places[:, 0] - view.x_m, places[:, 1] - view.y_m
        lit = headlight_share(dx * view.cos_yaw + dy * view.sin_yaw, dy * view.cos_yaw - dx * view.sin_yaw)
        for lamp in self._lamps:
            x_m, y_m = lamp_head(lamp)
            distance = np.hypot(places[:, 0] - x_m, places[:, 1] - y_m) / lamp.height_m
            lit = lit + 0.34 * np.exp(-(distance**2))
        clipped: FloatArray = np.clip(lit, 0.0, 1.0)
        return clipped

    def _lamp_marks(self, lamp: Lamp, lit: float, view: View) -> list[Mark]:
        x_m, y_m = lamp_head(lamp)
        top = (lamp.x_m, lamp.y_m, lamp.height_m)
        joints = np.array([[(lamp.x_m, lamp.y_m, 0.0), top], [top, (x_m, y_m, lamp.height_m + 0.1)]])
        radii = np.array([(0.085, 0.055), (0.05, 0.04)])
        marks = self._foliage.limbs(joints, radii, (92, 96, 98), view, lit)
        across = (0.16 * math.sin(lamp.yaw_rad), 0.16 * math.cos(lamp.yaw_rad))
        ahead = (0.45 * math.cos(lamp.yaw_rad), 0.45 * math.sin(lamp.yaw_rad))
        head = np.array(
            [
                (x_m + a * ahead[0] - b * across[0], y_m + a * ahead[1] + b * across[1], lamp.height_m + 0.04)
                for a, b in ((-0.3, -1), (1, -1), (1, 1), (-0.3, 1))
            ]
        )
        rgb = (255.0, 232.0, 184.0) if self._lamps else (150.0, 152.0, 154.0)
        marks.append(Stroke(view.polygon(view.to_camera(head)), rgb, True))
        return marks

    def _cover(self, near: list[_Item], ordered: list[_Item], view: View) -> GroundCover:
        """Return what lies on the ground: hard shadows first, the dark below bodies after them."""
        first_row = min(max(math.ceil(view.horizon_px), 0), view.height_px)
        shadows: list[tuple[FloatArray, int]] = []
        for item in near:
            thing = item.thing
            if isinstance(thing, _Crown):
                shadows += self._caster.of_tree(thing.tree, item.low_m)
            elif isinstance(thing, Body | Building):
                shadows += self._caster.of_box(item.corners, item.high_m, contact=isinstance(thing, Body))
        shadows.sort(key=lambda shadow: -shadow[1])
        pools = [pool for lamp in self._lamps for pool in lamp_pools(lamp)]
        pools.sort(key=lambda pool: pool[1])
        mirrored = self._mirrored(ordered, view) if self._lighting.wet else []
        return GroundCover(
            shadows=_projected(shadows, view, first_row),
            pools=_projected(pools, view, first_row),
            mirrored=[(half_size(points, first_row), rgb) for points, rgb in mirrored if len(points) > 2],
        )

    def _mirrored(self, ordered: list[_Item], view: View) -> list[tuple[IntArray, Rgb]]:
        found = []
        light = self._lighting
        share = light.ambient_share + 0.4 * light.sun_share
        for item in ordered:
            thing = item.thing
            if isinstance(thing, Building):
                found += self._facades.mirrored(thing, view)
            elif isinstance(thing, Body):
                rgb = (
                    paint_of(thing.look, thing.height_m)
                    if thing.kind is BodyKind.VEHICLE
                    else (70.0, 68.0, 62.0)
                )
                shade = (rgb[0] * share * 0.7, rgb[1] * share * 0.7, rgb[2] * share * 0.7)
                found += mirrored_body(thing, shade, light, view)
        return found

    def _paint_glows(self, canvas: Canvas, items: list[_Item], view: View) -> None:
        """Lay halos around the lights that are seen: those whose pixel belongs to their body."""
        if not (self._lighting.lights_on or self._lamps):
            return
        strength = 1.0 if self._lighting.night else 0.4
        for item in items:
            thing = item.thing
            if isinstance(thing, Lamp) and self._lamps:
                x_m, y_m = lamp_head(thing)
                self._glow_at(canvas, (x_m, y_m, thing.height_m), 1.5, (230.0, 190.0, 120.0), 0, view)
            elif isinstance(thing, Body) and thing.kind is BodyKind.VEHICLE:
                ahead = (view.x_m - thing.x_m) * math.cos(thing.yaw_rad) + (view.y_m - thing.y_m) * math.sin(
                    thing.yaw_rad
                )
                for _, place, end in light_places(thing):
                    if ahead * end <= thing.length_m / 2:
                        continue
                    rgb = (
                        (220.0, 214.0, 196.0)
                        if end > 0
                        else ((200.0, 30.0, 20.0) if thing.braking else (120.0, 12.0, 10.0))
                    )
                    shine = (rgb[0] * strength, rgb[1] * strength, rgb[2] * strength)
                    self._glow_at(canvas, place, 0.75 if end > 0 else 0.4, shine, thing.id, view)

    def _glow_at(
        self,
        canvas: Canvas,
        place: tuple[float, float, float],
        size_m: float,
        rgb: Rgb,
        number: int,
        view: View,
    ) -> None:
        seen = view.to_camera(np.array([place]))
        if seen[0, 0] < 1.0:
            return
        column, row = view.pixels(seen)[0].tolist()
        x, y = round(column), round(row)
        if not (0 <= x < view.width_px and 0 <= y < view.height_px) or canvas.ids[y, x] != number:
            return
        half = round(
            min(max(size_m * view.focal_px / float(seen[0, 0]), 0.008 * view.width_px), 0.2 * view.width_px)
        )
        left, top = max(x - half, 0), max(y - half, 0)
        right, bottom = min(x + half + 1, view.width_px), min(y + half + 1, view.height_px)
        side = 2 * half + 1
        disc = cv2.resize(self._glow, (side, side), interpolation=cv2.INTER_LINEAR)
        cut = disc[top - y + half : bottom - y + half, left - x + half : right - x + half]
        halo = cv2.multiply(cv2.cvtColor(cut, cv2.COLOR_GRAY2RGB), (*rgb, 0.0), scale=1 / 255)
        region = canvas.image[top:bottom, left:right]
        cv2.add(region, halo, dst=region)


def _projected(
    areas: list[tuple[FloatArray, int]], view: View, first_row_px: int
) -> list[tuple[IntArray, int]]:
    polygons = [(on_ground(points, view), value) for points, value in areas]
    return [(half_size(polygon, first_row_px), value) for polygon, value in polygons if len(polygon) > 2]


def _glow_texture() -> Picture:
    line = (np.arange(65) - 32) / 32
    distance = np.hypot(line[:, None], line[None, :])
    fall = np.clip(1 - distance, 0, 1) ** 2.4
    return (255 * fall).astype(np.uint8)


def _placed(body: Body) -> Placed:
    mesh = _MESHES[body.kind](body.look, body.length_m, body.width_m, body.height_m)
    return Placed(mesh, body.x_m, body.y_m, body.yaw_rad, body.height_m, body.braking)


def _body_item(body: Body) -> _Item:
    corners = footprint(body.x_m, body.y_m, body.yaw_rad, body.length_m, body.width_m)
    return _Item(thing=body, corners=corners, low_m=0.0, high_m=body.height_m, far_m=_BODY_FAR_M)


def _static_items(scene: StreetScene) -> list[_Item]:
    items = [
        _Item(
            thing=house,
            corners=footprint(house.x_m, house.y_m, house.yaw_rad, house.length_m, house.width_m),
            low_m=0.0,
            high_m=house.height_m,
            far_m=_HOUSE_FAR_M,
        )
        for house in scene.buildings
    ]
    for tree in scene.trees:
        low, thick = TRUNK_SHARE * tree.height_m, 0.07 * tree.height_m
        trunk = footprint(tree.x_m, tree.y_m, 0.0, thick, thick)
        crown = footprint(tree.x_m, tree.y_m, 0.0, tree.crown_m, tree.crown_m)
        items.append(_Item(thing=tree, corners=trunk, low_m=0.0, high_m=low, far_m=_BODY_FAR_M))
        items.append(
            _Item(thing=_Crown(tree=tree), corners=crown, low_m=low, high_m=tree.height_m, far_m=_HOUSE_FAR_M)
        )
    for lamp in scene.lamps:
        post = footprint(lamp.x_m, lamp.y_m, 0.0, 0.2, 0.2)
        items.append(_Item(thing=lamp, corners=post, low_m=0.0, high_m=lamp.height_m, far_m=_BODY_FAR_M))
    return items + [_body_item(body) for body in sorted(scene.parked, key=lambda body: body.id)]


def _in_view(items: list[_Item], view: View) -> tuple[list[_Item], FloatArray, FloatArray]:
    """Return what may be seen, the columns each may touch, shape ``(n, 2)``, and the nearest depths, ``(n,)``."""
    if not items:
        return [], np.zeros((0, 2)), np.zeros(0)
    corners = np.array([item.corners for item in items])
    heights = np.array([(item.low_m, item.high_m) for item in items])
    points = np.concatenate(
        [np.dstack((corners, np.repeat(heights[:, k, None], 4, axis=1))) for k in (0, 1)], axis=1
    )
    seen = view.to_camera(points.reshape(-1, 3)).reshape(len(items), 8, 3)
    depth = seen[..., 0]
    nearest, farthest = depth.min(axis=1), depth.max(axis=1)
    pixels = view.pixels(seen.reshape(-1, 3)).reshape(len(items), 8, 2)[..., 0]
    crosses = nearest < NEAR_M
    first = np.where(crosses, -1.0, pixels.min(axis=1) - 2)
    last = np.where(crosses, view.width_px, pixels.max(axis=1) + 2)
    half = view.width_px / 2 / view.focal_px
    beside = (seen[..., 1] > half * depth).all(axis=1) | (seen[..., 1] < -half * depth).all(axis=1)
    far = np.array([item.far_m for item in items])
    keep = (
        (farthest > NEAR_M)
        & (nearest < far)
        & (first < view.width_px)
        & (last > 0)
        & ~(beside & (farthest > 0))
    )
    rows = np.flatnonzero(keep)
    return [items[i] for i in rows.tolist()], np.stack((first, last), axis=1)[rows], nearest[rows]


def _near(items: Iterable[_Item], view: View) -> list[_Item]:
    """Return what may cast a shadow into the picture."""
    return [
        item
        for item in items
        if abs(item.corners[0, 0] - view.x_m) < _SHADOW_FAR_M
        and abs(item.corners[0, 1] - view.y_m) < _SHADOW_FAR_M
    ]


def _ordered(items: list[_Item], columns: FloatArray, view: View) -> list[int]:
    if not items:
        return []
    corners = np.array([item.corners for item in items])
    heights = np.array([(item.low_m, item.high_m) for item in items])
    return paint_order(corners, heights, columns, (view.x_m, view.y_m, view.height_m))

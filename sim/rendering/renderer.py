"""Owns a frame: from a street, a light and a place to the picture and the id mask.

Sky and ground are painted first; then everything that stands, statics and bodies alike, in painter's order; at last
halos, rain and grain, which change the picture and never the mask.
"""

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np

from brink.sim.rendering.buildings import Facades, SeenWalls
from brink.sim.rendering.canvas import Canvas, Mark, Outline, Rgb
from brink.sim.rendering.cover import (
    Caster,
    Shadow,
    half_size,
    lamp_head,
    lamp_pools,
    mirrored_bodies,
    on_half_sheet,
)
from brink.sim.rendering.foliage import Foliage
from brink.sim.rendering.ground import GroundCover, GroundPainter, headlight_share
from brink.sim.rendering.items import Crown, House, Items, SeenItems, Thing, body_items, in_order, items_of
from brink.sim.rendering.lamps import Halos, lamp_marks
from brink.sim.rendering.light import lighting_of
from brink.sim.rendering.meshes import Placed, mesh_marks
from brink.sim.rendering.people import person_marks
from brink.sim.rendering.rain import Air
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    FloatArray,
    Frame,
    Lamp,
    Light,
    PictureCamera,
    StreetScene,
    Tree,
    Viewpoint,
    check_unique,
)
from brink.sim.rendering.sky import Sky
from brink.sim.rendering.vehicle_looks import paint_of
from brink.sim.rendering.vehicles import overturned_mesh, vehicle_mesh
from brink.sim.rendering.view import IntArray, View, view_from

_SHADOW_FAR_M: Final = 60.0
_OTHERS_RGB: Final = (70.0, 68.0, 62.0)
_MESHES: Final = {BodyKind.VEHICLE: vehicle_mesh, BodyKind.OVERTURNED_VEHICLE: overturned_mesh}

_Marks: TypeAlias = list[list[Mark]]


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
        self._facades = Facades(scene.buildings, self._lighting, camera.width_px, camera.height_px)
        self._foliage = Foliage(self._lighting)
        self._air = Air(self._lighting, camera, seed)
        self._halos = Halos(night=self._lighting.night)
        self._parked = frozenset(body.id for body in scene.parked)
        self._statics = items_of(scene)
        self._caster = Caster(self._lighting)
        self._shadows = [self._shadows_of(*row) for row in _rows(self._statics)]
        self._lamps = scene.lamps if self._lighting.night else ()
        self._pools = sorted(
            (pool for lamp in self._lamps for pool in lamp_pools(lamp)), key=lambda pool: pool[1]
        )

    def frame(self, viewpoint: Viewpoint, bodies: Sequence[Body], time_s: float) -> Frame:
        """Return what the camera sees.

        Args:
            viewpoint: Where the ego is.
            bodies: All that moves, the ego not included, in any order.
            time_s: Time in the episode: it moves the rain.

        Raises:
            InvalidScene: An id occurs twice, parked vehicles included.
        """
        check_unique((*self._parked, *(body.id for body in bodies)))
        view = view_from(self.camera, viewpoint)
        moving = body_items(bodies)
        seen = in_order(self._statics.joined(moving), view)
        walls = self._facades.place(view)
        shape = (view.height_px, view.width_px)
        canvas = Canvas(image=np.empty((*shape, 3), np.uint8), ids=np.zeros(shape, np.int32))
        self._sky.paint(canvas.image, view)
        self._ground.paint(canvas.image, view, self._cover(moving, seen, walls, view))
        outlines = self._paint(canvas, seen, walls, view)
        if self._lighting.lights_on:
            self._halos.lay(canvas, seen.things, self._parked, view)
        self._air.lay(canvas.image, time_s)
        return Frame(image=canvas.image, ids=canvas.ids, outlines=outlines)

    def _paint(self, canvas: Canvas, seen: SeenItems, walls: SeenWalls, view: View) -> dict[int, Outline]:
        marks = self._marks(seen, view)
        outlines: dict[int, Outline] = {}
        for index, thing in enumerate(seen.things):
            if isinstance(thing, House):
                self._facades.paint(thing.number, walls, canvas, view)
            elif isinstance(thing, Body):
                canvas.paint(marks[index], thing.id)
                depth = max(float(seen.depths[index]), 0.0)
                outlines[thing.id] = Outline(kind=thing.kind, depth_m=depth, marks=tuple(marks[index]))
            else:
                canvas.paint(marks[index], 0)
        return outlines

    def _marks(self, seen: SeenItems, view: View) -> _Marks:
        """Return the marks of everything but houses, in the order of `seen`; kinds are made together."""
        lit = self._lit(seen, view)
        marks: _Marks = [[] for _ in seen.things]
        solids: list[tuple[int, Placed]] = []
        people: list[tuple[int, Body]] = []
        trees: list[tuple[int, Tree]] = []
        lamps: list[tuple[int, Lamp]] = []
        for index, thing in enumerate(seen.things):
            if isinstance(thing, Tree):
                trees.append((index, thing))
            elif isinstance(thing, Crown):
                marks[index] = self._foliage.crown(thing.tree, view, float(lit[index]))
            elif isinstance(thing, Lamp):
                lamps.append((index, thing))
            elif isinstance(thing, Body):
                if thing.kind is BodyKind.PERSON:
                    people.append((index, thing))
                elif thing.kind is BodyKind.FALLEN_TREE:
                    marks[index] = self._foliage.fallen(thing, view, float(lit[index]))
                else:
                    solids.append((index, self._placed(thing)))
        rows = [index for index, _ in trees]
        _put(marks, rows, self._foliage.trunks([tree for _, tree in trees], view, lit[rows]))
        rows = [index for index, _ in lamps]
        posts = [lamp for _, lamp in lamps]
        _put(marks, rows, lamp_marks(posts, self._foliage, view, lit[rows], burning=bool(self._lamps)))
        rows = [index for index, _ in solids]
        _put(marks, rows, mesh_marks([model for _, model in solids], view, self._lighting, lit[rows]))
        rows = [index for index, _ in people]
        _put(marks, rows, person_marks([body for _, body in people], view, self._lighting, lit[rows]))
        return marks

    def _placed(self, body: Body) -> Placed:
        mesh = _MESHES[body.kind](body.look, body.length_m, body.width_m, body.height_m)
        parked = body.id in self._parked
        return Placed(mesh, body.x_m, body.y_m, body.yaw_rad, body.height_m, body.braking, parked)

    def _lit(self, seen: SeenItems, view: View) -> FloatArray:
        """Return how strongly each item is lit by the ego's headlights and by street lamps."""
        if not self._lighting.night or not seen.things:
            return np.zeros(len(seen.things))
        x_m, y_m = seen.centres[:, 0], seen.centres[:, 1]
        dx, dy = x_m - view.x_m, y_m - view.y_m
        lit = headlight_share(dx * view.cos_yaw + dy * view.sin_yaw, dy * view.cos_yaw - dx * view.sin_yaw)
        for lamp in self._lamps:
            lamp_x_m, lamp_y_m = lamp_head(lamp)
            lit = lit + 0.34 * np.exp(-((x_m - lamp_x_m) ** 2 + (y_m - lamp_y_m) ** 2) / lamp.height_m**2)
        clipped: FloatArray = np.clip(lit, 0.0, 1.0)
        return clipped

    def _shadows_of(self, thing: Thing, corners: FloatArray, low_m: float, high_m: float) -> list[Shadow]:
        if isinstance(thing, Crown):
            return self._caster.of_tree(thing.tree, low_m)
        if isinstance(thing, Body | House):
            return self._caster.of_box(corners, high_m, contact=isinstance(thing, Body))
        return []

    def _cover(self, moving: Items, seen: SeenItems, walls: SeenWalls, view: View) -> GroundCover:
        """Return what lies on the ground: cast shadows first, the dark below bodies after them."""
        first_row = min(max(math.ceil(view.horizon_px), 0), view.height_px)
        shadows = [
            shadow
            for items, cast in ((self._statics, self._shadows), (moving, None))
            for shadow in self._near_shadows(items, cast, view)
        ]
        shadows.sort(key=lambda shadow: -shadow[1])
        mirrored = self._mirrored(seen, walls, view) if self._lighting.wet else []
        return GroundCover(
            shadows=on_half_sheet(shadows, view, first_row),
            pools=on_half_sheet(self._pools, view, first_row),
            mirrored=[(half_size(points, first_row), rgb) for points, rgb in mirrored if len(points) > 2],
        )

    def _near_shadows(self, items: Items, cast: list[list[Shadow]] | None, view: View) -> list[Shadow]:
        apart = np.abs(items.corners[:, 0] - (view.x_m, view.y_m)).max(axis=1)
        near = np.flatnonzero(apart < _SHADOW_FAR_M).tolist()
        if cast is not None:
            return [shadow for row in near for shadow in cast[row]]
        rows = list(_rows(items))
        return [shadow for row in near for shadow in self._shadows_of(*rows[row])]

    def _mirrored(self, seen: SeenItems, walls: SeenWalls, view: View) -> list[tuple[IntArray, Rgb]]:
        light = self._lighting
        share = 0.7 * (light.ambient_share + 0.4 * light.sun_share)
        bodies = [thing for thing in seen.things if isinstance(thing, Body)]
        colours: list[Rgb] = []
        for body in bodies:
            vehicle = body.kind is BodyKind.VEHICLE
            rgb = paint_of(body.look, body.height_m) if vehicle else _OTHERS_RGB
            colours.append((rgb[0] * share, rgb[1] * share, rgb[2] * share))
        driven = [light.lights_on and body.id not in self._parked for body in bodies]
        of_bodies = iter(mirrored_bodies(bodies, colours, driven, view))
        of_houses = self._facades.mirrored(walls, view)
        found: list[tuple[IntArray, Rgb]] = []
        for thing in seen.things:
            if isinstance(thing, House):
                found += of_houses[thing.number]
            elif isinstance(thing, Body):
                found += next(of_bodies)
        return found


def _rows(items: Items) -> list[tuple[Thing, FloatArray, float, float]]:
    heights = items.heights.tolist()
    return [
        (thing, corners, low, high)
        for thing, corners, (low, high) in zip(items.things, items.corners, heights, strict=True)
    ]


def _put(marks: _Marks, rows: list[int], made: _Marks) -> None:
    for row, mine in zip(rows, made, strict=True):
        marks[row] = mine

"""The renderer: turns a street, a light and a viewpoint into an image and an id mask.

Sky and ground are painted first, then all upright objects in painter's order. Halos, rain and the sensor come last;
they change the image but never the mask.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np

from brink.sim.driving.interface import LightState
from brink.sim.rendering.buildings import BuildingPainter, PlacedWalls
from brink.sim.rendering.canvas import Canvas
from brink.sim.rendering.furniture import make_furniture_mesh
from brink.sim.rendering.ground import (
    GroundCover,
    GroundPainter,
    Shadow,
    ShadowCaster,
    body_reflections,
    headlight_strength,
    lamp_light_pools,
    project_areas,
    to_half_size,
)
from brink.sim.rendering.lamps import Halos, draw_lamps, lamp_head_position
from brink.sim.rendering.light import make_lighting
from brink.sim.rendering.order import (
    Crown,
    House,
    Items,
    Thing,
    VisibleItems,
    cull_and_sort,
    make_body_items,
    make_static_items,
    separated,
)
from brink.sim.rendering.people import draw_people, shadow_outline
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    FloatArray,
    Frame,
    Furniture,
    IntArray,
    Lamp,
    Light,
    Mark,
    Outline,
    PictureCamera,
    Rgb,
    SignalGroup,
    StreetScene,
    TrafficLight,
    Tree,
    Viewpoint,
    check_unique_ids,
)
from brink.sim.rendering.sensor import Sensor
from brink.sim.rendering.signals import make_traffic_light_mesh
from brink.sim.rendering.sky import Rain, Sky
from brink.sim.rendering.solids import PlacedMesh, draw_meshes
from brink.sim.rendering.trees import TreePainter
from brink.sim.rendering.vehicles import make_overturned_mesh, make_vehicle_mesh, vehicle_colour
from brink.sim.rendering.view import View, make_view

_SHADOW_FAR_M: Final = 60.0
_OTHERS_RGB: Final = (70.0, 68.0, 62.0)
_MESHES: Final = {BodyKind.VEHICLE: make_vehicle_mesh, BodyKind.OVERTURNED_VEHICLE: make_overturned_mesh}

_Marks: TypeAlias = list[list[Mark]]


class Renderer:
    """Renders one street under fixed lighting.

    Args:
        scene: Everything that does not move.
        light: Time of day and weather.
        camera: The ego's camera.
        seed: Seed of textures, clouds, rain, grain and the sun's position.

    Raises:
        InvalidScene: An id occurs twice.
    """

    def __init__(self, scene: StreetScene, light: Light, camera: PictureCamera, seed: int) -> None:
        self.camera = camera
        self._lighting = make_lighting(light, seed)
        self._sky = Sky(self._lighting, camera, seed)
        self._ground = GroundPainter(scene.ground, self._lighting, camera, seed)
        self._buildings = BuildingPainter(scene.buildings, self._lighting, camera.width_px, camera.height_px)
        self._trees = TreePainter(self._lighting)
        self._rain = Rain(self._lighting, camera, seed)
        self._sensor = Sensor(self._lighting, camera, seed)
        self._halos = Halos(night=self._lighting.night)
        self._parked = frozenset(body.id for body in scene.parked)
        self._statics = make_static_items(scene)
        self._apart = separated(self._statics.corners, self._statics.corners)
        self._caster = ShadowCaster(self._lighting)
        self._shadows = [self._shadows_of(*row) for row in _rows(self._statics)]
        self._lamps = scene.lamps if self._lighting.night else ()
        self._pools = sorted(
            (pool for lamp in self._lamps for pool in lamp_light_pools(lamp)), key=lambda pool: pool[1]
        )

    def frame(
        self,
        viewpoint: Viewpoint,
        bodies: Sequence[Body],
        time_s: float,
        signals: Mapping[SignalGroup, LightState] | None = None,
    ) -> Frame:
        """Render one frame.

        Args:
            viewpoint: Pose of the ego.
            bodies: All moving bodies except the ego, in any order.
            time_s: Time in the episode, which moves the rain and the grain.
            signals: What the traffic lights show; those that are left out are off.

        Raises:
            InvalidScene: An id occurs twice, parked vehicles included.
        """
        check_unique_ids((*self._parked, *(body.id for body in bodies)))
        view = make_view(self.camera, viewpoint)
        moving = make_body_items(bodies)
        seen = cull_and_sort(self._statics.joined(moving), view, self._apart)
        walls = self._buildings.place_walls(view)
        shape = (view.height_px, view.width_px)
        canvas = Canvas(image=np.empty((*shape, 3), np.uint8), ids=np.zeros(shape, np.int32))
        self._sky.paint(canvas.image, view)
        self._ground.paint(canvas.image, view, self._cover(moving, seen, walls, view))
        signals = signals or {}
        outlines = self._paint(canvas, seen, walls, signals, view)
        if self._lighting.lights_on:
            self._halos.add(canvas, seen.things, self._parked, signals, view)
        np.maximum(canvas.ids, 0, out=canvas.ids)
        self._rain.apply(canvas.image, time_s)
        self._sensor.apply(canvas.image, time_s)
        return Frame(image=canvas.image, ids=canvas.ids, outlines=outlines)

    def _paint(
        self,
        canvas: Canvas,
        seen: VisibleItems,
        walls: PlacedWalls,
        signals: Mapping[SignalGroup, LightState],
        view: View,
    ) -> dict[int, Outline]:
        marks = self._marks(seen, signals, view)
        outlines: dict[int, Outline] = {}
        for index, thing in enumerate(seen.things):
            if isinstance(thing, House):
                self._buildings.paint(thing.number, walls, canvas, view)
            elif isinstance(thing, Body):
                canvas.paint(marks[index], thing.id)
                depth = max(float(seen.depths[index]), 0.0)
                outlines[thing.id] = Outline(kind=thing.kind, depth_m=depth, marks=tuple(marks[index]))
            else:
                canvas.paint(marks[index], -1 - index)
        return outlines

    def _marks(self, seen: VisibleItems, signals: Mapping[SignalGroup, LightState], view: View) -> _Marks:
        """Return the marks of all items except buildings, in item order; each kind is drawn in one batch."""
        lit = self._lit(seen, view)
        marks: _Marks = [[] for _ in seen.things]
        solids: list[tuple[int, PlacedMesh]] = []
        people: list[tuple[int, Body]] = []
        trees: list[tuple[int, Tree]] = []
        lamps: list[tuple[int, Lamp]] = []
        for index, thing in enumerate(seen.things):
            if isinstance(thing, Tree):
                trees.append((index, thing))
            elif isinstance(thing, Crown):
                marks[index] = self._trees.crown(thing.tree, view, float(lit[index]))
            elif isinstance(thing, Lamp):
                lamps.append((index, thing))
            elif isinstance(thing, TrafficLight):
                solids.append((index, _placed_light(thing, signals.get(thing.group))))
            elif isinstance(thing, Furniture):
                solids.append((index, _placed_furniture(thing)))
            elif isinstance(thing, Body):
                if thing.kind is BodyKind.PERSON:
                    people.append((index, thing))
                elif thing.kind is BodyKind.FALLEN_TREE:
                    marks[index] = self._trees.fallen(thing, view, float(lit[index]))
                else:
                    solids.append((index, self._placed(thing)))
        rows = [index for index, _ in trees]
        _put(marks, rows, self._trees.trunks([tree for _, tree in trees], view, lit[rows]))
        rows = [index for index, _ in lamps]
        posts = [lamp for _, lamp in lamps]
        _put(marks, rows, draw_lamps(posts, self._lighting, view, lit[rows], burning=bool(self._lamps)))
        rows = [index for index, _ in solids]
        _put(marks, rows, draw_meshes([model for _, model in solids], view, self._lighting, lit[rows]))
        rows = [index for index, _ in people]
        _put(marks, rows, draw_people([body for _, body in people], view, self._lighting, lit[rows]))
        return marks

    def _placed(self, body: Body) -> PlacedMesh:
        mesh = _MESHES[body.kind](body.look, body.length_m, body.width_m, body.height_m)
        parked = body.id in self._parked
        return PlacedMesh(mesh, body.x_m, body.y_m, body.yaw_rad, body.height_m, body.braking, parked)

    def _lit(self, seen: VisibleItems, view: View) -> FloatArray:
        """Return the artificial light on each item from the ego's headlights and street lamps."""
        if not self._lighting.night or not seen.things:
            return np.zeros(len(seen.things))
        x_m, y_m = seen.centres[:, 0], seen.centres[:, 1]
        dx, dy = x_m - view.x_m, y_m - view.y_m
        lit = headlight_strength(dx * view.cos_yaw + dy * view.sin_yaw, dy * view.cos_yaw - dx * view.sin_yaw)
        for lamp in self._lamps:
            lamp_x_m, lamp_y_m = lamp_head_position(lamp)
            lit = lit + 0.34 * np.exp(-((x_m - lamp_x_m) ** 2 + (y_m - lamp_y_m) ** 2) / lamp.height_m**2)
        clipped: FloatArray = np.clip(lit, 0.0, 1.0)
        return clipped

    def _shadows_of(self, thing: Thing, corners: FloatArray, low_m: float, high_m: float) -> list[Shadow]:
        if isinstance(thing, Crown):
            return self._caster.tree_shadows(thing.tree, low_m)
        if isinstance(thing, Body) and thing.kind is BodyKind.PERSON:
            return self._caster.box_shadows(shadow_outline(thing), high_m, contact=True)
        if isinstance(thing, Body | House | Furniture):
            return self._caster.box_shadows(corners, high_m, contact=not isinstance(thing, House))
        return []

    def _cover(self, moving: Items, seen: VisibleItems, walls: PlacedWalls, view: View) -> GroundCover:
        """Collect shadows, lamp light and reflections; cast shadows precede contact shadows."""
        first_row = min(max(math.ceil(view.horizon_px), 0), view.height_px)
        shadows = [
            shadow
            for items, cast in ((self._statics, self._shadows), (moving, None))
            for shadow in self._near_shadows(items, cast, view)
        ]
        shadows.sort(key=lambda shadow: -shadow[1])
        mirrored = self._mirrored(seen, walls, view) if self._lighting.wet else []
        return GroundCover(
            shadows=project_areas(shadows, view, first_row),
            pools=project_areas(self._pools, view, first_row),
            mirrored=[(to_half_size(points, first_row), rgb) for points, rgb in mirrored if len(points) > 2],
        )

    def _near_shadows(self, items: Items, cast: list[list[Shadow]] | None, view: View) -> list[Shadow]:
        apart = np.abs(items.corners[:, 0] - (view.x_m, view.y_m)).max(axis=1)
        near = np.flatnonzero(apart < _SHADOW_FAR_M).tolist()
        if cast is not None:
            return [shadow for row in near for shadow in cast[row]]
        rows = list(_rows(items))
        return [shadow for row in near for shadow in self._shadows_of(*rows[row])]

    def _mirrored(self, seen: VisibleItems, walls: PlacedWalls, view: View) -> list[tuple[IntArray, Rgb]]:
        light = self._lighting
        share = 0.7 * (light.ambient_strength + 0.4 * light.sun_strength)
        bodies = [thing for thing in seen.things if isinstance(thing, Body)]
        colours: list[Rgb] = []
        for body in bodies:
            vehicle = body.kind is BodyKind.VEHICLE
            rgb = vehicle_colour(body.look, body.height_m) if vehicle else _OTHERS_RGB
            colours.append((rgb[0] * share, rgb[1] * share, rgb[2] * share))
        driven = [light.lights_on and body.id not in self._parked for body in bodies]
        of_bodies = iter(body_reflections(bodies, colours, driven, view))
        houses = [thing.number for thing in seen.things if isinstance(thing, House)]
        of_houses = self._buildings.mirrored(houses, walls, view)
        found: list[tuple[IntArray, Rgb]] = []
        for thing in seen.things:
            if isinstance(thing, House):
                found += of_houses[thing.number]
            elif isinstance(thing, Body):
                found += next(of_bodies)
        return found


def _placed_furniture(item: Furniture) -> PlacedMesh:
    mesh = make_furniture_mesh(replace(item, x_m=0.0, y_m=0.0, yaw_rad=0.0))
    return PlacedMesh(mesh, item.x_m, item.y_m, item.yaw_rad, item.height_m, braking=False, parked=True)


def _placed_light(light: TrafficLight, state: LightState | None) -> PlacedMesh:
    mesh = make_traffic_light_mesh(light.height_m, state)
    return PlacedMesh(mesh, light.x_m, light.y_m, light.yaw_rad, light.height_m, braking=False, parked=True)


def _rows(items: Items) -> list[tuple[Thing, FloatArray, float, float]]:
    heights = items.heights.tolist()
    return [
        (thing, corners, low, high)
        for thing, corners, (low, high) in zip(items.things, items.corners, heights, strict=True)
    ]


def _put(marks: _Marks, rows: list[int], drawn: _Marks) -> None:
    for row, item_marks in zip(rows, drawn, strict=True):
        marks[row] = item_marks

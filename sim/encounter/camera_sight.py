"""The camera in the loop of an encounter: the road rendered, a detector's boxes in the driving system's image."""

import math
from typing import Final

import cv2
import numpy as np

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.encounter.road_users import ScriptedUser
from brink.sim.encounter.script import Kind
from brink.sim.encounter.world import EncounterWorld
from brink.sim.perception.detector import LABELS, Detector
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    Building,
    FloatArray,
    Ground,
    Light,
    Material,
    PictureCamera,
    StreetScene,
    Tree,
    Viewpoint,
)
from brink.sim.trace import Surface
from brink.sim.world.road import Road
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.scenery import fixtures, scene_surfaces

SIZE_PX: Final = (640, 360)
CROWN_M: Final = 3.0
STEPS_A_SECOND: Final = 1.9
"""Steps of a walking person, for how its legs stand."""

_GRASS_BEYOND_M: Final = 80.0
_MATERIALS: Final = {
    "pavement": Material.PAVEMENT,
    "road": Material.ASPHALT,
    "marking": Material.MARKING,
    "stop-line": Material.MARKING,
    "crossing": Material.CROSSING,
}
_LABELS: Final = {"vehicle": ObstacleLabel.VEHICLE, "person": ObstacleLabel.PERSON}


class EncounterCamera:
    """Renders what the ego's camera sees, and says what a detector finds in it.

    Args:
        world: What there is to see.
        place: When it is, in which weather.
        seed: Decides the looks.
        detector: What looks at the pictures.
        threshold: Least score of a detection that is told.
        camera: The driving system's, in whose image boxes are told.
    """

    def __init__(
        self,
        world: EncounterWorld,
        place: UrbanScenario,
        *,
        seed: int,
        detector: Detector,
        threshold: float,
        camera: Camera,
    ) -> None:
        cv2.setNumThreads(1)
        self._world = world
        self._detector = detector
        self._threshold = threshold
        self._camera = camera
        self._picture = PictureCamera(
            width_px=SIZE_PX[0], height_px=SIZE_PX[1], fov_deg=camera.fov_deg, height_m=camera.height_m,
            forward_m=camera.forward_m,
        )  # fmt: skip
        light = Light(time_of_day=place.time_of_day, weather=place.weather)
        self._first_id = 1 + len(fixtures(world.road))
        self._renderer = Renderer(street_scene(world.road), light, self._picture, seed)

    def boxes(self, time_s: float) -> tuple[Box, ...]:
        """Return what the detector finds now, in px of the driving system's image."""
        ego = self._world.ego
        bodies = [self._body(index, user, time_s) for index, user in enumerate(self._world.everybody)]
        view = Viewpoint(x_m=ego.x_m, y_m=ego.y_m, yaw_rad=ego.yaw_rad)
        found = self._detector.detect(self._renderer.frame(view, bodies, time_s).image)
        sure = np.flatnonzero(found.scores >= self._threshold).tolist()
        return tuple(self._told(LABELS[found.labels[i]], *found.boxes[i].tolist()) for i in sure)

    def _body(self, index: int, user: ScriptedUser, time_s: float) -> Body:
        person = user.kind is Kind.PEDESTRIAN
        walks = 2.0 * math.pi * STEPS_A_SECOND * time_s if person and user.speed_mps > 0.1 else 0.0
        return Body(
            id=self._first_id + index, kind=BodyKind.PERSON if person else BodyKind.VEHICLE, x_m=user.x_m,
            y_m=user.y_m, yaw_rad=user.yaw_rad, length_m=user.length_m, width_m=user.width_m,
            height_m=user.size.height_m, look=7 * index + 3, phase=walks % (2.0 * math.pi),
        )  # fmt: skip

    def _told(self, label: str, x_min: float, y_min: float, x_max: float, y_max: float) -> Box:
        """Return a box of the picture in the driving system's image: the same rays, other pixels."""
        scale = self._camera.focal_px / self._picture.focal_px
        middle_x, middle_y = 0.5 * SIZE_PX[0], 0.5 * SIZE_PX[1]
        return Box(
            label=_LABELS[label],
            x_min_px=self._camera.centre_x_px + (x_min - middle_x) * scale,
            x_max_px=self._camera.centre_x_px + (x_max - middle_x) * scale,
            y_min_px=self._camera.horizon_px + (y_min - middle_y) * scale,
            y_max_px=self._camera.horizon_px + (y_max - middle_y) * scale,
        )


def street_scene(road: Road) -> StreetScene:
    """Return a road as the renderer takes it: the same surfaces and fixtures that replays show from above."""
    still = fixtures(road)
    ground = [_grass(road)]
    ground += [_ground(surface) for surface in scene_surfaces(road) if surface.kind in _MATERIALS]
    return StreetScene(
        ground=tuple(ground),
        buildings=tuple(
            Building(
                x_m=f.x_m, y_m=f.y_m, yaw_rad=f.yaw_rad, length_m=f.length_m, width_m=f.width_m,
                height_m=f.height_m, look=index,
            )
            for index, f in enumerate(still)
            if f.kind == "building"
        ),
        trees=tuple(
            Tree(x_m=f.x_m, y_m=f.y_m, height_m=f.height_m, crown_m=CROWN_M, look=index)
            for index, f in enumerate(still)
            if f.kind == "tree"
        ),
        parked=tuple(
            Body(
                id=index + 1, kind=BodyKind.VEHICLE, x_m=f.x_m, y_m=f.y_m, yaw_rad=f.yaw_rad,
                length_m=f.length_m, width_m=f.width_m, height_m=f.height_m, look=index,
            )
            for index, f in enumerate(still)
            if f.kind == "parked-car"
        ),
    )  # fmt: skip


def _grass(road: Road) -> Ground:
    stations = np.linspace(-_GRASS_BEYOND_M, road.length_m + _GRASS_BEYOND_M, 24)
    points = np.array([road.centre.pose_at(float(station))[:2] for station in stations])
    low, high = points.min(axis=0) - _GRASS_BEYOND_M, points.max(axis=0) + _GRASS_BEYOND_M
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    return Ground(material=Material.GRASS, points=corners)


def _ground(surface: Surface) -> Ground:
    points = surface.points.astype(np.float64)
    if not surface.closed:
        points = _widened(points, surface.width_m)
    return Ground(material=_MATERIALS[surface.kind], points=points)


def _widened(points: FloatArray, width_m: float) -> FloatArray:
    """Return the outline of a line of some width."""
    along = np.gradient(points, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    across *= 0.5 * width_m / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return np.concatenate([points + across, (points - across)[::-1]])

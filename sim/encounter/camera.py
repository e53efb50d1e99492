"""The simulator `brink-encounter-camera@1`: encounters in which a detector processes rendered camera images.

The road is rendered from the ego's camera, and the detector's boxes are converted to the driving system's image.
"""

import math
from collections.abc import Mapping
from typing import ClassVar, Final

import cv2
import numpy as np

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.encounter.specification import EncounterScenario, Kind
from brink.sim.encounter.world import EncounterWorld, ScriptedUser
from brink.sim.episode import EpisodeSpec, Json, check_fields
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.detector import LABELS, Detector, find_detector
from brink.sim.perception.user_files import weights_digest
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    Ground,
    Light,
    Material,
    PictureCamera,
    StreetScene,
    Tree,
    Viewpoint,
)
from brink.sim.rendering.street import building_from_fixture, road_surfaces
from brink.sim.urban.episode_loop import Detects
from brink.sim.world.road import Road
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.scenery import fixtures

MODE: Final = "detector"
SIZE_PX: Final = (640, 360)
CROWN_M: Final = 3.0
STEPS_PER_S: Final = 1.9
"""Step rate of a walking person, for the pose of the legs."""

_GRASS_BEYOND_M: Final = 80.0
_FIELDS: Final = ("mode", "detector", "threshold", "weights")
_LABELS: Final = {"vehicle": ObstacleLabel.VEHICLE, "person": ObstacleLabel.PERSON}


class EncounterCamera:
    """Renders what the ego's camera sees and returns a detector's boxes.

    Args:
        world: The world of the encounter.
        place: Time of day and weather.
        seed: Selects the appearances.
        detector: The detector.
        threshold: Minimum score of a box.
        camera: The driving system's camera, which defines the image of the returned boxes.
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
        """Return the current detections, in pixels of the driving system's image."""
        ego = self._world.ego
        bodies = [self._body(index, user, time_s) for index, user in enumerate(self._world.road_users)]
        view = Viewpoint(x_m=ego.x_m, y_m=ego.y_m, yaw_rad=ego.yaw_rad)
        found = self._detector.detect(self._renderer.frame(view, bodies, time_s).image)
        sure = np.flatnonzero(found.scores >= self._threshold).tolist()
        return tuple(self._to_driving_image(LABELS[found.labels[i]], *found.boxes[i].tolist()) for i in sure)

    def _body(self, index: int, user: ScriptedUser, time_s: float) -> Body:
        person = user.kind is Kind.PEDESTRIAN
        walks = 2.0 * math.pi * STEPS_PER_S * time_s if person and user.speed_mps > 0.1 else 0.0
        return Body(
            id=self._first_id + index, kind=BodyKind.PERSON if person else BodyKind.VEHICLE, x_m=user.x_m,
            y_m=user.y_m, yaw_rad=user.yaw_rad, length_m=user.length_m, width_m=user.width_m,
            height_m=user.size.height_m, look=7 * index + 3, phase=walks % (2.0 * math.pi),
        )  # fmt: skip

    def _to_driving_image(self, label: str, x_min: float, y_min: float, x_max: float, y_max: float) -> Box:
        """Convert a box to the driving system's image: the same rays, different pixels."""
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
    """Convert a road to a scene for rendering, with the surfaces and fixtures that replays show from above."""
    still = fixtures(road)
    return StreetScene(
        ground=(_grass(road), *road_surfaces(road)),
        buildings=tuple(
            building_from_fixture(f, index) for index, f in enumerate(still) if f.kind == "building"
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


class BrinkEncounterCamera(BrinkEncounter):
    """Runs encounters with a camera in the loop."""

    id: ClassVar[str] = "brink-encounter-camera@1"

    def _check(self, behaviour: Mapping[str, Json]) -> None:
        check_fields("behaviour", {"weights": "", **behaviour}, _FIELDS)
        if behaviour["mode"] != MODE:
            raise InvalidEpisode(f"behaviour.mode: expected {MODE}, got {behaviour['mode']!r}")
        threshold = behaviour["threshold"]
        if isinstance(threshold, bool) or not isinstance(threshold, int | float) or not 0 < threshold < 1:
            raise InvalidEpisode(f"behaviour.threshold: expected a number in (0, 1), got {threshold!r}")
        if not isinstance(behaviour["detector"], str):
            raise InvalidEpisode(
                f"behaviour.detector: expected an id such as brink-det@1, got {behaviour['detector']!r}"
            )
        weights = behaviour.get("weights", "")
        if weights and weights != weights_digest(behaviour["detector"]):
            raise InvalidEpisode(
                f"behaviour.detector: {behaviour['detector']} differs from the file that the "
                "campaign was submitted with"
            )

    def _detects(
        self, spec: EpisodeSpec, scenario: EncounterScenario, world: EncounterWorld
    ) -> Detects | None:
        return EncounterCamera(
            world,
            scenario.place,
            seed=spec.seed,
            detector=find_detector(str(spec.behaviour["detector"])),
            threshold=float(str(spec.behaviour["threshold"])),
            camera=self._camera,
        ).boxes

"""The simulator `brink-encounter-camera@2`: encounters in which a detector processes rendered camera images.

The road is rendered from the ego's camera, and the detector's boxes are converted to the driving system's image.
"""

from collections.abc import Mapping
from typing import ClassVar

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.encounter.specification import EncounterScenario, Kind
from brink.sim.encounter.world import EncounterWorld, ScriptedUser
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception.detector import Detector, find_detector
from brink.sim.rendering.scene import Body, BodyKind, Light
from brink.sim.urban.camera import RoadCamera, check_detector, gait
from brink.sim.urban.episode_loop import Detects
from brink.sim.world.scenario import UrbanScenario


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
        self._world = world
        light = Light(time_of_day=place.time_of_day, weather=place.weather)
        self._camera = RoadCamera(
            world.road, light, seed=seed, detector=detector, threshold=threshold, camera=camera
        )

    def boxes(self, time_s: float) -> tuple[Box, ...]:
        """Return the current detections, in pixels of the driving system's image."""
        bodies = [self._body(index, user, time_s) for index, user in enumerate(self._world.road_users)]
        return self._camera.boxes(self._world.ego, bodies, time_s)

    def _body(self, index: int, user: ScriptedUser, time_s: float) -> Body:
        person = user.kind is Kind.PEDESTRIAN
        return Body(
            id=self._camera.first_id + index,
            kind=BodyKind.PERSON if person else BodyKind.VEHICLE,
            x_m=user.x_m,
            y_m=user.y_m,
            yaw_rad=user.yaw_rad,
            length_m=user.length_m,
            width_m=user.width_m,
            height_m=user.size.height_m,
            look=7 * index + 3,
            phase=gait(user.speed_mps, time_s) if person else 0.0,
        )


class BrinkEncounterCamera(BrinkEncounter):
    """Runs encounters with a camera in the loop."""

    id: ClassVar[str] = "brink-encounter-camera@2"

    def _check(self, behaviour: Mapping[str, Json]) -> None:
        check_detector(behaviour)

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

"""The simulator `brink-encounter-camera@3`: encounters in which a detector processes rendered camera images.

The road is rendered from the ego's camera, and the detector's boxes are converted to the driving system's image.
"""

from collections.abc import Mapping
from typing import ClassVar

from brink.sim.driving.camera import Camera
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.encounter.specification import EncounterScenario
from brink.sim.encounter.world import EncounterWorld
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception.detector import find_detector
from brink.sim.rendering.scene import Light
from brink.sim.urban.camera import RoadCamera, check_detector
from brink.sim.urban.episode_loop import Detects


class BrinkEncounterCamera(BrinkEncounter):
    """Runs encounters with a camera in the loop."""

    id: ClassVar[str] = "brink-encounter-camera@3"

    def _check(self, behaviour: Mapping[str, Json]) -> None:
        check_detector(behaviour)

    def _detects(
        self, spec: EpisodeSpec, scenario: EncounterScenario, world: EncounterWorld, camera: Camera
    ) -> Detects | None:
        place = scenario.place
        return RoadCamera(
            world,
            Light(time_of_day=place.time_of_day, weather=place.weather),
            seed=spec.seed,
            detector=find_detector(str(spec.behaviour["detector"])),
            threshold=float(str(spec.behaviour["threshold"])),
            camera=camera,
        ).boxes

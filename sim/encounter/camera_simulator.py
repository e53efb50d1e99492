"""Owns the simulator `brink-encounter-camera@1`: encounters in which a detector looks at the camera's pictures."""

from collections.abc import Mapping
from typing import ClassVar, Final

from brink.sim.encounter.camera_sight import EncounterCamera
from brink.sim.encounter.scenario import EncounterScenario
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.encounter.world import EncounterWorld
from brink.sim.episode import EpisodeSpec, Json, check_fields
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.registry import find_detector
from brink.sim.perception.weights_file import weights_digest
from brink.sim.urban.episode_loop import Detects

MODE: Final = "detector"
_FIELDS: Final = ("mode", "detector", "threshold", "weights")


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
                f"behaviour.detector: {behaviour['detector']} here is not the file that the campaign was "
                "submitted with"
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

"""The obstacle detector with errors from a fitted process, and its simulator, `brink-drive-fitted@2`.

What the detector did is measured as with a camera, in the terms of `detection_errors`.
"""

from collections.abc import Mapping
from statistics import NormalDist
from typing import Final

import numpy as np

from brink.sim.driving.camera import Camera, Sighting, Solid
from brink.sim.driving.interface import PERCEPTION_STEP_S, Box, ObstacleLabel
from brink.sim.episode import EpisodeSpec, Json, check_fields, parse_integer
from brink.sim.errors import InvalidEpisode
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour, last_perception_step
from brink.sim.urban.detection_errors import Target
from brink.sim.urban.episode_loop import Detects, Outcome
from brink.sim.urban.erroneous_detector import Observer, Scene, clipped, ghost_bodies, relabelled
from brink.sim.urban.error_draws import RoadUserErrors, group_of
from brink.sim.urban.error_meter import GHOST_WITHIN_M, ErrorMeter, ReportedBox, measures_to_json
from brink.sim.urban.error_process import LABELS, MAX_REPLICATES, MODE, SCORES, ErrorProcess, FloatArray
from brink.sim.urban.simulator import BrinkDrive, UrbanDetector
from brink.sim.world.streams import Stream, generator
from brink.sim.world.world import World

SIMULATOR_ID: Final = "brink-drive-fitted@2"
REPLICATE: Final = "replicate"
"""Name of the feature that says which replicate of the fit was driven."""
_GHOSTS_FROM_M: Final = 5.0


class FittedDetector:
    """Reports road users with errors from a fitted process. Create a new one for each episode.

    Args:
        world: The world of the episode.
        camera: The detector's camera.
        process: The process.
        seed: The episode's seed.
        perception_steps: Number of perception steps.

    Attributes:
        meter: Measures what the detector does.
    """

    def __init__(
        self, world: World, camera: Camera, process: ErrorProcess, *, seed: int, perception_steps: int
    ) -> None:
        self._world = world
        self._camera = camera
        self._process = process
        self._observer = Observer(world, camera)
        self._seed = seed
        self._steps = perception_steps
        self._road_users: dict[int, RoadUserErrors] = {}
        self._ghosts = [_Ghosts(process.ghosts[i], seed, i, perception_steps) for i in range(len(LABELS))]
        self.meter = ErrorMeter(camera, in_lane=self._observer.is_in_lane)

    def __call__(self, time_s: float) -> tuple[Box, ...]:
        """Return the reported boxes at a perception step."""
        step = round(time_s / PERCEPTION_STEP_S)
        scene = self._observer.look(time_s)
        lead = scene.lead()
        reported = [self._reported(sight, step, is_target=sight.body == lead) for sight in scene.sights]
        boxes = [box for box in reported if box is not None]
        ego = self._world.ego
        for ghosts in self._ghosts:
            seen = [
                self._camera.project(ego.x_m, ego.y_m, ego.yaw_rad, body) for body in ghosts.at(scene, step)
            ]
            boxes += [one[0] for one in seen if one is not None]
        self.meter.see(time_s, scene.true_boxes(), [ReportedBox(box) for box in boxes])
        return self._camera.all_tilted(boxes, ego.pitch_rad)

    def _reported(self, sight: Sighting, step: int, *, is_target: bool) -> Box | None:
        """Return the box of a road user in sight; None if it is not reported."""
        errors = self._road_users.get(sight.body)
        if errors is None:
            errors = self._road_users[sight.body] = RoadUserErrors(
                self._process, seed=self._seed, index=sight.body, steps=self._steps
            )
        drawn = errors.at(step, group_of(sight.box.label, is_target=is_target), sight.depth_m)
        if drawn is None:
            return None
        box = relabelled(sight.box) if drawn.is_wrong else sight.box
        return with_errors(self._camera, box, sight.depth_m, *drawn[1:])


def with_errors(
    camera: Camera, box: Box, depth_m: float, far: float, right_m: float, size: float
) -> Box | None:
    """Return a box with the errors of position and size that `ErrorMeter` measures; None if hardly any of it is left.

    Args:
        camera: The camera.
        box: The true box.
        depth_m: True distance.
        far: Error of the distance, as a share of it.
        right_m: Error to the side.
        size: Error of the size, as a share of it.
    """
    if far == 0.0 and right_m == 0.0 and size == 0.0:
        return box
    bottom = camera.horizon_px + (box.y_max_px - camera.horizon_px) / (1.0 + far)
    middle = 0.5 * (box.x_min_px + box.x_max_px) + right_m * camera.focal_px / max(depth_m, camera.near_m)
    half = 0.5 * (1.0 + size) * (box.x_max_px - box.x_min_px)
    top = bottom - (1.0 + size) * (box.y_max_px - box.y_min_px)
    return clipped(
        camera,
        Box(label=box.label, x_min_px=middle - half, x_max_px=middle + half, y_min_px=top, y_max_px=bottom),
    )


class _Ghosts:
    """Ghosts of one label: they stand in the ego's lane at a random distance, one at a time.

    Args:
        numbers: Ghosts that begin in an hour, and the quantiles of their durations.
        seed: The episode's seed.
        label: Number of the label.
        perception_steps: Number of perception steps.
    """

    def __init__(self, numbers: FloatArray, seed: int, label: int, perception_steps: int) -> None:
        per_hour, *self._quantiles = numbers.tolist()
        self._share = min(per_hour * PERCEPTION_STEP_S / 3600.0, 1.0)
        self._target = Target.LEAD if LABELS[label] is ObstacleLabel.VEHICLE else Target.PEDESTRIAN
        self._draws = generator(seed, Stream.DETECTOR_GHOSTS, label).random((perception_steps, 3))
        self._until = 0
        self._bodies: list[Solid] = []

    def at(self, scene: Scene, step: int) -> list[Solid]:
        """Return the ghosts at a perception step."""
        if step < self._until:
            return self._bodies
        begins, place, lasts = self._draws[step].tolist()
        if begins >= self._share:
            return []
        ahead_m = _GHOSTS_FROM_M + place * (GHOST_WITHIN_M - _GHOSTS_FROM_M)
        lasts_s = float(np.interp(NormalDist().inv_cdf(max(lasts, 1e-12)), SCORES, self._quantiles))
        self._until = step + max(round(lasts_s / PERCEPTION_STEP_S), 1)
        self._bodies = ghost_bodies(scene, self._target, ahead_m)
        return self._bodies


class BrinkDriveFitted(BrinkDrive):
    """Runs urban episodes in which the obstacle detector's errors come from a fitted process."""

    id = SIMULATOR_ID

    def _detector(self, spec: EpisodeSpec) -> UrbanDetector:
        return _Fitted(spec)


class _Fitted:
    """A detector with errors from a fitted process."""

    def __init__(self, spec: EpisodeSpec) -> None:
        self.behaviour = DetectorBehaviour(mode=BehaviourMode.ORACLE)
        self._spec = spec
        self._process, self._replicate = process_from_json(spec.behaviour)
        self._detector: FittedDetector | None = None

    def start(self, world: World, camera: Camera) -> Detects:
        spec = self._spec
        self._detector = FittedDetector(
            world,
            camera,
            self._process,
            seed=spec.seed,
            perception_steps=last_perception_step(spec.duration_s) + 1,
        )
        return self._detector

    def features(self, outcome: Outcome) -> dict[str, Json]:
        """Return which replicate was driven, and the detector's errors."""
        measured = {} if self._detector is None else measures_to_json(self._detector.meter)
        return {REPLICATE: self._replicate, **measured}


def process_from_json(behaviour: Mapping[str, Json]) -> tuple[ErrorProcess, int]:
    """Parse the behaviour of an episode.

    Args:
        behaviour: ``{"mode": "fitted", "replicate": …, "process": […]}``.

    Returns:
        The process, and the number of the replicate of its fit that it is.

    Raises:
        InvalidEpisode: A field is missing, unknown, or out of range.
    """
    check_fields("behaviour", behaviour, ("mode", REPLICATE, "process"))
    if behaviour["mode"] != MODE:
        raise InvalidEpisode(f"behaviour.mode: expected {MODE}, got {behaviour['mode']!r}")
    return (
        ErrorProcess.from_json("behaviour.process", behaviour["process"]),
        parse_integer(f"behaviour.{REPLICATE}", behaviour[REPLICATE], 0, MAX_REPLICATES),
    )

"""The camera on urban roads: renders what the ego sees and returns a detector's boxes.

`brink-drive-camera@3` runs urban episodes with the detector in the loop. Its results say how wrong the detector was,
in the terms of `detection_errors`, so that it can be checked against a requirement.
"""

import math
from collections.abc import Mapping
from typing import Final

import cv2

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.episode import EpisodeSpec, Json, check_fields
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.boxes import BoolArray, Detections
from brink.sim.perception.detector import LABELS, Detector, find_detector
from brink.sim.perception.user_files import DEFAULT_DETECTOR, weights_digest
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import Body, BodyKind, Frame, Light, PictureCamera, SignalGroup, Viewpoint
from brink.sim.rendering.street import street_from_road
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour
from brink.sim.urban.episode_loop import Detects, Outcome
from brink.sim.urban.erroneous_detector import Observer
from brink.sim.urban.error_meter import MEASURES, ErrorMeter, ReportedBox, measures_to_json
from brink.sim.urban.simulator import BrinkDrive, UrbanDetector
from brink.sim.world.ego import EgoMotion
from brink.sim.world.pedestrians import PERSON_HEIGHT_M
from brink.sim.world.scenario import TimeOfDay, Weather
from brink.sim.world.vehicle import brake_lights_on
from brink.sim.world.world import World

MODE: Final = "detector"
SIMULATOR_ID: Final = "brink-drive-camera@3"
SIZE_PX: Final = (640, 360)
PITCH_STEP_RAD: Final = 5e-4
STEPS_PER_S: Final = 1.9
"""Step rate of a walking person, for the pose of the legs."""

_FIELDS: Final = ("mode", "detector", "threshold", "weights")
_LABELS: Final = {"vehicle": ObstacleLabel.VEHICLE, "person": ObstacleLabel.PERSON}


class RoadCamera:
    """Renders what the ego's camera sees and returns a detector's boxes.

    The camera pitches with the ego's body, and stays at the same height above level ground. It does not see grades:
    a slope changes how the ego drives, and no image.

    Args:
        world: The world.
        light: Time of day and weather.
        seed: Selects the appearances.
        detector: The detector.
        threshold: Minimum score of a box.
        camera: The driving system's camera, which defines the image of the returned boxes.
    """

    def __init__(
        self, world: World, light: Light, *, seed: int, detector: Detector, threshold: float, camera: Camera
    ) -> None:
        cv2.setNumThreads(1)
        self._world = world
        self._detector = detector
        self._threshold = threshold
        self._camera = camera
        self._picture = PictureCamera(
            width_px=SIZE_PX[0],
            height_px=SIZE_PX[1],
            fov_deg=camera.fov_deg,
            height_m=camera.height_m,
            forward_m=camera.forward_m,
        )
        self._renderer = Renderer(street_from_road(world.road, seed=seed), light, self._picture, seed)

    def boxes(self, time_s: float) -> tuple[Box, ...]:
        """Return the current detections, in pixels of the driving system's image."""
        found = self._detector.detect(self.frame(time_s).image)
        return driving_boxes(found, found.scores >= self._threshold, self._picture, self._camera)

    def frame(self, time_s: float) -> Frame:
        """Return the current image; the ids of road users are their numbers from 1, vehicles first."""
        ego, signals = self._world.ego, self._world.signals
        shown = (
            {}
            if signals is None
            else {SignalGroup.MAIN: signals.main_at(time_s), SignalGroup.SIDE: signals.side_at(time_s)}
        )
        return self._renderer.frame(viewpoint_of(ego), _bodies(self._world, time_s), time_s, shown)


def viewpoint_of(ego: EgoMotion) -> Viewpoint:
    """Return the pose of the ego's camera.

    The pitch is rounded to 0.03 degrees, a sixth of a pixel, so that frames share the renderer's tables.
    """
    pitch_rad = PITCH_STEP_RAD * round(ego.pitch_rad / PITCH_STEP_RAD)
    return Viewpoint(x_m=ego.x_m, y_m=ego.y_m, yaw_rad=ego.yaw_rad, pitch_rad=pitch_rad)


def driving_boxes(
    found: Detections, reported: BoolArray, picture: PictureCamera, camera: Camera
) -> tuple[Box, ...]:
    """Return detections in the driving system's image: the same rays, different pixels.

    Args:
        found: All detections in a picture.
        reported: Which of them to return, shape ``(n,)``.
        picture: The camera of the picture.
        camera: The driving system's camera.
    """
    scale = camera.focal_px / picture.focal_px
    middle_x, middle_y = 0.5 * picture.width_px, 0.5 * picture.height_px
    return tuple(
        Box(
            label=_LABELS[LABELS[label]],
            x_min_px=camera.centre_x_px + (x_min - middle_x) * scale,
            x_max_px=camera.centre_x_px + (x_max - middle_x) * scale,
            y_min_px=camera.horizon_px + (y_min - middle_y) * scale,
            y_max_px=camera.horizon_px + (y_max - middle_y) * scale,
        )
        for label, (x_min, y_min, x_max, y_max) in zip(
            found.labels[reported].tolist(), found.boxes[reported].tolist(), strict=True
        )
    )


def check_detector(behaviour: Mapping[str, Json]) -> None:
    """Check a behaviour that names a detector.

    Raises:
        InvalidEpisode: It is not ``{"mode": "detector", "detector": …, "threshold": …}``, or the detector's file is
            not the one that was meant.
    """
    check_fields("behaviour", {"weights": "", **behaviour}, _FIELDS)
    if behaviour["mode"] != MODE:
        raise InvalidEpisode(f"behaviour.mode: expected {MODE}, got {behaviour['mode']!r}")
    threshold = behaviour["threshold"]
    if isinstance(threshold, bool) or not isinstance(threshold, int | float) or not 0 < threshold < 1:
        raise InvalidEpisode(f"behaviour.threshold: expected a number in (0, 1), got {threshold!r}")
    if not isinstance(behaviour["detector"], str):
        raise InvalidEpisode(
            f"behaviour.detector: expected an id such as {DEFAULT_DETECTOR}, got {behaviour['detector']!r}"
        )
    weights = behaviour.get("weights", "")
    if weights and weights != weights_digest(behaviour["detector"]):
        raise InvalidEpisode(
            f"behaviour.detector: {behaviour['detector']} differs from the file that the campaign was submitted with"
        )


class BrinkDriveCamera(BrinkDrive):
    """Runs urban episodes with a camera and a detector in the loop."""

    id = SIMULATOR_ID

    def _detector(self, spec: EpisodeSpec) -> UrbanDetector:
        check_detector(spec.behaviour)
        return InTheLoop(spec)


class InTheLoop:
    """A detector on rendered images, with its measured errors.

    Attributes:
        meter: Has the comparison of each image with the truth; None before the start.
    """

    def __init__(self, spec: EpisodeSpec) -> None:
        self.behaviour = DetectorBehaviour(mode=BehaviourMode.ORACLE)
        self._spec = spec
        self.meter: ErrorMeter | None = None

    def start(self, world: World, camera: Camera) -> Detects:
        """Return the detector for a new world."""
        spec = self._spec
        light = Light(
            time_of_day=TimeOfDay(str(spec.scenario["time_of_day"])),
            weather=Weather(str(spec.scenario["weather"])),
        )
        eyes = RoadCamera(
            world,
            light,
            seed=spec.seed,
            detector=find_detector(str(spec.behaviour["detector"])),
            threshold=float(str(spec.behaviour["threshold"])),
            camera=camera,
        )
        observer = Observer(world, camera)
        meter = self.meter = ErrorMeter(camera, in_lane=observer.is_in_lane)

        def detects(time_s: float) -> tuple[Box, ...]:
            found = eyes.boxes(time_s)
            level = camera.all_tilted(found, -world.ego.pitch_rad)
            truth = observer.look(time_s).true_boxes()
            meter.see(time_s, truth, [ReportedBox(box) for box in level], parked=observer.parked_boxes())
            return found

        return detects

    def features(self, outcome: Outcome) -> dict[str, Json]:
        """Return the detector's errors."""
        return {MEASURES: {}} if self.meter is None else measures_to_json(self.meter)


def _bodies(world: World, time_s: float) -> list[Body]:
    bodies = [
        Body(
            id=number,
            kind=BodyKind.VEHICLE,
            x_m=vehicle.x_m,
            y_m=vehicle.y_m,
            yaw_rad=vehicle.yaw_rad,
            length_m=vehicle.length_m,
            width_m=vehicle.width_m,
            height_m=vehicle.size.height_m,
            look=_look(number),
            braking=brake_lights_on(vehicle.speed_mps, vehicle.accel_mps2),
        )
        for number, vehicle in enumerate(world.vehicles, 1)
    ]
    bodies += [
        Body(
            id=number,
            kind=BodyKind.PERSON,
            x_m=walker.x_m,
            y_m=walker.y_m,
            yaw_rad=walker.yaw_rad,
            length_m=walker.length_m,
            width_m=walker.width_m,
            height_m=PERSON_HEIGHT_M,
            look=_look(number),
            phase=_gait(walker.speed_mps, time_s + 0.1 * number),
        )
        for number, walker in enumerate(world.walkers, 1 + len(bodies))
    ]
    return bodies


def _look(number: int) -> int:
    return 7 * number - 4


def _gait(speed_mps: float, time_s: float) -> float:
    """Return the pose of the legs of a person, as an angle in [0, 2 pi); 0 while the person stands."""
    return (2.0 * math.pi * STEPS_PER_S * time_s if speed_mps > 0.1 else 0.0) % (2.0 * math.pi)

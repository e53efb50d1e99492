"""What the brake perceives: ground truth, nothing, injected boxes, or a detector's boxes."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.aeb.braking import PERSON, VEHICLE, Detection, EmergencyBrake
from brink.sim.aeb.labels import MIN_VISIBLE, label_boxes
from brink.sim.aeb.scores import Scores, reported, score_episode
from brink.sim.aeb.street import Street
from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import PERCEPTION_STEP_S, Box, ObstacleLabel
from brink.sim.perception.boxes import MIN_HEIGHT_SHARE, MIN_WIDTH_SHARE, Detections, GroundTruth
from brink.sim.perception.detector import LABELS, Detector
from brink.sim.perturbations import Mode, Perturbation, Pipeline
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import Body, BodyKind, Light, PictureCamera, Viewpoint
from brink.sim.urban.behaviour import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX, InjectedTrajectory
from brink.sim.world.ego import EgoCar

Picture: TypeAlias = NDArray[np.uint8]


class CameraShot(NamedTuple):
    """One image of a camera in the loop, with its ground truth and detections.

    Attributes:
        picture: The image shown to the detector, RGB, shape ``(h, w, 3)``.
        truth: Ground truth, including ignored boxes.
        found: All detections.
    """

    picture: Picture
    truth: GroundTruth
    found: Detections


class FrameObservation(NamedTuple):
    """Result of observing one frame.

    Attributes:
        truth: Ground-truth boxes including unusual bodies; a fallen tree is labelled as a vehicle, since it blocks
            the road like one.
        detections: Boxes reported to the brake.
        shot: Image, ground truth and detections of the camera; None without a camera.
    """

    truth: tuple[Detection, ...]
    detections: tuple[Detection, ...]
    shot: CameraShot | None = None


class Sight(Protocol):
    """Observes each frame of an episode."""

    def observe(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> FrameObservation:
        """Observe a frame.

        Args:
            frame: Index of the frame.
            time_s: Time of the frame.
            street: The street.
            ego: The car under test.
        """
        ...


class OracleSight:
    """Computes the ground truth by geometry: boxes of all bodies in view that no nearer body covers.

    Args:
        width_px: Width of the image.
        height_px: Height of the image.
        reported: Whether the boxes are reported to the brake; if not, it receives no boxes.
    """

    def __init__(self, width_px: int, height_px: int, *, reported: bool = True) -> None:
        self._camera = Camera(
            width_px=width_px,
            height_px=height_px,
            min_width_px=MIN_WIDTH_SHARE * width_px,
            min_height_px=MIN_HEIGHT_SHARE * height_px,
            hidden_fraction=1.0 - MIN_VISIBLE,
        )
        self._reported = reported

    def observe(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> FrameObservation:
        """Observe a frame; see `Sight`."""
        bodies = [*(actor.current_body() for actor in street.actors), *street.scene.parked]
        seen = self._camera.look(ego.x_m, ego.y_m, ego.yaw_rad, [_prism(body) for body in bodies])
        truth = tuple(
            Detection(
                label=PERSON if sight.box.label is ObstacleLabel.PERSON else VEHICLE,
                x_min_px=sight.box.x_min_px,
                y_min_px=sight.box.y_min_px,
                x_max_px=sight.box.x_max_px,
                y_max_px=sight.box.y_max_px,
            )
            for sight in seen
        )
        return FrameObservation(truth, truth if self._reported else ())


class InjectedSight:
    """Reports only injected boxes to the brake.

    Args:
        width_px: Width of the image.
        height_px: Height of the image.
        trajectories: The boxes, in the urban simulator's image.
    """

    def __init__(self, width_px: int, height_px: int, trajectories: Sequence[InjectedTrajectory]) -> None:
        self._truth = OracleSight(width_px, height_px, reported=False)
        self._trajectories = trajectories
        self._scale = width_px / IMAGE_WIDTH_PX
        # Both cameras have the same horizontal field of view and horizon, so scaling and shifting is exact.
        self._shift_px = 0.5 * height_px - 0.5 * IMAGE_HEIGHT_PX * self._scale

    def observe(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> FrameObservation:
        """Observe a frame; see `Sight`."""
        boxes = [trajectory.box_at(time_s / PERCEPTION_STEP_S) for trajectory in self._trajectories]
        injected = tuple(self._placed(box) for box in boxes if box is not None)
        return FrameObservation(self._truth.observe(frame, time_s, street, ego).truth, injected)

    def _placed(self, box: Box) -> Detection:
        return Detection(
            label=PERSON if box.label is ObstacleLabel.PERSON else VEHICLE,
            x_min_px=box.x_min_px * self._scale,
            y_min_px=box.y_min_px * self._scale + self._shift_px,
            x_max_px=box.x_max_px * self._scale,
            y_max_px=box.y_max_px * self._scale + self._shift_px,
        )


def _prism(body: Body) -> Solid:
    label = ObstacleLabel.PERSON if body.kind is BodyKind.PERSON else ObstacleLabel.VEHICLE
    return Solid(label, body.x_m, body.y_m, body.yaw_rad, body.length_m, body.width_m, body.height_m)


def boxes_of(detections: Sequence[Detection]) -> list[tuple[float, float, float, float, float]]:
    """Return boxes as rows of label (0 vehicle, 1 person), x_min, x_max, y_min, y_max."""
    return [(float(d.label == PERSON), d.x_min_px, d.x_max_px, d.y_min_px, d.y_max_px) for d in detections]


class CameraSight:
    """Renders and perturbs each frame and runs a detector on it; keeps all ground truth and detections.

    Args:
        street: The street.
        light: Time of day and weather.
        size_px: Size of the images.
        seed: The episode's seed, for appearances and perturbations.
        detector: The detector.
        threshold: Minimum score of a detection reported to the brake.
        perturbations: Applied in order.
        mode: Whether random fields are drawn for each frame or once.
    """

    def __init__(
        self,
        street: Street,
        light: Light,
        size_px: tuple[int, int],
        *,
        seed: int,
        detector: Detector,
        threshold: float,
        perturbations: Sequence[Perturbation] = (),
        mode: Mode = Mode.PER_FRAME,
    ) -> None:
        cv2.setNumThreads(1)
        camera = PictureCamera(width_px=size_px[0], height_px=size_px[1])
        self._renderer = Renderer(street.scene, light, camera, seed)
        self._pipeline = Pipeline(tuple(perturbations), seed=seed, mode=mode)
        self._detector = detector
        self._threshold = threshold
        self._warning = EmergencyBrake.for_picture(*size_px).warning
        self._truths: list[GroundTruth] = []
        self._found: list[Detections] = []

    def observe(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> FrameObservation:
        """Observe a frame; see `Sight`."""
        view = Viewpoint(x_m=ego.x_m, y_m=ego.y_m, yaw_rad=ego.yaw_rad)
        picture = self._renderer.frame(view, [actor.current_body() for actor in street.actors], time_s)
        truth = label_boxes(picture)
        shown = self._pipeline(picture.image, frame)
        shot = CameraShot(shown, truth, self._detector.detect(shown))
        found = shot.found
        self._truths.append(shot.truth)
        self._found.append(found)
        passed = np.flatnonzero(reported(found, self._threshold, *shown.shape[1::-1])).tolist()
        detections = tuple(_detection(found, place) for place in passed)
        counting = np.flatnonzero(~truth.ignored).tolist()
        return FrameObservation(tuple(_true_box(truth, place) for place in counting), detections, shot)

    def scores(self) -> Scores:
        """Return the detector's scores over all frames so far."""
        return score_episode(self._truths, self._found, self._threshold, self._warning)


def _true_box(truth: GroundTruth, place: int) -> Detection:
    return Detection(LABELS[truth.labels[place]], *truth.boxes[place].tolist())


def _detection(found: Detections, place: int) -> Detection:
    x_min, y_min, x_max, y_max = found.boxes[place].tolist()
    return Detection(LABELS[found.labels[place]], x_min, y_min, x_max, y_max, float(found.scores[place]))

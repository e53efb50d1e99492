"""The camera in the loop: each frame is rendered, perturbed, and shown to the detector."""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from brink.sim.aeb.braking import PERSON, VEHICLE, Detection, EmergencyBrake
from brink.sim.aeb.scores import Scores, scored
from brink.sim.aeb.sight import MIN_HEIGHT_SHARE, Look, Shot
from brink.sim.aeb.street import Street
from brink.sim.perception.detector import LABELS, Detector
from brink.sim.perception.quality import Found, Truth
from brink.sim.perturbations import Mode, Perturbation, Pipeline
from brink.sim.rendering.canvas import visible_bodies
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import BodyKind, Frame, Light, PictureCamera, Viewpoint
from brink.sim.world.ego import EgoCar

MIN_VISIBLE: Final = 0.25


class CameraSight:
    """Renders, perturbs, detects; keeps what was there and what was found.

    Args:
        street: Where it happens.
        light: Sun and sky.
        size_px: Of the pictures.
        seed: The episode's seed: decides the looks and the perturbations' fields.
        detector: What looks at the pictures.
        threshold: Least score of a detection that the brake is told.
        perturbations: Applied left to right.
        mode: Whether their fields are drawn for each frame, or once.
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
        self._truths: list[Truth] = []
        self._found: list[Found] = []

    def look(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> Look:
        """Return what is seen in a frame."""
        view = Viewpoint(x_m=ego.x_m, y_m=ego.y_m, yaw_rad=ego.yaw_rad)
        picture = self._renderer.frame(view, [actor.now() for actor in street.actors], time_s)
        truth, ignored = ground_truth(picture)
        shown = self._pipeline(picture.image, frame)
        shot = Shot(shown, _rows(truth, ignored), self._detector.detect(shown))
        found = shot.found
        self._truths.append(shot.truth)
        self._found.append(found)
        sure = np.flatnonzero(found.scores >= self._threshold).tolist()
        detections = tuple(_detection(found, place) for place in sure)
        counting = tuple(box for box, skip in zip(truth, ignored, strict=True) if not skip)
        return Look(counting, detections, shot)

    def scores(self) -> Scores:
        """Return how well the detector did in all frames so far."""
        return scored(self._truths, self._found, self._threshold, self._warning)


def ground_truth(frame: Frame) -> tuple[list[Detection], list[bool]]:
    """Return the visible part of everybody, and who does not count: too low, or nearly hidden.

    A fallen tree is labelled a vehicle, since it stands in the way like one.
    """
    boxes, ignored = [], []
    least_px = MIN_HEIGHT_SHARE * frame.image.shape[0]
    for body in visible_bodies(frame):
        if body.box is None:
            continue
        label = PERSON if body.kind is BodyKind.PERSON else VEHICLE
        boxes.append(Detection(label, *(float(edge) for edge in body.box)))
        ignored.append(body.box.y_max_px - body.box.y_min_px < least_px or body.visible_share < MIN_VISIBLE)
    return boxes, ignored


def _detection(found: Found, place: int) -> Detection:
    x_min, y_min, x_max, y_max = found.boxes[place].tolist()
    return Detection(LABELS[found.labels[place]], x_min, y_min, x_max, y_max, float(found.scores[place]))


def _rows(boxes: Sequence[Detection], ignored: Sequence[bool]) -> Truth:
    return Truth(
        labels=np.array([LABELS.index(box.label) for box in boxes], np.int64),
        boxes=np.array([box[1:5] for box in boxes], np.float32).reshape(len(boxes), 4),
        ignored=np.array(ignored, np.bool_),
    )

"""What the brake is told: by ground truth, by nobody, by boxes that are made up, or by a detector that looks."""

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.aeb.braking import PERSON, VEHICLE, Detection
from brink.sim.aeb.street import Street
from brink.sim.driving.camera import Body as Prism
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.perception.quality import Found, Truth
from brink.sim.rendering.scene import Body, BodyKind
from brink.sim.urban.behaviour import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX, PERCEPTION_STEP_S, InjectedTrajectory
from brink.sim.world.ego import EgoCar

Picture: TypeAlias = NDArray[np.uint8]

MIN_HEIGHT_SHARE: Final = 8.0 / 360.0
"""Lower ground-truth boxes do not count: 8 px in a picture of 640 x 360."""


class Shot(NamedTuple):
    """One picture of a camera in the loop.

    Attributes:
        picture: As the detector was shown it, RGB, shape ``(h, w, 3)``.
        truth: What is there, what does not count included.
        found: All that the detector found.
    """

    picture: Picture
    truth: Truth
    found: Found


class Look(NamedTuple):
    """What one frame gave.

    Attributes:
        truth: Ground-truth boxes, unusual bodies included: a fallen tree is labelled a vehicle, since it stands in
            the way like one.
        detections: What the brake is told.
        shot: What the camera and the detector gave; None without them.
    """

    truth: tuple[Detection, ...]
    detections: tuple[Detection, ...]
    shot: Shot | None = None


class Sight(Protocol):
    """Gives each frame of an episode."""

    def look(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> Look:
        """Return what is seen in a frame."""
        ...


class GroundTruth:
    """Boxes of everybody in view, by geometry; a body that a nearer one covers is not seen.

    Args:
        width_px: Of the picture.
        height_px: Of the picture.
        told: Whether the brake is told; otherwise it is told nothing.
    """

    def __init__(self, width_px: int, height_px: int, *, told: bool = True) -> None:
        self._camera = Camera(
            width_px=width_px, height_px=height_px, min_height_px=MIN_HEIGHT_SHARE * height_px
        )
        self._told = told

    def look(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> Look:
        """Return what is seen in a frame."""
        bodies = [*(actor.now() for actor in street.actors), *street.scene.parked]
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
        return Look(truth, truth if self._told else ())


class Injected:
    """Boxes that are made up: the brake is told nothing else.

    Args:
        width_px: Of the picture.
        height_px: Of the picture.
        trajectories: The boxes, in the urban simulator's image.
    """

    def __init__(self, width_px: int, height_px: int, trajectories: Sequence[InjectedTrajectory]) -> None:
        self._truth = GroundTruth(width_px, height_px, told=False)
        self._trajectories = trajectories
        self._scale = width_px / IMAGE_WIDTH_PX
        # Cameras with the same horizontal field of view see the same there, around the same horizon.
        self._shift_px = 0.5 * height_px - 0.5 * IMAGE_HEIGHT_PX * self._scale

    def look(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> Look:
        """Return what is there, and what was made up for this time."""
        boxes = [trajectory.box_at(time_s / PERCEPTION_STEP_S) for trajectory in self._trajectories]
        said = tuple(self._placed(box) for box in boxes if box is not None)
        return Look(self._truth.look(frame, time_s, street, ego).truth, said)

    def _placed(self, box: Box) -> Detection:
        return Detection(
            label=PERSON if box.label is ObstacleLabel.PERSON else VEHICLE,
            x_min_px=box.x_min_px * self._scale,
            y_min_px=box.y_min_px * self._scale + self._shift_px,
            x_max_px=box.x_max_px * self._scale,
            y_max_px=box.y_max_px * self._scale + self._shift_px,
        )


def _prism(body: Body) -> Prism:
    label = ObstacleLabel.PERSON if body.kind is BodyKind.PERSON else ObstacleLabel.VEHICLE
    return Prism(label, body.x_m, body.y_m, body.yaw_rad, body.length_m, body.width_m, body.height_m)


def boxes_of(detections: Sequence[Detection]) -> list[tuple[float, float, float, float, float]]:
    """Return boxes as rows of label (0 vehicle, 1 person), x_min, x_max, y_min, y_max."""
    return [(float(d.label == PERSON), d.x_min_px, d.x_max_px, d.y_min_px, d.y_max_px) for d in detections]

"""Recordings with three-dimensional positions: their boxes in the driving system's image.

Every object, true or detected, is an upright box on level ground, and is projected into the driving system's own
camera on the ego. So truth and detections are compared in the same image, and no camera of the recording is needed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from brink.recordings.format import RecordingBuilder
from brink.recordings.recording import Detection, ReadOptions, RecordedDrive, RecordingError, RoadUser, Sides
from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import Target
from brink.sim.urban.error_meter import HALF_LANE_M

CAMERA: Final = Camera()
_MOST_M: Final = 1e7
_LONGEST_M: Final = 200.0


class Pose(NamedTuple):
    """The centre of the ego and its heading."""

    x_m: float
    y_m: float
    yaw_rad: float


def refuse_cameras(title: str, options: ReadOptions) -> None:
    """Refuse the user's cameras.

    Raises:
        RecordingError: There is one.
    """
    if options.camera is not None or options.cameras:
        raise RecordingError(
            f"{title} says where things are in three dimensions, so that boxes are computed for the driving system's "
            "camera; expected no camera, got one (--camera, or a camera in the file of --calibration)"
        )


def checked_body(where: str, place: Sequence[float], yaw_rad: float, size: Sequence[float]) -> Solid:
    """Return an object.

    Args:
        where: Where it stands, for messages.
        place: x and y of its centre, in m.
        yaw_rad: Its heading.
        size: Its length, width and height, in m.

    Raises:
        RecordingError: A number is not finite, or cannot be meant in metres.
    """
    if not all(abs(one) <= _MOST_M for one in (*place, yaw_rad)):
        raise RecordingError(f"{where}: expected a place and a heading in m and rad, got {[*place, yaw_rad]}")
    if not all(0.0 < one <= _LONGEST_M for one in size):
        raise RecordingError(
            f"{where}: expected a length, width and height between 0 and {_LONGEST_M:g} m, got {list(size)}"
        )
    return Solid(ObstacleLabel.VEHICLE, place[0], place[1], yaw_rad, *size)


def target_by_heading(ego: Pose, body: Solid) -> Target:
    """Return the direction of a vehicle relative to the ego."""
    turn_deg = abs(math.degrees(math.remainder(body.yaw_rad - ego.yaw_rad, math.tau)))
    if turn_deg <= 45.0:
        return Target.LEAD
    return Target.ONCOMING if turn_deg >= 135.0 else Target.CROSSING


class _View(NamedTuple):
    sides: Sides
    distance_m: float
    left_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundImage:
    """An image of a drive to which objects in three dimensions are added.

    Attributes:
        builder: Builds the recording; counts what is outside the driving system's image.
        drive: The drive.
        time_s: Time of the image.
        ego: The ego at this time, in the frame of the objects.
    """

    builder: RecordingBuilder
    drive: RecordedDrive
    time_s: float
    ego: Pose

    def add_truth(
        self,
        where: str,
        name: str,
        track: str,
        body: Solid,
        *,
        has_region: bool = True,
        shares_lane: bool | None = None,
        occlusion: int | None = None,
        visible_share: float | None = None,
    ) -> None:
        """Add a true object.

        Args:
            where: Where it stands, for messages.
            name: Its class.
            track: Identifies it within its drive.
            body: The object.
            has_region: Whether its box is a region to ignore if its class is ignored.
            shares_lane: Whether it is assigned to the ego's lane; None if lanes are unknown. A lane ends somewhere,
                so that what is straight ahead is in the ego's lane as well.
            occlusion: As in `RoadUser`.
            visible_share: As in `RoadUser`.

        Raises:
            RecordingError: Nobody said what the class means, or the recording is too large.
        """
        label = self.builder.label(where, name)
        if label is None and not has_region:
            return
        view = self._view(body, "true objects")
        if view is None:
            return
        if label is None:
            self.builder.add_region(where, self.drive, self.time_s, view.sides)
            return
        is_ahead = abs(view.left_m) < HALF_LANE_M
        road_user = RoadUser(
            track=track,
            label=label,
            sides=view.sides,
            target=target_by_heading(self.ego, body) if label is ObstacleLabel.VEHICLE else None,
            distance_m=view.distance_m,
            left_m=view.left_m,
            in_lane=None if shares_lane is None else shares_lane or is_ahead,
            occlusion=occlusion,
            visible_share=visible_share,
        )
        self.builder.add_road_user(where, self.drive, self.time_s, road_user)

    def add_detection(self, where: str, name: str, body: Solid, score: float) -> None:
        """Add a detection.

        Raises:
            RecordingError: Nobody said what the class means, or the recording is too large.
        """
        label = self.builder.label(where, name)
        if label is None:
            self.builder.drop_detection(where, name)
            return
        view = self._view(body, "detections")
        if view is not None:
            detection = Detection(
                label=label, sides=view.sides, score=score, distance_m=view.distance_m, left_m=view.left_m
            )
            self.builder.add_detection(where, self.drive, self.time_s, detection)

    def _view(self, body: Solid, kind: str) -> _View | None:
        seen = CAMERA.project(*self.ego, body)
        if seen is None:
            self.builder.recording.dropped[f"{kind} outside the driving system's image"] += 1
            return None
        box, distance_m = seen
        dx, dy = body.x_m - self.ego.x_m, body.y_m - self.ego.y_m
        left_m = dy * math.cos(self.ego.yaw_rad) - dx * math.sin(self.ego.yaw_rad)
        sides = Sides(box.x_min_px, box.x_max_px, box.y_min_px, box.y_max_px)
        return _View(sides, distance_m, left_m)

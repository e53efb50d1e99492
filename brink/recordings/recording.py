"""The contents of a recording: drives, their images, the true road users in each, and a detector's reports.

Readers of all formats return a `Recording`. Boxes are in pixels of the drive's own camera; `brink.recordings.measure`
converts them to the driving system's image and measures the detector's errors.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

from brink.recordings.camera import CameraModel
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.errors import SimulatorError
from brink.sim.urban.detection_errors import Target

MAX_BYTES: Final = 512 * 1024**2
"""Maximum size of a file."""
MAX_BOXES: Final = 5_000_000
"""Maximum number of boxes of a recording."""
MAX_IMAGES: Final = 1_000_000
"""Maximum number of images of a recording."""
MAX_SEQUENCES: Final = 10_000
"""Maximum number of files or folders that are read from a folder."""
MAX_TIME_S: Final = 1e11
"""Largest time, so that seconds and milliseconds since 1970 fit."""
TIME_DECIMALS: Final = 3
"""Decimal places of times: images within a millisecond are one."""


class RecordingError(SimulatorError):
    """A recording cannot be used; the message says where and why."""


class Sides(NamedTuple):
    """The sides of a box, in pixels of the drive's camera."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadUser:
    """A true road user in one image.

    Attributes:
        track: Identifies the road user within its drive.
        label: What a detector should report.
        sides: Its box.
        target: Which way a vehicle goes relative to the ego: lead (the same way), oncoming or crossing; None if that
            is unknown.
        distance_m: Distance of its nearest point ahead of the camera; None to take it from the box's bottom edge.
        left_m: How far left of the middle of the ego's lane its middle is; None to take it from the box.
        in_lane: Whether it is in the ego's lane; None to decide by `left_m`.
        occlusion: 0 visible, 1 partly hidden, 2 largely hidden, 3 unknown; None if nothing is said.
        visible_share: Share of it that is visible, in [0, 1]; None if nothing is said.
        truncation: Share of it outside the image, in [0, 1]; None if nothing is said.
    """

    track: str
    label: ObstacleLabel
    sides: Sides
    target: Target | None = None
    distance_m: float | None = None
    left_m: float | None = None
    in_lane: bool | None = None
    occlusion: int | None = None
    visible_share: float | None = None
    truncation: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """One report of the detector.

    Attributes:
        label: Its label.
        sides: Its box.
        score: Its score; 1 if the recording has none.
        distance_m: Reported distance of its nearest point; None to take it from the bottom edge of the box.
        left_m: Reported place to the left of the middle of the ego's lane; None to take it from the box.
    """

    label: ObstacleLabel
    sides: Sides
    score: float = 1.0
    distance_m: float | None = None
    left_m: float | None = None


@dataclass(slots=True, kw_only=True)
class Image:
    """One image of a drive.

    Attributes:
        time_s: Its time.
        road_users: All true road users in it, hidden ones included.
        detections: What was reported, whatever the score.
        ignored: Regions in which nothing was labelled, so that detections there are neither right nor wrong.
    """

    time_s: float
    road_users: list[RoadUser] = field(default_factory=list)
    detections: list[Detection] = field(default_factory=list)
    ignored: list[Sides] = field(default_factory=list)


@dataclass(slots=True, kw_only=True)
class RecordedDrive:
    """A drive.

    Attributes:
        name: Its name.
        images: Its images by time, in any order.
        detections_elsewhere: Detections at times at which there is no image, by time.
        condition: Name of its condition; None if nothing is said.
        camera: Its camera; None for that of the whole recording.
    """

    name: str
    images: dict[float, Image] = field(default_factory=dict)
    detections_elsewhere: dict[float, list[Detection]] = field(default_factory=dict)
    condition: str | None = None
    camera: CameraModel | None = None

    @property
    def length_s(self) -> float:
        """Time from its first image to its last."""
        return max(self.images) - min(self.images) if self.images else 0.0

    def image(self, time_s: float) -> Image:
        """Return the image at a time, which is added if there is none.

        Raises:
            RecordingError: The time is beyond `MAX_TIME_S`.
        """
        time_s = self._time(time_s)
        image = self.images.get(time_s)
        if image is None:
            image = self.images[time_s] = Image(time_s=time_s)
        return image

    def report(self, time_s: float, detection: Detection) -> None:
        """Add a detection to the image at its time; without an image, to `detections_elsewhere`.

        Raises:
            RecordingError: The time is beyond `MAX_TIME_S`.
        """
        time_s = self._time(time_s)
        image = self.images.get(time_s)
        if image is None:
            self.detections_elsewhere.setdefault(time_s, []).append(detection)
        else:
            image.detections.append(detection)

    def _time(self, time_s: float) -> float:
        if not abs(time_s) <= MAX_TIME_S:
            raise RecordingError(
                f"drive {self.name}: expected a time within {MAX_TIME_S:g} s of 0, got {time_s:g} s"
            )
        return round(time_s, TIME_DECIMALS)

    def place_detections(self) -> None:
        """Move detections that were read before the image at their time to that image."""
        for time_s in self.detections_elsewhere.keys() & self.images.keys():
            self.images[time_s].detections.extend(self.detections_elsewhere.pop(time_s))


@dataclass(slots=True, kw_only=True)
class Recording:
    """Drives with truth and detections.

    Attributes:
        name: What to call the detector, such as the name of the file with its detections.
        drives: The drives by name.
        camera: The camera of drives without one of their own; None for the driving system's.
        dropped: How many rows or boxes of the files were left out, by reason, such as ``boxes without width or
            height``.
        notes: What the reader assumed or did not read, in sentences for the user.
    """

    name: str
    drives: dict[str, RecordedDrive] = field(default_factory=dict)
    camera: CameraModel | None = None
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def drive(self, name: str) -> RecordedDrive:
        """Return a drive, which is added if there is none."""
        drive = self.drives.get(name)
        if drive is None:
            drive = self.drives[name] = RecordedDrive(name=name)
        return drive


class ClassMeaning(StrEnum):
    """The meaning of a class of a data set for the driving system."""

    VEHICLE = "vehicle"
    PERSON = "person"
    IGNORE = "ignore"


CLASSES: Final[Mapping[str, ClassMeaning]] = {
    **dict.fromkeys(("vehicle", "car", "truck", "bus", "van"), ClassMeaning.VEHICLE),
    **dict.fromkeys(("person", "pedestrian"), ClassMeaning.PERSON),
}
"""Classes that every format knows; the user may add others, such as cyclists, and say what they mean."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadOptions:
    """The user's settings for a recording, which its files do not contain.

    Attributes:
        classes: Meaning of each class, by its name in lower case; classes of the format that are not among them are
            refused with a hint to name them.
        frames_per_s: Images per second, for formats that number images.
        clip: Whether boxes that reach beyond the image are clipped; otherwise they are refused.
        camera: The camera of all drives; None for the driving system's, or for what the format says.
        cameras: Cameras of single drives, by name.
        condition: Condition of all drives of which the files say nothing.
        conditions: Conditions of single drives, by name.
    """

    classes: Mapping[str, ClassMeaning] = field(default_factory=lambda: dict(CLASSES))
    frames_per_s: float | None = None
    clip: bool = False
    camera: CameraModel | None = None
    cameras: Mapping[str, CameraModel] = field(default_factory=dict)
    condition: str | None = None
    conditions: Mapping[str, str] = field(default_factory=dict)

    def meaning(self, where: str, name: str) -> ClassMeaning:
        """Return the meaning of a class.

        Raises:
            RecordingError: Nobody said what it means.
        """
        found = self.classes.get(name.strip().lower())
        if found is None:
            raise RecordingError(
                f"{where}: label: expected one of {', '.join(self.classes)}; got {name!r} (say what it means with "
                f"--classes {name.strip().lower() or 'NAME'}=vehicle, =person or =ignore)"
            )
        return found

    def label(self, where: str, name: str) -> ObstacleLabel | None:
        """Return what a detector should report for a class; None if the class is to be ignored.

        Raises:
            RecordingError: Nobody said what the class means.
        """
        return LABELS.get(self.meaning(where, name))

    def camera_of(self, drive: str) -> CameraModel | None:
        """Return the camera that the user gave for a drive; None if there is none."""
        return self.cameras.get(drive, self.camera)


LABELS: Final[Mapping[ClassMeaning, ObstacleLabel]] = {
    ClassMeaning.VEHICLE: ObstacleLabel.VEHICLE,
    ClassMeaning.PERSON: ObstacleLabel.PERSON,
}


def checked_sides(
    where: str,
    sides: Sequence[float],
    recording: Recording,
    options: ReadOptions,
    size_px: tuple[float, float] | None,
) -> Sides | None:
    """Return a box clipped to its image; None if nothing of it is left, which is counted in the recording.

    Args:
        where: Where the box stands, for messages.
        sides: x_min, x_max, y_min, y_max.
        recording: Counts what is dropped.
        options: Whether boxes are clipped.
        size_px: Width and height of the image; None if they are unknown.

    Raises:
        RecordingError: A side is on the wrong side of the other, or the box reaches beyond the image.
    """
    x_min, x_max, y_min, y_max = sides
    if x_min > x_max or y_min > y_max:
        raise RecordingError(
            f"{where}: expected x_min_px <= x_max_px and y_min_px <= y_max_px, got {list(sides)}"
        )
    if size_px is not None:
        width_px, height_px = size_px
        reaches_beyond = (
            x_min < -_SLACK_PX
            or y_min < -_SLACK_PX
            or x_max > width_px + _SLACK_PX
            or y_max > height_px + _SLACK_PX
        )
        if reaches_beyond and not options.clip:
            raise RecordingError(
                f"{where}: the box {x_min:g} to {x_max:g}, {y_min:g} to {y_max:g} px reaches beyond the image of "
                f"{width_px:g} x {height_px:g} px; expected the camera of the images (--camera or --calibration), "
                "or --clip to clip boxes"
            )
        if reaches_beyond:
            recording.dropped["boxes clipped to the image"] += 1
        x_min, x_max = max(x_min, 0.0), min(x_max, width_px)
        y_min, y_max = max(y_min, 0.0), min(y_max, height_px)
    if x_max <= x_min or y_max <= y_min:
        recording.dropped["boxes without width or height"] += 1
        return None
    return Sides(x_min, x_max, y_min, y_max)


_SLACK_PX: Final = 1.0
"""Boxes may reach beyond the image by this much: sides of pixels are counted from 0 or 1, or rounded."""

"""A format of recordings: how it is recognised and read, and the builder that every reader fills.

The builder owns what all formats share: boxes are checked against the camera's image, what is dropped is counted, a
track occurs once in an image, and a recording stays within its bounds.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from brink.recordings.camera import CameraModel
from brink.recordings.recording import (
    MAX_BOXES,
    MAX_IMAGES,
    ClassMeaning,
    Detection,
    ReadOptions,
    RecordedDrive,
    Recording,
    RecordingError,
    RoadUser,
    Sides,
    checked_sides,
)
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import Target

TARGETS: Final = {target.value: target for target in (Target.LEAD, Target.ONCOMING, Target.CROSSING)}
"""What a true vehicle can be said to be."""
ASSUMED_FOV_DEG: Final = 90.0
"""Field of view of a camera of which only the size of its images is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A format of recordings.

    Attributes:
        name: Its name on the command line.
        title: Its name in the documentation.
        expects: Which files it looks for: the end of the sentence "Expected ...".
        recognises: Whether the files of detections and of truth look like this format.
        read: Reads a recording from detections and truth; the truth is None if the user named none.
        classes: What its own classes mean unless the user says otherwise.
    """

    name: str
    title: str
    expects: str
    recognises: Callable[[Path, Path | None], bool]
    read: Callable[[Path, Path | None, ReadOptions], Recording]
    classes: Mapping[str, ClassMeaning] = field(default_factory=dict)


class RecordingBuilder:
    """Builds a recording from the rows of a format.

    Attributes:
        recording: What was built so far.
        options: What the user says.
    """

    def __init__(self, name: str, options: ReadOptions) -> None:
        self.recording = Recording(name=name, camera=options.camera)
        self.options = options
        self._boxes = 0
        self._images = 0
        self._tracks: set[tuple[str, float, str]] = set()

    def drive(self, name: str, camera: CameraModel | None = None) -> RecordedDrive:
        """Return a drive, adding it if it is new.

        Args:
            name: Its name.
            camera: Its camera by the recording's files, for a drive that is added; the user's comes first.
        """
        drive = self.recording.drives.get(name)
        if drive is None:
            drive = self.recording.drive(name)
            drive.camera = self.options.camera_of(name) or camera
        return drive

    def check_size(self, where: str, drive: RecordedDrive, width_px: float, height_px: float) -> None:
        """Check that the camera of a drive has the size given in its files.

        Raises:
            RecordingError: It has another.
        """
        camera = drive.camera
        if camera is not None and (camera.width_px, camera.height_px) != (width_px, height_px):
            raise RecordingError(
                f"{where}: the images of drive {drive.name} are {width_px:g} x {height_px:g} px, but those of its "
                f"camera {camera.width_px:g} x {camera.height_px:g} px"
            )

    def note_assumed_camera(self, where: Path) -> None:
        """Add a note that the cameras of some drives were assumed, unless the user gave all of them."""
        if any(self.options.camera_of(name) is None for name in self.recording.drives):
            self.recording.notes.append(
                f"{where} does not say which camera took the images. Assumed a level one with a horizontal field of "
                f"view of {ASSUMED_FOV_DEG:g} degrees, {_OWN.above_m:g} m above the ground; distances depend on it "
                "(--camera or --calibration)."
            )

    def pair_sequences(
        self, truth: Mapping[str, Path], detections: Mapping[str, Path], looked_for: str
    ) -> list[tuple[str, Path, Path]]:
        """Return name, truth and detections of each sequence that has both; count and note what was left out.

        Args:
            truth: Where the truth of each sequence is.
            detections: Where its detections are. A file without rows says that nothing was detected.
            looked_for: Which files were looked for, for messages.

        Raises:
            RecordingError: No sequence has both.
        """
        both = sorted(truth.keys() & detections.keys())
        if not both:
            raise RecordingError(
                f"expected sequences with truth and detections: {looked_for}; found truth of {_names(truth)}, and "
                f"detections of {_names(detections)}"
            )
        for lacking, names in (("detections", truth.keys() - both), ("truth", detections.keys() - both)):
            if names:
                self.recording.dropped[f"sequences without a file of {lacking}"] += len(names)
                self.recording.notes.append(
                    f"Left out, without a file of {lacking}: {_names(names)}."
                    + (" An empty file says that nothing was detected." if lacking == "detections" else "")
                )
        return [(name, truth[name], detections[name]) for name in both]

    def set_condition(self, where: str, drive: RecordedDrive, condition: object) -> None:
        """Set the condition of a drive; None leaves it unset.

        Raises:
            RecordingError: It is not text, or differs from before.
        """
        if condition is None:
            return
        if not isinstance(condition, str) or drive.condition not in (None, condition):
            expected = "a name" if drive.condition is None else repr(drive.condition)
            raise RecordingError(
                f"{where}: condition: expected {expected} throughout drive {drive.name}, got {condition!r:.80}"
            )
        drive.condition = condition

    def add_image(self, where: str, drive: RecordedDrive, time_s: float) -> None:
        """Add an image, unless there is one at that time.

        Raises:
            RecordingError: The recording has too many images.
        """
        before = len(drive.images)
        drive.image(time_s)
        self._images += len(drive.images) - before
        if self._images > MAX_IMAGES:
            raise RecordingError(f"{where}: expected at most {MAX_IMAGES} images in a recording")

    def add_frames(self, where: str, drive: RecordedDrive, count: int, frames_per_s: float) -> None:
        """Add the images of a drive that begins at 0 s, where they are missing.

        Raises:
            RecordingError: The recording has too many images.
        """
        if count > MAX_IMAGES:  # said at once: that many take long to add
            raise RecordingError(f"{where}: expected at most {MAX_IMAGES} images in a recording, got {count}")
        for frame in range(count):
            self.add_image(where, drive, frame / frames_per_s)

    def add_road_user(self, where: str, drive: RecordedDrive, time_s: float, road_user: RoadUser) -> None:
        """Add a true road user to an image, adding the image if it is new.

        Raises:
            RecordingError: Its track is empty or occurs twice in the image, something that is said of it is out of
                range, or its box cannot be.
        """
        _check_said(where, road_user)
        self.add_image(where, drive, time_s)
        image = drive.image(time_s)
        key = (drive.name, image.time_s, road_user.track)
        if not road_user.track:
            raise RecordingError(f"{where}: id: expected the id of a true road user, got nothing")
        if key in self._tracks:
            raise RecordingError(f"{where}: id {road_user.track!r} occurs twice at {time_s:g} s")
        self._tracks.add(key)
        sides = self._sides(where, drive, road_user.sides)
        if sides is not None:
            truncation = road_user.truncation
            if truncation is None and sides != road_user.sides:
                truncation = 1.0 - _area(sides) / _area(road_user.sides)
            image.road_users.append(replace(road_user, sides=sides, truncation=truncation))

    def add_region(self, where: str, drive: RecordedDrive, time_s: float, sides: Sequence[float]) -> None:
        """Add a region to ignore to an image, adding the image if it is new; the region may exceed the image.

        Raises:
            RecordingError: Its sides are swapped.
        """
        self.add_image(where, drive, time_s)
        self._count_box(where)
        region = checked_sides(where, sides, self.recording, self.options, None)
        if region is not None:
            drive.image(time_s).ignored.append(region)

    def add_detection(self, where: str, drive: RecordedDrive, time_s: float, detection: Detection) -> None:
        """Add a detection, without adding an image.

        Raises:
            RecordingError: Its box cannot be, or it is reported behind the camera.
        """
        _check_distance(where, detection.distance_m)
        sides = self._sides(where, drive, detection.sides)
        if sides is not None:
            drive.report(time_s, detection if sides == detection.sides else replace(detection, sides=sides))

    def label(self, where: str, name: str) -> ObstacleLabel | None:
        """Return what a detector should report for a class; None to ignore its boxes.

        Raises:
            RecordingError: Nobody said what the class means.
        """
        return self.options.label(where, name)

    def drop_detection(self, where: str, name: str) -> None:
        """Count a detection of a class to ignore."""
        self._count_box(where)
        self.recording.dropped[f"detections of the class {name.strip().lower():.40}, which is ignored"] += 1

    def _sides(self, where: str, drive: RecordedDrive, sides: Sequence[float]) -> Sides | None:
        self._count_box(where)
        camera = drive.camera or self.recording.camera or _OWN
        return checked_sides(where, sides, self.recording, self.options, (camera.width_px, camera.height_px))

    def _count_box(self, where: str) -> None:
        self._boxes += 1
        if self._boxes > MAX_BOXES:
            raise RecordingError(f"{where}: expected at most {MAX_BOXES} boxes in a recording")


_OWN: Final = CameraModel.own()
_SHOWN: Final = 8


def assumed_camera(width_px: float, height_px: float) -> CameraModel:
    """Return a level camera at the height of the driving system's, for images of which only the size is known."""
    return CameraModel.level(width_px, height_px, ASSUMED_FOV_DEG, _OWN.above_m)


def target_of(where: str, name: object) -> Target | None:
    """Return the target class of a true vehicle; None if it is unknown, or for a pedestrian.

    Raises:
        RecordingError: The name is unknown.
    """
    if name in (None, "", Target.PEDESTRIAN.value):
        return None
    if not isinstance(name, str) or name not in TARGETS:
        raise RecordingError(
            f"{where}: target: expected one of {', '.join(TARGETS)}, or nothing; got {name!r:.80}"
        )
    return TARGETS[name]


def _names(names: Iterable[str]) -> str:
    ordered = sorted(names)
    more = f" and {len(ordered) - _SHOWN} more" if len(ordered) > _SHOWN else ""
    return ", ".join(ordered[:_SHOWN]) + more or "none"


def _area(sides: Sides) -> float:
    return (sides.x_max - sides.x_min) * (sides.y_max - sides.y_min)


def _check_said(where: str, road_user: RoadUser) -> None:
    """Check the attributes of a road user.

    Raises:
        RecordingError: A value is out of range.
    """
    if road_user.occlusion is not None and road_user.occlusion not in range(4):
        raise RecordingError(f"{where}: occlusion: expected 0, 1, 2 or 3, got {road_user.occlusion}")
    for name, share in (("visible_share", road_user.visible_share), ("truncation", road_user.truncation)):
        if share is not None and not 0.0 <= share <= 1.0:
            raise RecordingError(f"{where}: {name}: expected a share between 0 and 1, got {share:g}")
    _check_distance(where, road_user.distance_m)


def _check_distance(where: str, distance_m: float | None) -> None:
    if distance_m is not None and distance_m < 0.0:
        raise RecordingError(
            f"{where}: distance_m: expected the distance of something ahead, got {distance_m:g}"
        )

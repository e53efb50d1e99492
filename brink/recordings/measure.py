"""A detector's errors in each drive of a recording, measured as in simulated drives with a camera.

Boxes are converted to the driving system's image, so that distances mean the same everywhere. Where the recording
says how far away or how far aside something is, that is used instead of the box.
"""

import bisect
import itertools
import math
import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from brink.recordings.camera import CameraModel
from brink.recordings.choices import Visibility
from brink.recordings.recording import Detection, Image, RecordedDrive, Recording, RecordingError, RoadUser
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.urban.detection_errors import PEDESTRIAN_WITHIN_M, Target
from brink.sim.urban.error_meter import (
    HALF_LANE_M,
    SUSTAINED_S,
    ErrorMeter,
    MeasuredDrive,
    ReportedBox,
    TrueBox,
)

STEPS_S: Final = (0.005, 0.6)
"""Shortest and longest time between images."""
VEHICLE_HEIGHTS_M: Final = (1.0, 3.2)
"""Where the median height of vehicles is expected, if camera and boxes fit together."""
RATIOS: Final = (0.8, 1.25)
"""Where the median ratio of distances by the box to those of the recording is expected, likewise."""
_LEAST_BOXES: Final = 50
_TOO_SHORT: Final = f"drives with less than {SUSTAINED_S:g} s of truth"


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservedDrive:
    """A drive whose detections were compared with the truth.

    Attributes:
        drive: The drive.
        step_s: Time between its images.
        meter: Has the comparison of each image, in the driving system's image.
        measured: How wrong the detector was.
        tracks: Ids of the road users in the recording, by their number in the comparison.
        below_threshold: How many detections did not count for their score.
    """

    drive: RecordedDrive
    step_s: float
    meter: ErrorMeter
    measured: MeasuredDrive
    tracks: tuple[str, ...]
    below_threshold: int


def observe(
    recording: Recording, *, threshold: float = 0.0, visibility: Visibility | None = None
) -> list[ObservedDrive]:
    """Return the comparison of detections and truth in each drive of a recording that is long enough.

    Args:
        recording: The recording.
        threshold: Smallest score of a detection that counts.
        visibility: From when road users count as visible.

    Raises:
        RecordingError: All drives are too short, images are too far apart, or clocks disagree.
    """
    rule = visibility or Visibility()
    lengths_s = {name: drive.length_s for name, drive in recording.drives.items()}
    longest_s = max(lengths_s.values())
    if longest_s < SUSTAINED_S:
        raise RecordingError(
            f"{recording.name}: expected drives of at least {SUSTAINED_S:g} s of truth, got at most {longest_s:.1f} "
            "s: too short for durations"
        )
    recording.dropped[_TOO_SHORT] = sum(length_s < SUSTAINED_S for length_s in lengths_s.values())
    return [
        _observed(f"{recording.name}: drive {name}", drive, drive.camera or recording.camera, threshold, rule)
        for name, drive in recording.drives.items()
        if lengths_s[name] >= SUSTAINED_S
    ]


def _observed(
    where: str, drive: RecordedDrive, model: CameraModel | None, threshold: float, visibility: Visibility
) -> ObservedDrive:
    times = sorted(drive.images)
    step_s = _step_s(where, times)
    own = Camera()
    convert = _Converter(model, own)
    for time_s, detections in _at_images(where, drive.detections_elsewhere, times, step_s).items():
        drive.images[time_s].detections.extend(detections)
    drive.detections_elsewhere.clear()
    meter = ErrorMeter(own, step_s, is_excerpt=True)
    numbers: dict[str, int] = {}
    below = 0
    for time_s in times:
        image = drive.images[time_s]
        detections = [one for one in image.detections if one.score >= threshold]
        below += len(image.detections) - len(detections)
        truth = _truth(where, image, convert, visibility, numbers)
        meter.see(
            time_s,
            truth,
            [
                ReportedBox(convert.box(one.label, one.sides), one.distance_m, one.left_m)
                for one in detections
            ],
            [convert.box(ObstacleLabel.VEHICLE, sides) for sides in image.ignored],
        )
    measured = MeasuredDrive(name=drive.name, condition=drive.condition, errors=meter.errors())
    return ObservedDrive(
        drive=drive,
        step_s=step_s,
        meter=meter,
        measured=measured,
        tracks=tuple(numbers),
        below_threshold=below,
    )


def _step_s(where: str, times: Sequence[float]) -> float:
    """Return the time between images.

    Raises:
        RecordingError: They are too far apart or too close.
    """
    step_s = statistics.median_high([later - earlier for earlier, later in itertools.pairwise(times)])
    if not STEPS_S[0] <= step_s <= STEPS_S[1]:
        hint = " (are the times in milliseconds?)" if step_s >= 10.0 and step_s == round(step_s) else ""
        raise RecordingError(
            f"{where}: expected images every {STEPS_S[0]:g} to {STEPS_S[1]:g} s, got every {step_s:g} s{hint}"
        )
    return step_s


def _at_images(
    where: str, detections: Mapping[float, Sequence[Detection]], times: Sequence[float], step_s: float
) -> dict[float, list[Detection]]:
    """Return detections by the time of the nearest image.

    Raises:
        RecordingError: A time is too far from that of any image.
    """
    found: dict[float, list[Detection]] = {}
    for time_s, boxes in detections.items():
        after = bisect.bisect_left(times, time_s)
        nearest_s = min(times[max(after - 1, 0) : after + 1], key=lambda one: abs(one - time_s))
        if abs(nearest_s - time_s) > 0.25 * step_s:
            raise RecordingError(
                f"{where}: detections at {time_s:g} s, but the nearest truth is at {nearest_s:g} s; expected both on "
                "one clock, and every image in the truth, those without road users as rows with the source frame"
            )
        found.setdefault(nearest_s, []).extend(boxes)
    return found


class _Converter:
    """Converts boxes of a drive's camera to the driving system's image."""

    def __init__(self, model: CameraModel | None, own: Camera) -> None:
        self._model = model
        self.own = own

    def box(self, label: ObstacleLabel, sides: Sequence[float]) -> Box:
        if self._model is not None:
            return self._model.box(label, sides, self.own)
        x_min, x_max, y_min, y_max = sides
        return Box(label=label, x_min_px=x_min, x_max_px=x_max, y_min_px=y_min, y_max_px=y_max)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Placed:
    """A road user in an image, with its position relative to the ego."""

    user: RoadUser
    box: Box
    depth_m: float
    aside_m: float
    is_in_lane: bool
    is_visible: bool


def _truth(
    where: str, image: Image, convert: _Converter, visibility: Visibility, numbers: dict[str, int]
) -> list[TrueBox]:
    """Return the true boxes of an image, each with its relation to the ego.

    The lead is the nearest visible vehicle in the ego's lane that is not said to go another way, the pedestrian the
    nearest visible one within `PEDESTRIAN_WITHIN_M` of the middle of the lane. A vehicle without a given direction
    goes the ego's way if it is in its lane; otherwise its direction is unknown.
    """
    placed = [_place(user, convert, visibility) for user in image.road_users]
    if len({one.user.track for one in placed}) < len(placed):
        twice = Counter(one.user.track for one in placed).most_common(1)[0][0]
        raise RecordingError(f"{where}: id {twice!r} occurs twice at {image.time_s:g} s")
    leads = [
        one
        for one in placed
        if one.user.label is ObstacleLabel.VEHICLE
        and one.user.target in (None, Target.LEAD)
        and one.is_visible
        and one.is_in_lane
    ]
    people = [
        one
        for one in placed
        if one.user.label is ObstacleLabel.PERSON and one.is_visible and one.aside_m < PEDESTRIAN_WITHIN_M
    ]
    targets = [min(ones, key=lambda one: one.depth_m) for ones in (leads, people) if ones]
    return [
        TrueBox(
            numbers.setdefault(one.user.track, len(numbers)),
            one.box,
            _kind(one),
            one in targets,
            one.is_visible,
            one.user.distance_m,
            one.user.left_m,
        )
        for one in placed
    ]


def _kind(one: _Placed) -> Target:
    if one.user.label is ObstacleLabel.PERSON:
        return Target.PEDESTRIAN
    return one.user.target or (Target.LEAD if one.is_in_lane else Target.EVERYBODY)


def _place(user: RoadUser, convert: _Converter, visibility: Visibility) -> _Placed:
    own = convert.own
    box = convert.box(user.label, user.sides)
    depth_m = user.distance_m
    if depth_m is None:
        depth_m = own.ground_depth_m(box.y_max_px)
    if user.left_m is not None:
        aside_m = abs(user.left_m)
    elif depth_m is None:
        aside_m = math.inf
    else:
        aside_m = abs(own.left_m(0.5 * (box.x_min_px + box.x_max_px), depth_m))
    return _Placed(
        user=user,
        box=box,
        depth_m=own.far_m if depth_m is None else depth_m,
        aside_m=aside_m,
        is_in_lane=aside_m < HALF_LANE_M if user.in_lane is None else user.in_lane,
        is_visible=visibility.holds(user, box, own),
    )


def contradictions(recording: Recording) -> list[str]:
    """Describe in sentences where the boxes of a recording contradict its camera."""
    own = Camera()
    heights_m: list[float] = []
    ratios: list[float] = []
    for drive, user in _vehicles(recording.drives.values()):
        convert = _Converter(drive.camera or recording.camera, own)
        box = convert.box(user.label, user.sides)
        depth_m = own.ground_depth_m(box.y_max_px) or math.inf  # above the horizon
        if user.distance_m is not None and user.distance_m > 0.0:
            ratios.append(depth_m / user.distance_m)
        elif not user.truncation:
            # In the driving system's image, rows are scaled by the height of the camera.
            heights_m.append((box.y_max_px - box.y_min_px) * depth_m / own.focal_px)
    found = []
    if len(ratios) >= _LEAST_BOXES and not RATIOS[0] <= statistics.median(ratios) <= RATIOS[1]:
        found.append(
            f"by the bottom edges of their boxes, vehicles are {_times(statistics.median(ratios))} as far away as "
            "the recording says (median): give the optical axis, height and pitch of the camera with --calibration"
        )
    if len(heights_m) >= _LEAST_BOXES:
        height_m = statistics.median(heights_m)
        if math.isinf(height_m):
            found.append(f"with this camera, most vehicles stand above the horizon: {_GIVE_CAMERA}")
        elif not VEHICLE_HEIGHTS_M[0] <= height_m <= VEHICLE_HEIGHTS_M[1]:
            found.append(
                f"with this camera, vehicles are {height_m:.1f} m high (median), so distances are wrong: "
                f"{_GIVE_CAMERA}"
            )
    return found


_GIVE_CAMERA: Final = "give the camera of the images with --camera or --calibration"


def _times(ratio: float) -> str:
    return "infinitely" if math.isinf(ratio) else f"{ratio:.2f} times"


def _vehicles(drives: Iterable[RecordedDrive]) -> Iterable[tuple[RecordedDrive, RoadUser]]:
    for drive in drives:
        for image in drive.images.values():
            for user in image.road_users:
                if user.label is ObstacleLabel.VEHICLE:
                    yield drive, user

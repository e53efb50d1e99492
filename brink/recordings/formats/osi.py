"""Recordings in OSI traces: SensorView or GroundTruth with the truth, SensorData with the detections.

Ground truth is in the global frame. Detections are in the frame of the virtual sensor, which
`SensorData.mounting_position` places in the vehicle's frame; the origin of that is the middle of the host vehicle's
rear axle. OSI does not say what is hidden, so a road user counts as largely hidden if a nearer one covers most of its
box. Each message of SensorData makes an image with the truth at its time; where messages are missing, the truth makes
images without detections at the same rate, so that a detector that stops sending is not judged on less.

References:
    ASAM OSI 3.8, reference of SensorView, GroundTruth, SensorData and MovingObject.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple, TypeVar

from brink.recordings.files import describe, list_folder
from brink.recordings.format import Format, RecordingBuilder
from brink.recordings.ground import CAMERA, GroundImage, Pose, checked_body, refuse_cameras
from brink.recordings.osi_traces import SUFFIXES, TYPES, TraceMessage, read_messages, type_by_name
from brink.recordings.recording import MAX_BOXES, ClassMeaning, ReadOptions, Recording, RecordingError
from brink.sim.driving.camera import Solid

_REPORTS: Final = ("SensorData",)
_TRUTHS: Final = ("SensorView", "GroundTruth")
_VEHICLE: Final = 2
_TYPES: Final = {3: "pedestrian", 4: "animal"}
"""Classes by `MovingObject.Type`, except vehicles."""
_VEHICLE_TYPES: Final = {
    2: "car",
    3: "car",
    4: "car",
    5: "car",
    6: "van",
    7: "truck",
    8: "trailer",
    9: "trailer",
    10: "motorcycle",
    11: "bicycle",
    12: "bus",
    13: "tram",
    14: "train",
    15: "wheelchair",
    16: "truck",
    17: "scooter",
    18: "micromobility",
    19: "work_machine",
    20: "watercraft",
    21: "aircraft",
}
"""Classes of vehicles by `MovingObject.VehicleClassification.Type`; the others are just vehicles."""
_OTHER: Final = "other"
_LARGELY_HIDDEN: Final = 2
_SAME_TIME_S: Final = 0.0015


class _Object(NamedTuple):
    """A true object."""

    where: str
    track: str
    name: str
    body: Solid
    lanes: frozenset[int]


class _Frame(NamedTuple):
    """The truth at a time; `rear_m` is how far the rear axle is ahead of the host's centre, and left of it."""

    where: str
    time_s: float
    ego: Pose
    rear_m: tuple[float, float] | None
    lanes: frozenset[int]
    objects: Sequence[_Object]


class _Detected(NamedTuple):
    """A detection in the vehicle's frame; `size` is None if it has none."""

    where: str
    name: str
    score: float
    x_m: float
    y_m: float
    yaw_rad: float
    size: tuple[float, float, float] | None


class _Report(NamedTuple):
    """What the sensor reported at a time."""

    where: str
    time_s: float
    detected: Sequence[_Detected]


_Timed = TypeVar("_Timed", _Frame, _Report)


def _recognises(detections: Path, truth: Path | None) -> bool:
    return bool(_files(detections)) and (truth is None or bool(_files(truth)))


def _files(path: Path) -> list[Path]:
    return [one for one in (list_folder(path) or [path]) if one.suffix.lower() in SUFFIXES and one.is_file()]


def read(detections: Path, truth: Path | None, options: ReadOptions) -> Recording:
    """Read a recording from OSI traces.

    Args:
        detections: A trace with SensorData, or a folder of them.
        truth: A trace with SensorView or GroundTruth, or a folder of them with the same names but for the code of
            the type; None if it is with the detections.
        options: The user's settings for the recording.

    Raises:
        RecordingError: A file is missing or cannot be used.
        MissingExtra: The packages that read traces are not installed.
    """
    refuse_cameras(FORMAT.title, options)
    builder = RecordingBuilder(detections.stem, options)
    true, reported = _by_drive(truth or detections, _TRUTHS), _by_drive(detections, _REPORTS)
    if detections.is_file() and (truth is None or truth.is_file()):  # whatever their names
        true = dict(zip(reported, true.values(), strict=True))
    for name, true_file, reported_file in builder.pair_sequences(true, reported, FORMAT.expects):
        frames = _read_messages(true_file, _TRUTHS, _frame)
        reports = _read_messages(reported_file, _REPORTS, _report)
        for before, after in pairwise(frames):
            if after.time_s - before.time_s < _SAME_TIME_S:
                raise RecordingError(
                    f"{after.where}: expected each time once, got {before.time_s:g} s and {after.time_s:g} s"
                )
        for frame, report in _images(frames, reports, builder):
            _add_image(name, frame, report, builder)
    return builder.recording


def _by_drive(path: Path, types: Sequence[str]) -> dict[str, Path]:
    """Return the traces that may contain messages of certain types, by drive."""
    found: dict[str, Path] = {}
    for file in _files(path):
        if type_by_name(file) in (None, *types):
            name = _drive_name(file)
            if name in found:
                raise RecordingError(f"drive {name!r}: expected one trace, got {found[name]} and {file}")
            found[name] = file
    if not found:
        codes = " or ".join(f"_{code}_" for code, type_ in TYPES.items() if type_ in types)
        raise RecordingError(
            f"expected a trace of {' or '.join(types)}: NAME.mcap, or NAME.osi with {codes} in the name; "
            f"{describe(path)}"
        )
    return found


def _drive_name(path: Path) -> str:
    """Return the name of a trace without what differs between the types of its messages."""
    parts = path.stem.split("_")
    codes = [place for place, part in enumerate(parts) if part.lower() in TYPES]
    if len(codes) != 1:
        return path.stem
    (place,) = codes
    # …_<type>_<osi-version>_<protobuf-version>_<number-of-frames>_<name>
    has_versions = len(parts) > place + 3 and all(part.isdigit() for part in parts[place + 1 : place + 4])
    return "_".join(parts[:place] + parts[place + (4 if has_versions else 1) :]) or path.stem


def _read_messages(path: Path, types: Sequence[str], parse: Callable[[TraceMessage], _Timed]) -> list[_Timed]:
    """Return the messages, by time, of the first of these types that a trace contains.

    Raises:
        RecordingError: The trace cannot be used, has no such messages, or has them in several channels.
    """
    channels: dict[str, dict[str, list[_Timed]]] = {type_: {} for type_ in types}
    boxes = 0
    for message in read_messages(path, types):
        boxes += len((_ground_truth(message) or message.content).moving_object)
        if boxes > MAX_BOXES:
            raise RecordingError(f"{message.where}: expected at most {MAX_BOXES} objects in a trace")
        channels[message.type].setdefault(message.channel, []).append(parse(message))
    named = next((named for named in channels.values() if named), None)
    if named is None:
        raise RecordingError(f"{path}: expected messages of {' or '.join(types)}, found none")
    if len(named) > 1:
        raise RecordingError(
            f"{path}: expected one channel of {' or '.join(types)}, got {', '.join(sorted(named))}"
        )
    (messages,) = named.values()
    return sorted(messages, key=lambda one: one.time_s)


def _ground_truth(message: TraceMessage) -> Any:
    return message.content.global_ground_truth if message.type == "SensorView" else message.content


def _frame(message: TraceMessage) -> _Frame:
    where, content, truth = message.where, message.content, _ground_truth(message)
    host_id = content.host_vehicle_id if content.HasField("host_vehicle_id") else truth.host_vehicle_id
    host = next((one for one in truth.moving_object if one.id.value == host_id.value), None)
    if host is None:
        raise RecordingError(
            f"{where}: expected the host vehicle {host_id.value} among the moving objects of the ground truth, which "
            f"are {len(truth.moving_object)}"
        )
    ego = _body(f"{where}: host vehicle", host.base)
    attributes = host.vehicle_attributes
    rear = attributes.bbcenter_to_rear if attributes.HasField("bbcenter_to_rear") else None
    return _Frame(
        where=where,
        time_s=_time(where, (content, "timestamp"), (truth, "timestamp")),
        ego=Pose(ego.x_m, ego.y_m, ego.yaw_rad),
        rear_m=None if rear is None else (rear.x, rear.y),
        lanes=_lanes(host),
        objects=[_object(where, one) for one in truth.moving_object if one is not host],
    )


def _object(where: str, one: Any) -> _Object:
    where = f"{where}: moving object {one.id.value}"
    name = _class_of(one.type, one.vehicle_classification.type)
    return _Object(where, str(one.id.value), name, _body(where, one.base), _lanes(one))


def _body(where: str, base: Any) -> Solid:
    size = base.dimension
    return checked_body(
        where,
        (base.position.x, base.position.y),
        base.orientation.yaw,
        (size.length, size.width, size.height),
    )


def _lanes(one: Any) -> frozenset[int]:
    lanes = one.moving_object_classification.assigned_lane_id or one.assigned_lane_id
    return frozenset(lane.value for lane in lanes)


def _class_of(type_: int, vehicle_type: int) -> str:
    if type_ == _VEHICLE:
        return _VEHICLE_TYPES.get(vehicle_type, "vehicle")
    return _TYPES.get(type_, _OTHER)


def _report(message: TraceMessage) -> _Report:
    content = message.content
    mounting = content.mounting_position
    rotation = _rotation(mounting.orientation)
    detected = []
    for number, one in enumerate(content.moving_object, 1):
        candidate = max(one.candidate, key=lambda candidate: candidate.probability, default=None)
        size = one.base.dimension
        x_m, y_m = _rotated(rotation, one.base.position.x, one.base.position.y, one.base.position.z)
        ahead, left = _rotated(
            rotation, math.cos(one.base.orientation.yaw), math.sin(one.base.orientation.yaw), 0.0
        )
        detected.append(
            _Detected(
                where=f"{message.where}: detected moving object {number}",
                name=_OTHER
                if candidate is None
                else _class_of(candidate.type, candidate.vehicle_classification.type),
                score=one.header.existence_probability
                if one.header.HasField("existence_probability")
                else 1.0,
                x_m=x_m + mounting.position.x,
                y_m=y_m + mounting.position.y,
                yaw_rad=math.atan2(left, ahead),
                size=(size.length, size.width, size.height) if one.base.HasField("dimension") else None,
            )
        )
    time_s = _time(message.where, (content, "last_measurement_time"), (content, "timestamp"))
    return _Report(message.where, time_s, detected)


def _time(where: str, *fields: tuple[Any, str]) -> float:
    """Return the first of these times that is set."""
    for content, name in fields:
        if content.HasField(name):
            return float(getattr(content, name).seconds + getattr(content, name).nanos / 1e9)
    raise RecordingError(f"{where}: expected a timestamp, got none")


_Rows = tuple[tuple[float, float, float], tuple[float, float, float]]


def _rotation(orientation: Any) -> _Rows:
    """Return the first two rows of the matrix that turns a vector of the rotated frame into its parent frame.

    The rotation is yaw, then pitch about the new y axis, then roll about the new x axis.
    """
    (cy, sy), (cp, sp), (cr, sr) = (
        (math.cos(angle), math.sin(angle)) for angle in (orientation.yaw, orientation.pitch, orientation.roll)
    )
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
    )


def _rotated(rows: _Rows, x: float, y: float, z: float) -> tuple[float, float]:
    (a, b, c), (d, e, f) = rows
    return a * x + b * y + c * z, d * x + e * y + f * z


def _images(
    frames: Sequence[_Frame], reports: Sequence[_Report], builder: RecordingBuilder
) -> Iterator[tuple[_Frame, _Report | None]]:
    """Yield the images of a drive: the truth, and the report about it; None if nothing was sent.

    Raises:
        RecordingError: A report is of a time without truth.
    """
    times = [frame.time_s for frame in frames]
    step_s = median([after - before for before, after in pairwise(times)] or [0.0])
    matched: dict[int, _Report] = {}
    for report in reports:
        after = bisect_left(times, report.time_s)
        nearest = min(
            (place for place in (after - 1, after) if 0 <= place < len(times)),
            key=lambda place: abs(times[place] - report.time_s),
        )
        off_s = abs(times[nearest] - report.time_s)
        if off_s > max(step_s, _SAME_TIME_S):
            raise RecordingError(
                f"{report.where}: expected ground truth at {report.time_s:g} s, found it from {times[0]:g} to "
                f"{times[-1]:g} s, and next to it at {times[nearest]:g} s"
            )
        earlier = matched.get(nearest)
        if earlier is not None:
            builder.recording.dropped["messages of SensorData between those of the truth"] += 1
        if earlier is None or off_s < abs(times[nearest] - earlier.time_s):
            matched[nearest] = report
    for place in sorted(matched.keys() | _silent(times, sorted(matched))):
        yield frames[place], matched.get(place)


def _silent(times: Sequence[float], sent: Sequence[int]) -> set[int]:
    """Return images at which the sensor should have sent a message: those in gaps of more than its usual step."""
    step_s = median([times[after] - times[before] for before, after in pairwise(sent)] or [0.0])
    silent = set()
    for before, after in pairwise((None, *sent, None)):
        last_s = times[0 if before is None else before]
        next_s = times[-1] + 0.5 * step_s if after is None else times[after]
        for place in range(0 if before is None else before, len(times) if after is None else after):
            if last_s + 0.99 * step_s <= times[place] <= next_s - 0.51 * step_s:
                silent.add(place)
                last_s = times[place]
    return silent - set(sent)


def _add_image(name: str, frame: _Frame, report: _Report | None, builder: RecordingBuilder) -> None:
    drive = builder.drive(name)
    builder.add_image(frame.where, drive, frame.time_s)
    image = GroundImage(builder=builder, drive=drive, time_s=frame.time_s, ego=frame.ego)
    visible = {sighting.body for sighting in CAMERA.look(*frame.ego, [one.body for one in frame.objects])}
    for place, one in enumerate(frame.objects):
        image.add_truth(
            one.where,
            one.name,
            one.track,
            one.body,
            shares_lane=bool(frame.lanes & one.lanes),
            occlusion=0 if place in visible else _LARGELY_HIDDEN,
        )
    for detected in report.detected if report is not None else ():
        if detected.size is None:
            builder.recording.dropped["detections without a size"] += 1
        else:
            image.add_detection(
                detected.where, detected.name, _detected_body(frame, detected, detected.size), detected.score
            )


def _detected_body(frame: _Frame, detected: _Detected, size: Sequence[float]) -> Solid:
    if frame.rear_m is None:
        raise RecordingError(
            f"{frame.where}: host vehicle: expected vehicle_attributes.bbcenter_to_rear, since places of detections "
            "count from the rear axle; got none"
        )
    ahead, left = detected.x_m + frame.rear_m[0], detected.y_m + frame.rear_m[1]
    x_m, y_m, yaw_rad = frame.ego
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    place = (x_m + ahead * cos - left * sin, y_m + ahead * sin + left * cos)
    return checked_body(detected.where, place, yaw_rad + detected.yaw_rad, size)


FORMAT: Final = Format(
    name="osi",
    title="OSI",
    expects="detections as a trace of SensorData, and truth as a trace of SensorView or GroundTruth: NAME.mcap, or "
    "NAME.osi with _sd_, _sv_ or _gt_ in the name; or folders of them, or one MCAP file or folder with both",
    recognises=_recognises,
    read=read,
    classes={
        **dict.fromkeys(("trailer", "tram", "train", "work_machine"), ClassMeaning.VEHICLE),
        **dict.fromkeys(
            (
                "motorcycle",
                "bicycle",
                "wheelchair",
                "scooter",
                "micromobility",
                "watercraft",
                "aircraft",
                "animal",
                _OTHER,
            ),
            ClassMeaning.IGNORE,
        ),
    },
)

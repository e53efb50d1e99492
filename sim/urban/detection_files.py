"""Detections of any detector beside the truth, from files: how wrong the detector was in each drive.

Two formats are read. A CSV file has one row for each box, true or detected (`COLUMNS`). A data set in COCO format has
images with a sequence and a time, annotations with track ids, and the detections in COCO's format of results.

Boxes are in pixels of the camera that took the images. They are converted to the same rays of the driving system's
camera, so that distances mean the same everywhere.
"""

import csv
import io
import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.errors import SimulatorError
from brink.sim.urban.detection_errors import PEDESTRIAN_WITHIN_M, Target
from brink.sim.urban.error_meter import (
    HALF_LANE_M,
    SUSTAINED_S,
    ErrorMeter,
    MeasuredDrive,
    ReportedBox,
    TrueBox,
)
from brink.user_file import read_file, read_text

COLUMNS: Final = ("drive", "time_s", "source", "id", "label", "x_min_px", "x_max_px", "y_min_px", "y_max_px")
"""Columns of a CSV file. `source` is truth or detection; `id` names a true road user within its drive."""
OPTIONAL: Final = ("target", "condition")
"""Further columns: what a true vehicle is (lead, oncoming or crossing), and the condition of its drive."""
LABELS: Final[Mapping[str, ObstacleLabel]] = {
    "vehicle": ObstacleLabel.VEHICLE, "car": ObstacleLabel.VEHICLE, "truck": ObstacleLabel.VEHICLE,
    "bus": ObstacleLabel.VEHICLE, "van": ObstacleLabel.VEHICLE, "person": ObstacleLabel.PERSON,
    "pedestrian": ObstacleLabel.PERSON,
}  # fmt: skip
KINDS: Final = {target.value: target for target in (Target.LEAD, Target.ONCOMING, Target.CROSSING)}
MAX_BYTES: Final = 512 * 1024**2
"""Maximum size of a file."""
STEPS_S: Final = (0.02, 0.5)
"""Shortest and longest time between images."""
_IDS: Final = ("id", "image_id", "category_id")
_PLACES: Final = 3
"""Decimal places of times: images within a millisecond are one."""


class DetectionFileError(SimulatorError):
    """A file with detections cannot be used; the message says where and why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """The camera that took the images: a pinhole that looks along the road, level, without distortion.

    Attributes:
        width_px: Width of the images.
        height_px: Height of the images; the horizon is in the middle.
        fov_deg: Horizontal field of view.
        height_m: Height above the ground.
    """

    width_px: float = 800.0
    height_px: float = 600.0
    fov_deg: float = 90.0
    height_m: float = 1.7

    def __post_init__(self) -> None:
        if not (self.width_px > 0 and self.height_px > 0 and 0 < self.fov_deg < 180 and self.height_m > 0):
            raise DetectionFileError(
                f"camera: expected positive sizes and an angle below 180 degrees, got {self.width_px:g} x "
                f"{self.height_px:g} px, {self.fov_deg:g} degrees, {self.height_m:g} m"
            )

    def box(self, label: ObstacleLabel, sides: Sequence[float], camera: Camera) -> Box:
        """Return a box in the driving system's image.

        Args:
            label: Its label.
            sides: x_min, x_max, y_min, y_max in this camera's pixels.
            camera: The driving system's camera.
        """
        focal_px = 0.5 * self.width_px / math.tan(math.radians(self.fov_deg) / 2.0)
        across = camera.focal_px / focal_px
        # A camera at another height sees the ground lower or higher in the image.
        down = across * camera.height_m / self.height_m
        x_min, x_max, y_min, y_max = sides
        return Box(
            label=label,
            x_min_px=camera.centre_x_px + (x_min - 0.5 * self.width_px) * across,
            x_max_px=camera.centre_x_px + (x_max - 0.5 * self.width_px) * across,
            y_min_px=camera.horizon_px + (y_min - 0.5 * self.height_px) * down,
            y_max_px=camera.horizon_px + (y_max - 0.5 * self.height_px) * down,
        )


class _True(NamedTuple):
    track: str
    box: Box
    kind: Target | None


@dataclass(slots=True)
class _Drive:
    """The boxes of a drive by time."""

    truth: dict[float, list[_True]] = field(default_factory=dict)
    detections: dict[float, list[Box]] = field(default_factory=dict)
    condition: str | None = None


def read_csv(path: Path, camera: CameraModel | None = None) -> list[MeasuredDrive]:
    """Return the errors of a detector in each drive of a CSV file.

    Args:
        path: The file; see `COLUMNS`.
        camera: The camera of the boxes; by default that of the driving system.

    Raises:
        DetectionFileError: The file is missing or cannot be used.
    """
    model, own = camera or CameraModel(), Camera()
    drives: dict[str, _Drive] = {}
    try:
        with io.StringIO(read_file(path, MAX_BYTES).decode("utf-8-sig"), newline="") as file:
            reader = csv.DictReader(file)
            _check_columns(path, reader.fieldnames or ())
            for number, row in enumerate(reader, 2):
                _add_row(f"{path}:{number}", row, drives, model, own)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DetectionFileError(f"{path}: {error}") from error
    return _measured(str(path), drives)


def _check_columns(path: Path, names: Sequence[str]) -> None:
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise DetectionFileError(
            f"{path}: expected the columns {', '.join(COLUMNS)}, and optionally {' and '.join(OPTIONAL)}; missing "
            f"{', '.join(missing)}"
        )


def _add_row(
    where: str, row: Mapping[str, str | None], drives: dict[str, _Drive], model: CameraModel, own: Camera
) -> None:
    label = (row["label"] or "").strip().lower()
    if label not in LABELS:
        raise DetectionFileError(f"{where}: label: expected one of {', '.join(LABELS)}; got {row['label']!r}")
    time_s = _number(where, "time_s", row["time_s"])
    sides = [_number(where, name, row[name]) for name in COLUMNS[5:]]
    if not (sides[0] < sides[1] and sides[2] < sides[3]):
        raise DetectionFileError(
            f"{where}: expected x_min_px < x_max_px and y_min_px < y_max_px, got {sides}"
        )
    drive = drives.setdefault((row["drive"] or "").strip(), _Drive())
    _set_condition(where, str(row["drive"]), drive, (row.get("condition") or "").strip() or None)
    box = model.box(LABELS[label], sides, own)
    time_s = round(time_s, _PLACES)
    source = (row["source"] or "").strip().lower()
    if source == "detection":
        drive.detections.setdefault(time_s, []).append(box)
        return
    if source != "truth":
        raise DetectionFileError(f"{where}: source: expected truth or detection, got {row['source']!r}")
    track = (row["id"] or "").strip()
    if not track:
        raise DetectionFileError(f"{where}: id: expected the id of a true road user, got nothing")
    kind = _kind_of(where, (row.get("target") or "").strip())
    _add_truth(where, drive, time_s, _True(track, box, kind))


def _kind_of(where: str, name: object) -> Target | None:
    """Return what a true vehicle is said to be; None if nothing is said, or of a pedestrian."""
    if name in ("", Target.PEDESTRIAN.value):
        return None
    if not isinstance(name, str) or name not in KINDS:
        raise DetectionFileError(
            f"{where}: target: expected one of {', '.join(KINDS)}, or nothing; got {name!r}"
        )
    return KINDS[name]


def _set_condition(where: str, name: str, drive: _Drive, condition: object) -> None:
    if condition is None:
        return
    if not isinstance(condition, str) or drive.condition not in (None, condition):
        expected = "a name" if drive.condition is None else repr(drive.condition)
        raise DetectionFileError(
            f"{where}: condition: expected {expected} throughout drive {name}, got {condition!r}"
        )
    drive.condition = condition


def _add_truth(where: str, drive: _Drive, time_s: float, one: _True) -> None:
    others = drive.truth.setdefault(time_s, [])
    if any(other.track == one.track for other in others):
        raise DetectionFileError(f"{where}: id {one.track!r} occurs twice at {time_s:g} s")
    others.append(one)


def _number(where: str, name: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DetectionFileError(f"{where}: {name}: expected a number, got {text!r}")
    return value


def read_coco(
    truth: Path,
    results: Path,
    *,
    threshold: float = 0.5,
    frames_per_s: float | None = None,
    camera: CameraModel | None = None,
) -> list[MeasuredDrive]:
    """Return the errors of a detector in each sequence of a data set in COCO format.

    Args:
        truth: The data set. Images have ``video_id`` (or ``sequence``) and either ``time_s`` or ``frame_id`` (or
            ``frame_index``); annotations have ``track_id``. Images may have ``condition``.
        results: The detections: a list of ``image_id``, ``category_id``, ``bbox`` and ``score``.
        threshold: Smallest score of a detection that counts.
        frames_per_s: Frames per second, for images without ``time_s``.
        camera: The camera of the images; by default that of the driving system, at the images' size.

    Raises:
        DetectionFileError: A file is missing or cannot be used.
    """
    document, found = _json(truth), _json(results)
    if not isinstance(document, dict) or not isinstance(found, list):
        raise DetectionFileError(
            f"{truth}: expected a data set with images and annotations, and a list of results in {results}"
        )
    own = Camera()
    images = {image["id"]: image for image in _objects(truth, document, "images", ("id", "width", "height"))}
    labels = _labels(truth, document)
    drives: dict[str, _Drive] = {}
    times: dict[Any, tuple[str, float]] = {}
    models: dict[Any, CameraModel] = {}
    for key, image in images.items():
        name = image.get("video_id", image.get("sequence"))
        if name is None:
            raise DetectionFileError(f"{truth}: image {key}: expected video_id or sequence")
        times[key] = str(name), _time_of(truth, image, frames_per_s)
        drive = drives.setdefault(str(name), _Drive())
        _set_condition(f"{truth}: image {key}", str(name), drive, image.get("condition"))
        drive.truth.setdefault(times[key][1], [])
        models[key] = camera or CameraModel(width_px=image["width"], height_px=image["height"])
    for one in _objects(truth, document, "annotations", ("image_id", "category_id", "bbox")):
        where = f"{truth}: annotation {one.get('id', '?')}"
        if one["image_id"] not in images:
            raise DetectionFileError(f"{where}: expected the id of an image, got {one['image_id']!r}")
        if "track_id" not in one:
            raise DetectionFileError(f"{where}: track_id is missing: without it, nothing has a duration")
        label = labels.get(one["category_id"])
        if label is not None:
            name, time_s = times[one["image_id"]]
            box = models[one["image_id"]].box(label, _sides(where, one["bbox"]), own)
            kind = _kind_of(where, one.get("target") or "")
            _add_truth(where, drives[name], time_s, _True(str(one["track_id"]), box, kind))
    for place, one in enumerate(found):
        where = f"{results}: result {place}"
        if not isinstance(one, dict) or not {"image_id", "category_id", "bbox", "score"} <= one.keys():
            raise DetectionFileError(
                f"{where}: expected image_id, category_id, bbox and score, got {one!r:.80}"
            )
        for name in ("image_id", "category_id"):
            if not isinstance(one[name], int | str):
                raise DetectionFileError(f"{where}: {name}: expected an id, got {one[name]!r:.80}")
        if one["image_id"] not in images:
            raise DetectionFileError(f"{where}: expected the id of an image, got {one['image_id']!r}")
        if not _is_number(one["score"]):
            raise DetectionFileError(f"{where}: score: expected a number, got {one['score']!r:.80}")
        label = labels.get(one["category_id"])
        if label is not None and one["score"] >= threshold:
            name, time_s = times[one["image_id"]]
            box = models[one["image_id"]].box(label, _sides(where, one["bbox"]), own)
            drives[name].detections.setdefault(time_s, []).append(box)
    return _measured(str(truth), drives)


def _json(path: Path) -> Any:
    try:
        return json.loads(read_text(path, MAX_BYTES))
    except (OSError, ValueError, RecursionError) as error:
        raise DetectionFileError(f"{path}: {error}") from error


def _objects(path: Path, document: Mapping[str, Any], name: str, fields: Sequence[str]) -> Iterable[Any]:
    items = document.get(name)
    if not isinstance(items, list):
        raise DetectionFileError(f"{path}: {name}: expected a list, got {items!r:.80}")
    for place, item in enumerate(items):
        missing = [one for one in fields if not isinstance(item, dict) or one not in item]
        if missing:
            raise DetectionFileError(f"{path}: {name}[{place}]: missing {', '.join(missing)}")
        for one in fields:
            if one in _IDS and not isinstance(item[one], int | str):
                raise DetectionFileError(
                    f"{path}: {name}[{place}].{one}: expected an id, got {item[one]!r:.80}"
                )
            if one in ("width", "height") and not (_is_number(item[one]) and item[one] > 0):
                raise DetectionFileError(
                    f"{path}: {name}[{place}].{one}: expected a positive number, got {item[one]!r:.80}"
                )
    return items


def _labels(path: Path, document: Mapping[str, Any]) -> dict[Any, ObstacleLabel]:
    categories = _objects(path, document, "categories", ("id", "name"))
    found = {
        one["id"]: LABELS[str(one["name"]).lower()]
        for one in categories
        if str(one["name"]).lower() in LABELS
    }
    if not found:
        raise DetectionFileError(f"{path}: expected one of the categories {', '.join(LABELS)}, found none")
    return found


def _time_of(path: Path, image: Mapping[str, Any], frames_per_s: float | None) -> float:
    if isinstance(image.get("time_s"), int | float):
        return round(float(image["time_s"]), _PLACES)
    frame = image.get("frame_id", image.get("frame_index"))
    if isinstance(frame, int | float) and frames_per_s:
        return round(float(frame) / frames_per_s, _PLACES)
    raise DetectionFileError(
        f"{path}: image {image['id']}: expected time_s, or frame_id and the number of frames per second"
    )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _sides(where: str, bbox: Any) -> tuple[float, float, float, float]:
    if not (isinstance(bbox, list) and len(bbox) == 4 and all(map(_is_number, bbox))):
        raise DetectionFileError(f"{where}: bbox: expected x, y, width and height, got {bbox!r:.80}")
    x, y, wide, high = bbox
    if not (wide > 0 and high > 0):
        raise DetectionFileError(f"{where}: bbox: expected a positive width and height, got {bbox!r}")
    return x, x + wide, y, y + high


def _measured(where: str, drives: Mapping[str, _Drive]) -> list[MeasuredDrive]:
    if not drives:
        raise DetectionFileError(f"{where}: expected boxes, found none")
    return [_measure(f"{where}: drive {name}", name, drive) for name, drive in drives.items()]


def _measure(where: str, name: str, drive: _Drive) -> MeasuredDrive:
    times = sorted(drive.truth)
    if len(times) < 2 or times[-1] - times[0] < SUSTAINED_S:
        length_s = times[-1] - times[0] if times else 0.0
        raise DetectionFileError(
            f"{where}: expected at least {SUSTAINED_S:g} s of truth, got {length_s:.1f} s: too short for durations"
        )
    gaps_s = sorted(later - earlier for earlier, later in itertools.pairwise(times))
    step_s = gaps_s[len(gaps_s) // 2]
    if not STEPS_S[0] <= step_s <= STEPS_S[1]:
        raise DetectionFileError(
            f"{where}: expected images every {STEPS_S[0]:g} to {STEPS_S[1]:g} s, got every {step_s:g} s"
        )
    lost = [time_s for time_s in drive.detections if time_s not in drive.truth]
    detections: dict[float, list[Box]] = {}
    for time_s, boxes in drive.detections.items():
        nearest = min(times, key=lambda one: abs(one - time_s)) if time_s in lost else time_s
        if abs(nearest - time_s) > 0.25 * step_s:
            raise DetectionFileError(
                f"{where}: detections at {time_s:g} s, but the nearest truth is at {nearest:g} s; expected both on "
                "one clock, and truth in every image"
            )
        detections.setdefault(nearest, []).extend(boxes)
    camera = Camera()
    meter = ErrorMeter(camera, step_s, is_excerpt=True)
    numbers: dict[str, int] = {}
    for time_s in times:
        truth = [
            TrueBox(
                numbers.setdefault(one.track, len(numbers)), one.box, *_kind(one, drive.truth[time_s], camera)
            )
            for one in drive.truth[time_s]
        ]
        meter.see(time_s, truth, [ReportedBox(box) for box in detections.get(time_s, ())])
    return MeasuredDrive(name=name, condition=drive.condition, errors=meter.errors())


def _kind(one: _True, others: Sequence[_True], camera: Camera) -> tuple[Target, bool]:
    """Return what a road user is, and whether it is the lead or the nearest pedestrian.

    A vehicle without a given kind goes the ego's way if it is in its lane; of any other, the direction is unknown.
    """
    is_person = one.box.label is ObstacleLabel.PERSON
    if is_person:
        kind = Target.PEDESTRIAN
    else:
        is_ahead = _aside_m(one.box, camera) < HALF_LANE_M
        kind = one.kind or (Target.LEAD if is_ahead else Target.EVERYBODY)
    if kind not in (Target.LEAD, Target.PEDESTRIAN):
        return kind, False
    within_m = PEDESTRIAN_WITHIN_M if is_person else HALF_LANE_M
    rivals = [
        other.box.y_max_px
        for other in others
        if other.box.label is one.box.label
        and other.kind in (None, one.kind)
        and _aside_m(other.box, camera) < within_m
    ]
    return kind, _aside_m(one.box, camera) < within_m and one.box.y_max_px >= max(rivals)


def _aside_m(box: Box, camera: Camera) -> float:
    depth_m = camera.ground_depth_m(box.y_max_px)
    if depth_m is None:
        return math.inf
    return abs(camera.left_m(0.5 * (box.x_min_px + box.x_max_px), depth_m))

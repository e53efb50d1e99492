"""Recordings in nuScenes tables, with detections in the format of the nuScenes detection task.

The truth is a folder with the tables of the nuScenes schema, one JSON file each. Tables of the whole data set have
gigabytes, so their rows are read one after another, and only those of scenes with results are kept. An ego pose is
that of the middle of the rear axle.

References:
    nuScenes devkit, docs/schema_nuscenes.md and python-sdk/nuscenes/eval/detection/README.md.
"""

import io
import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from brink.recordings.camera import is_number
from brink.recordings.files import describe, list_folder, read_json
from brink.recordings.format import Format, RecordingBuilder
from brink.recordings.ground import GroundImage, Pose, checked_body, refuse_cameras
from brink.recordings.recording import ClassMeaning, ReadOptions, Recording, RecordingError
from brink.user_file import open_file

MAX_TABLE_BYTES: Final = 4 * 1024**3
"""Maximum size of a table, of which one row is in memory at a time."""
CENTRE_AHEAD_M: Final = 1.4
"""How far the centre of the ego is ahead of its rear axle: that of the Renault Zoe that recorded nuScenes."""
_PIECE: Final = 1024**2
_TABLES: Final = (
    "scene",
    "sample",
    "sample_annotation",
    "instance",
    "category",
    "ego_pose",
    "sample_data",
    "calibrated_sensor",
    "sensor",
)
_POSE_CHANNELS: Final = ("CAM_FRONT", "LIDAR_TOP")
"""Sensors with the time of whose key frame the ego's pose is taken; the last that there is counts."""
_VISIBLE_SHARES: Final = {"": None, "1": 0.2, "2": 0.5, "3": 0.7, "4": 0.9}
_DETECTION_CLASSES: Final = {
    "vehicle.car": "car",
    "vehicle.truck": "truck",
    "vehicle.bus": "bus",
    "vehicle.trailer": "trailer",
    "vehicle.construction": "construction_vehicle",
    "vehicle.emergency": "emergency_vehicle",
    "vehicle.motorcycle": "motorcycle",
    "vehicle.bicycle": "bicycle",
    "human.pedestrian.personal_mobility": "personal_mobility",
    "human.pedestrian.stroller": "stroller",
    "human.pedestrian.wheelchair": "wheelchair",
    "human.pedestrian": "pedestrian",
    "animal": "animal",
    "movable_object.barrier": "barrier",
    "movable_object.trafficcone": "traffic_cone",
    "movable_object": "object",
    "static_object": "object",
}
"""Class of each category, or of all categories with that prefix; those of the detection task under its names."""
_THINGS: Final = ("barrier", "traffic_cone", "object")
"""Classes that are not road users: boxes of road users in front of them are judged."""
_SPACE: Final = re.compile(r"\s*")
_SEPARATOR: Final = re.compile(r"\s*(?:,|(?=\]))\s*")

_Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sample:
    scene: str
    timestamp_us: float


def _recognises(detections: Path, truth: Path | None) -> bool:
    return truth is not None and any(
        (folder / "sample_annotation.json").is_file() for folder in _folders(truth)
    )


def _folders(truth: Path) -> list[Path]:
    """Return the folders that may hold the tables: this one, and its versions."""
    return [truth, *(entry for entry in list_folder(truth) if entry.name.startswith("v1.0"))]


def read(detections: Path, truth: Path | None, options: ReadOptions) -> Recording:
    """Read a recording from nuScenes tables and detection results.

    Args:
        detections: The file with the results.
        truth: The folder with the tables, or one with a single folder ``v1.0-…`` that has them.
        options: The user's settings for the recording.

    Raises:
        RecordingError: A file is missing or cannot be used, or a sample of a scene has no results.
    """
    refuse_cameras(FORMAT.title, options)
    if truth is None:
        raise RecordingError(
            f"{detections}: expected {FORMAT.expects}; say where the tables are with --truth"
        )
    folder = _folder_of_tables(truth)
    results = _results(detections)
    builder = RecordingBuilder(detections.stem, options)
    images = _images(folder, detections, results, builder)
    _add_truth(folder, images, builder)
    for token, boxes in results.items():
        for number, box in enumerate(boxes):
            _add_detection(f"{detections}: results[{token!r}][{number}]", box, images[token])
    return builder.recording


def _folder_of_tables(truth: Path) -> Path:
    found = [
        folder for folder in _folders(truth) if all((folder / f"{name}.json").is_file() for name in _TABLES)
    ]
    if len(found) != 1:
        several = f"; it has several: {', '.join(folder.name for folder in found)}" if found else ""
        raise RecordingError(
            f"{truth}: expected a folder with {', '.join(f'{name}.json' for name in _TABLES)}, or one with a single "
            f"folder v1.0-… that has them; {describe(truth)}{several}"
        )
    return found[0]


def _results(path: Path) -> dict[str, list[_Row]]:
    document = read_json(path)
    results = document.get("results") if isinstance(document, dict) else None
    if (
        not isinstance(results, dict)
        or not results
        or not all(isinstance(boxes, list) for boxes in results.values())
    ):
        raise RecordingError(
            f'{path}: expected {{"meta": …, "results": {{sample_token: [boxes], …}}}} with one sample at least'
        )
    return results


def _rows(folder: Path, name: str) -> Iterator[tuple[str, _Row]]:
    """Yield the position of each row of a table, and the row.

    Raises:
        RecordingError: The table cannot be read, is too large, or is no JSON array of objects.
    """
    path = folder / f"{name}.json"
    try:
        with open_file(path) as file, io.TextIOWrapper(file, encoding="utf-8") as text:
            size = os.fstat(file.fileno()).st_size
            if size > MAX_TABLE_BYTES:
                raise RecordingError(f"{path}: expected at most {MAX_TABLE_BYTES} bytes, got {size}")
            for number, row in enumerate(_json_array(path, text)):
                where = f"{path}: row {number + 1}"
                if not isinstance(row, dict):
                    raise RecordingError(f"{where}: expected an object, got {row!r:.80}")
                yield where, row
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: {getattr(error, 'strerror', None) or error}") from error


def _json_array(path: Path, file: io.TextIOWrapper) -> Iterator[Any]:
    """Yield the items of a JSON array, each of which is shorter than a piece of the file."""
    decoder = json.JSONDecoder()
    text = file.read(_PIECE)
    at = _SPACE.match(text).end()  # type: ignore[union-attr]
    if text[at : at + 1] != "[":
        raise RecordingError(f"{path}: expected a JSON array of rows, got {text[:40]!r}")
    at += 1
    while True:
        at = _SPACE.match(text, at).end()  # type: ignore[union-attr]
        if text[at : at + 1] == "]":
            return
        try:
            item, end = decoder.raw_decode(text, at)
            separator = _SEPARATOR.match(text, end)
        except (ValueError, RecursionError):
            separator = None
        if separator is not None:
            at = separator.end()
            yield item
            continue
        piece = file.read(_PIECE) if len(text) - at <= _PIECE else ""
        if not piece:
            raise RecordingError(f"{path}: expected a JSON array of rows, got {text[at : at + 80]!r} in it")
        text, at = text[at:] + piece, 0


def _images(
    folder: Path, detections: Path, results: Mapping[str, Any], builder: RecordingBuilder
) -> dict[str, GroundImage]:
    """Return the image of each sample in a scene with results."""
    samples = _samples(folder, detections, results)
    names = {_text(where, row, "token"): _text(where, row, "name") for where, row in _rows(folder, "scene")}
    if len(set(names.values())) < len(names):
        raise RecordingError(f"{folder / 'scene.json'}: expected each name once")
    scenes = {sample.scene for sample in samples.values()}
    if len(names) > len(scenes):
        builder.recording.notes.append(
            f"Left out, without results: {len(names) - len(scenes)} of {len(names)} scenes."
        )
    starts_us: dict[str, float] = {}
    for sample in samples.values():
        starts_us[sample.scene] = min(sample.timestamp_us, starts_us.get(sample.scene, math.inf))
    poses = _poses(folder, samples)
    images = {}
    for token, sample in samples.items():
        where = f"{folder / 'sample.json'}: sample {token!r}"
        if token not in poses or sample.scene not in names:
            raise RecordingError(
                f"{where}: expected its scene, and the ego pose of a key frame of {' or '.join(_POSE_CHANNELS)}"
            )
        drive = builder.drive(names[sample.scene])
        time_s = (sample.timestamp_us - starts_us[sample.scene]) / 1e6
        builder.add_image(where, drive, time_s)
        images[token] = GroundImage(builder=builder, drive=drive, time_s=time_s, ego=poses[token])
    return images


def _samples(folder: Path, detections: Path, results: Mapping[str, Any]) -> dict[str, _Sample]:
    """Return the samples of all scenes with results."""
    samples = {
        _text(where, row, "token"): _Sample(
            scene=_text(where, row, "scene_token"),
            timestamp_us=_numbers(f"{where}: timestamp", [row.get("timestamp")], 1)[0],
        )
        for where, row in _rows(folder, "sample")
    }
    unknown = next((token for token in results if token not in samples), None)
    if unknown is not None:
        raise RecordingError(
            f"{detections}: results: expected samples of {folder / 'sample.json'}, got {unknown!r:.80}"
        )
    scenes = {samples[token].scene for token in results}
    missing = next(
        (token for token, sample in samples.items() if sample.scene in scenes and token not in results), None
    )
    if missing is not None:
        raise RecordingError(
            f"{detections}: results: expected all samples of a scene, with an empty list if nothing was detected; "
            f"{missing!r} of scene {samples[missing].scene!r} is missing"
        )
    return {token: samples[token] for token in results}


def _poses(folder: Path, samples: Mapping[str, _Sample]) -> dict[str, Pose]:
    """Return the pose of the ego in each sample."""
    channels = {_text(where, row, "token"): row.get("channel") for where, row in _rows(folder, "sensor")}
    sensors = {
        _text(where, row, "token"): channels.get(_text(where, row, "sensor_token"))
        for where, row in _rows(folder, "calibrated_sensor")
    }
    chosen: dict[str, tuple[int, str]] = {}
    for where, row in _rows(folder, "sample_data"):
        sample = _text(where, row, "sample_token")
        if row.get("is_key_frame") is not True or sample not in samples:
            continue
        channel = sensors.get(_text(where, row, "calibrated_sensor_token"))
        if channel in _POSE_CHANNELS:
            rank = _POSE_CHANNELS.index(channel)
            chosen[sample] = max(chosen.get(sample, (-1, "")), (rank, _text(where, row, "ego_pose_token")))
    tokens = {token for _, token in chosen.values()}
    poses = {
        token: _pose(where, row)
        for where, row in _rows(folder, "ego_pose")
        if (token := _text(where, row, "token")) in tokens
    }
    return {sample: poses[token] for sample, (_, token) in chosen.items() if token in poses}


def _pose(where: str, row: _Row) -> Pose:
    x_m, y_m, _ = _numbers(where, row.get("translation"), 3)
    yaw_rad = _yaw(where, row)
    return Pose(x_m + CENTRE_AHEAD_M * math.cos(yaw_rad), y_m + CENTRE_AHEAD_M * math.sin(yaw_rad), yaw_rad)


def _add_truth(folder: Path, images: Mapping[str, GroundImage], builder: RecordingBuilder) -> None:
    categories = {
        _text(where, row, "token"): _text(where, row, "name") for where, row in _rows(folder, "category")
    }
    instances = {
        _text(where, row, "token"): categories.get(_text(where, row, "category_token"))
        for where, row in _rows(folder, "instance")
    }
    for where, row in _rows(folder, "sample_annotation"):
        image = images.get(_text(where, row, "sample_token"))
        if image is None:
            continue
        track = _text(where, row, "instance_token")
        category = instances.get(track)
        if category is None:
            raise RecordingError(f"{where}: expected an instance with a category, got {track!r}")
        name = _class_of(category, builder.options)
        image.add_truth(
            where,
            name,
            track,
            _body(where, row),
            has_region=name not in _THINGS,
            visible_share=_visible_share(where, row),
        )


def _visible_share(where: str, row: _Row) -> float | None:
    """Return the share of an object that is visible; 0 if no sensor has a point of it, as in the detection task."""
    visibility = row.get("visibility_token", "")
    if not isinstance(visibility, str) or visibility not in _VISIBLE_SHARES:
        raise RecordingError(
            f"{where}: visibility_token: expected 1, 2, 3, 4 or nothing, got {visibility!r:.80}"
        )
    has_points = row.get("num_lidar_pts") != 0 or row.get("num_radar_pts") != 0
    return _VISIBLE_SHARES[visibility] if has_points else 0.0


def _class_of(category: str, options: ReadOptions) -> str:
    """Return the class of a category; the category itself if the user mapped it."""
    while category.lower() not in options.classes and category not in _DETECTION_CLASSES and "." in category:
        category = category.rpartition(".")[0]
    return category if category.lower() in options.classes else _DETECTION_CLASSES.get(category, category)


def _add_detection(where: str, box: object, image: GroundImage) -> None:
    if not isinstance(box, dict):
        raise RecordingError(f"{where}: expected a box, got {box!r:.80}")
    (score,) = _numbers(f"{where}: detection_score", [box.get("detection_score")], 1)
    if not 0.0 <= score <= 1.0:
        raise RecordingError(f"{where}: detection_score: expected a score between 0 and 1, got {score:g}")
    image.add_detection(where, _text(where, box, "detection_name"), _body(where, box), score)


def _body(where: str, row: _Row) -> Any:
    x_m, y_m, _ = _numbers(f"{where}: translation", row.get("translation"), 3)
    width_m, length_m, height_m = _numbers(f"{where}: size", row.get("size"), 3)
    return checked_body(where, (x_m, y_m), _yaw(where, row), (length_m, width_m, height_m))


def _yaw(where: str, row: _Row) -> float:
    w, x, y, z = _numbers(f"{where}: rotation", row.get("rotation"), 4)
    if not 0.5 < w * w + x * x + y * y + z * z < 2.0:
        raise RecordingError(f"{where}: rotation: expected a unit quaternion w, x, y, z; got {[w, x, y, z]}")
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _text(where: str, row: _Row, name: str) -> str:
    value = row.get(name)
    if not isinstance(value, str) or not value:
        raise RecordingError(f"{where}: {name}: expected text, got {value!r:.80}")
    return value


def _numbers(where: str, values: object, count: int) -> Sequence[float]:
    if not (isinstance(values, list) and len(values) == count and all(map(is_number, values))):
        raise RecordingError(f"{where}: expected {count} number{'s' * (count > 1)}, got {values!r:.80}")
    return [float(one) for one in values]


FORMAT: Final = Format(
    name="nuscenes",
    title="nuScenes",
    expects='detections as a file of results ({"meta": …, "results": {sample_token: [boxes]}}), and truth as a '
    "folder with the tables scene.json, sample.json, sample_annotation.json and so on, or one with a folder v1.0-… "
    "that has them",
    recognises=_recognises,
    read=read,
    classes={
        **dict.fromkeys(("trailer", "construction_vehicle", "emergency_vehicle"), ClassMeaning.VEHICLE),
        **dict.fromkeys(
            ("motorcycle", "bicycle", "personal_mobility", "stroller", "wheelchair", "animal", *_THINGS),
            ClassMeaning.IGNORE,
        ),
    },
)

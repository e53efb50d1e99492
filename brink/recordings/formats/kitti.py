"""Recordings in the format of the KITTI tracking benchmark.

A sequence is a text file of labels with 17 columns: frame, track, type, truncated, occluded, alpha, the sides of the
box (left, top, right, bottom), height, width and length in metres, the place (x right, y down, z ahead of the camera)
of the middle of its bottom, and its rotation about the vertical axis, 0 to the right and -pi/2 ahead. Results have a
score as 18th column. Detections may also be in the 15 columns that 3D trackers read, separated by commas: frame,
class (1 pedestrian, 2 car, 3 cyclist), sides, score, height, width, length, place, rotation and alpha.

Source: A. Geiger, P. Lenz, R. Urtasun: the development kit of the KITTI tracking benchmark, readme.txt.
"""

import itertools
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from brink.recordings.camera import CameraModel
from brink.recordings.files import first_bytes, list_folder, parse_integer, parse_number, read_rows
from brink.recordings.format import Format, RecordingBuilder
from brink.recordings.recording import (
    MAX_IMAGES,
    ClassMeaning,
    Detection,
    ReadOptions,
    RecordedDrive,
    Recording,
    RecordingError,
    RoadUser,
    Sides,
)
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import Target

FRAMES_PER_S: Final = 10.0
ABOVE_M: Final = 1.65
"""Height of the cameras above the ground."""
SIZE_PX: Final = (1242.0, 375.0)
_TRUNCATION_LEVELS: Final = {"0": 0.0, "1": 0.25, "2": 0.75}
"""Share that is taken for each level of truncation of the tracking benchmark: none, some, most."""
_COMMA_CLASSES: Final = {1: "pedestrian", 2: "car", 3: "cyclist"}
_FOLDERS: Final = (".", "label_02", "training/label_02", "data")
_SEQUENCE_LISTS: Final = tuple(f"evaluate_tracking.seqmap{end}" for end in ("", ".training", ".val"))
_ABSENT: Final = -999.0
"""Places below this are none; the format writes -1000."""


class _Place(NamedTuple):
    """Position of a road user: the depth of its nearest point, its lateral position, and its heading."""

    distance_m: float
    left_m: float
    target: Target


class _Row(NamedTuple):
    where: str
    frame: int
    track: str
    name: str
    truncated: str
    occluded: str
    sides: Sides
    place: _Place | None
    score: float


def _recognises(detections: Path, truth: Path | None) -> bool:
    if truth is None or not _sequence_files(detections):
        return False
    lines = (first_bytes(path).split(b"\n")[0].split() for path in _sequence_files(truth).values())
    fields = next(filter(None, lines), [])
    return len(fields) in (17, 18) and fields[2][:1].isalpha()


def _sequence_files(path: Path) -> dict[str, Path]:
    """Return the file of each sequence by name."""
    if path.is_file():
        return {path.stem: path}
    for folder in _FOLDERS:
        files = {file.stem: file for file in list_folder(path / folder) if file.suffix == ".txt"}
        if files:
            return files
    return {}


def read(detections: Path, truth: Path | None, options: ReadOptions) -> Recording:
    """Read a recording from a folder of label files and a folder of result files, or from one file of each.

    The camera is read from ``calib/NAME.txt`` beside the folder of labels, or in it, unless the user gave one. A
    sequence has at least as many images as ``evaluate_tracking.seqmap`` or the folder ``image_02/NAME`` say, if they
    are there, and one for each frame up to the last with a row.

    Args:
        detections: The results, in 2D or 3D.
        truth: The labels.
        options: The user's settings for the recording.

    Raises:
        RecordingError: A file is missing or cannot be used.
    """
    if truth is None:
        raise RecordingError(
            f"{detections}: expected {FORMAT.expects}; say where the labels are with --truth"
        )
    builder = RecordingBuilder(detections.stem, options)
    labels, results = _sequence_files(truth), _sequence_files(detections)
    if truth.is_file() and detections.is_file():
        results = {truth.stem: detections}
    looked_for = f"files NAME.txt in {truth} (or its label_02) and in {detections} (or its data)"
    for name, label_file, result_file in builder.pair_sequences(labels, results, looked_for):
        camera = options.camera_of(name) or _calibration(name, label_file)
        _read_sequence(builder, builder.drive(name, camera), label_file, result_file)
    return builder.recording


def _read_sequence(builder: RecordingBuilder, drive: RecordedDrive, truth: Path, detections: Path) -> None:
    true_rows, found_rows = list(_rows(truth)), list(_rows(detections))
    rate = builder.options.frames_per_s or FRAMES_PER_S
    last = max((row.frame for row in itertools.chain(true_rows, found_rows)), default=-1)
    builder.add_frames(str(truth), drive, max(last + 1, _frame_count(drive.name, truth)), rate)
    for row in true_rows:
        label = builder.label(row.where, row.name)
        if label is None:
            builder.add_region(row.where, drive, row.frame / rate, row.sides)
        else:
            builder.add_road_user(row.where, drive, row.frame / rate, _road_user(row, label))
    for row in found_rows:
        label = builder.label(row.where, row.name)
        if label is None:
            builder.drop_detection(row.where, row.name)
        else:
            detection = Detection(
                label=label,
                sides=row.sides,
                score=row.score,
                distance_m=None if row.place is None else row.place.distance_m,
                left_m=None if row.place is None else row.place.left_m,
            )
            builder.add_detection(row.where, drive, row.frame / rate, detection)


def _road_user(row: _Row, label: ObstacleLabel) -> RoadUser:
    occluded = parse_integer(row.where, "occluded", row.occluded)
    truncated = parse_number(row.where, "truncated", row.truncated)
    place = row.place
    return RoadUser(
        track=row.track,
        label=label,
        sides=row.sides,
        target=place.target if place is not None and label is ObstacleLabel.VEHICLE else None,
        distance_m=None if place is None else place.distance_m,
        left_m=None if place is None else place.left_m,
        occlusion=occluded if occluded >= 0 else None,
        truncation=_TRUNCATION_LEVELS.get(row.truncated, truncated) if truncated >= 0.0 else None,
    )


def _rows(path: Path) -> Iterator[_Row]:
    separator = "," if b"," in first_bytes(path) else None
    for where, fields in read_rows(path, separator):
        if separator == "," and len(fields) == 15:
            yield _comma_row(where, fields)
        elif separator is None and len(fields) in (17, 18):
            yield _row(where, fields)
        else:
            raise RecordingError(
                f"{where}: expected the 17 columns of the KITTI tracking benchmark, or 18 with a score; got "
                f"{len(fields)}" + _hint(fields)
            )


def _hint(fields: Sequence[str]) -> str:
    if len(fields) in (15, 16) and fields[0][:1].isalpha():
        return " (those of the object benchmark, whose images have no order)"
    return ""


def _row(where: str, fields: Sequence[str]) -> _Row:
    left, top, right, bottom = (parse_number(where, "bbox", text) for text in fields[6:10])
    return _Row(
        where=where,
        frame=_frame(where, fields[0]),
        track=fields[1],
        name=fields[2],
        truncated=fields[3],
        occluded=fields[4],
        sides=Sides(left, right, top, bottom),
        place=_place(where, fields[10:17]),
        score=parse_number(where, "score", fields[17]) if len(fields) == 18 else 1.0,
    )


def _comma_row(where: str, fields: Sequence[str]) -> _Row:
    left, top, right, bottom = (parse_number(where, "bbox", text) for text in fields[2:6])
    kind = parse_integer(where, "class", fields[1])
    return _Row(
        where=where,
        frame=_frame(where, fields[0]),
        track="",
        name=_COMMA_CLASSES.get(kind, str(kind)),
        truncated="-1",
        occluded="-1",
        sides=Sides(left, right, top, bottom),
        place=_place(where, fields[7:14]),
        score=parse_number(where, "score", fields[6]),
    )


def _frame(where: str, text: str) -> int:
    frame = parse_integer(where, "frame", text)
    if not 0 <= frame < MAX_IMAGES:
        raise RecordingError(f"{where}: frame: expected a number from 0, got {text}")
    return frame


def _place(where: str, fields: Sequence[str]) -> _Place | None:
    """Return the position of a road user; None if the row does not contain it.

    Args:
        where: Where the row stands, for messages.
        fields: Height, width, length, x, y, z and rotation.
    """
    names = ("height", "width", "length", "x", "y", "z", "rotation_y")
    numbers = (parse_number(where, name, text) for name, text in zip(names, fields, strict=True))
    height, width, length, x, y, z, rotation = numbers
    if min(height, width, length) <= 0.0 or min(x, y, z) < _ABSENT:
        return None
    ahead, across = -math.sin(rotation), math.cos(rotation)
    nearest = z - 0.5 * (length * abs(ahead) + width * abs(across))
    target = Target.CROSSING
    if abs(ahead) >= math.sqrt(0.5):
        target = Target.LEAD if ahead > 0.0 else Target.ONCOMING
    return _Place(distance_m=max(nearest, 0.0), left_m=-x, target=target)


def _calibration(name: str, labels: Path) -> CameraModel:
    """Return the left colour camera of a sequence.

    Raises:
        RecordingError: There is no calibration, or none of this camera.
    """
    files = [folder / "calib" / f"{name}.txt" for folder in (labels.parent.parent, labels.parent)]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        raise RecordingError(
            f"{labels}: expected the calibration of sequence {name}; looked for {files[0]} and {files[1]} (or give "
            "the camera with --calibration or --camera)"
        )
    for where, (key, *fields) in read_rows(file, None):
        if key.rstrip(":") == "P2":
            if len(fields) != 12:
                raise RecordingError(f"{where}: P2: expected 12 numbers, got {len(fields)}")
            matrix = [parse_number(where, "P2", text) for text in fields]
            width_px, height_px = SIZE_PX
            return CameraModel(
                width_px=width_px,
                height_px=height_px,
                fx_px=matrix[0],
                fy_px=matrix[5],
                cx_px=matrix[2],
                cy_px=matrix[6],
                above_m=ABOVE_M,
            )
    raise RecordingError(
        f"{file}: expected a line P2: with the projection of the left colour camera, found none"
    )


def _frame_count(name: str, labels: Path) -> int:
    """Return the number of images of a sequence; 0 if its files do not contain it."""
    folder = labels.parent
    for near, file_name in itertools.product((folder, folder.parent, folder.parent.parent), _SEQUENCE_LISTS):
        if (near / file_name).is_file():
            for where, fields in read_rows(near / file_name, None):
                if len(fields) == 4 and fields[0] == name:
                    return parse_integer(where, "frames", fields[3])
    images = folder.parent / "image_02" / name
    if not images.is_dir():
        return 0
    with os.scandir(images) as files:
        return sum(1 for _ in itertools.islice(files, MAX_IMAGES + 1))


FORMAT: Final = Format(
    name="kitti",
    title="KITTI tracking",
    expects="truth as a folder of label files NAME.txt (label_02, with calib beside it), and detections as a folder "
    "with a file of results of the same name for each sequence",
    recognises=_recognises,
    read=read,
    classes={
        "person_sitting": ClassMeaning.PERSON,
        **dict.fromkeys(("cyclist", "tram", "misc", "dontcare"), ClassMeaning.IGNORE),
    },
)

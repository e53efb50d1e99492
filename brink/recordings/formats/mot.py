"""Recordings in the format of MOTChallenge.

A sequence is a folder with `gt/gt.txt`, `det/det.txt` and `seqinfo.ini`. The rows of `gt.txt` are frame, track, left,
top, width and height of the box, whether it counts, its class, and its visible share; frames and pixels count from 1.
The first data set of the benchmark has places in the world instead of class and share, and pedestrians only. The rows
of `det.txt` have a score instead of the flag.

Source: A. Milan, L. Leal-Taixé, I. Reid, S. Roth, K. Schindler: MOT16, a benchmark for multi-object tracking,
arXiv:1603.00831, section 3 and table 5.
"""

import configparser
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from brink.recordings.files import list_folder, parse_integer, parse_number, read_content, read_rows
from brink.recordings.format import Format, RecordingBuilder, assumed_camera
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

CLASS_NAMES: Final = {
    1: "pedestrian",
    2: "person on vehicle",
    3: "car",
    4: "bicycle",
    5: "motorbike",
    6: "non motorized vehicle",
    7: "static person",
    8: "distractor",
    9: "occluder",
    10: "occluder on the ground",
    11: "full occluder",
    12: "reflection",
    13: "crowd",
}
_PEDESTRIAN: Final = CLASS_NAMES[1]
_PLACE_COLUMNS: Final = 10
"""Rows with places in the world have this many columns, and no class."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _SequenceInfo:
    """Facts about the images of a sequence; None if unknown."""

    frames_per_s: float | None = None
    size_px: tuple[float, float] | None = None
    frames: int | None = None


def _recognises(detections: Path, truth: Path | None) -> bool:
    return bool(_sequences(truth or detections))


def _sequences(root: Path) -> dict[str, Path]:
    """Return the folder of each sequence by name."""
    folders = [root, *list_folder(root)]
    return {folder.absolute().name: folder for folder in folders if (folder / "gt" / "gt.txt").is_file()}


def _detection_files(names: Sequence[str], root: Path) -> dict[str, Path]:
    """Return the file with the detections of each sequence."""
    if len(names) == 1:
        for file in (root, root / "det" / "det.txt"):
            if file.is_file():
                return {names[0]: file}
    places = {
        name: (root / name / "det" / "det.txt", root / f"{name}.txt", root / "data" / f"{name}.txt")
        for name in names
    }
    found = {name: next((file for file in files if file.is_file()), None) for name, files in places.items()}
    return {name: file for name, file in found.items() if file is not None}


def read(detections: Path, truth: Path | None, options: ReadOptions) -> Recording:
    """Read a recording from a folder of sequences, or from one sequence.

    Args:
        detections: The folder with detections, by sequence: `NAME/det/det.txt` or `NAME.txt`.
        truth: The folder with sequences; None if it is the same.
        options: The user's settings for the recording.

    Raises:
        RecordingError: A file is missing or cannot be used.
    """
    root = truth or detections
    builder = RecordingBuilder(detections.stem, options)
    folders = _sequences(root)
    files = _detection_files(sorted(folders), detections)
    looked_for = (
        f"gt/gt.txt in {root} or its folders, and det/det.txt in {detections} or its folders, or NAME.txt"
    )
    truths: dict[bytes, str] = {}
    for name, folder, detection_file in builder.pair_sequences(folders, files, looked_for):
        digest = hashlib.sha256(read_content(folder / "gt" / "gt.txt").encode()).digest()
        other = truths.setdefault(digest, name)
        if other != name:
            raise RecordingError(
                f"{folder}: expected a drive of its own, but its truth is that of {other}, so that one drive would "
                "count twice; name a folder with the detections of one detector"
            )
        _read_sequence(builder, name, folder, detection_file)
    builder.note_assumed_camera(root)
    return builder.recording


def _read_sequence(builder: RecordingBuilder, name: str, folder: Path, detection_file: Path) -> None:
    info = _sequence_info(folder / "seqinfo.ini")
    rate = builder.options.frames_per_s or info.frames_per_s
    if rate is None:
        raise RecordingError(
            f"{folder}: expected the number of frames per second; looked for frameRate in {folder / 'seqinfo.ini'} "
            "(or give --frames-per-s)"
        )
    drive = builder.drive(name, None if info.size_px is None else assumed_camera(*info.size_px))
    if info.size_px is not None:
        builder.check_size(str(folder), drive, *info.size_px)
    last = max(
        _add_truth(builder, drive, folder / "gt" / "gt.txt", rate, info.frames),
        _add_detections(builder, drive, detection_file, rate, info.frames),
    )
    builder.add_frames(str(folder), drive, last if info.frames is None else info.frames, rate)


def _add_truth(
    builder: RecordingBuilder, drive: RecordedDrive, path: Path, rate: float, frames: int | None
) -> int:
    """Add the truth of a sequence, and return its last frame."""
    last = 0
    for where, fields in read_rows(path, ","):
        if not 6 <= len(fields) <= _PLACE_COLUMNS:
            raise RecordingError(
                f"{where}: expected between 6 and {_PLACE_COLUMNS} columns, got {len(fields)}"
            )
        frame = _frame(where, fields, frames)
        last, time_s, sides = max(last, frame), (frame - 1) / rate, _sides(where, fields)
        has_class = 8 <= len(fields) < _PLACE_COLUMNS
        name = _class_name(where, fields) if has_class else _PEDESTRIAN
        counts = len(fields) < 7 or parse_number(where, "flag", fields[6]) != 0.0
        label = builder.label(where, name) if counts else None
        if label is None:
            builder.add_region(where, drive, time_s, sides)
            continue
        visible = parse_number(where, "visibility", fields[8]) if len(fields) == 9 else -1.0
        road_user = RoadUser(
            track=fields[1], label=label, sides=sides, visible_share=visible if visible >= 0.0 else None
        )
        builder.add_road_user(where, drive, time_s, road_user)
    return last


def _add_detections(
    builder: RecordingBuilder, drive: RecordedDrive, path: Path, rate: float, frames: int | None
) -> int:
    """Add the detections of a sequence, and return its last frame."""
    last = 0
    for where, fields in read_rows(path, ","):
        if not 7 <= len(fields) <= _PLACE_COLUMNS:
            raise RecordingError(
                f"{where}: expected between 7 and {_PLACE_COLUMNS} columns, got {len(fields)}"
            )
        frame = _frame(where, fields, frames)
        last = max(last, frame)
        has_class = 8 <= len(fields) < _PLACE_COLUMNS and parse_number(where, "class", fields[7]) > 0.0
        name = _class_name(where, fields) if has_class else _PEDESTRIAN
        label = builder.label(where, name)
        if label is None:
            builder.drop_detection(where, name)
            continue
        score = parse_number(where, "score", fields[6])
        detection = Detection(label=label, sides=_sides(where, fields), score=score)
        builder.add_detection(where, drive, (frame - 1) / rate, detection)
    return last


def _frame(where: str, fields: Sequence[str], frames: int | None) -> int:
    frame = parse_integer(where, "frame", fields[0])
    if not 1 <= frame <= (MAX_IMAGES if frames is None else frames):
        expected = "from 1" if frames is None else f"between 1 and {frames}"
        raise RecordingError(f"{where}: frame: expected a number {expected}, got {frame}")
    return frame


def _sides(where: str, fields: Sequence[str]) -> Sides:
    names = ("left", "top", "width", "height")
    left, top, width, height = (
        parse_number(where, name, text) for name, text in zip(names, fields[2:6], strict=True)
    )
    if width < 0.0 or height < 0.0:
        raise RecordingError(
            f"{where}: expected left, top, width and height, got a negative size: {fields[2:6]}"
        )
    return Sides(left - 1.0, left - 1.0 + width, top - 1.0, top - 1.0 + height)


def _class_name(where: str, fields: Sequence[str]) -> str:
    number = parse_integer(where, "class", fields[7])
    return CLASS_NAMES.get(number, str(number))


def _sequence_info(path: Path) -> _SequenceInfo:
    """Return the content of `seqinfo.ini`.

    Raises:
        RecordingError: It cannot be used.
    """
    if not path.is_file():
        return _SequenceInfo()
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(read_content(path))
    except configparser.Error as error:
        raise RecordingError(f"{path}: {error}") from error
    if not parser.has_section("Sequence"):
        raise RecordingError(f"{path}: expected a section [Sequence]")
    section = parser["Sequence"]
    numbers = {
        name: parse_number(str(path), name, section[name])
        for name in ("frameRate", "seqLength", "imWidth", "imHeight")
        if name in section
    }
    for name, value in numbers.items():
        if value <= 0.0:
            raise RecordingError(f"{path}: {name}: expected a positive number, got {value:g}")
    width_px, height_px = numbers.get("imWidth"), numbers.get("imHeight")
    return _SequenceInfo(
        frames_per_s=numbers.get("frameRate"),
        size_px=None if width_px is None or height_px is None else (width_px, height_px),
        frames=int(numbers["seqLength"]) if "seqLength" in numbers else None,
    )


FORMAT: Final = Format(
    name="mot",
    title="MOTChallenge",
    expects="truth as a folder of sequences, each with gt/gt.txt and seqinfo.ini, and detections as det/det.txt in "
    "each sequence, or as a folder of files NAME.txt",
    recognises=_recognises,
    read=read,
    classes={name: ClassMeaning.IGNORE for name in CLASS_NAMES.values() if name not in (_PEDESTRIAN, "car")},
)

"""Recordings in a CSV file with one row for each box, true or detected."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from brink.recordings.files import first_bytes, parse_integer, parse_number, read_content
from brink.recordings.format import Format, RecordingBuilder, target_of
from brink.recordings.recording import (
    Detection,
    ReadOptions,
    RecordedDrive,
    Recording,
    RecordingError,
    RoadUser,
    Sides,
)
from brink.sim.driving.interface import ObstacleLabel

COLUMNS: Final = ("drive", "time_s", "source", "id", "label", "x_min_px", "x_max_px", "y_min_px", "y_max_px")
"""Columns of every file. `id` names a true road user within its drive."""
OPTIONAL: Final = (
    "target",
    "condition",
    "score",
    "occlusion",
    "visible_share",
    "truncation",
    "distance_m",
    "lateral_m",
    "lane",
    "ignore",
)
SOURCES: Final = ("truth", "detection", "ignore", "frame")
"""What a row says: a true road user, a detection, a region to ignore, or that there is an image at this time."""
EGO_LANE: Final = "ego"

_Row = Mapping[str, str]


def _recognises(detections: Path, truth: Path | None) -> bool:
    files = (detections,) if truth is None else (detections, truth)
    return all(
        path.suffix.lower() == ".csv" or b"time_s" in first_bytes(path).partition(b"\n")[0] for path in files
    )


def read(detections: Path, truth: Path | None, options: ReadOptions) -> Recording:
    """Read a recording from a CSV file, or from two: one with detections and one with the truth.

    Args:
        detections: The file with detections; see `COLUMNS` and `OPTIONAL`.
        truth: Another file with the truth; None if there is one file.
        options: The user's settings for the recording.

    Raises:
        RecordingError: A file is missing or cannot be used.
    """
    builder = RecordingBuilder(detections.stem, options)
    for path in (detections,) if truth in (None, detections) else (truth, detections):
        try:
            _read_file(path, builder)
        except csv.Error as error:
            raise RecordingError(f"{path}: {error}") from error
    return builder.recording


def _read_file(path: Path, builder: RecordingBuilder) -> None:
    rows = csv.reader(io.StringIO(read_content(path), newline=""))
    names = [name.strip() for name in next(rows, [])]
    _check_columns(path, names)
    unread = [name for name in names if name not in (*COLUMNS, *OPTIONAL)]
    if unread:
        builder.recording.notes.append(f"Columns of {path} that were not read: {', '.join(unread)[:200]}.")
    drives_with_lanes: set[str] = set()
    for fields in rows:
        where = f"{path}:{rows.line_num}"
        if not fields:
            continue
        if len(fields) != len(names):
            raise RecordingError(
                f"{where}: expected {len(names)} fields, as in the first line; got {len(fields)}"
            )
        row = dict(zip(names, map(str.strip, fields), strict=True))
        drive = builder.drive(row["drive"])
        builder.set_condition(where, drive, row.get("condition") or None)
        if row.get("lane"):
            drives_with_lanes.add(drive.name)
        _add_row(where, row, drive, builder)
    for name in drives_with_lanes:
        _set_lanes(builder.recording.drives[name])


def _check_columns(path: Path, names: Sequence[str]) -> None:
    missing = [name for name in COLUMNS if name not in names]
    twice = sorted({name for name in names if names.count(name) > 1 and name in (*COLUMNS, *OPTIONAL)})
    if missing:
        separator = next((mark for mark in (";", "\t") if len(names) == 1 and mark in names[0]), None)
        hint = f"; expected commas between them, not {separator!r}" if separator else ""
        raise RecordingError(
            f"{path}: expected the columns {', '.join(COLUMNS)}, and optionally {', '.join(OPTIONAL)}; missing "
            f"{', '.join(missing)}{hint}"
        )
    if twice:
        raise RecordingError(f"{path}: expected each column once, got {', '.join(twice)} twice")


def _add_row(where: str, row: _Row, drive: RecordedDrive, builder: RecordingBuilder) -> None:
    source = row["source"].lower()
    if source not in SOURCES:
        raise RecordingError(
            f"{where}: source: expected one of {', '.join(SOURCES)}; got {row['source']!r:.80}"
        )
    if not drive.name:
        raise RecordingError(f"{where}: drive: expected the name of a drive, got nothing")
    time_s = parse_number(where, "time_s", row["time_s"])
    if source == "frame":
        builder.add_image(where, drive, time_s)
        return
    sides = Sides(*(parse_number(where, name, row[name]) for name in COLUMNS[5:]))
    is_ignored = source == "ignore" or _is_ignored(where, row)
    label = None if is_ignored else builder.label(where, row["label"])
    if source == "detection":
        if is_ignored:
            raise RecordingError(
                f"{where}: ignore: expected 1 in rows of truth alone, got it for a detection"
            )
        if label is None:
            builder.drop_detection(where, row["label"])
        else:
            builder.add_detection(where, drive, time_s, _detection(where, row, label, sides))
    elif label is None:
        builder.add_region(where, drive, time_s, sides)
    else:
        builder.add_road_user(where, drive, time_s, _road_user(where, row, label, sides))


def _is_ignored(where: str, row: _Row) -> bool:
    given = row.get("ignore", "")
    if given not in ("", "0", "1"):
        raise RecordingError(f"{where}: ignore: expected 0, 1 or nothing, got {given!r:.80}")
    return given == "1"


def _road_user(where: str, row: _Row, label: ObstacleLabel, sides: Sides) -> RoadUser:
    lane = row.get("lane", "").lower()
    return RoadUser(
        track=row["id"],
        label=label,
        sides=sides,
        target=target_of(where, row.get("target")),
        distance_m=_optional(where, row, "distance_m"),
        left_m=_optional(where, row, "lateral_m"),
        in_lane=lane == EGO_LANE if lane else None,
        occlusion=parse_integer(where, "occlusion", row["occlusion"]) if row.get("occlusion") else None,
        visible_share=_optional(where, row, "visible_share"),
        truncation=_optional(where, row, "truncation"),
    )


def _detection(where: str, row: _Row, label: ObstacleLabel, sides: Sides) -> Detection:
    score = _optional(where, row, "score")
    return Detection(
        label=label,
        sides=sides,
        score=1.0 if score is None else score,
        distance_m=_optional(where, row, "distance_m"),
        left_m=_optional(where, row, "lateral_m"),
    )


def _optional(where: str, row: _Row, name: str) -> float | None:
    return parse_number(where, name, row[name]) if row.get(name) else None


def _set_lanes(drive: RecordedDrive) -> None:
    """Record that road users without a lane are in none of the named ones."""
    for image in drive.images.values():
        image.road_users = [
            replace(one, in_lane=False) if one.in_lane is None else one for one in image.road_users
        ]


FORMAT: Final = Format(
    name="csv",
    title="CSV",
    expects="a file NAME.csv with one row for each box, true or detected, and the columns "
    f"{', '.join(COLUMNS)}; or one such file for detections and one for truth",
    recognises=_recognises,
    read=read,
)

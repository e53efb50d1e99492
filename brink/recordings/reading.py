"""Reads a recording in any format, with the user's settings for it."""

import importlib
import pkgutil
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field

from brink.recordings import formats
from brink.recordings.camera import CameraModel
from brink.recordings.files import describe
from brink.recordings.format import Format
from brink.recordings.recording import (
    CLASSES,
    MAX_BOXES,
    ClassMeaning,
    ReadOptions,
    Recording,
    RecordingError,
)
from brink.server.documents import Body, errors_in_file, parse_document, read_yaml


@cache
def formats_by_name() -> Mapping[str, Format]:
    """Return all formats: one for each module of `brink.recordings.formats`."""
    modules = sorted(module.name for module in pkgutil.iter_modules(formats.__path__, f"{formats.__name__}."))
    found: list[Format] = [importlib.import_module(name).FORMAT for name in modules]
    return {one.name: one for one in found}


def read_recording(
    detections: Path,
    truth: Path | None = None,
    *,
    format: str | None = None,  # noqa: A002 - the name on the command line
    options: ReadOptions | None = None,
) -> Recording:
    """Read a recording.

    Args:
        detections: The file or folder with what the detector reported.
        truth: The file or folder with the true road users; None if it is the same.
        format: Name of the format; None to recognise it.
        options: The user's settings for the recording.

    Raises:
        RecordingError: The format is unknown, or the files cannot be used.
    """
    options = options or ReadOptions()
    try:
        chosen = _recognised(detections, truth) if format is None else _named(format)
        classes = {**chosen.classes, **options.classes}
        recording = chosen.read(detections, truth, replace(options, classes=classes))
    except OSError as error:
        raise RecordingError(f"{error.filename or detections}: {error.strerror or error}") from error
    unknown = sorted((options.cameras.keys() | options.conditions.keys()) - recording.drives.keys())
    if unknown:
        raise RecordingError(
            f"settings of drive {unknown[0]!r}: expected one of the drives "
            f"{', '.join(sorted(recording.drives)[:20])}"
        )
    recording.camera = options.camera or recording.camera
    boxes = 0
    for drive in recording.drives.values():
        drive.place_detections()
        drive.camera = options.camera_of(drive.name) or drive.camera
        drive.condition = drive.condition or options.conditions.get(drive.name, options.condition)
        boxes += sum(map(len, drive.detections_elsewhere.values()))
        boxes += sum(len(image.road_users) + len(image.detections) for image in drive.images.values())
    if boxes > MAX_BOXES:
        raise RecordingError(f"{detections}: expected at most {MAX_BOXES} boxes, found {boxes}")
    if not any(drive.images for drive in recording.drives.values()):
        raise RecordingError(f"{truth or detections}: expected boxes, found none")
    _note_copies(recording)
    return recording


def _note_copies(recording: Recording) -> None:
    """Note drives with the same truth as another, such as one drive under two names."""
    names: dict[Hashable, list[str]] = {}
    for name, drive in recording.drives.items():
        truth = tuple(
            (time_s, tuple((user.label, tuple(user.sides)) for user in image.road_users))
            for time_s, image in sorted(drive.images.items())
        )
        names.setdefault(truth, []).append(name)
    copies = [same for same in names.values() if len(same) > 1]
    if copies:
        recording.notes.append(
            f"{sum(map(len, copies)) - len(copies)} drives have exactly the true boxes of another "
            f"({copies[0][1]} those of {copies[0][0]}, for one): if they are copies, one drive counts several times, "
            "and intervals are narrower than they should be"
        )


def _named(name: str) -> Format:
    found = formats_by_name().get(name)
    if found is None:
        raise RecordingError(f"format: expected one of {', '.join(formats_by_name())}; got {name!r:.40}")
    return found


def _recognised(detections: Path, truth: Path | None) -> Format:
    found = [one for one in formats_by_name().values() if one.recognises(detections, truth)]
    if len(found) == 1:
        return found[0]
    paths = (detections,) if truth is None else (detections, truth)
    came = "; ".join(describe(path) for path in paths)
    if found:
        names = " or ".join(f"--format {one.name}" for one in found)
        raise RecordingError(f"{came}. These files could be in several formats: say {names}")
    lines = [f"  {one.name}: {one.expects}" for one in formats_by_name().values()]
    raise RecordingError(
        "\n".join([f"{came}. Expected detections and truth (--truth) in one of these formats:", *lines])
    )


def parse_classes(given: Iterable[str]) -> dict[str, ClassMeaning]:
    """Return the meanings of classes.

    Args:
        given: What the user said, such as ``cyclist=person``.

    Raises:
        RecordingError: Something is not a name with a meaning.
    """
    meanings: dict[str, ClassMeaning] = {}
    for text in given:
        name, _, meaning = (part.strip().lower() for part in text.rpartition("="))
        if not name or meaning not in set(ClassMeaning):
            raise RecordingError(
                f"classes: expected CLASS=MEANING, where the meaning is one of {', '.join(ClassMeaning)}; got "
                f"{text!r:.80}"
            )
        meanings[name] = ClassMeaning(meaning)
    return meanings


class _DriveSettings(Body):
    condition: str | None = None
    camera: dict[str, Any] | None = None


class _Settings(Body):
    camera: dict[str, Any] | None = None
    frames_per_s: float | None = Field(default=None, gt=0.0, le=1000.0)
    classes: dict[str, str] = Field(default_factory=dict)
    condition: str | None = None
    drives: dict[str, _DriveSettings] = Field(default_factory=dict)


def read_settings(path: Path) -> ReadOptions:
    """Read the user's settings for a recording from a YAML file.

    Args:
        path: The file, with any of ``camera``, ``frames_per_s``, ``classes``, ``condition`` and ``drives``.

    Raises:
        InvalidInput: The file cannot be read, or has a field that is unknown or of the wrong type.
        RecordingError: A class has no such meaning.
        CameraError: A camera cannot be.
    """
    document = read_yaml(path)
    with errors_in_file(path):
        settings = parse_document(document, _Settings, "settings of a recording")
    camera = None
    if settings.camera is not None:
        camera = CameraModel.from_document(f"{path}: camera", settings.camera)
    drives = settings.drives.items()
    return ReadOptions(
        classes={
            **CLASSES,
            **parse_classes(f"{name}={meaning}" for name, meaning in settings.classes.items()),
        },
        frames_per_s=settings.frames_per_s,
        camera=camera,
        cameras={
            name: CameraModel.from_document(f"{path}: camera of drive {name}", drive.camera)
            for name, drive in drives
            if drive.camera is not None
        },
        condition=settings.condition,
        conditions={name: drive.condition for name, drive in drives if drive.condition is not None},
    )

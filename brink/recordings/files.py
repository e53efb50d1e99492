"""Reads the files of a recording within bounds; every failure is a `RecordingError` that names the file."""

import io
import itertools
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from brink.recordings.recording import MAX_BYTES, MAX_SEQUENCES, RecordingError
from brink.user_file import open_file, read_file

_SNIFFED_BYTES: Final = 4096
_SHOWN: Final = 8


def read_content(path: Path) -> str:
    """Return the content of a text file.

    Raises:
        RecordingError: It cannot be read, is not a regular file, is too large, or is not UTF-8.
    """
    try:
        return read_file(path, MAX_BYTES).decode("utf-8-sig")
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: {getattr(error, 'strerror', None) or error}") from error


def read_rows(path: Path, separator: str | None) -> Iterator[tuple[str, list[str]]]:
    """Yield the position of each row of a text file, for messages, and its fields, skipping empty lines.

    Args:
        path: The file.
        separator: What separates fields; None for white space.

    Raises:
        RecordingError: The file cannot be read.
    """
    for number, line in enumerate(io.StringIO(read_content(path)), 1):
        if line.strip():
            yield f"{path}:{number}", [field.strip() for field in line.split(separator)]


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.

    Raises:
        RecordingError: It cannot be read, or is not JSON.
    """
    try:
        return json.loads(read_content(path))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: expected JSON: {error}") from error


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file; empty if it cannot be read."""
    try:
        with open_file(path) as file:
            return file.read(_SNIFFED_BYTES)
    except (OSError, ValueError):
        return b""


def list_folder(folder: Path) -> list[Path]:
    """Return the content of a folder, by name; empty if it is not a folder.

    Raises:
        RecordingError: It cannot be read, or contains too much.
    """
    try:
        if not folder.is_dir():
            return []
        found = list(itertools.islice(folder.iterdir(), MAX_SEQUENCES + 1))
    except (OSError, ValueError) as error:
        raise RecordingError(f"{folder}: {error}") from error
    if len(found) > MAX_SEQUENCES:
        raise RecordingError(f"{folder}: expected at most {MAX_SEQUENCES} files and folders, found more")
    return sorted(found)


def describe(path: Path) -> str:
    """Describe what is at a path, such as ``a folder with 0000.txt, 0001.txt``, for messages."""
    entries = [entry.name for entry in list_folder(path)]
    if entries:
        more = f" and {len(entries) - _SHOWN} more" if len(entries) > _SHOWN else ""
        return f"{path} is a folder with {', '.join(entries[:_SHOWN])}{more}"
    kind = (
        "an empty folder" if path.is_dir() else "a file" if path.is_file() else "neither a file nor a folder"
    )
    return f"{path} is {kind}" if path.exists() else f"{path} does not exist"


def parse_number(where: str, name: str, text: str | None) -> float:
    """Return a finite number.

    Raises:
        RecordingError: The text is none.
    """
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RecordingError(f"{where}: {name}: expected a number, got {text!r:.80}")
    return value


def parse_integer(where: str, name: str, text: str | None) -> int:
    """Return a whole number.

    Raises:
        RecordingError: The text is none.
    """
    value = parse_number(where, name, text)
    if value != int(value):
        raise RecordingError(f"{where}: {name}: expected a whole number, got {text!r:.80}")
    return int(value)

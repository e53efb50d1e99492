"""Users' weights files: named in ids such as ``onnx:FILE``, known by their content. Light: loads no network."""

import hashlib
import subprocess
import sys
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from brink.sim.perception.errors import DetectorError
from brink.sim.perception.plain_files import not_plain

LOADING_S: Final = 120.0
KINDS: Final = ("onnx", "torchscript", "ultralytics")


def file_of(detector_id: str) -> Path | None:
    """Return the weights file that an id names; None if it names none.

    Raises:
        DetectorError: The kind is unknown, or the file is not there.
    """
    kind, colon, name = detector_id.partition(":")
    if not colon:
        return None
    if kind not in KINDS:
        raise DetectorError(
            f"detector: expected {', '.join(f'{one}:FILE' for one in KINDS)}; got {detector_id!r}"
        )
    if wrong := "no such file" if not name else not_plain(Path(name)):
        raise DetectorError(f"detector: {name or 'a file'}: {wrong}")
    return Path(name)


def weights_digest(detector_id: str) -> str:
    """Return what identifies the weights of an id: 16 hexadecimal digits, empty if it names no file.

    Raises:
        DetectorError: The kind is unknown, or the file is not there.
    """
    file = file_of(detector_id)
    if file is None:
        return ""
    stat = file.stat()
    return _digest(file, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=8)
def _digest(file: Path, _changed: int, _size: int) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


def check_loads(detector_id: str) -> None:
    """Load a weights file in a process of its own, where this machine has what that takes.

    Raises:
        DetectorError: It is no detector.
    """
    file = file_of(detector_id)
    if file is not None and all(find_spec(module) is not None for module in ("cv2", "onnxruntime")):
        _check_loads(detector_id, weights_digest(detector_id))


@lru_cache(maxsize=8)
def _check_loads(detector_id: str, _content: str) -> None:
    command = [sys.executable, "-m", "brink.sim.perception.adapters", detector_id]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LOADING_S)
    except subprocess.TimeoutExpired:
        raise DetectorError(f"{detector_id}: cannot be loaded in {LOADING_S:g} s") from None
    if done.returncode != 0:
        said = (done.stdout or done.stderr).strip().splitlines()
        raise DetectorError(said[-1] if said else f"{detector_id}: cannot be loaded")

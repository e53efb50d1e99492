"""Files that users provide: detector weights and labelled data sets in COCO format, checked before use.

This module loads no network, so a coordinator can validate a submission with it. Only plain files on a disk are read:
reading a device or a pipe might never end.

A data set is read completely or rejected. Boxes of persons and vehicles are kept, other categories are left out.
Crowds and very small boxes are ignored, as in COCO's own evaluation.

SimulatorError
├── DetectorError          a detector cannot be loaded, or cannot process an image
│   └── InvalidDetections  final, also an InvalidEpisode: a detector answered an image with NaN or without boxes
└── DatasetError           a data set is missing or invalid

Source: the COCO data format, https://cocodataset.org/#format-data.
"""

import hashlib
import json
import stat
import subprocess
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from brink.sim.errors import InvalidEpisode, SimulatorError
from brink.sim.perception.boxes import MIN_HEIGHT_SHARE, MIN_WIDTH_SHARE, GroundTruth, too_small
from brink.user_file import read_file

MAX_BYTES: Final = 2 * 1024**3
MAX_DESCRIPTION_BYTES: Final = 1024**2
LOAD_TIMEOUT_S: Final = 120.0
DEFAULT_DETECTOR: Final = "brink-det@2"
"""Detector of a problem with a camera, unless another is chosen."""
KINDS: Final = ("onnx", "torchscript", "ultralytics")
CATEGORY_LABELS: Final[Mapping[str, int]] = {
    "vehicle": 0,
    "car": 0,
    "truck": 0,
    "bus": 0,
    "van": 0,
    "motorcycle": 0,
    "train": 0,
    "person": 1,
    "pedestrian": 1,
}
"""Label of each known category: 0 for a vehicle, 1 for a person."""
LABEL_WORDS: Final = ("vehicles", "persons")
MAX_LISTED: Final = 3
"""Number of faults that a message lists."""
_SYSTEM_FOLDERS: Final = ("/proc", "/sys")

_Box: TypeAlias = tuple[int, tuple[float, float, float, float], bool]
"""Label, corners, and whether the box is a crowd."""


class DetectorError(SimulatorError):
    """A detector cannot be loaded, or cannot process an image."""


class InvalidDetections(DetectorError, InvalidEpisode):
    """A detector's answer to an image is not a set of detections, such as one with a score of NaN.

    It is final, because a detector answers the same image in the same way.
    """


class DatasetError(SimulatorError):
    """A data set is missing or invalid."""


def _unreadable(file: Path) -> str | None:
    """Return the reason why a file must not be read, or None if it may be read."""
    try:
        real = file.resolve()
        status = real.stat()
    except (OSError, ValueError, RuntimeError) as error:  # missing, name too long, NUL in it, cycle of links
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        return "no such file" if isinstance(error, FileNotFoundError) else f"no file: {reason}"
    if stat.S_ISDIR(status.st_mode):
        return "expected a file, got a folder"
    if not stat.S_ISREG(status.st_mode) or any(real.is_relative_to(folder) for folder in _SYSTEM_FOLDERS):
        return "expected a regular file on a disk"
    if status.st_size > MAX_BYTES:
        return f"expected at most {MAX_BYTES} bytes, got {status.st_size}"
    return None


def weights_file(detector_id: str) -> Path | None:
    """Return the weights file named by a detector id, or None for a registered detector.

    Raises:
        DetectorError: The kind is unknown, or the file cannot be read.
    """
    kind, colon, name = detector_id.partition(":")
    if not colon:
        return None
    if kind not in KINDS:
        raise DetectorError(
            f"detector: expected {', '.join(f'{one}:FILE' for one in KINDS)}; got {detector_id!r}"
        )
    if reason := "no such file" if not name else _unreadable(Path(name)):
        raise DetectorError(f"detector: {name or 'a file'}: {reason}")
    return Path(name)


def weights_digest(detector_id: str) -> str:
    """Return a digest of the weights file and its description, 16 hexadecimal digits.

    It is empty for a registered detector.

    Raises:
        DetectorError: The kind is unknown, or the file cannot be read.
    """
    file = weights_file(detector_id)
    if file is None:
        return ""
    return _digest(file, _stamp(file), _stamp(description_file(file)))


def description_file(weights: Path) -> Path:
    """Return the file beside a weights file that may describe the network."""
    return weights.with_name(weights.name + ".json")


def _stamp(file: Path) -> tuple[int, int] | None:
    """Return the time of the last change and the size of a file; None if there is none."""
    if not file.is_file():
        return None
    status = file.stat()
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=8)
def _digest(file: Path, _weights: tuple[int, int] | None, description: tuple[int, int] | None) -> str:
    digest = hashlib.sha256(read_file(file, MAX_BYTES))
    if description is not None:
        digest.update(read_file(description_file(file), MAX_DESCRIPTION_BYTES))
    return digest.hexdigest()[:16]


def check_loads(detector_id: str) -> frozenset[int] | None:
    """Check that a weights file can be loaded, in a separate process, if this machine has the libraries for it.

    Returns:
        The labels that the detector may give; None if they are unknown.

    Raises:
        DetectorError: The file is not a detector.
    """
    file = weights_file(detector_id)
    if file is None or any(find_spec(module) is None for module in ("cv2", "onnxruntime")):
        return None
    return _check_loads(detector_id, weights_digest(detector_id))


@lru_cache(maxsize=8)
def _check_loads(detector_id: str, _content: str) -> frozenset[int]:
    command = [sys.executable, "-m", "brink.sim.perception.detector", detector_id]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LOAD_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        raise DetectorError(f"{detector_id}: loading took more than {LOAD_TIMEOUT_S:g} s") from None
    if done.returncode != 0:
        output = (done.stdout or done.stderr).strip().splitlines()
        raise DetectorError(output[-1] if output else f"{detector_id}: cannot be loaded")
    return frozenset(map(int, done.stdout.split()[-len(LABEL_WORDS) :]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CocoPicture:
    """One image of a data set.

    Attributes:
        file: Path of the image.
        width_px: Width stated by the annotations.
        height_px: Height stated by the annotations.
        truth: Ground truth in pixels of the image.
    """

    file: Path
    width_px: int
    height_px: int
    truth: GroundTruth


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CocoDataset:
    """A labelled data set.

    Attributes:
        file: The annotations.
        digest: Digest of the annotations, 16 hexadecimal digits.
        pictures: In the order of the file, including images without boxes.
    """

    file: Path
    digest: str
    pictures: tuple[CocoPicture, ...]


def read_coco(file: Path) -> CocoDataset:
    """Read a data set; an unchanged file is read only once.

    Args:
        file: Annotations in JSON. Images are searched for in its folder and in the subfolder ``images``.

    Raises:
        DatasetError: The file is missing or invalid, a box is invalid, or an image is missing or not in its folder.
    """
    try:
        status = file.stat()
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file}: {getattr(error, 'strerror', None) or error}") from None
    if reason := _unreadable(file):
        raise DatasetError(f"{file}: {reason}; it should be JSON in COCO format")
    return _read_coco(file, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4)
def _read_coco(file: Path, _modified_ns: int, _size: int) -> CocoDataset:
    try:
        raw = read_file(file, MAX_BYTES)
        document = json.loads(raw)
    except OSError as error:
        raise DatasetError(f"{file}: {error.strerror or error}") from None
    except ValueError as error:
        raise DatasetError(f"{file}: not JSON: {error}") from None
    except RecursionError:
        raise DatasetError(f"{file}: JSON is nested too deeply") from None
    try:
        images, annotations, categories = (
            _rows(document, name) for name in ("images", "annotations", "categories")
        )
        labels = {row["id"]: CATEGORY_LABELS.get(str(row["name"]).lower()) for row in categories}
        sizes = {row["id"]: _image(row) for row in images}
    except (DatasetError, KeyError, TypeError, ValueError) as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise DatasetError(f"{file}: {reason}") from None
    if all(label is None for label in labels.values()):
        raise DatasetError(
            f"{file}: expected at least one category with one of the names {', '.join(CATEGORY_LABELS)}"
        )
    boxes = _boxes_by_image(file, annotations, labels, sizes)
    paths = {key: _find(file, name) for key, (name, _, _) in sizes.items()}
    missing = [name for key, (name, _, _) in sizes.items() if paths[key] is None]
    if missing:
        more = f" and {len(missing) - MAX_LISTED} more" if len(missing) > MAX_LISTED else ""
        raise DatasetError(
            f"{file}: images not found in its folder or in images/: {', '.join(missing[:MAX_LISTED])}{more}"
        )
    pictures = tuple(
        CocoPicture(file=path, width_px=wide, height_px=high, truth=_truth(boxes[key], wide, high))
        for (key, path), (_, wide, high) in zip(paths.items(), sizes.values(), strict=True)
        if path is not None
    )
    if not any(len(picture.truth.labels) for picture in pictures):
        raise DatasetError(f"{file}: no box belongs to any of the categories {', '.join(CATEGORY_LABELS)}")
    return CocoDataset(file=file, digest=hashlib.sha256(raw).hexdigest()[:16], pictures=pictures)


def _rows(document: object, name: str) -> list[Any]:
    rows = document.get(name) if isinstance(document, dict) else None
    if not isinstance(rows, list) or not rows:
        raise DatasetError(f"expected a non-empty list of {name}, as in COCO format")
    return rows


def _image(row: Any) -> tuple[str, int, int]:
    width_px, height_px = row["width"], row["height"]
    if not (isinstance(width_px, int) and isinstance(height_px, int) and width_px > 0 and height_px > 0):
        raise DatasetError(
            f"image {row.get('id')!r}: expected width and height in px, got {width_px!r}, {height_px!r}"
        )
    name = str(row["file_name"])
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise DatasetError(
            f"image {row.get('id')!r}: file_name: expected a path in the folder of the annotations, got {name!r}"
        )
    return name, width_px, height_px


def _boxes_by_image(
    file: Path,
    annotations: list[Any],
    labels: Mapping[Any, int | None],
    sizes: Mapping[Any, tuple[str, int, int]],
) -> dict[Any, list[_Box]]:
    """Return the boxes of known categories for each image.

    Raises:
        DatasetError: Lists the first invalid annotations.
    """
    boxes: dict[Any, list[_Box]] = {key: [] for key in sizes}
    faults: list[str] = []
    for index, annotation in enumerate(annotations):
        try:
            box = _box(annotation, labels, sizes)
        except DatasetError as error:
            number = annotation.get("id", index) if isinstance(annotation, dict) else index
            faults.append(f"annotation {number}: {error}")
            continue
        if box is not None:
            boxes[annotation["image_id"]].append(box)
    if faults:
        more = f"; and {len(faults) - MAX_LISTED} more" if len(faults) > MAX_LISTED else ""
        raise DatasetError(f"{file}: {'; '.join(faults[:MAX_LISTED])}{more}")
    return boxes


def _box(
    annotation: Any, labels: Mapping[Any, int | None], sizes: Mapping[Any, tuple[str, int, int]]
) -> _Box | None:
    """Return an annotation's box, or None if its category is not among the known ones."""
    if not isinstance(annotation, dict):
        raise DatasetError(f"expected an object, got {annotation!r}")
    if annotation.get("image_id") not in sizes:
        raise DatasetError(f"image_id {annotation.get('image_id')!r} is not among the images")
    if annotation.get("category_id") not in labels:
        raise DatasetError(f"category_id {annotation.get('category_id')!r} is not among the categories")
    label = labels[annotation["category_id"]]
    if label is None:
        return None
    box = annotation.get("bbox")
    if not isinstance(box, list) or len(box) != 4 or not all(_is_number(number) for number in box):
        raise DatasetError(f"bbox: expected [x, y, width, height] in px, got {box!r}")
    x, y, wide, high = (float(number) for number in box)
    if wide <= 0 or high <= 0:
        raise DatasetError(f"bbox: expected a width and a height above 0, got {box!r}")
    _, width_px, height_px = sizes[annotation["image_id"]]
    if x >= width_px or y >= height_px or x + wide <= 0 or y + high <= 0:
        raise DatasetError(f"bbox: {box!r} lies outside its image of {width_px} x {height_px}")
    corners = (max(0.0, x), max(0.0, y), min(float(width_px), x + wide), min(float(height_px), y + high))
    return label, corners, bool(annotation.get("iscrowd", 0))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _truth(boxes: list[_Box], width_px: int, height_px: int) -> GroundTruth:
    corners = np.array([box for _, box, _ in boxes], np.float32).reshape(len(boxes), 4)
    return GroundTruth(
        labels=np.array([label for label, _, _ in boxes], np.int64),
        boxes=corners,
        ignored=too_small(corners, width_px, height_px)
        | np.array([crowd for _, _, crowd in boxes], np.bool_),
    )


def _find(file: Path, name: str) -> Path | None:
    """Return the path of an image; None if it is missing.

    Raises:
        DatasetError: It is a link to a place outside the folder of the annotations.
    """
    for folder in (file.parent, file.parent / "images"):
        path = folder / name
        if _unreadable(path) is not None:
            continue
        if not path.resolve().is_relative_to(file.parent.resolve()):
            raise DatasetError(
                f"{file}: {name}: expected a file in the folder of the annotations, got a link to {path.resolve()}"
            )
        return path
    return None


def sample_evenly(pictures: Sequence[CocoPicture], count: int) -> list[CocoPicture]:
    """Return `count` images spread evenly over a data set, or all of them if it has fewer."""
    if count >= len(pictures):
        return list(pictures)
    return [pictures[index * len(pictures) // count] for index in range(count)]


def check_sample(data: CocoDataset, count: int, labels: Collection[int] | None) -> None:
    """Check that a detector can be evaluated on the images selected from a data set.

    Args:
        data: The data set.
        count: Number of images to use.
        labels: The labels that the detector may give; None if they are unknown.

    Raises:
        DatasetError: An image cannot be read or has another size than stated, no box counts, or none of those that
            count has a label that the detector gives.
    """
    chosen = sample_evenly(data.pictures, count)
    faults = [fault for one in chosen if (fault := _wrong_size(one)) is not None]
    if faults:
        more = f"; and {len(faults) - MAX_LISTED} more" if len(faults) > MAX_LISTED else ""
        raise DatasetError(f"{data.file}: {'; '.join(faults[:MAX_LISTED])}{more}")
    counted = {int(label) for one in chosen for label in one.truth.labels[~one.truth.ignored]}
    if not counted:
        raise DatasetError(
            f"{data.file}: expected boxes that count in the {len(chosen)} images to use, got none: crowds and boxes "
            f"lower than {MIN_HEIGHT_SHARE:.1%} or narrower than {MIN_WIDTH_SHARE:.1%} of the image are ignored"
        )
    if labels is not None and not counted & set(labels):
        found, there = (" and ".join(LABEL_WORDS[one] for one in sorted(some)) for some in (labels, counted))
        raise DatasetError(
            f"{data.file}: the detector only finds {found}, but all boxes that count are {there}"
        )


def _wrong_size(one: CocoPicture) -> str | None:
    """Return how the size of an image differs from the annotations, or why it cannot be read; None if it fits."""
    # Pillow reads the header alone; imported here, because most of what reads this module reads no image.
    from PIL import Image

    try:
        with Image.open(one.file) as opened:
            width_px, height_px = opened.size
            if opened.getexif().get(_ORIENTATION, 1) in _TURNED:
                width_px, height_px = height_px, width_px
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return f"{one.file} cannot be read as an image"
    if (width_px, height_px) == (one.width_px, one.height_px):
        return None
    return (
        f"{one.file}: expected {one.width_px} x {one.height_px} px according to the annotations, got {width_px} x "
        f"{height_px}"
    )


_ORIENTATION: Final = 0x0112
"""Tag of an image's orientation in EXIF."""
_TURNED: Final = (5, 6, 7, 8)
"""Orientations in which width and height change places when the image is shown."""

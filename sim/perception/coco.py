"""Labelled pictures in COCO format: read, checked, never half-used.

Boxes of the categories that the detectors know are kept, `person` and what is a vehicle; other categories are left
out. Crowds, and boxes too small to ask for, are ignored, as in the evaluation of COCO itself.

Source: the COCO data format, https://cocodataset.org/#format-data.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from brink.sim.perception.errors import DatasetError
from brink.sim.perception.plain_files import not_plain
from brink.sim.perception.quality import Truth

LABELS: Final[Mapping[str, int]] = {
    "vehicle": 0, "car": 0, "truck": 0, "bus": 0, "van": 0, "motorcycle": 0, "train": 0,
    "person": 1, "pedestrian": 1,
}  # fmt: skip
"""Which label each category is: 0 for a vehicle, 1 for a person."""
MIN_SHARE: Final = 8.0 / 360.0
"""Boxes lower than this share of the picture's height are ignored."""
SHOWN: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CocoPicture:
    """One picture of a data set.

    Attributes:
        file: Where it is.
        width_px: As the annotations say.
        height_px: As the annotations say.
        truth: What is in it, in its pixels.
    """

    file: Path
    width_px: int
    height_px: int
    truth: Truth


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CocoDataset:
    """A data set.

    Attributes:
        file: Its annotations.
        digest: Of the annotations, 16 hexadecimal digits.
        pictures: In the order of the file; those without any box are kept.
    """

    file: Path
    digest: str
    pictures: tuple[CocoPicture, ...]


def read_coco(file: Path) -> CocoDataset:
    """Read a data set; nothing is read twice while the file stays as it is.

    Args:
        file: Annotations, a JSON file. Pictures are looked for beside it and in ``images`` beside it.

    Raises:
        DatasetError: It is no such file, a box is broken, or a picture is missing; the message says which.
    """
    try:
        stat = file.stat()
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file}: {getattr(error, 'strerror', None) or error}") from None
    if wrong := not_plain(file):
        raise DatasetError(f"{file}: {wrong}; it should be JSON in COCO format")
    return _read(file, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=4)
def _read(file: Path, _changed: int, _size: int) -> CocoDataset:
    try:
        raw = file.read_bytes()
        document = json.loads(raw)
    except OSError as error:
        raise DatasetError(f"{file}: {error.strerror or error}") from None
    except ValueError as error:
        raise DatasetError(f"{file}: not JSON: {error}") from None
    except RecursionError:
        raise DatasetError(f"{file}: not JSON that is read: nested too deeply") from None
    try:
        images, annotations, categories = (
            _rows(document, name) for name in ("images", "annotations", "categories")
        )
        labels = {row["id"]: LABELS.get(str(row["name"]).lower()) for row in categories}
        sizes = {row["id"]: _image(row) for row in images}
    except (DatasetError, KeyError, TypeError, ValueError) as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise DatasetError(f"{file}: {what}") from None
    if all(label is None for label in labels.values()):
        raise DatasetError(f"{file}: expected a category named one of {', '.join(LABELS)}")
    boxes: dict[Any, list[tuple[int, tuple[float, float, float, float], bool]]] = {key: [] for key in sizes}
    broken: list[str] = []
    for place, annotation in enumerate(annotations):
        try:
            kept = _box(annotation, labels, sizes)
        except DatasetError as error:
            broken.append(
                f"annotation {annotation.get('id', place) if isinstance(annotation, dict) else place}: {error}"
            )
            continue
        if kept is not None:
            boxes[annotation["image_id"]].append(kept)
    if broken:
        more = f"; and {len(broken) - SHOWN} more" if len(broken) > SHOWN else ""
        raise DatasetError(f"{file}: {'; '.join(broken[:SHOWN])}{more}")
    found = {key: _find(file, name) for key, (name, _, _) in sizes.items()}
    missing = [name for key, (name, _, _) in sizes.items() if found[key] is None]
    if missing:
        more = f" and {len(missing) - SHOWN} more" if len(missing) > SHOWN else ""
        raise DatasetError(
            f"{file}: pictures not found beside it or in images/: {', '.join(missing[:SHOWN])}{more}"
        )
    pictures = tuple(
        CocoPicture(
            file=path,
            width_px=sizes[key][1],
            height_px=sizes[key][2],
            truth=_truth(boxes[key], sizes[key][2]),
        )
        for key, path in found.items()
        if path is not None
    )
    if not any(len(picture.truth.labels) for picture in pictures):
        raise DatasetError(f"{file}: no box of a category named one of {', '.join(LABELS)}")
    return CocoDataset(file=file, digest=hashlib.sha256(raw).hexdigest()[:16], pictures=pictures)


def _rows(document: object, name: str) -> list[Any]:
    rows = document.get(name) if isinstance(document, dict) else None
    if not isinstance(rows, list) or not rows:
        raise DatasetError(f"expected a list of {name} that is not empty, as COCO has it")
    return rows


def _image(row: Any) -> tuple[str, int, int]:
    width_px, height_px = row["width"], row["height"]
    if not (isinstance(width_px, int) and isinstance(height_px, int) and width_px > 0 and height_px > 0):
        raise DatasetError(
            f"image {row.get('id')!r}: expected width and height in px, got {width_px!r}, {height_px!r}"
        )
    return str(row["file_name"]), width_px, height_px


def _box(
    annotation: Any, labels: Mapping[Any, int | None], sizes: Mapping[Any, tuple[str, int, int]]
) -> tuple[int, tuple[float, float, float, float], bool] | None:
    """Return label, box and whether it is a crowd; None if its category is none that detectors know."""
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
        raise DatasetError(f"bbox: {box!r} lies outside of its picture of {width_px} x {height_px}")
    corners = (max(0.0, x), max(0.0, y), min(float(width_px), x + wide), min(float(height_px), y + high))
    return label, corners, bool(annotation.get("iscrowd", 0))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _truth(boxes: list[tuple[int, tuple[float, float, float, float], bool]], height_px: int) -> Truth:
    corners = np.array([box for _, box, _ in boxes], np.float32).reshape(len(boxes), 4)
    low = (corners[:, 3] - corners[:, 1]) < MIN_SHARE * height_px
    return Truth(
        labels=np.array([label for label, _, _ in boxes], np.int64),
        boxes=corners,
        ignored=low | np.array([crowd for _, _, crowd in boxes], np.bool_),
    )


def _find(file: Path, name: str) -> Path | None:
    for folder in (file.parent, file.parent / "images"):
        if not_plain(folder / name) is None:
            return folder / name
    return None

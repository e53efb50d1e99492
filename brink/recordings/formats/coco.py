"""Recordings as a data set in COCO format, whose images have a sequence and a time, and COCO's format of results."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from brink.recordings.camera import is_number
from brink.recordings.files import first_bytes, read_json
from brink.recordings.format import Format, RecordingBuilder, assumed_camera, target_of
from brink.recordings.recording import (
    ClassMeaning,
    Detection,
    ReadOptions,
    RecordedDrive,
    Recording,
    RecordingError,
    RoadUser,
    Sides,
)

_IDS: Final = ("id", "image_id", "category_id")
_RESULT: Final = ("image_id", "category_id", "bbox", "score")


@dataclass(frozen=True, slots=True, kw_only=True)
class _CocoImage:
    drive: RecordedDrive
    time_s: float


def _recognises(detections: Path, truth: Path | None) -> bool:
    return (
        truth is not None
        and first_bytes(detections).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"[")
        and first_bytes(truth).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")
    )


def read(detections: Path, truth: Path | None, options: ReadOptions) -> Recording:
    """Read a recording from a data set and results.

    Args:
        detections: A list of ``image_id``, ``category_id``, ``bbox`` and ``score``.
        truth: The data set. Images have ``video_id`` (or ``sequence``) and either ``time_s`` or ``frame_id`` (or
            ``frame_index``), and optionally ``condition``. Annotations have ``track_id``, and optionally ``iscrowd``,
            ``occlusion``, ``visible_share``, ``truncation``, ``distance_m``, ``lateral_m`` and ``target``.
        options: The user's settings for the recording.

    Raises:
        RecordingError: A file is missing or cannot be used.
    """
    if truth is None:
        raise RecordingError(
            f"{detections}: expected {FORMAT.expects}; say where the data set is with --truth"
        )
    document, results = read_json(truth), read_json(detections)
    if not isinstance(document, dict) or not isinstance(results, list):
        raise RecordingError(
            f"expected a data set with images and annotations in {truth}, and a list of results in {detections}"
        )
    builder = RecordingBuilder(detections.stem, options)
    categories = _categories(truth, document, options)
    images = _add_images(truth, document, builder)
    _add_annotations(truth, document, images, categories, builder)
    _add_results(detections, results, images, categories, builder)
    return builder.recording


def _categories(path: Path, document: Mapping[str, Any], options: ReadOptions) -> dict[Any, str]:
    """Return the names of all categories."""
    names = {one["id"]: str(one["name"]) for _, one in _objects(path, document, "categories", ("id", "name"))}
    meant = [name for name, meaning in options.classes.items() if meaning is not ClassMeaning.IGNORE]
    if not any(name.strip().lower() in meant for name in names.values()):
        raise RecordingError(
            f"{path}: expected one of the categories {', '.join(meant)}; got "
            f"{', '.join(names.values())[:200] or 'none'} (say what they mean with --classes NAME=vehicle or =person)"
        )
    return names


def _add_images(path: Path, document: Mapping[str, Any], builder: RecordingBuilder) -> dict[Any, _CocoImage]:
    images: dict[Any, _CocoImage] = {}
    for where, image in _objects(path, document, "images", ("id", "width", "height")):
        name = image.get("video_id", image.get("sequence"))
        if not isinstance(name, int | str) or isinstance(name, bool) or name == "":
            raise RecordingError(f"{where}: expected video_id or sequence, so that images have an order")
        size_px = _positive(where, image, "width"), _positive(where, image, "height")
        drive = builder.drive(str(name), assumed_camera(*size_px))
        builder.check_size(where, drive, *size_px)
        builder.set_condition(where, drive, image.get("condition"))
        time_s = _time_of(where, image, builder.options.frames_per_s)
        builder.add_image(where, drive, time_s)
        if image["id"] in images:
            raise RecordingError(f"{where}: expected each id of an image once, got {image['id']!r:.80} twice")
        images[image["id"]] = _CocoImage(drive=drive, time_s=time_s)
    builder.note_assumed_camera(path)
    return images


def _add_annotations(
    path: Path,
    document: Mapping[str, Any],
    images: Mapping[Any, _CocoImage],
    categories: Mapping[Any, str],
    builder: RecordingBuilder,
) -> None:
    for where, one in _objects(path, document, "annotations", ("image_id", "category_id", "bbox")):
        image = _image_of(where, one, images)
        name = _category_of(where, one, categories)
        sides = _sides(where, one["bbox"])
        if one.get("iscrowd"):
            builder.add_region(where, image.drive, image.time_s, sides)
            continue
        if name.strip().lower() not in builder.options.classes:
            builder.recording.dropped[f"true boxes of the class {name:.40}"] += 1
            continue
        label = builder.label(where, name)
        if label is None:
            builder.add_region(where, image.drive, image.time_s, sides)
            continue
        if not isinstance(one.get("track_id"), int | str):
            raise RecordingError(f"{where}: track_id is missing: without it, nothing has a duration")
        occlusion = _optional(where, one, "occlusion")
        if occlusion is not None and occlusion not in range(4):
            raise RecordingError(f"{where}: occlusion: expected 0, 1, 2 or 3, got {occlusion:g}")
        road_user = RoadUser(
            track=str(one["track_id"]),
            label=label,
            sides=sides,
            target=target_of(where, one.get("target")),
            distance_m=_optional(where, one, "distance_m"),
            left_m=_optional(where, one, "lateral_m"),
            occlusion=None if occlusion is None else int(occlusion),
            visible_share=_optional(where, one, "visible_share"),
            truncation=_optional(where, one, "truncation"),
        )
        builder.add_road_user(where, image.drive, image.time_s, road_user)


def _add_results(
    path: Path,
    results: Sequence[Any],
    images: Mapping[Any, _CocoImage],
    categories: Mapping[Any, str],
    builder: RecordingBuilder,
) -> None:
    for place, one in enumerate(results):
        where = f"{path}: result {place}"
        if not isinstance(one, dict) or any(name not in one for name in _RESULT):
            raise RecordingError(f"{where}: expected image_id, category_id, bbox and score, got {one!r:.80}")
        _check_ids(where, one)
        image = _image_of(where, one, images)
        name = _category_of(where, one, categories)
        score = _optional(where, one, "score")
        if score is None:
            raise RecordingError(f"{where}: score: expected a number, got None")
        if name.strip().lower() not in builder.options.classes:
            builder.recording.dropped[f"detections of the class {name:.40}"] += 1
            continue
        label = builder.label(where, name)
        if label is None:
            builder.drop_detection(where, name)
            continue
        detection = Detection(
            label=label,
            sides=_sides(where, one["bbox"]),
            score=score,
            distance_m=_optional(where, one, "distance_m"),
            left_m=_optional(where, one, "lateral_m"),
        )
        builder.add_detection(where, image.drive, image.time_s, detection)


def _objects(
    path: Path, document: Mapping[str, Any], name: str, fields: Sequence[str]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the position of each object of a list, and the object."""
    items = document.get(name)
    if not isinstance(items, list):
        raise RecordingError(f"{path}: {name}: expected a list, got {items!r:.80}")
    for place, item in enumerate(items):
        where = f"{path}: {name}[{place}]"
        missing = [one for one in fields if not isinstance(item, dict) or one not in item]
        if missing:
            raise RecordingError(f"{where}: missing {', '.join(missing)}")
        _check_ids(where, item)
        yield where, item


def _check_ids(where: str, item: Mapping[str, Any]) -> None:
    for name in _IDS:
        if name in item and not isinstance(item[name], int | str):
            raise RecordingError(f"{where}: {name}: expected an id, got {item[name]!r:.80}")


def _image_of(where: str, item: Mapping[str, Any], images: Mapping[Any, _CocoImage]) -> _CocoImage:
    image = images.get(item["image_id"])
    if image is None:
        raise RecordingError(f"{where}: expected the id of an image, got {item['image_id']!r:.80}")
    return image


def _category_of(where: str, item: Mapping[str, Any], categories: Mapping[Any, str]) -> str:
    name = categories.get(item["category_id"])
    if name is None:
        raise RecordingError(f"{where}: expected the id of a category, got {item['category_id']!r:.80}")
    return name


def _time_of(where: str, image: Mapping[str, Any], frames_per_s: float | None) -> float:
    if is_number(image.get("time_s")):
        return float(image["time_s"])
    frame = image.get("frame_id", image.get("frame_index"))
    if is_number(frame) and frames_per_s:
        return float(frame) / frames_per_s
    raise RecordingError(
        f"{where}: expected time_s, or frame_id and the number of frames per second (--frames-per-s)"
    )


def _positive(where: str, item: Mapping[str, Any], name: str) -> float:
    value = _optional(where, item, name)
    if value is None or value <= 0.0:
        raise RecordingError(f"{where}.{name}: expected a positive number, got {item[name]!r:.80}")
    return value


def _optional(where: str, item: Mapping[str, Any], name: str) -> float | None:
    value = item.get(name)
    if value is None:
        return None
    if not is_number(value):
        raise RecordingError(f"{where}: {name}: expected a number, got {value!r:.80}")
    return float(value)


def _sides(where: str, bbox: Any) -> Sides:
    if not (isinstance(bbox, list) and len(bbox) == 4 and all(map(is_number, bbox))):
        raise RecordingError(f"{where}: bbox: expected x, y, width and height, got {bbox!r:.80}")
    x, y, wide, high = map(float, bbox)
    if wide < 0.0 or high < 0.0:
        raise RecordingError(f"{where}: bbox: expected x, y, width and height, got a negative size: {bbox!r}")
    return Sides(x, x + wide, y, y + high)


FORMAT: Final = Format(
    name="coco",
    title="COCO",
    expects="detections as a file of COCO results (a list of image_id, category_id, bbox and score), and truth as a "
    "COCO data set whose images have video_id and whose annotations have track_id",
    recognises=_recognises,
    read=read,
    classes=dict.fromkeys(
        ("bicycle", "cyclist", "rider", "motorcycle", "motorbike", "train"), ClassMeaning.IGNORE
    ),
)

"""Recordings in COCO format: sequences, results with scores, crowds, and what is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from brink.recordings.reading import read_recording
from brink.recordings.recording import CLASSES, ClassMeaning, ReadOptions, Recording, RecordingError, Sides
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.urban.detection_errors import Target

Json = dict[str, Any]
AT_10 = ReadOptions(frames_per_s=10.0)


def coco(**changes: Any) -> tuple[Json, list[Json]]:
    """Return a data set of one sequence of 5 images, with a car in each but the last, and results."""
    bbox = [380.0, 300.0, 40.0, 30.0]
    images = [{"id": i, "width": 960, "height": 540, "video_id": 4, "frame_id": i} for i in range(5)]
    notes = [{"id": i, "image_id": i, "category_id": 3, "track_id": 7, "bbox": bbox} for i in range(4)]
    categories = [{"id": 3, "name": "car"}, {"id": 9, "name": "traffic light"}]
    results = [{"image_id": i, "category_id": 3, "bbox": bbox, "score": 0.2 * i} for i in range(5)]
    return {"images": images, "annotations": notes, "categories": categories, **changes}, results


def read(folder: Path, document: Any, results: Any, options: ReadOptions = AT_10) -> Recording:
    files = folder / "truth.json", folder / "results.json"
    for file, content in zip(files, (document, results), strict=True):
        file.write_text(json.dumps(content))
    return read_recording(files[1], files[0], options=options)


def test_sequences_become_drives_and_results_keep_their_scores(tmp_path: Path) -> None:
    recording = read(tmp_path, *coco())
    assert recording.name == "results"
    (drive,) = recording.drives.values()
    assert (drive.name, drive.condition) == ("4", None)
    assert sorted(drive.images) == [0.0, 0.1, 0.2, 0.3, 0.4]
    image = drive.images[0.2]
    assert [(one.track, one.label, one.sides) for one in image.road_users] == [
        ("7", ObstacleLabel.VEHICLE, Sides(380, 420, 300, 330))
    ]
    assert [one.score for one in image.detections] == [0.4]
    assert (drive.images[0.4].road_users, len(drive.images[0.4].detections)) == ([], 1)
    assert drive.camera is not None
    assert drive.camera.width_px == 960.0
    assert drive.camera.fx_px == pytest.approx(480.0)
    assert any("does not say which camera" in note for note in recording.notes)


def test_crowds_are_regions_and_annotations_say_more(tmp_path: Path) -> None:
    document, results = coco()
    document["annotations"][0] |= {"occlusion": 1, "visible_share": 0.5, "truncation": 0.1}
    document["annotations"][0] |= {"distance_m": 20, "lateral_m": -3.5, "target": "oncoming"}
    crowd = {"image_id": 0, "category_id": 3, "iscrowd": 1, "bbox": [0, 0, 100, 100]}
    document["annotations"].append(crowd)
    document["images"] = [
        {**image, "time_s": 3.0 + image["id"], "condition": "day, dry"} for image in document["images"]
    ]
    drive = read(tmp_path, document, results).drives["4"]
    assert drive.condition == "day, dry"
    image = drive.images[3.0]
    (car,) = image.road_users
    assert (car.occlusion, car.visible_share, car.truncation) == (1, 0.5, 0.1)
    assert (car.distance_m, car.left_m, car.target) == (20.0, -3.5, Target.ONCOMING)
    assert image.ignored == [Sides(0, 100, 0, 100)]


def test_boxes_of_other_classes_are_counted_and_bicycles_are_regions(tmp_path: Path) -> None:
    document, results = coco()
    document["categories"] += [{"id": 10, "name": "Bicycle"}]
    document["annotations"] += [{"image_id": 0, "category_id": key, "bbox": [1, 1, 9, 9]} for key in (9, 10)]
    results += [{**results[0], "category_id": key} for key in (9, 9, 10)]
    recording = read(tmp_path, document, results)
    assert recording.dropped == {
        "true boxes of the class traffic light": 1,
        "detections of the class traffic light": 2,
        "detections of the class bicycle, which is ignored": 1,
    }
    image = recording.drives["4"].images[0.0]
    assert (len(image.road_users), len(image.detections), len(image.ignored)) == (1, 1, 1)
    classes = {**CLASSES, "bicycle": ClassMeaning.PERSON}
    document["annotations"][-1]["track_id"] = 8
    image = (
        read(tmp_path, document, results, ReadOptions(frames_per_s=10.0, classes=classes))
        .drives["4"]
        .images[0]
    )
    assert [one.label for one in image.road_users] == [ObstacleLabel.VEHICLE, ObstacleLabel.PERSON]


def test_boxes_without_size_are_dropped_and_those_beyond_the_image_refused(tmp_path: Path) -> None:
    document, results = coco()
    results[0]["bbox"] = [1, 2, 0, 4]
    assert read(tmp_path, document, results).dropped == {"boxes without width or height": 1}
    results[0]["bbox"] = [900, 2, 90, 4]
    with pytest.raises(
        RecordingError, match=r"result 0: the box 900 to 990.* beyond the image of 960 x 540 px"
    ):
        read(tmp_path, document, results)


def without(item: Json, name: str) -> Json:
    return {key: value for key, value in item.items() if key != name}


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d, r: ({**d, "images": 3}, r), "images: expected a list"),
        (lambda d, r: ({**d, "images": [{"id": 1}]}, r), r"images\[0\]: missing width, height"),
        (
            lambda d, r: ({**d, "images": [without(d["images"][0], "video_id")]}, r),
            "expected video_id or sequence",
        ),
        (
            lambda d, r: ({**d, "images": [{**d["images"][0], "width": -1}]}, r),
            r"images\[0\].width: expected a pos",
        ),
        (lambda d, r: ({**d, "images": [d["images"][0]] * 2}, r), "each id of an image once, got 0 twice"),
        (
            lambda d, r: ({**d, "images": [d["images"][0], {**d["images"][1], "width": 9}]}, r),
            "the images of drive 4 are 9 x 540 px, but those of its camera 960 x 540 px",
        ),
        (
            lambda d, r: ({**d, "annotations": [without(d["annotations"][0], "track_id")]}, r),
            "track_id is missing",
        ),
        (lambda d, r: ({**d, "annotations": d["annotations"][:1] * 2}, r), "id '7' occurs twice at 0 s"),
        (lambda d, r: ({**d, "categories": [{"id": 3, "name": "tree"}]}, r), "one of the categories vehicle"),
        (lambda d, r: (d, [{**r[0], "image_id": 5000}]), "expected the id of an image, got 5000"),
        (lambda d, r: (d, [{**r[0], "category_id": 5000}]), "expected the id of a category, got 5000"),
        (lambda d, r: (d, [{**r[0], "bbox": [1, 2, -1, 4]}]), "got a negative size"),
        (lambda d, r: (d, [{**r[0], "bbox": [1, 2, 3]}]), "expected x, y, width and height"),
        (lambda d, r: (d, [{**r[0], "bbox": [1, 2, 3, 10**400]}]), "expected x, y, width and height"),
        (lambda d, r: (d, [{"image_id": 0}]), "expected image_id, category_id, bbox and score"),
        (lambda d, r: (d, [{**r[0], "score": "0.9"}]), "result 0: score: expected a number, got '0.9'"),
        (lambda d, r: (d, [{**r[0], "image_id": [0]}]), "result 0: image_id: expected an id, got"),
        (lambda d, r: (d, [{**r[0], "category_id": {}}]), "result 0: category_id: expected an id, got"),
    ],
)
def test_a_data_set_that_does_not_fit_is_refused(
    tmp_path: Path, spoil: Callable[[Any, Any], tuple[Any, Any]], words: str
) -> None:
    with pytest.raises(RecordingError, match=words):
        read(tmp_path, *spoil(*coco()))


def test_results_that_are_no_list_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"coco: detections as a file of COCO results \(a list of"):
        read(tmp_path, coco()[0], {})
    with pytest.raises(RecordingError, match="a list of results"):
        read_recording(tmp_path / "results.json", tmp_path / "truth.json", format="coco")
    with pytest.raises(RecordingError, match="say where the data set is with --truth"):
        read_recording(tmp_path / "results.json", format="coco")
    (tmp_path / "truth.json").write_text("{")
    with pytest.raises(RecordingError, match=r"truth\.json: expected JSON"):
        read_recording(tmp_path / "results.json", tmp_path / "truth.json", format="coco")


def test_images_need_times_or_a_frame_rate(tmp_path: Path) -> None:
    with pytest.raises(
        RecordingError, match="expected time_s, or frame_id and the number of frames per second"
    ):
        read(tmp_path, *coco(), ReadOptions())

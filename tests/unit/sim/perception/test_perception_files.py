"""Detectors and labelled data in users' files, and the inputs that are refused."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from brink.sim.errors import InvalidEpisode
from brink.sim.perception.detector import NetworkDetector, find_detector, fit_picture
from brink.sim.perception.user_files import DatasetError, DetectorError, read_coco, weights_file

BRIGHT = np.zeros((180, 320, 3), np.uint8)
BRIGHT[40:120, 100:140] = 255


DOCUMENT: dict[str, Any] = {
    "images": [
        {"id": 7, "file_name": "a.png", "width": 320, "height": 180},
        {"id": 8, "file_name": "b.png", "width": 320, "height": 180},
    ],
    "annotations": [
        {"id": 1, "image_id": 7, "category_id": 1, "bbox": [10, 20, 30, 60]},
        {"id": 2, "image_id": 7, "category_id": 3, "bbox": [100, 20, 300, 60], "iscrowd": 0},
        {"id": 3, "image_id": 8, "category_id": 9, "bbox": [0, 0, 5, 5]},
        {"id": 4, "image_id": 8, "category_id": 3, "bbox": [0, 0, 50, 3]},
    ],
    "categories": [{"id": 1, "name": "person"}, {"id": 3, "name": "car"}, {"id": 9, "name": "kite"}],
}  # fmt: skip


def written(folder: Path, **changes: Any) -> Path:
    for name in ("a.png", "images/b.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(folder / name), BRIGHT)
    file = folder / "labels.json"
    file.write_text(json.dumps({**DOCUMENT, **changes}))
    return file


def test_boxes_of_known_categories_are_kept_and_cropped_to_the_picture(tmp_path: Path) -> None:
    data = read_coco(written(tmp_path))
    first, second = data.pictures
    assert first.truth.labels.tolist() == [1, 0]
    assert first.truth.boxes.tolist() == [[10, 20, 40, 80], [100, 20, 320, 80]]
    assert first.truth.ignored.tolist() == [False, False]
    assert second.truth.ignored.tolist() == [True], "3 px high"
    assert second.file == tmp_path / "images" / "b.png"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"images": []}, "non-empty list of images"),
        ({"annotations": None}, "list of annotations"),
        ({"categories": [{"id": 9, "name": "kite"}]}, "category with one of the names vehicle, car"),
        ({"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [1, 2, 3]}]}, "annotation 5: bbox: exp"),
        ({"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [1, 2, 0, 3]}]}, "above 0"),
        ({"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [999, 2, 5, 3]}]}, "outside its"),
        ({"annotations": [{"id": 5, "image_id": 6, "category_id": 1, "bbox": [1, 2, 5, 3]}]}, "image_id 6"),
        ({"images": [{"id": 7, "file_name": "a.png", "width": "320", "height": 180}]}, "width and height"),
        ({"images": [{"id": 7, "width": 320, "height": 180}]}, "'file_name' is missing"),
        ({"annotations": [{"id": 3, "image_id": 8, "category_id": 9, "bbox": [0, 0, 5, 5]}]}, "no box belongs"),
    ],
)  # fmt: skip
def test_invalid_file_names_its_first_faults(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        read_coco(written(tmp_path, **changes))


@pytest.mark.parametrize(
    "name",
    ["\0", "x" * 5000, "/proc/kmsg", "/proc/self/mem", "/dev/zero", "/dev/null", "/sys/kernel/notes", "ring"],
)
def test_only_plain_files_are_read(tmp_path: Path, name: str) -> None:
    (tmp_path / "ring").symlink_to(tmp_path / "ring")
    (tmp_path / "link").symlink_to("/proc/kmsg")
    for given in (str(tmp_path / name), str(tmp_path / "link")):
        with pytest.raises(DatasetError):
            read_coco(Path(given))
        with pytest.raises(DetectorError):
            weights_file(f"onnx:{given}")


def test_deeply_nested_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(DatasetError, match="nested too deeply"):
        read_coco(tmp_path / "deep.json")


def test_missing_pictures_are_listed(tmp_path: Path) -> None:
    file = written(tmp_path)
    (tmp_path / "a.png").unlink()
    with pytest.raises(DatasetError, match=r"not found .*: a\.png"):
        read_coco(file)
    with pytest.raises(DatasetError, match="No such file"):
        read_coco(tmp_path / "none.json")
    (tmp_path / "text.json").write_text("{")
    with pytest.raises(DatasetError, match="not JSON"):
        read_coco(tmp_path / "text.json")


def test_pictures_keep_their_aspect_ratio() -> None:
    canvas, scale = fit_picture(np.full((360, 640, 3), 200, np.uint8))
    assert (canvas.shape, scale) == ((192, 320, 3), 0.5)
    assert (canvas[:180] == 200).all()
    assert (canvas[180:] != 200).all()


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((360, 640), np.uint8), np.zeros((360, 640, 4), np.uint8), np.zeros((360, 640, 3), np.float32),
        np.zeros((0, 640, 3), np.uint8),
    ],
)  # fmt: skip
def test_arrays_other_than_rgb_pictures_are_refused(picture: NDArray[np.uint8]) -> None:
    with pytest.raises(DetectorError, match=r"expected uint8 of shape \(h, w, 3\), got"):
        fit_picture(picture)


def test_weights_that_cannot_be_loaded_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DetectorError, match="cannot be loaded"):
        NetworkDetector(tmp_path / "missing.onnx")
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"not a network")
    with pytest.raises(DetectorError, match="cannot be loaded"):
        NetworkDetector(broken)


def test_an_unknown_detector_gets_a_suggestion() -> None:
    with pytest.raises(InvalidEpisode, match="did you mean 'brink-det@1'"):
        find_detector("brink-dot@1")

"""Detectors and labelled data in users' files, and the inputs that are refused."""

import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from support.onnx_file import write_network

from brink.sim.errors import InvalidEpisode
from brink.sim.perception.boxes import Detections
from brink.sim.perception.detector import (
    CheckedDetector,
    FileDetector,
    NetworkDetector,
    find_detector,
    fit_picture,
    load_file_detector,
)
from brink.sim.perception.user_files import (
    DatasetError,
    DetectorError,
    InvalidDetections,
    check_loads,
    check_sample,
    read_coco,
    weights_digest,
    weights_file,
)

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
}


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
        (
            {"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [1, 2, 3]}]},
            "annotation 5: bbox: exp",
        ),
        ({"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [1, 2, 0, 3]}]}, "above 0"),
        (
            {"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [999, 2, 5, 3]}]},
            "outside its",
        ),
        ({"annotations": [{"id": 5, "image_id": 6, "category_id": 1, "bbox": [1, 2, 5, 3]}]}, "image_id 6"),
        ({"images": [{"id": 7, "file_name": "a.png", "width": "320", "height": 180}]}, "width and height"),
        ({"images": [{"id": 7, "width": 320, "height": 180}]}, "'file_name' is missing"),
        (
            {"annotations": [{"id": 3, "image_id": 8, "category_id": 9, "bbox": [0, 0, 5, 5]}]},
            "no box belongs",
        ),
    ],
)
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


@pytest.mark.parametrize("name", ["../a.png", "images/../../a.png", "/etc/hostname", "images/../a.png"])
def test_pictures_elsewhere_are_refused(tmp_path: Path, name: str) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), BRIGHT)
    folder = tmp_path / "data"
    folder.mkdir()
    images = [{"id": 7, "file_name": name, "width": 320, "height": 180}, DOCUMENT["images"][1]]
    with pytest.raises(
        DatasetError, match=f"image 7: file_name: expected a path in the folder .*, got '{name}'"
    ):
        read_coco(written(folder, images=images))


def test_links_out_of_the_folder_are_refused_and_links_within_it_are_not(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    file = written(folder)
    (folder / "b.png").symlink_to(folder / "a.png")
    assert len(read_coco(file).pictures) == 2
    (folder / "a.png").rename(tmp_path / "a.png")
    (folder / "a.png").symlink_to(tmp_path / "a.png")
    file.write_text(file.read_text() + "\n")
    with pytest.raises(
        DatasetError, match=r"a\.png: expected a file in the folder .*, got a link to .*a\.png"
    ):
        read_coco(file)
    (folder / "a.png").unlink()
    (tmp_path / "all").mkdir()
    (tmp_path / "a.png").rename(tmp_path / "all" / "a.png")
    (folder / "sub").symlink_to(tmp_path / "all")
    images = [{**DOCUMENT["images"][0], "file_name": "sub/a.png"}, DOCUMENT["images"][1]]
    file.write_text(json.dumps({**DOCUMENT, "images": images}))
    with pytest.raises(DatasetError, match="got a link to"):
        read_coco(file)


def test_images_that_will_be_used_are_checked(tmp_path: Path) -> None:
    data = read_coco(written(tmp_path))
    check_sample(data, 10, {0, 1})
    check_sample(data, 10, {1})
    cv2.imwrite(str(tmp_path / "a.png"), BRIGHT[:, :300])
    with pytest.raises(DatasetError, match=r"a\.png: expected 320 x 180 px according to .*, got 300 x 180"):
        check_sample(data, 10, None)
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(DatasetError, match=r"a\.png cannot be read as an image"):
        check_sample(data, 10, None)


def test_an_image_that_lies_on_its_side_has_the_size_that_is_shown(tmp_path: Path) -> None:
    data = read_coco(written(tmp_path))
    turned = Image.fromarray(np.ascontiguousarray(BRIGHT.transpose(1, 0, 2)))
    exif = Image.Exif()
    exif[0x0112] = 6
    turned.save(tmp_path / "a.png", exif=exif)
    shown = cv2.imread(str(tmp_path / "a.png"))
    assert shown is not None
    assert shown.shape == (180, 320, 3), "as the evaluator reads it"
    check_sample(data, 10, None)


def test_a_detector_of_other_classes_than_the_boxes_is_refused(tmp_path: Path) -> None:
    person = [DOCUMENT["annotations"][0]]
    data = read_coco(written(tmp_path, annotations=person))
    check_sample(data, 10, None)
    with pytest.raises(
        DatasetError, match="the detector only finds vehicles, but all boxes that count are persons"
    ):
        check_sample(data, 10, {0})
    crowd = [{**person[0], "iscrowd": 1}]
    with pytest.raises(DatasetError, match="expected boxes that count in the 2 images to use, got none"):
        check_sample(read_coco(written(tmp_path, annotations=crowd)), 10, {1})


def yolo(classes: int, boxes: int = 3) -> NDArray[np.float32]:
    return np.ones((1, 4 + classes, boxes), np.float32)


def test_a_network_is_loaded_and_says_what_it_finds(tmp_path: Path) -> None:
    detector = load_file_detector(write_network(tmp_path / "two.onnx", yolo(2), input_px=(320, 192)))
    assert detector.labels == {0, 1}
    assert len(detector.detect(BRIGHT).labels) > 0
    name = write_network(tmp_path / "one.onnx", yolo(2), metadata={"names": "{0: 'person', 1: 'dog'}"})
    assert check_loads(name) == frozenset({1})
    (tmp_path / "one.onnx.json").write_text('{"names": ["cat", "truck"]}')
    assert check_loads(name) == frozenset({0}), "what is said of it has changed"


def test_a_file_that_has_changed_is_loaded_again(tmp_path: Path) -> None:
    name = write_network(tmp_path / "net.onnx", yolo(2, boxes=3), input_px=(320, 192))
    first = load_file_detector(name)
    assert load_file_detector(name) is first
    write_network(tmp_path / "net.onnx", yolo(80), input_px=(320, 192))
    assert load_file_detector(name) is not first
    before = weights_digest(name)
    (tmp_path / "net.onnx.json").write_text(json.dumps({"names": ["truck", *["cat"] * 79]}))
    assert weights_digest(name) != before, "class names decide what is detected"
    assert load_file_detector(name).labels == {0}


@pytest.mark.parametrize("said", ["json", "imgsz"])
def test_the_size_of_a_network_is_stated_if_it_is_not_fixed(tmp_path: Path, said: str) -> None:
    file = tmp_path / "net.onnx"
    metadata = {"imgsz": "[192, 320]"} if said == "imgsz" else {}
    name = write_network(file, yolo(2), needs_px=(320, 192), metadata=metadata)
    if said == "json":
        with pytest.raises(
            DetectorError, match=r"cannot process an image of 640 x 384 px: .*net\.onnx\.json"
        ):
            check_loads(name)
        (tmp_path / "net.onnx.json").write_text('{"input_px": [320, 192]}')
    assert check_loads(name) == frozenset({0, 1})


@pytest.mark.parametrize(
    ("output", "options", "beside", "message"),
    [
        (yolo(2), {"input_px": (320, 192), "needs_px": (640, 384)}, "", "cannot be loaded as an ONNX"),
        (yolo(2), {"input_px": (320, 192)}, '{"input_px": [640, 384]}', "takes images of 320 x 192 px, but"),
        (yolo(2), {}, '{"input_px": [640]}', r"input_px: expected \[width, height\] in px, got \[640\]"),
        (
            yolo(2),
            {},
            '{"names": ["person"]}',
            r"expected an output \(1, 5, n\): .* classes person; got shape",
        ),
        (yolo(3), {}, "", r"\(1, 6, n\) of vehicle and person or \(1, 84, n\) .*, got shape \(1, 7, 3\)"),
        (np.ones((1, 8400, 84), np.float32), {}, "", r"got shape \(1, 8400, 84\)"),
        (
            yolo(2),
            {"metadata": {"names": "['cat', 'dog']"}},
            "",
            "at least one of the classes .*; got cat, dog",
        ),
        (
            np.ones((1, 1000), np.float32),
            {},
            "",
            r"expected one output .* got outputs of shapes \[\(1, 1000\)\]",
        ),
    ],
    ids=["false size", "other size", "no size", "names", "classes", "transposed", "no class", "classifier"],
)
def test_networks_of_another_size_or_kind_are_refused(
    tmp_path: Path, output: NDArray[np.float32], options: dict[str, Any], beside: str, message: str
) -> None:
    name = write_network(tmp_path / "net.onnx", output, **options)
    if beside:
        (tmp_path / "net.onnx.json").write_text(beside)
    with pytest.raises(DetectorError, match=message):
        load_file_detector(name)


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((360, 640), np.uint8),
        np.zeros((360, 640, 4), np.uint8),
        np.zeros((360, 640, 3), np.float32),
        np.zeros((0, 640, 3), np.uint8),
    ],
)
def test_arrays_other_than_rgb_pictures_are_refused(picture: NDArray[np.uint8]) -> None:
    with pytest.raises(DetectorError, match=r"expected uint8 of shape \(h, w, 3\), got"):
        fit_picture(picture, (320, 192))


def test_weights_that_cannot_be_loaded_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DetectorError, match="cannot be loaded"):
        NetworkDetector.from_file(tmp_path / "missing.onnx")
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"not a network")
    with pytest.raises(DetectorError, match="cannot be loaded"):
        NetworkDetector.from_file(broken)


def test_an_unknown_detector_gets_a_suggestion() -> None:
    with pytest.raises(InvalidEpisode, match="did you mean 'brink-det@1'"):
        find_detector("brink-dot@1")


OWN_WEIGHTS = Path(str(files("brink.sim.perception").joinpath("weights/brink-det-1.onnx")))


def test_weights_of_brinks_own_training_are_accepted(tmp_path: Path) -> None:
    file = tmp_path / "mine.onnx"
    file.write_bytes(OWN_WEIGHTS.read_bytes())
    assert check_loads(f"onnx:{file}") == frozenset({0, 1})
    picture = np.random.default_rng(0).integers(0, 256, (180, 320, 3), dtype=np.uint8)
    mine, shipped = (find_detector(name).detect(picture) for name in (f"onnx:{file}", "brink-det@1"))
    np.testing.assert_array_equal(mine.boxes, shipped.boxes)
    np.testing.assert_array_equal(mine.scores, shipped.scores)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("row", "message"), [(0, r"0 of 3 scores and 6 of 12 coor"), (4, r"3 of 3 scores and")]
)
def test_a_network_that_answers_nan_or_infinity_is_refused(
    tmp_path: Path, value: float, row: int, message: str
) -> None:
    output = yolo(2)
    output[0, row] = output[0, 5 if row == 4 else row] = value
    name = write_network(tmp_path / "net.onnx", output, input_px=(320, 192))
    with pytest.raises(
        DetectorError, match=r"net\.onnx: expected finite scores and boxes, got NaN or infinity"
    ) as caught:
        check_loads(name)
    with pytest.raises(InvalidDetections, match=message):
        load_file_detector(name)
    assert "InvalidDetections" not in str(caught.value), "the message stands for itself"


def test_infinite_boxes_without_a_score_do_not_matter(tmp_path: Path) -> None:
    output = yolo(2)
    output[0, 2:4, 0], output[0, 4:, 0] = np.inf, 0.0  # an exponential that overflowed, in the background
    name = write_network(tmp_path / "net.onnx", output, input_px=(320, 192))
    assert np.isfinite(find_detector(name).detect(BRIGHT).boxes).all()


class _ThreeArrays:
    """A network that returns boxes, scores and labels."""

    input_px = (64, 64)
    names: Mapping[int, str] = {}

    def __init__(self, scores: list[float], labels: list[float]) -> None:
        boxes = np.tile(np.array([1.0, 2.0, 30.0, 40.0], np.float32), (len(scores), 1))
        self._outputs = [boxes, np.array(scores, np.float32), np.array(labels, np.float32)]

    def infer(self, planes: NDArray[np.float32]) -> list[NDArray[Any]]:
        """Return the same outputs for any image."""
        return self._outputs


@pytest.mark.parametrize(
    ("scores", "labels", "message"),
    [
        ([0.9, 0.8], [np.nan, 1.0], "expected labels, got NaN or infinity"),
        (
            [2.5, -4.0],
            [1.0, 3.0],
            "expected scores from 0 to 1, got -4 to 2.5; if these are logits, export the",
        ),
        ([-4.0], [1.0], "expected scores from 0 to 1, got -4 to -4"),
    ],
)
def test_labels_that_are_nan_and_scores_that_are_logits_are_refused(
    scores: list[float], labels: list[float], message: str
) -> None:
    assert FileDetector(_ThreeArrays([0.9], [1.0]), "net").detect(BRIGHT).labels.tolist() == [1]
    with pytest.raises(InvalidDetections, match=f"^net: {message}"):
        FileDetector(_ThreeArrays(scores, labels), "net")


class _BrokenSession:
    """The session of a network of `brink-det@1` whose output is NaN somewhere."""

    def __init__(self, session: Any, output: int, value: float) -> None:
        self._session, self._output, self._value = session, output, value

    def run(self, names: None, inputs: dict[str, Any]) -> list[NDArray[np.float32]]:
        """Return the network's outputs, one of them broken."""
        outputs: list[NDArray[np.float32]] = self._session.run(names, inputs)
        outputs[self._output].flat[:: 7 if self._output == 0 else 1] = self._value
        return outputs


@pytest.mark.parametrize("output", [0, 1], ids=["heat", "edges"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_network_of_our_own_kind_that_answers_nan_or_infinity_is_refused(output: int, value: float) -> None:
    detector = NetworkDetector.from_file(OWN_WEIGHTS)
    detector._session = _BrokenSession(detector._session, output, value)
    with pytest.raises(
        InvalidDetections, match=r"brink-det-1\.onnx: expected finite scores and boxes, got NaN"
    ):
        detector.detect(BRIGHT)


def detections(**changes: Any) -> Detections:
    one = {
        "labels": np.array([1]),
        "boxes": np.array([[1.0, 2.0, 3.0, 4.0]], np.float32),
        "scores": np.array([0.5], np.float32),
    }
    return Detections(**{**one, **changes})


class _Answers:
    """A detector from a plug-in that gives a fixed answer."""

    def __init__(self, answer: Any) -> None:
        self._answer = answer

    def detect(self, picture: NDArray[np.uint8]) -> Detections:
        """Return the answer."""
        return self._answer  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (detections(scores=np.array([np.nan], np.float32)), "1 of 1 scores and 0 of 4 coordinates of boxes"),
        (
            detections(boxes=np.array([[1, np.inf, 3, np.nan]], np.float32)),
            "0 of 1 scores and 2 of 4 coordinates",
        ),
        (
            detections(boxes=np.ones((2, 4), np.float32)),
            r"boxes \(n, 4\) and scores \(n,\), got arrays of shapes",
        ),
        (detections(labels=np.array([2])), r"expected labels 0 \(vehicle\) and 1 \(person\), got \[2\]"),
        (None, "expected Detections, got NoneType"),
        (detections(scores=np.array([7.0], np.float32)), "expected scores from 0 to 1, got 7 to 7"),
        (detections(scores=np.array([-3.0], np.float32)), "expected scores from 0 to 1, got -3 to -3"),
        (detections(scores=np.array(["high"])), "expected boxes and scores to be arrays of numbers"),
        (
            detections(boxes=np.array([[3.0, 2.0, 1.0, 4.0]], np.float32)),
            r"expected boxes \(x_min, .* got \[3\.0",
        ),
    ],
    ids=["score", "box", "shape", "label", "nothing", "logit", "negative", "text", "turned"],
)
def test_answers_of_plug_ins_are_checked(answer: Any, message: str) -> None:
    assert CheckedDetector(_Answers(detections()), "mine@1").detect(BRIGHT).labels.tolist() == [1]
    with pytest.raises(InvalidDetections, match=rf"^mine@1: .*{message}"):
        CheckedDetector(_Answers(answer), "mine@1").detect(BRIGHT)

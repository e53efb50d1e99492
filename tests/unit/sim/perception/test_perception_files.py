"""Users' files: networks, labelled pictures in COCO format, and faults in them."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from brink.sim.errors import InvalidEpisode
from brink.sim.perception.detector import find_detector, load_file_detector
from brink.sim.perception.user_files import (
    DatasetError,
    DetectorError,
    check_loads,
    read_coco,
    weights_digest,
    weights_file,
)

BRIGHT = np.zeros((180, 320, 3), np.uint8)
BRIGHT[40:120, 100:140] = 255


class Yolo(nn.Module):
    """Returns (1, 4 + c, 2): a box whose score for one class is the picture's maximum, and an uncertain one."""

    def __init__(self, classes: int, index: int) -> None:
        super().__init__()
        self.register_buffer(
            "boxes", torch.tensor([[60.0, 48.0, 20.0, 40.0], [200.0, 20.0, 8.0, 8.0]]).T[None]
        )
        scores = torch.zeros(1, classes, 2)
        scores[0, index, 0] = 1.0
        scores[0, 0, 1] = 0.0001
        self.register_buffer("scores", scores)

    def forward(self, picture: Tensor) -> Tensor:
        """Return boxes and scores, one array."""
        boxes, scores = self.get_buffer("boxes"), self.get_buffer("scores")
        return torch.cat([boxes, scores * picture.amax()], dim=1)


class Parts(nn.Module):
    """Returns boxes, scores and labels as torchvision does: the bright part is a person (1)."""

    def forward(self, picture: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return three arrays."""
        score = picture.amax()[None]
        return torch.tensor([[50.0, 28.0, 70.0, 68.0]]), score, torch.ones(1, dtype=torch.int64)


class Nonsense(nn.Module):
    """Returns a number."""

    def forward(self, picture: Tensor) -> Tensor:
        """Return the mean."""
        return picture.mean()


def exported(network: nn.Module, file: Path, *, outputs: list[str] | None = None) -> str:
    picture = torch.zeros(1, 3, 96, 160)
    if file.suffix == ".onnx":
        torch.onnx.export(
            network, (picture,), str(file), dynamo=False, opset_version=17, input_names=["images"],
            output_names=outputs or ["output0"],
        )  # fmt: skip
        return f"onnx:{file}"
    torch.jit.trace(network, picture).save(str(file))  # type: ignore[no-untyped-call]
    return f"torchscript:{file}"


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::torch.jit.TracerWarning")
class TestNetworks:
    """Networks in users' files."""

    @pytest.mark.parametrize(("classes", "index", "label"), [(2, 1, 1), (2, 0, 0), (80, 0, 1), (80, 5, 0)])
    def test_yolo_output_is_read(self, tmp_path: Path, classes: int, index: int, label: int) -> None:
        detector = load_file_detector(exported(Yolo(classes, index), tmp_path / "net.onnx"))
        found = detector.detect(BRIGHT)
        # The input is 160 x 96, so pictures of 320 x 180 are halved and get 3 px of padding at the top.
        assert found.labels.tolist() == [label]
        assert found.boxes[0] == pytest.approx([100, 50, 140, 130])
        assert found.scores[0] == pytest.approx(1.0)

    def test_other_classes_are_left_out(self, tmp_path: Path) -> None:
        detector = load_file_detector(exported(Yolo(80, 1), tmp_path / "net.onnx"))
        assert len(detector.detect(BRIGHT).labels) == 0

    def test_names_beside_the_weights_take_precedence(self, tmp_path: Path) -> None:
        name = exported(Yolo(2, 0), tmp_path / "net.onnx")
        (tmp_path / "net.onnx.json").write_text(json.dumps({"names": ["pedestrian", "dog"]}))
        assert load_file_detector(name).detect(BRIGHT).labels.tolist() == [1]
        (tmp_path / "other.onnx.json").write_text(json.dumps({"names": ["cat", "dog"]}))
        with pytest.raises(DetectorError, match="at least one of them"):
            load_file_detector(exported(Yolo(2, 0), tmp_path / "other.onnx"))

    def test_torchvision_output_is_read(self, tmp_path: Path) -> None:
        for name in (
            exported(Parts(), tmp_path / "parts.onnx", outputs=["boxes", "scores", "labels"]),
            exported(Yolo(2, 1), tmp_path / "yolo.pt"),
            exported(Parts(), tmp_path / "parts.pt"),
        ):
            found = find_detector(name).detect(BRIGHT)
            assert found.labels.tolist() == [1]
            assert found.boxes.shape == (1, 4)

    def test_files_that_are_not_detectors_are_refused_on_loading(self, tmp_path: Path) -> None:
        (tmp_path / "text.onnx").write_text("nothing")
        (tmp_path / "text.pt").write_text("nothing")
        for name, message in (
            (f"onnx:{tmp_path}/none.onnx", "no such file"),
            (f"onnx:{tmp_path}/text.onnx", "cannot be loaded as an ONNX network"),
            (f"torchscript:{tmp_path}/text.pt", "cannot be loaded as a TorchScript network"),
            (exported(Nonsense(), tmp_path / "nonsense.onnx"), "expected one output"),
            (exported(Nonsense(), tmp_path / "nonsense.pt"), "expected one output"),
            (f"keras:{tmp_path}/text.pt", "onnx:FILE, torchscript:FILE, ultralytics:FILE"),
        ):
            with pytest.raises(InvalidEpisode, match=message):
                find_detector(name)
        with pytest.raises(DetectorError, match="expected one output"):
            check_loads(f"onnx:{tmp_path}/nonsense.onnx")

    def test_weights_are_identified_by_their_content(self, tmp_path: Path) -> None:
        one = exported(Yolo(2, 1), tmp_path / "one.onnx")
        before = weights_digest(one)
        exported(Yolo(2, 0), tmp_path / "one.onnx")
        assert weights_digest(one) != before
        assert weights_digest("brink-det@1") == ""


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
        ({"categories": [{"id": 9, "name": "kite"}]}, "category named one of vehicle, car"),
        ({"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [1, 2, 3]}]}, "annotation 5: bbox: exp"),
        ({"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [1, 2, 0, 3]}]}, "above 0"),
        ({"annotations": [{"id": 5, "image_id": 7, "category_id": 1, "bbox": [999, 2, 5, 3]}]}, "outside its"),
        ({"annotations": [{"id": 5, "image_id": 6, "category_id": 1, "bbox": [1, 2, 5, 3]}]}, "image_id 6"),
        ({"images": [{"id": 7, "file_name": "a.png", "width": "320", "height": 180}]}, "width and height"),
        ({"images": [{"id": 7, "width": 320, "height": 180}]}, "'file_name' is missing"),
        ({"annotations": [{"id": 3, "image_id": 8, "category_id": 9, "bbox": [0, 0, 5, 5]}]}, "no box belongs"),
    ],
)  # fmt: skip
def test_an_invalid_file_is_refused_with_its_first_faults(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
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

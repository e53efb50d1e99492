"""Weights for Ultralytics, which is not a dependency (AGPL): these tests run where it happens to be installed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from brink.sim.perception.detector import UltralyticsDetector, find_detector
from brink.sim.perception.user_files import DetectorError, InvalidDetections

pytestmark = pytest.mark.long("needs ultralytics")
ultralytics: Any = pytest.importorskip("ultralytics")
torch: Any = pytest.importorskip("torch")


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """Random weights of a small network with 80 classes, of which the first is a person and the third a car."""
    torch.manual_seed(0)
    file = tmp_path / "net.pt"
    model = ultralytics.YOLO("yolov8n.yaml")
    model.model.names = {**model.model.names, 0: "person", 2: "car"}
    model.save(str(file))
    return file


def street(height: int = 180, width: int = 320) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)


def confident(weights: Path, score: float) -> str:
    """Set the score that a network gives a person everywhere, as a logit; return the detector's id."""
    model = ultralytics.YOLO(str(weights))
    with torch.no_grad():
        for branch in model.model.model[-1].cv3:
            branch[-1].bias.fill_(-9.0)
            branch[-1].bias[0] = score
    model.save(str(weights))
    return f"ultralytics:{weights}"


def test_a_real_network_finds_boxes_of_known_classes(weights: Path) -> None:
    detector = find_detector(confident(weights, 0.5))
    for height, width in ((180, 320), (360, 640), (50, 40)):
        found = detector.detect(street(height, width))
        assert len(found.labels) > 0
        assert set(found.labels.tolist()) <= {0, 1}
        assert found.boxes.min() >= 0
        assert found.boxes[:, [0, 2]].max() <= width
        assert found.boxes[:, [1, 3]].max() <= height


@pytest.mark.parametrize(
    "picture",
    [np.zeros((180, 320), np.uint8), np.zeros((180, 320, 3), np.float32), np.zeros((180, 320, 4), np.uint8)],
    ids=["grey", "float", "transparent"],
)
def test_arrays_other_than_rgb_pictures_are_refused(weights: Path, picture: NDArray[Any]) -> None:
    detector = UltralyticsDetector(weights)
    with pytest.raises(DetectorError, match=r"expected uint8 of shape \(h, w, 3\), got"):
        detector.detect(picture)


def test_a_network_that_answers_nan_is_refused(weights: Path) -> None:
    detector = find_detector(confident(weights, float("nan")))
    with pytest.raises(InvalidDetections, match=r"net\.pt: expected finite scores and boxes, got NaN"):
        detector.detect(street())

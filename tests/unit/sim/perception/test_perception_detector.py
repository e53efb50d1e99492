"""The detector and its network, in torch and in onnxruntime, and the inputs that are refused."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from brink.sim.errors import InvalidEpisode
from brink.sim.perception.boxes import GroundTruth, mean_average_precision
from brink.sim.perception.detector import INPUT_PX, NetworkDetector, decode, find_detector, fit_picture
from brink.sim.perception.network import Network, detection_loss, make_target
from brink.sim.perception.training import detect_all, export_onnx, to_tensor
from brink.sim.perception.user_files import DetectorError

torch.set_num_threads(1)  # with more, threads that wait for a core make these tests very slow


@pytest.fixture(scope="module")
def network() -> Network:
    torch.manual_seed(0)
    made = Network()
    with torch.no_grad():  # a new network has no batch statistics yet
        made.train()
        made(torch.rand(4, 3, INPUT_PX[1], INPUT_PX[0]))
    return made.eval()


@pytest.fixture(scope="module")
def weights(network: Network, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("weights") / "network.onnx"
    export_onnx(network, file)
    return file


def pictures(count: int, seed: int = 0) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, 256, (count, INPUT_PX[1], INPUT_PX[0], 3), dtype=np.uint8)


def truth(*rows: tuple[int, float, float, float, float], ignored: tuple[int, ...] = ()) -> GroundTruth:
    flags = np.zeros(len(rows), np.bool_)
    flags[list(ignored)] = True
    return GroundTruth(
        labels=np.array([row[0] for row in rows], np.int64),
        boxes=np.array([row[1:] for row in rows], np.float32).reshape(len(rows), 4),
        ignored=flags,
    )


STREET = truth((0, 10, 60, 110, 130), (1, 150, 70, 162, 110), (1, 200, 80, 206, 96), (0, 230, 84, 318, 190))


def test_onnxruntime_and_torch_give_the_same_output(network: Network, weights: Path) -> None:
    detector = NetworkDetector(weights)
    for picture in pictures(3):
        heat, edges = detector.infer(picture)
        with torch.no_grad():
            wanted_heat, wanted_edges = network(to_tensor(picture[None]))
        assert heat == pytest.approx(wanted_heat[0].numpy(), abs=1e-4)
        assert edges == pytest.approx(wanted_edges[0].numpy(), rel=1e-3)


def test_the_network_is_small(network: Network, weights: Path) -> None:
    assert 4e5 < sum(part.numel() for part in network.parameters()) < 6e5
    assert weights.stat().st_size < 5_000_000


def test_boxes_are_in_pixels_of_a_picture_of_any_size(weights: Path) -> None:
    detector = NetworkDetector(weights)
    for height, width in ((360, 640), (192, 320), (600, 800), (720, 1280), (50, 40)):
        picture = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
        found = detector.detect(picture)
        assert found.boxes.min() >= 0
        assert found.boxes[:, [0, 2]].max() <= width
        assert found.boxes[:, [1, 3]].max() <= height
        assert np.all(np.diff(found.scores) <= 0)


def test_pictures_keep_their_aspect_ratio() -> None:
    canvas, scale = fit_picture(np.full((360, 640, 3), 200, np.uint8))
    assert (canvas.shape, scale) == ((192, 320, 3), 0.5)
    assert (canvas[:180] == 200).all()
    assert (canvas[180:] != 200).all()


def test_the_target_of_a_picture_decodes_to_its_boxes() -> None:
    target = make_target([STREET])
    logits = torch.logit(target.heat.clamp(1e-5, 1 - 1e-5))
    found = decode(logits[0].numpy(), target.edges[0].numpy())
    sure = found.scores > 0.9
    assert sorted(found.labels[sure].tolist()) == [0, 0, 1, 1]
    assert mean_average_precision([STREET], [found]) == pytest.approx(1.0)
    for label, box in zip(STREET.labels, STREET.boxes, strict=True):
        same = found.boxes[sure & (found.labels == label)]
        assert np.abs(same - box).max(axis=1).min() < 1e-3


def test_the_perfect_output_has_the_lowest_loss() -> None:
    target = make_target([STREET])
    perfect = torch.logit(target.heat.clamp(1e-4, 1 - 1e-4))
    best = float(detection_loss(perfect, target.edges, target))
    assert best < float(detection_loss(perfect, 1.3 * target.edges, target))
    assert best < float(detection_loss(torch.zeros_like(perfect), target.edges, target))
    assert best < float(detection_loss(perfect.flip(3), target.edges, target))


def test_ignored_boxes_are_not_trained() -> None:
    target = make_target([truth((1, 100, 60, 140, 140), (0, 10, 60, 60, 100), ignored=(0,))])
    assert float(target.heat[0, 1].max()) == 0.0
    assert float(target.heat_mask[0, 0, 20:30, 26:34].max()) == 0.0
    assert float(target.heat[0, 0].max()) == 1.0
    wrong = torch.full_like(target.heat, -8.0)
    wrong[0, 1, 20:30, 26:34] = 8.0
    calm = torch.full_like(target.heat, -8.0)
    assert float(detection_loss(wrong, target.edges, target)) == pytest.approx(
        float(detection_loss(calm, target.edges, target))
    )


def test_the_network_can_overfit_one_picture() -> None:
    torch.manual_seed(1)
    learner, planes = Network(), np.zeros((1, INPUT_PX[1], INPUT_PX[0], 3), np.uint8)
    for label, (left, upper, right, lower) in zip(
        STREET.labels, STREET.boxes.astype(int).tolist(), strict=True
    ):
        planes[0, upper:lower, left:right] = (220, 60, 40) if label else (40, 90, 230)
    optimiser = torch.optim.AdamW(learner.parameters(), lr=3e-3)
    target = make_target([STREET])
    for _ in range(60):
        learner.train()
        heat, edges = learner(to_tensor(planes))
        loss = detection_loss(heat, edges, target)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    learner.train()  # keeps the batch statistics of this one picture
    with torch.no_grad():
        heat, edges = learner(to_tensor(planes))
    assert mean_average_precision([STREET], [decode(heat[0].numpy(), edges[0].numpy())]) > 0.99


def test_detections_are_in_the_order_of_the_pictures(network: Network) -> None:
    planes = pictures(5)
    together = detect_all(network, planes)
    for place in range(5):
        (alone,) = detect_all(network, planes[place : place + 1])
        assert alone.boxes[:5] == pytest.approx(together[place].boxes[:5], abs=0.1)


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


def test_weights_with_other_outputs_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "other.onnx"
    other = torch.nn.Conv2d(3, 4, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(other, (torch.zeros(1, 3, 8, 8),), str(file), dynamo=False)
    with pytest.raises(DetectorError, match="expected input and outputs of shapes"):
        NetworkDetector(file)


def test_an_unknown_detector_gets_a_suggestion() -> None:
    with pytest.raises(InvalidEpisode, match="did you mean 'brink-det@1'"):
        find_detector("brink-dot@1")

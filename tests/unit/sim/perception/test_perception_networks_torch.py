"""The network of brink-det@2, its training, and networks in users' files, made and exported with torch."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmarks.training import trainer
from benchmarks.training.network import Network, detection_loss, make_target
from benchmarks.training.quantisation import quantise
from benchmarks.training.trainer import (
    INPUT_PX,
    Settings,
    TrainingSet,
    batches,
    export_onnx,
    to_tensor,
    train,
)
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.boxes import GroundTruth, mean_average_precision
from brink.sim.perception.detector import NetworkDetector, decode, find_detector, load_file_detector
from brink.sim.perception.user_files import DetectorError, check_loads

pytestmark = pytest.mark.long("needs torch")
torch.set_num_threads(1)  # with more, threads that wait for a core make these tests very slow

BRIGHT = np.zeros((180, 320, 3), np.uint8)
BRIGHT[40:120, 100:140] = 255


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


def pictures(count: int, seed: int = 0, size_px: tuple[int, int] = INPUT_PX) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, 256, (count, size_px[1], size_px[0], 3), dtype=np.uint8)


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
    detector = NetworkDetector.from_file(weights)
    for picture in pictures(3):
        heat, edges = detector.infer(picture)
        with torch.no_grad():
            wanted_heat, wanted_edges = network(to_tensor(picture[None]))
        assert heat == pytest.approx(wanted_heat[0].numpy(), abs=1e-4)
        assert edges == pytest.approx(wanted_edges[0].numpy(), rel=1e-3)


def test_the_quantised_network_gives_nearly_the_same_output(
    network: Network, weights: Path, tmp_path: Path
) -> None:
    files = [tmp_path / f"{name}.onnx" for name in ("one", "two")]
    for file in files:
        quantise(weights, pictures(8), file)
    assert files[0].read_bytes() == files[1].read_bytes()
    assert files[0].stat().st_size < 0.35 * weights.stat().st_size
    in_float, in_integers = NetworkDetector.from_file(weights), NetworkDetector.from_file(files[0])
    for picture in pictures(3, seed=1):
        wanted, found = in_float.infer(picture), in_integers.infer(picture)
        for one, other in zip(wanted, found, strict=True):
            assert np.abs(one - other).mean() < 0.1 * np.ptp(one)
            assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.98


def test_boxes_are_in_pixels_of_a_picture_of_any_size(weights: Path) -> None:
    detector = NetworkDetector.from_file(weights)
    for height, width in ((360, 640), (192, 320), (600, 800), (720, 1280), (50, 40)):
        picture = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
        found = detector.detect(picture)
        assert found.boxes.min() >= 0
        assert found.boxes[:, [0, 2]].max() <= width
        assert found.boxes[:, [1, 3]].max() <= height
        assert np.all(np.diff(found.scores) <= 0)


def test_the_target_of_a_picture_decodes_to_its_boxes() -> None:
    target = make_target([STREET], (320, 192))
    logits = torch.logit(target.heat.clamp(1e-5, 1 - 1e-5))
    found = decode(logits[0].numpy(), target.edges[0].numpy())
    sure = found.scores > 0.9
    assert sorted(found.labels[sure].tolist()) == [0, 0, 1, 1]
    assert mean_average_precision([STREET], [found]) == pytest.approx(1.0)
    for label, box in zip(STREET.labels, STREET.boxes, strict=True):
        same = found.boxes[sure & (found.labels == label)]
        assert np.abs(same - box).max(axis=1).min() < 1e-3


def test_ignored_boxes_are_not_trained() -> None:
    target = make_target([truth((1, 100, 60, 140, 140), (0, 10, 60, 60, 100), ignored=(0,))], (320, 192))
    assert float(target.heat[0, 1].max()) == 0.0
    assert float(target.heat_mask[0, 0, 20:30, 26:34].max()) == 0.0
    assert float(target.heat[0, 0].max()) == 1.0
    wrong = torch.full_like(target.heat, -8.0)
    wrong[0, 1, 20:30, 26:34] = 8.0
    calm = torch.full_like(target.heat, -8.0)
    assert float(detection_loss(wrong, target.edges, target)) == pytest.approx(
        float(detection_loss(calm, target.edges, target))
    )


def test_a_box_counts_though_its_centre_lies_in_a_smaller_ignored_one() -> None:
    target = make_target([truth((0, 40, 40, 200, 160), (1, 100, 80, 140, 120), ignored=(1,))], (320, 192))
    row, column = (100 // 4, 120 // 4)
    assert float(target.heat[0, 0, row, column]) == 1.0
    assert float(target.heat_mask[0, 0, row, column]) == 1.0
    assert float(target.heat_mask[0, 0, row, column + 2]) == 0.0


def test_weights_with_other_outputs_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "other.onnx"
    other = torch.nn.Conv2d(3, 4, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(other, (torch.zeros(1, 3, 8, 8),), str(file), dynamo=False)
    with pytest.raises(DetectorError, match="expected an input of shape"):
        NetworkDetector.from_file(file)


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
            network,
            (picture,),
            str(file),
            dynamo=False,
            opset_version=17,
            input_names=["images"],
            output_names=outputs or ["output0"],
        )
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


@pytest.fixture(scope="module", autouse=True)
def small_batches() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(trainer, "BATCH", 8)
        patched.setattr(trainer, "VALIDATION_EVERY", 2)
        patched.setattr(trainer, "find_device", lambda: torch.device("cpu"))
        yield


@pytest.fixture(scope="module")
def street_images() -> TrainingSet:
    return TrainingSet(planes=pictures(64, size_px=(192, 128)), truths=(STREET,) * 64)


SETTINGS = Settings(frames=64, epochs=4, seed=1)


def weights_after(out: Path, images: TrainingSet, settings: Settings = SETTINGS) -> dict[str, Tensor]:
    return train(images, images, settings, out)[0].state_dict()


def test_batches_do_not_depend_on_who_makes_them(street_images: TrainingSet) -> None:
    alone = list(batches(street_images, SETTINGS, epoch=0, workers=0))
    assert len(alone) == SETTINGS.epochs * SETTINGS.steps_an_epoch
    assert not torch.equal(alone[0][0], alone[8][0])
    assert sum(len(planes) for planes, _ in alone[:8]) == len(street_images.truths)
    cv2.setNumThreads(4)
    cv2.GaussianBlur(np.zeros((2_000, 2_000, 3), np.uint8), (31, 31), 0)  # starts the threads of OpenCV
    later = list(batches(street_images, SETTINGS, epoch=2, workers=2))
    for (planes, target), (same, same_target) in zip(alone[16:], later, strict=True):
        assert torch.equal(planes, same)
        assert torch.equal(target.heat, same_target.heat)
        assert torch.equal(target.edges, same_target.edges)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("whole")


@pytest.fixture(scope="module")
def uninterrupted(street_images: TrainingSet, whole: Path) -> dict[str, Tensor]:
    return weights_after(whole, street_images)


def test_an_interrupted_training_goes_on_with_the_same_result(
    street_images: TrainingSet,
    uninterrupted: dict[str, Tensor],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    complete = 3  # one after the first validation
    trained = 0

    def counted(*given: Any) -> float:
        nonlocal trained
        if trained == complete:
            raise KeyboardInterrupt
        trained += 1
        return train_epoch(*given)

    train_epoch = trainer._train_epoch
    with monkeypatch.context() as patched:
        patched.setattr(trainer, "_train_epoch", counted)
        with pytest.raises(KeyboardInterrupt):
            weights_after(tmp_path, street_images)
        assert torch.load(tmp_path / "training.pt")["epoch"] == complete
        trained = complete - SETTINGS.epochs  # counts up to 0
        found = weights_after(tmp_path, street_images)
        assert trained == 0
    assert all(torch.equal(found[name], value) for name, value in uninterrupted.items())


@pytest.mark.usefixtures("uninterrupted")
def test_a_checkpoint_of_other_settings_is_refused(street_images: TrainingSet, whole: Path) -> None:
    with pytest.raises(ValueError, match="expected the state of a run with"):
        weights_after(whole, street_images, replace(SETTINGS, seed=2))

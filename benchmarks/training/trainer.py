"""Training of `brink-det@2`: augmented batches, the optimiser loop, checkpoints, and the quantised network.

Initial weights, the order of images and the augmentation of each batch come from a seed, and the number of threads
is fixed, so that a second run on the same kind of processor or GPU gives the same weights, bit for bit. The output
folder keeps the state after each epoch in `training.pt`: a run that was interrupted goes on from there, with the same
result.
"""

import copy
import hashlib
import json
import os
import time
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torch.utils.data import DataLoader, Dataset

from benchmarks.training.augmentation import augment
from benchmarks.training.network import HEAD_WIDTH, WIDTHS, Network, Target, detection_loss, make_target
from benchmarks.training.quantisation import quantise
from brink.sim.perception.boxes import Detections, GroundTruth, LabelledFrame, curves, mean_average_precision
from brink.sim.perception.detector import LABELS, NetworkDetector, Picture, decode, fit_picture

INPUT_PX: Final = (448, 256)
"""Width and height of the network's input."""
BATCH: Final = 64
LEARNING_RATE: Final = 4e-3
"""The highest learning rate."""
WARM_UP: Final = 0.1
"""Share of the steps in which the learning rate rises; it falls in the others."""
WEIGHT_DECAY: Final = 1e-4
UNCHANGED: Final = 0.3
"""Share of the images that are only mirrored, zoomed and cropped."""
AVERAGE_DECAY: Final = 0.999
"""Decay of the moving average of all weights, which is the trained network."""
VALIDATION_EVERY: Final = 10
"""Epochs from one measurement on the validation images to the next."""
THREADS: Final = 2
"""A fixed number, because rounding differs between numbers of threads."""
PROGRESS_EVERY: Final = 500
_FEWEST_STEPS: Final = 20
"""The schedule of the learning rate divides by zero if its first tenth is a single step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings of a training run.

    Attributes:
        frames: Number of training images.
        epochs: Number of passes over the training images.
        seed: Seed of the initial weights, the order of the images and the augmentation.

    Raises:
        ValueError: There are fewer images than in a batch, or no epochs.
    """

    frames: int
    epochs: int
    seed: int

    def __post_init__(self) -> None:
        if self.frames < BATCH:
            raise ValueError(f"frames: expected at least {BATCH}, the images of one batch, got {self.frames}")
        if self.epochs < 1:
            raise ValueError(f"epochs: expected a positive number, got {self.epochs}")

    @property
    def steps_an_epoch(self) -> int:
        """Number of batches in an epoch."""
        return self.frames // BATCH


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrainingSet:
    """Images in the network's input format, with their ground truth.

    Attributes:
        planes: Shape ``(n, h, w, 3)``, uint8.
        truths: Ground truth in px of the network's input.
    """

    planes: Picture
    truths: tuple[GroundTruth, ...]

    def digest(self) -> str:
        """Return a digest of the images and their ground truth, 16 hexadecimal digits."""
        found = hashlib.sha256(np.ascontiguousarray(self.planes).data)
        for truth in self.truths:
            for part in (truth.labels, truth.boxes, truth.ignored):
                found.update(part.tobytes())
        return found.hexdigest()[:16]


def make_deterministic() -> None:
    """Run torch on a fixed number of threads and OpenCV on one, with deterministic algorithms only."""
    os.environ["CUBLAS_WORKSPACE_CONFIG"] = ":4096:8"  # else matrix products on a GPU are not deterministic
    torch.set_num_threads(THREADS)
    cv2.setNumThreads(1)
    torch.use_deterministic_algorithms(True)


def find_device() -> torch.device:
    """Return the first GPU, or the CPU if there is none."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def collect(frames: Iterable[LabelledFrame], count: int, name: str) -> TrainingSet:
    """Convert images to the network's input format, and print the progress.

    Args:
        frames: The images.
        count: Number of images.
        name: Name of the set in the printed progress.
    """
    planes = np.empty((count, *INPUT_PX[::-1], 3), np.uint8)
    truths = []
    started = time.monotonic()
    for index, frame in enumerate(frames):
        truth = frame.truth
        planes[index], scale = fit_picture(frame.picture, INPUT_PX)
        scaled = (truth.boxes * np.float32(scale)).astype(np.float32)
        truths.append(GroundTruth(labels=truth.labels, boxes=scaled, ignored=truth.ignored))
        if (index + 1) % PROGRESS_EVERY == 0:
            elapsed_s = time.monotonic() - started
            print(f"{name}: {index + 1} of {count} images, {elapsed_s:.0f} s", flush=True)  # noqa: T201
    return TrainingSet(planes=planes, truths=tuple(truths))


def to_tensor(planes: NDArray[np.uint8] | torch.Tensor, device: torch.device | None = None) -> torch.Tensor:
    """Return images as the network's input, shape ``(n, 3, h, w)``, in [0, 1].

    Args:
        planes: Images, shape ``(n, h, w, 3)``, uint8.
        device: Where the network is; by default on the processor.
    """
    moved = torch.as_tensor(planes).to(device or torch.device("cpu"))
    return (moved.permute(0, 3, 1, 2).float() / 255.0).contiguous(memory_format=torch.channels_last)


class _Batches(Dataset[tuple[torch.Tensor, Target]]):
    """Augmented batches by step, counted over all epochs; each depends on the seed and its step alone."""

    def __init__(self, pictures: TrainingSet, settings: Settings) -> None:
        self._pictures = pictures
        self._settings = settings

    def __getitem__(self, index: int) -> tuple[torch.Tensor, Target]:
        settings, truths = self._settings, self._pictures.truths
        epoch, step = divmod(index, settings.steps_an_epoch)
        order = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(epoch,))).permutation(
            len(truths)
        )
        chosen = order[step * BATCH : (step + 1) * BATCH]
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(epoch, step)))
        planes, augmented = _augmented(self._pictures, chosen, rng)
        height_px, width_px = planes.shape[1:3]
        return torch.from_numpy(planes), make_target(augmented, (width_px, height_px))


def _augmented(
    pictures: TrainingSet, chosen: NDArray[np.intp], rng: np.random.Generator
) -> tuple[Picture, list[GroundTruth]]:
    planes = np.empty((len(chosen), *pictures.planes.shape[1:]), np.uint8)
    truths = []
    for place, index in enumerate(chosen.tolist()):
        other = pictures.planes[int(rng.integers(len(pictures.planes)))]
        planes[place], truth = augment(
            pictures.planes[index], pictures.truths[index], other, rng, unchanged=UNCHANGED
        )
        truths.append(truth)
    return planes, truths


@dataclass(slots=True, kw_only=True, eq=False)
class _State:
    """Everything that an epoch changes.

    Attributes:
        network: The network that is trained.
        average: Moving average of its weights.
        optimiser: The optimiser.
        schedule: Learning rate of each step.
        epoch: Number of complete epochs.
        validation_map: mAP on the validation images by number of complete epochs.
        wall_s: Wall-clock time of the epochs so far, validation included.
    """

    network: Network
    average: Network
    optimiser: torch.optim.Optimizer
    schedule: torch.optim.lr_scheduler.LRScheduler
    epoch: int = 0
    validation_map: dict[str, float] = field(default_factory=dict)
    wall_s: float = 0.0

    @classmethod
    def initial(cls, settings: Settings, device: torch.device) -> "_State":
        torch.manual_seed(settings.seed)
        network = Network()
        network.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload] # the stubs lack it
        optimiser = torch.optim.AdamW(network.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
        steps = max(_FEWEST_STEPS, settings.epochs * settings.steps_an_epoch)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, LEARNING_RATE, total_steps=steps, pct_start=WARM_UP
        )
        return cls(network=network, average=copy.deepcopy(network), optimiser=optimiser, schedule=schedule)

    def step(self, planes: torch.Tensor, target: Target, device: torch.device) -> torch.Tensor:
        """Train on one batch, and return its loss."""
        heat, edges = self.network(to_tensor(planes, device))
        loss = detection_loss(heat, edges, target.to(device))
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self.optimiser.step()
        _update_average(self.average, self.network, self.schedule.last_epoch)
        self.schedule.step()
        return loss.detach()

    def _parts(self) -> dict[str, Any]:
        return {
            "network": self.network,
            "average": self.average,
            "optimiser": self.optimiser,
            "schedule": self.schedule,
        }

    def save(self, file: Path, run: dict[str, Any]) -> None:
        content = {name: part.state_dict() for name, part in self._parts().items()}
        content |= {
            "run": run,
            "epoch": self.epoch,
            "validation_map": self.validation_map,
            "wall_s": self.wall_s,
        }
        torch.save(content, file.with_suffix(".new"))
        file.with_suffix(".new").replace(file)

    def load(self, file: Path, run: dict[str, Any]) -> None:
        content = torch.load(file, weights_only=True, map_location="cpu")
        if content["run"] != run:
            raise ValueError(
                f"{file}: expected the state of a run with {run}, got one with {content['run']}; "
                f"delete the file to start anew, or choose another output folder"
            )
        for name, part in self._parts().items():
            part.load_state_dict(content[name])
        self.epoch, self.wall_s = content["epoch"], content["wall_s"]
        self.validation_map = content["validation_map"]


def train(
    pictures: TrainingSet, validation: TrainingSet, settings: Settings, out: Path
) -> tuple[Network, dict[str, Any]]:
    """Train a network, continuing from the last complete epoch in the output folder, if there is one.

    Args:
        pictures: Training images, as from `collect`.
        validation: Validation images.
        settings: Settings.
        out: Output folder.

    Returns:
        The network, on the processor, and a record of the training as plain JSON values.

    Raises:
        ValueError: There are more or fewer images than in the settings; or the output folder has the state of a run
            with other settings, images, libraries or another kind of device.
    """
    if len(pictures.truths) != settings.frames:
        raise ValueError(f"pictures: expected {settings.frames} images, got {len(pictures.truths)}")
    device = find_device()
    run = {
        **asdict(settings),
        "input_px": list(INPUT_PX),
        "batch": BATCH,
        "learning_rate": LEARNING_RATE,
        "warm_up": WARM_UP,
        "weight_decay": WEIGHT_DECAY,
        "average_decay": AVERAGE_DECAY,
        "unchanged": UNCHANGED,
        "widths": [*WIDTHS, HEAD_WIDTH],
        "images": pictures.digest(),
        "device": _name(device),
        "torch": str(torch.__version__),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }
    state, checkpoint = _State.initial(settings, device), out / "training.pt"
    if checkpoint.is_file():
        state.load(checkpoint, run)
    workers = len(os.sched_getaffinity(0)) if device.type == "cuda" else 0
    stream = batches(pictures, settings, epoch=state.epoch, workers=workers)
    while state.epoch < settings.epochs:
        started = time.monotonic()
        loss = _train_epoch(state, stream, settings.steps_an_epoch, device)
        state.epoch += 1
        measured = ""
        if state.epoch % VALIDATION_EVERY == 0 or state.epoch == settings.epochs:
            found = mean_average_precision(validation.truths, detect_all(state.average, validation.planes))
            state.validation_map[str(state.epoch)] = found
            measured = f", validation mAP {found:.3f}"
        state.wall_s += time.monotonic() - started
        state.save(checkpoint, run)
        print(  # noqa: T201
            f"epoch {state.epoch} of {settings.epochs}: loss {loss:.3f}{measured}, {state.wall_s:.0f} s",
            flush=True,
        )
    record = {**run, "validation_map": state.validation_map, "wall_s": round(state.wall_s)}
    return state.average.cpu().eval(), record


def _name(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else "processor"


def batches(
    pictures: TrainingSet, settings: Settings, *, epoch: int, workers: int
) -> Iterator[tuple[torch.Tensor, Target]]:
    """Yield the augmented batches of an epoch and of all later ones, the same with any number of processes.

    Args:
        pictures: Training images.
        settings: Settings.
        epoch: The first epoch, counted from 0.
        workers: Number of processes that make batches ahead; 0 makes them in this process.
    """
    steps = range(epoch * settings.steps_an_epoch, settings.epochs * settings.steps_an_epoch)
    loader = DataLoader(
        _Batches(pictures, settings),
        batch_size=None,
        sampler=steps,
        num_workers=workers,
        multiprocessing_context="fork" if workers else None,  # the processes share the images
    )
    # Set here, not in the new processes: they would wait for OpenCV's threads, which exist only in this one.
    cv2.setNumThreads(1)
    return iter(loader)


def _train_epoch(
    state: _State, stream: Iterator[tuple[torch.Tensor, Target]], steps: int, device: torch.device
) -> float:
    """Train one epoch; return the mean loss."""
    state.network.train()
    total = torch.zeros((), device=device)
    for _ in range(steps):
        total += state.step(*next(stream), device)
    return float(total) / steps


def _update_average(average: Network, network: Network, step: int) -> None:
    """Update the exponential moving average of the weights; its decay is smaller in the first steps."""
    decay = min(AVERAGE_DECAY, (1 + step) / (10 + step))
    means, currents = list(average.state_dict().values()), list(network.state_dict().values())
    floating = [place for place, mean in enumerate(means) if mean.dtype.is_floating_point]
    update = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]
    update([means[place] for place in floating], [currents[place] for place in floating], step)
    for mean, current in zip(means, currents, strict=True):
        if not mean.dtype.is_floating_point:
            mean.copy_(current)


def detect_all(network: Network, planes: Picture) -> list[Detections]:
    """Return the network's detections in each image.

    Boxes are not clipped to the image, as a detector's are, so that mAP is slightly lower than that of
    `python -m benchmarks detector`.
    """
    network.eval()
    device = next(network.parameters()).device
    detections = []
    with torch.no_grad():
        for start in range(0, len(planes), 32):
            heat, edges = network(to_tensor(planes[start : start + 32], device))
            found = zip(heat.cpu().numpy(), edges.cpu().numpy(), strict=True)
            detections += [decode(h, e) for h, e in found]
    return detections


def export_onnx(network: Network, file: Path) -> None:
    """Write a network as an ONNX file."""
    picture = torch.zeros(1, 3, INPUT_PX[1], INPUT_PX[0])
    network.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload] # the stubs lack it
    with warnings.catch_warnings():
        # The exporter that replaces this one needs two more packages and writes the same file.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network,
            (picture,),
            str(file),
            dynamo=False,
            opset_version=17,
            input_names=["picture"],
            output_names=["heat", "edges"],
        )


def write_results(
    network: Network, test: TrainingSet, calibration: Picture, out: Path, *, record: dict[str, Any]
) -> None:
    """Write the weights, in floating point and quantised, and a record of the training; print the record.

    Args:
        network: The trained network.
        test: Test images, for the metrics in the record.
        calibration: Training images in the network's input format, for the scales of its activations.
        out: Output folder.
        record: Settings and progress of the training.
    """
    detections = detect_all(network, test.planes)
    in_float, quantised = out / "brink-det-2-float.onnx", out / "brink-det-2.onnx"
    export_onnx(network, in_float)
    quantise(in_float, calibration, quantised)
    detector = NetworkDetector.from_file(quantised)
    by_quantised = [decode(*detector.infer(canvas)) for canvas in test.planes]
    record = {
        **record,
        "parameters": sum(weights.numel() for weights in network.parameters()),
        "test_map": mean_average_precision(test.truths, detections),
        "test_average_precision": {
            LABELS[curve.label]: curve.average_precision for curve in curves(test.truths, detections)
        },
        "quantised_test_map": mean_average_precision(test.truths, by_quantised),
    }
    (out / "brink-det-2.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(record, indent=2))  # noqa: T201

"""Training of `brink-det@2`: augmented batches, the optimiser loop, checkpoints, and the export to ONNX.

Initial weights, the order of images and their augmentation come from a seed and the number of threads is fixed, so
that a second run on the same kind of processor gives the same weights, bit for bit. The output folder keeps the state
after each epoch in `training.pt`: a run that was interrupted goes on from there, with the same result.
"""

import copy
import hashlib
import json
import time
import warnings
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from brink.sim.perception.augmentation import augment
from brink.sim.perception.boxes import Detections, GroundTruth, LabelledFrame, curves, mean_average_precision
from brink.sim.perception.detector import INPUT_PX, LABELS, Picture, decode, fit_picture
from brink.sim.perception.network import Network, detection_loss, make_target

BATCH: Final = 16
THREADS: Final = 2
"""A fixed number, because rounding differs between numbers of threads."""
SECTION_PX: Final = (192, 128)
"""Size of the sections that most epochs are trained on, which takes less than half the time of whole images."""
WHOLE_EPOCHS: Final = (3, 2)
"""Number of epochs at the end of each cycle that are trained on whole images."""
LEARNING_RATES: Final = (3e-3, 2e-3)
"""Highest learning rate of each cycle."""
UNCHANGED_SHARES: Final = (0.2, 0.4)
"""Share of the images in each cycle that are only mirrored, zoomed and cropped."""
AVERAGE_DECAY: Final = 0.999
"""Decay of the moving average of all weights, which is the trained network."""
PROGRESS_EVERY: Final = 500
_FEWEST_STEPS: Final = 20
"""The schedule of the learning rate divides by zero if its first tenth is a single step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings of a training run.

    Attributes:
        frames: Number of training images.
        epochs: Number of passes over the training images in the first cycle of the learning rate.
        more_epochs: The same for the second cycle, which has less augmentation.
        seed: Seed of the initial weights, the order of the images and the augmentation.
    """

    frames: int
    epochs: int
    more_epochs: int
    seed: int

    def cycle_of(self, epoch: int) -> int:
        """Return the cycle of an epoch, 0 or 1."""
        return int(epoch >= self.epochs)

    def is_whole(self, epoch: int) -> bool:
        """Return whether an epoch is trained on whole images."""
        cycle = self.cycle_of(epoch)
        end = self.epochs + cycle * self.more_epochs
        return epoch >= end - WHOLE_EPOCHS[cycle]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrainingSet:
    """Images in the network's input format, with their ground truth.

    Attributes:
        planes: Shape ``(n, 192, 320, 3)``, uint8.
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
    torch.set_num_threads(THREADS)
    cv2.setNumThreads(1)
    torch.use_deterministic_algorithms(True)


def collect(frames: Iterable[LabelledFrame], count: int, name: str) -> TrainingSet:
    """Convert images to the network's input format, and print the progress.

    Args:
        frames: The images.
        count: Number of images.
        name: Name of the set in the printed progress.
    """
    planes = np.empty((count, INPUT_PX[1], INPUT_PX[0], 3), np.uint8)
    truths = []
    started = time.monotonic()
    for index, frame in enumerate(frames):
        planes[index], scale = fit_picture(frame.picture)
        truth = frame.truth
        scaled = (truth.boxes * np.float32(scale)).astype(np.float32)
        truths.append(GroundTruth(labels=truth.labels, boxes=scaled, ignored=truth.ignored))
        if (index + 1) % PROGRESS_EVERY == 0:
            elapsed_s = time.monotonic() - started
            print(f"{name}: {index + 1} of {count} images, {elapsed_s:.0f} s", flush=True)  # noqa: T201
    return TrainingSet(planes=planes, truths=tuple(truths))


def to_tensor(planes: Picture) -> torch.Tensor:
    """Return images as the network's input, shape ``(n, 3, 192, 320)``, in [0, 1]."""
    tensor = torch.from_numpy(np.ascontiguousarray(planes.transpose(0, 3, 1, 2))).float() / 255.0
    return tensor.contiguous(memory_format=torch.channels_last)


@dataclass(slots=True, kw_only=True, eq=False)
class _State:
    """All that an epoch changes.

    Attributes:
        network: The network that is trained.
        average: Moving average of its weights.
        optimiser: The optimiser.
        schedule: Learning rate of each step.
        validation_map: mAP on the validation images after each epoch so far.
        cpu_s: CPU time of the epochs so far.
    """

    network: Network
    average: Network
    optimiser: torch.optim.Optimizer
    schedule: torch.optim.lr_scheduler.LRScheduler
    validation_map: list[float] = field(default_factory=list)
    cpu_s: float = 0.0

    @classmethod
    def initial(cls, settings: Settings) -> "_State":
        torch.manual_seed(settings.seed)
        network = Network()
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload] # the stubs lack it
        optimiser = torch.optim.AdamW(network.parameters(), lr=LEARNING_RATES[0], weight_decay=1e-4)
        schedule = _schedule(optimiser, settings, cycle=0)
        average = copy.deepcopy(network)
        return cls(network=network, average=average, optimiser=optimiser, schedule=schedule)

    def _parts(self) -> dict[str, Any]:
        return {
            "network": self.network, "average": self.average, "optimiser": self.optimiser,
            "schedule": self.schedule,
        }  # fmt: skip

    def save(self, file: Path, run: dict[str, Any]) -> None:
        content = {name: part.state_dict() for name, part in self._parts().items()}
        content |= {"run": run, "validation_map": self.validation_map, "cpu_s": self.cpu_s}
        torch.save(content, file.with_suffix(".new"))
        file.with_suffix(".new").replace(file)

    def load(self, file: Path, run: dict[str, Any]) -> None:
        content = torch.load(file, weights_only=True)
        if content["run"] != run:
            raise ValueError(
                f"{file}: expected the state of a run with {run}, got one with {content['run']}; "
                f"delete the file to start anew, or choose another output folder"
            )
        for name, part in self._parts().items():
            part.load_state_dict(content[name])
        self.validation_map, self.cpu_s = content["validation_map"], content["cpu_s"]


def _schedule(
    optimiser: torch.optim.Optimizer, settings: Settings, cycle: int
) -> torch.optim.lr_scheduler.LRScheduler:
    epochs = (settings.epochs, settings.more_epochs)[cycle]
    steps = max(_FEWEST_STEPS, epochs * (settings.frames // BATCH))
    return torch.optim.lr_scheduler.OneCycleLR(
        optimiser, LEARNING_RATES[cycle], total_steps=steps, pct_start=0.1
    )


def train(
    pictures: TrainingSet, validation: TrainingSet, settings: Settings, out: Path
) -> tuple[Network, dict[str, Any]]:
    """Train a network, going on from the last complete epoch in the output folder, if there is one.

    Args:
        pictures: Training images.
        validation: Validation images.
        settings: Settings.
        out: Output folder.

    Returns:
        The network, and a record of the training as plain JSON values.

    Raises:
        ValueError: The output folder has the state of a run with other settings, images or version of torch.
    """
    run = {**asdict(settings), "images": pictures.digest(), "torch": str(torch.__version__)}
    state, checkpoint = _State.initial(settings), out / "training.pt"
    if checkpoint.is_file():
        state.load(checkpoint, run)
    epochs = settings.epochs + settings.more_epochs
    for epoch in range(len(state.validation_map), epochs):
        cpu_s = time.process_time()
        if epoch == settings.epochs:
            state.schedule = _schedule(state.optimiser, settings, cycle=1)
        loss = _train_epoch(state, pictures, settings, epoch)
        detections = detect_all(state.average, validation.planes)
        state.validation_map.append(mean_average_precision(validation.truths, detections))
        state.cpu_s += time.process_time() - cpu_s
        state.save(checkpoint, run)
        print(  # noqa: T201
            f"epoch {epoch + 1} of {epochs}: loss {loss:.3f}, "
            f"validation mAP {state.validation_map[-1]:.3f}, {state.cpu_s:.0f} CPU s",
            flush=True,
        )
    record = {**run, "validation_map": state.validation_map, "cpu_s": round(state.cpu_s)}
    return state.average.eval(), record


def _train_epoch(state: _State, pictures: TrainingSet, settings: Settings, epoch: int) -> float:
    """Train one epoch; return the mean loss. Its random numbers depend on the seed and the epoch alone."""
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(epoch,)))
    size_px = INPUT_PX if settings.is_whole(epoch) else SECTION_PX
    unchanged = UNCHANGED_SHARES[settings.cycle_of(epoch)]
    state.network.train()
    batches = len(pictures.truths) // BATCH
    order = rng.permutation(len(pictures.truths))
    total = 0.0
    for step in range(batches):
        chosen = order[step * BATCH : (step + 1) * BATCH]
        planes, truths = _augmented(pictures, chosen, rng, size_px, unchanged)
        heat, edges = state.network(to_tensor(planes))
        loss = detection_loss(heat, edges, make_target(truths, size_px))
        state.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(state.network.parameters(), 10.0)
        state.optimiser.step()
        state.schedule.step()
        total += loss.item()
        _update_average(state.average, state.network, epoch * batches + step)
    return total / max(1, batches)


def _augmented(
    pictures: TrainingSet,
    chosen: NDArray[np.intp],
    rng: np.random.Generator,
    size_px: tuple[int, int],
    unchanged: float,
) -> tuple[Picture, list[GroundTruth]]:
    planes = np.empty((len(chosen), size_px[1], size_px[0], 3), np.uint8)
    truths = []
    for place, index in enumerate(chosen.tolist()):
        other = pictures.planes[int(rng.integers(len(pictures.planes)))]
        planes[place], truth = augment(
            pictures.planes[index], pictures.truths[index], other, rng, size_px=size_px, unchanged=unchanged
        )
        truths.append(truth)
    return planes, truths


def _update_average(average: Network, network: Network, step: int) -> None:
    """Update the exponential moving average of the weights; its decay is smaller in the first steps."""
    decay = min(AVERAGE_DECAY, (1 + step) / (10 + step))
    with torch.no_grad():
        for mean, current in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
            if mean.dtype.is_floating_point:
                mean.mul_(decay).add_(current, alpha=1 - decay)
            else:
                mean.copy_(current)


def detect_all(network: Network, planes: Picture) -> list[Detections]:
    """Return the network's detections in each image."""
    network.eval()
    detections = []
    with torch.no_grad():
        for start in range(0, len(planes), 32):
            heat, edges = network(to_tensor(planes[start : start + 32]))
            detections += [decode(h, e) for h, e in zip(heat.numpy(), edges.numpy(), strict=True)]
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


def write_results(network: Network, test: TrainingSet, out: Path, *, record: dict[str, Any]) -> None:
    """Write the weights and a record of the training, and print the record.

    Args:
        network: The trained network.
        test: Test images, for the metrics in the record.
        out: Output folder.
        record: Settings and progress of the training.
    """
    detections = detect_all(network, test.planes)
    record = {
        **record,
        "parameters": sum(weights.numel() for weights in network.parameters()),
        "test_map": mean_average_precision(test.truths, detections),
        "test_average_precision": {
            LABELS[curve.label]: curve.average_precision for curve in curves(test.truths, detections)
        },
    }
    export_onnx(network, out / "brink-det-2.onnx")
    (out / "brink-det-2.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(record, indent=2))  # noqa: T201

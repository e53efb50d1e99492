"""Training of `brink-det@2`: augmented batches, the optimiser loop, checkpoints, and the quantised network.

Initial weights, the order of images and their augmentation come from a seed and the number of threads is fixed, so
that a second run on the same kind of processor gives the same weights, bit for bit. The output folder keeps the state
after each epoch in `training.pt`: a run that was interrupted goes on from there, with the same result.
"""

import copy
import hashlib
import json
import time
import warnings
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from brink.sim.perception.augmentation import augment
from brink.sim.perception.boxes import Detections, GroundTruth, LabelledFrame, curves, mean_average_precision
from brink.sim.perception.detector import LABELS, NetworkDetector, Picture, decode, fit_picture
from brink.sim.perception.network import Network, detection_loss, make_target
from brink.sim.perception.quantisation import quantise

BATCH: Final = 16
THREADS: Final = 2
"""A fixed number, because rounding differs between numbers of threads."""
SizePx: TypeAlias = tuple[int, int]
"""Width and height."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cycle:
    """One cycle of the learning rate.

    Attributes:
        learning_rate: The highest learning rate.
        input_px: Size of the images.
        section_px: Size of the random sections that most epochs are trained on, which takes less than half the time
            of whole images.
        whole_epochs: Number of epochs at the end that are trained on whole images.
        unchanged: Share of the images that are only mirrored, zoomed and cropped.
    """

    learning_rate: float
    input_px: SizePx
    section_px: SizePx
    whole_epochs: int
    unchanged: float


CYCLES: Final = (
    Cycle(learning_rate=3e-3, input_px=(320, 192), section_px=(192, 128), whole_epochs=3, unchanged=0.2),
    Cycle(learning_rate=2e-3, input_px=(320, 192), section_px=(192, 128), whole_epochs=2, unchanged=0.4),
    Cycle(learning_rate=2e-3, input_px=(448, 256), section_px=(256, 160), whole_epochs=1, unchanged=0.4),
)
"""The last cycle has the resolution of the finished network; a lower one in the others halves their time."""
INPUT_PX: Final = CYCLES[-1].input_px
"""Size of the finished network's input."""
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
        epochs: Number of passes over the training images in each of `CYCLES`.
        seed: Seed of the initial weights, the order of the images and the augmentation.

    Raises:
        ValueError: `epochs` does not have one positive number for each of `CYCLES`.
    """

    frames: int
    epochs: tuple[int, ...]
    seed: int

    def __post_init__(self) -> None:
        if len(self.epochs) != len(CYCLES) or min(self.epochs) < 1:
            raise ValueError(
                f"epochs: expected {len(CYCLES)} positive numbers, one for each cycle, got {self.epochs}"
            )

    @property
    def starts(self) -> tuple[int, ...]:
        """The first epoch of each cycle, counted from 0."""
        return tuple(sum(self.epochs[:cycle]) for cycle in range(len(self.epochs)))

    def cycle_of(self, epoch: int) -> int:
        """Return the index of the cycle that an epoch belongs to."""
        return bisect_right(self.starts, epoch) - 1

    def size_px(self, epoch: int) -> SizePx:
        """Return the size of the images or sections that an epoch is trained on."""
        index = self.cycle_of(epoch)
        left = self.starts[index] + self.epochs[index] - epoch
        cycle = CYCLES[index]
        return cycle.input_px if left <= cycle.whole_epochs else cycle.section_px


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
    torch.set_num_threads(THREADS)
    cv2.setNumThreads(1)
    torch.use_deterministic_algorithms(True)


def collect(frames: Iterable[LabelledFrame], count: int, name: str) -> dict[SizePx, TrainingSet]:
    """Convert images to the input format of each of `CYCLES`, and print the progress.

    Args:
        frames: The images.
        count: Number of images.
        name: Name of the set in the printed progress.

    Returns:
        The images by size.
    """
    planes = {cycle.input_px: np.empty((count, *cycle.input_px[::-1], 3), np.uint8) for cycle in CYCLES}
    truths: dict[SizePx, list[GroundTruth]] = {size_px: [] for size_px in planes}
    started = time.monotonic()
    for index, frame in enumerate(frames):
        truth = frame.truth
        for size_px in planes:
            planes[size_px][index], scale = fit_picture(frame.picture, size_px)
            scaled = (truth.boxes * np.float32(scale)).astype(np.float32)
            truths[size_px].append(GroundTruth(labels=truth.labels, boxes=scaled, ignored=truth.ignored))
        if (index + 1) % PROGRESS_EVERY == 0:
            elapsed_s = time.monotonic() - started
            print(f"{name}: {index + 1} of {count} images, {elapsed_s:.0f} s", flush=True)  # noqa: T201
    return {size_px: TrainingSet(planes=planes[size_px], truths=tuple(truths[size_px])) for size_px in planes}


def to_tensor(planes: Picture) -> torch.Tensor:
    """Return images as the network's input, shape ``(n, 3, h, w)``, in [0, 1]."""
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
        optimiser = torch.optim.AdamW(network.parameters(), lr=CYCLES[0].learning_rate, weight_decay=1e-4)
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
    steps = max(_FEWEST_STEPS, settings.epochs[cycle] * (settings.frames // BATCH))
    return torch.optim.lr_scheduler.OneCycleLR(
        optimiser, CYCLES[cycle].learning_rate, total_steps=steps, pct_start=0.1
    )


def train(
    pictures: Mapping[SizePx, TrainingSet],
    validation: Mapping[SizePx, TrainingSet],
    settings: Settings,
    out: Path,
) -> tuple[Network, dict[str, Any]]:
    """Train a network, going on from the last complete epoch in the output folder, if there is one.

    Args:
        pictures: Training images by size, as from `collect`.
        validation: Validation images by size.
        settings: Settings.
        out: Output folder.

    Returns:
        The network, and a record of the training as plain JSON values.

    Raises:
        ValueError: The output folder has the state of a run with other settings, images or versions of libraries.
    """
    digests = [pictures[size_px].digest() for size_px in sorted(pictures)]
    run = {
        **asdict(settings), "cycles": [asdict(cycle) for cycle in CYCLES], "images": digests,
        "torch": str(torch.__version__), "numpy": np.__version__, "opencv": cv2.__version__,
    }  # fmt: skip
    state, checkpoint = _State.initial(settings), out / "training.pt"
    if checkpoint.is_file():
        state.load(checkpoint, run)
    epochs = sum(settings.epochs)
    for epoch in range(len(state.validation_map), epochs):
        cpu_s = time.process_time()
        cycle = settings.cycle_of(epoch)
        if epoch == settings.starts[cycle]:
            state.schedule = _schedule(state.optimiser, settings, cycle)
        size_px = CYCLES[cycle].input_px
        loss = _train_epoch(state, pictures[size_px], settings, epoch)
        seen = validation[size_px]
        state.validation_map.append(
            mean_average_precision(seen.truths, detect_all(state.average, seen.planes))
        )
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
    size_px = settings.size_px(epoch)
    unchanged = CYCLES[settings.cycle_of(epoch)].unchanged
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
    """Return the network's detections in each image.

    Boxes are not clipped to the image, as a detector's are, so that mAP is slightly lower than that of
    `brink bench detector`.
    """
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


def write_results(
    network: Network,
    test: Mapping[SizePx, TrainingSet],
    calibration: Picture,
    out: Path,
    *,
    record: dict[str, Any],
) -> None:
    """Write the weights, in floating point and quantised, and a record of the training; print the record.

    Args:
        network: The trained network.
        test: Test images by size, for the metrics in the record.
        calibration: Training images in the network's input format, for the scales of its activations.
        out: Output folder.
        record: Settings and progress of the training.
    """
    seen = test[INPUT_PX]
    detections = detect_all(network, seen.planes)
    in_float, quantised = out / "brink-det-2-float.onnx", out / "brink-det-2.onnx"
    export_onnx(network, in_float)
    quantise(in_float, calibration, quantised)
    detector = NetworkDetector.from_file(quantised)
    by_quantised = [decode(*detector.infer(canvas)) for canvas in seen.planes]
    record = {
        **record,
        "parameters": sum(weights.numel() for weights in network.parameters()),
        "test_map": mean_average_precision(seen.truths, detections),
        "test_average_precision": {
            LABELS[curve.label]: curve.average_precision for curve in curves(seen.truths, detections)
        },
        "quantised_test_map": mean_average_precision(seen.truths, by_quantised),
    }
    (out / "brink-det-2.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(record, indent=2))  # noqa: T201

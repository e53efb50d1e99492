"""Training of `brink-det@1`: batches, exposure variation, the optimiser loop, and the export to ONNX.

Initial weights and the order of images come from a seed and everything runs on one thread, so that a second run
on the same kind of processor gives the same weights.
"""

import copy
import json
import time
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import torch

from brink.sim.perception.boxes import Detections, GroundTruth, LabelledFrame, curves, mean_average_precision
from brink.sim.perception.detector import INPUT_PX, LABELS, Picture, decode, fit_picture
from brink.sim.perception.network import Network, detection_loss, make_target

BATCH: Final = 8
LEARNING_RATE: Final = 3e-3
AVERAGE_DECAY: Final = 0.999
"""Decay of the moving average of all weights, which is the trained network."""
PROGRESS_EVERY: Final = 500


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrainingSet:
    """Images in the network's input format, with their ground truth.

    Attributes:
        planes: Shape ``(n, 192, 320, 3)``, uint8.
        truths: Ground truth in px of the network's input.
    """

    planes: Picture
    truths: tuple[GroundTruth, ...]


def make_deterministic() -> None:
    """Run torch and OpenCV on one thread, with deterministic algorithms only."""
    torch.set_num_threads(1)
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


def _flip(truth: GroundTruth) -> GroundTruth:
    boxes = truth.boxes.copy()
    boxes[:, [0, 2]] = INPUT_PX[0] - truth.boxes[:, [2, 0]]
    return GroundTruth(labels=truth.labels, boxes=boxes, ignored=truth.ignored)


def _vary_exposure(planes: Picture, rng: np.random.Generator) -> Picture:
    """Randomly vary gain, offset, white balance and noise in about two thirds of the images.

    These differ between cameras. The variation is no stronger than the weakest levels of contrast; all other
    perturbations stay unknown to the detector.
    """
    count = len(planes)
    gain = rng.uniform(0.8, 1.2, (count, 1, 1, 1)) * rng.uniform(0.93, 1.07, (count, 1, 1, 3))
    offset = rng.uniform(-20.0, 20.0, (count, 1, 1, 1))
    noise = rng.standard_normal((1, *planes.shape[1:]), np.float32) * rng.uniform(0.0, 6.0, (count, 1, 1, 1))
    varied = np.clip(planes * gain + offset + noise, 0.0, 255.0).astype(np.uint8)
    unchanged = rng.random(count) < 1 / 3
    varied[unchanged] = planes[unchanged]
    return varied


def to_tensor(planes: Picture) -> torch.Tensor:
    """Return images as the network's input, shape ``(n, 3, 192, 320)``, in [0, 1]."""
    tensor = torch.from_numpy(np.ascontiguousarray(planes.transpose(0, 3, 1, 2))).float() / 255.0
    return tensor.contiguous(memory_format=torch.channels_last)


def train(
    pictures: TrainingSet, validation: TrainingSet, *, epochs: int, seed: int
) -> tuple[Network, list[float]]:
    """Train a network.

    Args:
        pictures: Training images.
        validation: Validation images.
        epochs: Number of passes over the training images.
        seed: Seed of the initial weights, the order of the images and the augmentation.

    Returns:
        The network, and its mAP on the validation images after each epoch.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = Network()
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload] # the stubs lack it
    average = copy.deepcopy(network)
    optimiser = torch.optim.AdamW(network.parameters(), lr=LEARNING_RATE, weight_decay=1e-4)
    count = len(pictures.truths)
    batches = count // BATCH
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, LEARNING_RATE, total_steps=max(1, epochs * batches), pct_start=0.1
    )
    validation_map: list[float] = []
    started = time.monotonic()
    for epoch in range(epochs):
        network.train()
        order = rng.permutation(count)
        total = 0.0
        for step in range(batches):
            chosen = order[step * BATCH : (step + 1) * BATCH]
            flips = rng.random(BATCH) < 0.5
            planes = pictures.planes[chosen]
            planes[flips] = planes[flips, :, ::-1]
            planes = _vary_exposure(planes, rng)
            truths = [
                _flip(pictures.truths[i]) if flip else pictures.truths[i]
                for i, flip in zip(chosen.tolist(), flips.tolist(), strict=True)
            ]
            heat, edges = network(to_tensor(planes))
            loss = detection_loss(heat, edges, make_target(truths))
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
            optimiser.step()
            schedule.step()
            total += loss.item()
            _update_average(average, network, epoch * batches + step)
        detections = detect_all(average, validation.planes)
        validation_map.append(mean_average_precision(validation.truths, detections))
        print(  # noqa: T201
            f"epoch {epoch + 1} of {epochs}: loss {total / max(1, batches):.3f}, "
            f"validation mAP {validation_map[-1]:.3f}, {time.monotonic() - started:.0f} s",
            flush=True,
        )
    return average.eval(), validation_map


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


def write_results(
    network: Network, test: TrainingSet, out: Path, *, settings: dict[str, Any], validation_map: list[float]
) -> None:
    """Write the weights and a record of the training, and print the record.

    Args:
        network: The trained network.
        test: Test images, for the metrics in the record.
        out: Output folder.
        settings: Number of images, epochs and seed.
        validation_map: mAP after each epoch.
    """
    detections = detect_all(network, test.planes)
    record = {
        **settings,
        "parameters": sum(weights.numel() for weights in network.parameters()),
        "validation_map": validation_map,
        "test_map": mean_average_precision(test.truths, detections),
        "test_average_precision": {
            LABELS[curve.label]: curve.average_precision for curve in curves(test.truths, detections)
        },
    }
    export_onnx(network, out / "brink-det-1.onnx")
    (out / "training.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(record, indent=2))  # noqa: T201

"""Trains `brink-det@1` on pictures that the simulator makes, and writes weights, figures and a record of both.

    python -m brink.sim.perception.train --out FOLDER

Pictures, start and order come from seeds and everything runs on one thread, so that a second run on the same kind of
processor gives the same weights.
"""

import argparse
import copy
import json
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch

from brink.sim.aeb.pictures import LabelledFrame, Split, labelled_frames
from brink.sim.perception.detector import INPUT_PX, Picture, decoded, fitted
from brink.sim.perception.network import Network
from brink.sim.perception.quality import Found, Truth, curves, mean_average_precision
from brink.sim.perception.targets import loss_of, target_of

FRAMES: Final = 10_000
VALIDATION_FRAMES: Final = 600
EPOCHS: Final = 12
BATCH: Final = 8
RATE: Final = 3e-3
MEMORY: Final = 0.999
"""Of the running mean of all weights, which is the network that is kept."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pictures:
    """Pictures as the network takes them.

    Attributes:
        planes: Shape ``(n, 192, 320, 3)``, uint8.
        truths: In px of the network's input.
    """

    planes: Picture
    truths: tuple[Truth, ...]


def gathered(frames: Iterator[LabelledFrame], count: int, what: str) -> Pictures:
    """Return pictures fitted to the network."""
    planes = np.empty((count, INPUT_PX[1], INPUT_PX[0], 3), np.uint8)
    truths = []
    began = time.monotonic()
    for index, frame in enumerate(frames):
        planes[index], scale = fitted(frame.picture)
        truth = frame.truth
        scaled = (truth.boxes * np.float32(scale)).astype(np.float32)
        truths.append(Truth(labels=truth.labels, boxes=scaled, ignored=truth.ignored))
        if (index + 1) % 500 == 0:
            print(f"{what}: {index + 1} of {count} pictures, {time.monotonic() - began:.0f} s", flush=True)  # noqa: T201
    return Pictures(planes=planes, truths=tuple(truths))


def _flipped(truth: Truth) -> Truth:
    boxes = truth.boxes.copy()
    boxes[:, [0, 2]] = INPUT_PX[0] - truth.boxes[:, [2, 0]]
    return Truth(labels=truth.labels, boxes=boxes, ignored=truth.ignored)


def lit_otherwise(planes: Picture, rng: np.random.Generator) -> Picture:
    """Return pictures as another camera might have exposed them: gain, offset, white balance, a little noise.

    One in three stays as it is. It is what cameras differ by, and no more than the weakest levels of contrast; every
    other perturbation stays new to the detector.
    """
    count = len(planes)
    gain = rng.uniform(0.8, 1.2, (count, 1, 1, 1)) * rng.uniform(0.93, 1.07, (count, 1, 1, 3))
    offset = rng.uniform(-20.0, 20.0, (count, 1, 1, 1))
    noise = rng.standard_normal((1, *planes.shape[1:]), np.float32) * rng.uniform(0.0, 6.0, (count, 1, 1, 1))
    changed = np.clip(planes * gain + offset + noise, 0.0, 255.0).astype(np.uint8)
    kept = rng.random(count) < 1 / 3
    changed[kept] = planes[kept]
    return changed


def tensor_of(planes: Picture) -> torch.Tensor:
    """Return pictures as the network's input, shape ``(n, 3, 192, 320)``, in [0, 1]."""
    tensor = torch.from_numpy(np.ascontiguousarray(planes.transpose(0, 3, 1, 2))).float() / 255.0
    return tensor.contiguous(memory_format=torch.channels_last)


def trained(
    pictures: Pictures, validation: Pictures, *, epochs: int, seed: int
) -> tuple[Network, list[float]]:
    """Return a trained network, and its mAP on the validation pictures after each epoch."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = Network()
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload] # the stubs lack it
    kept = copy.deepcopy(network)
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=1e-4)
    count = len(pictures.truths)
    steps = epochs * (count // BATCH)
    plan = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=max(1, steps), pct_start=0.1)
    course = []
    began = time.monotonic()
    for epoch in range(epochs):
        network.train()
        order = rng.permutation(count)
        total = 0.0
        for step in range(count // BATCH):
            chosen = order[step * BATCH : (step + 1) * BATCH]
            flips = rng.random(BATCH) < 0.5
            planes = pictures.planes[chosen]
            planes[flips] = planes[flips, :, ::-1]
            planes = lit_otherwise(planes, rng)
            truths = [
                _flipped(pictures.truths[i]) if flip else pictures.truths[i]
                for i, flip in zip(chosen.tolist(), flips.tolist(), strict=True)
            ]
            heat, edges = network(tensor_of(planes))
            loss = loss_of(heat, edges, target_of(truths))
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
            optimiser.step()
            plan.step()
            total += loss.item()
            _remember(kept, network, epoch * (count // BATCH) + step)
        course.append(mean_average_precision(validation.truths, answers(kept, validation.planes)))
        print(  # noqa: T201
            f"epoch {epoch + 1} of {epochs}: loss {total / max(1, count // BATCH):.3f}, "
            f"validation mAP {course[-1]:.3f}, {time.monotonic() - began:.0f} s",
            flush=True,
        )
    return kept.eval(), course


def _remember(kept: Network, network: Network, step: int) -> None:
    """Move the running mean a little towards the network; faster in the beginning."""
    memory = min(MEMORY, (1 + step) / (10 + step))
    with torch.no_grad():
        for mean, now in zip(kept.state_dict().values(), network.state_dict().values(), strict=True):
            if mean.dtype.is_floating_point:
                mean.mul_(memory).add_(now, alpha=1 - memory)
            else:
                mean.copy_(now)


def answers(network: Network, planes: Picture) -> list[Found]:
    """Return what a network finds in pictures."""
    network.eval()
    found = []
    with torch.no_grad():
        for start in range(0, len(planes), 32):
            heat, edges = network(tensor_of(planes[start : start + 32]))
            found += [decoded(h, e) for h, e in zip(heat.numpy(), edges.numpy(), strict=True)]
    return found


def export(network: Network, file: Path) -> None:
    """Write a network as ONNX."""
    picture = torch.zeros(1, 3, INPUT_PX[1], INPUT_PX[0])
    network.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload] # the stubs lack it
    with warnings.catch_warnings():
        # The exporter that replaces this one needs two packages more, for the same file.
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, judge on the test pictures, and write everything."""
    parser = argparse.ArgumentParser(prog="python -m brink.sim.perception.train", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for weights and figures")
    parser.add_argument("--frames", type=int, default=FRAMES, help="training pictures (%(default)s)")
    parser.add_argument("--epochs", type=int, default=EPOCHS, help="epochs (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of start and order (%(default)s)")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    torch.use_deterministic_algorithms(True)
    validation = gathered(
        labelled_frames(Split.VALIDATION, VALIDATION_FRAMES), VALIDATION_FRAMES, "validation"
    )
    pictures = gathered(labelled_frames(Split.TRAIN, given.frames), given.frames, "training")
    network, course = trained(pictures, validation, epochs=given.epochs, seed=given.seed)
    test = gathered(labelled_frames(Split.TEST, VALIDATION_FRAMES), VALIDATION_FRAMES, "test")
    found = answers(network, test.planes)
    record = {
        "frames": given.frames,
        "epochs": given.epochs,
        "seed": given.seed,
        "parameters": sum(weights.numel() for weights in network.parameters()),
        "validation_map": course,
        "test_map": mean_average_precision(test.truths, found),
        "test_average_precision": {
            ("vehicle", "person")[curve.label]: curve.average_precision
            for curve in curves(test.truths, found)
        },
    }
    export(network, given.out / "brink-det-1.onnx")
    (given.out / "training.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(record, indent=2))  # noqa: T201


if __name__ == "__main__":
    main()

"""Train `brink-det@2` on images of the emergency-braking street.

python -m brink.sim.aeb train --out FOLDER      writes brink-det-2.onnx, and brink-det-2.json about the training

A run that was interrupted goes on from its last complete epoch when it is started again. `brink bench detector`
measures the result.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Final

from brink.sim.aeb.dataset import Split, render_frames

TRAINING_FRAMES: Final = 10_000
HELD_OUT_FRAMES: Final = 600
EPOCHS: Final = (12, 8, 8)
"""Epochs in each cycle of the learning rate."""


def train(out: Path, *, frames: int, epochs: Sequence[int], seed: int) -> None:
    """Train the detector and write its weights; validation and test images are not used for training.

    Args:
        out: Output folder.
        frames: Number of training images.
        epochs: Number of epochs in each cycle of the learning rate.
        seed: Seed of the initial weights, the order of the images and the augmentation.
    """
    from brink.sim.perception import training  # loads torch

    training.make_deterministic()
    out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        validation, test, pictures = (
            training.collect(render_frames(pool, split, count), count, split.name.lower())
            for split, count in (
                (Split.VALIDATION, HELD_OUT_FRAMES), (Split.TEST, HELD_OUT_FRAMES), (Split.TRAIN, frames)
            )
        )  # fmt: skip
    settings = training.Settings(frames=frames, epochs=tuple(epochs), seed=seed)
    network, record = training.train(pictures, validation, settings, out)
    training.write_results(network, test, out, record=record)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the arguments and train."""
    parser = argparse.ArgumentParser(
        prog="python -m brink.sim.aeb",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True)
    training = commands.add_parser("train", help="train brink-det@2 and write its weights")
    training.add_argument(
        "--out", type=Path, required=True, help="output folder for the weights and their metrics"
    )
    training.add_argument(
        "--frames", type=int, default=TRAINING_FRAMES, help="number of training images (%(default)s)"
    )
    training.add_argument(
        "--epochs",
        type=int,
        nargs=len(EPOCHS),
        default=EPOCHS,
        help=f"epochs in each cycle of the learning rate ({' '.join(map(str, EPOCHS))})",
    )
    training.add_argument(
        "--seed",
        type=int,
        default=0,
        help="seed of the initial weights, image order and augmentation (%(default)s)",
    )
    train(**vars(parser.parse_args(arguments)))


if __name__ == "__main__":
    main()

"""Train and quantise `brink-det@2` on images of the emergency-braking street.

python -m benchmarks.training train --out FOLDER
    writes brink-det-2.onnx, brink-det-2-float.onnx in floating point, and brink-det-2.json about the training
python -m benchmarks.training quantise FLOAT.onnx --out FOLDER
    writes brink-det-2.onnx from the network in floating point

A run that was interrupted goes on from its last complete epoch when it is started again. `python -m benchmarks
detector` measures the result.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.training.images import render_frames
from brink.sim.aeb.dataset import Split, labelled_frames
from brink.sim.perception.boxes import mean_average_precision
from brink.sim.perception.detector import NetworkDetector, fit_picture

TRAINING_FRAMES: Final = 20_000
CALIBRATION_FRAMES: Final = 200
"""Training images that give the scales of the quantised network."""
HELD_OUT_FRAMES: Final = 600
EPOCHS: Final = 34


def train(out: Path, *, frames: int, epochs: int, seed: int) -> None:
    """Train the detector and write its weights; validation and test images are not used for training.

    Args:
        out: Output folder.
        frames: Number of training images.
        epochs: Number of epochs.
        seed: Seed of the initial weights, the order of the images and the augmentation.

    Raises:
        ValueError: A number is too small, or the output folder has the state of another training.
    """
    from benchmarks.training import trainer  # loads torch

    settings = trainer.Settings(frames=frames, epochs=epochs, seed=seed)
    trainer.make_deterministic()
    out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        validation, test, pictures = (
            trainer.collect(render_frames(pool, split, count), count, split.name.lower())
            for split, count in (
                (Split.VALIDATION, HELD_OUT_FRAMES),
                (Split.TEST, HELD_OUT_FRAMES),
                (Split.TRAIN, frames),
            )
        )
    network, record = trainer.train(pictures, validation, settings, out)
    calibration = pictures.planes[:CALIBRATION_FRAMES]
    trainer.write_results(network, test, calibration, out, record=record)


def quantise_weights(weights: Path, out: Path) -> None:
    """Quantise a trained network, and print its mAP on the test images before and after.

    Args:
        weights: ONNX file of the network in floating point.
        out: Output folder.
    """
    from benchmarks.training.quantisation import quantise  # loads onnx

    out.mkdir(parents=True, exist_ok=True)
    size_px = NetworkDetector.from_file(weights).input_px
    pictures = labelled_frames(Split.TRAIN, CALIBRATION_FRAMES)
    canvases = np.stack([fit_picture(frame.picture, size_px)[0] for frame in pictures])
    quantise(weights, canvases, out / "brink-det-2.onnx")
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        test = list(render_frames(pool, Split.TEST, HELD_OUT_FRAMES))
    for file in (weights, out / "brink-det-2.onnx"):
        detector = NetworkDetector.from_file(file)
        found = [detector.detect(frame.picture) for frame in test]
        print(f"{file}: mAP {mean_average_precision([frame.truth for frame in test], found):.4f}")  # noqa: T201


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the arguments and train."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.training",
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
    training.add_argument("--epochs", type=int, default=EPOCHS, help="number of epochs (%(default)s)")
    training.add_argument(
        "--seed",
        type=int,
        default=0,
        help="seed of the initial weights, image order and augmentation (%(default)s)",
    )
    training.set_defaults(run=train)
    quantisation = commands.add_parser("quantise", help="quantise the weights of brink-det@2")
    quantisation.add_argument("weights", type=Path, help="ONNX file of the network in floating point")
    quantisation.add_argument("--out", type=Path, required=True, help="output folder")
    quantisation.set_defaults(run=quantise_weights)
    options = vars(parser.parse_args(arguments))
    try:
        options.pop("run")(**options)
    except ValueError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")


if __name__ == "__main__":
    main()

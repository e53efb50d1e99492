"""Train or evaluate `brink-det@1` on images of the emergency-braking street.

python -m brink.sim.aeb train --out FOLDER      writes the weights and training.json
python -m brink.sim.aeb evaluate --out FOLDER   writes evaluation.json and evaluation.png
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2

from brink.sim.aeb.dataset import Split, labelled_frames

TRAINING_FRAMES: Final = 10_000
HELD_OUT_FRAMES: Final = 600
EPOCHS: Final = 12


def train(out: Path, *, frames: int, epochs: int, seed: int) -> None:
    """Train the detector and write its weights; validation and test images are not used for training.

    Args:
        out: Output folder.
        frames: Number of training images.
        epochs: Number of epochs.
        seed: Seed of the initial weights, the order of the images and the augmentation.
    """
    from brink.sim.perception import training  # loads torch

    training.make_deterministic()
    validation = training.collect(
        labelled_frames(Split.VALIDATION, HELD_OUT_FRAMES), HELD_OUT_FRAMES, "validation"
    )
    pictures = training.collect(labelled_frames(Split.TRAIN, frames), frames, "training")
    network, validation_map = training.train(pictures, validation, epochs=epochs, seed=seed)
    test = training.collect(labelled_frames(Split.TEST, HELD_OUT_FRAMES), HELD_OUT_FRAMES, "test")
    settings = {"frames": frames, "epochs": epochs, "seed": seed}
    training.write_results(network, test, out, settings=settings, validation_map=validation_map)


def evaluate(out: Path, *, detector: str, frames: int) -> None:
    """Evaluate a detector on test images and write the report.

    Args:
        out: Output folder.
        detector: Id of the detector.
        frames: Number of test images.
    """
    from brink.sim.perception.detector import find_detector  # loads onnxruntime
    from brink.sim.perception.evaluation import write_report  # loads matplotlib

    cv2.setNumThreads(1)
    write_report(detector, find_detector(detector), list(labelled_frames(Split.TEST, frames)), out)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the arguments and run `train` or `evaluate`."""
    parser = argparse.ArgumentParser(
        prog="python -m brink.sim.aeb",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True)
    training = commands.add_parser("train", help="train brink-det@1 and write its weights")
    training.set_defaults(run=train)
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
    evaluation = commands.add_parser("evaluate", help="evaluate a detector on test images")
    evaluation.set_defaults(run=evaluate)
    evaluation.add_argument("--out", type=Path, required=True, help="output folder for the metrics and plots")
    evaluation.add_argument("--detector", default="brink-det@1", help="id of the detector (%(default)s)")
    evaluation.add_argument(
        "--frames", type=int, default=HELD_OUT_FRAMES, help="number of test images (%(default)s)"
    )
    given = vars(parser.parse_args(arguments))
    given["out"].mkdir(parents=True, exist_ok=True)
    given.pop("run")(**given)


if __name__ == "__main__":
    main()

"""Time every perturbation: ``python benchmarks/perturbation_cost.py``.

Median CPU time on one thread, at the lowest, middle and highest level. Where albumentations can be imported (it is no
dependency) its equivalent is timed in the same run, at the highest level.
"""

import argparse
import importlib
import os
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from brink.sim.perturbations import CATALOGUE, Frame, Gene, Perturbation, apply, generator
from brink.sim.perturbations.pictures import draw_street

TARGET_MS = {
    "gaussian_noise": 1.0, "gaussian_blur": 6.0, "grid_dropout": 0.1, "coarse_dropout": 0.15, "snow": 5.0,
    "broken_lens": 3.0, "dirty": 3.0, "condensation": 3.0, "sun_flare": 8.0, "rain": 7.0, "smoke": 20.0,
}  # fmt: skip
"""At 1280x720. Those of the dropouts do not count a plain copy of the frame; that of blur is for its middle level."""
AT_MIDDLE = {"gaussian_blur"}
WITHOUT_COPY = {"grid_dropout", "coarse_dropout"}


def main() -> None:
    """Print a table for each size: ms at three levels, target, albumentations, ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--heights", type=int, nargs="+", default=[360, 720], help="of 16:9 frames, in px")
    parser.add_argument("--repeats", type=int, default=40, help="calls a level")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    theirs = _theirs()
    for height in arguments.heights:
        frame = draw_street(height)
        copy_ms = _copy_ms(frame, arguments.repeats)
        print(f"\n{frame.shape[1]}x{height}; a plain copy of the frame takes {copy_ms:.2f} ms")
        head = f"{'gene':<16}{'low':>8}{'middle':>8}{'top':>8}{'target':>8} {'':<7}{'theirs':>8}{'ratio':>7}"
        print(head)
        for gene in CATALOGUE.values():
            print(_row(gene, frame, theirs, copy_ms, arguments.repeats))


def _row(
    gene: Gene, frame: Frame, theirs: dict[str, Callable[[Frame], Any]], copy_ms: float, repeats: int
) -> str:
    levels = (1, gene.levels // 2, gene.levels - 1)
    ours = [_gene_ms(Perturbation(gene.name, level), frame, repeats) for level in levels]
    target, verdict = "–", ""
    if gene.name in TARGET_MS and frame.shape[0] == 720:
        counted = ours[1] if gene.name in AT_MIDDLE else max(ours)
        allowed = TARGET_MS[gene.name] + (copy_ms if gene.name in WITHOUT_COPY else 0)
        target, verdict = f"{TARGET_MS[gene.name]:g}", "met" if counted <= allowed else "MISSED"
    albumentations, ratio = "–", "–"
    if gene.name in theirs and frame.shape[0] == 720:  # their sizes in px do not scale
        ms = _median_ms(lambda _: theirs[gene.name](frame), max(5, repeats // 4))
        albumentations, ratio = f"{ms:.2f}", f"{ms / ours[-1]:.1f}"
    times = "".join(f"{ms:>8.2f}" for ms in ours)
    return f"{gene.name:<16}{times}{target:>8} {verdict:<7}{albumentations:>8}{ratio:>7}"


def _copy_ms(frame: Frame, repeats: int) -> float:
    return _median_ms(lambda _: frame.copy(), repeats)


def _gene_ms(perturbation: Perturbation, frame: Frame, repeats: int) -> float:
    return _median_ms(lambda index: apply(frame, perturbation, generator(1, 0, index)), repeats)


def _median_ms(call: Callable[[int], Any], repeats: int) -> float:
    """Return the median CPU time of a call; the first one, which fills the caches, is not counted."""
    times = []
    for index in range(repeats + 1):
        start = time.process_time_ns()
        kept = call(index)
        times.append((time.process_time_ns() - start) / 1e6)
        del kept
    return float(np.median(times[1:]))


def _theirs() -> dict[str, Callable[[Frame], Any]]:
    """Return what albumentations does for the same gene at its highest level; nothing where it is not installed."""
    os.environ["NO_ALBUMENTATIONS_UPDATE"] = "1"  # it asks the network for news on import
    try:
        library = importlib.import_module("albumentations")
    except ImportError:
        print("albumentations is not installed: its columns stay empty")
        return {}
    print(f"theirs: albumentations {library.__version__}, at the highest level; ratio: theirs / ours")
    sigma = 0.7**0.5
    transforms = {
        "gaussian_noise": library.GaussNoise(std_range=(sigma, sigma), p=1),
        "gaussian_blur": library.GaussianBlur(blur_limit=(45, 45), sigma_limit=(7.1, 7.1), p=1),
        "grid_dropout": library.GridDropout(ratio=0.5, unit_size_range=(80, 81), p=1),
        "coarse_dropout": library.CoarseDropout(
            num_holes_range=(45, 45), hole_height_range=(40, 40), hole_width_range=(40, 40), p=1
        ),
        "channel_dropout": library.ChannelDropout(channel_drop_range=(2, 2), p=1),
        "snow": library.RandomSnow(brightness_coeff=5.0, method="bleach", p=1),
        "sun_flare": library.RandomSunFlare(src_radius=900, p=1),
        "brightness": library.RandomBrightnessContrast(
            brightness_limit=(0.8, 0.8), contrast_limit=(0, 0), p=1
        ),
        "contrast": library.RandomBrightnessContrast(brightness_limit=(0, 0), contrast_limit=(0.7, 0.7), p=1),
        "rain": library.RandomRain(rain_type="torrential", p=1),
        "smoke": library.RandomFog(fog_coef_range=(0.3, 1.0), alpha_coef=0.3, p=1),
    }
    return {name: _call(transform) for name, transform in transforms.items()}


def _call(transform: Any) -> Callable[[Frame], Any]:
    return lambda frame: transform(image=frame)["image"]


if __name__ == "__main__":
    main()

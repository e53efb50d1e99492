"""CPU time on one thread of rendering a camera frame, computing its labels, and perturbing it."""

import importlib
import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import cv2
import numpy as np

from benchmarks.measurement import Row, at_most, untargeted
from benchmarks.sample_street import EGO, sample_street, sample_traffic
from brink.sim.aeb.dataset import example_picture
from brink.sim.perturbations import CATALOGUE, Frame, Gene, Perturbation, apply, generator
from brink.sim.rendering.canvas import visible_bodies
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import Light, PictureCamera, Viewpoint
from brink.sim.world.scenario import TimeOfDay, Weather

FRAME_SIZES = ((320, 192, 5.0), (640, 360, 8.0), (800, 600, None), (1280, 720, 17.0))
"""Width and height in px, and the longest allowed median time of a frame in ms."""
LIGHTS = (
    (TimeOfDay.NOON, Weather.CLEAR),
    (TimeOfDay.SUNSET, Weather.CLOUDY),
    (TimeOfDay.NIGHT, Weather.CLEAR),
    (TimeOfDay.NOON, Weather.HARD_RAIN),
    (TimeOfDay.NIGHT, Weather.HARD_RAIN),
)
GENE_TARGETS_MS = {
    "gaussian_noise": 1.0,
    "gaussian_blur": 6.0,
    "grid_dropout": 0.1,
    "coarse_dropout": 0.15,
    "snow": 5.0,
    "broken_lens": 3.0,
    "dirty": 3.0,
    "condensation": 3.0,
    "sun_flare": 8.0,
    "rain": 7.0,
    "smoke": 20.0,
}
"""Longest allowed time at 1280x720; blur counts at the middle level, dropouts without the time to copy a frame."""
AT_MIDDLE_LEVEL = {"gaussian_blur"}
BEYOND_COPY = {"grid_dropout", "coarse_dropout"}


def measure_rendering(frames: int = 60) -> Iterator[Row]:
    """Measure rendering for each size and lighting condition, with a moving ego and walking pedestrians.

    Args:
        frames: Number of frames whose median is taken.
    """
    cv2.setNumThreads(1)
    street = sample_street()
    for width_px, height_px, target_ms in FRAME_SIZES:
        for time_of_day, weather in LIGHTS:
            camera = PictureCamera(width_px=width_px, height_px=height_px)
            renderer = Renderer(street, Light(time_of_day=time_of_day, weather=weather), camera, 3)
            frame_ms, labels_ms = _frame_times(renderer, frames)
            what = f"ms a frame, {width_px} x {height_px}, {time_of_day} {weather}"
            yield at_most(what, frame_ms, target_ms, f"labels {labels_ms:.2f} ms")


def _frame_times(renderer: Renderer, frames: int) -> tuple[float, float]:
    drawing, labelling = [], []
    for number in range(-3, frames):  # three frames to warm up
        viewpoint = Viewpoint(x_m=EGO.x_m + 0.05 * number, y_m=EGO.y_m, yaw_rad=0.0)
        bodies = sample_traffic(0.1 * number)
        start = time.process_time_ns()
        frame = renderer.frame(viewpoint, bodies, 0.1 * number)
        drawn = time.process_time_ns()
        visible_bodies(frame)
        labelled = time.process_time_ns()
        if number >= 0:
            drawing.append((drawn - start) / 1e6)
            labelling.append((labelled - drawn) / 1e6)
    return statistics.median(drawing), statistics.median(labelling)


def measure_perturbations(heights_px: Sequence[int] = (360, 720), repeats: int = 40) -> Iterator[Row]:
    """Measure every perturbation and, if albumentations is installed, its equivalent there.

    Args:
        heights_px: Heights of 16:9 frames.
        repeats: Number of calls at each level.
    """
    cv2.setNumThreads(1)
    theirs, street = _albumentations(), example_picture()
    for height_px in heights_px:
        size_px = round(street.shape[1] * height_px / street.shape[0]), height_px
        frame = cv2.resize(street, size_px, interpolation=cv2.INTER_AREA).astype(np.uint8)
        copy_ms = _copy_ms(frame, repeats)
        for gene in CATALOGUE.values():
            yield _gene_row(gene, frame, theirs.get(gene.name), copy_ms, repeats)


def _gene_row(
    gene: Gene, frame: Frame, theirs: Callable[..., Any] | None, copy_ms: float, repeats: int
) -> Row:
    """Return the time at the highest level, with the target if the frame has 720 rows."""
    levels = (1, gene.levels // 2, gene.levels - 1)
    low_ms, middle_ms, top_ms = (
        _level_ms(Perturbation(gene.name, level), frame, repeats) for level in levels
    )
    note = f"lowest level {low_ms:.2f}, middle {middle_ms:.2f}"
    what, has_targets = f"ms of {gene.name}, {frame.shape[0]} px", frame.shape[0] == 720
    if theirs is not None and has_targets:  # their sizes in px do not scale with the frame
        theirs_ms = _median_ms(lambda _: theirs(image=frame), max(5, repeats // 4))
        note += f"; albumentations {theirs_ms:.2f}, {theirs_ms / top_ms:.1f} times as long"
    target_ms = GENE_TARGETS_MS.get(gene.name) if has_targets else None
    if target_ms is None:
        return untargeted(what, top_ms, note)
    judged_ms = middle_ms if gene.name in AT_MIDDLE_LEVEL else max(low_ms, middle_ms, top_ms)
    bound_ms = target_ms + (copy_ms if gene.name in BEYOND_COPY else 0.0)
    return Row(what=what, value=top_ms, target=f"at most {target_ms:g}", met=judged_ms <= bound_ms, note=note)


def _level_ms(perturbation: Perturbation, frame: Frame, repeats: int) -> float:
    return _median_ms(lambda index: apply(frame, perturbation, generator(1, 0, index)), repeats)


def _copy_ms(frame: Frame, repeats: int) -> float:
    return _median_ms(lambda _: frame.copy(), repeats)


def _median_ms(call: Callable[[int], Any], repeats: int) -> float:
    """Return the median CPU time of a call in ms, without the first call, which fills caches."""
    times_ms = []
    for index in range(repeats + 1):
        start = time.process_time_ns()
        result = call(index)
        times_ms.append((time.process_time_ns() - start) / 1e6)
        del result  # outside the measured time
    return statistics.median(times_ms[1:])


def _albumentations() -> dict[str, Callable[..., Any]]:
    """Return the albumentations equivalents of genes at their highest level; empty if it is not installed."""
    os.environ["NO_ALBUMENTATIONS_UPDATE"] = "1"  # it looks for updates on import
    try:
        library = importlib.import_module("albumentations")
    except ImportError:
        return {}
    sigma = 0.7**0.5
    return {
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

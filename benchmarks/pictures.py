"""CPU time on one thread of rendering a camera frame, computing its labels, and perturbing it."""

import importlib
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

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


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTime:
    """Median CPU times of rendering a frame and computing its labels.

    Attributes:
        width_px: Width of the frame.
        height_px: Height of the frame.
        light: Time of day and weather.
        frame_ms: Time of the picture.
        labels_ms: Time of its labels.
        target_ms: Longest allowed time of the picture, or None.
    """

    width_px: int
    height_px: int
    light: str
    frame_ms: float
    labels_ms: float
    target_ms: float | None

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without a target."""
        return None if self.target_ms is None else self.frame_ms <= self.target_ms


def measure_rendering(frames: int = 60) -> list[FrameTime]:
    """Measure rendering for each size and lighting condition, with a moving ego and walking pedestrians.

    Args:
        frames: Number of frames whose median is taken.
    """
    cv2.setNumThreads(1)
    street = sample_street()
    found = []
    for width_px, height_px, target_ms in FRAME_SIZES:
        for time_of_day, weather in LIGHTS:
            camera = PictureCamera(width_px=width_px, height_px=height_px)
            renderer = Renderer(street, Light(time_of_day=time_of_day, weather=weather), camera, 3)
            frame_ms, labels_ms = _frame_times(renderer, frames)
            found.append(
                FrameTime(
                    width_px=width_px,
                    height_px=height_px,
                    light=f"{time_of_day} {weather}",
                    frame_ms=frame_ms,
                    labels_ms=labels_ms,
                    target_ms=target_ms,
                )
            )
    return found


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


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneTime:
    """Median CPU time of a perturbation.

    Attributes:
        height_px: Height of the 16:9 frame.
        gene: Name of the gene.
        low_ms: Time at the lowest level.
        middle_ms: Time at the middle level.
        top_ms: Time at the highest level.
        target_ms: Longest allowed time, or None.
        met: Whether the target is met; None without a target.
        albumentations_ms: Time of the albumentations equivalent at the highest level, or None.
    """

    height_px: int
    gene: str
    low_ms: float
    middle_ms: float
    top_ms: float
    target_ms: float | None
    met: bool | None
    albumentations_ms: float | None

    @property
    def ratio(self) -> float | None:
        """Time of the albumentations equivalent divided by that of the perturbation; None if it was not measured."""
        return None if self.albumentations_ms is None else self.albumentations_ms / self.top_ms


def measure_perturbations(heights_px: Sequence[int] = (360, 720), repeats: int = 40) -> list[GeneTime]:
    """Measure every perturbation and, if albumentations is installed, its equivalent there.

    Args:
        heights_px: Heights of 16:9 frames.
        repeats: Number of calls at each level.
    """
    cv2.setNumThreads(1)
    theirs, street = _albumentations(), example_picture()
    found = []
    for height_px in heights_px:
        size_px = round(street.shape[1] * height_px / street.shape[0]), height_px
        frame = cv2.resize(street, size_px, interpolation=cv2.INTER_AREA).astype(np.uint8)
        copy_ms = _copy_ms(frame, repeats)
        found += [
            _gene_time(gene, frame, theirs.get(gene.name), copy_ms, repeats) for gene in CATALOGUE.values()
        ]
    return found


def _gene_time(
    gene: Gene, frame: Frame, theirs: Callable[..., Any] | None, copy_ms: float, repeats: int
) -> GeneTime:
    levels = (1, gene.levels // 2, gene.levels - 1)
    low_ms, middle_ms, top_ms = (
        _level_ms(Perturbation(gene.name, level), frame, repeats) for level in levels
    )
    has_targets = frame.shape[0] == 720
    target_ms = GENE_TARGETS_MS.get(gene.name) if has_targets else None
    met = albumentations_ms = None
    if target_ms is not None:
        measured_ms = middle_ms if gene.name in AT_MIDDLE_LEVEL else max(low_ms, middle_ms, top_ms)
        met = measured_ms <= target_ms + (copy_ms if gene.name in BEYOND_COPY else 0.0)
    if theirs is not None and has_targets:  # their sizes in px do not scale with the frame
        albumentations_ms = _median_ms(lambda _: theirs(image=frame), max(5, repeats // 4))
    return GeneTime(
        height_px=frame.shape[0],
        gene=gene.name,
        low_ms=low_ms,
        middle_ms=middle_ms,
        top_ms=top_ms,
        target_ms=target_ms,
        met=met,
        albumentations_ms=albumentations_ms,
    )


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

"""Videos: frames as a GIF or as H.264 in MP4, ten per simulated second, so that they play in real time."""

import os
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, Final, Protocol, TypeAlias

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from brink.pictures.style import TELLING

ProgressCallback: TypeAlias = Callable[[int, int], None]
"""Called with the number of frames drawn and the total."""

FRAMES_PER_S: Final = 10
HOLD_S: Final = 1.0
"""How long the last frame is held."""
GIF_COLOURS: Final = 96
MP4_QUALITY: Final = "23"
"""Constant rate factor of x264: flat drawings need no higher quality."""
MOST_FRAMES: Final = 3000


class Painter(Protocol):
    """Draws the frames of a film."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the frames in pixels."""

    @property
    def time_s(self) -> NDArray[np.floating[Any]]:
        """Times of the samples, ascending, shape ``(n,)``."""

    @property
    def key_samples(self) -> list[int]:
        """Samples that together contain all colours of the film."""

    def frame(self, sample: int) -> Image.Image:
        """Return the frame at a sample as an RGB image."""


def film_samples(painter: Painter) -> list[int]:
    """Return the sample that each frame shows: one every tenth of a second, the last one held for a second."""
    time_s = np.asarray(painter.time_s, dtype=np.float64)
    count = min(MOST_FRAMES, round((time_s[-1] - time_s[0]) * FRAMES_PER_S) + 1)
    wanted = time_s[0] + np.arange(count) / FRAMES_PER_S
    # Float32 times lie slightly off the grid: take the nearest sample, not the next.
    right = np.clip(np.searchsorted(time_s, wanted), 1, max(1, len(time_s) - 1))
    right = np.minimum(right, len(time_s) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(wanted - time_s[left] <= time_s[right] - wanted, left, right)
    samples: list[int] = nearest.tolist()
    return samples + samples[-1:] * round(HOLD_S * FRAMES_PER_S)


def write_mp4(painter: Painter, path: Path, on_progress: ProgressCallback | None = None) -> None:
    """Write the video of an episode as MP4: H.264, yuv420p, index first, so that browsers can play it at once.

    Args:
        painter: Draws the frames.
        path: The file.
        on_progress: Called after each frame.
    """
    width, height = painter.size
    with av.open(os.fspath(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=FRAMES_PER_S)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": MP4_QUALITY, "preset": "veryfast", "tune": "animation"}
        stream.thread_count = 1
        for index, image in enumerate(_frames(painter, on_progress)):
            frame = av.VideoFrame.from_ndarray(np.asarray(image), format="rgb24")
            frame.pts, frame.time_base = index, Fraction(1, FRAMES_PER_S)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def write_gif(painter: Painter, path: Path, on_progress: ProgressCallback | None = None) -> None:
    """Write the video of an episode as a looping GIF with one palette for all frames.

    Args:
        painter: Draws the frames.
        path: The file.
        on_progress: Called after each frame.
    """
    palette = _film_palette(painter)
    frames = (
        image.quantize(palette=palette, dither=Image.Dither.NONE) for image in _frames(painter, on_progress)
    )
    first = next(frames)
    first.save(
        path,
        format="GIF",
        save_all=True,
        append_images=frames,
        duration=1000 // FRAMES_PER_S,
        loop=0,
        optimize=False,
    )


def _film_palette(painter: Painter) -> Image.Image:
    """Return one palette, so that colours do not flicker: the commonest of the key samples, and those that tell."""
    pictures = [painter.frame(sample) for sample in painter.key_samples]
    width, height = painter.size
    sheet = Image.new("RGB", (width, height * len(pictures)))
    for index, picture in enumerate(pictures):
        sheet.paste(picture, (0, index * height))
    common = sheet.quantize(colors=GIF_COLOURS, method=Image.Quantize.MEDIANCUT).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*common[: 3 * GIF_COLOURS], *chain.from_iterable(TELLING)])
    return palette


def _frames(painter: Painter, on_progress: ProgressCallback | None) -> Iterator[Image.Image]:
    samples = film_samples(painter)
    last: tuple[int, Image.Image] | None = None
    for done, sample in enumerate(samples, start=1):
        if last is None or last[0] != sample:
            last = (sample, painter.frame(sample))
        yield last[1]
        if on_progress is not None:
            on_progress(done, len(samples))

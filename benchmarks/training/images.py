"""Rendering of labelled images for training, by several processes."""

from collections.abc import Iterator
from concurrent.futures import Executor
from itertools import chain
from typing import Final

import cv2

from brink.sim.aeb.dataset import FRAMES_A_STREET, SIZE_PX, Split, labelled_frames
from brink.sim.perception.boxes import LabelledFrame

SMALL_SHARE: Final = 4
"""One image in this many has half the size, for cameras with fewer pixels."""


def render_frames(pool: Executor, split: Split, count: int) -> Iterator[LabelledFrame]:
    """Yield labelled images rendered by several processes, first those of full size, then some of half the size.

    Args:
        pool: Processes, or threads.
        split: One of the three disjoint sets.
        count: Number of images.
    """
    small = count // SMALL_SHARE
    jobs = [
        (split, min(FRAMES_A_STREET, part - start), seed, width_px, start // FRAMES_A_STREET)
        for part, seed, width_px in ((count - small, 0, SIZE_PX[0]), (small, 1, SIZE_PX[0] // 2))
        for start in range(0, part, FRAMES_A_STREET)
    ]
    return chain.from_iterable(pool.map(_render_street, jobs))


def _render_street(job: tuple[Split, int, int, int, int]) -> list[LabelledFrame]:
    """Return the images of one street, given split, number of images, seed, width in px and number of the street."""
    split, count, seed, width_px, street = job
    cv2.setNumThreads(1)
    return list(labelled_frames(split, count, seed, width_px=width_px, first_street=street))

"""Smoke: white discs, densest at the centre, in closed form.

Laying n discs of opacity a over a pixel, one after the other, leaves ``(1 - a)^n`` of it; so it is enough to count
the discs over each pixel. Each disc adds 1 at the left end of every row that it covers and takes it back at the right
end; running sums along the rows are the counts.
"""

from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from brink.sim.perturbations.gene import Frame
from brink.sim.perturbations.layers import Field, enlarge, lay_white_over, scale_of, to_layer

DISCS = 110
SMALLEST, LARGEST = 0.05, 0.22
"""Radius of a disc in widths of the frame, before it is scaled by the density c."""
THINNEST, DENSEST = 0.3, 1.0
GRID_PX = 4
"""Discs are counted on every so manieth pixel, and their edges softened over about two of these steps."""

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]


def smoke(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    """Return ``frame T + 255 (1 - T)`` with ``T = (1 - value c)^N``, N discs over a pixel and c drawn in [0.3, 1]."""
    density = rng.uniform(THINNEST, DENSEST)
    height, width = frame.shape[:2]
    centres, radii = draw_discs(height, width, density, rng)
    step = max(1, round(GRID_PX * scale_of(frame)))
    grid = (-(-height // step), -(-width // step))
    counts = count_discs(grid, centres / step, radii / step)
    through = ((1 - value * density) ** np.arange(counts.max() + 1)).astype(np.float32)[counts]
    soft = cast(Field, cv2.GaussianBlur(through, (0, 0), 2.0))
    return lay_white_over(frame, to_layer(enlarge(soft, (height, width))))


def draw_discs(
    height: int, width: int, density: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return centres ``(n, 2)`` as x and y, and radii ``(n,)``, in px; the denser, the larger.

    The product of two uniform numbers lies near zero more often than either: that heaps the discs at the centre.
    """
    spread = rng.uniform(-1, 1, size=(DISCS, 2)) * rng.uniform(0.2, 1, size=(DISCS, 1))
    centres = (0.5 + 0.6 * spread) * (width, height)
    radii = rng.uniform(SMALLEST, LARGEST, size=DISCS) * width * (0.4 + 0.6 * density)
    return centres, radii


def count_discs(shape: tuple[int, int], centres: FloatArray, radii: FloatArray) -> IntArray:
    """Return how many discs cover each pixel of a grid.

    Args:
        shape: ``(height, width)`` of the grid.
        centres: x and y of the discs, shape ``(n, 2)``.
        radii: Radii of the discs, shape ``(n,)``.

    Returns:
        Counts, shape ``(height, width)``. A disc covers the pixels whose row it meets and whose column lies within
        the half chord of that row.
    """
    height, width = shape
    rows = np.arange(height)
    half_squared = radii[:, None] ** 2 - (rows[None, :] - centres[:, 1:]) ** 2
    disc, row = np.nonzero(half_squared >= 0)
    half = np.sqrt(half_squared[disc, row])
    begin = np.clip(np.ceil(centres[disc, 0] - half), 0, width).astype(np.int64)
    end = np.clip(np.floor(centres[disc, 0] + half) + 1, 0, width).astype(np.int64)
    end = np.maximum(begin, end)
    size = height * (width + 1)
    change = np.bincount(row * (width + 1) + begin, minlength=size)
    change -= np.bincount(row * (width + 1) + end, minlength=size)
    return np.cumsum(change.reshape(height, width + 1), axis=1)[:, :width]

"""The ground of a map: the unsafe share that neighbourhoods nearby suggest, and where too little is known to tell.

A neighbourhood tells something about the boundary if its interval lies on one side of the threshold probability, or
if it has both verdicts. Few neighbours that are all safe tell nothing: more of them could still turn out unsafe.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.search.analysis.boundary import has_evidence
from brink.search.archive import Archive
from brink.search.space import BoolArray, FloatArray

CLEAR: Final = 1.2
"""Summed weight of the solutions nearby at which the ground has its full colour."""
FAINT: Final = 0.35
"""How clear the ground is where simulations nearby do not tell on which side of the boundary it lies."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """A grid over a part of a map; rows go up, columns to the right.

    Attributes:
        low: Left and lower edge, shape ``(2,)``.
        high: Right and upper edge, shape ``(2,)``.
        tint: Smoothed unsafe share on a scale with p_th in the middle: 0 safe, 0.5 on the boundary, 1 unsafe, shape
            ``(rows, columns)``.
        clarity: How much is known there, from 0 (nothing was simulated nearby) to 1, shape ``(rows, columns)``.
    """

    low: FloatArray
    high: FloatArray
    tint: FloatArray
    clarity: FloatArray


def is_telling(archive: Archive) -> BoolArray:
    """Return which neighbourhoods are conclusive: on one side of the boundary or on it, shape ``(n,)``."""
    p_th = archive.neighbourhood.p_th
    aside: BoolArray = (archive.interval[:, 0] > p_th) | (archive.interval[:, 1] < p_th)
    return aside | has_evidence(archive)


def tint_of(share: FloatArray, p_th: float) -> FloatArray:
    """Return unsafe shares on a scale from 0 to 1 with the threshold probability in the middle."""
    return np.where(share < p_th, 0.5 * share / p_th, 0.5 + 0.5 * (share - p_th) / (1 - p_th))


def ground_of(
    archive: Archive,
    rows: NDArray[np.intp],
    points: FloatArray,
    *,
    low: FloatArray,
    high: FloatArray,
    cells: int,
    width: float,
) -> Ground:
    """Return the ground of a map.

    Args:
        archive: The evaluated solutions.
        rows: Those on the map, as positions in the archive, shape ``(n,)``.
        points: Their positions on the map, shape ``(n, 2)``.
        low: Left and lower edge of the ground, shape ``(2,)``.
        high: Right and upper edge, shape ``(2,)``.
        cells: Number of cells along the longer side.
        width: Width of the smoothing kernel, in the units of the map.
    """
    extent = high - low
    side = float(extent.max())
    columns, lines = (max(2, round(cells * float(one) / side)) for one in extent)
    x, y = np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], lines)
    # The kernel is separable, so the sums are matrix products.
    along = np.exp(-0.5 * ((x[:, None] - points[:, 0]) / width) ** 2)
    across = np.exp(-0.5 * ((y[:, None] - points[:, 1]) / width) ** 2)
    weight = across @ along.T
    share = archive.unsafe_neighbours[rows] / archive.neighbours[rows]
    smooth, told = (
        (across * values) @ along.T / np.maximum(weight, 1e-12)
        for values in (share, is_telling(archive)[rows].astype(np.float64))
    )
    return Ground(
        low=low,
        high=high,
        tint=tint_of(smooth, archive.neighbourhood.p_th),
        clarity=np.clip(weight / CLEAR, 0, 1) * (FAINT + (1 - FAINT) * told),
    )

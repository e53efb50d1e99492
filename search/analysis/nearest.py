"""The evaluated solutions nearest to one of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brink.search.archive import Archive
from brink.search.component import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nearest:
    """Solutions near another one, nearest first.

    Attributes:
        places: Positions in the archive, shape ``(k,)``.
        distances: To the other one, shape ``(k,)``.
    """

    places: NDArray[np.intp]
    distances: FloatArray


def nearest(archive: Archive, place: int, most: int) -> Nearest:
    """Return the solutions nearest to one, itself left out; of those equally near, the lower number first.

    It measures one row of distances: 100,000 solutions take a tenth of a second.

    Args:
        archive: All evaluated solutions.
        place: Position of the one.
        most: How many at most, >= 0.
    """
    distances = archive.distances([place], np.arange(len(archive)))[0]
    others = np.flatnonzero(np.arange(len(archive)) != place)
    if 0 < most < others.size:
        farthest = np.partition(distances[others], most - 1)[most - 1]
        others = others[distances[others] <= farthest]
    order = others[np.lexsort((archive.numbers[others], distances[others]))][:most]
    return Nearest(places=order, distances=distances[order])

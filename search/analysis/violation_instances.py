"""Distinct instances of one type of violation: clusters of scaled circumstances.

Source: Ester, Kriegel, Sander, Xu, "A density-based algorithm for discovering clusters in large spatial databases
with noise" (DBSCAN), KDD 1996.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

NEIGHBOURS: Final = 3
"""Members of a dense place (min_samples), itself included."""

REACH: Final = 1.0
"""Neighbours are no farther (eps), in scaled circumstances: each of these differences alone is one unit."""

_SPEED_MPS, _TURN_RAD, _WAY_M = 3.0, 0.5, 10.0


def scaled_circumstances(violation: Mapping[str, Any]) -> list[float]:
    """Return speeds, directions and the place of a violation in units in which they compare."""
    ego, other = violation["ego"], violation["other"]
    numbers = [ego["speed_mps"] / _SPEED_MPS, violation["place"]["station_m"] / _WAY_M]
    if other is None:
        return [*numbers, 0.0, 0.0, 0.0, 0.0, 0.0]
    bearing, heading = other["bearing_rad"], other["heading_rad"]
    return [
        *numbers,
        other["speed_mps"] / _SPEED_MPS,
        math.cos(bearing) / _TURN_RAD,
        math.sin(bearing) / _TURN_RAD,
        math.cos(heading) / _TURN_RAD,
        math.sin(heading) / _TURN_RAD,
    ]


def dbscan(
    points: NDArray[np.float64], reach: float = REACH, neighbours: int = NEIGHBOURS
) -> NDArray[np.int64]:
    """Return the cluster of each point, counting from 0; -1 for noise.

    Args:
        points: Shape ``(n, d)``.
        reach: Largest distance of neighbours (eps).
        neighbours: Neighbours that make a point a core, itself included (min_samples).
    """
    count = len(points)
    labels = np.full(count, -1, np.int64)
    if not count:
        return labels
    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray").astype(np.int64)
    core = 1 + np.bincount(pairs.ravel(), minlength=count) >= neighbours
    links = pairs[core[pairs].all(axis=1)]
    graph = csr_array((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(count, count))
    component = connected_components(graph, directed=False)[1]
    numbers: dict[int, int] = {}
    for point in np.flatnonzero(core).tolist():
        labels[point] = numbers.setdefault(int(component[point]), len(numbers))
    for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():
        for border, inner in ((first, second), (second, first)):
            if core[inner] and not core[border] and labels[border] < 0:
                labels[border] = labels[inner]
    return labels


def instances(violations: Sequence[Mapping[str, Any]]) -> int:
    """Return how many distinct instances violations of one type are: clusters, and what belongs to none."""
    labels = dbscan(np.array([scaled_circumstances(violation) for violation in violations]))
    return int(labels.max(initial=-1) + 1 + np.count_nonzero(labels < 0))

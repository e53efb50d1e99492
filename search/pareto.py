"""Pareto dominance: ranks, crowding distances, the survivors of a generation. All objectives are minimised.

Source: Deb, Pratap, Agarwal, Meyarivan, "A Fast and Elitist Multiobjective Genetic Algorithm: NSGA-II",
IEEE Transactions on Evolutionary Computation 6(2), 2002.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.search.component import BoolArray, FloatArray

IntArray: TypeAlias = NDArray[np.int64]


def dominates(objectives: FloatArray) -> BoolArray:
    """Return whether row i dominates row j: nowhere worse, somewhere better.

    Args:
        objectives: Shape ``(n, m)``, no NaN; infinity stands for the worst.

    Returns:
        Shape ``(n, n)``.

    Raises:
        ValueError: The shape is wrong, or there is a NaN.
    """
    if objectives.ndim != 2 or np.isnan(objectives).any():
        raise ValueError(f"expected rows of objectives without NaN, got shape {objectives.shape}")
    first, second = objectives[:, None, :], objectives[None, :, :]
    return np.asarray((first <= second).all(axis=2) & (first < second).any(axis=2))


def ranks(objectives: FloatArray) -> IntArray:
    """Return the non-dominated front of each row, 0 for the best (fast non-dominated sort).

    Args:
        objectives: Shape ``(n, m)``.

    Returns:
        Shape ``(n,)``.
    """
    beats = dominates(objectives)
    beaten_by = beats.sum(axis=0)
    front = np.full(len(objectives), -1, np.int64)
    rank = 0
    while (front < 0).any():
        here = (beaten_by == 0) & (front < 0)
        front[here] = rank
        beaten_by = beaten_by - beats[here].sum(axis=0)
        rank += 1
    return front


def first_front(first: FloatArray, second: FloatArray) -> IntArray:
    """Return the positions of the points that nobody dominates, ascending by the first of two objectives.

    Sorts and sweeps, so that it does for any number of points.

    Args:
        first: Minimised, no NaN, shape ``(n,)``.
        second: Minimised, no NaN, shape ``(n,)``.
    """
    order = np.lexsort((second, first))
    kept: list[int] = []
    for place in order.tolist():
        same = kept and (first[kept[-1]], second[kept[-1]]) == (first[place], second[place])
        if not kept or same or second[place] < second[kept[-1]]:
            kept.append(place)
    return np.array(kept, np.int64)


def crowding(objectives: FloatArray) -> FloatArray:
    """Return the crowding distance of each row of one front; infinite at the ends of every objective.

    An objective in which all rows agree, or that is infinite somewhere, tells nothing apart and adds nothing.

    Args:
        objectives: Shape ``(n, m)``.

    Returns:
        Shape ``(n,)``.
    """
    count = len(objectives)
    if count <= 2:
        return np.full(count, np.inf)
    distances = np.zeros(count)
    for values in objectives.T:
        if not np.isfinite(values).all():
            continue
        order = np.argsort(values, kind="stable")
        spread = values[order[-1]] - values[order[0]]
        if spread == 0:
            continue
        distances[order[[0, -1]]] = np.inf
        distances[order[1:-1]] += (values[order[2:]] - values[order[:-2]]) / spread
    return distances


def ranks_and_crowding(objectives: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the front of each row, and its crowding distance in that front."""
    front = ranks(objectives)
    distances = np.zeros(len(objectives))
    for rank in range(int(front.max(initial=-1)) + 1):
        here = front == rank
        distances[here] = crowding(objectives[here])
    return front, distances


def survivors(objectives: FloatArray, count: int) -> IntArray:
    """Return the positions of the best rows, best first: by front, then the least crowded, then the elder.

    Args:
        objectives: Shape ``(n, m)``.
        count: How many; all if there are fewer.
    """
    front, distances = ranks_and_crowding(objectives)
    return np.lexsort((-distances, front))[:count]

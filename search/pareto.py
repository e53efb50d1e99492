"""Pareto dominance: fronts, crowding distances and survival. All objectives are minimised.

Source: Deb, Pratap, Agarwal, Meyarivan, "A Fast and Elitist Multiobjective Genetic Algorithm: NSGA-II",
IEEE Transactions on Evolutionary Computation 6(2), 2002.
"""

import numpy as np

from brink.search.space import BoolArray, FloatArray, IntArray


def dominates(objectives: FloatArray) -> BoolArray:
    """Return whether row i dominates row j: no objective is worse, and at least one is better.

    Args:
        objectives: Shape ``(n, m)``, no NaN; infinity is the worst value.

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

    Raises:
        ValueError: The shape is wrong, or there is a NaN.
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
    """Return the positions of the non-dominated points of two objectives, ascending by the first.

    Sorts and sweeps, so it scales to any number of points.

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

    An objective that is constant, or infinite in any row, adds nothing.

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
    """Return the front of each row and its crowding distance within that front, both of shape ``(n,)``."""
    front = ranks(objectives)
    distances = np.zeros(len(objectives))
    for rank in range(int(front.max(initial=-1)) + 1):
        here = front == rank
        distances[here] = crowding(objectives[here])
    return front, distances


def survivors(objectives: FloatArray, count: int) -> IntArray:
    """Return the positions of the best rows, best first: by front, then least crowded, then lowest position.

    Args:
        objectives: Shape ``(n, m)``.
        count: Number of survivors; all rows if there are fewer.
    """
    front, distances = ranks_and_crowding(objectives)
    return np.lexsort((-distances, front))[:count]

"""The ground of a map: what its colours say, and where it says that too little is known."""

import numpy as np
import pytest

from brink.search.analysis.ground import FAINT, Ground, ground_of, is_telling
from brink.search.archive import Archive, Neighbourhood
from brink.search.space import Component, FloatArray, Real, SearchSpace

SPACE = SearchSpace(components=(Component(name="place", parameters=(Real("x", 0, 10), Real("y", 0, 10))),))
P_TH = 0.1


def ground(clusters: dict[tuple[float, float], tuple[int, int]]) -> tuple[Archive, Ground]:
    """Return the ground of clusters of solutions, each with its number of solutions and of unsafe ones."""
    rows, unsafe = [], []
    for place, (count, violating) in clusters.items():
        rows += [place] * count
        unsafe += [True] * violating + [False] * (count - violating)
    points = np.array(rows, np.float64)
    near = Neighbourhood(radius=0.01, p_th=P_TH)
    archive = Archive.empty(SPACE, near).grown(np.arange(len(rows)), points, unsafe, np.zeros(len(rows)))
    low, high = np.zeros(2), np.full(2, 10.0)
    return archive, ground_of(archive, np.arange(len(rows)), points, low=low, high=high, cells=101, width=0.2)


def at(grid: FloatArray, x: float, y: float) -> float:
    return float(grid[round(10 * y), round(10 * x)])


def test_few_safe_neighbours_are_unknown_and_neither_safe_nor_on_the_boundary() -> None:
    archive, found = ground({(2.0, 2.0): (10, 0), (8.0, 8.0): (60, 0)})
    assert is_telling(archive).tolist() == [False] * 10 + [True] * 60
    assert at(found.clarity, 2, 2) == pytest.approx(FAINT)
    assert at(found.clarity, 8, 8) == pytest.approx(1)
    assert at(found.tint, 8, 8) == pytest.approx(0)


def test_boundary_and_unsafe_region_are_clear_with_few_neighbours_of_both_verdicts() -> None:
    _, found = ground({(2.0, 2.0): (10, 1), (8.0, 8.0): (10, 9)})
    assert (at(found.clarity, 2, 2), at(found.clarity, 8, 8)) == pytest.approx((1, 1))
    assert at(found.tint, 2, 2) == pytest.approx(0.5)
    assert at(found.tint, 8, 8) > 0.9

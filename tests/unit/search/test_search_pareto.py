"""Non-dominated sorting and crowding, against the definition and against pymoo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray
from pymoo.operators.survival.rank_and_crowding.metrics import calc_crowding_distance
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting

from brink.search.pareto import crowding, dominates, first_front, ranks, ranks_and_crowding, survivors

Rows = NDArray[np.float64]

coarse = arrays(
    np.float64,
    array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12),
    elements=st.integers(0, 4).map(float),
)
"""Rows with many ties."""


@given(coarse)
def test_fronts_are_those_of_pymoo(rows: Rows) -> None:
    fronts = NonDominatedSorting().do(rows)
    expected = np.empty(len(rows), np.int64)
    for rank, front in enumerate(fronts):
        expected[front] = rank
    assert ranks(rows).tolist() == expected.tolist()


@pytest.mark.parametrize("seed", range(20))
def test_crowding_is_that_of_pymoo_where_no_two_rows_tie(seed: int) -> None:
    rows = np.random.default_rng(seed).random((15, 3))
    ours, theirs = crowding(rows), calc_crowding_distance(rows)
    inner = np.isfinite(ours)
    assert inner.tolist() == np.isfinite(theirs).tolist()
    # pymoo divides by the number of objectives.
    assert ours[inner] == pytest.approx(3 * theirs[inner])


@given(coarse)
def test_nobody_in_a_front_is_dominated_from_the_same_or_a_later_one(rows: Rows) -> None:
    front, beats = ranks(rows), dominates(rows)
    for loser in range(len(rows)):
        winners = np.flatnonzero(beats[:, loser])
        assert all(front[winner] < front[loser] for winner in winners)
        if front[loser] > 0:
            assert front[loser] - 1 in front[winners]


@given(arrays(np.float64, st.tuples(st.integers(0, 15), st.just(2)), elements=st.integers(0, 4).map(float)))
def test_the_first_front_of_two_objectives_is_that_of_all_fronts(rows: Rows) -> None:
    found = first_front(rows[:, 0], rows[:, 1])
    assert sorted(found.tolist()) == np.flatnonzero(ranks(rows) == 0).tolist()
    assert (np.diff(rows[found, 0]) >= 0).all()


def test_crowding_of_a_known_front() -> None:
    # Spread 4 and 8: the inner ones get (2/4 + 6/8) and (3/4 + 4/8).
    rows = np.array([[0.0, 8.0], [1.0, 4.0], [2.0, 2.0], [4.0, 0.0]])
    assert crowding(rows).tolist() == [np.inf, 1.25, 1.25, np.inf]


def test_an_objective_without_spread_or_with_infinity_adds_nothing() -> None:
    rows = np.array([[0.0, 7.0], [1.0, 7.0], [3.0, 7.0], [4.0, 7.0]])
    assert crowding(rows).tolist() == [np.inf, 0.75, 0.75, np.inf]
    assert crowding(np.array([[np.inf, 1.0], [2.0, 1.0], [np.inf, 1.0]])).tolist() == [0.0, 0.0, 0.0]


def test_survivors_are_the_first_fronts_then_the_least_crowded_then_the_elders() -> None:
    rows = np.array([[5.0, 5.0], [0.0, 4.0], [1.0, 3.0], [1.1, 2.9], [4.0, 0.0], [5.0, 5.0]])
    assert survivors(rows, 3).tolist() == [1, 4, 3]
    assert survivors(rows, 9).tolist() == [1, 4, 3, 2, 0, 5]


@given(coarse, st.integers(0, 15))
def test_survivors_never_lose_to_those_that_went(rows: Rows, count: int) -> None:
    front, distances = ranks_and_crowding(rows)
    kept = survivors(rows, count)
    gone = sorted(set(range(len(rows))) - set(kept.tolist()))
    assert len(kept) == min(count, len(rows)) == len(set(kept.tolist()))
    for winner in kept:
        for loser in gone:
            assert (front[winner], -distances[winner]) <= (front[loser], -distances[loser])


def test_what_is_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError, match="without NaN"):
        ranks(np.array([[0.0, np.nan]]))

"""Selection and variation: tournaments, crossover, mutation, and Pareto survival compared with pymoo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray
from pymoo.operators.survival.rank_and_crowding.metrics import calc_crowding_distance
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting

from brink.search.operators import crossed, mutated, offspring, tournament
from brink.search.pareto import crowding, dominates, first_front, ranks, ranks_and_crowding, survivors
from brink.search.space import Categorical, Component, Dormant, Integer, Real
from brink.search.testing import example_spaces

BEHAVIOUR = example_spaces()["mixed"].components[1]


def test_tournament_favours_the_smallest_fitness() -> None:
    fitness = np.array([0.9, 0.1, 0.5, 0.7])
    rng = np.random.default_rng(0)
    wins = np.bincount([tournament(fitness, 3, rng) for _ in range(4000)], minlength=4) / 4000
    # Of n ranked individuals the one with r better ones wins a tournament of 3 with ((n-r)^3 - (n-r-1)^3) / n^3.
    assert wins == pytest.approx([1 / 64, 37 / 64, 19 / 64, 7 / 64], abs=0.03)


def test_unranked_individual_never_beats_a_ranked_one() -> None:
    fitness = np.array([np.inf, 1.0, np.inf])
    for seed in range(200):
        rng = np.random.default_rng(seed)
        contestants = set(np.random.default_rng(seed).integers(3, size=2).tolist())
        winner = tournament(fitness, 2, rng)
        assert winner == 1 if 1 in contestants else winner in contestants
    assert tournament(np.full(4, np.inf), 3, np.random.default_rng(0)) in range(4)


def test_crossover_swaps_each_gene_with_its_probability() -> None:
    mother, father = np.zeros(10_000), np.ones(10_000)
    first, second = crossed(mother, father, 0.3, np.random.default_rng(0))
    assert np.array_equal(first + second, np.ones(10_000))
    assert first.mean() == pytest.approx(0.3, abs=0.02)


def test_mutation_shifts_numbers_by_sigma_and_redraws_categories() -> None:
    component = Component(
        "c", (Real("x", 0.0, 800.0, "px", 40.0), Integer("i", 0, 100), Categorical("k", ("a", "b", "c", "d")))
    )
    rng = np.random.default_rng(0)
    start = np.array([400.0, 50.0, 1.0])
    children = np.array([mutated(component, start, 1.0, rng) for _ in range(4000)])
    assert children[:, 0].std() == pytest.approx(40.0, rel=0.05)
    assert children[:, 0].mean() == pytest.approx(400.0, abs=3)
    assert children[:, 1].std() == pytest.approx(10.0, rel=0.05)
    assert np.bincount(children[:, 2].astype(int)) / 4000 == pytest.approx([0.25] * 4, abs=0.03)
    untouched = np.array([mutated(component, start, 0.01, rng) for _ in range(4000)]) == start
    assert np.count_nonzero(~untouched[:, 0]) == pytest.approx(40, abs=25)
    assert np.array_equal(mutated(component, start, 0.0, rng), start)


def test_parents_are_never_modified() -> None:
    rng = np.random.default_rng(0)
    mother, father = (np.array(BEHAVIOUR.sample(rng)) for _ in range(2))
    before = mother.tobytes(), father.tobytes()
    children = offspring(BEHAVIOUR, mother, father, crossover=0.5, mutation=1.0, rng=rng)
    assert (mother.tobytes(), father.tobytes()) == before
    for child in children:
        assert not np.shares_memory(child, mother)
        assert not np.shares_memory(child, father)
        assert not child.flags.writeable


def test_children_are_valid_and_free_of_dormant_zeros() -> None:
    block = Component(
        "block",
        (Categorical("label", ("off", "on")), Real("a", -100.0, 900.0), Real("b", -100.0, 900.0)),
        (Dormant("label", "off", ("a", "b")),),
    )
    dormant, active = np.zeros(3), np.array([1.0, 777.0, 888.0])
    rng = np.random.default_rng(0)
    fresh = kept = 0
    for _ in range(500):
        for child in offspring(block, dormant, active, crossover=0.5, mutation=0.0, rng=rng):
            assert list(block.problems(child)) == []
            if child[0]:
                assert 0 not in child[1:]
                kept += int(np.count_nonzero(child[1:] == active[1:]))
                fresh += int(np.count_nonzero(child[1:] != active[1:]))
            else:
                assert child.tolist() == [0.0, 0.0, 0.0]
    assert kept > 300
    assert fresh > 300


def test_block_reactivated_by_mutation_gets_numbers_from_the_whole_range() -> None:
    block = Component(
        "block",
        (Categorical("label", ("off", "on")), Real("a", -100.0, 900.0)),
        (Dormant("label", "off", ("a",)),),
    )
    dormant = np.zeros(2)
    rng = np.random.default_rng(0)
    children = [
        child
        for _ in range(500)
        for child in offspring(block, dormant, dormant, crossover=0.5, mutation=1.0, rng=rng)
        if child[0]
    ]
    numbers = [child[1] for child in children]
    assert len(numbers) == pytest.approx(500, abs=80)
    assert np.mean(numbers) == pytest.approx(400, abs=50)
    assert np.std(numbers) == pytest.approx(1000 / np.sqrt(12), abs=40)


Rows = NDArray[np.float64]

coarse = arrays(
    np.float64,
    array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12),
    elements=st.integers(0, 4).map(float),
)
"""Rows with many ties."""


@given(coarse)
def test_fronts_match_pymoo(rows: Rows) -> None:
    fronts = NonDominatedSorting().do(rows)
    expected = np.empty(len(rows), np.int64)
    for rank, front in enumerate(fronts):
        expected[front] = rank
    assert ranks(rows).tolist() == expected.tolist()


@pytest.mark.parametrize("seed", range(20))
def test_crowding_without_ties_matches_pymoo(seed: int) -> None:
    rows = np.random.default_rng(seed).random((15, 3))
    ours, theirs = crowding(rows), calc_crowding_distance(rows)
    inner = np.isfinite(ours)
    assert inner.tolist() == np.isfinite(theirs).tolist()
    # pymoo divides by the number of objectives.
    assert ours[inner] == pytest.approx(3 * theirs[inner])


@given(coarse)
def test_rows_are_dominated_only_from_earlier_fronts(rows: Rows) -> None:
    front, beats = ranks(rows), dominates(rows)
    for loser in range(len(rows)):
        winners = np.flatnonzero(beats[:, loser])
        assert all(front[winner] < front[loser] for winner in winners)
        if front[loser] > 0:
            assert front[loser] - 1 in front[winners]


@given(arrays(np.float64, st.tuples(st.integers(0, 15), st.just(2)), elements=st.integers(0, 4).map(float)))
def test_first_front_matches_the_full_sort(rows: Rows) -> None:
    found = first_front(rows[:, 0], rows[:, 1])
    assert sorted(found.tolist()) == np.flatnonzero(ranks(rows) == 0).tolist()
    assert (np.diff(rows[found, 0]) >= 0).all()


def test_crowding_of_a_known_front() -> None:
    # Spread 4 and 8: the inner ones get (2/4 + 6/8) and (3/4 + 4/8).
    rows = np.array([[0.0, 8.0], [1.0, 4.0], [2.0, 2.0], [4.0, 0.0]])
    assert crowding(rows).tolist() == [np.inf, 1.25, 1.25, np.inf]


def test_constant_and_infinite_objectives_add_no_crowding() -> None:
    rows = np.array([[0.0, 7.0], [1.0, 7.0], [3.0, 7.0], [4.0, 7.0]])
    assert crowding(rows).tolist() == [np.inf, 0.75, 0.75, np.inf]
    assert crowding(np.array([[np.inf, 1.0], [2.0, 1.0], [np.inf, 1.0]])).tolist() == [0.0, 0.0, 0.0]


def test_survivors_are_sorted_by_front_crowding_and_position() -> None:
    rows = np.array([[5.0, 5.0], [0.0, 4.0], [1.0, 3.0], [1.1, 2.9], [4.0, 0.0], [5.0, 5.0]])
    assert survivors(rows, 3).tolist() == [1, 4, 3]
    assert survivors(rows, 9).tolist() == [1, 4, 3, 2, 0, 5]


@given(coarse, st.integers(0, 15))
def test_survivors_are_never_worse_than_the_dropped_rows(rows: Rows, count: int) -> None:
    front, distances = ranks_and_crowding(rows)
    kept = survivors(rows, count)
    gone = sorted(set(range(len(rows))) - set(kept.tolist()))
    assert len(kept) == min(count, len(rows)) == len(set(kept.tolist()))
    for winner in kept:
        for loser in gone:
            assert (front[winner], -distances[winner]) <= (front[loser], -distances[loser])


def test_nan_objectives_are_rejected() -> None:
    with pytest.raises(ValueError, match="without NaN"):
        ranks(np.array([[0.0, np.nan]]))

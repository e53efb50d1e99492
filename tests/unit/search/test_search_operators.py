import numpy as np
import pytest

from brink.search.operators import crossed, mutated, offspring, tournament
from brink.search.space import Categorical, Component, Dormant, Integer, Real
from brink.search.testing import example_spaces

BEHAVIOUR = example_spaces()["mixed"].components[1]


def test_tournament_prefers_the_smallest_fitness() -> None:
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


def test_mutation_steps_numbers_by_sigma_and_redraws_categories() -> None:
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


def test_parents_are_never_touched() -> None:
    rng = np.random.default_rng(0)
    mother, father = (np.array(BEHAVIOUR.sample(rng)) for _ in range(2))
    before = mother.tobytes(), father.tobytes()
    children = offspring(BEHAVIOUR, mother, father, crossover=0.5, mutation=1.0, rng=rng)
    assert (mother.tobytes(), father.tobytes()) == before
    for child in children:
        assert not np.shares_memory(child, mother)
        assert not np.shares_memory(child, father)
        assert not child.flags.writeable


def test_children_comply_and_sleeping_zeros_never_mix_into_them() -> None:
    block = Component(
        "block",
        (Categorical("label", ("off", "on")), Real("a", -100.0, 900.0), Real("b", -100.0, 900.0)),
        (Dormant("label", "off", ("a", "b")),),
    )
    asleep, awake = np.zeros(3), np.array([1.0, 777.0, 888.0])
    rng = np.random.default_rng(0)
    fresh = kept = 0
    for _ in range(500):
        for child in offspring(block, asleep, awake, crossover=0.5, mutation=0.0, rng=rng):
            assert list(block.problems(child)) == []
            if child[0]:
                assert 0 not in child[1:]
                kept += int(np.count_nonzero(child[1:] == awake[1:]))
                fresh += int(np.count_nonzero(child[1:] != awake[1:]))
            else:
                assert child.tolist() == [0.0, 0.0, 0.0]
    assert kept > 300
    assert fresh > 300


def test_label_that_mutates_back_to_life_gets_numbers_from_the_whole_range() -> None:
    block = Component(
        "block",
        (Categorical("label", ("off", "on")), Real("a", -100.0, 900.0)),
        (Dormant("label", "off", ("a",)),),
    )
    asleep = np.zeros(2)
    rng = np.random.default_rng(0)
    children = [
        child
        for _ in range(500)
        for child in offspring(block, asleep, asleep, crossover=0.5, mutation=1.0, rng=rng)
        if child[0]
    ]
    numbers = [child[1] for child in children]
    assert len(numbers) == pytest.approx(500, abs=80)
    assert np.mean(numbers) == pytest.approx(400, abs=50)
    assert np.std(numbers) == pytest.approx(1000 / np.sqrt(12), abs=40)

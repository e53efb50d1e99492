import dataclasses

import numpy as np
import pytest

from brink.search.algorithm import Scored
from brink.search.algorithms.ga import GeneticAlgorithm, GeneticAlgorithmConfig
from brink.search.algorithms.random_search import RandomSearch, RandomSearchConfig
from brink.search.errors import ConfigError
from brink.search.problems import onemax
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.search.testing import example_spaces, made_up_verdicts, play

SPACE = example_spaces()["mixed"]
TINY = SearchSpace((Component("a", (Categorical("x", ("0", "1", "2")), Categorical("y", ("0", "1")))),))


def test_random_search_spends_its_budget_exactly() -> None:
    run = play(RandomSearch(), SPACE, RandomSearchConfig(), made_up_verdicts(SPACE), seed=1, budget=130)
    assert [len(generation) for generation in run.generations] == [60, 60, 10]


def test_random_search_draws_what_the_space_samples() -> None:
    run = play(RandomSearch(), SPACE, RandomSearchConfig(), made_up_verdicts(SPACE), seed=1, budget=600)
    drawn = np.array([SPACE.join(c.vectors) for c in run.candidates])
    rng = np.random.default_rng(0)
    sampled = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(600)])
    assert drawn.mean(axis=0) / SPACE.ranges == pytest.approx(sampled.mean(axis=0) / SPACE.ranges, abs=0.15)


@pytest.mark.parametrize("generation_size", [1, 4, 60])
def test_random_search_finds_every_solution_of_a_small_space_then_ends(generation_size: int) -> None:
    config = RandomSearchConfig(generation_size=generation_size)
    run = play(RandomSearch(), TINY, config, made_up_verdicts(TINY, failing=0.3), seed=1, budget=1000)
    assert len(run.candidates) == 6


def test_genetic_algorithm_finds_every_solution_of_a_small_space_then_ends() -> None:
    verdicts = made_up_verdicts(TINY, failing=0.3)
    run = play(GeneticAlgorithm(), TINY, GeneticAlgorithmConfig(), verdicts, seed=1, budget=1000)
    assert len(run.candidates) == 6


def test_genetic_algorithm_is_generational() -> None:
    algorithm, config = GeneticAlgorithm(), GeneticAlgorithmConfig()
    verdicts = made_up_verdicts(SPACE, failing=0.0)
    state = algorithm.start(SPACE, config, seed=1, budget=300)
    while not algorithm.finished(state):
        parents = {row.tobytes() for row in state.population}
        state, candidates = algorithm.ask(state)
        assert len(candidates) <= 60
        asked = {SPACE.join(c.vectors).tobytes() for c in candidates}
        assert asked <= parents
        state = algorithm.tell(state, {c.number: verdicts(c) for c in candidates})
        assert state.population.shape == (60, SPACE.dimension)


def test_genetic_algorithm_starts_afresh_when_it_has_converged() -> None:
    # With hardly any mutation a population of bits soon holds nothing new; the budget is spent all the same.
    algorithm = GeneticAlgorithm()
    config = GeneticAlgorithmConfig(
        radius=onemax.RADIUS, population_size=10, mutation_probability=1e-9, tournament_size=10
    )
    run = play(algorithm, onemax.SPACE, config, lambda c: onemax.evaluate(c.vectors), seed=1, budget=300)
    assert len(run.candidates) >= 300


def test_genetic_algorithm_concentrates_where_fitness_is_low() -> None:
    near_boundary = {}
    for algorithm in (GeneticAlgorithm(), RandomSearch()):
        verdicts = made_up_verdicts(SPACE, failing=0.0)
        run = play(algorithm, SPACE, algorithm.config_type(), verdicts, seed=1, budget=600)
        near_boundary[algorithm.id] = int(np.count_nonzero(run.archive.fitness <= 0.15))
    assert near_boundary["ga@1"] > 2 * near_boundary["random@1"]


@pytest.mark.parametrize("count", [1, 3])
def test_baselines_take_any_number_of_components(count: int) -> None:
    space = SearchSpace(tuple(Component(f"part-{i}", (Real("x", 0.0, 1.0),)) for i in range(count)))
    for algorithm in (GeneticAlgorithm(), RandomSearch()):
        verdicts = made_up_verdicts(space)
        run = play(algorithm, space, algorithm.config_type(), verdicts, seed=1, budget=80)
        assert len(run.candidates) >= 80


def test_budgets_below_the_first_generation_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"budget: expected at least the 60 simulations"):
        GeneticAlgorithm().check(SPACE, GeneticAlgorithmConfig(), budget=59)
    with pytest.raises(ConfigError, match="budget"):
        RandomSearch().start(SPACE, RandomSearchConfig(), seed=0, budget=0)


def test_defaults_are_the_papers() -> None:
    config = GeneticAlgorithmConfig()
    assert (config.population_size, config.mutation_probability, config.crossover_probability) == (
        60,
        0.01,
        0.85,
    )
    assert config.tournament_size == 3
    with pytest.raises(ConfigError, match="mutation_probability"):
        dataclasses.replace(config, mutation_probability=0.0)


def test_unranked_solutions_are_no_parents() -> None:
    algorithm, config = (
        GeneticAlgorithm(),
        GeneticAlgorithmConfig(tournament_size=40, mutation_probability=1e-9),
    )
    state = algorithm.start(SPACE, config, seed=1, budget=300)
    state, candidates = algorithm.ask(state)
    made_up = made_up_verdicts(SPACE, failing=0.5)
    evaluations = {c.number: made_up(c) for c in candidates}
    ranked = np.array(
        [SPACE.join(c.vectors) for c in candidates if isinstance(evaluations[c.number], Scored)]
    )
    state = algorithm.tell(state, evaluations)
    assert 10 < len(ranked) < 50
    for child in state.population:
        # The free number can come from nowhere but a ranked parent.
        assert child[7] in ranked[:, 7]

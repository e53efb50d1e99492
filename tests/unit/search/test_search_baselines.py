"""Random search, the genetic algorithm, and the benchmark problems with known boundaries."""

import dataclasses
import math

import numpy as np
import pytest

from brink.search.algorithm import Scored
from brink.search.algorithms.ga import GeneticAlgorithm, GeneticAlgorithmConfig
from brink.search.algorithms.mlcshe import Mlcshe
from brink.search.algorithms.random_search import RandomSearch, RandomSearchConfig
from brink.search.analysis.boundary import dbs_grid, distinct_boundary
from brink.search.archive import Archive, archive_digest
from brink.search.errors import ConfigError
from brink.search.problems import (
    MTQ_RADIUS,
    MTQ_SAFE_RADIUS,
    MTQ_SPACE,
    ONEMAX_RADIUS,
    ONEMAX_SPACE,
    evaluate_mtq,
    evaluate_onemax,
    mtq_gap_to_boundary,
    mtq_robustness,
)
from brink.search.space import Categorical, Component, SearchSpace
from brink.search.testing import example_spaces, play, synthetic_verdicts

SPACE = example_spaces()["mixed"]
TINY = SearchSpace((Component("a", (Categorical("x", ("0", "1", "2")), Categorical("y", ("0", "1")))),))


@pytest.mark.parametrize("space", [SPACE, TINY])
def test_random_search_finds_the_same_with_any_number_of_generations_in_flight(space: SearchSpace) -> None:
    digests = {
        archive_digest(play(RandomSearch(), space, config, verdicts, seed=1, budget=130).archive)
        for config in (RandomSearchConfig(generation_size=7, in_flight=n) for n in (1, 2, 8, 100))
        for verdicts in [synthetic_verdicts(space, failing=0.3)]
    }
    assert len(digests) == 1


@pytest.mark.parametrize("generation_size", [1, 4, 60])
def test_random_search_exhausts_a_small_space_and_ends(generation_size: int) -> None:
    config = RandomSearchConfig(generation_size=generation_size)
    run = play(RandomSearch(), TINY, config, synthetic_verdicts(TINY, failing=0.3), seed=1, budget=1000)
    assert len(run.candidates) == 6


def test_genetic_algorithm_exhausts_a_small_space_and_ends() -> None:
    verdicts = synthetic_verdicts(TINY, failing=0.3)
    run = play(GeneticAlgorithm(), TINY, GeneticAlgorithmConfig(), verdicts, seed=1, budget=1000)
    assert len(run.candidates) == 6


def test_genetic_algorithm_is_generational() -> None:
    algorithm, config = GeneticAlgorithm(), GeneticAlgorithmConfig()
    verdicts = synthetic_verdicts(SPACE, failing=0.0)
    state = algorithm.start(SPACE, config, seed=1, budget=300)
    while not algorithm.finished(state):
        parents = {row.tobytes() for row in state.population}
        state, candidates = algorithm.ask(state)
        assert len(candidates) <= 60
        asked = {SPACE.join(c.vectors).tobytes() for c in candidates}
        assert asked <= parents
        state = algorithm.tell(state, {c.number: verdicts(c) for c in candidates})
        assert state.population.shape == (60, SPACE.dimension)


def test_budgets_below_the_first_generation_are_rejected() -> None:
    with pytest.raises(ConfigError, match=r"budget: expected at least the 60 simulations"):
        GeneticAlgorithm().check(SPACE, GeneticAlgorithmConfig(), budget=59)
    with pytest.raises(ConfigError, match="budget"):
        RandomSearch().start(SPACE, RandomSearchConfig(), seed=0, budget=0)


def test_failed_solutions_are_never_parents() -> None:
    algorithm, config = (
        GeneticAlgorithm(),
        GeneticAlgorithmConfig(tournament_size=40, mutation_probability=1e-9),
    )
    state = algorithm.start(SPACE, config, seed=1, budget=300)
    state, candidates = algorithm.ask(state)
    synthetic = synthetic_verdicts(SPACE, failing=0.5)
    evaluations = {c.number: synthetic(c) for c in candidates}
    ranked = np.array(
        [SPACE.join(c.vectors) for c in candidates if isinstance(evaluations[c.number], Scored)]
    )
    state = algorithm.tell(state, evaluations)
    assert 10 < len(ranked) < 50
    for child in state.population:
        # Its continuous number can only come from a ranked parent.
        assert child[7] in ranked[:, 7]


def test_mtq_has_known_values() -> None:
    assert mtq_robustness(0.75, 0.75) == 50.0
    assert mtq_robustness(0.25, 0.25) == -50.0
    assert mtq_robustness(0.75 + MTQ_SAFE_RADIUS, 0.75) == pytest.approx(0.0, abs=1e-9)
    assert mtq_robustness(0.0, 1.0) == pytest.approx(150 * (1 - 10 * (0.5625 + 0.0625)) - 100)


def test_mtq_is_safe_exactly_inside_the_disc() -> None:
    points = np.random.default_rng(0).random((2000, 2))
    for x, y in points.tolist():
        inside = math.hypot(x - 0.75, y - 0.75) <= MTQ_SAFE_RADIUS
        verdict = evaluate_mtq((np.array([x]), np.array([y])))
        assert verdict.unsafe == (not inside)
        assert verdict.unsafe == (verdict.robustness < 0)
    assert mtq_gap_to_boundary(0.75, 0.75) == pytest.approx(MTQ_SAFE_RADIUS)


def test_onemax_has_known_values() -> None:
    def solution(ones: int) -> tuple[np.ndarray, np.ndarray]:
        row = np.repeat([1.0, 0.0], [ones, 20 - ones])
        left, right = ONEMAX_SPACE.split(row)
        return left, right

    assert [evaluate_onemax(solution(n)).unsafe for n in (0, 4, 5, 20)] == [True, True, False, False]
    assert evaluate_onemax(solution(7)).robustness == 2.0
    assert ONEMAX_SPACE.size == 2**20


def mtq_archive(algorithm: Mlcshe | RandomSearch, seed: int) -> Archive:
    config = algorithm.config_type(radius=MTQ_RADIUS)
    return play(
        algorithm, MTQ_SPACE, config, lambda c: evaluate_mtq(c.vectors), seed=seed, budget=1000
    ).archive


def test_mlcshe_finds_the_boundary_of_mtq() -> None:
    for seed in range(3):
        archive = mtq_archive(Mlcshe(), seed)
        found = distinct_boundary(archive, 0.10, 0.05, strict=True)
        assert found.size >= 2
        gaps = [mtq_gap_to_boundary(*archive.vectors[i].tolist()) for i in found]
        # A tenth of a neighbourhood (|dx| + |dy| <= 0.1) is unsafe where its centre lies about 0.05 inside.
        assert max(gaps) < 0.08
        assert dbs_grid(mtq_archive(RandomSearch(), seed), (0.10,), (0.05,)).dbs[0, 0] == 0


def test_random_search_spends_its_budget_exactly() -> None:
    run = play(RandomSearch(), SPACE, RandomSearchConfig(), synthetic_verdicts(SPACE), seed=1, budget=130)
    assert [len(generation) for generation in run.generations] == [60, 60, 10]


def test_random_search_draws_from_the_distribution_of_the_space() -> None:
    run = play(RandomSearch(), SPACE, RandomSearchConfig(), synthetic_verdicts(SPACE), seed=1, budget=600)
    drawn = np.array([SPACE.join(c.vectors) for c in run.candidates])
    rng = np.random.default_rng(0)
    sampled = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(600)])
    assert drawn.mean(axis=0) / SPACE.ranges == pytest.approx(sampled.mean(axis=0) / SPACE.ranges, abs=0.15)


def test_genetic_algorithm_restarts_when_it_has_converged() -> None:
    # With almost no mutation a population of bits soon breeds nothing new; the budget is still spent.
    algorithm = GeneticAlgorithm()
    config = GeneticAlgorithmConfig(
        radius=ONEMAX_RADIUS, population_size=10, mutation_probability=1e-9, tournament_size=10
    )
    run = play(algorithm, ONEMAX_SPACE, config, lambda c: evaluate_onemax(c.vectors), seed=1, budget=300)
    assert len(run.candidates) >= 300


def test_defaults_of_the_genetic_algorithm_are_those_of_the_paper_or_of_the_authors_code() -> None:
    config = GeneticAlgorithmConfig()
    assert (config.population_size, config.mutation_probability, config.crossover_probability) == (
        60,
        0.01,
        0.85,
    )
    assert config.tournament_size == 3
    with pytest.raises(ConfigError, match="mutation_probability"):
        dataclasses.replace(config, mutation_probability=0.0)

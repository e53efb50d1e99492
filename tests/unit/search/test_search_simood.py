"""SiMOOD: fitness, breeding, finalists, explanation and cost."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import Candidate, Evaluation, Failed, Measured, Question, Scored
from brink.search.algorithms.simood import Simood, SimoodConfig, SimoodState, Stage, finalists_of
from brink.search.errors import ConfigError
from brink.search.testing import check_algorithm, example_spaces, play

SPACE = example_spaces()["slots"]
SIMOOD = Simood()
BUDGET = 500
LEVELS = (9, 24, 6, 11, 31)


def harm(candidate: Candidate) -> float:
    """Return alpha: blur (1) first does most harm, dirt (3) second a little; higher levels do more."""
    first, strong, second, weak = candidate.vectors[1].tolist()
    return float(1.0 - 0.7 * strong * (first == 1) - 0.2 * weak * (second == 3) - 0.01 * (strong + weak))


def answered(candidate: Candidate) -> Evaluation:
    objectives = {"alpha": harm(candidate)}
    if candidate.question is Question.DATASET:
        return Measured(objectives=objectives)
    robustness = harm(candidate) - 0.5
    return Scored(unsafe=robustness < 0, robustness=robustness, objectives=objectives)


def run_to_end(
    answer: Callable[[Candidate], Evaluation] = answered,
    *,
    budget: int = BUDGET,
    seed: int = 1,
    **changes: Any,
) -> tuple[SimoodState, list[tuple[Candidate, ...]]]:
    config = dataclasses.replace(SimoodConfig(), **changes)
    state = SIMOOD.start(SPACE, config, seed=seed, budget=budget)
    generations = []
    while not SIMOOD.finished(state):
        state, candidates = SIMOOD.ask(state)
        generations.append(candidates)
        state = SIMOOD.tell(state, {c.number: answer(c) for c in candidates})
    return state, generations


def test_fitness_is_alpha_plus_weighted_mean_intensity() -> None:
    state, _ = run_to_end(generations=0, omega=0.3)
    for place, fitness in zip(state.population, state.fitness, strict=True):
        first, strong, second, weak = state.individuals[place].tolist()
        alpha = 1.0 - 0.7 * strong * (first == 1) - 0.2 * weak * (second == 3) - 0.01 * (strong + weak)
        assert fitness == pytest.approx(alpha + 0.3 * (strong + weak) / 2, abs=1e-12)


def test_fitness_of_errors_is_their_difference_to_the_weighted_intensity() -> None:
    state, _ = run_to_end(generations=0, omega=0.3, alpha="errors")
    eta = state.individuals[:, [1, 3]].mean(axis=1)
    expected = np.abs(0.3 * eta - state.alphas)[list(state.population)]
    assert state.fitness == pytest.approx(expected)


def test_cost_is_bounded_by_the_papers_and_nothing_is_asked_twice() -> None:
    state, generations = run_to_end()
    asked = [c for generation in generations for c in generation if c.question is Question.DATASET]
    assert len(generations[0]) == 20
    assert 20 + 20 <= len(asked) <= 20 + 2 * 20
    assert len({c.vectors[1].tobytes() for c in asked}) == len(asked) == len(state.individuals)
    bred = [g for g in generations[1:] if g[0].question is Question.DATASET]
    assert all(len(generation) <= 2 for generation in bred)


def test_only_finalists_are_simulated_in_the_same_scenarios() -> None:
    state, generations = run_to_end(finalists=4, repeats=3, explained=0)
    *_, last = generations
    assert all(c.question is Question.EPISODE for c in last)
    assert all(c.question is Question.DATASET for generation in generations[:-1] for c in generation)
    assert len(last) == 12 == len(state.archive)
    finalists = {c.vectors[1].tobytes() for c in last}
    assert finalists == {row.tobytes() for row in finalists_of(state)}
    assert len({tuple(c.vectors[1][[0, 2]]) for c in last}) == 4, "one for each order of techniques"
    assert [c.seed_number for c in last] == [0, 1, 2] * 4
    scenarios = [{c.vectors[0].tobytes() for c in last if c.vectors[1].tobytes() == f} for f in finalists]
    assert all(len(found) == 3 for found in scenarios)
    assert all(found == scenarios[0] for found in scenarios)


def test_parts_and_other_orders_of_hazardous_finalists_are_simulated_in_the_same_scenarios() -> None:
    state, generations = run_to_end(finalists=4, repeats=3)
    finalists, variants = generations[-2:]
    hazardous = {c.vectors[1].tobytes() for c in finalists if harm(c) < 0.5}
    assert hazardous
    places = {(c.vectors[0].tobytes(), c.seed_number) for c in finalists}
    assert len(places) == 3
    expected = {(0.0, 0.0, 1.0, 0.0)}
    for one in (np.frombuffer(row) for row in hazardous):
        first, strong, second, weak = one.tolist()
        expected |= {(first, strong, float(first == 0), 0.0), (float(second == 0), 0.0, second, weak)}
        expected.add((second, weak, first, strong))
    expected -= {tuple(c.vectors[1]) for c in finalists}
    assert {tuple(c.vectors[1]) for c in variants} == expected
    assert all((c.vectors[0].tobytes(), c.seed_number) in places for c in variants)
    assert len(variants) == 3 * len(expected)
    assert len(state.archive) == len(finalists) + len(variants)


def test_population_keeps_its_size_and_never_gets_worse() -> None:
    config = SimoodConfig()
    state = SIMOOD.start(SPACE, config, seed=3, budget=BUDGET)
    best: list[float] = []
    while True:
        state, candidates = SIMOOD.ask(state)
        if state.stage is not Stage.SEARCH:
            break
        state = SIMOOD.tell(state, {c.number: answered(c) for c in candidates})
        assert len(state.population) == config.population_size
        best.append(float(state.fitness.min()))
        assert list(state.fitness) == sorted(state.fitness)
    assert best == sorted(best, reverse=True)


def test_breeding_beats_random_draws_of_equal_number() -> None:
    def mean_fitness(propose: str, seed: int) -> float:
        state, _ = run_to_end(generations=60, propose=propose, seed=seed)
        return float(state.fitness.mean())

    wins = sum(mean_fitness("ga", seed) < mean_fitness("random", seed) for seed in range(8))
    assert wins >= 7


def test_every_individual_is_valid() -> None:
    _, generations = run_to_end(generations=60, mutation_probability=0.9)
    for candidate in (c for generation in generations for c in generation):
        SPACE.check(candidate.vectors)


def test_single_point_crossover_keeps_slots_whole() -> None:
    state, generations = run_to_end(mutation_probability=0.0, generations=1, population_size=2)
    parents = state.individuals[:2]
    whole = {tuple(row[slot : slot + 2]) for row in parents for slot in (0, 2)}
    mutated_slots = 0
    for candidate in generations[1]:
        row = candidate.vectors[1]
        mutated_slots += sum(tuple(row[slot : slot + 2]) not in whole for slot in (0, 2))
    assert mutated_slots <= len(generations[1])  # a child that repeats a technique has one slot redrawn


def test_failed_evaluations_never_become_finalists() -> None:
    def answer(candidate: Candidate) -> Evaluation:
        bad = candidate.vectors[1][0] == 1 and candidate.question is Question.DATASET
        return Failed(reason="no") if bad else answered(candidate)

    state, generations = run_to_end(answer)
    assert np.isinf(state.alphas).any()
    finalists = next(g for g in generations if g[0].question is Question.EPISODE)
    assert all(candidate.vectors[1][0] != 1 for candidate in finalists)


def test_budget_is_reserved_for_the_finalists() -> None:
    state, generations = run_to_end(budget=20 + 7 + 15, explained=0)
    assert sum(map(len, generations)) == 42
    assert len(generations[-1]) == 15
    assert len(state.archive) == 15


def test_search_can_run_in_the_simulator() -> None:
    state, generations = run_to_end(evaluate="episode", finalists=2, repeats=2, explained=0)
    assert all(c.question is Question.EPISODE for generation in generations for c in generation)
    assert len({c.vectors[0].tobytes() for generation in generations[:-1] for c in generation}) == 1
    assert len(generations[-1]) == 2, "the individuals were already simulated at repeat 0"
    assert len(state.archive) == sum(map(len, generations))


@pytest.mark.parametrize(
    ("changes", "budget", "field"),
    [({}, 94, "budget"), ({"parents": 30}, BUDGET, "parents"), ({"finalists": 0}, BUDGET, "finalists")],
)
def test_inconsistent_settings_are_rejected(changes: dict[str, Any], budget: int, field: str) -> None:
    with pytest.raises(ConfigError) as caught:
        run_to_end(budget=budget, **changes)
    assert caught.value.field == field


@pytest.mark.parametrize("changes", [{"propose": "random"}, {"evaluate": "episode"}, {"parents": 5}])
def test_every_variant_keeps_the_contract(changes: dict[str, Any]) -> None:
    config = dataclasses.replace(SimoodConfig(), **changes)
    check_algorithm(SIMOOD, SPACE, budget=BUDGET, config=config, ends_itself=True)


def test_seeds_give_different_searches() -> None:
    first, second = (
        play(SIMOOD, SPACE, SimoodConfig(), answered, seed=seed, budget=BUDGET).documents[-1]
        for seed in (1, 2)
    )
    assert first != second

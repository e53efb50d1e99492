"""SiMOOD: fitness, breeding, finalists, explanation and cost."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import Candidate, Evaluation, Failed, Measured, Question, Scored
from brink.search.algorithms.simood import (
    Simood,
    SimoodConfig,
    SimoodState,
    Stage,
    budget_for,
    explained_of,
    finalists_of,
)
from brink.search.errors import ConfigError, DocumentError
from brink.search.slots import Slots
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.search.testing import check_algorithm, example_spaces

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
    state, _ = run_to_end(generations=0, omega=0.3, interaction="none")
    for place, fitness in zip(state.population, state.fitness, strict=True):
        first, strong, second, weak = state.individuals[place].tolist()
        alpha = 1.0 - 0.7 * strong * (first == 1) - 0.2 * weak * (second == 3) - 0.01 * (strong + weak)
        assert fitness == pytest.approx(alpha + 0.3 * (strong + weak) / 2, abs=1e-12)


def test_search_for_errors_prefers_the_worst_component() -> None:
    state, _ = run_to_end(generations=0, omega=0.3, alpha="errors", interaction="none")
    eta = state.individuals[:, [1, 3]].mean(axis=1)
    assert state.fitness == pytest.approx((0.3 * eta - state.alphas)[list(state.population)])
    # |omega eta - alpha|, the paper's formula, would prefer the individual with 0.1 errors to that with 0.9.
    many = dataclasses.replace(
        state, alphas=np.where(np.arange(20) == 7, 0.9, 0.1), population=tuple(range(20))
    )
    assert int(np.argmin(many.fitness)) == 7


def test_errors_that_could_not_be_counted_are_not_the_most() -> None:
    def answer(candidate: Candidate) -> Evaluation:
        return Failed(reason="no") if candidate.vectors[1][0] == 1 else answered(candidate)

    state, generations = run_to_end(answer, alpha="errors", interaction="none")
    assert np.isinf(state.alphas).any()
    assert all(candidate.vectors[1][0] != 1 for candidate in generations[-1])


def test_cost_is_bounded_by_the_papers_and_nothing_is_asked_twice() -> None:
    state, generations = run_to_end(interaction="none")
    asked = [c for generation in generations for c in generation if c.question is Question.DATASET]
    assert len(generations[0]) == 20
    assert len(asked) == 20 + 2 * 20
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
    state, generations = run_to_end(finalists=4, repeats=3, interaction="fitness")
    finalists, variants = generations[-2:]
    hazardous = {c.vectors[1].tobytes() for c in finalists if harm(c) < 0.5}
    assert hazardous
    places = {(c.vectors[0].tobytes(), c.seed_number) for c in finalists}
    assert len(places) == 3
    expected = {(0.0, 0.0, 1.0, 0.0)}
    for one in (np.frombuffer(row) for row in hazardous):
        first, strong, second, weak = one.tolist()
        expected |= {(first, strong, float(first == 0), 0.0), (second, weak, float(second == 0), 0.0)}
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


@pytest.mark.parametrize(
    ("changes", "budget", "field"),
    [
        ({"interaction": "none"}, 94, "budget"),
        ({}, 134, "budget"),
        ({"interaction": "finalists"}, 104, "budget"),
        ({"parents": 30}, BUDGET, "parents"),
        ({"finalists": 0}, BUDGET, "finalists"),
        ({"interaction": "yes"}, BUDGET, "interaction"),
    ],
)
def test_inconsistent_settings_are_rejected(changes: dict[str, Any], budget: int, field: str) -> None:
    with pytest.raises(ConfigError) as caught:
        run_to_end(budget=budget, **changes)
    assert caught.value.field == field


@pytest.mark.parametrize(
    "changes",
    [
        {"propose": "random"},
        {"evaluate": "episode"},
        {"parents": 5},
        {"interaction": "none"},
        {"interaction": "finalists"},
        {"interaction": "finalists", "evaluate": "episode"},
        {"alpha": "errors"},
        {"interaction": "added_harm"},
        {"interaction": "added_harm", "alpha": "errors", "propose": "random"},
    ],
)
def test_every_variant_keeps_the_contract(changes: dict[str, Any]) -> None:
    config = dataclasses.replace(SimoodConfig(), **changes)
    check_algorithm(SIMOOD, SPACE, budget=BUDGET, config=config, ends_itself=True)


def test_no_individual_enters_the_population_twice() -> None:
    state, _ = run_to_end(generations=100, interaction="none")
    assert len({row.tobytes() for row in state.individuals}) == len(state.individuals) == 20 + 2 * 100
    assert len(set(state.population)) == 20
    assert state.given_up == 0


@pytest.mark.parametrize("propose", ["ga", "random"])
def test_children_of_an_exhausted_space_are_given_up_and_counted(propose: str) -> None:
    genes = Component(
        "perturbation",
        (
            Categorical("gene_1", ("a", "b")),
            Real("intensity_1", 0.0, 1.0),
            Categorical("gene_2", ("a", "b")),
            Real("intensity_2", 0.0, 1.0),
        ),
        (Slots((("gene_1", "intensity_1"), ("gene_2", "intensity_2")), (3, 2)),),
    )
    space = SearchSpace((SPACE.components[0], genes))
    config = SimoodConfig(propose=propose, population_size=2, finalists=2, repeats=1, interaction="none")
    state = SIMOOD.start(space, config, seed=1, budget=BUDGET)
    while state.stage is Stage.SEARCH:
        state, candidates = SIMOOD.ask(state)
        state = SIMOOD.tell(state, {c.number: answered(c) for c in candidates})
    assert len(state.individuals) == 4, "two orders of a at level 1 or 2 and b at level 1"
    assert state.given_up == 2, "the first generation without a new child ends the search"


LONE = {(0, 8): 0.9, (1, 23): 0.3, (2, 5): 0.8, (3, 10): 0.7, (4, 30): 0.8}
"""Alpha of each technique alone at its highest level."""


def interacting_alpha(candidate: Candidate) -> float:
    """Return an alpha of which one technique does all the harm, except that dirt (3) then snow (2) interact."""
    first, strong, second, weak = candidate.vectors[1].tolist()
    alone = [
        1.0 - (1.0 - LONE[int(one), LEVELS[int(one)] - 1]) * level
        for one, level in ((first, strong), (second, weak))
    ]
    alpha = float(min(alone))
    if (first, second) == (3.0, 2.0) and strong and weak:
        alpha -= 0.3 * min(strong, weak)
    return alpha


def interacting(candidate: Candidate) -> Evaluation:
    alpha = interacting_alpha(candidate)
    if candidate.question is Question.DATASET:
        return Measured(objectives={"alpha": alpha})
    return Scored(unsafe=alpha < 0.5, robustness=alpha - 0.5, objectives={"alpha": alpha})


@pytest.mark.parametrize("interaction", ["added_harm", "fitness", "finalists"])
def test_chains_that_harm_more_than_their_parts_come_first(interaction: str) -> None:
    for seed in range(3):
        state, _ = run_to_end(interacting, seed=seed, generations=60, interaction=interaction)
        best = finalists_of(state)[0]
        assert tuple(best[[0, 2]]) == (3, 2)
        paper, _ = run_to_end(interacting, seed=seed, generations=60, interaction="none")
        assert 1 in finalists_of(paper)[0][[0, 2]], "blur with a free rider"
        assert not len(paper.parts)


@pytest.mark.parametrize("interaction", ["added_harm", "fitness"])
def test_fitness_of_a_chain_that_does_not_interact_is_what_it_lacks_behind_the_worst_that_does(
    interaction: str,
) -> None:
    state, generations = run_to_end(
        interacting, generations=0, omega=0.5, margin=0.05, interaction=interaction
    )
    first = generations[0]
    parts = {
        (int(c.vectors[1][0]), float(c.vectors[1][1])): interacting_alpha(c)
        for c in first
        if c.vectors[1][3] == 0
    }
    for place, fitness in zip(state.population, state.fitness, strict=True):
        a, strong, b, weak = state.individuals[place].tolist()
        added_harm = min(parts[int(a), strong], parts[int(b), weak]) - state.alphas[place]
        assert state.added_harms[place] == pytest.approx(added_harm)
        lacking = 0.05 - max(0.0, added_harm)
        intensity = 0.5 * (strong + weak) / 2
        if interaction == "fitness":
            expected, worst = state.alphas[place] + intensity, 1.5
        else:
            expected, worst = intensity - added_harm, 0.5
        assert fitness == pytest.approx(expected if added_harm >= 0.05 else worst + lacking)


def one_after_another(candidate: Candidate) -> Evaluation:
    """Return the least of two alphas: the more intense technique does all the harm, so that nothing interacts."""
    alpha = 1.0 - 0.8 * float(max(candidate.vectors[1][[1, 3]]))
    if candidate.question is Question.DATASET:
        return Measured(objectives={"alpha": alpha})
    return Scored(unsafe=alpha < 0.5, robustness=alpha - 0.5, objectives={"alpha": alpha})


def paper_fitness(state: SimoodState) -> np.ndarray[Any, Any]:
    return np.asarray(state.alphas + state.config.omega * state.individuals[:, [1, 3]].mean(axis=1))


@pytest.mark.parametrize("propose", ["ga", "random"])
def test_where_nothing_interacts_the_papers_fitness_decides(propose: str) -> None:
    for seed in range(3):
        state, _ = run_to_end(one_after_another, seed=seed, propose=propose)
        assert state.added_harms == pytest.approx(0.0, abs=1e-12)
        paper = paper_fitness(state)
        best: dict[tuple[float, ...], float] = {}
        for row, value in zip(state.individuals, paper, strict=True):
            order = tuple(row[[0, 2]])
            best[order] = min(value, best.get(order, np.inf))
        found = [paper[(state.individuals == one).all(axis=1)][0] for one in finalists_of(state)]
        assert found == pytest.approx(sorted(best.values())[:5]), "the best of each order, best first"
        population = paper[list(state.population)]
        assert list(population) == sorted(population)
        assert list(population) == pytest.approx(sorted(paper)[:20]), "the best ever bred or drawn"


@pytest.mark.parametrize("interaction", ["added_harm", "fitness"])
def test_a_campaign_whose_parts_all_fail_simulates_its_best_chains(interaction: str) -> None:
    def answer(candidate: Candidate) -> Evaluation:
        return Failed(reason="no") if candidate.vectors[1][3] == 0 else one_after_another(candidate)

    state, generations = run_to_end(answer, explained=0, interaction=interaction)
    assert np.isnan(state.added_harms).all()
    assert np.isinf(state.part_alphas).all()
    finalists = finalists_of(state)
    assert len(finalists) == 5
    assert {c.vectors[1].tobytes() for c in generations[-1]} == {row.tobytes() for row in finalists}
    best = state.individuals[int(np.argmin(paper_fitness(state)))]
    np.testing.assert_array_equal(finalists[0], best)


def test_each_technique_at_a_level_is_evaluated_alone_once() -> None:
    state, generations = run_to_end(interacting)
    asked = [c for generation in generations for c in generation if c.question is Question.DATASET]
    rows = [c.vectors[1] for c in asked if c.vectors[1][3] == 0]
    singles = {(int(row[0]), float(row[1])) for row in rows}
    assert len(singles) == len(rows) == len(state.parts)
    steps = {(int(row[s]), float(row[s + 1])) for row in state.individuals for s in (0, 2)}
    assert singles == steps


def test_only_parts_of_possible_finalists_are_evaluated_for_the_choice_of_finalists() -> None:
    def answer(candidate: Candidate) -> Evaluation:
        qualities = [1.0 - 0.5 * level for level in candidate.vectors[1][[1, 3]]]
        alpha = float(np.prod(qualities))
        if candidate.question is Question.DATASET:
            return Measured(objectives={"alpha": alpha})
        return Scored(unsafe=alpha < 0.5, robustness=alpha - 0.5, objectives={"alpha": alpha})

    state, generations = run_to_end(answer, interaction="finalists")
    stages = [[c.vectors[1][3] == 0 for c in g] for g in generations if g[0].question is Question.DATASET]
    assert all(not any(parts) or all(parts) for parts in stages)
    searched = [place for place, parts in enumerate(stages) if not any(parts)]
    assert searched == list(range(len(searched))), "parts come after the search"
    known = ~np.isnan(state.added_harms)
    assert 5 <= known.sum() < len(state.individuals)


def test_chain_with_a_part_that_could_not_be_measured_does_not_interact() -> None:
    def answer(candidate: Candidate) -> Evaluation:
        row = candidate.vectors[1]
        return Failed(reason="no") if row[3] == 0 and row[0] == 3 else interacting(candidate)

    state, _ = run_to_end(answer, generations=60)
    with_dirt = (state.individuals[:, [0, 2]] == 3).any(axis=1)
    assert np.isnan(state.added_harms[with_dirt]).all()
    assert not (state.individuals[list(state.population)][:, [0, 2]] == 3).any()


def test_parts_of_two_steps_count_for_finalists_of_three() -> None:
    """Blur with dirt does all the harm of blur, dirt and snow, but no technique alone does any."""
    genes = tuple(str(gene) for gene in range(4))
    pairs = tuple((f"gene_{slot}", f"intensity_{slot}") for slot in (1, 2, 3))
    component = Component(
        "perturbation",
        tuple(p for gene, level in pairs for p in (Categorical(gene, genes), Real(level, 0.0, 1.0))),
        (Slots(pairs, (3,) * len(genes)),),
    )
    space = SearchSpace((SPACE.components[0], component))

    def answer(candidate: Candidate) -> Evaluation:
        row = candidate.vectors[1]
        used = {int(gene) for gene, level in zip(row[::2], row[1::2], strict=True) if level}
        alpha = 0.2 if {0, 1} <= used else 0.4 if used == {1, 2, 3} else 0.8
        if candidate.question is Question.DATASET:
            return Measured(objectives={"alpha": alpha})
        return Scored(unsafe=alpha < 0.5, robustness=alpha - 0.5, objectives={"alpha": alpha})

    for interaction in ("added_harm", "fitness", "finalists"):
        config = SimoodConfig(generations=40, interaction=interaction, finalists=3)
        state = SIMOOD.start(space, config, seed=1, budget=1_000)
        while not SIMOOD.finished(state):
            state, candidates = SIMOOD.ask(state)
            state = SIMOOD.tell(state, {c.number: answer(c) for c in candidates})
        assert all(set(row[::2]) == {1, 2, 3} for row in finalists_of(state))


def test_finalists_that_are_unsafe_most_often_are_explained_first() -> None:
    asked: list[bytes] = []

    def answer(candidate: Candidate) -> Evaluation:
        """Call the five finalists, in their order, unsafe in 1, 0, 4, 1 and 3 of 4 scenarios."""
        if candidate.question is Question.DATASET:
            return answered(candidate)
        key, scenario = candidate.vectors[1].tobytes(), candidate.seed_number
        assert scenario is not None
        if key not in asked:
            asked.append(key)
        unsafe = scenario < [1, 0, 4, 1, 3, *[0] * 100][asked.index(key)]
        return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0, objectives={})

    for explained, expected in ((5, [2, 4, 0, 3]), (2, [2, 4])):
        asked.clear()
        state, _ = run_to_end(answer, finalists=5, repeats=4, explained=explained)
        assert asked[:5] == [row.tobytes() for row in finalists_of(state)]
        assert [asked.index(one.tobytes()) for one in explained_of(state)] == expected


def test_a_margin_of_errors_may_exceed_one() -> None:
    """Each technique alone costs 2 errors, both together 7: 5 more than the most harmful part."""

    def answer(candidate: Candidate) -> Evaluation:
        levels = candidate.vectors[1][[1, 3]]
        errors = 7.0 if (levels > 0).all() else 2.0
        if candidate.question is Question.DATASET:
            return Measured(objectives={"alpha": errors})
        return Scored(unsafe=True, robustness=-1.0, objectives={"alpha": errors})

    for margin, interact in ((5.0, True), (5.5, False)):
        state, _ = run_to_end(answer, alpha="errors", margin=margin, generations=1)
        assert state.added_harms == pytest.approx(5.0)
        assert (state.fitness < 0).all() == interact, "f = omega eta - 7, or omega and what is lacking"


@pytest.mark.parametrize("propose", ["ga", "random"])
@pytest.mark.parametrize("interaction", ["fitness", "none"])
def test_searches_can_be_stopped_at_the_same_number_of_evaluations(propose: str, interaction: str) -> None:
    config = SimoodConfig(interaction=interaction, propose=propose, generations=200)
    budget = budget_for(SPACE, config, 100)
    state, generations = run_to_end(budget=budget, interaction=interaction, propose=propose, generations=200)
    asked = sum(c.question is Question.DATASET for generation in generations for c in generation)
    assert 98 <= asked <= 100, "a child and its parts are at most three evaluations"
    assert asked == len(state.individuals) + len(state.parts)


@pytest.mark.parametrize("name", ["alphas", "added_harms", "part_alphas"])
def test_a_document_with_too_few_values_is_refused(name: str) -> None:
    state, _ = run_to_end(generations=1)
    document = SIMOOD.dump(state)
    damaged = dataclasses.replace(document, arrays={**document.arrays, name: document.arrays[name][:-1]})
    with pytest.raises(DocumentError, match=f"^{name}: expected [0-9]+ values, got [0-9]+$"):
        SIMOOD.load(SPACE, state.config, damaged, state.archive)


def test_every_individual_is_valid() -> None:
    _, generations = run_to_end(generations=60, mutation_probability=0.9)
    for candidate in (c for generation in generations for c in generation):
        SPACE.check(candidate.vectors)


def test_budget_is_reserved_for_the_finalists() -> None:
    state, generations = run_to_end(budget=20 + 7 + 15, explained=0, interaction="none")
    assert sum(map(len, generations)) == 42
    assert len(generations[-1]) == 15
    assert len(state.archive) == 15


def test_where_nothing_interacts_breeding_is_as_good_as_with_the_papers_fitness() -> None:
    def best(seed: int, **changes: Any) -> float:
        state, _ = run_to_end(one_after_another, seed=seed, generations=60, **changes)
        return float(paper_fitness(state)[list(state.population)].mean())

    for seed in range(4):
        assert best(seed) == best(seed, interaction="none") < best(seed, propose="random")


def test_parts_stay_within_the_budget() -> None:
    for interaction, least in (("finalists", 105), ("fitness", 135), ("added_harm", 135)):
        state, generations = run_to_end(interacting, interaction=interaction, budget=least)
        assert sum(map(len, generations)) <= least
        assert len({c.vectors[1].tobytes() for c in generations[-1]}) >= 1
        assert len(finalists_of(state)) == 5

import dataclasses
from collections import Counter
from typing import Any

import numpy as np
import pytest

from brink.search.algorithm import Candidate, Evaluation, Failed, Scored
from brink.search.algorithms.ledger import Ledger
from brink.search.algorithms.mlcshe import (
    Mlcshe,
    MlcsheConfig,
    MlcsheState,
    Population,
    mutation_rates,
    population_archive,
)
from brink.search.archive import archive_digest
from brink.search.errors import ConfigError, DocumentError, OrderError, UnsupportedSpace
from brink.search.metric import Metric
from brink.search.operators import offspring
from brink.search.space import Categorical, Component, Integer, Real, SearchSpace
from brink.search.testing import check_algorithm, example_spaces, synthetic_verdicts

SPACE = example_spaces()["mixed"]
MLCSHE = Mlcshe()
CONFIG = MlcsheConfig()


def told(state: MlcsheState, failing: float = 0.0) -> tuple[MlcsheState, tuple[Candidate, ...]]:
    verdicts = synthetic_verdicts(SPACE, failing)
    state, candidates = MLCSHE.ask(state)
    return MLCSHE.tell(state, {c.number: verdicts(c) for c in candidates}), candidates


def started(budget: int = 400, **changes: object) -> MlcsheState:
    config = dataclasses.replace(CONFIG, **changes)  # type: ignore[arg-type]
    return MLCSHE.start(SPACE, config, seed=1, budget=budget)


def test_first_generation_joins_all_pairs() -> None:
    _, candidates = MLCSHE.ask(started())
    first = {c.vectors[0].tobytes() for c in candidates}
    second = {c.vectors[1].tobytes() for c in candidates}
    # There are only 15 scenarios, so some were drawn twice; their pairs are asked once.
    assert len(candidates) == len(first) * len(second)
    assert len(second) == 10


def test_later_generations_join_individuals_with_the_other_archive() -> None:
    state, _ = told(started())
    first, second = state.populations
    assert len(first) == len(second) == 10
    assert 1 <= first.archived <= 3
    _, candidates = MLCSHE.ask(state)
    archived = [
        {row.tobytes() for row in population.individuals[population.outside :]}
        for population in state.populations
    ]
    for candidate in candidates:
        assert any(
            vector.tobytes() in known for vector, known in zip(candidate.vectors, archived, strict=True)
        )
    joined = {(c.vectors[0].tobytes(), c.vectors[1].tobytes()) for c in candidates}
    seen = {(v[:2].tobytes(), v[2:].tobytes()) for v in state.archive.vectors}
    for scenario in first.individuals:
        for behaviour in second.individuals[second.outside :]:
            assert (scenario.tobytes(), behaviour.tobytes()) in joined | seen


def test_missing_partners_are_drawn_from_outside_the_archive() -> None:
    state, _ = told(started(partners=5, archive_size=1))
    _, candidates = MLCSHE.ask(state)
    seen = {(v[:2].tobytes(), v[2:].tobytes()) for v in state.archive.vectors}
    pairs = {(c.vectors[0].tobytes(), c.vectors[1].tobytes()) for c in candidates} | seen
    for scenario in {row.tobytes() for row in state.populations[0].individuals}:
        assert sum(pair[0] == scenario for pair in pairs) >= 5


def test_population_archive_starts_with_the_best_and_keeps_its_distance() -> None:
    state = started(archive_distance=0.4)
    for _ in range(4):
        before = state.populations
        state, _ = told(state)
        for index, population in enumerate(state.populations):
            archived = population.individuals[population.outside :]
            assert 1 <= len(archived) <= 3
            distance = Metric.of_component(SPACE, index).between(archived, archived)
            assert np.all(distance[~np.eye(len(archived), dtype=bool)] >= 0.4)
            part = SPACE.slices[index]
            fitness = {
                row.tobytes(): state.archive.fitness[
                    (state.archive.vectors[:, part] == row).all(axis=1)
                ].min()
                for row in before[index].individuals
            }
            assert fitness[archived[0].tobytes()] == min(fitness.values())


def test_individual_whose_solutions_all_failed_is_dropped() -> None:
    state = started()
    state, candidates = MLCSHE.ask(state)
    victim = candidates[0].vectors[1].tobytes()
    verdicts = synthetic_verdicts(SPACE, 0.0)
    evaluations: dict[int, Evaluation] = {
        c.number: Failed(reason="crashed") if c.vectors[1].tobytes() == victim else verdicts(c)
        for c in candidates
    }
    state = MLCSHE.tell(state, evaluations)
    population = state.populations[1]
    assert victim not in {row.tobytes() for row in population.individuals[population.outside :]}
    assert len(state.ledger.failed) == sum(isinstance(e, Failed) for e in evaluations.values()) > 0
    assert victim not in {row.tobytes() for row in state.archive.vectors[:, 2:]}


def test_search_continues_when_a_whole_generation_fails() -> None:
    state, candidates = told(started(), failing=1.0)
    assert len(state.archive) == 0
    assert state.ledger.spent == len(candidates)
    asked_before = {SPACE.join(c.vectors).tobytes() for c in candidates}
    state, candidates = MLCSHE.ask(state)
    assert candidates
    assert asked_before.isdisjoint(SPACE.join(c.vectors).tobytes() for c in candidates)
    assert candidates[0].number == len(asked_before)


@pytest.mark.parametrize(
    ("changes", "budget", "field"),
    [
        ({}, 99, "budget"),
        ({"population_size": 20}, 399, "budget"),
        ({"archive_size": 10}, 400, "archive_size"),
        ({"archive_size": 11}, 400, "archive_size"),
        ({"partners": 11}, 400, "partners"),
    ],
)
def test_inconsistent_settings_are_named_by_field(changes: dict[str, Any], budget: int, field: str) -> None:
    with pytest.raises(ConfigError) as caught:
        MLCSHE.check(SPACE, MlcsheConfig(**changes), budget=budget)
    assert caught.value.field == field


@pytest.mark.parametrize("count", [1, 3])
def test_spaces_without_exactly_two_components_are_rejected(count: int) -> None:
    space = SearchSpace(tuple(Component(f"part-{i}", (Real("x", 0.0, 1.0),)) for i in range(count)))
    with pytest.raises(UnsupportedSpace, match="two components"):
        MLCSHE.start(space, CONFIG, seed=0, budget=400)


def test_stored_state_is_rejected_with_another_archive_or_settings() -> None:
    state, _ = told(started())
    document = MLCSHE.dump(state)
    with pytest.raises(DocumentError, match="expected the archive of"):
        MLCSHE.load(SPACE, CONFIG, document, state.archive.first(3))
    with pytest.raises(DocumentError, match="radius"):
        MLCSHE.load(SPACE, MlcsheConfig(radius=0.1), document, state.archive)
    with pytest.raises(DocumentError, match="rows of 14"):
        MLCSHE.load(example_spaces()["categorical"], CONFIG, document, state.archive)
    for broken in (
        {"seed": "1"},
        {"flight": 1},
        {"flight": [10_000]},
        {"population_archives": [1]},
        {"archived": None},
    ):
        with pytest.raises(DocumentError, match=next(iter(broken))):
            MLCSHE.load(
                SPACE,
                CONFIG,
                dataclasses.replace(document, header={**document.header, **broken}),
                state.archive,
            )


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("mixed", "9f6443ab0b4c6cfde11bb7d45cd0ce0a2d8b19df7c8649eed2faeab27e3b3432"),
        ("numeric", "8c9fd764ca01bf1bd79cf29cc5bfb1fdc374d9283bc1b59fb98d13967d0e9f25"),
        ("categorical", "b7d34fbff9ac38572bbe399716f13a1de39154c507824edc1ba007d6cc4f4fb1"),
    ],
)
def test_default_settings_give_the_archives_they_gave_before_there_were_others(
    name: str, digest: str
) -> None:
    space = example_spaces()[name]
    verdicts = synthetic_verdicts(space, 0.05)
    state = MLCSHE.start(space, CONFIG, seed=7, budget=300)
    while not MLCSHE.finished(state):
        state, candidates = MLCSHE.ask(state)
        state = MLCSHE.tell(state, {c.number: verdicts(c) for c in candidates})
    assert archive_digest(state.archive) == digest


def test_mutation_rates_are_products_of_three_numbers() -> None:
    component = Component(
        "any", (Real("speed", 0.0, 1.0), Categorical("label", ("a", "b")), Integer("step", 0, 9))
    )
    assert mutation_rates(component, 0, CONFIG).tolist() == [1.0, 1.0, 1.0]
    config = MlcsheConfig(
        mutation_probability=0.5,
        real_mutation_factor=0.4,
        categorical_mutation_factor=0.2,
        integer_mutation_factor=0.0,
        scenario_mutation_factor=0.5,
    )
    assert mutation_rates(component, 0, config).tolist() == pytest.approx([0.1, 0.05, 0.0])
    assert mutation_rates(component, 1, config).tolist() == pytest.approx([0.2, 0.1, 0.0])


def surviving(probability: float, children: int = 6_000) -> float:
    """Return how often children of two equal parents have the parents' category, one of four."""
    component = Component("scenario", (Categorical("road", ("a", "b", "c", "d")),))
    parent, rng = np.array([2.0]), np.random.default_rng(1)
    bred = [
        float(child[0])
        for _ in range(children // 2)
        for child in offspring(component, parent, parent, crossover=0.5, mutation=probability, rng=rng)
    ]
    return Counter(bred)[2.0] / len(bred)


@pytest.mark.parametrize(
    ("probability", "share"), [(1.0, 1 / 4), (0.2, 0.8 + 0.2 / 4), (0.05, 0.95 + 0.05 / 4)]
)
def test_a_category_survives_unless_it_is_redrawn_as_another_one(probability: float, share: float) -> None:
    assert surviving(probability) == pytest.approx(share, abs=0.02)  # 3.5 standard errors at most


def ranking(fitness: list[float], **changes: object) -> list[tuple[int, ...]]:
    """Return the population archives of ten seeds after a first generation in which individuals have this fitness."""
    space = example_spaces()["numeric"]
    config = dataclasses.replace(CONFIG, **changes)  # type: ignore[arg-type]
    rows = np.stack([np.linspace(1.0, 60.0, len(fitness)), np.linspace(-3.0, 3.0, len(fitness))], axis=1)
    population = Population(individuals=rows, archived=len(rows))
    return [
        population_archive(
            MlcsheState(
                config=config,
                ledger=Ledger.start(space, config, seed=seed, budget=100),
                populations=(population, population),
            ),
            0,
            np.array(fitness),
        )
        for seed in range(10)
    ]


FITNESS = [0.9, 0.2, 0.5, np.inf, 0.1, 0.8]


def test_archive_of_the_best_has_the_smallest_fitness() -> None:
    assert set(ranking(FITNESS, archive_strategy="best")) == {(4, 1, 2)}


def test_archive_of_random_individuals_ignores_fitness_but_not_failures() -> None:
    found = ranking(FITNESS, archive_strategy="random")
    assert all(len(set(one)) == 3 for one in found)
    assert len(set(found)) > 5
    assert {position for one in found for position in one} == {0, 1, 2, 4, 5}


def test_diverse_archive_starts_with_the_best_and_with_any_without_selection() -> None:
    assert {one[0] for one in ranking(FITNESS)} == {4}
    equal = [0.0, 0.0, 0.0, np.inf, 0.0, 0.0]
    firsts = {one[0] for one in ranking(equal, selection="none")}
    assert len(firsts) > 2
    assert 3 not in firsts


def test_fitness_of_an_individual_is_the_chosen_aggregate_of_its_solutions() -> None:
    state, _ = told(started())
    ledger, part = state.ledger, SPACE.slices[0]
    individuals = np.array(sorted({tuple(row) for row in state.archive.vectors[:, part].tolist()}))
    stranger = individuals[:1] + 1e6
    for aggregate, combine in (("best", np.min), ("mean", np.mean), ("worst", np.max)):
        expected = [
            combine(state.archive.fitness[(state.archive.vectors[:, part] == row).all(axis=1)])
            for row in individuals
        ]
        found = ledger.fitness_of(part, np.concatenate([individuals, stranger]), aggregate)
        assert found[:-1].tolist() == pytest.approx(expected)
        assert found[-1] == np.inf


def test_without_selection_verdicts_have_no_effect_on_what_is_bred() -> None:
    def bred(unsafe: bool, selection: str) -> list[list[float]]:
        state = started(selection=selection)
        state, candidates = MLCSHE.ask(state)
        verdicts = {c.number: Scored(unsafe=unsafe and c.number % 3 == 0, robustness=1.0) for c in candidates}
        state = MLCSHE.tell(state, verdicts)
        return [population.individuals.tolist() for population in state.populations]

    assert bred(True, "none") == bred(False, "none")
    assert bred(True, "fitness") != bred(False, "fitness")


@pytest.mark.parametrize(
    "changes",
    [
        {"selection": "none"},
        {"archive_strategy": "best", "fitness_aggregate": "mean"},
        {"archive_strategy": "random", "fitness_aggregate": "worst"},
        {"mutation_probability": 0.2, "categorical_mutation_factor": 0.25},
    ],
)
def test_every_strategy_keeps_the_contract(changes: dict[str, object]) -> None:
    config = dataclasses.replace(CONFIG, **changes)  # type: ignore[arg-type]
    check_algorithm(MLCSHE, SPACE, budget=150, config=config)


def test_unknown_strategies_are_named_by_field() -> None:
    for field in ("selection", "archive_strategy", "fitness_aggregate"):
        with pytest.raises(ConfigError) as caught:
            MlcsheConfig(**{field: "other"})  # type: ignore[arg-type]
        assert caught.value.field == field


def test_failures_count_towards_the_budget() -> None:
    state = started(budget=150)
    while not MLCSHE.finished(state):
        state, _ = told(state, failing=1.0)
    assert state.ledger.spent >= 150
    assert len(state.archive) == 0


def test_budget_is_checked_after_each_generation() -> None:
    state = started(budget=110)
    sizes = []
    while not MLCSHE.finished(state):
        state, candidates = told(state)
        sizes.append(len(candidates))
    assert sum(sizes[:-1]) < 110 <= sum(sizes)
    with pytest.raises(OrderError, match="finished"):
        MLCSHE.ask(state)


def test_exhausted_space_ends_the_search() -> None:
    tiny = SearchSpace(
        (
            Component("u", (Categorical("a", ("0", "1", "2")), Categorical("b", ("0", "1")))),
            Component("v", (Categorical("c", ("0", "1", "2", "3")),)),
        )
    )
    state = MLCSHE.start(tiny, CONFIG, seed=0, budget=1000)
    while not MLCSHE.finished(state):
        state, candidates = MLCSHE.ask(state)
        state = MLCSHE.tell(state, {c.number: Scored(unsafe=False, robustness=1.0) for c in candidates})
    assert len(state.archive) == 24


def test_later_generations_leave_earlier_states_unchanged() -> None:
    state, _ = told(started())
    stored = MLCSHE.dump(state).to_bytes()
    later = state
    for _ in range(3):
        later, _ = told(later)
    assert MLCSHE.dump(state).to_bytes() == stored
    assert len(later.archive) > len(state.archive)


def test_defaults_are_those_of_the_paper_or_of_the_authors_code() -> None:
    assert (CONFIG.population_size, CONFIG.archive_size, CONFIG.archive_distance) == (10, 3, 0.4)
    assert CONFIG.partners == 1
    assert (CONFIG.gene_swap_probability, CONFIG.mutation_probability) == (0.5, 1.0)
    assert (CONFIG.p_th, CONFIG.z) == (0.1, 1.96)
    assert (CONFIG.archive_strategy, CONFIG.fitness_aggregate) == ("diverse", "best")
    assert (CONFIG.radius, CONFIG.tournament_size) == (0.3, 3), "not in the paper, but in the authors' code"


def test_genes_with_rate_zero_only_come_from_the_first_population() -> None:
    start = started(scenario_mutation_factor=0.0)
    first = {tuple(row) for row in start.populations[0].individuals.tolist()}
    weathers, cars = ({row[place] for row in first} for place in (0, 1))
    state = start
    for _ in range(3):  # before a converged population is replaced by a random one
        state, candidates = told(state)
        for candidate in candidates:
            weather, count = candidate.vectors[0].tolist()
            assert weather in weathers
            assert count in cars

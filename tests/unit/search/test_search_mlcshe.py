import dataclasses

import numpy as np
import pytest

from brink.search.algorithm import Candidate, Evaluation, Failed, Scored
from brink.search.algorithms.mlcshe import Mlcshe, MlcsheConfig, MlcsheState
from brink.search.errors import ConfigError, DocumentError, OrderError, UnsupportedSpace
from brink.search.metric import Metric
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.search.testing import example_spaces, synthetic_verdicts

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
def test_inconsistent_settings_are_named_by_field(changes: dict[str, int], budget: int, field: str) -> None:
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


def test_defaults_are_those_of_the_paper() -> None:
    assert (CONFIG.population_size, CONFIG.archive_size, CONFIG.archive_distance) == (10, 3, 0.4)
    assert (CONFIG.partners, CONFIG.tournament_size) == (1, 3)
    assert (CONFIG.gene_swap_probability, CONFIG.mutation_probability) == (0.5, 1.0)
    assert (CONFIG.p_th, CONFIG.z) == (0.1, 1.96)

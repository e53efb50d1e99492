"""Multi-objective searches on traffic: survival, adaptive breeding, seeds from outside."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from brink.search.actions.distance import matched_distances
from brink.search.actions.genome import Genome
from brink.search.actions.participants import MOST_ACTIONS
from brink.search.actions.patterns import MOTIFS, PATTERNS, hostile_solution
from brink.search.actions.road import RoadLimits
from brink.search.actions.rollout import rolled_out
from brink.search.actions.rule import participants_component
from brink.search.actions.variation import (
    crossed_genes,
    crossed_uniformly,
    major_change,
    prolonged,
    small_change,
)
from brink.search.algorithm import Candidate, Evaluation, Failed, Scored
from brink.search.algorithms.multi_objective import CRITICALITY, MultiObjectiveState, diversities, gap_of
from brink.search.algorithms.mumoea import Mumoea, MumoeaConfig, MumoeaState, different_enough
from brink.search.algorithms.nsga2 import Mosat, Nsga2, Nsga2Config
from brink.search.document import Document
from brink.search.errors import ConfigError, OrderError
from brink.search.pareto import dominates
from brink.search.seeding import Origin, Proposal
from brink.search.space import Categorical, Component, SearchSpace
from brink.search.testing import check_algorithm

ROAD = RoadLimits(streets_m=(30.0,))
SPACE = SearchSpace(
    (
        Component("scenario", (Categorical("weather", ("dry", "wet")),)),
        participants_component("npcs", 3, ROAD),
    )
)
GENOME = Genome.of(SPACE)
MUMOEA = Mumoea()
SMALL = MumoeaConfig(population_size=12, seeds=4)


@lru_cache(maxsize=4096)
def _gaps(vector: bytes) -> tuple[float, ...]:
    """Return how near each participant comes to an ego that drives on at 8 m/s."""
    gaps = []
    for one in GENOME.rule.read(np.frombuffer(vector)):
        stretches = rolled_out(one, ROAD, 15.0)
        nearest = math.inf
        for time_s in np.arange(0.0, 15.0, 0.5).tolist():
            here = next(s for s in stretches if time_s <= s.from_s + s.lasts_s)
            share = (time_s - here.from_s) / here.lasts_s
            s_m = here.s_m + share * (here.end[0] - here.s_m)
            d_m = here.d_m + share * (here.end[1] - here.d_m)
            nearest = min(nearest, math.hypot(s_m - 8.0 * time_s, d_m) - 2.5)
        gaps.append(nearest)
    return tuple(gaps)


def driven(candidate: Candidate) -> Evaluation:
    if candidate.number % 23 == 7:
        return Failed(reason="made up")
    gaps = _gaps(candidate.vectors[1].tobytes())
    objectives = {CRITICALITY: min(gaps)} | {gap_of(i): gap for i, gap in enumerate(gaps, start=1)}
    return Scored(unsafe=min(gaps) < 0, robustness=min(gaps), objectives=objectives)


def told(algorithm: Any, state: Any) -> Any:
    state, candidates = algorithm.ask(state)
    return algorithm.tell(state, {c.number: driven(c) for c in candidates})


def run(config: MumoeaConfig, generations: int, seeds: Sequence[Proposal] = (), seed: int = 1) -> MumoeaState:
    state = MUMOEA.start(SPACE, config, seed=seed, budget=10_000)
    while state.generation < generations:
        if MUMOEA.wanted(state) is not None:
            state = MUMOEA.seeded(state, seeds)
            continue
        state = told(MUMOEA, state)
    return state


@pytest.mark.parametrize("algorithm", [Nsga2(), Mosat(), Mumoea()], ids=lambda one: one.id)
def test_the_population_is_the_best_of_parents_and_children(algorithm: Any) -> None:
    config = replace(algorithm.config_type(), population_size=12)
    state: MultiObjectiveState = algorithm.start(SPACE, config, seed=1, budget=1_000)
    for _ in range(4):
        before = state
        state = told(algorithm, state)
        fresh = range(len(before.book), len(state.book))
        pool = [*before.population, *(n for n in fresh if state.book.judged[n])]
        assert set(state.population) <= set(pool)
        assert len(state.population) == min(12, len(pool))
        diversity = diversities(GENOME, state.book, pool, config)
        beats = dominates(np.stack([state.book.criticality[pool], -diversity], axis=1))
        gone = [place for place, number in enumerate(pool) if number not in state.population]
        kept = [place for place, number in enumerate(pool) if number in state.population]
        assert not beats[np.ix_(gone, kept)].any()


def test_a_failure_never_survives() -> None:
    state = run(SMALL, 6)
    assert any(not judged for judged in state.book.judged)
    assert state.book.judged[list(state.population)].all()


def test_every_solution_says_where_it_comes_from() -> None:
    state = run(replace(SMALL, differential="always"), 5)
    origins = {state.book.origin(number) for number in range(len(state.book))}
    assert {Origin.HEURISTIC, Origin.MUTATION, Origin.CROSSOVER} <= origins
    assert {state.book.origin(number) for number in range(12)} == {Origin.HEURISTIC}
    randomly = run(replace(SMALL, initial="random", differential="never"), 5)
    assert {randomly.book.origin(number) for number in range(12)} == {Origin.RANDOM}
    assert Origin.HEURISTIC not in {randomly.book.origin(n) for n in range(len(randomly.book))}


def test_critical_solutions_are_found_more_often_as_it_goes_on() -> None:
    state = run(replace(SMALL, initial="random"), 12)
    unsafe = state.book.unsafe
    assert unsafe[-48:].mean() > unsafe[:24].mean()


def test_diversity_is_the_mean_distance_to_others_of_late() -> None:
    state = run(replace(SMALL, lately=2), 5)
    number = state.population[0]
    lately = [n for n in state.book.lately(2) if n != number]
    assert min(state.book.generations[lately]) >= 3
    rolled = GENOME.rolled_out(GENOME.solution(state.book.rows[n]) for n in [number, *lately])
    sums = []
    for other in range(1, len(lately) + 1):
        pairs = []
        for a in range(3):
            for b in range(3):
                shared = int(min(rolled.actions[0, a], rolled.actions[other, b]))
                if shared:
                    apart = rolled.points[0, a, :shared] - rolled.points[other, b, :shared]
                    pairs.append(float(np.linalg.norm(apart, axis=1).sum()))
        sums.append(np.mean(pairs))
    found = diversities(GENOME, state.book, [number], state.config)
    assert found[0] == pytest.approx(np.mean(sums))
    least = diversities(GENOME, state.book, [number], replace(state.config, diversity="min"))
    assert least[0] == pytest.approx(min(sums))


def same_front(state: MumoeaState) -> Mapping[int, Evaluation]:
    """Return evaluations that leave the front as it is: nobody gets a verdict."""
    return {candidate.number: Failed(reason="made up") for candidate in state.pending}


def showing(state: MumoeaState, *kinds: str) -> Mapping[int, Evaluation]:
    """Return evaluations of which the last one shows kinds of violations."""
    evaluations = {candidate.number: driven(candidate) for candidate in state.pending}
    shown = Scored(unsafe=True, robustness=-1.0, objectives={CRITICALITY: -1.0}, kinds=frozenset(kinds))
    return {**evaluations, state.pending[-1].number: shown}


def test_generations_without_a_new_kind_of_violation_bring_differential_seeds() -> None:
    config = replace(SMALL, seeder="llm", initial="random", stuck_after=2)
    state = MUMOEA.start(SPACE, config, seed=1, budget=10_000)
    stuck = []
    for kinds in (("a",), ("a",), ("b",), ("a", "b"), ("b",)):
        assert MUMOEA.wanted(state) is None
        asked, _ = MUMOEA.ask(state)
        state = MUMOEA.tell(asked, showing(asked, *kinds))
        state = MUMOEA.load(SPACE, config, MUMOEA.dump(state), state.archive)
        stuck.append(state.stuck)
    assert MUMOEA.wanted(state) is not None
    assert state.kinds == {"a", "b"}
    assert stuck == [0, 1, 0, 1, 0]


def test_patterns_that_unstick_begin_as_patterns_do_and_go_on() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        for one in hostile_solution(ROAD, 3, rng):
            longer = prolonged(one, rng)
            assert longer.genes[: len(one.genes)] == one.genes
            assert len(longer.genes) <= MOST_ACTIONS
            assert replace(longer, genes=one.genes) == one


def test_a_front_that_stays_the_same_may_bring_them_too() -> None:
    state = run(replace(SMALL, initial="random", stuck_by="front", stuck_after=2), 3)
    stuck = []
    for _ in range(3):
        asked, _ = MUMOEA.ask(state)
        state = MUMOEA.tell(asked, same_front(asked))
        stuck.append(state.stuck)
    assert stuck[:2] == [1, 0]
    never = run(replace(SMALL, initial="random", differential="never", stuck_by="front", lately=50), 3)
    for _ in range(3):
        asked, _ = MUMOEA.ask(never)
        never = MUMOEA.tell(asked, same_front(asked))
    assert never.stuck >= 3
    assert Origin.HEURISTIC not in set(never.queue_origins)


def test_what_is_wanted_first_is_a_whole_population() -> None:
    config = replace(SMALL, seeder="llm")
    state = MUMOEA.start(SPACE, config, seed=1, budget=1_000)
    request = MUMOEA.wanted(state)
    assert request is not None
    assert (request.number, request.count, request.exposed, request.round) == (0, 12, (), 0)
    assert not MUMOEA.finished(state)
    with pytest.raises(OrderError, match="seeds that are wanted"):
        MUMOEA.ask(state)
    rng = np.random.default_rng(5)
    mine = GENOME.repaired(hostile_solution(ROAD, 3, rng), rng)
    state = MUMOEA.seeded(state, [Proposal(solution=mine, origin=Origin.LLM)])
    assert MUMOEA.wanted(state) is None
    state, candidates = MUMOEA.ask(state)
    assert len(candidates) == 12
    assert GENOME.solution(np.concatenate(candidates[0].vectors)) == mine
    assert state.queue_origins == (Origin.LLM, *[Origin.HEURISTIC] * 11)
    with pytest.raises(OrderError, match="nothing is wanted"):
        MUMOEA.seeded(state, [])


def test_seeds_that_do_not_differ_go_back_and_then_major_mutants_take_their_place() -> None:
    config = replace(SMALL, seeder="llm", initial="random", stuck_by="front", stuck_after=1, rounds=2)
    state = run(config, 3)
    while MUMOEA.wanted(state) is None:
        asked, _ = MUMOEA.ask(state)
        state = MUMOEA.tell(asked, same_front(asked))
    first = MUMOEA.wanted(state)
    assert first is not None
    copies = [Proposal(solution=first.exposed[0], origin=Origin.LLM)] * 4
    for number in range(3):
        request = MUMOEA.wanted(state)
        assert request is not None
        assert (request.round, request.number) == (number, number)
        assert len(request.rejected) == (0 if number == 0 else 4)
        assert request.exposed or request.silent
        stored = MUMOEA.dump(state).to_bytes()
        again = MUMOEA.load(SPACE, config, Document.from_bytes(stored), state.archive)
        assert MUMOEA.wanted(again) == request
        state = MUMOEA.seeded(again, copies)
    assert MUMOEA.wanted(state) is None
    assert Origin.LLM not in state.queue_origins
    assert state.queue_origins[:4] == (Origin.MUTATION,) * 4


def test_nobody_who_answers_means_patterns_and_no_further_round() -> None:
    config = replace(SMALL, seeder="llm", initial="random", differential="always")
    state = run(config, 1)
    assert MUMOEA.wanted(state) is not None
    state = MUMOEA.seeded(state, [])
    assert MUMOEA.wanted(state) is None
    assert set(state.queue_origins) <= {Origin.HEURISTIC, Origin.MUTATION, Origin.CROSSOVER}


def test_different_enough_is_as_far_as_known_ones_are_apart() -> None:
    state = run(SMALL, 4)
    known = state.book.lately(5)
    copies = [state.book.rows[number] for number in known[:3]]
    assert different_enough(state, [], GENOME) == []
    rng = np.random.default_rng(0)
    drawn = [GENOME.row(GENOME.random(rng), None, rng) for _ in range(30)]
    fine = different_enough(state, drawn, GENOME)
    far = matched_distances(
        GENOME.rolled_out(GENOME.solution(row) for row in drawn),
        GENOME.rolled_out(GENOME.solution(state.book.rows[n]) for n in known),
    ).mean(axis=1)
    assert any(fine)
    assert not all(fine)
    assert far[fine].mean() > far[[not one for one in fine]].mean()
    exposed = [state.book.rows[n] for n in known if state.book.unsafe[n]][-12:]
    assert not any(different_enough(state, exposed, GENOME)), copies


def test_seeds_of_one_reply_must_differ_from_each_other() -> None:
    state = run(SMALL, 4)
    rng = np.random.default_rng(0)
    drawn = [GENOME.row(GENOME.random(rng), None, rng) for _ in range(30)]
    fine = [row for row, good in zip(drawn, different_enough(state, drawn, GENOME), strict=True) if good]
    repeated = different_enough(state, [fine[0], fine[0], fine[0]], GENOME)
    assert repeated == [True, False, False]
    taken = replace(state, taken=((fine[0], Origin.LLM),))
    assert different_enough(taken, [fine[0]], GENOME) == [False]


@pytest.mark.parametrize("pattern", [*PATTERNS, *MOTIFS], ids=lambda one: one.__name__)
def test_a_pattern_can_be_driven_as_it_is_but_for_who_stands_in_its_way(pattern: Any) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        solution = pattern(ROAD, rng)
        mended = GENOME.repaired(solution, rng)
        assert [one.kind for one in mended] == [one.kind for one in solution]
        assert [[gene.action for gene in one.genes] for one in mended] == [
            [gene.action for gene in one.genes] for one in solution
        ]


def test_variation_touches_no_parent_and_gives_what_can_be_mended() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        mother, father = (GENOME.random(rng) for _ in range(2))
        kept = repr((mother, father))
        for child in (
            *crossed_uniformly(mother, father, rng),
            (small_change(mother[0], rng),),
            (major_change(mother[0], rng),),
            crossed_genes(mother[0], father[0], rng),
        ):
            assert child
            assert all(2 <= len(one.genes) <= 8 for one in child)
            SPACE.components[1].repair(GENOME.rule.written(child[:3]), rng)
        assert repr((mother, father)) == kept


def test_settings_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ConfigError, match="at most population_size"):
        MUMOEA.check(SPACE, MumoeaConfig(population_size=8, seeds=9), budget=100)
    never = MumoeaConfig(seeder="llm", initial="random", differential="never")
    with pytest.raises(ConfigError, match="never asked"):
        MUMOEA.check(SPACE, never, budget=100)
    with pytest.raises(ConfigError, match="50 simulations"):
        Nsga2().check(SPACE, Nsga2Config(), budget=49)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"differential": "always"},
        {"initial": "random", "differential": "never"},
        {"crossover": "srinivas"},
    ],
)
def test_the_contract_holds_with_other_settings(changes: dict[str, Any]) -> None:
    check_algorithm(MUMOEA, SPACE, budget=100, config=replace(SMALL, **changes), evaluate=driven)

"""Multi-objective searches on traffic: survival, adaptive rates and breeding, seeds from outside."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from support.marks import mostly_long

from brink.search.algorithm import Candidate, Evaluation, Failed, Origin, Proposal, Scored
from brink.search.algorithms.multi_objective import (
    CRITICALITY,
    MultiObjectiveState,
    diversities,
    gap_objective,
)
from brink.search.algorithms.mumoea import (
    Crossover,
    FitnessRange,
    Mumoea,
    MumoeaConfig,
    MumoeaState,
    crossover_probability,
    different_enough,
    mutation_probability,
    scalar_fitness,
    scaled,
)
from brink.search.algorithms.nsga2 import Breeding, Mosat, Nsga2, Nsga2Config
from brink.search.document import Document
from brink.search.errors import ConfigError, OrderError, OtherVersion
from brink.search.pareto import dominates
from brink.search.space import Categorical, Component, FloatArray, SearchSpace
from brink.search.testing import check_algorithm
from brink.search.traffic.constraint import participants_component
from brink.search.traffic.motion import Distance, encounter_distances, matched_distances, roll_out
from brink.search.traffic.participants import Action, Gene, RoadLimits
from brink.search.traffic.variation import (
    MOTIFS,
    PATTERNS,
    TrafficGenome,
    crossed_genes,
    crossed_uniformly,
    hostile_solution,
    major_change,
    person_crosses,
    small_change,
)

ROAD = RoadLimits(streets_m=(30.0,))
SPACE = SearchSpace(
    (
        Component("scenario", (Categorical("weather", ("dry", "wet")),)),
        participants_component("npcs", 3, ROAD),
    )
)
GENOME = TrafficGenome.of(SPACE)
MUMOEA = Mumoea()
SMALL = MumoeaConfig(population_size=12, seeds=4)


@lru_cache(maxsize=4096)
def _gaps(vector: bytes) -> tuple[float, ...]:
    """Return the smallest gap of each participant to an ego that drives at a constant 8 m/s."""
    gaps = []
    for one in GENOME.rule.decode(np.frombuffer(vector)):
        stretches = roll_out(one, ROAD, 15.0)
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
        return Failed(reason="synthetic")
    gaps = _gaps(candidate.vectors[1].tobytes())
    objectives = {CRITICALITY: min(gaps)} | {gap_objective(i): gap for i, gap in enumerate(gaps, start=1)}
    return Scored(unsafe=min(gaps) < 0, robustness=min(gaps), objectives=objectives)


def test_a_violation_that_does_not_count_is_no_success_and_bounds_nothing() -> None:
    state, candidates = MUMOEA.ask(MUMOEA.start(SPACE, MumoeaConfig(population_size=10), seed=1, budget=20))
    worthless = candidates[0].number

    def judged(candidate: Candidate) -> Scored:
        if candidate.number == worthless:
            objectives = {CRITICALITY: 250.0}
            return Scored(unsafe=True, robustness=-1.0, objectives=objectives, counts=False)
        return Scored(unsafe=False, robustness=1.0, objectives={CRITICALITY: 1.0 + candidate.number})

    state = MUMOEA.tell(state, {one.number: judged(one) for one in candidates})
    assert not state.history.unsafe.any()
    assert state.criticality_bounds.high < 20.0
    assert state.history.criticality[worthless] == 250.0


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
def test_population_is_the_best_of_parents_and_children(algorithm: Any) -> None:
    config = replace(algorithm.config_type(), population_size=12)
    state: MultiObjectiveState = algorithm.start(SPACE, config, seed=1, budget=1_000)
    for _ in range(4):
        before = state
        state = told(algorithm, state)
        fresh = range(len(before.history), len(state.history))
        pool = [*before.population, *(n for n in fresh if state.history.has_verdict[n])]
        assert set(state.population) <= set(pool)
        assert len(state.population) == min(12, len(pool))
        diversity = diversities(GENOME, state.history, pool, config)
        beats = dominates(np.stack([state.history.criticality[pool], -diversity], axis=1))
        gone = [place for place, number in enumerate(pool) if number not in state.population]
        kept = [place for place, number in enumerate(pool) if number in state.population]
        assert not beats[np.ix_(gone, kept)].any()


def test_failed_solutions_never_survive() -> None:
    state = run(SMALL, 6)
    assert any(not known for known in state.history.has_verdict)
    assert state.history.has_verdict[list(state.population)].all()


def test_every_solution_records_its_origin() -> None:
    state = run(replace(SMALL, differential="always"), 5)
    origins = {state.history.origin(number) for number in range(len(state.history))}
    assert {Origin.HEURISTIC, Origin.MUTATION, Origin.CROSSOVER} <= origins
    assert {state.history.origin(number) for number in range(12)} == {Origin.HEURISTIC}
    randomly = run(replace(SMALL, initial="random", differential="never"), 5)
    assert {randomly.history.origin(number) for number in range(12)} == {Origin.RANDOM}
    assert Origin.HEURISTIC not in {randomly.history.origin(n) for n in range(len(randomly.history))}


def test_diversity_is_the_distance_to_recent_solutions() -> None:
    state = run(replace(SMALL, lately=2, distance="paper"), 5)
    number = state.population[0]
    lately = [n for n in state.history.recent(2) if n != number]
    assert min(state.history.generations[lately]) >= 3
    rolled = GENOME.roll_out_rows((state.history.rows[n] for n in [number, *lately]), Distance.PAPER)
    sums = []
    for other in range(1, len(lately) + 1):
        pairs = []
        for a in range(3):
            for b in range(3):
                shared = int(min(rolled.counts[0, a], rolled.counts[other, b]))
                if shared:
                    apart = rolled.points[0, a, :shared] - rolled.points[other, b, :shared]
                    pairs.append(float(np.linalg.norm(apart, axis=1).sum()))
        sums.append(np.mean(pairs))
    found = diversities(GENOME, state.history, [number], state.config)
    assert found[0] == pytest.approx(np.mean(sums))
    least = diversities(GENOME, state.history, [number], replace(state.config, diversity="min"))
    assert least[0] == pytest.approx(min(sums))
    timely = GENOME.roll_out_rows(state.history.rows[n] for n in [number, *lately])
    by_time = diversities(GENOME, state.history, [number], replace(state.config, distance="time"))
    others = timely.take(range(1, len(timely)))
    assert by_time[0] == pytest.approx(encounter_distances(timely.take([0]), others).mean())


def same_front(state: MumoeaState) -> Mapping[int, Evaluation]:
    """Return evaluations without any verdict, which leave the front unchanged."""
    return {candidate.number: Failed(reason="synthetic") for candidate in state.pending}


def showing(state: MumoeaState, *kinds: str) -> Mapping[int, Evaluation]:
    """Return evaluations of which the last one exposes kinds of violations."""
    evaluations = {candidate.number: driven(candidate) for candidate in state.pending}
    shown = Scored(unsafe=True, robustness=-1.0, objectives={CRITICALITY: -1.0}, kinds=frozenset(kinds))
    return {**evaluations, state.pending[-1].number: shown}


def test_generations_without_a_new_kind_of_violation_trigger_differential_seeds() -> None:
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


def test_an_unchanged_front_triggers_differential_seeds() -> None:
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


def test_first_request_is_for_a_whole_population() -> None:
    config = replace(SMALL, seeder="llm")
    state = MUMOEA.start(SPACE, config, seed=1, budget=1_000)
    request = MUMOEA.wanted(state)
    assert request is not None
    assert (request.number, request.count, request.exposed, request.round) == (0, 12, (), 0)
    assert not MUMOEA.finished(state)
    with pytest.raises(OrderError, match="pass the wanted seeds"):
        MUMOEA.ask(state)
    rng = np.random.default_rng(5)
    mine = GENOME.repaired(hostile_solution(ROAD, 3, rng), rng)
    state = MUMOEA.seeded(state, [Proposal(solution=mine, origin=Origin.LLM)])
    assert MUMOEA.wanted(state) is None
    state, candidates = MUMOEA.ask(state)
    assert len(candidates) == 12
    assert GENOME.solution(np.concatenate(candidates[0].vectors)) == mine
    assert state.queue_origins == (Origin.LLM, *[Origin.HEURISTIC] * 11)
    with pytest.raises(OrderError, match="no seeds were requested"):
        MUMOEA.seeded(state, [])


def test_rejected_seeds_are_sent_back_and_finally_replaced_by_major_mutants() -> None:
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


def test_seeds_must_be_as_far_from_known_solutions_as_these_are_apart() -> None:
    state = run(SMALL, 4)
    known = state.history.recent(5)
    copies = [state.history.rows[number] for number in known[:3]]
    assert different_enough(state, [], GENOME) == []
    rng = np.random.default_rng(0)
    drawn = [GENOME.row(GENOME.sample(rng), None, rng) for _ in range(30)]
    fine = different_enough(state, drawn, GENOME)
    far = matched_distances(
        GENOME.roll_out(GENOME.solution(row) for row in drawn),
        GENOME.roll_out(GENOME.solution(state.history.rows[n]) for n in known),
    ).mean(axis=1)
    assert any(fine)
    assert not all(fine)
    assert far[fine].mean() > far[[not one for one in fine]].mean()
    exposed = [state.history.rows[n] for n in known if state.history.unsafe[n]][-12:]
    assert not any(different_enough(state, exposed, GENOME)), copies


def test_seeds_of_one_reply_must_differ_from_each_other() -> None:
    state = run(SMALL, 4)
    rng = np.random.default_rng(0)
    drawn = [GENOME.row(GENOME.sample(rng), None, rng) for _ in range(30)]
    fine = [row for row, good in zip(drawn, different_enough(state, drawn, GENOME), strict=True) if good]
    repeated = different_enough(state, [fine[0], fine[0], fine[0]], GENOME)
    assert repeated == [True, False, False]
    taken = replace(state, taken=((fine[0], Origin.LLM),))
    assert different_enough(taken, [fine[0]], GENOME) == [False]


@pytest.mark.parametrize("pattern", [*PATTERNS, *MOTIFS], ids=lambda one: one.__name__)
def test_repair_keeps_kinds_and_actions_of_every_pattern(pattern: Any) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        solution = pattern(ROAD, rng)
        repaired = GENOME.repaired(solution, rng)
        assert [one.kind for one in repaired] == [one.kind for one in solution]
        assert [[gene.action for gene in one.genes] for one in repaired] == [
            [gene.action for gene in one.genes] for one in solution
        ]


def test_variation_leaves_parents_unchanged_and_gives_repairable_children() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        mother, father = (GENOME.sample(rng) for _ in range(2))
        kept = repr((mother, father))
        for child in (
            *crossed_uniformly(mother, father, rng),
            (small_change(mother[0], rng),),
            (major_change(mother[0], rng),),
            crossed_genes(mother[0], father[0], rng),
        ):
            assert child
            assert all(2 <= len(one.genes) <= 8 for one in child)
            SPACE.components[1].repair(GENOME.rule.encode(child[:3]), rng)
        assert repr((mother, father)) == kept


@given(st.integers(0, 2**32 - 1))
def test_crossed_actions_are_cut_at_the_same_place_and_none_is_lost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mother, father = (GENOME.sample(rng)[0] for _ in range(2))
    son, daughter = crossed_genes(mother, father, rng)
    cuts = [
        cut
        for cut in range(1, min(len(mother.genes), len(father.genes)))
        if son.genes == mother.genes[:cut] + father.genes[cut:]
        and daughter.genes == father.genes[:cut] + mother.genes[cut:]
    ]
    assert mother.genes[cuts[0] : cuts[-1]] == father.genes[cuts[0] : cuts[-1]], "no cut could be told apart"
    assert replace(son, genes=mother.genes) == mother
    assert replace(daughter, genes=father.genes) == father


def test_children_that_equal_a_parent_are_bred_again_then_replaced_by_mutants() -> None:
    usual = Nsga2Config(population_size=12)
    only_copies = replace(usual, crossover_probability=0.0, mutation_probability=0.0)
    for config in (usual, only_copies):
        state: MultiObjectiveState = Nsga2().start(SPACE, config, seed=1, budget=1_000)
        for _ in range(6):
            state = told(Nsga2(), state)
        origins = [state.history.origin(number) for number in range(12, len(state.history))]
        assert len(state.history) == 72
        assert set(origins) == {Origin.MUTATION} | ({Origin.CROSSOVER} if config is usual else set())
        assert len({row.tobytes() for row in state.history.rows}) == 72


def test_a_search_that_an_older_version_began_cannot_be_continued() -> None:
    state = run(SMALL, 2)
    stored = MUMOEA.dump(state)
    with pytest.raises(
        OtherVersion, match="expected a document of mumoea@1, version 3; got 'mumoea@1', version 2"
    ):
        MUMOEA.load(SPACE, SMALL, replace(stored, version=2), state.archive)


def test_inconsistent_settings_are_rejected() -> None:
    with pytest.raises(ConfigError, match="at most population_size"):
        MUMOEA.check(SPACE, MumoeaConfig(population_size=8, seeds=9), budget=100)
    never = MumoeaConfig(seeder="llm", initial="random", differential="never")
    with pytest.raises(ConfigError, match="never be used"):
        MUMOEA.check(SPACE, never, budget=100)
    with pytest.raises(ConfigError, match="50 simulations"):
        Nsga2().check(SPACE, Nsga2Config(), budget=49)


@pytest.mark.parametrize(
    "changes",
    mostly_long(
        [
            {},
            {"differential": "always"},
            {"initial": "random", "differential": "never"},
            {"crossover": "srinivas"},
        ],
        [],
        "searches several times",
    ),
)
def test_contract_holds_with_other_settings(changes: dict[str, Any]) -> None:
    check_algorithm(MUMOEA, SPACE, budget=100, config=replace(SMALL, **changes), evaluate=driven)


FITNESS = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
RANGE = FitnessRange.of(FITNESS)


def test_mutation_rate_falls_to_zero_for_the_best() -> None:
    assert mutation_probability(FITNESS) == pytest.approx([1.0, 0.9, 0.6, 0.3, 0.0])


@pytest.mark.parametrize(
    ("form", "rates"),
    [
        (Crossover.MIRROR, [0.0, 0.3, 0.6, 0.9, 1.0]),
        (Crossover.RECIPROCAL, [0.3, 0.4, 0.6, 1.0, 1.0]),
        # Below the mean the classical form is at its cap; without that branch it would equal the mutation rate.
        (Crossover.SRINIVAS, [1.0, 1.0, 0.6, 0.3, 0.0]),
    ],
)
def test_crossover_rate_depends_on_the_better_parent(form: Crossover, rates: list[float]) -> None:
    assert crossover_probability(FITNESS, RANGE, form) == pytest.approx(rates)


def test_threshold_falls_as_the_population_converges() -> None:
    assert RANGE.threshold() == pytest.approx(0.4)
    assert FitnessRange.of(0.5 + 0.1 * FITNESS).threshold() == pytest.approx(0.04)


@pytest.mark.parametrize("form", list(Crossover))
def test_rates_of_a_uniform_population_are_at_their_caps(form: Crossover) -> None:
    equal = np.full(4, 0.4)
    assert mutation_probability(equal, k4=0.8).tolist() == [0.8] * 4
    assert crossover_probability(equal, FitnessRange.of(equal), form, k3=0.7).tolist() == [0.7] * 4
    assert FitnessRange.of(equal).threshold() == 0.0


@given(arrays(np.float64, st.integers(1, 12), elements=st.floats(0.0, 1.0)), st.sampled_from(Crossover))
def test_rates_are_probabilities(fitness: NDArray[np.float64], form: Crossover) -> None:
    for rates in (
        mutation_probability(fitness),
        crossover_probability(fitness, FitnessRange.of(fitness), form),
    ):
        assert ((rates >= 0) & (rates <= 1)).all()


def test_critical_and_diverse_solutions_are_fit() -> None:
    criticality, diversity = np.array([0.0, 1.0, 0.5]), np.array([1.0, 0.0, 0.5])
    assert scalar_fitness(criticality, diversity).tolist() == [1.0, 0.0, 0.5]
    assert scalar_fitness(criticality, diversity, 1.0).tolist() == [1.0, 0.0, 0.5]
    assert scaled(np.array([-1.0, 2.0, 9.0]), 0.0, 4.0).tolist() == [0.0, 0.5, 1.0]
    assert scaled(np.array([3.0, 3.0]), 3.0, 3.0).tolist() == [0.0, 0.0]


def test_crossed_participants_are_of_like_kind_if_the_other_parent_has_one() -> None:
    rng = np.random.default_rng(1)
    changes = Gene(action=Action.CHANGE_LEFT, duration_s=2.0, magnitude=0.5)
    crosses = Gene(action=Action.CROSS, duration_s=2.0, magnitude=1.5)
    seeds = []
    for number in range(12):
        (car,), (walker,) = PATTERNS[0](ROAD, rng), person_crosses(ROAD, rng)
        pair = (replace(car, genes=(changes,) * (2 + number % 6)), replace(walker, genes=(crosses,) * 3))
        seeds.append(Proposal(solution=GENOME.repaired(pair, rng), origin=Origin.LLM))
    state = run(replace(SMALL, seeder="llm", differential="never"), 1, seeds)
    assert Origin.CROSSOVER in state.queue_origins
    for candidate, origin in zip(state.ledger.queue, state.queue_origins, strict=True):
        if origin is Origin.CROSSOVER:
            # Repair turns a vehicle's `cross` into `keep`, and a pedestrian's `change_left` into `cross`.
            kept = {gene.action for one in GENOME.rule.decode(candidate.vectors[1]) for gene in one.genes}
            assert kept == {Action.CHANGE_LEFT, Action.CROSS}


def test_uncrossed_children_mutate_at_the_configured_rate() -> None:
    for rate in (0.0, 0.3, 1.0):
        state, children = _bred(400, crossover_probability=0.0, mutation_probability=rate)
        assert {origin for _, origin in children} == {Origin.MUTATION}
        # Some mutations change nothing that repair leaves.
        assert _changed(state, children) == pytest.approx(400 * rate, abs=40)
    assert _changed(*_bred(400, crossover_probability=0.0, mutation_probability=0.0)) == 0


def _bred(children: int, **changes: Any) -> tuple[MultiObjectiveState, list[tuple[FloatArray, Origin]]]:
    """Return a state, and children that NSGA-II breeds from its population with other probabilities."""
    config = Nsga2Config(population_size=12, **changes)
    state = told(Nsga2(), Nsga2().start(SPACE, config, seed=1, budget=1_000))
    breeding = Breeding(state, GENOME, lambda config, genome, rng: genome.sample(rng)[0])
    return state, breeding.children(children, np.random.default_rng(3))


def _changed(state: MultiObjectiveState, children: Sequence[tuple[FloatArray, Origin]]) -> int:
    """Return how many children have other participants than every solution of the population."""
    known = {GENOME.solution(state.history.rows[number]) for number in state.population}
    return sum(GENOME.solution(row) not in known for row, _ in children)

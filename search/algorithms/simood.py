"""SiMOOD: a genetic algorithm for the weakest perturbations that together do the most harm to a component.

Individuals are ordered slots of distinct techniques, each at a level (`brink.search.slots`). The search runs in three
stages. In the first, most evaluations measure the component on a data set (`Question.DATASET`), which is cheap. The
finalists, the best individual of each order of techniques, are then simulated, all in the same few scenarios with the
same seeds. Finally the hazardous finalists are explained: their parts and other orders of the same techniques are
simulated in the same scenarios. Only simulated solutions end up in the archive. For comparison, the first stage can
also simulate every individual, or draw individuals at random.

The fitness, minimised, is f = alpha + omega eta, or |omega eta - alpha| if alpha counts errors. alpha is an objective
measured by the problem, eta the mean intensity. No individual is evaluated twice.

Source: Ferreira, Guerin, Guiochet, Waeselynck, "SiMOOD: Evolutionary Testing Simulation with Out-Of-Distribution
Images", PRDC 2022.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Final

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Failed, Question
from brink.search.algorithms.ledger import (
    BoundaryConfig,
    Ledger,
    LedgerAlgorithm,
    LedgerState,
    row_keys,
    stored_rows,
)
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError
from brink.search.settings import setting
from brink.search.slots import ChainGenome
from brink.search.space import FloatArray, SearchSpace, frozen_array
from brink.search.streams import Stream, generator

ALPHA: Final = "alpha"
"""Objective that a problem must measure: the quality of the component, or its number of errors."""


class Stage(StrEnum):
    """Purpose of a generation."""

    SEARCH = "search"
    FINALISTS = "finalists"
    EXPLANATION = "explanation"


@dataclass(frozen=True, slots=True, kw_only=True)
class SimoodConfig(BoundaryConfig):
    """Settings of SiMOOD."""

    generations: int = setting(20, help="Generations after the first population (g).", ge=0, le=10_000)
    population_size: int = setting(20, help="Individuals in the population (n).", ge=2, le=10_000)
    parents: int = setting(2, help="Parents, and children, per generation (k).", ge=2, le=1_000)
    crossover_probability: float = setting(
        0.99, help="Probability that crossover is applied to two parents.", ge=0, le=1
    )
    mutation_probability: float = setting(0.1, help="Probability that a child mutates.", ge=0, le=1)
    omega: float = setting(
        0.5, help="Weight of intensity: larger values favour weaker perturbations.", ge=0, le=1
    )
    alpha: str = setting(
        "quality", help="What alpha measures: quality (mAP) or errors.", choices=("quality", "errors")
    )
    evaluate: str = setting(
        "data",
        help="How individuals are evaluated: on a data set, or in an episode.",
        choices=("data", "episode"),
    )
    propose: str = setting(
        "ga", help="How individuals are proposed: bred, or drawn at random.", choices=("ga", "random")
    )
    finalists: int = setting(5, help="Number of best individuals to simulate at the end.", ge=0, le=10_000)
    repeats: int = setting(3, help="Scenarios in which each finalist is simulated.", ge=1, le=1_000)
    explained: int = setting(
        5,
        help="Number of hazardous finalists whose parts and other orders are also simulated.",
        ge=0,
        le=10_000,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimoodState(LedgerState):
    """State of SiMOOD.

    Attributes:
        config: Settings.
        individuals: All evaluated individuals, in the order of asking, shape ``(a, d)``.
        alphas: Their alpha, infinite if it could not be measured, shape ``(a,)``.
        population: Positions of the population in `individuals`; that of the last generation until the next is told.
        children: Individuals that join the population once they are told, shape ``(c, d)``.
        bred: Number of generations bred so far.
        stage: Purpose of the queue.
    """

    config: SimoodConfig
    individuals: FloatArray
    alphas: FloatArray
    population: tuple[int, ...]
    children: FloatArray
    bred: int
    stage: Stage = Stage.SEARCH

    @property
    def fitness(self) -> FloatArray:
        """Fitness of the population, shape ``(n,)``."""
        return _fitness(self)[list(self.population)]


class Simood(LedgerAlgorithm[SimoodConfig, SimoodState]):
    """A genetic algorithm that evaluates individuals on a data set and simulates the finalists."""

    id = "simood-ga@1"
    summary = "SiMOOD: perturbations bred on a data set, the best of them simulated."
    config_type = SimoodConfig
    layout = 2

    def _min_budget(self, space: SearchSpace, config: SimoodConfig) -> int:
        genome = ChainGenome.of(space)
        if config.parents > config.population_size:
            raise ConfigError("parents", f"expected at most population_size, got {config.parents}")
        if config.evaluate == "data" and not config.finalists:
            raise ConfigError("finalists", "expected at least 1: a data set alone gives no verdict")
        return config.population_size + _reserve(config, genome)

    def _first_state(self, ledger: Ledger, config: SimoodConfig) -> SimoodState:
        genome = ChainGenome.of(ledger.space)
        rng = generator(ledger.seed, Stream.START)
        state = SimoodState(
            config=config,
            ledger=ledger,
            individuals=frozen_array(np.empty((0, genome.component.dimension))),
            alphas=frozen_array(np.empty(0)),
            population=(),
            children=frozen_array(_drawn(genome, config.population_size, rng)),
            bred=0,
        )
        return _with_children_queued(state, genome)

    def tell(self, state: SimoodState, evaluations: Mapping[int, Evaluation]) -> SimoodState:
        """Return the state after the pending generation was evaluated.

        Raises:
            OrderError: Nothing is pending, or the numbers are not those of the pending candidates.
            KeyError: An evaluation lacks the objective alpha.
        """
        pending = state.ledger.pending
        told = replace(state, ledger=state.ledger.tell(evaluations))
        genome = ChainGenome.of(told.ledger.space)
        match state.stage:
            case Stage.SEARCH:
                return _next_search(_with_alphas(told, genome, pending, evaluations), genome)
            case Stage.FINALISTS:
                return _explanation(told, genome)
            case Stage.EXPLANATION:
                return told

    def _content(self, state: SimoodState) -> tuple[dict[str, Any], dict[str, Any]]:
        header = {"population": list(state.population), "bred": state.bred, "stage": state.stage.value}
        arrays = {
            "individuals": state.individuals,
            "alphas": state.alphas[:, None],
            "children": state.children,
        }
        return header, arrays

    def _restored(self, ledger: Ledger, config: SimoodConfig, document: Document) -> SimoodState:
        width = ChainGenome.of(ledger.space).component.dimension
        population, bred = document.header.get("population"), document.header.get("bred")
        individuals = stored_rows(document, "individuals", width)
        if not isinstance(population, list) or not all(
            isinstance(place, int) and 0 <= place < len(individuals) for place in population
        ):
            raise DocumentError(
                f"population: expected a list of positions of individuals, got {population!r}"
            )
        stage = document.header.get("stage")
        if stage not in set(Stage):
            raise DocumentError(f"stage: expected one of {', '.join(Stage)}, got {stage!r}")
        if not isinstance(bred, int):
            raise DocumentError(f"bred: expected a whole number, got {bred!r}")
        return SimoodState(
            config=config,
            ledger=ledger,
            individuals=individuals,
            alphas=frozen_array(stored_rows(document, "alphas", 1)[:, 0]),
            population=tuple(population),
            children=stored_rows(document, "children", width),
            bred=bred,
            stage=Stage(str(stage)),
        )


def finalists_of(state: SimoodState) -> FloatArray:
    """Return the best evaluated individual of each order of techniques, best first, shape ``(n, d)``."""
    genome = ChainGenome.of(state.ledger.space)
    techniques = [genome.columns(slot)[0] for slot in range(len(genome.slots.pairs))]
    fitness = _fitness(state)
    best: dict[bytes, int] = {}
    for place in np.argsort(fitness, kind="stable").tolist():
        if np.isfinite(fitness[place]):
            best.setdefault(state.individuals[place, techniques].tobytes(), place)
    return state.individuals[list(best.values())[: state.config.finalists]]


def _fitness(state: SimoodState) -> FloatArray:
    """Return the fitness f of all individuals, shape ``(a,)``; infinite for those without an alpha."""
    weighted = state.config.omega * ChainGenome.of(state.ledger.space).eta(state.individuals)
    if state.config.alpha == "errors":
        return np.asarray(np.abs(weighted - state.alphas))
    return np.asarray(state.alphas + weighted)


def _drawn(genome: ChainGenome, count: int, rng: np.random.Generator) -> FloatArray:
    return np.array([genome.draw(rng) for _ in range(count)])


def _positions(state: SimoodState) -> dict[bytes, int]:
    return {key: place for place, key in enumerate(row_keys(state.individuals))}


def _with_alphas(
    state: SimoodState,
    genome: ChainGenome,
    pending: Sequence[Candidate],
    evaluations: Mapping[int, Evaluation],
) -> SimoodState:
    """Return the state with the pending individuals and their alphas recorded."""
    rows, alphas = [state.individuals], [state.alphas]
    for candidate in pending:
        evaluation = evaluations[candidate.number]
        alpha = np.inf if isinstance(evaluation, Failed) else float(evaluation.objectives[ALPHA])
        rows.append(candidate.vectors[genome.index][None])
        alphas.append(np.array([alpha]))
    return replace(
        state, individuals=frozen_array(np.concatenate(rows)), alphas=frozen_array(np.concatenate(alphas))
    )


def _next_search(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state after breeding until there is something new to evaluate, or with the finalists queued."""
    while True:
        state = _joined(state)
        if state.bred >= state.config.generations:
            return _finals(state, genome)
        children = _children(state, genome)
        state = _with_children_queued(replace(state, children=children, bred=state.bred + 1), genome)
        if state.ledger.queue:
            return state
        if _room(state) <= 0:
            return _finals(state, genome)


def _reserve(config: SimoodConfig, genome: ChainGenome) -> int:
    """Return the part of the budget reserved for the finalists and their explanation."""
    explained = min(config.explained, config.finalists) * genome.ablation_count
    return (config.finalists + explained) * config.repeats


def _room(state: SimoodState) -> int:
    """Return how many more individuals may be evaluated before the finalists."""
    return int(max(0, state.ledger.left - _reserve(state.config, ChainGenome.of(state.ledger.space))))


def _joined(state: SimoodState) -> SimoodState:
    """Return the state after the evaluated children joined the population and the worst individuals left it."""
    place = _positions(state)
    joined = [*state.population, *(place[key] for key in row_keys(state.children) if key in place)]
    fitness = _fitness(state)
    best = sorted(joined, key=lambda position: float(fitness[position]))  # stable: on ties, the older first
    return replace(
        state,
        population=tuple(best[: state.config.population_size]),
        children=frozen_array(np.empty((0, state.children.shape[1]))),
    )


def _children(state: SimoodState, genome: ChainGenome) -> FloatArray:
    """Return the children of the next generation, shape ``(parents, d)``."""
    config = state.config
    rng = generator(state.ledger.seed, Stream.BREEDING, state.bred)
    if config.propose == "random":
        return _drawn(genome, config.parents, rng)
    parents = state.individuals[list(state.population[: config.parents])]
    children: list[FloatArray] = []
    for index in range(0, config.parents, 2):
        mother, father = parents[index % len(parents)], parents[(index + 1) % len(parents)]
        crosses = rng.random() < config.crossover_probability
        pair = genome.crossed(mother, father, rng) if crosses else (np.array(mother), np.array(father))
        for child in pair:
            like_a_parent = any(np.array_equal(child, parent) for parent in (mother, father))
            mutates = like_a_parent or genome.has_repeats(child) or rng.random() < config.mutation_probability
            children.append(genome.mutated(child, rng) if mutates else child)
    return np.array(children[: config.parents])


def _with_children_queued(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with its new children queued, as far as the budget allows."""
    known = _positions(state)
    fresh: dict[bytes, FloatArray] = {}
    for key, child in zip(row_keys(state.children), state.children, strict=True):
        if key not in known:
            fresh.setdefault(key, child)
    question = Question.DATASET if state.config.evaluate == "data" else Question.EPISODE
    scenario = _scenario(state, 0)
    rows = [_row(genome, scenario, child) for child in fresh.values()][: _room(state)]
    return replace(state, ledger=state.ledger.plan(rows, question, [0] * len(rows)))


def _scenario(state: SimoodState, repeat: int) -> tuple[FloatArray, ...]:
    """Return the scenario of one repeat; individuals that are simulated during the search use repeat 0."""
    ledger = state.ledger
    return ledger.space.sample(generator(ledger.seed, Stream.FINALISTS, repeat))


def _row(genome: ChainGenome, scenario: Sequence[FloatArray], individual: FloatArray) -> FloatArray:
    vectors = [individual if index == genome.index else vector for index, vector in enumerate(scenario)]
    return genome.space.join(vectors)


def _with_simulations(
    state: SimoodState, genome: ChainGenome, individuals: Iterable[FloatArray], stage: Stage
) -> SimoodState:
    """Return the state with simulations of individuals in every scenario queued, skipping known ones."""
    ledger = state.ledger
    repeats = range(state.config.repeats)
    scenarios = [_scenario(state, repeat) for repeat in repeats]
    rows = [_row(genome, scenarios[repeat], one) for one in individuals for repeat in repeats]
    repeat_of = {row.tobytes(): place % len(scenarios) for place, row in enumerate(rows)}
    fresh = ledger.unseen(rows)[: int(max(0, ledger.left))]
    seeds = [repeat_of[row.tobytes()] for row in fresh]
    return replace(state, ledger=ledger.plan(fresh, Question.EPISODE, seeds), stage=stage)


def _finals(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with the finalists queued and no children left."""
    state = replace(state, children=frozen_array(np.empty((0, state.children.shape[1]))))
    state = _with_simulations(state, genome, finalists_of(state), Stage.FINALISTS)
    return state if state.ledger.queue else _explanation(state, genome)


def _explanation(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with the parts and other orders of the hazardous finalists queued."""
    archive = state.ledger.archive
    unsafe = set(row_keys(archive.vectors[archive.unsafe][:, genome.space.slices[genome.index]]))
    hazardous = [one for one in finalists_of(state) if one.tobytes() in unsafe]
    variants = [variant for one in hazardous[: state.config.explained] for variant in genome.ablations(one)]
    return _with_simulations(state, genome, variants, Stage.EXPLANATION)

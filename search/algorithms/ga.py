"""A generational genetic algorithm on whole complete solutions, with the boundary fitness of the archive.

It takes any space. Children that were evaluated before keep their place in the population and their fitness, and
are not asked again; a population that has converged, so that its children bring nothing new, gives way to a random
one. Source: Sharifi et al. 2023, baseline GA.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from brink.search.algorithm import Candidate, Evaluation
from brink.search.algorithms.ledger import BoundaryConfig, Ledger, LedgerState, check_budget, stored_rows
from brink.search.archive import Archive
from brink.search.component import FloatArray, frozen_array
from brink.search.document import Document
from brink.search.operators import offspring, tournament
from brink.search.settings import setting
from brink.search.space import SearchSpace
from brink.search.streams import Stream, generator

_VERSION = 1
_BREEDINGS = 10
"""Populations bred without one new solution after which the search starts afresh from a random one."""

_RESTARTS = 90
"""Random populations without one new solution after which a finite space counts as exhausted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneticAlgorithmConfig(BoundaryConfig):
    """Settings of the genetic algorithm."""

    population_size: int = setting(60, help="Complete solutions a generation.", ge=2, le=10_000)
    crossover_probability: float = setting(0.85, help="Probability that two parents cross.", ge=0, le=1)
    gene_swap_probability: float = setting(
        0.5, help="Probability that a gene is swapped when parents cross.", ge=0, le=1
    )
    mutation_probability: float = setting(0.01, help="Probability that a gene mutates.", gt=0, le=1)
    tournament_size: int = setting(3, help="Contestants for one place as a parent.", ge=1, le=100)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GeneticAlgorithmState(LedgerState):
    """State of the genetic algorithm.

    Attributes:
        config: Settings.
        population: The current generation as rows, shape ``(population_size, d)``; evaluated, failed or queued.
    """

    config: GeneticAlgorithmConfig
    population: FloatArray


class GeneticAlgorithm:
    """Generational, tournament selection, uniform crossover."""

    id = "ga@1"
    summary = "Genetic algorithm on whole solutions, towards the hazard boundary."
    config_type = GeneticAlgorithmConfig

    def check(self, space: SearchSpace, config: GeneticAlgorithmConfig, *, budget: int) -> None:
        """Raise ConfigError if the budget does not cover a population; any space will do."""
        check_budget(budget, config.population_size)

    def start(
        self, space: SearchSpace, config: GeneticAlgorithmConfig, *, seed: int, budget: int
    ) -> GeneticAlgorithmState:
        """Return the first state, with nothing asked yet."""
        self.check(space, config, budget=budget)
        ledger = Ledger.opened(space, config, seed=seed, budget=budget)
        rng = generator(seed, Stream.START)
        population = _random_population(space, config.population_size, rng)
        return GeneticAlgorithmState(
            config=config,
            ledger=ledger.planned(ledger.unseen(population)),
            population=frozen_array(population),
        )

    def ask(self, state: GeneticAlgorithmState) -> tuple[GeneticAlgorithmState, tuple[Candidate, ...]]:
        """Return a state with a pending generation, and that generation."""
        ledger = state.ledger.handed_out()
        return replace(state, ledger=ledger), ledger.pending

    def tell(
        self, state: GeneticAlgorithmState, evaluations: Mapping[int, Evaluation]
    ) -> GeneticAlgorithmState:
        """Return the state after the pending generation was evaluated."""
        ledger = state.ledger.told(evaluations)
        told = replace(state, ledger=ledger)
        if ledger.left <= 0:
            return told
        fitness = ledger.fitness_of(slice(0, ledger.space.dimension), state.population)
        for attempt in range(_BREEDINGS + _RESTARTS):
            rng = generator(ledger.seed, Stream.BREEDING, ledger.generation, attempt)
            population = (
                _next_population(told, fitness, rng)
                if attempt < _BREEDINGS
                else _random_population(ledger.space, state.config.population_size, rng)
            )
            if rows := ledger.unseen(population):
                return replace(told, ledger=ledger.planned(rows), population=frozen_array(population))
        return told

    def finished(self, state: GeneticAlgorithmState) -> bool:
        """Return whether the budget is spent, or the space is."""
        return not state.ledger.queue

    def dump(self, state: GeneticAlgorithmState) -> Document:
        """Return the state without its archive, as a versioned document."""
        return state.ledger.dump(self.id, _VERSION, {}, {"population": state.population})

    def load(
        self, space: SearchSpace, config: GeneticAlgorithmConfig, document: Document, archive: Archive
    ) -> GeneticAlgorithmState:
        """Return the state that `dump` wrote, with the archive that it had then."""
        ledger = Ledger.load(space, config, document.expect(self.id, _VERSION), archive)
        population = stored_rows(document, "population", space.dimension)
        return GeneticAlgorithmState(config=config, ledger=ledger, population=population)


def _random_population(space: SearchSpace, size: int, rng: np.random.Generator) -> FloatArray:
    return np.array([space.join(space.sample(rng)) for _ in range(size)])


def _next_population(
    state: GeneticAlgorithmState, fitness: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return a population of children, shape ``(population_size, d)``."""
    config, space = state.config, state.ledger.space
    children: list[FloatArray] = []
    while len(children) < config.population_size:
        mother, father = (
            space.split(state.population[tournament(fitness, config.tournament_size, rng)]) for _ in range(2)
        )
        crosses = rng.random() < config.crossover_probability
        pairs = [
            offspring(
                component,
                mother[index],
                father[index],
                crossover=config.gene_swap_probability if crosses else 0.0,
                mutation=config.mutation_probability,
                rng=rng,
            )
            for index, component in enumerate(space.components)
        ]
        children.extend(space.join([pair[child] for pair in pairs]) for child in range(2))
    return np.array(children[: config.population_size])

"""A generational genetic algorithm on complete solutions that minimises the boundary fitness of the archive.

It supports any space. Children that were evaluated before stay in the population with their fitness and are not asked
for again. A population that has converged, and so breeds nothing new, is replaced by a random one.

The paper's crossover rates are .5 for MLCSHE and .85 for the GA. The authors' code reads both per gene. Here,
MLCSHE's is per gene; the GA's is per pair of parents, whose genes are then swapped with probability .5. The
tournament of three is not in the paper but in the authors' code.

Source: Sharifi et al. 2023, baseline GA.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import (
    MAX_BREEDINGS,
    MAX_RESTARTS,
    BoundaryConfig,
    BoundaryState,
    Ledger,
    WarmLedgerAlgorithm,
    leading_rows,
    stored_rows,
)
from brink.search.document import Document
from brink.search.operators import offspring, tournament
from brink.search.settings import setting
from brink.search.space import FloatArray, SearchSpace, frozen_array
from brink.search.streams import Stream, generator


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneticAlgorithmConfig(BoundaryConfig):
    """Settings of the genetic algorithm."""

    population_size: int = setting(60, help="Complete solutions per generation.", ge=2, le=10_000)
    crossover_probability: float = setting(
        0.85, help="Probability that crossover is applied to a pair of parents.", ge=0, le=1
    )
    gene_swap_probability: float = setting(0.5, help="Probability that crossover swaps a gene.", ge=0, le=1)
    mutation_probability: float = setting(0.01, help="Probability that a gene mutates.", gt=0, le=1)
    tournament_size: int = setting(3, help="Number of contestants in each tournament.", ge=1, le=100)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GeneticAlgorithmState(BoundaryState):
    """State of the genetic algorithm.

    Attributes:
        config: Settings.
        population: The current generation as rows, shape ``(n, d)``: evaluated, failed, known or queued. There are
            `population_size`, or more at first if more points are known.
    """

    config: GeneticAlgorithmConfig
    population: FloatArray


class GeneticAlgorithm(WarmLedgerAlgorithm[GeneticAlgorithmConfig, GeneticAlgorithmState]):
    """A generational genetic algorithm with tournament selection and uniform crossover."""

    id = "ga@1"
    summary = "Genetic algorithm on whole solutions, towards the hazard boundary."
    config_type = GeneticAlgorithmConfig

    def _min_budget(self, space: SearchSpace, config: GeneticAlgorithmConfig) -> int:
        return config.population_size

    def _first_state(self, ledger: Ledger, config: GeneticAlgorithmConfig) -> GeneticAlgorithmState:
        rng = generator(ledger.seed, Stream.START)
        leading = leading_rows(ledger, config.population_size)
        random = _random_population(ledger.space, config.population_size, rng)
        population = np.array([*leading, *random[: max(0, len(random) - len(leading))]])
        state = GeneticAlgorithmState(config=config, ledger=ledger, population=frozen_array(population))
        rows = ledger.unseen(population)
        return replace(state, ledger=ledger.plan(rows)) if rows else _bred(state)

    def tell(
        self, state: GeneticAlgorithmState, evaluations: Mapping[int, Evaluation]
    ) -> GeneticAlgorithmState:
        """Return the state after the pending generation was evaluated."""
        return _bred(replace(state, ledger=state.ledger.tell(evaluations)))

    def _content(self, state: GeneticAlgorithmState) -> tuple[dict[str, Any], dict[str, Any]]:
        return {}, {"population": state.population}

    def _restored(
        self, ledger: Ledger, config: GeneticAlgorithmConfig, document: Document
    ) -> GeneticAlgorithmState:
        population = stored_rows(document, "population", ledger.space.dimension)
        return GeneticAlgorithmState(config=config, ledger=ledger, population=population)


def _bred(state: GeneticAlgorithmState) -> GeneticAlgorithmState:
    """Return the state with the next generation planned, if budget and space allow."""
    ledger = state.ledger
    if ledger.left <= 0:
        return state
    fitness = ledger.fitness_of(slice(0, ledger.space.dimension), state.population)
    for attempt in range(MAX_BREEDINGS + MAX_RESTARTS):
        rng = generator(ledger.seed, Stream.BREEDING, ledger.generation, attempt)
        population = (
            _next_population(state, fitness, rng)
            if attempt < MAX_BREEDINGS
            else _random_population(ledger.space, state.config.population_size, rng)
        )
        if rows := ledger.unseen(population):
            return replace(state, ledger=ledger.plan(rows), population=frozen_array(population))
    return state


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

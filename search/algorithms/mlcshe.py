"""MLCSHE: cooperative co-evolution of scenarios and behaviours towards the hazard boundary.

Two populations evolve side by side. The fitness of an individual is that of the best complete solution containing it.
Each population keeps a small archive of individuals that represent it in collaborations with the other one.

With the default mutation probability of 1 per gene, and categories that are redrawn uniformly, every category of a
child is an independent random draw. A scenario of categories alone, as in the case study, inherits nothing: selection
and crossover have no effect on scenarios, nor on the labels in behaviours, only on numbers. Smaller rates, for all
genes or by kind of gene, give a search that inherits; ``selection: none`` is the control that shows what selection
contributes (`examples/heredity.yaml`).

Source: Sharifi et al. 2023, Algorithms 1 (co-evolution), 2 (collaboration), 3 (population archive). Where the
authors' code departs from the paper, this follows the paper; tournaments of three and the radius are in their code
only. Population archives of the best or of random individuals, and other aggregates of fitness, are
strategies that the paper compares in passing. Rates by kind of gene and ``selection: none`` are ours.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import (
    AGGREGATES,
    MAX_BREEDINGS,
    MAX_RESTARTS,
    BoundaryConfig,
    BoundaryState,
    Ledger,
    WarmLedgerAlgorithm,
    leading_rows,
    row_keys,
    stored_rows,
)
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, UnsupportedSpace
from brink.search.metric import Metric
from brink.search.operators import offspring, tournament
from brink.search.settings import setting
from brink.search.space import Categorical, Component, FloatArray, Integer, Real, SearchSpace, frozen_array
from brink.search.streams import Stream, generator


@dataclass(frozen=True, slots=True, kw_only=True)
class MlcsheConfig(BoundaryConfig):
    """Settings of MLCSHE; the defaults are those of the paper or, where it gives none, of its authors' code.

    ``archive_distance`` applies to the strategy ``diverse`` alone.
    """

    population_size: int = setting(10, help="Individuals in each of the two populations.", ge=2, le=1_000)
    archive_size: int = setting(
        3, help="Largest number of individuals in a population archive (l).", ge=1, le=1_000
    )
    archive_distance: float = setting(
        0.4, help="Smallest distance between members of a population archive (d_a).", ge=0, le=1
    )
    partners: int = setting(1, help="Smallest number of partners for each individual (k).", ge=1, le=1_000)
    gene_swap_probability: float = setting(
        0.5, help="Probability that crossover swaps a gene: the crossover rate, read per gene.", ge=0, le=1
    )
    mutation_probability: float = setting(
        1.0,
        help="Probability that a gene mutates, multiplied by the factors of its kind and of its population.",
        gt=0,
        le=1,
    )
    real_mutation_factor: float = setting(1.0, help="Factor for the mutation of real numbers.", ge=0, le=1)
    integer_mutation_factor: float = setting(1.0, help="Factor for the mutation of integers.", ge=0, le=1)
    categorical_mutation_factor: float = setting(
        1.0, help="Factor for the mutation of categories, which redraws them.", ge=0, le=1
    )
    scenario_mutation_factor: float = setting(
        1.0, help="Factor for the mutation of scenarios, the first component.", ge=0, le=1
    )
    behaviour_mutation_factor: float = setting(
        1.0, help="Factor for the mutation of behaviours, the second component.", ge=0, le=1
    )
    tournament_size: int = setting(3, help="Number of contestants in each tournament.", ge=1, le=100)
    selection: str = setting(
        "fitness",
        help="Whether fitness decides on parents and archives, or chance alone: a control without selection.",
        choices=("fitness", "none"),
    )
    archive_strategy: str = setting(
        "diverse",
        help="Members of a population archive: the best and random ones far from each other, the best, or random.",
        choices=("diverse", "best", "random"),
    )
    fitness_aggregate: str = setting(
        "best",
        help="Fitness of an individual: that of its best solution, the mean of all its solutions, or the worst.",
        choices=tuple(AGGREGATES),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Population:
    """The individuals of one component.

    Attributes:
        individuals: Vectors, shape ``(n, d)``; those of the population archive last.
        archived: Size of the population archive.
    """

    individuals: FloatArray
    archived: int

    def __len__(self) -> int:
        return len(self.individuals)

    @property
    def outside(self) -> int:
        """Number of individuals outside the population archive; they come first."""
        return len(self) - self.archived


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MlcsheState(BoundaryState):
    """State of MLCSHE.

    Attributes:
        config: Settings.
        populations: Populations of the first and the second component.
    """

    config: MlcsheConfig
    populations: tuple[Population, Population]


class Mlcshe(WarmLedgerAlgorithm[MlcsheConfig, MlcsheState]):
    """Cooperative co-evolutionary search for the hazard boundary."""

    id = "mlcshe@1"
    suggested = 2
    summary = "Cooperative co-evolution of scenarios and behaviours, towards the hazard boundary."
    config_type = MlcsheConfig

    def _min_budget(self, space: SearchSpace, config: MlcsheConfig) -> int:
        if len(space.components) != 2:
            names = ", ".join(component.name for component in space.components)
            raise UnsupportedSpace(
                f"{self.id} evolves two populations: expected a space of two components, got {names}; "
                "ga@1 and random@1 support any space"
            )
        if config.archive_size >= config.population_size:
            raise ConfigError(
                "archive_size",
                f"expected less than population_size ({config.population_size}), to leave room for offspring; "
                f"got {config.archive_size}",
            )
        if config.partners > config.population_size:
            raise ConfigError(
                "partners",
                f"expected at most population_size ({config.population_size}), got {config.partners}",
            )
        return config.population_size**2

    def flight(self, config: MlcsheConfig) -> tuple[int, int]:
        """Return the most candidates of one generation, and the most generations in flight at a time."""
        partners = min(max(config.archive_size, config.partners), config.population_size)
        return min(2 * partners, config.population_size) * config.population_size, 1

    def _first_state(self, ledger: Ledger, config: MlcsheConfig) -> MlcsheState:
        # The whole populations are their own archives, so the first generation combines all pairs.
        first, second = (_first_population(ledger, config, index) for index in range(2))
        state = MlcsheState(config=config, ledger=ledger, populations=(first, second))
        pairs = _collaborations(ledger, config, (first, second), attempt=0)
        rows = ledger.unseen([*ledger.known.points, *pairs])
        return replace(state, ledger=ledger.plan(rows)) if rows else _bred(state)

    def tell(self, state: MlcsheState, evaluations: Mapping[int, Evaluation]) -> MlcsheState:
        """Return the state after the pending generation was evaluated."""
        return _bred(replace(state, ledger=state.ledger.tell(evaluations)))

    def _content(self, state: MlcsheState) -> tuple[dict[str, Any], dict[str, Any]]:
        first, second = state.populations
        return (
            {"population_archives": [first.archived, second.archived]},
            {"population_0": first.individuals, "population_1": second.individuals},
        )

    def _restored(self, ledger: Ledger, config: MlcsheConfig, document: Document) -> MlcsheState:
        components = ledger.space.components
        match document.header.get("population_archives"):
            case [int(), int()] as archived if len(components) == 2:
                first, second = (
                    Population(
                        individuals=stored_rows(document, f"population_{index}", component.dimension),
                        archived=archived[index],
                    )
                    for index, component in enumerate(components)
                )
                return MlcsheState(config=config, ledger=ledger, populations=(first, second))
            case got:
                raise DocumentError(f"population_archives: expected two whole numbers, got {got!r}")


def _bred(state: MlcsheState) -> MlcsheState:
    """Return the state with the next generation planned, if budget and space allow."""
    ledger = state.ledger
    if ledger.left <= 0:
        return state
    stocks = [_breeding_stock(state, index) for index in range(2)]
    for attempt in range(MAX_BREEDINGS + MAX_RESTARTS):
        first, second = (
            _next_population(state, stock, attempt)
            if attempt < MAX_BREEDINGS
            else _random_population(ledger, state.config, stock.index, attempt)
            for stock in stocks
        )
        if rows := ledger.unseen(_collaborations(ledger, state.config, (first, second), attempt)):
            return replace(state, ledger=ledger.plan(rows), populations=(first, second))
    return state


def _first_population(ledger: Ledger, config: MlcsheConfig, index: int) -> Population:
    """Return the first population: the vectors of known solutions, then random ones."""
    random = _random_population(ledger, config, index, attempt=0)
    known = leading_rows(ledger, config.population_size)
    if not known:
        return random
    vectors = np.array(known)[:, ledger.space.slices[index]]
    different = dict(zip(row_keys(vectors), vectors, strict=True))
    rows = [*different.values(), *random.individuals][: config.population_size]
    return Population(individuals=frozen_array(np.array(rows)), archived=len(rows))


def _random_population(ledger: Ledger, config: MlcsheConfig, index: int, attempt: int) -> Population:
    """Return a random population that is its own archive."""
    rng = generator(ledger.seed, Stream.START, ledger.generation, attempt, index)
    rows = [ledger.space.sample_component(index, rng) for _ in range(config.population_size)]
    return Population(individuals=frozen_array(np.array(rows)), archived=config.population_size)


def _collaborations(
    ledger: Ledger, config: MlcsheConfig, populations: tuple[Population, Population], attempt: int
) -> list[FloatArray]:
    """Return all complete solutions of a generation as rows (Algorithm 2)."""
    rng = generator(ledger.seed, Stream.COLLABORATION, ledger.generation, attempt)
    first, second = populations
    pairs = {(i, j) for i in range(len(first)) for j in range(second.outside, len(second))}
    pairs |= {(i, j) for j in range(len(second)) for i in range(first.outside, len(first))}
    for i in range(len(first)):
        pairs |= {(i, j) for j in _further_partners(second, config.partners, rng)}
    for j in range(len(second)):
        pairs |= {(i, j) for i in _further_partners(first, config.partners, rng)}
    return [np.concatenate([first.individuals[i], second.individuals[j]]) for i, j in sorted(pairs)]


def _further_partners(population: Population, wanted: int, rng: np.random.Generator) -> list[int]:
    """Return random individuals from outside the archive that complete the wanted number of partners."""
    lacking = wanted - population.archived
    if lacking <= 0:
        return []
    return [int(position) for position in rng.choice(population.outside, size=lacking, replace=False)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BreedingStock:
    """An evaluated population, ready to breed.

    Attributes:
        index: Position of its component.
        individuals: Vectors, shape ``(n, d)``.
        fitness: Aggregate fitness of the complete solutions containing each individual, or 0 without selection;
            infinite if all of them failed. Shape ``(n,)``.
        archived: Positions of the new population archive.
    """

    index: int
    individuals: FloatArray
    fitness: FloatArray
    archived: tuple[int, ...]


def _breeding_stock(state: MlcsheState, index: int) -> BreedingStock:
    config, ledger = state.config, state.ledger
    individuals = state.populations[index].individuals
    fitness = ledger.fitness_of(ledger.space.slices[index], individuals, config.fitness_aggregate)
    if config.selection == "none":
        fitness = np.where(np.isfinite(fitness), 0.0, np.inf)
    archived = population_archive(state, index, fitness)
    return BreedingStock(index=index, individuals=individuals, fitness=fitness, archived=archived)


def population_archive(state: MlcsheState, index: int, fitness: FloatArray) -> tuple[int, ...]:
    """Return the positions of the new population archive (Algorithm 3, or another strategy).

    An individual whose solutions all failed is left out, unless all individuals are like that.

    Args:
        state: A state whose last generation was evaluated.
        index: Position of the component.
        fitness: Fitness of the individuals, infinite if all their solutions failed, shape ``(n,)``.
    """
    config, ledger = state.config, state.ledger
    individuals = state.populations[index].individuals
    rng = generator(ledger.seed, Stream.POPULATION_ARCHIVE, ledger.generation, index)
    ranked = np.isfinite(fitness) if np.isfinite(fitness).any() else np.ones(len(fitness), np.bool_)
    order = [position for position in rng.permutation(len(individuals)).tolist() if ranked[position]]
    if config.archive_strategy == "best":
        order.sort(key=lambda position: fitness[position])  # stable: on ties, in random order
    if config.archive_strategy != "diverse":
        return tuple(order[: config.archive_size])
    distances = Metric.of_component(ledger.space, index).between(individuals, individuals)
    chosen = [order[0] if config.selection == "none" else int(np.argmin(fitness))]
    for position in order:
        if len(chosen) == config.archive_size:
            break
        if position not in chosen and distances[position, chosen].min() >= config.archive_distance:
            chosen.append(position)
    return tuple(chosen)


def mutation_rates(component: Component, index: int, config: MlcsheConfig) -> FloatArray:
    """Return the probability that each gene of an individual mutates, shape ``(d,)``.

    Args:
        component: The component of the individual.
        index: Its position: 0 for scenarios, 1 for behaviours.
        config: The settings.
    """
    factors = {
        Real: config.real_mutation_factor,
        Integer: config.integer_mutation_factor,
        Categorical: config.categorical_mutation_factor,
    }
    whole = config.mutation_probability * (
        config.scenario_mutation_factor if index == 0 else config.behaviour_mutation_factor
    )
    return np.array([whole * factors[type(parameter)] for parameter in component.parameters])


def _next_population(state: MlcsheState, stock: BreedingStock, attempt: int) -> Population:
    """Return the offspring of a population, followed by its archive."""
    config, ledger = state.config, state.ledger
    rng = generator(ledger.seed, Stream.BREEDING, ledger.generation, attempt, stock.index)
    wanted = len(stock.individuals) - len(stock.archived)
    component = ledger.space.components[stock.index]
    rates = mutation_rates(component, stock.index, config)
    children: list[FloatArray] = []
    while len(children) < wanted:
        mother, father = (
            stock.individuals[tournament(stock.fitness, config.tournament_size, rng)] for _ in range(2)
        )
        children.extend(
            offspring(
                component, mother, father, crossover=config.gene_swap_probability, mutation=rates, rng=rng
            )
        )
    rows = [*children[:wanted], *stock.individuals[list(stock.archived)]]
    return Population(individuals=frozen_array(np.array(rows)), archived=len(stock.archived))

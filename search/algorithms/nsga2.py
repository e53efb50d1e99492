"""NSGA-II on traffic participants with fixed rates, and MOSAT: the same with hand-written motifs as mutations.

Parents are selected by binary tournaments on rank and crowding, crossed uniformly and mutated at random, each with a
probability of its own. A child that equals a known solution is bred again.

Source: Deb et al. 2002; Tian et al., "MOSAT: Finding Safety Violations of Autonomous Driving Systems Using
Multi-objective Genetic Algorithm", ESEC/FSE 2022.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from brink.search.algorithm import Evaluation, Origin
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm
from brink.search.algorithms.multi_objective import (
    CRITICALITY,
    Child,
    MultiObjectiveConfig,
    MultiObjectiveState,
    breeding_rng,
    child_of,
    empty_state,
    plan_generation,
    random_children,
    restored_state,
    select_survivors,
    state_content,
)
from brink.search.document import Document
from brink.search.pareto import ranks_and_crowding
from brink.search.settings import setting
from brink.search.space import FloatArray, IntArray, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.traffic.participants import Participant, Solution
from brink.search.traffic.variation import TrafficGenome, crossed_uniformly, motif, mutated_randomly


@dataclass(frozen=True, slots=True, kw_only=True)
class Nsga2Config(MultiObjectiveConfig):
    """Settings of NSGA-II."""

    crossover_probability: float = setting(
        0.8, help="Probability that crossover is applied to two parents.", ge=0, le=1
    )
    mutation_probability: float = setting(0.3, help="Probability that a child mutates.", ge=0, le=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class MosatConfig(Nsga2Config):
    """Settings of MOSAT."""

    motif_probability: float = setting(
        0.5, help="Probability that a mutation uses a participant with a motif.", ge=0, le=1
    )


Newcomer: TypeAlias = Callable[[Nsga2Config, TrafficGenome, np.random.Generator], Participant]
"""Draws a participant that a mutation may add to a solution."""


class Nsga2(LedgerAlgorithm[Nsga2Config, MultiObjectiveState]):
    """NSGA-II with fixed crossover and mutation rates."""

    id = "nsga2@1"
    former = MappingProxyType({"distance": "paper"})
    finds = ("violations",)
    minimises = "criticality"
    summary = "NSGA-II: critical and diverse scenarios of scripted traffic, with fixed rates."
    config_type: type[Any] = Nsga2Config
    needed_objectives = (CRITICALITY,)
    layout = 2

    def _min_budget(self, space: SearchSpace, config: Nsga2Config) -> int:
        TrafficGenome.of(space)
        return config.population_size

    def _first_state(self, ledger: Ledger, config: Nsga2Config) -> MultiObjectiveState:
        genome = TrafficGenome.of(ledger.space)
        rng = generator(ledger.seed, Stream.START)
        children = random_children(genome, config.population_size, rng)
        return plan_generation(empty_state(ledger, config), children, genome, rng)

    def tell(self, state: MultiObjectiveState, evaluations: Mapping[int, Evaluation]) -> MultiObjectiveState:
        """Return the state after the pending generation was evaluated.

        Raises:
            OrderError: Nothing is pending, or the numbers are not those of the pending candidates.
            KeyError: An evaluation lacks the criticality.
        """
        genome = TrafficGenome.of(state.ledger.space)
        survived = select_survivors(state, evaluations, genome)
        rng = breeding_rng(survived)
        if not survived.population:
            return plan_generation(survived, [], genome, rng)
        breeding = Breeding(survived, genome, self._newcomer)
        return plan_generation(
            survived,
            breeding.children(survived.config.population_size, rng),
            genome,
            rng,
            [lambda count: breeding.children(count, rng), lambda count: breeding.mutants(count, rng)],
        )

    def _content(self, state: MultiObjectiveState) -> tuple[dict[str, Any], dict[str, Any]]:
        return state_content(state)

    def _restored(self, ledger: Ledger, config: Nsga2Config, document: Document) -> MultiObjectiveState:
        return restored_state(ledger, config, document)

    def _newcomer(self, config: Nsga2Config, genome: TrafficGenome, rng: np.random.Generator) -> Participant:
        """Draw a participant that a mutation may add to a solution."""
        drawn = genome.sample(rng)
        return drawn[int(rng.integers(len(drawn)))]


class Mosat(Nsga2):
    """NSGA-II with motifs as mutations."""

    id = "mosat@1"
    summary = "MOSAT: NSGA-II with hand-written motifs of hostile drivers."
    config_type: type[Any] = MosatConfig

    def _newcomer(self, config: Nsga2Config, genome: TrafficGenome, rng: np.random.Generator) -> Participant:
        assert isinstance(config, MosatConfig)
        if rng.random() < config.motif_probability:
            return motif(genome.road, rng)
        return super()._newcomer(config, genome, rng)


class Breeding:
    """Breeds the children of a population that is not empty.

    Args:
        state: State with the population.
        genome: Genome of the space.
        newcomer: Draws a participant that a mutation may add to a solution.
    """

    def __init__(self, state: MultiObjectiveState, genome: TrafficGenome, newcomer: Newcomer) -> None:
        assert isinstance(state.config, Nsga2Config)
        self._state = state
        self._config: Nsga2Config = state.config
        self._genome = genome
        self._newcomer = newcomer
        self._ranked = ranks_and_crowding(state.objectives)

    def children(self, count: int, rng: np.random.Generator) -> list[Child]:
        """Return children of pairs, some crossed, some mutated, some both, and some equal to a parent.

        Args:
            count: Number of children, of which the second of the last pair is left out if it is odd.
            rng: Source of all randomness.
        """
        children: list[Child] = []
        while len(children) < count:
            children += self._pair(rng)
        return children[:count]

    def _pair(self, rng: np.random.Generator) -> list[Child]:
        parents = [self._parent(rng) for _ in range(2)]
        mother, father = (self._solution(parent) for parent in parents)
        origin = Origin.MUTATION
        if rng.random() < self._config.crossover_probability:
            mother, father = crossed_uniformly(mother, father, rng)
            origin = Origin.CROSSOVER
        children: list[Child] = []
        for parent, solution in zip(parents, (mother, father), strict=True):
            mutates = rng.random() < self._config.mutation_probability
            child = self._mutated(solution, rng) if mutates else solution
            children.append(child_of(self._state, self._genome, child, parent, origin, rng))
        return children

    def mutants(self, count: int, rng: np.random.Generator) -> list[Child]:
        """Return mutants of selected parents.

        Args:
            count: Number of mutants.
            rng: Source of all randomness.
        """
        parents = [self._parent(rng) for _ in range(count)]
        return [
            child_of(
                self._state,
                self._genome,
                self._mutated(self._solution(parent), rng),
                parent,
                Origin.MUTATION,
                rng,
            )
            for parent in parents
        ]

    def _parent(self, rng: np.random.Generator) -> int:
        return self._state.population[_tournament(self._ranked, rng)]

    def _solution(self, number: int) -> Solution:
        return self._genome.solution(self._state.history.rows[number])

    def _mutated(self, solution: Solution, rng: np.random.Generator) -> Solution:
        newcomer = self._newcomer(self._config, self._genome, rng)
        return mutated_randomly(solution, newcomer, self._genome.max_participants, rng)


def _tournament(ranked: tuple[IntArray, FloatArray], rng: np.random.Generator) -> int:
    """Return the better of two random positions: by front, then less crowded, then first drawn."""
    front, crowding = ranked
    first, second = rng.integers(len(front), size=2).tolist()
    return int(min((first, second), key=lambda place: (front[place], -crowding[place])))

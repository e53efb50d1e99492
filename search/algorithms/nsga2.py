"""NSGA-II on traffic participants with fixed rates, and MOSAT: the same with hand-written motifs among its mutations.

Parents are drawn by binary tournament on rank and crowding, cross uniformly and mutate at random.

Source: Deb et al. 2002; Tian et al., "MOSAT: Finding Safety Violations of Autonomous Driving Systems Using
Multi-objective Genetic Algorithm", ESEC/FSE 2022.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from brink.search.actions.genome import Genome
from brink.search.actions.patterns import motif
from brink.search.actions.variation import crossed_uniformly, mutated_randomly
from brink.search.algorithm import Candidate, Evaluation
from brink.search.algorithms.ledger import check_budget
from brink.search.algorithms.multi_objective import (
    Child,
    MultiObjectiveConfig,
    MultiObjectiveState,
    breeding_rng,
    child_of,
    dump_state,
    load_state,
    opened,
    queued,
    random_children,
    survived,
)
from brink.search.archive import Archive
from brink.search.document import Document
from brink.search.pareto import ranks_and_crowding
from brink.search.seeding import Origin
from brink.search.settings import setting
from brink.search.space import SearchSpace
from brink.search.streams import Stream, generator

_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Nsga2Config(MultiObjectiveConfig):
    """Settings of NSGA-II."""

    crossover_probability: float = setting(0.8, help="Probability that two parents cross.", ge=0, le=1)
    mutation_probability: float = setting(0.3, help="Probability that a child mutates.", ge=0, le=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class MosatConfig(Nsga2Config):
    """Settings of MOSAT."""

    motif_probability: float = setting(
        0.5, help="Probability that a mutation brings in a participant with a motif.", ge=0, le=1
    )


class Nsga2:
    """NSGA-II with fixed rates."""

    id = "nsga2@1"
    summary = "NSGA-II: critical and different scenarios of scripted traffic, fixed rates."
    config_type: type[Any] = Nsga2Config

    def check(self, space: SearchSpace, config: Nsga2Config, *, budget: int) -> None:
        """Raise UnsupportedSpace without participants, ConfigError if the budget does not cover a population."""
        Genome.of(space)
        check_budget(budget, config.population_size)

    def start(
        self, space: SearchSpace, config: Nsga2Config, *, seed: int, budget: int
    ) -> MultiObjectiveState:
        """Return the first state, with nothing asked yet."""
        self.check(space, config, budget=budget)
        genome = Genome.of(space)
        rng = generator(seed, Stream.START)
        state = opened(space, config, seed=seed, budget=budget)
        return queued(state, random_children(genome, config.population_size, rng), genome, rng)

    def ask(self, state: MultiObjectiveState) -> tuple[MultiObjectiveState, tuple[Candidate, ...]]:
        """Return a state with a pending generation, and that generation."""
        ledger = state.ledger.handed_out()
        return replace(state, ledger=ledger), ledger.pending

    def tell(self, state: MultiObjectiveState, evaluations: Mapping[int, Evaluation]) -> MultiObjectiveState:
        """Return the state after the pending generation was evaluated.

        Raises:
            OrderError: Nothing is pending, or the numbers are not the pending ones.
            KeyError: An evaluation lacks the objective of criticality.
        """
        genome = Genome.of(state.ledger.space)
        told = survived(state, evaluations, genome)
        rng = breeding_rng(told)
        return queued(told, self._children(told, genome, rng), genome, rng)

    def finished(self, state: MultiObjectiveState) -> bool:
        """Return whether the budget is spent, or nothing new was found."""
        return not state.ledger.queue

    def dump(self, state: MultiObjectiveState) -> Document:
        """Return the state without its archive, as a versioned document."""
        return dump_state(state, self.id, _VERSION, {})

    def load(
        self, space: SearchSpace, config: Nsga2Config, document: Document, archive: Archive
    ) -> MultiObjectiveState:
        """Return the state that `dump` wrote, with the archive that it had then."""
        return load_state(space, config, document.expect(self.id, _VERSION), archive)

    def _children(self, state: MultiObjectiveState, genome: Genome, rng: np.random.Generator) -> list[Child]:
        """Return the next generation's children."""
        config = state.config
        assert isinstance(config, Nsga2Config)
        if not state.population:
            return []
        ranked = ranks_and_crowding(state.objectives)
        children: list[Child] = []
        while len(children) < config.population_size:
            parents = [state.population[_tournament(ranked, rng)] for _ in range(2)]
            mother, father = (genome.solution(state.book.rows[number]) for number in parents)
            origin = Origin.MUTATION
            if rng.random() < config.crossover_probability:
                mother, father = crossed_uniformly(mother, father, rng)
                origin = Origin.CROSSOVER
            for parent, solution in zip(parents, (mother, father), strict=True):
                child = solution
                if origin is Origin.MUTATION or rng.random() < config.mutation_probability:
                    fresh = self._fresh(config, genome, rng)
                    child = mutated_randomly(solution, fresh, genome.most, rng)
                children.append(child_of(state, genome, child, parent, origin, rng))
        return children

    def _fresh(self, config: Nsga2Config, genome: Genome, rng: np.random.Generator) -> Any:
        """Return somebody who may come into a solution."""
        drawn = genome.random(rng)
        return drawn[int(rng.integers(len(drawn)))]


class Mosat(Nsga2):
    """NSGA-II whose mutations bring in motifs."""

    id = "mosat@1"
    summary = "MOSAT: NSGA-II with hand-written motifs of hostile drivers."
    config_type: type[Any] = MosatConfig

    def _fresh(self, config: Nsga2Config, genome: Genome, rng: np.random.Generator) -> Any:
        assert isinstance(config, MosatConfig)
        if rng.random() < config.motif_probability:
            return motif(genome.road, rng)
        return super()._fresh(config, genome, rng)


def _tournament(ranked: tuple[Any, Any], rng: np.random.Generator) -> int:
    """Return the place of the better of two: by front, then the less crowded, then the first drawn."""
    front, crowding = ranked
    first, second = rng.integers(len(front), size=2).tolist()
    return int(min((first, second), key=lambda place: (front[place], -crowding[place])))

"""SiMOOD: a genetic algorithm for the weakest combinations of perturbations that most harm a component.

Individuals are ordered slots of distinct techniques, each at a level (`brink.search.levels.Slots`). Most
evaluations ask how the component fares on a data set (`Question.DATASET`), which is cheap. The finalists, the best
individual of each order of techniques, are then simulated, all in the same few scenarios with the same seeds. Those
with a hazard are explained: what they consist of is simulated in the same places, and what becomes of them in another
order. Only what was simulated ends in the archive. For comparison the same search can ask the simulator every time,
or draw individuals at random.

Fitness, minimised: f = alpha + omega eta, or |omega eta - alpha| where alpha counts errors. alpha is the objective
that the problem measures, eta the mean intensity. No individual is evaluated twice.

Source: Ferreira, Guerin, Guiochet, Waeselynck, "SiMOOD: Evolutionary Testing Simulation with Out-Of-Distribution
Images", PRDC 2022.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Failed, Question
from brink.search.algorithms.ledger import (
    BoundaryConfig,
    Ledger,
    LedgerState,
    check_budget,
    row_keys,
    stored_rows,
)
from brink.search.archive import Archive
from brink.search.chains import ChainGenome
from brink.search.component import FloatArray, frozen_array
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError
from brink.search.settings import setting
from brink.search.space import SearchSpace
from brink.search.streams import Stream, generator

_VERSION: Final = 2
ALPHA: Final = "alpha"
"""Objective that a problem must measure: how well the component fares, or how many errors it makes."""


class Stage(StrEnum):
    """What the evaluations of a generation are for."""

    SEARCH = "search"
    FINALISTS = "finalists"
    EXPLANATION = "explanation"


@dataclass(frozen=True, slots=True, kw_only=True)
class SimoodConfig(BoundaryConfig):
    """Settings of SiMOOD."""

    generations: int = setting(20, help="Generations after the first population (g).", ge=0, le=10_000)
    population_size: int = setting(20, help="Individuals in the population (n).", ge=2, le=10_000)
    parents: int = setting(2, help="Parents, and children, of a generation (k).", ge=2, le=1_000)
    crossover_probability: float = setting(0.99, help="Probability that two parents cross.", ge=0, le=1)
    mutation_probability: float = setting(0.1, help="Probability that a child mutates.", ge=0, le=1)
    omega: float = setting(0.5, help="Weight of intensity: larger prefers weaker perturbations.", ge=0, le=1)
    alpha: str = setting(
        "quality", help="What alpha measures: quality (mAP) or errors.", choices=("quality", "errors")
    )
    evaluate: str = setting(
        "data",
        help="Where individuals are evaluated: on data, or in an episode.",
        choices=("data", "episode"),
    )
    propose: str = setting(
        "ga", help="How individuals are proposed: bred, or drawn at random.", choices=("ga", "random")
    )
    finalists: int = setting(5, help="Best individuals that are simulated at the end.", ge=0, le=10_000)
    repeats: int = setting(3, help="Scenarios in which each finalist is simulated.", ge=1, le=1_000)
    explained: int = setting(
        5, help="Hazardous finalists whose parts and other orders are simulated too.", ge=0, le=10_000
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimoodState(LedgerState):
    """State of SiMOOD.

    Attributes:
        config: Settings.
        individuals: Every individual that was evaluated, in the order of asking, shape ``(a, d)``.
        alphas: Their alpha, infinite if it could not be had, shape ``(a,)``.
        population: Positions of the population's individuals in `individuals`, shape ``(n,)``; the last generation's
            until the next is told.
        children: Individuals that are to join the population once they are told, shape ``(c, d)``.
        bred: Generations bred so far.
        stage: What the queue is for.
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


class Simood:
    """The genetic algorithm on data, and its finalists in the simulator."""

    id = "simood-ga@1"
    summary = "SiMOOD: perturbations bred on a data set, the best of them simulated."
    config_type = SimoodConfig

    def check(self, space: SearchSpace, config: SimoodConfig, *, budget: int) -> None:
        """Raise UnsupportedSpace without slots, ConfigError if the budget or the settings do not fit."""
        genome = ChainGenome.of(space)
        check_budget(budget, config.population_size + _reserve(config, genome))
        if config.parents > config.population_size:
            raise ConfigError("parents", f"expected at most population_size, got {config.parents}")
        if config.evaluate == "data" and not config.finalists:
            raise ConfigError("finalists", "expected at least 1: data alone gives no verdict")

    def start(self, space: SearchSpace, config: SimoodConfig, *, seed: int, budget: int) -> SimoodState:
        """Return the first state, with nothing asked yet."""
        self.check(space, config, budget=budget)
        genome = ChainGenome.of(space)
        rng = generator(seed, Stream.START)
        individuals = _drawn(genome, config.population_size, rng)
        state = SimoodState(
            config=config,
            ledger=Ledger.opened(space, config, seed=seed, budget=budget),
            individuals=frozen_array(np.empty((0, genome.component.dimension))),
            alphas=frozen_array(np.empty(0)),
            population=(),
            children=frozen_array(individuals),
            bred=0,
        )
        return _planned(state, genome)

    def ask(self, state: SimoodState) -> tuple[SimoodState, tuple[Candidate, ...]]:
        """Return a state with a pending generation, and that generation."""
        ledger = state.ledger.handed_out()
        return replace(state, ledger=ledger), ledger.pending

    def tell(self, state: SimoodState, evaluations: Mapping[int, Evaluation]) -> SimoodState:
        """Return the state after the pending generation was evaluated.

        Raises:
            OrderError: Nothing is pending, or the numbers are not the pending ones.
            KeyError: An evaluation lacks the objective alpha.
        """
        pending = state.ledger.pending
        told = replace(state, ledger=state.ledger.told(evaluations))
        genome = ChainGenome.of(told.ledger.space)
        if state.stage is Stage.FINALISTS:
            return _explaining(told, genome)
        if state.stage is Stage.EXPLANATION:
            return told
        told = _with_alphas(told, genome, pending, evaluations)
        return _bred_on(told, genome)

    def finished(self, state: SimoodState) -> bool:
        """Return whether the finalists are simulated and explained, or the budget is spent."""
        return not state.ledger.queue

    def dump(self, state: SimoodState) -> Document:
        """Return the state without its archive, as a versioned document."""
        return state.ledger.dump(
            self.id,
            _VERSION,
            {"population": list(state.population), "bred": state.bred, "stage": state.stage.value},
            {
                "individuals": state.individuals,
                "alphas": state.alphas[:, None],
                "children": state.children,
            },
        )

    def load(
        self, space: SearchSpace, config: SimoodConfig, document: Document, archive: Archive
    ) -> SimoodState:
        """Return the state that `dump` wrote, with the archive that it had then."""
        ledger = Ledger.load(space, config, document.expect(self.id, _VERSION), archive)
        width = ChainGenome.of(space).component.dimension
        population, bred = document.header.get("population"), document.header.get("bred")
        individuals = stored_rows(document, "individuals", width)
        if not isinstance(population, list) or not all(
            isinstance(place, int) and 0 <= place < len(individuals) for place in population
        ):
            raise DocumentError(f"population: expected positions of individuals, got {population!r}")
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
    """Return the best individual of each order of techniques among all evaluated, best first, shape ``(n, d)``."""
    genome = ChainGenome.of(state.ledger.space)
    techniques = [genome.columns(slot)[0] for slot in range(len(genome.slots.pairs))]
    fitness = _fitness(state)
    best: dict[bytes, int] = {}
    for place in np.argsort(fitness, kind="stable").tolist():
        if np.isfinite(fitness[place]):
            best.setdefault(state.individuals[place, techniques].tobytes(), place)
    return state.individuals[list(best.values())[: state.config.finalists]]


def _fitness(state: SimoodState) -> FloatArray:
    """Return f of all individuals, shape ``(a,)``; infinite where alpha could not be had."""
    weighted = state.config.omega * ChainGenome.of(state.ledger.space).eta(state.individuals)
    if state.config.alpha == "errors":
        return np.asarray(np.abs(weighted - state.alphas))
    return np.asarray(state.alphas + weighted)


def _drawn(genome: ChainGenome, count: int, rng: np.random.Generator) -> FloatArray:
    return np.array([genome.draw(rng) for _ in range(count)])


def _places(state: SimoodState) -> dict[bytes, int]:
    return (
        {key: place for place, key in enumerate(row_keys(state.individuals))}
        if len(state.individuals)
        else {}
    )


def _with_alphas(
    state: SimoodState,
    genome: ChainGenome,
    pending: Sequence[Candidate],
    evaluations: Mapping[int, Evaluation],
) -> SimoodState:
    """Return the state with the alphas of the individuals that were pending."""
    rows, alphas = [state.individuals], [state.alphas]
    for candidate in pending:
        evaluation = evaluations[candidate.number]
        alpha = np.inf if isinstance(evaluation, Failed) else float(evaluation.objectives[ALPHA])
        rows.append(candidate.vectors[genome.index][None])
        alphas.append(np.array([alpha]))
    return replace(
        state, individuals=frozen_array(np.concatenate(rows)), alphas=frozen_array(np.concatenate(alphas))
    )


def _bred_on(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Let the told children join, breed on until something new is to be evaluated, or plan the finalists."""
    while True:
        state = _joined(state)
        if state.bred >= state.config.generations:
            return _final(state, genome)
        children = _children(state, genome)
        state = _planned(replace(state, children=children, bred=state.bred + 1), genome)
        if state.ledger.queue:
            return state
        if _room(state) <= 0:
            return _final(state, genome)


def _reserve(config: SimoodConfig, genome: ChainGenome) -> int:
    """Return how much of the budget is kept for the finalists and their explanation."""
    explained = min(config.explained, config.finalists) * genome.variants
    return (config.finalists + explained) * config.repeats


def _room(state: SimoodState) -> int:
    """Return how many more individuals may be evaluated before the finalists."""
    return int(max(0, state.ledger.left - _reserve(state.config, ChainGenome.of(state.ledger.space))))


def _joined(state: SimoodState) -> SimoodState:
    """Return the state whose children have joined the population and whose worst individuals have left it."""
    place = _places(state)
    joined = [*state.population, *(place[key] for key in row_keys(state.children) if key in place)]
    fitness = _fitness(state)
    best = sorted(joined, key=lambda position: float(fitness[position]))  # stable: elders first among equals
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
            bred = child
            if like_a_parent or genome.repeats(child) or rng.random() < config.mutation_probability:
                bred = genome.varied(child, rng)
            children.append(bred)
    return np.array(children[: config.parents])


def _planned(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with those children queued that were never evaluated, as far as the budget goes."""
    known = _places(state)
    fresh: dict[bytes, FloatArray] = {}
    for key, child in zip(row_keys(state.children), state.children, strict=True):
        if key not in known:
            fresh.setdefault(key, child)
    question = Question.DATASET if state.config.evaluate == "data" else Question.EPISODE
    base = _scenario(state, 0)
    rows = [_row(genome, base, child) for child in fresh.values()][: _room(state)]
    return replace(state, ledger=state.ledger.planned(rows, question, [0] * len(rows)))


def _scenario(state: SimoodState, repeat: int) -> tuple[FloatArray, ...]:
    """Return what a finalist meets at a repeat, and what individuals meet that are simulated: repeat 0."""
    ledger = state.ledger
    return ledger.space.sample(generator(ledger.seed, Stream.FINALISTS, repeat))


def _row(genome: ChainGenome, base: Sequence[FloatArray], individual: FloatArray) -> FloatArray:
    vectors = [individual if index == genome.index else vector for index, vector in enumerate(base)]
    return genome.space.join(vectors)


def _simulating(
    state: SimoodState, genome: ChainGenome, individuals: Iterable[FloatArray], stage: Stage
) -> SimoodState:
    """Return the state with individuals queued that are to be simulated at every repeat, unless they were."""
    ledger = state.ledger
    repeats = range(state.config.repeats)
    bases = [_scenario(state, repeat) for repeat in repeats]
    rows = [_row(genome, bases[repeat], one) for one in individuals for repeat in repeats]
    repeat_of = {row.tobytes(): place % len(bases) for place, row in enumerate(rows)}
    fresh = ledger.unseen(rows)[: int(max(0, ledger.left))]
    seeds = [repeat_of[row.tobytes()] for row in fresh]
    return replace(state, ledger=ledger.planned(fresh, Question.EPISODE, seeds), stage=stage)


def _final(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with the finalists queued; nothing is to join any more."""
    state = replace(state, children=frozen_array(np.empty((0, state.children.shape[1]))))
    state = _simulating(state, genome, finalists_of(state), Stage.FINALISTS)
    return state if state.ledger.queue else _explaining(state, genome)


def _explaining(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with parts and other orders of the hazardous finalists queued."""
    archive = state.ledger.archive
    unsafe = set(row_keys(archive.vectors[archive.unsafe][:, genome.space.slices[genome.index]]))
    hazardous = [one for one in finalists_of(state) if one.tobytes() in unsafe]
    variants = [variant for one in hazardous[: state.config.explained] for variant in genome.taken_apart(one)]
    return _simulating(state, genome, variants, Stage.EXPLANATION)

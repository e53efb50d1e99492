"""SiMOOD: a genetic algorithm for the weakest perturbations that together do the most harm to a component.

Individuals are ordered slots of distinct techniques, each at a level (`brink.search.slots`). The search runs in
stages. In the first, most evaluations measure the component on a data set (`Question.DATASET`), which is cheap. The
finalists, the best individual of each order of techniques, are then simulated, all in the same few scenarios with the
same seeds. Finally the finalists that are unsafe in at least one scenario are explained, those unsafe most often
first: their parts and other orders of the same techniques are simulated in the same scenarios. Only simulated
solutions end up in the archive. For comparison, the first stage can also simulate every individual, or draw
individuals at random.

The fitness, minimised, is f = alpha + omega eta, or f = omega eta - alpha if alpha counts errors. alpha is an
objective measured by the problem, eta the mean intensity. No individual is evaluated twice, and none enters the
population twice.

A chain interacts if it does more harm than its most harmful part alone, by a margin (`brink.search.interaction`). The
paper does not ask for that, and much of what it finds is one harmful technique with a free rider. By default, the
fitness of a chain that interacts is omega eta minus its added harm, so that chains come first whose parts do little
harm alone. A chain that does not interact has a worse fitness than every chain that does, as in Deb's rules for
infeasible solutions: the less its added harm, the worse. Among chains without any added harm, and among finalists
that do not interact, the paper's fitness decides. To know that, each technique at a level is evaluated alone, too,
once in a search.

Sources: Ferreira, Guerin, Guiochet, Waeselynck, "SiMOOD: Evolutionary Testing Simulation with Out-Of-Distribution
Images", PRDC 2022. Deb, "An efficient constraint handling method for genetic algorithms", 2000. What differs from the
paper: docs/adr/0051-interaction-in-simood.md.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Final, TypeVar

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Failed, Question
from brink.search.algorithms.ledger import (
    Ledger,
    LedgerAlgorithm,
    LedgerConfig,
    LedgerState,
    row_keys,
    stored_rows,
)
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError
from brink.search.interaction import added_harm, interacts
from brink.search.settings import setting
from brink.search.slots import Chain, ChainGenome, parts_of
from brink.search.space import BoolArray, FloatArray, SearchSpace, frozen_array
from brink.search.streams import Stream, generator

ALPHA: Final = "alpha"
"""Objective that a problem must measure: the quality of the component, in [0, 1], or its number of errors, from 0."""

_Alpha = TypeVar("_Alpha", float, FloatArray)
_MAX_ATTEMPTS: Final = 100
"""Number of times that an individual is mutated, and then drawn again, because it is known, before it is given up."""


class Stage(StrEnum):
    """Purpose of a generation."""

    SEARCH = "search"
    PARTS = "parts"
    FINALISTS = "finalists"
    EXPLANATION = "explanation"


@dataclass(frozen=True, slots=True, kw_only=True)
class SimoodConfig(LedgerConfig):
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
    interaction: str = setting(
        "added_harm",
        help="Whether chains that do more harm than their most harmful part come first: by how much (added_harm), "
        "whether by margin (fitness), only when finalists are chosen (finalists), or not at all, as in the paper.",
        choices=("added_harm", "fitness", "finalists", "none"),
    )
    margin: float = setting(
        0.05,
        help="Added harm from which a chain interacts: by how much it is worse than its most harmful part alone, in "
        "units of alpha: mAP, or number of errors.",
        ge=0,
    )
    propose: str = setting(
        "ga", help="How individuals are proposed: bred, or drawn at random.", choices=("ga", "random")
    )
    finalists: int = setting(5, help="Number of best individuals to simulate at the end.", ge=0, le=10_000)
    repeats: int = setting(
        3,
        help="Scenarios in which each finalist is simulated; below 3, none is called hazardous.",
        ge=1,
        le=1_000,
    )
    explained: int = setting(
        5,
        help="Number of finalists, unsafe in at least one scenario, whose parts and other orders are also simulated.",
        ge=0,
        le=10_000,
    )

    def quality(self, alpha: _Alpha) -> _Alpha:
        """Return alpha oriented as a quality: lower means more harm."""
        return alpha if self.alpha == "quality" else -alpha


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimoodState(LedgerState):
    """State of SiMOOD.

    Attributes:
        config: Settings.
        individuals: All evaluated individuals, in the order of asking, shape ``(a, d)``.
        alphas: Their alpha, infinite if it could not be measured, shape ``(a,)``.
        added_harms: Their added harm, NaN as long as it is unknown, shape ``(a,)``.
        parts: All evaluated parts of individuals, as `ChainGenome.row` has them, shape ``(p, d)``.
        part_alphas: Their alpha, infinite if it could not be measured, shape ``(p,)``.
        population: Positions of the population in `individuals`; that of the last generation until the next is told.
        children: Individuals that join the population once they are told, shape ``(c, d)``.
        bred: Number of generations bred so far.
        given_up: Number of children that were given up because they remained equal to known individuals.
        stage: Purpose of the queue.
    """

    config: SimoodConfig
    individuals: FloatArray
    alphas: FloatArray
    added_harms: FloatArray
    parts: FloatArray
    part_alphas: FloatArray
    population: tuple[int, ...]
    children: FloatArray
    bred: int
    given_up: int = 0
    stage: Stage = Stage.SEARCH

    @property
    def fitness(self) -> FloatArray:
        """Fitness of the population, shape ``(n,)``."""
        return _fitness(self)[list(self.population)]


class Simood(LedgerAlgorithm[SimoodConfig, SimoodState]):
    """A genetic algorithm that evaluates individuals on a data set and simulates the finalists."""

    id = "simood-ga@1"
    finds = ("combinations",)
    summary = "SiMOOD: perturbations bred on a data set, the best of them simulated."
    config_type = SimoodConfig
    layout = 3

    def _min_budget(self, space: SearchSpace, config: SimoodConfig) -> int:
        genome = ChainGenome.of(space)
        if config.parents > config.population_size:
            raise ConfigError("parents", f"expected at most population_size, got {config.parents}")
        if config.evaluate == "data" and not config.finalists:
            raise ConfigError("finalists", "expected at least 1: a data set alone gives no verdict")
        return _first_cost(config, genome) + _reserve(config, genome)

    def _first_state(self, ledger: Ledger, config: SimoodConfig) -> SimoodState:
        genome = ChainGenome.of(ledger.space)
        no_rows, no_values = (
            frozen_array(np.empty((0, genome.component.dimension))),
            frozen_array(np.empty(0)),
        )
        state = SimoodState(
            config=config,
            ledger=ledger,
            individuals=no_rows,
            alphas=no_values,
            added_harms=no_values,
            parts=no_rows,
            part_alphas=no_values,
            population=(),
            children=no_rows,
            bred=0,
        )
        rng = generator(ledger.seed, Stream.START)
        drawn = [genome.draw(rng) for _ in range(config.population_size)]
        state = _with_new_children(state, genome, drawn, rng)
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
            case Stage.PARTS:
                return _selection(_with_alphas(told, genome, pending, evaluations), genome)
            case Stage.FINALISTS:
                return _explanation(told, genome)
            case Stage.EXPLANATION:
                return told

    def _content(self, state: SimoodState) -> tuple[dict[str, Any], dict[str, Any]]:
        header = {
            "population": list(state.population),
            "bred": state.bred,
            "given_up": state.given_up,
            "stage": state.stage.value,
        }
        arrays = {
            "individuals": state.individuals,
            "alphas": state.alphas[:, None],
            "added_harms": state.added_harms[:, None],
            "parts": state.parts,
            "part_alphas": state.part_alphas[:, None],
            "children": state.children,
        }
        return header, arrays

    def _restored(self, ledger: Ledger, config: SimoodConfig, document: Document) -> SimoodState:
        width = ChainGenome.of(ledger.space).component.dimension
        population, stage = document.header.get("population"), document.header.get("stage")
        bred, given_up = document.header.get("bred"), document.header.get("given_up")
        individuals = stored_rows(document, "individuals", width)
        if not isinstance(population, list) or not all(
            isinstance(place, int) and 0 <= place < len(individuals) for place in population
        ):
            raise DocumentError(
                f"population: expected a list of positions of individuals, got {population!r}"
            )
        if stage not in set(Stage):
            raise DocumentError(f"stage: expected one of {', '.join(Stage)}, got {stage!r}")
        if not isinstance(bred, int) or not isinstance(given_up, int):
            raise DocumentError(f"bred, given_up: expected whole numbers, got {bred!r} and {given_up!r}")
        parts = stored_rows(document, "parts", width)
        return SimoodState(
            config=config,
            ledger=ledger,
            individuals=individuals,
            alphas=_stored_values(document, "alphas", len(individuals)),
            added_harms=_stored_values(document, "added_harms", len(individuals)),
            parts=parts,
            part_alphas=_stored_values(document, "part_alphas", len(parts)),
            population=tuple(population),
            children=stored_rows(document, "children", width),
            bred=bred,
            given_up=given_up,
            stage=Stage(str(stage)),
        )


def _stored_values(document: Document, name: str, count: int) -> FloatArray:
    values = stored_rows(document, name, 1)[:, 0]
    if len(values) != count:
        raise DocumentError(f"{name}: expected {count} values, got {len(values)}")
    return frozen_array(values)


def finalists_of(state: SimoodState) -> FloatArray:
    """Return the best evaluated individual of each order of techniques, best first, shape ``(n, d)``.

    Best is what has the best fitness of the paper. Unless `SimoodConfig.interaction` is ``none``, those that interact
    come first.
    """
    return state.individuals[_selected(state, _interacting(state))]


def explained_of(state: SimoodState) -> list[FloatArray]:
    """Return the finalists to explain: unsafe in at least one scenario, those unsafe most often first.

    Args:
        state: A state after the finalists were simulated.
    """
    genome, archive = ChainGenome.of(state.ledger.space), state.ledger.archive
    verdicts: dict[bytes, list[bool]] = {}
    keys = row_keys(archive.vectors[:, genome.space.slices[genome.index]])
    for key, unsafe in zip(keys, archive.unsafe.tolist(), strict=True):
        verdicts.setdefault(key, []).append(unsafe)
    simulated = [
        (finalist, verdicts[key])
        for finalist in finalists_of(state)
        if (key := finalist.tobytes()) in verdicts
    ]
    hazardous = [(chain, sum(unsafe) / len(unsafe)) for chain, unsafe in simulated if any(unsafe)]
    ranked = sorted(hazardous, key=lambda pair: -pair[1])  # stable: on ties, the better finalist first
    return [chain for chain, _ in ranked[: state.config.explained]]


def budget_for(space: SearchSpace, config: SimoodConfig, evaluations: int) -> int:
    """Return the budget for a search of so many evaluations, those of parts included, and for what follows it.

    Its `SimoodConfig.generations` may end it earlier.
    """
    return evaluations + _reserve(config, ChainGenome.of(space))


def _selected(state: SimoodState, preferred: BoolArray) -> list[int]:
    """Return the positions of the finalists if some individuals, shape ``(a,)``, come before all others."""
    genome = ChainGenome.of(state.ledger.space)
    techniques = [genome.columns(slot)[0] for slot in range(len(genome.slots.pairs))]
    fitness = paper = _paper_fitness(state)
    if state.config.interaction == "added_harm":
        fitness = np.where(_interacting(state), _fitness(state), paper)
    best: dict[bytes, int] = {}
    for place in np.lexsort((fitness, ~preferred)).tolist():  # stable: on ties, the older first
        if np.isfinite(paper[place]):
            best.setdefault(state.individuals[place, techniques].tobytes(), place)
    return list(best.values())[: state.config.finalists]


def _seeks_interaction(config: SimoodConfig, genome: ChainGenome) -> bool:
    """Return whether parts matter; a chain of one technique has none."""
    return config.interaction != "none" and len(genome.slots.pairs) > 1


def _breeds_interaction(config: SimoodConfig, genome: ChainGenome) -> bool:
    """Return whether the fitness depends on the parts of a chain."""
    return config.interaction in ("added_harm", "fitness") and _seeks_interaction(config, genome)


def _interacting(state: SimoodState) -> BoolArray:
    """Return which individuals are known to interact, shape ``(a,)``."""
    margin = state.config.margin
    return np.array([interacts(harm, margin) for harm in state.added_harms.tolist()], np.bool_)


def _paper_fitness(state: SimoodState) -> FloatArray:
    """Return f as in the paper for all individuals, shape ``(a,)``; infinite for those without an alpha."""
    eta = ChainGenome.of(state.ledger.space).eta(state.individuals)
    return np.asarray(_qualities(state.config, state.alphas) + state.config.omega * eta)


def _fitness(state: SimoodState) -> FloatArray:
    """Return the fitness f of all individuals, shape ``(a,)``; infinite for those without an alpha.

    An individual that interacts has the paper's f, or, with ``added_harm``, omega eta minus its added harm. One that
    does not gets the worst possible f of those that do, and what it lacks of the margin. That is infinite if it is
    unknown because a part could not be measured. Added harm below 0 counts as 0: it is not worse to have a part that
    masks another than to have a free rider, and most of it is noise.
    """
    config, paper = state.config, _paper_fitness(state)
    genome = ChainGenome.of(state.ledger.space)
    if not _breeds_interaction(config, genome):
        return paper
    known = np.isfinite(state.added_harms)
    lacking = np.where(known, config.margin - np.clip(state.added_harms, 0.0, None), np.inf)
    if config.interaction == "added_harm":
        fitness, worst = config.omega * genome.eta(state.individuals) - state.added_harms, config.omega
    else:
        fitness, worst = paper, config.omega + (1.0 if config.alpha == "quality" else 0.0)
    return np.where(_interacting(state), fitness, np.where(np.isfinite(paper), worst + lacking, np.inf))


def _qualities(config: SimoodConfig, alphas: FloatArray) -> FloatArray:
    """Return alphas oriented so that lower means more harm; infinite for those that could not be measured."""
    return np.where(np.isfinite(alphas), config.quality(alphas), np.inf)


def _known_qualities(state: SimoodState, genome: ChainGenome) -> dict[Chain, float]:
    """Return the qualities of all parts that could be measured, by chain."""
    qualities = _qualities(state.config, state.part_alphas).tolist()
    return {
        genome.chain(part): quality
        for part, quality in zip(state.parts, qualities, strict=True)
        if np.isfinite(quality)
    }


def _added_harms(state: SimoodState, genome: ChainGenome, places: range) -> FloatArray:
    """Return the added harm of the individuals at some positions, NaN where they are unknown."""
    known = _known_qualities(state, genome)
    harms = []
    for place, quality in zip(places, _qualities(state.config, state.alphas[places]).tolist(), strict=True):
        chain = genome.chain(state.individuals[place])
        value = added_harm(chain, {**known, chain: quality}) if np.isfinite(quality) else None
        harms.append(np.nan if value is None else value)
    return np.array(harms, np.float64)


def _positions(state: SimoodState) -> dict[bytes, int]:
    return {key: place for place, key in enumerate(row_keys(state.individuals))}


def _with_alphas(
    state: SimoodState,
    genome: ChainGenome,
    pending: Sequence[Candidate],
    evaluations: Mapping[int, Evaluation],
) -> SimoodState:
    """Return the state with the pending individuals and parts, their alphas and added harm recorded."""
    whole = len(genome.slots.pairs)
    rows, alphas = [state.individuals], [state.alphas]
    part_rows, part_alphas = [state.parts], [state.part_alphas]
    for candidate in pending:
        evaluation, row = evaluations[candidate.number], candidate.vectors[genome.index]
        alpha = np.inf if isinstance(evaluation, Failed) else float(evaluation.objectives[ALPHA])
        is_part = len(genome.chain(row)) < whole
        (part_rows if is_part else rows).append(row[None])
        (part_alphas if is_part else alphas).append(np.array([alpha]))
    told = replace(
        state,
        individuals=frozen_array(np.concatenate(rows)),
        alphas=frozen_array(np.concatenate(alphas)),
        parts=frozen_array(np.concatenate(part_rows)),
        part_alphas=frozen_array(np.concatenate(part_alphas)),
    )
    # Pairs of steps are measured only after the search, so older values stay valid until then.
    first = len(state.individuals) if state.stage is Stage.SEARCH else 0
    added_harms = _added_harms(told, genome, range(first, len(told.individuals)))
    return replace(told, added_harms=frozen_array(np.concatenate([state.added_harms[:first], added_harms])))


def _next_search(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with the next generation queued, or, if there is none, what follows the search."""
    state = _joined(state)
    if state.bred < state.config.generations:
        rng = generator(state.ledger.seed, Stream.BREEDING, state.bred)
        bred = replace(state, bred=state.bred + 1)
        state = _with_new_children(bred, genome, _proposals(state, genome, rng), rng)
        state = _with_children_queued(state, genome)
        if state.ledger.queue:
            return state
    return _selection(state, genome)


def _first_cost(config: SimoodConfig, genome: ChainGenome) -> int:
    """Return the largest number of evaluations of the first population."""
    if not _breeds_interaction(config, genome):
        return config.population_size
    steps = config.population_size * len(genome.slots.pairs)
    return config.population_size + min(steps, genome.single_count)


def _reserve(config: SimoodConfig, genome: ChainGenome) -> int:
    """Return the part of the budget reserved for what follows the search."""
    if not _seeks_interaction(config, genome):
        return _reserve_for_episodes(config, genome)
    steps = len(genome.slots.pairs)
    parts = (1 << steps) - 2 - (steps if _breeds_interaction(config, genome) else 0)
    return config.finalists * parts + _reserve_for_episodes(config, genome)


def _reserve_for_episodes(config: SimoodConfig, genome: ChainGenome) -> int:
    """Return the part of the budget reserved for the finalists and their explanation."""
    explained = min(config.explained, config.finalists) * genome.ablation_count
    return (config.finalists + explained) * config.repeats


def _joined(state: SimoodState) -> SimoodState:
    """Return the state after the evaluated children joined the population and the worst individuals left it."""
    place = _positions(state)
    joined = [*state.population, *(place[key] for key in row_keys(state.children) if key in place)]
    fitness, paper = _fitness(state).tolist(), _paper_fitness(state).tolist()
    best = sorted(joined, key=lambda one: (fitness[one], paper[one]))  # stable: on ties, the older first
    return replace(state, population=tuple(best[: state.config.population_size]), children=_no_rows(state))


def _no_rows(state: SimoodState) -> FloatArray:
    return frozen_array(np.empty((0, state.individuals.shape[1])))


def _proposals(state: SimoodState, genome: ChainGenome, rng: np.random.Generator) -> list[FloatArray]:
    """Return the children of the next generation, as many as parents; some may be known already."""
    config = state.config
    if config.propose == "random":
        return [genome.draw(rng) for _ in range(config.parents)]
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
    return children[: config.parents]


def _with_new_children(
    state: SimoodState, genome: ChainGenome, proposals: Iterable[FloatArray], rng: np.random.Generator
) -> SimoodState:
    """Return the state with children that are all new.

    A proposal that is known is mutated until it is not, step by step away from where it was, then drawn again; in a
    random search and in the first population it is only drawn again. After that it is given up, and counted.
    """
    known = set(row_keys(state.individuals))
    children, given_up = [state.children[:0]], state.given_up
    mutations = 0 if state.config.propose == "random" or not len(state.individuals) else _MAX_ATTEMPTS
    for proposal in proposals:
        child = proposal
        for attempt in range(mutations + _MAX_ATTEMPTS):
            if child.tobytes() not in known:
                break
            child = genome.mutated(child, rng) if attempt < mutations else genome.draw(rng)
        if child.tobytes() in known:
            given_up += 1
        else:
            known.add(child.tobytes())
            children.append(child[None])
    return replace(state, children=frozen_array(np.concatenate(children)), given_up=given_up)


def _with_children_queued(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with its children queued, with their unknown parts if the fitness needs these.

    A child is queued with all of its parts, or, once the budget does not allow that, not at all.
    """
    config = state.config
    needs_parts = _breeds_interaction(config, genome)
    asked = set(row_keys(state.parts))
    room = _left(state, _reserve(config, genome))
    queued: list[FloatArray] = []
    queued_parts: list[FloatArray] = []
    for child in state.children:
        steps = [genome.row((step,)) for step in genome.chain(child)] if needs_parts else []
        fresh = [part for part in steps if part.tobytes() not in asked]
        if len(queued) + len(queued_parts) + 1 + len(fresh) > room:
            break
        queued.append(child)
        queued_parts += fresh
        asked.update(part.tobytes() for part in fresh)
    return _with_evaluations(state, genome, [*queued, *queued_parts])


def _with_evaluations(
    state: SimoodState, genome: ChainGenome, individuals: Sequence[FloatArray]
) -> SimoodState:
    """Return the state with individuals or parts queued, to be evaluated as the search evaluates them."""
    question = Question.DATASET if state.config.evaluate == "data" else Question.EPISODE
    scenario = _scenario(state, 0)
    rows = [_row(genome, scenario, individual) for individual in individuals]
    return replace(state, ledger=state.ledger.plan(rows, question, [0] * len(rows)))


def _left(state: SimoodState, reserve: int) -> int:
    """Return how many more evaluations the budget allows, besides a reserve."""
    return int(max(0, state.ledger.left - reserve))


def _selection(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with unknown parts of possible finalists queued, or, if none is unknown, with the finalists.

    Individuals that may interact, for all that is known, count as possible finalists.
    """
    if _seeks_interaction(state.config, genome):
        asked = set(row_keys(state.parts))
        missing = [
            [
                row
                for part in parts_of(genome.chain(individual))
                if (row := genome.row(part)).tobytes() not in asked
            ]
            for individual in state.individuals
        ]
        hopeful = np.isnan(state.added_harms) & np.array([bool(rows) for rows in missing], np.bool_)
        preferred = _interacting(state) | hopeful
        possible = [place for place in _selected(state, preferred) if preferred[place]]
        rows = {row.tobytes(): row for place in possible for row in missing[place]}
        room = _left(state, _reserve_for_episodes(state.config, genome))
        if rows and room:
            queued = _with_evaluations(state, genome, list(rows.values())[:room])
            return replace(queued, stage=Stage.PARTS, children=_no_rows(state))
    return _finals(state, genome)


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
    rows = [_row(genome, scenarios[repeat], individual) for individual in individuals for repeat in repeats]
    repeat_of = {row.tobytes(): place % len(scenarios) for place, row in enumerate(rows)}
    fresh = ledger.unseen(rows)[: int(max(0, ledger.left))]
    seeds = [repeat_of[row.tobytes()] for row in fresh]
    return replace(state, ledger=ledger.plan(fresh, Question.EPISODE, seeds), stage=stage)


def _finals(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with the finalists queued and no children left."""
    state = replace(state, children=_no_rows(state))
    state = _with_simulations(state, genome, finalists_of(state), Stage.FINALISTS)
    return state if state.ledger.queue else _explanation(state, genome)


def _explanation(state: SimoodState, genome: ChainGenome) -> SimoodState:
    """Return the state with the parts and other orders of the explained finalists queued."""
    variants = [variant for explained in explained_of(state) for variant in genome.ablations(explained)]
    return _with_simulations(state, genome, variants, Stage.EXPLANATION)

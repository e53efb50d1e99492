"""`deepjanus@1`: an evolutionary search along the frontier between safe and unsafe.

An individual is a *pair* of solutions. It is across the frontier if one member is safe and the other one unsafe.
NSGA-II minimises two objectives: the distance to the nearest archived pair, negated, plus a share of the distance
between the members; and the product of the members' robustness, or -0.1 across the frontier. A child is a selected
pair with one member mutated in one unit. Pairs across the frontier are archived if they are far from all archived
ones, or in place of the nearest one if their members are closer together. A pair begins with a *seed*, a safe
solution, and its mutant. Once a pair is archived, each generation replaces a random number of the most dominated
ones, a tenth at most, by new seeds.

The members of a pair share an episode seed, and so do those of its children.

Source: Riccio and Tonella, "Model-Based Exploration of the Frontier of Behaviours for Deep Learning System Testing",
ESEC/FSE 2020, with the constants of its study of a self-driving car. Distances, mutations and seeds: docs/adr/0082.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import Ledger, LedgerAlgorithm, LedgerConfig, LedgerState, stored_rows
from brink.search.algorithms.pool import random_rows
from brink.search.document import Document
from brink.search.errors import DocumentError
from brink.search.features import Unit, units_of
from brink.search.metric import Metric
from brink.search.operators import mutated
from brink.search.pairs import Steps
from brink.search.pareto import ranks_and_crowding, survivors
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, SearchSpace
from brink.search.streams import Stream, generator

ACROSS: Final = -0.1
"""Second objective of a pair across the frontier."""
_POOL: Final = 5
"""Random solutions for each pair of the first population, which is chosen among them to be far apart."""
_MUTATIONS: Final = 20
"""Mutations of a member that are tried until one is new."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeepJanusConfig(LedgerConfig):
    """Settings of DeepJanus."""

    population_size: int = setting(12, help="Pairs in the population.", ge=2, le=10_000)
    closeness: float = setting(
        0.01,
        label="Weight of closeness",
        help="Weight of the distance between members, beside that to the nearest archived pair (k).",
        ge=0,
        le=100,
    )
    d_th: float = setting(
        0.2,
        label="Distance between pairs",
        main=True,
        help="Distance from all archived pairs beyond which a pair across the frontier is archived.",
        ge=0,
        le=1,
    )
    reseed: float = setting(
        0.1, help="Largest share of the population that new pairs replace in a generation.", ge=0, le=1
    )


class Pair(NamedTuple):
    """Two solutions, by their numbers.

    Attributes:
        first: Number of one member.
        second: Number of the other one.
        seed: Number of the candidate whose episode seed both share.
    """

    first: int
    second: int
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeepJanusState(LedgerState):
    """State of DeepJanus.

    Attributes:
        config: Settings.
        population: The evaluated pairs, best first.
        born: The pairs that wait for a member in the queue or in flight.
        sown: Numbers of the seeds: in the queue or in flight, or just found to be safe.
        frontier: The archived pairs.
    """

    config: DeepJanusConfig
    population: tuple[Pair, ...] = ()
    born: tuple[Pair, ...] = ()
    sown: tuple[int, ...] = ()
    frontier: tuple[Pair, ...] = ()


class DeepJanus(LedgerAlgorithm[DeepJanusConfig, DeepJanusState]):
    """The exploration of the frontier of behaviours."""

    id = "deepjanus@1"
    finds = ("pairs",)
    minimises = ""
    summary = "DeepJanus: evolves pairs of solutions towards the frontier, and apart from each other."
    config_type = DeepJanusConfig

    def _min_budget(self, space: SearchSpace, config: DeepJanusConfig) -> int:
        return config.population_size

    def _first_state(self, ledger: Ledger, config: DeepJanusConfig) -> DeepJanusState:
        return _bred(DeepJanusState(config=config, ledger=ledger))

    def tell(self, state: DeepJanusState, evaluations: Mapping[int, Evaluation]) -> DeepJanusState:
        """Return the state after the pending generation was evaluated."""
        return _bred(_selected(replace(state, ledger=state.ledger.tell(evaluations))))

    def _content(self, state: DeepJanusState) -> tuple[dict[str, Any], dict[str, Any]]:
        groups = {"population": state.population, "born": state.born, "frontier": state.frontier}
        arrays = {name: np.reshape(pairs, (-1, 3)).astype(np.float64) for name, pairs in groups.items()}
        return {}, arrays | {"sown": np.reshape(state.sown, (-1, 1)).astype(np.float64)}

    def _restored(self, ledger: Ledger, config: DeepJanusConfig, document: Document) -> DeepJanusState:
        simulated = set(ledger.archive.numbers.tolist())
        numbered = set(range(ledger.spent + ledger.in_flight + len(ledger.queue)))
        groups: dict[str, tuple[Pair, ...]] = {}
        for name in ("population", "born", "frontier"):
            rows = stored_rows(document, name, 3).astype(np.int64).tolist()
            groups[name] = tuple(Pair(*row) for row in rows)
            possible = numbered if name == "born" else simulated
            members = {member for pair in groups[name] for member in pair[:2]}
            if unknown := (members - possible) | ({pair.seed for pair in groups[name]} - numbered):
                raise DocumentError(f"{name}: {min(unknown)} is none of the solutions of this campaign")
        sown = tuple(stored_rows(document, "sown", 1).astype(np.int64)[:, 0].tolist())
        if unknown := set(sown) - numbered:
            raise DocumentError(f"sown: {min(unknown)} is none of the solutions of this campaign")
        return DeepJanusState(config=config, ledger=ledger, sown=sown, **groups)


@dataclass(frozen=True, slots=True, eq=False)
class Members:
    """The members of pairs; of a pair across the frontier, the safe one is the first.

    Attributes:
        first: One member of each, shape ``(n, d)``.
        second: The other one, shape ``(n, d)``.
        across: Whether exactly one of them is unsafe, shape ``(n,)``.
        apart: The distance between them, shape ``(n,)``.
        product: The product of their robustness, shape ``(n,)``.
    """

    first: FloatArray
    second: FloatArray
    across: BoolArray
    apart: FloatArray
    product: FloatArray

    @classmethod
    def of(cls, pairs: Sequence[Pair], ledger: Ledger) -> "Members":
        """Return the members of pairs, all of which have verdicts."""
        archive = ledger.archive
        places = np.searchsorted(archive.numbers, np.reshape(pairs, (-1, 3))[:, :2].astype(np.int64))
        swapped = archive.unsafe[places[:, 0]] & ~archive.unsafe[places[:, 1]]
        first, second = np.where(swapped[:, None], places[:, ::-1], places).T
        with np.errstate(invalid="ignore"):
            product = archive.robustness[first] * archive.robustness[second]
        return cls(
            archive.vectors[first],
            archive.vectors[second],
            archive.unsafe[first] != archive.unsafe[second],
            Steps(ledger.space).apart(archive.vectors[first], archive.vectors[second]),
            np.where(np.isnan(product), np.inf, product),  # 0 times infinity
        )

    def distances(self, others: "Members", metric: Metric) -> FloatArray:
        """Return the mean distance of the members of each pair from those of other ones, shape ``(n, m)``.

        The members of pairs across the frontier are compared with those of the same verdict, others with the nearer.
        """
        straight = metric.between(self.first, others.first) + metric.between(self.second, others.second)
        crossed = metric.between(self.first, others.second) + metric.between(self.second, others.first)
        return 0.5 * np.where(self.across[:, None], straight, np.minimum(straight, crossed))


def _selected(state: DeepJanusState) -> DeepJanusState:
    """Return the state with the pairs that survive, after those across the frontier have been archived."""
    ledger, config = state.ledger, state.config
    simulated = set(ledger.archive.numbers.tolist())
    born = [pair for pair in state.born if {pair.first, pair.second} <= simulated]
    pairs = [*state.population, *born]
    frontier = _archived(state.frontier, pairs, ledger, config.d_th)
    objectives = _objectives(pairs, frontier, ledger, config.closeness)
    best = survivors(objectives, config.population_size).tolist()
    safe = set(ledger.archive.numbers[~ledger.archive.unsafe].tolist())
    return replace(
        state,
        population=tuple(pairs[place] for place in best),
        born=(),
        sown=tuple(number for number in state.sown if number in safe),
        frontier=frontier,
    )


def _archived(
    frontier: Sequence[Pair], pairs: Sequence[Pair], ledger: Ledger, threshold: float
) -> tuple[Pair, ...]:
    """Return the archived pairs after the given ones were offered, one after another."""
    kept = list(frontier)
    across = Members.of(pairs, ledger).across.tolist()
    for pair in itertools.compress(pairs, across):
        if pair in kept:
            continue
        mine, theirs = Members.of([pair], ledger), Members.of(kept, ledger)
        distances = mine.distances(theirs, ledger.archive.metric)[0]
        if not kept or distances.min() > threshold:
            kept.append(pair)
        elif mine.apart[0] < theirs.apart[nearest := int(distances.argmin())]:
            kept[nearest] = pair
    return tuple(kept)


def _objectives(
    pairs: Sequence[Pair], frontier: Sequence[Pair], ledger: Ledger, closeness: float
) -> FloatArray:
    """Return both objectives of each pair, minimised, shape ``(n, 2)``."""
    mine, theirs = Members.of(pairs, ledger), Members.of(frontier, ledger)
    distances = mine.distances(theirs, ledger.archive.metric)
    itself = np.array([[pair == other for other in frontier] for pair in pairs], np.bool_)
    sparseness = np.where(itself.reshape(distances.shape), np.inf, distances).min(axis=1, initial=1.0)
    return np.stack(
        [closeness * mine.apart - sparseness, np.where(mine.across, ACROSS, mine.product)], axis=1
    )


class _Brood:
    """The next generation while it is bred.

    Attributes:
        rows: New solutions.
        seeds: For each, the number of the candidate whose seed it shares; None for its own.
        pairs: The pairs that they complete.
        sown: Numbers of the seeds among them.
    """

    def __init__(self, ledger: Ledger, rng: np.random.Generator) -> None:
        self._ledger, self._rng = ledger, rng
        self._units = units_of(ledger.space)
        self._number = ledger.spent + ledger.in_flight
        self.rows: list[FloatArray] = []
        self.seeds: list[int | None] = []
        self.pairs: list[Pair] = []
        self.sown: list[int] = []

    @property
    def room(self) -> int:
        """How many more solutions the budget and the space allow."""
        return int(self._ledger.left) - len(self.rows)

    def add_child(self, kept: int, changed: int, seed: int) -> None:
        """Add a pair of a simulated solution and a mutant of one, if a new mutant was found and there is room."""
        mutant = self._mutant(self._row(changed)) if self.room else None
        if mutant is not None:
            self.pairs.append(Pair(kept, self._add(mutant, seed), seed))

    def add_seed(self, row: FloatArray) -> None:
        """Add a solution from which a pair begins once it is known to be safe."""
        self.sown.append(self._add(row, None))

    def _add(self, row: FloatArray, seed: int | None) -> int:
        self.rows.append(row)
        self.seeds.append(seed)
        return self._number + len(self.rows) - 1

    def _row(self, number: int) -> FloatArray:
        archive = self._ledger.archive
        row: FloatArray = archive.vectors[int(np.searchsorted(archive.numbers, number))]
        return row

    def _mutant(self, row: FloatArray) -> FloatArray | None:
        """Return a new solution that differs in one unit and in what follows from it; None if none was found."""
        for _ in range(_MUTATIONS):
            mutant = mutated_in(
                self._ledger.space, row, self._units[int(self._rng.integers(len(self._units)))], self._rng
            )
            if len(self._ledger.unseen([*self.rows, mutant])) > len(self.rows):
                return mutant
        return None


def mutated_in(space: SearchSpace, row: FloatArray, unit: Unit, rng: np.random.Generator) -> FloatArray:
    """Return a solution with one unit mutated, repaired.

    Args:
        space: The space.
        row: A valid solution, shape ``(d,)``.
        unit: The columns to mutate.
        rng: Source of the mutation.
    """
    hit = np.zeros(space.dimension)
    hit[list(unit)] = 1.0
    vectors = list(space.split(row))
    for index, (component, part) in enumerate(zip(space.components, space.slices, strict=True)):
        if hit[part].any():
            free = component.unset_dormant(vectors[index])
            vectors[index] = component.repair(mutated(component, free, hit[part], rng), rng)
    return space.join(vectors)


def _bred(state: DeepJanusState) -> DeepJanusState:
    """Return the state with the next generation planned, as budget and space allow."""
    ledger, config = state.ledger, state.config
    if ledger.left <= 0:
        return state
    rng = generator(ledger.seed, Stream.DEEPJANUS, ledger.generation)
    brood, size = _Brood(ledger, rng), config.population_size
    dropped = int(rng.integers(int(config.reseed * size) + 1)) if state.frontier else 0
    population = state.population[: max(0, len(state.population) - dropped)]
    for number in state.sown:
        brood.add_child(number, number, number)
    for row in _far_apart(ledger, size - len(population) - len(brood.pairs), rng)[: brood.room]:
        brood.add_seed(row)
    for pair in _parents(population, state, rng):
        kept, changed = (pair.first, pair.second)[:: int(rng.choice((1, -1)))]
        brood.add_child(kept, changed, pair.seed)
    if not brood.rows:
        for row in random_rows(ledger, min(1, brood.room), rng):
            brood.add_seed(row)
    planned = ledger.plan(brood.rows, seed_numbers=brood.seeds)
    return replace(
        state, ledger=planned, population=population, born=tuple(brood.pairs), sown=tuple(brood.sown)
    )


def _parents(population: Sequence[Pair], state: DeepJanusState, rng: np.random.Generator) -> list[Pair]:
    """Return the winners of as many tournaments of two as the population has places; none without a population."""
    if not population:
        return []
    config = state.config
    objectives = _objectives(population, state.frontier, state.ledger, config.closeness)
    front, crowding = ranks_and_crowding(objectives)
    contests = rng.integers(len(population), size=(config.population_size, 2)).tolist()
    return [population[min(two, key=lambda place: (front[place], -crowding[place]))] for two in contests]


def _far_apart(ledger: Ledger, count: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return random solutions, each the one of a pool that is farthest from those before it."""
    if count <= 0:
        return []
    pool = np.reshape(random_rows(ledger, _POOL * count, rng), (-1, ledger.space.dimension))
    metric = Metric.of_space(ledger.space)
    nearest = np.full(len(pool), np.inf)
    chosen: list[int] = []
    while len(chosen) < min(count, len(pool)):
        place = int(np.argmax(nearest))
        chosen.append(place)
        nearest = np.minimum(nearest, metric.between(pool, pool[place][None])[:, 0])
        nearest[chosen] = -np.inf
    return list(pool[chosen])

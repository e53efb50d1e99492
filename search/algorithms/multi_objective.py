"""What multi-objective searches over traffic participants have in common: a book of all solutions, and survival.

Two objectives, both minimised: how near a solution comes to a violation (criticality, measured by the problem), and
minus how far it is from what was tried lately (diversity, computed from roll-outs). Survival is NSGA-II's, over
parents and children alike. How children are bred is each algorithm's own.

Source: Tian et al., "An LLM-Empowered Adaptive Evolutionary Algorithm for Multi-Component Deep Learning Systems".
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self, TypeAlias, TypeVar

import numpy as np

from brink.search.actions.distance import encounter_distances
from brink.search.actions.genome import Genome
from brink.search.actions.variation import Solution
from brink.search.algorithm import Candidate, Evaluation, Scored
from brink.search.algorithms.ledger import BoundaryConfig, Ledger, LedgerState, stored_rows
from brink.search.archive import Archive
from brink.search.component import BoolArray, FloatArray, frozen_array
from brink.search.document import Document
from brink.search.errors import DocumentError
from brink.search.pareto import ranks_and_crowding, survivors
from brink.search.seeding import Origin
from brink.search.settings import setting
from brink.search.space import SearchSpace
from brink.search.streams import Stream, generator

CRITICALITY: Final = "criticality_m"
"""Objective that a problem must measure: the smallest distance to a violation, negative if violated."""
ORIGINS: Final = tuple(Origin)
_FILLS: Final = 30
"""Rounds of random draws for a generation that breeding could not fill."""


def gap_of(participant: int) -> str:
    """Return the objective that says how near a participant came to the ego; they count from 1."""
    return f"gap_{participant}_m"


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiObjectiveConfig(BoundaryConfig):
    """Settings of all of them."""

    population_size: int = setting(
        50, help="Solutions in the population, and children a generation.", ge=4, le=1_000
    )
    diversity: str = setting(
        "mean", help="Diversity is the mean or the least distance to what was tried lately.",
        choices=("mean", "min"),
    )  # fmt: skip
    lately: int = setting(5, help="Generations that count as lately.", ge=1, le=100)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Book:
    """Every solution that was told, by its number.

    Attributes:
        rows: Shape ``(a, d)``.
        criticality: Infinite if there is no verdict, shape ``(a,)``.
        gaps: How near each participant came to the ego, infinite if unknown, shape ``(a, p)``.
        unsafe: Shape ``(a,)``.
        generations: In which each was told, from 0, shape ``(a,)``.
        origins: Positions in `ORIGINS`, shape ``(a,)``.
    """

    rows: FloatArray
    criticality: FloatArray
    gaps: FloatArray
    unsafe: FloatArray
    generations: FloatArray
    origins: FloatArray

    @classmethod
    def empty(cls, genome: Genome) -> Self:
        """Return a book without entries."""
        none = frozen_array(np.empty(0))
        return cls(
            rows=frozen_array(np.empty((0, genome.space.dimension))), criticality=none,
            gaps=frozen_array(np.empty((0, genome.most))), unsafe=none, generations=none, origins=none,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.rows)

    def told(
        self,
        candidates: Sequence[Candidate],
        evaluations: Mapping[int, Evaluation],
        origins: Sequence[Origin],
        generation: int,
    ) -> Self:
        """Return the book with a generation added.

        Raises:
            KeyError: An evaluation lacks an objective.
        """
        rows, criticality, gaps, unsafe = [], [], [], []
        participants = self.gaps.shape[1]
        for candidate in candidates:
            evaluation = evaluations[candidate.number]
            rows.append(np.concatenate(candidate.vectors))
            if isinstance(evaluation, Scored):
                criticality.append(evaluation.objectives[CRITICALITY])
                gaps.append(
                    [evaluation.objectives.get(gap_of(p), np.inf) for p in range(1, participants + 1)]
                )
                unsafe.append(evaluation.unsafe)
            else:
                criticality.append(np.inf)
                gaps.append([np.inf] * participants)
                unsafe.append(False)
        codes = [ORIGINS.index(origin) for origin in origins]

        def more(before: FloatArray, after: object) -> FloatArray:
            return frozen_array(np.concatenate([before, np.asarray(after, np.float64)]))

        return replace(
            self,
            rows=more(self.rows, rows),
            criticality=more(self.criticality, criticality),
            gaps=more(self.gaps, gaps),
            unsafe=more(self.unsafe, unsafe),
            generations=more(self.generations, [generation] * len(rows)),
            origins=more(self.origins, codes),
        )

    @property
    def judged(self) -> BoolArray:
        """Which solutions have a verdict, shape ``(a,)``."""
        return np.isfinite(self.criticality)

    def lately(self, generations: int) -> list[int]:
        """Return the numbers of judged solutions of the last generations."""
        if not len(self):
            return []
        recent = self.generations > self.generations[-1] - generations
        return [int(number) for number in np.flatnonzero(self.judged & recent)]

    def origin(self, number: int) -> Origin:
        """Return where a solution comes from."""
        return ORIGINS[int(self.origins[number])]


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """The least and the greatest of an objective that were ever seen; infinite before there are any."""

    low: float = np.inf
    high: float = -np.inf

    def seen(self, values: FloatArray) -> "Bounds":
        """Return the bounds after more values."""
        finite = values[np.isfinite(values)]
        return Bounds(
            low=float(min(self.low, finite.min(initial=np.inf))),
            high=float(max(self.high, finite.max(initial=-np.inf))),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MultiObjectiveState(LedgerState):
    """State of a multi-objective search.

    Attributes:
        config: Settings.
        book: All solutions that were told.
        population: Their numbers, best first.
        diversity: Of the population, in m, shape ``(n,)``.
        queue_origins: Where the queued solutions come from.
        criticality_bounds: Ever seen.
        diversity_bounds: Ever seen.
    """

    config: MultiObjectiveConfig
    book: Book
    population: tuple[int, ...]
    diversity: FloatArray
    queue_origins: tuple[Origin, ...]
    criticality_bounds: Bounds
    diversity_bounds: Bounds

    @property
    def fitness(self) -> FloatArray:
        """Criticality of the population, shape ``(n,)``."""
        return self.book.criticality[list(self.population)]

    @property
    def objectives(self) -> FloatArray:
        """Criticality and minus diversity of the population, both minimised, shape ``(n, 2)``."""
        return np.stack([self.fitness, -self.diversity], axis=1)

    @property
    def front(self) -> tuple[int, ...]:
        """Numbers of those in the population that nobody dominates."""
        if not self.population:
            return ()
        first = ranks_and_crowding(self.objectives)[0] == 0
        return tuple(number for number, best in zip(self.population, first.tolist(), strict=True) if best)


def opened(
    space: SearchSpace, config: MultiObjectiveConfig, *, seed: int, budget: int
) -> MultiObjectiveState:
    """Return the state of a search that has not begun.

    Raises:
        UnsupportedSpace: The space has no participants.
    """
    return MultiObjectiveState(
        config=config,
        ledger=Ledger.opened(space, config, seed=seed, budget=budget),
        book=Book.empty(Genome.of(space)),
        population=(),
        diversity=frozen_array(np.empty(0)),
        queue_origins=(),
        criticality_bounds=Bounds(),
        diversity_bounds=Bounds(),
    )


S = TypeVar("S", bound=MultiObjectiveState)

Child: TypeAlias = tuple[FloatArray, Origin]
"""A row and where it comes from."""


def survived(state: S, evaluations: Mapping[int, Evaluation], genome: Genome) -> S:
    """Return the state after a generation was told: the best of parents and children are its population."""
    pending = state.ledger.pending
    ledger = state.ledger.told(evaluations)
    book = state.book.told(pending, evaluations, state.queue_origins, state.ledger.generation)
    fresh = [number for number in range(len(state.book), len(book)) if book.judged[number]]
    pool = [*state.population, *fresh]
    diversity = diversities(genome, book, pool, state.config)
    objectives = np.stack([book.criticality[pool], -diversity], axis=1)
    kept = survivors(objectives, state.config.population_size).tolist()
    return replace(
        state,
        ledger=ledger,
        book=book,
        population=tuple(pool[place] for place in kept),
        diversity=frozen_array(diversity[kept]),
        queue_origins=(),
        criticality_bounds=state.criticality_bounds.seen(book.criticality[fresh]),
        diversity_bounds=state.diversity_bounds.seen(diversity),
    )


def diversities(
    genome: Genome, book: Book, numbers: Sequence[int], config: MultiObjectiveConfig
) -> FloatArray:
    """Return how far solutions are from what was tried lately, themselves excepted, in m.

    Returns:
        Shape ``(n,)``; 0 where there is nothing to compare with.
    """
    lately = book.lately(config.lately)
    every = sorted({*numbers, *lately})
    place = {number: index for index, number in enumerate(every)}
    rolled = genome.rolled_out(genome.solution(book.rows[number]) for number in every)
    apart = encounter_distances(
        rolled.take([place[number] for number in numbers]), rolled.take([place[n] for n in lately])
    )
    itself = np.asarray(numbers)[:, None] == np.asarray(lately)[None, :]
    found = np.zeros(len(numbers))
    for row in range(len(numbers)):
        others = apart[row][~itself[row]]
        if others.size:
            found[row] = others.mean() if config.diversity == "mean" else others.min()
    return found


def random_children(genome: Genome, count: int, rng: np.random.Generator) -> list[Child]:
    """Return random solutions."""
    return [(genome.row(genome.random(rng), None, rng), Origin.RANDOM) for _ in range(count)]


def queued(state: S, children: Sequence[Child], genome: Genome, rng: np.random.Generator) -> S:
    """Return the state with a generation queued: children that are new, then random ones until it is full."""
    ledger = state.ledger
    wanted = int(min(state.config.population_size, max(0, ledger.left)))
    found: dict[bytes, Child] = {}

    def take(more: Sequence[Child]) -> None:
        origins = {row.tobytes(): origin for row, origin in reversed(more)}
        for row in ledger.unseen([row for row, _ in more]):
            found.setdefault(row.tobytes(), (row, origins[row.tobytes()]))

    take(children)
    for _ in range(_FILLS):
        if len(found) >= wanted:
            break
        take(random_children(genome, wanted - len(found), rng))
    chosen = list(found.values())[:wanted]
    return replace(
        state,
        ledger=ledger.planned([row for row, _ in chosen]),
        queue_origins=tuple(origin for _, origin in chosen),
    )


def breeding_rng(state: MultiObjectiveState) -> np.random.Generator:
    """Return the generator of the next generation's children."""
    return generator(state.ledger.seed, Stream.BREEDING, state.ledger.generation)


def child_of(
    state: MultiObjectiveState,
    genome: Genome,
    solution: Solution,
    parent: int,
    origin: Origin,
    rng: np.random.Generator,
) -> Child:
    """Return a child of a solution, by its number."""
    return genome.row(solution, state.book.rows[parent], rng), origin


def dump_state(state: MultiObjectiveState, kind: str, version: int, header: Mapping[str, object]) -> Document:
    """Return a state without its archive."""
    book = state.book
    bounds = [state.criticality_bounds, state.diversity_bounds]
    columns = np.stack([book.criticality, book.unsafe, book.generations, book.origins, *book.gaps.T], axis=1)
    return state.ledger.dump(
        kind,
        version,
        {
            "population": list(state.population),
            "queue_origins": [origin.value for origin in state.queue_origins],
            **header,
        },
        {
            "rows": book.rows,
            "columns": columns,
            "diversity": state.diversity[:, None],
            "bounds": np.array([[bound.low, bound.high] for bound in bounds]),
        },
    )


def load_state(
    space: SearchSpace, config: MultiObjectiveConfig, document: Document, archive: Archive
) -> MultiObjectiveState:
    """Return the state that `dump_state` wrote.

    Raises:
        DocumentError: The document is broken, or does not belong to the space, settings or archive.
    """
    genome = Genome.of(space)
    ledger = Ledger.load(space, config, document, archive)
    rows = stored_rows(document, "rows", space.dimension)
    columns = stored_rows(document, "columns", 4 + genome.most)
    diversity = stored_rows(document, "diversity", 1)[:, 0]
    bounds = stored_rows(document, "bounds", 2)
    population = document.header.get("population")
    if not isinstance(population, list) or not all(
        isinstance(number, int) and 0 <= number < len(rows) for number in population
    ):
        raise DocumentError(f"population: expected numbers of solutions, got {population!r}")
    if len(diversity) != len(population) or len(columns) != len(rows) or len(bounds) != 2:
        raise DocumentError("expected as many entries in every table of the search")
    origins = document.header.get("queue_origins")
    if not isinstance(origins, list) or not set(origins) <= set(Origin) or len(origins) != len(ledger.queue):
        raise DocumentError(f"queue_origins: expected one of each queued solution, got {origins!r}")
    return MultiObjectiveState(
        config=config,
        ledger=ledger,
        book=Book(
            rows=rows, criticality=frozen_array(columns[:, 0]), unsafe=frozen_array(columns[:, 1]),
            generations=frozen_array(columns[:, 2]), origins=frozen_array(columns[:, 3]),
            gaps=frozen_array(columns[:, 4:]),
        ),
        population=tuple(population),
        diversity=frozen_array(diversity),
        queue_origins=tuple(Origin(origin) for origin in origins),
        criticality_bounds=Bounds(low=float(bounds[0, 0]), high=float(bounds[0, 1])),
        diversity_bounds=Bounds(low=float(bounds[1, 0]), high=float(bounds[1, 1])),
    )  # fmt: skip

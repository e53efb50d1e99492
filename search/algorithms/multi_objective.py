"""Common base of multi-objective searches over traffic participants: the history of all solutions, and survival.

There are two objectives, both minimised: the criticality, which is the distance to a violation as measured by the
problem, and the negative diversity, which is the distance to recently tried solutions as computed from roll-outs.
Survival is that of NSGA-II, over parents and children together. Each algorithm breeds its children in its own way.

Source: Tian et al., "An LLM-Empowered Adaptive Evolutionary Algorithm for Multi-Component Deep Learning Systems".
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Self, TypeAlias, TypeVar

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Origin, Scored
from brink.search.algorithms.ledger import Ledger, LedgerConfig, LedgerState, stored_rows
from brink.search.document import Document
from brink.search.errors import DocumentError
from brink.search.pareto import ranks_and_crowding, survivors
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, frozen_array
from brink.search.streams import Stream, generator
from brink.search.traffic.motion import Distance, encounter_distances
from brink.search.traffic.participants import Solution
from brink.search.traffic.variation import TrafficGenome

CRITICALITY: Final = "criticality_m"
"""Objective that a problem must measure: the smallest distance to a violation, negative if violated."""
ORIGINS: Final = tuple(Origin)
_MAX_FILLS: Final = 30
"""Maximum rounds of random draws to fill a generation that breeding could not fill."""
_MAX_BREEDINGS: Final = 10
"""Maximum rounds of breeding in place of children that were known already."""


def gap_objective(participant: int) -> str:
    """Return the name of the objective for a participant's smallest gap to the ego; numbers start from 1."""
    return f"gap_{participant}_m"


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiObjectiveConfig(LedgerConfig):
    """Settings of all multi-objective searches."""

    by_criticality: ClassVar[bool] = True

    population_size: int = setting(
        50, help="Solutions in the population, and children per generation.", ge=4, le=1_000
    )
    diversity: str = setting(
        "mean",
        help="Whether diversity is the mean or the smallest distance to recent solutions.",
        choices=("mean", "min"),
    )
    lately: int = setting(5, help="Number of generations that count as recent.", ge=1, le=100)
    distance: str = setting(
        "time",
        choices=tuple(str(measure) for measure in Distance),
        help="Distance of two trajectories: mean over positions at equal times, or the paper's sum over actions.",
    )

    @property
    def measure(self) -> Distance:
        """How the distance between two trajectories is measured."""
        return Distance(self.distance)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class History:
    """Every solution told so far, by number.

    Attributes:
        rows: Solutions, shape ``(a, d)``.
        criticality: Infinite without a verdict, shape ``(a,)``.
        gaps: Smallest gap of each participant to the ego, infinite if unknown, shape ``(a, p)``.
        unsafe: Whether there was a violation that counts, shape ``(a,)``.
        generations: Generation of each, from 0, shape ``(a,)``.
        origins: Positions in `ORIGINS`, shape ``(a,)``.
    """

    rows: FloatArray
    criticality: FloatArray
    gaps: FloatArray
    unsafe: FloatArray
    generations: FloatArray
    origins: FloatArray

    @classmethod
    def empty(cls, genome: TrafficGenome) -> Self:
        """Return an empty history."""
        none = frozen_array(np.empty(0))
        return cls(
            rows=frozen_array(np.empty((0, genome.space.dimension))),
            criticality=none,
            gaps=frozen_array(np.empty((0, genome.max_participants))),
            unsafe=none,
            generations=none,
            origins=none,
        )

    def __len__(self) -> int:
        return len(self.rows)

    def extended(
        self,
        candidates: Sequence[Candidate],
        evaluations: Mapping[int, Evaluation],
        origins: Sequence[Origin],
        generation: int,
    ) -> Self:
        """Return the history with one more generation.

        Args:
            candidates: Candidates of the generation.
            evaluations: Their evaluations, by number.
            origins: The origin of each candidate.
            generation: Number of the generation.

        Raises:
            KeyError: An evaluation lacks an objective.
        """
        rows, criticality, gaps, unsafe = [], [], [], []
        participants = self.gaps.shape[1]
        for candidate in candidates:
            evaluation = evaluations[candidate.number]
            rows.append(np.concatenate(candidate.vectors))
            if isinstance(evaluation, Scored):
                objectives = evaluation.objectives
                criticality.append(objectives[CRITICALITY])
                gaps.append([objectives.get(gap_objective(p), np.inf) for p in range(1, participants + 1)])
                unsafe.append(evaluation.unsafe and evaluation.counts)
            else:
                criticality.append(np.inf)
                gaps.append([np.inf] * participants)
                unsafe.append(False)

        def joined(before: FloatArray, after: object) -> FloatArray:
            return frozen_array(np.concatenate([before, np.asarray(after, np.float64)]))

        return replace(
            self,
            rows=joined(self.rows, rows),
            criticality=joined(self.criticality, criticality),
            gaps=joined(self.gaps, gaps),
            unsafe=joined(self.unsafe, unsafe),
            generations=joined(self.generations, [generation] * len(rows)),
            origins=joined(self.origins, [ORIGINS.index(origin) for origin in origins]),
        )

    @property
    def has_verdict(self) -> BoolArray:
        """Which solutions have a verdict, shape ``(a,)``."""
        return np.isfinite(self.criticality)

    def recent(self, generations: int) -> list[int]:
        """Return the numbers of the solutions of the last generations that have a verdict."""
        if not len(self):
            return []
        recent = self.generations > self.generations[-1] - generations
        return [int(number) for number in np.flatnonzero(self.has_verdict & recent)]

    def origin(self, number: int) -> Origin:
        """Return the origin of a solution."""
        return ORIGINS[int(self.origins[number])]


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """The smallest and largest value of an objective so far; infinite before the first value."""

    low: float = np.inf
    high: float = -np.inf

    def widened(self, values: FloatArray) -> "Bounds":
        """Return the bounds extended to the finite numbers among the given values, shape ``(n,)``."""
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
        history: All solutions told so far.
        population: Numbers of the solutions in the population, best first.
        diversity: Diversity of the population in m, shape ``(n,)``.
        queue_origins: The origin of each queued solution.
        criticality_bounds: Bounds of the criticality over the whole history.
        diversity_bounds: Bounds of the diversity over the whole history.
    """

    config: MultiObjectiveConfig
    history: History
    population: tuple[int, ...]
    diversity: FloatArray
    queue_origins: tuple[Origin, ...]
    criticality_bounds: Bounds
    diversity_bounds: Bounds

    @property
    def fitness(self) -> FloatArray:
        """Criticality of the population, shape ``(n,)``."""
        return self.history.criticality[list(self.population)]

    @property
    def objectives(self) -> FloatArray:
        """Criticality and negative diversity of the population, both minimised, shape ``(n, 2)``."""
        return np.stack([self.fitness, -self.diversity], axis=1)

    @property
    def front(self) -> tuple[int, ...]:
        """Numbers of the non-dominated solutions of the population."""
        if not self.population:
            return ()
        first = ranks_and_crowding(self.objectives)[0] == 0
        return tuple(number for number, best in zip(self.population, first.tolist(), strict=True) if best)


S = TypeVar("S", bound=MultiObjectiveState)

Child: TypeAlias = tuple[FloatArray, Origin]
"""A row of the space, and its origin."""


def empty_state(ledger: Ledger, config: MultiObjectiveConfig) -> MultiObjectiveState:
    """Return a state without a population.

    Raises:
        UnsupportedSpace: The space has no participants.
    """
    return MultiObjectiveState(
        config=config,
        ledger=ledger,
        history=History.empty(TrafficGenome.of(ledger.space)),
        population=(),
        diversity=frozen_array(np.empty(0)),
        queue_origins=(),
        criticality_bounds=Bounds(),
        diversity_bounds=Bounds(),
    )


def select_survivors(state: S, evaluations: Mapping[int, Evaluation], genome: TrafficGenome) -> S:
    """Return the state after a generation, with the best of the parents and children as its population.

    Args:
        state: A state with a pending generation.
        evaluations: Evaluations of that generation, by number.
        genome: Genome of the space.

    Raises:
        OrderError: Nothing is pending, or the numbers are not those of the pending candidates.
        KeyError: An evaluation lacks the criticality.
    """
    pending = state.ledger.pending
    ledger = state.ledger.tell(evaluations)
    history = state.history.extended(pending, evaluations, state.queue_origins, state.ledger.generation)
    fresh = [number for number in range(len(state.history), len(history)) if history.has_verdict[number]]
    pool = [*state.population, *fresh]
    diversity = diversities(genome, history, pool, state.config)
    objectives = np.stack([history.criticality[pool], -diversity], axis=1)
    # A violation that does not count comes last, by a value that must not become a bound.
    counting = [counts(evaluations[candidate.number]) for candidate in pending]
    criticality = history.criticality[len(state.history) :][np.array(counting, np.bool_)]
    kept = survivors(objectives, state.config.population_size).tolist()
    return replace(
        state,
        ledger=ledger,
        history=history,
        population=tuple(pool[place] for place in kept),
        diversity=frozen_array(diversity[kept]),
        queue_origins=(),
        criticality_bounds=state.criticality_bounds.widened(criticality),
        diversity_bounds=state.diversity_bounds.widened(diversity),
    )


def counts(evaluation: Evaluation) -> bool:
    """Return whether an evaluation's criticality guides the search towards its target."""
    return isinstance(evaluation, Scored) and (evaluation.counts or not evaluation.unsafe)


def diversities(
    genome: TrafficGenome, history: History, numbers: Sequence[int], config: MultiObjectiveConfig
) -> FloatArray:
    """Return the distance of each solution to the recently tried solutions other than itself.

    Args:
        genome: Genome of the space.
        history: All solutions told so far.
        numbers: Numbers of the n solutions.
        config: Settings: which solutions count as recent, and whether to take the mean or the minimum.

    Returns:
        Distances in m, shape ``(n,)``; 0 for a solution without others to compare with.
    """
    recent = history.recent(config.lately)
    compared = sorted({*numbers, *recent})
    place = {number: index for index, number in enumerate(compared)}
    rollouts = genome.roll_out_rows((history.rows[number] for number in compared), config.measure)
    distances = encounter_distances(
        rollouts.take([place[number] for number in numbers]), rollouts.take([place[n] for n in recent])
    )
    itself = np.asarray(numbers)[:, None] == np.asarray(recent)[None, :]
    values = np.zeros(len(numbers))
    for row in range(len(numbers)):
        others = distances[row][~itself[row]]
        if others.size:
            values[row] = others.mean() if config.diversity == "mean" else others.min()
    return values


def random_children(genome: TrafficGenome, count: int, rng: np.random.Generator) -> list[Child]:
    """Draw random solutions.

    Args:
        genome: Genome of the space.
        count: Number of solutions.
        rng: Source of all randomness.
    """
    return [(genome.row(genome.sample(rng), None, rng), Origin.RANDOM) for _ in range(count)]


Breeder: TypeAlias = Callable[[int], Sequence[Child]]
"""Breeds as many further children as it is asked for."""


def plan_generation(
    state: S,
    children: Sequence[Child],
    genome: TrafficGenome,
    rng: np.random.Generator,
    breeders: Sequence[Breeder] = (),
) -> S:
    """Return the state with the next generation queued: new children, then random solutions until it is full.

    Children that are known already are skipped, so they cost no simulation. The breeders in turn replace them, each
    for a few rounds. Random solutions replace what is then still missing; if there is a population that they are
    added to, their origin is `Origin.IMMIGRANT`.

    Args:
        state: A state with an empty queue.
        children: Children in order of preference.
        genome: Genome of the space.
        rng: Source of all randomness.
        breeders: Breed children in place of known ones.
    """
    ledger = state.ledger
    wanted = int(min(state.config.population_size, max(0, ledger.left)))
    chosen: dict[bytes, Child] = {}

    def take(candidates: Sequence[Child]) -> None:
        origins = {row.tobytes(): origin for row, origin in reversed(candidates)}
        for row in ledger.unseen([row for row, _ in candidates]):
            chosen.setdefault(row.tobytes(), (row, origins[row.tobytes()]))

    def drawn(count: int) -> list[Child]:
        origin = Origin.IMMIGRANT if state.population else Origin.RANDOM
        return [(row, origin) for row, _ in random_children(genome, count, rng)]

    take(children)
    for breed, rounds in [*((breeder, _MAX_BREEDINGS) for breeder in breeders), (drawn, _MAX_FILLS)]:
        for _ in range(rounds):
            if len(chosen) >= wanted:
                break
            take(breed(wanted - len(chosen)))
    generation = list(chosen.values())[:wanted]
    return replace(
        state,
        ledger=ledger.plan([row for row, _ in generation]),
        queue_origins=tuple(origin for _, origin in generation),
    )


def breeding_rng(state: MultiObjectiveState) -> np.random.Generator:
    """Return the random generator for breeding the next generation."""
    return generator(state.ledger.seed, Stream.BREEDING, state.ledger.generation)


def child_of(
    state: MultiObjectiveState,
    genome: TrafficGenome,
    solution: Solution,
    parent: int,
    origin: Origin,
    rng: np.random.Generator,
) -> Child:
    """Return a child with the given participants and the other components of its parent.

    Args:
        state: State with the parent in its history.
        genome: Genome of the space.
        solution: Participants of the child.
        parent: Number of the parent.
        origin: How the participants were made.
        rng: Source of all randomness.
    """
    return genome.row(solution, state.history.rows[parent], rng), origin


def state_content(state: MultiObjectiveState) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the header entries and arrays that store a state, without its ledger."""
    history = state.history
    bounds = [state.criticality_bounds, state.diversity_bounds]
    columns = [history.criticality, history.unsafe, history.generations, history.origins, *history.gaps.T]
    header = {
        "population": list(state.population),
        "queue_origins": [origin.value for origin in state.queue_origins],
    }
    arrays = {
        "rows": history.rows,
        "columns": np.stack(columns, axis=1),
        "diversity": state.diversity[:, None],
        "bounds": np.array([[bound.low, bound.high] for bound in bounds]),
    }
    return header, arrays


def restored_state(ledger: Ledger, config: MultiObjectiveConfig, document: Document) -> MultiObjectiveState:
    """Return the state restored from its ledger and from a document that holds its `state_content`.

    Args:
        ledger: The ledger.
        config: Settings.
        document: The document.

    Raises:
        DocumentError: The document is corrupt, or does not match the space.
    """
    rows = stored_rows(document, "rows", ledger.space.dimension)
    columns = stored_rows(document, "columns", 4 + TrafficGenome.of(ledger.space).max_participants)
    diversity = stored_rows(document, "diversity", 1)[:, 0]
    bounds = stored_rows(document, "bounds", 2)
    population = document.header.get("population")
    if not isinstance(population, list) or not all(
        isinstance(number, int) and 0 <= number < len(rows) for number in population
    ):
        raise DocumentError(f"population: expected a list of solution numbers, got {population!r}")
    if len(diversity) != len(population) or len(columns) != len(rows) or len(bounds) != 2:
        raise DocumentError(
            "expected as many entries in diversity as in population, as many rows in columns as in rows, and two in "
            "bounds"
        )
    return MultiObjectiveState(
        config=config,
        ledger=ledger,
        history=History(
            rows=rows, criticality=frozen_array(columns[:, 0]), unsafe=frozen_array(columns[:, 1]),
            generations=frozen_array(columns[:, 2]), origins=frozen_array(columns[:, 3]),
            gaps=frozen_array(columns[:, 4:]),
        ),
        population=tuple(population),
        diversity=frozen_array(diversity),
        queue_origins=stored_origins(document, len(ledger.pending or ledger.queue)),
        criticality_bounds=Bounds(low=float(bounds[0, 0]), high=float(bounds[0, 1])),
        diversity_bounds=Bounds(low=float(bounds[1, 0]), high=float(bounds[1, 1])),
    )  # fmt: skip


def stored_origins(document: Document, count: int) -> tuple[Origin, ...]:
    """Return the origins of the solutions in flight and in the queue.

    Args:
        document: A document with ``queue_origins`` in its header.
        count: Number of these solutions.

    Raises:
        DocumentError: The origins are missing or corrupt, or there are more or fewer.
    """
    origins = document.header.get("queue_origins")
    if not isinstance(origins, list) or not set(origins) <= set(Origin) or len(origins) != count:
        raise DocumentError(f"queue_origins: expected one for each of {count} solutions, got {origins!r}")
    return tuple(Origin(origin) for origin in origins)

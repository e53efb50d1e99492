"""Common base of the built-in algorithms: the ledger of all candidates, shared settings, and most of the contract.

The ledger records every solution ever asked for: the archive, failed and measured solutions, the generations in
flight, and the queue, which is the next generation. Numbers count from 0 in the order of planning and are not stored:
every archived, failed, pending or queued solution has used up one. The next generation is planned as soon as there is
room for it in flight; an empty queue then means that nothing is left to ask for.

What was known before the search started stands beside the archive, never in it: the archive holds what this search
has simulated. `Ledger.evidence` is both together.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from types import MappingProxyType
from typing import Any, ClassVar, Final, Generic, Self, TypeVar

import numpy as np

from brink.search.algorithm import (
    UNDECLARED,
    Candidate,
    Evaluation,
    Failed,
    Known,
    Measured,
    Question,
    Scored,
)
from brink.search.archive import Archive, Neighbourhood
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, OrderError, SpaceError
from brink.search.settings import check_settings, setting
from brink.search.space import FloatArray, SearchSpace, frozen_array

MAX_BREEDINGS: Final = 10
"""Number of populations bred without a new solution before a search restarts from a random one."""

MAX_RESTARTS: Final = 90
"""Number of random populations without a new solution before a finite space counts as exhausted."""


AGGREGATES: Final[Mapping[str, Callable[[Sequence[float]], float]]] = {
    "best": min,
    "mean": fmean,
    "worst": max,
}
"""How the fitness of an individual follows from that of its solutions; none depends on their order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerConfig:
    """Settings of every built-in algorithm: the neighbourhood in which an archive estimates the unsafe share.

    Unless the search is guided by boundary fitness (`BoundaryConfig`), they only say how the archive is shown.
    """

    by_criticality: ClassVar[bool] = False
    """Whether the criticality of solutions guides the search."""
    unused: ClassVar[tuple[str, ...]] = ("radius", "p_th", "z")
    """Settings that do not affect the search. Campaigns may have them, but forms and lists do not offer them."""

    radius: float = setting(
        0.3, label="Neighbourhood radius", help="Maximum distance of a neighbour (delta).", gt=0, le=1
    )
    p_th: float = setting(
        0.1,
        label="Threshold probability",
        main=True,
        help="Unsafe probability that defines the boundary.",
        gt=0,
        lt=1,
    )
    z: float = setting(
        1.96,
        label="Confidence quantile",
        help="Quantile of the standard normal for the Wilson interval.",
        gt=0,
        le=10,
    )

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundaryConfig(LedgerConfig):
    """Settings of every algorithm that is guided by boundary fitness, or serves as a baseline of one."""

    unused: ClassVar[tuple[str, ...]] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class PairConfig(LedgerConfig):
    """Settings of every algorithm that narrows pairs: when one is tight, and which are distinct."""

    eps: float = setting(
        0.02,
        label="Distance within a pair",
        main=True,
        help="Largest distance of a tight pair.",
        ge=1e-6,
        le=1,
    )
    d_th: float = setting(
        0.2,
        label="Distance between pairs",
        main=True,
        help="Smallest distance between two distinct pairs.",
        ge=0,
        le=1,
    )


def row_keys(rows: FloatArray) -> list[bytes]:
    """Return the bytes of each row, shape ``(n, d)``; two keys are equal if and only if the rows are."""
    blob = np.ascontiguousarray(rows).tobytes()
    width = rows.shape[1] * rows.itemsize
    return [blob[start : start + width] for start in range(0, len(blob), width)]


def candidate_key(candidate: Candidate) -> bytes:
    """Return the key of a candidate's row; see `row_keys`."""
    return b"".join(vector.tobytes() for vector in candidate.vectors)


def candidate_rows(candidates: Iterable[Candidate], dimension: int) -> FloatArray:
    """Return candidates as rows, shape ``(n, dimension)``, read-only."""
    rows: FloatArray = np.frombuffer(b"".join(map(candidate_key, candidates)), np.float64)
    return rows.reshape(-1, dimension)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ledger:
    """All candidates of a search.

    Attributes:
        space: The search space.
        seed: The campaign's seed.
        budget: Number of evaluations after which no generation is planned.
        generation: Number of generations told so far.
        archive: Evaluated solutions.
        known: What was known before the search started.
        failed: Solutions without a verdict, as rows, shape ``(f, d)``.
        measured: Solutions measured on a data set, as rows, shape ``(m, d)``; they may still be simulated.
        flight: The generations that were asked for but not told yet, oldest first.
        queue: The planned generation, ascending by number.
    """

    space: SearchSpace
    seed: int
    budget: int
    generation: int
    archive: Archive
    known: Known
    failed: FloatArray
    measured: FloatArray
    flight: tuple[tuple[Candidate, ...], ...]
    queue: tuple[Candidate, ...]

    @classmethod
    def start(
        cls, space: SearchSpace, config: object, *, seed: int, budget: int, known: Known | None = None
    ) -> Self:
        """Return an empty ledger.

        Args:
            space: The search space.
            config: Settings; the archive takes those of its neighbourhood, if there are any.
            seed: The campaign's seed.
            budget: Number of evaluations.
            known: What is known already; None for nothing.
        """
        return cls(
            space=space,
            seed=seed,
            budget=budget,
            generation=0,
            archive=Archive.empty(space, Neighbourhood.of(config)),
            known=Known.nothing(space.dimension) if known is None else known,
            failed=frozen_array(np.empty((0, space.dimension))),
            measured=frozen_array(np.empty((0, space.dimension))),
            flight=(),
            queue=(),
        )

    @property
    def spent(self) -> int:
        """Number of evaluations told so far, including failed ones."""
        return len(self.archive) + len(self.failed) + len(self.measured)

    @property
    def ended(self) -> dict[int, bool | None]:
        """Whether each candidate told so far was unsafe, by number; None for one without a verdict."""
        numbers, unsafe = self.archive.numbers.tolist(), self.archive.unsafe.tolist()
        return dict.fromkeys(range(self.spent)) | dict(zip(numbers, unsafe, strict=True))

    @property
    def in_flight(self) -> int:
        """Number of candidates asked for but not yet told."""
        return sum(map(len, self.flight))

    @property
    def left(self) -> float:
        """Number of solutions that budget and space allow to plan; zero or less if there is none."""
        return min(self.unspent, self.space.size - self.spent - self.in_flight)

    @property
    def unspent(self) -> int:
        """Number of evaluations that the budget allows to plan, for searches that may repeat solutions."""
        return self.budget - self.spent - self.in_flight

    @property
    def evidence(self) -> Archive:
        """The archive, followed by the known results, whose numbers are negative."""
        known = self.known
        if not len(known):
            return self.archive
        numbers = -1 - np.arange(len(known))
        return self.archive.grown(numbers, known.rows, known.unsafe, known.robustness, keep_rows=False)

    @property
    def points(self) -> tuple[FloatArray, ...]:
        """Known points that have not been asked for yet."""
        return self.unseen(self.known.points) if len(self.known.points) else ()

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """The oldest generation in flight."""
        return self.flight[0] if self.flight else ()

    @property
    def flying(self) -> FloatArray:
        """The candidates in flight as rows, shape ``(in_flight, d)``."""
        return candidate_rows((one for generation in self.flight for one in generation), self.space.dimension)

    @property
    def planned_generation(self) -> int:
        """Number of the generation in the queue."""
        return self.generation + len(self.flight)

    def unseen(self, rows: Iterable[FloatArray]) -> tuple[FloatArray, ...]:
        """Return the rows that were never asked for and whose results are not known, in order, without duplicates.

        Those that combine components in a way that a constraint does not allow are left out.
        """
        seen = {*row_keys(self.archive.vectors), *row_keys(self.failed), *row_keys(self.known.rows)}
        seen.update(candidate_key(candidate) for generation in self.flight for candidate in generation)
        fresh = []
        for row in rows:
            key = row.tobytes()
            if key not in seen and self.space.allows(row):
                seen.add(key)
                fresh.append(row)
        return tuple(fresh)

    def plan(
        self,
        rows: Iterable[FloatArray],
        question: Question = Question.EPISODE,
        seed_numbers: Sequence[int | None] | None = None,
    ) -> Self:
        """Return the ledger with the next generation queued.

        Args:
            rows: New solutions, each of shape ``(d,)``.
            question: How to evaluate them.
            seed_numbers: For each, the number of the candidate whose episode seed it shares; None for its own seed.
        """
        rows = list(rows)
        seeds: Sequence[int | None] = [None] * len(rows) if seed_numbers is None else seed_numbers
        queue = tuple(
            Candidate(number=number, vectors=self.space.split(row), question=question, seed_number=seed)
            for number, (row, seed) in enumerate(zip(rows, seeds, strict=True), self.spent + self.in_flight)
        )
        return replace(self, queue=queue)

    def ask(self) -> Self:
        """Return the ledger with its queue in flight, and an empty queue.

        Raises:
            OrderError: The queue is empty.
        """
        if self.queue:
            return replace(self, flight=(*self.flight, self.queue), queue=())
        if self.flight:
            raise OrderError(f"ask: tell the {len(self.pending)} pending evaluations first")
        raise OrderError("ask: the search is finished; check `finished` before asking")

    def tell(self, evaluations: Mapping[int, Evaluation]) -> Self:
        """Return the ledger with the oldest generation in flight evaluated.

        Raises:
            OrderError: Nothing is pending, the queue has not been asked for yet, or the numbers are not those of the
                pending candidates.
        """
        self._check_pending(evaluations)
        scored: list[tuple[Candidate, Scored]] = []
        failed, measured = [self.failed], [self.measured]
        for candidate in self.pending:
            match evaluations[candidate.number]:
                case Scored() as evaluation:
                    scored.append((candidate, evaluation))
                case Measured():
                    measured.append(self.space.join(candidate.vectors)[None])
                case Failed():
                    failed.append(self.space.join(candidate.vectors)[None])
        archive = self.archive.grown(
            np.array([candidate.number for candidate, _ in scored], np.int64),
            candidate_rows((candidate for candidate, _ in scored), self.space.dimension),
            np.array([evaluation.unsafe for _, evaluation in scored], np.bool_),
            np.array([evaluation.robustness for _, evaluation in scored], np.float64),
        )
        return replace(
            self,
            generation=self.generation + 1,
            archive=archive,
            failed=frozen_array(np.concatenate(failed)),
            measured=frozen_array(np.concatenate(measured)),
            flight=self.flight[1:],
        )

    def _check_pending(self, evaluations: Mapping[int, Evaluation]) -> None:
        if not self.flight or self.queue:
            raise OrderError("tell: ask for the planned generation first")
        expected, got = {candidate.number for candidate in self.pending}, set(evaluations)
        if expected != got:
            raise OrderError(
                f"tell: expected evaluations of the {len(expected)} pending candidates; "
                f"missing {sorted(expected - got)[:5]}, not pending {sorted(got - expected)[:5]}"
            )

    def fitness_of(self, index: slice, individuals: FloatArray, aggregate: str = "best") -> FloatArray:
        """Return the fitness of each individual, from that of the archived or known solutions that contain it.

        Args:
            index: Columns of the individuals in a row.
            individuals: Shape ``(n, index.stop - index.start)``.
            aggregate: One of `AGGREGATES`.

        Returns:
            Shape ``(n,)``; infinite for an individual without an evaluated solution.
        """
        by_individual: dict[bytes, list[float]] = {key: [] for key in row_keys(individuals)}
        evidence = self.evidence
        for key, fitness in zip(row_keys(evidence.vectors[:, index]), evidence.fitness.tolist(), strict=True):
            if key in by_individual:
                by_individual[key].append(fitness)
        combined = AGGREGATES[aggregate]
        values = {key: combined(one) if one else np.inf for key, one in by_individual.items()}
        return np.array([values[key] for key in row_keys(individuals)])

    def dump(self, kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> Document:
        """Return the ledger, without its archive, together with the rest of an algorithm's state.

        Args:
            kind: Id of the algorithm.
            version: Version of its layout.
            header: Further entries of the header.
            arrays: Further arrays.
        """
        generations = [*self.flight, self.queue]
        candidates = [candidate for generation in generations for candidate in generation]
        seeds = [candidate.seed_number for candidate in candidates]
        return Document(
            kind=kind,
            version=version,
            header={
                "seed": self.seed,
                "budget": self.budget,
                "generation": self.generation,
                "flight": [len(generation) for generation in self.flight],
                "archived": len(self.archive),
                "question": (candidates[0].question if candidates else Question.EPISODE).value,
                "seed_numbers": seeds if any(seed is not None for seed in seeds) else None,
                **header,
            },
            arrays={
                "failed": self.failed,
                "measured": self.measured,
                "queue": candidate_rows(candidates, self.space.dimension),
                **_known_arrays(self.known),
                **arrays,
            },
        )

    @classmethod
    def load(cls, space: SearchSpace, config: object, document: Document, archive: Archive) -> Self:
        """Return the ledger that `dump` stored.

        Args:
            space: The search space.
            config: Settings; the archive takes those of its neighbourhood, if there are any.
            document: The document that `dump` returned.
            archive: The archive of the ledger at that time.

        Raises:
            DocumentError: The document is corrupt, or does not match the space, settings or archive.
        """
        header = document.header
        rows = stored_rows(document, "queue", space.dimension)
        flight = _checked_flight(header, len(rows))
        if len(archive) != header["archived"]:
            raise DocumentError(f"expected the archive of {header['archived']} solutions, got {len(archive)}")
        if archive.neighbourhood != Neighbourhood.of(config):
            raise DocumentError(
                f"expected an archive of {Neighbourhood.of(config)}, got {archive.neighbourhood}"
            )
        measured = (
            stored_rows(document, "measured", space.dimension)
            if "measured" in document.arrays
            else frozen_array(np.empty((0, space.dimension)))  # written before data-set evaluations existed
        )
        ledger = cls(
            space=space,
            seed=header["seed"],
            budget=header["budget"],
            generation=header["generation"],
            archive=archive,
            known=_stored_known(document, space.dimension),
            failed=stored_rows(document, "failed", space.dimension),
            measured=measured,
            flight=(),
            queue=(),
        )
        question = Question(header.get("question", Question.EPISODE.value))
        seeds = header.get("seed_numbers") or [None] * len(rows)
        for size in flight:
            ledger = ledger.plan(rows[:size], question, seeds[:size]).ask()
            rows, seeds = rows[size:], seeds[size:]
        return ledger.plan(rows, question, seeds)


def _known_arrays(known: Known) -> dict[str, Any]:
    """Return the arrays that store prior knowledge; none without any, as in documents of older versions."""
    arrays: dict[str, Any] = {}
    if len(known):
        arrays |= {
            "known": known.rows,
            "known_results": np.stack([known.unsafe.astype(np.float64), known.robustness], axis=1),
        }
    return arrays | ({"points": known.points} if len(known.points) else {})


def _stored_known(document: Document, dimension: int) -> Known:
    """Return what `_known_arrays` stored.

    Raises:
        DocumentError: The arrays are corrupt.
    """
    nothing = Known.nothing(dimension)
    rows, results, points = nothing.rows, np.empty((0, 2)), nothing.points
    if "known" in document.arrays:
        rows, results = stored_rows(document, "known", dimension), stored_rows(document, "known_results", 2)
    if "points" in document.arrays:
        points = stored_rows(document, "points", dimension)
    if len(rows) != len(results):
        raise DocumentError(f"known_results: expected one for each of {len(rows)} rows, got {len(results)}")
    return Known(rows=rows, unsafe=results[:, 0] != 0, robustness=results[:, 1], points=points)


def _checked_flight(header: Mapping[str, Any], rows: int) -> list[int]:
    """Check the header of a ledger with `rows` candidates; return the sizes of the generations in flight.

    Raises:
        DocumentError: The header is corrupt.
    """
    for name in ("seed", "budget", "generation", "archived"):
        if not isinstance(header.get(name), int):
            raise DocumentError(f"{name}: expected a whole number, got {header.get(name)!r}")
    flight = header.get("flight", [])  # missing if written when there was one generation in flight at most
    if not (isinstance(flight, list) and all(isinstance(size, int) and size > 0 for size in flight)):
        raise DocumentError(f"flight: expected the sizes of the generations in flight, got {flight!r}")
    if sum(flight) > rows:
        raise DocumentError(f"flight: expected at most {rows} candidates, got {sum(flight)}")
    seeds = header.get("seed_numbers")
    if seeds is not None and not (
        isinstance(seeds, list) and len(seeds) == rows and all(s is None or isinstance(s, int) for s in seeds)
    ):
        raise DocumentError(f"seed_numbers: expected one for each candidate, got {seeds!r}")
    question = header.get("question", Question.EPISODE.value)
    if question not in set(Question):
        raise DocumentError(f"question: expected one of {', '.join(Question)}, got {question!r}")
    return flight


def stored_rows(document: Document, name: str, width: int) -> FloatArray:
    """Return an array of a document, shape ``(n, width)``, read-only.

    Args:
        document: The document.
        name: Name of the array.
        width: Expected number of columns.

    Raises:
        DocumentError: The array is missing or has another shape or type.
    """
    rows = document.arrays.get(name)
    if rows is None or rows.ndim != 2 or rows.shape[1] != width or rows.dtype != np.float64:
        got = "nothing" if rows is None else f"{rows.dtype} of shape {rows.shape}"
        raise DocumentError(f"{name}: expected float64 rows of {width} numbers, got {got}")
    return frozen_array(rows)


def check_given_rows(space: SearchSpace, name: str, rows: Sequence[Sequence[float]]) -> None:
    """Check that the rows of a setting are complete solutions.

    Raises:
        ConfigError: With the number of the first row that is not.
    """
    for place, row in enumerate(rows):
        try:
            space.check(space.split(np.asarray(row, np.float64)))
        except SpaceError as error:
            raise ConfigError(name, f"row {place}: {error}") from None


def check_seed_numbers(numbers: Sequence[int], count: int, what: str) -> None:
    """Check the setting ``seed_numbers``: one number for each of `count` given solutions or pairs, or none.

    Raises:
        ConfigError: There are too few or too many, or one is negative.
    """
    if len(numbers) not in (0, count) or min(numbers, default=0) < 0:
        raise ConfigError(
            "seed_numbers", f"expected a number >= 0 for each of {count} {what}, or none, got {list(numbers)}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LedgerState:
    """Base class of the states of all built-in algorithms.

    Attributes:
        ledger: All candidates.
    """

    ledger: Ledger

    @property
    def generation(self) -> int:
        """Number of generations told so far."""
        return self.ledger.generation

    @property
    def archive(self) -> Archive:
        """All complete solutions with a verdict."""
        return self.ledger.archive

    @property
    def fitness(self) -> FloatArray:
        """Values that the search currently minimises, shape ``(n,)``; none by default."""
        return np.empty(0)

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """The oldest generation that was asked for but not yet told, ascending by number."""
        return self.ledger.pending


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoundaryState(LedgerState):
    """Base class of the states of algorithms that are guided by boundary fitness, or serve as their baselines."""

    @property
    def fitness(self) -> FloatArray:
        """Boundary fitness of all archived solutions, known results counted as neighbours, shape ``(n,)``."""
        return self.ledger.evidence.fitness[: len(self.archive)]


C = TypeVar("C")
S = TypeVar("S", bound=LedgerState)


class LedgerAlgorithm(Generic[C, S]):
    """Base class of all built-in algorithms; a subclass implements `tell` and the four hooks.

    Attributes:
        id: Versioned plug-in id.
        summary: One line for catalogues.
        config_type: Type of the settings.
        finds: Kinds of findings, the main one first.
        minimises: What the state's `fitness` is called; empty for nothing.
        suggested: Place among the algorithms that a new campaign may begin with, the lowest first; None for no place.
        former: For settings that were added later, what their value was before, by name.
        is_baseline: Whether it draws solutions at random, without a search.
        honours_distribution: Whether it draws by the operational distribution.
        internal: Whether only Brink itself starts campaigns with it.
        layout: Version of stored states: of their layout, and of how the search continues from them.
    """

    id: str
    summary: str
    config_type: type[C]
    finds: tuple[str, ...] = UNDECLARED
    minimises: str = "fitness"
    suggested: int | None = None
    former: Mapping[str, Any] = MappingProxyType({})
    is_baseline: bool = False
    honours_distribution: bool = False
    internal: bool = False
    layout: int = 1

    def _min_budget(self, space: SearchSpace, config: C) -> int:
        """Check space and settings, and return the smallest sufficient budget."""
        raise NotImplementedError

    def _first_state(self, ledger: Ledger, config: C) -> S:
        """Return the initial state, with its first generation planned in an empty ledger."""
        raise NotImplementedError

    def _refilled(self, state: S) -> S:
        """Return a state that has just asked for its queue, with one more generation planned if that may overlap."""
        return state

    def _content(self, state: S) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the header entries and arrays that store a state, without its ledger."""
        return {}, {}

    def _restored(self, ledger: Ledger, config: C, document: Document) -> S:
        """Return the state restored from its ledger and from the document that holds its `_content`."""
        raise NotImplementedError

    def check(self, space: SearchSpace, config: C, *, budget: int) -> None:
        """Check that the algorithm can run with these arguments.

        Args:
            space: The search space.
            config: Settings.
            budget: Number of simulations.

        Raises:
            UnsupportedSpace: The algorithm does not support the space.
            ConfigError: A setting does not fit the space, the other settings or the budget.
        """
        least = self._min_budget(space, config)
        if budget < least:
            raise ConfigError(
                "budget", f"expected at least the {least} simulations of one generation, got {budget}"
            )

    def flight(self, config: C) -> tuple[int, int]:
        """Return the most candidates of one generation, and the most generations in flight at a time."""
        size: int = getattr(config, "generation_size", getattr(config, "population_size", 1))
        generations: int = getattr(config, "in_flight", 1)
        return size, generations

    def start(self, space: SearchSpace, config: C, *, seed: int, budget: int) -> S:
        """Return the initial state, with nothing asked for yet.

        Args:
            space: The search space.
            config: Settings.
            seed: The campaign's seed.
            budget: Number of simulations.

        Raises:
            UnsupportedSpace: The algorithm does not support the space.
            ConfigError: A setting does not fit the space, the other settings or the budget.
        """
        self.check(space, config, budget=budget)
        return self._first_state(Ledger.start(space, config, seed=seed, budget=budget), config)

    def ask(self, state: S) -> tuple[S, tuple[Candidate, ...]]:
        """Return the state with one more generation in flight, and that generation.

        Raises:
            OrderError: No further generation may be in flight, or none is left to ask for.
        """
        ledger = state.ledger.ask()
        return self._refilled(replace(state, ledger=ledger)), ledger.flight[-1]

    def can_ask(self, state: S) -> bool:
        """Return whether a further generation is to be asked for before the pending one is told."""
        return bool(state.ledger.queue)

    def finished(self, state: S) -> bool:
        """Return whether nothing is in flight and nothing is planned."""
        return not state.ledger.flight and not state.ledger.queue

    def dump(self, state: S) -> Document:
        """Return the state, without its archive, as a versioned document."""
        header, arrays = self._content(state)
        return state.ledger.dump(self.id, self.layout, header, arrays)

    def load(self, space: SearchSpace, config: C, document: Document, archive: Archive) -> S:
        """Return the state that `dump` stored.

        Args:
            space: The search space.
            config: Settings.
            document: The document that `dump` returned.
            archive: The archive of the state at that time.

        Raises:
            DocumentError: The document is corrupt, or of another algorithm.
            OtherVersion: Another version of the algorithm stored it.
        """
        ledger = Ledger.load(space, config, document.expect(self.id, self.layout), archive)
        return self._restored(ledger, config, document)


class WarmLedgerAlgorithm(LedgerAlgorithm[C, S]):
    """Base class of the algorithms whose `_first_state` uses the ledger's prior knowledge."""

    def start_with(self, space: SearchSpace, config: C, *, seed: int, budget: int, known: Known) -> S:
        """Return the initial state of a search with prior knowledge; see `WarmStarts`.

        Args:
            space: The search space.
            config: Settings.
            seed: The campaign's seed.
            budget: Number of simulations; at least one for each point.
            known: Known results and points, all of them valid solutions.

        Raises:
            UnsupportedSpace: The algorithm does not support the space.
            ConfigError: A setting does not fit the space, the other settings or the budget.
        """
        self.check(space, config, budget=budget)
        if len(known.points) > budget:
            raise ConfigError(
                "budget",
                f"expected at least the {len(known.points)} simulations of the known points, got {budget}",
            )
        return self._first_state(Ledger.start(space, config, seed=seed, budget=budget, known=known), config)


def leading_rows(ledger: Ledger, most: int) -> list[FloatArray]:
    """Return the solutions that a population starts with: all known points, then the results nearest to the boundary.

    Args:
        ledger: An empty ledger.
        most: Number of solutions, unless there are more points.
    """
    known = ledger.known
    rows = {row.tobytes(): row for row in known.points}
    for place in known.nearest().tolist():
        if len(rows) >= most:
            break
        rows.setdefault(known.rows[place].tobytes(), known.rows[place])
    return list(rows.values())

"""Common base of the built-in algorithms: the ledger of all candidates, shared settings, and most of the contract.

The ledger records every solution ever asked for: the archive, failed and measured solutions, and the queue. The
queue is the next or the pending generation. Numbers count from 0 in the order of asking and are not stored: every
archived, failed or queued solution has used up one. The next generation is planned as soon as the last one is told;
an empty queue means that the search is over.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Generic, Self, TypeVar

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Failed, Measured, Question, Scored
from brink.search.archive import Archive, Neighbourhood
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, OrderError
from brink.search.settings import check_settings, setting
from brink.search.space import FloatArray, SearchSpace, frozen_array

MAX_BREEDINGS: Final = 10
"""Number of populations bred without a new solution before a search restarts from a random one."""

MAX_RESTARTS: Final = 90
"""Number of random populations without a new solution before a finite space counts as exhausted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundaryConfig:
    """Settings of every algorithm that searches for the boundary of the p_th-unsafe region."""

    radius: float = setting(0.3, help="Maximum distance of a neighbour (delta).", gt=0, le=1)
    p_th: float = setting(0.1, help="Unsafe probability that defines the boundary.", gt=0, lt=1)
    z: float = setting(1.96, help="Quantile of the standard normal for the Wilson interval.", gt=0, le=10)

    def __post_init__(self) -> None:
        check_settings(self)


def row_keys(rows: FloatArray) -> list[bytes]:
    """Return the bytes of each row, shape ``(n, d)``; two keys are equal if and only if the rows are."""
    blob = np.ascontiguousarray(rows).tobytes()
    width = rows.shape[1] * rows.itemsize
    return [blob[start : start + width] for start in range(0, len(blob), width)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ledger:
    """All candidates of a search.

    Attributes:
        space: The search space.
        seed: The campaign's seed.
        budget: Number of evaluations after which no generation is planned.
        generation: Number of generations told so far.
        archive: Evaluated solutions.
        failed: Solutions without a verdict, as rows, shape ``(f, d)``.
        measured: Solutions measured on a data set, as rows, shape ``(m, d)``; they may still be simulated.
        queue: The planned generation, ascending by number; empty when the search is over.
        asked: Whether the queue was asked but not told yet.
    """

    space: SearchSpace
    seed: int
    budget: int
    generation: int
    archive: Archive
    failed: FloatArray
    measured: FloatArray
    queue: tuple[Candidate, ...]
    asked: bool

    @classmethod
    def start(cls, space: SearchSpace, config: BoundaryConfig, *, seed: int, budget: int) -> Self:
        """Return an empty ledger.

        Args:
            space: The search space.
            config: Settings of the neighbourhood.
            seed: The campaign's seed.
            budget: Number of evaluations.
        """
        return cls(
            space=space,
            seed=seed,
            budget=budget,
            generation=0,
            archive=Archive.empty(space, Neighbourhood.of(config)),
            failed=frozen_array(np.empty((0, space.dimension))),
            measured=frozen_array(np.empty((0, space.dimension))),
            queue=(),
            asked=False,
        )

    @property
    def spent(self) -> int:
        """Number of evaluations told so far, including failed ones."""
        return len(self.archive) + len(self.failed) + len(self.measured)

    @property
    def left(self) -> float:
        """Number of further solutions that budget and space allow; zero or less when the search is over."""
        return min(self.budget, self.space.size) - self.spent

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """Candidates asked for but not yet told."""
        return self.queue if self.asked else ()

    def unseen(self, rows: Iterable[FloatArray]) -> tuple[FloatArray, ...]:
        """Return the rows that were never asked for, without duplicates, in their order."""
        seen = {*row_keys(self.archive.vectors), *row_keys(self.failed)}
        fresh = []
        for row in rows:
            key = row.tobytes()
            if key not in seen:
                seen.add(key)
                fresh.append(row)
        return tuple(fresh)

    def plan(
        self,
        rows: Iterable[FloatArray],
        question: Question = Question.EPISODE,
        seed_numbers: Sequence[int] | None = None,
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
            for number, (row, seed) in enumerate(zip(rows, seeds, strict=True), start=self.spent)
        )
        return replace(self, queue=queue)

    def ask(self) -> Self:
        """Return the ledger with its queue pending.

        Raises:
            OrderError: The queue is already pending, or empty.
        """
        if self.asked:
            raise OrderError(f"ask: tell the {len(self.queue)} pending evaluations first")
        if not self.queue:
            raise OrderError("ask: the search is finished; check `finished` before asking")
        return replace(self, asked=True)

    def tell(self, evaluations: Mapping[int, Evaluation]) -> Self:
        """Return the ledger with the pending generation evaluated and an empty queue.

        Raises:
            OrderError: Nothing is pending, or the numbers are not those of the pending candidates.
        """
        self._check_pending(evaluations)
        scored: list[tuple[Candidate, Scored]] = []
        failed, measured = [self.failed], [self.measured]
        for candidate in self.queue:
            match evaluations[candidate.number]:
                case Scored() as evaluation:
                    scored.append((candidate, evaluation))
                case Measured():
                    measured.append(self.space.join(candidate.vectors)[None])
                case Failed():
                    failed.append(self.space.join(candidate.vectors)[None])
        rows = [self.space.join(candidate.vectors) for candidate, _ in scored]
        archive = self.archive.grown(
            np.array([candidate.number for candidate, _ in scored], np.int64),
            np.reshape(rows, (len(rows), self.space.dimension)),
            np.array([evaluation.unsafe for _, evaluation in scored], np.bool_),
            np.array([evaluation.robustness for _, evaluation in scored], np.float64),
        )
        return replace(
            self,
            generation=self.generation + 1,
            archive=archive,
            failed=frozen_array(np.concatenate(failed)),
            measured=frozen_array(np.concatenate(measured)),
            queue=(),
            asked=False,
        )

    def _check_pending(self, evaluations: Mapping[int, Evaluation]) -> None:
        if not self.asked:
            raise OrderError("tell: nothing is pending; ask first")
        expected, got = {candidate.number for candidate in self.queue}, set(evaluations)
        if expected != got:
            raise OrderError(
                f"tell: expected evaluations of the {len(expected)} pending candidates; "
                f"missing {sorted(expected - got)[:5]}, not pending {sorted(got - expected)[:5]}"
            )

    def fitness_of(self, index: slice, individuals: FloatArray) -> FloatArray:
        """Return, for each individual, the smallest fitness of the archived solutions that contain it.

        Args:
            index: Columns of the individuals in a row.
            individuals: Shape ``(n, index.stop - index.start)``.

        Returns:
            Shape ``(n,)``; infinite for an individual without an evaluated solution.
        """
        best = dict.fromkeys(row_keys(individuals), np.inf)
        for key, fitness in zip(
            row_keys(self.archive.vectors[:, index]), self.archive.fitness.tolist(), strict=True
        ):
            if fitness < best.get(key, -np.inf):
                best[key] = fitness
        return np.array([best[key] for key in row_keys(individuals)])

    def dump(self, kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> Document:
        """Return the ledger, without its archive, together with the rest of an algorithm's state.

        Args:
            kind: Id of the algorithm.
            version: Version of its layout.
            header: Further entries of the header.
            arrays: Further arrays.
        """
        rows = [self.space.join(candidate.vectors) for candidate in self.queue]
        seeds = [candidate.seed_number for candidate in self.queue]
        return Document(
            kind=kind,
            version=version,
            header={
                "seed": self.seed,
                "budget": self.budget,
                "generation": self.generation,
                "asked": self.asked,
                "archived": len(self.archive),
                "question": self.queue[0].question.value if self.queue else Question.EPISODE.value,
                "seed_numbers": None if None in seeds else seeds,
                **header,
            },
            arrays={
                "failed": self.failed,
                "measured": self.measured,
                "queue": np.reshape(rows, (len(rows), self.space.dimension)).astype(np.float64),
                **arrays,
            },
        )

    @classmethod
    def load(cls, space: SearchSpace, config: BoundaryConfig, document: Document, archive: Archive) -> Self:
        """Return the ledger that `dump` stored.

        Args:
            space: The search space.
            config: Settings of the neighbourhood.
            document: The document that `dump` returned.
            archive: The archive of the ledger at that time.

        Raises:
            DocumentError: The document is corrupt, or does not match the space, settings or archive.
        """
        header = document.header
        queue = stored_rows(document, "queue", space.dimension)
        _check_header(header, len(queue))
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
            failed=stored_rows(document, "failed", space.dimension),
            measured=measured,
            queue=(),
            asked=header["asked"],
        )
        question = Question(header.get("question", Question.EPISODE.value))
        return ledger.plan(queue, question, header.get("seed_numbers"))


def _check_header(header: Mapping[str, Any], queued: int) -> None:
    for name in ("seed", "budget", "generation", "archived"):
        if not isinstance(header.get(name), int):
            raise DocumentError(f"{name}: expected a whole number, got {header.get(name)!r}")
    if not isinstance(header.get("asked"), bool):
        raise DocumentError(f"asked: expected true or false, got {header.get('asked')!r}")
    seeds = header.get("seed_numbers")
    if seeds is not None and not (
        isinstance(seeds, list) and len(seeds) == queued and all(isinstance(s, int) for s in seeds)
    ):
        raise DocumentError(f"seed_numbers: expected one for each candidate, got {seeds!r}")
    question = header.get("question", Question.EPISODE.value)
    if question not in set(Question):
        raise DocumentError(f"question: expected one of {', '.join(Question)}, got {question!r}")


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
        """Boundary fitness of all archived solutions, shape ``(n,)``."""
        return self.archive.fitness

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """Candidates asked for but not yet told, ascending by number."""
        return self.ledger.pending


C = TypeVar("C", bound=BoundaryConfig)
S = TypeVar("S", bound=LedgerState)


class LedgerAlgorithm(Generic[C, S]):
    """Base class of all built-in algorithms; a subclass implements `tell` and the four hooks.

    Attributes:
        id: Versioned plug-in id.
        summary: One line for catalogues.
        config_type: Type of the settings.
        layout: Version of the layout of stored states.
    """

    id: str
    summary: str
    config_type: type[Any]
    layout: int = 1

    def _min_budget(self, space: SearchSpace, config: C) -> int:
        """Check space and settings, and return the smallest sufficient budget."""
        raise NotImplementedError

    def _first_state(self, ledger: Ledger, config: C) -> S:
        """Return the initial state, with its first generation planned in an empty ledger."""
        raise NotImplementedError

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
        """Return the state with a pending generation, and that generation.

        Raises:
            OrderError: The last generation has not been told yet, or the search is finished.
        """
        ledger = state.ledger.ask()
        return replace(state, ledger=ledger), ledger.pending

    def finished(self, state: S) -> bool:
        """Return whether no further generation is planned."""
        return not state.ledger.queue

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
            DocumentError: The document is corrupt, of another algorithm, or of an unknown version.
        """
        ledger = Ledger.load(space, config, document.expect(self.id, self.layout), archive)
        return self._restored(ledger, config, document)

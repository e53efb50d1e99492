"""What the algorithms that seek the hazard boundary share: their common settings, and the ledger of candidates.

The ledger knows every solution that was ever asked: the archive, those that failed, and the queue of the next or
pending generation. Numbers count from 0 in the order of asking, so none is stored twice: whatever is in the
archive, failed or queued has used up one number. A generation is planned as soon as the last one is told; when
there is none, the search is over.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Failed, Measured, Question, Scored
from brink.search.archive import Archive, Neighbourhood
from brink.search.component import FloatArray, frozen_array
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, OrderError
from brink.search.settings import check_settings, setting
from brink.search.space import SearchSpace


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundaryConfig:
    """Settings of every algorithm that seeks the boundary of the p_th-unsafe region."""

    radius: float = setting(0.3, help="Largest distance of a neighbour (delta).", gt=0, le=1)
    p_th: float = setting(0.1, help="Probability of unsafe on the boundary that is sought.", gt=0, lt=1)
    z: float = setting(1.96, help="Quantile of the standard normal for the Wilson interval.", gt=0, le=10)

    def __post_init__(self) -> None:
        check_settings(self)


def check_budget(budget: int, first_generation: int) -> None:
    """Raise ConfigError if the budget does not cover the first generation."""
    if budget < first_generation:
        raise ConfigError(
            "budget", f"expected at least the {first_generation} simulations of one generation, got {budget}"
        )


def row_keys(rows: FloatArray) -> list[bytes]:
    """Return the bytes of each row: equal solutions, and only those, have equal keys."""
    blob = np.ascontiguousarray(rows).tobytes()
    width = rows.shape[1] * rows.itemsize
    return [blob[start : start + width] for start in range(0, len(blob), width)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ledger:
    """Every candidate of a search.

    Attributes:
        space: What is searched.
        seed: The campaign's seed.
        budget: Simulations after which nothing more is planned.
        generation: Generations told so far.
        archive: Evaluated solutions.
        failed: Solutions of which no verdict could be had, as rows, shape ``(f, d)``.
        measured: Solutions that were measured on a data set, as rows, shape ``(m, d)``; they may be simulated yet.
        queue: The planned generation, ascending by number; empty when the search is over.
        asked: Whether the queue has been asked and not been told.
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
    def opened(cls, space: SearchSpace, config: BoundaryConfig, *, seed: int, budget: int) -> Self:
        """Return the ledger of a search that has not begun."""
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
        """Evaluations that were told, failed ones included."""
        return len(self.archive) + len(self.failed) + len(self.measured)

    @property
    def left(self) -> float:
        """New solutions that budget and space leave room for; not positive when the search is over."""
        return min(self.budget, self.space.size) - self.spent

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """Candidates asked and not yet told."""
        return self.queue if self.asked else ()

    def unseen(self, rows: Iterable[FloatArray]) -> tuple[FloatArray, ...]:
        """Return those rows that were never asked, each once, in their order."""
        seen = {*row_keys(self.archive.vectors), *row_keys(self.failed)}
        fresh = []
        for row in rows:
            key = row.tobytes()
            if key not in seen:
                seen.add(key)
                fresh.append(row)
        return tuple(fresh)

    def planned(
        self,
        rows: Iterable[FloatArray],
        question: Question = Question.EPISODE,
        seed_numbers: Sequence[int] | None = None,
    ) -> Self:
        """Return the ledger with the next generation queued.

        Args:
            rows: Unseen solutions.
            question: What is asked about them.
            seed_numbers: Numbers whose episode seeds they have; their own if None.
        """
        rows = list(rows)
        seeds: Sequence[int | None] = [None] * len(rows) if seed_numbers is None else seed_numbers
        queue = tuple(
            Candidate(number=number, vectors=self.space.split(row), question=question, seed_number=seed)
            for number, (row, seed) in enumerate(zip(rows, seeds, strict=True), start=self.spent)
        )
        return replace(self, queue=queue)

    def handed_out(self) -> Self:
        """Return the ledger with its queue pending.

        Raises:
            OrderError: It is pending already, or there is none.
        """
        if self.asked:
            raise OrderError(f"ask: tell the {len(self.queue)} pending evaluations first")
        if not self.queue:
            raise OrderError("ask: the search is finished; check `finished` before asking")
        return replace(self, asked=True)

    def told(self, evaluations: Mapping[int, Evaluation]) -> Self:
        """Return the ledger with the pending generation evaluated and nothing queued.

        Raises:
            OrderError: Nothing is pending, or the numbers are not the pending ones.
        """
        if not self.asked:
            raise OrderError("tell: nothing is pending; ask first")
        expected, got = {candidate.number for candidate in self.queue}, set(evaluations)
        if expected != got:
            raise OrderError(
                f"tell: expected evaluations of the {len(expected)} pending candidates; "
                f"missing {sorted(expected - got)[:5]}, not pending {sorted(got - expected)[:5]}"
            )
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

    def fitness_of(self, index: slice, individuals: FloatArray) -> FloatArray:
        """Return the smallest fitness of all archived solutions that contain each individual.

        Args:
            index: Where the individuals lie in a row.
            individuals: Shape ``(n, index.stop - index.start)``.

        Returns:
            Shape ``(n,)``; infinite for an individual that no evaluated solution contains.
        """
        best = dict.fromkeys(row_keys(individuals), np.inf)
        for key, fitness in zip(
            row_keys(self.archive.vectors[:, index]), self.archive.fitness.tolist(), strict=True
        ):
            if fitness < best.get(key, -np.inf):
                best[key] = fitness
        return np.array([best[key] for key in row_keys(individuals)])

    def dump(self, kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> Document:
        """Return the ledger without its archive, with what else the algorithm's state holds."""
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
        """Return the ledger that `dump` wrote.

        Raises:
            DocumentError: The document is broken, or does not belong to the space, settings or archive.
        """
        header = document.header
        failed = stored_rows(document, "failed", space.dimension)
        measured = (
            stored_rows(document, "measured", space.dimension)
            if "measured" in document.arrays
            else np.empty((0, space.dimension))  # written before there were data sets
        )
        question = header.get("question", Question.EPISODE.value)
        queue = stored_rows(document, "queue", space.dimension)
        for name in ("seed", "budget", "generation", "archived"):
            if not isinstance(header.get(name), int):
                raise DocumentError(f"{name}: expected a whole number, got {header.get(name)!r}")
        if not isinstance(header.get("asked"), bool):
            raise DocumentError(f"asked: expected true or false, got {header.get('asked')!r}")
        seeds = header.get("seed_numbers")
        if seeds is not None and not (
            isinstance(seeds, list) and len(seeds) == len(queue) and all(isinstance(s, int) for s in seeds)
        ):
            raise DocumentError(f"seed_numbers: expected one a candidate, got {seeds!r}")
        if question not in set(Question):
            raise DocumentError(f"question: expected a known one, got {question!r}")
        if len(archive) != header["archived"]:
            raise DocumentError(f"expected the archive of {header['archived']} solutions, got {len(archive)}")
        if archive.neighbourhood != Neighbourhood.of(config):
            raise DocumentError(
                f"expected an archive of {Neighbourhood.of(config)}, got {archive.neighbourhood}"
            )
        ledger = cls(
            space=space,
            seed=header["seed"],
            budget=header["budget"],
            generation=header["generation"],
            archive=archive,
            failed=frozen_array(failed),
            measured=frozen_array(measured),
            queue=(),
            asked=header["asked"],
        )
        return ledger.planned(queue, Question(question), seeds)


def stored_rows(document: Document, name: str, width: int) -> FloatArray:
    """Return one matrix of a document, read-only.

    Raises:
        DocumentError: It is missing or has another shape.
    """
    rows = document.arrays.get(name)
    if rows is None or rows.ndim != 2 or rows.shape[1] != width or rows.dtype != np.float64:
        got = "nothing" if rows is None else f"{rows.dtype} of shape {rows.shape}"
        raise DocumentError(f"{name}: expected float64 rows of {width} numbers, got {got}")
    return frozen_array(rows)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LedgerState:
    """What the states of all these algorithms have in common.

    Attributes:
        ledger: All candidates.
    """

    ledger: Ledger

    @property
    def generation(self) -> int:
        """Generations told so far."""
        return self.ledger.generation

    @property
    def archive(self) -> Archive:
        """All complete solutions that were evaluated and did not fail."""
        return self.ledger.archive

    @property
    def fitness(self) -> FloatArray:
        """Boundary fitness of all archived solutions."""
        return self.archive.fitness

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """Candidates asked and not yet told, ascending by number."""
        return self.ledger.pending

"""The SQL of the generation step: the solutions asked for, their verdicts, checkpoints and distances."""

import hashlib
import itertools
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, bindparam, delete, func, insert, select, update

from brink.search.metric import METRIC_VERSION
from brink.search.space import FloatArray
from brink.server.campaigns.store import CAMPAIGNS, Campaign, set_status
from brink.server.db.models import (
    NEXT_SEQUENCE,
    CampaignRow,
    CheckpointRow,
    DistanceBlockRow,
    GenerationRow,
    SolutionRow,
)
from brink.server.db.sql import LAST_TURN, database_now, note_change
from brink.server.errors import Damaged
from brink.server.queue import job_store
from brink.server.queue.job_store import NewJob
from brink.server.states import CampaignStatus, JobKind, SolutionVerdict

PIECE: Final = 500
"""Maximum number of solutions that one transaction stores, or of results: some tens of milliseconds, in which nobody
else can write."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class NewSolution:
    """A solution that the algorithm asked for.

    Attributes:
        vector: The complete solution as little-endian float64 values.
        job: The simulation that evaluates it; None if the problem is computed in process.
        origin: Where the solution comes from, if the algorithm says.
    """

    number: int
    vector: bytes
    seed: int
    job: NewJob | None
    kind: JobKind = JobKind.EPISODE
    origin: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """A piece of what an algorithm has asked for: solutions with successive numbers.

    Attributes:
        first: Number of the first generation of which it has solutions.
        generations: The solutions of each, of the first and the last one possibly only some; empty if there is
            nothing to ask for now.
        end: First number that does not belong to the oldest generation in flight; None if nothing is in flight.
    """

    first: int
    generations: Sequence[Sequence[NewSolution]]
    end: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SolutionResult:
    """The verdict on a solution, with its measures or the reason for its failure."""

    number: int
    verdict: SolutionVerdict
    robustness: float | None = None
    objectives: Mapping[str, float] | None = None
    failure: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceBlock:
    """A generation's rows of the distance matrix: float32, row-major, of shape ``(rows, columns)``.

    Attributes:
        sha256: The checksum of the data, as hexadecimal digits.
    """

    first_row: int
    rows: int
    columns: int
    metric_version: int
    data: bytes
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """The algorithm's state after a `tell`, and the neighbour counts of its archive as little-endian int64.

    The counts are empty if the search does not use them: they are then counted when they are asked for.
    """

    generation: int
    document: bytes
    neighbours: bytes
    unsafe_neighbours: bytes

    def sha256(self) -> str:
        """Return the checksum that is stored with the checkpoint."""
        return hashlib.sha256(self.document + self.neighbours + self.unsafe_neighbours).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class GenerationSummary:
    """A completed generation: the campaign's counts and scores after it.

    Of a search that is not for the boundary, boundary solutions are counted after the last generation only.
    """

    number: int
    evaluated: int
    unsafe: int
    failed: int
    measured: int
    best_fitness: float | None
    median_fitness: float | None
    dbs: int | None
    strict_dbs: int | None
    step_s: float
    told_at: datetime | None = None

    @property
    def completed(self) -> int:
        """Candidates of completed generations: evaluated, measured on a data set, or failed."""
        return self.evaluated + self.measured + self.failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Everything that one generation step writes.

    Attributes:
        campaign: Id of the campaign.
        generation: The completed generation; the step is only written if the campaign is still in it.
        results: The results of its solutions.
        without_result: Those of them that count as failed because their jobs ended without a result.
        summary: The campaign's counts and scores after it.
        block: Its distances, or None if they are not stored.
        checkpoint: The state after it.
        asked: The generations that the algorithm then asked for.
        traces: Numbers of solutions whose traces are recorded as evidence, at the end of the search.
        status: The campaign's status after the step.
        reason: Why it has failed; empty otherwise.
    """

    campaign: str
    generation: int
    results: Sequence[SolutionResult]
    without_result: Sequence[int]
    summary: GenerationSummary
    block: DistanceBlock | None
    checkpoint: Checkpoint
    asked: Asked
    traces: Sequence[int]
    status: CampaignStatus
    reason: str

    def early_results(self, size: int) -> list[Sequence[SolutionResult]]:
        """Return the results to write before the step, in pieces of at most `size`; none of a small generation."""
        early = [result for result in self.results if result.verdict is not SolutionVerdict.FAILED]
        early = early[: max(0, len(self.results) - size)]
        return [early[start : start + size] for start in range(0, len(early), size)]

    def late_results(self, size: int) -> list[SolutionResult]:
        """Return the results to write with the step: those that are not among the early ones."""
        early = {result.number for piece in self.early_results(size) for result in piece}
        return [result for result in self.results if result.number not in early]


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredArchive:
    """The evaluated solutions as of the last checkpoint, ascending by number: arrays of n rows."""

    generation: int
    numbers: NDArray[np.int64]
    vectors: NDArray[np.float64]
    unsafe: NDArray[np.bool_]
    robustness: NDArray[np.float64]
    generations: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    unsafe_neighbours: NDArray[np.int64]


def insert_generations(connection: Connection, campaign: Campaign, asked: Asked) -> None:
    """Store new solutions and enqueue their jobs.

    Args:
        connection: In a write transaction.
        campaign: The campaign.
        asked: The solutions.
    """
    for generation, solutions in enumerate(asked.generations, asked.first):
        _insert_solutions(connection, campaign, generation, solutions)
    connection.execute(
        update(CampaignRow).where(CampaignRow.id == campaign.id).values(generation_end=asked.end)
    )


def _insert_solutions(
    connection: Connection, campaign: Campaign, generation: int, solutions: Sequence[NewSolution]
) -> None:
    connection.execute(
        insert(SolutionRow),
        [
            {
                "campaign_id": campaign.id,
                "number": solution.number,
                "generation": generation,
                "vector": solution.vector,
                "seed": solution.seed,
                "spec_hash": solution.job.spec_hash if solution.job else None,
                "verdict": SolutionVerdict.PENDING,
                "origin": solution.origin,
            }
            for solution in solutions
        ],
    )
    for kind in (JobKind.EPISODE, JobKind.DATASET):
        jobs = [
            (solution.number, solution.job)
            for solution in solutions
            if solution.job is not None and solution.kind is kind
        ]
        job_store.enqueue(connection, campaign.id, kind, jobs, campaign.job_settings)


def write_piece(connection: Connection, campaign: Campaign, asked: Asked) -> int | None:
    """Store the next piece of what a campaign's search has asked for.

    Args:
        connection: In a write transaction.
        campaign: The campaign.
        asked: The piece, which is not empty.

    Returns:
        The number of the next solution to store. If that is not the one after the piece, nothing was stored: another
        coordinator has stored this piece, or the one before is missing. None, with nothing stored, if the campaign
        has moved on, or was paused, cancelled or deleted.
    """
    if not _is_in(CAMPAIGNS.find(connection, campaign.id, lock=True), campaign.generation):
        return None
    table = SolutionRow.__table__.c
    stored = select(func.max(table.number)).where(table.campaign_id == campaign.id)
    last = connection.execute(stored).scalar_one()
    following = 0 if last is None else last + 1
    if following != asked.generations[0][0].number:
        return following
    insert_generations(connection, campaign, asked)
    note_change(connection, campaign.id)
    return asked.generations[-1][-1].number + 1


def _is_in(campaign: Campaign | None, generation: int) -> bool:
    """Return whether a campaign is running and in a generation."""
    return (
        campaign is not None
        and campaign.status is CampaignStatus.RUNNING
        and campaign.generation == generation
    )


def write_seeded(connection: Connection, campaign: Campaign, checkpoint: Checkpoint, asked: Asked) -> bool:
    """Store the state of a campaign that has received seeds, and the generation that it then asked for.

    Args:
        connection: In a write transaction.
        campaign: The campaign, which waits for seeds.
        checkpoint: The state with the seeds.
        asked: The generation; none if the campaign needs more seeds.

    Returns:
        False, with nothing stored, if the campaign has moved on, or was paused, cancelled or deleted.
    """
    if not _is_in(CAMPAIGNS.find(connection, campaign.id, lock=True), campaign.generation):
        return False
    if read_vectors(connection, campaign.id, campaign.generation):
        return False
    _save_checkpoint(connection, campaign.id, checkpoint)
    insert_generations(connection, campaign, asked)
    note_change(connection, campaign.id)
    return True


def write_step(connection: Connection, step: Step) -> bool:
    """Write a generation step, all or nothing, and only once.

    Returns:
        False, with nothing written, if the campaign has moved on, or was paused, cancelled or deleted, or if one of
        the generation's jobs has been returned to the queue, even if it has been completed since.
    """
    campaign = CAMPAIGNS.find(connection, step.campaign, lock=True)
    if (
        campaign is None
        or campaign.status is not CampaignStatus.RUNNING
        or campaign.generation != step.generation
        or job_store.has_open_jobs(connection, step.campaign, campaign.generation_end)
        or job_store.any_done(connection, step.campaign, step.without_result)
    ):
        return False
    _update_results(connection, step.campaign, step.late_results(PIECE))
    _write_archive(connection, step)
    insert_generations(connection, campaign, step.asked)
    job_store.enqueue_traces(connection, campaign.id, step.traces, campaign.job_settings)
    connection.execute(
        update(CampaignRow)
        .where(CampaignRow.id == campaign.id)
        .values(
            generation=step.generation + 1,
            evaluated=step.summary.evaluated,
            unsafe=step.summary.unsafe,
            failed=step.summary.failed,
            measured=step.summary.measured,
            turn=LAST_TURN,
            served=0,
            sequence=NEXT_SEQUENCE,
        )
    )
    if step.status is not CampaignStatus.RUNNING:
        set_status(connection, campaign.id, step.status, step.reason)
    return True


def write_results(
    connection: Connection, campaign_id: str, generation: int, results: Sequence[SolutionResult]
) -> bool:
    """Write some results of a generation before its step, so that the step is a short transaction.

    Nobody is told of them before the step: archives have only generations that were told. If the step is not written,
    the next one writes them again.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        generation: The generation.
        results: The results, none of them a failure: its job may still be retried.

    Returns:
        False, with nothing written, if the campaign has moved on, or was paused, cancelled or deleted.
    """
    if not _is_in(CAMPAIGNS.find(connection, campaign_id, lock=True), generation):
        return False
    _update_results(connection, campaign_id, results)
    return True


def _update_results(connection: Connection, campaign_id: str, results: Sequence[SolutionResult]) -> None:
    if not results:
        return
    connection.execute(
        update(SolutionRow)
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.number == bindparam("solution"))
        .values(
            verdict=bindparam("verdict_of"),
            robustness=bindparam("robustness_of"),
            objectives=bindparam("objectives_of"),
            failure=bindparam("failure_of"),
        ),
        [
            {
                "solution": result.number,
                "verdict_of": result.verdict,
                "robustness_of": result.robustness,
                "objectives_of": dict(result.objectives) if result.objectives is not None else None,
                "failure_of": result.failure,
            }
            for result in results
        ],
    )
    # A result that could not be evaluated must not be shared with other campaigns.
    failed = [result.number for result in results if result.verdict is SolutionVerdict.FAILED]
    job_store.withdraw_results(connection, campaign_id, failed)


def _write_archive(connection: Connection, step: Step) -> None:
    counts = {**asdict(step.summary), "told_at": database_now(connection)}
    connection.execute(insert(GenerationRow).values(campaign_id=step.campaign, **counts))
    if step.block is not None:
        block = step.block
        connection.execute(
            insert(DistanceBlockRow).values(
                campaign_id=step.campaign,
                generation=step.generation,
                first_row=block.first_row,
                rows=block.rows,
                columns=block.columns,
                metric_version=block.metric_version,
                sha256=block.sha256,
                data=block.data,
            )
        )
    _save_checkpoint(connection, step.campaign, step.checkpoint)


def _save_checkpoint(connection: Connection, campaign_id: str, saved: Checkpoint) -> None:
    connection.execute(delete(CheckpointRow).where(CheckpointRow.campaign_id == campaign_id))
    connection.execute(
        insert(CheckpointRow).values(
            campaign_id=campaign_id,
            generation=saved.generation,
            document=saved.document,
            neighbours=saved.neighbours,
            unsafe_neighbours=saved.unsafe_neighbours,
            sha256=saved.sha256(),
        )
    )


def find_checkpoint(connection: Connection, campaign_id: str) -> Checkpoint | None:
    """Return a campaign's checkpoint, or None before its first generation is completed or seeded.

    Raises:
        Damaged: The checkpoint does not match its checksum.
    """
    row = connection.execute(
        select(CheckpointRow.__table__).where(CheckpointRow.campaign_id == campaign_id)
    ).one_or_none()
    if row is None:
        return None
    checkpoint = Checkpoint(
        generation=row.generation,
        document=row.document,
        neighbours=row.neighbours,
        unsafe_neighbours=row.unsafe_neighbours,
    )
    if checkpoint.sha256() != row.sha256:
        raise Damaged(f"campaign {campaign_id}: the checkpoint of generation {row.generation} is damaged")
    return checkpoint


def read_distances(connection: Connection, campaign_id: str, rows: Sequence[int]) -> FloatArray | None:
    """Return the stored distances between some solutions of the archive.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        rows: Positions of n solutions in the archive.

    Returns:
        Distances of shape ``(n, n)``; None if not all are stored, or if they are damaged or belong to another metric
        version.
    """
    wanted = np.asarray(rows, dtype=np.int64)
    half = np.full((len(wanted), len(wanted)), np.nan, dtype=np.float32)
    query = select(DistanceBlockRow.__table__).where(
        DistanceBlockRow.campaign_id == campaign_id,
        DistanceBlockRow.first_row <= int(wanted.max()),
        DistanceBlockRow.first_row + DistanceBlockRow.rows > int(wanted.min()),
        DistanceBlockRow.metric_version == METRIC_VERSION,
    )
    # One block at a time: all of them may not fit into memory.
    with connection.execution_options(stream_results=True, yield_per=1).execute(query) as blocks:
        for block in blocks:
            inside = np.flatnonzero((wanted >= block.first_row) & (wanted < block.first_row + block.rows))
            known = np.flatnonzero(wanted < block.columns)
            if not inside.size:
                continue
            if hashlib.sha256(block.data).hexdigest() != block.sha256:
                about = {"campaign": campaign_id, "generation": block.generation}
                log.error("stored distances are damaged", extra=about)
                return None
            matrix = np.frombuffer(block.data, dtype="<f4").reshape(block.rows, block.columns)
            half[np.ix_(inside, known)] = matrix[np.ix_(wanted[inside] - block.first_row, wanted[known])]
    # A row holds the distances to its own and earlier generations; those to later ones are in the later rows.
    whole = np.where(np.isnan(half), half.T, half).astype(np.float64)
    return None if np.isnan(whole).any() else whole


def read_vectors(connection: Connection, campaign_id: str, generation: int) -> list[dict[int, bytes]]:
    """Return the vectors of the solutions in flight, by number, for each generation from `generation` on."""
    query = (
        select(SolutionRow.generation, SolutionRow.number, SolutionRow.vector)
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.generation >= generation)
        .order_by(SolutionRow.generation)
    )
    rows = connection.execute(query)
    return [
        {row.number: row.vector for row in group}
        for _, group in itertools.groupby(rows, key=lambda row: row.generation)
    ]


def read_archive(connection: Connection, campaign_id: str, dimension: int) -> StoredArchive:
    """Return the evaluated solutions as of the last checkpoint.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        dimension: Length of a solution's vector.

    Raises:
        Damaged: The checkpoint does not match its checksum.
    """
    checkpoint = find_checkpoint(connection, campaign_id)
    generation = checkpoint.generation if checkpoint else 0
    rows = connection.execute(
        select(
            SolutionRow.number,
            SolutionRow.vector,
            SolutionRow.verdict,
            SolutionRow.robustness,
            SolutionRow.generation,
        )
        .where(
            SolutionRow.campaign_id == campaign_id,
            SolutionRow.generation < generation,
            SolutionRow.verdict.in_([SolutionVerdict.SAFE, SolutionVerdict.UNSAFE]),
        )
        .order_by(SolutionRow.number)
    ).all()
    counts = (checkpoint.neighbours, checkpoint.unsafe_neighbours) if checkpoint else (b"", b"")
    return StoredArchive(
        generation=generation,
        numbers=np.array([row.number for row in rows], dtype=np.int64),
        vectors=np.frombuffer(b"".join(row.vector for row in rows), dtype="<f8").reshape(-1, dimension),
        unsafe=np.array([row.verdict == SolutionVerdict.UNSAFE for row in rows], dtype=np.bool_),
        robustness=np.array([row.robustness for row in rows], dtype=np.float64),
        generations=np.array([row.generation for row in rows], dtype=np.int64),
        neighbours=np.frombuffer(counts[0], dtype="<i8"),
        unsafe_neighbours=np.frombuffer(counts[1], dtype="<i8"),
    )

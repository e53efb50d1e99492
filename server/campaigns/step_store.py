"""The SQL of the generation step: solutions and jobs asked for, verdicts told, checkpoint and distances."""

import hashlib
import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, bindparam, delete, insert, select, update

from brink.search.metric import METRIC_VERSION
from brink.search.space import FloatArray
from brink.server.campaigns.store import find_campaign, set_status
from brink.server.campaigns.values import Campaign, Checkpoint, NewJob, NewSolution, Step, StoredArchive
from brink.server.db.clock import database_now
from brink.server.db.locking import note_change
from brink.server.db.models import (
    EVALUATES,
    LAST_TURN,
    NEXT_SEQUENCE,
    CampaignRow,
    CheckpointRow,
    DistanceBlockRow,
    GenerationRow,
    JobRow,
    SolutionRow,
    has_open_jobs,
)
from brink.server.db.news import announce
from brink.server.errors import Damaged
from brink.server.states import CampaignStatus, JobKind, JobStatus, SolutionVerdict

log = logging.getLogger(__name__)

MAX_NAMED = 10_000
"""Values that one statement may name: databases bound how many there can be."""


def insert_solutions(
    connection: Connection, campaign: Campaign, generation: int, solutions: Sequence[NewSolution]
) -> None:
    """Store a generation that was asked for, and enqueue its jobs; known simulations are done at once."""
    if not solutions:
        return
    connection.execute(
        insert(SolutionRow),
        [
            {
                "campaign_id": campaign.id, "number": s.number, "generation": generation, "vector": s.vector,
                "seed": s.seed, "spec_hash": s.job.spec_hash if s.job else None,
                "verdict": SolutionVerdict.PENDING, "origin": s.origin,
            }
            for s in solutions
        ],
    )  # fmt: skip
    for kind in (JobKind.EPISODE, JobKind.DATASET):
        jobs = [(s.number, s.job) for s in solutions if s.job is not None and s.kind is kind]
        insert_jobs(connection, campaign, jobs, kind)


def write_seeded(
    connection: Connection, campaign: Campaign, checkpoint: Checkpoint, solutions: Sequence[NewSolution]
) -> bool:
    """Store the state of a generation that waits for seeds after some came, and the generation once it is asked.

    Returns:
        Whether it was stored: False if the campaign has moved on, was paused, cancelled or deleted.
    """
    now = find_campaign(connection, campaign.id, lock=True)
    if now is None or now.status is not CampaignStatus.RUNNING or now.generation != campaign.generation:
        return False
    if read_vectors(connection, campaign.id, campaign.generation):
        return False
    _save_checkpoint(connection, campaign.id, checkpoint)
    insert_solutions(connection, campaign, campaign.generation, solutions)
    note_change(connection, campaign.id)
    return True


def insert_jobs(
    connection: Connection, campaign: Campaign, jobs: Sequence[tuple[int, NewJob]], kind: JobKind
) -> None:
    """Enqueue jobs; those whose simulation is known already are done at once."""
    if not jobs:
        return
    execution = campaign.body.execution
    known = _known_results(connection, [job.spec_hash for _, job in jobs], kind) if execution.cache else {}
    now = database_now(connection)
    connection.execute(
        insert(JobRow),
        [
            {
                "campaign_id": campaign.id, "number": number, "kind": kind, "spec": job.spec,
                "spec_hash": job.spec_hash, "needs": job.needs, "cache": execution.cache,
                "timeout_s": job.timeout_s, "attempt": 0, "max_attempts": execution.max_attempts,
                "status": JobStatus.DONE if job.spec_hash in known else JobStatus.QUEUED,
                "result": known.get(job.spec_hash), "created_at": now,
                "finished_at": now if job.spec_hash in known else None,
            }
            for number, job in jobs
        ],
    )  # fmt: skip
    announce(connection)


def _known_results(connection: Connection, hashes: Sequence[str], kind: JobKind) -> dict[str, str]:
    known: dict[str, str] = {}
    for start in range(0, len(hashes), MAX_NAMED):
        query = select(JobRow.spec_hash, JobRow.result).where(
            JobRow.spec_hash.in_(hashes[start : start + MAX_NAMED]),
            JobRow.status == JobStatus.DONE,
            JobRow.kind == kind,
            JobRow.cache,
        )
        known.update({row.spec_hash: row.result for row in connection.execute(query)})
    return known


def enqueue_traces(connection: Connection, campaign: Campaign, numbers: Sequence[int]) -> None:
    """Have the episodes of some solutions run again for their traces, unless that was asked for before."""
    asked = select(JobRow.number).where(
        JobRow.campaign_id == campaign.id, JobRow.kind == JobKind.TRACE, JobRow.number.in_(list(numbers))
    )
    present = set(connection.execute(asked).scalars())
    jobs = _jobs_again(connection, campaign.id, [number for number in numbers if number not in present])
    insert_jobs(connection, campaign, jobs, JobKind.TRACE)


def _jobs_again(connection: Connection, campaign_id: str, numbers: Sequence[int]) -> list[tuple[int, NewJob]]:
    query = (
        select(JobRow.number, JobRow.spec, JobRow.spec_hash, JobRow.needs, JobRow.timeout_s)
        .where(
            JobRow.campaign_id == campaign_id,
            JobRow.kind == JobKind.EPISODE,
            JobRow.number.in_(list(numbers)),
        )
        .order_by(JobRow.number)
    )
    return [
        (
            row.number,
            NewJob(spec=row.spec, spec_hash=row.spec_hash, needs=row.needs, timeout_s=row.timeout_s),
        )
        for row in connection.execute(query)
    ]


def generation_jobs(connection: Connection, campaign_id: str, generation: int) -> list[Row[*tuple[Any, ...]]]:
    """Return number, status, result and last_error of a generation's episodes."""
    query = (
        select(JobRow.number, JobRow.status, JobRow.result, JobRow.last_error)
        .join(
            SolutionRow,
            (SolutionRow.campaign_id == JobRow.campaign_id) & (SolutionRow.number == JobRow.number),
        )
        .where(
            JobRow.campaign_id == campaign_id,
            SolutionRow.generation == generation,
            EVALUATES,
        )
        .order_by(JobRow.number)
    )
    return list(connection.execute(query))


def write_step(connection: Connection, step: Step) -> bool:
    """Write a generation step, all or nothing, only if nobody wrote it before.

    Returns:
        Whether it was written: False if the campaign has moved on, was paused, cancelled or deleted, or if one of
        the generation's jobs was put back into the queue meanwhile.
    """
    campaign = find_campaign(connection, step.campaign, lock=True)
    if (
        campaign is None
        or campaign.status is not CampaignStatus.RUNNING
        or campaign.generation != step.generation
        or _has_open_jobs(connection, step)
    ):
        return False
    _write_judged(connection, step)
    _write_archive(connection, step)
    told = step.generation + 1
    insert_solutions(connection, campaign, told, step.asked)
    enqueue_traces(connection, campaign, step.traces)
    connection.execute(
        update(CampaignRow)
        .where(CampaignRow.id == campaign.id)
        .values(
            generation=told, evaluated=step.summary.evaluated, unsafe=step.summary.unsafe,
            failed=step.summary.failed, measured=step.summary.measured, turn=LAST_TURN, served=0,
            sequence=NEXT_SEQUENCE,
        )
    )  # fmt: skip
    if step.status is not CampaignStatus.RUNNING:
        set_status(connection, campaign.id, step.status, step.reason)
    return True


def _has_open_jobs(connection: Connection, step: Step) -> bool:
    return bool(connection.execute(select(has_open_jobs(step.campaign))).scalar_one())


def _write_judged(connection: Connection, step: Step) -> None:
    if not step.judged:
        return
    connection.execute(
        update(SolutionRow)
        .where(SolutionRow.campaign_id == step.campaign, SolutionRow.number == bindparam("judged"))
        .values(
            verdict=bindparam("verdict_of"), robustness=bindparam("robustness_of"),
            objectives=bindparam("objectives_of"), failure=bindparam("failure_of"),
        ),
        [
            {
                "judged": j.number, "verdict_of": j.verdict, "robustness_of": j.robustness,
                "objectives_of": dict(j.objectives) if j.objectives is not None else None,
                "failure_of": j.failure,
            }
            for j in step.judged
        ],
    )  # fmt: skip
    failed = [j.number for j in step.judged if j.verdict is SolutionVerdict.FAILED]
    # A result that cannot be judged must not be handed to other campaigns as one that is known.
    for start in range(0, len(failed), MAX_NAMED):
        connection.execute(
            update(JobRow)
            .where(
                JobRow.campaign_id == step.campaign,
                EVALUATES,
                JobRow.number.in_(failed[start : start + MAX_NAMED]),
            )
            .values(cache=False)
        )


def _write_archive(connection: Connection, step: Step) -> None:
    summary = step.summary
    connection.execute(
        insert(GenerationRow).values(
            campaign_id=step.campaign, number=summary.number, evaluated=summary.evaluated,
            unsafe=summary.unsafe, failed=summary.failed, measured=summary.measured,
            best_fitness=summary.best_fitness, median_fitness=summary.median_fitness, dbs=summary.dbs,
            strict_dbs=summary.strict_dbs,
            step_s=summary.step_s, told_at=database_now(connection),
        )
    )  # fmt: skip
    if step.block is not None:
        block = step.block
        connection.execute(
            insert(DistanceBlockRow).values(
                campaign_id=step.campaign, generation=step.generation, first_row=block.first_row,
                rows=block.rows, columns=block.columns, metric_version=block.metric_version,
                sha256=hashlib.sha256(block.data).hexdigest(), data=block.data,
            )
        )  # fmt: skip
    _save_checkpoint(connection, step.campaign, step.checkpoint)


def _save_checkpoint(connection: Connection, campaign_id: str, saved: Checkpoint) -> None:
    connection.execute(delete(CheckpointRow).where(CheckpointRow.campaign_id == campaign_id))
    connection.execute(
        insert(CheckpointRow).values(
            campaign_id=campaign_id, generation=saved.generation, document=saved.document,
            neighbours=saved.neighbours, unsafe_neighbours=saved.unsafe_neighbours, sha256=saved.sha256(),
        )
    )  # fmt: skip


def find_checkpoint(connection: Connection, campaign_id: str) -> Checkpoint | None:
    """Return a campaign's checkpoint, or None before its first generation was told or seeded.

    Raises:
        Damaged: The stored checksum does not fit.
    """
    row = connection.execute(
        select(CheckpointRow.__table__).where(CheckpointRow.campaign_id == campaign_id)
    ).one_or_none()
    if row is None:
        return None
    checkpoint = Checkpoint(
        generation=row.generation, document=row.document, neighbours=row.neighbours,
        unsafe_neighbours=row.unsafe_neighbours,
    )  # fmt: skip
    if checkpoint.sha256() != row.sha256:
        raise Damaged(f"campaign {campaign_id}: the checkpoint of generation {row.generation} is damaged")
    return checkpoint


def read_distances(connection: Connection, campaign_id: str, rows: Sequence[int]) -> FloatArray | None:
    """Return the stored distances between solutions at some positions of the archive, shape ``(rows, rows)``.

    None if they are not all stored, or stored by another version of the metric, or damaged.
    """
    wanted = np.asarray(rows, dtype=np.int64)
    half = np.full((len(wanted), len(wanted)), np.nan, dtype=np.float32)
    query = select(DistanceBlockRow.__table__).where(
        DistanceBlockRow.campaign_id == campaign_id,
        DistanceBlockRow.first_row <= int(wanted.max()),
        DistanceBlockRow.first_row + DistanceBlockRow.rows > int(wanted.min()),
        DistanceBlockRow.metric_version == METRIC_VERSION,
    )
    # One block at a time: all of them may take more memory than there is.
    with connection.execution_options(stream_results=True, yield_per=1).execute(query) as blocks:
        for block in blocks:
            inside = np.flatnonzero((wanted >= block.first_row) & (wanted < block.first_row + block.rows))
            known = np.flatnonzero(wanted < block.columns)
            if not inside.size:
                continue
            if hashlib.sha256(block.data).hexdigest() != block.sha256:
                about = {"campaign": campaign_id, "generation": block.generation}
                log.error("its distances are damaged", extra=about)
                return None
            matrix = np.frombuffer(block.data, dtype="<f4").reshape(block.rows, block.columns)
            half[np.ix_(inside, known)] = matrix[np.ix_(wanted[inside] - block.first_row, wanted[known])]
    # A row knows the solutions of its own generation and of those before; of later ones, their rows know it.
    whole = np.where(np.isnan(half), half.T, half).astype(np.float64)
    return None if np.isnan(whole).any() else whole


def read_vectors(connection: Connection, campaign_id: str, generation: int) -> dict[int, bytes]:
    """Return the vectors of a generation's solutions by number."""
    query = select(SolutionRow.number, SolutionRow.vector).where(
        SolutionRow.campaign_id == campaign_id, SolutionRow.generation == generation
    )
    return {row.number: row.vector for row in connection.execute(query)}


def read_archive(connection: Connection, campaign_id: str, dimension: int) -> StoredArchive:
    """Return the evaluated solutions as of the last checkpoint.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        dimension: Length of a solution's vector.
    """
    checkpoint = find_checkpoint(connection, campaign_id)
    generation = checkpoint.generation if checkpoint else 0
    rows = connection.execute(
        select(
            SolutionRow.number, SolutionRow.vector, SolutionRow.verdict, SolutionRow.robustness,
            SolutionRow.generation,
        )
        .where(
            SolutionRow.campaign_id == campaign_id,
            SolutionRow.generation < generation,
            SolutionRow.verdict.in_([SolutionVerdict.SAFE, SolutionVerdict.UNSAFE]),
        )
        .order_by(SolutionRow.number)
    ).all()  # fmt: skip
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

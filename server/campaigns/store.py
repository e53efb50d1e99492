"""The SQL of campaigns: rows in, plain values out.

Functions that write are units for `server.db.writer.Writer`; functions that read take a connection of the reader,
which sees one snapshot.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Row, Select, bindparam, delete, func, insert, select, update

from server.campaigns.body import CampaignBody
from server.db.clock import database_now
from server.db.models import (
    CampaignRow,
    CampaignStatus,
    CheckpointRow,
    DistanceBlockRow,
    GenerationRow,
    JobKind,
    JobRow,
    JobStatus,
    SolutionRow,
    SolutionVerdict,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A campaign as it stands in the database."""

    id: str
    body: CampaignBody
    status: CampaignStatus
    status_reason: str
    generation: int
    evaluated: int
    unsafe: int
    failed: int
    failures_accepted: int
    created_at: datetime
    finished_at: datetime | None


@dataclass(frozen=True, slots=True, kw_only=True)
class NewJob:
    """A simulation that a solution needs."""

    spec: str
    spec_hash: str
    needs: str
    timeout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NewSolution:
    """A solution that was asked for."""

    number: int
    vector: bytes
    seed: int
    job: NewJob | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """What became of a solution."""

    number: int
    verdict: SolutionVerdict
    robustness: float | None
    objectives: Mapping[str, float] | None
    failure: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A generation's rows of the distance matrix."""

    first_row: int
    rows: int
    columns: int
    metric_version: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """The algorithm's state after a `tell`, and the counts of the archive that goes with it."""

    generation: int
    document: bytes
    neighbours: bytes
    unsafe_neighbours: bytes

    def sha256(self) -> str:
        """Return the checksum that is stored with it."""
        return hashlib.sha256(self.document + self.neighbours + self.unsafe_neighbours).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class GenerationSummary:
    """Where the archive stood after a generation."""

    number: int
    evaluated: int
    unsafe: int
    failed: int
    best_fitness: float | None
    median_fitness: float | None
    dbs: int
    strict_dbs: int
    step_s: float
    told_at: datetime | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """All that one generation step writes.

    Attributes:
        campaign: Its id.
        generation: Generations told before this step; the step is written only if that still holds.
        judged: The generation that was told.
        summary: Where the archive stands after it.
        block: Its distances, unless they are not stored.
        checkpoint: The state after it.
        asked: The next generation; empty if the search is over.
        traces: Solutions of which a trace is wanted as evidence, once the search is over.
        status: What the campaign is after the step.
        reason: Why.
    """

    campaign: str
    generation: int
    judged: Sequence[Judged]
    summary: GenerationSummary
    block: Block | None
    checkpoint: Checkpoint
    asked: Sequence[NewSolution]
    traces: Sequence[int]
    status: CampaignStatus
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredArchive:
    """The evaluated solutions of a campaign, ascending by number, as of its last checkpoint."""

    generation: int
    numbers: NDArray[np.int64]
    vectors: NDArray[np.float64]
    unsafe: NDArray[np.bool_]
    robustness: NDArray[np.float64]
    generations: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    unsafe_neighbours: NDArray[np.int64]


# --- campaigns -----------------------------------------------------------------------------------------------


def insert_campaign(connection: Connection, campaign_id: str, body: CampaignBody, key: str | None) -> None:
    """Store a new campaign, running, with nothing asked yet."""
    connection.execute(
        insert(CampaignRow).values(
            id=campaign_id, name=body.name, document=body.model_dump(mode="json"),
            document_hash=body.document_hash(), idempotency_key=key, status=CampaignStatus.RUNNING,
            status_reason="", seed=body.seed, priority=body.priority, budget=body.budget.simulations,
            generation=0, evaluated=0, unsafe=0, failed=0, failures_accepted=0, turn=0,
            created_at=database_now(connection), finished_at=None,
        )
    )  # fmt: skip


def find_campaign(connection: Connection, campaign_id: str, *, lock: bool = False) -> Campaign | None:
    """Return a campaign, or None; with `lock`, hold its row until the transaction ends."""
    query = select(CampaignRow.__table__).where(CampaignRow.id == campaign_id)
    if lock and connection.dialect.name != "sqlite":
        query = query.with_for_update()
    row = connection.execute(query).one_or_none()
    return None if row is None else _campaign(row)


def find_by_key(connection: Connection, key: str) -> Campaign | None:
    """Return the campaign that was submitted with an idempotency key, or None."""
    row = connection.execute(
        select(CampaignRow.__table__).where(CampaignRow.idempotency_key == key)
    ).one_or_none()
    return None if row is None else _campaign(row)


def find_by_prefix(connection: Connection, prefix: str) -> list[Campaign]:
    """Return the campaigns whose id begins with a prefix, at most two."""
    query = (
        select(CampaignRow.__table__)
        .where(CampaignRow.id.startswith(prefix, autoescape=True))
        .order_by(CampaignRow.id)
        .limit(2)
    )
    return [_campaign(row) for row in connection.execute(query)]


def list_campaigns(
    connection: Connection,
    *,
    limit: int,
    before: tuple[datetime, str] | None = None,
    document_hash: str | None = None,
    statuses: Sequence[CampaignStatus] = (),
) -> list[Campaign]:
    """Return campaigns, newest first."""
    query = select(CampaignRow.__table__).order_by(CampaignRow.created_at.desc(), CampaignRow.id.desc())
    if before is not None:
        moment, campaign_id = before
        query = query.where(
            (CampaignRow.created_at < moment)
            | ((CampaignRow.created_at == moment) & (CampaignRow.id < campaign_id))
        )
    if document_hash is not None:
        query = query.where(CampaignRow.document_hash == document_hash)
    if statuses:
        query = query.where(CampaignRow.status.in_(statuses))
    return [_campaign(row) for row in connection.execute(query.limit(limit))]


def running_idle(connection: Connection) -> list[str]:
    """Return running campaigns without an open episode: their next step is due."""
    busy = select(JobRow.id).where(
        JobRow.campaign_id == CampaignRow.id,
        JobRow.kind == JobKind.EPISODE,
        JobRow.status.in_([JobStatus.QUEUED, JobStatus.LEASED]),
    )
    query = select(CampaignRow.id).where(CampaignRow.status == CampaignStatus.RUNNING, ~busy.exists())
    return list(connection.execute(query).scalars())


def end_running(connection: Connection, campaign_id: str, status: CampaignStatus, reason: str) -> None:
    """Change what a campaign is, unless somebody changed it meanwhile."""
    campaign = find_campaign(connection, campaign_id, lock=True)
    if campaign is not None and campaign.status is CampaignStatus.RUNNING:
        set_status(connection, campaign_id, status, reason)


def set_status(
    connection: Connection,
    campaign_id: str,
    status: CampaignStatus,
    reason: str,
    *,
    accept_failures: bool = False,
) -> None:
    """Change what a campaign is; on cancelling, its open jobs end too."""
    values: dict[str, Any] = {"status": status, "status_reason": reason}
    if status in (CampaignStatus.FINISHED, CampaignStatus.CANCELLED, CampaignStatus.FAILED):
        values["finished_at"] = database_now(connection)
    if accept_failures:
        values["failures_accepted"] = count_quarantined(connection, campaign_id)
    connection.execute(update(CampaignRow).where(CampaignRow.id == campaign_id).values(values))
    if status is CampaignStatus.CANCELLED:
        connection.execute(
            update(JobRow)
            .where(
                JobRow.campaign_id == campaign_id,
                JobRow.status.in_([JobStatus.QUEUED, JobStatus.LEASED]),
            )
            .values(status=JobStatus.CANCELLED, lease_expires_at=None, finished_at=database_now(connection))
        )


def delete_campaign(connection: Connection, campaign_id: str) -> None:
    """Delete a campaign and everything that belongs to it."""
    connection.execute(delete(CampaignRow).where(CampaignRow.id == campaign_id))


def _campaign(row: Row[*tuple[Any, ...]]) -> Campaign:
    return Campaign(
        id=row.id, body=CampaignBody.model_validate(row.document), status=CampaignStatus(row.status),
        status_reason=row.status_reason, generation=row.generation, evaluated=row.evaluated,
        unsafe=row.unsafe, failed=row.failed, failures_accepted=row.failures_accepted,
        created_at=row.created_at, finished_at=row.finished_at,
    )  # fmt: skip


# --- the generation step -------------------------------------------------------------------------------------


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
                "verdict": SolutionVerdict.PENDING,
            }
            for s in solutions
        ],
    )  # fmt: skip
    jobs = [(s.number, s.job) for s in solutions if s.job is not None]
    insert_jobs(connection, campaign, jobs, JobKind.EPISODE)


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


def _known_results(connection: Connection, hashes: Sequence[str], kind: JobKind) -> dict[str, str]:
    query = select(JobRow.spec_hash, JobRow.result).where(
        JobRow.spec_hash.in_(hashes), JobRow.status == JobStatus.DONE, JobRow.kind == kind, JobRow.cache
    )
    return {row.spec_hash: row.result for row in connection.execute(query)}


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
            JobRow.kind == JobKind.EPISODE,
        )
        .order_by(JobRow.number)
    )
    return list(connection.execute(query))


def write_step(connection: Connection, step: Step) -> bool:
    """Write a generation step, all or nothing, only if nobody wrote it before.

    Returns:
        Whether it was written: False if the campaign has moved on, was paused, cancelled or deleted.
    """
    campaign = find_campaign(connection, step.campaign, lock=True)
    if (
        campaign is None
        or campaign.status is not CampaignStatus.RUNNING
        or campaign.generation != step.generation
    ):
        return False
    _write_judged(connection, step)
    _write_archive(connection, step)
    told = step.generation + 1
    insert_solutions(connection, campaign, told, step.asked)
    if step.traces:
        jobs = _jobs_again(connection, campaign.id, step.traces)
        insert_jobs(connection, campaign, jobs, JobKind.TRACE)
    connection.execute(
        update(CampaignRow)
        .where(CampaignRow.id == campaign.id)
        .values(
            generation=told, evaluated=step.summary.evaluated, unsafe=step.summary.unsafe,
            failed=step.summary.failed,
        )
    )  # fmt: skip
    if step.status is not CampaignStatus.RUNNING:
        set_status(connection, campaign.id, step.status, step.reason)
    return True


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


def _write_archive(connection: Connection, step: Step) -> None:
    summary = step.summary
    connection.execute(
        insert(GenerationRow).values(
            campaign_id=step.campaign, number=summary.number, evaluated=summary.evaluated,
            unsafe=summary.unsafe, failed=summary.failed, best_fitness=summary.best_fitness,
            median_fitness=summary.median_fitness, dbs=summary.dbs, strict_dbs=summary.strict_dbs,
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
    saved = step.checkpoint
    connection.execute(delete(CheckpointRow).where(CheckpointRow.campaign_id == step.campaign))
    connection.execute(
        insert(CheckpointRow).values(
            campaign_id=step.campaign, generation=saved.generation, document=saved.document,
            neighbours=saved.neighbours, unsafe_neighbours=saved.unsafe_neighbours, sha256=saved.sha256(),
        )
    )  # fmt: skip


def find_checkpoint(connection: Connection, campaign_id: str) -> Checkpoint | None:
    """Return a campaign's checkpoint, or None before its first generation was told.

    Raises:
        ValueError: The stored checksum does not fit: the database is damaged.
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
        raise ValueError(f"campaign {campaign_id}: the checkpoint of generation {row.generation} is damaged")
    return checkpoint


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


def read_failed_count(connection: Connection, campaign_id: str) -> int:
    """Return how many solutions failed."""
    return connection.execute(
        select(func.count()).where(
            SolutionRow.campaign_id == campaign_id, SolutionRow.verdict == SolutionVerdict.FAILED
        )
    ).scalar_one()


# --- views ---------------------------------------------------------------------------------------------------


def list_generations(connection: Connection, campaign_id: str, since: int) -> list[GenerationSummary]:
    """Return the generations told, from number `since` on."""
    query = (
        select(GenerationRow.__table__)
        .where(GenerationRow.campaign_id == campaign_id, GenerationRow.number >= since)
        .order_by(GenerationRow.number)
    )
    return [
        GenerationSummary(
            number=row.number, evaluated=row.evaluated, unsafe=row.unsafe, failed=row.failed,
            best_fitness=row.best_fitness, median_fitness=row.median_fitness, dbs=row.dbs,
            strict_dbs=row.strict_dbs, step_s=row.step_s, told_at=row.told_at,
        )
        for row in connection.execute(query)
    ]  # fmt: skip


def count_open_jobs(connection: Connection, campaign_id: str) -> dict[str, int]:
    """Return how many of a campaign's jobs are in each state that is not done, and done in this generation."""
    query = (
        select(JobRow.status, func.count())
        .where(JobRow.campaign_id == campaign_id, JobRow.kind == JobKind.EPISODE)
        .where(JobRow.status != JobStatus.DONE)
        .group_by(JobRow.status)
    )
    return {str(row[0]): int(row[1]) for row in connection.execute(query)}


def count_pending(connection: Connection, campaign: Campaign) -> int:
    """Return how many solutions the generation that is being simulated has."""
    return connection.execute(
        select(func.count()).where(
            SolutionRow.campaign_id == campaign.id, SolutionRow.generation == campaign.generation
        )
    ).scalar_one()


def count_quarantined(connection: Connection, campaign_id: str) -> int:
    """Return how many of a campaign's episodes are in quarantine."""
    return connection.execute(
        select(func.count()).where(
            JobRow.campaign_id == campaign_id,
            JobRow.kind == JobKind.EPISODE,
            JobRow.status == JobStatus.QUARANTINED,
        )
    ).scalar_one()


def waiting_needs(connection: Connection) -> dict[str, int]:
    """Return how many queued jobs need each capability."""
    query = select(JobRow.needs, func.count()).where(JobRow.status == JobStatus.QUEUED).group_by(JobRow.needs)
    return {str(row[0]): int(row[1]) for row in connection.execute(query)}


def read_solutions(
    connection: Connection, campaign_id: str, numbers: Iterable[int]
) -> list[Row[*tuple[Any, ...]]]:
    """Return solutions by number, ascending, each with its job's result, attempts and last error."""
    return list(connection.execute(_solutions(campaign_id).where(SolutionRow.number.in_(list(numbers)))))


def page_solutions(
    connection: Connection, campaign_id: str, *, after: int, limit: int, unsafe: bool | None
) -> list[Row[*tuple[Any, ...]]]:
    """Return solutions with numbers past `after`, ascending, each with its job."""
    query = _solutions(campaign_id).where(SolutionRow.number > after).limit(limit)
    if unsafe is not None:
        wanted = SolutionVerdict.UNSAFE if unsafe else SolutionVerdict.SAFE
        query = query.where(SolutionRow.verdict == wanted)
    return list(connection.execute(query))


def _solutions(campaign_id: str) -> Select[*tuple[Any, ...]]:
    return (
        select(
            SolutionRow.number, SolutionRow.generation, SolutionRow.vector, SolutionRow.seed,
            SolutionRow.spec_hash, SolutionRow.verdict, SolutionRow.robustness, SolutionRow.objectives,
            SolutionRow.failure, JobRow.spec, JobRow.result, JobRow.attempt, JobRow.status.label("job_status"),
        )
        .outerjoin(
            JobRow,
            (JobRow.campaign_id == SolutionRow.campaign_id)
            & (JobRow.number == SolutionRow.number)
            & (JobRow.kind == JobKind.EPISODE),
        )
        .where(SolutionRow.campaign_id == campaign_id)
        .order_by(SolutionRow.number)
    )  # fmt: skip


def _jobs_again(connection: Connection, campaign_id: str, numbers: Sequence[int]) -> list[tuple[int, NewJob]]:
    """Return the episodes of some solutions, to be run again for their traces."""
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


def request_trace(connection: Connection, campaign: Campaign, number: int) -> bool:
    """Enqueue the trace of a solution unless it is enqueued already; return whether that is possible."""
    present = connection.execute(
        select(JobRow.id).where(
            JobRow.campaign_id == campaign.id, JobRow.number == number, JobRow.kind == JobKind.TRACE
        )
    ).one_or_none()
    if present is not None:
        return True
    jobs = _jobs_again(connection, campaign.id, [number])
    insert_jobs(connection, campaign, jobs, JobKind.TRACE)
    return bool(jobs)


def spec_json(spec: Mapping[str, Any]) -> str:
    """Return a specification as it is stored: compact JSON."""
    return json.dumps(spec, separators=(",", ":"), allow_nan=False)

"""Jobs for the rest of the server: enqueue, cancel, retry, list, count them, and read their outcomes.

Leases and reports are in `lease_store` and `report_store`. Functions that write take a
connection in a write transaction.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    and_,
    bindparam,
    delete,
    func,
    insert,
    or_,
    select,
    text,
    true,
    update,
)
from sqlalchemy.orm import InstrumentedAttribute

from brink.server.db.models import CampaignRow, JobRow, SolutionRow, TraceRow
from brink.server.db.sql import constant, database_now, in_list
from brink.server.db.statements import Statement, read
from brink.server.db.types import UtcDateTime
from brink.server.queue.wakeups import notify_coordinators
from brink.server.states import CampaignStatus, JobKind, JobStatus, SolutionVerdict

MAX_NAMED = 10_000
"""Maximum number of values in one ``IN (…)``: databases limit the number of parameters of a statement."""
TRACES_A_PIECE = 50
"""Maximum number of traces deleted together with jobs; each takes some 100 kB."""
LISTED_BY_STATUS = frozenset({JobStatus.QUEUED, JobStatus.LEASED, JobStatus.QUARANTINED})
"""States with few jobs, which are found by an index on the status."""

# Literals instead of parameters: Postgres plans a prepared statement without knowing its parameters, and could not
# use the partial indexes on queued and leased jobs.
IS_EVALUATION = JobRow.kind != constant(JobKind.TRACE)
"""The job evaluates a solution, in an episode or on a data set."""
IS_LEASED = JobRow.status == constant(JobStatus.LEASED)

EVALUATIONS = (
    select(JobRow.campaign_id, JobRow.number, JobRow.spec, JobRow.result, JobRow.attempt, JobRow.losses)
    .where(IS_EVALUATION)
    .subquery("evaluations")
)
"""The jobs that evaluate solutions, for joins with the table of solutions: at most one job for each solution."""


def is_told(campaign_id: str) -> ColumnElement[bool]:
    """Return the condition that a solution of a campaign belongs to a generation whose step was taken.

    Verdicts of a large generation are stored before its step. If the campaign ends in between, no archive has them.
    """
    reached = select(CampaignRow.generation).where(CampaignRow.id == campaign_id).scalar_subquery()
    return SolutionRow.generation < reached


@dataclass(frozen=True, slots=True, kw_only=True)
class NewJob:
    """A simulation to enqueue.

    Attributes:
        spec: The specification as canonical JSON.
        spec_hash: Its digest. Jobs with the same digest share one simulation.
        needs: The capability that a worker must offer.
        timeout_s: Time limit for one attempt.
    """

    spec: str
    spec_hash: str
    needs: str
    timeout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class JobSettings:
    """Settings that all jobs of a campaign share.

    Attributes:
        cache: Whether the jobs share results with identical simulations.
        max_attempts: Failed attempts before quarantine.
        max_losses: Lost leases before quarantine.
    """

    cache: bool
    max_attempts: int
    max_losses: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """The current state of a job.

    Attributes:
        attempt: Number of leases so far, except those that were given back.
        counted_attempts: Those among them that were not lost; after `max_attempts` of them, the job is quarantined.
        losses: The others; after `max_losses` of them, it is quarantined as well.
        worker: The worker that holds its lease, or None.
    """

    id: int
    campaign: str
    number: int
    kind: str
    needs: str
    status: JobStatus
    attempt: int
    counted_attempts: int
    max_attempts: int
    losses: int
    max_losses: int
    worker: str | None
    last_error: str | None
    created_at: datetime
    finished_at: datetime | None


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOutcome:
    """The outcome of a job that evaluates a solution.

    Attributes:
        number: The number of the solution.
        generation: The generation of the solution.
        result: The completed episode as JSON, or None.
        error: The last error, or None.
    """

    number: int
    generation: int
    status: JobStatus
    result: str | None
    error: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class JobCount:
    """The number of jobs of one campaign with the same status, kind and required capability.

    Attributes:
        name: The name of the campaign.
        oldest: Creation time of the oldest of these jobs.
    """

    status: JobStatus
    kind: str
    needs: str
    campaign: str
    name: str
    campaign_status: CampaignStatus
    jobs: int
    oldest: datetime


def first_line(error: str) -> str:
    """Return the first line of an error; the rest is a traceback or the output of a process."""
    return error.strip().partition("\n")[0]


def enqueue(
    connection: Connection,
    campaign_id: str,
    kind: JobKind,
    jobs: Sequence[tuple[int, NewJob]],
    settings: JobSettings,
) -> None:
    """Enqueue jobs. A job whose simulation already has a result is stored as done.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign of the jobs.
        kind: The kind of all jobs.
        jobs: Solution numbers and simulations.
        settings: The campaign's settings.
    """
    if not jobs:
        return
    known = _known_results(connection, [job.spec_hash for _, job in jobs], kind) if settings.cache else {}
    now = database_now(connection)
    connection.execute(
        insert(JobRow),
        [
            {
                "campaign_id": campaign_id,
                "number": number,
                "kind": kind,
                "spec": job.spec,
                "spec_hash": job.spec_hash,
                "needs": job.needs,
                "cache": settings.cache,
                "timeout_s": job.timeout_s,
                "attempt": 0,
                "max_attempts": settings.max_attempts,
                "losses": 0,
                "max_losses": settings.max_losses,
                "status": JobStatus.DONE if job.spec_hash in known else JobStatus.QUEUED,
                "result": known.get(job.spec_hash),
                "created_at": now,
                "finished_at": now if job.spec_hash in known else None,
            }
            for number, job in jobs
        ],
    )
    notify_coordinators(connection)


def _known_results(connection: Connection, hashes: Sequence[str], kind: JobKind) -> dict[str, str]:
    known: dict[str, str] = {}
    for some in _chunks(hashes):
        query = select(JobRow.spec_hash, JobRow.result).where(
            JobRow.spec_hash.in_(some), JobRow.status == JobStatus.DONE, JobRow.kind == kind, JobRow.cache
        )
        known.update({row.spec_hash: row.result for row in connection.execute(query)})
    return known


def _chunks(values: Sequence[Any]) -> Iterator[Sequence[Any]]:
    for start in range(0, len(values), MAX_NAMED):
        yield values[start : start + MAX_NAMED]


def enqueue_traces(
    connection: Connection, campaign_id: str, numbers: Sequence[int], settings: JobSettings
) -> None:
    """Enqueue jobs that run episodes again to record their traces, except those enqueued before.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        numbers: Numbers of simulated solutions.
        settings: The campaign's settings.
    """
    its_jobs = (JobRow.campaign_id == campaign_id, JobRow.number.in_(list(numbers)))
    present = select(JobRow.number).where(*its_jobs, JobRow.kind == JobKind.TRACE)
    known = set(connection.execute(present).scalars())
    episodes = (
        select(JobRow.number, JobRow.spec, JobRow.spec_hash, JobRow.needs, JobRow.timeout_s)
        .where(*its_jobs, JobRow.kind == JobKind.EPISODE)
        .order_by(JobRow.number)
    )
    jobs = [
        (row.number, NewJob(spec=row.spec, spec_hash=row.spec_hash, needs=row.needs, timeout_s=row.timeout_s))
        for row in connection.execute(episodes)
        if row.number not in known
    ]
    enqueue(connection, campaign_id, JobKind.TRACE, jobs, settings)


def cancel_evaluations(connection: Connection, campaign_id: str) -> None:
    """Cancel the open jobs of a campaign, except those that record traces."""
    connection.execute(
        update(JobRow)
        .where(
            JobRow.campaign_id == campaign_id,
            IS_EVALUATION,
            JobRow.status.in_([JobStatus.QUEUED, JobStatus.LEASED]),
        )
        .values(
            status=JobStatus.CANCELLED,
            lease_token=None,
            lease_expires_at=None,
            finished_at=database_now(connection),
        )
    )


def requeue(connection: Connection, job_id: int, *, more_attempts: int, more_losses: int) -> bool:
    """Return a quarantined job to the queue.

    Args:
        connection: In a write transaction.
        job_id: The job.
        more_attempts: Failed attempts in addition to those so far.
        more_losses: Lost leases in addition to those so far.

    Returns:
        False if the job is not in quarantine any more.
    """
    changed = connection.execute(
        update(JobRow)
        .where(JobRow.id == job_id, JobRow.status == JobStatus.QUARANTINED)
        .values(
            status=JobStatus.QUEUED,
            max_attempts=JobRow.attempt - JobRow.losses + more_attempts,
            max_losses=JobRow.losses + more_losses,
            not_before=None,
            lease_token=None,
            finished_at=None,
        )
    )
    if changed.rowcount:
        notify_coordinators(connection)
    return changed.rowcount > 0


def withdraw_results(connection: Connection, campaign_id: str, numbers: Sequence[int]) -> None:
    """Stop sharing the results of some solutions with other jobs, because they cannot be evaluated.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        numbers: Numbers of the solutions.
    """
    for some in _chunks(numbers):
        connection.execute(
            update(JobRow)
            .where(JobRow.campaign_id == campaign_id, IS_EVALUATION, JobRow.number.in_(some))
            .values(cache=False)
        )


def _has_open_jobs(
    campaign: InstrumentedAttribute[str] | str, in_generation: ColumnElement[bool]
) -> ColumnElement[bool]:
    """Return the condition that a campaign has queued or leased evaluations in its current generation.

    The two states are looked up separately; in one lookup, Postgres may read all jobs of the campaign.

    Args:
        campaign: Id of the campaign, or the column that holds it.
        in_generation: Condition on jobs of the campaign.
    """
    queued, leased = (
        select(JobRow.id)
        .where(JobRow.campaign_id == campaign, JobRow.status == status, IS_EVALUATION, in_generation)
        .offset(0)  # keeps Postgres from turning the subquery into a join
        for status in (JobStatus.QUEUED, JobStatus.LEASED)
    )
    return or_(queued.exists(), leased.exists())


# The sum keeps Postgres from reading all jobs of the campaign by their number.
_IN_GENERATION = or_(CampaignRow.generation_end.is_(None), JobRow.number + 0 < CampaignRow.generation_end)
_IDLE = select(CampaignRow.id).where(
    CampaignRow.status == constant(CampaignStatus.RUNNING), ~_has_open_jobs(CampaignRow.id, _IN_GENERATION)
)
_IDLE_AMONG = Statement(_IDLE.where(in_list(CampaignRow.id, "campaigns")))


def has_open_jobs(connection: Connection, campaign_id: str, end: int | None) -> bool:
    """Return whether a campaign has queued or leased evaluations in its current generation.

    Args:
        connection: In a transaction.
        campaign_id: The campaign.
        end: First number that belongs to a later generation; None if there is none.
    """
    in_generation = true() if end is None else JobRow.number + 0 < end
    return bool(connection.execute(select(_has_open_jobs(campaign_id, in_generation))).scalar_one())


def any_done(connection: Connection, campaign_id: str, numbers: Sequence[int]) -> bool:
    """Return whether any evaluation of some of a campaign's solutions is done.

    Args:
        connection: In a transaction.
        campaign_id: The campaign.
        numbers: Numbers of solutions, ascending.
    """
    return any(row.status == JobStatus.DONE for row in _jobs_among(connection, campaign_id, numbers))


def idle_campaigns(connection: Connection, campaigns: Iterable[str] | None = None) -> tuple[str, ...]:
    """Return the running campaigns whose current generation has no open evaluations.

    Args:
        connection: Sees one snapshot.
        campaigns: The campaigns to look at, in a write transaction; None for all of them.
    """
    if campaigns is None:
        return tuple(connection.execute(_IDLE).scalars())
    names = list(campaigns)
    if not names:
        return ()
    return tuple(sorted(row.id for row in read(connection, (_IDLE_AMONG, {"campaigns": names}))[0]))


def generation_outcomes(connection: Connection, campaign_id: str, generation: int) -> list[JobOutcome]:
    """Return the outcomes of a generation's evaluations, ascending by number.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        generation: Number of the generation.
    """
    return _outcomes(connection, campaign_id, SolutionRow.generation == generation)


def unsafe_outcomes(connection: Connection, campaign_id: str) -> list[JobOutcome]:
    """Return the outcomes of the unsafe solutions in a campaign's archive, ascending by number."""
    unsafe = and_(SolutionRow.verdict == SolutionVerdict.UNSAFE, is_told(campaign_id))
    return _outcomes(connection, campaign_id, unsafe)


def _outcomes(connection: Connection, campaign_id: str, condition: ColumnElement[bool]) -> list[JobOutcome]:
    # Two queries: while Postgres has no statistics on the campaign, a join may scan all its jobs for each solution.
    solutions = select(SolutionRow.number, SolutionRow.generation).where(
        SolutionRow.campaign_id == campaign_id, condition
    )
    generations = {row.number: row.generation for row in connection.execute(solutions)}
    return [
        JobOutcome(
            number=row.number,
            generation=generations[row.number],
            status=JobStatus(row.status),
            result=row.result,
            error=row.last_error,
        )
        for row in _jobs_among(connection, campaign_id, sorted(generations))
    ]


def _jobs_among(
    connection: Connection, campaign_id: str, numbers: Sequence[int]
) -> Iterable[Row[int, str, str | None, str | None]]:
    """Return the evaluations of some of a campaign's solutions, ascending by number.

    Args:
        connection: In a transaction.
        campaign_id: The campaign.
        numbers: Numbers of solutions, ascending.
    """
    if not numbers:
        return ()
    first, last = numbers[0], numbers[-1]
    query = select(JobRow.number, JobRow.status, JobRow.result, JobRow.last_error).where(
        JobRow.campaign_id == campaign_id, IS_EVALUATION, JobRow.number.between(first, last)
    )
    if len(numbers) <= last - first:
        query = query.where(in_list(JobRow.number, "numbers"))
    return connection.execute(query.order_by(JobRow.number), {"numbers": numbers})


_JOB = (
    JobRow.id,
    JobRow.campaign_id,
    JobRow.number,
    JobRow.kind,
    JobRow.needs,
    JobRow.status,
    JobRow.attempt,
    JobRow.max_attempts,
    JobRow.losses,
    JobRow.max_losses,
    JobRow.lease_worker,
    JobRow.last_error,
    JobRow.created_at,
    JobRow.finished_at,
)


def _job(row: Row[*tuple[Any, ...]]) -> Job:
    return Job(
        id=row.id,
        campaign=row.campaign_id,
        number=row.number,
        kind=row.kind,
        needs=row.needs,
        status=JobStatus(row.status),
        attempt=row.attempt,
        counted_attempts=row.attempt - row.losses,
        max_attempts=row.max_attempts,
        losses=row.losses,
        max_losses=row.max_losses,
        worker=row.lease_worker if row.status == JobStatus.LEASED else None,
        last_error=row.last_error,
        created_at=row.created_at,
        finished_at=row.finished_at,
    )


def find_job(connection: Connection, job_id: int) -> Job | None:
    """Return a job, or None."""
    return next(map(_job, connection.execute(select(*_JOB).where(JobRow.id == job_id))), None)


def find_job_of(connection: Connection, campaign_id: str, number: int, kind: JobKind) -> Job | None:
    """Return a solution's job of the given kind, or None.

    Args:
        connection: Sees one snapshot.
        campaign_id: The campaign.
        number: Number of the solution.
        kind: What the job is for.
    """
    its_job = (JobRow.campaign_id == campaign_id, JobRow.number == number, JobRow.kind == kind)
    return next(map(_job, connection.execute(select(*_JOB).where(*its_job))), None)


# Statements about open jobs visit the campaigns one by one and use the index on campaign and status: reading all jobs
# that ever ran would take longer and longer. SQLite joins the tables of a CROSS JOIN in the order given; Postgres
# does not merge a subquery that has an OFFSET.
_JOBS_WITH_STATUS = {
    "sqlite": "campaigns CROSS JOIN jobs WHERE jobs.campaign_id = campaigns.id AND jobs.status = '{status}'",
    "postgresql": """campaigns CROSS JOIN LATERAL (
    SELECT * FROM jobs WHERE jobs.campaign_id = campaigns.id AND jobs.status = '{status}' OFFSET 0
) AS jobs WHERE true""",
}
_COUNT = """SELECT jobs.kind, jobs.needs, jobs.campaign_id, campaigns.status AS campaign_status, campaigns.name,
    count(*) AS jobs, min(jobs.created_at) AS oldest
FROM {jobs}
GROUP BY jobs.kind, jobs.needs, jobs.campaign_id, campaigns.status, campaigns.name"""
_COUNTS = {
    dialect: {
        status: text(_COUNT.format(jobs=jobs.format(status=status))).columns(oldest=UtcDateTime)
        for status in (JobStatus.QUEUED, JobStatus.LEASED, JobStatus.QUARANTINED)
    }
    for dialect, jobs in _JOBS_WITH_STATUS.items()
}


def list_jobs(
    connection: Connection,
    *,
    statuses: Sequence[JobStatus] = (),
    campaign: str | None = None,
    after: int = 0,
    limit: int = 100,
) -> list[Job]:
    """Return one page of jobs, ascending by id.

    Args:
        connection: Sees one snapshot.
        statuses: Only jobs with one of these statuses; any status if empty.
        campaign: Only jobs of this campaign.
        after: The last id of the previous page.
        limit: Maximum number of jobs.
    """
    query = select(*_JOB).order_by(JobRow.id).limit(limit)
    if statuses and LISTED_BY_STATUS.issuperset(statuses):
        found = (_ids(connection, status, campaign, after, limit) for status in dict.fromkeys(statuses))
        query = query.where(JobRow.id.in_(sorted(itertools.chain.from_iterable(found))[:limit]))
    else:
        query = query.where(JobRow.id > after)
        if statuses:
            query = query.where(JobRow.status.in_(statuses))
        if campaign is not None:
            query = query.where(JobRow.campaign_id == campaign)
    return [_job(row) for row in connection.execute(query)]


def _ids(
    connection: Connection, status: JobStatus, campaign: str | None, after: int, limit: int
) -> list[int]:
    """Return the ids of the first jobs with the given status, in one campaign or in all."""
    jobs = _JOBS_WITH_STATUS[connection.dialect.name].format(status=status)
    whose = "" if campaign is None else "AND campaigns.id = :campaign"
    statement = text(f"SELECT jobs.id FROM {jobs} AND jobs.id > :after {whose} ORDER BY jobs.id LIMIT :limit")
    given = {"after": after, "limit": limit, **({} if campaign is None else {"campaign": campaign})}
    return list(connection.execute(statement, given).scalars())


def count_jobs(connection: Connection) -> Iterator[JobCount]:
    """Yield the counts of all queued, leased and quarantined jobs."""
    for status, statement in _COUNTS[connection.dialect.name].items():
        for row in connection.execute(statement):
            yield JobCount(
                status=status,
                kind=row.kind,
                needs=row.needs,
                campaign=row.campaign_id,
                name=row.name,
                campaign_status=CampaignStatus(row.campaign_status),
                jobs=row.jobs,
                oldest=row.oldest,
            )


# Every open page runs this every few seconds, and SQLAlchemy takes longer to build it than the database to run it. It
# names the statuses because "other than done" would read all jobs of a campaign.
_UNFINISHED = (
    select(JobRow.status, func.count())
    .where(JobRow.campaign_id.in_(bindparam("campaigns", expanding=True)), IS_EVALUATION)
    .where(JobRow.status.in_([status for status in JobStatus if status is not JobStatus.DONE]))
    .group_by(JobRow.status)
)


def count_unfinished(connection: Connection, *campaigns: str) -> dict[str, int]:
    """Count the evaluations of the given campaigns by status, except those that are done."""
    counts = connection.execute(_UNFINISHED, {"campaigns": campaigns})
    return {str(row[0]): int(row[1]) for row in counts}


def count_by_status(connection: Connection, campaign_statuses: Sequence[CampaignStatus]) -> dict[str, int]:
    """Count the jobs of all campaigns with the given statuses, by job status. Slow: it reads every job."""
    query = (
        select(JobRow.status, func.count())
        .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
        .where(CampaignRow.status.in_(campaign_statuses))
        .group_by(JobRow.status)
    )
    return {str(row[0]): int(row[1]) for row in connection.execute(query)}


def count_retriable(connection: Connection) -> int:
    """Count the quarantined evaluations of running and paused campaigns whose results would still count."""
    solution = and_(SolutionRow.campaign_id == JobRow.campaign_id, SolutionRow.number == JobRow.number)
    query = (
        select(func.count())
        .select_from(JobRow)
        .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
        .join(SolutionRow, solution)
        .where(
            CampaignRow.status.in_([CampaignStatus.RUNNING, CampaignStatus.PAUSED]),
            JobRow.status == JobStatus.QUARANTINED,
            IS_EVALUATION,
            SolutionRow.verdict == SolutionVerdict.PENDING,
        )
    )
    return int(connection.execute(query).scalar_one())


def queued_needs(connection: Connection, campaign_id: str) -> dict[str, int]:
    """Count a campaign's queued jobs by the capability that they need."""
    query = (
        select(JobRow.needs, func.count())
        .where(JobRow.campaign_id == campaign_id, JobRow.status == JobStatus.QUEUED)
        .group_by(JobRow.needs)
    )
    return {str(row[0]): int(row[1]) for row in connection.execute(query)}


def count_leases(connection: Connection, expired_before: datetime) -> tuple[int, int]:
    """Return the number of leases that expired before the given time, and of all leases."""
    overdue = func.count().filter(JobRow.lease_expires_at < expired_before)
    row = connection.execute(select(overdue, func.count()).where(IS_LEASED)).one()
    return int(row[0]), int(row[1])


def next_expiry(connection: Connection) -> datetime | None:
    """Return when the next lease expires, or None if no job is leased."""
    return connection.execute(select(func.min(JobRow.lease_expires_at)).where(IS_LEASED)).scalar_one()


def last_finished_at(connection: Connection, campaign_id: str) -> datetime | None:
    """Return when a campaign's latest finished job finished, or None."""
    query = select(func.max(JobRow.finished_at)).where(JobRow.campaign_id == campaign_id)
    return connection.execute(query).scalar_one()


def delete_some(connection: Connection, campaign_id: str, limit: int) -> int:
    """Delete some jobs of a campaign, with their traces unless another campaign shares these; return how many.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        limit: Maximum number of jobs. It is returned as well if traces were deleted instead, because there are many.
    """
    query = select(JobRow.id, JobRow.spec_hash).where(JobRow.campaign_id == campaign_id).limit(limit)
    rows = connection.execute(query).all()
    hashes = {"hashes": [row.spec_hash for row in rows]}
    others = select(JobRow.id).where(
        JobRow.spec_hash == TraceRow.spec_hash, JobRow.campaign_id != campaign_id
    )
    traced = select(TraceRow.spec_hash).where(in_list(TraceRow.spec_hash, "hashes"), ~others.exists())
    traces = list(connection.execute(traced.limit(TRACES_A_PIECE), hashes).scalars())
    if traces:
        connection.execute(delete(TraceRow).where(in_list(TraceRow.spec_hash, "hashes")), {"hashes": traces})
    if len(traces) == TRACES_A_PIECE:
        return limit
    if rows:
        connection.execute(delete(JobRow).where(in_list(JobRow.id, "ids")), {"ids": [row.id for row in rows]})
    return len(rows)


def delete_traces(connection: Connection, before: datetime, *, dry_run: bool) -> int:
    """Delete old traces; return how many.

    Args:
        connection: In a write transaction.
        before: Traces recorded earlier are deleted.
        dry_run: Only count them.
    """
    old = TraceRow.created_at < before
    count = connection.execute(select(func.count()).select_from(TraceRow).where(old)).scalar_one()
    if not dry_run:
        # A finished job whose trace is gone would prevent the trace from being requested again.
        connection.execute(
            delete(JobRow).where(
                JobRow.kind == JobKind.TRACE,
                JobRow.status == JobStatus.DONE,
                JobRow.spec_hash.in_(select(TraceRow.spec_hash).where(old)),
            )
        )
        connection.execute(delete(TraceRow).where(old))
    return count

"""The SQL of outcomes: results stored, jobs finished, retried, or put into quarantine.

Each public function is a unit for `brink.server.db.writer.Writer`. An outcome is stored and its job finished in one
transaction, only if the lease token that it names still holds the job.
"""

import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta

from sqlalchemy import Connection, bindparam, func, insert, select, update

from brink.server.db.clock import database_now
from brink.server.db.locking import locked
from brink.server.db.many import UpdateEach, among
from brink.server.db.models import IS_LEASED, CampaignRow, JobRow, TraceRow, has_open_jobs
from brink.server.db.types import UtcDateTime
from brink.server.queue.values import JobRecord, LeaseTerms, Loss, Outcome, Report
from brink.server.states import CampaignStatus, JobStatus

MAX_ERROR_CHARACTERS = 4000
MAX_BACKOFF_S = 300.0
MAX_EXPIRED = 1000
"""Leases that one sweep takes back: when all run out at once, nobody waits long for the writer."""

# Built once: making a statement costs more than running it.
_REPORTED = select(
    JobRow.id, JobRow.campaign_id, JobRow.kind, JobRow.status, JobRow.lease_token,
    JobRow.lease_worker, JobRow.attempt, JobRow.max_attempts, JobRow.spec_hash, JobRow.cache,
).where(among(JobRow.id, "jobs"))  # fmt: skip
_REPORTED_IN_ORDER = _REPORTED.add_columns(func.clock_timestamp(type_=UtcDateTime).label("now")).order_by(
    JobRow.id
)
"""Where rows are locked, so that coordinators do not wait for one another in a circle; SQLite would read all jobs.

With the time, which is a question less.
"""
_FINISH = UpdateEach(
    JobRow.id, [JobRow.result], status=JobStatus.DONE, finished_at=bindparam("now"), lease_expires_at=None
)
_TWINS = (
    select(JobRow.id, JobRow.spec_hash, JobRow.kind, JobRow.campaign_id)
    .where(
        among(JobRow.spec_hash, "spec_hashes"),
        JobRow.status == JobStatus.QUEUED,
        JobRow.cache,
    )
    .order_by(JobRow.id)
)
_IDLE = select(CampaignRow.id).where(
    among(CampaignRow.id, "campaigns"),
    CampaignRow.status == CampaignStatus.RUNNING,
    ~has_open_jobs(CampaignRow.id),
)
_RAN_OUT = (
    select(JobRow.id, JobRow.campaign_id, JobRow.attempt, JobRow.max_attempts, JobRow.lease_worker)
    .where(IS_LEASED, JobRow.lease_expires_at < bindparam("now"))
    .order_by(JobRow.lease_expires_at)
    .limit(bindparam("most"))
)
_FORGET_TOKENS = update(JobRow).where(among(JobRow.id, "jobs")).values(lease_token=None)


def report(connection: Connection, outcomes: Sequence[Outcome], terms: LeaseTerms) -> Report:
    """Store outcomes of jobs whose lease still holds; everything else changes nothing."""
    taken, _ = take_in(connection, outcomes, terms)
    return replace(taken, campaigns=idle_campaigns(connection, taken.campaigns))


def take_in(
    connection: Connection, outcomes: Sequence[Outcome], terms: LeaseTerms
) -> tuple[Report, datetime]:
    """Store outcomes as `report` does.

    Returns:
        The report, with all campaigns that they have to do with, idle or not; and the database's time.
    """
    if not outcomes:
        return Report(statuses=(), campaigns=()), database_now(connection)
    known = {"jobs": sorted({outcome.job for outcome in outcomes})}
    if connection.dialect.name == "sqlite":
        found = connection.execute(_REPORTED, known).all()
        now = database_now(connection)
    else:
        found = connection.execute(locked(_REPORTED_IN_ORDER, connection, JobRow), known).all()
        now = found[0].now if found else database_now(connection)
    rows: dict[int, JobRecord] = {row.id: row for row in found}
    statuses: list[str] = []
    accepted: dict[int, Outcome] = {}
    for outcome in outcomes:
        status = _judge(rows.get(outcome.job), outcome, outcome.job in accepted)
        statuses.append(status)
        if status == "accepted":
            accepted[outcome.job] = outcome
    done = {job: outcome.result for job, outcome in accepted.items() if outcome.result is not None}
    _finish(connection, done, now)
    _keep_traces(connection, {rows[o.job].spec_hash: o.trace for o in accepted.values() if o.trace}, now)
    sharing = _share(connection, [rows[job] for job in done if rows[job].cache], done, now)
    losses = _fail(
        connection,
        [(rows[job], o) for job, o in accepted.items() if o.result is None],
        now,
        terms.retry_backoff_s,
    )
    touched = {rows[job].campaign_id for job in accepted} | sharing
    taken = Report(
        statuses=tuple(statuses),
        campaigns=tuple(sorted(touched)),
        owners={job: row.campaign_id for job, row in rows.items()},
        quarantined=tuple(loss for loss in losses if loss.final),
    )
    return taken, now


def expire(connection: Connection, terms: LeaseTerms) -> tuple[tuple[str, ...], list[Loss]]:
    """Take back leases that ran out, the oldest `MAX_EXPIRED`: to the queue after a backoff, or into quarantine.

    Returns:
        The campaigns that have no open episode left because of it, and the leases that ran out.
    """
    now = database_now(connection)
    ran_out = locked(_RAN_OUT, connection, JobRow, skip_locked=True)
    rows = connection.execute(ran_out, {"now": now, "most": MAX_EXPIRED}).all()
    if not rows:
        return (), []
    failures = [
        (
            row,
            Outcome(
                job=row.id, token="", result=None,
                error=f"lease ran out: worker {row.lease_worker} was not heard of any more",
            ),
        )
        for row in rows
    ]  # fmt: skip
    losses = _fail(connection, failures, now, terms.retry_backoff_s)
    # Nothing was reported: whatever comes with these tokens from now on is late, and must not pass for stored.
    connection.execute(_FORGET_TOKENS, {"jobs": [row.id for row in rows]})
    return idle_campaigns(connection, {row.campaign_id for row in rows}), losses


def idle_campaigns(connection: Connection, campaigns: Iterable[str]) -> tuple[str, ...]:
    """Return which of these campaigns have no open episode."""
    names = list(campaigns)
    if not names:
        return ()
    return tuple(sorted(connection.execute(_IDLE, {"campaigns": names}).scalars()))


def _judge(row: JobRecord | None, outcome: Outcome, reported_before: bool) -> str:
    if row is None or row.lease_token is None:
        return "stale"
    if not secrets.compare_digest(row.lease_token, outcome.token):
        return "stale"
    if row.status == JobStatus.LEASED and not reported_before:
        return "accepted"
    return "duplicate"


def _finish(connection: Connection, done: Mapping[int, str], now: datetime) -> None:
    _FINISH.run(connection, list(done.items()), {"now": now})


def _keep_traces(connection: Connection, traces: Mapping[str, bytes], now: datetime) -> None:
    if not traces:
        return
    known = set(
        connection.execute(select(TraceRow.spec_hash).where(TraceRow.spec_hash.in_(list(traces)))).scalars()
    )
    fresh = [
        {"spec_hash": spec_hash, "data": data, "created_at": now}
        for spec_hash, data in traces.items()
        if spec_hash not in known
    ]
    if fresh:
        connection.execute(insert(TraceRow), fresh)


def _share(
    connection: Connection, rows: Sequence[JobRecord], done: Mapping[int, str], now: datetime
) -> set[str]:
    """Finish queued jobs of the same simulation with the result that just came in; return their campaigns."""
    if not rows:
        return set()
    results = {(row.spec_hash, row.kind): done[row.id] for row in rows}
    wanted = {"spec_hashes": [row.spec_hash for row in rows]}
    twins = [twin for twin in connection.execute(_TWINS, wanted) if (twin.spec_hash, twin.kind) in results]
    _finish(connection, {twin.id: results[twin.spec_hash, twin.kind] for twin in twins}, now)
    return {twin.campaign_id for twin in twins}


def _fail(
    connection: Connection,
    failures: Sequence[tuple[JobRecord, Outcome]],
    now: datetime,
    backoff_s: float,
) -> list[Loss]:
    """Put failed jobs back after a backoff, or into quarantine."""
    if not failures:
        return []
    values, losses = [], []
    for row, outcome in failures:
        retry = not outcome.final and row.attempt < row.max_attempts
        wait_s = min(MAX_BACKOFF_S, backoff_s * 2 ** (row.attempt - 1))
        values.append(
            {
                "failed": row.id,
                "by": row.lease_worker,
                "next_status": JobStatus.QUEUED if retry else JobStatus.QUARANTINED,
                "wait_until": now + timedelta(seconds=wait_s) if retry else None,
                "error": outcome.error[-MAX_ERROR_CHARACTERS:],
                "ended": None if retry else now,
            }
        )
        losses.append(
            Loss(
                job=row.id, campaign=row.campaign_id, worker=row.lease_worker, attempt=row.attempt,
                reason=outcome.error, final=not retry,
            )
        )  # fmt: skip
    connection.execute(
        update(JobRow)
        .where(JobRow.id == bindparam("failed"))
        .values(
            status=bindparam("next_status"),
            not_before=bindparam("wait_until"),
            failed_worker=bindparam("by"),
            last_error=bindparam("error"),
            finished_at=bindparam("ended"),
            lease_expires_at=None,  # the token stays, so that the same report sent again is known
        ),
        values,
    )
    return losses

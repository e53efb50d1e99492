"""The queue's SQL: every statement that leases, renews, finishes or gives back a job.

Each function is a unit for `server.db.writer.Writer`: it takes a connection in a write transaction. A lease is
held by its token alone: whoever does not name the token of the row changes nothing. The database's clock decides
when a lease ends.
"""

import json
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, TypeAlias

from sqlalchemy import Connection, Row, Select, bindparam, exists, func, insert, or_, select, update
from sqlalchemy.orm import aliased

from server.db.clock import database_now
from server.db.models import CampaignRow, CampaignStatus, JobKind, JobRow, JobStatus, TraceRow
from worker.wire import HeldLease, LeasedJob

MAX_ERROR_CHARACTERS = 4000
MAX_BACKOFF_S = 300.0

JobRecord: TypeAlias = Row[*tuple[Any, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseTerms:
    """How leases are granted.

    Attributes:
        lease_s: How long a lease holds.
        retry_backoff_s: Wait before the first retry; doubles each time.
        live_workers: Workers that share the queue now, at least 1.
    """

    lease_s: float
    retry_backoff_s: float
    live_workers: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a worker reports of one job.

    Attributes:
        result: The completed episode as JSON text, without its trace, or None if it failed.
        trace: The trace, if there is one.
        error: Why it failed.
        final: Whether trying again is pointless.
    """

    job: int
    token: str
    result: str | None
    trace: bytes | None = None
    error: str = ""
    final: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What became of reported outcomes.

    Attributes:
        statuses: ``accepted``, ``duplicate`` or ``stale``, in the order of the outcomes.
        campaigns: Campaigns that have no open episode left because of them.
        requeued: Whether a job went back to the queue.
    """

    statuses: tuple[str, ...]
    campaigns: tuple[str, ...]
    requeued: bool


def lease(
    connection: Connection, worker: str, capabilities: Sequence[str], max_jobs: int, terms: LeaseTerms
) -> list[LeasedJob]:
    """Grant up to `max_jobs` jobs to a worker.

    Traces come first: somebody is waiting for a picture. Episodes are taken from the running campaigns by priority,
    then in turn. The closer the queue is to its end, the smaller the grant, so that a generation's last jobs spread
    over all workers. A job that was tried before is granted alone, to a worker that holds nothing else: if it kills
    its worker, nobody is buried with it.
    """
    now = database_now(connection)
    held, holds_retry = _holdings(connection, worker)
    if holds_retry:
        return []
    allowed = min(max_jobs, _fair_share(connection, terms.live_workers, max_jobs))
    rows = _pick_fresh(connection, capabilities, allowed, now)
    if not rows and not held:
        rows = _pick_retry(connection, capabilities, now)
    return _grant(connection, rows, worker, now, terms.lease_s)


def renew(connection: Connection, leases: Iterable[HeldLease], lease_s: float) -> list[int]:
    """Renew leases and return the jobs that are still held."""
    wanted = {held.job: held.token for held in leases}
    rows = connection.execute(
        _locked(
            select(JobRow.id, JobRow.lease_token).where(
                JobRow.id.in_(wanted), JobRow.status == JobStatus.LEASED
            ),
            connection,
        )
    ).all()
    held = [row.id for row in rows if secrets.compare_digest(row.lease_token, wanted[row.id])]
    if held:
        expires = database_now(connection) + timedelta(seconds=lease_s)
        connection.execute(update(JobRow).where(JobRow.id.in_(held)).values(lease_expires_at=expires))
    return sorted(held)


def release(connection: Connection, leases: Iterable[HeldLease]) -> int:
    """Put leased jobs back unrun, without a charge to their attempts; return how many."""
    given_back = 0
    for held in leases:
        changed = connection.execute(
            update(JobRow)
            .where(JobRow.id == held.job, JobRow.status == JobStatus.LEASED, JobRow.lease_token == held.token)
            .values(
                status=JobStatus.QUEUED,
                attempt=JobRow.attempt - 1,
                lease_token=None,
                lease_worker=None,
                lease_expires_at=None,
            )
        )
        given_back += changed.rowcount
    return given_back


def report(connection: Connection, outcomes: Sequence[Outcome], terms: LeaseTerms) -> Report:
    """Store outcomes of jobs whose lease still holds; everything else changes nothing."""
    now = database_now(connection)
    rows = {
        row.id: row
        for row in connection.execute(
            _locked(
                select(
                    JobRow.id, JobRow.campaign_id, JobRow.kind, JobRow.status, JobRow.lease_token,
                    JobRow.attempt, JobRow.max_attempts, JobRow.spec_hash, JobRow.cache,
                ).where(JobRow.id.in_([outcome.job for outcome in outcomes])),
                connection,
            )
        )
    }  # fmt: skip
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
    _share(connection, [rows[job] for job in done if rows[job].cache], done, now)
    requeued = _fail(
        connection,
        [(rows[job], o) for job, o in accepted.items() if o.result is None],
        now,
        terms.retry_backoff_s,
    )
    touched = {rows[job].campaign_id for job in accepted} | _campaigns_sharing(connection, rows, done)
    return Report(statuses=tuple(statuses), campaigns=idle_campaigns(connection, touched), requeued=requeued)


def expire(connection: Connection, terms: LeaseTerms) -> tuple[tuple[str, ...], int]:
    """Take back leases that ran out: to the queue after a backoff, or into quarantine.

    Returns:
        The campaigns that have no open episode left because of it, and how many leases ran out.
    """
    now = database_now(connection)
    rows = connection.execute(
        _locked(
            select(
                JobRow.id, JobRow.campaign_id, JobRow.attempt, JobRow.max_attempts, JobRow.lease_worker
            ).where(JobRow.status == JobStatus.LEASED, JobRow.lease_expires_at < now),
            connection,
            skip_locked=True,
        )
    ).all()
    if not rows:
        return (), 0
    losses = [
        (
            row,
            Outcome(
                job=row.id, token="", result=None,
                error=f"lease ran out: worker {row.lease_worker} was not heard of any more",
            ),
        )
        for row in rows
    ]  # fmt: skip
    _fail(connection, losses, now, terms.retry_backoff_s)
    return idle_campaigns(connection, {row.campaign_id for row in rows}), len(rows)


def idle_campaigns(connection: Connection, campaigns: Iterable[str]) -> tuple[str, ...]:
    """Return which of these campaigns have no open episode."""
    names = list(campaigns)
    if not names:
        return ()
    busy = select(JobRow.id).where(
        JobRow.campaign_id == CampaignRow.id,
        JobRow.kind == JobKind.EPISODE,
        JobRow.status.in_([JobStatus.QUEUED, JobStatus.LEASED]),
    )
    query = select(CampaignRow.id).where(
        CampaignRow.id.in_(names), CampaignRow.status == CampaignStatus.RUNNING, ~exists(busy)
    )
    return tuple(sorted(connection.execute(query).scalars()))


def _holdings(connection: Connection, worker: str) -> tuple[int, bool]:
    attempts = (
        connection.execute(
            select(JobRow.attempt).where(JobRow.status == JobStatus.LEASED, JobRow.lease_worker == worker)
        )
        .scalars()
        .all()
    )
    return len(attempts), any(attempt > 1 for attempt in attempts)


def _fair_share(connection: Connection, live_workers: int, max_jobs: int) -> int:
    """Return half of an equal share of what is queued: large grants first, single jobs at the end."""
    enough = 2 * live_workers * max_jobs
    running = select(CampaignRow.id).where(CampaignRow.status == CampaignStatus.RUNNING)
    queued = (
        select(JobRow.id)
        .where(JobRow.status == JobStatus.QUEUED, JobRow.campaign_id.in_(running))
        .limit(enough)
        .subquery()
    )
    waiting = connection.execute(select(func.count()).select_from(queued)).scalar_one()
    return max(1, -(-waiting // (2 * live_workers)))


def _eligible(capabilities: Sequence[str], now: datetime) -> Select[*tuple[Any, ...]]:
    """Return the queued jobs that a worker could run now, whose simulation nobody runs already."""
    twin = aliased(JobRow)
    running = select(twin.id).where(
        twin.spec_hash == JobRow.spec_hash, twin.kind == JobRow.kind, twin.status == JobStatus.LEASED
    )
    return select(JobRow).where(
        JobRow.status == JobStatus.QUEUED,
        JobRow.needs.in_(list(capabilities)),
        or_(JobRow.not_before.is_(None), JobRow.not_before <= now),
        ~(exists(running) & JobRow.cache),
    )


_GRANTED = (
    JobRow.id, JobRow.campaign_id, JobRow.kind, JobRow.spec, JobRow.spec_hash,
    JobRow.attempt, JobRow.timeout_s, JobRow.cache,
)  # fmt: skip


def _pick_fresh(
    connection: Connection, capabilities: Sequence[str], limit: int, now: datetime
) -> list[JobRecord]:
    fresh = _eligible(capabilities, now).with_only_columns(*_GRANTED).where(JobRow.attempt == 0)
    traces = fresh.where(JobRow.kind == JobKind.TRACE).order_by(JobRow.id).limit(limit)
    rows = list(connection.execute(_locked(traces, connection, skip_locked=True)))
    remaining = _campaigns_in_turn(connection, capabilities, now)
    while remaining and len(rows) < limit:
        campaign, priority = remaining.pop(0)
        peers = 1 + sum(1 for _, other in remaining if other == priority)
        share = -(-(limit - len(rows)) // peers)
        query = (
            fresh.where(JobRow.kind == JobKind.EPISODE, JobRow.campaign_id == campaign)
            .order_by(JobRow.id)
            .limit(share)
        )
        rows += connection.execute(_locked(query, connection, skip_locked=True)).all()
    return _without_twins(rows)


def _pick_retry(connection: Connection, capabilities: Sequence[str], now: datetime) -> list[JobRecord]:
    query = (
        _eligible(capabilities, now)
        .with_only_columns(*_GRANTED)
        .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
        .where(
            JobRow.attempt > 0,
            or_(JobRow.kind == JobKind.TRACE, CampaignRow.status == CampaignStatus.RUNNING),
        )
        .order_by(CampaignRow.priority.desc(), JobRow.not_before, JobRow.id)
        .limit(1)
    )
    return list(connection.execute(_locked(query, connection, skip_locked=True)))


def _campaigns_in_turn(
    connection: Connection, capabilities: Sequence[str], now: datetime
) -> list[tuple[str, int]]:
    """Return running campaigns with jobs for this worker: by priority, then whose turn is longest ago."""
    waiting = (
        _eligible(capabilities, now)
        .with_only_columns(JobRow.id)
        .where(JobRow.campaign_id == CampaignRow.id, JobRow.kind == JobKind.EPISODE, JobRow.attempt == 0)
        .correlate(CampaignRow)
    )
    query = (
        select(CampaignRow.id, CampaignRow.priority)
        .where(CampaignRow.status == CampaignStatus.RUNNING, exists(waiting))
        .order_by(CampaignRow.priority.desc(), CampaignRow.turn, CampaignRow.id)
    )
    return [(row.id, row.priority) for row in connection.execute(query)]


def _without_twins(rows: list[JobRecord]) -> list[JobRecord]:
    """Keep one job of each simulation: the others take over its result."""
    seen: set[str] = set()
    kept = []
    for row in rows:
        if row.cache and row.spec_hash in seen:
            continue
        seen.add(row.spec_hash)
        kept.append(row)
    return kept


def _grant(
    connection: Connection, rows: list[JobRecord], worker: str, now: datetime, lease_s: float
) -> list[LeasedJob]:
    if not rows:
        return []
    expires = now + timedelta(seconds=lease_s)
    granted = [
        LeasedJob(
            job=row.id,
            token=secrets.token_hex(16),
            attempt=row.attempt + 1,
            spec=json.loads(row.spec),
            record=row.kind == JobKind.TRACE,
            timeout_s=row.timeout_s,
        )
        for row in rows
    ]
    connection.execute(
        update(JobRow)
        .where(JobRow.id == bindparam("granted"))
        .values(
            status=JobStatus.LEASED,
            attempt=JobRow.attempt + 1,
            lease_token=bindparam("token"),
            lease_worker=worker,
            lease_expires_at=expires,
            not_before=None,
        ),
        [{"granted": job.job, "token": job.token} for job in granted],
    )
    served = sorted({row.campaign_id for row in rows})
    latest = select(func.coalesce(func.max(CampaignRow.turn), 0) + 1).scalar_subquery()
    turn = connection.execute(select(latest)).scalar_one()
    connection.execute(update(CampaignRow).where(CampaignRow.id.in_(served)).values(turn=turn))
    return granted


def _judge(row: JobRecord | None, outcome: Outcome, reported_before: bool) -> str:
    if row is None or row.lease_token is None:
        return "stale"
    if not secrets.compare_digest(row.lease_token, outcome.token):
        return "stale"
    if row.status == JobStatus.LEASED and not reported_before:
        return "accepted"
    return "duplicate"


def _finish(connection: Connection, done: Mapping[int, str], now: datetime) -> None:
    if not done:
        return
    connection.execute(
        update(JobRow)
        .where(JobRow.id == bindparam("finished"))
        .values(status=JobStatus.DONE, result=bindparam("outcome"), finished_at=now, lease_expires_at=None),
        [{"finished": job, "outcome": result} for job, result in done.items()],
    )


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


def _share(connection: Connection, rows: Sequence[JobRecord], done: Mapping[int, str], now: datetime) -> None:
    """Finish queued jobs of the same simulation with the result that just came in."""
    if not rows:
        return
    twins = connection.execute(
        select(JobRow.id, JobRow.spec_hash, JobRow.kind).where(
            JobRow.spec_hash.in_([row.spec_hash for row in rows]),
            JobRow.status == JobStatus.QUEUED,
            JobRow.cache,
        )
    ).all()
    results = {(row.spec_hash, row.kind): done[row.id] for row in rows}
    shared = {
        twin.id: results[twin.spec_hash, twin.kind]
        for twin in twins
        if (twin.spec_hash, twin.kind) in results
    }
    _finish(connection, shared, now)


def _campaigns_sharing(
    connection: Connection, rows: Mapping[int, JobRecord], done: Mapping[int, str]
) -> set[str]:
    hashes = [rows[job].spec_hash for job in done if rows[job].cache]
    if not hashes:
        return set()
    return set(
        connection.execute(
            select(JobRow.campaign_id).where(JobRow.spec_hash.in_(hashes)).distinct()
        ).scalars()
    )


def _fail(
    connection: Connection,
    failures: Sequence[tuple[JobRecord, Outcome]],
    now: datetime,
    backoff_s: float,
) -> bool:
    """Put failed jobs back after a backoff, or into quarantine; return whether any went back."""
    if not failures:
        return False
    requeued = False
    values = []
    for row, outcome in failures:
        retry = not outcome.final and row.attempt < row.max_attempts
        requeued |= retry
        wait_s = min(MAX_BACKOFF_S, backoff_s * 2 ** (row.attempt - 1))
        values.append(
            {
                "failed": row.id,
                "next_status": JobStatus.QUEUED if retry else JobStatus.QUARANTINED,
                "wait_until": now + timedelta(seconds=wait_s) if retry else None,
                "error": outcome.error[-MAX_ERROR_CHARACTERS:],
                "ended": None if retry else now,
            }
        )
    connection.execute(
        update(JobRow)
        .where(JobRow.id == bindparam("failed"))
        .values(
            status=bindparam("next_status"),
            not_before=bindparam("wait_until"),
            last_error=bindparam("error"),
            finished_at=bindparam("ended"),
            lease_expires_at=None,  # the token stays, so that the same report sent again is known
        ),
        values,
    )
    return requeued


def _locked(
    query: Select[*tuple[Any, ...]], connection: Connection, *, skip_locked: bool = False
) -> Select[*tuple[Any, ...]]:
    """Lock the selected jobs on databases with row locks; SQLite's writer holds the only write lock already."""
    if connection.dialect.name == "sqlite":
        return query
    return query.with_for_update(of=JobRow, skip_locked=skip_locked)

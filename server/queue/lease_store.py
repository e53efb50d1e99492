"""The SQL of leases: who gets which jobs, and for how long.

Each public function is a unit for `server.db.writer.Writer`: it takes a connection in a write transaction. A lease
is held by its token alone: whoever does not name the token of the row changes nothing. The database's clock decides
when a lease ends.
"""

import json
import secrets
from collections.abc import Iterable, Sequence
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Connection, Select, bindparam, exists, func, or_, select, update
from sqlalchemy.orm import aliased

from server.db.clock import database_now
from server.db.locking import locked
from server.db.models import CampaignRow, CampaignStatus, JobKind, JobRow, JobStatus
from server.queue.values import JobRecord, LeaseTerms
from worker.wire import HeldLease, LeasedJob

_GRANTED = (
    JobRow.id, JobRow.campaign_id, JobRow.kind, JobRow.spec, JobRow.spec_hash,
    JobRow.attempt, JobRow.timeout_s, JobRow.cache,
)  # fmt: skip


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
        locked(
            select(JobRow.id, JobRow.lease_token).where(
                JobRow.id.in_(wanted), JobRow.status == JobStatus.LEASED
            ),
            connection,
            JobRow,
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


def _pick_fresh(
    connection: Connection, capabilities: Sequence[str], limit: int, now: datetime
) -> list[JobRecord]:
    fresh = _eligible(capabilities, now).with_only_columns(*_GRANTED).where(JobRow.attempt == 0)
    traces = fresh.where(JobRow.kind == JobKind.TRACE).order_by(JobRow.id).limit(limit)
    rows = list(connection.execute(locked(traces, connection, JobRow, skip_locked=True)))
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
        rows += connection.execute(locked(query, connection, JobRow, skip_locked=True)).all()
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
    return list(connection.execute(locked(query, connection, JobRow, skip_locked=True)))


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

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

from sqlalchemy import Connection, Select, bindparam, exists, func, literal, or_, select, update

from server.db.clock import database_now
from server.db.locking import locked
from server.db.models import EVALUATES, CampaignRow, CampaignStatus, JobKind, JobRow, JobStatus
from server.queue.values import JobRecord, LeaseTerms
from worker.wire import HeldLease, LeasedJob

# Spelled out in the SQL: Postgres' plans for prepared statements do not know the values of parameters, and could not
# use the indexes that hold queued or leased jobs alone.
_IS_QUEUED = JobRow.status == literal(JobStatus.QUEUED, literal_execute=True)
_IS_TRACE = JobRow.kind == literal(JobKind.TRACE, literal_execute=True)
_IS_LEASED = JobRow.status == literal(JobStatus.LEASED, literal_execute=True)
_WAS_TRIED = JobRow.attempt > literal(0, literal_execute=True)
_TWIN = JobRow.__table__.alias("twin")
_SOMEBODY_RUNS_IT = exists(
    select(_TWIN.c.id).where(
        _TWIN.c.spec_hash == JobRow.spec_hash, _TWIN.c.kind == JobRow.kind, _TWIN.c.status == JobStatus.LEASED
    )
)
_DUE = or_(JobRow.not_before.is_(None), JobRow.not_before <= bindparam("now"))
_ELIGIBLE = (
    _IS_QUEUED,
    JobRow.needs.in_(bindparam("capabilities", expanding=True)),
    _DUE,
    ~(_SOMEBODY_RUNS_IT & JobRow.cache),
)
"""A worker with these capabilities could run it now, and nobody runs the same simulation already."""

_GRANTED = (
    JobRow.id, JobRow.campaign_id, JobRow.kind, JobRow.spec, JobRow.spec_hash,
    JobRow.attempt, JobRow.timeout_s, JobRow.cache,
)  # fmt: skip

# Built once: making a statement costs more than running it.
_HOLDINGS = select(JobRow.attempt).where(_IS_LEASED, JobRow.lease_worker == bindparam("worker"))
_WAITING = select(
    select(func.count())
    .select_from(
        select(JobRow.id)
        .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
        .where(_IS_QUEUED, EVALUATES, CampaignRow.status == CampaignStatus.RUNNING)
        .limit(bindparam("enough"))
        .subquery()
    )
    .scalar_subquery()
    .label("jobs"),
    exists(select(JobRow.id).where(_IS_QUEUED, _IS_TRACE)).label("traces"),
    exists(select(JobRow.id).where(_IS_QUEUED, _WAS_TRIED, _DUE)).label("retries"),
)
_FRESH = select(*_GRANTED).where(*_ELIGIBLE, JobRow.attempt == 0)
_FRESH_TRACES = _FRESH.where(_IS_TRACE).order_by(JobRow.id).limit(bindparam("most"))
_FRESH_WORK = (
    _FRESH.where(EVALUATES, JobRow.campaign_id == bindparam("campaign"))
    .order_by(JobRow.id)
    .limit(bindparam("most"))
)
_RETRY = (
    select(*_GRANTED, CampaignRow.priority)
    .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
    .where(
        *_ELIGIBLE,
        _WAS_TRIED,
        or_(
            JobRow.failed_worker.is_(None),
            JobRow.failed_worker != bindparam("worker"),
            JobRow.needs.not_in(bindparam("elsewhere", expanding=True)),
        ),
        or_(_IS_TRACE, CampaignRow.status == CampaignStatus.RUNNING),
    )
    .order_by(_IS_TRACE.desc(), CampaignRow.priority.desc(), JobRow.not_before, JobRow.id)
    .limit(1)
)
_CAMPAIGNS_IN_TURN = (
    select(CampaignRow.id, CampaignRow.priority)
    .where(
        CampaignRow.status == CampaignStatus.RUNNING,
        exists(
            select(JobRow.id)
            .where(
                *_ELIGIBLE,
                JobRow.campaign_id == CampaignRow.id,
                EVALUATES,
                JobRow.attempt == 0,
            )
            .correlate(CampaignRow)
        ),
    )
    .order_by(CampaignRow.priority.desc(), CampaignRow.turn, CampaignRow.id)
)
_EVERY_CAMPAIGN = CampaignRow.__table__.alias("every_campaign")
_GRANT = (
    update(JobRow)
    .where(JobRow.id == bindparam("granted"))
    .values(
        status=JobStatus.LEASED,
        attempt=JobRow.attempt + 1,
        lease_token=bindparam("token"),
        lease_worker=bindparam("worker"),
        lease_expires_at=bindparam("expires"),
        not_before=None,
    )
)
_TAKE_TURN = (
    update(CampaignRow)
    .where(
        CampaignRow.id.in_(
            # A campaign that somebody else is writing keeps its turn: coordinators that waited for one another here,
            # each with several campaigns in one commit, would deadlock. SQLite knows no row locks and leaves it out.
            select(CampaignRow.id)
            .where(CampaignRow.id.in_(bindparam("served", expanding=True)))
            .with_for_update(key_share=True, skip_locked=True)
            .scalar_subquery()
        )
    )
    .values(turn=select(func.coalesce(func.max(_EVERY_CAMPAIGN.c.turn), 0) + 1).scalar_subquery())
)


def lease(
    connection: Connection, worker: str, capabilities: Sequence[str], max_jobs: int, terms: LeaseTerms
) -> list[LeasedJob]:
    """Grant up to `max_jobs` jobs to a worker.

    Traces come first: somebody is waiting for a picture. Episodes are taken from the running campaigns by priority,
    then in turn. The closer the queue is to its end, the smaller the grant, so that a generation's last jobs spread
    over all workers.

    A job that was tried before is granted alone, to a worker that holds nothing else: if it kills its worker, nobody
    is buried with it. It is not granted to the worker that failed it last as long as another one can run it: the
    fault may be the worker's. Once its backoff is over it goes before fresh jobs of its own priority and of lower
    ones; and as workers fetch ahead, whoever could take it but still holds jobs gets no fresh ones, so that somebody
    comes with empty hands soon.
    """
    now = database_now(connection)
    held, holds_retry = _holdings(connection, worker)
    if holds_retry:
        return []
    enough = terms.live_workers * (max_jobs + 1) * 3 // 2
    waiting = connection.execute(_WAITING, {"enough": enough, "now": now}).one()
    known = {"capabilities": list(capabilities), "now": now}
    rows: list[JobRecord] = []
    if waiting.retries:
        mine = {**known, "worker": worker, "elsewhere": list(terms.elsewhere)}
        retry = connection.execute(_RETRY, mine).first()
        if retry is not None and _goes_first(connection, retry, known, traces=waiting.traces):
            if held:
                return []
            rows = _locked_rows(connection, _RETRY, mine)  # none if another coordinator is just granting it
    if not rows:
        limit = min(max_jobs, _fair_share(waiting.jobs, terms.live_workers))
        rows = _pick_fresh(connection, known, limit, traces=waiting.traces)
    return _grant(connection, rows, worker, now, terms.lease_s)


def renew(connection: Connection, leases: Iterable[HeldLease], lease_s: float) -> list[int]:
    """Renew leases and return the jobs that are still held."""
    wanted = {held.job: held.token for held in leases}
    rows = connection.execute(
        locked(
            select(JobRow.id, JobRow.lease_token)
            .where(JobRow.id.in_(wanted), JobRow.status == JobStatus.LEASED)
            .order_by(JobRow.id),
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


def cut_short(connection: Connection, leases: Iterable[HeldLease]) -> None:
    """Let leases run out now, for workers that are known to be dead."""
    past = database_now(connection) - timedelta(seconds=1)
    for held in leases:
        connection.execute(
            update(JobRow)
            .where(JobRow.id == held.job, JobRow.status == JobStatus.LEASED, JobRow.lease_token == held.token)
            .values(lease_expires_at=past)
        )


def _holdings(connection: Connection, worker: str) -> tuple[int, bool]:
    attempts = connection.execute(_HOLDINGS, {"worker": worker}).scalars().all()
    return len(attempts), any(attempt > 1 for attempt in attempts)


def _fair_share(waiting: int, live_workers: int) -> int:
    """Return two thirds of an equal share of what is queued: large grants first, single jobs at the end.

    Half would need a fifth more requests and gain nothing; all of it lets the slowest worker keep the others waiting.
    """
    return max(1, -(-2 * waiting // (3 * live_workers)))


def _goes_first(connection: Connection, retry: JobRecord, known: dict[str, Any], *, traces: bool) -> bool:
    """Return whether a job that was tried before goes before all fresh ones that the worker could have."""
    if retry.kind == JobKind.TRACE:
        return True
    if traces and connection.execute(_FRESH_TRACES, {**known, "most": 1}).first() is not None:
        return False
    best = connection.execute(_CAMPAIGNS_IN_TURN, known).first()
    return best is None or retry.priority >= best.priority


def _pick_fresh(
    connection: Connection, known: dict[str, Any], limit: int, *, traces: bool
) -> list[JobRecord]:
    rows = _locked_rows(connection, _FRESH_TRACES, {**known, "most": limit}) if traces else []
    campaigns = connection.execute(_CAMPAIGNS_IN_TURN, known).all() if len(rows) < limit else []
    for place, (campaign, priority) in enumerate(campaigns):
        if len(rows) >= limit:
            break
        peers = sum(other.priority == priority for other in campaigns[place:])
        share = -(-(limit - len(rows)) // peers)
        rows += _locked_rows(connection, _FRESH_WORK, {**known, "campaign": campaign, "most": share})
    return _without_twins(rows)


def _locked_rows(
    connection: Connection, query: Select[*tuple[Any, ...]], values: dict[str, Any]
) -> list[JobRecord]:
    return list(connection.execute(locked(query, connection, JobRow, skip_locked=True), values))


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
            campaign=row.campaign_id,
        )
        for row in rows
    ]
    connection.execute(
        _GRANT,
        [{"granted": job.job, "token": job.token, "worker": worker, "expires": expires} for job in granted],
    )
    connection.execute(_TAKE_TURN, {"served": sorted({row.campaign_id for row in rows})})
    return granted

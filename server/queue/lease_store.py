"""The SQL of leases: granted as `lease_policy` decides, renewed, given back, ended.

Each public function is a unit for `brink.server.db.writer.Writer`. The database's clock decides when a lease ends,
and a lease can only be changed by naming its token.
"""

import json
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, cast

from sqlalchemy import (
    Connection,
    Label,
    Row,
    Select,
    bindparam,
    exists,
    func,
    literal,
    or_,
    select,
    text,
    update,
)

from brink.server.db.models import LAST_TURN, CampaignRow, JobRow
from brink.server.db.sql import BulkUpdate, database_now, in_list, lock_rows
from brink.server.queue import lease_policy
from brink.server.queue.job_store import IS_EVALUATION, IS_LEASED
from brink.server.queue.lease_policy import NEW_TURN, Backlog, CampaignTurn, LeaseDemand, QueuedJob, Retry
from brink.server.states import CampaignStatus, JobKind, JobStatus
from brink.worker.wire import HeldLease, LeasedJob

MOST_WOKEN = 10_000
"""Due retries are counted up to this number; more workers than this rarely wait at one coordinator."""

# Statuses and kinds are literals, as in `job_store`, and statements are built once: building one takes longer than
# running it.
_IS_QUEUED = JobRow.status == literal(JobStatus.QUEUED, literal_execute=True)
_IS_TRACE = JobRow.kind == literal(JobKind.TRACE, literal_execute=True)
_WAS_TRIED = JobRow.attempt > literal(0, literal_execute=True)
_CAMPAIGN_ALLOWS_IT = or_(_IS_TRACE, CampaignRow.status == CampaignStatus.RUNNING)
_TWIN = JobRow.__table__.alias("twin")
_TWIN_RUNS = exists(
    select(_TWIN.c.id)
    .where(
        _TWIN.c.spec_hash == JobRow.spec_hash, _TWIN.c.kind == JobRow.kind, _TWIN.c.status == JobStatus.LEASED
    )
    .offset(0)  # forces one lookup for each job: a join would first collect all running jobs
)
_DUE = or_(JobRow.not_before.is_(None), JobRow.not_before <= bindparam("now"))
_ELIGIBLE = (_IS_QUEUED, in_list(JobRow.needs, "capabilities"), _DUE, ~(_TWIN_RUNS & JobRow.cache))
"""A worker with these capabilities could run the job now, and no worker is running the same simulation."""

_GRANTED = (
    JobRow.id, JobRow.campaign_id, JobRow.kind, JobRow.spec, JobRow.spec_hash,
    JobRow.attempt, JobRow.timeout_s, JobRow.cache,
)  # fmt: skip
_HELD_ATTEMPTS = select(JobRow.lease_worker, JobRow.attempt).where(
    IS_LEASED, in_list(JobRow.lease_worker, "workers")
)
_HELD_ATTEMPTS_SQLITE = text(  # without statistics, SQLite would read all leases
    "SELECT lease_worker, attempt FROM jobs INDEXED BY ix_jobs_lease_worker "
    f"WHERE status = '{JobStatus.LEASED}' AND lease_worker IN (SELECT value FROM json_each(:workers))"
)
# Requests must not inspect every retry that no worker can run. The order is that of the index of retries, which
# Postgres then uses when only the first row is needed; otherwise, once most jobs have been tried, it may read all
# jobs, or all queued jobs of each campaign.
_DUE_RETRY = (
    select(JobRow.id)
    .where(
        _IS_QUEUED, _WAS_TRIED, _DUE, in_list(JobRow.needs, "capabilities"),
        or_(
            _IS_TRACE,
            JobRow.campaign_id.in_(
                select(CampaignRow.id).where(CampaignRow.status == CampaignStatus.RUNNING)
            ),
        ),
    )
    .order_by(JobRow.not_before)
)  # fmt: skip
_DUE_RETRIES = select(func.count()).select_from(_DUE_RETRY.limit(bindparam("most")).subquery())
_WORK = (
    select(JobRow.id)
    .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
    .where(_IS_QUEUED, IS_EVALUATION, CampaignRow.status == CampaignStatus.RUNNING)
    .limit(bindparam("enough"))
)


def _count(rows: Select[Any]) -> Label[int]:
    return select(func.count()).select_from(rows.subquery()).scalar_subquery().label("jobs")


_OTHERS = (
    exists(select(JobRow.id).where(_IS_QUEUED, _IS_TRACE, in_list(JobRow.needs, "capabilities"))).label(
        "traces"
    ),
    _DUE_RETRY.limit(literal(1, literal_execute=True)).scalar_subquery().is_not(None).label("retries"),
)
_BACKLOG = select(_count(_WORK), *_OTHERS)
_BACKLOG_OR_TRIED = select(
    # The order is that of the index of queued jobs, which Postgres then uses; otherwise it may read all jobs.
    _count(_WORK.order_by(JobRow.campaign_id, JobRow.attempt, JobRow.id)),
    *_OTHERS,
    exists(
        select(JobRow.id).where(
            IS_LEASED,
            JobRow.attempt > literal(1, literal_execute=True),
            in_list(JobRow.lease_worker, "workers"),
        )
    ).label("tried"),
)
_FRESH = select(*_GRANTED).where(*_ELIGIBLE, JobRow.attempt == 0)
_FRESH_TRACES = _FRESH.where(_IS_TRACE).order_by(JobRow.id).limit(bindparam("most"))
_FRESH_WORK = (
    _FRESH.where(IS_EVALUATION, JobRow.campaign_id == bindparam("campaign"), JobRow.id > bindparam("after"))
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
            ~in_list(JobRow.needs, "elsewhere"),
        ),
        _CAMPAIGN_ALLOWS_IT,
    )
    .order_by(_IS_TRACE.desc(), CampaignRow.priority.desc(), JobRow.not_before, JobRow.id)
    .limit(1)
)
_CAMPAIGNS_IN_TURN = (
    select(CampaignRow.id, CampaignRow.priority, CampaignRow.turn, CampaignRow.served)
    .where(
        CampaignRow.status == CampaignStatus.RUNNING,
        exists(
            select(JobRow.id)
            .where(*_ELIGIBLE, JobRow.campaign_id == CampaignRow.id, IS_EVALUATION, JobRow.attempt == 0)
            .correlate(CampaignRow)
            .offset(0)  # keeps Postgres from joining, which would read every queued job
        ),
    )
    .order_by(CampaignRow.priority.desc(), CampaignRow.turn, CampaignRow.id)
)
_GRANT = BulkUpdate(
    JobRow.id,
    [JobRow.lease_token, JobRow.lease_worker],
    status=JobStatus.LEASED,
    attempt=JobRow.attempt + 1,
    lease_expires_at=bindparam("expires"),
    lost_token=None,
    interrupted=False,
    not_before=None,
)
_NOT_LOCKED = CampaignRow.id.in_(
    # A campaign that another coordinator is writing keeps its turn: coordinators that waited for each other here,
    # each with several campaigns in one commit, would deadlock. SQLite has no row locks and ignores the clause.
    select(CampaignRow.id)
    .where(CampaignRow.id == bindparam("dealt"))
    .with_for_update(key_share=True, skip_locked=True)
    .scalar_subquery()
)
_SERVE = update(CampaignRow).where(_NOT_LOCKED).values(served=bindparam("count"))
_END_TURN = update(CampaignRow).where(_NOT_LOCKED).values(served=bindparam("count"), turn=LAST_TURN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Grants:
    """Granted leases.

    Attributes:
        jobs: The jobs for each demand.
        campaigns: The campaigns of all granted jobs.
    """

    jobs: Sequence[list[LeasedJob]]
    campaigns: frozenset[str]


def lease_together(connection: Connection, demands: Sequence[LeaseDemand], now: datetime) -> Grants:
    """Grant jobs to several workers as if they asked one after another, but read fresh jobs only once.

    Args:
        connection: In a write transaction.
        demands: The workers' demands, in order.
        now: The database's time.
    """
    if not demands:
        return Grants(jobs=(), campaigns=frozenset())
    backlog, held = _read_backlog(connection, demands, now)
    if len(demands) > 1 and (backlog.retries or backlog.traces):
        alone = [lease_together(connection, [demand], now) for demand in demands]
        return Grants(
            jobs=[grants.jobs[0] for grants in alone],
            campaigns=frozenset().union(*(grants.campaigns for grants in alone)),
        )
    assignment = lease_policy.assign_jobs(demands, backlog, held, _View(connection, now))
    grants = _grant(connection, demands, assignment.jobs, now)
    _write_turns(connection, assignment.turns)
    return grants


def count_due_retries(connection: Connection, capabilities: Iterable[str]) -> int:
    """Count the due retries that these capabilities can run, up to `MOST_WOKEN`."""
    known = {"now": database_now(connection), "capabilities": sorted(capabilities), "most": MOST_WOKEN}
    return connection.execute(_DUE_RETRIES, known).scalar_one()


def renew(connection: Connection, leases: Iterable[HeldLease], lease_s: float) -> list[int]:
    """Renew leases; return the ids of the jobs that are still held, ascending."""
    wanted = {held.job: held.token for held in leases}
    rows = connection.execute(
        lock_rows(
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
        connection.execute(
            update(JobRow).where(JobRow.id.in_(held)).values(lease_expires_at=expires, interrupted=False)
        )
    return sorted(held)


def release(connection: Connection, leases: Iterable[HeldLease]) -> int:
    """Return leased jobs to the queue without charging an attempt; return how many."""
    released = 0
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
        released += changed.rowcount
    return released


def end_now(connection: Connection, leases: Iterable[HeldLease]) -> None:
    """Let leases expire now, because their workers are known to be dead."""
    past = database_now(connection) - timedelta(seconds=1)
    for held in leases:
        connection.execute(
            update(JobRow)
            .where(JobRow.id == held.job, JobRow.status == JobStatus.LEASED, JobRow.lease_token == held.token)
            .values(lease_expires_at=past)
        )


@dataclass(frozen=True, slots=True)
class _View:
    """A `lease_policy.QueueView` of a write transaction; its jobs are database rows."""

    connection: Connection
    now: datetime

    def first_retry(self, demand: LeaseDemand) -> Retry | None:
        return cast(Retry | None, self.connection.execute(_RETRY, self._retry(demand)).first())

    def has_trace(self, capabilities: tuple[str, ...]) -> bool:
        known = {"capabilities": capabilities, "now": self.now, "most": 1}
        return self.connection.execute(_FRESH_TRACES, known).first() is not None

    def top_priority(self, capabilities: tuple[str, ...]) -> int | None:
        known = {"capabilities": capabilities, "now": self.now}
        best = self.connection.execute(_CAMPAIGNS_IN_TURN, known).first()
        return None if best is None else best.priority

    def lock_retry(self, demand: LeaseDemand) -> Sequence[QueuedJob]:
        return self._locked(_RETRY, self._retry(demand))

    def lock_traces(self, capabilities: tuple[str, ...], limit: int) -> Sequence[QueuedJob]:
        return self._locked(_FRESH_TRACES, {"capabilities": capabilities, "now": self.now, "most": limit})

    def turns(self, capabilities: tuple[str, ...]) -> Sequence[CampaignTurn]:
        known = {"capabilities": capabilities, "now": self.now}
        rows = self.connection.execute(_CAMPAIGNS_IN_TURN, known)
        return [CampaignTurn(row.id, row.priority, row.turn, row.served) for row in rows]

    def lock_fresh(
        self, campaign: str, capabilities: tuple[str, ...], *, after: int, limit: int
    ) -> Sequence[QueuedJob]:
        known = {
            "capabilities": capabilities, "now": self.now, "campaign": campaign, "after": after, "most": limit,
        }  # fmt: skip
        return self._locked(_FRESH_WORK, known)

    def _retry(self, demand: LeaseDemand) -> dict[str, Any]:
        return {
            "capabilities": demand.capabilities, "now": self.now, "worker": demand.worker,
            "elsewhere": list(demand.terms.elsewhere),
        }  # fmt: skip

    def _locked(self, query: Select[*tuple[Any, ...]], values: dict[str, Any]) -> Sequence[QueuedJob]:
        rows = self.connection.execute(lock_rows(query, self.connection, JobRow, skip_locked=True), values)
        return cast(Sequence[QueuedJob], rows.all())


def _read_backlog(
    connection: Connection, demands: Sequence[LeaseDemand], now: datetime
) -> tuple[Backlog, dict[str, list[int]]]:
    """Return a summary of the queue, and the attempt numbers of held jobs where they matter."""
    workers = [demand.worker for demand in demands]
    enough = max(map(lease_policy.enough_jobs, demands)) + sum(demand.max_jobs for demand in demands[1:])
    capabilities = sorted({name for demand in demands for name in demand.capabilities})
    known: dict[str, Any] = {"enough": enough, "now": now, "capabilities": capabilities}
    row: Any
    if connection.dialect.name == "sqlite":
        row = connection.execute(_BACKLOG, known).one()
        held = connection.execute(_HELD_ATTEMPTS_SQLITE, {"workers": json.dumps(workers)}).all()
    else:  # where each statement is a round trip
        row = connection.execute(_BACKLOG_OR_TRIED, {**known, "workers": workers}).one()
        matters = row.retries or row.tried
        held = connection.execute(_HELD_ATTEMPTS, {"workers": workers}).all() if matters else []
    attempts: dict[str, list[int]] = {}
    for one in held:
        attempts.setdefault(one.lease_worker, []).append(one.attempt)
    return Backlog(jobs=row.jobs, traces=row.traces, retries=row.retries), attempts


def _grant(
    connection: Connection,
    demands: Sequence[LeaseDemand],
    assigned: Sequence[Sequence[QueuedJob]],
    now: datetime,
) -> Grants:
    granted: list[list[LeasedJob]] = []
    values: dict[float, list[tuple[int, str, str]]] = {}
    for demand, rows in zip(demands, assigned, strict=True):
        jobs = [_leased(row) for row in rows]
        granted.append(jobs)
        values.setdefault(demand.terms.lease_s, []).extend(
            (job.job, job.token, demand.worker) for job in jobs
        )
    for lease_s, rows_of in values.items():
        _GRANT.run(connection, rows_of, {"expires": now + timedelta(seconds=lease_s)})
    return Grants(jobs=granted, campaigns=frozenset(row.campaign_id for rows in assigned for row in rows))


def _write_turns(connection: Connection, turns: Mapping[str, tuple[int, int]]) -> None:
    for campaign, (turn, served) in sorted(turns.items(), key=lambda item: item[1]):
        statement = _END_TURN if turn > NEW_TURN else _SERVE
        connection.execute(statement, {"dealt": campaign, "count": served})


def _leased(job: QueuedJob) -> LeasedJob:
    row = cast(Row[*tuple[Any, ...]], job)
    return LeasedJob(
        job=row.id,
        token=secrets.token_hex(16),
        attempt=row.attempt + 1,
        spec=json.loads(row.spec),
        record=row.kind == JobKind.TRACE,
        timeout_s=row.timeout_s,
        campaign=row.campaign_id,
    )

"""The SQL of leases: granted as `lease_policy` decides, renewed, given back, ended.

Each public function is a unit for `brink.server.db.writer.Writer`. The database's clock decides when a lease ends,
and a lease can only be changed by naming its token.
"""

import itertools
import json
import secrets
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import (
    Connection,
    Label,
    Select,
    String,
    bindparam,
    cast,
    exists,
    func,
    or_,
    select,
    text,
    true,
    update,
)

from brink.server.db.models import CampaignRow, JobRow
from brink.server.db.sql import LAST_TURN, constant, database_now, in_list
from brink.server.db.statements import Statement
from brink.server.db.types import UtcDateTime
from brink.server.queue import lease_policy
from brink.server.queue.job_store import IS_EVALUATION, IS_LEASED
from brink.server.queue.lease_policy import NEW_TURN, Backlog, CampaignTurn, LeaseDemand, QueuedJob, Retry
from brink.server.states import CampaignStatus, JobKind, JobStatus
from brink.worker.wire import HeldLease, LeasedJob

MOST_WOKEN = 10_000
"""Due retries are counted up to this number; more workers than this rarely wait at one coordinator."""

# Statuses and kinds are literals, as in `job_store`, and statements are built once: building one takes longer than
# running it.
_IS_QUEUED = JobRow.status == constant(JobStatus.QUEUED)
_IS_TRACE = JobRow.kind == constant(JobKind.TRACE)
_WAS_TRIED = JobRow.attempt > constant(0)
_IS_FRESH = JobRow.attempt == constant(0)
_IS_RUNNING = CampaignRow.status == constant(CampaignStatus.RUNNING)
_CAMPAIGN_ALLOWS_IT = or_(_IS_TRACE, _IS_RUNNING)
_TWIN = JobRow.__table__.alias("twin")
_TWIN_RUNS = exists(
    select(_TWIN.c.id)
    .where(
        # The status is a parameter: with a literal, Postgres may scan the index of leased jobs for each job.
        _TWIN.c.spec_hash == JobRow.spec_hash,
        _TWIN.c.kind == JobRow.kind,
        _TWIN.c.status == JobStatus.LEASED,
    )
    .offset(0)  # forces one lookup for each job: a join would first collect all running jobs
)
_NOW = bindparam("now", type_=UtcDateTime())
_DUE = or_(JobRow.not_before.is_(None), JobRow.not_before <= _NOW)
_ELIGIBLE = (_IS_QUEUED, in_list(JobRow.needs, "capabilities"), _DUE, ~(JobRow.cache & _TWIN_RUNS))
"""A worker with these capabilities could run the job now, and no worker is running the same simulation."""

_OWNER = CampaignRow.__table__.alias("owner")
_GRANTED = (
    JobRow.id,
    JobRow.campaign_id,
    JobRow.number,
    JobRow.kind,
    JobRow.spec,
    JobRow.spec_hash,
    JobRow.attempt,
    JobRow.timeout_s,
    JobRow.cache,
    select(_OWNER.c.generation_end)
    .where(_OWNER.c.id == JobRow.campaign_id)
    .scalar_subquery()
    .label("generation_end"),
)
_HELD_ATTEMPTS = Statement(
    text(  # without statistics, SQLite would read all leases
        "SELECT lease_worker, attempt FROM jobs INDEXED BY ix_jobs_lease_worker "
        f"WHERE status = '{JobStatus.LEASED}' AND lease_worker IN (SELECT value FROM json_each(:workers))"
    ),
    postgres=select(JobRow.lease_worker, JobRow.attempt).where(
        IS_LEASED, in_list(JobRow.lease_worker, "workers")
    ),
)
# Requests must not inspect every retry that no worker can run. The order is that of the index of retries, which
# Postgres then uses when only the first row is needed; otherwise, once most jobs have been tried, it may read all
# jobs, or all queued jobs of each campaign.
_DUE_RETRY = (
    select(JobRow.id)
    .where(
        _IS_QUEUED,
        _WAS_TRIED,
        _DUE,
        in_list(JobRow.needs, "capabilities"),
        or_(_IS_TRACE, JobRow.campaign_id.in_(select(CampaignRow.id).where(_IS_RUNNING))),
    )
    .order_by(JobRow.not_before)
)
_DUE_RETRIES = select(func.count()).select_from(_DUE_RETRY.limit(bindparam("most")).subquery())
_WORK = (
    select(JobRow.id)
    .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
    .where(_IS_QUEUED, IS_EVALUATION, _IS_RUNNING)
    .limit(bindparam("enough"))
)
_WORK_OF_ONE = (
    select(JobRow.id)
    .where(_IS_QUEUED, IS_EVALUATION, JobRow.campaign_id == CampaignRow.id)
    # The order is that of the index of queued jobs, which Postgres then uses; otherwise it may read all jobs.
    .order_by(JobRow.attempt, JobRow.id)
    .limit(bindparam("enough"))
    .lateral()
)
_WORK_BY_CAMPAIGN = (
    select(_WORK_OF_ONE.c.id)
    .select_from(CampaignRow)
    .join(_WORK_OF_ONE, true())
    .where(_IS_RUNNING)
    .limit(bindparam("enough"))
)
"""For Postgres, which takes several times as long to look up the campaign of each job."""


def _count(rows: Select[Any]) -> Label[int]:
    return select(func.count()).select_from(rows.subquery()).scalar_subquery().label("jobs")


_OTHERS = (
    exists(select(JobRow.id).where(_IS_QUEUED, _IS_TRACE, in_list(JobRow.needs, "capabilities"))).label(
        "traces"
    ),
    _DUE_RETRY.limit(constant(1)).scalar_subquery().is_not(None).label("retries"),
)
_TRIED = exists(
    select(JobRow.id).where(IS_LEASED, JobRow.attempt > constant(1), in_list(JobRow.lease_worker, "workers"))
).label("tried")
_BACKLOG = Statement(
    select(_count(_WORK), *_OTHERS, _TRIED), postgres=select(_count(_WORK_BY_CAMPAIGN), *_OTHERS, _TRIED)
)
_FRESH = select(*_GRANTED).where(*_ELIGIBLE, _IS_FRESH)
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
        _IS_RUNNING,
        exists(
            select(JobRow.id)
            .where(*_ELIGIBLE, JobRow.campaign_id == CampaignRow.id, IS_EVALUATION, _IS_FRESH)
            .correlate(CampaignRow)
            .offset(0)  # keeps Postgres from joining, which would read every queued job
        ),
    )
    .order_by(CampaignRow.priority.desc(), CampaignRow.turn, CampaignRow.id)
)
_READ_RETRY, _READ_TRACES, _READ_TURNS = map(Statement, (_RETRY, _FRESH_TRACES, _CAMPAIGNS_IN_TURN))
_LOCK_RETRY, _LOCK_TRACES, _LOCK_FRESH = (
    # Except those that another coordinator is granting. SQLite has no row locks and ignores the clause.
    Statement(query.with_for_update(of=JobRow, skip_locked=True))
    for query in (_RETRY, _FRESH_TRACES, _FRESH_WORK)
)
_GRANT = Statement(
    update(JobRow)
    .where(in_list(JobRow.id, "jobs"))
    .values(
        status=JobStatus.LEASED,
        attempt=JobRow.attempt + 1,
        lease_token=bindparam("grant", type_=String) + cast(JobRow.id, String),
        lease_worker=bindparam("holder"),
        lease_expires_at=bindparam("expires"),
        lost_token=None,
        interrupted=False,
        not_before=None,
    )
)
_HELD = (
    select(JobRow.id, JobRow.status, JobRow.lease_token)
    # By id alone: with a condition on the status, Postgres may scan all leased jobs instead.
    .where(in_list(JobRow.id, "jobs"))
    .order_by(JobRow.id)
    .with_for_update(of=JobRow)
)
_RENEW = (
    update(JobRow)
    .where(in_list(JobRow.id, "jobs"))
    .values(lease_expires_at=bindparam("until"), interrupted=False)
)
_NOT_LOCKED = CampaignRow.id.in_(
    # A campaign that another coordinator is writing keeps its turn: coordinators that waited for each other here,
    # each with several campaigns in one commit, would deadlock. SQLite has no row locks and ignores the clause.
    select(CampaignRow.id)
    .where(CampaignRow.id == bindparam("dealt"))
    .with_for_update(key_share=True, skip_locked=True)
    .scalar_subquery()
)
_SERVE = Statement(update(CampaignRow).where(_NOT_LOCKED).values(served=bindparam("count")))
_END_TURN = Statement(
    update(CampaignRow).where(_NOT_LOCKED).values(served=bindparam("count"), turn=LAST_TURN)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Grants:
    """Granted leases.

    Attributes:
        jobs: The jobs for each demand.
        busy: The campaigns whose current generations have some of these jobs.
    """

    jobs: Sequence[list[LeasedJob]] = ()
    busy: frozenset[str] = frozenset()


def lease_together(connection: Connection, demands: Sequence[LeaseDemand], now: datetime) -> Grants:
    """Grant jobs to several workers as if they asked one after another, but read fresh jobs only once.

    Args:
        connection: In a write transaction.
        demands: The workers' demands, in order.
        now: The database's time.
    """
    if not demands:
        return Grants()
    backlog, tried = _backlog(connection, demands, now)
    if len(demands) > 1 and (backlog.retries or backlog.traces):
        alone = [lease_together(connection, [demand], now) for demand in demands]
        return Grants(
            jobs=[grants.jobs[0] for grants in alone],
            busy=frozenset().union(*(grants.busy for grants in alone)),
        )
    held = _held_attempts(connection, demands) if backlog.retries or tried else {}
    assignment = lease_policy.assign_jobs(demands, backlog, held, _View(connection, now))
    granted = _grant(connection, demands, assignment.jobs, now)
    _write_turns(connection, assignment.turns)
    return Grants(jobs=granted, busy=_busy(itertools.chain.from_iterable(assignment.jobs)))


def count_due_retries(connection: Connection, capabilities: Iterable[str]) -> int:
    """Count the due retries that these capabilities can run, up to `MOST_WOKEN`."""
    known = {"now": database_now(connection), "capabilities": sorted(capabilities), "most": MOST_WOKEN}
    return connection.execute(_DUE_RETRIES, known).scalar_one()


def renew(connection: Connection, leases: Iterable[HeldLease], lease_s: float) -> list[int]:
    """Renew leases; return the ids of the jobs that are still held, ascending."""
    wanted = {held.job: held.token for held in leases}
    held = [
        row.id
        for row in connection.execute(_HELD, {"jobs": sorted(wanted)})
        if row.status == JobStatus.LEASED and secrets.compare_digest(row.lease_token, wanted[row.id])
    ]
    if held:
        until = database_now(connection) + timedelta(seconds=lease_s)
        connection.execute(_RENEW, {"jobs": held, "until": until})
    return held


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
        rows = self._retry(_READ_RETRY, demand)
        return typing.cast(Retry, rows[0]) if rows else None

    def has_trace(self, capabilities: tuple[str, ...]) -> bool:
        return bool(self._read(_READ_TRACES, capabilities=capabilities, most=1))

    def top_priority(self, capabilities: tuple[str, ...]) -> int | None:
        turns = self.turns(capabilities)
        return turns[0].priority if turns else None

    def lock_retry(self, demand: LeaseDemand) -> Sequence[QueuedJob]:
        return self._retry(_LOCK_RETRY, demand)

    def lock_traces(self, capabilities: tuple[str, ...], limit: int) -> Sequence[QueuedJob]:
        return self._read(_LOCK_TRACES, capabilities=capabilities, most=limit)

    def turns(self, capabilities: tuple[str, ...]) -> Sequence[CampaignTurn]:
        return [CampaignTurn(*row) for row in self._read(_READ_TURNS, capabilities=capabilities)]

    def lock_fresh(
        self, campaign: str, capabilities: tuple[str, ...], *, after: int, limit: int
    ) -> Sequence[QueuedJob]:
        return self._read(_LOCK_FRESH, campaign=campaign, capabilities=capabilities, after=after, most=limit)

    def _retry(self, query: Statement, demand: LeaseDemand) -> Sequence[Any]:
        return self._read(
            query,
            capabilities=demand.capabilities,
            worker=demand.worker,
            elsewhere=list(demand.terms.elsewhere),
        )

    def _read(self, query: Statement, **values: object) -> Sequence[Any]:
        return query.run(self.connection, **values, now=self.now)


def _busy(jobs: Iterable[Any]) -> frozenset[str]:
    """Return the campaigns whose current generations have some of these jobs."""
    return frozenset(
        job.campaign_id
        for job in jobs
        if job.kind != JobKind.TRACE and (job.generation_end is None or job.number < job.generation_end)
    )


def _backlog(connection: Connection, demands: Sequence[LeaseDemand], now: datetime) -> tuple[Backlog, bool]:
    """Return a summary of the queue, and whether one of the workers holds a job that was tried before."""
    about = {
        "workers": [demand.worker for demand in demands],
        "enough": _enough(demands),
        "capabilities": sorted({name for demand in demands for name in demand.capabilities}),
        "now": now,
    }
    (row,) = _BACKLOG.run(connection, **about)
    backlog = Backlog(jobs=row.jobs, traces=bool(row.traces), retries=bool(row.retries))
    return backlog, bool(row.tried)


def _enough(demands: Sequence[LeaseDemand]) -> int:
    """Return how many queued jobs are enough for the largest possible grants to all of these workers."""
    return max(map(lease_policy.enough_jobs, demands)) + sum(demand.max_jobs for demand in demands[1:])


def _held_attempts(connection: Connection, demands: Sequence[LeaseDemand]) -> dict[str, list[int]]:
    """Return the attempt numbers of the jobs that workers hold."""
    workers = [demand.worker for demand in demands]
    given = json.dumps(workers) if connection.dialect.name == "sqlite" else workers
    attempts: dict[str, list[int]] = {}
    for row in _HELD_ATTEMPTS.run(connection, workers=given):
        attempts.setdefault(row.lease_worker, []).append(row.attempt)
    return attempts


def _grant(
    connection: Connection,
    demands: Sequence[LeaseDemand],
    assigned: Sequence[Sequence[QueuedJob]],
    now: datetime,
) -> list[list[LeasedJob]]:
    granted: list[list[LeasedJob]] = []
    for demand, rows in zip(demands, assigned, strict=True):
        grant = f"{secrets.token_hex(16)}-"
        if rows:
            values = {
                "jobs": [row.id for row in rows],
                "grant": grant,
                "holder": demand.worker,
                "expires": now + timedelta(seconds=demand.terms.lease_s),
            }
            _GRANT.run(connection, **values)
        granted.append([_leased(row, grant) for row in rows])
    return granted


def _write_turns(connection: Connection, turns: Mapping[str, tuple[int, int]]) -> None:
    for campaign, (turn, served) in sorted(turns.items(), key=lambda item: item[1]):
        statement = _END_TURN if turn > NEW_TURN else _SERVE
        statement.run(connection, dealt=campaign, count=served)


def _leased(job: QueuedJob, grant: str) -> LeasedJob:
    row = typing.cast(Any, job)
    return LeasedJob(
        job=row.id,
        token=f"{grant}{row.id}",
        attempt=row.attempt + 1,
        spec=json.loads(row.spec),
        record=row.kind == JobKind.TRACE,
        timeout_s=row.timeout_s,
        campaign=row.campaign_id,
    )

"""The SQL of leases: granted as `lease_policy` decides, renewed, given back, ended.

Each public function is a unit for `brink.server.db.writer.Writer`. The database's clock decides when a lease ends,
and a lease can only be changed by naming its token.
"""

import itertools
import json
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, cast

from sqlalchemy import (
    Connection,
    Integer,
    Label,
    Select,
    bindparam,
    case,
    exists,
    func,
    or_,
    select,
    text,
    true,
    update,
)

from brink.server.db.models import CampaignRow, JobRow
from brink.server.db.sql import LAST_TURN, constant, database_now, driver_time, in_list, transaction_time
from brink.server.db.statements import BulkUpdate, Statement, Values, is_pipelined, read, write
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
_NOW = transaction_time("now")
_DUE = or_(JobRow.not_before.is_(None), JobRow.not_before <= _NOW)
_ELIGIBLE = (_IS_QUEUED, in_list(JobRow.needs, "capabilities"), _DUE, ~(JobRow.cache & _TWIN_RUNS))
"""A worker with these capabilities could run the job now, and no worker is running the same simulation."""

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
_DUE_RETRIES = Statement(
    select(func.count().label("jobs")).select_from(_DUE_RETRY.limit(bindparam("most")).subquery())
)
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
)
_BACKLOG = Statement(
    select(_count(_WORK), *_OTHERS),
    postgres=select(_count(_WORK_BY_CAMPAIGN), *_OTHERS, _TRIED.label("tried"), _NOW.label("now")),
)
_FRESH = select(*_GRANTED).where(*_ELIGIBLE, _IS_FRESH)
_FRESH_TRACES = _FRESH.where(_IS_TRACE).order_by(JobRow.id).limit(bindparam("most"))
_FRESH_WORK = (
    _FRESH.where(IS_EVALUATION, JobRow.campaign_id == bindparam("campaign"), JobRow.id > bindparam("after"))
    .order_by(JobRow.id)
    .limit(bindparam("most"))
)
_RETRY = (
    select(*_GRANTED, CampaignRow.priority, CampaignRow.generation_end)
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
    select(
        CampaignRow.id, CampaignRow.priority, CampaignRow.turn, CampaignRow.served, CampaignRow.generation_end
    )
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
_QUEUE_IS_LONG = _count(_WORK_BY_CAMPAIGN).element >= bindparam("enough")
_NEXT_WORK = (
    _FRESH.where(
        IS_EVALUATION,
        JobRow.campaign_id
        == _CAMPAIGNS_IN_TURN.with_only_columns(CampaignRow.id).limit(constant(1)).scalar_subquery(),
    )
    .order_by(JobRow.id)
    .limit(case((_QUEUE_IS_LONG, bindparam("most", type_=Integer)), else_=bindparam("least", type_=Integer)))
)
"""The first fresh jobs of the first campaign in turn: on Postgres, they are read together with everything else."""


def _locking(query: Select[*tuple[Any, ...]]) -> Statement:
    """Return a query that locks its jobs on Postgres, skipping those that another coordinator is granting."""
    return Statement(query, postgres=query.with_for_update(of=JobRow, skip_locked=True))


_READ_RETRY, _LOCK_RETRY = Statement(_RETRY), _locking(_RETRY)
_READ_TRACES, _LOCK_TRACES = Statement(_FRESH_TRACES), _locking(_FRESH_TRACES)
_LOCK_FRESH, _LOCK_NEXT = _locking(_FRESH_WORK), _locking(_NEXT_WORK)
_READ_TURNS = Statement(_CAMPAIGNS_IN_TURN)
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
_HELD_JOBS = select(JobRow.id, JobRow.status, JobRow.lease_token, _NOW.label("now")).where(
    # By id alone: with a condition on the status, Postgres may scan all leased jobs instead.
    in_list(JobRow.id, "jobs")
)
_HELD = Statement(_HELD_JOBS, postgres=_HELD_JOBS.order_by(JobRow.id).with_for_update(of=JobRow))
_RENEW = Statement(
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

    jobs: Sequence[list[LeasedJob]]
    busy: frozenset[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """A snapshot of the queue for the demands of one commit.

    On Postgres, it is read in one round trip, with the jobs that will most likely be granted. SQLite reads these when
    they are needed.

    Attributes:
        backlog: A summary.
        is_plain: Whether only fresh evaluations are queued for these workers, and none of them holds a retry.
        now: The database's time.
        capabilities: Those of the first demand.
        turns: The campaigns in turn for them; None if they were not read.
        next_jobs: The first fresh jobs of the first of these campaigns.
        limit: The maximum number of `next_jobs`: if there are fewer, the campaign has no more.
    """

    backlog: Backlog
    is_plain: bool
    now: datetime
    capabilities: tuple[str, ...]
    turns: Sequence[CampaignTurn] | None = None
    next_jobs: Sequence[QueuedJob] = ()
    limit: int = 0


def look_queries(demands: Sequence[LeaseDemand]) -> list[tuple[Statement, Values]]:
    """Return the queries whose rows `found_look` takes, on Postgres."""
    first = {"capabilities": demands[0].capabilities, "enough": _enough(demands)}
    most = sum(demand.max_jobs for demand in demands)
    return [
        (_BACKLOG, _about(demands)),
        (_READ_TURNS, first),
        (_LOCK_NEXT, {**first, "most": most, "least": len(demands)}),
    ]


def found_look(demands: Sequence[LeaseDemand], rows: Sequence[Sequence[Any]]) -> Look:
    """Return the snapshot from the rows of `look_queries`."""
    (summary,), turns, jobs = rows
    is_long = summary.jobs >= _enough(demands)
    return Look(
        backlog=_backlog(summary),
        is_plain=not (summary.traces or summary.retries or summary.tried),
        now=driver_time(summary.now),
        capabilities=demands[0].capabilities,
        turns=[CampaignTurn(*row) for row in turns],
        next_jobs=jobs,
        limit=sum(demand.max_jobs for demand in demands) if is_long else len(demands),
    )


def lease_together(
    connection: Connection, demands: Sequence[LeaseDemand], look: Look | None = None
) -> Grants:
    """Grant jobs to several workers as if they asked one after another, but read fresh jobs only once.

    Args:
        connection: In a write transaction.
        demands: The workers' demands, in order.
        look: The queue as it is now, if known.
    """
    if not demands:
        return Grants(jobs=(), busy=frozenset())
    if look is None:
        look = _look(connection, demands)
    if len(demands) > 1 and (look.backlog.retries or look.backlog.traces):
        alone = [lease_together(connection, [demand]) for demand in demands]
        return Grants(
            jobs=[grants.jobs[0] for grants in alone],
            busy=frozenset().union(*(grants.busy for grants in alone)),
        )
    held = {} if look.is_plain else _held_attempts(connection, demands)
    view = _View(connection, look)
    assignment = lease_policy.assign_jobs(demands, look.backlog, held, view)
    granted = _grant(connection, demands, assignment.jobs, look.now)
    _write_turns(connection, assignment.turns)
    return Grants(jobs=granted, busy=view.busy_among(itertools.chain.from_iterable(assignment.jobs)))


def count_due_retries(connection: Connection, capabilities: Iterable[str]) -> int:
    """Count the due retries that these capabilities can run, up to `MOST_WOKEN`."""
    known = {"now": datetime.now(UTC), "capabilities": sorted(capabilities), "most": MOST_WOKEN}
    jobs: int = read(connection, (_DUE_RETRIES, known))[0][0].jobs
    return jobs


def renew(connection: Connection, leases: Iterable[HeldLease], lease_s: float) -> list[int]:
    """Renew leases; return the ids of the jobs that are still held, ascending."""
    wanted = {held.job: held.token for held in leases}
    (rows,) = read(connection, (_HELD, {"jobs": sorted(wanted), "now": datetime.now(UTC)}))
    held = [
        row
        for row in rows
        if row.status == JobStatus.LEASED and secrets.compare_digest(row.lease_token, wanted[row.id])
    ]
    if held:
        until = driver_time(held[0].now) + timedelta(seconds=lease_s)
        write(connection, _RENEW, {"jobs": [row.id for row in held], "until": until})
    return sorted(row.id for row in held)


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
    """A `lease_policy.QueueView` of a write transaction; its jobs are database rows.

    Attributes:
        ends: The `CampaignTurn.generation_end` of each campaign whose jobs were found.
    """

    connection: Connection
    look: Look
    ends: dict[str, int | None] = field(default_factory=dict)

    def first_retry(self, demand: LeaseDemand) -> Retry | None:
        rows = self._read(_READ_RETRY, self._retry(demand))
        return cast(Retry, rows[0]) if rows else None

    def has_trace(self, capabilities: tuple[str, ...]) -> bool:
        return bool(self._read(_READ_TRACES, {"capabilities": capabilities, "most": 1}))

    def top_priority(self, capabilities: tuple[str, ...]) -> int | None:
        turns = self.turns(capabilities)
        return turns[0].priority if turns else None

    def lock_retry(self, demand: LeaseDemand) -> Sequence[QueuedJob]:
        rows = self._read(_LOCK_RETRY, self._retry(demand))
        self.ends.update((row.campaign_id, row.generation_end) for row in rows)
        return rows

    def lock_traces(self, capabilities: tuple[str, ...], limit: int) -> Sequence[QueuedJob]:
        return self._read(_LOCK_TRACES, {"capabilities": capabilities, "most": limit})

    def turns(self, capabilities: tuple[str, ...]) -> Sequence[CampaignTurn]:
        turns = self.look.turns
        if turns is None or capabilities != self.look.capabilities:
            turns = [CampaignTurn(*row) for row in self._read(_READ_TURNS, {"capabilities": capabilities})]
        self.ends.update((one.campaign, one.generation_end) for one in turns)
        return turns

    def lock_fresh(
        self, campaign: str, capabilities: tuple[str, ...], *, after: int, limit: int
    ) -> Sequence[QueuedJob]:
        known = [
            job
            for job in self.look.next_jobs
            if capabilities == self.look.capabilities and job.campaign_id == campaign and job.id > after
        ]
        is_all = bool(known) and len(self.look.next_jobs) < self.look.limit
        if is_all or len(known) >= limit:
            return known[:limit]
        after = known[-1].id if known else after
        asked = {
            "capabilities": capabilities,
            "campaign": campaign,
            "after": after,
            "most": limit - len(known),
        }
        return [*known, *self._read(_LOCK_FRESH, asked)]

    def busy_among(self, jobs: Iterable[QueuedJob]) -> frozenset[str]:
        """Return the campaigns whose current generations have some of these jobs."""
        busy = set()
        for job in jobs:
            end = self.ends.get(job.campaign_id)
            if job.kind != JobKind.TRACE and (end is None or cast(Any, job).number < end):
                busy.add(job.campaign_id)
        return frozenset(busy)

    def _retry(self, demand: LeaseDemand) -> dict[str, Any]:
        return {
            "capabilities": demand.capabilities,
            "worker": demand.worker,
            "elsewhere": list(demand.terms.elsewhere),
        }

    def _read(self, query: Statement, values: Values) -> list[Any]:
        return read(self.connection, (query, {**values, "now": self.look.now}))[0]


def _look(connection: Connection, demands: Sequence[LeaseDemand]) -> Look:
    if is_pipelined(connection):
        return found_look(demands, read(connection, *look_queries(demands)))
    now = datetime.now(UTC)
    (summary,) = read(connection, (_BACKLOG, {**_about(demands), "now": now}))[0]
    return Look(backlog=_backlog(summary), is_plain=False, now=now, capabilities=demands[0].capabilities)


def _about(demands: Sequence[LeaseDemand]) -> dict[str, Any]:
    return {
        "enough": _enough(demands),
        "workers": [demand.worker for demand in demands],
        "capabilities": sorted({name for demand in demands for name in demand.capabilities}),
    }


def _enough(demands: Sequence[LeaseDemand]) -> int:
    """Return how many queued jobs are enough for the largest possible grants to all of these workers."""
    return max(map(lease_policy.enough_jobs, demands)) + sum(demand.max_jobs for demand in demands[1:])


def _backlog(summary: Any) -> Backlog:
    return Backlog(jobs=summary.jobs, traces=bool(summary.traces), retries=bool(summary.retries))


def _held_attempts(connection: Connection, demands: Sequence[LeaseDemand]) -> dict[str, list[int]]:
    """Return the attempt numbers of the jobs that workers hold."""
    workers = [demand.worker for demand in demands]
    given = workers if is_pipelined(connection) else json.dumps(workers)
    attempts: dict[str, list[int]] = {}
    for one in read(connection, (_HELD_ATTEMPTS, {"workers": given}))[0]:
        attempts.setdefault(one.lease_worker, []).append(one.attempt)
    return attempts


def _grant(
    connection: Connection,
    demands: Sequence[LeaseDemand],
    assigned: Sequence[Sequence[QueuedJob]],
    now: datetime,
) -> list[list[LeasedJob]]:
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
    return granted


def _write_turns(connection: Connection, turns: Mapping[str, tuple[int, int]]) -> None:
    for campaign, (turn, served) in sorted(turns.items(), key=lambda item: item[1]):
        statement = _END_TURN if turn > NEW_TURN else _SERVE
        write(connection, statement, {"dealt": campaign, "count": served})


def _leased(job: QueuedJob) -> LeasedJob:
    row = cast(Any, job)
    return LeasedJob(
        job=row.id,
        token=secrets.token_hex(16),
        attempt=row.attempt + 1,
        spec=json.loads(row.spec),
        record=row.kind == JobKind.TRACE,
        timeout_s=row.timeout_s,
        campaign=row.campaign_id,
    )

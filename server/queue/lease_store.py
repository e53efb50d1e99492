"""The SQL of leases: who gets which jobs, and for how long.

`lease` and `lease_together` are units for `brink.server.db.writer.Writer`: they take a connection in a write
transaction. Many workers ask at once: then fresh jobs are read once and dealt out in memory, exactly as if one worker
had come after the other. The database's clock decides when a lease ends.
"""

import json
import secrets
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Connection, Label, Select, bindparam, exists, func, literal, or_, select, text, update

from brink.server.db.clock import database_now
from brink.server.db.locking import locked
from brink.server.db.many import UpdateEach, among
from brink.server.db.models import EVALUATES, IS_LEASED, LAST_TURN, CampaignRow, JobRow
from brink.server.queue.values import Grants, JobRecord, LeaseTerms, LeaseWanted
from brink.server.states import CampaignStatus, JobKind, JobStatus
from brink.worker.wire import LeasedJob

# Spelled out in the SQL: Postgres' plans for prepared statements do not know the values of parameters, and could not
# use the indexes that hold queued or leased jobs alone.
_IS_QUEUED = JobRow.status == literal(JobStatus.QUEUED, literal_execute=True)
_IS_TRACE = JobRow.kind == literal(JobKind.TRACE, literal_execute=True)
_WAS_TRIED = JobRow.attempt > literal(0, literal_execute=True)
_ITS_CAMPAIGN_GOES_ON = or_(_IS_TRACE, CampaignRow.status == CampaignStatus.RUNNING)
_TWIN = JobRow.__table__.alias("twin")
_SOMEBODY_RUNS_IT = exists(
    select(_TWIN.c.id)
    .where(
        _TWIN.c.spec_hash == JobRow.spec_hash, _TWIN.c.kind == JobRow.kind, _TWIN.c.status == JobStatus.LEASED
    )
    .offset(0)  # one look a job: Postgres would first gather all that run, out of all that there ever were
)
_DUE = or_(JobRow.not_before.is_(None), JobRow.not_before <= bindparam("now"))
_ELIGIBLE = (
    _IS_QUEUED,
    among(JobRow.needs, "capabilities"),
    _DUE,
    ~(_SOMEBODY_RUNS_IT & JobRow.cache),
)
"""A worker with these capabilities could run it now, and nobody runs the same simulation already."""

_GRANTED = (
    JobRow.id, JobRow.campaign_id, JobRow.kind, JobRow.spec, JobRow.spec_hash,
    JobRow.attempt, JobRow.timeout_s, JobRow.cache,
)  # fmt: skip

TURN = 4
"""Jobs a live worker that a campaign hands out before the next one's turn."""
_AFTER_ALL = 2**62
"""Later than every turn in the database."""
_NOTHING = Grants(jobs=(), campaigns=frozenset())

# Built once: making a statement costs more than running it.
_HOLDINGS = select(JobRow.lease_worker, JobRow.attempt).where(
    IS_LEASED, among(JobRow.lease_worker, "workers")
)
_HOLDINGS_SQLITE = text(  # which, without statistics, would look through all leases
    "SELECT lease_worker, attempt FROM jobs INDEXED BY ix_jobs_lease_worker "
    f"WHERE status = '{JobStatus.LEASED}' AND lease_worker IN (SELECT value FROM json_each(:workers))"
)
# Those that nobody can run now must not cost everybody a look for each worker. The order is that of the index of
# retries, which Postgres takes then if it is asked for the first few: else, as most jobs were tried once, it may look
# through all jobs, or through all that is queued of each campaign.
_DUE_RETRY = (
    select(JobRow.id)
    .where(
        _IS_QUEUED, _WAS_TRIED, _DUE, among(JobRow.needs, "capabilities"),
        or_(
            _IS_TRACE,
            JobRow.campaign_id.in_(
                select(CampaignRow.id).where(CampaignRow.status == CampaignStatus.RUNNING)
            ),
        ),
    )
    .order_by(JobRow.not_before)
)  # fmt: skip
_WORK = (
    select(JobRow.id)
    .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
    .where(_IS_QUEUED, EVALUATES, CampaignRow.status == CampaignStatus.RUNNING)
    .limit(bindparam("enough"))
)


def _counted(rows: Select[Any]) -> Label[int]:
    return select(func.count()).select_from(rows.subquery()).scalar_subquery().label("jobs")


_OTHERS = (
    exists(select(JobRow.id).where(_IS_QUEUED, _IS_TRACE, among(JobRow.needs, "capabilities"))).label(
        "traces"
    ),
    _DUE_RETRY.limit(literal(1, literal_execute=True)).scalar_subquery().is_not(None).label("retries"),
)
_WAITING = select(_counted(_WORK), *_OTHERS)
_WAITING_OR_TRIED = select(
    # The order is that of the index of queued jobs, which Postgres takes then; else it may read all jobs.
    _counted(_WORK.order_by(JobRow.campaign_id, JobRow.attempt, JobRow.id)),
    *_OTHERS,
    exists(
        select(JobRow.id).where(
            IS_LEASED,
            JobRow.attempt > literal(1, literal_execute=True),
            among(JobRow.lease_worker, "workers"),
        )
    ).label("tried"),
)
_DUE_RETRIES = select(func.count()).select_from(_DUE_RETRY.limit(bindparam("most")).subquery())
MOST_WOKEN = 10_000
"""More workers would hardly wait at one coordinator."""
_FRESH = select(*_GRANTED).where(*_ELIGIBLE, JobRow.attempt == 0)
_FRESH_TRACES = _FRESH.where(_IS_TRACE).order_by(JobRow.id).limit(bindparam("most"))
_FRESH_WORK = (
    _FRESH.where(EVALUATES, JobRow.campaign_id == bindparam("campaign"), JobRow.id > bindparam("after"))
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
            ~among(JobRow.needs, "elsewhere"),
        ),
        _ITS_CAMPAIGN_GOES_ON,
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
            .where(
                *_ELIGIBLE,
                JobRow.campaign_id == CampaignRow.id,
                EVALUATES,
                JobRow.attempt == 0,
            )
            .correlate(CampaignRow)
            .offset(0)  # else Postgres joins, and reads every queued job
        ),
    )
    .order_by(CampaignRow.priority.desc(), CampaignRow.turn, CampaignRow.id)
)
_GRANT = UpdateEach(
    JobRow.id,
    [JobRow.lease_token, JobRow.lease_worker],
    status=JobStatus.LEASED,
    attempt=JobRow.attempt + 1,
    lease_expires_at=bindparam("expires"),
    not_before=None,
)
_NOT_HELD = CampaignRow.id.in_(
    # A campaign that somebody else is writing stands where it did: coordinators that waited for one another here,
    # each with several campaigns in one commit, would deadlock. SQLite knows no row locks and leaves it out.
    select(CampaignRow.id)
    .where(CampaignRow.id == bindparam("dealt"))
    .with_for_update(key_share=True, skip_locked=True)
    .scalar_subquery()
)
_SERVE = update(CampaignRow).where(_NOT_HELD).values(served=bindparam("count"))
_END_TURN = update(CampaignRow).where(_NOT_HELD).values(served=bindparam("count"), turn=LAST_TURN)


@dataclass(slots=True)
class _Line:
    """The fresh jobs of one campaign that certain capabilities can run, ascending by id, read as they are needed."""

    campaign: str
    priority: int
    rows: list[JobRecord] = field(default_factory=list)
    last: int = -1
    ended: bool = False

    @property
    def untouched(self) -> bool:
        """Whether nothing was read yet: then there is something, or the campaign would not be here."""
        return self.last < 0 and not self.ended


def due_retries(connection: Connection, capabilities: Iterable[str]) -> int:
    """Return how many jobs whose backoff is over wait to be tried again, of those that workers like this can run.

    Above `MOST_WOKEN` they are not counted.
    """
    known = {"now": database_now(connection), "capabilities": sorted(capabilities), "most": MOST_WOKEN}
    return connection.execute(_DUE_RETRIES, known).scalar_one()


def lease(
    connection: Connection, worker: str, capabilities: Sequence[str], max_jobs: int, terms: LeaseTerms
) -> list[LeasedJob]:
    """Grant jobs to one worker, as `lease_together` does."""
    wanted = LeaseWanted(worker=worker, capabilities=tuple(capabilities), max_jobs=max_jobs, terms=terms)
    return lease_together(connection, [wanted], database_now(connection)).jobs[0]


def lease_together(connection: Connection, wanted: Sequence[LeaseWanted], now: datetime) -> Grants:
    """Grant each worker up to `max_jobs` jobs, to one after the other.

    Traces come first: somebody is waiting for a picture. Episodes are taken from the running campaigns by priority,
    then in turn. The closer the queue is to its end, the smaller the grant, so that a generation's last jobs spread
    over all workers.

    A job that was tried before is granted alone, to a worker that holds nothing else: if it kills its worker, nobody
    is buried with it. It is not granted to the worker that failed it last as long as another one can run it: the
    fault may be the worker's. Once its backoff is over it goes before fresh jobs of its own priority and of lower
    ones; and as workers fetch ahead, whoever could take it but still holds jobs gets no fresh ones, so that somebody
    comes with empty hands soon.
    """
    if not wanted:
        return _NOTHING
    waiting, holdings = _look(connection, wanted, now)
    if len(wanted) > 1 and (waiting.retries or waiting.traces):
        alone = [lease_together(connection, [one], now) for one in wanted]
        return Grants(
            jobs=[grants.jobs[0] for grants in alone],
            campaigns=frozenset().union(*(grants.campaigns for grants in alone)),
        )
    # What is read ahead is locked, and not to be had by other coordinators meanwhile: no more than will be granted.
    deal = _Deal(connection, now, ahead=sum(_limit(one, waiting.jobs) for one in wanted[1:]))
    grants: list[list[JobRecord]] = []
    for one in wanted:
        limit = _limit(one, waiting.jobs - sum(map(len, grants)))
        rows = _choose(connection, deal, one, holdings.get(one.worker, ()), waiting, limit)
        deal.note(rows)
        grants.append(rows)
    granted = _grant(connection, wanted, grants, now)
    _write_turns(connection, deal.changed)
    return granted


class _Deal:
    """Deals fresh jobs out in memory, to one worker after the other.

    Args:
        connection: Where they are read, and locked, as they are needed.
        now: The database's time.
        ahead: How many jobs those may want who come after the first.

    Attributes:
        changed: Of each campaign that was served, its turn, past `_AFTER_ALL` if that is another one, and how many
            jobs it has handed out in it.
    """

    def __init__(self, connection: Connection, now: datetime, *, ahead: int) -> None:
        self.now = now
        self._connection = connection
        self._ahead = ahead
        self._lines: dict[tuple[str, ...], list[_Line]] = {}
        self._granted: set[int] = set()
        self._running: set[tuple[str, str]] = set()
        self._stands: dict[str, tuple[int, int]] = {}
        self._turns_ended = 0
        self.changed: dict[str, tuple[int, int]] = {}

    def fresh(self, capabilities: tuple[str, ...], limit: int, live_workers: int) -> list[JobRecord]:
        """Take up to `limit` fresh jobs from the running campaigns, by priority, then in turn.

        A turn ends with the grant by which the campaign has handed out so many jobs a live worker, or when there are
        no more: campaigns that took turns job by job would come to the ends of their generations together, and
        workers wait for the last jobs of all.
        """
        if limit <= 0:  # traces took it all
            return []
        lines = [
            line for line in self._of(capabilities) if line.untouched or self._first(line, 1, capabilities)
        ]
        lines.sort(key=lambda line: (-line.priority, self._stands[line.campaign][0], line.campaign))
        rows: list[JobRecord] = []
        for line in lines:
            more = self._first(line, limit - len(rows), capabilities, ahead=self._ahead)
            if not more:
                continue
            rows += more
            turn, served = self._stands[line.campaign]
            served += len(more)
            if served >= TURN * live_workers:
                self._turns_ended += 1
                turn, served = _AFTER_ALL + self._turns_ended, 0
            self._stands[line.campaign] = self.changed[line.campaign] = (turn, served)
            if len(rows) == limit:
                break
        return rows

    def note(self, rows: Sequence[JobRecord]) -> None:
        """Note what one worker gets: nobody else may have it, nor run the same."""
        self._granted |= {row.id for row in rows}
        self._running |= {(row.spec_hash, row.kind) for row in rows}

    def _of(self, capabilities: tuple[str, ...]) -> list[_Line]:
        if capabilities not in self._lines:
            known = {"capabilities": capabilities, "now": self.now}
            found = self._connection.execute(_CAMPAIGNS_IN_TURN, known).all()
            self._lines[capabilities] = [_Line(campaign=row.id, priority=row.priority) for row in found]
            for row in found:
                self._stands.setdefault(row.id, (row.turn, row.served))
        return self._lines[capabilities]

    def _first(
        self, line: _Line, count: int, capabilities: tuple[str, ...], *, ahead: int = 0
    ) -> list[JobRecord]:
        """Return the first jobs of a line that are still to be had, without taking them from it."""
        line.rows = [row for row in line.rows if self._to_be_had(row)]
        while len(line.rows) < count and not line.ended:
            most = count - len(line.rows) + ahead
            asked = {
                "capabilities": capabilities, "now": self.now, "campaign": line.campaign, "after": line.last,
                "most": most,
            }  # fmt: skip
            more = _locked_rows(self._connection, _FRESH_WORK, asked)
            line.ended = len(more) < most
            line.last = more[-1].id if more else line.last
            line.rows += [row for row in more if self._to_be_had(row)]
        return line.rows[:count]

    def _to_be_had(self, row: JobRecord) -> bool:
        return row.id not in self._granted and not (row.cache and (row.spec_hash, row.kind) in self._running)


def _choose(
    connection: Connection,
    deal: _Deal,
    wanted: LeaseWanted,
    attempts: Sequence[int],
    waiting: JobRecord,
    limit: int,
) -> list[JobRecord]:
    """Return what one worker gets, who holds jobs with these attempts; of fresh ones no more than the limit."""
    if any(attempt > 1 for attempt in attempts):
        return []
    known = {"capabilities": wanted.capabilities, "now": deal.now}
    if waiting.retries:
        mine = {**known, "worker": wanted.worker, "elsewhere": list(wanted.terms.elsewhere)}
        retry = connection.execute(_RETRY, mine).first()
        if retry is not None and _goes_first(connection, retry, known, traces=waiting.traces):
            if attempts:
                return []
            if rows := _locked_rows(
                connection, _RETRY, mine
            ):  # none if another coordinator is just granting it
                return rows
    rows = _locked_rows(connection, _FRESH_TRACES, {**known, "most": limit}) if waiting.traces else []
    return _without_twins(
        [*rows, *deal.fresh(wanted.capabilities, limit - len(rows), wanted.terms.live_workers)]
    )


def _look(
    connection: Connection, wanted: Sequence[LeaseWanted], now: datetime
) -> tuple[JobRecord, dict[str, list[int]]]:
    """Return what waits, and the attempts of the jobs that workers hold where these decide anything."""
    workers = [one.worker for one in wanted]
    enough = max(_enough(one) for one in wanted) + sum(one.max_jobs for one in wanted[1:])
    capabilities = sorted({name for one in wanted for name in one.capabilities})
    known: dict[str, Any] = {"enough": enough, "now": now, "capabilities": capabilities}
    if connection.dialect.name == "sqlite":
        waiting: JobRecord = connection.execute(_WAITING, known).one()
        rows = connection.execute(_HOLDINGS_SQLITE, {"workers": json.dumps(workers)}).all()
    else:  # where a question has a way to go
        waiting = connection.execute(_WAITING_OR_TRIED, {**known, "workers": workers}).one()
        decide = waiting.retries or waiting.tried
        rows = connection.execute(_HOLDINGS, {"workers": workers}).all() if decide else []
    holdings: dict[str, list[int]] = {}
    for row in rows:
        holdings.setdefault(row.lease_worker, []).append(row.attempt)
    return waiting, holdings


def _enough(wanted: LeaseWanted) -> int:
    """Return how many waiting jobs need not be counted any further: the grant is as large as it can be."""
    return wanted.terms.live_workers * (wanted.max_jobs + 1) * 3 // 2


def _limit(wanted: LeaseWanted, waiting: int) -> int:
    """Return how many jobs a worker gets at most: two thirds of an equal share of what is queued.

    So grants are large at first, and single jobs at the end. Half would need a fifth more requests and gain nothing;
    all of it lets the slowest worker keep the others waiting.
    """
    share = -(-2 * min(waiting, _enough(wanted)) // (3 * wanted.terms.live_workers))
    return min(wanted.max_jobs, max(1, share))


def _goes_first(connection: Connection, retry: JobRecord, known: dict[str, Any], *, traces: bool) -> bool:
    """Return whether a job that was tried before goes before all fresh ones that the worker could have."""
    if retry.kind == JobKind.TRACE:
        return True
    if traces and connection.execute(_FRESH_TRACES, {**known, "most": 1}).first() is not None:
        return False
    best = connection.execute(_CAMPAIGNS_IN_TURN, known).first()
    return best is None or retry.priority >= best.priority


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
    connection: Connection, wanted: Sequence[LeaseWanted], grants: Sequence[list[JobRecord]], now: datetime
) -> Grants:
    granted: list[list[LeasedJob]] = []
    values: dict[float, list[tuple[int, str, str]]] = {}
    for one, rows in zip(wanted, grants, strict=True):
        jobs = [_leased(row) for row in rows]
        granted.append(jobs)
        values.setdefault(one.terms.lease_s, []).extend((job.job, job.token, one.worker) for job in jobs)
    for lease_s, rows_of in values.items():
        _GRANT.run(connection, rows_of, {"expires": now + timedelta(seconds=lease_s)})
    return Grants(jobs=granted, campaigns=frozenset(row.campaign_id for rows in grants for row in rows))


def _write_turns(connection: Connection, changed: dict[str, tuple[int, int]]) -> None:
    for campaign, (turn, served) in sorted(changed.items(), key=lambda item: item[1]):
        statement = _END_TURN if turn > _AFTER_ALL else _SERVE
        connection.execute(statement, {"dealt": campaign, "count": served})


def _leased(row: JobRecord) -> LeasedJob:
    return LeasedJob(
        job=row.id,
        token=secrets.token_hex(16),
        attempt=row.attempt + 1,
        spec=json.loads(row.spec),
        record=row.kind == JobKind.TRACE,
        timeout_s=row.timeout_s,
        campaign=row.campaign_id,
    )

"""The SQL of reports: results are stored, jobs finished, retried, or quarantined.

Each public function is a unit for `brink.server.db.writer.Writer`. An outcome is stored and its job finished in one
transaction, and only if the outcome names the token of the job's last lease: while that lease holds, and after it ran
out until the job is granted again.
"""

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any, Final, Protocol, TypeAlias

from sqlalchemy import Connection, bindparam, case, exists, insert, select, update

from brink.server.db.models import JobRow, TraceRow
from brink.server.db.sql import driver_time, in_list, storable, transaction_time
from brink.server.db.statements import BulkUpdate, Statement, Values, read
from brink.server.queue.job_store import IS_LEASED, idle_campaigns
from brink.server.queue.lease_policy import LeaseTerms
from brink.server.states import JobStatus
from brink.worker.wire import Completed

JobRecord: TypeAlias = Any
"""A row with some columns of a job."""

UNJUDGED: Final = "unjudged"
"""Status of an outcome of which nothing was stored, because `ResultCheck.judge` has to be asked first."""
MAX_ERROR_CHARACTERS = 4000
MAX_BACKOFF_S = 300.0
MAX_DOUBLINGS = 30
MAX_EXPIRED = 1000
"""Maximum number of leases that one sweep takes back, so that other writes do not wait long if all expire at once."""

# Built once: building a statement takes longer than running it.
_TWIN = JobRow.__table__.alias("twin")
_HAS_TWINS = exists(
    select(_TWIN.c.id)
    .where(
        _TWIN.c.spec_hash == JobRow.spec_hash,
        _TWIN.c.kind == JobRow.kind,
        _TWIN.c.status == JobStatus.QUEUED,  # a parameter, as in `lease_store`
    )
    .offset(0)  # forces one lookup for each job: Postgres might otherwise collect all queued jobs first
)
_REPORTED_JOBS = select(
    JobRow.id,
    JobRow.campaign_id,
    JobRow.kind,
    JobRow.status,
    JobRow.lease_token,
    JobRow.lost_token,
    JobRow.lease_worker,
    JobRow.attempt,
    JobRow.max_attempts,
    JobRow.losses,
    JobRow.spec_hash,
    JobRow.cache,
    _HAS_TWINS.label("has_twins"),
    transaction_time("now").label("now"),
).where(in_list(JobRow.id, "jobs"))
_REPORTED = Statement(
    _REPORTED_JOBS,
    # Locking rows in the order of their ids prevents deadlocks.
    postgres=_REPORTED_JOBS.order_by(JobRow.id).with_for_update(of=JobRow),
)
_FINISH = BulkUpdate(
    JobRow.id, [JobRow.result], status=JobStatus.DONE, finished_at=bindparam("now"), lease_expires_at=None
)
_TWINS = (
    select(JobRow.id, JobRow.spec_hash, JobRow.kind, JobRow.campaign_id)
    .where(in_list(JobRow.spec_hash, "spec_hashes"), JobRow.status == JobStatus.QUEUED, JobRow.cache)
    .order_by(JobRow.id)
)
_EXPIRED_JOBS = (
    select(
        JobRow.id,
        JobRow.campaign_id,
        JobRow.attempt,
        JobRow.losses,
        JobRow.max_losses,
        JobRow.lease_worker,
        JobRow.interrupted,
        transaction_time("now").label("now"),
    )
    .where(IS_LEASED, JobRow.lease_expires_at < transaction_time("now"))
    .order_by(JobRow.lease_expires_at)
    .limit(bindparam("most"))
)
_EXPIRED = Statement(_EXPIRED_JOBS, postgres=_EXPIRED_JOBS.with_for_update(of=JobRow, skip_locked=True))
_LOSE = (
    update(JobRow)
    .where(in_list(JobRow.id, "jobs"))
    .values(losses=JobRow.losses + 1, lost_token=JobRow.lease_token, lease_token=None)
)
_TAKE_BACK = (
    update(JobRow)
    .where(in_list(JobRow.id, "jobs"))
    .values(
        status=JobStatus.QUEUED,
        attempt=JobRow.attempt - 1,
        lost_token=JobRow.lease_token,
        lease_token=None,
        lease_expires_at=None,
    )
)
"""For interrupted leases. The mark stays until the next lease: `_RESTORE` then knows what to undo."""
_RESTORE = (
    update(JobRow)
    .where(in_list(JobRow.id, "jobs"))
    .values(
        status=JobStatus.LEASED,
        attempt=JobRow.attempt + case((JobRow.interrupted, 1), else_=0),
        losses=JobRow.losses - case((JobRow.interrupted, 0), else_=1),
        lease_token=JobRow.lost_token,
        lost_token=None,
        lease_expires_at=bindparam("now"),
        interrupted=False,
    )
)


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whether a campaign can use a result.

    Attributes:
        refusal: Why it cannot; None if it can.
    """

    refusal: str | None = None


@dataclass(frozen=True, slots=True)
class UnjudgedResult:
    """A result whose usability a transaction cannot decide.

    Attributes:
        campaign: The campaign.
        kind: What the result's job was for.
        result: The result.
    """

    campaign: str
    kind: str
    result: Completed


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A worker's report on one job.

    Attributes:
        job: Id of the job.
        token: Token of the lease.
        result: The completed episode as JSON, without its trace, or None if the attempt failed.
        completed: The same, parsed.
        trace: The recorded trace, if any.
        error: Why the attempt failed.
        final: Whether another attempt would be pointless.
        judgement: Whether its campaign can use it; None if that is not known yet.
    """

    job: int
    token: str
    result: str | None
    completed: Completed | None = None
    trace: bytes | None = None
    error: str = ""
    final: bool = False
    judgement: Judgement | None = None


class ResultCheck(Protocol):
    """Decides which results a campaign can use."""

    def __call__(self, campaign_id: str, kind: str, result: Completed) -> Judgement | None:
        """Return whether a campaign can use a result, in a write transaction; None if that cannot be decided there.

        Args:
            campaign_id: The campaign.
            kind: What the result's job was for.
            result: The result.
        """

    async def judge(self, results: Sequence[UnjudgedResult]) -> Sequence[Judgement]:
        """Return whether campaigns can use results, outside a transaction and in bounded time."""

    def close(self) -> None:
        """End the threads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedAttempt:
    """An attempt that failed or whose lease ran out.

    Attributes:
        worker: The worker that held the lease.
        final: Whether the job is in quarantine now.
    """

    job: int
    campaign: str
    worker: str
    attempt: int
    reason: str
    final: bool

    @property
    def log_fields(self) -> dict[str, object]:
        """Fields for the log."""
        return {
            "campaign": self.campaign,
            "job": self.job,
            "worker": self.worker,
            "attempt": self.attempt,
            "reason": self.reason.partition("\n")[0],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The result of storing outcomes.

    Attributes:
        statuses: ``accepted``, ``invalid``, ``duplicate``, ``stale`` or `UNJUDGED`, in the order of the outcomes.
        campaigns: The campaigns that have no open evaluation left.
        owners: The campaign of each known job.
        quarantined: The final attempts at jobs that went into quarantine.
        changes_queue: Whether anything but the accepted jobs may have changed, or these went back to the queue.
        unjudged: What `ResultCheck.judge` is to tell of, by job; of several results of a job, any. These outcomes
            changed nothing.
    """

    statuses: tuple[str, ...]
    campaigns: tuple[str, ...]
    owners: Mapping[int, str] = field(default_factory=dict)
    quarantined: tuple[FailedAttempt, ...] = ()
    changes_queue: bool = False
    unjudged: Mapping[int, UnjudgedResult] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Expiry:
    """The leases that a sweep took back.

    Attributes:
        campaigns: The campaigns that have no open evaluation left because of it.
        lost: Leases that were lost with their workers.
        interrupted: Leases that ended after an outage, which count for nothing.
    """

    campaigns: tuple[str, ...] = ()
    lost: Sequence[FailedAttempt] = ()
    interrupted: Sequence[FailedAttempt] = ()


def reported_query(outcomes: Sequence[Outcome]) -> tuple[Statement, Values]:
    """Return the query for the reported jobs, which locks them until the transaction ends."""
    return _REPORTED, {"jobs": sorted({outcome.job for outcome in outcomes}), "now": datetime.now(UTC)}


def store_outcomes(
    connection: Connection,
    outcomes: Sequence[Outcome],
    found: Sequence[JobRecord],
    retry_backoff_s: float,
    check: ResultCheck | None = None,
) -> Report:
    """Store the outcomes of jobs that nobody else holds; other outcomes change nothing.

    Args:
        connection: In a write transaction.
        outcomes: What workers report.
        found: The rows of `reported_query`.
        retry_backoff_s: Delay before the first retry; doubles with each attempt.
        check: Refuses results that are of no use; their attempts have failed. None to store all results.

    Returns:
        The report, with the campaigns of all accepted outcomes, idle or not.
    """
    if not found:
        return Report(statuses=tuple("stale" for _ in outcomes), campaigns=())
    now = driver_time(found[0].now)
    rows: dict[int, JobRecord] = {row.id: row for row in found}
    restored = _restore_lost(connection, rows, outcomes, now)
    rows |= restored
    statuses, accepted, unjudged = _judge(rows, outcomes, check)
    done = {job: outcome.result for job, outcome in accepted.items() if outcome.result is not None}
    _finish(connection, done, now)
    _keep_traces(connection, {rows[o.job].spec_hash: o.trace for o in accepted.values() if o.trace}, now)
    sharing = _share(
        connection, [rows[job] for job in done if rows[job].cache and rows[job].has_twins], done, now
    )
    failed = _fail(
        connection,
        [_failure(rows[job], o) for job, o in accepted.items() if o.result is None],
        now,
        retry_backoff_s,
    )
    touched = {rows[job].campaign_id for job in accepted} | sharing
    return Report(
        statuses=tuple(statuses),
        campaigns=tuple(sorted(touched)),
        owners={job: row.campaign_id for job, row in rows.items()},
        quarantined=tuple(attempt for attempt in failed if attempt.final),
        changes_queue=bool(restored or failed) or any(rows[job].has_twins for job in accepted),
        unjudged=unjudged,
    )


def _judge(
    rows: Mapping[int, JobRecord], outcomes: Sequence[Outcome], check: ResultCheck | None
) -> tuple[list[str], dict[int, Outcome], dict[int, UnjudgedResult]]:
    """Return the status of each outcome, and by job the outcomes to store and those that cannot be decided here.

    Invalid results are failures.
    """
    statuses: list[str] = []
    accepted: dict[int, Outcome] = {}
    unjudged: dict[int, UnjudgedResult] = {}
    for outcome in outcomes:
        # A result after an unjudged one is judged, too, and found to be a duplicate once the first is stored.
        before = unjudged if outcome.completed is None else {}
        status = _status_of(rows.get(outcome.job), outcome, outcome.job in accepted or outcome.job in before)
        if status == "accepted":
            row = rows[outcome.job]
            judgement = _judgement(row, outcome, check)
            if judgement is None:
                assert outcome.completed is not None
                status = UNJUDGED
                unjudged[outcome.job] = UnjudgedResult(row.campaign_id, row.kind, outcome.completed)
            elif judgement.refusal is not None:
                status = "invalid"
                error = storable(f"invalid result: {judgement.refusal}")
                accepted[outcome.job] = replace(outcome, result=None, trace=None, error=error)
            else:
                accepted[outcome.job] = outcome
        statuses.append(status)
    return statuses, accepted, unjudged


def expire(connection: Connection, terms: LeaseTerms) -> Expiry:
    """Take back the oldest `MAX_EXPIRED` leases that ran out.

    Those that an outage interrupted count as given back. The others are lost: their jobs are retried later, or put
    into quarantine after too many losses.
    """
    (rows,) = read(connection, (_EXPIRED, {"now": datetime.now(UTC), "most": MAX_EXPIRED}))
    if not rows:
        return Expiry()
    now = driver_time(rows[0].now)
    interrupted = [row for row in rows if row.interrupted]
    lost = [row for row in rows if not row.interrupted]
    failed = _fail(connection, [_loss(row) for row in lost], now, terms.retry_backoff_s)
    if lost:
        connection.execute(_LOSE, {"jobs": [row.id for row in lost]})
    if interrupted:
        connection.execute(_TAKE_BACK, {"jobs": [row.id for row in interrupted]})
    return Expiry(
        campaigns=idle_campaigns(connection, {row.campaign_id for row in lost}),
        lost=failed,
        interrupted=[_interruption(row) for row in interrupted],
    )


def _restore_lost(
    connection: Connection, rows: Mapping[int, JobRecord], outcomes: Sequence[Outcome], now: datetime
) -> dict[int, JobRecord]:
    """Restore lost leases whose outcomes have arrived after all, unless their jobs have since been granted to others.

    Returns:
        The new rows of these jobs.
    """
    late = {
        outcome.job
        for outcome in outcomes
        if (row := rows.get(outcome.job)) is not None
        and row.status == JobStatus.QUEUED
        and row.lost_token is not None
        and secrets.compare_digest(row.lost_token, outcome.token)
    }
    if not late:
        return {}
    known = {"jobs": sorted(late), "now": now}
    connection.execute(_RESTORE, known)
    return {row.id: row for row in read(connection, (_REPORTED, known))[0]}


def _status_of(row: JobRecord | None, outcome: Outcome, reported_before: bool) -> str:
    if row is None or row.lease_token is None:
        return "stale"
    if not secrets.compare_digest(row.lease_token, outcome.token):
        return "stale"
    if row.status == JobStatus.LEASED and not reported_before:
        return "accepted"
    return "duplicate"


def _judgement(row: JobRecord, outcome: Outcome, check: ResultCheck | None) -> Judgement | None:
    """Return whether a result is usable; None if that cannot be decided in a transaction."""
    if check is None or outcome.completed is None:
        return Judgement()
    return outcome.judgement or check(row.campaign_id, row.kind, outcome.completed)


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
    """Finish queued jobs of the same simulations with new results; return their campaigns."""
    if not rows:
        return set()
    results = {(row.spec_hash, row.kind): done[row.id] for row in rows}
    wanted = {"spec_hashes": [row.spec_hash for row in rows]}
    twins = [twin for twin in connection.execute(_TWINS, wanted) if (twin.spec_hash, twin.kind) in results]
    _finish(connection, {twin.id: results[twin.spec_hash, twin.kind] for twin in twins}, now)
    return {twin.campaign_id for twin in twins}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Failure:
    """The consequences for a job whose attempt failed or was lost.

    Attributes:
        row: The job.
        error: What happened.
        times: How often it has happened to the job, this time included, at least 1.
        retry: Whether the job is tried again.
    """

    row: JobRecord
    error: str
    times: int
    retry: bool


def _failure(row: JobRecord, outcome: Outcome) -> _Failure:
    times = row.attempt - row.losses
    retry = not outcome.final and times < row.max_attempts
    return _Failure(row=row, error=outcome.error, times=times, retry=retry)


def _loss(row: JobRecord) -> _Failure:
    times = row.losses + 1
    error = f"lease expired: worker {row.lease_worker} stopped responding"
    retry = times < row.max_losses
    if not retry:
        again = "" if times == 1 else f", the {times}th time that this job lost its worker"
        error += f"{again}: does it kill its workers, or were they all stopped?"
    return _Failure(row=row, error=error, times=times, retry=retry)


def _interruption(row: JobRecord) -> FailedAttempt:
    reason = "lease expired after an outage of the coordinator, which is not charged to the job"
    return FailedAttempt(
        job=row.id,
        campaign=row.campaign_id,
        worker=row.lease_worker,
        attempt=row.attempt,
        reason=reason,
        final=False,
    )


def _fail(
    connection: Connection, failures: Sequence[_Failure], now: datetime, backoff_s: float
) -> list[FailedAttempt]:
    """Return failed jobs to the queue after a backoff, or quarantine them."""
    if not failures:
        return []
    values, failed = [], []
    for failure in failures:
        row, retry = failure.row, failure.retry
        wait_s = min(MAX_BACKOFF_S, backoff_s * 2 ** min(failure.times - 1, MAX_DOUBLINGS))
        values.append(
            {
                "failed": row.id,
                "by": row.lease_worker,
                "next_status": JobStatus.QUEUED if retry else JobStatus.QUARANTINED,
                "wait_until": now + timedelta(seconds=wait_s) if retry else None,
                "error": failure.error[-MAX_ERROR_CHARACTERS:],
                "ended": None if retry else now,
            }
        )
        failed.append(
            FailedAttempt(
                job=row.id,
                campaign=row.campaign_id,
                worker=row.lease_worker,
                attempt=row.attempt,
                reason=failure.error,
                final=not retry,
            )
        )
    connection.execute(
        update(JobRow)
        .where(JobRow.id == bindparam("failed"))
        .values(
            status=bindparam("next_status"),
            not_before=bindparam("wait_until"),
            failed_worker=bindparam("by"),
            last_error=bindparam("error"),
            finished_at=bindparam("ended"),
            lease_expires_at=None,  # the token stays: the same report sent again is a duplicate
        ),
        values,
    )
    return failed

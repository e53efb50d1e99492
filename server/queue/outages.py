"""Detects outages: periods in which no coordinator took back leases, so that no worker could renew one.

Outages are nobody's fault. After one, every lease gets a full term before it can run out, and until its worker renews
it, its end counts as *interrupted*, not as lost. The time of the last sweep is in the database and goes by its clock,
so that coordinators which share a database share it too.
"""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlalchemy import Connection, bindparam, false, insert, select, update

from brink.server.db.models import JobRow, SweepRow
from brink.server.db.sql import database_now, driver_time, in_list, lock_rows, transaction_time
from brink.server.db.statements import Statement, read, write
from brink.server.queue.job_store import IS_LEASED

GAP_LEASES = 0.5
"""Time without a sweep that counts as an outage, in terms of a lease. Workers renew leases every third of one."""
GAP_SWEEPS = 2
"""The same in intervals of the sweeper, in case these are longer than leases."""
NOTED_LEASES = 0.1
"""Interval at which sweeps are noted, in terms of a lease: an idle coordinator hardly ever writes to the disk."""

_LAST_SWEEP = select(SweepRow.swept_at, transaction_time("now").label("now"))
_READ_LAST = Statement(_LAST_SWEEP)
_LOCK_LAST = Statement(
    _LAST_SWEEP,
    # Skipped, not waited for, if locked: two coordinators with other writes in their transactions could deadlock.
    postgres=_LAST_SWEEP.with_for_update(of=SweepRow, skip_locked=True),
)
_NOTE_SWEEP = Statement(update(SweepRow).values(swept_at=bindparam("now")))
_SHORT = select(JobRow.id).where(IS_LEASED, JobRow.lease_expires_at < bindparam("until"))
_NOT_YET_EXTENDED = _SHORT.where(JobRow.interrupted == false())
_EXTEND = (
    update(JobRow)
    .where(in_list(JobRow.id, "jobs"))
    .values(lease_expires_at=bindparam("until"), interrupted=True)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """The beginning of a sweep.

    Attributes:
        away_s: Time since the last sweep of any coordinator, in seconds; None if this is the first one.
        extended: Number of leases that got a full term.
    """

    away_s: float | None
    extended: int


def begin_sweep(connection: Connection, *, lease_s: float, sweep_s: float, resuming: bool) -> Sweep | None:
    """Record a sweep, and give leases a full term if there was none for a while.

    A coordinator that resumes gives each lease one full term even if another one swept meanwhile: its workers may
    know no other. A lease that is not renewed gets no second one, so that a coordinator that keeps restarting beside
    others does not keep the jobs of dead workers.

    Args:
        connection: In a write transaction, which then takes back the leases that ran out.
        lease_s: How long a lease lasts.
        sweep_s: Interval between two sweeps.
        resuming: Whether this coordinator has just started, or its last sweep failed.

    Returns:
        None if another coordinator is sweeping: no lease may be taken back before it has committed.
    """
    asked = {"now": datetime.now(UTC)}
    if rows := read(connection, (_LOCK_LAST, asked))[0]:
        now = driver_time(rows[0].now)
        away_s = (now - driver_time(rows[0].swept_at)).total_seconds()
    elif read(connection, (_READ_LAST, asked))[0]:
        return None
    else:
        now, away_s = database_now(connection), None
        connection.execute(insert(SweepRow).values(id=1, swept_at=now))
    is_gap = away_s is None or away_s > max(GAP_LEASES * lease_s, GAP_SWEEPS * sweep_s)
    extended = 0
    if is_gap or resuming:
        extended = _extend(connection, now + timedelta(seconds=lease_s), again=is_gap)
    # A negative time means that the clock was put back.
    if resuming or (away_s is not None and not 0 <= away_s <= NOTED_LEASES * lease_s):
        write(connection, _NOTE_SWEEP, {"now": now})
    return Sweep(away_s=away_s, extended=extended)


def _extend(connection: Connection, until: datetime, *, again: bool) -> int:
    """Extend the leases that end earlier, skipping locked ones, which are just being renewed or ended."""
    short = lock_rows(_SHORT if again else _NOT_YET_EXTENDED, connection, JobRow, skip_locked=True)
    jobs = list(connection.execute(short, {"until": until}).scalars())
    if jobs:
        connection.execute(_EXTEND, {"jobs": jobs, "until": until})
    return len(jobs)

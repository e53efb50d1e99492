"""The SQL of leases that are held: renewed, given back, let go.

Each public function is a unit for `brink.server.db.writer.Writer`. Whoever does not name the token of the row changes
nothing.
"""

import secrets
from collections.abc import Iterable
from datetime import timedelta

from sqlalchemy import Connection, select, update

from brink.server.db.clock import database_now
from brink.server.db.locking import locked
from brink.server.db.models import JobRow
from brink.server.states import JobStatus
from brink.worker.wire import HeldLease


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

"""Which workers were heard of, and which of them are dead."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Connection, bindparam, delete, exists, func, insert, select, update

from brink.server.db.clock import database_now
from brink.server.db.locking import locked
from brink.server.db.many import among
from brink.server.db.models import IS_LEASED, JobRow, WorkerRow
from brink.worker.wire import HeldLease, WorkerIdentity, machine_name

_LIVE = select(WorkerRow.id, WorkerRow.machine, WorkerRow.pid, WorkerRow.capabilities).where(
    WorkerRow.last_seen_at >= bindparam("horizon")
)
"""Made once: every page that is open asks for it every few seconds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenWorker:
    """A worker, when it was heard of, and what it holds."""

    id: str
    host: str
    pid: int
    version: str
    capabilities: tuple[str, ...]
    first_seen_at: datetime
    last_seen_at: datetime
    seen_s_ago: float
    jobs_done: int
    jobs_failed: int
    jobs_held: int
    gone: bool
    """Known to be dead: its process was on this machine, and is no more."""


def note(
    connection: Connection, worker: WorkerIdentity, capabilities: Sequence[str], *, done: int, failed: int
) -> None:
    """Note that a worker was heard of, and how many more jobs it finished."""
    now = database_now(connection)
    values: dict[str, Any] = {
        "host": worker.host, "pid": worker.pid, "machine": worker.machine, "version": worker.version,
        "last_seen_at": now,
    }  # fmt: skip
    if capabilities:
        values["capabilities"] = list(capabilities)
    changed = connection.execute(
        update(WorkerRow)
        .where(WorkerRow.id == worker.id)
        .values(**values, jobs_done=WorkerRow.jobs_done + done, jobs_failed=WorkerRow.jobs_failed + failed)
    )
    if changed.rowcount == 0:
        values["capabilities"] = list(capabilities)
        connection.execute(
            insert(WorkerRow).values(
                id=worker.id, first_seen_at=now, jobs_done=done, jobs_failed=failed, **values
            )
        )


def add_counts(connection: Connection, worker_id: str, *, done: int, failed: int) -> None:
    """Note jobs that a worker finished, of which there was no news since."""
    connection.execute(
        update(WorkerRow)
        .where(WorkerRow.id == worker_id)
        .values(jobs_done=WorkerRow.jobs_done + done, jobs_failed=WorkerRow.jobs_failed + failed)
    )


def list_seen(connection: Connection, *, within_s: float | None = None) -> list[SeenWorker]:
    """Return workers and what they hold, the latest heard of first; with `within_s`, only the live ones."""
    now = database_now(connection)
    holding = select(JobRow.lease_worker, func.count()).where(IS_LEASED).group_by(JobRow.lease_worker)
    held = {str(row[0]): int(row[1]) for row in connection.execute(holding)}
    query = select(WorkerRow.__table__).order_by(WorkerRow.last_seen_at.desc(), WorkerRow.id)
    if within_s is not None:
        query = query.where(WorkerRow.last_seen_at >= now - timedelta(seconds=within_s))
    seen = [
        SeenWorker(
            id=row.id, host=row.host, pid=row.pid, version=row.version,
            capabilities=tuple(row.capabilities), first_seen_at=row.first_seen_at,
            last_seen_at=row.last_seen_at, seen_s_ago=max(0.0, (now - row.last_seen_at).total_seconds()),
            jobs_done=row.jobs_done, jobs_failed=row.jobs_failed, jobs_held=held.get(row.id, 0),
            gone=process_is_gone(row.machine, row.pid),
        )
        for row in connection.execute(query)
    ]  # fmt: skip
    return seen if within_s is None else [worker for worker in seen if not worker.gone]


def capabilities_of_live(connection: Connection, within_s: float) -> dict[str, tuple[str, ...]]:
    """Return what each worker can run that any coordinator heard of lately, but for those known to be dead."""
    horizon = database_now(connection) - timedelta(seconds=within_s)
    return {
        row.id: tuple(row.capabilities)
        for row in connection.execute(_LIVE, {"horizon": horizon})
        if not process_is_gone(row.machine, row.pid)
    }


def can_run(connection: Connection, needs: str, within_s: float) -> bool:
    """Return whether a live worker can run what needs this: one heard of lately, or whose lease still holds."""
    now = database_now(connection)
    holds_a_lease = exists(
        select(JobRow.id).where(
            IS_LEASED,
            JobRow.lease_worker == WorkerRow.id,
            JobRow.lease_expires_at >= now,
        )
    )
    query = select(WorkerRow.machine, WorkerRow.pid, WorkerRow.capabilities).where(
        (WorkerRow.last_seen_at >= now - timedelta(seconds=within_s)) | holds_a_lease
    )
    return any(
        needs in row.capabilities and not process_is_gone(row.machine, row.pid)
        for row in connection.execute(query)
    )


def leases_of(connection: Connection, gone: Callable[[str, int], bool]) -> list[HeldLease]:
    """Return the leases of workers that are gone.

    Args:
        connection: To the database.
        gone: Whether the process of a machine and a process id is no more.
    """
    holders = select(WorkerRow.id, WorkerRow.machine, WorkerRow.pid).where(
        exists(select(JobRow.id).where(IS_LEASED, JobRow.lease_worker == WorkerRow.id))
    )
    dead = [row.id for row in connection.execute(holders).all() if gone(row.machine, row.pid)]
    if not dead:
        return []
    held = select(JobRow.id, JobRow.lease_token).where(IS_LEASED, among(JobRow.lease_worker, "workers"))
    return [
        HeldLease(job=row.id, token=row.lease_token) for row in connection.execute(held, {"workers": dead})
    ]


def process_is_gone(machine: str, pid: int) -> bool:
    """Return whether a process ran on this machine (`worker.machine`) and is no more."""
    if not machine or machine != machine_name() or pid <= 0:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except (PermissionError, OverflowError):
        return False
    return False


def forget_absent(connection: Connection, after_s: float) -> int:
    """Forget workers that were not heard of for so long and hold nothing; return how many."""
    holding = exists(select(JobRow.id).where(IS_LEASED, JobRow.lease_worker == WorkerRow.id))
    absent = select(WorkerRow.id).where(
        WorkerRow.last_seen_at < database_now(connection) - timedelta(seconds=after_s), ~holding
    )
    names = list(connection.execute(locked(absent, connection, WorkerRow, skip_locked=True)).scalars())
    if names:
        connection.execute(delete(WorkerRow).where(among(WorkerRow.id, "names")), {"names": names})
    return len(names)

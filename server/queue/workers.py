"""Workers that contacted a coordinator: their capabilities, their jobs, and whether they are gone."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from sqlalchemy import Connection, bindparam, case, delete, exists, func, insert, select, update

from brink.server.db.models import JobRow, WorkerRow
from brink.server.db.sql import database_now, in_list, lock_rows
from brink.server.db.statements import Statement, read
from brink.server.queue.job_store import IS_LEASED
from brink.worker.wire import HeldLease, WorkerIdentity, machine_name

_LIVE = select(WorkerRow.id, WorkerRow.machine, WorkerRow.pid, WorkerRow.capabilities).where(
    WorkerRow.last_seen_at >= bindparam("horizon"), WorkerRow.drained_at.is_(None)
)
"""Built once, because every open page runs it every few seconds."""
_DRAINING = Statement(
    select(WorkerRow.id, WorkerRow.pid, WorkerRow.machine).where(WorkerRow.drained_at.is_not(None))
)
_PROCESSES = select(WorkerRow.id, WorkerRow.pid, WorkerRow.machine, WorkerRow.last_seen_at).where(
    in_list(WorkerRow.id, "names")
)
_REFRESH = (
    update(WorkerRow)
    .where(WorkerRow.id == bindparam("named"))
    .values(
        last_seen_at=bindparam("seen"),
        jobs_done=WorkerRow.jobs_done + bindparam("done"),
        jobs_failed=WorkerRow.jobs_failed + bindparam("failed"),
    )
)


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerStatus:
    """A worker with its last contact and its jobs.

    Attributes:
        seen_s_ago: Time since the last contact, in seconds.
        gone: Whether the worker is known to be dead: its process was on this machine and has ended.
        draining: Whether the worker is to finish its jobs and exit.
    """

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
    draining: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """A worker's last contact.

    Attributes:
        worker: The worker.
        capabilities: What it can run; empty if it did not say.
        ago_s: Time since the contact, in seconds.
        done: Jobs completed since the previous record.
        failed: Failed attempts since then.
    """

    worker: WorkerIdentity
    capabilities: Sequence[str] = ()
    ago_s: float = 0.0
    done: int = 0
    failed: int = 0

    @property
    def process(self) -> "Process":
        """The worker's process."""
        return Process(self.worker.pid, self.worker.machine)


def record_contact(connection: Connection, contact: Contact) -> None:
    """Record a worker's contact and the jobs it finished since the previous one, in a write transaction."""
    worker, now = contact.worker, database_now(connection)
    values: dict[str, Any] = {
        "host": worker.host,
        "pid": worker.pid,
        "machine": worker.machine,
        "version": worker.version,
        "last_seen_at": now - timedelta(seconds=contact.ago_s),
    }
    if contact.capabilities:
        values["capabilities"] = list(contact.capabilities)
    # Another process with the same id has not been asked to exit.
    same = (WorkerRow.pid == worker.pid) & (WorkerRow.machine == worker.machine)
    values["drained_at"] = case((same, WorkerRow.drained_at), else_=None)
    changed = connection.execute(
        update(WorkerRow)
        .where(WorkerRow.id == worker.id)
        .values(
            **values,
            jobs_done=WorkerRow.jobs_done + contact.done,
            jobs_failed=WorkerRow.jobs_failed + contact.failed,
        )
    )
    if changed.rowcount == 0:
        values |= {"capabilities": list(contact.capabilities), "drained_at": None}
        connection.execute(
            insert(WorkerRow).values(
                id=worker.id, first_seen_at=now, jobs_done=contact.done, jobs_failed=contact.failed, **values
            )
        )


def record_contacts(connection: Connection, contacts: Sequence[Contact]) -> None:
    """Record the last contacts of any number of workers, with one statement for all known workers.

    Contacts are left out if another process with the same id has made a later one.
    """
    if not contacts:
        return
    known = connection.execute(_PROCESSES, {"names": [one.worker.id for one in contacts]})
    stored = {row.id: (Process(row.pid, row.machine), row.last_seen_at) for row in known}
    now = database_now(connection)
    rows: list[dict[str, Any]] = []
    for one in sorted(contacts, key=lambda one: one.worker.id):  # in one order: no deadlocks
        seen = now - timedelta(seconds=one.ago_s)
        process, last_seen = stored.get(one.worker.id, (None, None))
        if process == one.process:
            rows.append({"named": one.worker.id, "seen": seen, "done": one.done, "failed": one.failed})
        elif last_seen is None or last_seen < seen:
            record_contact(connection, one)
    if rows:
        connection.execute(_REFRESH, rows)


class Process(NamedTuple):
    """The process of a worker, which tells apart processes with the same worker id."""

    pid: int
    machine: str


def drain(connection: Connection, worker_id: str) -> Process | None:
    """Ask a worker to finish its jobs and exit; return its process, or None if there is no such worker."""
    found = connection.execute(
        select(WorkerRow.pid, WorkerRow.machine).where(WorkerRow.id == worker_id)
    ).one_or_none()
    if found is None:
        return None
    connection.execute(
        update(WorkerRow).where(WorkerRow.id == worker_id).values(drained_at=database_now(connection))
    )
    return Process(found.pid, found.machine)


def read_draining(connection: Connection) -> dict[str, Process]:
    """Return the workers that were asked to finish their jobs and exit, by id."""
    return {row.id: Process(row.pid, row.machine) for row in read(connection, (_DRAINING, {}))[0]}


def list_workers(connection: Connection, *, within_s: float | None = None) -> list[WorkerStatus]:
    """Return workers, the latest contact first; with `within_s`, only live ones."""
    now = database_now(connection)
    holding = select(JobRow.lease_worker, func.count()).where(IS_LEASED).group_by(JobRow.lease_worker)
    held = {str(row[0]): int(row[1]) for row in connection.execute(holding)}
    query = select(WorkerRow.__table__).order_by(WorkerRow.last_seen_at.desc(), WorkerRow.id)
    if within_s is not None:
        query = query.where(WorkerRow.last_seen_at >= now - timedelta(seconds=within_s))
    seen = [
        WorkerStatus(
            id=row.id,
            host=row.host,
            pid=row.pid,
            version=row.version,
            capabilities=tuple(row.capabilities),
            first_seen_at=row.first_seen_at,
            last_seen_at=row.last_seen_at,
            seen_s_ago=max(0.0, (now - row.last_seen_at).total_seconds()),
            jobs_done=row.jobs_done,
            jobs_failed=row.jobs_failed,
            jobs_held=held.get(row.id, 0),
            gone=process_is_gone(row.machine, row.pid),
            draining=row.drained_at is not None,
        )
        for row in connection.execute(query)
    ]
    return seen if within_s is None else [worker for worker in seen if not worker.gone]


def live_capabilities(connection: Connection, within_s: float) -> dict[str, tuple[str, ...]]:
    """Return what each live worker can run, by worker id.

    A worker is live if it contacted any coordinator within this time, is not known to be dead, and takes jobs.
    """
    horizon = database_now(connection) - timedelta(seconds=within_s)
    return {
        row.id: tuple(row.capabilities)
        for row in connection.execute(_LIVE, {"horizon": horizon})
        if not process_is_gone(row.machine, row.pid)
    }


def can_run(connection: Connection, needs: str, within_s: float) -> bool:
    """Return whether an undrained worker, live or with an unexpired lease, offers a capability."""
    now = database_now(connection)
    holds_a_lease = exists(
        select(JobRow.id).where(
            IS_LEASED, JobRow.lease_worker == WorkerRow.id, JobRow.lease_expires_at >= now
        )
    )
    query = select(WorkerRow.machine, WorkerRow.pid, WorkerRow.capabilities).where(
        WorkerRow.drained_at.is_(None),
        (WorkerRow.last_seen_at >= now - timedelta(seconds=within_s)) | holds_a_lease,
    )
    return any(
        needs in row.capabilities and not process_is_gone(row.machine, row.pid)
        for row in connection.execute(query)
    )


def leases_of_dead(connection: Connection) -> list[HeldLease]:
    """Return the leases of workers whose processes were on this machine and have ended."""
    holders = select(WorkerRow.id, WorkerRow.machine, WorkerRow.pid).where(
        exists(select(JobRow.id).where(IS_LEASED, JobRow.lease_worker == WorkerRow.id))
    )
    dead = [row.id for row in connection.execute(holders).all() if process_is_gone(row.machine, row.pid)]
    if not dead:
        return []
    held = select(JobRow.id, JobRow.lease_token).where(IS_LEASED, in_list(JobRow.lease_worker, "workers"))
    return [
        HeldLease(job=row.id, token=row.lease_token) for row in connection.execute(held, {"workers": dead})
    ]


def process_is_gone(machine: str, pid: int) -> bool:
    """Return whether a process ran on this machine (see `machine_name`) and has ended."""
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
    """Delete workers that hold no lease and have made no contact for a given time; return how many."""
    holding = exists(select(JobRow.id).where(IS_LEASED, JobRow.lease_worker == WorkerRow.id))
    absent = select(WorkerRow.id).where(
        WorkerRow.last_seen_at < database_now(connection) - timedelta(seconds=after_s), ~holding
    )
    names = list(connection.execute(lock_rows(absent, connection, WorkerRow, skip_locked=True)).scalars())
    if names:
        connection.execute(delete(WorkerRow).where(in_list(WorkerRow.id, "names")), {"names": names})
    return len(names)

"""Examines a database and those who work on it: what is wrong, and what to do about it."""

import hashlib
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import Final

import numpy as np
from sqlalchemy import Connection, func, select, text
from sqlalchemy.exc import DBAPIError

from brink.search.errors import SearchError
from brink.server.campaigns import step_store, store
from brink.server.campaigns.plan import make_plan, restored_archive
from brink.server.db.clock import database_now
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow, DistanceBlockRow, JobRow
from brink.server.db.upgrade import current_revision, head_revision
from brink.server.errors import ServerError
from brink.server.queue.workers import list_seen
from brink.server.settings import Settings
from brink.server.states import CampaignStatus, JobStatus

SKEW_S: Final = 2.0
"""A database's clock may be off by so much from this machine's."""
OVERDUE_S: Final = 30.0
"""A lease, or a step, that is due for longer than this was seen to by nobody."""
LEAST_FREE_BYTES: Final = 1 << 30
SAMPLED_ROWS: Final = 64
"""Solutions of a campaign whose stored distances are computed again."""


class State(StrEnum):
    """How a check went."""

    FINE = "fine"
    LOOK = "look"
    WRONG = "wrong"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What a check found.

    Attributes:
        check: What was looked at.
        state: How it went.
        found: In words.
        advice: What to do; empty if nothing.
    """

    check: str
    state: State
    found: str
    advice: str = ""


def examine(settings: Settings, engines: Engines, *, thorough: bool) -> Iterator[Finding]:
    """Give what each check found, one after another; those that need the database stop where it cannot be read.

    Args:
        settings: Which database, and how long a worker is waited for.
        engines: Of that database.
        thorough: Whether to read all checkpoints and distances, and compute some of them again.
    """
    try:
        with engines.reader.connect() as connection:
            connection.execute(text("SELECT 1"))
        revision = current_revision(engines)
    except (ServerError, DBAPIError) as error:
        words = str(error.orig if isinstance(error, DBAPIError) else error).strip().splitlines()
        yield Finding(
            check="database", state=State.WRONG, found=words[0] if words else "it does not answer",
            advice="is the URL right, the server up, the file there?",
        )  # fmt: skip
        return
    yield Finding(check="database", state=State.FINE, found="it answers")
    if revision != head_revision():
        yield Finding(
            check="schema", state=State.WRONG, found=f"{revision or 'none'}, this version needs {head_revision()}",
            advice="brink db upgrade",
        )  # fmt: skip
        return
    yield Finding(check="schema", state=State.FINE, found=str(revision))
    checks: list[Callable[[Connection], Iterator[Finding]]] = [
        _clock,
        lambda connection: _workers(connection, settings),
        _leases,
        _jobs,
        _campaigns,
    ]
    if settings.sqlite_file is not None:
        checks.insert(0, lambda connection: _file(connection, settings))
    if thorough:
        checks.append(_stored)
    for check in checks:
        with engines.reader.connect() as connection:
            yield from check(connection)


def _file(connection: Connection, settings: Settings) -> Iterator[Finding]:
    file = settings.sqlite_file
    assert file is not None
    said = connection.execute(text("PRAGMA quick_check(1)")).scalar_one()
    free = shutil.disk_usage(file.resolve().parent).free
    size = file.stat().st_size
    if said != "ok":
        yield Finding(
            check="file", state=State.WRONG, found=f"it is damaged: {said}",
            advice="stop everything, keep a copy, and recover what can be with sqlite3 .recover",
        )  # fmt: skip
    elif free < max(LEAST_FREE_BYTES, size // 10):
        yield Finding(
            check="file", state=State.LOOK, found=f"{_bytes(size)}; {_bytes(free)} are left on its disk",
            advice="make room: brink db prune",
        )  # fmt: skip
    else:
        yield Finding(
            check="file", state=State.FINE, found=f"{_bytes(size)}; {_bytes(free)} are left on its disk"
        )


def _clock(connection: Connection) -> Iterator[Finding]:
    skew_s = (database_now(connection) - datetime.now(UTC)).total_seconds()
    found = f"the database's is {abs(skew_s):.1f} s {'ahead of' if skew_s > 0 else 'behind'} this machine's"
    if abs(skew_s) > SKEW_S:
        yield Finding(
            check="clock", state=State.LOOK, found=found,
            advice="leases go by the database's clock alone; mend it for the sake of logs",
        )  # fmt: skip
    else:
        yield Finding(check="clock", state=State.FINE, found=found)


def _workers(connection: Connection, settings: Settings) -> Iterator[Finding]:
    live = list_seen(connection, within_s=settings.worker_seen_s)
    offered = {capability for worker in live for capability in worker.capabilities}
    waiting = (
        select(JobRow.needs, func.count())
        .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
        .where(JobRow.status == JobStatus.QUEUED, CampaignRow.status == CampaignStatus.RUNNING)
        .group_by(JobRow.needs)
    )
    queued = {str(row[0]): int(row[1]) for row in connection.execute(waiting)}
    found = f"{len(live)} heard of in the last {settings.worker_seen_s:g} s"
    lacking = {needs: count for needs, count in queued.items() if needs not in offered}
    if not lacking:
        yield Finding(check="workers", state=State.FINE, found=found)
    for needs, count in sorted(lacking.items()):
        yield Finding(
            check="workers", state=State.WRONG, found=f"{found}; {count} queued jobs need {needs}, which none offers",
            advice="start a worker where that is installed: brink worker --server URL",
        )  # fmt: skip


def _leases(connection: Connection) -> Iterator[Finding]:
    horizon = database_now(connection) - timedelta(seconds=OVERDUE_S)
    overdue, held = connection.execute(
        select(func.count().filter(JobRow.lease_expires_at < horizon), func.count()).where(
            JobRow.status == JobStatus.LEASED
        )
    ).one()
    if overdue:
        yield Finding(
            check="leases", state=State.WRONG,
            found=f"{overdue} of {held} ran out over {OVERDUE_S:g} s ago, and nobody took them back",
            advice="is a coordinator running on this database? brink serve",
        )  # fmt: skip
    else:
        yield Finding(check="leases", state=State.FINE, found=f"{held} held")


def _jobs(connection: Connection) -> Iterator[Finding]:
    by_status = (
        select(JobRow.status, func.count())
        .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
        .where(CampaignRow.status.in_([CampaignStatus.RUNNING, CampaignStatus.PAUSED]))
        .group_by(JobRow.status)
    )
    counts = {str(row[0]): int(row[1]) for row in connection.execute(by_status)}
    found = ", ".join(f"{count} {status}" for status, count in sorted(counts.items())) or "none"
    quarantined = counts.get(JobStatus.QUARANTINED, 0)
    if quarantined:
        yield Finding(
            check="jobs", state=State.LOOK, found=f"of campaigns that go on: {found}",
            advice="see why with brink status ID; retry with POST /api/v1/jobs/ID/retry",
        )  # fmt: skip
    else:
        yield Finding(check="jobs", state=State.FINE, found=f"of campaigns that go on: {found}")


def _campaigns(connection: Connection) -> Iterator[Finding]:
    horizon = database_now(connection) - timedelta(seconds=OVERDUE_S)
    stuck = 0
    for campaign_id in store.running_idle(connection):
        campaign = store.find_campaign(connection, campaign_id)
        latest = connection.execute(
            select(func.max(JobRow.finished_at)).where(JobRow.campaign_id == campaign_id)
        ).scalar_one()
        since = latest or (campaign.created_at if campaign is not None else None)
        if since is not None and since < horizon:
            stuck += 1
            yield Finding(
                check="campaigns", state=State.WRONG,
                found=f"{campaign_id} has had nothing to simulate since {since:%Y-%m-%d %H:%M:%S} UTC",
                advice="is a coordinator running, and what does its log say? Its step is due, or its seeds",
            )  # fmt: skip
    if not stuck:
        running = connection.execute(
            select(func.count()).where(CampaignRow.status == CampaignStatus.RUNNING)
        ).scalar_one()
        yield Finding(check="campaigns", state=State.FINE, found=f"{running} running, none of them stuck")


def _stored(connection: Connection) -> Iterator[Finding]:
    """Read every campaign's checkpoint and distances, and compute some of the distances again."""
    names = connection.execute(select(CampaignRow.id).order_by(CampaignRow.created_at)).scalars().all()
    broken = 0
    compared = 0
    for name in names:
        try:
            compared += _compared_rows(connection, name)
        except (ServerError, SearchError, ValueError, LookupError) as error:
            broken += 1
            yield Finding(
                check="stored", state=State.WRONG, found=f"{name}: {error}",
                advice="results of single simulations are apart and stay; the search cannot go on from here",
            )  # fmt: skip
    if not broken:
        yield Finding(
            check="stored", state=State.FINE,
            found=f"archives of {len(names)} campaigns; {compared} solutions' distances computed again",
        )  # fmt: skip


def _compared_rows(connection: Connection, campaign_id: str) -> int:
    """Return how many solutions' stored distances were found to be what they should be.

    Raises:
        ValueError: Something is not what it should be.
    """
    campaign = store.find_campaign(connection, campaign_id)
    assert campaign is not None
    plan = make_plan(campaign.body)
    stored = step_store.read_archive(connection, campaign_id, plan.problem.space.dimension)
    archive = restored_archive(plan, stored)
    _check_blocks(connection, campaign_id)
    count = len(archive)
    if count < 2:
        return 0
    rows = sorted(set(np.linspace(0, count - 1, min(count, SAMPLED_ROWS)).astype(int).tolist()))
    known = step_store.read_distances(connection, campaign_id, rows)
    if known is None:
        return 0
    again = archive.distances(rows, rows)
    wrong = np.abs(known - again).max()
    if wrong > 1e-5:
        raise ValueError(f"stored distances differ by up to {wrong:.2g} from what they should be")
    return len(rows)


def _check_blocks(connection: Connection, campaign_id: str) -> None:
    """Raise ValueError if a block of distances has not the checksum with which it was stored."""
    query = select(DistanceBlockRow.generation, DistanceBlockRow.sha256, DistanceBlockRow.data).where(
        DistanceBlockRow.campaign_id == campaign_id
    )
    # One block at a time: all of them may take more memory than there is.
    with connection.execution_options(stream_results=True, yield_per=1).execute(query) as blocks:
        for block in blocks:
            if hashlib.sha256(block.data).hexdigest() != block.sha256:
                raise ValueError(f"the distances of generation {block.generation} are damaged")


def _bytes(count: float) -> str:
    for unit in ("B", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.0f} {unit}"
        count /= 1024
    return f"{count:.1f} GiB"

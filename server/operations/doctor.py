"""Diagnoses a database, its workers and its campaigns: what is wrong, and what to do about it."""

import hashlib
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import Final

import numpy as np
from sqlalchemy import Connection, func, select, text
from sqlalchemy.exc import DBAPIError

from brink.search.errors import SearchError
from brink.server.campaigns import step_store
from brink.server.campaigns.plan import make_plan, restored_archive
from brink.server.campaigns.store import CAMPAIGNS
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow, DistanceBlockRow
from brink.server.db.sql import database_now
from brink.server.db.upgrade import current_revision, head_revision
from brink.server.errors import InvalidInput, ServerError
from brink.server.operations.verification import (
    Verification,
    count_missing_jobs,
    verify_counts,
    verify_results,
)
from brink.server.queue import job_store
from brink.server.queue.workers import list_workers
from brink.server.settings import Settings
from brink.server.states import CampaignStatus, JobStatus
from brink.sim.catalogue import start_words

SKEW_S: Final = 2.0
"""Tolerated difference between the database's clock and this machine's."""
OVERDUE_S: Final = 30.0
"""A lease that expired longer ago than this, or a step that has been due for longer, was overlooked."""
LEAST_FREE_BYTES: Final = 1 << 30
SAMPLED_ROWS: Final = 64
"""Solutions of each campaign whose stored distances are verified."""
VERIFIED_RESULTS: Final = 20_000
"""Results that are evaluated again unless all are to be: these take a few seconds."""
RESTORE: Final = "restore the database from a backup; the results of the search since then depend on this"


class State(StrEnum):
    """The result of a check."""

    FINE = "fine"
    LOOK = "look"
    WRONG = "wrong"


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding of the diagnosis.

    Attributes:
        check: Name of the check.
        state: Its result.
        found: What was found.
        advice: What to do; empty if nothing.
    """

    check: str
    state: State
    found: str
    advice: str = ""


def examine(
    settings: Settings, engines: Engines, *, thorough: bool, restored: bool = False
) -> Iterator[Finding]:
    """Yield the findings of all checks; only of the first ones if the database cannot be used.

    Args:
        settings: The coordinator's settings.
        engines: Its database.
        thorough: Also read all results, checkpoints and distances, and verify some distances by computing them again.
        restored: Check only what is stored: nothing runs on this database, which was restored from a backup.
    """
    try:
        with engines.reader.connect() as connection:
            connection.execute(text("SELECT 1"))
        revision = current_revision(engines)
    except (ServerError, DBAPIError) as error:
        words = str(error.orig if isinstance(error, DBAPIError) else error).strip().splitlines()
        advice = "check the URL, and that the server runs or the file exists"
        yield Finding("database", State.WRONG, words[0] if words else "no answer", advice)
        return
    yield Finding("database", State.FINE, "reachable")
    if revision != head_revision():
        found = f"{revision or 'none'}, this version needs {head_revision()}"
        yield Finding("schema", State.WRONG, found, "brink db upgrade")
        return
    yield Finding("schema", State.FINE, str(revision))
    checks: list[Callable[[Connection], Iterator[Finding]]] = [
        _jobs,
        lambda connection: _results(connection, None if thorough else VERIFIED_RESULTS),
    ]
    if not restored:
        checks.insert(1, _campaigns)
        checks[:0] = [_clock, lambda connection: _workers(connection, settings), _leases]
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
    integrity = connection.execute(text("PRAGMA quick_check(1)")).scalar_one()
    free = shutil.disk_usage(file.resolve().parent).free
    size = file.stat().st_size
    if integrity != "ok":
        advice = "stop everything, copy the file, and recover the data with sqlite3 .recover"
        yield Finding("file", State.WRONG, f"damaged: {integrity}", advice)
    elif free < max(LEAST_FREE_BYTES, size // 10):
        advice = "free some space: brink db prune"
        yield Finding("file", State.LOOK, f"{_bytes(size)}; {_bytes(free)} free on its disk", advice)
    else:
        yield Finding("file", State.FINE, f"{_bytes(size)}; {_bytes(free)} free on its disk")


def _clock(connection: Connection) -> Iterator[Finding]:
    skew_s = (database_now(connection) - datetime.now(UTC)).total_seconds()
    found = (
        f"the database's clock is {abs(skew_s):.1f} s {'ahead of' if skew_s > 0 else 'behind'} this machine's"
    )
    if abs(skew_s) > SKEW_S:
        advice = "leases are not affected, but times in logs are: correct this machine's clock"
        yield Finding("clock", State.LOOK, found, advice)
    else:
        yield Finding("clock", State.FINE, found)


def _workers(connection: Connection, settings: Settings) -> Iterator[Finding]:
    live = list_workers(connection, within_s=settings.worker_seen_s)
    offered = {capability for worker in live for capability in worker.capabilities}
    queued: Counter[str] = Counter()
    for one in job_store.count_jobs(connection):
        if one.status is JobStatus.QUEUED and one.campaign_status is CampaignStatus.RUNNING:
            queued[one.needs] += one.jobs
    found = f"{len(live)} in contact within the last {settings.worker_seen_s:g} s"
    lacking = {needs: count for needs, count in queued.items() if needs not in offered}
    if not lacking:
        yield Finding("workers", State.FINE, found)
    for needs, count in sorted(lacking.items()):
        advice = start_words(needs, "URL")
        unrunnable = f"{count} queued jobs need {needs}, which no live worker offers"
        yield Finding("workers", State.WRONG, f"{found}; {unrunnable}", advice)


def _leases(connection: Connection) -> Iterator[Finding]:
    horizon = database_now(connection) - timedelta(seconds=OVERDUE_S)
    overdue, held = job_store.count_leases(connection, horizon)
    if overdue:
        advice = "is a coordinator running on this database? brink serve"
        found = f"{overdue} of {held} expired over {OVERDUE_S:g} s ago and were not reclaimed"
        yield Finding("leases", State.WRONG, found, advice)
    else:
        yield Finding("leases", State.FINE, f"{held} held")


def _jobs(connection: Connection) -> Iterator[Finding]:
    counts = job_store.count_by_status(connection, [CampaignStatus.RUNNING, CampaignStatus.PAUSED])
    found = ", ".join(f"{count} {status}" for status, count in sorted(counts.items())) or "none"
    if retriable := job_store.count_retriable(connection):
        found += f"; the campaigns have not gone on without {retriable} of those in quarantine"
        advice = "see the reason with brink status ID; put them back into the queue with brink retry ID"
        yield Finding("jobs", State.LOOK, f"of running and paused campaigns: {found}", advice)
    else:
        yield Finding("jobs", State.FINE, f"of running and paused campaigns: {found}")


def _campaigns(connection: Connection) -> Iterator[Finding]:
    horizon = database_now(connection) - timedelta(seconds=OVERDUE_S)
    stuck = 0
    for campaign_id in job_store.idle_campaigns(connection):
        campaign = CAMPAIGNS.find(connection, campaign_id)
        latest = job_store.last_finished_at(connection, campaign_id)
        since = latest or (campaign.created_at if campaign is not None else None)
        if since is not None and since < horizon:
            stuck += 1
            advice = "is a coordinator running, and what does its log say? A step or seeds are due"
            found = f"{campaign_id} has had no open job since {since:%Y-%m-%d %H:%M:%S} UTC"
            yield Finding("campaigns", State.WRONG, found, advice)
    if not stuck:
        running = connection.execute(
            select(func.count()).where(CampaignRow.status == CampaignStatus.RUNNING)
        ).scalar_one()
        yield Finding("campaigns", State.FINE, f"{running} running, none of them stuck")

    overdue = select(func.count()).where(CampaignRow.deleted_at < horizon)
    if left := connection.execute(overdue).scalar_one():
        advice = "any coordinator on this database continues it: brink serve"
        found = f"{left} were deleted over {OVERDUE_S:g} s ago, and their rows are not erased yet"
        yield Finding("campaigns", State.LOOK, found, advice)


_SHOWN: Final = select(CampaignRow.id).where(CampaignRow.deleted_at.is_(None))
"""Campaigns that were not deleted."""


def _results(connection: Connection, limit: int | None) -> Iterator[Finding]:
    """Look for solutions without jobs, and evaluate results again, those of the latest campaigns first.

    Args:
        connection: Sees one snapshot.
        limit: Maximum number of results; None for all.
    """
    sound = True
    for name, count, first in count_missing_jobs(connection):
        sound = False
        found = f"{name}: the jobs of {count} solutions are missing, the first of them of solution {first}"
        yield Finding("results", State.WRONG, found, RESTORE)
    verified = late = 0
    names = connection.execute(_SHOWN.order_by(CampaignRow.created_at.desc())).scalars().all()
    for name in names:
        campaign = CAMPAIGNS.find(connection, name)
        assert campaign is not None
        wrong = verify_counts(connection, campaign)
        try:
            done = verify_results(connection, campaign, None if limit is None else limit - verified)
        except InvalidInput as error:
            advice = "install the plug-ins that the campaign was run with"
            yield Finding("results", State.LOOK, f"{name} cannot be verified here: {error}", advice)
            sound, done = False, Verification()
        verified += done.verified
        late += done.late
        for words in filter(None, (wrong, str(done))):
            sound = False
            yield Finding("results", State.WRONG, f"{name}: {words}", RESTORE)
    if sound:
        rest = "" if limit is None or verified < limit else ", the newest; --thorough verifies all"
        retried = f"; {late} count as failed, since their jobs were retried too late" if late else ""
        yield Finding("results", State.FINE, f"verdicts of {verified} solutions verified{rest}{retried}")


def _stored(connection: Connection) -> Iterator[Finding]:
    """Read the checkpoint and the distances of each campaign, and verify some distances."""
    names = connection.execute(_SHOWN.order_by(CampaignRow.created_at)).scalars().all()
    broken = 0
    compared = 0
    for name in names:
        try:
            compared += _verify(connection, name)
        except (ServerError, SearchError, ValueError, LookupError) as error:
            broken += 1
            advice = "the results of simulations are not affected, but the search cannot continue"
            yield Finding("stored", State.WRONG, f"{name}: {error}", advice)
    if not broken:
        found = f"archives of {len(names)} campaigns; distances of {compared} solutions verified"
        yield Finding("stored", State.FINE, found)


def _verify(connection: Connection, campaign_id: str) -> int:
    """Verify a campaign's archive; return for how many solutions the distances were verified.

    Raises:
        ValueError: Stored data is damaged or wrong.
    """
    campaign = CAMPAIGNS.find(connection, campaign_id)
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
        raise ValueError(f"stored distances differ by up to {wrong:.2g} from computed ones")
    return len(rows)


def _check_blocks(connection: Connection, campaign_id: str) -> None:
    """Check the checksums of all distance blocks.

    Raises:
        ValueError: A block does not match its checksum.
    """
    query = select(DistanceBlockRow.generation, DistanceBlockRow.sha256, DistanceBlockRow.data).where(
        DistanceBlockRow.campaign_id == campaign_id
    )
    # One block at a time: all of them may not fit into memory.
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

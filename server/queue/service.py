"""What workers ask of the coordinator: leases, heartbeats, results.

Everything that changes a job goes through the one writer. News travels on the event loop: whoever enqueues jobs
wakes waiting workers; `on_idle` is called with the campaigns that have no open job left.
"""

import asyncio
import base64
import itertools
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from sqlalchemy import Connection

from brink.server.db.writer import Joint, Writer
from brink.server.errors import FieldError, InvalidInput
from brink.server.metrics import Metrics
from brink.server.queue import holding_store, lease_store, report_store, workers
from brink.server.queue.exchange import Exchange, Exchanged, exchange
from brink.server.queue.values import LeaseTerms, LeaseWanted, Loss, Outcome, Report
from brink.server.queue.wakeups import Wakeups
from brink.server.settings import Settings
from brink.worker.wire import (
    Completed,
    HeartbeatReply,
    HeartbeatRequest,
    HeldLease,
    LeasedJob,
    LeaseReply,
    LeaseRequest,
    ResultsReply,
    ResultsRequest,
    ResultStatus,
    WorkerIdentity,
)

RECHECK_S = 10.0
"""Pause after which a waiting lease looks again by itself, in case that news was lost."""
SHARED_RECHECK_S = 2.0
"""The same where coordinators share a database: no news tells of jobs that one read ahead and did not grant."""
CREW_S = 0.5
"""How long a list of the live workers is good."""
TOUCH_S = 5.0
"""Pause between two notes in the database that a worker was heard of."""
FORGET_S = 24 * 3600.0
"""A worker that was not heard of for so long is no longer listed."""

log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Seen:
    """What this process remembers of a worker."""

    identity: WorkerIdentity
    at: float
    noted_at: float = 0.0
    capabilities: tuple[str, ...] = ()
    done: int = 0
    failed: int = 0


@dataclass(frozen=True, slots=True)
class _Crew:
    """The live workers as of a moment, what each of them can run, and how many can run each."""

    at: float
    capabilities: dict[str, tuple[str, ...]]
    count: Counter[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Swept:
    """What a sweep found.

    Attributes:
        idle: Campaigns that have no open job any more.
        lost: Leases that ran out.
        live: What the workers can run that any coordinator has heard of lately.
        due: How many jobs wait to be tried again that one of them can run.
    """

    idle: tuple[str, ...]
    lost: list[Loss]
    live: dict[str, tuple[str, ...]]
    due: int


@dataclass(slots=True)
class QueueService:
    """The queue of one coordinator process."""

    settings: Settings
    writer: Writer
    on_idle: Callable[[Iterable[str]], None]
    metrics: Metrics = field(default_factory=Metrics)
    wakeups: Wakeups = field(default_factory=Wakeups)
    clock: Callable[[], float] = time.monotonic
    stopping: bool = False
    _seen: dict[str, _Seen] = field(default_factory=dict)
    _crew: _Crew | None = None
    _with_others: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def _alone(self) -> bool:
        """Whether no other coordinator can share the database."""
        return self.settings.sqlite_file is not None

    def end_waits(self) -> None:
        """Answer those who wait for work with none, and let nobody wait any more."""
        self.stopping = True
        self.wakeups.wake()

    def terms(self, worker: str | None = None) -> LeaseTerms:
        """Return how leases are granted now, to a worker if one is named."""
        crew = self._live_crew()
        own = crew.capabilities.get(worker, ()) if worker is not None else ()
        return LeaseTerms(
            lease_s=self.settings.lease_s,
            retry_backoff_s=self.settings.retry_backoff_s,
            live_workers=max(1, len(crew.capabilities)),
            elsewhere=frozenset(name for name, count in crew.count.items() if count > (name in own)),
        )

    def _live_crew(self) -> _Crew:
        """Return the live workers: with a thousand of them, a look through all is too much for each request."""
        now = self.clock()
        if self._crew is None or now - self._crew.at >= CREW_S:
            horizon = now - self.settings.worker_seen_s
            mine = {name: seen.capabilities for name, seen in self._seen.items() if seen.at >= horizon}
            live = self._with_others | mine
            count = Counter(itertools.chain.from_iterable(map(set, live.values())))
            self._crew = _Crew(at=now, capabilities=live, count=count)
        return self._crew

    async def lease(self, request: LeaseRequest, gone: asyncio.Event) -> LeaseReply:
        """Grant jobs, waiting for some if need be, as long as the client is there."""
        deadline = self.clock() + request.wait_s
        while not gone.is_set():
            news = self.wakeups.news
            granted = await self._lease_now(request)
            remaining = deadline - self.clock()
            if granted and gone.is_set():
                await self._give_back(granted)
                break
            if granted or remaining <= 0 or self.stopping:
                return LeaseReply(jobs=granted, lease_s=self.settings.lease_s)
            recheck_s = RECHECK_S if self._alone else SHARED_RECHECK_S
            await self.wakeups.wait(min(remaining, recheck_s), gone, since=news)
        return LeaseReply(jobs=[], lease_s=self.settings.lease_s)

    async def heartbeat(self, request: HeartbeatRequest) -> HeartbeatReply:
        """Renew leases."""
        note = self._heard_of(request.worker, None)

        def unit(connection: Connection) -> list[int]:
            if note is not None:
                note(connection)
            return holding_store.renew(connection, request.leases, self.settings.lease_s)

        held = await asyncio.wrap_future(self.writer.submit(unit))
        return HeartbeatReply(held=held, lease_s=self.settings.lease_s)

    async def results(self, request: ResultsRequest, gone: asyncio.Event) -> ResultsReply:
        """Store outcomes, take leases back, and grant the next lease, all in one commit if there are jobs."""
        outcomes = [
            _outcome(index, item.job, item.token, item.outcome) for index, item in enumerate(request.results)
        ]
        notes = [self._heard_of(request.worker, None)]
        wanted = request.lease
        if wanted is not None:
            notes.append(self._heard_of(wanted.worker, wanted.capabilities))
        terms = self.terms(wanted.worker.id if wanted is not None else None)
        exchanged = await self._exchange(
            Exchange(
                terms=terms, notes=tuple(filter(None, notes)), outcomes=tuple(outcomes),
                release=tuple(request.release), wanted=_wanted(wanted, terms) if wanted is not None else None,
            )
        )  # fmt: skip
        report, released, granted = exchanged.report, exchanged.released, exchanged.granted
        self._count(request, report)
        _log_report(request, report)
        _log_granted(request.worker.id, granted)
        if released or report.quarantined:  # the latter may have kept the same simulation of others waiting
            self.wakeups.wake()  # not only the first in line, who may be unable to run what there is now
        self.on_idle(report.campaigns)
        reply: LeaseReply | None = None
        if wanted is not None:
            if granted and gone.is_set():
                await self._give_back(granted)
                granted = []
            reply = LeaseReply(jobs=granted, lease_s=self.settings.lease_s)
            if not granted and wanted.wait_s > 0:
                reply = await self.lease(wanted, gone)
        statuses = [
            ResultStatus.model_validate({"job": outcome.job, "status": status})
            for outcome, status in zip(outcomes, report.statuses, strict=True)
        ]
        return ResultsReply(statuses=statuses, lease=reply)

    def _count(self, request: ResultsRequest, report: Report) -> None:
        seen = self._seen.get(request.worker.id)
        for item, status in zip(request.results, report.statuses, strict=True):
            self.metrics.results.labels(status).inc()
            if status != "accepted":
                continue
            if not isinstance(item.outcome, Completed):
                self.metrics.failures.labels(item.outcome.reason).inc()
            if seen is not None:
                seen.done += isinstance(item.outcome, Completed)
                seen.failed += not isinstance(item.outcome, Completed)

    async def sweep(self) -> None:
        """Take back expired leases and forget workers that are gone."""
        terms = self.terms()
        local = self._alone
        unnoted = self._drop_absent()

        def unit(connection: Connection) -> _Swept:
            for name, seen in unnoted.items():
                workers.add_counts(connection, name, done=seen.done, failed=seen.failed)
            workers.forget_absent(connection, FORGET_S)
            live = {} if local else workers.capabilities_of_live(connection, self.settings.worker_seen_s)
            if local:  # then workers of this machine can be looked up, and need not be waited for
                dead = workers.leases_of(connection, workers.process_is_gone)
                holding_store.cut_short(connection, dead)
            idle, lost = report_store.expire(connection, terms)
            return _Swept(
                idle=idle,
                lost=lost,
                live=live,
                due=lease_store.due_retries(connection, terms.elsewhere),
            )

        swept = await asyncio.wrap_future(self.writer.submit(unit))
        self._with_others = {name: known for name, known in swept.live.items() if name not in self._seen}
        self._crew = None
        lost = swept.lost
        if lost:
            log.warning("leases that ran out: %d", len(lost))
            for loss in lost:
                log.info("lease ran out", extra=loss.fields)
            _log_quarantined(lost)
            self.metrics.expired.inc(len(lost))
        self.wakeups.wake(swept.due)
        self.on_idle(swept.idle)

    def _drop_absent(self) -> dict[str, _Seen]:
        """Drop workers that were not heard of lately, or are dead; return those with counts not yet noted."""
        horizon = self.clock() - self.settings.worker_seen_s
        absent = {
            name: seen
            for name, seen in self._seen.items()
            if seen.at < horizon or workers.process_is_gone(seen.identity.machine, seen.identity.pid)
        }
        for name, seen in absent.items():
            del self._seen[name]
            log.info(
                "worker gone", extra={"worker": name, "host": seen.identity.host, "pid": seen.identity.pid}
            )
        return {name: seen for name, seen in absent.items() if seen.done or seen.failed}

    async def _lease_now(self, request: LeaseRequest) -> list[LeasedJob]:
        note = self._heard_of(request.worker, request.capabilities)
        notes = (note,) if note is not None else ()
        terms = self.terms(request.worker.id)
        asked = Exchange(terms=terms, notes=notes, wanted=_wanted(request, terms))
        granted = (await self._exchange(asked)).granted
        _log_granted(request.worker.id, granted)
        return granted

    async def _exchange(self, request: Exchange) -> Exchanged:
        return await asyncio.wrap_future(self.writer.submit(Joint(exchange, request)))

    async def _give_back(self, granted: Sequence[LeasedJob]) -> None:
        """Return a grant whose client has gone, and let the next in line have it."""
        leases = [HeldLease(job=job.job, token=job.token) for job in granted]
        await asyncio.wrap_future(
            self.writer.submit(lambda connection: holding_store.release(connection, leases))
        )
        self.wakeups.wake()

    def _heard_of(
        self, worker: WorkerIdentity, capabilities: Sequence[str] | None
    ) -> Callable[[Connection], None] | None:
        """Remember a worker; return what notes it in the database, or None if that is not due."""
        now = self.clock()
        if worker.id not in self._seen:
            about = {"worker": worker.id, "host": worker.host, "pid": worker.pid, "version": worker.version}
            log.info("worker first seen", extra=about)
            self._crew = None
        seen = self._seen.setdefault(worker.id, _Seen(identity=worker, at=now))
        seen.at, seen.identity = now, worker
        changed = capabilities is not None and tuple(capabilities) != seen.capabilities
        if changed and capabilities is not None:
            seen.capabilities = tuple(capabilities)
            self._crew = None
        if not changed and now - seen.noted_at < TOUCH_S:
            return None
        done, failed = seen.done, seen.failed
        seen.noted_at, seen.done, seen.failed = now, 0, 0
        known = list(seen.capabilities)
        return lambda connection: workers.note(connection, worker, known, done=done, failed=failed)


def _wanted(request: LeaseRequest, terms: LeaseTerms) -> LeaseWanted:
    return LeaseWanted(
        worker=request.worker.id,
        capabilities=tuple(request.capabilities),
        max_jobs=request.max_jobs,
        terms=terms,
    )


def _log_granted(worker: str, granted: Sequence[LeasedJob]) -> None:
    if log.isEnabledFor(logging.DEBUG):
        for job in granted:
            about = {"campaign": job.campaign, "job": job.job, "worker": worker, "attempt": job.attempt}
            log.debug("job granted", extra=about)


def _log_report(request: ResultsRequest, report: Report) -> None:
    _log_quarantined(report.quarantined)
    if log.isEnabledFor(logging.DEBUG):
        for item, status in zip(request.results, report.statuses, strict=True):
            about = {
                "campaign": report.owners.get(item.job, ""),
                "job": item.job,
                "worker": request.worker.id,
            }
            log.debug("result %s", status, extra={**about, "outcome": item.outcome.kind})


def _log_quarantined(losses: Iterable[Loss]) -> None:
    for loss in losses:
        if loss.final:
            log.info("job in quarantine", extra=loss.fields)


def _outcome(index: int, job: int, token: str, outcome: Completed | object) -> Outcome:
    if isinstance(outcome, Completed):
        trace = None
        if outcome.trace is not None:
            try:
                trace = base64.b64decode(outcome.trace, validate=True)
            except ValueError:  # of base64, or a letter that is not ASCII
                raise InvalidInput(
                    [FieldError(pointer=f"/results/{index}/outcome/trace", message="expected base64")]
                ) from None
        return Outcome(job=job, token=token, result=outcome.model_dump_json(exclude={"trace"}), trace=trace)
    reason, message = getattr(outcome, "reason", "error"), getattr(outcome, "message", "")
    error = f"{reason}: {message}".replace("\0", "�")  # Postgres takes no NUL in a text
    return Outcome(job=job, token=token, result=None, error=error, final=reason == "invalid")

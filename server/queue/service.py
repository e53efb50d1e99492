"""Serves workers: leases, heartbeats, results.

All changes to jobs go through the writer. Waiting requests are woken on the event loop whenever jobs are enqueued,
and `on_due` is called with the campaigns that have no open job left, and with those that have another failed job.
"""

import asyncio
import base64
import itertools
import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

from sqlalchemy import Connection

from brink.server.db.sql import storable
from brink.server.db.writer import BatchedUnit, Unit, Writer
from brink.server.errors import FieldError, InvalidInput
from brink.server.metrics import Metrics
from brink.server.queue import lease_store, outages, report_store, workers
from brink.server.queue.exchange import Exchange, run_exchanges
from brink.server.queue.lease_policy import LeaseDemand, LeaseTerms
from brink.server.queue.outages import Sweep
from brink.server.queue.report_store import UNJUDGED, Expiry, FailedAttempt, Outcome, Report, ResultCheck
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
"""Interval at which a waiting lease looks for jobs by itself, in case a wake-up was lost."""
SHARED_RECHECK_S = 2.0
"""The same while another coordinator serves workers: no wake-up announces jobs that it read ahead and did not grant,
and on SQLite none of its jobs."""
LIVE_WORKERS_S = 0.5
"""How long a list of the live workers is reused."""
SPACING_S_A_WORKER = 1e-4
"""Time between two commits for each live worker: with many of them, requests share commits."""
MAX_SPACING_S = 0.025
"""Longest time between two commits."""
CONTACT_S = 5.0
"""Shortest interval at which a known worker's contacts are recorded in the database, all at once by a sweep."""
FORGET_S = 24 * 3600.0
"""A worker that has not made contact for this long is deleted."""

T = TypeVar("T")

log = logging.getLogger(__name__)


@dataclass(slots=True)
class _WorkerRecord:
    """A worker as this process knows it.

    Attributes:
        contact_s: Time of the last contact.
        recorded_s: Time when the contact was last recorded in the database, or given to a write that records it.
        done: Jobs completed since then.
        failed: Failed attempts since then.
    """

    identity: WorkerIdentity
    contact_s: float
    recorded_s: float = -math.inf
    capabilities: tuple[str, ...] = ()
    done: int = 0
    failed: int = 0

    @property
    def is_unrecorded(self) -> bool:
        """Whether the database lacks a contact, or jobs that ended."""
        return self.contact_s > self.recorded_s or self.done > 0 or self.failed > 0

    def take_contact(self, now_s: float) -> workers.Contact:
        """Return the last contact, which the caller records or else puts back."""
        contact = workers.Contact(
            worker=self.identity,
            capabilities=self.capabilities,
            ago_s=now_s - self.contact_s,
            done=self.done,
            failed=self.failed,
        )
        self.recorded_s, self.done, self.failed = now_s, 0, 0
        return contact

    def put_back(self, contact: workers.Contact) -> None:
        """Undo the recording of a contact, so that the next one is recorded in full."""
        self.recorded_s = -math.inf
        self.done += contact.done
        self.failed += contact.failed


@dataclass(frozen=True, slots=True)
class _LiveWorkers:
    """The live workers at one moment.

    Attributes:
        at_s: The moment.
        capabilities: What each worker can run.
        count: How many workers offer each capability.
    """

    at_s: float
    capabilities: dict[str, tuple[str, ...]]
    count: Counter[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Swept:
    """The results of a sweep.

    Attributes:
        sweep: How it began; None if another coordinator was sweeping.
        expiry: The leases taken back.
        elsewhere: What each live worker of any coordinator can run.
        due_retries: How many retries are due.
        draining: The workers that were asked to exit.
    """

    sweep: Sweep | None
    expiry: Expiry
    elsewhere: dict[str, tuple[str, ...]]
    due_retries: int
    draining: dict[str, workers.Process]


@dataclass(slots=True)
class QueueService:
    """The queue of one coordinator process."""

    settings: Settings
    writer: Writer
    on_due: Callable[[Iterable[str]], None]
    metrics: Metrics = field(default_factory=Metrics)
    wakeups: Wakeups = field(default_factory=Wakeups)
    clock: Callable[[], float] = time.monotonic
    check: ResultCheck | None = None
    stopping: bool = False
    _resuming: bool = True
    _workers: dict[str, _WorkerRecord] = field(default_factory=dict)
    _live: _LiveWorkers | None = None
    _elsewhere: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _draining: dict[str, workers.Process] = field(default_factory=dict)

    @property
    def has_workers_elsewhere(self) -> bool:
        """Whether another coordinator served workers lately, as of the last sweep."""
        return any(name not in self._workers for name in self._elsewhere)

    def end_waits(self) -> None:
        """Answer all waiting requests, and let no request wait from now on."""
        self.stopping = True
        self.wakeups.wake()

    def close(self) -> None:
        """End the threads; all waiting requests were answered."""
        if self.check is not None:
            self.check.close()
        self.writer.close()

    def terms(self, worker: str | None = None) -> LeaseTerms:
        """Return the current terms of leases, for the given worker or for any."""
        live = self._live_workers()
        own = live.capabilities.get(worker, ()) if worker is not None else ()
        return LeaseTerms(
            lease_s=self.settings.lease_s,
            retry_backoff_s=self.settings.retry_backoff_s,
            live_workers=max(1, len(live.capabilities)),
            elsewhere=frozenset(name for name, count in live.count.items() if count > (name in own)),
        )

    def _live_workers(self) -> _LiveWorkers:
        """Return the live workers, cached because counting a thousand of them for each request is too slow."""
        now = self.clock()
        if self._live is None or now - self._live.at_s >= LIVE_WORKERS_S:
            horizon = now - self.settings.worker_seen_s
            here = {
                name: one.capabilities
                for name, one in self._workers.items()
                if one.contact_s >= horizon and not self._is_draining(one.identity)
            }
            live = self._elsewhere | here
            count = Counter(itertools.chain.from_iterable(map(set, live.values())))
            self._live = _LiveWorkers(at_s=now, capabilities=live, count=count)
            self.writer.spacing_s = min(MAX_SPACING_S, SPACING_S_A_WORKER * len(live))
        return self._live

    async def lease(self, request: LeaseRequest, gone: asyncio.Event) -> LeaseReply:
        """Grant jobs, waiting for some if none are queued and the client stays connected."""
        deadline = self.clock() + request.wait_s
        while not gone.is_set():
            changes = self.wakeups.changes
            if self._is_draining(request.worker):
                return await self._refuse_more(request.worker)
            granted = await self._lease_now(request)
            remaining = deadline - self.clock()
            if granted and gone.is_set():
                await self._give_back(granted)
                break
            if granted or remaining <= 0 or self.stopping:
                return LeaseReply(jobs=granted, lease_s=self.settings.lease_s)
            recheck_s = SHARED_RECHECK_S if self.has_workers_elsewhere else RECHECK_S
            await self.wakeups.wait(min(remaining, recheck_s), gone, since=changes)
        return LeaseReply(jobs=[], lease_s=self.settings.lease_s)

    async def heartbeat(self, request: HeartbeatRequest) -> HeartbeatReply:
        """Renew leases."""
        contacts = self._note_contact(request.worker, None)

        def unit(connection: Connection) -> list[int]:
            for contact in contacts:
                workers.record_contact(connection, contact)
            return lease_store.renew(connection, request.leases, self.settings.lease_s)

        held = await self._write(unit, contacts)
        return HeartbeatReply(held=held, lease_s=self.settings.lease_s)

    async def results(self, request: ResultsRequest, gone: asyncio.Event) -> ResultsReply:
        """Store outcomes, take back leases, and grant the next ones, in one commit if jobs are queued.

        Args:
            request: The worker's request.
            gone: Set when the client has disconnected.

        Raises:
            InvalidInput: A trace is not base64.
        """
        traced = any(isinstance(item.outcome, Completed) and item.outcome.trace for item in request.results)
        outcomes = await asyncio.to_thread(_outcomes, request) if traced else _outcomes(request)
        contacts = self._note_contact(request.worker, None)
        draining = self._is_draining(request.worker)
        wanted = None if draining else request.lease
        if wanted is not None:
            contacts += self._note_contact(wanted.worker, wanted.capabilities)
        terms = self.terms(wanted.worker.id if wanted is not None else None)
        exchange = Exchange(
            terms=terms,
            contacts=contacts,
            outcomes=tuple(outcomes),
            release=tuple(request.release),
            demand=_demand(wanted, terms) if wanted is not None else None,
            check=self.check,
        )
        stored = await self._write(BatchedUnit(run_exchanges, exchange), contacts)
        report, released, granted = stored.report, stored.released, stored.granted
        if UNJUDGED in report.statuses and self.check is not None:
            report = await self._judge(self.check, exchange, report)
        self._count(request, report)
        _log_report(request, report)
        _log_granted(request.worker.id, granted)
        if released or report.quarantined:  # a quarantined job may have kept identical simulations waiting
            self.wakeups.wake()  # all waiters: the first may be unable to run these jobs
        self.on_due({*report.campaigns, *(attempt.campaign for attempt in report.quarantined)})
        reply: LeaseReply | None = None
        if wanted is not None:
            if granted and gone.is_set():
                await self._give_back(granted)
                granted = []
            reply = LeaseReply(jobs=granted, lease_s=self.settings.lease_s)
            if not granted and wanted.wait_s > 0:
                reply = await self.lease(wanted, gone)
        elif request.lease is not None:
            reply = LeaseReply(jobs=[], lease_s=self.settings.lease_s, drain=True)
        statuses = [
            ResultStatus.model_validate({"job": outcome.job, "status": status})
            for outcome, status in zip(outcomes, report.statuses, strict=True)
        ]
        return ResultsReply(statuses=statuses, lease=reply)

    async def _judge(self, check: ResultCheck, exchange: Exchange, report: Report) -> Report:
        """Judge and store the outcomes that cannot be judged within a transaction; return the report on all outcomes.

        The other outcomes and the leases granted have been committed before.
        """
        waiting = [place for place, status in enumerate(report.statuses) if status == UNJUDGED]
        outcomes = [exchange.outcomes[place] for place in waiting]
        judgements = await check.judge(
            [
                replace(report.unjudged[one.job], result=one.completed)
                for one in outcomes
                if one.completed is not None
            ]
        )
        judged = [replace(one, judgement=found) for one, found in zip(outcomes, judgements, strict=True)]
        again = Exchange(terms=exchange.terms, outcomes=tuple(judged), check=check)
        then = (await self.writer.write(BatchedUnit(run_exchanges, again))).report
        found_statuses = dict(zip(waiting, then.statuses, strict=True))
        return replace(
            report,
            statuses=tuple(found_statuses.get(place, one) for place, one in enumerate(report.statuses)),
            campaigns=tuple(sorted({*report.campaigns, *then.campaigns})),
            owners={**report.owners, **then.owners},
            quarantined=(*report.quarantined, *then.quarantined),
        )

    async def drain(self, worker_id: str) -> bool:
        """Ask a worker to finish the jobs that it holds, and exit; return whether there is such a worker."""
        process = await self.writer.write(lambda connection: workers.drain(connection, worker_id))
        if process is None:
            return False
        self._draining[worker_id] = process
        self._live = None
        log.info("worker drains", extra={"worker": worker_id, "pid": process.pid})
        self.wakeups.wake()  # all waiters: it may wait for jobs
        return True

    def _is_draining(self, worker: WorkerIdentity) -> bool:
        return self._draining.get(worker.id) == (worker.pid, worker.machine)

    async def _refuse_more(self, worker: WorkerIdentity) -> LeaseReply:
        """Return the reply that tells a worker to ask for no more jobs, and record its contact."""
        if contacts := self._note_contact(worker, None):
            await self._write(partial(workers.record_contacts, contacts=contacts), contacts)
        return LeaseReply(jobs=[], lease_s=self.settings.lease_s, drain=True)

    def _count(self, request: ResultsRequest, report: Report) -> None:
        record = self._workers.get(request.worker.id)
        for item, status in zip(request.results, report.statuses, strict=True):
            self.metrics.results.labels(status).inc()
            if status not in ("accepted", "invalid"):
                continue
            done = status == "accepted" and isinstance(item.outcome, Completed)
            if not done:
                reason = "invalid-result" if isinstance(item.outcome, Completed) else item.outcome.reason
                self.metrics.failures.labels(reason).inc()
            if record is not None:
                record.done += done
                record.failed += not done

    async def sweep(self) -> None:
        """Take back leases that ran out, except after an outage, and forget workers that are gone."""
        # Until this sweep has succeeded, nobody knows whether workers could renew their leases.
        resuming, self._resuming = self._resuming, True
        terms = self.terms()
        absent = [one for one in self._workers.values() if self._is_absent(one)]
        contacts = self._due_contacts(absent)

        def unit(connection: Connection) -> _Swept:
            workers.record_contacts(connection, contacts)
            return self._sweep(connection, terms, resuming=resuming)

        swept = await self._write(unit, contacts)
        self._drop(absent)
        self._resuming = resuming and swept.sweep is None
        self._draining = swept.draining
        self._elsewhere = {name: able for name, able in swept.elsewhere.items() if name not in self._workers}
        self._live = None
        _log_swept(swept)
        expiry = swept.expiry
        self.metrics.expired.inc(len(expiry.lost) + len(expiry.interrupted))
        self.wakeups.wake(None if expiry.interrupted else swept.due_retries)
        self.on_due({*expiry.campaigns, *(attempt.campaign for attempt in expiry.lost if attempt.final)})

    def _sweep(self, connection: Connection, terms: LeaseTerms, *, resuming: bool) -> _Swept:
        workers.forget_absent(connection, FORGET_S)
        settings = self.settings
        sweep = outages.begin_sweep(
            connection, lease_s=settings.lease_s, sweep_s=settings.sweep_s, resuming=resuming
        )
        if (
            settings.sqlite_file is not None
        ):  # its workers are most likely on this machine: look up their processes
            lease_store.end_now(connection, workers.leases_of_dead(connection))
        return _Swept(
            sweep=sweep,
            expiry=report_store.expire(connection, terms) if sweep is not None else Expiry(),
            elsewhere=workers.live_capabilities(connection, settings.worker_seen_s),
            due_retries=lease_store.count_due_retries(connection, terms.elsewhere),
            draining=workers.read_draining(connection),
        )

    def _is_absent(self, one: _WorkerRecord) -> bool:
        """Return whether a worker is dead or has not made contact."""
        return one.contact_s < self.clock() - self.settings.worker_seen_s or workers.process_is_gone(
            one.identity.machine, one.identity.pid
        )

    def _due_contacts(self, absent: Sequence[_WorkerRecord]) -> tuple[workers.Contact, ...]:
        """Return the unrecorded contacts of absent workers, and of those whose last record is `CONTACT_S` old."""
        now, gone = self.clock(), {one.identity.id for one in absent}
        return tuple(
            one.take_contact(now)
            for name, one in self._workers.items()
            if one.is_unrecorded and (name in gone or now - one.recorded_s >= CONTACT_S)
        )

    def _drop(self, absent: Iterable[_WorkerRecord]) -> None:
        """Drop absent workers, except those that have made contact since."""
        for one in filter(self._is_absent, absent):
            self._workers.pop(one.identity.id, None)
            about = {"worker": one.identity.id, "host": one.identity.host, "pid": one.identity.pid}
            log.info("worker gone", extra=about)

    async def _write(self, unit: Unit[T], contacts: Iterable[workers.Contact]) -> T:
        """Write a unit that also records contacts; put them back if it fails."""
        try:
            return await self.writer.write(unit)
        except BaseException:
            for contact in contacts:
                if (one := self._workers.get(contact.worker.id)) is not None:
                    one.put_back(contact)
            raise

    async def _lease_now(self, request: LeaseRequest) -> list[LeasedJob]:
        contacts = self._note_contact(request.worker, request.capabilities)
        terms = self.terms(request.worker.id)
        exchange = Exchange(terms=terms, contacts=contacts, demand=_demand(request, terms))
        granted = (await self._write(BatchedUnit(run_exchanges, exchange), contacts)).granted
        _log_granted(request.worker.id, granted)
        return granted

    async def _give_back(self, granted: Sequence[LeasedJob]) -> None:
        """Release jobs whose client has disconnected, for the next waiter."""
        leases = [HeldLease(job=job.job, token=job.token) for job in granted]
        await self.writer.write(lambda connection: lease_store.release(connection, leases))
        self.wakeups.wake()

    def _note_contact(
        self, worker: WorkerIdentity, capabilities: Sequence[str] | None
    ) -> tuple[workers.Contact, ...]:
        """Remember a worker's contact; return it if it is to be recorded now, not by a sweep."""
        now = self.clock()
        if worker.id not in self._workers:
            about = {"worker": worker.id, "host": worker.host, "pid": worker.pid, "version": worker.version}
            log.info("worker first seen", extra=about)
            self._live = None
        one = self._workers.setdefault(worker.id, _WorkerRecord(identity=worker, contact_s=now))
        restarted = (one.identity.pid, one.identity.machine) != (worker.pid, worker.machine)
        one.contact_s, one.identity = now, worker
        changed = capabilities is not None and tuple(capabilities) != one.capabilities
        if changed and capabilities is not None:
            one.capabilities = tuple(capabilities)
            self._live = None
        if not (changed or restarted) and one.recorded_s > -math.inf:
            return ()
        return (one.take_contact(now),)


def _demand(request: LeaseRequest, terms: LeaseTerms) -> LeaseDemand:
    return LeaseDemand(
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


def _log_swept(swept: _Swept) -> None:
    sweep, expiry = swept.sweep, swept.expiry
    if sweep is not None and sweep.extended:
        away_s = round(sweep.away_s or 0.0, 1)
        log.info(
            "leases got a full term: no coordinator served their workers",
            extra={"leases": sweep.extended, "away_s": away_s},
        )
    if expiry.lost:
        log.warning("leases that ran out: %d", len(expiry.lost))
    for attempt in (*expiry.lost, *expiry.interrupted):
        log.info("lease ran out", extra=attempt.log_fields)
    _log_quarantined(expiry.lost)


def _log_quarantined(attempts: Iterable[FailedAttempt]) -> None:
    for attempt in attempts:
        if attempt.final:
            log.info("job in quarantine", extra=attempt.log_fields)


def _outcomes(request: ResultsRequest) -> list[Outcome]:
    """Return the outcomes that a worker reports.

    Raises:
        InvalidInput: A trace is not base64.
    """
    return [_outcome(index, item.job, item.token, item.outcome) for index, item in enumerate(request.results)]


def _outcome(index: int, job: int, token: str, outcome: Completed | object) -> Outcome:
    if isinstance(outcome, Completed):
        trace = None
        if outcome.trace is not None:
            try:
                trace = base64.b64decode(outcome.trace, validate=True)
            except ValueError:  # not base64, or not ASCII
                raise InvalidInput(
                    [FieldError(pointer=f"/results/{index}/outcome/trace", message="expected base64")]
                ) from None
        result = outcome.model_dump_json(exclude={"trace"})
        return Outcome(job=job, token=token, result=result, completed=outcome, trace=trace)
    reason, message = getattr(outcome, "reason", "error"), getattr(outcome, "message", "")
    error = storable(f"{reason}: {message}")
    return Outcome(job=job, token=token, result=None, error=error, final=reason == "invalid")

"""The worker loop: three threads that share `HeldJobs`, and how they start and end.

The runner keeps the simulation process busy. The reporter leases jobs and reports outcomes. The heartbeat renews
leases. The thread that calls `Worker.run` waits for them and bounds how long stopping takes.
"""

import logging
import os
import socket
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from random import Random
from typing import Final

from brink import __version__
from brink.extras import install_command
from brink.worker.alive_file import AliveFile
from brink.worker.backoff import Backoff, Outage
from brink.worker.client import CoordinatorClient
from brink.worker.errors import (
    ChildFailedToStart,
    CoordinatorUnavailable,
    EpisodeAbandoned,
    RequestRefused,
    WorkerError,
)
from brink.worker.held_jobs import HeldJobs, Poll, PrefetchPolicy, Report
from brink.worker.process import Episode, EpisodeProcess, FinishedEpisode
from brink.worker.settings import WorkerSettings
from brink.worker.wire import (
    HeartbeatRequest,
    JobFailed,
    LeasedJob,
    LeaseReply,
    LeaseRequest,
    ResultsRequest,
    WorkerIdentity,
    machine_name,
)

log = logging.getLogger(__name__)

LAST_REPORT_S: Final = 5.0
"""Time limit for the last report, once the running episode has ended."""

LAST_ANSWER_S: Final = 0.5
"""How long a stopping worker waits for its open lease request, so that jobs it grants are not lost on the way."""

SIGNAL_CHECK_S: Final = 0.5
"""Longest wait of the main thread: Python may handle a signal that arrives just before a wait only after it."""

JOIN_S: Final = 2.0

AHEAD: Final = 2
"""Episodes in the simulation process: the running one and the next, so that it never waits in between."""

START_ATTEMPTS: Final = 3
"""Consecutive failed starts of the simulation process after which the worker gives up."""

BODY_ERRORS: Final = frozenset({400, 413, 422})
"""Statuses of refusals that are due to the request body; any other is due to the worker or the address."""

FAULTS_BEFORE_ISOLATION: Final = 3
"""Consecutive internal errors of the coordinator (500) after which a report is suspected to be the cause."""

LONGEST_PAUSE_WHEN_STOPPING_S: Final = 0.5

LONGEST_HEARTBEAT_WAIT_S: Final = 5.0
"""Longest wait of the heartbeat thread, so that it can be told from one that is stuck."""

RENEWALS_PER_LEASE: Final = 3
RETRIES_PER_RENEWAL: Final = 3
"""How often a failed renewal is retried before the next one is due."""


class Worker:
    """Leases jobs, simulates them, and reports the outcomes.

    Args:
        client: Client of the coordinator; the caller closes it.
        settings: All other settings.
    """

    def __init__(self, client: CoordinatorClient, settings: WorkerSettings) -> None:
        self._client = client
        self._settings = settings
        self._held = HeldJobs(
            PrefetchPolicy(max_jobs=settings.max_jobs, prefetch_s=settings.prefetch_s),
            report_after_s=settings.report_after_s,
            exit_when_idle_s=settings.exit_when_idle_s,
        )
        self._process = EpisodeProcess(
            memory_mib=settings.memory_mib, plugins=settings.plugins, start_timeout_s=settings.start_timeout_s
        )
        self._alive = AliveFile(settings.alive_file)
        self._grace_end_s: float | None = None
        self._error: BaseException | None = None
        self._started = False
        self._reporter_done = False
        self._leaving = False

    def stop(self, grace_s: float | None = None) -> None:
        """Finish the running episode, report, release the other jobs, and let `run` return.

        Safe from any thread and from a signal handler.

        Args:
            grace_s: How long the running episode may continue; None for the time in the settings.
        """
        grace_s = self._settings.grace_s if grace_s is None else grace_s
        with self._held.changed:
            grace_end_s = time.monotonic() + grace_s
            self._grace_end_s = (
                grace_end_s if self._grace_end_s is None else min(self._grace_end_s, grace_end_s)
            )
            self._held.stop()
        if not self._started:
            self._process.kill()

    def run(self) -> int:
        """Work until stopped, or until idle for as long as the settings say; return the exit status.

        Returns:
            0 after a stop or an idle exit; 1 if the worker could not work, with the reason in the log.
        """
        self._alive.update()
        try:
            hello = self._process.start()
        except EpisodeAbandoned:
            return 0
        except ChildFailedToStart as error:
            log.error("%s", error)  # noqa: TRY400  (one line: the stack would only show this call)
            self._process.close()
            return 1
        self._started = True
        for simulator_id, reason in hello.left_out.items():
            log.warning("simulator left out: %s", reason, extra={"simulator": simulator_id})
        if not hello.simulators:
            log.error("no simulator can run here: install one, or name its module in BRINK_PLUGINS")
            self._process.close()
            return 1
        log.info("working for %s", self._client.server, extra={"simulators": ",".join(hello.simulators)})
        if hello.lacking:
            extras = sorted(set(hello.lacking.values()))
            log.info(
                "cannot run %s; to change that: %s",
                ", ".join(hello.lacking),
                install_command(*extras),
                extra={"extras": ",".join(extras)},
            )
        return self._work(hello.simulators)

    def _work(self, capabilities: tuple[str, ...]) -> int:
        rng = Random(self._settings.worker_id)
        identity = WorkerIdentity(
            id=self._settings.worker_id,
            host=socket.gethostname()[:255],
            pid=os.getpid(),
            version=__version__,
            machine=machine_name(),
        )
        runner = Runner(self._held, self._process, rng)
        heartbeat = Heartbeat(
            self._held,
            self._client,
            identity=identity,
            abandon_after_s=self._settings.abandon_after_s,
            abandon=runner.abandon,
        )
        reporter = Reporter(
            self._held,
            self._client,
            identity=identity,
            capabilities=capabilities,
            wait_s=self._settings.wait_s,
            rng=rng,
            on_lease=heartbeat.set_lease_duration,
        )
        runner_thread = self._thread("runner", runner.run)
        heartbeat_thread = self._thread("heartbeat", heartbeat.run)
        reporter_thread = self._thread("reporter", reporter.run, self._mark_reporter_done)
        self._supervise(heartbeat)
        # Abandon any running episode: killing the process ends the runner, and the reporter ends with this program.
        self._leaving = True
        self._held.stop()
        self._process.kill()
        heartbeat.stop()
        for thread in (runner_thread, heartbeat_thread, *((reporter_thread,) if self._reporter_done else ())):
            thread.join(JOIN_S)
        return self._exit_status(coordinator_away=reporter.coordinator_away)

    def _supervise(self, heartbeat: "Heartbeat") -> None:
        """Wait until the worker is done; after a stop, kill the running episode once its grace period is over."""
        changed = self._held.changed
        while not self._reporter_done and self._grace_end_s is None:
            with changed:
                changed.wait_for(lambda: self._reporter_done or self._grace_end_s is not None, SIGNAL_CHECK_S)
            self._alive.update(heartbeat.progress_s)
        with changed:
            if self._grace_end_s is None:
                return
            log.info("stopping", extra={"held": len(self._held.leases())})
            report_end_s: float | None = None
            poll_end_s = time.monotonic() + LAST_ANSWER_S
            while not self._reporter_done:
                now_s = time.monotonic()
                if self._held.polling:
                    # The answer to a long poll may take long, and leaving it loses nothing.
                    if now_s >= poll_end_s:
                        return
                    changed.wait(poll_end_s - now_s)
                    continue
                if report_end_s is None and (self._held.runner_done or now_s >= self._grace_end_s):
                    self._process.kill()
                    report_end_s = now_s + LAST_REPORT_S
                end_s = self._grace_end_s if report_end_s is None else report_end_s
                if now_s >= end_s:
                    return
                changed.wait(min(end_s - now_s, SIGNAL_CHECK_S))

    def _mark_reporter_done(self) -> None:
        with self._held.changed:
            self._reporter_done = True
            self._held.changed.notify_all()

    def _exit_status(self, *, coordinator_away: bool) -> int:
        unsent = self._held.unsent
        if self._error is not None:
            log.error("leaving: %s", self._error, extra={"unsent": unsent})
            return 1
        if unsent:
            log.warning("leaving with outcomes that could not be reported", extra={"unsent": unsent})
        if coordinator_away and self._grace_end_s is None:
            log.error("leaving: no coordinator could be reached at %s", self._client.server)
            return 1
        log.info("leaving")
        return 0

    def _thread(
        self, name: str, work: Callable[[], None], afterwards: Callable[[], None] | None = None
    ) -> threading.Thread:
        def guarded() -> None:
            try:
                work()
            except WorkerError as error:
                self._fail(error)
            except Exception as error:
                # While leaving, the caller may already have closed the client under an unanswered request.
                if not self._leaving:
                    log.exception("the %s thread failed", name)
                    self._fail(error)
            finally:
                if afterwards is not None:
                    afterwards()

        # A daemon thread: a request that hangs must not keep a stopped worker alive.
        thread = threading.Thread(target=guarded, name=f"brink-{name}", daemon=True)
        thread.start()
        return thread

    def _fail(self, error: BaseException) -> None:
        with self._held.changed:
            self._error = self._error or error
            self.stop(grace_s=0.0)


class Runner:
    """The thread that keeps the simulation process busy.

    Args:
        held: Source of jobs and destination of outcomes.
        process: A started process; only this thread uses and closes it.
        rng: Jitter of the waits between failed starts.
    """

    def __init__(self, held: HeldJobs, process: EpisodeProcess, rng: Random) -> None:
        self._held = held
        self._process = process
        self._rng = rng
        self._backoff = Backoff(first_s=1.0, cap_s=30.0)
        self._jobs: dict[int, LeasedJob] = {}
        self._next_ticket = 0
        self._failed_starts = 0

    def run(self) -> None:
        """Run jobs until the worker stops; then end the process and put back unfinished jobs.

        Raises:
            ChildFailedToStart: The process died and could not be restarted.
        """
        try:
            while self._fill_process() and self._receive():
                pass
        finally:
            self._process.close()
            self._held.put_back(tuple(self._jobs.values()))
            self._held.mark_runner_done()

    def abandon(self, job: LeasedJob) -> None:
        """Kill the episode of a job if it is the running one; safe from any thread."""
        for ticket, other in self._jobs.copy().items():
            if other == job:
                self._process.abandon(ticket)

    def _fill_process(self) -> bool:
        """Send jobs ahead, and wait for a job if none is pending. Return False if the worker stops."""
        while self._process.pending < AHEAD:
            job = self._held.take(wait=self._process.pending == 0)
            if job is None:
                break
            ticket, self._next_ticket = self._next_ticket, self._next_ticket + 1
            # Recorded before it is sent, so that it is put back in any case.
            self._jobs[ticket] = job
            episode = Episode(ticket=ticket, spec=job.spec, record=job.record, timeout_s=job.timeout_s)
            try:
                self._process.send(episode)
            except ChildFailedToStart as error:
                self._held.put_back([self._jobs.pop(ticket)])
                self._wait_after_failed_start(error)
            except EpisodeAbandoned:
                return False
        return self._process.pending > 0

    def _receive(self) -> bool:
        """Wait for one outcome. Return False if it was the last: the worker stops, or the process was killed."""
        try:
            finished = self._process.receive()
        except EpisodeAbandoned as abandoned:
            if abandoned.ticket is None:
                return False
            self._held.put_back([self._jobs.pop(abandoned.ticket)])
            return not self._held.stopping
        except ChildFailedToStart as error:
            self._wait_after_failed_start(error)
            return not self._held.stopping
        self._failed_starts = 0
        job = self._jobs.pop(finished.ticket)
        _log_outcome(job, finished)
        stopping = self._held.finish(
            job, finished.outcome, wall_s=finished.wall_s, size_bytes=finished.size_bytes
        )
        return not stopping

    def _wait_after_failed_start(self, error: ChildFailedToStart) -> None:
        self._failed_starts += 1
        if self._failed_starts >= START_ATTEMPTS:
            raise error
        delay_s = self._backoff.delay_s(self._failed_starts, self._rng)
        log.warning("%s; trying again", error, extra={"in_s": round(delay_s, 1)})
        with self._held.changed:
            self._held.changed.wait_for(lambda: self._held.stopping, delay_s)


class Reporter:
    """The thread that reports outcomes, releases leases, and leases more jobs.

    Args:
        held: Says which request is due.
        client: Client of the coordinator.
        identity: This worker.
        capabilities: What this worker can run.
        wait_s: How long the lease request of an idle worker may wait for a job.
        rng: Jitter of the waits while the coordinator is unavailable.
        on_lease: Receives the duration of leases after every lease request.
    """

    def __init__(
        self,
        held: HeldJobs,
        client: CoordinatorClient,
        *,
        identity: WorkerIdentity,
        capabilities: tuple[str, ...],
        wait_s: float,
        rng: Random,
        on_lease: Callable[[float], None],
    ) -> None:
        self._held = held
        self._client = client
        self._identity = identity
        self._capabilities = list(capabilities)
        self._wait_s = wait_s
        self._on_lease = on_lease
        self._outage = Outage(client.server, Backoff(first_s=0.5, cap_s=10.0), rng)
        self._faults = 0

    def run(self) -> None:
        """Make requests until none is left to make.

        Raises:
            RequestRefused: The coordinator does not accept this worker, or the address is wrong.
            UnexpectedReply: The server is not a coordinator.
        """
        while (request := self._held.next_request()) is not None:
            try:
                if isinstance(request, Poll):
                    self._poll(request)
                else:
                    self._report(request)
            except CoordinatorUnavailable as error:
                delay_s = self._outage.record_failure(error, unsent=self._held.unsent)
                if self._held.stopping:
                    delay_s = min(delay_s, LONGEST_PAUSE_WHEN_STOPPING_S)
                self._held.postpone(delay_s)
            else:
                self._outage.record_success()

    @property
    def coordinator_away(self) -> bool:
        """Whether the last request failed because the coordinator was unavailable."""
        return self._outage.since_s is not None

    def _poll(self, poll: Poll) -> None:
        wait_s = self._wait_s if poll.idle_left_s is None else min(self._wait_s, poll.idle_left_s)
        self._add(self._client.lease(self._lease_request(poll.room, max(0.0, wait_s))))

    def _report(self, report: Report) -> None:
        request = ResultsRequest(
            worker=self._identity,
            results=[outcome.to_wire() for outcome in report.outcomes],
            release=list(report.release),
            lease=self._lease_request(report.room, 0.0) if report.room else None,
        )
        began_s = time.monotonic()
        try:
            reply = self._client.report(request)
        except RequestRefused as refusal:
            if refusal.status not in BODY_ERRORS or not report.outcomes:
                raise
            self._held.handle_refusal(
                report, str(refusal), too_large=refusal.status == HTTPStatus.REQUEST_ENTITY_TOO_LARGE
            )
            return
        except CoordinatorUnavailable as error:
            self._note_fault(report, error)
            raise
        self._faults = 0
        self._held.acknowledge(report, reply.statuses, wall_s=time.monotonic() - began_s)
        if reply.lease is not None:
            self._add(reply.lease)

    def _note_fault(self, report: Report, error: CoordinatorUnavailable) -> None:
        """Isolate outcomes if the coordinator keeps failing on their report, rather than being unavailable."""
        if error.status != HTTPStatus.INTERNAL_SERVER_ERROR or not report.outcomes:
            return
        self._faults += 1
        if self._faults == FAULTS_BEFORE_ISOLATION:
            self._faults = 0
            self._held.handle_fault(report, str(error))

    def _add(self, reply: LeaseReply) -> None:
        self._on_lease(reply.lease_s)
        self._held.add(reply)

    def _lease_request(self, room: int, wait_s: float) -> LeaseRequest:
        return LeaseRequest(
            worker=self._identity, capabilities=self._capabilities, max_jobs=room, wait_s=wait_s
        )


class Heartbeat:
    """The thread that renews leases after each third of their duration, and abandons jobs whose lease is lost.

    Args:
        held: The jobs whose leases to renew.
        client: Client of the coordinator.
        identity: This worker.
        abandon_after_s: A running job whose lease is lost is abandoned once it has run this long.
        abandon: Kills the episode of a job.

    Attributes:
        progress_s: When the thread last made progress, by the monotonic clock.
    """

    def __init__(
        self,
        held: HeldJobs,
        client: CoordinatorClient,
        *,
        identity: WorkerIdentity,
        abandon_after_s: float,
        abandon: Callable[[LeasedJob], None],
    ) -> None:
        self._held = held
        self._client = client
        self._identity = identity
        self._abandon_after_s = abandon_after_s
        self._abandon = abandon
        self._lease_s: float | None = None
        self._due_s = 0.0
        self._stopped = False
        self.progress_s = time.monotonic()
        self._abandoned: LeasedJob | None = None

    def set_lease_duration(self, lease_s: float) -> None:
        """Set how long leases last; safe from any thread."""
        with self._held.changed:
            if self._lease_s != lease_s:
                self._lease_s = lease_s
                self._due_s = time.monotonic() + lease_s / RENEWALS_PER_LEASE
                self._held.changed.notify_all()

    def stop(self) -> None:
        """Let `run` return; safe from any thread."""
        with self._held.changed:
            self._stopped = True
            self._held.changed.notify_all()

    def run(self) -> None:
        """Renew leases until `stop` is called.

        Raises:
            RequestRefused: The coordinator does not accept this worker, or the address is wrong.
            UnexpectedReply: The server is not a coordinator.
        """
        while self._wait_until_due():
            self._abandon_lost_job()
            lease_s = self._lease_s
            leases = self._held.leases()
            if lease_s is None:
                continue
            now_s = time.monotonic()
            if now_s < self._due_s:
                continue
            self._due_s = now_s + lease_s / RENEWALS_PER_LEASE
            if not leases:
                continue
            try:
                reply = self._client.heartbeat(HeartbeatRequest(worker=self._identity, leases=list(leases)))
            except CoordinatorUnavailable as error:
                # Only for debugging: the reporter logs the outage, at growing intervals.
                log.debug("no renewal: %s", error)
                self._due_s = now_s + lease_s / RENEWALS_PER_LEASE / RETRIES_PER_RENEWAL
                continue
            self._held.apply_renewal(leases, reply.held)
            self.set_lease_duration(reply.lease_s)
            self._abandon_lost_job()

    def _wait_until_due(self) -> bool:
        """Wait until a renewal or an abandonment is due; return False after `stop`."""
        with self._held.changed:
            while not self._stopped:
                self.progress_s = time.monotonic()
                times_s = [] if self._lease_s is None else [self._due_s]
                if (lost := self._lost_job()) is not None:
                    times_s.append(time.monotonic() + self._abandon_after_s - lost[1])
                left_s = min(times_s) - time.monotonic() if times_s else LONGEST_HEARTBEAT_WAIT_S
                if left_s <= 0:
                    return True
                self._held.changed.wait(min(left_s, LONGEST_HEARTBEAT_WAIT_S))
            return False

    def _lost_job(self) -> tuple[LeasedJob, float] | None:
        lost = self._held.lost_running_job()
        return None if lost is None or lost[0] == self._abandoned else lost

    def _abandon_lost_job(self) -> None:
        lost = self._lost_job()
        if lost is not None and lost[1] >= self._abandon_after_s:
            job = lost[0]
            fields = {"campaign": job.campaign, "job": job.job, "attempt": job.attempt}
            log.info("abandoning a running job whose lease was lost", extra=fields)
            self._abandoned = job
            self._abandon(job)


def _log_outcome(job: LeasedJob, finished: FinishedEpisode) -> None:
    fields: dict[str, object] = {"campaign": job.campaign, "job": job.job, "attempt": job.attempt}
    if isinstance(finished.outcome, JobFailed):
        fields["reason"] = finished.outcome.reason
        log.warning("job failed: %s", finished.outcome.message.partition("\n")[0], extra=fields)
    elif log.isEnabledFor(logging.DEBUG):
        fields["wall_s"] = round(finished.wall_s, 4)
        log.debug("job completed", extra=fields)

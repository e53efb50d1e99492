"""The worker: three threads around one set of holdings, and how they end.

The runner keeps the simulation process busy, the reporter speaks with the coordinator about jobs, the heartbeat
renews leases. The thread that calls `run` waits, and bounds the time that stopping takes.
"""

import logging
import os
import socket
import threading
import time
from collections.abc import Callable
from random import Random
from typing import Final

from brink import __version__
from brink.worker.client import CoordinatorClient
from brink.worker.errors import ChildFailedToStart, EpisodeAbandoned, WorkerError
from brink.worker.heartbeat import Heartbeat
from brink.worker.holdings import Holdings
from brink.worker.machine import machine_name
from brink.worker.pace import Pace
from brink.worker.process import EpisodeProcess
from brink.worker.reporter import Reporter
from brink.worker.runner import Runner
from brink.worker.settings import WorkerSettings
from brink.worker.wire import LeasedJob, WorkerIdentity

log = logging.getLogger(__name__)

LAST_REPORT_S: Final = 5.0
"""How long the last report may take, after the running episode has ended."""

LAST_ANSWER_S: Final = 0.5
"""How long an idle request that is under way may take when asked to stop: its grant must not be lost on the way."""

SIGNALS_S: Final = 0.5
"""Longest wait of the main thread: Python may miss a signal that comes just before a wait, and look only after."""

JOIN_S: Final = 2.0


class Worker:
    """Leases jobs, simulates them, reports.

    Args:
        client: The way to the coordinator; stays the caller's to close.
        settings: Everything else.
    """

    def __init__(self, client: CoordinatorClient, settings: WorkerSettings) -> None:
        self._client = client
        self._settings = settings
        self._holdings = Holdings(
            Pace(max_jobs=settings.max_jobs, prefetch_s=settings.prefetch_s),
            report_after_s=settings.report_after_s,
            exit_when_idle_s=settings.exit_when_idle_s,
        )
        self._process = EpisodeProcess(
            memory_mib=settings.memory_mib,
            plugins=settings.plugins,
            start_timeout_s=settings.start_timeout_s,
        )
        self._grace_end_s: float | None = None
        self._error: BaseException | None = None
        self._started = False
        self._reported_all = False
        self._left = False

    @property
    def child_pid(self) -> int | None:
        """Process id of the simulation process, or None while there is none."""
        return self._process.pid

    def stop(self, grace_s: float | None = None) -> None:
        """Finish the running episode, report, give the rest back, and let `run` return.

        Safe from any thread and from a signal handler.

        Args:
            grace_s: How long the running episode may go on; None for the settings' time.
        """
        grace_s = self._settings.grace_s if grace_s is None else grace_s
        with self._holdings.changed:
            grace_end_s = time.monotonic() + grace_s
            self._grace_end_s = (
                grace_end_s if self._grace_end_s is None else min(self._grace_end_s, grace_end_s)
            )
            self._holdings.stop()
        if not self._started:
            self._process.kill()

    def run(self) -> int:
        """Work until told to stop, or until idle for as long as the settings say; return the exit status.

        Returns:
            0 after a stop or an idle exit; 1 if the worker could not work, with the reason in the log.
        """
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
        return self._work(hello.simulators)

    def _work(self, capabilities: tuple[str, ...]) -> int:
        rng = Random(self._settings.worker_id)
        identity = _identity(self._settings.worker_id)
        runner = Runner(self._holdings, self._process, rng)

        def give_up(job: LeasedJob) -> None:
            ticket = runner.ticket_of(job)
            if ticket is not None:
                self._process.abandon(ticket)

        heartbeat = Heartbeat(
            self._holdings,
            self._client,
            identity=identity,
            abandon_after_s=self._settings.abandon_after_s,
            give_up=give_up,
        )
        reporter = Reporter(
            self._holdings,
            self._client,
            identity=identity,
            capabilities=capabilities,
            wait_s=self._settings.wait_s,
            rng=rng,
            on_lease=heartbeat.leases_hold,
        )
        runner_thread = self._thread("runner", runner.run)
        heartbeat_thread = self._thread("heartbeat", heartbeat.run)
        reporter_thread = self._thread("reporter", reporter.run, self._end_of_reports)
        self._supervise()
        # Whatever still runs is given up: the process ends the runner, the end of this program the reporter.
        self._left = True
        self._holdings.stop()
        self._process.kill()
        heartbeat.end()
        for thread in (runner_thread, heartbeat_thread, *((reporter_thread,) if self._reported_all else ())):
            thread.join(JOIN_S)
        return self._farewell(away=reporter.away)

    def _supervise(self) -> None:
        """Wait for the end; once asked to stop, end the running episode when its time is over."""
        changed = self._holdings.changed
        with changed:
            while not self._reported_all and self._grace_end_s is None:
                changed.wait(SIGNALS_S)
            if self._grace_end_s is None:
                return
            log.info("stopping", extra={"held": len(self._holdings.leases())})
            report_end_s: float | None = None
            poll_end_s = time.monotonic() + LAST_ANSWER_S
            while not self._reported_all:
                now_s = time.monotonic()
                if self._holdings.polling:
                    # An idle request may take long to be answered, and nothing is lost by leaving it then.
                    if now_s >= poll_end_s:
                        return
                    changed.wait(poll_end_s - now_s)
                    continue
                if report_end_s is None and (self._holdings.runner_ended or now_s >= self._grace_end_s):
                    self._process.kill()
                    report_end_s = now_s + LAST_REPORT_S
                end_s = self._grace_end_s if report_end_s is None else report_end_s
                if now_s >= end_s:
                    return
                changed.wait(min(end_s - now_s, SIGNALS_S))

    def _end_of_reports(self) -> None:
        with self._holdings.changed:
            self._reported_all = True
            self._holdings.changed.notify_all()

    def _farewell(self, *, away: bool) -> int:
        unsent = self._holdings.unsent
        if self._error is not None:
            log.error("leaving: %s", self._error, extra={"unsent": unsent})
            return 1
        if unsent:
            log.warning("leaving with outcomes that could not be reported", extra={"unsent": unsent})
        if away and self._grace_end_s is None:
            log.error("leaving: there was no coordinator at %s", self._client.server)
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
                # The client may be closed by now under a request that was left unanswered.
                if not self._left:
                    log.exception("the %s broke down", name)
                    self._fail(error)
            finally:
                if afterwards is not None:
                    afterwards()

        # A daemon: a request that hangs must not keep a stopped worker alive.
        thread = threading.Thread(target=guarded, name=f"brink-{name}", daemon=True)
        thread.start()
        return thread

    def _fail(self, error: BaseException) -> None:
        with self._holdings.changed:
            self._error = self._error or error
            self.stop(grace_s=0.0)


def _identity(worker_id: str) -> WorkerIdentity:
    return WorkerIdentity(
        id=worker_id, host=socket.gethostname()[:255], pid=os.getpid(), version=__version__, machine=machine_name()
    )  # fmt: skip

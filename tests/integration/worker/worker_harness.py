"""A fake coordinator over real HTTP, and workers to run against it.

The coordinator is a queue in memory with leases and fencing, and with faults on demand. It uses the server of the
standard library, because web frameworks do not let it close a connection instead of answering, or cut all connections
at once.
"""

import itertools
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum, auto
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import entry_points
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import pytest
from pydantic import ValidationError

from brink.sim.catalogue import PLUGINS_VARIABLE, SIMULATORS
from brink.worker.client import CoordinatorClient
from brink.worker.loop import Worker
from brink.worker.settings import WorkerSettings
from brink.worker.wire import (
    Completed,
    HeartbeatReply,
    HeartbeatRequest,
    HeldLease,
    JobFailed,
    JobResult,
    LeasedJob,
    LeaseReply,
    LeaseRequest,
    Message,
    ResultsReply,
    ResultsRequest,
    ResultStatus,
)

ROOT = Path(__file__).resolve().parents[3]
PLUGINS = ROOT / "tests" / "plugins"
TIMEOUT_S = 30.0


class Fault(Enum):
    """Faults of a request other than an HTTP error status."""

    DROP_REQUEST = auto()
    DROP_REPLY = auto()


@dataclass
class Job:
    job: int
    spec: dict[str, Any]
    record: bool
    timeout_s: float
    needs: str
    attempt: int = 0
    token: str | None = None
    expires_s: float = 0.0
    outcome: Completed | JobFailed | None = None


M = TypeVar("M", bound=Message)


class FakeCoordinator:
    """Leases jobs in order. Tests may inspect all attributes while holding `changed`."""

    def __init__(self, *, lease_s: float = 30.0, token: str | None = None) -> None:
        self.changed = threading.Condition()
        self.lease_s = lease_s
        self.jobs: dict[int, Job] = {}
        self.faults: dict[str, deque[int | Fault]] = defaultdict(deque)
        self.requests: list[tuple[str, Message]] = []
        self.statuses: list[ResultStatus] = []
        self.refused_jobs: set[int] = set()
        self.poisonous_jobs: set[int] = set()
        self.delivered: set[int] = set()
        self.draining = False
        self.port = 0
        self._bearer = token
        self._tokens = itertools.count()
        self._server: _Server | None = None
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def __enter__(self) -> Self:
        self.appear()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, stack: TracebackType | None
    ) -> None:
        self.disappear()

    def appear(self) -> None:
        """Start to listen, always on the same port."""
        self._server = _Server(("127.0.0.1", self.port), _handler(self))
        self.port = self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self._thread.start()

    def disappear(self) -> None:
        """Stop listening and cut all connections."""
        server, self._server = self._server, None
        if server is None or self._thread is None:
            return
        server.shutdown()
        self._thread.join()
        server.cut_connections()
        with self.changed:
            self.changed.notify_all()
        server.server_close()

    def add(
        self,
        scenario: dict[str, Any] | None = None,
        *,
        timeout_s: float = 20.0,
        record: bool = False,
        simulator: str = "faulty@1",
    ) -> int:
        """Queue an episode of ``faulty@1`` and return its job number."""
        with self.changed:
            number = len(self.jobs) + 1
            spec = {
                "simulator": simulator,
                "scenario": scenario or {},
                "behaviour": {"x": number / 10},
                "requirements": ["distance@1"],
                "seed": number,
                "duration_s": 1.0,
                "options": {},
            }
            self.jobs[number] = Job(number, spec, record, timeout_s, needs=simulator)
            self.changed.notify_all()
            return number

    def revoke(self, number: int) -> None:
        """Take a lease away as if it had expired; nobody can lease the job again."""
        with self.changed:
            self.jobs[number].token = "another-worker"
            self.jobs[number].expires_s = float("inf")

    def wait_until(self, predicate: Callable[[Self], bool]) -> None:
        """Wait until a condition holds; fail after `TIMEOUT_S`."""
        with self.changed:
            if not self.changed.wait_for(lambda: predicate(self), TIMEOUT_S):
                raise AssertionError(f"not true after {TIMEOUT_S} s; jobs: {self.jobs}")

    def wait_for_outcome(self, number: int) -> Completed | JobFailed:
        self.wait_until(lambda c: c.jobs[number].outcome is not None)
        outcome = self.jobs[number].outcome
        assert outcome is not None
        return outcome

    def wait_for_all(self) -> None:
        self.wait_until(lambda c: all(job.outcome is not None for job in c.jobs.values()))

    def queued(self) -> list[int]:
        """Return the jobs that nobody holds and that have no outcome."""
        with self.changed:
            return [j.job for j in self.jobs.values() if j.token is None and j.outcome is None]

    def served(self, kind: type[M]) -> list[M]:
        """Return the requests of one kind that were served so far."""
        with self.changed:
            return [message for _, message in self.requests if isinstance(message, kind)]

    # The three requests.

    def answer(
        self, name: str, body: bytes, gone: Callable[[], bool]
    ) -> tuple[int, Message | dict[str, Any]]:
        try:
            match name:
                case "lease":
                    lease = LeaseRequest.model_validate_json(body)
                    self._record(name, lease)
                    return 200, self._lease(lease, gone)
                case "heartbeat":
                    heartbeat = HeartbeatRequest.model_validate_json(body)
                    reply = self._heartbeat(heartbeat)
                    self._record(name, heartbeat)
                    return 200, reply
                case "results":
                    results = ResultsRequest.model_validate_json(body)
                    if any(result.job in self.refused_jobs for result in results.results):
                        self._record(name, results)
                        return 422, {"title": "Unprocessable", "detail": "results.0:\n too strange"}
                    if any(self._is_poison(result) for result in results.results):
                        return 500, {"title": "Internal error", "detail": "see the log"}
                    answered = self._results(results, gone)
                    self._record(name, results)
                    return 200, answered
        except ValidationError as error:
            return 422, {"title": "Unprocessable", "detail": str(error)}
        return 404, {"title": "Not Found", "detail": name}

    def authorised(self, header: str | None) -> bool:
        return self._bearer is None or header == f"Bearer {self._bearer}"

    def next_fault(self, name: str) -> int | Fault | None:
        with self.changed:
            return self.faults[name].popleft() if self.faults[name] else None

    def note_delivered(self, reply: Message | dict[str, Any]) -> None:
        """Record which jobs were delivered; a job whose reply was cut off is lost until its lease expires."""
        lease = reply.lease if isinstance(reply, ResultsReply) else reply
        if isinstance(lease, LeaseReply):
            with self.changed:
                self.delivered.update(job.job for job in lease.jobs)
                self.changed.notify_all()

    def _record(self, name: str, message: Message) -> None:
        with self.changed:
            self.requests.append((name, message))
            self.changed.notify_all()

    def _lease(self, request: LeaseRequest, gone: Callable[[], bool]) -> LeaseReply:
        until_s = time.monotonic() + request.wait_s
        if self.draining:
            return LeaseReply(jobs=[], lease_s=self.lease_s, drain=True)
        with self.changed:
            while not (free := self._free(request)) and (left_s := until_s - time.monotonic()) > 0:
                # Wakes up regularly, since leases expire without a notification.
                self.changed.wait(min(left_s, 0.05))
                if gone() or self._server is None:
                    break
            granted = [] if gone() else [self._grant(job) for job in free[: request.max_jobs]]
            self.changed.notify_all()
            return LeaseReply(jobs=granted, lease_s=self.lease_s)

    def _free(self, request: LeaseRequest) -> list[Job]:
        now_s = time.monotonic()
        return [
            job
            for job in self.jobs.values()
            if job.outcome is None
            and job.needs in request.capabilities
            and (job.token is None or job.expires_s < now_s)
        ]

    def _grant(self, job: Job) -> LeasedJob:
        job.attempt += 1
        job.token = f"lease-{next(self._tokens)}"
        job.expires_s = time.monotonic() + self.lease_s
        return LeasedJob(
            job=job.job,
            token=job.token,
            attempt=job.attempt,
            spec=job.spec,
            record=job.record,
            timeout_s=job.timeout_s,
        )

    def _heartbeat(self, request: HeartbeatRequest) -> HeartbeatReply:
        with self.changed:
            held = [job for lease in request.leases if (job := self._held(lease)) is not None]
            for job in held:
                job.expires_s = time.monotonic() + self.lease_s
            return HeartbeatReply(held=[job.job for job in held], lease_s=self.lease_s)

    def _results(self, request: ResultsRequest, gone: Callable[[], bool]) -> ResultsReply:
        with self.changed:
            statuses = [self._store(result) for result in request.results]
            self.statuses += statuses
            for lease in request.release:
                if (job := self._held(lease)) is not None:
                    job.token = None
                    job.attempt -= 1
            self.changed.notify_all()
        lease_reply = None if request.lease is None else self._lease(request.lease, gone)
        return ResultsReply(statuses=statuses, lease=lease_reply)

    def _is_poison(self, result: JobResult) -> bool:
        return result.job in self.poisonous_jobs and isinstance(result.outcome, Completed)

    def _store(self, result: JobResult) -> ResultStatus:
        job = self.jobs.get(result.job)
        if job is None or job.token != result.token:
            return ResultStatus(job=result.job, status="stale")
        if job.outcome is not None:
            return ResultStatus(job=result.job, status="duplicate")
        job.outcome = result.outcome
        return ResultStatus(job=result.job, status="accepted")

    def _held(self, lease: HeldLease) -> Job | None:
        job = self.jobs.get(lease.job)
        if job is None or job.outcome is not None or job.token != lease.token:
            return None
        return job if job.expires_s >= time.monotonic() else None


class _Server(ThreadingHTTPServer):
    """A server that can cut its connections."""

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self.connections: set[socket.socket] = set()
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        self.connections.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self.connections.discard(request)
        super().shutdown_request(request)

    def cut_connections(self) -> None:
        for connection in tuple(self.connections):
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Stay silent: some tests kill a client in the middle of a request."""


def _handler(coordinator: FakeCoordinator) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        # Send each reply in one segment: with two, the second would wait for the acknowledgement of the first.
        wbufsize = -1
        disable_nagle_algorithm = True

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            name = self.path.rpartition("/")[2]
            fault = coordinator.next_fault(name)
            if fault is Fault.DROP_REQUEST:
                self.close_connection = True
                return
            if isinstance(fault, int):
                self._send(fault, {"title": "Trouble", "detail": f"asked to answer {fault}"})
                return
            if not coordinator.authorised(self.headers.get("Authorization")):
                self._send(401, {"title": "Unauthorized", "detail": "a bearer token is needed"})
                return
            status, reply = coordinator.answer(name, body, self._gone)
            if fault is Fault.DROP_REPLY:
                self.close_connection = True
                return
            self._send(status, reply)
            coordinator.note_delivered(reply)

        def _gone(self) -> bool:
            self.connection.setblocking(False)
            try:
                return not self.connection.recv(1, socket.MSG_PEEK)
            except BlockingIOError:
                return False
            except OSError:
                return True
            finally:
                self.connection.setblocking(True)

        def _send(self, status: int, reply: Message | dict[str, Any]) -> None:
            text = reply.model_dump_json() if isinstance(reply, Message) else json.dumps(reply)
            body = text.encode()
            self.send_response(status)
            self.send_header(
                "Content-Type", "application/json" if status == 200 else "application/problem+json"
            )
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
            self.wfile.flush()

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
            """Stay silent."""

    return Handler


def use_faulty_simulator(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let simulation processes find ``faulty@1`` and no installed simulator, so that they start quickly.

    Args:
        monkeypatch: Sets the environment of the processes.
        folder: Empty folder for installation records that hide those with entry points for simulators.
    """
    for name in {point.dist.name for point in entry_points(group=SIMULATORS) if point.dist is not None}:
        record = folder / f"{name.replace('-', '_')}-0.dist-info"
        record.mkdir()
        (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (folder, PLUGINS, ROOT))))
    monkeypatch.setenv(PLUGINS_VARIABLE, "faulty_simulator")


class RunningWorker:
    """A worker in a thread."""

    def __init__(self, worker: Worker) -> None:
        self.worker = worker
        self.status: int | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def join(self) -> int:
        """Wait until the worker ends and return its exit status."""
        self._thread.join(TIMEOUT_S)
        assert self.status is not None, "the worker did not end"
        return self.status

    def _run(self) -> None:
        self.status = self.worker.run()


@contextmanager
def running_worker(url: str, *, token: str | None = None, **settings: Any) -> Iterator[RunningWorker]:
    """Run a worker in a thread until the end of the block."""
    defaults: dict[str, Any] = {
        "server": url,
        "worker_id": "w",
        "wait_s": 5.0,
        "memory_mib": 512,
        "token": token,
    }
    with CoordinatorClient(url, token=token) as client:
        running = RunningWorker(Worker(client, WorkerSettings(**(defaults | settings))))
        try:
            yield running
        finally:
            running.worker.stop(grace_s=0.0)
            running.join()


@contextmanager
def worker_program(url: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run ``python -m brink.worker`` until the end of the block, with pipes for standard input and error."""
    options = ("--server", url, "--wait", "5", "--memory", "512", *arguments)
    command = [sys.executable, "-m", "brink.worker", *options]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as program:
        try:
            yield program
        finally:
            if program.poll() is None:
                program.kill()

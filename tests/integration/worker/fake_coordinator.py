"""A small coordinator over real HTTP: a queue in memory with leases and fencing, and faults on demand.

Built on the standard library's server rather than on the application's framework, since it must be able to do what
a framework prevents: close a connection instead of answering, and vanish with all its connections at once.
"""

import itertools
import json
import socket
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Self

from pydantic import ValidationError

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

PATIENCE_S = 30.0


class Fault(Enum):
    """What may go wrong with a request, besides an HTTP status."""

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


class FakeCoordinator:
    """Hands out jobs in order. All of it may be inspected under `changed`."""

    def __init__(self, *, lease_s: float = 30.0, token: str | None = None) -> None:
        self.changed = threading.Condition()
        self.lease_s = lease_s
        self.jobs: dict[int, Job] = {}
        self.faults: dict[str, deque[int | Fault]] = defaultdict(deque)
        self.requests: list[tuple[str, Message]] = []
        self.statuses: list[ResultStatus] = []
        self.refused_jobs: set[int] = set()
        self.delivered: set[int] = set()
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
        """Listen, on the port of the first time."""
        self._server = _Server(("127.0.0.1", self.port), _handler(self))
        self.port = self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self._thread.start()

    def disappear(self) -> None:
        """Stop listening, and cut every connection where it is."""
        server, self._server = self._server, None
        if server is None or self._thread is None:
            return
        server.shutdown()
        self._thread.join()
        server.cut()
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
        """Take a lease away, as if it had expired, and put the job out of reach of everyone."""
        with self.changed:
            self.jobs[number].token = "somebody-else"
            self.jobs[number].expires_s = float("inf")

    def wait_until(self, predicate: Callable[[Self], bool]) -> None:
        """Wait until something holds; fail after a long time."""
        with self.changed:
            if not self.changed.wait_for(lambda: predicate(self), PATIENCE_S):
                raise AssertionError(f"waited {PATIENCE_S} s in vain; jobs: {self.jobs}")

    def wait_for_outcome(self, number: int) -> Completed | JobFailed:
        self.wait_until(lambda c: c.jobs[number].outcome is not None)
        outcome = self.jobs[number].outcome
        assert outcome is not None
        return outcome

    def wait_for_all(self) -> None:
        self.wait_until(lambda c: all(job.outcome is not None for job in c.jobs.values()))

    def queued(self) -> list[int]:
        """Jobs that nobody holds and that have no outcome."""
        with self.changed:
            return [j.job for j in self.jobs.values() if j.token is None and j.outcome is None]

    def of(self, kind: type[Message]) -> list[Message]:
        """Requests of a kind that were served so far."""
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
                    self._note(name, lease)
                    return 200, self._lease(lease, gone)
                case "heartbeat":
                    heartbeat = HeartbeatRequest.model_validate_json(body)
                    reply = self._heartbeat(heartbeat)
                    self._note(name, heartbeat)
                    return 200, reply
                case "results":
                    results = ResultsRequest.model_validate_json(body)
                    if any(result.job in self.refused_jobs for result in results.results):
                        self._note(name, results)
                        return 422, {"title": "Unprocessable", "detail": "results.0:\n too strange"}
                    answered = self._results(results, gone)
                    self._note(name, results)
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
        """Remember which grants went out: one that is cut off is lost until its lease runs out."""
        lease = reply.lease if isinstance(reply, ResultsReply) else reply
        if isinstance(lease, LeaseReply):
            with self.changed:
                self.delivered.update(job.job for job in lease.jobs)
                self.changed.notify_all()

    def _note(self, name: str, message: Message) -> None:
        with self.changed:
            self.requests.append((name, message))
            self.changed.notify_all()

    def _lease(self, request: LeaseRequest, gone: Callable[[], bool]) -> LeaseReply:
        until_s = time.monotonic() + request.wait_s
        with self.changed:
            while not (free := self._free(request)) and (left_s := until_s - time.monotonic()) > 0:
                # Woken now and then: leases expire without anybody's doing.
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
    """Knows its connections, so that it can cut them."""

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

    def cut(self) -> None:
        for connection in tuple(self.connections):
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a client that is killed in the middle of a request is part of the tests."""


def _handler(coordinator: FakeCoordinator) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        # One segment an answer: two would wait for each other's acknowledgement.
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
            """Say nothing."""

    return Handler

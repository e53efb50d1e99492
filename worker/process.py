"""The worker's side of the simulation process: start it, send it episodes, and survive its crashes.

Episodes may be sent ahead, so that the process goes from one to the next without waiting for the worker. An episode
that crashes or hangs ends the process: it is reported as failed, and the others run in a new process. One thread uses
an `EpisodeProcess`; only `abandon` and `kill` may be called from other threads.
"""

import base64
import binascii
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.sim.episode import EpisodeResult, JsonObject, Verdict
from brink.sim.programs import OutputTail, exit_words
from brink.worker.child_protocol import (
    EpisodeReply,
    FrameBuffer,
    Hello,
    RunEpisode,
    encode_frame,
    failure_text,
)
from brink.worker.errors import BrokenFrame, ChildFailedToStart, EpisodeAbandoned, UnexpectedReply
from brink.worker.settings import TOKEN_VARIABLE
from brink.worker.wire import Completed, JobFailed, Outcome

log = logging.getLogger(__name__)

ONE_THREAD: Final = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "BLIS_NUM_THREADS",
    ),
    "1",
)
"""One thread per episode: a machine runs one worker per core, and sums must not depend on the number of threads."""

_READ_BYTES = 1 << 16
_LIVENESS_S = 1.0
_STACK_S = 0.3
_STACK_PAUSE_S = 0.02

_HELLO = TypeAdapter(Hello)
_REQUEST = TypeAdapter(RunEpisode)
_REPLY = TypeAdapter(EpisodeReply)
_OUTCOME: TypeAdapter[Completed | JobFailed] = TypeAdapter(Outcome)


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """One episode to run.

    Attributes:
        ticket: Number that identifies the episode within the process.
        spec: The `EpisodeSpec` as JSON.
        record: Whether the result must carry the trace.
        timeout_s: Wall-clock limit, > 0; an episode that exceeds it is killed.
    """

    ticket: int
    spec: Mapping[str, Any]
    record: bool
    timeout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedEpisode:
    """An episode with its outcome.

    Attributes:
        ticket: Number of the episode.
        outcome: The result, or why there is none.
        wall_s: Wall-clock time of the episode.
        size_bytes: Size of the outcome as JSON.
    """

    ticket: int
    outcome: Completed | JobFailed
    wall_s: float
    size_bytes: int


class EpisodeProcess:
    """A simulation process that is restarted whenever an episode ends it.

    Args:
        memory_mib: Memory that episodes may add to what the started process uses; 0 sets no limit.
        plugins: Modules to add to those in ``BRINK_PLUGINS``.
        start_timeout_s: Time limit for importing the simulators.
    """

    def __init__(
        self, *, memory_mib: int = 2048, plugins: tuple[str, ...] = (), start_timeout_s: float = 120.0
    ) -> None:
        self._memory_mib = memory_mib
        self._plugins = plugins
        self._start_timeout_s = start_timeout_s
        self._pending: deque[Episode] = deque()
        self._began_s = 0.0
        self._child: _Child | None = None
        self._abandoned = False
        self._starting = False
        self._killed = False
        self._last_ticket = -1
        # Guards the state that other threads and signal handlers touch: _child, _pending[0], _abandoned, _killed.
        self._lock = threading.RLock()

    @property
    def pending(self) -> int:
        """Number of episodes that were sent and have no outcome yet."""
        return len(self._pending)

    @property
    def pid(self) -> int | None:
        """Process id of the simulation process, or None if there is none."""
        child = self._child
        return None if child is None else child.popen.pid

    def start(self) -> Hello:
        """Start the process and return what it can simulate.

        Raises:
            ChildFailedToStart: The process died or stayed silent while it imported its simulators.
            EpisodeAbandoned: `kill` was called.
        """
        self._end_child()
        child = _Child(self._memory_mib, self._plugins)
        with self._lock:
            self._child = child
            self._starting = True
            if self._killed:
                child.kill_group()
        hello = child.await_hello(self._start_timeout_s)
        if hello is None:
            ending = self._reap(child)
            if self._killed:
                raise EpisodeAbandoned(None)
            last_line = child.output.text().rstrip().rpartition("\n")[2]
            raise ChildFailedToStart(f"the simulation process did not start ({ending}): {last_line}")
        for simulator_id, reason in hello.left_out.items():
            log.debug("simulator left out", extra={"simulator": simulator_id, "reason": reason})
        self._began_s = time.monotonic()
        for episode in self._pending:
            child.send(episode)
        with self._lock:
            self._starting = False
            if self._abandoned:
                child.kill_group()
        return hello

    def run(self, spec: Mapping[str, Any], *, record: bool, timeout_s: float) -> Completed | JobFailed:
        """Run one episode and wait for it. No other episode may be pending.

        Args:
            spec: The `EpisodeSpec` as JSON.
            record: Whether the result must carry the trace.
            timeout_s: Wall-clock limit, > 0.

        Raises:
            ChildFailedToStart: The process had died and cannot be restarted.
            EpisodeAbandoned: `abandon` or `kill` was called meanwhile.
        """
        self.send(Episode(ticket=self._last_ticket + 1, spec=spec, record=record, timeout_s=timeout_s))
        return self.receive().outcome

    def send(self, episode: Episode) -> None:
        """Queue an episode; it runs after those sent before.

        Raises:
            ChildFailedToStart: The process died while idle and cannot be restarted.
            EpisodeAbandoned: `kill` was called.
        """
        # A process that died while idle must not be blamed on the next episode.
        if self._child is None or (not self._pending and not self._child.alive()):
            self.start()
        if not self._pending:
            self._began_s = time.monotonic()
        self._last_ticket = episode.ticket
        with self._lock:
            self._pending.append(episode)
        if self._child is not None:
            self._child.send(episode)

    def receive(self) -> FinishedEpisode:
        """Wait for the outcome of the oldest pending episode.

        If that episode ended the process, the next call starts a new one and sends it the remaining episodes.

        Raises:
            EpisodeAbandoned: `abandon` or `kill` was called; the episode is no longer pending.
            ChildFailedToStart: The process cannot be restarted. Episodes stay pending, so the call may be repeated.
        """
        child = self._child
        if child is None or child.reaped:
            if self._abandoned:
                raise self._drop_abandoned()
            self.start()
            child = self._child
            assert child is not None
        episode = self._pending[0]
        deadline_s = self._began_s + episode.timeout_s
        try:
            frame = child.await_frame(deadline_s)
        except TimeoutError:
            stack = child.dump_stack()
            self._reap(child)
            message = f"no verdict after {episode.timeout_s:g} s of wall-clock time; killed"
            return self._failed(JobFailed(reason="timeout", message=failure_text(message, stack)))
        except BrokenFrame as error:
            self._reap(child)
            return self._failed(JobFailed(reason="crashed", message=failure_text(f"broken reply: {error}")))
        if frame is None:
            return self._died(child)
        return self._replied(child, episode, frame)

    def abandon(self, ticket: int) -> None:
        """Kill an episode if it is the running one; safe from any thread."""
        with self._lock:
            if self._pending and self._pending[0].ticket == ticket:
                self._abandoned = True
                # A starting process has not received the episode yet: `start` checks the flag at its end.
                if self._child is not None and not self._starting:
                    self._child.kill_group()

    def kill(self) -> None:
        """Kill the process for good; safe from any thread. `close` must still be called."""
        with self._lock:
            self._killed = True
            if self._child is not None:
                self._child.kill_group()

    def close(self) -> tuple[int, ...]:
        """Kill the process and return the tickets of the episodes without an outcome."""
        self.kill()
        self._end_child()
        tickets = tuple(episode.ticket for episode in self._pending)
        self._pending.clear()
        return tickets

    def _replied(self, child: "_Child", episode: Episode, frame: bytes) -> FinishedEpisode:
        try:
            reply = _REPLY.validate_json(frame)
        except ValidationError as error:
            self._reap(child)
            failure = JobFailed(reason="crashed", message=failure_text(f"broken reply: {error}"))
            return self._failed(failure)
        outcome = parse_outcome(reply.outcome)
        child.output.clear()
        # A process killed just after its reply must not be blamed on the next episode. And memory that an episode
        # left in the allocator must not count against the next one.
        if self._next() or (isinstance(outcome, JobFailed) and outcome.reason == "out-of-memory"):
            self._reap(child)
        return FinishedEpisode(
            ticket=episode.ticket, outcome=outcome, wall_s=reply.wall_s, size_bytes=len(frame)
        )

    def _died(self, child: "_Child") -> FinishedEpisode:
        ending = self._reap(child)
        if self._killed or self._abandoned:
            raise self._drop_abandoned()
        message = f"the simulation process {ending}"
        return self._failed(JobFailed(reason="crashed", message=failure_text(message, child.output.text())))

    def _failed(self, failure: JobFailed) -> FinishedEpisode:
        ticket, wall_s = self._pending[0].ticket, time.monotonic() - self._began_s
        self._next()
        return FinishedEpisode(ticket=ticket, outcome=failure, wall_s=wall_s, size_bytes=len(failure.message))

    def _drop_abandoned(self) -> EpisodeAbandoned:
        ticket = self._pending[0].ticket
        self._next()
        return EpisodeAbandoned(ticket)

    def _next(self) -> bool:
        """Remove the oldest pending episode and return whether it had been abandoned."""
        with self._lock:
            self._pending.popleft()
            abandoned, self._abandoned = self._abandoned, False
        self._began_s = time.monotonic()
        return abandoned

    def _end_child(self) -> None:
        if self._child is not None:
            self._reap(self._child)
            self._child.close()
            with self._lock:
                self._child = None

    def _reap(self, child: "_Child") -> str:
        # Under the lock: no other thread may signal a process id that the system may already have reused.
        with self._lock:
            return child.reap()


def parse_outcome(document: JsonObject) -> Completed | JobFailed:
    """Return an outcome that a simulation process sent; one that exceeds the limits of the wire becomes a failure."""
    try:
        return _OUTCOME.validate_python(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"][1:])
        complaint = f"{place}: {first['msg']}, got {str(first['input'])[:80]!r}"
        return JobFailed(reason="error", message=failure_text(f"the result cannot be sent: {complaint}"))


def episode_result(message: Completed) -> EpisodeResult:
    """Return the result that a message carries.

    Raises:
        UnexpectedReply: The trace is not base64.
    """
    try:
        trace = None if message.trace is None else base64.b64decode(message.trace, validate=True)
    except binascii.Error as error:
        raise UnexpectedReply(f"trace: expected base64: {error}") from error
    return EpisodeResult(
        verdicts={
            name: Verdict(robustness=v.robustness, unit=v.unit, violated_at_s=v.violated_at_s)
            for name, v in message.verdicts.items()
        },
        objectives=dict(message.objectives),
        features=dict(message.features),
        provenance=dict(message.provenance),
        trace=trace,
    )


class _Child:
    """One operating-system process with its pipes.

    Attributes:
        popen: The process.
        output: The end of what it printed.
        reaped: Whether it is dead and its exit status was collected.
    """

    def __init__(self, memory_mib: int, plugins: tuple[str, ...]) -> None:
        requests_in, self._requests = os.pipe()
        self._replies, replies_out = os.pipe()
        lifeline_in, self._lifeline = os.pipe()
        output, output_in = os.pipe()
        passed = (requests_in, replies_out, lifeline_in)
        command = [sys.executable, "-m", "brink.worker.child"]
        for name, fd in zip(("--requests", "--replies", "--lifeline"), passed, strict=True):
            command += [name, str(fd)]
        command += ["--memory-mib", str(memory_mib)]
        try:
            self.popen = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output_in,
                stderr=output_in,
                pass_fds=passed,
                # Its own group: programs that a simulator starts are killed with it, and Ctrl-C does not reach it.
                start_new_session=True,
                env=_environment(plugins),
            )
        finally:
            for fd in (*passed, output_in):
                os.close(fd)
        for fd in (self._requests, self._replies, output):
            os.set_blocking(fd, False)
        self.output = OutputTail(output)
        self.reaped = False
        self._frames = FrameBuffer()
        self._unsent = bytearray()
        self._writing = False
        self._poll = select.poll()
        self._poll.register(self._replies, select.POLLIN)
        self._poll.register(output, select.POLLIN)

    def alive(self) -> bool:
        """Return whether the process is still running."""
        return not self.reaped and self.popen.poll() is None

    def send(self, episode: Episode) -> None:
        """Queue a request and write as much of it as the pipe accepts."""
        request = RunEpisode(ticket=episode.ticket, spec=dict(episode.spec), record=episode.record)
        self._unsent += encode_frame(_REQUEST.dump_json(request))
        self._flush()

    def await_hello(self, timeout_s: float) -> Hello | None:
        """Return the first message, or None if the process died, stayed silent, or sent something else."""
        try:
            frame = self.await_frame(time.monotonic() + timeout_s)
            return None if frame is None else _HELLO.validate_json(frame)
        except (TimeoutError, BrokenFrame, ValidationError):
            return None

    def await_frame(self, deadline_s: float) -> bytes | None:
        """Return the next frame, or None once the process has died.

        Raises:
            TimeoutError: The deadline on the monotonic clock has passed.
            BrokenFrame: The pipe carries something other than frames.
        """
        while (frame := self._frames.pop()) is None:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise TimeoutError
            # Descendants may keep the pipe open after the process has died, so check the process regularly too.
            events = self._poll.poll(min(left_s, _LIVENESS_S) * 1000)
            if any(fd == self.output.fd for fd, _ in events) and not self.output.drain():
                self._poll.unregister(self.output.fd)
            if any(fd == self._requests for fd, _ in events):
                self._flush()
            if any(fd == self._replies for fd, _ in events):
                if not self._read_replies():
                    return None
            elif not events and self.popen.poll() is not None:
                return self._frames.pop()
        return frame

    def dump_stack(self) -> str:
        """Make a hung process print its Python stack, and return the end of its output."""
        self.output.drain()
        self.popen.send_signal(signal.SIGUSR1)
        watch = select.poll()
        watch.register(self.output.fd, select.POLLIN)
        wait_s, deadline_s = _STACK_S, time.monotonic() + 2 * _STACK_S
        while time.monotonic() < deadline_s and watch.poll(wait_s * 1000) and self.output.drain():
            wait_s = _STACK_PAUSE_S
        return self.output.text()

    def kill_group(self) -> None:
        """Kill the process and all that it started, unless it was reaped."""
        if not self.reaped:
            try:
                os.killpg(self.popen.pid, signal.SIGKILL)
            except ProcessLookupError:
                log.debug("the simulation process was already gone", extra={"pid": self.popen.pid})

    def reap(self) -> str:
        """Kill the process if it still runs and return how it ended, such as ``was killed by SIGSEGV``."""
        if not self.reaped:
            # If its pipe has ended, the process already has its exit status: this signal does not change it.
            self.kill_group()
            self.popen.wait()
            self.reaped = True
            self.output.drain()
        return exit_words(self.popen.returncode)

    def close(self) -> None:
        """Close the pipes of a reaped process."""
        for fd in (self._requests, self._replies, self._lifeline, self.output.fd):
            os.close(fd)

    def _flush(self) -> None:
        try:
            while self._unsent:
                del self._unsent[: os.write(self._requests, self._unsent)]
        except BlockingIOError:
            if not self._writing:
                self._poll.register(self._requests, select.POLLOUT)
                self._writing = True
            return
        except BrokenPipeError:
            # The reply pipe will end too; the death is reported there, with its cause.
            self._unsent.clear()
        if self._writing:
            self._poll.unregister(self._requests)
            self._writing = False

    def _read_replies(self) -> bool:
        """Read all available replies; return False once the pipe has ended."""
        try:
            while data := os.read(self._replies, _READ_BYTES):
                self._frames.feed(data)
                if len(data) < _READ_BYTES:
                    return True
        except BlockingIOError:
            return True
        return False


def _environment(plugins: tuple[str, ...]) -> dict[str, str]:
    environment = {name: value for name, value in os.environ.items() if name != TOKEN_VARIABLE}
    modules = [*filter(None, environment.get(PLUGINS_VARIABLE, "").split(",")), *plugins]
    return {
        **environment,
        **ONE_THREAD,
        PLUGINS_VARIABLE: ",".join(dict.fromkeys(modules)),
        # Unbuffered: what a simulator printed before it died must already be in the pipe.
        "PYTHONUNBUFFERED": "1",
    }

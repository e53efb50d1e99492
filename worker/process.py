"""The parent's side of the simulation process: sends episodes ahead, and survives whatever they do to it.

One thread uses an `EpisodeProcess`; only `abandon` and `kill` may be called from others. Episodes may be sent ahead
of their turn, so that the process goes from one to the next without waiting for its parent.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from brink.worker.child_handle import ChildHandle
from brink.worker.child_wire import EpisodeReply, Hello, RunEpisode
from brink.worker.codec import outcome_from
from brink.worker.errors import BrokenFrame, ChildFailedToStart, EpisodeAbandoned
from brink.worker.outcome_document import failure_text
from brink.worker.wire import Completed, JobFailed

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """One episode to run.

    Attributes:
        ticket: Unique in the process; comes back with the outcome.
        spec: The `EpisodeSpec` as JSON.
        record: Whether the result must carry the trace.
        timeout_s: Wall-clock time after which it is given up, > 0.
    """

    ticket: int
    spec: Mapping[str, Any]
    record: bool
    timeout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """What came out of an episode.

    Attributes:
        ticket: Of the episode.
        outcome: Its result, or why there is none.
        wall_s: How long it took.
        size_bytes: Size of the outcome as JSON.
    """

    ticket: int
    outcome: Completed | JobFailed
    wall_s: float
    size_bytes: int


class EpisodeProcess:
    """A simulation process that is started again whenever an episode ends it.

    Args:
        memory_mib: Memory that episodes may add to what the process has once it is up; 0 sets no limit.
        plugins: Modules for ``BRINK_PLUGINS``, besides those that the environment names.
        start_timeout_s: How long it may take to import its simulators.
    """

    def __init__(
        self, *, memory_mib: int = 2048, plugins: tuple[str, ...] = (), start_timeout_s: float = 120.0
    ) -> None:
        self._memory_mib = memory_mib
        self._plugins = plugins
        self._start_timeout_s = start_timeout_s
        self._sent: deque[Episode] = deque()
        self._began_s = 0.0
        self._child: ChildHandle | None = None
        self._abandoned = False
        self._starting = False
        self._killed = False
        self._last_ticket = -1
        # Guards what other threads and signal handlers touch: _child, the first of _sent, _abandoned, _killed.
        self._lock = threading.RLock()

    @property
    def pending(self) -> int:
        """Episodes that were sent and have no outcome yet."""
        return len(self._sent)

    @property
    def pid(self) -> int | None:
        """Process id of the simulation process, or None while there is none."""
        child = self._child
        return None if child is None else child.popen.pid

    def start(self) -> Hello:
        """Start the process and return what it can run.

        Raises:
            ChildFailedToStart: It died or said nothing while it imported its simulators.
            EpisodeAbandoned: `kill` was called.
        """
        self._end_child()
        child = ChildHandle(self._memory_mib, self._plugins)
        with self._lock:
            self._child = child
            self._starting = True
            if self._killed:
                child.kill_group()
        hello = child.await_hello(self._start_timeout_s)
        if hello is None:
            context = self._bury(child)
            if self._killed:
                raise EpisodeAbandoned(None)
            last_line = child.stderr.text().rstrip().rpartition("\n")[2]
            raise ChildFailedToStart(f"the simulation process did not start ({context}): {last_line}")
        for simulator_id, reason in hello.left_out.items():
            log.debug("simulator left out", extra={"simulator": simulator_id, "reason": reason})
        self._began_s = time.monotonic()
        for episode in self._sent:
            child.send(_request(episode))
        with self._lock:
            self._starting = False
            if self._abandoned:
                child.kill_group()
        return hello

    def run(self, spec: Mapping[str, Any], *, record: bool, timeout_s: float) -> Completed | JobFailed:
        """Run one episode and wait for it; nothing else may be pending.

        Raises:
            ChildFailedToStart: The process died before and cannot be started again.
            EpisodeAbandoned: `abandon` or `kill` was called meanwhile.
        """
        self.send(Episode(ticket=self._last_ticket + 1, spec=spec, record=record, timeout_s=timeout_s))
        return self.receive().outcome

    def send(self, episode: Episode) -> None:
        """Hand an episode over; it runs after those that were sent before.

        Raises:
            ChildFailedToStart: The process died while idle and cannot be started again.
            EpisodeAbandoned: `kill` was called.
        """
        # A process that died while idle must not be blamed on the next episode.
        if self._child is None or (not self._sent and not self._child.alive()):
            self.start()
        if not self._sent:
            self._began_s = time.monotonic()
        self._last_ticket = episode.ticket
        with self._lock:
            self._sent.append(episode)
        if self._child is not None:
            self._child.send(_request(episode))

    def receive(self) -> Finished:
        """Wait for the outcome of the oldest pending episode.

        The process is started again, and the other pending episodes handed to it, if this one ended it.

        Raises:
            EpisodeAbandoned: `abandon` or `kill` was called; the episode is no longer pending.
            ChildFailedToStart: The process cannot be started again. Pending episodes stay pending: call again.
        """
        child = self._child
        if child is None or child.gone:
            if self._abandoned:
                raise self._give_up()
            self.start()
            child = self._child
            assert child is not None
        episode = self._sent[0]
        deadline_s = self._began_s + episode.timeout_s
        try:
            frame = child.await_frame(deadline_s)
        except TimeoutError:
            stack = child.last_words()
            self._bury(child)
            message = f"no verdict after {episode.timeout_s:g} s of wall-clock time; killed"
            return self._failed(JobFailed(reason="timeout", message=failure_text(message, stack)))
        except BrokenFrame as error:
            self._bury(child)
            return self._failed(JobFailed(reason="crashed", message=failure_text(f"broken reply: {error}")))
        if frame is None:
            return self._died(child)
        return self._replied(child, episode, frame)

    def abandon(self, ticket: int) -> None:
        """Give up an episode if it is the one that is running; safe from any thread."""
        with self._lock:
            if self._sent and self._sent[0].ticket == ticket:
                self._abandoned = True
                # A process that is starting has not got the episode yet: `start` looks at the flag at its end.
                if self._child is not None and not self._starting:
                    self._child.kill_group()

    def kill(self) -> None:
        """End the process for good; safe from any thread. `close` is still to be called."""
        with self._lock:
            self._killed = True
            if self._child is not None:
                self._child.kill_group()

    def close(self) -> tuple[int, ...]:
        """End the process and return the tickets of the episodes that have no outcome."""
        self.kill()
        self._end_child()
        tickets = tuple(episode.ticket for episode in self._sent)
        self._sent.clear()
        return tickets

    def _replied(self, child: ChildHandle, episode: Episode, frame: bytes) -> Finished:
        try:
            reply = EpisodeReply.model_validate_json(frame)
        except ValidationError as error:
            self._bury(child)
            failure = JobFailed(reason="crashed", message=failure_text(f"broken reply: {error}"))
            return self._failed(failure)
        outcome = outcome_from(reply.outcome)
        child.stderr.forget()
        # A process that was killed just after it had answered must not be blamed on the next episode; and what
        # a hungry episode left in the allocator must not count against it.
        if self._advance() or (isinstance(outcome, JobFailed) and outcome.reason == "out-of-memory"):
            self._bury(child)
        return Finished(ticket=episode.ticket, outcome=outcome, wall_s=reply.wall_s, size_bytes=len(frame))

    def _died(self, child: ChildHandle) -> Finished:
        how = self._bury(child)
        if self._killed or self._abandoned:
            raise self._give_up()
        message = f"the simulation process {how}"
        return self._failed(JobFailed(reason="crashed", message=failure_text(message, child.stderr.text())))

    def _failed(self, failure: JobFailed) -> Finished:
        ticket, wall_s = self._sent[0].ticket, time.monotonic() - self._began_s
        self._advance()
        return Finished(ticket=ticket, outcome=failure, wall_s=wall_s, size_bytes=len(failure.message))

    def _give_up(self) -> EpisodeAbandoned:
        ticket = self._sent[0].ticket
        self._advance()
        return EpisodeAbandoned(ticket)

    def _advance(self) -> bool:
        """Go on to the next pending episode; return whether the last one had been abandoned."""
        with self._lock:
            self._sent.popleft()
            abandoned, self._abandoned = self._abandoned, False
        self._began_s = time.monotonic()
        return abandoned

    def _end_child(self) -> None:
        if self._child is not None:
            self._bury(self._child)
            self._child.close()
            with self._lock:
                self._child = None

    def _bury(self, child: ChildHandle) -> str:
        # Under the lock: no other thread may signal a process id that was just given back to the system.
        with self._lock:
            return child.bury()


def _request(episode: Episode) -> RunEpisode:
    return RunEpisode(ticket=episode.ticket, spec=dict(episode.spec), record=episode.record)

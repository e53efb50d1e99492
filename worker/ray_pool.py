"""Workers on a Ray cluster: actors of one CPU each, all running the loop of `brink.worker.loop`.

A pool starts them, replaces those that die, and has them finish and leave when it is told to stop. They are the same
workers as everywhere: each asks the coordinator for jobs over HTTP, so a dead one costs what it was simulating, and
no result. Nothing of a campaign passes through Ray.

Brink has to be installed on every node, in the same version. The token reaches an actor as an argument of its
constructor: Ray writes the environment of actors into its logs and onto command lines, but not their arguments.
"""

import logging
import os
import socket
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from random import Random
from typing import Any, Final

import ray
from ray.exceptions import RayError

from brink.worker.backoff import Backoff
from brink.worker.client import CoordinatorClient
from brink.worker.errors import NoCluster
from brink.worker.log import LogFormat, LogLevel, configure_logging
from brink.worker.loop import LAST_REPORT_S, Worker
from brink.worker.run import stopped_by_signals
from brink.worker.settings import WorkerSettings, new_worker_id

LOCAL: Final = "local"
"""In place of an address: start a Ray of our own on this machine."""

LOOK_S: Final = 0.5
PLACED_WITHIN_S: Final = 30.0
"""An actor that got no CPU within this time is given up, if there should be one a free CPU: another took it."""
HEALTHY_S: Final = 30.0
"""A worker that lived this long was no false start."""
FALSE_STARTS: Final = 3
"""Workers that could not work, after which the pool gives up if no other one can."""
WITHOUT_CPU_S: Final = 15.0
TOLD_AGAIN_S: Final = 60.0
"""After so long without a single worker at work the log says so, and then again and again."""
OBJECT_STORE_BYTES: Final = 80 * 1024 * 1024
"""Of a Ray of our own: about the least that it takes, as nothing is stored there."""
LEAVING_S: Final = LAST_REPORT_S + 5.0
"""How long a worker may take to leave, after its running episode."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoolSettings:
    """Everything that a pool can be told.

    Attributes:
        address: Of the cluster: ``HOST:PORT``, ``auto`` for the one that this machine belongs to, or ``local``.
        worker: What each worker is told; each makes an id of its own.
        workers: How many workers to have, or None for one a CPU that is free, as nodes come and go.
        level: Of the log, here and in the actors.
        log_format: Of the log, here and in the actors.
    """

    address: str
    worker: WorkerSettings
    workers: int | None = None
    level: LogLevel = LogLevel.INFO
    log_format: LogFormat = LogFormat.TEXT


class PoolWorker:
    """One worker, as an actor: its methods run on threads, beside one another.

    Args:
        settings: What the worker is told, but for its id.
        level: Of its log.
        log_format: Of its log.
    """

    def __init__(self, settings: WorkerSettings, level: LogLevel, log_format: LogFormat) -> None:
        self._settings = replace(settings, worker_id=new_worker_id())
        configure_logging(level, log_format, worker=self._settings.worker_id)
        self._client = CoordinatorClient(settings.server, token=settings.token)
        self._worker = Worker(self._client, self._settings)

    def who(self) -> tuple[str, dict[str, object]]:
        """Return the id of this node, and what the log says of this worker."""
        about = {"worker": self._settings.worker_id, "host": socket.gethostname(), "pid": os.getpid()}
        return str(ray.get_runtime_context().get_node_id()), about

    def work(self) -> int:
        """Work until told to stop; return as `Worker.run` does."""
        with self._client:
            return self._worker.run()

    def stop(self) -> None:
        """Have `work` finish and return."""
        self._worker.stop()


@dataclass(slots=True)
class _Member:
    """An actor of the pool; what it returns comes through Ray's references."""

    actor: Any
    work: Any
    who: Any
    started_s: float
    leaving: bool = False
    node: str = ""
    about: dict[str, object] = field(default_factory=dict)

    @property
    def placed(self) -> bool:
        """Whether it was seen to run."""
        return bool(self.about)


def run_pool(settings: PoolSettings) -> int:
    """Run workers on a cluster until told to stop; return the exit status.

    SIGTERM or SIGINT lets running episodes end and gives the rest back; a second one ends the program at once.
    """
    with _connected(settings):
        pool = Pool(settings)
        with stopped_by_signals(pool.stop):
            return pool.run()


class Pool:
    """The workers of one `brink worker --ray`.

    Args:
        settings: Everything else.
    """

    def __init__(self, settings: PoolSettings) -> None:
        self._settings = settings
        self._actor_type = ray.remote(num_cpus=1, max_concurrency=3)(PoolWorker)
        self._members: list[_Member] = []
        self._stopping = False
        self._idle_left = False
        self._failures = 0
        self._false_starts = 0
        self._next_start_s = 0.0
        self._quiet_until_s = time.monotonic() + WITHOUT_CPU_S
        self._backoff = Backoff(first_s=0.5, cap_s=30.0)
        self._rng = Random()

    def stop(self) -> None:
        """Have all workers finish, and let `run` return; safe from a signal handler."""
        self._stopping = True

    def run(self) -> int:
        """Have workers on the cluster until told to stop, or until all were idle for as long as the settings say.

        Returns:
            0 after a stop or an idle exit; 1 if workers could not work, with the reason in their logs.
        """
        log.info("workers for %s", self._settings.worker.server, extra={"cpus": _cpus()})
        while not self._stopping:
            if self._false_starts >= FALSE_STARTS and not any(map(_is_healthy, self._members)):
                log.error("leaving: one worker after the other could not work; their logs say why")
                self._drain()
                return 1
            if self._idle_left and not self._members:
                break
            self._fill()
            self._look(LOOK_S)
            self._leave_nodes_that_drain()
            self._tell_if_none_works()
        self._drain()
        log.info("leaving")
        return 0

    def _fill(self) -> None:
        """Start workers where there is room."""
        if self._idle_left or time.monotonic() < self._next_start_s:
            return
        for _ in range(self._room()):
            actor = self._actor_type.remote(
                self._settings.worker, self._settings.level, self._settings.log_format
            )
            self._members.append(
                _Member(actor, actor.work.remote(), actor.who.remote(), started_s=time.monotonic())
            )

    def _room(self) -> int:
        if self._settings.workers is not None:
            # Those that find no CPU wait for one: that is how a cluster learns that it should grow.
            return self._settings.workers - len(self._members)
        # What waits for a CPU is no reason to have more: it would make a cluster grow without end.
        waiting = sum(not member.placed for member in self._members)
        free = int(ray.available_resources().get("CPU", 0.0)) - waiting
        return max(0, min(free, _cpus() - len(self._members)))

    def _look(self, wait_s: float) -> None:
        """See which workers have begun and which have ended."""
        if not self._members:
            time.sleep(wait_s)
            return
        done, _ = ray.wait([member.work for member in self._members], timeout=wait_s)
        ended = [member for member in self._members if member.work in done]
        for member in self._members:
            if not member.placed:
                self._note_place(member)
        for member in ended:
            self._members.remove(member)
            self._ended(member)
        if self._settings.workers is None:
            horizon_s = time.monotonic() - PLACED_WITHIN_S
            self._give_up([m for m in self._members if not m.placed and m.started_s < horizon_s])

    def _note_place(self, member: _Member) -> None:
        if not ray.wait([member.who], timeout=0)[0]:
            return
        try:
            member.node, member.about = ray.get(member.who)
        except RayError as error:
            log.debug("an actor has no place: %s", _in_a_line(error))
            return
        log.info("worker started", extra=member.about)

    def _ended(self, member: _Member) -> None:
        try:
            status = int(ray.get(member.work))
        except RayError as error:
            if not member.leaving:
                log.warning("worker lost: %s", _in_a_line(error), extra=member.about)
            self._failed(member, false_start=False)
            return
        ray.kill(member.actor)  # nothing runs in it any more
        if status == 0:
            self._idle_left |= not member.leaving
            log.info("worker left", extra=member.about)
        else:
            log.warning("worker could not work; its log says why", extra=member.about)
            self._failed(member, false_start=True)

    def _failed(self, member: _Member, *, false_start: bool) -> None:
        if _is_healthy(member):
            self._failures = self._false_starts = 0
        self._failures += 1
        self._false_starts += false_start
        self._next_start_s = time.monotonic() + self._backoff.delay_s(self._failures, self._rng)

    def _tell_if_none_works(self) -> None:
        now_s = time.monotonic()
        if any(member.placed for member in self._members):
            self._quiet_until_s = now_s + WITHOUT_CPU_S
        elif now_s >= self._quiet_until_s:
            log.warning(
                "no worker has a CPU: others use them, or the cluster has none", extra={"cpus": _cpus()}
            )
            self._quiet_until_s = now_s + TOLD_AGAIN_S

    def _leave_nodes_that_drain(self) -> None:
        """Have workers leave nodes that are about to be taken away."""
        draining = _draining_nodes()
        for member in self._members:
            if member.node in draining and not member.leaving:
                log.info("worker leaves a node that drains", extra=member.about)
                self._let_go(member)

    def _let_go(self, member: _Member) -> None:
        if not member.leaving:
            member.leaving = True
            member.actor.stop.remote()

    def _drain(self) -> None:
        """Have all workers finish what they run and leave; end those that do not."""
        self._give_up([member for member in self._members if not member.placed])
        log.info("stopping", extra={"workers": len(self._members)})
        for member in self._members:
            self._let_go(member)
        end_s = time.monotonic() + self._settings.worker.grace_s + LEAVING_S
        while self._members and time.monotonic() < end_s:
            self._look(LOOK_S)
        if self._members:
            log.warning("workers that did not leave in time: %d; ending them", len(self._members))
            self._give_up(list(self._members))

    def _give_up(self, members: list[_Member]) -> None:
        for member in members:
            self._members.remove(member)
            ray.kill(member.actor)


@contextmanager
def _connected(settings: PoolSettings) -> Iterator[None]:
    """Join the cluster, or start one of our own, which ends with the block."""
    # What workers log reaches us with a prefix of Ray's, which no reader of JSON would take.
    given: dict[str, Any] = {
        "log_to_driver": settings.log_format is LogFormat.TEXT,
        "configure_logging": False,
    }
    if settings.address == LOCAL:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        own = {"object_store_memory": OBJECT_STORE_BYTES, "include_dashboard": False}
        given |= {"num_cpus": settings.workers, **own}
    try:
        ray.init(address=settings.address, **given)
    except (ConnectionError, RuntimeError, ValueError, RayError) as error:
        raise NoCluster(f"--ray {settings.address}: {_in_a_line(error)}") from error
    try:
        yield
    finally:
        ray.shutdown()


def _cpus() -> int:
    return int(ray.cluster_resources().get("CPU", 0.0))


def _is_healthy(member: _Member) -> bool:
    return member.placed and time.monotonic() - member.started_s >= HEALTHY_S


def _draining_nodes() -> Collection[str]:
    """Return the ids of nodes that are about to be taken away.

    Ray tells this to its own libraries alone so far. Should it stop to do so, workers work on until their node goes.
    """
    state = getattr(getattr(ray, "_private", None), "state", None)
    tell = getattr(getattr(state, "state", None), "get_draining_nodes", None)
    return tell() if tell is not None else ()


def _in_a_line(error: Exception) -> str:
    return " ".join(str(error).split())[:400] or type(error).__name__

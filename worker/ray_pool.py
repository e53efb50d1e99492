"""A pool of workers on a Ray cluster: actors with one CPU each that run the loop of `brink.worker.loop`.

The pool starts the workers, replaces those that die, and stops them gracefully. Each worker leases jobs from the
coordinator over HTTP, like any other, so a worker that dies loses its running episodes but no results. No campaign
data passes through Ray.

The same version of Brink must be installed on every node. An actor receives the token as a constructor argument,
because Ray writes the environment of actors, but not their arguments, to its logs and to command lines.
"""

import logging
import math
import os
import secrets
import socket
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
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
"""Address that starts a new Ray instance on this machine instead of joining a cluster."""

AUTH_MODE_VARIABLE: Final = "RAY_AUTH_MODE"
AUTH_TOKEN_VARIABLE: Final = "RAY_AUTH_TOKEN"
AUTH_FILE_VARIABLE: Final = "RAY_AUTH_TOKEN_PATH"
"""Ray's environment variables: whether a cluster requires a token, the token, and a file with it."""

POLL_S: Final = 0.5
PLACEMENT_TIMEOUT_S: Final = 30.0
"""When the pool fills free CPUs, an actor that gets no CPU within this time is killed: its CPU went elsewhere."""
HEALTHY_S: Final = 30.0
"""A worker that has lived this long counts as healthy."""
MAX_FALSE_STARTS: Final = 3
"""Number of workers that could not work after which the pool gives up, unless another worker is healthy."""
NO_CPU_WARNING_S: Final = 15.0
NO_CPU_REPEAT_S: Final = 60.0
"""While no worker runs, the pool logs a warning after the first time, and then at intervals of the second."""
OBJECT_STORE_BYTES: Final = 80 * 1024 * 1024
"""Size of a new Ray instance's object store: about the minimum that Ray accepts, since nothing is stored in it."""
EXIT_TIMEOUT_S: Final = LAST_REPORT_S + 5.0
"""How long a worker may take to exit after its running episode."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoolSettings:
    """Settings of a pool of workers.

    Attributes:
        address: Address of the cluster: ``HOST:PORT``, ``auto`` for the cluster of this machine, or ``local``.
        worker: Settings of each worker, except for its id.
        workers: Number of workers, or None for one per free CPU as nodes come and go.
        level: Log level of the pool and its workers.
        log_format: Log format of the pool and its workers.
    """

    address: str
    worker: WorkerSettings
    workers: int | None = None
    level: LogLevel = LogLevel.INFO
    log_format: LogFormat = LogFormat.TEXT


class PoolWorker:
    """One worker as an actor, whose methods run concurrently on threads.

    Args:
        settings: Settings of the worker, except for its id.
        level: Level of its log.
        log_format: Format of its log.
    """

    def __init__(self, settings: WorkerSettings, level: LogLevel, log_format: LogFormat) -> None:
        self._settings = replace(settings, worker_id=new_worker_id())
        configure_logging(level, log_format, worker=self._settings.worker_id)
        self._client = CoordinatorClient(settings.server, token=settings.token)
        self._worker = Worker(self._client, self._settings)

    def locate(self) -> tuple[str, dict[str, object]]:
        """Return the node id, and fields that identify this worker in the log."""
        fields = {"worker": self._settings.worker_id, "host": socket.gethostname(), "pid": os.getpid()}
        return str(ray.get_runtime_context().get_node_id()), fields

    def work(self) -> int:
        """Work until stopped, and return the exit status of `Worker.run`."""
        with self._client:
            return self._worker.run()

    def stop(self) -> None:
        """Let `work` finish and return."""
        self._worker.stop()


@dataclass(slots=True)
class _Member:
    """An actor of the pool; `work` and `location` are Ray references to its results."""

    actor: Any
    work: Any
    location: Any
    requested_s: float
    placed_s: float = math.inf
    leaving: bool = False
    node: str = ""
    log_fields: dict[str, object] = field(default_factory=dict)

    @property
    def placed(self) -> bool:
        """Whether the actor got a CPU and has started."""
        return math.isfinite(self.placed_s)

    @property
    def healthy(self) -> bool:
        """Whether the worker has run for a while; the time that it waited for a CPU does not count."""
        return time.monotonic() - self.placed_s >= HEALTHY_S


def run_pool(settings: PoolSettings) -> int:
    """Run workers on a cluster until stopped, and return the exit status.

    On SIGTERM or SIGINT the workers finish their running episodes and release their other jobs. A second signal ends
    the program at once.
    """
    with _connected(settings):
        pool = Pool(settings)
        with stopped_by_signals(pool.stop):
            return pool.run()


class Pool:
    """The workers of one `brink worker --ray` command."""

    def __init__(self, settings: PoolSettings) -> None:
        self._settings = settings
        self._actor_type = ray.remote(num_cpus=1, max_concurrency=3)(PoolWorker)
        self._members: list[_Member] = []
        self._stopping = False
        self._idle = False
        self._failures = 0
        self._false_starts = 0
        self._next_start_s = 0.0
        self._next_warning_s = time.monotonic() + NO_CPU_WARNING_S
        self._backoff = Backoff(first_s=0.5, cap_s=30.0)
        self._rng = Random()

    def stop(self) -> None:
        """Stop all workers gracefully and let `run` return; safe from a signal handler."""
        self._stopping = True

    def run(self) -> int:
        """Keep workers running until stopped, or until all have exited for being idle.

        Returns:
            0 after a stop or an idle exit; 1 if workers could not work, with the reason in their logs.
        """
        log.info("workers for %s", self._settings.worker.server, extra={"cpus": _cpus()})
        while not self._stopping:
            if self._false_starts >= MAX_FALSE_STARTS and not any(m.healthy for m in self._members):
                log.error("exiting: several workers in a row failed to start; see their logs")
                self._drain()
                return 1
            if self._idle and not self._members:
                break
            self._fill()
            self._update_members(POLL_S)
            self._leave_draining_nodes()
            self._warn_if_none_runs()
        self._drain()
        log.info("leaving")
        return 0

    def _fill(self) -> None:
        """Start as many workers as there is room for."""
        if self._idle or time.monotonic() < self._next_start_s:
            return
        for _ in range(self._room()):
            actor = self._actor_type.remote(
                self._settings.worker, self._settings.level, self._settings.log_format
            )
            self._members.append(
                _Member(actor, actor.work.remote(), actor.locate.remote(), requested_s=time.monotonic())
            )

    def _room(self) -> int:
        if self._settings.workers is not None:
            # Actors without a CPU wait for one: pending actors make an autoscaling cluster grow.
            return self._settings.workers - len(self._members)
        # Subtract actors that still wait for a CPU; otherwise an autoscaling cluster would grow without end.
        waiting = sum(not member.placed for member in self._members)
        free = int(ray.available_resources().get("CPU", 0.0)) - waiting
        return max(0, min(free, _cpus() - len(self._members)))

    def _update_members(self, wait_s: float) -> None:
        """Find out which workers have started and which have ended, waiting up to `wait_s` for an end."""
        if not self._members:
            time.sleep(wait_s)
            return
        done, _ = ray.wait([member.work for member in self._members], timeout=wait_s)
        ended = [member for member in self._members if member.work in done]
        for member in self._members:
            if not member.placed:
                self._update_location(member)
        for member in ended:
            self._members.remove(member)
            self._handle_end(member)
        if self._settings.workers is None:
            horizon_s = time.monotonic() - PLACEMENT_TIMEOUT_S
            self._kill([m for m in self._members if not m.placed and m.requested_s < horizon_s])

    def _update_location(self, member: _Member) -> None:
        if not ray.wait([member.location], timeout=0)[0]:
            return
        try:
            member.node, member.log_fields = ray.get(member.location)
        except RayError as error:
            log.debug("an actor was not placed: %s", _one_line(error))
            return
        member.placed_s = time.monotonic()
        log.info("worker started", extra=member.log_fields)

    def _handle_end(self, member: _Member) -> None:
        try:
            status = int(ray.get(member.work))
        except RayError as error:
            if not member.leaving:
                log.warning("worker lost: %s", _one_line(error), extra=member.log_fields)
            self._record_failure(member, false_start=False)
            return
        ray.kill(member.actor)  # nothing runs in it any more
        if status == 0:
            self._idle |= not member.leaving
            log.info("worker left", extra=member.log_fields)
        else:
            log.warning("worker could not work; see its log", extra=member.log_fields)
            self._record_failure(member, false_start=True)

    def _record_failure(self, member: _Member, *, false_start: bool) -> None:
        if member.healthy:
            self._failures = self._false_starts = 0
        self._failures += 1
        self._false_starts += false_start
        self._next_start_s = time.monotonic() + self._backoff.delay_s(self._failures, self._rng)

    def _warn_if_none_runs(self) -> None:
        now_s = time.monotonic()
        if any(member.placed for member in self._members):
            self._next_warning_s = now_s + NO_CPU_WARNING_S
        elif now_s >= self._next_warning_s:
            log.warning(
                "no worker has a CPU: all are in use, or the cluster has none", extra={"cpus": _cpus()}
            )
            self._next_warning_s = now_s + NO_CPU_REPEAT_S

    def _leave_draining_nodes(self) -> None:
        """Stop the workers on nodes that are about to be removed."""
        draining = _draining_nodes()
        for member in self._members:
            if member.node in draining and not member.leaving:
                log.info("worker leaves a draining node", extra=member.log_fields)
                self._stop_worker(member)

    def _stop_worker(self, member: _Member) -> None:
        if not member.leaving:
            member.leaving = True
            member.actor.stop.remote()

    def _drain(self) -> None:
        """Stop all workers gracefully, and kill those that do not exit in time."""
        self._kill([member for member in self._members if not member.placed])
        log.info("stopping", extra={"workers": len(self._members)})
        for member in self._members:
            self._stop_worker(member)
        end_s = time.monotonic() + self._settings.worker.grace_s + EXIT_TIMEOUT_S
        while self._members and time.monotonic() < end_s:
            self._update_members(POLL_S)
        if self._members:
            log.warning("%d workers did not exit in time; killing them", len(self._members))
            self._kill(list(self._members))

    def _kill(self, members: list[_Member]) -> None:
        for member in members:
            self._members.remove(member)
            ray.kill(member.actor)


@contextmanager
def _connected(settings: PoolSettings) -> Iterator[None]:
    """Join the cluster, or start a local one that ends with the block."""
    # Ray adds a prefix to the lines that workers log, which would make them invalid JSON.
    options: dict[str, Any] = {
        "log_to_driver": settings.log_format is LogFormat.TEXT,
        "configure_logging": False,
    }
    if settings.address == LOCAL:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        # Without one, Ray would write a token to the home folder, and from then on every `ray start --head` of this
        # user would start a cluster that requires it.
        os.environ.setdefault(AUTH_TOKEN_VARIABLE, secrets.token_hex(32))
        own = {"object_store_memory": OBJECT_STORE_BYTES, "include_dashboard": False}
        options |= {"num_cpus": settings.workers, **own}
    try:
        ray.init(address=settings.address, **options)
    except (ConnectionError, RuntimeError, ValueError, RayError) as error:
        advice = "" if settings.address == LOCAL else f". {_advice()}"
        raise NoCluster(f"--ray {settings.address}: {_one_line(error)}{advice}") from error
    try:
        yield
    finally:
        ray.shutdown()


def _advice() -> str:
    """Return what to do if a cluster cannot be joined; Ray does not say whether the cluster requires a token."""
    set_token = f"{AUTH_TOKEN_VARIABLE} to what `ray get-auth-token` prints on the head node"
    if os.environ.get(AUTH_MODE_VARIABLE, "").lower() != "token":
        return (
            "Is a cluster running there? If it requires a token, set "
            f"{AUTH_MODE_VARIABLE}=token and {set_token}"
        )
    file = Path(os.environ.get(AUTH_FILE_VARIABLE) or "~/.ray/auth_token")
    if os.environ.get(AUTH_TOKEN_VARIABLE):
        used = AUTH_TOKEN_VARIABLE
    elif file.expanduser().exists():
        used = str(file)
    else:
        return f"Set {set_token}"
    return f"Is a cluster running there, and is {used} its token? Set {set_token}"


def _cpus() -> int:
    return int(ray.cluster_resources().get("CPU", 0.0))


def _draining_nodes() -> Collection[str]:
    """Return the ids of nodes that are about to be removed.

    Ray exposes them only in a private API. If that API disappears, workers keep running until their node is removed.
    """
    state = getattr(getattr(ray, "_private", None), "state", None)
    get_draining_nodes = getattr(getattr(state, "state", None), "get_draining_nodes", None)
    return get_draining_nodes() if get_draining_nodes is not None else ()


def _one_line(error: Exception) -> str:
    words = getattr(error, "message", None) or str(
        error
    )  # that of authentication errors comes with other advice
    return " ".join(str(words).split())[:400].rstrip(".") or type(error).__name__

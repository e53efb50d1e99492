"""Running a coordinator in this process, and worker processes alongside it."""

import asyncio
import contextlib
import errno
import gc
import logging
import os
import resource
import secrets
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import uvicorn
from pydantic import SecretStr

from brink.server.app import create_app
from brink.server.errors import ServerError
from brink.server.runtime.database import has_tokens, prepare_database, release_leases_of_dead_workers
from brink.server.runtime.request_timeout import protocol_with_timeout
from brink.server.settings import LOOPBACK, Settings
from brink.server.user_code import USER_CODE, Serving

START_S = 15.0
SWITCH_S: Final = 0.0005
"""Longest time for which a thread that computes makes the others wait. With Python's default, ten times as long, a
request waits that long several times over while a generation step runs."""


class CannotListen(ServerError):
    """The coordinator cannot listen on the configured address."""


class PortInUse(CannotListen):
    """Another program listens on the configured port."""


def freeze_loaded_objects() -> None:
    """Exempt all existing objects from garbage collection, in processes that only serve.

    There are some 200,000 of them. Visiting them in each full collection would stall all requests for .1 s.
    """
    gc.collect()
    gc.freeze()


def check_exposed(settings: Settings) -> None:
    """Check that a coordinator which other machines can reach has a token.

    Raises:
        CannotListen: It has none.
    """
    if settings.host not in LOOPBACK and settings.token is None and not has_tokens(settings):
        raise CannotListen(
            f"other machines can connect to {settings.host}, so a token is required: create one (brink token create "
            "NAME --scope worker), set a secret in BRINK_TOKEN here and for the workers, or listen on 127.0.0.1"
        )


def listen(settings: Settings) -> socket.socket:
    """Return a socket that listens on the configured address; port 0 selects a free one.

    Raises:
        CannotListen: A token is missing, the port is in use, or the address does not belong to this machine.
    """
    check_exposed(settings)
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    # asyncio disables Nagle's algorithm only if the protocol is given; otherwise responses wait 40 ms for an ACK.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((settings.host, settings.port))
    except OSError as error:
        listener.close()
        reason = PortInUse if error.errno == errno.EADDRINUSE else CannotListen
        raise reason(
            f"cannot listen on {settings.host}:{settings.port}: {error.strerror}; choose another port with --port"
        ) from None
    listener.listen(512)
    return listener


def url_of(listener: socket.socket) -> str:
    """Return the URL of a listening socket, as seen from this machine."""
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


class CoordinatorServer(uvicorn.Server):
    """A uvicorn server for the coordinator; on shutdown it answers pending long polls first."""

    def __init__(self, settings: Settings) -> None:
        self._app = create_app(settings)
        self._plugin_timeout_s = settings.plugin_timeout_s
        self._serving: Serving | None = None
        super().__init__(
            uvicorn.Config(
                self._app,
                log_config=None,
                access_log=False,
                http=protocol_with_timeout(settings.stall_s),
                lifespan="on",
                timeout_keep_alive=75,
                timeout_graceful_shutdown=3,
            )
        )

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until told to exit."""
        before_s = sys.getswitchinterval()
        sys.setswitchinterval(min(SWITCH_S, before_s))
        self._serving = USER_CODE.begin(self._plugin_timeout_s)
        try:
            await super().serve(sockets)
        finally:
            sys.setswitchinterval(before_s)
            # Requests that were cancelled may still have threads that wait for user code.
            USER_CODE.stop(self._serving)
            try:
                await asyncio.get_running_loop().shutdown_default_executor()
            finally:
                USER_CODE.end(self._serving)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop serving."""
        self._app.state.context.queue.end_waits()
        if self._serving is not None:
            USER_CODE.stop(self._serving)
        await super().shutdown(sockets)


class EmbeddedCoordinator:
    """A coordinator on a thread of this process."""

    def __init__(self, settings: Settings) -> None:
        self._listener = listen(settings)
        self.url = url_of(self._listener)
        self._server = CoordinatorServer(settings)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._listener]}, name="brink-coordinator"
        )

    def start(self) -> None:
        """Start serving; return once the server accepts requests.

        Raises:
            CannotListen: The server did not start.
        """
        self._thread.start()
        deadline = time.monotonic() + START_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                raise CannotListen("the coordinator did not start; see its log")
            time.sleep(0.01)

    def stop(self) -> None:
        """Finish the requests in progress, commit, and stop."""
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join()
        self._listener.close()


@dataclass(slots=True)
class WorkerProcesses:
    """Worker processes of this process. They exit when it does, even if it is killed.

    Attributes:
        url: The coordinator.
        log_file: File to which they log.
        token: Their token; None if the coordinator needs none.
        environment: Environment variables that they get besides those of this process.
    """

    url: str
    log_file: Path
    token: str | None
    environment: Mapping[str, str] = field(default_factory=dict)
    _running: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, count: int) -> None:
        """Start more workers."""
        environment = {**os.environ, **self.environment}
        if self.token is not None:
            environment["BRINK_TOKEN"] = self.token
        self.log_file.parent.mkdir(parents=True, exist_ok=True)
        with self.log_file.open("ab") as log:
            for _ in range(count):
                self._running.append(
                    subprocess.Popen(
                        [sys.executable, "-m", "brink.worker", "--server", self.url, "--exit-with-parent"],
                        stdin=subprocess.PIPE,
                        stdout=log,
                        stderr=log,
                        env=environment,
                        start_new_session=True,  # Ctrl-C goes to this command, which then stops its workers
                    )
                )

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return [process.pid for process in self._running]

    def replace_dead(self) -> int:
        """Replace the workers that have died; return their number."""
        dead = [process for process in self._running if process.poll() is not None]
        self._running = [process for process in self._running if process.poll() is None]
        for process in dead:
            if process.stdin is not None:
                process.stdin.close()
        if dead:
            logging.getLogger(__name__).warning("replacing workers that died: %d", len(dead))
            self.start(len(dead))
        return len(dead)

    def stop(self, grace_s: float = 10.0) -> None:
        """Let all workers finish their jobs and exit; kill those still running after ``grace_s`` seconds."""
        for process in self._running:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + grace_s
        for process in self._running:
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdin is not None:
                process.stdin.close()
        self._running.clear()


@contextlib.contextmanager
def local_coordinator(
    settings: Settings, worker_log: Path, *, any_port: bool = False
) -> Iterator[WorkerProcesses]:
    """Yield the workers of a coordinator in this process; all are stopped at the end of the block.

    Args:
        settings: Settings of the coordinator. Its database is created or upgraded.
        worker_log: Log file of the workers, none of which is started yet.
        any_port: Whether to listen on a free port if another program uses that of the settings.

    Raises:
        DatabaseError: The database is unusable.
        CannotListen: The coordinator failed to start.
    """
    prepare_database(settings)
    if settings.token is None and has_tokens(settings, valid_only=False):
        # The database belongs to a coordinator with tokens: this process and its workers share a separate token.
        settings = settings.model_copy(update={"token": SecretStr(secrets.token_hex(24))})
    release_leases_of_dead_workers(settings)
    try:
        coordinator = EmbeddedCoordinator(settings)
    except PortInUse:
        if not any_port:
            raise
        coordinator = EmbeddedCoordinator(settings.model_copy(update={"port": 0}))
    coordinator.start()
    token = settings.token.get_secret_value() if settings.token else None
    processes = WorkerProcesses(url=coordinator.url, log_file=worker_log, token=token)
    try:
        yield processes
    finally:
        processes.stop()
        coordinator.stop()


_MAX_OPEN_FILES: Final = 65_536


def allow_many_open_files() -> None:
    """Raise the limit on open files of this process: each connection needs one, and the default is often 1,024."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _MAX_OPEN_FILES if hard == resource.RLIM_INFINITY else min(hard, _MAX_OPEN_FILES)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))

"""A coordinator inside a command, and worker processes beside it."""

import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import uvicorn

from brink.server.app import create_app
from brink.server.errors import ServerError
from brink.server.runtime.database import has_tokens
from brink.server.runtime.request_timeout import impatient
from brink.server.settings import LOOPBACK, Settings

START_S = 15.0


class CannotListen(ServerError):
    """The coordinator cannot listen where it should."""


def check_exposed(settings: Settings) -> None:
    """Refuse to listen beyond this machine without a token.

    Raises:
        CannotListen: There is none.
    """
    if settings.host not in LOOPBACK and settings.token is None and not has_tokens(settings):
        raise CannotListen(
            f"listening on {settings.host} lets other machines in: make tokens (brink token create NAME --scope "
            "worker), or set a secret in BRINK_TOKEN, here and for the workers, or listen on 127.0.0.1"
        )


def listen(settings: Settings) -> socket.socket:
    """Return a socket that listens where the settings say; port 0 takes a free one.

    Raises:
        CannotListen: The port is in use, or the address is not one of this machine.
    """
    check_exposed(settings)
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    # asyncio turns Nagle's algorithm off only where the protocol is named; else every answer waits 40 ms for an ACK.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((settings.host, settings.port))
    except OSError as error:
        listener.close()
        raise CannotListen(
            f"cannot listen on {settings.host}:{settings.port}: {error.strerror}; choose another with --port"
        ) from None
    listener.listen(512)
    return listener


def url_of(listener: socket.socket) -> str:
    """Return the URL at which a listening socket is reached from this machine."""
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


class CoordinatorServer(uvicorn.Server):
    """Serves the coordinator; asked to stop, it answers those who wait for work, so that nobody is cut off."""

    def __init__(self, settings: Settings) -> None:
        self._app = create_app(settings)
        super().__init__(
            uvicorn.Config(
                self._app,
                log_config=None,
                access_log=False,
                http=impatient(settings.stall_s),
                lifespan="on",
                timeout_keep_alive=75,
                timeout_graceful_shutdown=3,
            )
        )

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop serving."""
        self._app.state.context.queue.end_waits()
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
        """Serve, and return once requests are answered.

        Raises:
            CannotListen: It did not come up.
        """
        self._thread.start()
        deadline = time.monotonic() + START_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                raise CannotListen("the coordinator did not come up; its log says why")
            time.sleep(0.01)

    def stop(self) -> None:
        """Answer what is under way, commit, and return."""
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join()
        self._listener.close()


@dataclass(slots=True)
class WorkerProcesses:
    """Worker processes of this command. They leave when it does, even if it is killed."""

    url: str
    log_file: Path
    token: str | None
    _running: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, count: int) -> None:
        """Start some more workers."""
        environment = dict(os.environ)
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
                        start_new_session=True,  # Ctrl-C is for this command, which then stops its workers
                    )
                )

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return [process.pid for process in self._running]

    def replace_dead(self) -> int:
        """Start a worker for each that died; return how many."""
        dead = [process for process in self._running if process.poll() is not None]
        self._running = [process for process in self._running if process.poll() is None]
        if dead:
            logging.getLogger(__name__).warning("workers that died: %d; starting others", len(dead))
            self.start(len(dead))
        return len(dead)

    def stop(self, grace_s: float = 10.0) -> None:
        """Have all workers finish what they run and leave; kill those that do not."""
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

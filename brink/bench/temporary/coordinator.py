"""Coordinators and workers as processes of their own, as users start them, for measurements and trials."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import httpx
from prometheus_client.parser import text_string_to_metric_families

from brink.server.errors import ServerError

START_S = 60.0
_BRINK = (sys.executable, "-c", "from brink.cli.main import main; main()")
_LOOPBACK = "127.0.0.1"


class DidNotStart(ServerError):
    """A process of a measurement did not come up."""


class Process:
    """A program in the background whose output goes to a file. Made again, it adds to the file.

    Args:
        command: What to run.
        log_file: Where its output goes.
        env: Environment, besides that of this process.
    """

    def __init__(self, command: Sequence[str], log_file: Path, env: Mapping[str, str]) -> None:
        self._command = tuple(command)
        self._log_file = log_file
        self._env = dict(env)
        self._popen: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """Its process id, if it runs."""
        return self._popen.pid if self.alive and self._popen is not None else None

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._popen is not None and self._popen.poll() is None

    @property
    def said(self) -> str:
        """The end of what it wrote."""
        return self._log_file.read_text(errors="replace")[-4000:] if self._log_file.exists() else ""

    @property
    def last_words(self) -> str:
        """The last line that it wrote."""
        return self.said.strip().rpartition("\n")[2]

    @property
    def exit_status(self) -> int | None:
        """How it ended, if it did: minus the signal, if one killed it."""
        return None if self._popen is None else self._popen.poll()

    def start(self) -> None:
        """Start it if it does not run."""
        if self.alive:
            return
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("BRINK_")}
        with self._log_file.open("ab") as log:
            self._popen = subprocess.Popen(
                self._command,
                env={**inherited, **self._env}, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                start_new_session=True,
            )  # fmt: skip

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal, if it runs."""
        if self._popen is not None and self.alive:
            self._popen.send_signal(number)

    def stop(self, grace_s: float = 15.0) -> None:
        """Have it end, and kill it if it does not."""
        if self._popen is None:
            return
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGTERM)
        try:
            self._popen.wait(grace_s)
        except subprocess.TimeoutExpired:
            self.kill()

    def kill(self) -> None:
        """End it at once."""
        if self._popen is not None:
            self.signal(signal.SIGKILL)
            self._popen.wait()


class CoordinatorProcess(Process):
    """``brink serve`` on a port of its own, the same each time that it is started.

    Attributes:
        url: Where it listens.
    """

    def __init__(self, database: str, log_file: Path, env: Mapping[str, str]) -> None:
        self.port = free_port()
        self.url = f"http://{_LOOPBACK}:{self.port}"
        super().__init__(
            [*_BRINK, "serve", "--database", database, "--host", _LOOPBACK, "--port", str(self.port)],
            log_file,
            env,
        )

    def start_ready(self) -> None:
        """Start it, and return once it serves.

        Raises:
            DidNotStart: It does not.
        """
        self.start()
        deadline = time.monotonic() + START_S
        while True:
            try:
                if httpx.get(f"{self.url}/readyz", timeout=5.0).status_code == httpx.codes.OK:
                    return
            except httpx.TransportError:
                pass
            if not self.alive or time.monotonic() > deadline:
                raise DidNotStart(f"the coordinator did not come up: {self.said}")
            time.sleep(0.02)  # between two looks

    def measured(self) -> dict[str, float]:
        """Return what it measures of itself without regard to labels, by the names in ``/metrics``."""
        told = httpx.get(f"{self.url}/metrics", timeout=60.0).raise_for_status().text
        return {
            sample.name: sample.value
            for family in text_string_to_metric_families(told)
            for sample in family.samples
            if not sample.labels
        }


def worker_command(server: str, *options: str) -> list[str]:
    """Return the command line of a worker."""
    return [sys.executable, "-m", "brink.worker", "--server", server, *options]


def free_port() -> int:
    """Return a port that nobody listens on now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.bind((_LOOPBACK, 0))
        port: int = listener.getsockname()[1]
        return port

"""Coordinators and workers as separate processes, started as users start them; they end with this process."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import httpx
from prometheus_client import Metric
from prometheus_client.parser import text_string_to_metric_families

from benchmarks.lifeline import start_tied
from brink.server.errors import ServerError
from brink.sim.catalogue import PLUGINS_VARIABLE

START_TIMEOUT_S = 60.0
_BRINK = (sys.executable, "-c", "from brink.cli.main import main; main()")
_LOOPBACK = "127.0.0.1"


class MeasurementFailed(ServerError):
    """A process of a measurement did not start, or did not complete its work in time."""


class Process:
    """A background process that appends its output to a log file and can be restarted.

    Args:
        command: Command line.
        log_file: File for its output.
        env: Environment variables in addition to those of this process. ``BRINK_*`` variables are not inherited.
    """

    def __init__(self, command: Sequence[str], log_file: Path, env: Mapping[str, str]) -> None:
        self._command = tuple(command)
        self._log_file = log_file
        self._env = dict(env)
        self._popen: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """Process id; None unless the process is running."""
        return self._popen.pid if self.alive and self._popen is not None else None

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self._popen is not None and self._popen.poll() is None

    @property
    def output(self) -> str:
        """The last 4,000 characters of the log file."""
        return self._log_file.read_text(errors="replace")[-4000:] if self._log_file.exists() else ""

    @property
    def last_line(self) -> str:
        """The last line of the log file."""
        return self.output.strip().rpartition("\n")[2]

    @property
    def exit_status(self) -> int | None:
        """Exit status, negative for a signal; None unless the process has ended."""
        return None if self._popen is None else self._popen.poll()

    def start(self) -> None:
        """Start the process unless it is running."""
        if self.alive:
            return
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("BRINK_")}
        with self._log_file.open("ab") as log:
            self._popen = start_tied(
                self._command,
                env={**inherited, **self._env},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the process if it is running."""
        if self._popen is not None and self.alive:
            self._popen.send_signal(number)

    def stop(self, grace_s: float = 15.0) -> None:
        """Terminate the process, and kill it after a grace period."""
        if self._popen is None:
            return
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGTERM)
        try:
            self._popen.wait(grace_s)
        except subprocess.TimeoutExpired:
            self.kill()

    def kill(self) -> None:
        """Kill the process."""
        if self._popen is not None:
            self.signal(signal.SIGKILL)
            self._popen.wait()


class CoordinatorProcess(Process):
    """``brink serve`` on a free port, which it keeps across restarts.

    Attributes:
        port: TCP port.
        url: Base URL.
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
        """Start the coordinator and wait until it is ready.

        Raises:
            MeasurementFailed: The process ended, or was not ready in time.
        """
        self.start()
        deadline = time.monotonic() + START_TIMEOUT_S
        while True:
            try:
                if httpx.get(f"{self.url}/readyz", timeout=5.0).status_code == httpx.codes.OK:
                    return
            except httpx.TransportError:
                pass
            if not self.alive or time.monotonic() > deadline:
                raise MeasurementFailed(f"the coordinator did not start: {self.output}")
            time.sleep(0.02)  # between two polls

    def metric_families(self) -> list[Metric]:
        """Return the metric families that ``/metrics`` reports."""
        text = httpx.get(f"{self.url}/metrics", timeout=60.0).raise_for_status().text
        return list(text_string_to_metric_families(text))

    def metrics(self) -> dict[str, float]:
        """Return the values of the metrics that have no labels, by name."""
        return {
            sample.name: sample.value
            for family in self.metric_families()
            for sample in family.samples
            if not sample.labels
        }


@contextmanager
def running_coordinator(folder: Path, plugin: str | None = None) -> Iterator[CoordinatorProcess]:
    """Run a coordinator on a new SQLite database until the end of the block.

    Args:
        folder: Folder for the database ``coordinator.db`` and the log file.
        plugin: Module that registers further problems and simulators.

    Raises:
        MeasurementFailed: The coordinator did not start.
    """
    coordinator = CoordinatorProcess(
        f"sqlite:///{folder}/coordinator.db", folder / "coordinator.log", plugin_environment(plugin)
    )
    try:
        coordinator.start_ready()
        yield coordinator
    finally:
        coordinator.kill()


@contextmanager
def running_workers(
    coordinator: CoordinatorProcess, count: int, folder: Path, plugin: str | None = None
) -> Iterator[list[Process]]:
    """Run worker processes until the end of the block.

    Args:
        coordinator: Their coordinator.
        count: Number of workers.
        folder: Folder for their log files.
        plugin: Module that registers further problems and simulators.
    """
    command = [sys.executable, "-m", "brink.worker", "--server", coordinator.url]
    environment = plugin_environment(plugin)
    workers = [Process(command, folder / f"worker-{number}.log", environment) for number in range(count)]
    try:
        for worker in workers:
            worker.start()
        yield workers
    finally:
        for worker in workers:
            worker.kill()


def free_port() -> int:
    """Return a free TCP port on the loopback interface."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.bind((_LOOPBACK, 0))
        port: int = listener.getsockname()[1]
        return port


def plugin_environment(*plugins: str | None) -> dict[str, str]:
    """Return the environment variables that make a process import plug-in modules."""
    names = [plugin for plugin in plugins if plugin is not None]
    return {PLUGINS_VARIABLE: ",".join(names)} if names else {}

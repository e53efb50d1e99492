"""Runs workers for tests: in a thread of the test, or as a program of their own."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from brink.worker.client import CoordinatorClient
from brink.worker.loop import Worker
from brink.worker.settings import WorkerSettings

ROOT = Path(__file__).resolve().parents[3]
PLUGINS = ROOT / "tests" / "plugins"
PATIENCE_S = 30.0


def use_faulty_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the simulation processes of this test find ``faulty@1``."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(PLUGINS), str(ROOT))))
    monkeypatch.setenv("BRINK_PLUGINS", "faulty_simulator")


class RunningWorker:
    """A worker in a thread."""

    def __init__(self, worker: Worker) -> None:
        self.worker = worker
        self.status: int | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def join(self) -> int:
        """Wait for its end and return its exit status."""
        self._thread.join(PATIENCE_S)
        assert self.status is not None, "the worker did not end"
        return self.status

    def _run(self) -> None:
        self.status = self.worker.run()


@contextmanager
def working(url: str, *, token: str | None = None, **settings: Any) -> Iterator[RunningWorker]:
    """Run a worker until the end of the block."""
    chosen = WorkerSettings(
        **{"server": url, "worker_id": "w", "wait_s": 5.0, "memory_mib": 512, "token": token, **settings}
    )
    with CoordinatorClient(url, token=token) as client:
        running = RunningWorker(Worker(client, chosen))
        try:
            yield running
        finally:
            running.worker.stop(grace_s=0.0)
            running.join()


@contextmanager
def worker_program(url: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run ``python -m brink.worker``; its log can be read from ``stderr`` after its end."""
    command = [
        sys.executable,
        "-m",
        "brink.worker",
        "--server",
        url,
        "--wait",
        "5",
        "--memory",
        "512",
        *arguments,
    ]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as program:
        try:
            yield program
        finally:
            if program.poll() is None:
                program.kill()

"""Real processes for tests: coordinators, workers and commands, as a user starts them."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx

TESTS = Path(__file__).resolve().parents[1]
ROOT = TESTS.parent
PATIENCE_S = 120.0
BRINK = str(Path(sys.executable).with_name("brink"))
TOY = {"BRINK_PLUGINS": "support.problem_plugin,faulty_simulator"}
"""Lets coordinators find ``ball@1`` and workers find ``faulty@1``."""


def environment(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment of a command: nothing of Brink's but what a test says."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("BRINK_")}
    paths = os.pathsep.join(map(str, (TESTS, TESTS / "plugins", ROOT)))
    return {**kept, "PYTHONPATH": paths, "COLUMNS": "200", **(more or {})}


def brink(
    *arguments: str, cwd: Path, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        [BRINK, *arguments],
        cwd=cwd,
        env=environment(env),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S * 2,
        check=False,
        stdin=subprocess.DEVNULL,
    )


class Program:
    """A program that runs in the background; its output is gathered line by line."""

    def __init__(self, command: Sequence[str], *, cwd: Path, env: Mapping[str, str] | None = None) -> None:
        self.lines: list[str] = []
        self._news = threading.Condition()
        self.process = subprocess.Popen(
            list(command),
            cwd=cwd,
            env=environment(env),
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        """Leave it running."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Kill it if it still runs."""
        self.kill()

    @property
    def output(self) -> str:
        """What it has said."""
        return "".join(self.lines)

    def await_line(self, pattern: str) -> re.Match[str]:
        """Wait for a line that matches."""
        deadline = time.monotonic() + PATIENCE_S
        with self._news:
            seen = 0
            while True:
                for line in self.lines[seen:]:
                    if found := re.search(pattern, line):
                        return found
                seen = len(self.lines)
                ended = self.process.poll() is not None and not self._reader.is_alive()
                assert not ended, f"ended with {self.process.returncode} before {pattern!r}: {self.output}"
                assert time.monotonic() < deadline, f"never said {pattern!r}: {self.output}"
                self._news.wait(0.1)

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self.process.send_signal(number)

    def wait(self) -> int:
        """Wait for its end and return its exit status."""
        status = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        return status

    def kill(self) -> None:
        """Kill it with all that it started in its session, at once, if it still runs."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._news:
                self.lines.append(line)
                self._news.notify_all()


@dataclass(slots=True, kw_only=True)
class Site:
    """A coordinator and workers on one database; both may be killed and started again."""

    folder: Path
    database: str
    env: Mapping[str, str] = field(default_factory=dict)
    port: int = 0
    coordinator: Program | None = None
    workers: list[Program] = field(default_factory=list)

    @property
    def url(self) -> str:
        """Where the coordinator listens."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def headers(self) -> dict[str, str]:
        """What every request carries: the coordinator's token, if it has one."""
        token = self.env.get("BRINK_TOKEN")
        return {"Authorization": f"Bearer {token}"} if token else {}

    def get(self, path: str) -> httpx.Response:
        """Ask the coordinator."""
        response = httpx.get(f"{self.url}{path}", headers=self.headers)
        assert response.status_code == 200, response.text
        return response

    def start_coordinator(self) -> None:
        """Start the coordinator, at the same port as before."""
        self.coordinator = Program(
            [BRINK, "serve", "--database", self.database, "--port", str(self.port)],
            cwd=self.folder,
            env=self.env,
        )
        self.port = int(self.coordinator.await_line(r"coordinator at http://127\.0\.0\.1:(\d+)")[1])
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                if httpx.get(f"{self.url}/readyz").status_code == 200:
                    return
            except httpx.TransportError:
                pass
            assert time.monotonic() < deadline, f"not ready: {self.coordinator.output}"
            time.sleep(0.02)  # between two looks

    def start_workers(self, count: int, *arguments: str) -> None:
        """Start some more workers."""
        command = [
            sys.executable,
            "-m",
            "worker",
            "--server",
            self.url,
            "--wait",
            "5",
            "--memory",
            "512",
            *arguments,
        ]
        self.workers += [Program(command, cwd=self.folder, env=self.env) for _ in range(count)]

    def kill_everything(self) -> None:
        """Kill coordinator and workers at once."""
        for program in (self.coordinator, *self.workers):
            if program is not None:
                program.kill()
        self.coordinator = None
        self.workers.clear()

    def progress(self, campaign: str) -> dict[str, Any]:
        """Return where a campaign stands."""
        document: dict[str, Any] = self.get(f"/api/v1/campaigns/{campaign}/progress").json()
        return document

    def submit(self, body: Mapping[str, Any]) -> str:
        """Submit a campaign and return its id."""
        response = httpx.post(f"{self.url}/api/v1/campaigns", json=dict(body), headers=self.headers)
        assert response.status_code == 201, response.text
        return str(response.json()["id"])

    def await_end(self, campaign: str) -> dict[str, Any]:
        """Wait until a campaign is no longer running, and return where it stands."""
        return self.await_progress(campaign, simulations=None)

    def await_progress(self, campaign: str, *, simulations: int | None) -> dict[str, Any]:
        """Wait until so many simulations are done, or the campaign is no longer running."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            stands = self.progress(campaign)
            if stands["status"] != "running" or (
                simulations is not None and stands["simulations"] >= simulations
            ):
                return stands
            said = "\n".join(program.output for program in self.workers)
            assert time.monotonic() < deadline, f"{json.dumps(stands)}\n{said}"
            time.sleep(0.02)  # between two looks


@contextmanager
def site(folder: Path, database: str, env: Mapping[str, str] | None = None) -> Iterator[Site]:
    """Give a coordinator that runs, killed at the end of the block with its workers."""
    made = Site(folder=folder, database=database, env=env or {})
    try:
        made.start_coordinator()
        yield made
    finally:
        made.kill_everything()

"""Settings of a worker, validated on construction."""

import math
import os
import secrets
import socket
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from brink.worker.errors import SettingsError

TOKEN_VARIABLE = "BRINK_TOKEN"
MAX_JOBS = 128
"""Upper bound of `max_jobs`; well below the 256 results that one message may carry."""


def new_worker_id() -> str:
    """Return a unique id made of host name, process id and eight random hexadecimal digits."""
    return f"{socket.gethostname()[:40]}-{os.getpid()}-{secrets.token_hex(4)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerSettings:
    """Settings of a worker.

    Attributes:
        server: Base URL of the coordinator, such as ``http://127.0.0.1:8700``.
        worker_id: Unique name, constant for the life of the process, 1 to 64 characters.
        token: Bearer token, or None if the coordinator requires none.
        max_jobs: Maximum number of jobs to hold at once, the running one included, 1 to 128.
        prefetch_s: Work to hold, in seconds of simulation, at most `max_jobs` jobs. A smaller value spreads the end
            of a generation more evenly over the workers; a larger one makes fewer requests.
        wait_s: How long the lease request of an idle worker may wait for a job, at most 60.
        report_after_s: Longest time that an outcome waits before it is reported.
        memory_mib: Memory that episodes may add to what the started simulation process uses; 0 sets no limit.
        grace_s: How long the running episode may continue after the worker was asked to stop.
        exit_when_idle_s: Time without a job after which the worker exits, or None.
        plugins: Modules to import for their plug-ins, in addition to those in ``BRINK_PLUGINS``.
        start_timeout_s: Time limit for importing the simulators in the simulation process.
        abandon_after_s: A running job whose lease is lost is killed once it has run this long. A shorter one may
            finish, since starting a new process costs about a second.
        exit_with_parent: Exit when standard input ends.
        alive_file: File that the worker touches every few seconds while its threads make progress, or None.
    """

    server: str
    worker_id: str = field(default_factory=new_worker_id)
    token: str | None = field(default=None, repr=False)
    max_jobs: int = 16
    prefetch_s: float = 1.0
    wait_s: float = 20.0
    report_after_s: float = 1.0
    memory_mib: int = 2048
    grace_s: float = 8.0
    exit_when_idle_s: float | None = None
    plugins: tuple[str, ...] = ()
    start_timeout_s: float = 120.0
    abandon_after_s: float = 2.0
    exit_with_parent: bool = False
    alive_file: Path | None = None

    def __post_init__(self) -> None:
        url = urlsplit(self.server)
        if url.scheme not in ("http", "https") or not url.hostname:
            raise SettingsError(
                "server", f"expected a URL such as http://127.0.0.1:8700, got {self.server!r}"
            )
        if not 1 <= len(self.worker_id) <= 64:
            raise SettingsError("worker_id", f"expected 1 to 64 characters, got {len(self.worker_id)}")
        if not 1 <= self.max_jobs <= MAX_JOBS:
            raise SettingsError("max_jobs", f"expected 1 to {MAX_JOBS}, got {self.max_jobs}")
        if not 0 <= self.wait_s <= 60:
            raise SettingsError("wait_s", f"expected 0 to 60 seconds, got {self.wait_s}")
        if self.memory_mib < 0:
            raise SettingsError("memory_mib", f"expected 0 (no limit) or more, got {self.memory_mib}")
        for name in ("prefetch_s", "report_after_s", "grace_s", "abandon_after_s"):
            self._check_seconds(name, getattr(self, name))
        self._check_seconds("start_timeout_s", self.start_timeout_s)
        if self.exit_when_idle_s is not None:
            self._check_seconds("exit_when_idle_s", self.exit_when_idle_s)

    @staticmethod
    def _check_seconds(name: str, value: float) -> None:
        if not (math.isfinite(value) and value >= 0):
            raise SettingsError(name, f"expected a number of seconds, 0 or more, got {value!r}")

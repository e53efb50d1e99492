"""Celery on Redis: tasks acknowledged late, results kept, every write on disk before it is acknowledged."""

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from brink.bench.queue.figures import Pickup, Throughput
from brink.bench.temporary.coordinator import DidNotStart, Process

NAME = "Celery, Redis"
SETTINGS = (
    "appendonly yes, appendfsync always; task_acks_late, results kept, prefetch of 8 a process, prefork pool"
)
PREFETCH = 8
SAMPLES = 200
_PATIENCE_S = 120.0
_APP = "brink.bench.queue.celery_app"


class CeleryQueue:
    """Celery on one Redis."""

    name = NAME

    def __init__(self, url: str, folder: Path) -> None:
        self._folder = folder
        self._environment = {"BENCH_REDIS_URL": url}

        os.environ.update(self._environment)
        from brink.bench.queue.celery_app import app, nothing

        self._app: Any = app
        self._nothing: Any = nothing

    def throughput(self, workers: int, jobs: int) -> Throughput:
        """Measure how many tasks that do nothing go through a pool of processes."""
        results = [self._nothing.delay() for _ in range(jobs)]
        with self._workers(workers):
            times = self._times(results)
        # The first are done while the pool's last processes start.
        return Throughput(
            system=NAME, workers=workers, batch=PREFETCH, jobs=jobs, seconds=max(times) - min(times)
        )

    def pickup(self) -> list[Pickup]:
        """Measure how soon an idle worker runs a task that is sent."""
        times_ms = []
        with self._workers(1):
            self._times([self._nothing.delay()])
            for _ in range(SAMPLES):
                time.sleep(0.05)  # the worker is idle
                began = time.time()
                times_ms.append(1e3 * (self._times([self._nothing.delay()])[0] - began))
        return [Pickup(system=NAME, since="sent", times_ms=tuple(times_ms))]

    @contextlib.contextmanager
    def _workers(self, count: int) -> Iterator[None]:
        command = [
            sys.executable, "-m", "celery", "-A", _APP, "worker", "--pool", "prefork", "--concurrency", str(count),
            "--without-gossip", "--without-mingle", "--without-heartbeat", "--loglevel", "WARNING",
        ]  # fmt: skip
        process = Process(command, self._folder / "celery.log", self._environment)
        process.start()
        try:
            yield
            if not process.alive:
                raise DidNotStart(f"Celery's worker ended: {process.said}")
        finally:
            process.stop()

    def _times(self, results: list[Any]) -> list[float]:
        """Return when each task ran; reads the stored results all at once, so as not to disturb."""
        client = self._app.backend.client
        keys = [self._app.backend.get_key_for_task(result.id) for result in results]
        deadline = time.monotonic() + _PATIENCE_S
        while any(found is None for found in client.mget(keys[-64:])) or None in (found := client.mget(keys)):
            if time.monotonic() > deadline:
                raise DidNotStart("Celery's workers do not come to an end")
            time.sleep(0.02 if len(keys) == 1 else 0.2)
        return [json.loads(text)["result"] for text in found]

"""procrastinate on Postgres: a job a row, one fetched at a time, finished in place."""

import asyncio
import contextlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg

from brink.bench.queue.figures import Pickup, Throughput
from brink.bench.temporary.coordinator import DidNotStart, Process

NAME = "procrastinate, Postgres"
SETTINGS = "fsync, synchronous_commit and full_page_writes on; one worker process with that many coroutines"
SAMPLES = 200
_PATIENCE_S = 180.0
_APP = "brink.bench.queue.procrastinate_app.app"
_TIMES = """
    SELECT min(at) FILTER (WHERE type = 'started'), max(at) FILTER (WHERE type = 'succeeded'),
           count(*) FILTER (WHERE type = 'succeeded')
    FROM procrastinate_events
"""


class ProcrastinateQueue:
    """procrastinate on one database."""

    name = NAME

    def __init__(self, url: str, folder: Path) -> None:

        self._url = url
        self._folder = folder
        self._environment = {"BENCH_POSTGRES_URL": url}
        os.environ.update(self._environment)
        from brink.bench.queue.procrastinate_app import app, nothing

        self._app: Any = app
        self._nothing: Any = nothing
        asyncio.run(self._prepare())

    def throughput(self, workers: int, jobs: int) -> Throughput:
        """Measure how many tasks that do nothing go through so many coroutines."""
        asyncio.run(self._defer(jobs))
        with self._workers(workers):
            first, last = self._await_done(jobs)
        return Throughput(system=NAME, workers=workers, batch=1, jobs=jobs, seconds=last - first)

    def pickup(self) -> list[Pickup]:
        """Measure how soon an idle worker runs a task that is deferred."""
        with self._workers(1):
            times_ms = asyncio.run(self._picked_up())
        return [Pickup(system=NAME, since="sent", times_ms=tuple(times_ms))]

    async def _prepare(self) -> None:
        async with self._app.open_async():
            await self._app.schema_manager.apply_schema_async()

    async def _defer(self, jobs: int) -> None:
        self._execute("TRUNCATE procrastinate_jobs, procrastinate_events CASCADE")
        async with self._app.open_async():
            await self._nothing.batch_defer_async(*({"number": number} for number in range(jobs)))

    async def _picked_up(self) -> list[float]:
        times_ms = []
        self._execute("TRUNCATE procrastinate_jobs, procrastinate_events CASCADE")
        async with self._app.open_async():
            for number in range(SAMPLES + 1):
                await asyncio.sleep(0.05)  # the worker is idle
                began = time.time()
                job = await self._nothing.defer_async(number=number)
                started = await self._started(job)
                times_ms.append(1e3 * (started - began))
        return times_ms[1:]

    async def _started(self, job: int) -> float:
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline:
            await asyncio.sleep(0.02)
            query = f"SELECT at FROM procrastinate_events WHERE type = 'started' AND job_id = {int(job)}"
            if rows := self._execute(query):
                return float(rows[0][0].timestamp())
        raise DidNotStart("procrastinate's worker does not start a job")

    @contextlib.contextmanager
    def _workers(self, count: int) -> Iterator[None]:
        command = [
            sys.executable, "-m", "procrastinate", "--app", _APP, "worker", "--concurrency", str(count),
            "--queues", "bench",
        ]  # fmt: skip
        process = Process(command, self._folder / "procrastinate.log", self._environment)
        process.start()
        try:
            yield
            if not process.alive:
                raise DidNotStart(f"procrastinate's worker ended: {process.said}")
        finally:
            process.stop()

    def _await_done(self, jobs: int) -> tuple[float, float]:
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline:
            time.sleep(0.2)
            first, last, done = self._execute(_TIMES)[0]
            if done >= jobs:
                return first.timestamp(), last.timestamp()
        raise DidNotStart("procrastinate's workers do not come to an end")

    def _execute(self, statement: str) -> list[Any]:
        with psycopg.connect(self._url, autocommit=True) as connection:
            cursor = connection.execute(statement.encode())
            return cursor.fetchall() if cursor.description else []

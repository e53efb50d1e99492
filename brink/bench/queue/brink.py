"""Brink's own queue: a coordinator in a process of its own, and clients that do nothing with their jobs."""

import asyncio
import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
from sqlalchemy import func, select

from brink.bench.load.campaign import load_campaign
from brink.bench.load.client import LoadClient
from brink.bench.load.problem import MODULE
from brink.bench.queue.figures import Pickup, Throughput, percentile
from brink.bench.temporary.coordinator import CoordinatorProcess, DidNotStart, Process, worker_command
from brink.server.db.engine import open_engines
from brink.server.db.models import JobRow
from brink.server.states import JobStatus
from brink.sim.catalogue import PLUGINS_VARIABLE

CAMPAIGN_JOBS = 5000
"""Jobs a campaign: its last step, which is not measured here, grows with the square."""
SAMPLES = 200
_PATIENCE_S = 120.0
_ENVIRONMENT = {PLUGINS_VARIABLE: MODULE}


class BrinkQueue:
    """A coordinator with one database, on which measurements follow one another.

    Attributes:
        name: Of this queue in tables.
    """

    def __init__(self, name: str, database: str, folder: Path) -> None:
        self.name = name
        self._database = database
        self._folder = folder
        self._coordinator = CoordinatorProcess(database, folder / "coordinator.log", _ENVIRONMENT)

    def __enter__(self) -> "BrinkQueue":
        self._coordinator.start_ready()
        return self

    def __exit__(self, *_: object) -> None:
        self._coordinator.stop()

    def throughput(self, workers: int, batch: int, jobs: int) -> Throughput:
        """Measure how many jobs go through clients that report a batch and lease the next in one request."""
        with self._campaigns(jobs):
            return asyncio.run(self._drain(workers, batch, jobs))

    def worker_throughput(self, workers: int, jobs: int) -> Throughput:
        """Measure how many jobs go through real workers with simulation processes, from when they are stored."""
        processes = [
            Process(worker_command(self._coordinator.url), self._folder / "worker.log", _ENVIRONMENT)
            for _ in range(workers)
        ]
        with contextlib.ExitStack() as stack:
            for process in processes:
                process.start()
                stack.callback(process.kill)
            self._await_workers(workers)
            with self._campaigns(jobs) as campaigns:
                seconds = self._await_done(campaigns, jobs)
        return Throughput(
            system=f"{self.name}, its workers", workers=workers, batch=128, jobs=jobs, seconds=seconds
        )

    def pickup(self) -> list[Pickup]:
        """Measure how soon a client that waits for work has a job of a campaign that is submitted."""
        posted, stored = asyncio.run(self._picked_up())
        return [
            Pickup(system=self.name, since="stored", times_ms=tuple(stored)),
            Pickup(system=self.name, since="submitted", times_ms=tuple(posted)),
        ]

    async def _drain(self, workers: int, batch: int, jobs: int) -> Throughput:
        left = jobs
        ended = 0.0

        async def work(client: LoadClient) -> None:
            nonlocal left, ended
            held = await client.lease()
            while held and left > 0:
                done, held = held, await client.report(held)
                left -= len(done)
                ended = time.perf_counter()

        async with contextlib.AsyncExitStack() as stack:
            clients = [
                await stack.enter_async_context(
                    LoadClient(self._coordinator.url, f"load-{index}", max_jobs=batch, wait_s=0.0)
                )
                for index in range(workers)
            ]
            began = time.perf_counter()
            await asyncio.gather(*(work(client) for client in clients))
        times_ms = [1e3 * taken_s for client in clients for taken_s in client.times_s]
        return Throughput(
            system=self.name, workers=workers, batch=batch, jobs=jobs - left, seconds=ended - began,
            lease_p50_ms=percentile(times_ms, 50), lease_p99_ms=percentile(times_ms, 99),
        )  # fmt: skip

    async def _picked_up(self) -> tuple[list[float], list[float]]:
        engines = open_engines(self._database)
        posted: list[float] = []
        stored: list[float] = []
        try:
            async with (
                LoadClient(self._coordinator.url, "idle", max_jobs=1) as client,
                httpx.AsyncClient(base_url=self._coordinator.url, timeout=60.0) as http,
            ):
                waiting = asyncio.create_task(client.lease())
                for index in range(SAMPLES):
                    await asyncio.sleep(0.05)  # the worker is idle, and waits
                    began = time.time()
                    submitted = asyncio.create_task(
                        http.post("/api/v1/campaigns", json=load_campaign(1, generation=1, seed=index))
                    )
                    jobs = await waiting
                    had = time.time()
                    (await submitted).raise_for_status()
                    with engines.reader.connect() as connection:
                        created = select(JobRow.created_at).where(JobRow.id == jobs[0]["job"])
                        at = connection.execute(created).scalar_one().timestamp()
                    posted.append(1e3 * (had - began))
                    stored.append(1e3 * (had - at))
                    waiting = asyncio.create_task(client.report(jobs))
                waiting.cancel()
        finally:
            engines.dispose()
        return posted, stored

    @contextlib.contextmanager
    def _campaigns(self, jobs: int) -> Iterator[list[str]]:
        ids = []
        for index in range(-(-jobs // CAMPAIGN_JOBS)):
            size = min(CAMPAIGN_JOBS, jobs - index * CAMPAIGN_JOBS)
            ids.append(self._submit(load_campaign(size, generation=size, seed=index)))
        try:
            yield ids
        finally:
            for campaign in ids:
                httpx.post(f"{self._coordinator.url}/api/v1/campaigns/{campaign}/cancel")

    def _submit(self, body: dict[str, Any]) -> str:
        response = httpx.post(f"{self._coordinator.url}/api/v1/campaigns", json=body, timeout=_PATIENCE_S)
        response.raise_for_status()
        return str(response.json()["id"])

    def _await_workers(self, count: int) -> None:
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            seen = httpx.get(f"{self._coordinator.url}/api/v1/workers").json()
            if sum(worker["live"] and worker["host"] != "bench" for worker in seen) >= count:
                return
            if time.monotonic() > deadline:
                raise DidNotStart("the workers did not come up")
            time.sleep(0.1)

    def _await_done(self, campaigns: list[str], jobs: int) -> float:
        engines = open_engines(self._database)
        of_these = JobRow.campaign_id.in_(campaigns)
        deadline = time.monotonic() + _PATIENCE_S
        try:
            while time.monotonic() < deadline:
                with engines.reader.connect() as connection:
                    done = select(func.count()).where(of_these, JobRow.status == JobStatus.DONE)
                    if connection.execute(done).scalar_one() >= jobs:
                        times = select(func.min(JobRow.created_at), func.max(JobRow.finished_at)).where(
                            of_these
                        )
                        first, last = connection.execute(times).one()
                        if first is not None and last is not None:
                            return float((last - first).total_seconds())
                time.sleep(0.2)
        finally:
            engines.dispose()
        raise DidNotStart("the workers do not come to an end")

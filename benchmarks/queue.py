"""Throughput and pick-up times of Brink's job queue, compared with Celery on Redis and procrastinate on Postgres.

All queues run on the same machine and are durable: an acknowledged job survives a power cut. Celery and procrastinate
are measured where they are installed.
"""

import asyncio
import contextlib
import json
import math
import os
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import httpx
import psycopg
from sqlalchemy import func, select

from benchmarks.load import MODULE, LoadClient, load_campaign
from benchmarks.measurement import Progress, counted, percentile
from benchmarks.processes import (
    CoordinatorProcess,
    MeasurementFailed,
    Process,
    plugin_environment,
    running_workers,
)
from benchmarks.servers import DURABLE_POSTGRES, NoRedis, find_redis, temporary_postgres, temporary_redis
from brink.extras import install_command
from brink.server.db.engine import open_engines
from brink.server.db.models import JobRow
from brink.server.states import JobStatus

SQLITE, POSTGRES = "Brink, SQLite", "Brink, Postgres"
PROCRASTINATE, CELERY = "procrastinate, Postgres", "Celery, Redis"
WORKERS = (1, 4, 16)
BATCHES = (1, 8, 32)
TARGET_BATCH = 8
TARGET_RATIO = 2.0
TARGET_PICKUP_MS = 10.0
CAMPAIGN_JOBS = 5000
"""Jobs per campaign. The time of the last generation step, not measured here, grows quadratically with them."""
CELERY_PREFETCH = 8
PICKUP_SAMPLES = 200
PICKUP_WARM_UP = 5
"""Jobs that run first and are not counted, because a new process is still loading and preparing things."""
SETTINGS = {
    SQLITE: "journal_mode WAL, synchronous FULL",
    POSTGRES: ", ".join(f"{name} {value}" for name, value in DURABLE_POSTGRES.items()),
    PROCRASTINATE: "fsync, synchronous_commit and full_page_writes on; one worker process with that many coroutines",
    CELERY: "appendonly yes, appendfsync always; task_acks_late, results kept, prefetch 8 per process, prefork pool",
}
"""Settings that make each system durable."""
_TIMEOUT_S = 180.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Throughput:
    """Throughput of no-op jobs.

    Attributes:
        system: Queue and its database.
        workers: Number of workers.
        batch: Maximum number of jobs per request; for the other systems, number of jobs that a worker prefetches.
        jobs: Number of jobs.
        seconds: Time from the first start to the last stored outcome.
        lease_p50_ms: Median time of a request that reports and is granted jobs; None without such requests.
        lease_p99_ms: The 99th percentile of these times.
    """

    system: str
    workers: int
    batch: int
    jobs: int
    seconds: float
    lease_p50_ms: float | None = None
    lease_p99_ms: float | None = None

    @property
    def per_s(self) -> float:
        """Jobs per second."""
        return self.jobs / self.seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class Pickup:
    """Times until an idle worker starts a new job.

    Attributes:
        system: Queue and its database.
        since: Event from which the time is measured.
        times_ms: Time for each job.
    """

    system: str
    since: str
    times_ms: tuple[float, ...]

    @property
    def p50_ms(self) -> float:
        """Median."""
        return percentile(self.times_ms, 50)

    @property
    def p99_ms(self) -> float:
        """99th percentile."""
        return percentile(self.times_ms, 99)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Measurements of all queues.

    Attributes:
        throughput: Throughput of each system by workers and batch size.
        pickups: Pick-up times of each system.
        settings: Settings that make each system durable.
        left_out: Reason for each system that was not measured.
    """

    throughput: tuple[Throughput, ...]
    pickups: tuple[Pickup, ...]
    settings: dict[str, str]
    left_out: dict[str, str]

    def ratios(self) -> list[tuple[Throughput, Throughput, float]]:
        """Return Brink's throughput at the target batch size, that of the best other system, and their ratio.

        There is one entry for each of Brink's databases and each number of workers.
        """
        others = [one for one in self.throughput if not one.system.startswith("Brink")]
        found = []
        for ours in self.throughput:
            rivals = [other for other in others if other.workers == ours.workers]
            if ours.system in (SQLITE, POSTGRES) and ours.batch == TARGET_BATCH and rivals:
                best = max(rivals, key=lambda other: other.per_s)
                found.append((ours, best, ours.per_s / best.per_s))
        return found


_Measured: TypeAlias = tuple[list[Throughput], list[Pickup]]


def compare_queues(
    progress: Progress, *, jobs: int = 4_000, rounds: int = 3, quick: bool = False
) -> Comparison:
    """Measure Brink on SQLite and Postgres, and Celery and procrastinate where they are installed.

    Every round measures all systems one after another, so that a slow minute of the machine affects all of them. The
    medians over the rounds are kept.

    Args:
        progress: Progress callback.
        jobs: Brink's jobs at batch sizes above 1; all other measurements use a third of them.
        rounds: Number of rounds.
        quick: Measure only one batch size and one number of workers.

    Raises:
        NoPostgres: Postgres is not installed or did not start.
        MeasurementFailed: A process did not start, or did not complete its jobs.
    """
    left_out = {name: reason for name, reason in _missing().items() if reason}
    throughput: list[Throughput] = []
    pickups: list[Pickup] = []
    plan = _Plan(
        workers=(4,) if quick else WORKERS,
        batches=(TARGET_BATCH,) if quick else BATCHES,
        jobs=jobs,
        quick=quick,
    )
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="brink-bench-")))
        server = stack.enter_context(temporary_postgres())
        measures: list[Callable[[int], _Measured]] = [
            lambda turn: _measure_brink(SQLITE, f"sqlite:///{folder}/queue-{turn}.db", folder, plan),
            lambda turn: _measure_brink(POSTGRES, server.database(f"brink_{turn}"), folder, plan),
        ]
        others: list[_OtherQueue] = []
        if PROCRASTINATE not in left_out:
            others.append(_ProcrastinateQueue(server.database("procrastinate"), folder))
        if CELERY not in left_out:
            others.append(_CeleryQueue(stack.enter_context(temporary_redis()), folder))
        measures += [partial(_measure_other, queue, plan) for queue in others]
        for place in counted(progress, "measurements", rounds * len(measures)):
            turn, which = divmod(place, len(measures))
            os.sync()  # so that writes of the previous system do not delay the commits of this one
            rates, times = measures[which](turn)
            throughput += rates
            pickups += times
    return Comparison(
        throughput=tuple(_medians(throughput)),
        pickups=tuple(_merged(pickups)),
        left_out=left_out,
        settings={name: setting for name, setting in SETTINGS.items() if name not in left_out},
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """The measurements to take of each system."""

    workers: tuple[int, ...]
    batches: tuple[int, ...]
    jobs: int
    quick: bool

    @property
    def few(self) -> int:
        """Number of jobs for measurements in which jobs are slow."""
        return max(200, self.jobs // 3)


def _measure_brink(system: str, database: str, folder: Path, plan: _Plan) -> _Measured:
    throughput: list[Throughput] = []
    with _BrinkQueue(system, database, folder) as queue:
        pickups = queue.pickup()
        for workers in plan.workers:
            throughput += [
                queue.throughput(workers, batch, plan.jobs if batch > 1 else plan.few)
                for batch in plan.batches
            ]
            if not plan.quick:
                throughput.append(queue.worker_throughput(workers, plan.few))
    return throughput, pickups


def _measure_other(queue: "_OtherQueue", plan: _Plan, _: int) -> _Measured:
    return [queue.throughput(workers, plan.few) for workers in plan.workers], [queue.pickup()]


def _missing() -> dict[str, str]:
    """Return why the other systems cannot be measured; empty if they can."""
    reasons = {
        PROCRASTINATE: "" if find_spec("procrastinate") else install_command("bench"),
        CELERY: "" if find_spec("celery") else install_command("bench"),
    }
    if not reasons[CELERY]:
        try:
            find_redis()
        except NoRedis as error:
            reasons[CELERY] = str(error)
    return reasons


def _medians(measured: Iterable[Throughput]) -> list[Throughput]:
    """Return, of each repeated measurement, the repetition with the median rate."""
    found: dict[tuple[str, int, int], list[Throughput]] = {}
    for one in measured:
        found.setdefault((one.system, one.workers, one.batch), []).append(one)
    return [sorted(same, key=lambda one: one.per_s)[len(same) // 2] for same in found.values()]


def _merged(measured: Iterable[Pickup]) -> list[Pickup]:
    """Merge the repetitions of each measurement into one."""
    found: dict[tuple[str, str], tuple[float, ...]] = {}
    for one in measured:
        found[one.system, one.since] = found.get((one.system, one.since), ()) + one.times_ms
    return [Pickup(system=system, since=since, times_ms=times) for (system, since), times in found.items()]


class _BrinkQueue:
    """A coordinator in a separate process, and clients whose jobs do nothing."""

    def __init__(self, name: str, database: str, folder: Path) -> None:
        self._name = name
        self._database = database
        self._folder = folder
        self._coordinator = CoordinatorProcess(
            database, folder / "coordinator.log", plugin_environment(MODULE)
        )

    def __enter__(self) -> "_BrinkQueue":
        self._coordinator.start_ready()
        return self

    def __exit__(self, *_: object) -> None:
        self._coordinator.stop()

    def throughput(self, workers: int, batch: int, jobs: int) -> Throughput:
        """Measure the throughput of clients that report a batch and lease the next one in one request.

        Args:
            workers: Number of clients.
            batch: Jobs per request.
            jobs: Number of jobs.
        """
        with self._campaigns(jobs):
            return asyncio.run(self._drain(workers, batch, jobs))

    def worker_throughput(self, workers: int, jobs: int) -> Throughput:
        """Measure the throughput of real workers with simulation processes."""
        with running_workers(self._coordinator, workers, self._folder, MODULE):
            self._await_workers(workers)
            with self._campaigns(jobs) as campaigns:
                seconds = self._await_done(campaigns, jobs)
        return Throughput(
            system=f"{self._name}, its workers", workers=workers, batch=128, jobs=jobs, seconds=seconds
        )

    def pickup(self) -> list[Pickup]:
        """Measure how soon an idle client gets a job of a new campaign."""
        submitted, stored = asyncio.run(self._pickup_times())
        return [
            Pickup(system=self._name, since="stored", times_ms=tuple(stored)),
            Pickup(system=self._name, since="submitted", times_ms=tuple(submitted)),
        ]

    async def _drain(self, workers: int, batch: int, jobs: int) -> Throughput:
        left, start, end = jobs, math.inf, 0.0

        async def work(client: LoadClient) -> None:
            nonlocal left, start, end
            held: list[dict[str, Any]] = []
            while left > 0:
                if held:
                    done, held = held, await client.report(held)
                    left -= len(done)
                    end = time.perf_counter()
                    continue
                asked = time.perf_counter()
                if held := await client.lease():
                    start = min(start, asked)
                else:
                    await asyncio.sleep(
                        0.01
                    )  # until the campaign's jobs are queued, or others have reported theirs

        async with contextlib.AsyncExitStack() as stack:
            clients = [
                await stack.enter_async_context(
                    LoadClient(self._coordinator.url, f"load-{index}", max_jobs=batch, wait_s=0.0)
                )
                for index in range(workers)
            ]
            try:
                await asyncio.wait_for(asyncio.gather(*(work(client) for client in clients)), _TIMEOUT_S)
            except TimeoutError as error:
                raise MeasurementFailed(f"{left} of {jobs} jobs were left after {_TIMEOUT_S:g} s") from error
        times_ms = [1e3 * taken_s for client in clients for taken_s in client.times_s]
        return Throughput(
            system=self._name,
            workers=workers,
            batch=batch,
            jobs=jobs,
            seconds=end - start,
            lease_p50_ms=percentile(times_ms, 50) if times_ms else None,
            lease_p99_ms=percentile(times_ms, 99) if times_ms else None,
        )

    async def _pickup_times(self) -> tuple[list[float], list[float]]:
        """Return the times in ms from submitting a campaign, and from storing its job, until a client has the job."""
        engines = open_engines(self._database)
        submitted: list[float] = []
        stored: list[float] = []
        try:
            async with (
                LoadClient(self._coordinator.url, "idle", max_jobs=1) as client,
                httpx.AsyncClient(base_url=self._coordinator.url, timeout=60.0) as http,
            ):
                waiting = asyncio.create_task(client.lease())
                for index in range(PICKUP_WARM_UP + PICKUP_SAMPLES):
                    await asyncio.sleep(0.05)  # until the client is idle and its request waits
                    start = time.time()
                    reply = asyncio.create_task(
                        http.post("/api/v1/campaigns", json=load_campaign(1, generation=1, seed=index))
                    )
                    jobs = await waiting
                    end = time.time()
                    (await reply).raise_for_status()
                    with engines.reader.connect() as connection:
                        created = select(JobRow.created_at).where(JobRow.id == jobs[0]["job"])
                        created_at = connection.execute(created).scalar_one().timestamp()
                    submitted.append(1e3 * (end - start))
                    stored.append(1e3 * (end - created_at))
                    waiting = asyncio.create_task(client.report(jobs))
                waiting.cancel()
        finally:
            engines.dispose()
        return submitted[PICKUP_WARM_UP:], stored[PICKUP_WARM_UP:]

    @contextlib.contextmanager
    def _campaigns(self, jobs: int) -> Iterator[list[str]]:
        ids = []
        for index in range(-(-jobs // CAMPAIGN_JOBS)):
            size = min(CAMPAIGN_JOBS, jobs - index * CAMPAIGN_JOBS)
            response = httpx.post(
                f"{self._coordinator.url}/api/v1/campaigns",
                json=load_campaign(size, generation=size, seed=index),
                timeout=_TIMEOUT_S,
            )
            ids.append(str(response.raise_for_status().json()["id"]))
        try:
            yield ids
            for campaign in ids:
                self._await_ended(campaign)
        finally:
            for campaign in ids:
                httpx.post(f"{self._coordinator.url}/api/v1/campaigns/{campaign}/cancel")

    def _await_ended(self, campaign: str) -> None:
        """Wait for the last step of a campaign, so that it does not slow down the next measurement."""
        deadline = time.monotonic() + _TIMEOUT_S
        url = f"{self._coordinator.url}/api/v1/campaigns/{campaign}/progress"
        while httpx.get(url, timeout=_TIMEOUT_S).json()["status"] == "running":
            if time.monotonic() > deadline:
                raise MeasurementFailed(f"campaign {campaign} did not end in {_TIMEOUT_S:g} s")
            time.sleep(0.1)

    def _await_workers(self, count: int) -> None:
        deadline = time.monotonic() + _TIMEOUT_S
        while True:
            workers = httpx.get(f"{self._coordinator.url}/api/v1/workers").json()
            if sum(worker["live"] and worker["host"] != "bench" for worker in workers) >= count:
                return
            if time.monotonic() > deadline:
                raise MeasurementFailed("the workers did not start")
            time.sleep(0.1)

    def _await_done(self, campaigns: list[str], jobs: int) -> float:
        """Wait until all jobs are done; return the time from the first insertion to the last result, in s."""
        engines = open_engines(self._database)
        of_these = JobRow.campaign_id.in_(campaigns)
        done = select(func.count()).where(of_these, JobRow.status == JobStatus.DONE)
        times = select(func.min(JobRow.created_at), func.max(JobRow.finished_at)).where(of_these)
        deadline = time.monotonic() + _TIMEOUT_S
        try:
            while time.monotonic() < deadline:
                with engines.reader.connect() as connection:
                    if connection.execute(done).scalar_one() >= jobs:
                        first, last = connection.execute(times).one()
                        if first is not None and last is not None:
                            return float((last - first).total_seconds())
                time.sleep(0.2)
        finally:
            engines.dispose()
        raise MeasurementFailed(f"the workers did not complete {jobs} jobs in {_TIMEOUT_S:g} s")


class _OtherQueue(ABC):
    """A queue to compare with Brink's: its worker process and a no-op task."""

    name: ClassVar[str]

    def __init__(self, folder: Path, url_variable: str, url: str) -> None:
        self._folder = folder
        self._environment = {url_variable: url}
        os.environ.update(self._environment)  # the application reads it on import

    @abstractmethod
    def throughput(self, workers: int, jobs: int) -> Throughput:
        """Measure the throughput of no-op tasks with the given number of workers."""

    @abstractmethod
    def pickup(self) -> Pickup:
        """Measure how soon an idle worker starts a new task."""

    @abstractmethod
    def _command(self, workers: int) -> list[str]:
        """Return the arguments of ``python -m`` that start the workers."""

    @contextlib.contextmanager
    def _workers(self, count: int) -> Iterator[None]:
        command = [sys.executable, "-m", *self._command(count)]
        process = Process(command, self._folder / f"{command[2]}.log", self._environment)
        process.start()
        try:
            yield
            if not process.alive:
                raise MeasurementFailed(f"the worker of {self.name} exited: {process.output}")
        finally:
            process.stop()


class _CeleryQueue(_OtherQueue):
    """Celery: late acknowledgements and stored results."""

    name = CELERY

    def __init__(self, url: str, folder: Path) -> None:
        super().__init__(folder, "BENCH_REDIS_URL", url)
        from benchmarks.celery_app import app, no_op

        self._app: Any = app
        self._no_op: Any = no_op

    def throughput(self, workers: int, jobs: int) -> Throughput:
        """Measure the throughput of no-op tasks with a pool of worker processes."""
        results = [self._no_op.delay() for _ in range(jobs)]
        with self._workers(workers):
            times = self._run_times(results)
        # The first tasks run while the last processes of the pool still start.
        seconds = max(times) - min(times)
        return Throughput(system=CELERY, workers=workers, batch=CELERY_PREFETCH, jobs=jobs, seconds=seconds)

    def pickup(self) -> Pickup:
        """Measure how soon an idle worker runs a new task."""
        times_ms = []
        with self._workers(1):
            for _ in range(PICKUP_WARM_UP + PICKUP_SAMPLES):
                time.sleep(0.05)  # until the worker is idle
                start = time.time()
                times_ms.append(1e3 * (self._run_times([self._no_op.delay()])[0] - start))
        return Pickup(system=CELERY, since="sent", times_ms=tuple(times_ms[PICKUP_WARM_UP:]))

    def _command(self, workers: int) -> list[str]:
        return [
            "celery",
            "-A",
            "benchmarks.celery_app",
            "worker",
            "--pool",
            "prefork",
            "--concurrency",
            str(workers),
            "--without-gossip",
            "--without-mingle",
            "--without-heartbeat",
            "--loglevel",
            "WARNING",
        ]

    def _run_times(self, results: list[Any]) -> list[float]:
        """Return the time at which each task ran, read in a single request so as not to disturb the workers."""
        client = self._app.backend.client
        keys = [self._app.backend.get_key_for_task(result.id) for result in results]
        deadline = time.monotonic() + _TIMEOUT_S
        while any(found is None for found in client.mget(keys[-64:])) or None in (found := client.mget(keys)):
            if time.monotonic() > deadline:
                raise MeasurementFailed(f"Celery did not complete {len(keys)} tasks in {_TIMEOUT_S:g} s")
            time.sleep(0.02 if len(keys) == 1 else 0.2)
        return [json.loads(text)["result"] for text in found]


class _ProcrastinateQueue(_OtherQueue):
    """procrastinate: a row per job, fetched one at a time and updated in place."""

    name = PROCRASTINATE

    def __init__(self, url: str, folder: Path) -> None:
        super().__init__(folder, "BENCH_POSTGRES_URL", url)
        from benchmarks.procrastinate_app import app, no_op

        self._url = url
        self._app: Any = app
        self._no_op: Any = no_op
        asyncio.run(self._create_schema())

    def throughput(self, workers: int, jobs: int) -> Throughput:
        """Measure the throughput of no-op tasks with the given number of coroutines."""
        asyncio.run(self._defer(jobs))
        with self._workers(workers):
            first, last = self._await_done(jobs)
        return Throughput(system=PROCRASTINATE, workers=workers, batch=1, jobs=jobs, seconds=last - first)

    def pickup(self) -> Pickup:
        """Measure how soon an idle worker runs a new task."""
        with self._workers(1):
            times_ms = asyncio.run(self._pickup_times())
        return Pickup(system=PROCRASTINATE, since="sent", times_ms=tuple(times_ms))

    def _command(self, workers: int) -> list[str]:
        return [
            "procrastinate",
            "--app",
            "benchmarks.procrastinate_app.app",
            "worker",
            "--concurrency",
            str(workers),
            "--queues",
            "bench",
        ]

    async def _create_schema(self) -> None:
        async with self._app.open_async():
            await self._app.schema_manager.apply_schema_async()

    def _clear(self) -> None:
        self._execute("TRUNCATE procrastinate_jobs, procrastinate_events CASCADE")

    async def _defer(self, jobs: int) -> None:
        self._clear()
        async with self._app.open_async():
            await self._no_op.batch_defer_async(*({"number": number} for number in range(jobs)))

    async def _pickup_times(self) -> list[float]:
        times_ms = []
        self._clear()
        async with self._app.open_async():
            for number in range(PICKUP_WARM_UP + PICKUP_SAMPLES):
                await asyncio.sleep(0.05)  # until the worker is idle
                start = time.time()
                job = await self._no_op.defer_async(number=number)
                times_ms.append(1e3 * (await self._start_time(job) - start))
        return times_ms[PICKUP_WARM_UP:]

    async def _start_time(self, job: int) -> float:
        deadline = time.monotonic() + _TIMEOUT_S
        while time.monotonic() < deadline:
            await asyncio.sleep(0.02)
            query = f"SELECT at FROM procrastinate_events WHERE type = 'started' AND job_id = {int(job)}"
            if rows := self._execute(query):
                return float(rows[0][0].timestamp())
        raise MeasurementFailed(f"procrastinate did not start a task in {_TIMEOUT_S:g} s")

    def _await_done(self, jobs: int) -> tuple[float, float]:
        """Wait until all tasks are done; return when the first one started and the last one succeeded."""
        deadline = time.monotonic() + _TIMEOUT_S
        while time.monotonic() < deadline:
            time.sleep(0.2)
            ((first, last, done),) = self._execute(
                "SELECT min(at) FILTER (WHERE type = 'started'), max(at) FILTER (WHERE type = 'succeeded'), "
                "count(*) FILTER (WHERE type = 'succeeded') FROM procrastinate_events"
            )
            if done >= jobs:
                return first.timestamp(), last.timestamp()
        raise MeasurementFailed(f"procrastinate did not complete {jobs} tasks in {_TIMEOUT_S:g} s")

    def _execute(self, statement: str) -> list[Any]:
        with psycopg.connect(self._url, autocommit=True) as connection:
            cursor = connection.execute(statement.encode())
            return cursor.fetchall() if cursor.description else []

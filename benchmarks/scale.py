"""Worker utilisation: simulated workers that share a coordinator, and a model of the scheduling alone.

The simulated workers are coroutines that lease a job, wait as long as its episode would take, and report it over real
HTTP. Episodes take log-normal times. They are scaled down, so overheads weigh more than they would in practice.
"""

import asyncio
import contextlib
import heapq
import itertools
import random
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx

from benchmarks.load import MODULE, LoadClient, load_campaign
from benchmarks.measurement import Progress, Row, counted, cpu_seconds, untargeted
from benchmarks.processes import CoordinatorProcess, plugin_environment, running_coordinator
from brink.search import surrogate
from brink.server.runtime.coordinator import allow_many_open_files

MEAN_S = 5.0
TARGET_WORKERS = 64
TARGET_SHARES = {TARGET_WORKERS: 0.95, 1000: 0.9}
"""Minimum utilisation by one campaign with generations in flight, up to these numbers of workers."""
TARGET_CPU_MS = 2.5
"""Most CPU time of the coordinator for each result of a busy campaign: half a core at 200 results a second."""
TARGET_GENERATION = 256
"""Jobs per generation. With 100, no scheduling order lets two campaigns fill 64 workers."""
GENERATIONS = (100, TARGET_GENERATION)
IN_FLIGHT = 8
JOBS_A_WORKER = 16
"""Jobs for each worker after which the model of candidates in flight stops, besides those in flight at the end."""
PROGRESS_TURNS = 10
"""Tenths of a second between two looks at the progress of campaigns."""
PAIRS = {"eps": 0.001, "d_th": 0.01}
"""Settings of the search for pairs: fine enough that the circle does not run out of pairs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """A configuration to measure.

    Attributes:
        workers: Number of workers.
        campaigns: Number of concurrent campaigns.
        generation: Jobs per generation of each campaign.
        in_flight: Generations of each campaign that are in flight at a time.
        algorithm: Search algorithm.
        coordinators: Coordinators that share the database and the workers.
        postgres: Whether the database is Postgres instead of SQLite.
        target: Whether the targets apply.
    """

    workers: int
    campaigns: int
    generation: int
    in_flight: int
    algorithm: str = "random@1"
    coordinators: int = 1
    postgres: bool = False
    target: bool = False

    @property
    def target_share(self) -> float | None:
        """Minimum utilisation; None without a target."""
        shares = (share for workers, share in TARGET_SHARES.items() if self.workers <= workers)
        return next(shares, None) if self.target else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Utilisation:
    """Measured utilisation of the workers.

    Attributes:
        setup: What was measured.
        jobs: Jobs that ran in the measured time.
        seconds: Measured time: from when all workers have work for the first time until the first campaign ends; with
            one campaign, until its last job is granted.
        busy_s: Total time in which workers ran episodes.
        coordinator_s: CPU time of the coordinators.
        writing_s: Time in which their writers were in a transaction.
        step_s: Mean time of a generation step, including its transaction.
    """

    setup: Setup
    jobs: int
    seconds: float
    busy_s: float
    coordinator_s: float
    writing_s: float
    step_s: float

    @property
    def share(self) -> float:
        """Fraction of their time that the workers spent running episodes."""
        return self.busy_s / (self.setup.workers * self.seconds)

    @property
    def cpu_ms(self) -> float:
        """CPU time of the coordinators for each job, in ms."""
        return 1e3 * self.coordinator_s / self.jobs

    @property
    def met(self) -> bool | None:
        """Whether the targets are met; None without a target. That for CPU time is for a thousand workers."""
        least = self.setup.target_share
        if least is None:
            return None
        return self.share >= least and (self.setup.workers <= TARGET_WORKERS or self.cpu_ms <= TARGET_CPU_MS)


def measure_utilisation(
    progress: Progress,
    *,
    workers: int | None = None,
    seconds: float = 30.0,
    scale: float = 0.2,
    postgres: bool = False,
    coordinators: int = 1,
) -> list[Utilisation]:
    """Measure the utilisation of 1 to 64 workers, or of a given number, by one campaign and by two.

    The search for pairs is left out if scikit-learn is not installed.

    Args:
        progress: Progress callback.
        workers: Number of workers in place of 1 to 64, for generations of one or four jobs per worker.
        seconds: Approximate duration of each measurement.
        scale: Fraction of its full time that an episode takes.
        postgres: Use Postgres instead of SQLite.
        coordinators: With more than one, measure one campaign with one coordinator on Postgres, with two, and so on.

    Raises:
        NoPostgres: Postgres is not installed or did not start.
        MeasurementFailed: A coordinator did not start.
    """
    if workers is None:
        setups = _small_setups()
    else:
        allow_many_open_files()
        setups = _large_setups(workers)
    if coordinators > 1:
        first = next(one for one in setups if one.target)
        setups = [
            replace(first, coordinators=count, postgres=True, target=False)
            for count in range(1, coordinators + 1)
        ]
    elif postgres:
        setups = [replace(one, postgres=True) for one in setups]
    if not surrogate.is_available():
        setups = [setup for setup in setups if setup.algorithm != "edge@1"]
    return [
        _measure(setups[place], seconds, scale) for place in counted(progress, "measurements", len(setups))
    ]


def _small_setups() -> list[Setup]:
    return [
        *(Setup(workers=n, campaigns=1, generation=100, in_flight=1) for n in (1, 4, 16, 64)),
        Setup(workers=64, campaigns=1, generation=100, in_flight=IN_FLIGHT, target=True),
        Setup(workers=64, campaigns=1, generation=64, in_flight=IN_FLIGHT, algorithm="edge@1"),
        Setup(workers=64, campaigns=1, generation=256, in_flight=1),
        Setup(workers=64, campaigns=2, generation=100, in_flight=1),
        Setup(workers=64, campaigns=2, generation=256, in_flight=1, target=True),
    ]


def _large_setups(workers: int) -> list[Setup]:
    return [
        Setup(workers=workers, campaigns=1, generation=workers, in_flight=IN_FLIGHT, target=True),
        Setup(workers=workers, campaigns=1, generation=4 * workers, in_flight=1),
        Setup(workers=workers, campaigns=2, generation=4 * workers, in_flight=1),
    ]


def _measure(setup: Setup, seconds: float, scale: float) -> Utilisation:
    jobs = setup.workers * seconds / (MEAN_S * scale * setup.campaigns)
    budget = setup.generation * max(3, round(jobs / setup.generation))
    bodies = [
        load_campaign(
            budget,
            generation=setup.generation,
            seed=seed,
            mean_s=MEAN_S,
            algorithm=setup.algorithm,
            in_flight=setup.in_flight,
            **(PAIRS if setup.algorithm == "edge@1" else {}),
        )
        for seed in range(setup.campaigns)
    ]
    with _running_coordinators(setup) as coordinators:
        return asyncio.run(_SimulatedWorkers(coordinators, setup, scale).work(bodies))


@contextlib.contextmanager
def _running_coordinators(setup: Setup) -> Iterator[list[CoordinatorProcess]]:
    """Run coordinators on a new database until the end of the block."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="brink-scale-")))
        if not setup.postgres:
            yield [stack.enter_context(running_coordinator(folder, MODULE))]
            return
        from benchmarks.servers import temporary_postgres  # needs an optional package

        database = stack.enter_context(temporary_postgres()).database("scale")
        coordinators = [
            CoordinatorProcess(database, folder / f"coordinator-{number}.log", plugin_environment(MODULE))
            for number in range(setup.coordinators)
        ]
        for coordinator in coordinators:
            stack.callback(coordinator.kill)
            coordinator.start_ready()
        yield coordinators


class _SimulatedWorkers:
    def __init__(self, coordinators: Sequence[CoordinatorProcess], setup: Setup, scale: float) -> None:
        self._coordinators = coordinators
        self._setup = setup
        self._granted = 0
        self._scale = scale
        self._spans: list[tuple[float, float]] = []
        self._busy: set[str] = set()
        self._all_busy = asyncio.Event()

    async def work(self, bodies: list[dict[str, Any]]) -> Utilisation:
        """Run campaigns until the first one ends, or all jobs are granted."""
        urls = [coordinator.url for coordinator in self._coordinators]
        async with (
            httpx.AsyncClient(base_url=f"{urls[0]}/api/v1", timeout=60.0) as api,
            contextlib.AsyncExitStack() as stack,
        ):
            clients = [
                await stack.enter_async_context(LoadClient(urls[number % len(urls)], f"worker-{number}"))
                for number in range(self._setup.workers)
            ]
            tasks = [
                asyncio.create_task(self._run(f"{number}", client)) for number, client in enumerate(clients)
            ]
            replies = [await api.post("/campaigns", json=body) for body in bodies]
            ids = [reply.raise_for_status().json()["id"] for reply in replies]
            all_busy = asyncio.create_task(self._all_busy.wait())
            done, _ = await asyncio.wait([all_busy, *tasks], return_when=asyncio.FIRST_COMPLETED)
            for task in done - {all_busy}:
                task.result()  # raises the task's exception
            before = await asyncio.to_thread(self._metrics)
            start, cpu_s = time.perf_counter(), self._cpu_seconds()
            jobs = sum(body["budget"]["simulations"] for body in bodies)
            for turn in itertools.count():
                # Progress is read as often as by the page of a campaign.
                ended = turn % PROGRESS_TURNS == 0 and await self._any_ended(api, ids)
                if ended or self._granted >= jobs:
                    break
                for task in tasks:
                    if task.done():
                        task.result()  # raises the task's exception
                await asyncio.sleep(0.1)
            end, cpu_s = time.perf_counter(), self._cpu_seconds() - cpu_s
            after = await asyncio.to_thread(self._metrics)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        # The campaigns overlap only until the last job of the campaign that ends first.
        within = [
            (max(began, start), min(ended, end))
            for began, ended in self._spans
            if ended > start and began < end
        ]
        grown = {name: after[name] - before.get(name, 0.0) for name in after}
        return Utilisation(
            setup=self._setup,
            coordinator_s=cpu_s,
            jobs=len(within),
            seconds=end - start,
            busy_s=sum(ended - began for began, ended in within),
            writing_s=grown["brink_commit_seconds_sum"],
            step_s=grown["brink_step_seconds_sum"] / grown["brink_step_seconds_count"],
        )

    def _metrics(self) -> Counter[str]:
        """Return the sums of the coordinators' metrics."""
        sums: Counter[str] = Counter()
        for coordinator in self._coordinators:
            sums.update(coordinator.metrics())
        return sums

    def _cpu_seconds(self) -> float:
        return sum(cpu_seconds(coordinator.pid or 0) for coordinator in self._coordinators)

    async def _run(self, name: str, client: LoadClient) -> None:
        jobs: list[dict[str, Any]] = []
        while True:
            jobs = await client.report(jobs) if jobs else await client.lease()
            self._granted += len(jobs)
            for job in jobs:
                self._busy.add(name)
                if len(self._busy) == self._setup.workers:
                    self._all_busy.set()
                start = time.perf_counter()
                place = len(self._spans)
                wait_s = self._scale * job["spec"]["scenario"]["wait_s"]
                self._spans.append((start, start + wait_s))
                await asyncio.sleep(wait_s)
                self._spans[place] = (start, time.perf_counter())

    async def _any_ended(self, api: httpx.AsyncClient, campaigns: list[str]) -> bool:
        for campaign in campaigns:
            reply = await api.get(f"/campaigns/{campaign}/progress?since=1000000")
            if reply.raise_for_status().json()["status"] != "running":
                return True
        return False


def model_turns(seeds: int = 20) -> Iterator[Row]:
    """Model `TARGET_WORKERS` workers without a coordinator: they lose time only at the ends of generations (ADR 32).

    Args:
        seeds: Number of runs whose mean is taken.
    """
    for generation, campaigns, generations in itertools.product(GENERATIONS, (1, 2, 4), (4, 32)):
        turns = {"job by job": 1, "four jobs per worker": 4 * TARGET_WORKERS}
        for name, turn in turns.items():
            yield untargeted(
                f"used, {campaigns} campaigns, generations of {generation}, turns of {name}",
                _mean_utilisation(generation, campaigns, turn, generations, seeds),
                f"{TARGET_WORKERS} workers, {generations} generations",
            )


def _mean_utilisation(generation: int, campaigns: int, turn: int, generations: int, seeds: int) -> float:
    runs = (
        _utilisation(generation, campaigns, turn, generations, random.Random(seed)) for seed in range(seeds)
    )
    return statistics.mean(runs)


def _utilisation(generation: int, campaigns: int, turn: int, generations: int, rng: random.Random) -> float:
    """Return the fraction of time that workers spend in episodes until the first campaign is complete.

    Args:
        generation: Jobs per generation of each campaign.
        campaigns: Number of campaigns.
        turn: Jobs that a campaign hands out before the next campaign's turn.
        generations: Number of generations.
        rng: Source of the episode times: log-normal with mean 1, sigma 0.5.
    """
    sigma = 0.5
    now, free, busy = 0.0, TARGET_WORKERS, 0.0
    running: list[tuple[float, float, int]] = []
    queued, unfinished, completed, served = ([value] * campaigns for value in (generation, generation, 0, 0))
    turns = list(range(campaigns))
    while max(completed) < generations:
        while free and (waiting := [one for one in range(campaigns) if queued[one]]):
            one = min(waiting, key=turns.__getitem__)
            queued[one] -= 1
            served[one] += 1
            if served[one] >= turn:
                turns[one], served[one] = max(turns) + 1, 0
            heapq.heappush(running, (now + rng.lognormvariate(-(sigma**2) / 2, sigma), now, one))
            free -= 1
        now, began, one = heapq.heappop(running)
        busy += now - began
        free += 1
        unfinished[one] -= 1
        if unfinished[one] == 0:
            completed[one] += 1
            queued[one] = unfinished[one] = generation
            turns[one], served[one] = max(turns) + 1, 0
    return (busy + sum(now - began for _, began, _ in running)) / (TARGET_WORKERS * now)


def model_in_flight(seeds: int = 5) -> Iterator[Row]:
    """Model how the utilisation by one campaign depends on its candidates in flight, without a coordinator.

    Args:
        seeds: Number of runs whose mean is taken.
    """
    for workers, a_worker, generations in itertools.product(
        (TARGET_WORKERS, 1000), (1, 2, 4, 8), (1, 2, IN_FLIGHT)
    ):
        size = a_worker * workers // generations
        shares = [
            _overlapping_utilisation(workers, size, generations, random.Random(seed)) for seed in range(seeds)
        ]
        yield untargeted(
            f"used, {workers} workers, {a_worker * workers} candidates in flight",
            statistics.mean(shares),
            f"in {generations} generations",
        )


def _overlapping_utilisation(workers: int, size: int, in_flight: int, rng: random.Random) -> float:
    """Return the fraction of time that workers spend in episodes until the last job is granted.

    Args:
        workers: Number of workers.
        size: Jobs per generation.
        in_flight: Generations in flight; the oldest one must be complete before another one is asked for.
        rng: Source of the episode times: log-normal with mean 1, sigma 0.5.
    """
    sigma = 0.5
    generations = in_flight + JOBS_A_WORKER * workers // size
    unfinished = [size] * generations
    running: list[tuple[float, float, int]] = []
    now, free, busy, granted, told = 0.0, workers, 0.0, 0, 0
    while granted < size * generations:
        queued = size * min(generations, told + in_flight) - granted
        for _ in range(min(free, queued)):
            end = now + rng.lognormvariate(-(sigma**2) / 2, sigma)
            heapq.heappush(running, (end, now, granted // size))
            granted, free = granted + 1, free - 1
        now, began, generation = heapq.heappop(running)
        busy, free = busy + now - began, free + 1
        unfinished[generation] -= 1
        while told < generations and not unfinished[told]:
            told += 1
    return (busy + sum(now - began for _, began, _ in running)) / (workers * now)

"""Simulated workers that share a coordinator: how much of their time they run episodes.

Workers are coroutines that lease, wait as long as the episode would take, and report, over real HTTP. Episodes take
log-normal times, scaled down, so that overheads weigh that much more here than they would.
"""

import asyncio
import contextlib
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from brink.bench.load.campaign import load_campaign
from brink.bench.load.client import LoadClient
from brink.bench.load.problem import MODULE
from brink.bench.processes import cpu_of
from brink.bench.telling import Told
from brink.bench.temporary.coordinator import CoordinatorProcess
from brink.server.runtime.coordinator import allow_many_open_files
from brink.sim.catalogue import PLUGINS_VARIABLE

WORKERS = (1, 4, 16, 64)
MEAN_S = 5.0
TARGET = 0.95
TARGET_WORKERS = 64
TARGET_CAMPAIGNS = 2
TARGET_GENERATION = 256
"""Of jobs. With 100, two campaigns cannot fill 64 workers, whoever deals: the longest episodes take too long."""
GENERATIONS = (100, TARGET_GENERATION)


@dataclass(frozen=True, slots=True, kw_only=True)
class Utilisation:
    """How well workers were used.

    Attributes:
        workers: How many.
        campaigns: Campaigns that ran side by side.
        generation: Jobs a generation of each.
        jobs: Jobs that ended in the time measured.
        seconds: That time: from when all have work for the first time until the first campaign ends.
        busy_s: Time in which workers ran episodes, of all together.
        coordinator_s: Processor time of the coordinator.
        writing_s: Time in which its writer was in a transaction.
        step_s: Mean time of a generation step, storing it included.
    """

    workers: int
    campaigns: int
    generation: int
    jobs: int
    seconds: float
    busy_s: float
    coordinator_s: float
    writing_s: float
    step_s: float

    @property
    def share(self) -> float:
        """Share of the workers' time in which they ran episodes."""
        return self.busy_s / (self.workers * self.seconds)

    @property
    def meets(self) -> bool | None:
        """Whether the target is met; None where there is none."""
        aimed_at = (TARGET_WORKERS, TARGET_CAMPAIGNS, TARGET_GENERATION)
        return self.share >= TARGET if (self.workers, self.campaigns, self.generation) == aimed_at else None


def measure_utilisation(
    told: Told, *, workers: int | None = None, seconds: float = 30.0, scale: float = 0.2
) -> list[Utilisation]:
    """Measure one, two and four campaigns with 1 to 64 workers, or one and two with so many.

    Args:
        told: Hears how far it is.
        workers: How many, in place of 1 to 64; generations are four jobs each then.
        seconds: About how long each measurement takes.
        scale: What of its time an episode takes here.

    Raises:
        DidNotStart: The coordinator did not come up.
    """
    plans = [
        (count, campaigns, generation)
        for count in WORKERS
        for generation in GENERATIONS
        for campaigns in (1, 2, 4)
        if count == TARGET_WORKERS or (campaigns == 1 and generation == GENERATIONS[0])
    ]
    if workers is not None:
        allow_many_open_files()
        plans = [(workers, campaigns, 4 * workers) for campaigns in (1, 2)]
    found = []
    for place, (count, campaigns, generation) in enumerate(plans):
        told("measurements", place, len(plans))
        jobs = count * seconds / (MEAN_S * scale * campaigns)
        budget = generation * max(3, round(jobs / generation))
        found.append(_measure(count, campaigns, generation, budget, scale))
    told("measurements", len(plans), len(plans))
    return found


def _measure(workers: int, campaigns: int, generation: int, budget: int, scale: float) -> Utilisation:
    with tempfile.TemporaryDirectory(prefix="brink-scale-") as name:
        folder = Path(name)
        environment = {PLUGINS_VARIABLE: MODULE}
        coordinator = CoordinatorProcess(
            f"sqlite:///{folder}/scale.db", folder / "coordinator.log", environment
        )
        try:
            coordinator.start_ready()
            bodies = [
                load_campaign(budget, generation=generation, seed=seed, mean_s=MEAN_S)
                for seed in range(campaigns)
            ]
            return asyncio.run(_Crew(coordinator, workers, scale).work(bodies, generation))
        finally:
            coordinator.kill()


class _Crew:
    def __init__(self, coordinator: CoordinatorProcess, workers: int, scale: float) -> None:
        self._coordinator = coordinator
        self._workers = workers
        self._scale = scale
        self._spans: list[tuple[float, float]] = []
        self._working: set[str] = set()
        self._all_work = asyncio.Event()

    async def work(self, bodies: list[dict[str, Any]], generation: int) -> Utilisation:
        url = self._coordinator.url
        async with (
            httpx.AsyncClient(base_url=f"{url}/api/v1", timeout=60.0) as api,
            contextlib.AsyncExitStack() as stack,
        ):
            clients = [
                await stack.enter_async_context(LoadClient(url, f"worker-{number}"))
                for number in range(self._workers)
            ]
            tasks = [
                asyncio.create_task(self._run(f"{number}", client)) for number, client in enumerate(clients)
            ]
            replies = [await api.post("/campaigns", json=body) for body in bodies]
            ids = [reply.raise_for_status().json()["id"] for reply in replies]
            every = asyncio.create_task(self._all_work.wait())
            done, _ = await asyncio.wait([every, *tasks], return_when=asyncio.FIRST_COMPLETED)
            for task in done - {every}:
                task.result()  # raises what went wrong
            before = await asyncio.to_thread(self._coordinator.measured)
            began, cpu_s = time.perf_counter(), cpu_of(self._coordinator.pid or 0)
            while not await self._any_ended(api, ids):
                for task in tasks:
                    if task.done():
                        task.result()  # raises what went wrong
                await asyncio.sleep(0.1)
            ended, cpu_s = time.perf_counter(), cpu_of(self._coordinator.pid or 0) - cpu_s
            after = await asyncio.to_thread(self._coordinator.measured)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        # What campaigns have in common ends with the last job of the one that ended first.
        within = [
            (max(start, began), min(end, ended))
            for start, end in self._spans
            if end > began and start < ended
        ]
        grown = {name: after[name] - before.get(name, 0.0) for name in after}
        return Utilisation(
            workers=self._workers, campaigns=len(bodies), generation=generation, coordinator_s=cpu_s,
            jobs=len(within), seconds=ended - began, busy_s=sum(end - start for start, end in within),
            writing_s=grown["brink_commit_seconds_sum"],
            step_s=grown["brink_step_seconds_sum"] / grown["brink_step_seconds_count"],
        )  # fmt: skip

    async def _run(self, name: str, client: LoadClient) -> None:
        jobs: list[dict[str, Any]] = []
        while True:
            jobs = await client.report(jobs) if jobs else await client.lease()
            for job in jobs:
                self._working.add(name)
                if len(self._working) == self._workers:
                    self._all_work.set()
                start = time.perf_counter()
                place = len(self._spans)
                wait_s = self._scale * job["spec"]["scenario"]["wait_s"]
                self._spans.append((start, start + wait_s))
                await asyncio.sleep(wait_s)
                self._spans[place] = (start, time.perf_counter())

    async def _any_ended(self, api: httpx.AsyncClient, campaigns: list[str]) -> bool:
        for campaign in campaigns:
            stands = (
                (await api.get(f"/campaigns/{campaign}/progress?since=1000000")).raise_for_status().json()
            )
            if stands["status"] != "running":
                return True
        return False

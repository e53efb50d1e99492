"""How fast a coordinator with a large archive answers, while a campaign runs."""

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
from brink.bench.queue.figures import percentile
from brink.bench.telling import Told
from brink.bench.temporary.coordinator import CoordinatorProcess, DidNotStart
from brink.sim.catalogue import PLUGINS_VARIABLE

GENERATION = 1000
RADIUS = 0.01
FILLERS = 2
FILLER_BATCH = 256
TARGET_MS = 200.0
WORKERS = 4
_PATIENCE_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """How long one kind of request took.

    Attributes:
        request: What was asked.
        first_ms: The first time, by a coordinator that had just been started.
        times_ms: All other times.
    """

    request: str
    first_ms: float
    times_ms: tuple[float, ...]

    @property
    def p50_ms(self) -> float:
        """Median."""
        return percentile(self.times_ms, 50)

    @property
    def p95_ms(self) -> float:
        """95th percentile."""
        return percentile(self.times_ms, 95)


@dataclass(frozen=True, slots=True, kw_only=True)
class LargeArchive:
    """What a large archive costs.

    Attributes:
        answers: How long requests took.
        bytes_a_solution: Of the database, with jobs and results.
        last_step_s: The last generation step: `GENERATION` new solutions beside all others.
    """

    answers: tuple[Answers, ...]
    bytes_a_solution: float
    last_step_s: float


def measure_archive(told: Told, *, solutions: int = 100_000, samples: int = 100) -> LargeArchive:
    """Fill an archive by simulations that take no time, start the coordinator again, and ask.

    Args:
        told: Hears how far it is.
        solutions: Of the archive.
        samples: Requests of each kind.

    Raises:
        DidNotStart: The coordinator did not come up, or does not come to an end.
    """
    with tempfile.TemporaryDirectory(prefix="brink-archive-") as name:
        folder = Path(name)
        database = f"sqlite:///{folder}/archive.db"
        coordinator = CoordinatorProcess(database, folder / "coordinator.log", {PLUGINS_VARIABLE: MODULE})
        try:
            coordinator.start_ready()
            campaign, last_step_s = asyncio.run(filled(coordinator, solutions, told))
            coordinator.stop()
            size = sum(file.stat().st_size for file in folder.glob("archive.db*"))
            coordinator.start_ready()
            answers = asyncio.run(_ask(coordinator, campaign, solutions, samples, told))
            return LargeArchive(
                answers=tuple(answers), bytes_a_solution=size / solutions, last_step_s=last_step_s
            )
        finally:
            coordinator.kill()


async def filled(coordinator: CoordinatorProcess, solutions: int, told: Told) -> tuple[str, float]:
    """Fill an archive; return its campaign, and how long its last generation step took in seconds.

    Raises:
        DidNotStart: It is not full within an hour.
    """
    async with httpx.AsyncClient(base_url=f"{coordinator.url}/api/v1", timeout=120.0) as api:
        campaign = await _submit(api, load_campaign(solutions, generation=GENERATION, seed=1, radius=RADIUS))
        async with _working(coordinator.url, FILLERS, batch=FILLER_BATCH):
            deadline = time.monotonic() + _PATIENCE_S
            while (stands := (await api.get(f"/campaigns/{campaign}/progress?since=1000000")).json())[
                "status"
            ] == "running":
                told("solutions", stands["evaluated"], solutions)
                if time.monotonic() > deadline:
                    raise DidNotStart("the archive is not full within an hour")
                await asyncio.sleep(1.0)
        last = f"/campaigns/{campaign}/progress?since={solutions // GENERATION - 1}"
        generations = (await api.get(last)).raise_for_status().json()["generations"]
    return campaign, float(generations[-1]["step_s"])


async def _ask(
    coordinator: CoordinatorProcess, campaign: str, solutions: int, samples: int, told: Told
) -> list[Answers]:
    requests = {
        "progress": f"/campaigns/{campaign}/progress",
        "progress since the last generation": f"/campaigns/{campaign}/progress?since={solutions // GENERATION - 1}",
        "boundary": f"/campaigns/{campaign}/boundary",
        "boundary at other thresholds": f"/campaigns/{campaign}/boundary?t_b=0.1&d_th=0.05",
        "solutions, first page": f"/campaigns/{campaign}/solutions?limit=100",
        "solutions, a page in the middle": f"/campaigns/{campaign}/solutions?limit=100&after={solutions // 2}",
        "solutions, unsafe and near the boundary": f"/campaigns/{campaign}/solutions?unsafe=true&max_fitness=0.2",
    }
    found = []
    async with (
        httpx.AsyncClient(base_url=f"{coordinator.url}/api/v1", timeout=120.0) as api,
        _working(coordinator.url, WORKERS, batch=1),
    ):
        await _submit(api, load_campaign(100_000, generation=60, seed=2, mean_s=0.2))
        for place, (name, path) in enumerate(requests.items()):
            told("requests", place, len(requests))
            times_ms = []
            for _ in range(samples + 1):
                began = time.perf_counter()
                (await api.get(path)).raise_for_status()
                times_ms.append(1e3 * (time.perf_counter() - began))
                await asyncio.sleep(0.05)
            found.append(Answers(request=name, first_ms=times_ms[0], times_ms=tuple(times_ms[1:])))
        told("requests", len(requests), len(requests))
    return found


@contextlib.asynccontextmanager
async def _working(url: str, count: int, *, batch: int) -> Any:
    """Have simulated workers work through whatever there is, until the end of the block."""

    async def work(client: LoadClient) -> None:
        held = await client.lease()
        while True:
            await asyncio.sleep(sum(job["spec"]["scenario"]["wait_s"] for job in held))
            held = await client.report(held) if held else await client.lease()

    async with contextlib.AsyncExitStack() as stack:
        clients = [
            await stack.enter_async_context(LoadClient(url, f"load-{number}", max_jobs=batch))
            for number in range(count)
        ]
        tasks = [asyncio.create_task(work(client)) for client in clients]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


async def _submit(api: httpx.AsyncClient, body: dict[str, Any]) -> str:
    return str((await api.post("/campaigns", json=body)).raise_for_status().json()["id"])

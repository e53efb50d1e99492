"""A coordinator under sustained use: response times with a large archive, and memory growth of all processes."""

import asyncio
import contextlib
import statistics
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from benchmarks.load import MODULE, LoadClient, load_campaign
from benchmarks.measurement import Progress, Row, children_of, memory_mib, percentile, under, untargeted
from benchmarks.processes import (
    CoordinatorProcess,
    MeasurementFailed,
    Process,
    running_coordinator,
    running_workers,
)

GENERATION = 1000
RADIUS = 0.01
FILLERS = 2
FILLER_BATCH = 256
FILL_TIMEOUT_S = 3600.0
BACKGROUND_WORKERS = 4
TARGET_MS = 200.0
SOAK_WORKERS = 2
SOAK_SIMULATIONS = 500
SAMPLE_INTERVAL_S = 10.0
WARM_UP_S = 300.0
"""Initial time of a soak that is left out, as caches fill and allocators settle; at most a quarter of the soak."""
TARGET_MIB_PER_HOUR = 10.0


def measure_archive(progress: Progress, *, solutions: int = 100_000, samples: int = 100) -> list[Row]:
    """Fill an archive with instantaneous simulations, restart the coordinator and measure response times.

    Args:
        progress: Progress callback.
        solutions: Size of the archive.
        samples: Number of requests of each kind.

    Raises:
        MeasurementFailed: The coordinator did not start, or the archive was not full in time.
    """
    with (
        tempfile.TemporaryDirectory(prefix="brink-archive-") as name,
        running_coordinator(Path(name), MODULE) as coordinator,
    ):
        campaign, last_step_s = asyncio.run(fill_archive(coordinator, solutions, progress))
        coordinator.stop()
        size = sum(file.stat().st_size for file in Path(name).glob("coordinator.db*"))
        coordinator.start_ready()
        rows = asyncio.run(_response_times(coordinator, campaign, solutions, samples, progress))
    return [
        *rows,
        untargeted("kB of the database a solution", size / solutions / 1000, "with its job and result"),
        untargeted("s of the last generation step", last_step_s, f"{GENERATION} new solutions"),
    ]


async def fill_archive(
    coordinator: CoordinatorProcess, solutions: int, progress: Progress
) -> tuple[str, float]:
    """Fill an archive by running a campaign with instantaneous simulations.

    Args:
        coordinator: A running coordinator.
        solutions: Number of solutions.
        progress: Progress callback.

    Returns:
        Id of the campaign, and the time of its last generation step in s.

    Raises:
        MeasurementFailed: The archive was not full in time.
    """
    async with httpx.AsyncClient(base_url=f"{coordinator.url}/api/v1", timeout=120.0) as api:
        campaign = await _submit(api, load_campaign(solutions, generation=GENERATION, seed=1, radius=RADIUS))
        path = f"/campaigns/{campaign}/progress"
        async with _load_clients(coordinator.url, FILLERS, batch=FILLER_BATCH):
            deadline = time.monotonic() + FILL_TIMEOUT_S
            while (found := (await api.get(f"{path}?since=1000000")).json())["status"] == "running":
                progress("solutions", found["evaluated"], solutions)
                if time.monotonic() > deadline:
                    raise MeasurementFailed(f"the archive was not full after {FILL_TIMEOUT_S / 60:g} minutes")
                await asyncio.sleep(1.0)
        last = await api.get(f"{path}?since={solutions // GENERATION - 1}")
        generations = last.raise_for_status().json()["generations"]
    return campaign, float(generations[-1]["step_s"])


async def _response_times(
    coordinator: CoordinatorProcess, campaign: str, solutions: int, samples: int, progress: Progress
) -> list[Row]:
    requests = {
        "progress": "progress",
        "progress since the last generation": f"progress?since={solutions // GENERATION - 1}",
        "boundary": "boundary",
        "boundary at other thresholds": "boundary?t_b=0.1&d_th=0.05",
        "solutions, first page": "solutions?limit=100",
        "solutions, a page in the middle": f"solutions?limit=100&after={solutions // 2}",
        "solutions, unsafe and near the boundary": "solutions?unsafe=true&max_fitness=0.2",
    }
    found = []
    async with (
        httpx.AsyncClient(base_url=f"{coordinator.url}/api/v1", timeout=120.0) as api,
        _load_clients(coordinator.url, BACKGROUND_WORKERS, batch=1),
    ):
        await _submit(api, load_campaign(100_000, generation=60, seed=2, mean_s=0.2))
        for place, (name, path) in enumerate(requests.items()):
            progress("requests", place, len(requests))
            times_ms = []
            for _ in range(samples + 1):
                start = time.perf_counter()
                (await api.get(f"/campaigns/{campaign}/{path}")).raise_for_status()
                times_ms.append(1e3 * (time.perf_counter() - start))
                await asyncio.sleep(0.05)
            note = f"first {times_ms[0]:.0f}, median {percentile(times_ms[1:], 50):.0f}"
            found.append(under(f"p95 ms, {name}", percentile(times_ms[1:], 95), TARGET_MS, note))
        progress("requests", len(requests), len(requests))
    return found


@contextlib.asynccontextmanager
async def _load_clients(url: str, count: int, *, batch: int) -> AsyncIterator[None]:
    """Run clients that play workers until the end of the block."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """Memory of one kind of process over time.

    Attributes:
        process: Kind of process.
        hours: Times of the samples since the start.
        mib: Resident memory at these times.
        campaigns: Campaigns that finished.
        simulations: Simulations that finished.
    """

    process: str
    hours: tuple[float, ...]
    mib: tuple[float, ...]
    campaigns: int
    simulations: int

    @property
    def slope(self) -> float:
        """Growth in MiB per hour: slope of the least-squares line after the warm-up."""
        start = min(WARM_UP_S / 3600, max(self.hours) / 4)
        samples = [(at, size) for at, size in zip(self.hours, self.mib, strict=True) if at >= start]
        return float(np.polyfit([at for at, _ in samples], [size for _, size in samples], 1)[0])


def measure_growth(progress: Progress, *, minutes: float = 60.0) -> list[Growth]:
    """Run one campaign after another and sample the memory of all processes.

    Args:
        progress: Progress callback.
        minutes: Duration.

    Raises:
        MeasurementFailed: A process did not start, or a campaign failed.
    """
    with tempfile.TemporaryDirectory(prefix="brink-soak-") as name:
        folder = Path(name)
        with (
            running_coordinator(folder) as coordinator,
            running_workers(coordinator, SOAK_WORKERS, folder) as workers,
        ):
            return asyncio.run(_soak(coordinator, workers, minutes, progress))


async def _soak(
    coordinator: CoordinatorProcess, workers: Sequence[Process], minutes: float, progress: Progress
) -> list[Growth]:
    start = time.monotonic()
    hours: list[float] = []
    sizes: dict[str, list[float]] = {"coordinator": [], "a worker": [], "its simulation process": []}
    finished = 0
    async with httpx.AsyncClient(base_url=f"{coordinator.url}/api/v1", timeout=60.0) as api:
        running = await _submit(api, _soak_campaign(finished))
        while (now := time.monotonic() - start) < 60 * minutes:
            progress("seconds", int(now), int(60 * minutes))
            await asyncio.sleep(SAMPLE_INTERVAL_S)
            status = (await api.get(f"/campaigns/{running}/progress?since=1000000")).json()["status"]
            if status not in ("running", "finished"):
                raise MeasurementFailed(f"campaign {running} is {status}")
            if status == "finished":
                finished += 1
                (await api.get(f"/campaigns/{running}/boundary")).raise_for_status()
                running = await _submit(api, _soak_campaign(finished))
            hours.append((time.monotonic() - start) / 3600)
            pids = [worker.pid or 0 for worker in workers]
            sizes["coordinator"].append(memory_mib(coordinator.pid or 0))
            sizes["a worker"].append(statistics.mean(map(memory_mib, pids)))
            sizes["its simulation process"].append(
                statistics.mean(memory_mib(child) for pid in pids for child in children_of(pid))
            )
    simulations = finished * SOAK_SIMULATIONS
    return [
        Growth(process=name, hours=tuple(hours), mib=tuple(mib), campaigns=finished, simulations=simulations)
        for name, mib in sizes.items()
    ]


def _soak_campaign(index: int) -> dict[str, Any]:
    return {
        "name": f"soak {index}",
        "problem": {"id": "urban-injected@1"},
        "seed": index,
        "algorithm": {"id": ("mlcshe@1", "ga@1", "random@1")[index % 3]},
        "budget": {"simulations": SOAK_SIMULATIONS},
    }

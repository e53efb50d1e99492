"""Memory of a coordinator and of a worker that run for long."""

import asyncio
import statistics
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from brink.bench.processes import children_of, memory_of
from brink.bench.telling import Told
from brink.bench.temporary.coordinator import CoordinatorProcess, DidNotStart, Process, worker_command

EVERY_S = 10.0
WARM_S = 300.0
"""Not counted at the beginning: caches fill, allocators settle. At most a quarter of the time."""
SIMULATIONS = 500
WORKERS = 2
TARGET_MIB_AN_HOUR = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """Memory of one process over time.

    Attributes:
        process: Which.
        hours: When it was measured, since the beginning.
        mib: Resident memory then.
        campaigns: Campaigns that ended meanwhile.
        simulations: Simulations that ended meanwhile.
    """

    process: str
    hours: tuple[float, ...]
    mib: tuple[float, ...]
    campaigns: int
    simulations: int

    @property
    def slope(self) -> float:
        """Growth in MiB an hour: of the line through the measurements after the warm-up."""
        start = min(WARM_S / 3600, max(self.hours) / 4)
        kept = [(at, size) for at, size in zip(self.hours, self.mib, strict=True) if at >= start]
        return float(np.polyfit([at for at, _ in kept], [size for _, size in kept], 1)[0])


def soak(told: Told, *, minutes: float = 60.0) -> list[Growth]:
    """Run one campaign after the other, and watch memory.

    Args:
        told: Hears how far it is.
        minutes: How long.

    Raises:
        DidNotStart: A process did not come up, or a campaign fails.
    """
    with tempfile.TemporaryDirectory(prefix="brink-soak-") as name:
        folder = Path(name)
        coordinator = CoordinatorProcess(f"sqlite:///{folder}/soak.db", folder / "coordinator.log", {})
        workers = [
            Process(worker_command(coordinator.url), folder / f"worker-{number}.log", {})
            for number in range(WORKERS)
        ]
        try:
            coordinator.start_ready()
            for worker in workers:
                worker.start()
            return asyncio.run(_watch(coordinator, workers, minutes, told))
        finally:
            for process in (*workers, coordinator):
                process.kill()


async def _watch(
    coordinator: CoordinatorProcess, workers: Sequence[Process], minutes: float, told: Told
) -> list[Growth]:
    began = time.monotonic()
    hours: list[float] = []
    sizes: dict[str, list[float]] = {"coordinator": [], "a worker": [], "its simulation process": []}
    ended = 0
    async with httpx.AsyncClient(base_url=f"{coordinator.url}/api/v1", timeout=60.0) as api:
        running = await _submit(api, ended)
        while (now := time.monotonic() - began) < 60 * minutes:
            told("seconds", int(now), int(60 * minutes))
            await asyncio.sleep(EVERY_S)
            status = (await api.get(f"/campaigns/{running}/progress?since=1000000")).json()["status"]
            if status not in ("running", "finished"):
                raise DidNotStart(f"campaign {running} is {status}")
            if status == "finished":
                ended += 1
                (await api.get(f"/campaigns/{running}/boundary")).raise_for_status()
                running = await _submit(api, ended)
            hours.append((time.monotonic() - began) / 3600)
            pids = [worker.pid or 0 for worker in workers]
            sizes["coordinator"].append(memory_of(coordinator.pid or 0))
            sizes["a worker"].append(statistics.mean(map(memory_of, pids)))
            sizes["its simulation process"].append(
                statistics.mean(memory_of(child) for pid in pids for child in children_of(pid))
            )
    return [
        Growth(
            process=name, hours=tuple(hours), mib=tuple(mib), campaigns=ended, simulations=ended * SIMULATIONS
        )
        for name, mib in sizes.items()
    ]


async def _submit(api: httpx.AsyncClient, index: int) -> str:
    algorithms: tuple[dict[str, Any], ...] = ({"id": "mlcshe@1"}, {"id": "ga@1"}, {"id": "random@1"})
    body = {
        "name": f"soak {index}", "problem": {"id": "urban-injected@1"},
        "algorithm": algorithms[index % len(algorithms)], "budget": {"simulations": SIMULATIONS}, "seed": index,
    }  # fmt: skip
    return str((await api.post("/campaigns", json=body)).raise_for_status().json()["id"])

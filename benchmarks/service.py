"""Throughput of the whole service, compared with a bare loop over the same episodes.

The *bare loop* runs exactly the same episodes in as many processes, without a coordinator, HTTP, a database or
isolation. Runs of the service and of the loop alternate, after all processes have warmed up. The result is the median
of their ratios.
"""

import asyncio
import contextlib
import json
import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from typing import Any

import httpx

from benchmarks.measurement import children_of, cpu_seconds
from brink.api.client import TIMEOUT, Api
from brink.server.campaigns.body import CampaignBody, PluginChoice, parse_body
from brink.server.runtime.coordinator import EmbeddedCoordinator, WorkerProcesses
from brink.server.runtime.database import prepare_database
from brink.server.settings import Settings
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeSpec
from brink.worker.pool import end_with_parent

START_TIMEOUT_S = 60.0
POLL_INTERVAL_S = 0.5
"""About that of `brink run`; the duration of a run is measured by the coordinator."""
TARGET_SHARE = 0.93
URBAN = PluginChoice(id="urban-injected@1", params={})


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceRate:
    """Throughput and CPU time of the service and of the bare loop; medians over the runs.

    Attributes:
        workers: Number of processes that simulate.
        algorithm: Id of the algorithm that proposed the episodes.
        episodes: Episodes per run.
        service_per_s: Episodes per second through the service.
        bare_per_s: Episodes per second in the bare loop.
        share: Ratio of the two rates.
        coordinator_ms: CPU time of the coordinator per episode.
        worker_ms: CPU time of the worker processes per episode, without their simulation processes.
        episode_ms: CPU time of the simulation processes per episode.
        bare_ms: CPU time of the bare loop per episode.
    """

    workers: int
    algorithm: str
    episodes: int
    service_per_s: float
    bare_per_s: float
    share: float
    coordinator_ms: float
    worker_ms: float
    episode_ms: float
    bare_ms: float


@dataclass(frozen=True, slots=True)
class _Run:
    seconds: float
    coordinator_s: float
    worker_s: float
    episode_s: float


def measure_service(
    workers: int, algorithm: str, *, problem: PluginChoice = URBAN, episodes: int = 240, repeats: int = 3
) -> ServiceRate:
    """Measure throughput and CPU time of the service and of the bare loop.

    Args:
        workers: Number of processes that simulate.
        algorithm: Id of the algorithm that proposes the episodes.
        problem: The problem whose episodes are simulated.
        episodes: Simulations per run.
        repeats: Runs of each kind.
    """
    body = partial(_body, problem, algorithm)
    runs: list[tuple[int, _Run, float, float]] = []
    with tempfile.TemporaryDirectory(prefix="brink-bench-") as name, _bare_pool(workers) as pool:
        folder = Path(name)
        database, log_file = f"sqlite:///{folder}/bench.db", folder / "worker.log"
        with embedded_service(database, log_file, workers) as (url, processes):
            asyncio.run(_run_campaign(url, processes, body(40, seed=1)))
            for repeat in range(repeats):
                campaign = _run_campaign(url, processes, body(episodes, seed=100 + repeat))
                run, specs = asyncio.run(campaign)
                runs.append((len(specs), run, *_run_bare(pool, specs)))
    return ServiceRate(
        workers=workers,
        algorithm=algorithm,
        episodes=round(median(count for count, *_ in runs)),
        service_per_s=median(count / run.seconds for count, run, _, _ in runs),
        bare_per_s=median(count / seconds for count, _, seconds, _ in runs),
        share=median(seconds / run.seconds for _, run, seconds, _ in runs),
        coordinator_ms=1e3 * median(run.coordinator_s / count for count, run, _, _ in runs),
        worker_ms=1e3 * median(run.worker_s / count for count, run, _, _ in runs),
        episode_ms=1e3 * median(run.episode_s / count for count, run, _, _ in runs),
        bare_ms=1e3 * median(cpu_s / count for count, _, _, cpu_s in runs),
    )


@contextlib.contextmanager
def embedded_service(database: str, log_file: Path, workers: int) -> Iterator[tuple[str, WorkerProcesses]]:
    """Run a coordinator in this process, and its workers, until the end of the block.

    Args:
        database: Database URL.
        log_file: File for the workers' output.
        workers: Number of workers.

    Yields:
        URL of the coordinator, and the workers.
    """
    settings = Settings(database=database, port=0)
    prepare_database(settings)
    coordinator = EmbeddedCoordinator(settings)
    coordinator.start()
    processes = WorkerProcesses(url=coordinator.url, log_file=log_file, token=None)
    try:
        processes.start(workers)
        yield coordinator.url, processes
    finally:
        processes.stop()
        coordinator.stop()


def _body(problem: PluginChoice, algorithm: str, episodes: int, *, seed: int) -> CampaignBody:
    params = {"generation_size": episodes} if algorithm == "random@1" else {}
    return parse_body(
        {
            "name": "bench",
            "problem": problem.model_dump(),
            "algorithm": {"id": algorithm, "params": params},
            "budget": {"simulations": max(episodes, 100) if algorithm == "mlcshe@1" else episodes},
            "seed": seed,
            "execution": {"cache": False, "keep_traces": 0},
        }
    )


async def _run_campaign(
    url: str, processes: WorkerProcesses, body: CampaignBody
) -> tuple[_Run, list[dict[str, Any]]]:
    """Run a campaign once all workers are up; return its times and its episodes."""
    async with httpx.AsyncClient(base_url=url, timeout=TIMEOUT) as client:
        api = Api(client, url)
        deadline = time.monotonic() + START_TIMEOUT_S
        while len([w for w in await api.get("/workers") if w["live"]]) < len(processes.pids):
            if time.monotonic() > deadline:
                raise TimeoutError("the workers did not start")
            await asyncio.sleep(0.1)
        before = _cpu_times(processes.pids)
        campaign = await api.post("/campaigns", body.model_dump(mode="json"))
        while True:
            progress = await api.get(f"/campaigns/{campaign['id']}/progress", {"since": 10**6})
            if progress["status"] != "running":
                break
            await asyncio.sleep(POLL_INTERVAL_S)
        after = _cpu_times(processes.pids)
        specs = await _specs(api, campaign["id"])
    coordinator, worker, episode = (b - a for a, b in zip(before, after, strict=True))
    return _Run(progress["elapsed_s"], coordinator, worker, episode), specs


async def _specs(api: Api, campaign: str) -> list[dict[str, Any]]:
    numbers: list[int] = []
    after: int | None = -1
    while after is not None:
        page = await api.get(f"/campaigns/{campaign}/solutions", {"limit": 1000, "after": after})
        numbers += [solution["number"] for solution in page["solutions"]]
        after = page["next"]
    return [(await api.get(f"/campaigns/{campaign}/solutions/{number}"))["spec"] for number in numbers]


def _cpu_times(workers: Sequence[int]) -> tuple[float, float, float]:
    """Return the CPU seconds of this process, of the workers, and of the workers' simulation processes."""
    own = time.process_time()
    parents = sum(cpu_seconds(pid) for pid in workers)
    children = sum(cpu_seconds(child) for pid in workers for child in children_of(pid))
    return own, parents, children


@contextlib.contextmanager
def _bare_pool(workers: int) -> Iterator[list[Connection]]:
    context = multiprocessing.get_context("spawn")
    connections: list[Connection] = []
    processes = []
    for _ in range(workers):
        here, there = context.Pipe()
        process = context.Process(target=_bare_loop, args=(there,), daemon=True)
        process.start()
        processes.append(process)
        connections.append(here)
    try:
        yield connections
    finally:
        for connection in connections:
            connection.send(None)
        for process in processes:
            process.join()


def _bare_loop(connection: Connection) -> None:
    end_with_parent()
    simulators: dict[str, Any] = {}
    while (specs := connection.recv()) is not None:
        start_s = time.process_time()
        for document in specs:
            spec = EpisodeSpec.from_json(json.loads(document))
            if spec.simulator not in simulators:
                simulators[spec.simulator] = make_simulator(spec.simulator)
            simulators[spec.simulator].run(spec)
        connection.send(time.process_time() - start_s)


def _run_bare(pool: Sequence[Connection], specs: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Run episodes, assigned to the processes in turn; return wall-clock and CPU seconds."""
    texts = [json.dumps(spec) for spec in specs]
    for connection in pool:  # one warm-up episode each, because the first one pays for imports
        connection.send(texts[:1])
    for connection in pool:
        connection.recv()
    start = time.perf_counter()
    for index, connection in enumerate(pool):
        connection.send(texts[index :: len(pool)])
    cpu_s = sum(connection.recv() for connection in pool)
    return time.perf_counter() - start, cpu_s

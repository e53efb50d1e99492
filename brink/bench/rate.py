"""How fast episodes run: the bare simulator, and the whole service around it.

The *bare loop* runs the very same episodes in as many processes, with no coordinator, HTTP, database or isolation.
Both are measured warm, after their processes have started, alternately and several times; the figure is the median
of the ratios.
"""

import asyncio
import contextlib
import json
import multiprocessing
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import httpx

from brink.api.client import TIMEOUT, Api
from brink.bench.processes import children_of, cpu_of
from brink.server.campaigns.body import CampaignBody, parse_body
from brink.server.runtime.coordinator import EmbeddedCoordinator, WorkerProcesses
from brink.server.runtime.database import prepare_database
from brink.server.settings import Settings
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeSpec

READY_S = 60.0
LOOK_EVERY_S = 0.5
"""As `brink run` does, more or less; the time of a run is the coordinator's own."""
TARGET_SHARE = 0.93


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceRate:
    """Episodes a second through the service and in a bare loop.

    Attributes:
        workers: Processes that simulate.
        algorithm: What proposed the episodes.
        episodes: Episodes a run.
        service_per_s: Through the service, median of the runs.
        bare_per_s: In the bare loop, median of the runs.
        share: Median of the runs' ratios service / bare.
        coordinator_ms: CPU time of the coordinator an episode.
        worker_ms: CPU time of the workers' parent processes an episode.
        episode_ms: CPU time of the simulation processes an episode.
        bare_ms: CPU time of the bare loop an episode.
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


def measure_service(workers: int, algorithm: str, *, episodes: int = 240, repeats: int = 3) -> ServiceRate:
    """Measure the service against the bare loop.

    Args:
        workers: Processes that simulate.
        algorithm: Id of the algorithm that proposes the episodes.
        episodes: Simulations a run.
        repeats: Runs of each kind.
    """
    runs: list[tuple[int, _Run, float, float]] = []
    with (
        tempfile.TemporaryDirectory(prefix="brink-bench-") as folder,
        _bare_pool(workers) as pool,
        _service(Path(folder), workers) as (url, processes),
    ):
        asyncio.run(_campaign(url, processes, _body(algorithm, 40, seed=1)))
        for repeat in range(repeats):
            body = _body(algorithm, episodes, seed=100 + repeat)
            run, specs = asyncio.run(_campaign(url, processes, body))
            runs.append((len(specs), run, *_run_bare(pool, specs)))
    return ServiceRate(
        workers=workers,
        algorithm=algorithm,
        episodes=round(statistics.median(count for count, *_ in runs)),
        service_per_s=statistics.median(count / run.seconds for count, run, _, _ in runs),
        bare_per_s=statistics.median(count / seconds for count, _, seconds, _ in runs),
        share=statistics.median(seconds / run.seconds for _, run, seconds, _ in runs),
        coordinator_ms=1e3 * statistics.median(run.coordinator_s / count for count, run, _, _ in runs),
        worker_ms=1e3 * statistics.median(run.worker_s / count for count, run, _, _ in runs),
        episode_ms=1e3 * statistics.median(run.episode_s / count for count, run, _, _ in runs),
        bare_ms=1e3 * statistics.median(cpu / count for count, _, _, cpu in runs),
    )


def _body(algorithm: str, episodes: int, *, seed: int) -> CampaignBody:
    params = {"generation_size": episodes} if algorithm == "random@1" else {}
    return parse_body(
        {
            "name": "bench",
            "problem": {"id": "urban-injected@1"},
            "algorithm": {"id": algorithm, "params": params},
            "budget": {"simulations": max(episodes, 100) if algorithm == "mlcshe@1" else episodes},
            "seed": seed,
            "execution": {"cache": False, "keep_traces": 0},
        }
    )


# --- the service ---------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _service(folder: Path, workers: int) -> Iterator[tuple[str, WorkerProcesses]]:
    settings = Settings(database=f"sqlite:///{folder}/bench.db", port=0)
    prepare_database(settings)
    coordinator = EmbeddedCoordinator(settings)
    coordinator.start()
    processes = WorkerProcesses(url=coordinator.url, log_file=folder / "worker.log", token=None)
    try:
        processes.start(workers)
        yield coordinator.url, processes
    finally:
        processes.stop()
        coordinator.stop()


async def _campaign(
    url: str, processes: WorkerProcesses, body: CampaignBody
) -> tuple[_Run, list[dict[str, Any]]]:
    """Run one campaign with workers that are up; return what it took, and its episodes."""
    async with httpx.AsyncClient(base_url=url, timeout=TIMEOUT) as client:
        api = Api(client, url)
        deadline = time.monotonic() + READY_S
        while len([w for w in await api.get("/workers") if w["live"]]) < len(processes.pids):
            if time.monotonic() > deadline:
                raise TimeoutError("the workers did not come up")
            await asyncio.sleep(0.1)
        before = _cpu_times(processes.pids)
        campaign = await api.post("/campaigns", body.model_dump(mode="json"))
        while True:
            progress = await api.get(f"/campaigns/{campaign['id']}/progress", {"since": 10**6})
            if progress["status"] != "running":
                break
            await asyncio.sleep(LOOK_EVERY_S)
        finished = await api.get(f"/campaigns/{campaign['id']}")
        seconds = progress["elapsed_s"]
        after = _cpu_times(processes.pids)
        specs = await _specs(api, finished["id"])
    coordinator, worker, episode = (b - a for a, b in zip(before, after, strict=True))
    return _Run(seconds, coordinator, worker, episode), specs


async def _specs(api: Api, campaign: str) -> list[dict[str, Any]]:
    numbers: list[int] = []
    after: int | None = -1
    while after is not None:
        page = await api.get(f"/campaigns/{campaign}/solutions", {"limit": 1000, "after": after})
        numbers += [solution["number"] for solution in page["solutions"]]
        after = page["next"]
    return [(await api.get(f"/campaigns/{campaign}/solutions/{number}"))["spec"] for number in numbers]


def _cpu_times(workers: Sequence[int]) -> tuple[float, float, float]:
    """Return CPU seconds of this process, of the workers, and of the workers' simulation processes."""
    own = time.process_time()
    parents = {pid: cpu_of(pid) for pid in workers}
    children = sum(cpu_of(child) for pid in workers for child in children_of(pid))
    return own, sum(parents.values()), children


# --- the bare loop -------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _bare_pool(workers: int) -> Iterator[list[Connection]]:
    context = multiprocessing.get_context("spawn")
    ends: list[Connection] = []
    processes = []
    for _ in range(workers):
        here, there = context.Pipe()
        process = context.Process(target=_bare_loop, args=(there,), daemon=True)
        process.start()
        processes.append(process)
        ends.append(here)
    try:
        yield ends
    finally:
        for end in ends:
            end.send(None)
        for process in processes:
            process.join()


def _bare_loop(connection: Connection) -> None:
    simulators: dict[str, Any] = {}
    while (specs := connection.recv()) is not None:
        began = time.process_time()
        for document in specs:
            spec = EpisodeSpec.from_json(json.loads(document))
            if spec.simulator not in simulators:
                simulators[spec.simulator] = make_simulator(spec.simulator)
            simulators[spec.simulator].run(spec)
        connection.send(time.process_time() - began)


def _run_bare(pool: Sequence[Connection], specs: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Run episodes dealt round the processes; return wall and CPU seconds."""
    texts = [json.dumps(spec) for spec in specs]
    for end in pool:  # one episode each, so that imports and first use are not counted
        end.send(texts[:1])
    for end in pool:
        end.recv()
    began = time.perf_counter()
    for index, end in enumerate(pool):
        end.send(texts[index :: len(pool)])
    cpu = sum(end.recv() for end in pool)
    return time.perf_counter() - began, cpu

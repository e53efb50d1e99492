"""The effect of one stalling campaign or costly request on all others.

A coordinator serves five *probes*, each over a connection of its own: a request of ``/healthz``, a heartbeat, a
report with the next lease, the submission of a campaign, and a whole small search. They are timed while nothing else
happens, and then beside a *disturbance*. The figure is the worst time beside it, also as a ratio to the worst time
before. In the end, the coordinator is told to exit.

A disturbance is a `Disturbance` in `DISTURBANCES`; whoever adds one adds a row.
"""

import asyncio
import itertools
import os
import shutil
import signal
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Final

import httpx

from benchmarks import stall_plugin
from benchmarks.load import MODULE, LoadClient, load_campaign
from benchmarks.measurement import Progress, counted
from benchmarks.processes import CoordinatorProcess
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.worker.wire import machine_name

PLUGIN_TIMEOUT_S: Final = 5.0
"""Time limit for a plug-in's code, shorter than a coordinator's default so that a trial does not take long."""
PROBES: Final = ("healthz", "heartbeat", "lease", "submission", "search")
PAUSES_S: Final[Mapping[str, float]] = {
    "healthz": 0.05,
    "heartbeat": 0.1,
    "lease": 0.1,
    "submission": 1.0,
    "search": 0.5,
}
"""Time between two requests of a probe."""
MOST_LATENCY_S: Final = 1.0
"""Target for the worst latency during a disturbance."""
MOST_EXIT_S: Final = 10.0
"""Target for the time from SIGTERM to the end of the process."""
GIVE_UP_S: Final = 30.0
"""A request or an exit that takes longer counts as this long."""
BACKGROUND_JOBS: Final = 200_000
FLOOD: Final = 3
"""Large campaigns of the flood that are accepted."""
ARCHIVE: Final = 20_000
"""Solutions of the archive that is read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """Where a disturbance takes place.

    Attributes:
        client: A client of the coordinator, which the probes do not use.
        folder: A folder of its own, readable by the coordinator.
        campaigns: Campaigns of the disturbance, whose fate is reported.
    """

    client: httpx.AsyncClient
    folder: Path
    campaigns: list[str] = field(default_factory=list)

    async def submit(self, document: Mapping[str, Any]) -> str:
        """Submit a campaign of the disturbance and return its id."""
        reply = (await self.client.post("/api/v1/campaigns", json=document)).raise_for_status().json()
        self.campaigns.append(reply["id"])
        return str(reply["id"])


async def _nothing(stage: Stage) -> None:
    """Prepare nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """Something that must not disturb others.

    Attributes:
        kind: The group that it belongs to, such as ``plug-in``.
        name: What happens.
        disturb: Does it, while the probes are timed; cancelled in the end.
        prepare: Called before the probes are timed without it.
    """

    kind: str
    name: str
    disturb: Callable[[Stage], Awaitable[None]]
    prepare: Callable[[Stage], Awaitable[None]] = _nothing

    @property
    def title(self) -> str:
        """Kind and name."""
        return f"{self.kind}: {self.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """The times of one probe.

    Attributes:
        probe: One of `PROBES`.
        idle_ms: The worst time before the disturbance.
        typical_ms: The median time beside it.
        worst_ms: The worst time beside it; `GIVE_UP_S` if a request was not answered.
        failed: Requests beside it that were refused or not answered.
    """

    probe: str
    idle_ms: float
    typical_ms: float
    worst_ms: float
    failed: int

    @property
    def ratio(self) -> float:
        """The worst time during the disturbance relative to that before it."""
        return self.worst_ms / self.idle_ms


@dataclass(frozen=True, slots=True, kw_only=True)
class Stalled:
    """The effect of a disturbance.

    Attributes:
        latencies: The times of each probe.
        fate: Status of its first campaign, with the reason; empty without one.
        cancel_s: Time in which that campaign was cancelled; None without one.
        exit_s: Time from SIGTERM to the end of the process.
    """

    title: str
    latencies: tuple[Latency, ...]
    fate: str
    cancel_s: float | None
    exit_s: float

    @property
    def met(self) -> bool:
        """Whether others were served and the process ended in time."""
        served = all(one.worst_ms <= 1e3 * MOST_LATENCY_S and not one.failed for one in self.latencies)
        return served and self.exit_s <= MOST_EXIT_S and (self.cancel_s or 0.0) <= MOST_LATENCY_S


def measure_stalls(
    progress: Progress, disturbances: Sequence[Disturbance], *, seconds: float
) -> Iterator[Stalled]:
    """Measure each disturbance on a new coordinator; yield each as soon as it is measured.

    Args:
        progress: Progress callback.
        disturbances: The disturbances.
        seconds: How long the probes are timed beside each.
    """
    for place in counted(progress, "disturbances", len(disturbances)):
        yield measure_stall(disturbances[place], seconds=seconds)


def measure_stall(disturbance: Disturbance, *, seconds: float, idle_s: float = 3.0) -> Stalled:
    """Measure one disturbance on a new coordinator.

    Args:
        disturbance: The disturbance.
        seconds: How long the probes are timed beside it.
        idle_s: How long they are timed before.
    """
    with tempfile.TemporaryDirectory(prefix="brink-stalls-") as name:
        folder = Path(name)
        shutil.copy(Path(stall_plugin.__file__), folder / f"{stall_plugin.PLUGIN}.py")
        coordinator = CoordinatorProcess(
            f"sqlite:///{folder}/coordinator.db",
            folder / "coordinator.log",
            {
                PLUGINS_VARIABLE: f"{MODULE},{stall_plugin.PLUGIN}",
                "BRINK_PLUGIN_TIMEOUT_S": f"{PLUGIN_TIMEOUT_S:g}",
                "BRINK_RATE_LIMIT": "0",
                "PYTHONPATH": _python_path(folder),
            },
        )
        try:
            coordinator.start_ready()
            trial = _Trial(coordinator.url, folder)
            latencies, fate, cancel_s = asyncio.run(trial.run(disturbance, idle_s, seconds))
            return Stalled(
                title=disturbance.title,
                latencies=latencies,
                fate=fate,
                cancel_s=cancel_s,
                exit_s=_exit_s(coordinator),
            )
        finally:
            coordinator.kill()


def _python_path(folder: Path) -> str:
    inherited = os.environ.get("PYTHONPATH", "")
    return os.pathsep.join(filter(None, (str(folder), inherited)))


def _exit_s(coordinator: CoordinatorProcess) -> float:
    """Tell a coordinator to exit; return how long that takes."""
    began = time.monotonic()
    coordinator.signal(signal.SIGTERM)
    while coordinator.alive and time.monotonic() - began < GIVE_UP_S:
        time.sleep(0.02)  # between two polls
    return time.monotonic() - began


class _Times:
    """Times of the probes, in seconds, and how many requests failed."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {probe: [] for probe in PROBES}
        self.failed: dict[str, int] = dict.fromkeys(PROBES, 0)

    def beside(self, disturbed: "_Times") -> Iterator[Latency]:
        """Return the figures of each probe, taking these times as the baseline."""
        for probe in PROBES:
            idle_s, busy_s = (times.seconds[probe] or [GIVE_UP_S] for times in (self, disturbed))
            yield Latency(
                probe=probe,
                idle_ms=1e3 * max(idle_s),
                typical_ms=1e3 * median(busy_s),
                worst_ms=1e3 * max(busy_s),
                failed=disturbed.failed[probe],
            )


class _Trial:
    """The probes of one coordinator."""

    def __init__(self, url: str, folder: Path) -> None:
        self._url = url
        self._folder = folder
        self._seeds = itertools.count(1)
        self._times = _Times()

    async def run(
        self, disturbance: Disturbance, idle_s: float, seconds: float
    ) -> tuple[tuple[Latency, ...], str, float | None]:
        """Time the probes before and during a disturbance.

        Returns:
            Their times, and what became of the disturbance's first campaign: its status, and how long it took to
            cancel it.
        """
        async with httpx.AsyncClient(base_url=self._url, timeout=GIVE_UP_S) as client:
            background = load_campaign(BACKGROUND_JOBS, generation=100, seed=0)
            (await client.post("/api/v1/campaigns", json=background)).raise_for_status()
            stage = Stage(client=client, folder=self._folder)
            async with self._probing():
                await disturbance.prepare(stage)
                await asyncio.sleep(0.5)  # until the first steps are taken
                before = await self._time(idle_s)
                disturbing = asyncio.ensure_future(disturbance.disturb(stage))
                beside = await self._time(seconds)
                fate, cancel_s = await _end(stage)
                disturbing.cancel()
                with suppress(asyncio.CancelledError, httpx.HTTPError):
                    await disturbing
        return tuple(before.beside(beside)), fate, cancel_s

    async def _time(self, seconds: float) -> _Times:
        """Return the times of the requests from now on: for some seconds, and until each probe has a response."""
        self._times = times = _Times()
        await asyncio.sleep(seconds)
        deadline = time.monotonic() + GIVE_UP_S
        while not all(times.seconds.values()) and time.monotonic() < deadline:
            await asyncio.sleep(0.05)  # until each probe has an answer
        self._times = _Times()
        return times

    @asynccontextmanager
    async def _probing(self) -> AsyncIterator[None]:
        """Run all probes until the end of the block."""
        tasks = [
            asyncio.create_task(probe())
            for probe in (
                self._probe_health,
                self._probe_heartbeat,
                self._probe_lease,
                self._probe_submission,
                self._probe_search,
            )
        ]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            for ended in await asyncio.gather(*tasks, return_exceptions=True):
                if isinstance(ended, Exception):
                    raise ended

    async def _repeat(self, probe: str, request: Callable[[], Awaitable[bool]]) -> None:
        """Send a request again and again, and record its times."""
        while True:
            times, began = self._times, time.perf_counter()
            try:
                async with asyncio.timeout(
                    GIVE_UP_S
                ):  # unlike wait_for, never swallows that the probe is cancelled
                    ok = await request()
            except (TimeoutError, httpx.HTTPError, OSError):
                ok = False
            times.seconds[probe].append(time.perf_counter() - began)
            times.failed[probe] += not ok
            await asyncio.sleep(PAUSES_S[probe])

    async def _probe_health(self) -> None:
        async with httpx.AsyncClient(base_url=self._url, timeout=GIVE_UP_S) as client:
            await self._repeat("healthz", lambda: _ok(client.get("/healthz")))

    async def _probe_heartbeat(self) -> None:
        worker = {"id": "heart", "host": "bench", "machine": machine_name(), "pid": 1}
        beat = {"worker": worker, "leases": []}
        async with httpx.AsyncClient(base_url=self._url, timeout=GIVE_UP_S) as client:
            await self._repeat("heartbeat", lambda: _ok(client.post("/api/v1/jobs/heartbeat", json=beat)))

    async def _probe_submission(self) -> None:
        async with httpx.AsyncClient(base_url=self._url, timeout=GIVE_UP_S) as client:

            def submit() -> Awaitable[bool]:
                return _ok(
                    client.post(
                        "/api/v1/campaigns", json=load_campaign(4, generation=4, seed=next(self._seeds))
                    )
                )

            await self._repeat("submission", submit)

    async def _probe_search(self) -> None:
        """Run searches that need no workers, so that only their steps take time."""
        async with httpx.AsyncClient(base_url=self._url, timeout=GIVE_UP_S) as client:

            async def search() -> bool:
                body = {
                    "name": "search",
                    "problem": {"id": "mtq@1"},
                    "budget": {"simulations": 10},
                    "algorithm": {"id": "random@1", "params": {"generation_size": 5}},
                    "seed": next(self._seeds),
                }
                reply = (await client.post("/api/v1/campaigns", json=body)).raise_for_status().json()
                path = f"/api/v1/campaigns/{reply['id']}/progress"
                while (await client.get(path)).raise_for_status().json()["status"] == "running":
                    await asyncio.sleep(0.02)  # between two polls
                return True

            await self._repeat("search", search)

    async def _probe_lease(self) -> None:
        """Play a worker: each request reports what the last one leased."""
        async with LoadClient(self._url, "bench", max_jobs=4, wait_s=1.0) as client:
            jobs = await client.lease()

            async def report() -> bool:
                nonlocal jobs
                jobs = await client.report(jobs) if jobs else await client.lease()
                return True

            await self._repeat("lease", report)


async def _ok(request: Awaitable[httpx.Response]) -> bool:
    return (await request).is_success


async def _end(stage: Stage) -> tuple[str, float | None]:
    """Cancel the first campaign of a disturbance; return its status before, and how long that took."""
    if not stage.campaigns:
        return "", None
    path = f"/api/v1/campaigns/{stage.campaigns[0]}"
    fate = "no answer"
    with suppress(httpx.HTTPError):
        view = (await stage.client.get(path)).raise_for_status().json()
        fate = f"{view['status']}: {view['status_reason']}" if view["status_reason"] else view["status"]
    began = time.perf_counter()
    with suppress(httpx.HTTPError):
        await stage.client.post(f"{path}/cancel")
    return fate, time.perf_counter() - began


def stalling_campaign(
    folder: Path, *, problem: Mapping[str, str] | None = None, algorithm: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return the body of a campaign whose plug-in stalls once `arm` was called.

    Args:
        folder: Folder of the trial.
        problem: Place and fault of the problem.
        algorithm: Place and fault of the algorithm; None for ``random@1``.
    """
    armed = {"armed": str(folder / "armed")}
    size = {"generation_size": 8, "in_flight": 1}
    search: dict[str, Any] = {"id": "random@1", "params": size}
    if algorithm is not None:
        search = {"id": stall_plugin.ALGORITHM, "params": {**size, **algorithm, **armed}}
    return {
        "name": "stalls",
        "seed": 1,
        "budget": {"simulations": 100_000},
        "algorithm": search,
        "problem": {"id": stall_plugin.PROBLEM, "params": {**(problem or {}), **armed}},
        "execution": {"cache": False, "keep_traces": 0},
        "priority": 10,
    }


def arm(folder: Path) -> None:
    """Make the plug-in of a trial stall from now on."""
    (folder / "armed").touch()


def _stalls(place: str, fault: str) -> Disturbance:
    """Return the disturbance by a plug-in that stalls in one of its methods."""
    where = {"place": place, "fault": fault}
    of_algorithm = place in ("ask", "tell")

    async def prepare(stage: Stage) -> None:
        body = stalling_campaign(
            stage.folder, problem=None if of_algorithm else where, algorithm=where if of_algorithm else None
        )
        await stage.submit(body)

    async def disturb(stage: Stage) -> None:
        arm(stage.folder)
        bodies = [stalling_campaign(stage.folder, problem=where) | {"seed": 2 + one} for one in range(4)]
        more = asyncio.gather(
            *(
                _ignored(stage.client.post("/api/v1/campaigns", json=body))
                for body in bodies
                if place == "construction"
            )
        )
        try:
            await _watch(stage)
        finally:
            more.cancel()

    verb = {"sleep": "sleeps", "hang": "hangs", "loop": "loops for ever", "raise": "raises an error"}[fault]
    return Disturbance(kind="plug-in", name=f"{place} {verb}", disturb=disturb, prepare=prepare)


async def _watch(stage: Stage) -> None:
    """Ask about the first campaign again and again, as an open dashboard does."""
    path = f"/api/v1/campaigns/{stage.campaigns[0]}"
    while True:
        await _ignored(stage.client.get(f"{path}/progress"))
        await _ignored(stage.client.get(f"{path}/solutions"))
        await asyncio.sleep(0.5)


async def _ignored(request: Awaitable[httpx.Response]) -> None:
    with suppress(httpx.HTTPError):
        await request


async def _flood(stage: Stage) -> None:
    """Submit large campaigns: some with more in flight than a coordinator takes, and some with the most it takes."""
    too_large = load_campaign(10_000_000, generation=10_000, seed=1, in_flight=20)
    largest = load_campaign(10_000_000, generation=10_000, seed=2, in_flight=2)
    await _ignored(stage.client.post("/api/v1/campaigns", json=too_large))
    for seed in range(FLOOD):
        await stage.submit({**largest, "seed": 3 + seed})
    while True:
        await asyncio.sleep(1.0)  # until it is cancelled


async def _fill_archive(stage: Stage) -> None:
    """Run a search of solutions that are all at least .05 apart, which needs no workers."""
    body = {
        "name": "archive",
        "problem": {"id": "onemax@1"},
        "seed": 1,
        "budget": {"simulations": ARCHIVE},
        "algorithm": {"id": "random@1", "params": {"generation_size": 1000, "in_flight": 1}},
    }
    path = f"/api/v1/campaigns/{await stage.submit(body)}/progress"
    while (await stage.client.get(path)).raise_for_status().json()["status"] == "running":
        await asyncio.sleep(0.5)  # between two polls


def _reads(name: str, *paths: str) -> Disturbance:
    """Return the disturbance by several clients that read a large archive again and again."""

    async def disturb(stage: Stage) -> None:
        async def read(path: str) -> None:
            async with httpx.AsyncClient(base_url=stage.client.base_url, timeout=GIVE_UP_S) as client:
                while True:
                    await _ignored(client.get(f"/api/v1/campaigns/{stage.campaigns[0]}/{path}"))

        readers = [asyncio.ensure_future(read(path)) for path in paths]
        try:
            await asyncio.gather(*readers)
        finally:
            for reader in readers:
                reader.cancel()

    return Disturbance(kind="reads", name=name, disturb=disturb, prepare=_fill_archive)


DISTURBANCES: Final[list[Disturbance]] = [
    *(
        _stalls(place, fault)
        for place in ("construction", "evaluation", "ask", "tell")
        for fault in ("sleep", "hang", "loop", "raise")
    ),
    Disturbance(kind="flood", name=f"{FLOOD} campaigns of 20,000 candidates in flight", disturb=_flood),
    _reads("6 boundaries at the same thresholds", *["boundary?t_b=1&d_th=0.05"] * 6),
    _reads("6 boundaries at different thresholds", *[f"boundary?t_b=1&d_th=0.0{n}" for n in range(1, 7)]),
    _reads(
        "archive, map and pages",
        "archive.npz",
        "map",
        "outcomes?solutions=true",
        *["solutions?limit=1000"] * 3,
    ),
]
"""All disturbances, in the order in which they are measured."""

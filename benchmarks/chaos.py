"""Fault injection: campaigns run under faults, then again without them, and the results are audited.

Two coordinators and four workers share a Postgres server. A proxy loses, delays, truncates and repeats their
messages. Processes, episodes, database connections and the database itself are killed or suspended, and the clocks of
two workers are wrong. In outages, no coordinator runs for longer than a lease. Afterwards no acknowledged verdict may
be missing or counted twice, no job may be stuck, in quarantine, or charged for an outage, no request may have met an
internal error, and every archive must be identical to that of the same campaign without faults.
"""

import asyncio
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import httpx
import psycopg
from sqlalchemy import Connection, func, select
from sqlalchemy.engine import make_url

from benchmarks.load import LOAD, MODULE
from benchmarks.measurement import Progress, children_of
from benchmarks.processes import (
    CoordinatorProcess,
    MeasurementFailed,
    Process,
    plugin_environment,
    running_coordinator,
    running_workers,
)
from benchmarks.servers import TemporaryPostgres, temporary_postgres
from brink.server.db.engine import open_engines
from brink.server.db.models import CampaignRow, JobRow, SolutionRow, WorkerRow
from brink.server.states import JobKind, JobStatus, SolutionVerdict
from brink.worker.wire import Completed

ENVIRONMENT = {
    "BRINK_LEASE_S": "3",
    "BRINK_SWEEP_S": "0.5",
    "BRINK_RETRY_BACKOFF_S": "0.2",
    "BRINK_WORKER_SEEN_S": "10",
}
COORDINATORS = 2
WORKERS = 4
CLOCKS = ((7200.0, 0.4), (0.0, 1.0), (-86400.0, 1.0), (0.0, 1.0))
"""For each worker, the offset of its time of day in s and the speed of its monotonic clock."""
SUSPENDED_S = (1.0, 6.0)
"""How long a process is suspended; the longest time exceeds the lease time."""
DOWN_S = (0.0, 3.0)
"""How long a killed process stays down."""
OUTAGE_S = (3.5, 9.0)
"""How long all coordinators are down in an outage: always longer than a lease."""
EPISODE_KILLED = "episode process killed"
CONCURRENT_CAMPAIGNS = 2
FINISH_TIMEOUT_S = 240.0
"""How long the campaigns may take to finish after the last fault."""
MESSAGE_FAULTS = (
    "request lost",
    "reply lost",
    "reply cut short",
    "request repeated",
    "request repeated late",
    "request delayed",
    "reply delayed",
    "answered 503",
)
LATE_S = (1.0, 8.0)
DELAY_S = (0.1, 5.0)
_POLL_S = 0.5
_HEADERS_END = b"\r\n\r\n"
_UNAVAILABLE = b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"

_Processes: TypeAlias = "Sequence[CoordinatorProcess] | Sequence[Process]"


@dataclass(frozen=True, slots=True, kw_only=True)
class ChaosPlan:
    """Parameters of a fault-injection trial.

    Attributes:
        minutes: Minimum duration of the fault injection.
        faults: Minimum number of faults of processes, connections and databases.
        every_s: Mean time between two of these faults.
        share: Fraction of the messages that suffer a fault.
        simulations: Simulations per campaign.
        drives: Whether episodes are simulated drives; otherwise they only wait briefly.
        seed: Seed of the campaigns and faults.
        workers: Number of workers in the undisturbed run.
        plugins: Further modules that coordinators and workers import in the trial.
    """

    minutes: float = 10.0
    faults: int = 200
    every_s: float = 2.0
    share: float = 0.02
    simulations: int = 400
    drives: bool = True
    seed: int = 1
    workers: int = 2
    plugins: tuple[str, ...] = ()

    def rng(self, stream: int) -> random.Random:
        """Return the random generator for a stream."""
        return random.Random(f"{self.seed}/{stream}")

    def body(self, index: int) -> dict[str, Any]:
        """Return the request body that submits a campaign."""
        algorithms: tuple[dict[str, Any], ...] = (
            {"id": "mlcshe@1"},
            {"id": "ga@1"},
            {"id": "random@1", "params": {"generation_size": 60}},
        )
        waiting: dict[str, Any] = {"id": LOAD, "params": {"mean_s": 0.05}}
        return {
            "name": f"trial {index}",
            "problem": {"id": "urban-injected@1"} if self.drives else waiting,
            "algorithm": algorithms[index % len(algorithms)],
            "budget": {"simulations": self.simulations},
            "seed": self.seed * 1000 + index,
            "execution": {"max_attempts": 20, "keep_traces": 0},
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """Errors that the audit found, by kind; all empty if there are none.

    Attributes:
        lost: Accepted verdicts that are not stored, and solutions without a verdict.
        doubled: Verdicts that were accepted twice, campaigns that count more verdicts than their solutions have, and
            campaigns that were not submitted.
        stuck: Jobs and campaigns that did not finish.
        charged: Losses and failed attempts that jobs were charged although they were nobody's fault.
        errors: Internal errors of coordinators.
    """

    lost: tuple[str, ...] = ()
    doubled: tuple[str, ...] = ()
    stuck: tuple[str, ...] = ()
    charged: tuple[str, ...] = ()
    errors: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ChaosOutcome:
    """Outcome of a fault-injection trial.

    Attributes:
        broken: Number of faults of processes, connections and databases, by kind.
        messages: Number of message faults, by kind.
        requests: Number of requests.
        statuses: Number of reported results, by the coordinator's response.
        campaigns: Number of simulations of each submitted campaign.
        digests: Archive digests of each campaign, with faults and undisturbed.
        findings: Errors that the audit found.
        unexpected_exits: Kind, exit status and last log line of each process that exited by itself and was restarted.
        minutes: Duration of the fault injection.
    """

    broken: Counter[str]
    messages: Counter[str]
    requests: int
    statuses: Counter[str]
    campaigns: Mapping[str, int]
    digests: Mapping[str, tuple[str, str]]
    findings: Findings
    unexpected_exits: tuple[str, ...] = ()
    minutes: float = 0.0

    @property
    def same(self) -> int:
        """Number of archives that are identical to those of the undisturbed run."""
        return sum(ours == theirs for ours, theirs in self.digests.values())


def run_trial(plan: ChaosPlan, progress: Progress) -> ChaosOutcome:
    """Run a fault-injection trial.

    Args:
        plan: Parameters of the trial.
        progress: Progress callback.

    Raises:
        NoPostgres: Postgres is not installed or did not start.
        MeasurementFailed: A process did not start, or a coordinator rejected a request.
    """
    with tempfile.TemporaryDirectory(prefix="brink-chaos-") as name, temporary_postgres() as server:
        folder = Path(name)
        site = Site(
            server,
            server.database("chaos"),
            folder,
            {**ENVIRONMENT, **plugin_environment(MODULE, *plan.plugins)},
            plan.rng(1),
        )
        ledger = Ledger()
        trial = _Trial(plan, progress, site, ledger)
        asyncio.run(trial.run())
        engines = open_engines(site.database)
        try:
            with engines.reader.connect() as connection:
                findings = audit(
                    connection,
                    ledger,
                    trial.campaigns,
                    crashes=site.faults[EPISODE_KILLED],
                    charged=site.charged,
                )
        finally:
            engines.dispose()
        undisturbed = _run_undisturbed(plan, list(trial.bodies.values()), folder, progress)
    return ChaosOutcome(
        broken=site.faults,
        messages=trial.messages,
        requests=trial.requests,
        statuses=ledger.statuses,
        campaigns=trial.campaigns,
        findings=findings,
        unexpected_exits=tuple(site.unexpected_exits),
        minutes=trial.minutes,
        digests={
            campaign: (ours, theirs)
            for (campaign, ours), theirs in zip(trial.digests.items(), undisturbed, strict=True)
        },
    )


@dataclass(slots=True)
class Ledger:
    """The results that coordinators accepted, whether or not the worker received the reply.

    Attributes:
        accepted: Accepted results of each job, as they are stored.
        statuses: Number of results by the coordinator's response.
        errors: Number of internal errors of coordinators by the request's method and path.
    """

    accepted: dict[int, list[str]] = field(default_factory=dict)
    statuses: Counter[str] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)

    def note(self, request: bytes, reply: bytes) -> None:
        """Record the results of one report and the coordinator's responses."""
        results: Sequence[Mapping[str, Any]] = json.loads(request)["results"]
        statuses: Sequence[Mapping[str, Any]] = json.loads(reply)["statuses"]
        for result, answer in zip(results, statuses, strict=True):
            self.statuses[answer["status"]] += 1
            if answer["status"] == "accepted" and result["outcome"]["kind"] == "completed":
                stored = Completed.model_validate(result["outcome"]).model_dump_json(exclude={"trace"})
                self.accepted.setdefault(result["job"], []).append(stored)


def audit(
    connection: Connection,
    ledger: Ledger,
    campaigns: Mapping[str, int],
    *,
    crashes: int = 0,
    charged: Sequence[str] = (),
) -> Findings:
    """Compare the results that coordinators accepted with those in the database.

    Args:
        connection: Connection to the database, which nothing writes to any more.
        ledger: The accepted results.
        campaigns: Number of simulations of each submitted campaign.
        crashes: Number of episodes that were made to fail; no other attempt may have failed.
        charged: What jobs were wrongly charged, as far as it is known already.
    """
    lost: list[str] = []
    stuck: list[str] = []
    doubled = [
        f"job {job}: accepted {len(results)} times"
        for job, results in ledger.accepted.items()
        if len(results) > 1
    ]
    jobs = {
        row.id: row
        for row in connection.execute(
            select(JobRow.id, JobRow.status, JobRow.result, JobRow.kind, JobRow.attempt, JobRow.losses)
        )
    }
    for job, results in ledger.accepted.items():
        row = jobs.get(job)
        if row is None or row.status != JobStatus.DONE or row.result not in results:
            lost.append(f"job {job}: accepted, but it is {row.status if row is not None else 'missing'}")
    for row in jobs.values():
        if row.status in (JobStatus.QUEUED, JobStatus.LEASED) and row.kind != JobKind.TRACE:
            stuck.append(f"job {row.id} is {row.status}")
        elif row.status != JobStatus.DONE and row.kind != JobKind.TRACE:
            lost.append(f"job {row.id} is {row.status}")
    columns = select(CampaignRow.id, CampaignRow.status, CampaignRow.evaluated)
    stored = {row.id: row for row in connection.execute(columns)}
    doubled += [f"campaign {campaign} was not submitted" for campaign in stored.keys() - campaigns.keys()]
    stuck += [f"campaign {row.id} is {row.status}" for row in stored.values() if row.status != "finished"]
    for campaign, simulations in campaigns.items():
        verdicts = connection.execute(
            select(func.count()).where(
                SolutionRow.campaign_id == campaign,
                SolutionRow.verdict.in_([SolutionVerdict.SAFE, SolutionVerdict.UNSAFE]),
            )
        ).scalar_one()
        if verdicts < simulations:
            lost.append(f"campaign {campaign}: {verdicts} verdicts of {simulations} simulations")
        if campaign in stored and stored[campaign].evaluated > verdicts:
            doubled.append(
                f"campaign {campaign}: counts {stored[campaign].evaluated} solutions, {verdicts} have a verdict"
            )
    failures = sum(
        max(0, row.attempt - row.losses - 1) for row in jobs.values() if row.status == JobStatus.DONE
    )
    if failures > crashes:
        charged = [*charged, f"{failures} failed attempts, but {crashes} episodes were killed"]
    return Findings(
        lost=tuple(lost),
        doubled=tuple(doubled),
        stuck=tuple(stuck),
        charged=tuple(charged),
        errors=tuple(f"{request}: {count} times" for request, count in ledger.errors.items()),
    )


@dataclass(frozen=True, slots=True)
class _Message:
    head: bytes
    body: bytes

    @property
    def raw(self) -> bytes:
        return self.head + self.body


class FaultyProxy:
    """Forwards HTTP/1.1 messages from workers to coordinators, and injects faults into some of them.

    Args:
        ports: Ports of the coordinators on this machine; each request goes to a random one.
        ledger: Records how coordinators respond to results, whether or not the worker receives it.
        share: Fraction of the requests that suffer a fault.
        rng: Source of randomness.
    """

    def __init__(self, ports: Sequence[int], ledger: Ledger, *, share: float, rng: random.Random) -> None:
        self.faults: Counter[str] = Counter()
        self.requests = 0
        self.share = share
        self._ports = tuple(ports)
        self._ledger = ledger
        self._rng = rng
        self._late: set[asyncio.Task[_Message | None]] = set()
        self._connections: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None

    @property
    def url(self) -> str:
        """URL that the workers connect to."""
        assert self._server is not None
        return f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def __aenter__(self) -> "FaultyProxy":
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        # A connection that was just accepted gets its task some iterations of the event loop later.
        await asyncio.sleep(0.1)
        tasks = [*self._late, *self._connections]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._connections.add(task)
        task.add_done_callback(self._connections.discard)
        try:
            while True:
                answer, keep_alive = await self._answer(await _read(reader))
                writer.write(answer)
                await writer.drain()
                if not keep_alive:
                    return
        except (OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
            return  # the worker disconnected, or the trial is over
        finally:
            writer.close()

    async def _answer(self, request: _Message) -> tuple[bytes, bool]:
        """Return the bytes to send to the worker, and whether its connection stays open."""
        self.requests += 1
        fault = self._rng.choice(MESSAGE_FAULTS) if self._rng.random() < self.share else None
        if fault is not None:
            self.faults[fault] += 1
        match fault:
            case "request lost":
                return b"", False
            case "answered 503":
                return _UNAVAILABLE, False
            case "request delayed":
                await asyncio.sleep(self._rng.uniform(*DELAY_S))
            case "request repeated late":
                self._forward_late(request)
            case _:
                pass
        reply = await self._forward(request)
        if fault == "request repeated":
            again = await self._forward(request)
            reply = self._rng.choice((reply, again))
        if reply is None:
            return b"", False
        match fault:
            case "reply lost":
                return b"", False
            case "reply cut short":
                return reply.raw[: self._rng.randrange(len(reply.raw))], False
            case "reply delayed":
                await asyncio.sleep(self._rng.uniform(*DELAY_S))
            case _:
                pass
        return reply.raw, True

    def _forward_late(self, request: _Message) -> None:
        async def forward() -> _Message | None:
            await asyncio.sleep(self._rng.uniform(*LATE_S))
            return await self._forward(request)

        task = asyncio.create_task(forward())
        self._late.add(task)
        task.add_done_callback(self._late.discard)

    async def _forward(self, request: _Message) -> _Message | None:
        """Forward a request to a random coordinator; return its reply, or None if there is none."""
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", self._rng.choice(self._ports))
        except OSError:
            return None
        try:
            writer.write(request.raw)
            reply = await _read(reader)
        except (OSError, asyncio.IncompleteReadError):
            return None
        finally:
            writer.close()
        asked, status = request.head.partition(b"\r\n")[0], reply.head.partition(b"\r\n")[0]
        if b" 500 " in status:
            self._ledger.errors[asked.decode().removesuffix(" HTTP/1.1")] += 1
        if b"/jobs/results " in asked and b" 200 " in status:
            self._ledger.note(request.body, reply.body)
        return reply


async def _read(reader: asyncio.StreamReader) -> _Message:
    head = await reader.readuntil(_HEADERS_END)
    length = 0
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.lower() == b"content-length":
            length = int(value)
    return _Message(head, await reader.readexactly(length))


class Site:
    """The processes under test, and the faults that are injected into them.

    Attributes:
        faults: Number of injected faults, by kind.
        unexpected_exits: Descriptions of processes that exited by themselves.
        charged: Descriptions of jobs that were charged for an outage.
        database: Database URL.
        proxy: The proxy of the workers; None before `start`.
        coordinators: The coordinators.
        workers: The workers; empty before `start`.

    Args:
        server: The Postgres server.
        database: URL of the database on it.
        folder: Folder for log files.
        env: Environment variables of coordinators and workers.
        rng: Source of randomness.
    """

    def __init__(
        self,
        server: TemporaryPostgres,
        database: str,
        folder: Path,
        env: Mapping[str, str],
        rng: random.Random,
    ) -> None:
        self.faults: Counter[str] = Counter()
        self.unexpected_exits: list[str] = []
        self.charged: list[str] = []
        self.database = database
        self.proxy: FaultyProxy | None = None
        self.coordinators = [
            CoordinatorProcess(database, folder / f"coordinator-{index}.log", env)
            for index in range(COORDINATORS)
        ]
        self.workers: list[Process] = []
        self._folder = folder
        self._server = server
        self._env = dict(env)
        self._rng = rng
        self._down: set[Process] = set()
        self._recoveries: set[asyncio.Task[None]] = set()
        self._faults: dict[str, tuple[int, Callable[[], Awaitable[bool]]]] = {
            "coordinator killed": (3, lambda: self._end(self.coordinators, Process.kill)),
            "all coordinators down for longer than a lease": (2, self._kill_coordinators),
            "coordinator told to stop": (1, lambda: self._end(self.coordinators, Process.stop)),
            "coordinator stands still": (3, lambda: self._suspend(self.coordinators)),
            "worker killed": (4, lambda: self._end(self.workers, Process.kill)),
            "worker told to stop": (2, lambda: self._end(self.workers, Process.stop)),
            "worker stands still": (3, lambda: self._suspend(self.workers)),
            EPISODE_KILLED: (6, self._kill_episode),
            "database connection cut": (6, lambda: self._cut_connections(1)),
            "all database connections cut": (2, lambda: self._cut_connections(None)),
            "database crashed": (1, self._crash_database),
        }

    def start(self, proxy: FaultyProxy) -> None:
        """Start all processes that are not running yet."""
        self.proxy = proxy
        for index, clocks in enumerate(CLOCKS[:WORKERS]):
            options = ("--server", proxy.url, "--wait", "5", "--grace", "3", "--memory", "0")
            skewed = ["benchmarks.wrong_clock", *map(str, clocks)]
            module = skewed if clocks != (0.0, 1.0) else ["brink.worker"]
            command = [sys.executable, "-m", *module, *options]
            self.workers.append(Process(command, self._folder / f"worker-{index}.log", self._env))
        for process in (*self.coordinators, *self.workers):
            process.start()

    def stop(self) -> None:
        """Kill all processes."""
        for process in (*self.workers, *self.coordinators):
            process.kill()

    async def inject_fault(self) -> None:
        """Inject a random fault; anything it stops recovers after a few seconds."""
        names = list(self._faults)
        (name,) = self._rng.choices(names, weights=[self._faults[n][0] for n in names])
        self.faults[name] += await self._faults[name][1]()

    def restart_exited(self) -> None:
        """Restart processes that exited by themselves."""
        for kind, processes in (("coordinator", self.coordinators), ("worker", self.workers)):
            for process in processes:
                if not process.alive and process not in self._down:
                    self.unexpected_exits.append(f"{kind}, exit {process.exit_status}: {process.last_line}")
                    process.start()

    async def recover(self) -> None:
        """Wait until all stopped processes have recovered."""
        await asyncio.gather(*self._recoveries)

    def _recover_later(self, recovery: Coroutine[None, None, None]) -> None:
        task = asyncio.create_task(recovery)
        self._recoveries.add(task)
        task.add_done_callback(self._recoveries.discard)

    def _take_down(self, processes: _Processes) -> Process | None:
        """Choose a random running process and mark it as down; return None if none is running."""
        running = [process for process in processes if process.alive and process not in self._down]
        if not running:
            return None
        process = self._rng.choice(running)
        self._down.add(process)
        return process

    async def _end(self, processes: _Processes, end: Callable[[Process], None]) -> bool:
        process = self._take_down(processes)
        if process is None:
            return False
        down_s = self._rng.uniform(*DOWN_S)

        async def restart() -> None:
            await asyncio.to_thread(end, process)
            await asyncio.sleep(down_s)
            process.start()
            self._down.discard(process)

        self._recover_later(restart())
        return True

    async def _kill_coordinators(self) -> bool:
        """Kill all coordinators for longer than a lease; no job that was leased then may be charged for it.

        Until that is clear, nothing else is broken: other faults may cost leases that were renewed after the outage.
        """
        assert self.proxy is not None
        share, self.proxy.share = self.proxy.share, 0.0
        await self.recover()
        for one in self.coordinators:
            await asyncio.to_thread(one.kill)
        before = await asyncio.to_thread(self._losses_of_leased)
        await asyncio.sleep(self._rng.uniform(*OUTAGE_S))
        await asyncio.gather(*(asyncio.to_thread(one.start_ready) for one in self.coordinators))
        await asyncio.sleep(float(ENVIRONMENT["BRINK_LEASE_S"]) + 2 * float(ENVIRONMENT["BRINK_SWEEP_S"]))
        after = await asyncio.to_thread(self._losses_of, list(before))
        self.charged += [
            f"job {job} was charged {after[job] - losses} losses for an outage"
            for job, losses in before.items()
            if after[job] > losses
        ]
        self.proxy.share = share
        return True

    def _losses_of_leased(self) -> dict[int, int]:
        """Return the losses of each leased job whose worker's clock is right: the others may renew too late."""
        punctual = [one.pid for one, clock in zip(self.workers, CLOCKS, strict=True) if clock[1] == 1.0]
        query = select(JobRow.id, JobRow.losses).join(WorkerRow, WorkerRow.id == JobRow.lease_worker)
        leased = query.where(JobRow.status == JobStatus.LEASED, WorkerRow.pid.in_(punctual))
        return self._read(lambda connection: {row.id: row.losses for row in connection.execute(leased)})

    def _losses_of(self, jobs: list[int]) -> dict[int, int]:
        query = select(JobRow.id, JobRow.losses).where(JobRow.id.in_(jobs))
        return self._read(lambda connection: {row.id: row.losses for row in connection.execute(query)})

    def _read(self, query: Callable[[Connection], dict[int, int]]) -> dict[int, int]:
        engines = open_engines(self.database)
        try:
            with engines.reader.connect() as connection:
                return query(connection)
        finally:
            engines.dispose()

    async def _suspend(self, processes: _Processes) -> bool:
        process = self._take_down(processes)
        if process is None:
            return False
        process.signal(signal.SIGSTOP)
        suspended_s = self._rng.uniform(*SUSPENDED_S)

        async def resume() -> None:
            await asyncio.sleep(suspended_s)
            process.signal(signal.SIGCONT)
            self._down.discard(process)

        self._recover_later(resume())
        return True

    async def _kill_episode(self) -> bool:
        running = [worker.pid for worker in self.workers if worker not in self._down and worker.pid]
        children = children_of(self._rng.choice(running)) if running else []
        for child in children:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        return bool(children)

    async def _cut_connections(self, most: int | None) -> bool:
        def cut() -> bool:
            with psycopg.connect(self._server.url, autocommit=True, connect_timeout=5) as connection:
                query = "SELECT pid FROM pg_stat_activity WHERE datname = %s"
                rows = connection.execute(query, [make_url(self.database).database]).fetchall()
                pids = [pid for (pid,) in rows]
                chosen = pids if most is None else self._rng.sample(pids, min(most, len(pids)))
                for pid in chosen:
                    connection.execute("SELECT pg_terminate_backend(%s)", [pid])
                return bool(chosen)

        return await asyncio.to_thread(cut)

    async def _crash_database(self) -> bool:
        def crash() -> None:
            self._server.stop()
            self._server.start()

        await asyncio.to_thread(crash)
        return True


class _Trial:
    def __init__(self, plan: ChaosPlan, progress: Progress, site: Site, ledger: Ledger) -> None:
        self.campaigns: dict[str, int] = {}
        self.bodies: dict[str, dict[str, Any]] = {}
        self.digests: dict[str, str] = {}
        self.messages: Counter[str] = Counter()
        self.requests = 0
        self.minutes = 0.0
        self._site = site
        self._plan = plan
        self._progress = progress
        self._ledger = ledger
        self._rng = plan.rng(4)

    async def run(self) -> None:
        """Run campaigns under faults, then let them finish."""
        plan = self._plan
        ports = [coordinator.port for coordinator in self._site.coordinators]
        async with FaultyProxy(ports, self._ledger, share=plan.share, rng=plan.rng(2)) as proxy:
            for coordinator in self._site.coordinators:  # one after another: the first creates the schema
                await asyncio.to_thread(coordinator.start_ready)
            self._site.start(proxy)
            try:
                async with httpx.AsyncClient(timeout=10.0) as client:
                    await self._begin(client)
                    await self._inject_faults(client)
                    proxy.share = 0.0
                    await self._site.recover()
                    await self._finish(client)
            finally:
                self._site.stop()
            self.messages, self.requests = proxy.faults, proxy.requests

    async def _begin(self, client: httpx.AsyncClient) -> None:
        """Wait for the first result, so that the faults strike work, however slowly processes start.

        Raises:
            MeasurementFailed: There is none in time.
        """
        deadline = time.monotonic() + FINISH_TIMEOUT_S
        while not self._ledger.statuses:
            if time.monotonic() > deadline:
                raise MeasurementFailed(f"no result within {FINISH_TIMEOUT_S:.0f} s of the start")
            self._site.restart_exited()
            await self._keep_busy(client)
            self._progress("first result", 0, 1)
            await asyncio.sleep(_POLL_S)

    async def _inject_faults(self, client: httpx.AsyncClient) -> None:
        plan, start, rng = self._plan, time.monotonic(), self._plan.rng(3)
        next_fault, next_poll = start, start
        while (
            now := time.monotonic()
        ) - start < 60 * plan.minutes or self._site.faults.total() < plan.faults:
            if now >= next_fault:
                await self._site.inject_fault()
                next_fault = now + rng.expovariate(1 / plan.every_s)
            if now >= next_poll:
                self._site.restart_exited()
                await self._keep_busy(client)
                self._progress("injecting faults", int(now - start), int(60 * plan.minutes))
                next_poll = now + _POLL_S
            await asyncio.sleep(0.05)
        self.minutes = (time.monotonic() - start) / 60

    async def _keep_busy(self, client: httpx.AsyncClient) -> None:
        """Submit campaigns so that some are always running."""
        running = await self._poll(client)
        while running < CONCURRENT_CAMPAIGNS:
            body = self._plan.body(len(self.campaigns))
            key = {"Idempotency-Key": f"trial-{body['seed']}"}
            submitted = await self._request(client, "POST", "/campaigns", json=body, headers=key)
            if submitted is None:
                return
            self.campaigns[submitted["id"]] = body["budget"]["simulations"]
            self.bodies[submitted["id"]] = body
            running += 1

    async def _poll(self, client: httpx.AsyncClient) -> int:
        """Store the digests of finished campaigns; return how many are not known to have finished."""
        open_campaigns = [campaign for campaign in self.campaigns if campaign not in self.digests]
        for campaign in open_campaigns:
            path = f"/campaigns/{campaign}/progress?since=1000000"
            progress = await self._request(client, "GET", path)
            if progress is not None and progress["status"] == "finished":
                self.digests[campaign] = progress["digest"]
        return len(self.campaigns) - len(self.digests)

    async def _request(self, client: httpx.AsyncClient, method: str, path: str, **more: Any) -> Any | None:
        """Send a request to a random coordinator; return the decoded response, or None if there is none.

        Raises:
            MeasurementFailed: The coordinator rejected the request, which no fault can cause.
        """
        coordinator = self._rng.choice(self._site.coordinators)
        try:
            response = await client.request(method, f"{coordinator.url}/api/v1{path}", **more)
        except httpx.TransportError:
            return None
        if response.status_code == httpx.codes.INTERNAL_SERVER_ERROR:
            self._ledger.errors[f"{method} {path}"] += 1
        if response.is_client_error:
            raise MeasurementFailed(f"{method} {path}: {response.status_code} {response.text[:500]}")
        return response.json() if response.is_success else None

    async def _finish(self, client: httpx.AsyncClient) -> None:
        deadline = time.monotonic() + FINISH_TIMEOUT_S
        while len(self.digests) < len(self.campaigns) and time.monotonic() < deadline:
            self._site.restart_exited()
            await self._poll(client)
            self._progress("finished campaigns", len(self.digests), len(self.campaigns))
            await asyncio.sleep(_POLL_S)
        self.digests = {campaign: self.digests.get(campaign, "not finished") for campaign in self.campaigns}


def _run_undisturbed(
    plan: ChaosPlan, bodies: list[dict[str, Any]], folder: Path, progress: Progress
) -> list[str]:
    """Run the same campaigns on SQLite without faults; return the digests of their archives."""
    digests = []
    with (
        running_coordinator(folder, MODULE) as coordinator,
        running_workers(coordinator, plan.workers, folder, MODULE),
        httpx.Client(base_url=f"{coordinator.url}/api/v1", timeout=30.0) as client,
    ):
        campaigns = [client.post("/campaigns", json=body).raise_for_status().json()["id"] for body in bodies]
        for index, campaign in enumerate(campaigns):
            while (found := client.get(f"/campaigns/{campaign}/progress").json())["status"] == "running":
                progress("undisturbed campaigns", index, len(campaigns))
                time.sleep(_POLL_S)
            if found["status"] != "finished":
                raise MeasurementFailed(f"undisturbed campaign {campaign} is {found['status']}")
            digests.append(str(found["digest"]))
        progress("undisturbed campaigns", len(campaigns), len(campaigns))
    return digests

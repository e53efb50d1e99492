"""The trial: campaigns while everything breaks, then the same ones undisturbed, then the audit."""

import asyncio
import random
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from brink.bench.chaos.ledger import Findings, Ledger, audit
from brink.bench.chaos.proxy import FaultyProxy
from brink.bench.chaos.site import Site
from brink.bench.load.problem import LOAD, MODULE
from brink.bench.telling import Told
from brink.bench.temporary.coordinator import CoordinatorProcess, DidNotStart, Process, worker_command
from brink.bench.temporary.postgres import temporary_postgres
from brink.server.db.engine import open_engines
from brink.sim.catalogue import PLUGINS_VARIABLE

ENVIRONMENT = {
    "BRINK_LEASE_S": "3", "BRINK_SWEEP_S": "0.5", "BRINK_RETRY_BACKOFF_S": "0.2", "BRINK_WORKER_SEEN_S": "10",
}  # fmt: skip
AT_ONCE = 2
"""Campaigns that run side by side."""
PATIENCE_S = 240.0
"""How long the campaigns may take to end once nothing breaks any more."""
_LOOK_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ChaosPlan:
    """What a trial does.

    Attributes:
        minutes: How long things break, at least.
        faults: How many processes, connections and databases are broken, at least.
        every_s: Mean time between two of these.
        share: Share of the messages that something happens to.
        simulations: Of each campaign.
        drives: Whether episodes are driven, or only wait for a moment.
        seed: Of everything that is drawn.
        workers: Of the undisturbed run.
        plugins: Modules that coordinators and workers of the trial import besides.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class ChaosOutcome:
    """What came of it.

    Attributes:
        broken: How often each thing was broken.
        messages: What happened to messages.
        requests: How many messages there were.
        statuses: What was answered to results.
        campaigns: Campaigns that were submitted, and their simulations.
        digests: For each campaign the digest of its archive in the trial, and undisturbed.
        findings: What is wrong.
        own_ends: Of each process that ended by itself, and was started again, what it was and its last words.
        minutes: How long things broke.
    """

    broken: Counter[str]
    messages: Counter[str]
    requests: int
    statuses: Counter[str]
    campaigns: Mapping[str, int]
    digests: Mapping[str, tuple[str, str]]
    findings: Findings
    own_ends: tuple[str, ...] = ()
    minutes: float = 0.0

    @property
    def same(self) -> int:
        """How many archives are those of the undisturbed run."""
        return sum(ours == theirs for ours, theirs in self.digests.values())


def run_trial(plan: ChaosPlan, told: Told) -> ChaosOutcome:
    """Run a trial.

    Args:
        plan: What to do.
        told: Hears how far it is: a part, what is done, of how much.

    Raises:
        NoPostgres: There is none for the trial.
        DidNotStart: A process did not come up.
    """
    with tempfile.TemporaryDirectory(prefix="brink-chaos-") as name, temporary_postgres() as server:
        folder = Path(name)
        environment = {**ENVIRONMENT, PLUGINS_VARIABLE: ",".join((MODULE, *plan.plugins))}
        trial = _Trial(plan, told, Site(server, server.database("chaos"), folder, environment, _rng(plan, 1)))
        ledger = Ledger()
        asyncio.run(trial.run(ledger))
        engines = open_engines(trial.database)
        try:
            with engines.reader.connect() as connection:
                findings = audit(connection, ledger, trial.campaigns)
        finally:
            engines.dispose()
        undisturbed = _undisturbed(plan, list(trial.bodies.values()), folder, told)
    return ChaosOutcome(
        broken=trial.site.faults, messages=trial.messages, requests=trial.requests, statuses=ledger.statuses,
        campaigns=trial.campaigns, findings=findings, own_ends=tuple(trial.site.own_ends), minutes=trial.minutes,
        digests={
            campaign: (ours, theirs)
            for (campaign, ours), theirs in zip(trial.digests.items(), undisturbed, strict=True)
        },
    )  # fmt: skip


class _Trial:
    def __init__(self, plan: ChaosPlan, told: Told, site: Site) -> None:
        self.site = site
        self.campaigns: dict[str, int] = {}
        self.bodies: dict[str, dict[str, Any]] = {}
        self.digests: dict[str, str] = {}
        self.messages: Counter[str] = Counter()
        self.requests = 0
        self.minutes = 0.0
        self._plan = plan
        self._told = told
        self._picks = _rng(plan, 4)

    @property
    def database(self) -> str:
        """URL of the database."""
        return self.site.database

    async def run(self, ledger: Ledger) -> None:
        """Run campaigns while things break, then let them end."""
        plan = self._plan
        ports = [coordinator.port for coordinator in self.site.coordinators]
        async with FaultyProxy(ports, ledger, share=plan.share, rng=_rng(plan, 2)) as proxy:
            for coordinator in self.site.coordinators:  # one after the other: the first makes the database
                await asyncio.to_thread(coordinator.start_ready)
            self.site.start(proxy.url)
            try:
                async with httpx.AsyncClient(timeout=10.0) as client:
                    await self._break(client)
                    proxy.share = 0.0
                    await self.site.mend()
                    await self._finish(client)
            finally:
                self.site.stop()
            self.messages, self.requests = proxy.faults, proxy.requests

    async def _break(self, client: httpx.AsyncClient) -> None:
        plan, began, rng = self._plan, time.monotonic(), _rng(self._plan, 3)
        next_break, next_look = began, began
        while (now := time.monotonic()) - began < 60 * plan.minutes or self._broken < plan.faults:
            if now >= next_break:
                await self.site.break_something()
                next_break = now + rng.expovariate(1 / plan.every_s)
            if now >= next_look:
                self.site.revive()
                await self._keep_busy(client)
                self._told("breaking things", int(now - began), int(60 * plan.minutes))
                next_look = now + _LOOK_S
            await asyncio.sleep(0.05)
        self.minutes = (time.monotonic() - began) / 60

    @property
    def _broken(self) -> int:
        return sum(self.site.faults.values())

    async def _keep_busy(self, client: httpx.AsyncClient) -> None:
        """Submit campaigns so that some always run; one that cannot be asked about counts as running."""
        running = 0
        for campaign in self.campaigns:
            if campaign not in self.digests:
                stands = await self._ask(client, "GET", f"/campaigns/{campaign}/progress?since=1000000")
                if stands is not None and stands["status"] == "finished":
                    self.digests[campaign] = stands["digest"]
                else:
                    running += 1
        while running < AT_ONCE:
            body = _body(self._plan, len(self.campaigns))
            key = {"Idempotency-Key": f"trial-{body['seed']}"}
            submitted = await self._ask(client, "POST", "/campaigns", json=body, headers=key)
            if submitted is None:
                return
            self.campaigns[submitted["id"]] = body["budget"]["simulations"]
            self.bodies[submitted["id"]] = body
            running += 1

    async def _ask(self, client: httpx.AsyncClient, method: str, path: str, **more: Any) -> Any | None:
        """Ask any coordinator; None if it did not answer, or cannot now.

        Raises:
            DidNotStart: It refused, which has nothing to do with faults.
        """
        coordinator = self._picks.choice(self.site.coordinators)
        try:
            response = await client.request(method, f"{coordinator.url}/api/v1{path}", **more)
        except httpx.TransportError:
            return None
        if response.is_client_error:
            raise DidNotStart(f"{method} {path}: {response.status_code} {response.text[:500]}")
        return response.json() if response.is_success else None

    async def _finish(self, client: httpx.AsyncClient) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while len(self.digests) < len(self.campaigns) and time.monotonic() < deadline:
            self.site.revive()
            for campaign in self.campaigns.keys() - self.digests.keys():
                stands = await self._ask(client, "GET", f"/campaigns/{campaign}/progress?since=1000000")
                if stands is not None and stands["status"] == "finished":
                    self.digests[campaign] = stands["digest"]
            self._told("campaigns that ended", len(self.digests), len(self.campaigns))
            await asyncio.sleep(_LOOK_S)
        for campaign in self.campaigns:
            self.digests.setdefault(campaign, "not finished")
        self.digests = {campaign: self.digests[campaign] for campaign in self.campaigns}


def _undisturbed(plan: ChaosPlan, bodies: list[dict[str, Any]], folder: Path, told: Told) -> list[str]:
    """Run the same campaigns on SQLite with nothing in the way; return the digests of their archives."""
    coordinator = CoordinatorProcess(
        f"sqlite:///{folder}/undisturbed.db", folder / "undisturbed.log", {PLUGINS_VARIABLE: MODULE}
    )
    workers = [
        Process(
            worker_command(coordinator.url), folder / "undisturbed-worker.log", {PLUGINS_VARIABLE: MODULE}
        )
        for _ in range(plan.workers)
    ]
    digests = []
    try:
        coordinator.start_ready()
        for worker in workers:
            worker.start()
        with httpx.Client(base_url=f"{coordinator.url}/api/v1", timeout=30.0) as client:
            campaigns = [
                client.post("/campaigns", json=body).raise_for_status().json()["id"] for body in bodies
            ]
            for index, campaign in enumerate(campaigns):
                while (stands := client.get(f"/campaigns/{campaign}/progress").json())["status"] == "running":
                    told("the same undisturbed", index, len(campaigns))
                    time.sleep(_LOOK_S)
                if stands["status"] != "finished":
                    raise DidNotStart(f"undisturbed campaign {campaign} is {stands['status']}")
                digests.append(str(stands["digest"]))
            told("the same undisturbed", len(campaigns), len(campaigns))
    finally:
        for process in (*workers, coordinator):
            process.kill()
    return digests


def _body(plan: ChaosPlan, index: int) -> dict[str, Any]:
    algorithms: tuple[dict[str, Any], ...] = (
        {"id": "mlcshe@1"},
        {"id": "ga@1"},
        {"id": "random@1", "params": {"generation_size": 60}},
    )
    if plan.drives:
        problem: dict[str, Any] = {"id": "urban-injected@1"}
    else:
        problem = {"id": LOAD, "params": {"mean_s": 0.05}}
    return {
        "name": f"trial {index}", "problem": problem, "algorithm": algorithms[index % len(algorithms)],
        "budget": {"simulations": plan.simulations}, "seed": plan.seed * 1000 + index,
        "execution": {"max_attempts": 20, "keep_traces": 0},
    }  # fmt: skip


def _rng(plan: ChaosPlan, stream: int) -> random.Random:
    return random.Random(f"{plan.seed}/{stream}")

"""A coordinator with a worker and campaigns of every state, for pages to look at.

The urban campaign is simulated for real. The ball is judged by `faulty@1` in the same worker: it takes no time, and
breaks down where it is told to.
"""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
from support.api import ball, eventually, expect, listening_coordinator, progress, submit
from support.problems import small_problems
from support.processes import Program

API = "/api/v1"
PATIENCE_S = 90.0

URBAN: dict[str, Any] = {
    "name": "night rain",
    "problem": {"id": "urban-injected@1", "params": {"duration_s": 20.0}},
    "algorithm": {"id": "mlcshe@1", "params": {"population_size": 4}},
    "budget": {"simulations": 40},
    "seed": 8,
}
TRAFFIC: dict[str, Any] = {
    "name": "hostile traffic",
    "problem": {"id": "npc-actions@1", "params": {"participants": 3, "duration_s": 12.0}},
    "algorithm": {"id": "mumoea@1", "params": {"population_size": 20}},
    "budget": {"simulations": 20},
    "seed": 1,
}
SECRET = "correct-horse"
"""The token of a coordinator that asks for one."""

LOOSE = {"t_b": 1, "d_th": 0}
"""Thresholds at which so small a campaign has boundary solutions: all of them."""

LOOSELY = "?t_b=1&d_th=0"
"""The same in an address."""

BROKEN = ball(
    name="broken",
    simulations=30,
    problem={"id": "ball@1", "params": {"fault": "crashed", "fault_from": 0.5}},
    execution={"max_attempts": 1, "max_failed_share": 1.0},
)
"""The ball with a simulator that crashes in the east."""

NOBODYS = {"id": "ball@1", "params": {"needs": "nobody-has-it@1"}}
"""The ball on a simulator that no worker has: its campaigns run, and get nowhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """What is there.

    Attributes:
        client: Of the coordinator.
        urban: A finished campaign in urban traffic, with traces kept.
        ball: A finished campaign on the ball, with boundary solutions.
        broken: A campaign with jobs in quarantine.
        stuck: A running campaign whose jobs no worker can run.
        experiment: Two algorithms on the ball with two seeds.
    """

    client: httpx.Client
    urban: str
    ball: str
    broken: str
    stuck: str
    experiment: str

    @property
    def url(self) -> str:
        """Where it listens."""
        return origin(self.client)


def origin(client: httpx.Client) -> str:
    """Return the URL of a client's coordinator."""
    return str(client.base_url).rstrip("/")


@contextmanager
def worker(url: str, folder: Path, *options: str) -> Iterator[Program]:
    """Run a worker process until the end of the block."""
    command = [sys.executable, "-m", "brink.worker", "--server", url, "--memory", "512", *options]
    with Program(command, cwd=folder) as program:
        yield program


@contextmanager
def served(database_url: str, folder: Path) -> Iterator[Served]:
    """Serve campaigns that have ended, and some that never will, until the end of the block."""
    with (
        small_problems(),
        listening_coordinator(database_url) as client,
        worker(origin(client), folder, "--plugin", "faulty_simulator") as program,
    ):
        made = Served(
            client=client,
            urban=submit(client, URBAN),
            ball=submit(client, ball(name="ball", simulations=60)),
            broken=submit(client, BROKEN),
            stuck=submit(client, ball(name="stuck", problem=NOBODYS)),
            experiment=_experiment(client),
        )
        _await_end(client, {made.urban, made.ball, made.broken}, program)
        eventually(
            lambda: _experiment_status(client, made.experiment) == "finished", program.output, PATIENCE_S
        )
        yield made


def unsafe_one(site: Served) -> dict[str, Any]:
    """Return a boundary solution of the urban campaign that is unsafe."""
    told = expect(site.client.get(f"{API}/campaigns/{site.urban}/boundary", params=LOOSE))
    found: dict[str, Any] = next(one for one in told["solutions"] if one["verdict"] == "unsafe")
    return found


ANY_PAIR = "?eps=1&d_th=0.4"
"""Part of an address: thresholds at which this small campaign has a few pairs; with a lower d_th it has hundreds."""


def a_pair(client: httpx.Client, campaign: str, query: str = ANY_PAIR) -> tuple[dict[str, Any], str]:
    """Return the first pair of a campaign, and the address of its page."""
    told = expect(client.get(f"{API}/campaigns/{campaign}/pairs{query}"))
    found: dict[str, Any] = told["pairs"][0]
    numbers = f"{found['safe']['number']}-{found['unsafe']['number']}"
    return found, f"#/campaigns/{campaign}/pairs/{numbers}{query}"


def loose(campaign: str, tab: str = "overview") -> str:
    """Return the address of a tab of a campaign at thresholds at which it has boundary solutions."""
    return f"#/campaigns/{campaign}{LOOSELY}&tab={tab}"


def _experiment(client: httpx.Client) -> str:
    body: Mapping[str, Any] = {
        "name": "two on a ball",
        "problems": [{"id": "ball@1"}],
        "algorithms": [{"id": "ga@1", "params": {"population_size": 8}}, {"id": "random@1"}],
        "seeds": {"first": 1, "count": 2},
        "budget": {"simulations": 24},
        "pairs": {"eps": 1.0, "d_th": 0.0, "confirm": 0, "component": False},
    }
    return str(expect(client.post(f"{API}/experiments", json=dict(body)), 201)["id"])


def _experiment_status(client: httpx.Client, experiment: str) -> str:
    return str(expect(client.get(f"{API}/experiments/{experiment}"))["status"])


def _await_end(client: httpx.Client, campaigns: set[str], program: Program) -> None:
    def ended() -> bool:
        return all(progress(client, one)["status"] == "finished" for one in campaigns)

    eventually(ended, f"the campaigns finish: {program.output}", PATIENCE_S)

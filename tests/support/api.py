"""A coordinator in this process behind a real socket, and a worker that needs no simulator."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import httpx
from sqlalchemy import func, select

from brink.server.db.engine import Engines
from brink.server.db.models import Base
from brink.server.runtime.coordinator import EmbeddedCoordinator
from brink.server.settings import Settings
from brink.worker.wire import Completed, JobFailed, LeasedJob, LeaseReply
from support.problems import SIMULATOR, simulated

PATIENCE_S = 30.0
Judge = Callable[[LeasedJob], Completed | JobFailed]


def settings_for(database_url: str, **given: Any) -> Settings:
    """Return settings that make a coordinator quick."""
    return Settings(**{"database": database_url, "port": 0, "retry_backoff_s": 0.0, "sweep_s": 0.05, **given})


@contextmanager
def coordinator(database_url: str, **given: Any) -> Iterator[httpx.Client]:
    """Give a client of a coordinator that runs on a thread of this process until the end of the block."""
    serving = EmbeddedCoordinator(settings_for(database_url, **given))
    serving.start()
    try:
        token = given.get("token")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        with httpx.Client(base_url=serving.url, timeout=PATIENCE_S, headers=headers) as client:
            yield client
    finally:
        serving.stop()


def ball(*, seed: int = 1, simulations: int = 60, **changes: Any) -> dict[str, Any]:
    """Return a small campaign on the ball."""
    return {
        "name": "ball",
        "problem": {"id": "ball@1"},
        "algorithm": {"id": "ga@1", "params": {"population_size": 20, "mutation_probability": 0.5}},
        "budget": {"simulations": simulations},
        "seed": seed,
        **changes,
    }


def expect(response: httpx.Response, status: int = 200) -> Any:
    """Return the decoded answer if it has the expected status."""
    assert response.status_code == status, f"{response.status_code}: {response.text}"
    return response.json() if response.content and "json" in response.headers["content-type"] else None


def submit(client: httpx.Client, body: Mapping[str, Any]) -> str:
    """Submit a campaign and return its id."""
    return str(expect(client.post("/api/v1/campaigns", json=dict(body)), 201)["id"])


def progress(client: httpx.Client, campaign: str, since: int = 0) -> dict[str, Any]:
    """Return where a campaign stands."""
    found: dict[str, Any] = expect(
        client.get(f"/api/v1/campaigns/{campaign}/progress", params={"since": since})
    )
    return found


def eventually(condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
    """Wait until a condition holds; fail after a deadline."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, f"not within {patience_s:g} s: {what}"
        time.sleep(0.01)  # between two looks


def row_counts(engines: Engines) -> dict[str, int]:
    """Return how many rows each table has."""
    with engines.reader.connect() as connection:
        return {
            name: connection.execute(select(func.count()).select_from(table)).scalar_one()
            for name, table in Base.metadata.tables.items()
        }


def completes(job: LeasedJob) -> Completed | JobFailed:
    """Judge a job of the ball as its simulator would."""
    return simulated(job.spec)


@dataclass
class FakeWorker:
    """Leases and reports over the API; judges in this process."""

    client: httpx.Client
    id: str = "worker-1"
    capabilities: tuple[str, ...] = (SIMULATOR,)
    judge: Judge = completes
    statuses: list[str] = field(default_factory=list)

    @property
    def identity(self) -> dict[str, Any]:
        """Who this worker says it is."""
        return {"id": self.id, "host": "here", "pid": 1, "version": "0"}

    def lease(self, max_jobs: int = 8, wait_s: float = 0.0) -> list[LeasedJob]:
        """Lease jobs."""
        body = {
            "worker": self.identity, "capabilities": list(self.capabilities), "max_jobs": max_jobs,
            "wait_s": wait_s,
        }  # fmt: skip
        return LeaseReply.model_validate(expect(self.client.post("/api/v1/jobs/lease", json=body))).jobs

    def report(self, jobs: list[LeasedJob], **more: Any) -> list[str]:
        """Judge jobs, report them, and return what became of each."""
        results = [
            {"job": job.job, "token": job.token, "outcome": self.judge(job).model_dump(mode="json")}
            for job in jobs
        ]
        body = {"worker": self.identity, "results": results, **more}
        reply = expect(self.client.post("/api/v1/jobs/results", json=body))
        statuses = [str(item["status"]) for item in reply["statuses"]]
        self.statuses += statuses
        return statuses

    def work(self, campaign: str, *, until: Callable[[dict[str, Any]], bool] | None = None) -> dict[str, Any]:
        """Work until a campaign is no longer running, or a condition on its progress holds; return its progress."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            jobs = self.lease(wait_s=0.2)
            if jobs:
                self.report(jobs)
            stands = progress(self.client, campaign)
            if stands["status"] != "running" or (until is not None and until(stands)):
                return stands
            assert time.monotonic() < deadline, f"campaign {campaign} did not get there: {stands}"

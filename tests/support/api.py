"""A coordinator in this process, and a fake worker that needs no simulator."""

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import httpx
from anyio.from_thread import BlockingPortal, start_blocking_portal
from sqlalchemy import func, select

from brink.search import surrogate
from brink.search.algorithm import ask_all
from brink.search.archive import archive_digest
from brink.server.app import create_app
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.deletion import marked_campaigns
from brink.server.campaigns.plan import make_plan, new_solutions
from brink.server.db.engine import Engines
from brink.server.db.models import Base
from brink.server.runtime.coordinator import EmbeddedCoordinator
from brink.server.settings import Settings
from brink.worker.wire import Completed, JobFailed, LeasedJob, LeaseReply, WireVerdict
from support.problems import SIMULATOR, Ball, simulated

PATIENCE_S = 90.0
Judge = Callable[[LeasedJob], Completed | JobFailed]


def settings_for(database_url: str, **changes: Any) -> Settings:
    """Return a coordinator's settings for tests: any free port, and no wait before a failed job is retried."""
    return Settings(**{"database": database_url, "port": 0, "retry_backoff_s": 0.0, **changes})


class _InProcess(httpx.BaseTransport):
    """Sends the requests of a synchronous client to an app that runs in another thread's event loop."""

    def __init__(self, app: Any, portal: BlockingPortal) -> None:
        self._asgi = httpx.ASGITransport(app, raise_app_exceptions=False)
        self._portal = portal

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        request.read()
        return self._portal.call(self._answer, request)

    async def _answer(self, request: httpx.Request) -> httpx.Response:
        answer = await self._asgi.handle_async_request(request)
        assert isinstance(answer.stream, httpx.AsyncByteStream)
        body = b"".join([part async for part in answer.stream])
        return httpx.Response(answer.status_code, headers=answer.headers, stream=httpx.ByteStream(body))


@contextmanager
def coordinator(database_url: str, *, sweeping: bool = True, **settings: Any) -> Iterator[httpx.Client]:
    """Run a coordinator in this process, without a socket.

    Args:
        database_url: A migrated database.
        sweeping: As for `create_app`.
        settings: Changes to `settings_for`.

    Yields:
        A client that sends the coordinator's own token, if one is set.
    """
    app = create_app(settings_for(database_url, **settings), sweeping=sweeping)
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(app.router.lifespan_context(app)),
        httpx.Client(
            transport=_InProcess(app, portal), base_url="http://127.0.0.1", headers=_bearer(settings)
        ) as client,
    ):
        try:
            yield client
        finally:
            portal.call(app.state.context.queue.end_waits)


@contextmanager
def listening_coordinator(database_url: str, **settings: Any) -> Iterator[httpx.Client]:
    """Run a coordinator in this process that listens on a socket, for commands, browsers and broken connections.

    Args:
        database_url: A migrated database.
        settings: Changes to `settings_for`.

    Yields:
        A client that sends the coordinator's own token, if one is set; its ``base_url`` is the coordinator's address.
    """
    served = EmbeddedCoordinator(settings_for(database_url, **settings))
    served.start()
    try:
        with httpx.Client(base_url=served.url, timeout=PATIENCE_S, headers=_bearer(settings)) as client:
            yield client
    finally:
        served.stop()


def _bearer(settings: Mapping[str, Any]) -> dict[str, str]:
    token = settings.get("token")
    return {"Authorization": f"Bearer {token}"} if token else {}


def ball(*, seed: int = 1, simulations: int = 60, **changes: Any) -> dict[str, Any]:
    """Return the body of a small campaign on the ball."""
    return {
        "name": "ball",
        "problem": {"id": "ball@1"},
        "algorithm": {"id": "ga@1", "params": {"population_size": 20, "mutation_probability": 0.5}},
        "budget": {"simulations": simulations},
        "seed": seed,
        **changes,
    }


def undisturbed_digest(document: dict[str, Any]) -> str:
    """Return the archive digest of a campaign on the ball, from its algorithm alone, without a coordinator."""
    return _digest(json.dumps(document), surrogate.TREES)


@lru_cache
def _digest(document: str, trees: int) -> str:
    """As `undisturbed_digest`, which many tests ask for the same campaign; what it finds depends on the `trees`."""
    body = parse_body(json.loads(document))
    plan = make_plan(body)
    assert isinstance(plan.problem, Ball)
    algorithm = plan.algorithm
    state = algorithm.start(plan.problem.space, plan.config, seed=body.seed, budget=body.budget.simulations)
    while not algorithm.finished(state):
        state, _ = ask_all(algorithm, state)
        candidates = state.pending
        solutions = new_solutions(plan.problem, candidates, {}, body.seed)
        evaluations = {}
        for candidate, solution in zip(candidates, solutions, strict=True):
            spec = plan.problem.episode(candidate.vectors, solution.seed)
            evaluations[candidate.number] = plan.problem.evaluation(simulated(spec.to_json()))
        state = algorithm.tell(state, evaluations)
    return archive_digest(state.archive)


def expect(response: httpx.Response, status: int = 200) -> Any:
    """Return the decoded JSON of a response; fail unless it has the expected status."""
    assert response.status_code == status, f"{response.status_code}: {response.text}"
    return response.json() if response.content and "json" in response.headers["content-type"] else None


def submit(client: httpx.Client, body: Mapping[str, Any]) -> str:
    """Submit a campaign and return its id."""
    return str(expect(client.post("/api/v1/campaigns", json=dict(body)), 201)["id"])


def progress(client: httpx.Client, campaign: str, since: int = 0) -> dict[str, Any]:
    """Return the progress of a campaign, with its generations from `since` on."""
    found: dict[str, Any] = expect(
        client.get(f"/api/v1/campaigns/{campaign}/progress", params={"since": since})
    )
    return found


def solutions(client: httpx.Client, campaign: str) -> list[dict[str, Any]]:
    """Return the solutions of a campaign, at most 1,000."""
    page = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 1000}))
    found: list[dict[str, Any]] = page["solutions"]
    return found


def reached(simulations: int) -> Callable[[dict[str, Any]], bool]:
    """Return the condition that so many simulations of a campaign are done."""
    return lambda stands: bool(stands["simulations"] >= simulations)


def eventually(condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
    """Wait until a condition holds; fail after a deadline."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, f"not within {patience_s:g} s: {what}"
        time.sleep(0.01)  # between two looks


def row_counts(engines: Engines) -> dict[str, int]:
    """Return the number of rows of each table, except for the time of the last sweep, which no request writes."""
    with engines.reader.connect() as connection:
        return {
            name: connection.execute(select(func.count()).select_from(table)).scalar_one()
            for name, table in Base.metadata.tables.items()
            if name != "sweeps"
        }


def await_erasure(engines: Engines) -> None:
    """Wait until all rows of deleted campaigns are erased."""

    def is_erased() -> bool:
        with engines.reader.connect() as connection:
            return not marked_campaigns(connection)

    eventually(is_erased, "deleted campaigns are erased")


def completes(job: LeasedJob) -> Completed | JobFailed:
    """Return the outcome that the simulator of the ball would give."""
    return simulated(job.spec)


def perturbed(job: LeasedJob) -> Completed | JobFailed:
    """As `completes`, but let a perturbation of at least a medium intensity be unsafe.

    The jobs of other campaigns are completed, too: those that record the traces of a campaign which has finished wait
    for whoever comes next.
    """
    if "strong" not in job.spec["behaviour"]:
        return completes(job)
    robustness = 0.5 - job.spec["behaviour"]["strong"]
    return Completed(
        verdicts={"distance@1": WireVerdict(robustness=robustness, unit="m", violated_at_s=None)}
    )


@dataclass
class FakeWorker:
    """Leases and reports over the API, and makes up the outcomes in this process.

    Attributes:
        client: Of the coordinator.
        id: The worker's id.
        capabilities: Simulators that it says it can run.
        judge: Returns the outcome of a job.
        statuses: What the coordinator answered to each result so far.
    """

    client: httpx.Client
    id: str = "worker-1"
    capabilities: tuple[str, ...] = (SIMULATOR,)
    judge: Judge = completes
    statuses: list[str] = field(default_factory=list)

    @property
    def identity(self) -> dict[str, Any]:
        """The worker's identity as it stands in requests."""
        return {"id": self.id, "host": "here", "pid": 1, "version": "0"}

    def lease(self, max_jobs: int = 8, wait_s: float = 0.0) -> list[LeasedJob]:
        """Lease jobs."""
        answer = self.client.post("/api/v1/jobs/lease", json=self._wanted(max_jobs, wait_s))
        return LeaseReply.model_validate(expect(answer)).jobs

    def lease_all(self) -> list[LeasedJob]:
        """Lease jobs until there are none left."""
        jobs: list[LeasedJob] = []
        while more := self.lease():
            jobs += more
        return jobs

    def report(self, jobs: list[LeasedJob], **more: Any) -> list[str]:
        """Report the outcomes of jobs, and return the status of each."""
        return self._report(jobs, **more)[0]

    def report_all(self) -> None:
        """Lease and report until there are no jobs left."""
        jobs = self.lease()
        while jobs:
            jobs = self._report(jobs, lease=self._wanted(64, 0.0))[1]

    def work(self, campaign: str, *, until: Callable[[dict[str, Any]], bool] | None = None) -> dict[str, Any]:
        """Work until a campaign is no longer running, or a condition on its progress holds.

        Args:
            campaign: Its id.
            until: A condition on its progress, checked after each report; the worker then holds no jobs.

        Returns:
            The campaign's progress.
        """
        deadline = time.monotonic() + PATIENCE_S
        while True:
            jobs = self.lease(max_jobs=8 if until else 64, wait_s=0.2)
            while jobs and until is None:
                jobs = self._report(jobs, lease=self._wanted(64, 0.0))[1]
            if jobs:
                self.report(jobs)
            found = progress(self.client, campaign)
            if found["status"] != "running" or (until is not None and until(found)):
                return found
            assert time.monotonic() < deadline, f"campaign {campaign} did not get there: {found}"

    def _wanted(self, max_jobs: int, wait_s: float) -> dict[str, Any]:
        return {
            "worker": self.identity,
            "capabilities": list(self.capabilities),
            "max_jobs": max_jobs,
            "wait_s": wait_s,
        }

    def _report(self, jobs: list[LeasedJob], **more: Any) -> tuple[list[str], list[LeasedJob]]:
        """Report outcomes; return the statuses, and the jobs of the next lease if `more` asks for one."""
        results = [
            {"job": job.job, "token": job.token, "outcome": self.judge(job).model_dump(mode="json")}
            for job in jobs
        ]
        body = {"worker": self.identity, "results": results, **more}
        reply = expect(self.client.post("/api/v1/jobs/results", json=body))
        statuses = [str(item["status"]) for item in reply["statuses"]]
        self.statuses += statuses
        lease = reply.get("lease")
        return statuses, LeaseReply.model_validate(lease).jobs if lease else []


def finish(client: httpx.Client, body: Mapping[str, Any], judge: Judge = completes) -> str:
    """Submit a campaign, work until it has finished, and return its id."""
    campaign = submit(client, body)
    done = FakeWorker(client, judge=judge).work(campaign)
    assert done["status"] == "finished", done["status_reason"]
    return campaign

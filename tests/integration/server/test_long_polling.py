"""Long polling for jobs: waking workers, clients that disconnect, retries by other workers."""

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from datetime import timedelta
from typing import Any

import httpx
import psycopg
import pytest
from sqlalchemy import select, update
from support.api import (
    FakeWorker,
    ball,
    coordinator,
    eventually,
    expect,
    listening_coordinator,
    progress,
    settings_for,
    submit,
)
from support.databases import on_postgres, sqlite_then_postgres
from support.queue import Queue

from brink.server.api.context import Context
from brink.server.app import create_app
from brink.server.db.engine import Engines
from brink.server.db.models import JobRow
from brink.server.db.sql import database_now
from brink.server.queue import lease_store, service
from brink.worker.wire import HeldLease, JobFailed, LeasedJob, LeaseRequest, ResultsRequest, WorkerIdentity

PATIENCE_S = 30.0
NEWS_S = 10.0
"""Limit for a wake-up, shorter than the wait of a worker, which ends with another look at the queue."""


@pytest.fixture
def no_rechecks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have waiting workers rely on wake-ups alone."""
    for pause in ("RECHECK_S", "SHARED_RECHECK_S"):
        monkeypatch.setattr(service, pause, 10 * PATIENCE_S)


def wait_in_thread(worker: FakeWorker, wait_s: float = PATIENCE_S) -> tuple[threading.Thread, list[Any]]:
    got: list[Any] = []
    thread = threading.Thread(target=lambda: got.extend(worker.lease(wait_s=wait_s)))
    thread.start()
    return thread, got


@pytest.mark.usefixtures("no_rechecks")
def test_submission_wakes_a_waiting_worker(client: httpx.Client) -> None:
    worker = FakeWorker(client)
    thread, got = wait_in_thread(worker)
    eventually(lambda: len(expect(client.get("/api/v1/workers"))) == 1, "the worker asked")
    submit(client, ball())
    thread.join(NEWS_S)
    assert len(got) == 8


def test_wait_ends_without_jobs(client: httpx.Client) -> None:
    began = time.monotonic()
    assert FakeWorker(client).lease(wait_s=0.3) == []
    assert time.monotonic() - began >= 0.3


@pytest.mark.usefixtures("no_rechecks")
def test_next_generation_wakes_a_waiting_worker(client: httpx.Client) -> None:
    worker, campaign = FakeWorker(client), submit(client, ball())
    jobs = worker.lease_all()
    thread, got = wait_in_thread(FakeWorker(client, id="worker-2"))
    eventually(lambda: len(expect(client.get("/api/v1/workers"))) == 2, "the second worker asked")
    worker.report(jobs)
    thread.join(NEWS_S)
    assert got
    assert progress(client, campaign)["generation"] == 1


def test_results_request_can_ask_for_the_next_lease(client: httpx.Client) -> None:
    worker = FakeWorker(client)
    submit(client, ball())
    jobs = worker.lease(max_jobs=2)
    body = {
        "worker": worker.identity,
        "results": [
            {"job": j.job, "token": j.token, "outcome": worker.judge(j).model_dump(mode="json")} for j in jobs
        ],
        "lease": {"worker": worker.identity, "capabilities": ["faulty@1"], "max_jobs": 3, "wait_s": 0},
    }
    reply = expect(client.post("/api/v1/jobs/results", json=body))
    assert [item["status"] for item in reply["statuses"]] == ["accepted", "accepted"]
    assert len(reply["lease"]["jobs"]) == 3


@pytest.mark.usefixtures("no_rechecks")
def test_released_job_wakes_a_waiting_worker(client: httpx.Client) -> None:
    worker = FakeWorker(client)
    submit(client, ball())
    jobs = worker.lease_all()
    thread, got = wait_in_thread(FakeWorker(client, id="worker-2"))
    eventually(lambda: len(expect(client.get("/api/v1/workers"))) == 2, "the second worker asked")
    worker.report([], release=[HeldLease(job=jobs[0].job, token=jobs[0].token).model_dump()])
    thread.join(NEWS_S)
    assert [(job.job, job.attempt) for job in got] == [(jobs[0].job, 1)]


def test_expired_lease_cannot_be_renewed_nor_reported_once_another_worker_has_the_job(
    database_url: str, small_problems: None
) -> None:
    with coordinator(database_url, lease_s=1.0, sweep_s=0.05) as client:
        worker, campaign = FakeWorker(client), submit(client, ball())
        lost = worker.lease(max_jobs=1)
        eventually(lambda: progress(client, campaign)["leased"] == 0, "the leases run out")
        heartbeat = {"worker": worker.identity, "leases": [{"job": j.job, "token": j.token} for j in lost]}
        assert expect(client.post("/api/v1/jobs/heartbeat", json=heartbeat))["held"] == []
        again = FakeWorker(client, id="worker-2").lease(max_jobs=1)
        assert [job.job for job in again] == [job.job for job in lost]
        assert worker.report(lost) == ["stale"]


@pytest.mark.usefixtures("small_problems", "no_rechecks")
def test_job_of_an_expired_lease_goes_to_a_waiting_worker(database_url: str) -> None:
    async def body(context: Context, client: httpx.AsyncClient) -> None:
        await client.post("/api/v1/campaigns", json=ball(simulations=20))
        held = []
        while granted := (await context.queue.lease(request("w1", wait_s=0), asyncio.Event())).jobs:
            held += granted
        waiting = asyncio.create_task(context.queue.lease(request("w2"), asyncio.Event()))
        await waiters(context, 1)
        lost = held[0].job
        with context.engines.writer.begin() as connection:
            past = database_now(connection) - timedelta(seconds=1)
            connection.execute(update(JobRow).where(JobRow.id == lost).values(lease_expires_at=past))
        await context.queue.sweep()
        async with asyncio.timeout(NEWS_S):
            assert [(job.job, job.attempt) for job in (await waiting).jobs] == [(lost, 2)]

    on_services(database_url, body)


@sqlite_then_postgres
def test_a_heartbeat_renews_a_lease(client: httpx.Client, engines: Engines) -> None:
    worker = FakeWorker(client)
    submit(client, ball())
    (job,) = worker.lease(max_jobs=1)
    with engines.writer.begin() as connection:
        nearly_over = database_now(connection) + timedelta(seconds=20)
        connection.execute(update(JobRow).where(JobRow.id == job.job).values(lease_expires_at=nearly_over))
    heartbeat = {"worker": worker.identity, "leases": [{"job": job.job, "token": job.token}]}
    assert expect(client.post("/api/v1/jobs/heartbeat", json=heartbeat))["held"] == [job.job]
    with engines.reader.connect() as connection:
        expires_at = connection.execute(
            select(JobRow.lease_expires_at).where(JobRow.id == job.job)
        ).scalar_one()
    assert expires_at is not None
    assert expires_at > nearly_over, "a lease takes 60 s"
    assert worker.report([job]) == ["accepted"]


@asynccontextmanager
async def services(database_url: str) -> AsyncIterator[tuple[Context, httpx.AsyncClient]]:
    """Run an app in this event loop; yield its services and a client."""
    app = create_app(settings_for(database_url, sweep_s=60.0))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://127.0.0.1") as client,
    ):
        yield app.state.context, client


def on_services(database_url: str, body: Callable[[Context, httpx.AsyncClient], Awaitable[None]]) -> None:
    async def run() -> None:
        async with services(database_url) as (context, client):
            await asyncio.wait_for(body(context, client), PATIENCE_S)

    asyncio.run(run())


def request(worker: str, wait_s: float = PATIENCE_S) -> LeaseRequest:
    return LeaseRequest(worker=WorkerIdentity(id=worker), capabilities=["faulty@1"], wait_s=wait_s)


async def leased(client: httpx.AsyncClient) -> list[Any]:
    response = await client.get("/api/v1/jobs", params={"status": "leased"})
    return list(response.json()["jobs"])


async def waiters(context: Context, count: int) -> None:
    while len(context.queue.wakeups) < count:
        await asyncio.sleep(0.005)


@pytest.mark.usefixtures("small_problems")
def test_client_that_disconnects_while_waiting_gets_no_lease(database_url: str) -> None:
    async def body(context: Context, client: httpx.AsyncClient) -> None:
        gone = asyncio.Event()
        waiting = asyncio.create_task(context.queue.lease(request("w1"), gone))
        await waiters(context, 1)
        gone.set()
        assert (await waiting).jobs == []
        assert (await client.post("/api/v1/campaigns", json=ball())).status_code == 201
        assert await leased(client) == []

    on_services(database_url, body)


@pytest.mark.usefixtures("small_problems", "no_rechecks")
def test_wake_up_of_a_disconnected_client_goes_to_the_next(database_url: str) -> None:
    async def body(context: Context, client: httpx.AsyncClient) -> None:
        submitted = (await client.post("/api/v1/campaigns", json=ball(simulations=20))).json()
        held = []
        while granted := (await context.queue.lease(request("w0", wait_s=0), asyncio.Event())).jobs:
            held += granted
        gone = asyncio.Event()
        first = asyncio.create_task(context.queue.lease(request("w1"), gone))
        await waiters(context, 1)
        second = asyncio.create_task(context.queue.lease(request("w2"), asyncio.Event()))
        await waiters(context, 2)
        release = [HeldLease(job=held[0].job, token=held[0].token)]
        with context.engines.writer.begin() as connection:
            assert lease_store.release(connection, release) == 1
        context.queue.wakeups.wake(1)  # wakes the first client, which disconnects before it looks
        gone.set()
        async with asyncio.timeout(NEWS_S):
            assert (await first).jobs == []
            assert [job.job for job in (await second).jobs] == [held[0].job]
        assert submitted["status"] == "running"

    on_services(database_url, body)


@pytest.mark.usefixtures("small_problems")
@pytest.mark.parametrize("with_results", [False, True])
def test_lease_granted_to_a_disconnected_client_is_released(database_url: str, with_results: bool) -> None:
    async def body(context: Context, client: httpx.AsyncClient) -> None:
        await client.post("/api/v1/campaigns", json=ball())
        gone = asyncio.Event()
        wanted = request("w1")
        if with_results:
            asked = context.queue.results(
                ResultsRequest(worker=wanted.worker, results=[], lease=wanted), gone
            )
            asking: asyncio.Task[Any] = asyncio.create_task(asked)
        else:
            asking = asyncio.create_task(context.queue.lease(wanted, gone))
        await asyncio.sleep(0)  # the request has reached the writer by now
        gone.set()
        await asking
        assert await leased(client) == []
        jobs = (await client.get("/api/v1/jobs")).json()["jobs"]
        assert {job["attempt"] for job in jobs} == {0}

    on_services(database_url, body)


def test_connection_closed_while_waiting_gets_no_lease(listening_client: httpx.Client) -> None:
    def held() -> dict[str, int]:
        workers = expect(listening_client.get("/api/v1/workers"))
        return {worker["id"]: worker["jobs_held"] for worker in workers}

    async def wait_and_leave() -> None:
        wanted = request("impatient").model_dump(mode="json")
        async with httpx.AsyncClient(base_url=listening_client.base_url, timeout=PATIENCE_S) as impatient:
            waiting = asyncio.create_task(impatient.post("/api/v1/jobs/lease", json=wanted))
            await asyncio.to_thread(eventually, lambda: "impatient" in held(), "the worker asked")
            waiting.cancel()

    asyncio.run(wait_and_leave())
    submit(listening_client, ball())
    eventually(lambda: len(FakeWorker(listening_client, id="patient").lease(max_jobs=1)) == 1, "a lease")
    assert held()["impatient"] == 0


@pytest.mark.usefixtures("no_rechecks")
def test_stopping_coordinator_answers_waiting_workers(database_url: str, small_problems: None) -> None:
    with contextlib.ExitStack() as stack:
        with listening_coordinator(database_url) as client:
            own = stack.enter_context(httpx.Client(base_url=client.base_url, timeout=PATIENCE_S))
            thread, got = wait_in_thread(FakeWorker(own), wait_s=PATIENCE_S)
            eventually(lambda: len(expect(client.get("/api/v1/workers"))) == 1, "the worker asked")
            began = time.monotonic()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert got == []
    assert time.monotonic() - began < PATIENCE_S / 2


@pytest.mark.usefixtures("small_problems", "no_rechecks")
@on_postgres
def test_submission_wakes_workers_of_another_coordinator(database_url: str) -> None:
    with coordinator(database_url) as here, coordinator(database_url) as there:
        thread, got = wait_in_thread(FakeWorker(there))
        eventually(lambda: len(expect(there.get("/api/v1/workers"))) == 1, "the worker asked")
        submit(here, ball())
        thread.join(NEWS_S)
    assert len(got) == 8


@on_postgres
def test_generation_is_announced_once(engines: Engines) -> None:
    heard = psycopg.connect(
        engines.writer.url.set(drivername="postgresql").render_as_string(hide_password=False)
    )
    heard.autocommit = True
    heard.execute(b"LISTEN brink_jobs")
    Queue(engines=engines).campaign(200)
    assert len(list(heard.notifies(timeout=5.0, stop_after=1))) == 1
    assert list(heard.notifies(timeout=0.0)) == []
    heard.close()


pytestmark = pytest.mark.usefixtures("small_problems")


def crashes(job: LeasedJob) -> JobFailed:
    return JobFailed(reason="crashed", message="killed by SIGSEGV")


def fail_one(client: httpx.Client) -> tuple[FakeWorker, LeasedJob]:
    """Return a worker that failed one job of a campaign and completed the others, and the failed job."""
    bad = FakeWorker(client, id="bad", judge=crashes)
    submit(client, ball(simulations=20))
    job, *others = bad.lease_all()
    FakeWorker(client, id="bad").report(others)
    assert bad.report([job]) == ["accepted"]
    return bad, job


def test_failed_job_goes_to_another_live_worker(client: httpx.Client) -> None:
    good = FakeWorker(client, id="good")
    assert good.lease() == []
    bad, job = fail_one(client)
    assert bad.lease() == []
    assert [(again.job, again.attempt) for again in good.lease()] == [(job.job, 2)]


def test_failed_job_does_not_wait_for_workers_that_cannot_run_it(client: httpx.Client) -> None:
    assert FakeWorker(client, id="other", capabilities=("other@1",)).lease() == []
    bad, job = fail_one(client)
    assert [(again.job, again.attempt) for again in bad.lease()] == [(job.job, 2)]


def test_failed_job_does_not_wait_for_a_worker_that_is_gone(database_url: str) -> None:
    with coordinator(database_url, worker_seen_s=0.5) as client:
        assert FakeWorker(client, id="silent").lease() == []
        bad, job = fail_one(client)
        again: list[LeasedJob] = []

        def granted() -> bool:
            again.extend(bad.lease())
            return bool(again)

        eventually(granted, "the other worker counts as gone")
        assert [(a.job, a.attempt) for a in again] == [(job.job, 2)]


def test_a_worker_that_is_gone_and_its_leases_are_logged(
    database_url: str, small_problems: None, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)

    def logged(message: str) -> list[dict[str, Any]]:
        return [vars(record) for record in caplog.records if record.getMessage() == message]

    with coordinator(database_url, lease_s=1.0, worker_seen_s=0.2, sweep_s=0.05) as client:
        campaign = submit(client, ball())
        [job] = FakeWorker(client, id="gone").lease(max_jobs=1)
        eventually(lambda: bool(logged("lease ran out") and logged("worker gone")), "both are logged")
    [lost] = logged("lease ran out")
    assert (lost["campaign"], lost["job"], lost["worker"]) == (campaign, job.job, "gone")
    [gone] = logged("worker gone")
    assert (gone["worker"], gone["host"]) == ("gone", "here")

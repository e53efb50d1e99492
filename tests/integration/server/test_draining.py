"""Draining a worker: it keeps the jobs that it holds, gets no more, and is told to exit."""

import threading
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, coordinator, eventually, expect, submit
from support.databases import Databases, sqlite_then_postgres

from brink.server.access.tokens import allows
from brink.server.states import Scope

API = "/api/v1"


def wanted(worker: FakeWorker, **more: Any) -> dict[str, Any]:
    return {
        "worker": worker.identity,
        "capabilities": list(worker.capabilities),
        "max_jobs": 4,
        "wait_s": 0,
        **more,
    }


def ask(client: httpx.Client, worker: FakeWorker, **more: Any) -> dict[str, Any]:
    reply: dict[str, Any] = expect(client.post(f"{API}/jobs/lease", json=wanted(worker, **more)))
    return reply


def drain(client: httpx.Client, worker: str = "worker-1", status: int = 204) -> None:
    answer = client.post(f"{API}/workers/{worker}/drain")
    assert answer.status_code == status, answer.text


def listed(client: httpx.Client) -> dict[str, dict[str, Any]]:
    return {one["id"]: one for one in expect(client.get(f"{API}/workers"))}


def test_a_draining_worker_gets_no_jobs_but_its_results_are_accepted(client: httpx.Client) -> None:
    submit(client, ball())
    worker, other = FakeWorker(client), FakeWorker(client, id="other")
    jobs = worker.lease(max_jobs=3)
    assert "drain" not in ask(client, other), "workers that do not know it are not told of it"
    drain(client)
    assert ask(client, worker) == {"jobs": [], "lease_s": ask(client, other)["lease_s"], "drain": True}
    held = [{"job": job.job, "token": job.token} for job in jobs]
    renewed = expect(client.post(f"{API}/jobs/heartbeat", json={"worker": worker.identity, "leases": held}))
    assert renewed["held"] == sorted(job.job for job in jobs)
    results = [
        {"job": job.job, "token": job.token, "outcome": worker.judge(job).model_dump(mode="json")}
        for job in jobs
    ]
    reply = expect(
        client.post(
            f"{API}/jobs/results",
            json={"worker": worker.identity, "results": results, "lease": wanted(worker)},
        )
    )
    assert [one["status"] for one in reply["statuses"]] == ["accepted"] * 3
    assert (reply["lease"]["jobs"], reply["lease"]["drain"]) == ([], True)
    assert other.lease(), "the others go on"


@sqlite_then_postgres
def test_a_worker_that_waits_for_jobs_is_told_at_once(client: httpx.Client) -> None:
    worker = FakeWorker(client)
    replies: list[dict[str, Any]] = []
    waiting = threading.Thread(target=lambda: replies.append(ask(client, worker, wait_s=30)))
    waiting.start()
    eventually(lambda: "worker-1" in listed(client), "it waits")
    drain(client)
    waiting.join(timeout=20)
    assert [reply["drain"] for reply in replies] == [True]


def test_a_draining_worker_is_listed_as_such_and_no_longer_counts_as_able(client: httpx.Client) -> None:
    campaign = submit(client, ball())
    FakeWorker(client).lease(max_jobs=1)
    before = expect(client.get(f"{API}/campaigns/{campaign}/progress"))
    assert (before["workers"], before["unrunnable"]) == (1, {})
    drain(client)
    assert (listed(client)["worker-1"]["draining"], listed(client)["worker-1"]["live"]) == (True, True)
    after = expect(client.get(f"{API}/campaigns/{campaign}/progress"))
    assert after["workers"] == 0
    assert after["unrunnable"]


def test_another_process_with_the_same_id_gets_jobs(client: httpx.Client) -> None:
    submit(client, ball())
    worker = FakeWorker(client)
    worker.lease(max_jobs=1)
    drain(client)
    again = wanted(worker) | {"worker": {**worker.identity, "pid": 2}}
    assert expect(client.post(f"{API}/jobs/lease", json=again))["jobs"]
    eventually(lambda: not listed(client)["worker-1"]["draining"], "the new process is known")


def test_a_worker_that_nobody_knows_cannot_be_drained(client: httpx.Client) -> None:
    drain(client, "nobody", 404)


def test_every_coordinator_of_a_database_and_one_that_starts_later_drains_the_worker(
    databases: Databases, small_problems: None
) -> None:
    with databases.database() as url, coordinator(url) as one:
        submit(one, ball())
        worker = FakeWorker(one)
        worker.lease(max_jobs=1)
        drain(one)
        with coordinator(url, sweep_s=0.1) as later:
            eventually(lambda: ask(later, worker).get("drain", False), "it reads which workers drain")


@pytest.mark.parametrize(
    ("scope", "may"), [("admin", True), ("user", False), ("read", False), ("worker", False)]
)
def test_only_an_admin_drains_workers(scope: str, may: bool) -> None:
    assert allows(Scope(scope), "POST", f"{API}/workers/worker-1/drain") is may

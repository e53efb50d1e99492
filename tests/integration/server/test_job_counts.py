"""What those see who look after jobs: how many are not done, whose, and the list of them."""

from typing import Any

import httpx
from support.api import FakeWorker, ball, expect, submit
from support.problems import SIMULATOR

from brink.worker.wire import JobFailed, LeasedJob

NOBODY: dict[str, Any] = {"problem": {"id": "ball@1", "params": {"needs": "nobody-has-it@1"}}}


def counts(client: httpx.Client) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get("/api/v1/jobs/counts"))
    return found


def entries(client: httpx.Client) -> set[tuple[str, str, str, str, int]]:
    found = counts(client)
    columns = (found[name] for name in ("status", "campaign", "kind", "needs", "jobs"))
    return set(zip(*columns, strict=True))


def listed(client: httpx.Client, **params: Any) -> list[int]:
    return [job["id"] for job in expect(client.get("/api/v1/jobs", params=params))["jobs"]]


def breaks(job: LeasedJob) -> JobFailed:
    return JobFailed(reason="crashed", message="boom")


def test_jobs_are_counted_by_state_campaign_and_need_until_they_are_done(client: httpx.Client) -> None:
    first = submit(client, ball(name="first", simulations=20, execution={"max_attempts": 1, "cache": False}))
    second = submit(client, ball(name="second", seed=2, **NOBODY))
    assert entries(client) == {
        ("queued", first, "episode", SIMULATOR, 20),
        ("queued", second, "episode", "nobody-has-it@1", 20),
    }
    worker = FakeWorker(client)
    done, held = worker.lease(max_jobs=2), worker.lease(max_jobs=3)
    worker.report(done)
    broken = FakeWorker(client, id="worker-2", judge=breaks)
    broken.report(broken.lease(max_jobs=1))
    assert len(held) == 3
    assert entries(client) == {
        ("queued", first, "episode", SIMULATOR, 14),
        ("leased", first, "episode", SIMULATOR, 3),
        ("quarantined", first, "episode", SIMULATOR, 1),
        ("queued", second, "episode", "nobody-has-it@1", 20),
    }
    found = counts(client)
    assert (found["campaigns"], found["ended"]) == ({first: "first", second: "second"}, [])
    expect(client.post(f"/api/v1/campaigns/{first}/cancel"))
    assert ("quarantined", first, "episode", SIMULATOR, 1) in entries(client)
    assert counts(client)["ended"] == [first]


def test_jobs_that_no_live_worker_can_run_are_told_apart_from_those_that_are_held_back(
    client: httpx.Client,
) -> None:
    waits = submit(client, ball(simulations=20))
    assert counts(client)["unrunnable"] == {SIMULATOR: 20}
    FakeWorker(client).lease(max_jobs=1)
    assert counts(client)["unrunnable"] == {}
    nobodys = submit(client, ball(seed=2, **NOBODY))
    assert counts(client)["unrunnable"] == {"nobody-has-it@1": 20}
    expect(client.post(f"/api/v1/campaigns/{nobodys}/pause"))
    found = counts(client)
    assert (found["unrunnable"], found["paused"]) == ({}, [nobodys])
    assert waits not in found["paused"]


def test_jobs_that_are_not_done_are_listed_in_order_across_campaigns(client: httpx.Client) -> None:
    first = submit(client, ball(simulations=20, execution={"cache": False}))
    second = submit(client, ball(seed=2, simulations=20, execution={"cache": False}))
    worker = FakeWorker(client)
    worker.report(worker.lease(max_jobs=5))
    held = sorted(job.job for job in worker.lease(max_jobs=4))
    everything = listed(client, limit=1000)
    assert len(everything) == 40
    assert listed(client, status="leased") == held
    done = listed(client, status="done")
    waiting = [job for job in everything if job not in (*held, *done)]
    assert listed(client, status="queued") == waiting
    assert listed(client, status=["leased", "queued"]) == sorted([*held, *waiting])
    assert listed(client, status=["leased", "queued", "done"]) == everything
    assert listed(client, status="quarantined") == []
    page = expect(client.get("/api/v1/jobs", params={"status": ["leased", "queued"], "limit": 7}))
    assert [job["id"] for job in page["jobs"]] == sorted([*held, *waiting])[:7]
    rest = listed(client, status=["leased", "queued"], after=page["next"])
    assert rest == sorted([*held, *waiting])[7:]
    ours = [job["id"] for job in expect(client.get("/api/v1/jobs", params={"campaign": first}))["jobs"]]
    assert listed(client, status="queued", campaign=first) == [job for job in waiting if job in ours]
    assert listed(client, status="queued", campaign=second) == [job for job in waiting if job not in ours]

"""Traces are made by workers on request, and kept."""

import base64
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import update
from support.api import (
    FakeWorker,
    ball,
    completes,
    coordinator,
    eventually,
    expect,
    row_counts,
    submit,
)
from typer.testing import CliRunner

from brink.api.client import CoordinatorSaid
from brink.cli.commands import app
from brink.server.db.engine import Engines
from brink.server.db.models import WorkerRow
from brink.server.operations.prune import prune
from brink.server.queue import service
from brink.server.queue.wakeups import Wakeups
from brink.worker.wire import Completed, JobFailed, LeasedJob


def finished(client: httpx.Client, worker: FakeWorker) -> str:
    campaign = submit(client, ball(execution={"keep_traces": 0}))
    assert worker.work(campaign)["status"] == "finished"
    return campaign


def traces(document: bytes | None) -> Callable[[LeasedJob], Completed | JobFailed]:
    """Return a judge that adds this trace to the outcome of every job that requests one."""

    def judge(job: LeasedJob) -> Completed | JobFailed:
        outcome = completes(job)
        if not job.record or document is None:
            return outcome
        return outcome.model_copy(update={"trace": base64.b64encode(document).decode()})

    return judge


def test_trace_is_made_once_and_then_kept(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = finished(client, worker)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    being_made = client.get(path, params={"wait_s": 0})
    assert being_made.status_code == 202
    assert being_made.headers["Retry-After"] == "2"
    assert client.get(path, params={"wait_s": 0}).status_code == 202  # requested only once
    (job,) = worker.lease()
    assert job.record
    assert worker.lease() == []
    assert worker.report([job]) == ["accepted"]
    kept = client.get(path, params={"wait_s": 0})
    assert (kept.status_code, kept.content) == (200, b"the trace")


def test_request_for_a_trace_waits_for_the_worker(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = finished(client, worker)
    answers: list[httpx.Response] = []
    asking = threading.Thread(
        target=lambda: answers.append(
            client.get(f"/api/v1/campaigns/{campaign}/solutions/3/trace", params={"wait_s": 30})
        )
    )
    asking.start()
    worker.report(worker.lease(wait_s=20))
    asking.join()
    assert (answers[0].status_code, answers[0].content) == (200, b"the trace")


def test_deleted_trace_can_be_made_again(client: httpx.Client, engines: Engines) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = finished(client, worker)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.get(path, params={"wait_s": 0}).status_code == 202
    assert worker.report(worker.lease()) == ["accepted"]
    with engines.writer.begin() as connection:
        pruned = prune(connection, ended=None, traces=timedelta(days=-1), really=True)
    assert pruned.traces == 1
    assert client.get(path, params={"wait_s": 0}).status_code == 202
    assert worker.report(worker.lease()) == ["accepted"]
    assert client.get(path, params={"wait_s": 0}).content == b"the trace"


def test_capable_worker_is_woken_behind_an_incapable_one(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "RECHECK_S", 600.0)
    monkeypatch.setattr(service, "SHARED_RECHECK_S", 600.0)
    worker = FakeWorker(client, id="who-can", judge=traces(b"the trace"))
    campaign = finished(client, worker)
    first = FakeWorker(client, id="who-cannot", capabilities=("another-simulator@1",))
    got: list[LeasedJob] = []
    waiting = [
        threading.Thread(target=lambda: first.lease(wait_s=6)),
        threading.Thread(target=lambda: got.extend(worker.lease(wait_s=20))),
    ]
    in_line: list[Wakeups] = []
    wait = Wakeups.wait

    async def noted(self: Wakeups, *given: Any, **named: Any) -> bool:
        in_line.append(self)
        return await wait(self, *given, **named)

    monkeypatch.setattr(Wakeups, "wait", noted)
    waiting[0].start()
    eventually(lambda: len(in_line) == 1, "the first waits")
    waiting[1].start()
    eventually(lambda: len(in_line) == 2, "the second waits")
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.get(path, params={"wait_s": 0}).status_code == 202
    waiting[1].join(10)
    assert [job.record for job in got] == [True]
    waiting[0].join()


@pytest.mark.parametrize("what", ["trace", "replay.png", "replay.mp4"])
def test_trace_that_no_worker_can_make_is_refused_at_once(
    client: httpx.Client, engines: Engines, what: str
) -> None:
    campaign = submit(client, ball())
    FakeWorker(client, capabilities=("another-simulator@1",)).lease()
    before = row_counts(engines)
    began = time.monotonic()
    answer = client.get(f"/api/v1/campaigns/{campaign}/solutions/3/{what}", params={"wait_s": 20})
    assert time.monotonic() - began < 10, "it did not wait"
    assert "no live worker can run faulty@1" in expect(answer, 503)["detail"]
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.headers["Retry-After"] == "5"
    assert row_counts(engines) == before, "no job is enqueued"
    worker = FakeWorker(client, id="who-can", judge=traces(b"the trace"))
    worker.lease(max_jobs=1)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.get(path, params={"wait_s": 0}).status_code == 202


@pytest.mark.parametrize("what", ["trace", "replay.{extension}"])
def test_responses_for_a_missing_trace_are_documented(client: httpx.Client, what: str) -> None:
    paths = expect(client.get("/openapi.json"))["paths"]
    answers = paths[f"/api/v1/campaigns/{{campaign_id}}/solutions/{{number}}/{what}"]["get"]["responses"]
    assert set(answers["202"]["content"]) == {"application/json"}
    assert set(answers["503"]["content"]) == {"application/problem+json"}


def test_replay_command_fails_at_once_if_no_worker_can_make_the_trace(
    client: httpx.Client, tmp_path: Path
) -> None:
    campaign = submit(client, ball())
    given = ["replay", campaign, "3", "--out", str(tmp_path / "x.png"), "--server", str(client.base_url)]
    said = CliRunner().invoke(app, given)
    assert isinstance(said.exception, CoordinatorSaid)
    assert "no live worker can run faulty@1" in str(said.exception)


def test_waiting_for_a_trace_ends_when_its_workers_leave(
    database_url: str, engines: Engines, small_problems: None
) -> None:
    with coordinator(database_url) as client:
        campaign = finished(client, FakeWorker(client))
        path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
        assert client.get(path, params={"wait_s": 0}).status_code == 202
        long_ago = datetime.now(UTC) - timedelta(hours=1)
        with engines.writer.begin() as connection:
            connection.execute(update(WorkerRow).values(last_seen_at=long_ago))
        expect(client.get(path, params={"wait_s": 20}), 503)


def test_worker_with_a_live_lease_can_make_a_trace(client: httpx.Client, engines: Engines) -> None:
    campaign = submit(client, ball())
    worker = FakeWorker(client)
    worker.lease(max_jobs=1)
    long_ago = datetime.now(UTC) - timedelta(hours=1)
    with engines.writer.begin() as connection:
        connection.execute(update(WorkerRow).values(last_seen_at=long_ago))
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.get(path, params={"wait_s": 0}).status_code == 202


def test_trace_job_is_leased_before_episodes(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = finished(client, worker)
    submit(client, ball(seed=2, priority=100))
    client.get(f"/api/v1/campaigns/{campaign}/solutions/3/trace", params={"wait_s": 0})
    assert worker.lease(max_jobs=1)[0].record


def test_failed_trace_reports_its_error_until_it_is_retried(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=lambda _: JobFailed(reason="invalid", message="no such road"))
    campaign = finished(client, FakeWorker(client))
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    client.get(path, params={"wait_s": 0})
    worker.report(worker.lease())
    document = expect(client.get(path, params={"wait_s": 5}), 409)
    assert "no such road" in document["detail"]
    (job,) = expect(client.get("/api/v1/jobs", params={"status": "quarantined"}))["jobs"]
    expect(client.post(f"/api/v1/jobs/{job['id']}/retry"), 204)
    worker.judge = traces(b"the trace")
    worker.report(worker.lease())
    assert client.get(path, params={"wait_s": 5}).content == b"the trace"


def test_simulator_that_records_no_traces_is_a_conflict(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(None))
    campaign = finished(client, worker)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    client.get(path, params={"wait_s": 0})
    worker.report(worker.lease())
    document = expect(client.get(path, params={"wait_s": 5}), 409)
    assert "records no trace" in document["detail"]


def test_trace_that_cannot_be_drawn_is_a_conflict(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = finished(client, worker)
    client.get(f"/api/v1/campaigns/{campaign}/solutions/3/trace", params={"wait_s": 0})
    worker.report(worker.lease())
    document = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions/3/replay.png"), 409)
    assert "cannot be drawn" in document["detail"]
    expect(client.get(f"/api/v1/campaigns/{campaign}/solutions/3/replay.exe"), 422)


def test_unknown_solution_has_no_trace(client: httpx.Client) -> None:
    campaign = finished(client, FakeWorker(client))
    expect(client.get(f"/api/v1/campaigns/{campaign}/solutions/9999/trace"), 404)


@pytest.mark.parametrize("garbage", ["no base64!", "AAA", "\u00fc"])
def test_trace_that_is_not_base64_is_rejected(client: httpx.Client, garbage: str) -> None:
    worker = FakeWorker(client)
    submit(client, ball())
    (job,) = worker.lease(max_jobs=1)
    outcome = {**completes(job).model_dump(), "trace": garbage}
    body = {"worker": worker.identity, "results": [{"job": job.job, "token": job.token, "outcome": outcome}]}
    (error,) = expect(client.post("/api/v1/jobs/results", json=body), 422)["errors"]
    assert error["pointer"] == "/results/0/outcome/trace"


def test_traces_of_the_best_boundary_solutions_are_kept(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"evidence"))
    campaign = submit(client, ball(execution={"keep_traces": 2}, simulations=120))
    done = worker.work(campaign)
    wanted = min(2, done["generations"][-1]["dbs"])
    assert wanted > 0
    eventually(lambda: not worker.report(worker.lease()), "all traces")
    boundary = expect(client.get(f"/api/v1/campaigns/{campaign}/boundary"))
    for solution in boundary["solutions"][:wanted]:
        path = f"/api/v1/campaigns/{campaign}/solutions/{solution['number']}/trace"
        assert client.get(path, params={"wait_s": 0}).content == b"evidence"


def test_requested_traces_do_not_keep_a_campaign_from_finishing(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = submit(client, ball(execution={"keep_traces": 12}, simulations=120))
    worker.work(campaign, until=lambda now: now["generation"] >= 1)
    for number in range(20):
        client.get(f"/api/v1/campaigns/{campaign}/solutions/{number}/trace", params={"wait_s": 0})
    done = worker.work(campaign)
    assert (done["status"], done["status_reason"]) == ("finished", "")


def test_cancelled_campaign_still_makes_traces(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=traces(b"the trace"))
    campaign = submit(client, ball())
    FakeWorker(client, id="another").lease(max_jobs=1)
    path = f"/api/v1/campaigns/{campaign}/solutions/3/trace"
    assert client.get(path, params={"wait_s": 0}).status_code == 202
    expect(client.post(f"/api/v1/campaigns/{campaign}/cancel"))
    assert worker.report(worker.lease()) == ["accepted"]
    assert client.get(path, params={"wait_s": 0}).content == b"the trace"
    assert worker.lease() == []

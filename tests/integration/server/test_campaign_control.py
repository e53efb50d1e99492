"""Campaigns over the API: submitting, listing, pausing, resuming, cancelling, deleting, failing, retrying."""

import base64
import hashlib
import json
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import select, update
from support.api import (
    FakeWorker,
    Judge,
    await_erasure,
    ball,
    completes,
    coordinator,
    eventually,
    expect,
    progress,
    row_counts,
    submit,
)
from support.databases import sqlite_then_postgres
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search.algorithms.ga import GeneticAlgorithmConfig
from brink.search.metric import Metric
from brink.server.api import campaigns as campaign_routes
from brink.server.api.schemas import Progress
from brink.server.db.engine import Engines
from brink.server.db.models import DistanceBlockRow
from brink.server.problems.catalogue import make_problem
from brink.sim import catalogue
from brink.worker.wire import Completed, JobFailed, LeasedJob


def post(client: httpx.Client, campaign: str, verb: str, status: int = 200) -> dict[str, object]:
    document: dict[str, object] = expect(client.post(f"/api/v1/campaigns/{campaign}/{verb}"), status)
    return document


def test_submission_answers_with_the_location_of_the_campaign(client: httpx.Client) -> None:
    answer = client.post("/api/v1/campaigns", json=ball())
    document = expect(answer, 201)
    assert answer.headers["Location"] == f"/api/v1/campaigns/{document['id']}"
    assert document["status"] == "running"
    assert (document["simulations"], document["budget"]) == (0, 60)
    current = progress(client, document["id"])
    assert (current["queued"], current["workers"], current["unrunnable"]) == (20, 0, {"faulty@1": 20})


def test_same_idempotency_key_returns_the_same_campaign(client: httpx.Client, engines: Engines) -> None:
    headers = {"Idempotency-Key": "key-1"}
    described = expect(client.get("/openapi.json"))["paths"]["/api/v1/campaigns"]["post"]["responses"]
    assert {"200", "201"} <= set(described)
    first = expect(client.post("/api/v1/campaigns", json=ball(), headers=headers), 201)
    again = expect(client.post("/api/v1/campaigns", json=ball(), headers=headers), 200)
    assert again["id"] == first["id"]
    assert row_counts(engines)["campaigns"] == 1
    document = expect(client.post("/api/v1/campaigns", json=ball(seed=2), headers=headers), 409)
    assert first["id"] in document["detail"]
    other = expect(client.post("/api/v1/campaigns", json=ball(), headers={"Idempotency-Key": "key-2"}), 201)
    assert other["id"] != first["id"]


@sqlite_then_postgres
def test_campaigns_are_listed_newest_first_and_in_pages(client: httpx.Client) -> None:
    ids = [submit(client, ball(seed=seed)) for seed in range(5)]
    listed: list[str] = []
    cursor: str | None = None
    while True:
        params: dict[str, str | int] = {"limit": 2} | ({"cursor": cursor} if cursor else {})
        page = expect(client.get("/api/v1/campaigns", params=params))
        listed += [item["id"] for item in page["campaigns"]]
        cursor = page["next"]
        if cursor is None:
            break
    assert listed == ids[::-1]
    post(client, ids[0], "pause")
    paused = expect(client.get("/api/v1/campaigns", params={"status": "paused"}))
    assert [item["id"] for item in paused["campaigns"]] == [ids[0]]


def test_paused_campaign_grants_no_jobs_until_it_is_resumed(client: httpx.Client) -> None:
    worker, campaign = FakeWorker(client), submit(client, ball())
    running = worker.lease(max_jobs=4)
    post(client, campaign, "pause")
    post(client, campaign, "pause")  # pausing again changes nothing
    assert worker.lease() == []
    assert set(worker.report(running)) == {"accepted"}
    assert progress(client, campaign)["status"] == "paused"
    post(client, campaign, "resume")
    assert worker.work(campaign)["status"] == "finished"


def test_generation_that_ends_during_a_pause_is_evaluated_after_resume(client: httpx.Client) -> None:
    worker, campaign = FakeWorker(client), submit(client, ball())
    jobs = worker.lease_all()
    post(client, campaign, "pause")
    worker.report(jobs)
    current = progress(client, campaign)
    assert (current["generation"], current["simulations"], current["queued"]) == (0, 20, 0)
    post(client, campaign, "resume")
    eventually(
        lambda: progress(client, campaign)["generation"] == 1, "the generation is evaluated after resume"
    )


def test_cancelled_campaign_keeps_its_results(client: httpx.Client) -> None:
    worker, campaign = FakeWorker(client), submit(client, ball())
    current = worker.work(campaign, until=lambda p: p["generation"] >= 1)
    late = worker.lease()
    post(client, campaign, "cancel")
    assert set(worker.report(late)) == {"stale"}
    done = progress(client, campaign)
    assert done["status"] == "cancelled"
    assert done["evaluated"] == current["evaluated"] == 20
    assert done["digest"]
    assert (done["queued"], done["leased"], done["remaining_s"]) == (0, 0, None)
    assert worker.lease() == []


@sqlite_then_postgres
def test_only_an_ended_campaign_can_be_deleted(client: httpx.Client, engines: Engines) -> None:
    worker, campaign = FakeWorker(client), submit(client, ball())
    late = worker.lease()
    document = expect(client.delete(f"/api/v1/campaigns/{campaign}"), 409)
    assert "cancel it" in document["detail"]
    post(client, campaign, "cancel")
    expect(client.delete(f"/api/v1/campaigns/{campaign}"), 204)
    expect(client.get(f"/api/v1/campaigns/{campaign}"), 404)
    assert set(worker.report(late)) == {"stale"}
    await_erasure(engines)
    left = {name for name, count in row_counts(engines).items() if count}
    assert left <= {"workers"}


def fails_east_of(x: float) -> Judge:
    """Return a judge that fails every job east of a line."""

    def judge(job: LeasedJob) -> Completed | JobFailed:
        if job.spec["scenario"]["x"] > x:
            return JobFailed(reason="invalid", message="no road here\0")
        return completes(job)

    return judge


def test_failed_candidates_do_not_count_as_safe(client: httpx.Client) -> None:
    body = ball(execution={"max_failed_share": 1.0})
    worker = FakeWorker(client, judge=fails_east_of(1.0))
    campaign = submit(client, body)
    done = worker.work(campaign)
    assert done["status"] == "finished"
    assert done["failed"] > 0
    assert done["quarantined"] == done["failed"]
    assert done["simulations"] == done["evaluated"] + done["failed"]
    solutions = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 1000}))[
        "solutions"
    ]
    failed = [s for s in solutions if s["verdict"] == "failed"]
    assert len(failed) == done["failed"]
    assert all(s["parameters"]["where"]["x"] > 1.0 for s in failed)
    assert {(s["fitness"], s["robustness"], s["failure"]) for s in failed} == {
        (None, None, "invalid: no road here\N{REPLACEMENT CHARACTER}")
    }


def test_too_many_failures_pause_a_campaign_that_can_resume_without_them(client: httpx.Client) -> None:
    worker, campaign = FakeWorker(client, judge=fails_east_of(0.0)), submit(client, ball())
    stopped = worker.work(campaign)
    assert stopped["status"] == "paused"
    assert "max_failed_share 0.2" in stopped["status_reason"]
    assert "no road here" in stopped["status_reason"]
    assert stopped["generation"] == 0
    post(client, campaign, "resume")
    worker.judge = completes
    assert worker.work(campaign)["status"] == "finished"


def test_a_campaign_of_which_nothing_succeeds_pauses_before_the_end_of_its_generation(
    client: httpx.Client,
) -> None:
    worker, campaign = FakeWorker(client, judge=fails_east_of(-9.0)), submit(client, ball())
    worker.report(worker.lease(max_jobs=4))
    early = progress(client, campaign)
    assert (early["status"], early["failed"], early["reported_failed"]) == ("running", 0, 4)
    assert early["failure"] == "invalid: no road here\N{REPLACEMENT CHARACTER}"
    worker.report(worker.lease(max_jobs=1))
    eventually(lambda: progress(client, campaign)["status"] == "paused", "five failures pause it")
    stopped = progress(client, campaign)
    assert stopped["status_reason"].startswith(
        "all of the first 5 simulations failed. Retry their jobs, or resume"
    )
    assert "First error: invalid: no road here" in stopped["status_reason"]
    assert (stopped["queued"], stopped["reported_failed"]) == (15, 5)
    post(client, campaign, "resume")
    worker.judge = completes
    done = worker.work(campaign)
    assert (done["status"], done["failed"], done["reported_failed"]) == ("finished", 5, 0)


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_failures_beside_successes_or_that_are_allowed_do_not_pause_it_early(
    client: httpx.Client, share: float
) -> None:
    worker = FakeWorker(client, judge=completes)
    campaign = submit(client, ball(execution={"max_failed_share": share}))
    if share < 1:
        worker.report(worker.lease(max_jobs=1))
    worker.judge = fails_east_of(-9.0)
    worker.report(worker.lease(max_jobs=6))
    worker.judge = completes
    stopped = worker.work(campaign)
    if share < 1:
        assert (stopped["status"], stopped["simulations"]) == ("paused", 20)
        assert stopped["status_reason"].startswith("6 of 20 candidates failed")
    else:
        assert (stopped["status"], stopped["failed"]) == ("finished", 6)


def few(**changes: Any) -> dict[str, Any]:
    """Return the body of a campaign so small that its failures never pause it."""
    return ball(simulations=3, algorithm={"id": "random@1"}, **changes)


@sqlite_then_postgres
def test_a_campaign_without_any_result_has_failed(listening_client: httpx.Client, tmp_path: Path) -> None:
    worker = FakeWorker(listening_client, judge=fails_east_of(-9.0))
    file = tmp_path / "few.json"
    file.write_text(json.dumps(few()))
    server = ["--server", str(listening_client.base_url)]

    def simulate() -> None:
        while len(worker.statuses) < 3:
            worker.report(worker.lease(wait_s=5.0))

    simulating = threading.Thread(target=simulate)
    simulating.start()
    watched = CliRunner().invoke(app, ["submit", str(file), "--watch", *server])
    simulating.join()
    assert watched.exit_code == 1, watched.output
    (campaign,) = [one["id"] for one in expect(listening_client.get("/api/v1/campaigns"))["campaigns"]]
    done = progress(listening_client, campaign)
    reason = "all 3 simulations failed. One of the errors: invalid: no road here\N{REPLACEMENT CHARACTER}"
    assert (done["status"], done["failed"], done["status_reason"]) == ("failed", 3, reason)
    found = expect(listening_client.get(f"/api/v1/campaigns/{campaign}/findings"))
    assert (found["words"], found["steps"]) == ("All 3 simulations failed.", [])
    said = CliRunner().invoke(app, ["status", campaign, *server])
    assert "is failed: all 3 simulations failed" in said.stdout
    out = tmp_path / "report.html"
    reported = CliRunner().invoke(app, ["report", campaign, "--out", str(out), *server])
    assert reported.exit_code == 0, reported.output
    assert "The campaign has failed after 3 of 3 simulations" in out.read_text()
    assert "Reason: all 3 simulations failed." in out.read_text()


def test_quarantined_jobs_can_be_retried_before_resuming(client: httpx.Client) -> None:
    worker, campaign = FakeWorker(client, judge=fails_east_of(0.0)), submit(client, ball())
    worker.work(campaign)
    jobs = expect(client.get("/api/v1/jobs", params={"status": "quarantined", "campaign": campaign}))["jobs"]
    assert jobs
    for job in jobs:
        expect(client.post(f"/api/v1/jobs/{job['id']}/retry"), 204)
    worker.judge = completes
    post(client, campaign, "resume")
    done = worker.work(campaign)
    assert (done["status"], done["failed"]) == ("finished", 0)
    expect(client.post(f"/api/v1/jobs/{jobs[0]['id']}/retry"), 409)


def test_campaign_continues_without_unreadable_results(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=lambda job: Completed(verdicts={}))
    campaign = submit(client, ball())
    assert worker.work(campaign)["status"] == "paused"
    post(client, campaign, "resume")
    worker.judge = completes
    done = worker.work(campaign)
    assert done["status"] == "finished"
    assert 0 < done["failed"] < 20


def test_unreadable_result_is_not_reused_by_other_campaigns(client: httpx.Client) -> None:
    worker = FakeWorker(client, judge=lambda job: Completed(verdicts={}))
    campaign = submit(client, ball(execution={"max_failed_share": 1.0}))
    worker.work(campaign, until=lambda now: now["generation"] >= 1)
    worker.judge = completes
    worker.work(campaign)
    again = submit(client, ball(name="again"))
    done = worker.work(again)
    assert (done["status"], done["failed"]) == ("finished", 0)


def test_campaign_shows_every_parameter_that_it_runs_with(client: httpx.Client) -> None:
    body = expect(client.get(f"/api/v1/campaigns/{submit(client, ball())}"))["body"]
    assert body["algorithm"]["params"] == asdict(
        GeneticAlgorithmConfig(radius=0.2, population_size=20, mutation_probability=0.5)
    )  # the radius is the default of the ball


def test_made_up_cursor_is_rejected(client: httpx.Client) -> None:
    for text in ("1.0 \0", "nan x", "1e999 x", "1.0", "", "\ud7ff"):
        cursor = base64.urlsafe_b64encode(text.encode()).decode()
        expect(client.get("/api/v1/campaigns", params={"cursor": cursor}), 422 if cursor else 200)


def test_distances_equal_those_of_the_metric(client: httpx.Client, engines: Engines) -> None:
    campaign = submit(client, ball())
    FakeWorker(client).work(campaign)
    solutions = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions", params={"limit": 60}))[
        "solutions"
    ]
    numbers = [s["number"] for s in reversed(solutions)][::3]
    values = {s["number"]: s["parameters"] for s in solutions}
    space = make_problem("ball@1", {}).space
    rows = np.array([space.join(space.encode(values[number])) for number in numbers])
    expected = Metric.of_space(space).between(rows, rows)
    wanted = {"numbers": ",".join(map(str, numbers))}
    answer = expect(client.get(f"/api/v1/campaigns/{campaign}/distances", params=wanted))
    assert answer["numbers"] == numbers
    np.testing.assert_allclose(answer["distances"], expected, atol=1e-6)
    # They come from the stored matrix, and a damaged block is an error.
    with engines.writer.begin() as connection:
        block = connection.execute(select(DistanceBlockRow.data).limit(1)).scalar_one()
        zeros = bytes(len(block))
        digest = hashlib.sha256(zeros).hexdigest()
        first = DistanceBlockRow.generation == 0
        connection.execute(update(DistanceBlockRow).where(first).values(data=zeros, sha256=digest))
    forged = expect(client.get(f"/api/v1/campaigns/{campaign}/distances", params=wanted))
    assert not np.allclose(forged["distances"], expected, atol=1e-6)
    with engines.writer.begin() as connection:
        connection.execute(update(DistanceBlockRow).where(first).values(sha256="0" * 64))
    answer = expect(client.get(f"/api/v1/campaigns/{campaign}/distances", params=wanted))
    np.testing.assert_allclose(answer["distances"], expected, atol=1e-6)


@pytest.mark.parametrize("value", ["\ud800", [[[]]] * 2, {"deep": None}])
def test_values_that_cannot_be_stored_are_rejected_by_pointer(client: httpx.Client, value: object) -> None:
    for _ in range(40):
        value = value if isinstance(value, str) else [value]
    campaign, worker = submit(client, ball()), FakeWorker(client)
    (job,) = worker.lease(max_jobs=1)
    outcome = completes(job).model_dump() | {"features": {"odd": value}}
    body = {"worker": worker.identity, "results": [{"job": job.job, "token": job.token, "outcome": outcome}]}
    headers = {"Content-Type": "application/json"}
    answer = client.post("/api/v1/jobs/results", content=json.dumps(body), headers=headers)
    (error, *_) = expect(answer, 422)["errors"]
    # No parser reads a lone surrogate, so that it is an error of the whole body.
    assert "JSON" in error["message"] if value == "\ud800" else "features" in error["pointer"]
    assert worker.report([job]) == ["accepted"]
    assert progress(client, campaign)["status"] == "running"


def test_campaigns_share_equal_simulations(client: httpx.Client) -> None:
    worker = FakeWorker(client)
    first = worker.work(submit(client, ball()))
    second = submit(client, ball(name="again"))
    eventually(lambda: progress(client, second)["status"] == "finished", "a campaign of known simulations")
    assert progress(client, second)["digest"] == first["digest"]
    third = submit(client, ball(execution={"cache": False}))
    assert progress(client, third)["queued"] == 20


def test_progress_counts_jobs_that_no_worker_can_run(client: httpx.Client) -> None:
    body = ball(problem={"id": "ball@1", "params": {"needs": "nobody-has-it@1"}})
    campaign = submit(client, body)
    submit(client, ball())
    FakeWorker(client).lease()
    found = progress(client, campaign)
    assert found["unrunnable"] == {"nobody-has-it@1": 20}
    assert found["waits_for"] == {
        "nobody-has-it@1": "a worker with the plug-in that provides nobody-has-it@1"
    }


def test_in_process_problem_needs_no_worker(client: httpx.Client) -> None:
    body = {
        "name": "mtq",
        "problem": {"id": "mtq@1"},
        "algorithm": {"id": "mlcshe@1"},
        "budget": {"simulations": 300},
        "seed": 1,
    }
    campaign = submit(client, body)
    eventually(lambda: progress(client, campaign)["status"] == "finished", "mtq")
    done = progress(client, campaign)
    assert done["evaluated"] >= 300
    assert expect(client.get("/api/v1/jobs"))["jobs"] == []
    solution = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions/0"))
    assert (solution["spec"], solution["attempts"]) == (None, None)
    expect(client.get(f"/api/v1/campaigns/{campaign}/solutions/0/trace"), 404)


def test_progress_has_the_digest_of_a_campaign_ended(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker, campaign = FakeWorker(client), submit(client, ball())
    read = campaign_routes.read_progress

    def end_meanwhile(*arguments: Any, **options: Any) -> Progress:
        monkeypatch.setattr(campaign_routes, "read_progress", read)
        assert worker.work(campaign)["status"] == "finished"
        return read(*arguments, **options)

    monkeypatch.setattr(campaign_routes, "read_progress", end_meanwhile)
    seen = progress(client, campaign)
    assert (seen["status"], len(seen["digest"] or "")) == ("finished", 64)


def test_readable_without_its_plugin(
    database_url: str, small_problems: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball())
        FakeWorker(client).work(campaign)
    monkeypatch.setattr(catalogue, "_registered", {})
    with coordinator(database_url) as client:
        seen = progress(client, campaign)
        assert (seen["status"], seen["digest"]) == ("finished", None)
        (error,) = expect(client.get(f"/api/v1/campaigns/{campaign}/boundary"), 422)["errors"]
        assert "ball@1" in error["message"]


@pytest.mark.parametrize("verb", ["pause", "resume", "cancel"])
def test_unknown_campaign_cannot_be_controlled(client: httpx.Client, verb: str) -> None:
    post(client, "zzzz", verb, 404)

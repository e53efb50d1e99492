"""Results that say nothing about what their campaign asked for: refused when they come, and asked for again."""

from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, completes, coordinator, eventually, expect, progress, submit
from support.databases import sqlite_then_postgres
from support.problems import Ball
from support.traffic import driven, traffic_worker

from brink.server.problems.catalogue import make_algorithm
from brink.worker.wire import Completed, JobFailed, LeasedJob

TRAFFIC: dict[str, Any] = {
    "name": "traffic",
    "problem": {"id": "npc-actions@1"},
    "algorithm": {"id": "nsga2@1"},
    "budget": {"simulations": 100},
}


def without(outcome: Completed | JobFailed, **changes: Any) -> Completed:
    """Return a completed outcome with less in it."""
    assert isinstance(outcome, Completed)
    return outcome.model_copy(update=changes)


def says_nothing(job: LeasedJob) -> Completed | JobFailed:
    """Return the outcome of a job without any verdict."""
    return without(completes(job), verdicts={})


def fails(job: LeasedJob) -> JobFailed:
    """Return the outcome of a job that failed."""
    return JobFailed(reason="crashed", message="boom")


@sqlite_then_postgres
def test_a_result_without_a_requirement_is_refused_and_its_job_retried(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=20))
    bad, good = FakeWorker(client, id="bad", judge=says_nothing), FakeWorker(client, id="good")
    jobs = bad.lease()
    assert bad.report(jobs) == ["invalid"] * len(jobs)
    (row,) = expect(client.get("/api/v1/jobs", params={"limit": 1}))["jobs"]
    assert (row["status"], row["attempt"]) == ("queued", 1)
    assert row["last_error"].startswith("invalid result: ball@1 cannot evaluate it: KeyError: 'distance@1'")
    stands = good.work(campaign)
    assert (stands["status"], stands["evaluated"], stands["failed"]) == ("finished", 20, 0)


@sqlite_then_postgres
def test_a_refused_result_sent_again_charges_nothing(client: httpx.Client) -> None:
    submit(client, ball(simulations=20))
    worker = FakeWorker(client, judge=says_nothing)
    jobs = worker.lease(max_jobs=1)
    assert worker.report(jobs) == ["invalid"]
    assert worker.report(jobs) == ["duplicate"]
    (row,) = expect(client.get("/api/v1/jobs", params={"limit": 1}))["jobs"]
    assert (row["status"], row["attempt"]) == ("queued", 1)


@sqlite_then_postgres
def test_refused_results_bury_their_job_after_max_attempts(client: httpx.Client) -> None:
    submit(client, ball(simulations=20, execution={"max_attempts": 2}))
    worker = FakeWorker(client, judge=says_nothing)
    first, *rest = worker.lease()
    worker.judge = completes
    worker.report(rest)
    worker.judge = says_nothing
    worker.report([first])
    for _ in range(20):  # fresh jobs may come before the retry
        jobs = worker.lease(max_jobs=1)
        worker.judge = says_nothing if jobs[0].job == first.job else completes
        worker.report(jobs)
        if jobs[0].job == first.job:
            break
    (row,) = expect(client.get("/api/v1/jobs", params={"status": "quarantined"}))["jobs"]
    assert (row["id"], row["attempt"]) == (first.job, 2)
    assert "invalid result" in row["last_error"]


@sqlite_then_postgres
def test_other_results_of_the_same_message_are_stored(client: httpx.Client) -> None:
    submit(client, ball(simulations=20))
    worker = FakeWorker(client)
    jobs = worker.lease()
    worker.judge = lambda job: says_nothing(job) if job == jobs[1] else completes(job)
    assert worker.report(jobs) == ["accepted", "invalid", *["accepted"] * (len(jobs) - 2)]


@sqlite_then_postgres
def test_of_two_results_of_a_job_in_the_first_message_of_a_campaign_the_first_counts(
    client: httpx.Client,
) -> None:
    submit(client, ball(simulations=20))
    outcomes = iter([completes, fails, says_nothing, says_nothing, completes])
    worker = FakeWorker(client, judge=lambda job: next(outcomes)(job))
    good, bad = worker.lease(max_jobs=2)
    expected = ["accepted", "duplicate", "duplicate", "invalid", "duplicate"]
    assert worker.report([good, good, good, bad, bad]) == expected


@sqlite_then_postgres
def test_a_refused_result_is_not_shared_with_another_campaign(client: httpx.Client) -> None:
    for _ in range(2):
        submit(client, ball(simulations=20))
    worker = FakeWorker(client, judge=says_nothing)
    worker.report(worker.lease())
    assert expect(client.get("/api/v1/jobs", params={"status": "done"}))["jobs"] == []


@sqlite_then_postgres
def test_a_refused_result_counts_in_the_metrics_and_not_as_done(client: httpx.Client) -> None:
    submit(client, ball(simulations=20))
    worker = FakeWorker(client, judge=says_nothing)
    worker.report(worker.lease(max_jobs=1))
    told = client.get("/metrics").text
    assert 'brink_results_total{status="invalid"} 1.0' in told
    assert 'brink_failures_total{reason="invalid-result"} 1.0' in told


@sqlite_then_postgres
def test_results_of_a_problem_that_cannot_be_made_are_stored_and_its_campaign_pauses(
    database_url: str, small_problems: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball(simulations=20))
        jobs = FakeWorker(client).lease_all()

    def broken(*_: Any) -> None:
        raise RuntimeError("a library of the plug-in is missing")

    monkeypatch.setattr(Ball, "__init__", broken)
    with coordinator(database_url) as client:
        assert FakeWorker(client).report(jobs) == ["accepted"] * len(jobs)
        eventually(lambda: progress(client, campaign)["status"] == "paused", "the campaign pauses")
        assert "a library of the plug-in is missing" in progress(client, campaign)["status_reason"]


@sqlite_then_postgres
def test_reason_with_a_character_that_no_database_stores_is_stored_without_it(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreadable(*_: Any) -> None:
        raise ValueError("expected a number, got \0")

    monkeypatch.setattr(Ball, "evaluation", unreadable)
    submit(client, ball(simulations=20))
    worker = FakeWorker(client)
    assert worker.report(worker.lease(max_jobs=1)) == ["invalid"]
    (row,) = expect(client.get("/api/v1/jobs", params={"limit": 1}))["jobs"]
    assert row["last_error"].endswith("expected a number, got \N{REPLACEMENT CHARACTER}")


def test_a_measurement_without_its_objective_is_refused(client: httpx.Client) -> None:
    body = {
        "name": "slots",
        "problem": {"id": "slotted@1"},
        "algorithm": {"id": "simood-ga@1"},
        "budget": {"simulations": 200},
        "seed": 5,
    }
    submit(client, body)
    worker = FakeWorker(client, judge=lambda job: Completed(verdicts={}, objectives={"other": 1.0}))
    jobs = worker.lease(max_jobs=4)
    assert {job.spec["requirements"] == [] for job in jobs} == {True}, "they are measured on data"
    assert set(worker.report(jobs)) == {"invalid"}


def test_a_result_without_an_objective_of_its_campaign_is_refused(client: httpx.Client) -> None:
    submit(client, TRAFFIC)
    worker = traffic_worker(client)
    (job,) = worker.lease(max_jobs=1)
    worker.judge = lambda job: without(driven(job.spec), objectives={})
    assert worker.report([job]) == ["invalid"]


def test_a_result_without_an_objective_of_the_algorithm_is_refused(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(make_algorithm("ga@1")), "needed_objectives", ("height",), raising=False)
    submit(client, ball(simulations=20))
    worker = FakeWorker(client)
    assert worker.report(worker.lease(max_jobs=1)) == ["invalid"]
    queued = expect(client.get("/api/v1/jobs", params={"status": "queued", "limit": 1}))["jobs"]
    assert queued[0]["last_error"] == "invalid result: ga@1 expects the objective height, which is missing"

"""Where and when a failed job is tried again, over the API."""

import httpx
import pytest
from support.api import FakeWorker, ball, coordinator, eventually, submit

from brink.worker.wire import JobFailed, LeasedJob

pytestmark = pytest.mark.usefixtures("small_problems")


def crashes(job: LeasedJob) -> JobFailed:
    return JobFailed(reason="crashed", message="killed by SIGSEGV")


def lease_everything(worker: FakeWorker) -> list[LeasedJob]:
    jobs = []
    while more := worker.lease():
        jobs += more
    return jobs


def fail_one(client: httpx.Client) -> tuple[FakeWorker, LeasedJob]:
    """Return a worker that has failed one of a campaign's jobs and completed the others, and the job."""
    bad = FakeWorker(client, id="bad", judge=crashes)
    submit(client, ball(simulations=20))
    job, *others = lease_everything(bad)
    FakeWorker(client, id="bad").report(others)
    assert bad.report([job]) == ["accepted"]
    return bad, job


def test_a_failed_job_goes_to_another_live_worker(client: httpx.Client) -> None:
    good = FakeWorker(client, id="good")
    assert good.lease() == []
    bad, job = fail_one(client)
    assert bad.lease() == []
    assert [(again.job, again.attempt) for again in good.lease()] == [(job.job, 2)]


def test_a_failed_job_does_not_wait_for_workers_that_cannot_run_it(client: httpx.Client) -> None:
    assert FakeWorker(client, id="other", capabilities=("other@1",)).lease() == []
    bad, job = fail_one(client)
    assert [(again.job, again.attempt) for again in bad.lease()] == [(job.job, 2)]


def test_a_failed_job_does_not_wait_for_a_worker_that_was_not_heard_of_lately(database_url: str) -> None:
    with coordinator(database_url, worker_seen_s=0.5) as client:
        assert FakeWorker(client, id="silent").lease() == []
        bad, job = fail_one(client)
        again: list[LeasedJob] = []

        def granted() -> bool:
            again.extend(bad.lease())
            return bool(again)

        eventually(granted, "the other one is given up")
        assert [(a.job, a.attempt) for a in again] == [(job.job, 2)]

"""Outages are nobody's fault: leases after times without a coordinator, on SQLite and on Postgres."""

import asyncio
import subprocess
import sys
from functools import partial

import pytest
from sqlalchemy import event
from support.api import (
    FakeWorker,
    ball,
    coordinator,
    eventually,
    expect,
    progress,
    settings_for,
    submit,
    undisturbed_digest,
)
from support.databases import on_postgres, on_sqlite, sqlite_then_postgres
from support.queue import TERMS, Queue

from brink.server.db.engine import Engines
from brink.server.db.sql import database_now
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.queue import outages, workers
from brink.server.queue.service import QueueService
from brink.worker.wire import LeasedJob, WorkerIdentity, machine_name

LEASE_S = TERMS.lease_s


def left_s(queue: Queue, job: int) -> float:
    """Return how long a lease still lasts."""
    now = queue.run(database_now)
    return float((queue.job(job).lease_expires_at - now).total_seconds())


def charged(queue: Queue) -> list[tuple[str, int, int]]:
    """Return status, attempts and losses of each job."""
    return [(str(row.status), row.attempt, row.losses) for row in queue.jobs()]


def test_after_an_outage_every_lease_gets_a_full_term(queue: Queue) -> None:
    queue.campaign(2)
    first, second = queue.lease_all()
    queue.begin_sweep()
    queue.be_away(seconds=75)
    begun = queue.begin_sweep()
    assert begun is not None
    assert begun.away_s == pytest.approx(75, abs=5)
    assert begun.extended == 2
    assert queue.expire() == ((), 0)
    assert left_s(queue, first.job) == pytest.approx(LEASE_S, abs=5)
    assert queue.complete(first) == ("accepted",)
    assert queue.renew(second) == [second.job]


def test_between_regular_sweeps_leases_run_out(queue: Queue) -> None:
    queue.campaign(1)
    queue.begin_sweep()
    queue.lease()
    for _ in range(6):
        queue.be_away(seconds=LEASE_S / 6 + 1)  # less than half a lease
        begun = queue.begin_sweep()
        assert begun is not None
        assert begun.extended == 0
    assert queue.expire()[1] == 1
    assert charged(queue) == [("queued", 1, 1)]


def test_the_first_sweep_of_a_database_gives_full_terms(queue: Queue) -> None:
    queue.campaign(1)
    queue.end_leases(*queue.lease())
    begun = queue.begin_sweep()
    assert begun is not None
    assert (begun.away_s, begun.extended) == (None, 1)
    assert queue.expire()[1] == 0


def test_a_lease_shorter_than_the_interval_of_sweeps_runs_out_all_the_same(queue: Queue) -> None:
    def sweep() -> None:
        queue.run(lambda c: outages.begin_sweep(c, lease_s=4.0, sweep_s=10.0, resuming=False))

    queue.campaign(1)
    sweep()
    queue.lease(lease_s=4.0)
    queue.be_away(seconds=12)  # a sweep takes place every ten seconds, or so
    sweep()
    assert queue.expire()[1] == 1
    assert charged(queue) == [("queued", 1, 1)]


def test_a_clock_that_was_put_back_is_no_outage(queue: Queue) -> None:
    queue.campaign(1)
    queue.begin_sweep()
    queue.be_away(seconds=-3600)
    queue.end_leases(*queue.lease())
    begun = queue.begin_sweep()
    assert begun is not None
    assert begun.extended == 0
    again = queue.begin_sweep()
    assert again is not None
    assert again.away_s == pytest.approx(0, abs=5)


def test_an_interrupted_lease_counts_for_nothing(queue: Queue) -> None:
    queue.campaign(1, max_attempts=1, max_losses=1)
    for _ in range(3):
        queue.begin_sweep()
        (job,) = queue.lease()
        queue.be_away(seconds=75)
        queue.begin_sweep()
        queue.end_leases(job)  # its worker never got it, or was stopped in the outage as well
        assert queue.expire() == ((), 1)
        assert charged(queue) == [("queued", 0, 0)]
        assert queue.job(job.job).not_before is None
    assert queue.complete(job) == ("accepted",), "late, but nobody else has got the job"
    assert charged(queue) == [("done", 1, 0)]


def test_a_late_failure_after_an_outage_is_charged(queue: Queue) -> None:
    queue.campaign(1, max_attempts=1)
    (job,) = queue.lease()
    queue.begin_sweep()
    queue.end_leases(job)
    queue.expire()
    assert queue.fail(job) == ("accepted",)
    assert charged(queue) == [("quarantined", 1, 0)]


def test_a_lease_that_was_renewed_after_an_outage_can_be_lost(queue: Queue) -> None:
    queue.campaign(1)
    (job,) = queue.lease()
    queue.begin_sweep()
    queue.renew(job)
    queue.run_out(job)
    assert charged(queue) == [("queued", 1, 1)]


def test_a_coordinator_that_restarts_beside_others_extends_each_lease_once(queue: Queue) -> None:
    queue.campaign(1)
    queue.begin_sweep()
    (job,) = queue.lease()
    queue.end_leases(job)
    assert queue.begin_sweep(resuming=True) is not None
    assert queue.expire()[1] == 0
    queue.end_leases(job)
    assert queue.begin_sweep(resuming=True) is not None
    assert queue.expire()[1] == 1


@on_postgres
def test_no_coordinator_takes_back_leases_while_another_one_extends_them(queue: Queue) -> None:
    queue.campaign(1)
    (job,) = queue.lease()
    queue.begin_sweep()
    queue.be_away(seconds=75)
    with queue.engines.writer.begin() as other:
        assert outages.begin_sweep(other, lease_s=LEASE_S, sweep_s=1.0, resuming=False) is not None
        assert queue.begin_sweep() is None
    begun = queue.begin_sweep()
    assert begun is not None
    assert begun.extended == 0, "the other one has done it"
    assert queue.expire()[1] == 0
    assert queue.complete(job) == ("accepted",)


def test_sweeps_of_an_idle_coordinator_hardly_ever_write(queue: Queue) -> None:
    written: list[str] = []
    event.listen(
        queue.engines.writer,
        "before_cursor_execute",
        lambda c, cursor, statement, *_: written.append(statement) if "UPDATE" in statement[:6] else None,
    )
    queue.begin_sweep()
    for _ in range(10):
        queue.begin_sweep()
    assert written == []


def service(engines: Engines, writer: Writer) -> QueueService:
    url = engines.writer.url.render_as_string(hide_password=False)
    settings = settings_for(url, lease_s=LEASE_S)
    return QueueService(settings=settings, writer=writer, on_due=lambda campaigns: None)


@sqlite_then_postgres
def test_after_a_sweep_that_failed_leases_get_a_full_term(
    engines: Engines, queue: Queue, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(sweeper: QueueService) -> None:
        await sweeper.sweep()
        queue.campaign(2)
        first, second = queue.lease_all()

        def refuse(*_: object, **__: object) -> None:
            raise Unavailable("the database is away")

        with monkeypatch.context() as patched:
            patched.setattr(outages, "begin_sweep", refuse)
            with pytest.raises(Unavailable):
                await sweeper.sweep()
        queue.end_leases(first)
        await sweeper.sweep()
        assert [row.status for row in queue.jobs()] == ["leased", "leased"]
        queue.end_leases(second)
        await sweeper.sweep()
        assert charged(queue)[1] == ("queued", 0, 0)

    writer = Writer(engines.writer)
    try:
        asyncio.run(body(service(engines, writer)))
    finally:
        writer.close()


def end_interrupted(queue: Queue, job: LeasedJob) -> None:
    """Let a lease run out after the coordinator that has just started has extended it."""
    eventually(lambda: bool(queue.job(job.job).interrupted), "the new coordinator extends the lease")
    queue.end_leases(job)
    eventually(lambda: queue.job(job.job).status == "queued", "the lease runs out")


@sqlite_then_postgres
@pytest.mark.usefixtures("small_problems", "few_trees")
def test_a_coordinator_killed_between_commit_and_answer_buries_no_job(
    database_url: str, queue: Queue
) -> None:
    document = ball(simulations=40, execution={"max_attempts": 1, "max_losses": 1, "max_failed_share": 0.0})
    campaign, granted = "", set()
    for _ in range(6):
        with coordinator(database_url, sweep_s=0.05) as client:
            campaign = campaign or submit(client, document)
            (job,) = FakeWorker(client).lease(max_jobs=1)  # the worker never gets this answer
            granted.add(job.job)
        with coordinator(database_url, sweep_s=0.05) as client:
            end_interrupted(queue, job)
    assert len(granted) == 1, "each time the same job"
    with coordinator(database_url) as client:
        done = FakeWorker(client).work(campaign)
    assert (done["status"], done["failed"], done["quarantined"]) == ("finished", 0, 0)
    assert done["digest"] == undisturbed_digest(document)


@sqlite_then_postgres
@pytest.mark.usefixtures("small_problems", "few_trees")
def test_results_of_live_workers_outlive_a_coordinator_that_is_away_longer_than_a_lease(
    database_url: str, queue: Queue
) -> None:
    document = ball(simulations=40)
    with coordinator(database_url) as client:
        campaign = submit(client, document)
        jobs = FakeWorker(client).lease(max_jobs=8)
    queue.be_away(seconds=75)
    with coordinator(database_url, sweep_s=0.05) as client:
        worker = FakeWorker(client)
        eventually(lambda: queue.job(jobs[0].job).interrupted, "the new coordinator extends the leases")
        assert set(worker.report(jobs[:4])) == {"accepted"}
        beat = {
            "worker": worker.identity,
            "leases": [{"job": job.job, "token": job.token} for job in jobs[4:]],
        }
        held = expect(client.post("/api/v1/jobs/heartbeat", json=beat))["held"]
        assert held == [job.job for job in jobs[4:]]
        queue.end_leases(*jobs[4:])
        eventually(lambda: progress(client, campaign)["leased"] == 0, "the leases run out")
        assert set(worker.report(jobs[4:])) == {"accepted"}
        assert worker.work(campaign)["digest"] == undisturbed_digest(document)


@sqlite_then_postgres
@pytest.mark.usefixtures("small_problems", "few_trees")
def test_workers_that_are_preempted_again_and_again_bury_no_job(database_url: str, queue: Queue) -> None:
    document = ball(simulations=20, execution={"max_failed_share": 0.0})
    with coordinator(database_url, sweep_s=0.05) as client:
        campaign = submit(client, document)
        for machine in range(9):
            jobs = FakeWorker(client, id=f"machine-{machine}").lease(max_jobs=20)
            assert jobs
            queue.renew(*jobs)
            queue.end_leases(*jobs)
            eventually(lambda: progress(client, campaign)["leased"] == 0, "the leases run out")
            queue.end_backoffs()
        assert max(losses for _, _, losses in charged(queue)) > 3
        done = FakeWorker(client).work(campaign)
    assert (done["status"], done["failed"]) == ("finished", 0)
    assert done["digest"] == undisturbed_digest(document)


@on_sqlite
def test_jobs_of_workers_that_died_in_an_outage_are_given_back_at_once(
    queue: Queue, engines: Engines
) -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    dead = WorkerIdentity(id="w1", host="here", pid=process.pid, machine=machine_name())
    queue.run(partial(workers.record_contact, contact=workers.Contact(worker=dead, capabilities=["x"])))
    queue.campaign(1, max_losses=1)
    queue.lease("w1")
    writer = Writer(engines.writer)
    try:
        asyncio.run(service(engines, writer).sweep())
    finally:
        writer.close()
    assert charged(queue) == [("queued", 0, 0)]

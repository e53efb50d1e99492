"""Who gets which jobs, and for how long: on SQLite and on Postgres."""

import itertools
from datetime import timedelta

import pytest
from support.problems import SIMULATOR
from support.queue import Queue

from brink.server.campaigns import store
from brink.server.campaigns.traces import request_trace
from brink.server.db.sql import database_now
from brink.server.queue import lease_store
from brink.server.states import CampaignStatus
from brink.worker.wire import LeasedJob


def test_jobs_are_granted_in_the_order_in_which_they_were_enqueued(queue: Queue) -> None:
    campaign = queue.campaign(6)
    granted = [*queue.lease(max_jobs=2), *queue.lease_all()]
    assert [job.job for job in granted] == [row.id for row in queue.jobs(campaign)]
    assert {job.attempt for job in granted} == {1}


def test_no_job_is_granted_twice(queue: Queue) -> None:
    queue.campaign(9)
    workers = itertools.cycle(("w1", "w2", "w3"))
    granted = [job.job for _ in range(12) for job in queue.lease(next(workers), max_jobs=2)]
    assert len(granted) == 9
    assert len(set(granted)) == 9


def test_a_lease_has_a_token_of_its_own_and_ends_by_the_database_clock(queue: Queue) -> None:
    queue.campaign(2)
    before = queue.run(database_now)
    first, second = queue.lease(lease_s=7.0, max_jobs=2) + queue.lease(lease_s=7.0, max_jobs=2)
    after = queue.run(database_now)
    assert first.token != second.token
    row = queue.job(first.job)
    assert row.lease_worker == "w1"
    assert before + timedelta(seconds=7) <= row.lease_expires_at <= after + timedelta(seconds=7)


def test_retries_that_nobody_here_can_run_cost_nobody_a_look(queue: Queue) -> None:
    paused, elsewhere = queue.campaign(1), queue.campaign(1, needs="other@1")
    queue.fail(*queue.lease(capabilities=(SIMULATOR,)), *queue.lease("w2", capabilities=("other@1",)))
    queue.end_backoffs()

    def due(*capabilities: str) -> int:
        return queue.run(lambda connection: lease_store.count_due_retries(connection, capabilities))

    assert (due(SIMULATOR), due("other@1"), due(SIMULATOR, "other@1"), due()) == (1, 1, 2, 0)
    queue.set_status(paused, CampaignStatus.PAUSED)
    assert due(SIMULATOR) == 0
    queue.set_status(elsewhere, CampaignStatus.CANCELLED)
    assert due(SIMULATOR, "other@1") == 0


def test_renewing_moves_the_end_of_a_lease(queue: Queue) -> None:
    queue.campaign(1)
    (job,) = queue.lease(lease_s=1.0)
    before = queue.job(job.job).lease_expires_at
    assert queue.renew(job) == [job.job]
    assert queue.job(job.job).lease_expires_at > before + timedelta(seconds=30)


def test_renewing_names_only_what_is_still_held(queue: Queue) -> None:
    campaign = queue.campaign(5)
    kept, done, lost, forged, deleted = queue.lease_all()
    queue.complete(done)
    queue.run_out(lost)
    held = queue.renew(
        kept,
        done,
        lost,
        forged.model_copy(update={"token": "guess"}),
        deleted.model_copy(update={"job": 10**9}),
    )
    assert held == [kept.job]
    queue.set_status(campaign, CampaignStatus.CANCELLED)
    assert queue.renew(kept, deleted) == []


def test_a_lease_that_ran_out_goes_back_after_a_backoff_with_a_charge(queue: Queue) -> None:
    queue.campaign(1)
    (job,) = queue.lease()
    queue.run_out(job)
    row = queue.job(job.job)
    assert (row.status, row.attempt) == ("queued", 1)
    assert row.not_before > queue.run(database_now)
    assert "w1" in row.last_error
    assert queue.lease() == []
    queue.end_backoffs()
    (again,) = queue.lease()
    assert (again.job, again.attempt) == (job.job, 2)
    assert again.token != job.token


def test_backoffs_double(queue: Queue) -> None:
    queue.campaign(1, max_attempts=5)
    waits = []
    for _ in range(3):
        (job,) = queue.lease()
        queue.fail(job)
        waits.append((queue.job(job.job).not_before - queue.run(database_now)).total_seconds())
        queue.end_backoffs()
    assert waits == pytest.approx([10.0, 20.0, 40.0], abs=5.0)


def failed_once(queue: Queue, *, priority: int = 0, worker: str = "w1") -> LeasedJob:
    """Return a job that was tried before and is due again."""
    queue.campaign(1, priority=priority)
    (tried,) = queue.lease(worker, max_jobs=1)
    queue.fail(tried)
    queue.end_backoffs()
    return tried


def test_a_worker_that_holds_jobs_drains_for_a_due_retry(queue: Queue) -> None:
    queue.campaign(9)
    held = queue.lease("w1", max_jobs=2)
    tried = failed_once(queue, priority=1, worker="w2")
    assert queue.lease("w1") == []
    queue.complete(held[0])
    assert queue.lease("w1") == []
    queue.complete(held[1])
    assert [job.job for job in queue.lease("w1")] == [tried.job]
    assert len(queue.lease("w2", max_jobs=4)) == 4  # nothing waits any more


def test_a_worker_that_fetches_ahead_takes_a_retry_within_one_round_of_its_holdings(queue: Queue) -> None:
    queue.campaign(60)
    tried = failed_once(queue, priority=1)
    queue.campaign(1, priority=9)
    order: list[LeasedJob] = []
    held: list[LeasedJob] = []
    while tried.job not in [job.job for job in order]:
        granted = queue.lease("w1", max_jobs=max(1, 8 - len(held)))
        held += granted
        order += granted
        queue.complete(held.pop(0))  # always asks before the last one is done
    assert len(order) == 8 + 1


def test_a_worker_does_not_drain_for_a_retry_that_it_must_not_have(queue: Queue) -> None:
    queue.campaign(9)
    queue.lease("w1", max_jobs=2)
    (bad,) = queue.lease("w1", max_jobs=1)
    queue.fail(bad)
    queue.end_backoffs()
    assert len(queue.lease("w1", max_jobs=3, elsewhere=[SIMULATOR])) == 3
    assert queue.lease("w1", max_jobs=3) == []


def test_a_picture_is_waited_for_whether_it_was_tried_before_or_not(queue: Queue) -> None:
    shown = queue.campaign(2, priority=-1)
    queue.complete(*queue.lease())
    found = queue.run(lambda connection: store.CAMPAIGNS.find(connection, shown))
    assert found is not None
    tried = failed_once(queue)
    queue.run(lambda connection: request_trace(connection, found, 0))
    (trace,) = queue.lease("w2")
    assert trace.record  # a fresh picture before an episode that was tried before
    queue.fail(trace)
    queue.end_backoffs()
    queue.campaign(5, priority=5)
    (again,) = queue.lease("w3")
    assert (again.job, again.attempt) == (trace.job, 2)  # before everything
    assert tried.job not in [job.job for job in queue.lease("w4")]


@pytest.mark.parametrize("elsewhere", [(), ("other@1",)])
def test_a_job_nobody_else_can_run_is_retried_by_the_same_worker(
    queue: Queue, elsewhere: tuple[str, ...]
) -> None:
    queue.campaign(1)
    queue.fail(*queue.lease("w1"))
    queue.end_backoffs()
    assert [job.attempt for job in queue.lease("w1", elsewhere=elsewhere)] == [2]


def test_a_retry_that_is_given_back_still_avoids_the_worker_that_failed_it(queue: Queue) -> None:
    queue.campaign(1)
    queue.fail(*queue.lease("w1"))
    queue.end_backoffs()
    queue.release(*queue.lease("w2", elsewhere=[SIMULATOR]))
    assert queue.lease("w1", elsewhere=[SIMULATOR]) == []
    assert len(queue.lease("w2", elsewhere=[SIMULATOR])) == 1


def test_only_the_holder_can_release(queue: Queue) -> None:
    queue.campaign(2)
    job, done = queue.lease_all()
    queue.complete(done)
    assert queue.release(job.model_copy(update={"token": "guess"}), done) == 0
    assert queue.job(job.job).status == "leased"
    assert queue.job(done.job).status == "done"

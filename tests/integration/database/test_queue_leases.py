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


def campaigns_of(queue: Queue, jobs: list[LeasedJob]) -> list[str]:
    return [queue.job(job.job).campaign_id for job in jobs]


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


def test_the_end_of_the_queue_is_shared_out_in_small_grants(queue: Queue) -> None:
    queue.campaign(32)
    sizes = []
    workers = itertools.cycle(("w1", "w2", "w3", "w4"))
    while granted := queue.lease(next(workers), max_jobs=8, live_workers=4):
        sizes.append(len(granted))
    assert sum(sizes) == 32
    assert sizes[0] == 6  # two thirds of an equal share of 32 among 4
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-4:] == [1, 1, 1, 1]


def test_the_higher_priority_goes_first(queue: Queue) -> None:
    low = queue.campaign(3, priority=-1)
    high = queue.campaign(3, priority=5)
    middle = queue.campaign(3)
    order = campaigns_of(queue, queue.lease_all())
    assert order == [high] * 3 + [middle] * 3 + [low] * 3


def test_campaigns_of_one_priority_take_turns_of_four_jobs_a_worker(queue: Queue) -> None:
    campaigns = [queue.campaign(30) for _ in range(3)]
    order = [campaigns_of(queue, queue.lease(max_jobs=1, live_workers=2))[0] for _ in range(48)]
    assert order == [campaign for _ in range(2) for campaign in campaigns for _ in range(8)]


def test_a_campaign_without_fresh_jobs_gives_its_turn_away(queue: Queue) -> None:
    first, second = queue.campaign(2), queue.campaign(8)
    assert campaigns_of(queue, queue.lease(max_jobs=5)) == [first] * 2 + [second] * 3


def test_a_turn_ends_with_the_grant_that_reaches_its_end(queue: Queue) -> None:
    first, second = queue.campaign(40), queue.campaign(40)
    order = [campaigns_of(queue, queue.lease(max_jobs=size)) for size in (3, 3, 10, 1)]
    assert order == [[first] * 3, [first] * 3, [second] * 10, [first]]


def test_turns_that_end_together_end_in_their_order(queue: Queue) -> None:
    first, second = queue.campaign(40), queue.campaign(40)
    granted = queue.lease_together([("w1", 4, (SIMULATOR,)), ("w2", 4, (SIMULATOR,))])
    assert [campaigns_of(queue, jobs) for jobs in granted] == [[first] * 4, [second] * 4]
    assert campaigns_of(queue, queue.lease(max_jobs=1)) == [first]


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


def test_a_worker_gets_only_what_it_can_run(queue: Queue) -> None:
    queue.campaign(3, needs="other@1")
    mine = queue.campaign(3, needs="faulty@1")
    assert set(campaigns_of(queue, queue.lease_all())) == {mine}
    assert queue.lease("w2", capabilities=()) == []
    assert len(queue.lease("w2", capabilities=("vision", "other@1"), max_jobs=1)) == 1


@pytest.mark.parametrize("status", [CampaignStatus.PAUSED, CampaignStatus.CANCELLED, CampaignStatus.FAILED])
def test_a_campaign_that_does_not_run_hands_out_nothing(queue: Queue, status: CampaignStatus) -> None:
    campaign = queue.campaign(3)
    queue.set_status(campaign, status)
    assert queue.lease() == []


def test_a_resumed_campaign_hands_out_its_jobs_again(queue: Queue) -> None:
    campaign = queue.campaign(3)
    queue.set_status(campaign, CampaignStatus.PAUSED)
    queue.set_status(campaign, CampaignStatus.RUNNING)
    assert len(queue.lease_all()) == 3


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


def test_a_job_that_was_tried_before_is_granted_alone(queue: Queue) -> None:
    queue.campaign(4)
    guilty, *others = queue.lease_all()
    queue.run_out(guilty, *others)
    queue.end_backoffs()
    assert len(queue.lease("w1")) == 1
    assert queue.lease("w1") == []  # w1 holds a job that was tried before
    assert len(queue.lease("w2")) == 1


def test_a_worker_that_holds_jobs_gets_no_job_that_was_tried_before(queue: Queue) -> None:
    queue.campaign(2)
    first, second = queue.lease_all()
    queue.fail(first)
    queue.end_backoffs()
    assert queue.lease("w1") == []
    assert queue.complete(second) == ("accepted",)
    assert [job.job for job in queue.lease("w1")] == [first.job]


def failed_once(queue: Queue, *, priority: int = 0, worker: str = "w1") -> LeasedJob:
    """Return a job that was tried before and is due again."""
    queue.campaign(1, priority=priority)
    (tried,) = queue.lease(worker, max_jobs=1)
    queue.fail(tried)
    queue.end_backoffs()
    return tried


@pytest.mark.parametrize("priority", [0, 3])
def test_due_retry_goes_alone_before_fresh_jobs_of_its_priority_or_lower(queue: Queue, priority: int) -> None:
    tried = failed_once(queue, priority=priority)
    queue.campaign(8)
    assert [(job.job, job.attempt) for job in queue.lease("w2")] == [(tried.job, 2)]
    assert len(queue.lease("w3", max_jobs=4)) == 4


def test_a_due_retry_waits_for_fresh_jobs_of_a_higher_priority(queue: Queue) -> None:
    tried = failed_once(queue)
    high = queue.campaign(2, priority=1)
    fresh = queue.lease("w2")
    assert campaigns_of(queue, fresh) == [high, high]
    queue.complete(*fresh)
    assert [job.job for job in queue.lease("w2")] == [tried.job]


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


def test_nobody_drains_for_a_retry_before_its_backoff_is_over(queue: Queue) -> None:
    queue.campaign(9)
    _, failed = queue.lease("w1", max_jobs=2)
    queue.fail(failed)
    assert len(queue.lease("w1", max_jobs=3)) == 3


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


@pytest.mark.parametrize("lost", ["failed", "ran out"])
def test_a_job_is_retried_by_another_worker_than_the_one_that_failed_it(queue: Queue, lost: str) -> None:
    queue.campaign(1)
    (job,) = queue.lease("w1")
    if lost == "failed":
        queue.fail(job)
    else:
        queue.run_out(job)
    queue.end_backoffs()
    assert queue.lease("w1", elsewhere=[SIMULATOR]) == []
    (again,) = queue.lease("w2", elsewhere=[SIMULATOR])
    queue.fail(again)
    queue.end_backoffs()
    assert queue.lease("w2", elsewhere=[SIMULATOR]) == []
    assert [third.attempt for third in queue.lease("w1", elsewhere=[SIMULATOR])] == [3]


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


def test_a_released_job_costs_no_attempt(queue: Queue) -> None:
    queue.campaign(1, max_attempts=1)
    (job,) = queue.lease()
    assert queue.release(job) == 1
    row = queue.job(job.job)
    assert (row.status, row.attempt, row.not_before) == ("queued", 0, None)
    (again,) = queue.lease("w2")
    assert again.attempt == 1


def test_only_the_holder_can_release(queue: Queue) -> None:
    queue.campaign(2)
    job, done = queue.lease_all()
    queue.complete(done)
    assert queue.release(job.model_copy(update={"token": "guess"}), done) == 0
    assert queue.job(job.job).status == "leased"
    assert queue.job(done.job).status == "done"


def test_only_one_of_equal_simulations_is_granted(queue: Queue) -> None:
    first = queue.campaign(["a" * 64, "b" * 64, "a" * 64])
    second = queue.campaign(["b" * 64])
    granted = queue.lease_all("w1") + queue.lease_all("w2")
    assert len(granted) == 2
    assert sorted(queue.states(first) + queue.states(second)) == ["leased", "leased", "queued", "queued"]


def test_without_the_cache_equal_simulations_are_all_granted(queue: Queue) -> None:
    queue.campaign(["a" * 64, "a" * 64], cache=False)
    assert len(queue.lease_all()) == 2


def test_who_comes_second_gets_as_much_as_if_it_had_come_later(queue: Queue) -> None:
    queue.campaign(30)
    first, second, third = queue.lease_together([(name, 5, (SIMULATOR,)) for name in ("w1", "w2", "w3")])
    assert [job.job for job in (*first, *second, *third)] == list(range(1, 16))

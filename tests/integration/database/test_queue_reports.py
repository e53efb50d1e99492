"""What becomes of reported outcomes: on SQLite and on Postgres."""

import pytest
from sqlalchemy import update
from support.databases import on_sqlite
from support.problems import SIMULATOR
from support.queue import RESULT, TERMS, Queue

from brink.server.campaigns import store
from brink.server.campaigns.store import retry_job
from brink.server.campaigns.traces import request_trace
from brink.server.db.models import CampaignRow, JobRow, TraceRow
from brink.server.db.sql import database_now
from brink.server.errors import NotFound
from brink.server.queue import report_store
from brink.server.queue.exchange import Exchange
from brink.server.queue.lease_policy import LeaseDemand
from brink.server.queue.report_store import Outcome
from brink.server.states import CampaignStatus
from brink.worker.wire import LeasedJob

A, B = "a" * 64, "b" * 64


def one_lease(queue: Queue, max_attempts: int = 3, max_losses: int = 3) -> LeasedJob:
    queue.campaign(1, max_attempts=max_attempts, max_losses=max_losses)
    (job,) = queue.lease()
    return job


def test_a_result_finishes_its_job(queue: Queue) -> None:
    job = one_lease(queue)
    assert queue.complete(job) == ("accepted",)
    row = queue.job(job.job)
    assert (row.status, row.result, row.lease_expires_at) == ("done", RESULT, None)
    assert row.finished_at is not None


def test_a_result_sent_again_is_a_duplicate_and_changes_nothing(queue: Queue) -> None:
    job = one_lease(queue)
    queue.complete(job)
    before = queue.job(job.job)
    assert queue.complete(job, result='{"other":1}') == ("duplicate",)
    assert queue.fail(job) == ("duplicate",)
    assert queue.job(job.job) == before


@pytest.mark.parametrize("change", [{"token": "guess"}, {"job": 10**9}])
def test_a_result_without_a_lease_is_stale(queue: Queue, change: dict[str, object]) -> None:
    job = one_lease(queue)
    before = queue.job(job.job)
    assert queue.complete(job.model_copy(update=change)) == ("stale",)
    assert queue.job(job.job) == before


def test_a_late_result_is_accepted_once_while_its_job_waits(queue: Queue) -> None:
    job = one_lease(queue)
    queue.run_out(job)
    assert queue.complete(job, job) == ("accepted", "duplicate")
    row = queue.job(job.job)
    assert (row.status, row.result, row.attempt, row.losses) == ("done", RESULT, 1, 0)
    assert queue.complete(job) == ("duplicate",)
    assert queue.job(job.job) == row


def test_a_late_result_finishes_equal_simulations_and_names_their_campaigns(queue: Queue) -> None:
    first, second = queue.campaign([A]), queue.campaign([A])
    (job,) = queue.lease()
    queue.run_out(job)
    report = queue.report(Outcome(job=job.job, token=job.token, result=RESULT))
    assert (report.statuses, set(report.campaigns)) == (("accepted",), {first, second})
    assert queue.states(first) == queue.states(second) == ["done"]


def test_a_late_result_is_stale_when_an_equal_simulation_was_faster(queue: Queue) -> None:
    queue.campaign([A, A])
    (late,) = queue.lease()
    queue.run_out(late)
    (fast,) = queue.lease("w2")
    assert fast.job != late.job
    queue.complete(fast, result='{"fast":1}')
    assert queue.complete(late) == ("stale",)
    assert queue.job(late.job).result == '{"fast":1}'


def test_a_late_result_is_taken_after_a_retry_by_hand(queue: Queue) -> None:
    job = one_lease(queue, max_losses=1)
    queue.run_out(job)
    queue.retry(job.job)
    assert queue.complete(job) == ("accepted",)


def test_a_late_result_is_stale_while_another_worker_runs_its_job(queue: Queue) -> None:
    job = one_lease(queue)
    queue.run_out(job)
    queue.end_backoffs()
    (again,) = queue.lease("w2")
    assert queue.complete(job) == ("stale",)
    assert queue.job(job.job).status == "leased"
    assert queue.complete(again, result='{"second":1}') == ("accepted",)
    assert queue.complete(job) == ("stale",)
    assert queue.job(job.job).result == '{"second":1}'


def test_a_result_of_a_deleted_campaign_is_stale(queue: Queue) -> None:
    campaign = queue.campaign(2)
    (job,) = queue.lease(max_jobs=1)
    queue.delete(campaign)
    assert queue.complete(job) == ("stale",)
    assert queue.jobs() == []


def test_a_result_of_a_paused_campaign_is_taken_in(queue: Queue) -> None:
    campaign = queue.campaign(1)
    (job,) = queue.lease()
    queue.set_status(campaign, CampaignStatus.PAUSED)
    report = queue.report(Outcome(job=job.job, token=job.token, result=RESULT))
    assert report.statuses == ("accepted",)
    assert report.campaigns == ()  # a paused campaign takes no step
    assert queue.states(campaign) == ["done"]


def test_statuses_come_in_the_order_of_the_outcomes(queue: Queue) -> None:
    queue.campaign(3)
    first, second, third = queue.lease_all()
    forged = second.model_copy(update={"token": "guess"})
    assert queue.complete(third, forged, first, third) == ("accepted", "stale", "accepted", "duplicate")


def test_the_last_outcome_names_the_campaign_whose_step_is_due(queue: Queue) -> None:
    campaign = queue.campaign(2)
    other = queue.campaign(1)
    leased = {queue.job(job.job).campaign_id: job for job in queue.lease_all()}
    jobs = [job for job in queue.jobs() if job.campaign_id == campaign]
    assert len(jobs) == 2
    last = LeasedJob(job=jobs[1].id, token=jobs[1].lease_token, attempt=1, spec={}, timeout_s=1)
    first = LeasedJob(job=jobs[0].id, token=jobs[0].lease_token, attempt=1, spec={}, timeout_s=1)
    assert queue.report(Outcome(job=first.job, token=first.token, result=RESULT)).campaigns == ()
    assert queue.report(Outcome(job=last.job, token=last.token, result=RESULT)).campaigns == (campaign,)
    done = leased[other]
    report = queue.report(Outcome(job=done.job, token=done.token, result=None, error="no", final=True))
    assert report.campaigns == (other,)


def test_a_due_step_is_named_although_a_job_of_a_later_generation_is_granted(queue: Queue) -> None:
    campaign = queue.campaign(5)
    queue.run(lambda connection: connection.execute(update(CampaignRow).values(generation_end=3)))
    first, second = queue.lease(max_jobs=2)
    demand = LeaseDemand(worker="w1", capabilities=(SIMULATOR,), max_jobs=1, terms=TERMS)

    def report_and_lease(job: LeasedJob) -> tuple[tuple[str, ...], LeasedJob]:
        outcome = Outcome(job=job.job, token=job.token, result=RESULT)
        ((report, (granted,)),) = queue.exchange(Exchange(terms=TERMS, outcomes=(outcome,), demand=demand))
        return report.campaigns, granted

    idle, third = report_and_lease(first)
    assert (idle, queue.job(third.job).number) == ((), 2)
    idle, fourth = report_and_lease(second)
    assert (idle, queue.job(fourth.job).number) == ((), 3), "the third one is still running"
    idle, fifth = report_and_lease(third)
    assert (idle, queue.job(fifth.job).number) == ((campaign,), 4)


def test_a_job_that_kills_each_of_its_workers_ends_in_quarantine(queue: Queue) -> None:
    campaign = queue.campaign(1, max_attempts=2, max_losses=4)
    for times in range(1, 5):
        assert queue.states(campaign) == ["queued"]
        queue.run_out(*queue.lease(f"w{times}"))
        queue.end_backoffs()
    row = queue.jobs(campaign)[0]
    assert (row.status, row.losses) == ("quarantined", 4)
    assert row.last_error == (
        "lease expired: worker w4 stopped responding, the 4th time that this job lost its worker: "
        "does it kill its workers, or were they all stopped?"
    )


def test_backoffs_of_losses_do_not_add_to_those_of_failures(queue: Queue) -> None:
    job = one_lease(queue, max_losses=9)
    for _ in range(3):
        queue.run_out(job)
        queue.end_backoffs()
        (job,) = queue.lease()
    queue.fail(job)
    wait_s = (queue.job(job.job).not_before - queue.run(database_now)).total_seconds()
    assert wait_s == pytest.approx(10.0, abs=5.0)


def test_a_job_that_is_lost_a_thousand_times_has_the_longest_backoff(queue: Queue) -> None:
    job = one_lease(queue, max_losses=1000)
    queue.run(lambda connection: connection.execute(update(JobRow).values(losses=998, attempt=999)))
    queue.run_out(job)
    wait_s = (queue.job(job.job).not_before - queue.run(database_now)).total_seconds()
    assert wait_s == pytest.approx(report_store.MAX_BACKOFF_S, abs=5.0)


def test_the_last_lease_to_run_out_names_the_campaign_whose_step_is_due(queue: Queue) -> None:
    campaign = queue.campaign(1, max_losses=1)
    queue.lease(lease_s=-1.0)
    assert queue.expire() == ((campaign,), 1)


def test_a_sweep_takes_back_the_oldest_expired_leases(queue: Queue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_store, "MAX_EXPIRED", 3)
    queue.campaign(10)
    late = [*queue.lease("w1", max_jobs=2, lease_s=-1.0), *queue.lease("w2", max_jobs=1, lease_s=-2.0)]
    oldest = queue.lease("w3", max_jobs=2, lease_s=-3.0)
    assert queue.expire()[1] == 3
    assert {queue.job(job.job).status for job in (*oldest, late[2])} == {"queued"}
    assert {queue.job(job.job).status for job in late[:2]} == {"leased"}
    assert queue.complete(*late[:2]) == ("accepted", "accepted"), "those still hold"
    assert {queue.job(job.job).losses for job in oldest} == {1}
    assert queue.expire()[1] == 0


@on_sqlite
def test_more_leases_run_out_at_once_than_a_statement_has_parameters(queue: Queue) -> None:
    campaign = queue.campaign(40)
    jobs = queue.lease_all()
    queue.end_leases(*jobs)
    queue.limit_parameters(30)
    assert queue.expire() == ((), 40)
    assert queue.states(campaign) == ["queued"] * 40


def test_one_result_finishes_all_equal_simulations(queue: Queue) -> None:
    first = queue.campaign([A, B, A])
    second = queue.campaign([A])
    paused = queue.campaign([A])
    queue.set_status(paused, CampaignStatus.PAUSED)
    by_hash = {queue.job(job.job).spec_hash: job for job in queue.lease_all()}
    report = queue.report(Outcome(job=by_hash[A].job, token=by_hash[A].token, result='{"of":"a"}'))
    assert report.campaigns == (second,)
    assert queue.states(first) == ["done", "leased", "done"]
    assert queue.states(second) == queue.states(paused) == ["done"]
    assert {row.result for row in queue.jobs() if row.spec_hash == A} == {'{"of":"a"}'}


def test_a_trace_is_kept_with_its_result(queue: Queue) -> None:
    job = one_lease(queue)
    report = queue.report(Outcome(job=job.job, token=job.token, result=RESULT, trace=b"the trace"))
    assert report.statuses == ("accepted",)
    kept = queue.run(lambda c: [(r.spec_hash, r.data) for r in c.execute(TraceRow.__table__.select())])
    assert kept == [(queue.job(job.job).spec_hash, b"the trace")]


def test_a_quarantined_trace_can_be_retried_by_hand(queue: Queue) -> None:
    campaign = queue.campaign(1)
    queue.complete(*queue.lease())
    found = queue.run(lambda connection: store.CAMPAIGNS.find(connection, campaign))
    assert found is not None
    queue.set_status(campaign, CampaignStatus.FINISHED)
    assert queue.run(lambda connection: request_trace(connection, found, 0))
    (trace,) = queue.lease()
    assert trace.record
    queue.fail(trace, final=True)
    queue.run(lambda connection: retry_job(connection, trace.job))
    assert [job.job for job in queue.lease()] == [trace.job]


def test_retrying_an_unknown_job_is_not_found(queue: Queue) -> None:
    with pytest.raises(NotFound, match="7"):
        queue.run(lambda connection: retry_job(connection, 7))


def test_deleting_takes_its_traces_but_not_those_of_others(queue: Queue) -> None:
    gone = queue.campaign([A, B])
    kept = queue.campaign([B], cache=False)
    for job in queue.lease_all():
        queue.report(Outcome(job=job.job, token=job.token, result=RESULT, trace=b"t"))
    queue.delete(gone)
    left = queue.run(lambda c: [r.spec_hash for r in c.execute(TraceRow.__table__.select())])
    assert left == [B]
    assert queue.states(kept) == ["done"]

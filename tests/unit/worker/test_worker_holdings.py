"""The holdings keep every job in one place until the coordinator has answered for it."""

from dataclasses import dataclass

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from brink.worker.holdings import MAX_BATCH_BYTES, Holdings, Poll, Report
from brink.worker.pace import Pace
from brink.worker.wire import Completed, HeldLease, JobFailed, LeasedJob, LeaseReply, ResultStatus

DONE = Completed(verdicts={})
FAILED = JobFailed(reason="crashed", message="bang")


@dataclass
class Clock:
    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


def leased(number: int) -> LeasedJob:
    return LeasedJob(job=number, token=f"t{number}", attempt=1, spec={}, timeout_s=1.0)


def grant(*numbers: int) -> LeaseReply:
    return LeaseReply(jobs=[leased(number) for number in numbers], lease_s=60.0)


def holdings(clock: Clock, *, hold: int = 5, **options: float) -> Holdings:
    """Return holdings whose pace is such that `hold` jobs are held and more are asked for when one waits."""
    return Holdings(
        Pace(max_jobs=hold, prefetch_s=100.0, episode_s=1.0, round_trip_s=0.01), clock=clock, **options
    )


def take(held: Holdings) -> LeasedJob:
    job = held.take(wait=False)
    assert job is not None
    return job


def finish(held: Holdings, job: LeasedJob, *, size_bytes: int = 10) -> None:
    held.finish(job, DONE, wall_s=1.0, size_bytes=size_bytes)


def report(held: Holdings) -> Report:
    errand = held.next_errand()
    assert isinstance(errand, Report)
    return errand


def accept(held: Holdings, errand: Report) -> None:
    statuses = [ResultStatus(job=o.leased.job, status="accepted") for o in errand.outcomes]
    held.acknowledged(errand, statuses, wall_s=0.01)


def test_an_empty_handed_worker_waits_for_jobs() -> None:
    assert holdings(Clock()).next_errand() == Poll(room=5, idle_left_s=None)


def test_more_jobs_are_asked_for_while_one_still_waits_and_the_report_goes_along() -> None:
    held = holdings(Clock())
    held.granted(grant(1, 2, 3))
    finish(held, take(held))
    take(held)
    errand = report(held)
    assert [outcome.leased.job for outcome in errand.outcomes] == [1]
    assert errand.room == 3


def test_the_last_outcome_is_reported_at_once() -> None:
    held = holdings(Clock(), report_after_s=3600.0)
    held.granted(grant(1))
    finish(held, take(held))
    assert len(report(held).outcomes) == 1


def test_what_is_left_of_an_empty_queue_is_reported_at_once_when_it_is_done() -> None:
    held = holdings(Clock(), report_after_s=3600.0)
    held.granted(grant(1, 2, 3))
    finish(held, take(held))
    last = [take(held), take(held)]
    errand = report(held)
    held.granted(LeaseReply(jobs=[], lease_s=60.0))
    accept(held, errand)
    finish(held, last[0])
    assert held._errand(100.0) is None  # not yet: nobody waits for a part of a generation
    finish(held, last[1])
    errand = report(held)
    assert [outcome.leased.job for outcome in errand.outcomes] == [2, 3]
    assert errand.room == 5


def test_an_outcome_does_not_grow_old_while_others_run() -> None:
    clock = Clock()
    held = holdings(clock, hold=50, report_after_s=1.0)
    held.granted(grant(*range(40)))
    finish(held, take(held))
    clock.now_s += 1.0
    assert [outcome.leased.job for outcome in report(held).outcomes] == [0]


def test_an_outcome_stays_until_it_is_acknowledged() -> None:
    clock = Clock()
    held = holdings(clock)
    held.granted(grant(1))
    finish(held, take(held))
    first = report(held)
    held.postpone(2.0)
    clock.now_s += 2.0
    assert report(held).outcomes == first.outcomes
    accept(held, first)
    assert isinstance(held.next_errand(), Poll)


def test_a_lost_job_that_waits_is_dropped_and_a_lost_job_that_runs_has_no_outcome() -> None:
    held = holdings(Clock())
    held.granted(grant(1, 2, 3))
    running = take(held)
    held.renewed(held.leases(), [3])
    assert [lease.job for lease in held.leases()] == [1, 3]
    assert held.lost_for_s() == (running, 0.0)
    finish(held, running)
    assert held.unsent == 0
    assert [lease.job for lease in held.leases()] == [3]


def test_a_heartbeat_reply_says_nothing_of_jobs_leased_after_its_request() -> None:
    held = holdings(Clock())
    held.granted(grant(1))
    asked = held.leases()
    held.granted(grant(2))
    held.renewed(asked, [1])
    assert [lease.job for lease in held.leases()] == [1, 2]


def test_a_heartbeat_reply_about_an_old_lease_says_nothing_of_a_new_one() -> None:
    held = holdings(Clock())
    held.granted(grant(1))
    held.renewed([HeldLease(job=1, token="older")], [])
    assert [lease.job for lease in held.leases()] == [1]


def test_an_outcome_is_reported_even_if_its_lease_seems_lost() -> None:
    held = holdings(Clock())
    held.granted(grant(1))
    finish(held, take(held))
    held.renewed(held.leases(), [])
    assert [outcome.leased.job for outcome in report(held).outcomes] == [1]


def test_after_a_stop_nothing_starts_and_what_waits_is_given_back() -> None:
    held = holdings(Clock())
    held.granted(grant(1, 2, 3))
    running = take(held)
    held.stop()
    assert held.take(wait=True) is None
    errand = report(held)
    assert [lease.job for lease in errand.release] == [2, 3]
    assert errand.room == 0
    accept(held, errand)
    finish(held, running)
    held.runner_ends()
    accept(held, report(held))
    assert held.next_errand() is None


def test_jobs_that_are_granted_after_a_stop_are_given_back() -> None:
    held = holdings(Clock())
    held.stop()
    held.runner_ends()
    held.granted(grant(1))
    assert [lease.job for lease in report(held).release] == [1]


def test_jobs_come_back_from_the_child_in_their_order() -> None:
    held = holdings(Clock())
    held.granted(grant(1, 2, 3))
    held.put_back([take(held), take(held)])
    assert [take(held).job for _ in range(3)] == [1, 2, 3]


def test_a_report_is_bounded_in_bytes_and_one_large_outcome_still_goes() -> None:
    held = holdings(Clock())
    held.granted(grant(1, 2, 3))
    for size_bytes in (2 * MAX_BATCH_BYTES, 10, 10):
        finish(held, take(held), size_bytes=size_bytes)
    errand = report(held)
    assert [outcome.leased.job for outcome in errand.outcomes] == [1]
    accept(held, errand)
    assert [outcome.leased.job for outcome in report(held).outcomes] == [2, 3]


def test_a_refused_report_is_sent_one_by_one_and_the_culprit_becomes_an_error() -> None:
    held = holdings(Clock())
    held.granted(grant(1, 2))
    for _ in range(2):
        finish(held, take(held))
    held.refused(report(held), "422")
    alone = report(held)
    assert [outcome.leased.job for outcome in alone.outcomes] == [1]
    assert alone.room == 0
    held.refused(alone, "422 too strange")
    again = report(held)
    assert isinstance(again.outcomes[0].outcome, JobFailed)
    accept(held, again)
    assert [outcome.leased.job for outcome in report(held).outcomes] == [2]


def test_a_worker_leaves_when_idle_but_not_without_having_asked() -> None:
    clock = Clock()
    held = Holdings(Pace(max_jobs=5, prefetch_s=1.0), exit_when_idle_s=0.0, clock=clock)
    assert isinstance(held.next_errand(), Poll)
    held.granted(grant())
    assert held.next_errand() is None


def test_a_worker_with_unsent_outcomes_does_not_leave() -> None:
    clock = Clock()
    held = Holdings(Pace(max_jobs=5, prefetch_s=1.0), exit_when_idle_s=1.0, clock=clock)
    held.granted(grant(1))
    finish(held, take(held))
    held.postpone(5.0)
    clock.now_s += 10.0
    assert isinstance(held.next_errand(), Report)


class Life(RuleBasedStateMachine):
    """Any order of events: no job is lost, none is in two places."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = Clock()
        self.held = holdings(self.clock, hold=4)
        self.given: set[int] = set()
        self.ended: set[int] = set()
        self.child: list[LeasedJob] = []
        self.lost: set[int] = set()
        self.stopped = False

    @rule(count=st.integers(0, 4))
    def grant(self, count: int) -> None:
        numbers = range(len(self.given), len(self.given) + count)
        self.given.update(numbers)
        self.held.granted(grant(*numbers))

    @precondition(lambda self: len(self.child) < 2)
    @rule()
    def take(self) -> None:
        job = self.held.take(wait=False)
        assert job is None or not self.stopped
        if job is not None:
            self.child.append(job)

    @precondition(lambda self: self.child)
    @rule(failed=st.booleans())
    def finish(self, failed: bool) -> None:
        job = self.child.pop(0)
        self.held.finish(job, FAILED if failed else DONE, wall_s=0.1, size_bytes=10)
        if job.job in self.lost:
            self.ended.add(job.job)

    @precondition(lambda self: self.child)
    @rule()
    def put_back(self) -> None:
        self.held.put_back(self.child)
        self.ended.update(job.job for job in self.child if job.job in self.lost)
        self.child = []

    @precondition(lambda self: self.held.leases() and not self.stopped)
    @rule(data=st.data())
    def lose(self, data: st.DataObject) -> None:
        asked = self.held.leases()
        gone = data.draw(st.sampled_from(asked)).job
        before = {lease.job for lease in self.held.leases()}
        self.held.renewed(asked, [lease.job for lease in asked if lease.job != gone])
        self.ended |= before - {lease.job for lease in self.held.leases()}
        if any(job.job == gone for job in self.child):
            self.lost.add(gone)

    @precondition(lambda self: self.held.unsent or (self.stopped and self.held.leases() and not self.child))
    @rule(fate=st.sampled_from(["acknowledged", "away"]))
    def report(self, fate: str) -> None:
        self.clock.now_s += 100.0
        errand = self.held.next_errand()
        assert isinstance(errand, Report)
        if fate == "away":
            self.held.postpone(1.0)
            return
        accept(self.held, errand)
        self.ended.update(outcome.leased.job for outcome in errand.outcomes)
        self.ended.update(lease.job for lease in errand.release)

    @rule()
    def stop(self) -> None:
        self.stopped = True
        self.held.stop()

    @invariant()
    def every_job_is_held_once_or_has_ended(self) -> None:
        held = [lease.job for lease in self.held.leases()]
        assert len(held) == len(set(held))
        assert set(held).isdisjoint(self.ended)
        assert set(held) | self.ended == self.given


TestLife = Life.TestCase
TestLife.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)


@pytest.mark.parametrize("status", ["accepted", "duplicate", "stale"])
def test_every_status_ends_a_job(status: str) -> None:
    held = holdings(Clock())
    held.granted(grant(1))
    finish(held, take(held))
    answer = ResultStatus.model_validate({"job": 1, "status": status})
    held.acknowledged(report(held), [answer], wall_s=0.01)
    assert held.leases() == ()

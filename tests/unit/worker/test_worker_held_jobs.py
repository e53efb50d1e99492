"""Every held job is in one place until the coordinator acknowledges its outcome; prefetching stays in bounds."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from brink.worker.held_jobs import MAX_BATCH_BYTES, HeldJobs, Poll, PrefetchPolicy, Report
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


def held_jobs(clock: Clock, *, capacity: int = 5, **options: float) -> HeldJobs:
    """Return held jobs that keep `capacity` jobs and lease more when one waits."""
    return HeldJobs(
        PrefetchPolicy(max_jobs=capacity, prefetch_s=100.0, episode_s=1.0, round_trip_s=0.01),
        clock=clock,
        **options,
    )


def take(held: HeldJobs) -> LeasedJob:
    job = held.take(wait=False)
    assert job is not None
    return job


def finish(held: HeldJobs, job: LeasedJob, *, size_bytes: int = 10) -> None:
    held.finish(job, DONE, wall_s=1.0, size_bytes=size_bytes)


def report(held: HeldJobs) -> Report:
    request = held.next_request()
    assert isinstance(request, Report)
    return request


def accept(held: HeldJobs, request: Report) -> None:
    statuses = [ResultStatus(job=o.leased.job, status="accepted") for o in request.outcomes]
    held.acknowledge(request, statuses, wall_s=0.01)


def test_a_worker_without_jobs_polls() -> None:
    assert held_jobs(Clock()).next_request() == Poll(room=5, idle_left_s=None)


def test_a_report_leases_more_jobs_while_one_still_waits() -> None:
    held = held_jobs(Clock())
    held.add(grant(1, 2, 3))
    finish(held, take(held))
    take(held)
    request = report(held)
    assert [outcome.leased.job for outcome in request.outcomes] == [1]
    assert request.room == 3


def test_the_last_outcome_is_reported_at_once() -> None:
    held = held_jobs(Clock(), report_after_s=3600.0)
    held.add(grant(1))
    finish(held, take(held))
    assert len(report(held).outcomes) == 1


def test_when_the_queue_is_empty_all_remaining_outcomes_are_reported_together() -> None:
    held = held_jobs(Clock(), report_after_s=3600.0)
    held.add(grant(1, 2, 3))
    finish(held, take(held))
    last = [take(held), take(held)]
    request = report(held)
    held.add(LeaseReply(jobs=[], lease_s=60.0))
    accept(held, request)
    finish(held, last[0])
    assert held._due_request(100.0) is None  # nobody waits for part of a generation
    finish(held, last[1])
    request = report(held)
    assert [outcome.leased.job for outcome in request.outcomes] == [2, 3]
    assert request.room == 5


def test_an_outcome_is_reported_after_its_longest_wait_while_other_jobs_run() -> None:
    clock = Clock()
    held = held_jobs(clock, capacity=50, report_after_s=1.0)
    held.add(grant(*range(40)))
    finish(held, take(held))
    clock.now_s += 1.0
    assert [outcome.leased.job for outcome in report(held).outcomes] == [0]


def test_a_heartbeat_reply_does_not_affect_jobs_leased_after_its_request() -> None:
    held = held_jobs(Clock())
    held.add(grant(1))
    asked = held.leases()
    held.add(grant(2))
    held.apply_renewal(asked, [1])
    assert [lease.job for lease in held.leases()] == [1, 2]


def test_a_heartbeat_reply_about_an_old_lease_does_not_affect_a_new_one() -> None:
    held = held_jobs(Clock())
    held.add(grant(1))
    held.apply_renewal([HeldLease(job=1, token="older")], [])
    assert [lease.job for lease in held.leases()] == [1]


def test_an_outcome_is_reported_even_if_its_lease_seems_lost() -> None:
    held = held_jobs(Clock())
    held.add(grant(1))
    finish(held, take(held))
    held.apply_renewal(held.leases(), [])
    assert [outcome.leased.job for outcome in report(held).outcomes] == [1]


def test_after_a_stop_no_job_starts_and_waiting_jobs_are_released() -> None:
    held = held_jobs(Clock())
    held.add(grant(1, 2, 3))
    running = take(held)
    held.stop()
    assert held.take(wait=True) is None
    request = report(held)
    assert [lease.job for lease in request.release] == [2, 3]
    assert request.room == 0
    accept(held, request)
    finish(held, running)
    held.mark_runner_done()
    accept(held, report(held))
    assert held.next_request() is None


def test_jobs_granted_after_a_stop_are_released() -> None:
    held = held_jobs(Clock())
    held.stop()
    held.mark_runner_done()
    held.add(grant(1))
    assert [lease.job for lease in report(held).release] == [1]


def test_a_report_is_bounded_in_bytes_but_a_single_large_outcome_is_sent() -> None:
    held = held_jobs(Clock())
    held.add(grant(1, 2, 3))
    for size_bytes in (2 * MAX_BATCH_BYTES, 10, 10):
        finish(held, take(held), size_bytes=size_bytes)
    request = report(held)
    assert [outcome.leased.job for outcome in request.outcomes] == [1]
    accept(held, request)
    assert [outcome.leased.job for outcome in report(held).outcomes] == [2, 3]


@pytest.mark.parametrize("answer", [HeldJobs.handle_refusal, HeldJobs.handle_fault])
def test_outcomes_of_a_refused_report_are_sent_singly_and_the_culprit_becomes_an_error(
    answer: Callable[[HeldJobs, Report, str], None],
) -> None:
    held = held_jobs(Clock())
    held.add(grant(1, 2))
    for _ in range(2):
        finish(held, take(held))
    answer(held, report(held), "no")
    alone = report(held)
    assert ([outcome.leased.job for outcome in alone.outcomes], alone.room) == ([1], 0)
    answer(held, alone, "too strange")
    error = report(held)
    assert isinstance(error.outcomes[0].outcome, JobFailed)
    assert "too strange" in error.outcomes[0].outcome.message
    accept(held, error)
    assert [outcome.leased.job for outcome in report(held).outcomes] == [2]


def test_outcome_is_kept_if_the_coordinator_fails_at_the_error_as_well() -> None:
    held = held_jobs(Clock())
    held.add(grant(1))
    finish(held, take(held))
    held.handle_fault(report(held), "500")
    for _ in range(2):
        held.handle_fault(report(held), "500")
    assert report(held).outcomes[0].outcome == DONE


def test_report_that_is_too_large_is_halved_as_are_all_later_ones() -> None:
    held = held_jobs(Clock(), capacity=20)
    held.add(grant(*range(8)))
    for _ in range(8):
        finish(held, take(held))
    held.handle_refusal(report(held), "413", too_large=True)
    accept(held, report(held))
    later = report(held)
    assert [outcome.leased.job for outcome in later.outcomes] == [4, 5, 6, 7]
    accept(held, later)
    held.add(grant(*range(8, 14)))
    for _ in range(6):
        finish(held, take(held))
    assert len(report(held).outcomes) == 4


def test_a_worker_polls_at_least_once_before_it_exits_for_being_idle() -> None:
    clock = Clock()
    held = HeldJobs(PrefetchPolicy(max_jobs=5, prefetch_s=1.0), exit_when_idle_s=0.0, clock=clock)
    assert isinstance(held.next_request(), Poll)
    held.add(grant())
    assert held.next_request() is None


def test_a_worker_with_unsent_outcomes_does_not_exit() -> None:
    clock = Clock()
    held = HeldJobs(PrefetchPolicy(max_jobs=5, prefetch_s=1.0), exit_when_idle_s=1.0, clock=clock)
    held.add(grant(1))
    finish(held, take(held))
    held.postpone(5.0)
    clock.now_s += 10.0
    assert isinstance(held.next_request(), Report)


class Life(RuleBasedStateMachine):
    """In any order of events, no job is lost and none is in two places."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = Clock()
        self.held = held_jobs(self.clock, capacity=4)
        self.given: set[int] = set()
        self.done: set[int] = set()
        self.child: list[LeasedJob] = []
        self.lost: set[int] = set()
        self.stopped = False

    @rule(count=st.integers(0, 4))
    def grant(self, count: int) -> None:
        numbers = range(len(self.given), len(self.given) + count)
        self.given.update(numbers)
        self.held.add(grant(*numbers))

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
            self.done.add(job.job)

    @precondition(lambda self: self.child)
    @rule()
    def put_back(self) -> None:
        self.held.put_back(self.child)
        self.done.update(job.job for job in self.child if job.job in self.lost)
        self.child = []

    @precondition(lambda self: self.held.leases() and not self.stopped)
    @rule(data=st.data())
    def lose(self, data: st.DataObject) -> None:
        asked = self.held.leases()
        gone = data.draw(st.sampled_from(asked)).job
        before = {lease.job for lease in self.held.leases()}
        self.held.apply_renewal(asked, [lease.job for lease in asked if lease.job != gone])
        self.done |= before - {lease.job for lease in self.held.leases()}
        if any(job.job == gone for job in self.child):
            self.lost.add(gone)

    @precondition(lambda self: self.held.unsent or (self.stopped and self.held.leases() and not self.child))
    @rule(fate=st.sampled_from(["acknowledged", "unavailable"]))
    def report(self, fate: str) -> None:
        self.clock.now_s += 100.0
        request = self.held.next_request()
        assert isinstance(request, Report)
        if fate == "unavailable":
            self.held.postpone(1.0)
            return
        accept(self.held, request)
        self.done.update(outcome.leased.job for outcome in request.outcomes)
        self.done.update(lease.job for lease in request.release)

    @rule()
    def stop(self) -> None:
        self.stopped = True
        self.held.stop()

    @invariant()
    def every_job_is_held_once_or_is_done(self) -> None:
        held = [lease.job for lease in self.held.leases()]
        assert len(held) == len(set(held))
        assert set(held).isdisjoint(self.done)
        assert set(held) | self.done == self.given


TestLife = Life.TestCase
TestLife.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)


@pytest.mark.parametrize("status", ["accepted", "duplicate", "stale"])
def test_every_status_of_a_report_ends_the_job(status: str) -> None:
    held = held_jobs(Clock())
    held.add(grant(1))
    finish(held, take(held))
    answer = ResultStatus.model_validate({"job": 1, "status": status})
    held.acknowledge(report(held), [answer], wall_s=0.01)
    assert held.leases() == ()


SECONDS = st.floats(0.0, 1e4, allow_nan=False)


@given(
    max_jobs=st.integers(1, 128),
    prefetch_s=SECONDS,
    episodes_s=st.lists(SECONDS, max_size=20),
    trips_s=st.lists(SECONDS, max_size=20),
)
def test_the_prefetch_policy_stays_in_its_bounds(
    max_jobs: int, prefetch_s: float, episodes_s: list[float], trips_s: list[float]
) -> None:
    policy = PrefetchPolicy(max_jobs=max_jobs, prefetch_s=prefetch_s)
    for episode_s in episodes_s:
        policy = policy.after_episode(episode_s)
    for trip_s in trips_s:
        policy = policy.after_request(trip_s)
    assert 1 <= policy.capacity <= max_jobs
    assert 0 <= policy.low_watermark < policy.capacity
    assert not episodes_s or min(episodes_s) * 0.99 <= (policy.episode_s or 0.0) <= max(episodes_s) * 1.01


@pytest.mark.parametrize(
    ("episode_s", "capacity"), [(None, 1), (60.0, 1), (0.6, 1), (0.25, 2), (0.07, 5), (0.001, 8), (0.0, 8)]
)
def test_a_worker_holds_a_set_time_of_work(episode_s: float | None, capacity: int) -> None:
    assert PrefetchPolicy(max_jobs=8, prefetch_s=0.25, episode_s=episode_s).capacity == capacity


def test_an_outcome_is_kept_until_it_is_acknowledged() -> None:
    clock = Clock()
    held = held_jobs(clock)
    held.add(grant(1))
    finish(held, take(held))
    first = report(held)
    held.postpone(2.0)
    clock.now_s += 2.0
    assert report(held).outcomes == first.outcomes
    accept(held, first)
    assert isinstance(held.next_request(), Poll)


def test_a_waiting_job_without_a_lease_is_dropped_and_a_running_one_has_no_outcome() -> None:
    held = held_jobs(Clock())
    held.add(grant(1, 2, 3))
    running = take(held)
    held.apply_renewal(held.leases(), [3])
    assert [lease.job for lease in held.leases()] == [1, 3]
    assert held.lost_running_job() == (running, 0.0)
    finish(held, running)
    assert held.unsent == 0
    assert [lease.job for lease in held.leases()] == [3]

"""The queue without a database: the lease policy, and the line of waiting requests."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field

import pytest

from brink.server.queue.lease_policy import (
    NEW_TURN,
    TURN,
    Assignment,
    Backlog,
    CampaignTurn,
    LeaseDemand,
    LeaseTerms,
    assign_jobs,
    grant_limit,
)
from brink.server.queue.wakeups import Wakeups
from brink.server.states import JobKind


@dataclass
class Job:
    id: int
    campaign_id: str = "a"
    kind: str = JobKind.EPISODE
    spec_hash: str = ""
    cache: bool = False
    priority: int = 0


@dataclass
class Queue:
    """A queue in memory; `reads` lists the fresh jobs that were locked."""

    fresh: Sequence[Job] = ()
    traces: Sequence[Job] = ()
    retry: Job | None = None
    campaigns: Sequence[CampaignTurn] = (CampaignTurn("a", 0, 0, 0),)
    reads: list[int] = field(default_factory=list)

    def first_retry(self, demand: LeaseDemand) -> Job | None:
        return self.retry

    def has_trace(self, capabilities: tuple[str, ...]) -> bool:
        return bool(self.traces)

    def top_priority(self, capabilities: tuple[str, ...]) -> int | None:
        return max((one.priority for one in self.campaigns), default=None)

    def lock_retry(self, demand: LeaseDemand) -> Sequence[Job]:
        return [self.retry] if self.retry else []

    def lock_traces(self, capabilities: tuple[str, ...], limit: int) -> Sequence[Job]:
        return self.traces[:limit]

    def turns(self, capabilities: tuple[str, ...]) -> Sequence[CampaignTurn]:
        return self.campaigns

    def lock_fresh(
        self, campaign: str, capabilities: tuple[str, ...], *, after: int, limit: int
    ) -> Sequence[Job]:
        found = [job for job in self.fresh if job.campaign_id == campaign and job.id > after][:limit]
        self.reads += [job.id for job in found]
        return found

    def assign(self, *demands: LeaseDemand, held: dict[str, list[int]] | None = None) -> Assignment:
        backlog = Backlog(jobs=len(self.fresh), traces=bool(self.traces), retries=self.retry is not None)
        return assign_jobs(demands, backlog, held or {}, self)


def demand(worker: str = "w1", max_jobs: int = 100, live_workers: int = 1) -> LeaseDemand:
    terms = LeaseTerms(lease_s=60.0, retry_backoff_s=1.0, live_workers=live_workers)
    return LeaseDemand(worker=worker, capabilities=("sim@1",), max_jobs=max_jobs, terms=terms)


def ids(assignment: Assignment) -> list[list[int]]:
    return [[job.id for job in jobs] for jobs in assignment.jobs]


def test_a_grant_is_two_thirds_of_an_equal_share_and_at_least_one_job() -> None:
    assert [grant_limit(demand(live_workers=4), queued) for queued in (600, 60, 6, 1, 0)] == [
        100,
        10,
        1,
        1,
        1,
    ]
    assert grant_limit(demand(max_jobs=8), 1000) == 8


def test_concurrent_workers_get_different_jobs_and_lock_no_others() -> None:
    queue = Queue(fresh=[Job(n) for n in range(30)])
    first, second = ids(queue.assign(demand("w1", 4, 2), demand("w2", 4, 2)))
    assert (first, second) == ([0, 1, 2, 3], [4, 5, 6, 7])
    assert queue.reads == list(range(8))


def test_higher_priorities_go_first_and_equal_ones_in_turn() -> None:
    campaigns = [CampaignTurn("c", 1, 9, 0), CampaignTurn("b", 0, 3, 0), CampaignTurn("a", 0, 5, 0)]
    fresh = [Job(0, "a"), Job(1, "b"), Job(2, "c"), *(Job(n, "a") for n in range(3, 9))]
    queue = Queue(fresh=fresh, campaigns=campaigns)
    assert ids(queue.assign(demand(max_jobs=3))) == [[2, 1, 0]]


def test_a_turn_ends_after_a_fixed_number_of_jobs_per_live_worker() -> None:
    queue = Queue(fresh=[Job(n) for n in range(300)], campaigns=[CampaignTurn("a", 0, 7, TURN - 1)])
    assert queue.assign(demand(max_jobs=1, live_workers=2)).turns == {"a": (7, TURN)}
    turn, served = queue.assign(demand(max_jobs=1)).turns["a"]
    assert (turn > NEW_TURN, served) == (True, 0)


def test_a_retry_is_granted_alone_and_only_to_a_worker_without_jobs() -> None:
    queue = Queue(fresh=[Job(n) for n in range(9)], retry=Job(99))
    assert ids(queue.assign(demand())) == [[99]]
    assert ids(queue.assign(demand(), held={"w1": [1]})) == [[]]
    assert ids(queue.assign(demand(), held={"w1": [2]})) == [[]]


def test_traces_and_jobs_of_higher_priority_precede_a_retry() -> None:
    urgent = [CampaignTurn("a", 5, 0, 0)]
    assert ids(Queue(fresh=[Job(1)], retry=Job(99), campaigns=urgent).assign(demand())) == [[1]]
    traced = Queue(traces=[Job(7, kind=JobKind.TRACE)], retry=Job(99), campaigns=[])
    assert ids(traced.assign(demand())) == [[7]]


def test_equal_simulations_that_share_results_are_granted_once() -> None:
    twins = [Job(n, spec_hash="x", cache=True) for n in (1, 2)]
    assert ids(Queue(fresh=[*twins, Job(3)]).assign(demand("w1"), demand("w2"))) == [[1], [3]]
    alone = [Job(n, spec_hash="x") for n in (1, 2)]
    assert ids(Queue(fresh=[*alone, Job(3)]).assign(demand())) == [[1, 2]]


LONG_S = 30.0


def on_a_loop(test: Callable[[Wakeups], Awaitable[None]]) -> Callable[[], None]:
    """Run an asynchronous test with a new line of waiting requests."""
    return lambda: asyncio.run(asyncio.wait_for(test(Wakeups()), LONG_S))


async def until_waiting(wakeups: Wakeups, count: int) -> None:
    while len(wakeups) < count:
        await asyncio.sleep(0)


def waiting(wakeups: Wakeups, gone: asyncio.Event | None = None, s: float = LONG_S) -> asyncio.Task[bool]:
    return asyncio.create_task(wakeups.wait(s, gone or asyncio.Event()))


@on_a_loop
async def test_a_wake_up_goes_to_the_first_in_line(wakeups: Wakeups) -> None:
    first = waiting(wakeups)
    await until_waiting(wakeups, 1)
    second = waiting(wakeups)
    await until_waiting(wakeups, 2)
    wakeups.wake(1)
    assert await first
    assert not second.done()
    wakeups.wake(1)
    assert await second


@on_a_loop
async def test_without_a_count_all_waiters_are_woken(wakeups: Wakeups) -> None:
    waiters = [waiting(wakeups) for _ in range(5)]
    await until_waiting(wakeups, 5)
    wakeups.wake()
    assert await asyncio.gather(*waiters) == [True] * 5


@on_a_loop
async def test_a_wait_times_out(wakeups: Wakeups) -> None:
    assert not await wakeups.wait(0.001, asyncio.Event())


@on_a_loop
async def test_a_wait_ends_when_its_client_disconnects(wakeups: Wakeups) -> None:
    gone = asyncio.Event()
    waiter = waiting(wakeups, gone)
    await until_waiting(wakeups, 1)
    gone.set()
    assert not await waiter


@on_a_loop
async def test_the_wake_up_of_a_disconnected_client_is_passed_on(wakeups: Wakeups) -> None:
    gone = asyncio.Event()
    first = waiting(wakeups, gone)
    await until_waiting(wakeups, 1)
    second = waiting(wakeups)
    await until_waiting(wakeups, 2)
    wakeups.wake(1)
    gone.set()
    assert not await first
    assert await second


@on_a_loop
async def test_the_wake_up_of_a_cancelled_wait_is_passed_on(wakeups: Wakeups) -> None:
    first = waiting(wakeups)
    await until_waiting(wakeups, 1)
    second = waiting(wakeups)
    await until_waiting(wakeups, 2)
    wakeups.wake(1)
    first.cancel()
    with pytest.raises(asyncio.CancelledError):
        await first
    assert await second


@on_a_loop
async def test_waiters_that_time_out_leave_the_line(wakeups: Wakeups) -> None:
    for _ in range(20):
        await wakeups.wait(0.0001, asyncio.Event())
    assert len(wakeups._line) == 0


@on_a_loop
async def test_a_wait_returns_at_once_after_a_change(wakeups: Wakeups) -> None:
    seen = wakeups.changes
    wakeups.wake(0)
    assert wakeups.changes == seen, "waking nobody does not count as a change"
    wakeups.wake()  # nobody is waiting
    assert await wakeups.wait(LONG_S, asyncio.Event(), since=seen)
    assert not await wakeups.wait(0.001, asyncio.Event(), since=wakeups.changes)


@on_a_loop
async def test_a_disconnected_client_does_not_use_a_change(wakeups: Wakeups) -> None:
    gone = asyncio.Event()
    gone.set()
    seen = wakeups.changes
    wakeups.wake()
    assert not await wakeups.wait(LONG_S, gone, since=seen)

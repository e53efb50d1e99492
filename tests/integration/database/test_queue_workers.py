"""Workers and coordinators of one queue: who is live, who is dead, and two coordinators at once."""

import asyncio
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, ExitStack, closing
from datetime import timedelta
from functools import partial
from typing import Any

import pytest
from sqlalchemy import Connection, delete, event, update
from support.api import ball, settings_for
from support.databases import PostgresDatabases, on_sqlite
from support.queue import RESULT, TERMS, Queue, lease, report

from brink.server.app import create_app
from brink.server.campaigns import store
from brink.server.campaigns.body import parse_body
from brink.server.db.engine import Engines, open_engines
from brink.server.db.models import WorkerRow
from brink.server.db.sql import database_now
from brink.server.db.writer import Unit, Writer
from brink.server.errors import Unavailable
from brink.server.queue import exchange, lease_store, workers
from brink.server.queue.report_store import Outcome, Report
from brink.server.queue.service import CONTACT_S, QueueService
from brink.server.states import CampaignStatus
from brink.worker.wire import (
    JobFailed,
    JobResult,
    LeasedJob,
    LeaseRequest,
    ResultsRequest,
    WorkerIdentity,
    machine_name,
)

PATIENCE_S = 30.0


@pytest.fixture
def dead_pid() -> int:
    """The id of a process that is no more."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def noted(queue: Queue, machine: str, pid: int, worker: str = "w1") -> None:
    identity = WorkerIdentity(id=worker, host="here", pid=pid, machine=machine)
    contact = workers.Contact(worker=identity, capabilities=["x"])
    queue.run(partial(workers.record_contact, contact=contact))


def test_leases_of_a_dead_process_of_this_machine_are_found(queue: Queue, dead_pid: int) -> None:
    queue.campaign(2)
    (lost,) = queue.lease("w1", max_jobs=1)
    queue.lease("w2", max_jobs=1)
    noted(queue, machine_name(), dead_pid)
    noted(queue, machine_name(), os.getpid(), "w2")
    found = queue.run(workers.leases_of_dead)
    assert [(lease.job, lease.token) for lease in found] == [(lost.job, lost.token)]
    queue.run(lambda connection: lease_store.end_now(connection, found))
    assert queue.expire()[1] == 1


@pytest.mark.parametrize("machine", ["", "another-boot pid:[4026531836]"])
def test_a_process_id_of_another_machine_is_not_looked_up(queue: Queue, dead_pid: int, machine: str) -> None:
    queue.campaign(1)
    queue.lease("w1")
    noted(queue, machine, dead_pid)
    assert queue.run(workers.leases_of_dead) == []


def test_a_machine_is_this_boot_seen_from_this_pid_namespace() -> None:
    with open("/proc/sys/kernel/random/boot_id") as file:
        assert file.read().strip() in machine_name()
    assert os.readlink("/proc/self/ns/pid") in machine_name()
    child = subprocess.run(
        [sys.executable, "-c", "from brink.worker.wire import machine_name; print(machine_name())"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert child.stdout.strip() == machine_name()


def silent_for(queue: Queue, silence: timedelta) -> None:
    """Have all workers not heard of for a while."""
    queue.run(lambda c: c.execute(update(WorkerRow).values(last_seen_at=database_now(c) - silence)))


def names(queue: Queue, within_s: float | None = None) -> set[str]:
    return {seen.id for seen in queue.run(lambda c: workers.list_workers(c, within_s=within_s))}


def test_workers_heard_of_lately_can_be_listed(queue: Queue) -> None:
    noted(queue, "", 1, "silent")
    silent_for(queue, timedelta(seconds=60))
    noted(queue, "", 1, "w1")
    assert names(queue) == {"silent", "w1"}
    assert names(queue, within_s=61) == {"silent", "w1"}
    assert names(queue, within_s=59) == {"w1"}


def test_workers_that_were_not_heard_of_for_long_are_forgotten_unless_they_hold_a_job(queue: Queue) -> None:
    queue.campaign(1)
    queue.lease("holds")
    for worker in ("holds", "holds-nothing"):
        noted(queue, "", 1, worker)
    silent_for(queue, timedelta(hours=2))
    noted(queue, "", 1, "live")
    assert queue.run(lambda c: workers.forget_absent(c, after_s=3600.0)) == 1
    assert names(queue) == {"holds", "live"}


@on_sqlite
def test_more_workers_are_forgotten_at_once_than_a_statement_has_parameters(queue: Queue) -> None:
    for number in range(40):
        noted(queue, "", 1, f"w{number}")
    silent_for(queue, timedelta(hours=2))
    queue.limit_parameters(30)
    assert queue.run(lambda c: workers.forget_absent(c, after_s=3600.0)) == 40
    assert names(queue) == set()


def test_what_live_workers_can_run_leaves_out_the_dead(queue: Queue, dead_pid: int) -> None:
    noted(queue, "", 1, "silent")
    silent_for(queue, timedelta(seconds=60))
    noted(queue, machine_name(), dead_pid, "dead")
    noted(queue, machine_name(), os.getpid(), "live")
    assert queue.run(lambda c: workers.live_capabilities(c, 45.0)) == {"live": ("x",)}


class Coordinators:
    """The queues of coordinators in this loop; their sweeps are made by hand."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self._stack = stack

    async def start(self, database_url: str) -> QueueService:
        app = create_app(settings_for(database_url), sweeping=False)
        await self._stack.enter_async_context(app.router.lifespan_context(app))
        queue: QueueService = app.state.context.queue
        return queue


def identity(worker: str, machine: str = "", pid: int = 0) -> WorkerIdentity:
    return WorkerIdentity(id=worker, machine=machine, pid=pid)


async def ask(service: QueueService, who: WorkerIdentity, *capabilities: str) -> None:
    wanted = LeaseRequest(worker=who, capabilities=list(capabilities), wait_s=0)
    await service.lease(wanted, asyncio.Event())


def test_coordinator_drops_the_state_of_a_campaign_another_stopped(
    database_url: str, small_problems: None
) -> None:
    async def body() -> None:
        async with AsyncExitStack() as stack:
            apps = [create_app(settings_for(database_url), sweeping=False) for _ in range(2)]
            for app in apps:
                await stack.enter_async_context(app.router.lifespan_context(app))
            first, second = (app.state.context for app in apps)
            one, other = [(await first.campaigns.submit(parse_body(ball(seed=n)), None))[0] for n in (1, 2)]
            await first.scheduler.sweep()
            assert set(first.scheduler.stepper.live_campaigns) == {one.id, other.id}
            await second.campaigns.cancel(one.id)
            await first.scheduler.sweep()
            assert set(first.scheduler.stepper.live_campaigns) == {other.id}

    asyncio.run(body())


def test_a_coordinator_forgets_silent_workers_but_not_what_they_did(database_url: str, queue: Queue) -> None:
    async def body() -> None:
        async with AsyncExitStack() as stack:
            service = await Coordinators(stack).start(database_url)
            now_s = 1000.0
            service.clock = lambda: now_s
            queue.campaign(1, needs="x", max_attempts=1)
            wanted = LeaseRequest(worker=identity("w1"), capabilities=["x"], wait_s=0)
            (job,) = (await service.lease(wanted, asyncio.Event())).jobs
            await ask(service, identity("w2"), "y")
            outcome = JobFailed(reason="error", message="no")
            result = JobResult(job=job.job, token=job.token, outcome=outcome)
            forged = JobResult(job=job.job, token="t", outcome=outcome)
            reported = ResultsRequest(worker=identity("w1"), results=[result, result, forged])
            replies = [await service.results(reported, asyncio.Event()) for _ in range(2)]
            statuses = [item.status for reply in replies for item in reply.statuses]
            assert statuses == ["accepted", "duplicate", "stale", "duplicate", "duplicate", "stale"]
            now_s += service.settings.worker_seen_s + 1
            await ask(service, identity("w2"), "y")
            await service.sweep()
            assert set(service._workers) == {"w2"}

    asyncio.run(asyncio.wait_for(body(), PATIENCE_S))
    told = queue.run(workers.list_workers)
    assert {seen.id: seen.jobs_failed for seen in told} == {"w1": 1, "w2": 0}, "what was accepted, and once"


def test_further_contacts_are_recorded_by_sweeps(database_url: str, queue: Queue) -> None:
    async def body() -> None:
        async with AsyncExitStack() as stack:
            service = await Coordinators(stack).start(database_url)
            now_s = 1000.0
            service.clock = lambda: now_s
            for worker in ("w1", "deleted", "silent"):
                await ask(service, identity(worker), "x")
            assert names(queue, within_s=30) == {"w1", "deleted", "silent"}, (
                "new workers are recorded at once"
            )
            silent_for(queue, timedelta(seconds=60))
            queue.run(lambda c: c.execute(delete(WorkerRow).where(WorkerRow.id == "deleted")))
            now_s += CONTACT_S
            for worker in ("w1", "deleted"):
                await ask(service, identity(worker), "x")
            assert names(queue, within_s=30) == set()
            await service.sweep()

    asyncio.run(asyncio.wait_for(body(), PATIENCE_S))
    assert names(queue, within_s=30) == {"w1", "deleted"}
    assert {seen.capabilities for seen in queue.run(workers.list_workers)} == {("x",)}


@pytest.mark.parametrize(("ago_s", "pid"), [(90.0, 2), (0.0, 1)], ids=["older", "newer"])
def test_of_the_contacts_of_two_processes_with_one_id_the_later_one_counts(
    queue: Queue, ago_s: float, pid: int
) -> None:
    noted(queue, "", 2)
    silent_for(queue, timedelta(seconds=60))
    contact = workers.Contact(worker=identity("w1", pid=1), ago_s=ago_s, done=1)
    queue.run(partial(workers.record_contacts, contacts=[contact]))
    (seen,) = queue.run(workers.list_workers)
    assert (seen.pid, seen.jobs_done) == (pid, int(pid == 1))
    assert seen.seen_s_ago == pytest.approx(min(60.0, ago_s), abs=10.0)


def fail(*_: object, **__: object) -> None:
    """Fail as a database that is away does."""
    raise Unavailable("the database is away")


@on_sqlite
def test_jobs_of_a_restarted_worker_whose_first_request_failed_are_not_taken_for_those_of_the_dead(
    database_url: str, queue: Queue, dead_pid: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The database still names the old process, which is dead."""

    async def body() -> None:
        async with AsyncExitStack() as stack:
            service = await Coordinators(stack).start(database_url)
            await ask(service, identity("w1", machine_name(), dead_pid), "x")
            live = identity("w1", machine_name(), os.getpid())
            with monkeypatch.context() as patched:
                patched.setattr(exchange, "record_contact", fail)
                with pytest.raises(Unavailable):
                    await ask(service, live, "x")
            queue.campaign(1, needs="x")
            await ask(service, live, "x")
            await service.sweep()

    asyncio.run(asyncio.wait_for(body(), PATIENCE_S))
    assert [(row.status, row.losses) for row in queue.jobs()] == [("leased", 0)]
    assert [seen.pid for seen in queue.run(workers.list_workers)] == [os.getpid()]


def test_what_a_worker_did_is_counted_although_the_write_that_should_have_said_so_failed(
    database_url: str, queue: Queue, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body() -> None:
        async with AsyncExitStack() as stack:
            service = await Coordinators(stack).start(database_url)
            now_s = 1000.0
            service.clock = lambda: now_s
            queue.campaign(1, needs="x", max_attempts=1)
            wanted = LeaseRequest(worker=identity("w1"), capabilities=["x"], wait_s=0)
            (job,) = (await service.lease(wanted, asyncio.Event())).jobs
            failed = JobFailed(reason="error", message="no")
            result = JobResult(job=job.job, token=job.token, outcome=failed)
            await service.results(ResultsRequest(worker=identity("w1"), results=[result]), asyncio.Event())
            now_s += service.settings.worker_seen_s + 1  # the worker is gone by then
            with monkeypatch.context() as patched:
                patched.setattr(workers, "record_contacts", fail)
                with pytest.raises(Unavailable):
                    await service.sweep()
            await service.sweep()
            assert service._workers == {}

    asyncio.run(asyncio.wait_for(body(), PATIENCE_S))
    assert [seen.jobs_failed for seen in queue.run(workers.list_workers)] == [1]


def test_a_dead_worker_of_this_machine_is_not_waited_for(database_url: str, dead_pid: int) -> None:
    async def body() -> None:
        async with AsyncExitStack() as stack:
            service = await Coordinators(stack).start(database_url)
            await ask(service, identity("dead", machine_name(), dead_pid), "x")
            await ask(service, identity("w1", machine_name(), os.getpid()), "x")
            assert service.terms("w1").elsewhere == {"x"}
            await service.sweep()
            assert service.terms("w1").elsewhere == frozenset()
            assert service.terms("w1").live_workers == 1

    asyncio.run(asyncio.wait_for(body(), PATIENCE_S))


def test_a_coordinator_knows_the_workers_of_the_others(database_url: str) -> None:
    async def body() -> None:
        async with AsyncExitStack() as stack:
            coordinators = Coordinators(stack)
            first, second = await coordinators.start(database_url), await coordinators.start(database_url)
            await ask(first, identity("w1"), "x")
            await first.sweep()
            known = [first.has_workers_elsewhere]
            await ask(second, identity("w2"), "x", "y")
            await first.sweep()
            assert [*known, first.has_workers_elsewhere] == [False, True]
            assert first.terms("w1").live_workers == 2
            assert first.terms("w1").elsewhere == {"x", "y"}

    asyncio.run(asyncio.wait_for(body(), PATIENCE_S))


def test_what_a_worker_can_run_is_noted_if_it_reports_before_it_asks(database_url: str, queue: Queue) -> None:
    async def body() -> None:
        async with AsyncExitStack() as stack:
            service = await Coordinators(stack).start(database_url)
            wanted = LeaseRequest(worker=identity("w1"), capabilities=["x"], wait_s=0)
            reported = ResultsRequest(worker=identity("w1"), results=[], lease=wanted)
            await service.results(reported, asyncio.Event())

    asyncio.run(asyncio.wait_for(body(), PATIENCE_S))
    assert [seen.capabilities for seen in queue.run(workers.list_workers)] == [("x",)]


WAIT_S = 30.0
NAMES = ("a", "b", "c", "d", "e", "f")


@pytest.fixture
def two(postgres_databases: PostgresDatabases) -> Iterator[tuple[Engines, Engines]]:
    """The engines of two coordinators on one Postgres."""
    with postgres_databases.database() as url:
        first, second = open_engines(url), open_engines(url)
        yield first, second
        first.dispose()
        second.dispose()


def leases(worker: str, needs: str, max_jobs: int = 1) -> Unit[list[LeasedJob]]:
    return lambda connection: lease(connection, worker, [needs], max_jobs, TERMS)


def reports(outcomes: list[Outcome]) -> Unit[Report]:
    return lambda connection: report(connection, outcomes, TERMS)


def in_one_transaction(engines: Engines, units: list[Callable[[Connection], Any]]) -> list[Any]:
    with engines.writer.begin() as connection:
        connection.exec_driver_sql("SET LOCAL lock_timeout = '10s'")
        return [unit(connection) for unit in units]


def test_commits_that_lease_from_campaigns_in_another_order_do_not_wait(two: tuple[Engines, Engines]) -> None:
    queue = Queue(engines=two[0])
    for name in ("a", "b"):
        queue.campaign(4, needs=name)
    met = threading.Barrier(2)

    def meet(connection: Connection) -> list[LeasedJob]:
        met.wait(WAIT_S)
        return []

    with ThreadPoolExecutor(2) as threads:
        done = [
            threads.submit(in_one_transaction, two[0], [leases("w1", "a"), meet, leases("w1", "b")]),
            threads.submit(in_one_transaction, two[1], [leases("w2", "b"), meet, leases("w2", "a")]),
        ]
        granted = [job.job for answer in done for jobs in answer.result(WAIT_S) for job in jobs]
    assert len(granted) == len(set(granted)) == 4


def test_a_lease_does_not_wait_for_the_one_who_cancels_its_campaign(two: tuple[Engines, Engines]) -> None:
    queue = Queue(engines=two[0])
    campaign = queue.campaign(2, needs="a")
    locked, leased = threading.Event(), threading.Event()

    def cancel(connection: Connection) -> None:
        store.CAMPAIGNS.find(connection, campaign, lock=True)
        locked.set()
        assert leased.wait(WAIT_S)
        store.set_status(connection, campaign, CampaignStatus.CANCELLED, "")

    def lease(connection: Connection) -> list[LeasedJob]:
        assert locked.wait(WAIT_S)
        granted = leases("w1", "a")(connection)
        leased.set()
        return granted

    with ThreadPoolExecutor(2) as threads:
        cancelling = threads.submit(in_one_transaction, two[1], [cancel])
        (granted,) = threads.submit(in_one_transaction, two[0], [lease]).result(WAIT_S)
        cancelling.result(WAIT_S)
    assert len(granted) == 1
    assert queue.states(campaign) == ["cancelled", "cancelled"]


def test_two_coordinators_grant_every_job_once_without_an_error(two: tuple[Engines, Engines]) -> None:
    queue = Queue(engines=two[0])
    campaigns = [queue.campaign(40, needs=name) for name in NAMES]
    rolled_back: list[object] = []
    for engines in two:
        event.listen(engines.writer, "rollback", rolled_back.append)
    with ExitStack() as stack:
        writers = [stack.enter_context(closing(Writer(engines.writer))) for engines in two]
        threads = stack.enter_context(ThreadPoolExecutor(8))
        worked = [
            threads.submit(work, writers[place % 2], f"w{place}", NAMES[place % 6 :] + NAMES[: place % 6])
            for place in range(8)
        ]
        granted = [job for answer in worked for job in answer.result(4 * WAIT_S)]
    assert (
        rolled_back == []
    )  # the writer runs the units of a commit that failed again, which would hide a deadlock
    assert len(granted) == len(set(granted)) == 40 * len(NAMES)
    assert {state for campaign in campaigns for state in queue.states(campaign)} == {"done"}


def work(writer: Writer, worker: str, names: tuple[str, ...]) -> list[int]:
    """Lease from all campaigns at once and report, until nothing is left; return the jobs that were granted."""
    granted: list[int] = []
    while True:
        answers = [writer.submit(leases(worker, name, max_jobs=3)) for name in names]
        jobs = [job for answer in answers for job in answer.result(WAIT_S)]
        if not jobs:
            return granted
        granted += [job.job for job in jobs]
        outcomes = [Outcome(job=job.job, token=job.token, result=RESULT) for job in jobs]
        assert set(writer.submit(reports(outcomes)).result(WAIT_S).statuses) == {"accepted"}

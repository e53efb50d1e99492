"""Coordinators that share a database: they neither wait for one another in a circle nor grant a job twice."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from typing import Any

import pytest
from sqlalchemy import Connection, event
from support.postgres import PostgresDatabases
from support.queue import RESULT, TERMS, Queue, lease, report

from brink.server.campaigns import store
from brink.server.db.engine import Engines, open_engines
from brink.server.db.writer import Unit, Writer
from brink.server.queue.report_store import Outcome, Report
from brink.server.states import CampaignStatus
from brink.worker.wire import LeasedJob

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


def test_commits_that_lease_from_the_same_campaigns_in_another_order_do_not_wait(
    two: tuple[Engines, Engines],
) -> None:
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

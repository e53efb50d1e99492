"""How the databases find jobs: by their indexes, whatever statistics of a moment ago may say.

The hot statements are caught as they run, on a database where thousands of jobs are done and few are open, with
statistics from when all of them were queued.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from sqlalchemy import Connection, Engine, event, text
from support.databases import Databases
from support.problems import SIMULATOR
from support.queue import RESULT, TERMS, Queue, held

from server.db.engine import open_engines
from server.db.models import JobStatus
from server.queue.exchange import Exchange, exchange
from server.queue.values import LeaseWanted, Outcome

DONE = 3000
Statement = tuple[str, Any]


def statements_of(engine: Engine, run: Callable[[], Any]) -> list[Statement]:
    said: list[Statement] = []

    def keep(connection: Any, cursor: Any, statement: str, parameters: Any, context: Any, many: bool) -> None:
        said.append((statement, parameters[0] if many else parameters))

    event.listen(engine, "before_cursor_execute", keep)
    try:
        run()
    finally:
        event.remove(engine, "before_cursor_execute", keep)
    return said


@pytest.fixture
def stale(databases: Databases) -> Iterator[Queue]:
    """A queue of which nearly everything is done since its statistics were made."""
    with databases.database() as url:
        engines = open_engines(url)
        queue = Queue(engines=engines)
        campaign = queue.campaign(DONE, cache=False)
        queue.campaign(40)
        queue.run(lambda connection: connection.execute(text("ANALYZE")))
        queue.run(
            lambda connection: connection.execute(
                text(
                    "UPDATE jobs SET status = :done, result = '{}', attempt = 1 WHERE campaign_id = :campaign"
                ),
                {"done": JobStatus.DONE, "campaign": campaign},
            )
        )
        yield queue
        engines.dispose()


def hot(queue: Queue) -> None:
    """Do what workers and sweepers do all the time."""
    jobs = queue.lease(max_jobs=4)
    wanted = LeaseWanted(worker="w1", capabilities=(SIMULATOR,), max_jobs=4, terms=TERMS)
    outcomes = tuple(Outcome(job=job.job, token=job.token, result=RESULT) for job in jobs[:2])
    failed = (Outcome(job=jobs[2].job, token=jobs[2].token, result=None, error="crashed: boom"),)
    request = Exchange(terms=TERMS, outcomes=(*outcomes, *failed), release=(held(jobs[3]),), wanted=wanted)
    queue.run(lambda connection: exchange(connection, [request, Exchange(terms=TERMS, wanted=wanted)]))
    queue.end_backoffs()
    queue.renew(*queue.lease("w2"))
    queue.expire()


def plan_of(connection: Connection, statement: Statement) -> str:
    words, parameters = statement
    explain = "EXPLAIN QUERY PLAN" if connection.dialect.name == "sqlite" else "EXPLAIN"
    rows: Sequence[Any] = connection.exec_driver_sql(f"{explain} {words}", parameters).all()
    return "\n".join(str(row[-1]) for row in rows)


SCANS = {
    # A look through an index that holds open jobs alone is fine.
    "sqlite": re.compile(
        r"SCAN jobs(?! USING (COVERING )?INDEX ix_jobs_(queued|retries|leased|lease_worker))"
    ),
    "postgresql": re.compile(r"Seq Scan on jobs|Index Scan using pk_jobs on jobs[^\n]*\n(?! *Index Cond)"),
}
BY_HAND = ("not_before IS NOT NULL",)
"""What the test itself says."""


def test_no_hot_statement_reads_all_jobs(stale: Queue) -> None:
    said = statements_of(stale.engines.writer, lambda: hot(stale))
    about_jobs = [
        one
        for one in said
        if re.match("SELECT|UPDATE", one[0])
        and "jobs" in one[0]
        and not any(own in one[0] for own in BY_HAND)
    ]
    assert len({statement for statement, _ in about_jobs}) >= 10
    with stale.engines.writer.connect() as connection:
        for statement in about_jobs:
            plan = plan_of(connection, statement)
            assert not SCANS[connection.dialect.name].search(plan), f"{statement[0]}\n\n{plan}"


def test_a_scan_would_be_noticed(stale: Queue) -> None:
    query = "SELECT id FROM jobs WHERE last_error = 'boom' ORDER BY id"
    with stale.engines.writer.connect() as connection:
        assert SCANS[connection.dialect.name].search(plan_of(connection, (query, ())))

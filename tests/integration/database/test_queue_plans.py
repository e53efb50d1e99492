"""How the databases find jobs: by their indexes, whatever statistics of a moment ago may say.

The hot statements are caught as they run, on a database where thousands of jobs are done and few are open, with
statistics from when all of them were queued. Postgres is asked for the plan that its writer has: one for whatever
values the parameters have. A plain EXPLAIN knows the values, and tells of a plan that nobody runs.
"""

import asyncio
import json
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import psycopg
import pytest
from sqlalchemy import Connection, Engine, event, text, update
from support.api import settings_for
from support.databases import Databases, databases_for, on_postgres
from support.problems import SIMULATOR
from support.queue import RESULT, TERMS, Queue, held

from brink.server.campaigns import store
from brink.server.db import statements
from brink.server.db.engine import open_engines
from brink.server.db.models import CampaignRow
from brink.server.db.writer import Writer
from brink.server.queue import job_store, lease_store, workers
from brink.server.queue.exchange import Exchange, run_exchanges
from brink.server.queue.lease_policy import LeaseDemand
from brink.server.queue.report_store import Outcome
from brink.server.queue.service import QueueService
from brink.server.states import JobStatus
from brink.worker.wire import WorkerIdentity, machine_name

DONE = 3000
NO_PROCESS = 2**22 + 1
"""Above every process id that Linux gives."""
Statement = tuple[str, Any]


class NoSeeds:
    """Has none, and nobody asks."""

    def proposals(self, *_: Any) -> tuple[()]:
        return ()


def statements_of(engine: Engine, run: Callable[[], Any]) -> list[Statement]:
    """Return the statements that a function runs, with their parameters."""
    said: list[Statement] = []
    execute = statements.execute

    def keep(connection: Any, cursor: Any, statement: str, parameters: Any, context: Any, many: bool) -> None:
        said.append((statement, parameters[0] if many else parameters))

    def keep_together(connection: Any, driver: Any, asked: Sequence[Any], values: Sequence[Any]) -> Any:
        said.extend((one.text, given) for one, given in zip(asked, values, strict=True))
        return execute(connection, driver, asked, values)

    event.listen(engine, "before_cursor_execute", keep)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(statements, "execute", keep_together)
        try:
            run()
        finally:
            event.remove(engine, "before_cursor_execute", keep)
    return said


TIDYINGS = ((), ("VACUUM",), ("ANALYZE",), ("VACUUM", "ANALYZE"))
"""What Postgres may have done by itself since most jobs were done."""


def tidied(*backends: str) -> pytest.MarkDecorator:
    """Run a test on `stale` queues: one on SQLite, which never tidies up, and one per tidying on Postgres."""
    cases: dict[str, list[tuple[str, tuple[str, ...]]]] = {
        "sqlite": [("sqlite", ())],
        "postgres": [("postgres", tidying) for tidying in TIDYINGS],
        "just analysed": [("postgres", TIDYINGS[-1])],
    }
    return pytest.mark.parametrize(
        ("stale_backend", "stale"),
        [case for backend in backends for case in cases[backend]],
        ids=lambda value: " and ".join(value) or "untidied" if isinstance(value, tuple) else str(value),
        indirect=True,
        scope="module",
    )


@pytest.fixture(scope="module")
def stale_backend(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Databases:
    """Databases for `stale` queues."""
    return databases_for(request, tmp_path_factory.mktemp("stale"))


@pytest.fixture(scope="module")
def stale(stale_backend: Databases, request: pytest.FixtureRequest) -> Iterator[Queue]:
    """A queue of which nearly everything is done since its statistics were made, or Postgres tidied up by itself."""
    with stale_backend.database() as url:
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
        with engines.writer.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            for statement in request.param if connection.dialect.name == "postgresql" else ():
                connection.execute(text(statement))
        yield queue
        engines.dispose()


def hot(queue: Queue) -> None:
    """Do what workers do all the time."""
    jobs = queue.lease(max_jobs=4)
    queue.run_out(jobs[0])  # its result is late
    demand = LeaseDemand(worker="w1", capabilities=(SIMULATOR,), max_jobs=4, terms=TERMS)
    outcomes = tuple(Outcome(job=job.job, token=job.token, result=RESULT) for job in jobs[:2])
    failed = (Outcome(job=jobs[2].job, token=jobs[2].token, result=None, error="crashed: boom"),)
    request = Exchange(terms=TERMS, outcomes=(*outcomes, *failed), release=(held(jobs[3]),), demand=demand)
    queue.run(lambda connection: run_exchanges(connection, [request, Exchange(terms=TERMS, demand=demand)]))
    queue.end_backoffs()
    queue.renew(*queue.lease("w2"))


def periodic(queue: Queue) -> None:
    """Do what the sweeper does: at first, and when two leases have run out and a worker is dead."""
    engines = queue.engines
    dead = WorkerIdentity(id="w3", host="here", pid=NO_PROCESS, machine=machine_name())
    contact = workers.Contact(worker=dead, capabilities=[SIMULATOR])
    queue.run(partial(workers.record_contact, contact=contact))
    queue.lease("w3", max_jobs=1)
    interrupted, lost = queue.lease("w4", max_jobs=2)
    writer = Writer(engines.writer)
    settings = settings_for(engines.writer.url.render_as_string(hide_password=False))
    idle: list[str] = []
    service = QueueService(settings=settings, writer=writer, on_due=idle.extend)
    try:
        asyncio.run(service.sweep())  # extends all leases: the coordinator has just started
        queue.renew(lost)
        queue.end_leases(interrupted, lost)
        asyncio.run(service.sweep())
    finally:
        writer.close()
    # Of this machine's workers alone, as on SQLite; a database that is shared has them too.
    queue.run(lambda connection: lease_store.end_now(connection, workers.leases_of_dead(connection)))
    queue.run(job_store.idle_campaigns)
    queue.run(lambda connection: store.running_among(connection, idle))


def watching(queue: Queue) -> None:
    """Ask what those ask who watch, every few seconds."""
    queue.lease("w1")
    queue.run(lambda connection: list(job_store.count_jobs(connection)))
    queue.run(workers.list_workers)
    for status in job_store.LISTED_BY_STATUS:
        queue.run(partial(job_store.list_jobs, statuses=[status]))
        queue.run(partial(job_store.list_jobs, statuses=[status], campaign="00000000", after=7))


def prepare(connection: Connection, statement: Statement) -> list[Any]:
    """Prepare a statement on Postgres as ``looked_at``, and return its parameters; unknown ones are None."""
    words, given = statement
    names = list(dict.fromkeys(re.findall(r"%\((\w+)\)s", words)))
    numbered = re.sub(r"%\((\w+)\)s", lambda found: f"${names.index(found[1]) + 1}", words)
    connection.exec_driver_sql(f"PREPARE looked_at AS {numbered}")
    return list(given) if isinstance(given, tuple) else [given.get(name) for name in names]


def looked_at(connection: Connection, statement: Statement) -> str:
    """Return the plan of a statement, line by line; Postgres' as JSON."""
    words, parameters = statement
    if connection.dialect.name == "sqlite":
        rows = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {words}", parameters).all()
        return "\n".join(str(row[-1]) for row in rows)
    known = prepare(connection, statement)
    given = f"({', '.join(['NULL'] * len(known))})" if known else ""
    plan = connection.exec_driver_sql(f"EXPLAIN (FORMAT JSON) EXECUTE looked_at{given}").scalar_one()
    connection.exec_driver_sql("DEALLOCATE looked_at")
    return json.dumps(plan, indent=1)


OPEN = r"ix_jobs_(queued|queued_traces|retries|leased|lease_worker)"
"""Indexes that hold open jobs alone: a look through them is fine."""
SEARCHES = {
    "pk_jobs": r"\bid = ",
    "ix_jobs_spec_hash_status": r"\(spec_hash\)::text = ",
    "ix_jobs_campaign_id_status": r"\(campaign_id\)::text = .* \(?\(status\)::text = ",
}
"""What an index that holds all jobs must be asked for, so that Postgres reads few of them."""
SQLITE_SCAN = re.compile(
    rf"SCAN (jobs|twin)\b(?! USING (COVERING )?INDEX {OPEN})|ix_jobs_campaign_id_status \(campaign_id=\?\)"
)


def nodes(plan: Any) -> Iterator[dict[str, Any]]:
    if isinstance(plan, dict):
        yield plan
    for part in plan.values() if isinstance(plan, dict) else plan if isinstance(plan, list) else ():
        yield from nodes(part)


def reads_all_jobs(plan: str) -> bool:
    """Whether a database would read all jobs, or all of a campaign."""
    if not plan.startswith("["):
        return SQLITE_SCAN.search(plan) is not None
    for node in nodes(json.loads(plan)):
        index = str(node.get("Index Name", ""))
        if node.get("Node Type") == "Seq Scan" and node["Relation Name"] == "jobs":
            return True
        if "jobs" not in index or re.fullmatch(OPEN, index):
            continue
        if index not in SEARCHES or not re.search(SEARCHES[index], node.get("Index Cond", "")):
            return True
    return False


CIRCUMSTANCES = (
    "",
    "SET LOCAL enable_indexonlyscan = off",
    "SET LOCAL enable_bitmapscan = on",
    "SET LOCAL random_page_cost = 1.1",
    "SET LOCAL cpu_index_tuple_cost = 0.1",
)
"""What tips Postgres between plans that seem equally good to it, as the sizes of its indexes do."""
BY_HAND = ("not_before IS NOT NULL", "lease_expires_at IS NOT NULL")
"""What the test itself says."""


@tidied("sqlite", "postgres")
@pytest.mark.parametrize(
    ("work", "least"), [(hot, 10), (periodic, 7), (watching, 8)], ids=["hot", "periodic", "watching"]
)
def test_no_frequent_statement_reads_all_jobs(
    stale: Queue, work: Callable[[Queue], None], least: int
) -> None:
    stale.campaign(40)  # the test before it may have left no job open
    said = statements_of(stale.engines.writer, lambda: work(stale))
    about_jobs = {
        words: given
        for words, given in said
        if re.match("SELECT|UPDATE|DELETE", words)
        and re.search(r"\bjobs\b", words)
        and not any(own in words for own in BY_HAND)
    }
    assert len(about_jobs) >= least
    with stale.engines.writer.connect() as connection:
        for circumstance in CIRCUMSTANCES if connection.dialect.name == "postgresql" else ("",):
            connection.exec_driver_sql(circumstance or "SELECT 1")
            for statement in about_jobs.items():
                plan = looked_at(connection, statement)
                assert not reads_all_jobs(plan), f"{circumstance}\n{statement[0]}\n\n{plan}"
            connection.rollback()


@tidied("sqlite", "postgres")
def test_a_scan_would_be_noticed(stale: Queue) -> None:
    query = "SELECT id FROM jobs WHERE last_error = 'boom' ORDER BY id"
    with stale.engines.writer.connect() as connection:
        assert reads_all_jobs(looked_at(connection, (query, ())))


LOOKS = (
    "status = %(leased)s AND lease_expires_at < %(now)s",  # which may be asked with another status
    "campaign_id = %(campaign)s AND last_error = 'boom'",
    "id > %(after)s",
)
"""Conditions for which Postgres looks through an index of all jobs."""


@tidied("postgres")
def test_a_look_through_an_index_of_all_jobs_would_be_noticed(stale: Queue) -> None:
    with stale.engines.writer.connect() as connection:
        for condition in LOOKS:
            plan = looked_at(connection, (f"SELECT id FROM jobs WHERE {condition}", {}))
            assert "Seq Scan" not in plan
            assert reads_all_jobs(plan), plan


SELDOM = "jobs.failed_worker IS NULL"
"""What is asked only when a retry is due."""
READS = 400
"""Rows that a statement may look at while 3,000 jobs wait: it counts no more than 150 of them."""
HELD = 1000
"""Jobs that another worker runs meanwhile."""


@tidied("just analysed")
def test_no_hot_question_looks_through_all_that_waits(stale: Queue) -> None:
    stale.run(lambda connection: connection.execute(text("DELETE FROM campaigns")))
    stale.campaign(DONE)  # while the statistics are from when nearly all jobs were done
    assert_hot_questions_read_few(stale)


@on_postgres
def test_without_statistics_no_hot_question_looks_through_all_that_waits(databases: Databases) -> None:
    with databases.database() as url:
        queue = Queue(engines=open_engines(url))
        queue.campaign(DONE, cache=False)
        assert len(queue.lease("w5", max_jobs=HELD)) == HELD
        assert_hot_questions_read_few(queue)
        queue.engines.dispose()


UNSAFE_JOBS = 50
UNSAFE = (
    "UPDATE solutions SET verdict = 'unsafe', robustness = -1 "
    "WHERE campaign_id = :campaign AND number % :each = 0"
)


@on_postgres
@pytest.mark.parametrize(
    ("read_outcomes", "outcomes"),
    [(partial(job_store.generation_outcomes, generation=0), DONE), (job_store.unsafe_outcomes, UNSAFE_JOBS)],
    ids=["a generation", "unsafe ones"],
)
def test_outcomes_are_read_once_whatever_is_known_of_a_campaign(
    databases: Databases, read_outcomes: Callable[[Connection, str], list[Any]], outcomes: int
) -> None:
    with databases.database() as url:
        queue = Queue(engines=open_engines(url))
        for _ in range(200):
            queue.campaign(1)
        queue.run(lambda connection: connection.execute(text("ANALYZE")))
        campaign = queue.campaign(DONE)
        its = {"campaign": campaign, "each": DONE // UNSAFE_JOBS}
        queue.run(lambda connection: connection.execute(text(UNSAFE), its))
        queue.run(lambda connection: connection.execute(update(CampaignRow).values(generation=1)))
        reader = queue.engines.reader
        found: list[Any] = []
        with reader.connect() as connection:
            said = statements_of(reader, lambda: found.extend(read_outcomes(connection, campaign)))
            driver = connection.connection.driver_connection
            plans = [run_and_explain(driver, words, given) for words, given in said]
        queue.engines.dispose()
    assert len(found) == outcomes
    assert sum(map(rows_read, plans)) <= 2 * DONE + UNSAFE_JOBS, json.dumps(plans, indent=1)


def run_and_explain(driver: Any, words: str, parameters: Any) -> Any:
    """Run a statement on Postgres, and return how that went."""
    assert isinstance(driver, psycopg.Connection)
    with psycopg.ClientCursor(driver) as cursor:
        ((plan,),) = cursor.execute(f"EXPLAIN (ANALYZE, FORMAT JSON) {words}", parameters).fetchall()
    return plan


def rows_read(plan: Any) -> int:
    """Return how many rows of tables a statement looked at, and how many pairs of rows it joined in vain."""
    total = 0
    for node in executed(plan):
        rows = node.get("Rows Removed by Join Filter", 0)
        if "Relation Name" in node:
            rows += node["Actual Rows"] + node.get("Rows Removed by Filter", 0)
        total += int(rows * node["Actual Loops"])
    return total


def executed(plan: Any) -> Iterator[dict[str, Any]]:
    return (node for node in nodes(plan) if "Actual Loops" in node)


def assert_hot_questions_read_few(queue: Queue) -> None:
    """Check that no frequent query reads the jobs that wait one and all."""
    engines = queue.engines
    said = dict(statements_of(engines.writer, lambda: hot(queue)))
    questions = {
        words: given
        for words, given in said.items()
        if re.match(r"SELECT.*\bjobs\b", words, re.S) and SELDOM not in words
    }
    assert len(questions) >= 7
    with engines.writer.connect() as connection:
        connection.exec_driver_sql("SET LOCAL plan_cache_mode = force_generic_plan")
        for words, given in questions.items():
            known = prepare(connection, (words, given))
            call = f"EXECUTE looked_at({', '.join(['%s'] * len(known))})" if known else words
            driver = connection.connection.driver_connection
            plan = run_and_explain(driver, call, known)
            connection.exec_driver_sql("DEALLOCATE looked_at")
            read = rows_read(plan)
            assert read < READS, f"{words}\n\n{json.dumps(plan, indent=1)}"

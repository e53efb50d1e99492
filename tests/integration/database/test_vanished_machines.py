"""Machines that vanish in the middle of something: a coordinator's with its locks, and that of Postgres."""

import threading
from collections.abc import Iterator
from contextlib import closing
from functools import partial

import pytest
from psycopg import Connection as Driver
from sqlalchemy import select, text
from support.api import eventually
from support.databases import on_postgres
from support.queue import RESULT, TERMS, Queue, report

from brink.server.db.engine import Engines, open_engines, parse_url, postgres_options
from brink.server.db.models import JobRow
from brink.server.db.upgrade import UPGRADE_LOCK, upgrade
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.queue.report_store import Outcome

WAIT_S = 30.0


@pytest.fixture
def impatient(database_url: str) -> Iterator[Engines]:
    """The engines of a coordinator that waits for a lock for 0.1 s, and may pause for 1 s with its own."""
    options = "-c lock_timeout=100ms -c idle_in_transaction_session_timeout=1s"
    url = parse_url(database_url).update_query_dict({"options": options})
    opened = open_engines(url.render_as_string(hide_password=False))
    yield opened
    opened.dispose()


@on_postgres
def test_locks_of_a_coordinator_that_vanished_hold_up_the_others_for_a_short_time(
    impatient: Engines, engines: Engines
) -> None:
    queue = Queue(engines=engines)
    queue.campaign(1)
    (job,) = queue.lease()
    outcome = Outcome(job=job.job, token=job.token, result=RESULT)
    reports = partial(report, outcomes=[outcome], terms=TERMS)
    vanished = impatient.writer.connect()
    vanished.begin()
    vanished.execute(select(JobRow.id).with_for_update())
    with closing(Writer(impatient.writer)) as writer:
        with pytest.raises(Unavailable, match="lock timeout"):
            writer.submit(reports).result(WAIT_S)
        assert writer.trouble is None, "the database is well, so the coordinator is ready"

        def is_accepted() -> bool:
            try:
                return writer.submit(reports).result(WAIT_S).statuses == ("accepted",)
            except Unavailable:
                return False

        eventually(is_accepted, "Postgres ends the transaction of the one that vanished")
    vanished.invalidate()
    vanished.close()


@on_postgres
def test_an_upgrade_waits_for_another_one_as_long_as_it_takes(impatient: Engines, engines: Engines) -> None:
    def is_late() -> bool:
        query = text(
            "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() "
            "AND wait_event = 'advisory' AND clock_timestamp() - query_start > interval '200 ms'"
        )
        with engines.reader.connect() as connection:
            return bool(connection.execute(query).scalar_one())

    done: list[object] = []
    waiting = threading.Thread(target=lambda: done.append(upgrade(impatient)))
    with engines.writer.begin() as connection:
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": UPGRADE_LOCK})
        waiting.start()
        eventually(is_late, "the upgrade waits")
    waiting.join(WAIT_S)
    assert len(done) == 1


@on_postgres
def test_both_ends_of_a_connection_notice_that_the_other_is_gone(engines: Engines) -> None:
    for engine in (engines.writer, engines.reader):
        with engine.connect() as connection:
            driver = connection.connection.driver_connection
            assert isinstance(driver, Driver)
            known = driver.info.get_parameters()
            assert {"connect_timeout", "tcp_user_timeout", "keepalives_idle"} <= known.keys()
            assert "tcp_keepalives_idle=10" in known["options"]
    with engines.writer.connect() as connection:
        names = ("lock_timeout", "idle_in_transaction_session_timeout")
        assert [connection.execute(text(f"SHOW {name}")).scalar_one() for name in names] == ["5s", "15s"]


def test_options_in_the_url_of_the_database_have_precedence() -> None:
    url = parse_url("postgresql://db/brink?connect_timeout=3&options=-c lock_timeout=1s")
    options = postgres_options(url, {"lock_timeout": "5s"})
    assert "connect_timeout" not in options
    assert options["options"].split("-c ")[-2:] == ["lock_timeout=5s ", "lock_timeout=1s"]

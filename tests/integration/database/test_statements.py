"""Frequent statements: what waits to share a round trip, and what becomes of it when something fails."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import Any

import pytest
from sqlalchemy import Connection, Text, bindparam, insert, select, text, update
from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, OperationalError
from support.databases import on_postgres
from support.problems import SIMULATOR
from support.queue import RESULT, TERMS, Queue

from brink.server.db import statements
from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow, TraceRow
from brink.server.db.sql import driver_time, in_list
from brink.server.db.statements import BulkUpdate, Statement, read, write
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable
from brink.server.queue.exchange import Exchange
from brink.server.queue.lease_policy import LeaseDemand
from brink.server.queue.report_store import Outcome

NOW = datetime(2026, 1, 1, tzinfo=UTC)
ADD = Statement(insert(TraceRow).values(spec_hash=bindparam("name"), data=b"", created_at=NOW))
NAMES = Statement(select(TraceRow.spec_hash).order_by(TraceRow.spec_hash))
RENAME = BulkUpdate(TraceRow.spec_hash, [TraceRow.data], created_at=bindparam("now"))


@pytest.fixture
def round_trips(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many statements each round trip had."""
    found: list[int] = []
    execute = statements.execute

    def counted(connection: Connection, driver: Any, asked: Sequence[Any], values: Any) -> list[Any]:
        found.append(len(asked))
        return execute(connection, driver, asked, values)

    monkeypatch.setattr(statements, "execute", counted)
    return found


def run(engines: Engines, unit: Callable[[Connection], object]) -> None:
    """Run a unit in a transaction of its own."""
    with engines.writer.begin() as connection:
        unit(connection)


def names(engines: Engines) -> list[str]:
    with engines.reader.connect() as connection:
        return list(connection.execute(select(TraceRow.spec_hash).order_by(TraceRow.spec_hash)).scalars())


def test_write_is_there_for_the_next_query_of_either_kind(engines: Engines) -> None:
    with engines.writer.begin() as connection:
        write(connection, ADD, {"name": "a"})
        assert [row.spec_hash for row in read(connection, (NAMES, {}))[0]] == ["a"]
        write(connection, ADD, {"name": "b"})
        assert list(connection.execute(select(TraceRow.spec_hash)).scalars()) == ["a", "b"]
        write(connection, ADD, {"name": "c"})
    assert names(engines) == ["a", "b", "c"]


def test_queries_that_are_read_together_return_their_own_rows(engines: Engines) -> None:
    count = Statement(text("SELECT count(*) AS jobs FROM traces"))
    with engines.writer.begin() as connection:
        write(connection, ADD, {"name": "a"})
        found, (counted,), nothing = read(connection, (NAMES, {}), (count, {}), (ADD, {"name": "b"}))
        assert ([row.spec_hash for row in found], counted.jobs, nothing) == (["a"], 1, [])
    assert names(engines) == ["a", "b"]


def test_bulk_update_changes_each_row_and_no_other(engines: Engines) -> None:
    with engines.writer.begin() as connection:
        for name in "abc":
            write(connection, ADD, {"name": name})
        RENAME.run(connection, [("a", b"1"), ("c", b"3"), ("gone", b"4")], {"now": NOW})
        RENAME.run(connection, [], {"now": NOW})
    with engines.reader.connect() as connection:
        rows = connection.execute(select(TraceRow.spec_hash, TraceRow.data, TraceRow.created_at)).all()
    assert sorted(rows) == [("a", b"1", NOW), ("b", b"", NOW), ("c", b"3", NOW)]


@pytest.mark.parametrize(
    "then",
    [
        lambda connection: None,
        lambda connection: read(connection, (NAMES, {})),
        lambda connection: connection.execute(select(CampaignRow.id)),
    ],
    ids=["commit", "query", "other statement"],
)
def test_failing_write_undoes_the_transaction(engines: Engines, then: Callable[[Connection], object]) -> None:
    def unit(connection: Connection) -> None:
        write(connection, ADD, {"name": "a"})
        write(connection, ADD, {"name": "a"})
        then(connection)

    with pytest.raises(IntegrityError):
        run(engines, unit)
    assert names(engines) == []
    with engines.writer.begin() as connection:
        write(connection, ADD, {"name": "b"})
    assert names(engines) == ["b"]


def test_write_that_waits_is_forgotten_with_its_transaction(engines: Engines) -> None:
    with engines.writer.connect() as connection:
        transaction = connection.begin()
        write(connection, ADD, {"name": "a"})
        transaction.rollback()
        with connection.begin():
            write(connection, ADD, {"name": "b"})
    assert names(engines) == ["b"]


def test_error_names_no_parameters(engines: Engines) -> None:
    def unit(connection: Connection) -> None:
        write(connection, ADD, {"name": "secret"})
        read(connection, (ADD, {"name": "secret"}))

    with pytest.raises(DBAPIError) as raised:
        run(engines, unit)
    assert raised.value.orig is not None
    assert raised.value.params is None


TEXTS = ["", " ", "NULL", '"', "\\", '\\"', "{a,b}", "a,b", "'", "%s $1", "é\U0001f600", "\n\t"]


def test_values_arrive_as_they_were_sent(engines: Engines) -> None:
    put = BulkUpdate(CampaignRow.id, [CampaignRow.notes], finished_at=bindparam("now"))
    look = Statement(
        select(CampaignRow.notes, CampaignRow.finished_at, CampaignRow.failed, CampaignRow.generation_end)
        .where(in_list(CampaignRow.notes, "notes"))
        .order_by(CampaignRow.id)
    )
    queue = Queue(engines=engines)
    campaigns = [queue.campaign(0) for _ in TEXTS]
    with engines.writer.begin() as connection:
        put.run(connection, list(zip(campaigns, TEXTS, strict=True)), {"now": NOW})
        rows, none = read(connection, (look, {"notes": TEXTS}), (look, {"notes": []}))
    assert [row.notes for row in rows] == TEXTS
    assert {driver_time(row.finished_at) for row in rows} == {NOW}
    assert {(row.failed, row.generation_end) for row in rows} == {(0, None)}
    assert none == []


@on_postgres
def test_text_that_postgres_cannot_store_is_refused(engines: Engines) -> None:
    with pytest.raises(DataError):
        run(engines, lambda connection: write(connection, ADD, {"name": "a\0b"}))
    run(engines, lambda connection: write(connection, ADD, {"name": "a"}))
    assert names(engines) == ["a"]


@on_postgres
def test_transaction_begins_all_the_same_after_a_query_with_an_invalid_parameter(engines: Engines) -> None:
    named = Statement(select(TraceRow.spec_hash).where(TraceRow.spec_hash == bindparam("name")))

    def unit(connection: Connection) -> None:
        with pytest.raises(DataError):
            read(connection, (named, {"name": "a\0b"}))
        write(connection, ADD, {"name": "a"})
        read(connection, (NAMES, {}))
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(engines, unit)
    assert names(engines) == [], "it was rolled back"


@on_postgres
def test_more_than_the_sockets_hold_is_sent_and_received_at_once(engines: Engines) -> None:
    echo = Statement(select(bindparam("words", type_=Text).label("words")))
    words = "x" * 4_000_000
    with engines.writer.begin() as connection:
        found = read(connection, *[(echo, {"words": words})] * 4)
    assert [row.words == words for (row,) in found] == [True] * 4


@on_postgres
def test_dropped_prepared_statements_are_prepared_again(engines: Engines) -> None:
    writer = Writer(engines.writer)
    try:
        for name in "ab":
            writer.submit(partial(write, statement=ADD, values={"name": name})).result(30.0)
            writer.submit(lambda connection: connection.execute(text("DEALLOCATE ALL"))).result(30.0)
    finally:
        writer.close()
    assert names(engines) == ["a", "b"]


def end_session(connection: Connection, engines: Engines) -> None:
    """Have the server end the session of a connection."""
    (own,) = read(connection, (Statement(text("SELECT pg_backend_pid() AS pid")), {}))[0]
    with engines.reader.connect() as other:
        other.execute(text("SELECT pg_terminate_backend(:pid, 5000)"), {"pid": own.pid})


@on_postgres
@pytest.mark.parametrize(
    "then",
    [
        lambda connection: write(connection, ADD, {"name": "a"}),
        lambda connection: read(connection, (NAMES, {})),
        lambda connection: connection.execute(select(CampaignRow.id)),
    ],
    ids=["commit", "query", "other statement"],
)
def test_lost_connection_is_reported_as_lost(engines: Engines, then: Callable[[Connection], object]) -> None:
    def unit(connection: Connection) -> None:
        end_session(connection, engines)
        then(connection)

    with pytest.raises(
        OperationalError, match="terminating connection due to administrator command"
    ) as raised:
        run(engines, unit)
    assert raised.value.connection_invalidated
    with engines.writer.begin() as connection:
        write(connection, ADD, {"name": "b"})
    assert names(engines) == ["b"]


@on_postgres
def test_unit_whose_connection_is_lost_is_told_that_the_database_is_unavailable(engines: Engines) -> None:
    def unit(connection: Connection) -> None:
        end_session(connection, engines)
        read(connection, (NAMES, {}))

    writer = Writer(engines.writer)
    try:
        with pytest.raises(Unavailable, match="database"):
            writer.submit(unit).result(30.0)
        writer.submit(partial(write, statement=ADD, values={"name": "a"})).result(30.0)
    finally:
        writer.close()
    assert names(engines) == ["a"]


@on_postgres
def test_transaction_that_only_writes_is_one_round_trip(engines: Engines, round_trips: list[int]) -> None:
    with engines.writer.begin() as connection:
        write(connection, ADD, {"name": "a"})
    assert round_trips == [3]
    with engines.writer.begin():
        pass
    assert round_trips == [3]
    assert names(engines) == ["a"]


@on_postgres
def test_connection_that_commits_each_statement_begins_no_transaction(engines: Engines) -> None:
    with engines.writer.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(text("VACUUM traces"))  # not allowed in a transaction
    with engines.writer.begin() as connection:
        write(connection, ADD, {"name": "a"})
    assert names(engines) == ["a"]


@on_postgres
def test_transaction_between_statements_of_sqlalchemy_is_one(engines: Engines) -> None:
    def unit(connection: Connection) -> None:
        connection.execute(insert(TraceRow).values(spec_hash="a", data=b"", created_at=NOW))
        connection.execute(update(TraceRow).values(data=b"1"))
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(engines, unit)
    assert names(engines) == []


@on_postgres
def test_report_and_lease_take_two_round_trips(queue: Queue, round_trips: list[int]) -> None:
    queue.campaign(100)
    demand = LeaseDemand(worker="w1", capabilities=(SIMULATOR,), max_jobs=4, terms=TERMS)
    jobs = queue.lease("w1", 4)
    round_trips.clear()
    outcomes = tuple(Outcome(job=job.job, token=job.token, result=RESULT) for job in jobs)
    ((report, granted),) = queue.exchange(Exchange(terms=TERMS, outcomes=outcomes, demand=demand))
    assert report.statuses == ("accepted",) * 4
    assert len(granted) == 4
    assert len(round_trips) == 2

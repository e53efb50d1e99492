"""Frequent statements, which the driver runs: their values, their errors, and what becomes of a transaction."""

from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial

import pytest
from sqlalchemy import Connection, bindparam, insert, select, text, update
from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, OperationalError
from support.databases import on_postgres
from support.queue import Queue

from brink.server.db.engine import Engines
from brink.server.db.models import CampaignRow, TraceRow
from brink.server.db.sql import in_list
from brink.server.db.statements import Statement
from brink.server.db.types import UtcDateTime
from brink.server.db.writer import Writer
from brink.server.errors import Unavailable

NOW = datetime(2026, 1, 1, tzinfo=UTC)
ADD = Statement(insert(TraceRow).values(spec_hash=bindparam("name"), data=b"", created_at=NOW))
NAMES = Statement(select(TraceRow.spec_hash).order_by(TraceRow.spec_hash))
PREPARED_AFTER = 5
"""A driver that runs a statement for more often than this prepares it."""


def run(engines: Engines, unit: Callable[[Connection], object]) -> None:
    """Run a unit in a transaction of its own."""
    with engines.writer.begin() as connection:
        unit(connection)


def names(engines: Engines) -> list[str]:
    with engines.reader.connect() as connection:
        return list(connection.execute(select(TraceRow.spec_hash).order_by(TraceRow.spec_hash)).scalars())


def test_statements_of_both_kinds_share_a_transaction(engines: Engines) -> None:
    def unit(connection: Connection) -> None:
        assert ADD.run(connection, name="a") == []
        assert list(connection.execute(select(TraceRow.spec_hash)).scalars()) == ["a"]
        connection.execute(insert(TraceRow).values(spec_hash="b", data=b"", created_at=NOW))
        assert [row.spec_hash for row in NAMES.run(connection)] == ["a", "b"]
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(engines, unit)
    assert names(engines) == []


def test_failing_statement_undoes_the_transaction_and_names_no_parameters(engines: Engines) -> None:
    def unit(connection: Connection) -> None:
        ADD.run(connection, name="secret")
        ADD.run(connection, name="secret")

    with pytest.raises(IntegrityError) as raised:
        run(engines, unit)
    assert isinstance(raised.value, DBAPIError)
    assert raised.value.params is None
    assert names(engines) == []
    run(engines, lambda connection: ADD.run(connection, name="b"))
    assert names(engines) == ["b"]


TEXTS = ["", " ", "NULL", '"', "\\", '\\"', "{a,b}", "a,b", "'", "%s $1", "é\U0001f600", "\n\t"]


def test_values_arrive_as_they_were_sent(engines: Engines) -> None:
    put = Statement(
        update(CampaignRow)
        .where(CampaignRow.id == bindparam("campaign"))
        .values(notes=bindparam("words"), finished_at=bindparam("now", type_=UtcDateTime()))
    )
    look = Statement(
        select(CampaignRow.notes, CampaignRow.failed, CampaignRow.generation_end)
        .where(in_list(CampaignRow.notes, "words"))
        .order_by(CampaignRow.id)
    )
    queue = Queue(engines=engines)
    campaigns = [queue.campaign(0) for _ in TEXTS]
    with engines.writer.begin() as connection:
        for campaign, words in zip(campaigns, TEXTS, strict=True):
            put.run(connection, campaign=campaign, words=words, now=NOW)
        rows = look.run(connection, words=TEXTS)
        assert look.run(connection, words=[]) == []
        moments = set(connection.execute(select(CampaignRow.finished_at)).scalars())
    assert [row.notes for row in rows] == TEXTS
    assert {(row.failed, row.generation_end) for row in rows} == {(0, None)}
    assert moments == {NOW}


@on_postgres
def test_text_that_postgres_cannot_store_is_refused(engines: Engines) -> None:
    with pytest.raises(DataError):
        run(engines, lambda connection: ADD.run(connection, name="a\0b"))
    run(engines, lambda connection: ADD.run(connection, name="a"))
    assert names(engines) == ["a"]


@on_postgres
def test_dropped_prepared_statements_are_prepared_again(engines: Engines) -> None:
    drop = text(
        "DO $$ BEGIN EXECUTE 'DEALLOCATE ALL'; END $$"
    )  # as a connection pooler does: the driver is not told
    prefixes = "abc"

    def add_some(connection: Connection, prefix: str) -> None:
        for number in range(PREPARED_AFTER + 3):
            ADD.run(connection, name=f"{prefix}{number}")

    def count_prepared(connection: Connection) -> int:
        return int(connection.execute(text("SELECT count(*) FROM pg_prepared_statements")).scalar_one())

    writer = Writer(engines.writer)
    try:
        for prefix in prefixes:
            writer.submit(partial(add_some, prefix=prefix)).result(30.0)
            assert writer.submit(count_prepared).result(30.0) > 0
            writer.submit(lambda connection: connection.execute(drop)).result(30.0)
    finally:
        writer.close()
    assert len(names(engines)) == len(prefixes) * (PREPARED_AFTER + 3)


def end_session(connection: Connection, engines: Engines) -> None:
    """Have the server end the session of a connection."""
    own = connection.execute(text("SELECT pg_backend_pid()")).scalar_one()
    with engines.reader.connect() as other:
        other.execute(text("SELECT pg_terminate_backend(:pid, 5000)"), {"pid": own})


@on_postgres
def test_lost_connection_is_reported_as_lost(engines: Engines) -> None:
    def unit(connection: Connection) -> None:
        end_session(connection, engines)
        NAMES.run(connection)

    with pytest.raises(
        OperationalError, match="terminating connection due to administrator command"
    ) as raised:
        run(engines, unit)
    assert raised.value.connection_invalidated
    run(engines, lambda connection: ADD.run(connection, name="b"))
    assert names(engines) == ["b"]


@on_postgres
@pytest.mark.parametrize(
    "then", [lambda connection: NAMES.run(connection), lambda connection: None], ids=["statement", "commit"]
)
def test_unit_whose_connection_is_lost_is_told_that_the_database_is_unavailable(
    engines: Engines, then: Callable[[Connection], object]
) -> None:
    def unit(connection: Connection) -> None:
        ADD.run(connection, name="lost")
        end_session(connection, engines)
        then(connection)

    writer = Writer(engines.writer)
    try:
        with pytest.raises(Unavailable, match="database"):
            writer.submit(unit).result(30.0)
        writer.submit(lambda connection: ADD.run(connection, name="a")).result(30.0)
    finally:
        writer.close()
    assert names(engines) == ["a"]

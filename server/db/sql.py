"""SQL that several packages share: the database's clock, row locks, list parameters, lookup by id.

SQLite and Postgres differ in most of these; this module hides the differences.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, Generic, TypeVar

from sqlalchemy import (
    ColumnClause,
    ColumnElement,
    Connection,
    FromClause,
    Integer,
    Row,
    Select,
    String,
    Text,
    bindparam,
    func,
    literal_column,
    select,
    text,
    true,
    update,
)
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.engine.interfaces import Dialect
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement
from sqlalchemy.types import TypeDecorator, TypeEngine

from brink.server.db.models import NEXT_SEQUENCE, CampaignRow
from brink.server.db.types import UtcDateTime
from brink.server.errors import SHORTEST_ID, NotFound
from brink.server.states import CampaignStatus

V = TypeVar("V")
MAX_ID = 16
AMBIGUOUS_SHOWN = 5


def database_now(connection: Connection) -> datetime:
    """Return the database server's time, which decides leases; for SQLite that is this machine's."""
    if connection.dialect.name == "postgresql":
        moment = connection.execute(text("SELECT clock_timestamp()")).scalar_one()
        assert isinstance(moment, datetime)
        return moment.astimezone(UTC)
    return datetime.now(UTC)


def allow_pauses(connection: Connection) -> None:
    """Let this transaction wait for locks, and pause between statements, without a time limit.

    Postgres otherwise ends transactions of the writer that do (`brink.server.db.engine`).
    """
    if connection.dialect.name == "postgresql":
        for timeout in ("lock_timeout", "idle_in_transaction_session_timeout"):
            connection.execute(text(f"SET LOCAL {timeout} = 0"))


def storable(words: str) -> str:
    """Return a text without NUL characters, which Postgres cannot store."""
    return words.replace("\0", "\N{REPLACEMENT CHARACTER}")


def constant(value: str | int) -> ColumnClause[Any]:
    """Return a literal that is embedded in a statement's text.

    Postgres plans a prepared statement without knowing its parameters. It cannot use a partial index whose condition
    is on a parameter.
    """
    if isinstance(value, int):
        return literal_column(str(value), Integer())
    if not value.isidentifier():
        raise ValueError(f"expected a plain word, got {value!r}")
    return literal_column(f"'{value}'", String())


_EVERY_CAMPAIGN = CampaignRow.__table__.alias("every_campaign")
LAST_TURN = (
    select(func.coalesce(func.max(_EVERY_CAMPAIGN.c.turn), 0) + 1)
    # A literal, so that the index of running campaigns is used: ended campaigns need not be read.
    .where(_EVERY_CAMPAIGN.c.status == constant(CampaignStatus.RUNNING))
    .scalar_subquery()
)
"""The turn of a campaign that moves to the back of the queue, behind all running ones."""


class _TransactionTime(FunctionElement[datetime]):
    """The time at which the transaction began on Postgres, and a parameter on SQLite."""

    type: TypeEngine[Any] = UtcDateTime()
    inherit_cache = True


@compiles(_TransactionTime, "sqlite")
def _transaction_time_sqlite(element: _TransactionTime, compiler: SQLCompiler, **options: Any) -> str:
    return compiler.process(element.clauses, **options)


@compiles(_TransactionTime)
def _transaction_time_postgres(element: _TransactionTime, compiler: SQLCompiler, **options: Any) -> str:
    return "now()"


def transaction_time(name: str) -> FunctionElement[datetime]:
    """Return the time of the transaction by the database's clock.

    SQLite has the clock of this machine, which the statement gets as the parameter `name`. Postgres needs none, so
    that the first statement of a transaction can tell the time and use it.
    """
    return _TransactionTime(bindparam(name, type_=UtcDateTime()))


def driver_time(value: datetime | str) -> datetime:
    """Return a time from a row of a frequent statement: SQLite's driver returns text without a time zone."""
    if isinstance(value, str):
        return datetime.fromisoformat(value).replace(tzinfo=UTC)
    return value.astimezone(UTC)


def lock_rows(
    query: Select[*tuple[Any, ...]], connection: Connection, table: Any, *, skip_locked: bool = False
) -> Select[*tuple[Any, ...]]:
    """Return a query that also locks its rows of one table until the transaction ends.

    SQLite has no row locks and needs none: its only writer holds the write lock from BEGIN on.

    Args:
        query: Selects the rows.
        connection: In a write transaction.
        table: The mapped class whose rows are locked.
        skip_locked: Leave out rows that another transaction has locked, instead of waiting for it.
    """
    if connection.dialect.name == "sqlite":
        return query
    return _for_update(query, table, skip_locked)


@lru_cache(maxsize=64)  # SQLAlchemy compiles every new statement object again
def _for_update(query: Select[*tuple[Any, ...]], table: Any, skip_locked: bool) -> Select[*tuple[Any, ...]]:
    return query.with_for_update(of=table, skip_locked=skip_locked)


def lock_campaign(connection: Connection, campaign_id: str) -> bool:
    """Lock a campaign's row until the transaction ends; return whether the campaign exists."""
    query = lock_rows(select(CampaignRow.id).where(CampaignRow.id == campaign_id), connection, CampaignRow)
    return connection.execute(query).one_or_none() is not None


def note_change(connection: Connection, campaign_id: str) -> None:
    """Increase a campaign's change counter, so that polling clients notice the change."""
    connection.execute(
        update(CampaignRow).where(CampaignRow.id == campaign_id).values(sequence=NEXT_SEQUENCE)
    )


def newest_first(
    table: FromClause, *, limit: int, before: tuple[datetime, str] | None
) -> Select[*tuple[Any, ...]]:
    """Return the query for one page of rows, newest first.

    Args:
        table: Table with columns ``id`` and ``created_at``.
        limit: Maximum number of rows.
        before: Creation time and id of the last row of the previous page.
    """
    query = select(table).order_by(table.c.created_at.desc(), table.c.id.desc()).limit(limit)
    if before is None:
        return query
    moment, name = before
    created = table.c.created_at
    return query.where((created < moment) | ((created == moment) & (table.c.id < name)))


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentTable(Generic[V]):
    """Finds submitted documents: campaigns or experiments.

    Attributes:
        kind: What a row is called in messages, such as "campaign".
        table: Table with columns ``id``, ``created_at``, ``document_hash`` and ``idempotency_key``.
        build: Converts a row to a value.
        shown: Condition on the rows that can be found; the others are as good as gone.
    """

    kind: str
    table: FromClause
    build: Callable[[Connection, Sequence[Row[*tuple[Any, ...]]]], list[V]]
    shown: ColumnElement[bool] = field(default_factory=true)

    def find(self, connection: Connection, exact_id: str, *, lock: bool = False) -> V | None:
        """Return the value with an id, or None; with `lock`, lock its row until the transaction ends."""
        return self._first(connection, self.table.c.id == exact_id, lock=lock)

    def find_by_key(self, connection: Connection, key: str) -> V | None:
        """Return the value that was submitted with an idempotency key, or None."""
        return self._first(connection, self.table.c.idempotency_key == key)

    def get(self, connection: Connection, name: str, *, lock: bool = False) -> V:
        """Return a value by its id or by a unique prefix of it, at least two characters long.

        Args:
            connection: To read from.
            name: The id or the prefix.
            lock: Whether to lock the row until the transaction ends.

        Raises:
            NotFound: No row matches, or several do.
        """
        plausible = name.isalnum() and name.isascii() and len(name) <= MAX_ID
        found = self.find(connection, name, lock=lock) if plausible else None
        if found is not None:
            return found
        rows: Sequence[Row[*tuple[Any, ...]]] = ()
        if plausible and len(name) >= SHORTEST_ID:
            starts = self.table.c.id.startswith(name, autoescape=True)
            matches = select(self.table).where(starts, self.shown)
            rows = connection.execute(matches.order_by(self.table.c.id).limit(AMBIGUOUS_SHOWN + 1)).all()
        if len(rows) == 1:
            return self.build(connection, rows)[0]
        raise NotFound(f"{self.kind} {name[:40]!r}: {self._why_none(name, [row.id for row in rows])}")

    def _why_none(self, name: str, matching: Sequence[str]) -> str:
        """Explain why a name, or the beginning of an id, matches nothing."""
        if matching:
            shown = ", ".join(matching[:AMBIGUOUS_SHOWN])
            more = " and more" if len(matching) > AMBIGUOUS_SHOWN else ""
            return (
                f"more than one {self.kind} has an id with this prefix: {shown}{more}; give more characters"
            )
        if len(name) < SHORTEST_ID:
            return f"expected at least {SHORTEST_ID} characters of the id"
        return f"no such {self.kind}"

    def page(
        self,
        connection: Connection,
        *,
        limit: int,
        before: tuple[datetime, str] | None = None,
        document_hash: str | None = None,
        statuses: Sequence[str] = (),
        conditions: Sequence[ColumnElement[bool]] = (),
    ) -> list[V]:
        """Return one page of values, newest first.

        Args:
            connection: To read from.
            limit: Maximum number of values.
            before: Creation time and id of the last value of the previous page.
            document_hash: Only values whose document has this hash.
            statuses: Only values with one of these statuses; any if empty. Needs a column ``status``.
            conditions: Further conditions on the table.
        """
        query = newest_first(self.table, limit=limit, before=before).where(self.shown, *conditions)
        if document_hash is not None:
            query = query.where(self.table.c.document_hash == document_hash)
        if statuses:
            query = query.where(self.table.c.status.in_(statuses))
        return self.build(connection, connection.execute(query).all())

    def _first(
        self, connection: Connection, condition: ColumnElement[bool], *, lock: bool = False
    ) -> V | None:
        query = select(self.table).where(condition, self.shown)
        rows = connection.execute(lock_rows(query, connection, self.table) if lock else query).all()
        return self.build(connection, rows)[0] if rows else None


class _ListParameter(TypeDecorator[Sequence[Any]]):
    """A list as a single parameter: an array on Postgres, JSON on SQLite."""

    impl = Text
    cache_ok = True

    def __init__(self, item: TypeEngine[Any]) -> None:
        super().__init__()
        self.item = item

    def load_dialect_impl(self, dialect: Dialect) -> TypeEngine[Any]:
        return dialect.type_descriptor(Text() if dialect.name == "sqlite" else ARRAY(self.item))

    def process_bind_param(self, value: Sequence[Any] | None, dialect: Dialect) -> Any:
        values = list(value or ())
        return json.dumps(values) if dialect.name == "sqlite" else values


class _InList(FunctionElement[bool]):
    """Tests whether the first argument is an element of the second."""

    # As a Boolean it would be compared with 1 on SQLite, which then uses no index.
    type: TypeEngine[Any] = Integer()
    inherit_cache = True


@compiles(_InList, "sqlite")
def _in_list_sqlite(element: _InList, compiler: SQLCompiler, **options: Any) -> str:
    left, right = element.clauses
    values = compiler.process(right, **options)
    return f"{compiler.process(left, **options)} IN (SELECT value FROM json_each({values}))"


@compiles(_InList)
def _in_list_postgres(element: _InList, compiler: SQLCompiler, **options: Any) -> str:
    left, right = element.clauses
    return f"{compiler.process(left, **options)} = ANY ({compiler.process(right, **options)})"


def in_list(attribute: InstrumentedAttribute[Any], name: str) -> FunctionElement[bool]:
    """Return the condition that a column's value is in the list bound to the parameter `name`.

    Unlike ``IN (…)``, the statement's text does not depend on the length of the list, so that the database and
    SQLAlchemy reuse its plan.
    """
    return _InList(attribute, bindparam(name, type_=_ListParameter(attribute.type)))

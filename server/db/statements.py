"""Frequent statements: written with SQLAlchemy, compiled once, and run by the database's driver.

SQLAlchemy takes longer to run a small statement than the database does, so these skip its execution. They keep its
language, its parameter types and its errors. Rows hold the driver's values: on SQLite, for example, Booleans are
numbers.

On Postgres, a statement that runs alone is a round trip. Here, several queries can share one, in psycopg's pipeline
mode, and BEGIN and writes wait for the next query or the COMMIT. SQLite has no round trips and runs each statement at
once.
"""

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

from sqlalchemy import BindParameter, ClauseElement, Connection, Engine, event, func, text, update
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.engine.interfaces import Dialect
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.pool import ConnectionPoolEntry
from sqlalchemy.sql import bindparam, column

Values: TypeAlias = Mapping[str, Any]
"""The parameters of a statement by name."""


@dataclass(slots=True)
class _Compiled:
    """A statement as one driver takes it.

    Attributes:
        text: The statement: text for SQLite, bytes for psycopg.
        constants: Parameters with fixed values.
        converters: Functions that convert the other parameters for the driver, where the driver cannot.
        order: The names of the parameters in order, for a driver that takes them by position.
        row: Makes a row of its values; None before the first result.
    """

    text: Any
    constants: dict[str, Any]
    converters: dict[str, Callable[[Any], Any]]
    order: tuple[str, ...] | None
    row: Callable[[Sequence[Any]], Any] | None = None

    def parameters(self, given: Values) -> Any:
        values = {**self.constants, **given}
        for name, convert in self.converters.items():
            values[name] = convert(values[name])
        return values if self.order is None else tuple([values[name] for name in self.order])

    def rows(self, cursor: Any) -> list[Any]:
        if self.row is None:
            # psycopg describes columns by objects, SQLite by tuples; both begin with the name.
            row: Any = namedtuple("Row", [described[0] for described in cursor.description])  # type: ignore[misc]
            self.row = row._make
        return list(map(self.row, cursor.fetchall()))


class Statement:
    """A statement with named parameters.

    Args:
        query: The statement.
        postgres: The statement for Postgres if that differs, for example because it locks rows.
    """

    def __init__(self, query: ClauseElement, *, postgres: ClauseElement | None = None) -> None:
        self._queries = {"sqlite": query, "postgresql": query if postgres is None else postgres}
        self._compiled: dict[str, _Compiled] = {}

    def compiled(self, dialect: Dialect) -> _Compiled:
        """Return the statement for a database."""
        found = self._compiled.get(dialect.name)
        if found is None:
            found = self._compiled[dialect.name] = _compile(self._queries[dialect.name], dialect)
        return found


def _compile(query: ClauseElement, dialect: Dialect) -> _Compiled:
    compiled: Any = query.compile(dialect=dialect)
    constants: dict[str, Any] = {}
    converters: dict[str, Callable[[Any], Any]] = {}
    for name, bound in compiled.binds.items():
        convert = bound.type.dialect_impl(dialect).bind_processor(dialect)
        if bound.required:
            if convert is not None:
                converters[name] = convert
        else:
            value = bound.effective_value
            value = value.value if isinstance(value, Enum) else value
            constants[name] = value if convert is None else convert(value)
    if compiled.positiontup is None:
        return _Compiled(compiled.string.encode(), constants, converters, None)
    order = tuple(compiled.positiontup)
    named = {name: convert for name, convert in converters.items() if name in order}
    return _Compiled(compiled.string, constants, named, order)


_WAITING = "brink.waiting"
"""Key of the statements that wait, in the information that SQLAlchemy keeps with a driver's connection."""
_BEGIN, _COMMIT = Statement(text("BEGIN")), Statement(text("COMMIT"))


def is_pipelined(connection: Connection) -> bool:
    """Return whether statements share round trips, so that it pays to read ahead."""
    return connection.dialect.name == "postgresql"


def write(connection: Connection, statement: Statement, values: Values) -> None:
    """Run a statement that returns no rows, at the latest with the next statement or the commit.

    Args:
        connection: In a write transaction.
        statement: The statement.
        values: Its parameters.
    """
    if is_pipelined(connection):
        connection.info.setdefault(_WAITING, []).append((statement, values))
    else:
        _run(connection, [(statement, values)])


def read(connection: Connection, *queries: tuple[Statement, Values]) -> list[list[Any]]:
    """Run the writes that wait, then these queries; return the rows of each query.

    Args:
        connection: In a write transaction.
        queries: Statements with their parameters.
    """
    waiting = connection.info.pop(_WAITING, [])
    return _run(connection, [*waiting, *queries])[len(waiting) :]


def share_round_trips(engine: Engine) -> None:
    """Send the BEGIN of an engine's transactions on Postgres with the first statement, and writes with the next one.

    The last writes share the round trip of the COMMIT.
    """

    @event.listens_for(engine, "connect")
    def configure(driver: Any, _: ConnectionPoolEntry) -> None:
        driver.autocommit = True  # otherwise, the driver sends each BEGIN alone and waits for the answer

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        commits_itself = connection.get_execution_options().get("isolation_level") == "AUTOCOMMIT"
        connection.info[_WAITING] = [] if commits_itself else [(_BEGIN, {})]

    @event.listens_for(engine, "before_cursor_execute")
    def run_waiting(connection: Connection, *_: Any) -> None:
        if connection.info.get(_WAITING):
            read(connection)

    @event.listens_for(engine, "commit")
    def commit(connection: Connection) -> None:
        waiting = connection.info.pop(_WAITING, [])
        if waiting and waiting != [(_BEGIN, {})]:
            # SQLAlchemy then commits as well, but the driver knows that the transaction has ended.
            _run(connection, [*waiting, (_COMMIT, {})])

    @event.listens_for(engine, "rollback")
    def forget(connection: Connection) -> None:
        connection.info.pop(_WAITING, None)


def _run(connection: Connection, statements: Sequence[tuple[Statement, Values]]) -> list[list[Any]]:
    """Run statements, on Postgres in one round trip; return the rows of each."""
    if not is_pipelined(connection):
        return [_round_trip(connection, [one])[0] for one in statements]
    return _round_trip(connection, statements)


def _round_trip(connection: Connection, statements: Sequence[tuple[Statement, Values]]) -> list[list[Any]]:
    dialect = connection.dialect
    compiled = [statement.compiled(dialect) for statement, _ in statements]
    parameters = [one.parameters(values) for one, (_, values) in zip(compiled, statements, strict=True)]
    driver: Any = connection.connection.driver_connection
    error_type = dialect.loaded_dbapi.Error
    try:
        with driver.pipeline() if len(statements) > 1 else nullcontext():
            cursors = execute(driver, [one.text for one in compiled], parameters)
        return [
            [] if cursor.description is None else one.rows(cursor)
            for one, cursor in zip(compiled, cursors, strict=True)
        ]
    except error_type as error:
        is_lost = dialect.is_disconnect(error, driver, None)
        if is_lost:
            connection.invalidate(error)
        raise DBAPIError.instance(
            None,
            None,
            error,
            error_type,
            hide_parameters=True,
            connection_invalidated=is_lost,
            dialect=dialect,
        ) from error


def execute(driver: Any, texts: Sequence[Any], parameters: Sequence[Any]) -> list[Any]:
    """Execute statements in order; return their cursors, which have no rows before the end of a pipeline.

    Args:
        driver: The driver's connection.
        texts: The statements; several only in a pipeline.
        parameters: The parameters of each.
    """
    return [driver.execute(text, given) for text, given in zip(texts, parameters, strict=True)]


class BulkUpdate:
    """An update of many rows with individual values: one statement on Postgres, one for each row on SQLite.

    The statement's text does not depend on the number of rows, so that its plan is reused.

    Args:
        key: The column that identifies rows.
        each: The columns with an individual value for each row.
        values: The other columns, with expressions that all rows share; these may contain parameters.
    """

    def __init__(
        self, key: InstrumentedAttribute[Any], each: Sequence[InstrumentedAttribute[Any]], **values: Any
    ) -> None:
        columns = [key, *each]
        self._names = [f"each_{attribute.key}" for attribute in columns]
        table = key.class_
        singly: dict[str, Any] = {attribute.key: bindparam(f"each_{attribute.key}") for attribute in each}
        arrays: list[BindParameter[Any]] = [
            bindparam(f"each_{attribute.key}", type_=ARRAY(attribute.type)) for attribute in columns
        ]
        given = (
            func.unnest(*arrays)
            .table_valued(*(column(attribute.key, attribute.type) for attribute in columns))
            .render_derived(name="given")
        )
        together = {attribute.key: given.c[attribute.key] for attribute in each}
        self._update = Statement(
            update(table).where(key == bindparam(f"each_{key.key}")).values({**singly, **values}),
            postgres=update(table).where(key == given.c[key.key]).values({**together, **values}),
        )

    def run(
        self, connection: Connection, rows: Sequence[Sequence[Any]], shared: Values | None = None
    ) -> None:
        """Update rows.

        Args:
            connection: In a write transaction.
            rows: For each row its key, followed by the values of the `each` columns.
            shared: Values of the parameters in the shared expressions.
        """
        shared = shared or {}
        if not rows:
            return
        if is_pipelined(connection):
            columns = [list(values) for values in zip(*rows, strict=True)]
            write(connection, self._update, {**dict(zip(self._names, columns, strict=True)), **shared})
        else:
            each = [{**dict(zip(self._names, row, strict=True)), **shared} for row in rows]
            _run(connection, [(self._update, values) for values in each])

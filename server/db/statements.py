"""Frequent statements: written with SQLAlchemy, compiled once, and run by the database's driver.

SQLAlchemy takes longer to run a small statement than the database does, so these skip its execution. They keep its
language, its parameter types and its errors. Rows hold the driver's values: on SQLite, for example, Booleans are
numbers.

On Postgres, a statement that runs alone is a round trip. Here, several queries can share one
(`brink.server.db.pipeline`), and BEGIN and writes wait for the next query or the COMMIT. SQLite has no round trips
and runs each statement at once.
"""

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
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
    """A statement in the form that one driver accepts.

    Attributes:
        text: The statement, with its parameters by position.
        order: The names of the parameters in order.
        constants: Parameters with fixed values.
        converters: Functions that convert the other parameters for the driver, where the driver cannot.
        row: Makes a row of its values, on SQLite; None before the first result.
    """

    text: str
    order: tuple[str, ...]
    constants: dict[str, Any]
    converters: dict[str, Callable[[Any], Any]]
    row: Callable[[Sequence[Any]], Any] | None = None

    def parameters(self, given: Values) -> tuple[Any, ...]:
        values = {**self.constants, **given}
        for name, convert in self.converters.items():
            values[name] = convert(values[name])
        return tuple([values[name] for name in self.order])


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
    styled: Dialect = dialect if dialect.name == "sqlite" else type(dialect)(paramstyle="numeric_dollar")  # type: ignore[call-arg]
    compiled: Any = query.compile(dialect=styled)
    constants: dict[str, Any] = {}
    converters: dict[str, Callable[[Any], Any]] = {}
    for name, bound in compiled.binds.items():
        convert = bound.type.dialect_impl(styled).bind_processor(styled)
        if bound.required:
            if convert is not None:
                converters[name] = convert
        else:
            value = bound.effective_value
            value = value.value if isinstance(value, Enum) else value
            constants[name] = value if convert is None else convert(value)
    return _Compiled(compiled.string, tuple(compiled.positiontup or ()), constants, converters)


_WAITING = "brink.waiting"
"""Key of the statements that wait, in the information that SQLAlchemy keeps with a driver's connection."""
_PIPELINE = "brink.pipeline"
"""Key of the connection's pipeline in the same place."""
_BEGIN, _COMMIT = Statement(text("BEGIN")), Statement(text("COMMIT"))


def is_pipelined(connection: Connection) -> bool:
    """Return whether statements share round trips, so that reading ahead pays off."""
    return connection.dialect.name == "postgresql"


def write(connection: Connection, statement: Statement, values: Values) -> None:
    """Queue a statement that returns no rows; it runs with the next query or the commit at the latest.

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
    """Run the queued writes, then these queries; return the rows of each query.

    Args:
        connection: In a write transaction.
        queries: Statements with their parameters.
    """
    waiting = connection.info.get(_WAITING, [])
    found = _run(connection, [*waiting, *queries])[len(waiting) :]
    # Not before: if a parameter is invalid, nothing was sent, and the BEGIN still has to be.
    connection.info.pop(_WAITING, None)
    return found


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
        if connection.invalidated:  # its information is gone, and asking for it would hide the original error
            return
        connection.info.pop(_WAITING, None)
        connection.info.pop(_PIPELINE, None)  # the driver may now drop all prepared statements


def _run(connection: Connection, statements: Sequence[tuple[Statement, Values]]) -> list[list[Any]]:
    """Run statements, on Postgres in one round trip; return the rows of each."""
    dialect = connection.dialect
    compiled = [statement.compiled(dialect) for statement, _ in statements]
    parameters = [one.parameters(values) for one, (_, values) in zip(compiled, statements, strict=True)]
    driver: Any = connection.connection.driver_connection
    error_type = dialect.loaded_dbapi.Error
    try:
        return execute(connection, driver, compiled, parameters)
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


def execute(
    connection: Connection,
    driver: Any,
    statements: Sequence[_Compiled],
    parameters: Sequence[tuple[Any, ...]],
) -> list[list[Any]]:
    """Execute statements in order; return the rows of each.

    Args:
        connection: The connection.
        driver: The driver's connection.
        statements: The statements.
        parameters: The parameters of each.
    """
    if not is_pipelined(connection):
        return [
            _rows(one, driver.execute(one.text, given))
            for one, given in zip(statements, parameters, strict=True)
        ]
    pipeline = connection.info.get(_PIPELINE)
    if pipeline is None:
        from brink.server.db.pipeline import Pipeline  # needs psycopg, which is optional

        pipeline = connection.info[_PIPELINE] = Pipeline(driver)
    rows: list[list[Any]] = pipeline.run([one.text for one in statements], parameters)
    return rows


def _rows(statement: _Compiled, cursor: Any) -> list[Any]:
    """Return the rows of a statement on SQLite."""
    if cursor.description is None:
        return []
    if statement.row is None:
        row: Any = namedtuple("Row", [described[0] for described in cursor.description])  # type: ignore[misc]
        statement.row = row._make
    return list(map(statement.row, cursor.fetchall()))


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

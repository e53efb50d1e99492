"""Frequent statements: written with SQLAlchemy, compiled once, and run by the database's driver.

SQLAlchemy takes longer to run a small statement than the database does, so these skip its execution. They keep its
language, its parameter types and its errors. Rows hold the driver's values: on SQLite, for example, Booleans are
numbers.
"""

from collections import namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import Any

from sqlalchemy import ClauseElement, Connection
from sqlalchemy.engine.interfaces import Dialect
from sqlalchemy.exc import DBAPIError


@dataclass(frozen=True, slots=True)
class _Compiled:
    """A statement in the form that one driver accepts.

    Attributes:
        text: The statement, with named parameters.
        constants: Parameters with fixed values.
        converters: Functions that convert the other parameters for the driver, where the driver cannot.
    """

    text: str
    constants: dict[str, Any]
    converters: dict[str, Callable[[Any], Any]]

    def parameters(self, given: Mapping[str, Any]) -> dict[str, Any]:
        values = {**self.constants, **given}
        for name, convert in self.converters.items():
            values[name] = convert(values[name])
        return values


class Statement:
    """A statement with named parameters.

    Args:
        query: The statement.
        postgres: The statement for Postgres, if that differs.
    """

    def __init__(self, query: ClauseElement, *, postgres: ClauseElement | None = None) -> None:
        self._queries = {"sqlite": query, "postgresql": query if postgres is None else postgres}
        self._compiled: dict[str, _Compiled] = {}

    def run(self, connection: Connection, **values: Any) -> list[Any]:
        """Run the statement; return its rows.

        Args:
            connection: In a transaction.
            values: The parameters.
        """
        dialect = connection.dialect
        compiled = self._compiled.get(dialect.name)
        if compiled is None:
            compiled = self._compiled[dialect.name] = _compile(self._queries[dialect.name], dialect)
        parameters = compiled.parameters(values)
        driver: Any = connection.connection.driver_connection
        error_type = dialect.loaded_dbapi.Error
        try:
            return execute(driver, compiled.text, parameters)
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


def execute(driver: Any, text: str, parameters: Mapping[str, Any]) -> list[Any]:
    """Execute a statement on a driver's connection; return its rows."""
    cursor = driver.execute(text, parameters)
    if cursor.description is None:
        return []
    row: Any = _row_type(tuple([described[0] for described in cursor.description]))
    return list(map(row._make, cursor.fetchall()))


@lru_cache(maxsize=64)
def _row_type(names: tuple[str, ...]) -> Any:
    return namedtuple("Row", names)


def _compile(query: ClauseElement, dialect: Dialect) -> _Compiled:
    named: Dialect = type(dialect)(paramstyle="named") if dialect.name == "sqlite" else dialect  # type: ignore[call-arg]
    compiled: Any = query.compile(dialect=named)
    constants: dict[str, Any] = {}
    converters: dict[str, Callable[[Any], Any]] = {}
    for name, bound in compiled.binds.items():
        convert = bound.type.dialect_impl(named).bind_processor(named)
        if bound.required:
            if convert is not None:
                converters[name] = convert
        else:
            value = bound.effective_value
            value = value.value if isinstance(value, Enum) else value
            constants[name] = value if convert is None else convert(value)
    return _Compiled(compiled.string, constants, converters)

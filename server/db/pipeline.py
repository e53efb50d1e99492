"""Runs statements on Postgres together, in one round trip: libpq's pipeline mode, by way of `psycopg.pq`.

psycopg has a pipeline mode of its own, but sends each statement in a packet of its own and looks for results after
each one. Eight small statements then take several times as long (docs/adr/0054-statements-share-round-trips.md).

Statements are prepared when a connection runs them for the first time. Parameters and results are text; psycopg's
loaders convert the results.
"""

import itertools
import select
from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, TypeAlias

from psycopg import Connection, DataError, InterfaceError, OperationalError, pq
from psycopg.errors import error_from_result

Rows: TypeAlias = list[Any]

_NAMES = itertools.count()
"""Numbers of prepared statements. Names are never used again: it is unknown which ones a rollback has left over."""
_EXPECTED = frozenset(
    {
        pq.ExecStatus.COMMAND_OK,
        pq.ExecStatus.TUPLES_OK,
        pq.ExecStatus.FATAL_ERROR,
        pq.ExecStatus.PIPELINE_ABORTED,
    }
)


@dataclass(slots=True)
class _Prepared:
    """A prepared statement of one connection.

    Attributes:
        name: Its name.
        row: Makes a row of its values; None before the first result.
        loaders: Functions that convert the values of each column.
    """

    name: bytes
    row: Callable[..., Any] | None = None
    loaders: tuple[Callable[[Any], Any], ...] = ()


class Pipeline:
    """A connection that runs several statements in one round trip.

    Args:
        driver: The connection, without a pipeline of its own. Statements do not begin a transaction by themselves.
    """

    def __init__(self, driver: Connection[Any]) -> None:
        self._driver = driver
        self._prepared: dict[str, _Prepared] = {}

    def run(self, texts: Sequence[str], parameters: Sequence[Sequence[Any]]) -> list[Rows]:
        """Run statements in order; return the rows of each.

        Args:
            texts: Statements with ``$1``, ``$2`` … for their parameters.
            parameters: The parameters of each: None, numbers, text, bytes, datetimes, and lists of these.

        Raises:
            psycopg.Error: A statement failed; those after it did not run. Or the connection is lost.
        """
        values = [[dump(value) for value in given] for given in parameters]
        try:
            prepared, results = self._exchange(texts, values)
        except BaseException:  # in the middle of a pipeline, nothing else can be done with the connection
            self._driver.close()
            raise
        for result in results:
            if result.status == pq.ExecStatus.FATAL_ERROR:
                self._prepared.clear()  # statements after this one were not prepared
                raise error_from_result(result)
        return [self._rows(one, result) for one, result in zip(prepared, results, strict=True)]

    def _exchange(
        self, texts: Sequence[str], values: Sequence[Sequence[bytes | None]]
    ) -> tuple[list[_Prepared], list[Any]]:
        """Send statements and wait for their results; return the statements and the results of each."""
        connection = self._driver.pgconn
        connection.enter_pipeline_mode()
        statements: list[_Prepared] = []
        own: list[bool] = []
        for text, given in zip(texts, values, strict=True):
            prepared = self._prepared.get(text)
            if prepared is None:
                prepared = self._prepared[text] = _Prepared(f"brink_{next(_NAMES)}".encode())
                connection.send_prepare(prepared.name, text.encode())
                own.append(False)
            connection.send_query_prepared(prepared.name, given)
            own.append(True)
            statements.append(prepared)
        connection.pipeline_sync()
        results = self._results()
        connection.exit_pipeline_mode()
        failed = [result for result in results if result.status == pq.ExecStatus.FATAL_ERROR]
        return statements, failed or list(itertools.compress(results, own))

    def _results(self) -> list[Any]:
        """Return all results up to the end of the pipeline.

        Raises:
            psycopg.Error: The connection is lost; if the server said why before it closed it, that is the error.
        """
        found: list[Any] = []
        try:
            self._collect(found)
        except OperationalError:
            last = next((one for one in found if one.status == pq.ExecStatus.FATAL_ERROR), None)
            if last is None:
                raise
            raise error_from_result(last) from None
        return found

    def _collect(self, found: list[Any]) -> None:
        """Append all results up to the end of the pipeline."""
        connection = self._driver.pgconn
        readable, both = select.poll(), select.poll()
        readable.register(connection.socket, select.POLLIN)
        both.register(connection.socket, select.POLLIN | select.POLLOUT)
        while connection.flush():
            for _, happened in both.poll():
                if happened & ~select.POLLOUT:
                    connection.consume_input()
        while True:
            while connection.is_busy():
                readable.poll()
                connection.consume_input()
            result = connection.get_result()
            if result is None:  # the end of one statement's results
                if connection.status != pq.ConnStatus.OK:
                    raise OperationalError("the connection is lost")
                continue
            if result.status == pq.ExecStatus.PIPELINE_SYNC:
                return
            if result.status not in _EXPECTED:
                raise InterfaceError(f"unexpected result: {pq.ExecStatus(result.status).name}")
            found.append(result)

    def _rows(self, prepared: _Prepared, result: Any) -> Rows:
        if not result.nfields:
            return []
        if prepared.row is None:
            prepared.row, prepared.loaders = self._loading(result)
        make, loaders = prepared.row, prepared.loaders
        return [
            make(
                *[
                    None if (value := result.get_value(row, column)) is None else load(value)
                    for column, load in enumerate(loaders)
                ]
            )
            for row in range(result.ntuples)
        ]

    def _loading(self, result: Any) -> tuple[Callable[..., Any], tuple[Callable[[Any], Any], ...]]:
        """Return the class of a result's rows, and the loaders of its columns."""
        columns = range(result.nfields)
        names = [result.fname(column).decode() for column in columns]
        oids = [result.ftype(column) for column in columns]
        adapters = self._driver.adapters
        loaders = [
            adapters.get_loader(oid, pq.Format.TEXT) or adapters.get_loader(0, pq.Format.TEXT) for oid in oids
        ]
        row: Any = namedtuple("Row", names)  # type: ignore[misc]
        return row, tuple(
            loader(oid, self._driver).load
            for loader, oid in zip(loaders, oids, strict=True)
            if loader is not None
        )


def dump(value: Any) -> bytes | None:
    """Return a parameter as Postgres reads it.

    Raises:
        DataError: Text with a NUL character, which Postgres cannot store.
        TypeError: There is no such parameter.
    """
    text = _text(value)
    if text is None:
        return None
    if "\0" in text:
        raise DataError("PostgreSQL text fields cannot contain NUL (0x00) bytes")
    return text.encode()


def _text(value: Any) -> str | None:
    if value is None or type(value) is str:
        return value
    if isinstance(value, bool):
        return "t" if value else "f"
    if isinstance(value, int | float | str):
        return str(value)
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, bytes):
        return "\\x" + value.hex()
    if isinstance(value, list | tuple):
        return "{" + ",".join(map(_element, value)) + "}"
    raise TypeError(
        f"expected a number, text, bytes, a datetime or a list of them, got {type(value).__name__}"
    )


def _element(value: Any) -> str:
    text = _text(value)
    if text is None:
        return "NULL"
    if type(value) is int:
        return text
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'

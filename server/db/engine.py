"""How the databases are opened: SQLite in WAL mode with real transactions, Postgres as it is.

A database has two engines. The *writer* takes the write lock at BEGIN, so that a transaction never fails halfway
because another one wrote first. The *reader* sees one snapshot for the length of a transaction.
"""

import asyncio
import re
import sqlite3
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError
from sqlalchemy.pool import ConnectionPoolEntry

from brink.server.errors import DatabaseError

T = TypeVar("T")

SQLITE_BUSY_S = 30.0
MAX_OVERFLOW = 32
"""Connections of a pool besides those that it keeps: more than there are threads that read at a time."""
WRITER_CACHE_KIB = 32 * 1024
READER_CACHE_KIB = 8 * 1024
"""Pages of the database that a connection keeps, at most. Each fills its own as the database grows; what one does not
keep the system's cache of files has."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Engines:
    """The two engines of one database."""

    writer: Engine
    reader: Engine

    @property
    def is_sqlite(self) -> bool:
        """Whether this is SQLite."""
        return self.writer.dialect.name == "sqlite"

    def dispose(self) -> None:
        """Close all pooled connections."""
        self.writer.dispose()
        self.reader.dispose()


def parse_url(database: str) -> URL:
    """Return the URL of a supported database, with its driver.

    Raises:
        DatabaseError: It is no URL, or of a database that is not supported.
    """
    expected = "expected sqlite:///FILE or postgresql://USER:PASSWORD@HOST:PORT/NAME"
    try:
        url = make_url(database)
    except (ArgumentError, ValueError):  # the latter for a port that is no number
        raise DatabaseError(f"database URL {_without_password(database)!r}: {expected}") from None
    if url.drivername == "sqlite":
        if url.database in (None, "", ":memory:"):
            raise DatabaseError(
                "database URL: an in-memory SQLite database would lose everything; name a file"
            )
        return url
    if url.drivername in ("postgresql", "postgres", "postgresql+psycopg"):
        return url.set(drivername="postgresql+psycopg")
    raise DatabaseError(f"database URL with {url.drivername!r}: {expected}")


def _without_password(database: str) -> str:
    """Return what was meant to be a URL, fit to be shown: it may hold a password anywhere before its last ``@``."""
    before, at, after = database.rpartition("@")
    shown = f"{before.partition(':')[0]}:***@{after}" if at else database
    return re.sub(r"(?<=password=)[^&]*", "***", shown)


def open_engines(database: str) -> Engines:
    """Return the engines of a database. Nothing is connected yet.

    Raises:
        DatabaseError: The URL is not of a supported database, or its driver is not installed.
    """
    url = parse_url(database)
    if url.drivername == "sqlite":
        return Engines(
            writer=_sqlite(url, "BEGIN IMMEDIATE", cache_kib=WRITER_CACHE_KIB),
            reader=_sqlite(url, "BEGIN", cache_kib=READER_CACHE_KIB),
        )
    try:
        # The writer finds rows by index; statistics of a moment ago, when all jobs were queued, say otherwise.
        # So would joins that read both tables in order, or one of them whole, and bitmaps, which gather all that an
        # index has before the first row comes.
        off = ("enable_seqscan", "enable_bitmapscan", "enable_mergejoin", "enable_hashjoin", "jit")
        by_index = {
            "options": " ".join(
                [*(f"-c {name}=off" for name in off), "-c plan_cache_mode=force_generic_plan"]
            )
        }
        writer = create_engine(
            url, pool_pre_ping=True, pool_size=4, connect_args=by_index, hide_parameters=True
        )
        reader = create_engine(
            url, pool_pre_ping=True, pool_size=8, max_overflow=MAX_OVERFLOW, isolation_level="REPEATABLE READ",
            hide_parameters=True,
        )  # fmt: skip
    except ModuleNotFoundError:
        raise DatabaseError("Postgres needs its driver: pip install 'brink[postgres]'") from None
    return Engines(writer=writer, reader=reader)


def _sqlite(url: URL, begin: str, *, cache_kib: int) -> Engine:
    engine = create_engine(
        url, connect_args={"timeout": SQLITE_BUSY_S, "check_same_thread": False}, max_overflow=MAX_OVERFLOW,
        hide_parameters=True, pool_use_lifo=True,
    )  # fmt: skip

    @event.listens_for(engine, "connect")
    def configure(connection: sqlite3.Connection, _: ConnectionPoolEntry) -> None:
        connection.isolation_level = None  # the driver's own BEGIN is neither immediate nor covers DDL
        _enter_wal(connection)
        for pragma in ("synchronous=FULL", "foreign_keys=ON", f"cache_size=-{cache_kib}"):
            connection.execute(f"PRAGMA {pragma}").close()

    @event.listens_for(engine, "begin")
    def start(connection: Any) -> None:
        connection.exec_driver_sql(begin)

    return engine


def _enter_wal(connection: sqlite3.Connection) -> None:
    """Switch a database to write-ahead logging, which lasts.

    The switch takes the whole file for a moment and does not wait for others by itself.
    """
    deadline = time.monotonic() + SQLITE_BUSY_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL").close()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.02)
        else:
            return


async def read(engines: Engines, query: Callable[[Connection], T]) -> T:
    """Run a query on one snapshot of the database, in a thread, and return its result."""

    def run() -> T:
        with engines.reader.connect() as connection:
            return query(connection)

    return await asyncio.get_running_loop().run_in_executor(None, run)

"""Opens databases: SQLite in WAL mode with real transactions, and Postgres.

Each database has two engines. The *writer* takes the write lock at BEGIN, so that no transaction fails halfway
because another one wrote first. The *reader* sees one snapshot for the duration of a transaction.
"""

import asyncio
import re
import sqlite3
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError
from sqlalchemy.pool import ConnectionPoolEntry

from brink.extras import install_command
from brink.server.db.statements import share_round_trips
from brink.server.errors import DatabaseError

T = TypeVar("T")

LOCK_S = 5
"""How long a write on Postgres waits for a row that another coordinator has locked."""
IDLE_S = 15
"""After this long without a statement, Postgres ends a write transaction: its coordinator, which never pauses in
between, is suspended or gone, and others may wait for its locks."""
CONNECT_S = 10
_SILENCE = {"idle": 10, "interval": 5, "count": 3}
"""When a connection is tested that carries no data, in seconds, and how many tests may fail."""
_UNACKNOWLEDGED_MS = 20_000
"""After this long without acknowledgement of what was sent, a connection is lost, in milliseconds."""
SQLITE_BUSY_S = 30.0
MAX_OVERFLOW = 32
"""Maximum number of temporary connections beyond a pool's permanent ones; more than there are reading threads."""
WRITER_CACHE_KIB = 32 * 1024
READER_CACHE_KIB = 8 * 1024
"""Page cache of one SQLite connection. Pages that do not fit are in the operating system's file cache."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Engines:
    """The writer and the reader engine of one database."""

    writer: Engine
    reader: Engine

    @property
    def is_sqlite(self) -> bool:
        """Whether the database is SQLite."""
        return self.writer.dialect.name == "sqlite"

    def dispose(self) -> None:
        """Close all pooled connections, and those that are still in use when they are returned."""
        for engine in (self.writer, self.reader):
            event.listen(engine.pool, "checkin", _close)
            engine.dispose()


def _close(_: object, entry: ConnectionPoolEntry) -> None:
    entry.close()


def parse_url(database: str) -> URL:
    """Return the URL of a supported database, including its driver.

    Raises:
        DatabaseError: The text is not a URL, or the database is not supported.
    """
    expected = "expected sqlite:///FILE or postgresql://USER:PASSWORD@HOST:PORT/NAME"
    try:
        url = make_url(database)
    except (ArgumentError, ValueError):  # ValueError: the port is not a number
        raise DatabaseError(f"database URL {_without_password(database)!r}: {expected}") from None
    if url.drivername == "sqlite":
        if url.database in (None, "", ":memory:"):
            raise DatabaseError(
                "database URL: an in-memory SQLite database would lose all data when it is closed; name a file"
            )
        return url
    if url.drivername in ("postgresql", "postgres", "postgresql+psycopg"):
        return url.set(drivername="postgresql+psycopg")
    raise DatabaseError(f"database URL with {url.drivername!r}: {expected}")


def _without_password(database: str) -> str:
    """Return a malformed URL without its password, which may be anywhere before the last ``@``."""
    before, at, after = database.rpartition("@")
    shown = f"{before.partition(':')[0]}:***@{after}" if at else database
    return re.sub(r"(?<=password=)[^&]*", "***", shown)


def open_engines(database: str) -> Engines:
    """Return the engines of a database, without connecting to it.

    Raises:
        DatabaseError: The database is not supported, or its driver is not installed.
    """
    url = parse_url(database)
    if url.drivername == "sqlite":
        return Engines(
            writer=_sqlite(url, "BEGIN IMMEDIATE", cache_kib=WRITER_CACHE_KIB),
            reader=_sqlite(url, "BEGIN", cache_kib=READER_CACHE_KIB),
        )
    # The writer must find rows by index. The job table changes so fast that its statistics mislead the planner:
    # left alone it chooses sequential scans, merge and hash joins, or bitmap scans that read a whole index first.
    off = ("enable_seqscan", "enable_bitmapscan", "enable_mergejoin", "enable_hashjoin", "jit")
    for_writing = {
        **dict.fromkeys(off, "off"),
        "plan_cache_mode": "force_generic_plan",
        "lock_timeout": f"{LOCK_S}s",
        "idle_in_transaction_session_timeout": f"{IDLE_S}s",
    }
    try:
        writer = create_engine(
            url,
            pool_pre_ping=True,
            pool_size=4,
            connect_args=postgres_options(url, for_writing),
            hide_parameters=True,
        )
        share_round_trips(writer)
        reader = create_engine(
            url,
            pool_pre_ping=True,
            pool_size=8,
            max_overflow=MAX_OVERFLOW,
            isolation_level="REPEATABLE READ",
            connect_args=postgres_options(url),
            hide_parameters=True,
        )
    except ModuleNotFoundError:
        raise DatabaseError(f"Postgres needs its driver: {install_command('postgres')}") from None
    return Engines(writer=writer, reader=reader)


def postgres_options(url: URL, settings: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return Postgres connection options that let both ends detect when the other machine is gone.

    Without them, a connection over which nothing is sent outlives the other end for hours, and so do its locks.
    Options in the URL have precedence.

    Args:
        url: The database.
        settings: Settings of the server for this connection.
    """
    ours = {
        "connect_timeout": CONNECT_S,
        "tcp_user_timeout": _UNACKNOWLEDGED_MS,
        **{f"keepalives_{name}": value for name, value in _SILENCE.items()},
    }
    on_the_server = {
        "tcp_user_timeout": str(_UNACKNOWLEDGED_MS),
        **{f"tcp_keepalives_{name}": str(value) for name, value in _SILENCE.items()},
        **(settings or {}),
    }
    given = url.normalized_query
    words = [f"-c {name}={value}" for name, value in on_the_server.items()]
    return {
        **{name: value for name, value in ours.items() if name not in given},
        "options": " ".join([*words, *given.get("options", ())]),
    }


def _sqlite(url: URL, begin: str, *, cache_kib: int) -> Engine:
    engine = create_engine(
        url,
        connect_args={"timeout": SQLITE_BUSY_S, "check_same_thread": False},
        max_overflow=MAX_OVERFLOW,
        hide_parameters=True,
        pool_use_lifo=True,
    )

    @event.listens_for(engine, "connect")
    def configure(connection: sqlite3.Connection, _: ConnectionPoolEntry) -> None:
        connection.isolation_level = None  # the driver's implicit BEGIN is not immediate and skips DDL
        _enter_wal(connection)
        for pragma in ("synchronous=FULL", "foreign_keys=ON", f"cache_size=-{cache_kib}"):
            connection.execute(f"PRAGMA {pragma}").close()

    @event.listens_for(engine, "begin")
    def start(connection: Any) -> None:
        connection.exec_driver_sql(begin)

    return engine


def _enter_wal(connection: sqlite3.Connection) -> None:
    """Switch a database file to write-ahead logging, permanently.

    The switch needs an exclusive lock on the file and ignores the busy timeout, hence the loop.
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

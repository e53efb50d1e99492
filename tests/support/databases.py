"""Databases for tests: each test gets one of its own, migrated, on SQLite or on a real Postgres.

``TEST_DATABASE_URL`` names a running Postgres server on which the user may create databases. Without it, one is
started once a run, as `benchmarks.servers` finds it.
"""

import os
import shutil
import sqlite3
import uuid
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import psycopg
import pytest
from sqlalchemy import create_engine, inspect
from sqlalchemy.engine import make_url
from sqlalchemy.util import LRUCache

from benchmarks.servers import temporary_postgres
from brink.server.db.engine import open_engines
from brink.server.db.upgrade import upgrade

URL_VARIABLE = "TEST_DATABASE_URL"
BACKENDS = ("sqlite", "postgres")
OTHER = pytest.mark.long("the other database")
_SQLITE_THEN_POSTGRES = ("sqlite", pytest.param("postgres", marks=OTHER))

on_sqlite = pytest.mark.parametrize("databases", BACKENDS[:1], indirect=True)
"""For tests in tests/integration/database, which run on both unless they say otherwise."""
on_postgres = pytest.mark.parametrize("databases", BACKENDS[1:], indirect=True)
sqlite_then_postgres = pytest.mark.parametrize("databases", _SQLITE_THEN_POSTGRES, indirect=True)
module_sqlite_then_postgres = pytest.mark.parametrize(
    "module_databases", _SQLITE_THEN_POSTGRES, indirect=True
)
"""For the tests that together run every statement on Postgres, too, in `make test-all`."""


def few_on_postgres(
    name: str, values: Iterable[Any], few: Collection[Any], reason: str, *, later: bool = False
) -> pytest.MarkDecorator:
    """Parametrise a test of what each value stores in the same way: all run on SQLite, few on Postgres.

    Args:
        name: The argument that gets a value.
        values: Its values.
        few: Those that run on Postgres, and that `make test` covers; all others are marked ``long``.
        reason: Why the others are left to `make test-all`.
        later: Whether all that runs on Postgres is left to `make test-all`.
    """
    long = pytest.mark.long(reason)
    rows = [pytest.param("sqlite", value, marks=() if value in few else long) for value in values]
    rows += [pytest.param("postgres", value, marks=OTHER if later else ()) for value in few]
    return pytest.mark.parametrize(("databases", name), rows, indirect=["databases"])


FAST = {
    "fsync": "off",
    "synchronous_commit": "off",
    "full_page_writes": "off",
    "autovacuum": "off",
    "wal_level": "minimal",
    "max_wal_senders": "0",
    "shared_buffers": "32MB",
}
"""Postgres settings: nothing in a test's database has to survive a power cut."""


class _Statements(LRUCache[Any, Any]):
    """Compiled statements, kept for all engines of a kind of database rather than for each engine."""

    def get(self, key: Any, default: Any = None) -> Any:
        """Return what was compiled for a dialect and a statement."""
        return super().get(self._for_all(key), default)

    def __setitem__(self, key: Any, value: Any) -> None:
        super().__setitem__(self._for_all(key), value)

    def _for_all(self, key: Any) -> Any:
        dialect, *statement = key
        return (type(dialect), *statement)


def share_statements() -> None:
    """Have the databases of this process share compiled statements, which takes most of a small campaign's time."""
    cached = {"compiled_cache": _Statements(4000)}
    shared = partial(create_engine, execution_options=cached)
    pytest.MonkeyPatch().setattr("brink.server.db.engine.create_engine", shared)


@contextmanager
def running_postgres() -> Iterator[str]:
    """Run a Postgres server until the end of the block, unless the environment names one.

    Yields:
        The URL of its maintenance database.

    Raises:
        NoPostgres: There is no Postgres on this machine.
    """
    given = os.environ.get(URL_VARIABLE)
    if given:
        yield given
        return
    with temporary_postgres(FAST) as server:
        yield server.url


class PostgresDatabases:
    """Makes databases on a server, each a copy of one that was migrated once.

    A copy takes a few hundred milliseconds, emptying a database a few. So a database that is returned is emptied,
    whoever is still connected is disconnected, and it is handed out again.
    """

    def __init__(self, url: str) -> None:
        self._url = make_url(url).set(drivername="postgresql")
        self._template = f"brink_template_{uuid.uuid4().hex}"
        self._free: list[str] = []
        self._made = [self._template]
        self._execute(f"CREATE DATABASE {self._template}")
        engines = open_engines(self._named(self._template))
        try:
            upgrade(engines)
            inspector = inspect(engines.reader)
            tables = [name for name in inspector.get_table_names() if name != "alembic_version"]
            restarts = [f"ALTER SEQUENCE {name} RESTART" for name in inspector.get_sequence_names()]
        finally:
            engines.dispose()
        # Deleting campaigns also empties the tables that refer to them, so the order of the others does not matter.
        deletes = [f"DELETE FROM {name}" for name in sorted(tables, key=lambda name: name != "campaigns")]
        self._empty = "; ".join(deletes + restarts)

    def close(self) -> None:
        """Drop all databases."""
        for name in self._made:
            self._execute(f"DROP DATABASE {name} WITH (FORCE)")

    @contextmanager
    def database(self, *, migrated: bool = True) -> Iterator[str]:
        """Hand out a database until the end of the block.

        Args:
            migrated: Whether it has this version's schema, which must then stay as it is; else it is empty.

        Yields:
            Its URL.
        """
        if not migrated:
            yield self._named(self._new("template0"))
            return
        name = self._free.pop() if self._free else self._new(self._template)
        yield self._named(name)
        self._execute(
            f"SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity WHERE datname = '{name}'"
        )
        self._execute(self._empty, database=name)
        self._free.append(name)

    def _new(self, template: str) -> str:
        name = f"brink_test_{uuid.uuid4().hex}"
        self._execute(f"CREATE DATABASE {name} TEMPLATE {template}")
        self._made.append(name)
        return name

    def _named(self, name: str) -> str:
        return self._url.set(database=name).render_as_string(hide_password=False)

    def _execute(self, statements: str, database: str | None = None) -> None:
        url = self._named(database) if database else self._url.render_as_string(hide_password=False)
        with psycopg.connect(url, autocommit=True) as connection:
            connection.execute(statements.encode())


@dataclass(frozen=True, slots=True, kw_only=True)
class Databases:
    """Hands out databases of one backend.

    Attributes:
        backend: ``sqlite`` or ``postgres``.
        template: A migrated SQLite file, copied for each database.
        folder: Folder of the SQLite files.
        postgres: Databases of the Postgres server; None on SQLite.
    """

    backend: str
    template: Path
    folder: Path
    postgres: PostgresDatabases | None

    @contextmanager
    def database(self, name: str = "brink", *, migrated: bool = True) -> Iterator[str]:
        """Hand out a database until the end of the block.

        Args:
            name: Tells the databases of one test apart.
            migrated: Whether it has this version's schema; else it is empty.

        Yields:
            Its URL.
        """
        if self.postgres is not None:
            with self.postgres.database(migrated=migrated) as url:
                yield url
            return
        file = self.folder / f"{name}.db"
        if migrated:
            shutil.copyfile(self.template, file)
        yield f"sqlite:///{file}"


def databases_for(request: pytest.FixtureRequest, folder: Path) -> Databases:
    """Return databases of the backend that a fixture is parametrised with, with SQLite's files in a folder."""
    backend: str = request.param
    postgres = request.getfixturevalue("postgres_databases") if backend == "postgres" else None
    template = request.getfixturevalue("sqlite_file")
    return Databases(backend=backend, template=template, folder=folder, postgres=postgres)


def sqlite_template(folder: Path) -> Path:
    """Return a migrated SQLite database in a single file."""
    file = folder / "template.db"
    engines = open_engines(f"sqlite:///{file}")
    try:
        upgrade(engines)
    finally:
        engines.dispose()
    connection = sqlite3.connect(file)
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").close()
    connection.close()
    return file

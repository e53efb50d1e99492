"""Databases of a real Postgres for tests, made from one that was migrated once.

``TEST_DATABASE_URL`` names a running server, on which the user may create databases; without it one is started as
`brink.bench.temporary.postgres` finds it.
"""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager

import psycopg
from sqlalchemy import inspect
from sqlalchemy.engine import make_url

from brink.bench.temporary.postgres import temporary_postgres
from brink.server.db.engine import open_engines
from brink.server.db.upgrade import upgrade

URL_VARIABLE = "TEST_DATABASE_URL"
FAST = {
    "fsync": "off",
    "synchronous_commit": "off",
    "full_page_writes": "off",
    "autovacuum": "off",
    "wal_level": "minimal",
    "max_wal_senders": "0",
    "shared_buffers": "32MB",
}
"""Nothing in a test's database has to survive a power cut."""


@contextmanager
def running_postgres() -> Iterator[str]:
    """Give the URL of the maintenance database of a server that runs until the end of the block.

    Raises:
        NoPostgres: None can be had.
    """
    given = os.environ.get(URL_VARIABLE)
    if given:
        yield given
        return
    with temporary_postgres(FAST) as server:
        yield server.url


class PostgresDatabases:
    """Makes databases on a server, each a copy of one that was migrated once.

    A copy takes a few hundred milliseconds, emptying one a few: a database that is given back is emptied, cut off
    from whoever is still connected, and given out again.
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
        # Deleting from campaigns empties what hangs on it, in whatever order the tables come.
        deletes = [f"DELETE FROM {name}" for name in sorted(tables, key=lambda name: name != "campaigns")]
        self._empty = "; ".join(deletes + restarts)

    def close(self) -> None:
        """Drop everything that was made."""
        for name in self._made:
            self._execute(f"DROP DATABASE {name} WITH (FORCE)")

    @contextmanager
    def database(self, *, migrated: bool = True) -> Iterator[str]:
        """Give the URL of a database of one's own; with `migrated`, of this version's schema, which must stay."""
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

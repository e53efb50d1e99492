"""Databases for tests: each test gets one of its own, migrated, on SQLite or on Postgres."""

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from brink.server.db.engine import open_engines
from brink.server.db.upgrade import upgrade
from support.postgres import PostgresDatabases

BACKENDS = ("sqlite", "postgres")


@dataclass(frozen=True, slots=True, kw_only=True)
class Databases:
    """Gives out databases of one kind.

    Attributes:
        backend: ``sqlite`` or ``postgres``.
        template: A migrated SQLite file, copied for each test.
        folder: Where SQLite files go.
        postgres: The server's databases, if that is the kind.
    """

    backend: str
    template: Path
    folder: Path
    postgres: PostgresDatabases | None

    @contextmanager
    def database(self, name: str = "brink", *, migrated: bool = True) -> Iterator[str]:
        """Give the URL of a database of one's own; an empty one without `migrated`."""
        if self.postgres is not None:
            with self.postgres.database(migrated=migrated) as url:
                yield url
            return
        file = self.folder / f"{name}.db"
        if migrated:
            shutil.copyfile(self.template, file)
        yield f"sqlite:///{file}"


def sqlite_template(folder: Path) -> Path:
    """Return a migrated SQLite file, all of it in one file."""
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

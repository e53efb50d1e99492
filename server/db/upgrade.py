"""Upgrades a database to this version's schema, safely when several processes try at once."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, text
from sqlalchemy.exc import DBAPIError

from brink.server.db.engine import Engines
from brink.server.db.sql import allow_pauses
from brink.server.errors import DatabaseError

UPGRADE_LOCK = 0x6272696E6B  # "brink": key of the advisory lock on Postgres


def alembic_config() -> Config:
    """Return the Alembic configuration for this version's migrations."""
    config = Config()
    config.set_main_option("script_location", str(files("brink.migrations")))
    return config


def head_revision() -> str:
    """Return the newest schema revision that this version knows.

    Raises:
        DatabaseError: The installation contains no migrations.
    """
    head = ScriptDirectory.from_config(alembic_config()).get_current_head()
    if head is None:
        raise DatabaseError("this installation has no migrations; install it again")
    return head


def current_revision(engines: Engines) -> str | None:
    """Return a database's schema revision, or None if the database is empty.

    Raises:
        DatabaseError: The database cannot be reached or read.
    """
    with _readable(engines), engines.reader.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision()


def check_known(revision: str | None) -> None:
    """Check that this version knows a schema revision.

    Raises:
        DatabaseError: The schema is newer than this version, or belongs to another program.
    """
    known = {script.revision for script in ScriptDirectory.from_config(alembic_config()).walk_revisions()}
    if revision is not None and revision not in known:
        raise DatabaseError(
            f"database schema {revision!r} is not known to this version of Brink, whose newest schema is "
            f"{head_revision()!r}; update Brink, or use another database"
        )


def upgrade(engines: Engines) -> tuple[str | None, str]:
    """Upgrade the schema to the newest revision, in one transaction and under a lock.

    Returns:
        The revisions before and after the upgrade.

    Raises:
        DatabaseError: The database cannot be reached, or its schema is newer than this version knows.
    """
    with _readable(engines), engines.writer.begin() as connection:
        allow_pauses(connection)
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": UPGRADE_LOCK})
        before = MigrationContext.configure(connection).get_current_revision()
        check_known(before)
        head = head_revision()
        if before != head:
            _run(connection)
    if before != head:
        # Migrations drop tables, and with them psycopg drops all prepared statements of its connection.
        engines.writer.dispose()
    return before, head


def _run(connection: Connection) -> None:
    config = alembic_config()
    config.attributes["connection"] = connection
    command.upgrade(config, "head")


@contextmanager
def _readable(engines: Engines) -> Iterator[None]:
    try:
        yield
    except DBAPIError as error:
        where = engines.writer.url.render_as_string(hide_password=True)
        reason = str(error.orig).strip().splitlines()[0]
        raise DatabaseError(f"database {where}: {reason}") from error

"""Bringing a database to this version's schema, once, whoever comes first."""

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
from brink.server.errors import DatabaseError

UPGRADE_LOCK = 0x6272696E6B  # "brink", the key of the advisory lock on Postgres


def alembic_config() -> Config:
    """Return the configuration of the migrations that belong to this version."""
    config = Config()
    config.set_main_option("script_location", str(files("brink.migrations")))
    return config


def head_revision() -> str:
    """Return the newest schema that this version knows."""
    head = ScriptDirectory.from_config(alembic_config()).get_current_head()
    if head is None:
        raise DatabaseError("this installation has no migrations; install it again")
    return head


def current_revision(engines: Engines) -> str | None:
    """Return the schema that a database has, or None if it has none.

    Raises:
        DatabaseError: The database cannot be reached or read.
    """
    with _readable(engines), engines.reader.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision()


def check_known(revision: str | None) -> None:
    """Raise unless this version knows that schema.

    Raises:
        DatabaseError: The schema is newer, or of something else.
    """
    known = {script.revision for script in ScriptDirectory.from_config(alembic_config()).walk_revisions()}
    if revision is not None and revision not in known:
        raise DatabaseError(
            f"database schema {revision!r} is newer than this version of Brink knows (newest: "
            f"{head_revision()!r}); update Brink, or use another database"
        )


def upgrade(engines: Engines) -> tuple[str | None, str]:
    """Bring the schema to the head, in one transaction, under a lock against racing processes.

    Returns:
        The revisions before and after.

    Raises:
        DatabaseError: The database cannot be reached, or its schema is newer than this version knows.
    """
    with _readable(engines), engines.writer.begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": UPGRADE_LOCK})
        before = MigrationContext.configure(connection).get_current_revision()
        check_known(before)
        head = head_revision()
        if before != head:
            _run(connection)
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

"""Preparation of the database before a coordinator serves: existence, schema version, leases of dead workers."""

from sqlalchemy import inspect

from brink.server.access.tokens import any_token
from brink.server.db.engine import open_engines, parse_url
from brink.server.db.models import TokenRow
from brink.server.db.upgrade import check_known, current_revision, head_revision, upgrade
from brink.server.errors import DatabaseError
from brink.server.queue.lease_store import release
from brink.server.queue.workers import leases_of_dead
from brink.server.settings import Settings


def prepare_database(settings: Settings) -> tuple[str | None, str]:
    """Upgrade the database to this version's schema; return the revisions before and after.

    Raises:
        DatabaseError: The database cannot be reached, or its schema is newer than this version.
    """
    engines = open_engines(settings.database)
    try:
        return upgrade(engines)
    finally:
        engines.dispose()


def check_exists(settings: Settings) -> None:
    """Check that the database file exists, if it is a file; opening it would create it.

    Raises:
        DatabaseError: The file does not exist.
    """
    path = settings.sqlite_file
    if path is not None and not path.exists():
        raise DatabaseError(
            f"no database at {path.absolute()}: run a campaign first (brink run FILE), choose another database with "
            "--database, or a coordinator with --server"
        )


def check_database(settings: Settings) -> None:
    """Check that the database exists and has this version's schema.

    Raises:
        DatabaseError: It does not exist, or it needs an upgrade.
    """
    check_exists(settings)
    engines = open_engines(settings.database)
    try:
        revision = current_revision(engines)
    finally:
        engines.dispose()
    check_known(revision)
    if revision != head_revision():
        raise DatabaseError(
            f"the database has schema {revision or 'none'}, this version needs {head_revision()}; "
            "upgrade it with: brink db upgrade"
        )


def release_leases_of_dead_workers(settings: Settings) -> int:
    """Requeue jobs leased by dead workers of this machine, without charging an attempt; return their number.

    Meant for a restart after everything crashed, which was not the fault of the jobs. Only for SQLite, where
    coordinator and database share a machine. If a live worker is mistaken for dead, its results are `stale`, and the
    jobs run again.
    """
    if settings.sqlite_file is None:
        return 0
    engines = open_engines(settings.database)
    try:
        with engines.writer.begin() as connection:
            leases = leases_of_dead(connection)
            return release(connection, leases)
    finally:
        engines.dispose()


def has_tokens(settings: Settings, *, valid_only: bool = True) -> bool:
    """Return whether the database has valid tokens or, if ``valid_only`` is false, any tokens."""
    file = settings.sqlite_file
    if file is not None and not file.exists():
        return False
    engines = open_engines(settings.database)
    try:
        with engines.reader.connect() as connection:
            # An older schema has no such table.
            return inspect(connection).has_table(TokenRow.__tablename__) and any_token(
                connection, valid_only=valid_only
            )
    finally:
        engines.dispose()


def shown_url(settings: Settings) -> str:
    """Return the URL of the database without its password."""
    return parse_url(settings.database).render_as_string(hide_password=True)

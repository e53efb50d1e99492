"""The database of a coordinator before it serves: there, of this version's schema, without leases of dead workers."""

from sqlalchemy import inspect

from brink.server.access.store import any_token
from brink.server.db.engine import open_engines, parse_url
from brink.server.db.models import TokenRow
from brink.server.db.upgrade import check_known, current_revision, head_revision, upgrade
from brink.server.errors import DatabaseError
from brink.server.queue.lease_store import release
from brink.server.queue.workers import leases_of_dead
from brink.server.settings import Settings


def prepare_database(settings: Settings) -> tuple[str | None, str]:
    """Bring the database to this version's schema; return the revisions before and after.

    Raises:
        DatabaseError: It cannot be reached, or its schema is newer than this version knows.
    """
    engines = open_engines(settings.database)
    try:
        return upgrade(engines)
    finally:
        engines.dispose()


def check_there(settings: Settings) -> None:
    """Raise unless the database is there, where it is a file; looking at one makes it.

    Raises:
        DatabaseError: It is not, with what to do.
    """
    path = settings.sqlite_file
    if path is not None and not path.exists():
        raise DatabaseError(
            f"no database at {path}: run a campaign first (brink run FILE), name another one with --database, "
            "or name a coordinator with --server"
        )


def check_database(settings: Settings) -> None:
    """Raise unless the database is there and has this version's schema.

    Raises:
        DatabaseError: It is not, with what to do.
    """
    check_there(settings)
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


def release_leases_of_the_dead(settings: Settings) -> int:
    """Put back what workers of this machine held that are no more, uncharged; return how many jobs.

    For the start after a crash of everything, which is no fault of the jobs. Only for SQLite, where the coordinator
    and its database share a machine; should a worker be mistaken for dead, its results are `stale` and run again.
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


def has_tokens(settings: Settings, *, that_hold: bool = True) -> bool:
    """Return whether tokens are stored: such that hold, or any, so that nobody is served without one."""
    file = settings.sqlite_file
    if file is not None and not file.exists():
        return False
    engines = open_engines(settings.database)
    try:
        with engines.reader.connect() as connection:
            # An older schema knows no tokens.
            return inspect(connection).has_table(TokenRow.__tablename__) and any_token(
                connection, that_holds=that_hold
            )
    finally:
        engines.dispose()


def shown_url(settings: Settings) -> str:
    """Return the URL of the database without its password."""
    return parse_url(settings.database).render_as_string(hide_password=True)

"""Announces new jobs and due steps to waiting requests and to other coordinators on the same Postgres."""

import asyncio
import logging
from collections.abc import Callable

from sqlalchemy import Connection, text
from sqlalchemy.engine import URL

from brink.server.db.engine import postgres_options

CHANNEL = "brink_jobs"
DUE_CHANNEL = "brink_due"
LISTENING = (0x6272696E, 0x6B)
"""Key of the advisory lock that each coordinator shares while it listens: the locks are as many as coordinators."""
RECONNECT_S = 1.0

log = logging.getLogger(__name__)


class Wakeups:
    """A first-come, first-served queue of waiting requests.

    All methods are called on the event loop. A waiter whose client left after it was woken passes its wake-up on, so
    that no wake-up is lost.
    """

    def __init__(self) -> None:
        self._line: dict[asyncio.Future[None], None] = {}
        self.changes = 0
        """Change counter: read it before looking for jobs, and pass it to `wait` to miss no change in between."""

    def __len__(self) -> int:
        return len(self._line)

    def wake(self, count: int | None = None) -> None:
        """Wake the first `count` waiters, or all of them."""
        self.changes += count != 0
        for waiter in list(self._line)[:count]:
            del self._line[waiter]
            waiter.set_result(None)

    async def wait(self, timeout_s: float, gone: asyncio.Event, *, since: int | None = None) -> bool:
        """Wait in line for a wake-up.

        Args:
            timeout_s: How long to wait.
            gone: Set when the client has disconnected.
            since: The change counter that the caller has seen; returns at once if it has increased.

        Returns:
            True after a wake-up whose client is still connected.
        """
        if since is not None and since != self.changes:
            return not gone.is_set()
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._line[waiter] = None
        left: asyncio.Future[bool] = asyncio.ensure_future(gone.wait())
        used = False
        try:
            await asyncio.wait((waiter, left), timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
            used = waiter.done() and not gone.is_set()
        finally:
            left.cancel()
            self._line.pop(waiter, None)
            if waiter.done() and not used:
                self.wake(1)
        return used


def notify_coordinators(connection: Connection) -> None:
    """Notify all coordinators on the same Postgres of new jobs when the transaction commits.

    Call it at most once in a transaction: each call takes a lock that all commits share. SQLite has one coordinator.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(text(f"SELECT pg_notify('{CHANNEL}', '')"))


def notify_due(connection: Connection, campaign_id: str) -> None:
    """Notify all coordinators on the same Postgres, when the transaction commits, that a campaign's step is due."""
    if connection.dialect.name == "postgresql":
        connection.execute(text(f"SELECT pg_notify('{DUE_CHANNEL}', :campaign)"), {"campaign": campaign_id})


def count_listening(connection: Connection) -> int:
    """Return how many coordinators listen on the same Postgres."""
    locks = text(
        "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND granted AND objsubid = 2 "
        "AND database = (SELECT oid FROM pg_database WHERE datname = current_database()) "
        "AND classid = :first AND objid = :second"
    )
    first, second = LISTENING
    return int(connection.execute(locks, {"first": first, "second": second}).scalar_one())


async def listen(url: URL, on_jobs: Callable[[], None], on_due: Callable[[str], None]) -> None:
    """Listen on a separate connection for notifications of new jobs and due steps, until cancelled.

    Args:
        url: URL of a Postgres database.
        on_jobs: Called when jobs were enqueued, and after a reconnect, since notifications may have been missed.
        on_due: Called with a campaign whose step another coordinator found due.
    """
    import psycopg  # an optional dependency

    conninfo = url.set(drivername="postgresql").render_as_string(hide_password=False)
    options = postgres_options(url)
    while True:
        try:
            async with await psycopg.AsyncConnection.connect(
                conninfo, autocommit=True, **options
            ) as connection:
                await connection.execute("SELECT pg_advisory_lock_shared(%s, %s)", LISTENING)
                await connection.execute(f"LISTEN {CHANNEL}".encode())
                await connection.execute(f"LISTEN {DUE_CHANNEL}".encode())
                on_jobs()
                async for notification in connection.notifies():
                    if notification.channel == DUE_CHANNEL:
                        on_due(notification.payload)
                    else:
                        on_jobs()
        except psycopg.Error as error:
            log.info("notifications: %s; reconnecting", " ".join(str(error).split()))
        await asyncio.sleep(RECONNECT_S)

"""News between coordinators that share a Postgres: there are new jobs.

`announce` is part of the transaction that enqueues them, so that news never comes before what it tells, and at most
once a commit: each takes a lock that all commits share. On SQLite there is nobody to tell.
"""

import asyncio
import logging
from collections.abc import Callable

from sqlalchemy import Connection, text
from sqlalchemy.engine import URL

CHANNEL = "brink_jobs"
RETRY_S = 1.0

log = logging.getLogger(__name__)


def announce(connection: Connection) -> None:
    """Tell all coordinators of new jobs, once the transaction is committed."""
    if connection.dialect.name == "postgresql":
        connection.execute(text(f"SELECT pg_notify('{CHANNEL}', '')"))


async def listen(url: URL, heard: Callable[[], None]) -> None:
    """Call `heard` for each piece of news, on a connection of its own, until this is cancelled.

    Args:
        url: Of a Postgres.
        heard: Also called when the connection was lost and is back: something may have been missed.
    """
    import psycopg  # with Postgres alone

    conninfo = url.set(drivername="postgresql").render_as_string(hide_password=False)
    while True:
        try:
            async with await psycopg.AsyncConnection.connect(conninfo, autocommit=True) as connection:
                await connection.execute(f"LISTEN {CHANNEL}".encode())
                heard()
                async for _ in connection.notifies():
                    heard()
        except psycopg.Error as error:
            log.info("news of other coordinators: %s; trying again", " ".join(str(error).split()))
        await asyncio.sleep(RETRY_S)

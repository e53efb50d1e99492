"""How rows that people name and leaf through are found: campaigns, experiments."""

from datetime import datetime
from typing import Any

from sqlalchemy import Connection, FromClause, Row, Select, select

from brink.server.errors import NotFound

MAX_ID = 16


def named_row(connection: Connection, table: FromClause, name: str, kind: str) -> Row[*tuple[Any, ...]]:
    """Return a row by its id, or by the beginning of its id if that is unique.

    Args:
        connection: To read from.
        table: With a column ``id``.
        name: The id, or its beginning.
        kind: What a row is, for the error.

    Raises:
        NotFound: There is none, or more than one.
    """
    plausible = name.isalnum() and name.isascii() and len(name) <= MAX_ID
    rows = connection.execute(select(table).where(table.c.id == name)).all() if plausible else []
    if not rows and plausible and len(name) >= 2:
        begins = select(table).where(table.c.id.startswith(name, autoescape=True))
        rows = connection.execute(begins.limit(2)).all()
    if len(rows) == 1:
        return rows[0]
    reason = f"more than one {kind} has an id that begins so" if rows else f"no such {kind}"
    raise NotFound(f"{kind} {name[:40]!r}: {reason}")


def newest_first(
    table: FromClause, *, limit: int, before: tuple[datetime, str] | None
) -> Select[*tuple[Any, ...]]:
    """Return the query of a page of rows by when they were made.

    Args:
        table: With columns ``id`` and ``created_at``.
        limit: Rows of a page.
        before: When the last row of the page before was made, and its id.
    """
    query = select(table).order_by(table.c.created_at.desc(), table.c.id.desc()).limit(limit)
    if before is None:
        return query
    moment, name = before
    made = table.c.created_at
    return query.where((made < moment) | ((made == moment) & (table.c.id < name)))

"""Row locks, where the database has them."""

from functools import lru_cache
from typing import Any

from sqlalchemy import Connection, Select


def locked(
    query: Select[*tuple[Any, ...]], connection: Connection, of: Any, *, skip_locked: bool = False
) -> Select[*tuple[Any, ...]]:
    """Lock the selected rows of a table until the transaction ends.

    SQLite has no row locks and needs none: its one writer holds the only write lock from BEGIN on.
    """
    if connection.dialect.name == "sqlite":
        return query
    return _for_update(query, of, skip_locked)


@lru_cache(maxsize=64)  # a statement made anew is compiled anew
def _for_update(query: Select[*tuple[Any, ...]], of: Any, skip_locked: bool) -> Select[*tuple[Any, ...]]:
    return query.with_for_update(of=of, skip_locked=skip_locked)

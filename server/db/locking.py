"""Row locks, where the database has them, and the change counter of a campaign's row."""

from functools import lru_cache
from typing import Any

from sqlalchemy import Connection, Select, select, update

from brink.server.db.models import NEXT_SEQUENCE, CampaignRow


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


def lock_campaign(connection: Connection, campaign_id: str) -> bool:
    """Lock a campaign's row until the transaction ends; return whether there is such a campaign."""
    query = locked(select(CampaignRow.id).where(CampaignRow.id == campaign_id), connection, CampaignRow)
    return connection.execute(query).one_or_none() is not None


def note_change(connection: Connection, campaign_id: str) -> None:
    """Increase a campaign's change counter, so that pages and clients see that something changed."""
    connection.execute(
        update(CampaignRow).where(CampaignRow.id == campaign_id).values(sequence=NEXT_SEQUENCE)
    )

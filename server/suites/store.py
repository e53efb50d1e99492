"""Queries of the campaigns that simulated a suite."""

from sqlalchemy import Connection, select

from brink.server.campaigns.store import Campaign, campaigns_of
from brink.server.db.models import CampaignRow

MOST_VERSIONS = 12
_SCANNED = 200


def read_versions(connection: Connection, campaign: Campaign) -> list[Campaign]:
    """Return the campaigns that simulated the same system of the same suite, newest first, at most `MOST_VERSIONS`.

    Args:
        connection: Of the database.
        campaign: One of them.
    """
    query = (
        select(CampaignRow.__table__)
        .where(CampaignRow.name == campaign.body.name, CampaignRow.deleted_at.is_(None))
        .order_by(CampaignRow.created_at.desc(), CampaignRow.id.desc())
        .limit(_SCANNED)
    )
    named = campaigns_of(connection, connection.execute(query).all())
    algorithm = campaign.body.algorithm.id
    return [one for one in named if one.body.algorithm.id == algorithm][:MOST_VERSIONS]

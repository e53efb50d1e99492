"""Retention: deletes campaigns that ended long ago, and traces, which can be recorded again.

`prune` only marks the campaigns as deleted; `brink.server.campaigns.deletion.erase_piece` then erases them.
"""

from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, Connection, func, select
from sqlalchemy.orm import aliased

from brink.server.campaigns.deletion import mark_deleted
from brink.server.campaigns.store import ENDED
from brink.server.db.models import CampaignRow, RepeatsRow, SolutionRow
from brink.server.db.sql import database_now
from brink.server.queue.job_store import delete_traces


@dataclass(frozen=True, slots=True, kw_only=True)
class Pruned:
    """Campaigns and traces that were deleted, or would be.

    Attributes:
        campaigns: Ids and names of campaigns, oldest first.
        solutions: Number of their solutions.
        traces: Number of traces of other campaigns.
    """

    campaigns: tuple[tuple[str, str], ...]
    solutions: int
    traces: int


def prune(
    connection: Connection, *, ended: timedelta | None, traces: timedelta | None, really: bool
) -> Pruned:
    """Delete old campaigns and traces, all or nothing.

    Args:
        connection: In a write transaction.
        ended: Delete campaigns that ended longer ago than this; None keeps all.
        traces: Delete traces that were recorded longer ago than this; None keeps those of the remaining campaigns.
        really: Whether to delete; otherwise only find out what would be deleted.
    """
    now = database_now(connection)
    found: list[tuple[str, str]] = []
    if ended is not None:
        query = (
            select(CampaignRow.id, CampaignRow.name)
            .where(
                CampaignRow.status.in_(ENDED),
                CampaignRow.finished_at < now - ended,
                CampaignRow.deleted_at.is_(None),
                ~_repeated_since(now - ended),
            )
            .order_by(CampaignRow.finished_at)
        )
        found = [(row.id, row.name) for row in connection.execute(query)]
    solutions = 0
    for campaign_id, _ in found:
        of_campaign = select(func.count()).where(SolutionRow.campaign_id == campaign_id)
        solutions += connection.execute(of_campaign).scalar_one()
    if really:
        mark_deleted(connection, [campaign_id for campaign_id, _ in found])
    deleted = 0 if traces is None else delete_traces(connection, now - traces, dry_run=not really)
    return Pruned(campaigns=tuple(found), solutions=solutions, traces=deleted)


def _repeated_since(moment: datetime) -> ColumnElement[bool]:
    """Return the condition that a campaign has repeats that are still running or ended after a point in time."""
    again = aliased(CampaignRow)
    recent = again.finished_at.is_(None) | (again.finished_at >= moment)
    return (
        select(RepeatsRow.campaign_id)
        .join(again, again.id == RepeatsRow.campaign_id)
        .where(RepeatsRow.of_id == CampaignRow.id, recent)
        .exists()
    )

"""Retention: deletes campaigns that ended long ago, and traces, which can be recorded again.

What belongs together goes together: a campaign with its follow-ups, theirs, and so on, and the campaigns of an
experiment. Nothing of it is deleted before all of it has ended, each campaign longer ago than the retention time.

`prune` only marks the campaigns as deleted; `brink.server.campaigns.deletion.erase_piece` then erases them.
"""

from collections import defaultdict
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import Connection, func, select

from brink.server.campaigns.deletion import TreeMember, mark_deleted, read_trees
from brink.server.db.models import CampaignRow, ExperimentCampaignRow, FollowUpRow, SolutionRow
from brink.server.db.sql import database_now
from brink.server.queue.job_store import delete_traces
from brink.server.states import ENDED


@dataclass(frozen=True, slots=True, kw_only=True)
class Pruned:
    """Campaigns and traces that were deleted, or would be.

    Attributes:
        campaigns: All campaigns that go, those that ended first before the others, each followed by its follow-ups.
        solutions: Number of their solutions.
        traces: Number of traces of other campaigns.
    """

    campaigns: tuple[TreeMember, ...]
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

    Raises:
        Conflict: A follow-up was just added to one of the campaigns; nothing is deleted.
    """
    now = database_now(connection)
    roots = [] if ended is None else _old_trees(connection, now - ended)
    found = mark_deleted(connection, roots) if really else read_trees(connection, roots)
    solutions = 0
    for one in found:
        of_campaign = select(func.count()).where(SolutionRow.campaign_id == one.id)
        solutions += connection.execute(of_campaign).scalar_one()
    deleted = 0 if traces is None else delete_traces(connection, now - traces, dry_run=not really)
    return Pruned(campaigns=tuple(found), solutions=solutions, traces=deleted)


def _old_trees(connection: Connection, moment: datetime) -> list[str]:
    """Return the roots of the trees that ended before a point in time, with everything that belongs to them."""
    query = (
        select(CampaignRow.id, CampaignRow.status, CampaignRow.finished_at)
        .where(CampaignRow.deleted_at.is_(None))
        .order_by(CampaignRow.finished_at, CampaignRow.id)
    )
    campaigns = connection.execute(query).all()
    links = select(FollowUpRow.campaign_id, FollowUpRow.of_id)
    above: dict[str, str] = {row.campaign_id: row.of_id for row in connection.execute(links)}
    memberships = select(ExperimentCampaignRow.campaign_id, ExperimentCampaignRow.experiment_id)
    experiments: dict[str, str] = {
        row.campaign_id: row.experiment_id for row in connection.execute(memberships)
    }
    roots = defaultdict[tuple[str | None, str], list[str]](list)
    kept = set[tuple[str | None, str]]()
    for row in campaigns:
        root = row.id
        while root in above:
            root = above[root]
        experiment = experiments.get(root)
        group = (experiment, "" if experiment else root)
        if root == row.id:
            roots[group].append(root)
        if row.status not in ENDED or row.finished_at is None or row.finished_at >= moment:
            kept.add(group)
    return [root for group, members in roots.items() if group not in kept for root in members]

"""Retention: campaigns that ended long ago, and traces that can be made again."""

from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, Connection, delete, func, select
from sqlalchemy.orm import aliased

from brink.server.campaigns.store import ENDED, delete_campaign
from brink.server.db.clock import database_now
from brink.server.db.models import CampaignRow, JobRow, RepeatsRow, SolutionRow, TraceRow
from brink.server.states import JobKind, JobStatus


@dataclass(frozen=True, slots=True, kw_only=True)
class Pruned:
    """What is older than it may be.

    Attributes:
        campaigns: Ids and names, the oldest first.
        solutions: How many these have.
        traces: How many traces of other campaigns.
    """

    campaigns: tuple[tuple[str, str], ...]
    solutions: int
    traces: int


def prune(
    connection: Connection, *, ended: timedelta | None, traces: timedelta | None, really: bool
) -> Pruned:
    """Delete what is older than it may be, all or nothing; return what that is.

    Args:
        connection: In a write transaction.
        ended: Campaigns that ended so long ago go; None keeps all.
        traces: Traces made so long ago go; None keeps all but those of campaigns that go.
        really: Whether to delete, or only to say what would be.
    """
    now = database_now(connection)
    found: list[tuple[str, str]] = []
    if ended is not None:
        query = (
            select(CampaignRow.id, CampaignRow.name)
            .where(
                CampaignRow.status.in_(ENDED),
                CampaignRow.finished_at < now - ended,
                ~_repeated_since(now - ended),
            )
            .order_by(CampaignRow.finished_at)
        )
        found = [(row.id, row.name) for row in connection.execute(query)]
    count = 0
    for campaign_id, _ in found:
        of_campaign = select(func.count()).where(SolutionRow.campaign_id == campaign_id)
        count += connection.execute(of_campaign).scalar_one()
        if really:
            delete_campaign(connection, campaign_id)
    old = TraceRow.created_at < now - traces if traces is not None else None
    gone = 0
    if old is not None:
        gone = connection.execute(select(func.count()).select_from(TraceRow).where(old)).scalar_one()
        if really:
            made = select(TraceRow.spec_hash).where(old)
            # A finished job would stand for a trace that is there, and nobody could ask for it again.
            connection.execute(
                delete(JobRow).where(
                    JobRow.kind == JobKind.TRACE,
                    JobRow.status == JobStatus.DONE,
                    JobRow.spec_hash.in_(made),
                )
            )
            connection.execute(delete(TraceRow).where(old))
    return Pruned(campaigns=tuple(found), solutions=count, traces=gone)


def _repeated_since(moment: datetime) -> ColumnElement[bool]:
    """Return the condition that repeats of a campaign have not ended, or ended later: they would go with it."""
    again = aliased(CampaignRow)
    young = again.finished_at.is_(None) | (again.finished_at >= moment)
    return (
        select(RepeatsRow.campaign_id)
        .join(again, again.id == RepeatsRow.campaign_id)
        .where(RepeatsRow.of_id == CampaignRow.id, young)
        .exists()
    )

"""Queries of follow-ups."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import Connection, Row, insert, select

from brink.server.campaigns.follow_ups.follow_up import FollowUp, PlannedFollowUp, StoredFollowUp
from brink.server.campaigns.follow_ups.question import questions
from brink.server.campaigns.plan import store_campaign
from brink.server.campaigns.store import Campaign, campaigns_of
from brink.server.db.models import CampaignRow, FollowUpRow, SolutionRow
from brink.server.db.sql import note_change
from brink.server.queue.job_store import is_told
from brink.server.states import CampaignStatus, FollowUpKind, Selection, SolutionVerdict

_GIVEN_UP = (CampaignStatus.CANCELLED, CampaignStatus.FAILED)
_ALL = (
    select(FollowUpRow.__table__, CampaignRow.__table__)
    .join(CampaignRow, CampaignRow.id == FollowUpRow.campaign_id)
    .order_by(CampaignRow.created_at, CampaignRow.id)
)


def _asked(row: Row[*tuple[Any, ...]]) -> dict[str, Any]:
    """Return the fields of `FollowUp` of a row."""
    return {
        "of_id": row.of_id,
        "kind": FollowUpKind(row.kind),
        "selection": Selection(row.selection),
        "t_b": row.t_b,
        "d_th": row.d_th,
        "repeats": row.repeats,
        "numbers": tuple(row.numbers),
    }


def insert_follow_up(connection: Connection, campaign_id: str, asks: FollowUp) -> None:
    """Store what a campaign asks about another one."""
    connection.execute(insert(FollowUpRow).values(campaign_id=campaign_id, **asdict(asks)))


def store_follow_up(connection: Connection, planned: PlannedFollowUp) -> tuple[Campaign, bool]:
    """Store a follow-up unless an equal one exists; return its campaign, and whether it is new."""
    asks = planned.asks
    query = _ALL.where(FollowUpRow.of_id == asks.of_id, CampaignRow.status.not_in(_GIVEN_UP))
    equal = [row for row in connection.execute(query) if FollowUp(**_asked(row)) == asks]
    if equal:
        return campaigns_of(connection, equal[:1])[0], False
    campaign = store_campaign(connection, planned.campaign)
    insert_follow_up(connection, campaign.id, asks)
    note_change(connection, asks.of_id)
    return campaign, True


def followed_by(connection: Connection, campaign_id: str) -> FollowUp | None:
    """Return the question of a follow-up; None if the campaign is not one."""
    row = connection.execute(
        select(FollowUpRow.__table__).where(FollowUpRow.campaign_id == campaign_id)
    ).one_or_none()
    return None if row is None else FollowUp(**_asked(row))


def read_follow_ups(connection: Connection, campaign_id: str) -> list[StoredFollowUp]:
    """Return all follow-ups of a campaign, oldest first."""
    rows = connection.execute(_ALL.where(FollowUpRow.of_id == campaign_id)).all()
    found = []
    for row, campaign in zip(rows, campaigns_of(connection, rows), strict=True):
        verdicts = _verdicts(connection, campaign.id)
        evaluated = {
            number: verdict for number, verdict in verdicts.items() if verdict != SolutionVerdict.FAILED
        }
        found.append(
            StoredFollowUp(
                **_asked(row),
                campaign=campaign,
                evaluated=tuple(evaluated),
                unsafe=tuple(verdict == SolutionVerdict.UNSAFE for verdict in evaluated.values()),
                failed=tuple(number for number in verdicts if number not in evaluated),
            )
        )
    return found


def read_pair_campaigns(connection: Connection, campaigns: Sequence[str]) -> list[Campaign]:
    """Return the campaigns that ask about the pairs of the given campaigns what experiments ask, oldest first.

    Those that were cancelled or have failed are left out: they may be asked for again.
    """
    query = (
        select(CampaignRow.__table__)
        .join(FollowUpRow, FollowUpRow.campaign_id == CampaignRow.id)
        .where(
            FollowUpRow.of_id.in_(list(campaigns)),
            FollowUpRow.selection == Selection.PAIRS,
            FollowUpRow.kind.in_([one.kind for one in questions() if one.is_asked_by_experiments]),
            CampaignRow.status.not_in(_GIVEN_UP),
        )
        .order_by(CampaignRow.created_at, CampaignRow.id)
    )
    return campaigns_of(connection, connection.execute(query).all())


def read_ended(connection: Connection, campaign_id: str) -> dict[int, bool | None]:
    """Return whether each finished simulation of a campaign was unsafe, by number; None if it failed."""
    return {
        number: None if verdict == SolutionVerdict.FAILED else verdict == SolutionVerdict.UNSAFE
        for number, verdict in _verdicts(connection, campaign_id).items()
    }


def _verdicts(connection: Connection, campaign_id: str) -> dict[int, str]:
    """Return whether each finished simulation of a campaign was safe or unsafe, or failed, by number."""
    ended = (SolutionVerdict.SAFE, SolutionVerdict.UNSAFE, SolutionVerdict.FAILED)
    query = select(SolutionRow.number, SolutionRow.verdict).where(
        SolutionRow.campaign_id == campaign_id, SolutionRow.verdict.in_(ended), is_told(campaign_id)
    )
    return {row.number: row.verdict for row in connection.execute(query)}

"""Summaries of all campaigns, for the list on the dashboard's first page, which polls them every few seconds."""

from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from threading import Lock
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Select, and_, case, func, select

from brink.server.campaigns.store import labelled, read_tags
from brink.server.db.models import CampaignRow, ExperimentCampaignRow, FollowUpRow, GenerationRow
from brink.server.db.sql import in_list, newest_first
from brink.server.states import ENDED, CampaignStatus, FollowUpKind

POINTS: Final = 24
"""Maximum number of points of a sparkline."""
CACHED: Final = 1_000
MOST_UNFOLDED: Final = 1_000
"""Maximum number of follow-ups that are listed below their campaigns."""


class FollowUpListing(StrEnum):
    """How a list of campaigns treats follow-ups."""

    LISTED = "listed"
    """Like any other campaign."""
    HIDDEN = "hidden"
    NESTED = "nested"
    """After the campaign that they follow up, oldest first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowUpCounts:
    """The follow-ups of a campaign.

    Attributes:
        all: Their number.
        open: Those that have not ended.
        sequence: Sum of their sequences; it increases with every change to one of them.
    """

    all: int = 0
    open: int = 0
    sequence: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """A campaign without its submitted document.

    Attributes:
        experiment: The experiment it belongs to, if any.
        follow_up_of: The campaign that it follows up, if any.
        kind: What it asks if it is a follow-up.
    """

    id: str
    name: str
    problem: str
    algorithm: str
    seed: int
    status: CampaignStatus
    status_reason: str
    sequence: int
    budget: int
    generation: int
    evaluated: int
    unsafe: int
    failed: int
    measured: int
    created_at: datetime
    finished_at: datetime | None
    experiment: str | None
    follow_up_of: str | None
    kind: FollowUpKind | None
    tags: list[str]
    follow_ups: FollowUpCounts

    @property
    def completed(self) -> int:
        """Finished candidates: evaluated, measured or failed."""
        return self.evaluated + self.measured + self.failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Chosen:
    """Filters for a list of campaigns.

    Attributes:
        statuses: Only campaigns in one of these states; all if empty.
        named: Only campaigns whose name contains this or whose id begins with it, ignoring case.
        experiment: Only campaigns of this experiment.
        tags: Only campaigns with all of these tags.
        search: Only campaigns with all of these words in name, notes or tags, or whose id begins with this; case does
            not matter.
        follow_ups: Whether to list follow-ups, too.
    """

    statuses: Sequence[CampaignStatus] = ()
    named: str = ""
    experiment: str | None = None
    tags: Sequence[str] = ()
    search: str = ""
    follow_ups: bool = True

    def conditions(self) -> list[ColumnElement[bool]]:
        """Return the conditions of a query."""
        row = CampaignRow
        found = list(labelled(self.tags, ""))
        if self.statuses:
            found.append(row.status.in_(self.statuses))
        if self.named:
            inside = func.lower(row.name).contains(self.named.lower(), autoescape=True)
            found.append(inside | row.id.startswith(self.named.lower(), autoescape=True))
        if self.experiment is not None:
            found.append(ExperimentCampaignRow.experiment_id == self.experiment)
        found.append(row.deleted_at.is_(None))
        if not self.follow_ups:
            found.append(FollowUpRow.campaign_id.is_(None))
        if words := labelled((), self.search):
            found.append(and_(*words) | row.id.startswith(self.search.strip().lower(), autoescape=True))
        return found


def list_outlines(
    connection: Connection, *, limit: int, before: tuple[datetime, str] | None, chosen: Chosen
) -> list[Outline]:
    """Return campaigns, newest first.

    Args:
        connection: Read connection on one snapshot.
        limit: Maximum number of campaigns.
        before: Creation time and id of a campaign; only older ones are returned.
        chosen: Which campaigns.
    """
    query = _with_columns(newest_first(CampaignRow.__table__, limit=limit, before=before))
    return _outlines(connection, query.where(*chosen.conditions()))


def count_campaigns(connection: Connection, chosen: Chosen) -> int:
    """Return the number of campaigns that match."""
    query = _joined(select(func.count()).select_from(CampaignRow.__table__))
    count: int = connection.execute(query.where(*chosen.conditions())).scalar_one()
    return count


def with_follow_ups(
    connection: Connection, outlines: Sequence[Outline], unfolded: Collection[str] | None
) -> list[Outline]:
    """Return campaigns, each followed by its follow-ups and theirs, oldest first.

    Args:
        connection: Read connection on one snapshot.
        outlines: The campaigns, without their follow-ups.
        unfolded: Campaigns whose follow-ups are returned; None for all.
    """
    parents = [one.id for one in outlines if one.follow_ups.all and (unfolded is None or one.id in unfolded)]
    if not parents:
        return list(outlines)
    row = CampaignRow
    query = _with_columns(select(row.__table__).order_by(row.created_at, row.id).limit(MOST_UNFOLDED))
    found = _outlines(connection, query.where(FollowUpRow.of_id.in_(parents)))
    below: dict[str, list[Outline]] = {}
    parent = ""
    for one in with_follow_ups(connection, found, unfolded):
        if one.follow_up_of in parents:  # otherwise it follows up the follow-up before it
            parent = one.follow_up_of
        below.setdefault(parent, []).append(one)
    return [each for one in outlines for each in (one, *below.get(one.id, ()))]


def _with_columns(page: Select[Any]) -> Select[Any]:
    """Return a query of campaigns that selects the columns that `_outlines` reads."""
    row = CampaignRow
    wanted = page.with_only_columns(
        row.id,
        row.name,
        row.document["problem"]["id"].as_string().label("problem"),
        row.document["algorithm"]["id"].as_string().label("algorithm"),
        row.seed,
        row.status,
        row.status_reason,
        row.sequence,
        row.budget,
        row.generation,
        row.evaluated,
        row.unsafe,
        row.failed,
        row.measured,
        row.created_at,
        row.finished_at,
        ExperimentCampaignRow.experiment_id.label("experiment"),
        FollowUpRow.of_id.label("follow_up_of"),
        FollowUpRow.kind,
    )
    return _joined(wanted)


def _joined(query: Select[Any]) -> Select[Any]:
    """Return a query of campaigns joined with their experiments and the campaigns that they follow up."""
    row = CampaignRow
    return query.outerjoin_from(
        row.__table__, ExperimentCampaignRow.__table__, ExperimentCampaignRow.campaign_id == row.id
    ).outerjoin(FollowUpRow.__table__, FollowUpRow.campaign_id == row.id)


def _outlines(connection: Connection, query: Select[Any]) -> list[Outline]:
    rows = connection.execute(query).all()
    ids = [one.id for one in rows]
    tagged, followed = read_tags(connection, ids), _count_follow_ups(connection, ids)
    return [
        Outline(
            **{
                **one._mapping,
                "status": CampaignStatus(one.status),
                "kind": None if one.kind is None else FollowUpKind(one.kind),
                "tags": tagged[one.id],
                "follow_ups": followed.get(one.id, FollowUpCounts()),
            }
        )
        for one in rows
    ]


_FOLLOW_UPS: Final = (
    select(
        FollowUpRow.of_id,
        func.count().label("all"),
        func.sum(case((CampaignRow.status.in_(ENDED), 0), else_=1)).label("open"),
        func.sum(CampaignRow.sequence).label("sequence"),
    )
    .join(CampaignRow, CampaignRow.id == FollowUpRow.campaign_id)
    .where(in_list(FollowUpRow.of_id, "campaigns"))
    .group_by(FollowUpRow.of_id)
)


def _count_follow_ups(connection: Connection, campaigns: Sequence[str]) -> dict[str, FollowUpCounts]:
    """Return the follow-ups of those campaigns that have any."""
    if not campaigns:
        return {}
    return {
        one.of_id: FollowUpCounts(all=one.all, open=int(one.open), sequence=int(one.sequence))
        for one in connection.execute(_FOLLOW_UPS, {"campaigns": list(campaigns)})
    }


@dataclass(slots=True)
class Sparklines:
    """A cache of sparklines: distinct boundary solutions at evenly spaced generations."""

    _cached: OrderedDict[tuple[str, int], tuple[int, ...]] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    def of(self, connection: Connection, outlines: Sequence[Outline]) -> Mapping[str, tuple[int, ...]]:
        """Return the sparkline of each campaign; only campaigns that have changed are read from the database."""
        with self._lock:
            known = {
                name: self._cached[name]
                for one in outlines
                if (name := (one.id, one.sequence)) in self._cached
            }
        known.update(
            _read_sparklines(connection, [one for one in outlines if (one.id, one.sequence) not in known])
        )
        with self._lock:
            for name, line in known.items():
                self._cached[name] = line
                self._cached.move_to_end(name)
            while len(self._cached) > CACHED:
                self._cached.popitem(last=False)
        return {campaign: line for (campaign, _), line in known.items()}


def _read_sparklines(
    connection: Connection, outlines: Sequence[Outline]
) -> Mapping[tuple[str, int], tuple[int, ...]]:
    wanted: dict[str, list[int]] = {}
    for one in outlines:
        step = max(1, -(-one.generation // POINTS))
        # The latest generation, and earlier ones at equal steps.
        wanted[one.id] = list(range((one.generation - 1) % step, one.generation, step))
    known: dict[str, list[int]] = {one.id: [] for one in outlines}
    for start in range(0, len(outlines), 50):
        some = [one.id for one in outlines[start : start + 50]]
        numbers = sorted({number for campaign in some for number in wanted[campaign]})
        query = (
            select(GenerationRow.campaign_id, GenerationRow.number, GenerationRow.dbs)
            .where(
                GenerationRow.campaign_id.in_(some),
                GenerationRow.number.in_(numbers),
                GenerationRow.dbs.is_not(None),
            )
            .order_by(GenerationRow.campaign_id, GenerationRow.number)
        )
        for row in connection.execute(query):
            if row.number in wanted[row.campaign_id]:
                known[row.campaign_id].append(row.dbs)
    return {(one.id, one.sequence): tuple(known[one.id]) for one in outlines}

"""Summaries of all campaigns, for the list on the dashboard's first page, which polls them every few seconds."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from threading import Lock
from typing import Final

from sqlalchemy import Connection, func, select

from brink.server.campaigns.store import labelled, read_tags
from brink.server.db.models import CampaignRow, ExperimentCampaignRow, GenerationRow, RepeatsRow
from brink.server.db.sql import newest_first
from brink.server.states import CampaignStatus

POINTS: Final = 24
"""Maximum number of points of a sparkline."""
CACHED: Final = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """A campaign without its submitted document.

    Attributes:
        experiment: The experiment it belongs to, if any.
        repeats_of: The campaign whose solutions it repeats, if any.
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
    repeats_of: str | None
    tags: list[str]

    @property
    def completed(self) -> int:
        """Finished candidates: evaluated, measured or failed."""
        return self.evaluated + self.measured + self.failed


def list_outlines(
    connection: Connection,
    *,
    limit: int,
    before: tuple[datetime, str] | None = None,
    statuses: Sequence[CampaignStatus] = (),
    named: str = "",
    experiment: str | None = None,
    tags: Sequence[str] = (),
    search: str = "",
) -> list[Outline]:
    """Return campaigns, newest first.

    Args:
        connection: Read connection on one snapshot.
        limit: Maximum number of campaigns.
        before: Creation time and id of a campaign; only older ones are returned.
        statuses: Only campaigns in one of these states; all if empty.
        named: Only campaigns whose name contains this or whose id begins with it, ignoring case.
        experiment: Only campaigns of this experiment.
        tags: Only campaigns with all of these tags.
        search: Only campaigns with all of these words in name, notes or tags, ignoring case.
    """
    row = CampaignRow
    page = newest_first(row.__table__, limit=limit, before=before)
    query = page.with_only_columns(
        row.id, row.name, row.document["problem"]["id"].as_string().label("problem"),
        row.document["algorithm"]["id"].as_string().label("algorithm"), row.seed, row.status, row.status_reason,
        row.sequence, row.budget, row.generation, row.evaluated, row.unsafe, row.failed, row.measured,
        row.created_at, row.finished_at, ExperimentCampaignRow.experiment_id.label("experiment"),
        RepeatsRow.of_id.label("repeats_of"),
    ).outerjoin_from(
        row.__table__, ExperimentCampaignRow.__table__, ExperimentCampaignRow.campaign_id == row.id
    ).outerjoin(RepeatsRow.__table__, RepeatsRow.campaign_id == row.id)  # fmt: skip
    if statuses:
        query = query.where(row.status.in_(statuses))
    if named:
        inside = func.lower(row.name).contains(named.lower(), autoescape=True)
        query = query.where(inside | row.id.startswith(named.lower(), autoescape=True))
    if experiment is not None:
        query = query.where(ExperimentCampaignRow.experiment_id == experiment)
    rows = connection.execute(query.where(*labelled(tags, search))).all()
    tagged = read_tags(connection, [one.id for one in rows])
    return [
        Outline(**{**one._mapping, "status": CampaignStatus(one.status), "tags": tagged[one.id]})
        for one in rows
    ]


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
            .where(GenerationRow.campaign_id.in_(some), GenerationRow.number.in_(numbers))
            .order_by(GenerationRow.campaign_id, GenerationRow.number)
        )
        for row in connection.execute(query):
            if row.number in wanted[row.campaign_id]:
                known[row.campaign_id].append(row.dbs)
    return {(one.id, one.sequence): tuple(known[one.id]) for one in outlines}

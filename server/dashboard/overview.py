"""All campaigns at a glance, columnar: what the list of campaigns shows, and asks for every few seconds."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from threading import Lock
from typing import Final

from sqlalchemy import Connection, func, select

from brink.server.db.models import CampaignRow, ExperimentCampaignRow, GenerationRow, RepeatsRow
from brink.server.db.sql import newest_first
from brink.server.states import CampaignStatus

POINTS: Final = 24
"""Of a course in a few pixels."""
KEPT: Final = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """A campaign without the document that asks for it.

    Attributes:
        experiment: That it belongs to, if it does.
        repeats_of: The campaign whose boundary it repeats, if it does.
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

    @property
    def completed(self) -> int:
        """Candidates of which all is known that was asked."""
        return self.evaluated + self.measured + self.failed


def list_outlines(
    connection: Connection,
    *,
    limit: int,
    before: tuple[datetime, str] | None = None,
    statuses: Sequence[CampaignStatus] = (),
    named: str = "",
    experiment: str | None = None,
) -> list[Outline]:
    """Return campaigns, newest first.

    Args:
        connection: Sees one snapshot.
        limit: Most of them.
        before: Only those submitted before this one.
        statuses: Only those in one of these states; any without.
        named: Only those with this in their name or at the beginning of their id, in any case.
        experiment: Only those of this experiment.
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
    return [
        Outline(**{**found._mapping, "status": CampaignStatus(found.status)})
        for found in connection.execute(query)
    ]


@dataclass(slots=True)
class Sparks:
    """Courses in a few pixels: how many distinct boundary solutions there were, evenly over the generations."""

    _kept: OrderedDict[tuple[str, int], tuple[int, ...]] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    def of(self, connection: Connection, outlines: Sequence[Outline]) -> Mapping[str, tuple[int, ...]]:
        """Return the course of each campaign; those that have not changed since are not read again."""
        with self._lock:
            known = {
                name: self._kept[name] for one in outlines if (name := (one.id, one.sequence)) in self._kept
            }
        known.update(_courses(connection, [one for one in outlines if (one.id, one.sequence) not in known]))
        with self._lock:
            for name, course in known.items():
                self._kept[name] = course
                self._kept.move_to_end(name)
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return {campaign: course for (campaign, _), course in known.items()}


def _courses(
    connection: Connection, outlines: Sequence[Outline]
) -> Mapping[tuple[str, int], tuple[int, ...]]:
    wanted: dict[str, list[int]] = {}
    for one in outlines:
        step = max(1, -(-one.generation // POINTS))
        # The latest generation, and every so many before it.
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

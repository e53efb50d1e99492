"""The SQL of experiments."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from sqlalchemy import Connection, Row, bindparam, delete, exists, func, insert, select

from brink.server.campaigns.store import Campaign, campaigns_of
from brink.server.db.models import (
    CampaignRow,
    ExperimentCampaignRow,
    ExperimentRow,
    GenerationRow,
    JobRow,
    SolutionRow,
)
from brink.server.db.sql import DocumentTable, database_now
from brink.server.experiments.body import Cell, ExperimentBody
from brink.server.states import CampaignStatus, JobKind, JobStatus


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """A campaign of an experiment.

    Attributes:
        place: Position in the experiment.
        method: Name of its algorithm.
        problem: Name of its problem.
    """

    place: int
    method: str
    problem: str
    campaign: Campaign


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """An experiment as it is stored.

    Attributes:
        body: What was submitted.
        document_hash: Hash of the body.
        members: Its campaigns in order, except deleted ones.
    """

    id: str
    body: ExperimentBody
    document_hash: str
    created_at: datetime
    members: tuple[Member, ...]

    @property
    def status(self) -> CampaignStatus:
        """The first of running, paused, failed, cancelled that applies to one of its campaigns; else finished."""
        statuses = {member.campaign.status for member in self.members}
        for status in (
            CampaignStatus.RUNNING,
            CampaignStatus.PAUSED,
            CampaignStatus.FAILED,
            CampaignStatus.CANCELLED,
        ):
            if status in statuses:
                return status
        return CampaignStatus.FINISHED

    @property
    def simulations(self) -> int:
        """Completed candidates of all campaigns."""
        return sum(member.campaign.completed for member in self.members)

    @property
    def budget(self) -> int:
        """Maximum number of simulations of all campaigns."""
        return self.body.campaigns * self.body.budget.simulations


def _experiments(connection: Connection, rows: Sequence[Row[*tuple[object, ...]]]) -> list[Experiment]:
    members = _members(connection, [str(row.id) for row in rows])
    return [
        Experiment(
            id=row.id,
            body=ExperimentBody.model_validate(row.document),
            document_hash=row.document_hash,
            created_at=row.created_at,
            members=tuple(members.get(row.id, ())),
        )
        for row in rows
    ]


def _members(connection: Connection, experiments: Sequence[str]) -> Mapping[str, list[Member]]:
    query = (
        select(
            ExperimentCampaignRow.experiment_id,
            ExperimentCampaignRow.place,
            ExperimentCampaignRow.method,
            ExperimentCampaignRow.problem,
            CampaignRow.__table__,
        )
        .join(CampaignRow, CampaignRow.id == ExperimentCampaignRow.campaign_id)
        .where(ExperimentCampaignRow.experiment_id.in_(list(experiments)))
        .order_by(ExperimentCampaignRow.place)
    )
    found: dict[str, list[Member]] = {}
    rows = connection.execute(query).all() if experiments else []
    for row, campaign in zip(rows, campaigns_of(connection, rows), strict=True):
        member = Member(place=row.place, method=row.method, problem=row.problem, campaign=campaign)
        found.setdefault(row.experiment_id, []).append(member)
    return found


EXPERIMENTS = DocumentTable(kind="experiment", table=ExperimentRow.__table__, build=_experiments)


def insert_experiment(
    connection: Connection,
    experiment_id: str,
    body: ExperimentBody,
    members: Sequence[tuple[Cell, str]],
    key: str | None,
) -> None:
    """Store a new experiment.

    Args:
        connection: In a write transaction.
        experiment_id: Its id.
        body: Its body.
        members: Its cells with the ids of their campaigns, which are stored already.
        key: Idempotency key.
    """
    connection.execute(
        insert(ExperimentRow).values(
            id=experiment_id,
            name=body.name,
            document=body.document(),
            document_hash=body.document_hash(),
            idempotency_key=key,
            created_at=database_now(connection),
        )
    )
    connection.execute(
        insert(ExperimentCampaignRow),
        [
            {
                "campaign_id": campaign,
                "experiment_id": experiment_id,
                "place": cell.place,
                "method": cell.method,
                "problem": cell.problem,
            }
            for cell, campaign in members
        ],
    )


def count_in_flight(connection: Connection, campaigns: Sequence[str]) -> int:
    """Return the number of solutions in flight in the given campaigns."""
    query = (
        select(func.count())
        .select_from(SolutionRow)
        .join(
            CampaignRow,
            (CampaignRow.id == SolutionRow.campaign_id) & (CampaignRow.generation <= SolutionRow.generation),
        )
        .where(CampaignRow.id.in_(list(campaigns)))
    )
    return connection.execute(query).scalar_one()


def completed_by(connection: Connection, campaigns: Sequence[Campaign], moment: datetime) -> int:
    """Return the number of candidates completed by a point in time, including those of open generations.

    Of campaigns that were cancelled or have failed, only the generations that were told count: the others have no
    results, although their jobs have ended.

    Args:
        connection: For reading.
        campaigns: The campaigns.
        moment: The point in time.
    """
    completed = GenerationRow.evaluated + GenerationRow.failed + GenerationRow.measured
    told = (
        select(GenerationRow.campaign_id, func.max(completed), func.max(GenerationRow.number))
        .where(GenerationRow.campaign_id.in_([one.id for one in campaigns]), GenerationRow.told_at <= moment)
        .group_by(GenerationRow.campaign_id)
    )
    found = {name: (count, number) for name, count, number in connection.execute(told)}
    total = sum(count for count, _ in found.values())
    for one in campaigns:
        if one.status in (CampaignStatus.CANCELLED, CampaignStatus.FAILED):
            continue
        if one.finished_at is None or one.finished_at > moment:
            values = {"campaign": one.id, "generation": found.get(one.id, (0, -1))[1], "moment": moment}
            total += connection.execute(_SIMULATED_AFTER, values).scalar_one()
    return int(total)


_SIMULATED_AFTER: Final = (
    select(func.count())
    .select_from(SolutionRow)
    .where(SolutionRow.campaign_id == bindparam("campaign"))
    .where(SolutionRow.generation > bindparam("generation"))
    .where(
        exists()
        .where(JobRow.campaign_id == SolutionRow.campaign_id, JobRow.number == SolutionRow.number)
        .where(JobRow.kind != JobKind.TRACE, JobRow.finished_at <= bindparam("moment"))
    )
)
"""Counts the candidates of a campaign in generations after the given one that were simulated by a point in time.

One statement a campaign: in a join over all of them, no index limits the generations.
"""


def cached_after(connection: Connection, campaigns: Sequence[Campaign], moment: datetime) -> int:
    """Return the number of candidates whose results came from the cache, not from a worker, after a point in time.

    Args:
        connection: For reading.
        campaigns: The campaigns.
        moment: The point in time.
    """
    ids = [one.id for one in campaigns if one.finished_at is None or one.finished_at > moment]
    told = (
        select(GenerationRow.campaign_id, func.max(GenerationRow.number))
        .where(GenerationRow.campaign_id.in_(ids), GenerationRow.told_at <= moment)
        .group_by(GenerationRow.campaign_id)
    )
    last: dict[str, int] = {row[0]: row[1] for row in connection.execute(told)}
    values = [{"campaign": one, "generation": last.get(one, -1), "moment": moment} for one in ids]
    return sum(connection.execute(_CACHED_AFTER, one).scalar_one() for one in values)


_CACHED_AFTER: Final = (
    select(func.count())
    .select_from(SolutionRow)
    .where(SolutionRow.campaign_id == bindparam("campaign"))
    .where(SolutionRow.generation > bindparam("generation"))
    .where(
        exists()
        .where(JobRow.campaign_id == SolutionRow.campaign_id, JobRow.number == SolutionRow.number)
        .where(JobRow.kind != JobKind.TRACE, JobRow.status == JobStatus.DONE, JobRow.attempt == 0)
        .where(JobRow.finished_at > bindparam("moment"))
    )
)
"""Counts the candidates of a campaign in generations after the given one whose results no worker reported."""


def delete_experiment(connection: Connection, experiment_id: str) -> None:
    """Delete an experiment, whose campaigns are marked as deleted."""
    connection.execute(delete(ExperimentRow).where(ExperimentRow.id == experiment_id))

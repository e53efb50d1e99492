"""The SQL of experiments: rows in, plain values out."""

from collections.abc import Mapping, Sequence
from datetime import datetime

from sqlalchemy import Connection, Row, delete, func, insert, select

from brink.server.campaigns import store as campaign_store
from brink.server.db.clock import database_now
from brink.server.db.listing import named_row, newest_first
from brink.server.db.models import (
    EVALUATES,
    CampaignRow,
    ExperimentCampaignRow,
    ExperimentRow,
    GenerationRow,
    JobRow,
    SolutionRow,
)
from brink.server.experiments.body import Cell, ExperimentBody
from brink.server.experiments.values import Experiment, Member
from brink.server.states import JobStatus


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
        body: What was asked for.
        members: Its campaigns, which are stored already, with their ids.
        key: Idempotency key.
    """
    connection.execute(
        insert(ExperimentRow).values(
            id=experiment_id, name=body.name, document=body.model_dump(mode="json"),
            document_hash=body.document_hash(), idempotency_key=key, created_at=database_now(connection),
        )
    )  # fmt: skip
    connection.execute(
        insert(ExperimentCampaignRow),
        [
            {
                "campaign_id": campaign, "experiment_id": experiment_id, "place": cell.place,
                "method": cell.method, "problem": cell.problem,
            }
            for cell, campaign in members
        ],
    )  # fmt: skip


def find_by_key(connection: Connection, key: str) -> Experiment | None:
    """Return the experiment that was submitted with an idempotency key, or None."""
    rows = connection.execute(select(ExperimentRow.__table__).where(ExperimentRow.idempotency_key == key))
    return next(iter(_experiments(connection, rows.all())), None)


def named_experiment(connection: Connection, name: str) -> Experiment:
    """Return an experiment by its id, or by the beginning of its id if that is unique.

    Raises:
        NotFound: There is none, or more than one.
    """
    row = named_row(connection, ExperimentRow.__table__, name, "experiment")
    return _experiments(connection, [row])[0]


def list_experiments(
    connection: Connection,
    *,
    limit: int,
    before: tuple[datetime, str] | None = None,
    document_hash: str | None = None,
) -> list[Experiment]:
    """Return experiments, newest first."""
    query = newest_first(ExperimentRow.__table__, limit=limit, before=before)
    if document_hash is not None:
        query = query.where(ExperimentRow.document_hash == document_hash)
    return _experiments(connection, connection.execute(query).all())


def count_open_jobs(connection: Connection, campaigns: Sequence[str]) -> dict[str, int]:
    """Return how many jobs of some campaigns are in each state that is not done."""
    query = (
        select(JobRow.status, func.count())
        .where(
            JobRow.campaign_id.in_(list(campaigns)),
            EVALUATES,
            JobRow.status.in_([status for status in JobStatus if status is not JobStatus.DONE]),
        )
        .group_by(JobRow.status)
    )
    return {str(row[0]): int(row[1]) for row in connection.execute(query)}


def count_pending(connection: Connection, campaigns: Sequence[str]) -> int:
    """Return how many solutions the generations have that some campaigns are being evaluated at."""
    query = (
        select(func.count())
        .select_from(SolutionRow)
        .join(
            CampaignRow,
            (CampaignRow.id == SolutionRow.campaign_id) & (CampaignRow.generation == SolutionRow.generation),
        )
        .where(CampaignRow.id.in_(list(campaigns)))
    )
    return connection.execute(query).scalar_one()


def told_by(connection: Connection, campaigns: Sequence[str], moment: datetime) -> int:
    """Return how many candidates of some campaigns had been evaluated at a moment."""
    told = GenerationRow.evaluated + GenerationRow.failed + GenerationRow.measured
    latest = (
        select(func.max(told).label("told"))
        .where(GenerationRow.campaign_id.in_(list(campaigns)), GenerationRow.told_at <= moment)
        .group_by(GenerationRow.campaign_id)
        .subquery()
    )
    return int(connection.execute(select(func.coalesce(func.sum(latest.c.told), 0))).scalar_one())


def delete_experiment(connection: Connection, experiment: Experiment) -> None:
    """Delete an experiment with its campaigns and all that belongs to them."""
    for member in experiment.members:
        campaign_store.delete_campaign(connection, member.campaign.id)
    connection.execute(delete(ExperimentRow).where(ExperimentRow.id == experiment.id))


def _experiments(connection: Connection, rows: Sequence[Row[*tuple[object, ...]]]) -> list[Experiment]:
    members = _members(connection, [str(row.id) for row in rows])
    return [
        Experiment(
            id=row.id, body=ExperimentBody.model_validate(row.document), document_hash=row.document_hash,
            created_at=row.created_at, members=tuple(members.get(row.id, ())),
        )
        for row in rows
    ]  # fmt: skip


def _members(connection: Connection, experiments: Sequence[str]) -> Mapping[str, list[Member]]:
    query = (
        select(
            ExperimentCampaignRow.experiment_id, ExperimentCampaignRow.place, ExperimentCampaignRow.method,
            ExperimentCampaignRow.problem, CampaignRow.__table__,
        )
        .join(CampaignRow, CampaignRow.id == ExperimentCampaignRow.campaign_id)
        .where(ExperimentCampaignRow.experiment_id.in_(list(experiments)))
        .order_by(ExperimentCampaignRow.place)
    )  # fmt: skip
    found: dict[str, list[Member]] = {}
    for row in connection.execute(query) if experiments else ():
        found.setdefault(row.experiment_id, []).append(
            Member(
                place=row.place, method=row.method, problem=row.problem,
                campaign=campaign_store.campaign_of(row),
            )
        )  # fmt: skip
    return found

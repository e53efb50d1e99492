"""The SQL of what users see of campaigns: series, counts, solutions."""

from collections.abc import Iterable
from typing import Any

from sqlalchemy import Connection, Row, Select, bindparam, func, select

from brink.server.campaigns.step_store import MAX_NAMED
from brink.server.campaigns.values import GenerationSummary
from brink.server.db.models import EVALUATES, CampaignRow, GenerationRow, JobRow, SolutionRow
from brink.server.states import JobStatus, SolutionVerdict

_NOT_DONE = tuple(status for status in JobStatus if status is not JobStatus.DONE)

# Every page that is open asks for these every few seconds: to build a statement anew takes longer than to run it.
_PULSE = select(CampaignRow.sequence, CampaignRow.finished_at).where(CampaignRow.id == bindparam("campaign"))
_OPEN_JOBS = (
    select(JobRow.status, func.count())
    .where(JobRow.campaign_id == bindparam("campaign"), EVALUATES)
    .where(JobRow.status.in_(_NOT_DONE))  # not "other than done", which would look at all jobs
    .group_by(JobRow.status)
)


def read_pulse(connection: Connection, campaign_id: str) -> tuple[object, ...] | None:
    """Return what is another one whenever something of a campaign has changed, quickly; None if there is none.

    Args:
        connection: Sees one snapshot.
        campaign_id: Its whole id.
    """
    row = connection.execute(_PULSE, {"campaign": campaign_id}).one_or_none()
    if row is None:
        return None
    if row.finished_at is not None:  # the jobs of what has ended stay as they are
        return (campaign_id, row.sequence)
    return (campaign_id, row.sequence, *sorted(count_open_jobs(connection, campaign_id).items()))


def list_generations(connection: Connection, campaign_id: str, since: int) -> list[GenerationSummary]:
    """Return the generations told, from number `since` on."""
    query = (
        select(GenerationRow.__table__)
        .where(GenerationRow.campaign_id == campaign_id, GenerationRow.number >= since)
        .order_by(GenerationRow.number)
    )
    return [
        GenerationSummary(
            number=row.number, evaluated=row.evaluated, unsafe=row.unsafe, failed=row.failed, measured=row.measured,
            best_fitness=row.best_fitness, median_fitness=row.median_fitness, dbs=row.dbs,
            strict_dbs=row.strict_dbs, step_s=row.step_s, told_at=row.told_at,
        )
        for row in connection.execute(query)
    ]  # fmt: skip


def count_open_jobs(connection: Connection, campaign_id: str) -> dict[str, int]:
    """Return how many of a campaign's jobs are in each state that is not done, and done in this generation."""
    return {str(row[0]): int(row[1]) for row in connection.execute(_OPEN_JOBS, {"campaign": campaign_id})}


def count_origins(connection: Connection, campaign_id: str) -> dict[str, int]:
    """Return how many solutions come from where, the commonest first; empty if the algorithm does not say."""
    query = (
        select(SolutionRow.origin, func.count())
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.origin.is_not(None))
        .group_by(SolutionRow.origin)
        .order_by(func.count().desc(), SolutionRow.origin)
    )
    return {str(row[0]): int(row[1]) for row in connection.execute(query)}


def count_pending(connection: Connection, campaign_id: str, generation: int) -> int:
    """Return how many solutions a generation has, such as the one that is being simulated."""
    return connection.execute(
        select(func.count()).where(
            SolutionRow.campaign_id == campaign_id, SolutionRow.generation == generation
        )
    ).scalar_one()


def waiting_needs(connection: Connection, campaign_id: str) -> dict[str, int]:
    """Return how many of a campaign's queued jobs need each capability."""
    query = (
        select(JobRow.needs, func.count())
        .where(JobRow.campaign_id == campaign_id, JobRow.status == JobStatus.QUEUED)
        .group_by(JobRow.needs)
    )
    return {str(row[0]): int(row[1]) for row in connection.execute(query)}


def read_solutions(
    connection: Connection, campaign_id: str, numbers: Iterable[int]
) -> list[Row[*tuple[Any, ...]]]:
    """Return solutions by number, ascending, each with its job's result, attempts and last error."""
    wanted = sorted(numbers)
    found: list[Row[*tuple[Any, ...]]] = []
    for start in range(0, len(wanted), MAX_NAMED):
        some = wanted[start : start + MAX_NAMED]
        found += connection.execute(_solutions(campaign_id).where(SolutionRow.number.in_(some))).all()
    return found


def page_solutions(
    connection: Connection, campaign_id: str, *, after: int, limit: int, unsafe: bool | None
) -> list[Row[*tuple[Any, ...]]]:
    """Return solutions with numbers past `after`, ascending, each with its job."""
    query = _solutions(campaign_id).where(SolutionRow.number > after).limit(limit)
    if unsafe is not None:
        wanted = SolutionVerdict.UNSAFE if unsafe else SolutionVerdict.SAFE
        query = query.where(SolutionRow.verdict == wanted)
    return list(connection.execute(query))


def _solutions(campaign_id: str) -> Select[*tuple[Any, ...]]:
    return (
        select(
            SolutionRow.number, SolutionRow.generation, SolutionRow.vector, SolutionRow.seed,
            SolutionRow.spec_hash, SolutionRow.verdict, SolutionRow.robustness, SolutionRow.objectives,
            SolutionRow.failure, SolutionRow.origin, JobRow.spec, JobRow.result, JobRow.attempt,
            JobRow.status.label("job_status"),
        )
        .outerjoin(
            JobRow,
            (JobRow.campaign_id == SolutionRow.campaign_id)
            & (JobRow.number == SolutionRow.number)
            & EVALUATES,
        )
        .where(SolutionRow.campaign_id == campaign_id)
        .order_by(SolutionRow.number)
    )  # fmt: skip

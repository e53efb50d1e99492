"""How many jobs there are that are not done: for metrics, which are asked for every few seconds.

Each statement has an index that holds few rows but those it counts: all jobs that ever were would take longer and
longer.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, and_, func, literal, select

from server.db.models import EVALUATES, IS_LEASED, CampaignRow, CampaignStatus, JobRow, JobStatus

_QUEUED = JobRow.status == literal(JobStatus.QUEUED, literal_execute=True)
_QUARANTINED = JobRow.status == literal(JobStatus.QUARANTINED, literal_execute=True)
_COUNTED = (JobRow.status, JobRow.kind, JobRow.needs, JobRow.campaign_id, CampaignRow.status.label("of"))
_STATEMENTS = tuple(
    select(*_COUNTED, func.count().label("jobs"), func.min(JobRow.created_at).label("since"))
    .select_from(CampaignRow)
    .join(JobRow, JobRow.campaign_id == CampaignRow.id)
    .where(condition)
    .group_by(*_COUNTED)
    for condition in (and_(_QUEUED, EVALUATES), and_(_QUEUED, ~EVALUATES), IS_LEASED, _QUARANTINED)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """Jobs of one campaign that are alike.

    Attributes:
        status: Their state.
        kind: What they are.
        needs: What a worker must be able to run.
        campaign: Whose they are.
        running: Whether it is running.
        jobs: How many.
        since: When the first of them was stored.
    """

    status: JobStatus
    kind: str
    needs: str
    campaign: str
    running: bool
    jobs: int
    since: datetime


def count_jobs(connection: Connection) -> Iterator[Count]:
    """Give the counts of all jobs that are queued, leased or in quarantine."""
    for statement in _STATEMENTS:
        for row in connection.execute(statement):
            yield Count(
                status=JobStatus(row.status), kind=row.kind, needs=row.needs, campaign=row.campaign_id,
                running=row.of == CampaignStatus.RUNNING, jobs=row.jobs, since=row.since,
            )  # fmt: skip

"""How many jobs there are that are not done: for metrics, which are asked for every few seconds.

Each statement finds by an index what it counts, and little else: all jobs that ever were would take longer and
longer.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, text

from server.db.models import CampaignStatus, JobStatus
from server.db.types import UtcDateTime

# By hand: SQLite takes the tables of a CROSS JOIN in this order, whatever its statistics say. One look a campaign.
_COUNT = """SELECT jobs.kind, jobs.needs, jobs.campaign_id, campaigns.status AS of, count(*) AS jobs,
    min(jobs.created_at) AS since
FROM campaigns CROSS JOIN jobs
WHERE jobs.campaign_id = campaigns.id AND jobs.status = '{status}'
GROUP BY jobs.kind, jobs.needs, jobs.campaign_id, campaigns.status"""
_STATEMENTS = {
    status: text(_COUNT.format(status=status)).columns(since=UtcDateTime)
    for status in (JobStatus.QUEUED, JobStatus.LEASED, JobStatus.QUARANTINED)
}


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
    for status, statement in _STATEMENTS.items():
        for row in connection.execute(statement):
            yield Count(
                status=status, kind=row.kind, needs=row.needs, campaign=row.campaign_id,
                running=row.of == CampaignStatus.RUNNING, jobs=row.jobs, since=row.since,
            )  # fmt: skip

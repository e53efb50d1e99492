"""How many jobs there are that are not done: for metrics and for pages, which ask every few seconds.

Each statement finds by an index what it counts, and little else: all jobs that ever were would take longer and
longer.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, text

from brink.server.db.types import UtcDateTime
from brink.server.states import CampaignStatus, JobStatus

_COUNT = """SELECT jobs.kind, jobs.needs, jobs.campaign_id, campaigns.status AS of, campaigns.name,
    count(*) AS jobs, min(jobs.created_at) AS since
FROM {jobs}
GROUP BY jobs.kind, jobs.needs, jobs.campaign_id, campaigns.status, campaigns.name"""
# One look a campaign, whatever statistics say: SQLite takes the tables of a CROSS JOIN in this order, Postgres runs
# what has an OFFSET as it stands.
_JOBS = {
    "sqlite": "campaigns CROSS JOIN jobs WHERE jobs.campaign_id = campaigns.id AND jobs.status = '{status}'",
    "postgresql": """campaigns CROSS JOIN LATERAL (
    SELECT * FROM jobs WHERE jobs.campaign_id = campaigns.id AND jobs.status = '{status}' OFFSET 0
) AS jobs""",
}
_STATEMENTS = {
    dialect: {
        status: text(_COUNT.format(jobs=jobs.format(status=status))).columns(since=UtcDateTime)
        for status in (JobStatus.QUEUED, JobStatus.LEASED, JobStatus.QUARANTINED)
    }
    for dialect, jobs in _JOBS.items()
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """Jobs of one campaign that are alike.

    Attributes:
        status: Their state.
        kind: What they are.
        needs: What a worker must be able to run.
        campaign: Whose they are.
        name: What that is called.
        of: Where that stands.
        jobs: How many.
        since: When the first of them was stored.
    """

    status: JobStatus
    kind: str
    needs: str
    campaign: str
    name: str
    of: CampaignStatus
    jobs: int
    since: datetime

    @property
    def running(self) -> bool:
        """Whether their campaign is running."""
        return self.of is CampaignStatus.RUNNING


def count_jobs(connection: Connection) -> Iterator[Count]:
    """Give the counts of all jobs that are queued, leased or in quarantine."""
    for status, statement in _STATEMENTS[connection.dialect.name].items():
        for row in connection.execute(statement):
            yield Count(
                status=status, kind=row.kind, needs=row.needs, campaign=row.campaign_id,
                name=row.name, of=CampaignStatus(row.of), jobs=row.jobs, since=row.since,
            )  # fmt: skip

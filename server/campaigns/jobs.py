"""Jobs as users see them: the list, and the retry by hand."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, select, text, update

from brink.server.campaigns.store import ENDED, find_campaign
from brink.server.campaigns.values import Campaign
from brink.server.db.locking import note_change
from brink.server.db.models import JobRow, SolutionRow
from brink.server.db.news import announce
from brink.server.errors import Conflict, NotFound
from brink.server.states import JobKind, JobStatus, SolutionVerdict

OPEN = frozenset({JobStatus.QUEUED, JobStatus.LEASED, JobStatus.QUARANTINED})
# One look a campaign, as `brink.server.queue.census` has it, and for the same reason.
_IDS = {
    "sqlite": """SELECT jobs.id FROM campaigns CROSS JOIN jobs
WHERE jobs.campaign_id = campaigns.id AND jobs.status = '{status}' AND jobs.id > :after {whose}
ORDER BY jobs.id LIMIT :limit""",
    "postgresql": """SELECT jobs.id FROM campaigns CROSS JOIN LATERAL (
    SELECT id FROM jobs WHERE jobs.campaign_id = campaigns.id AND jobs.status = '{status}' OFFSET 0
) AS jobs WHERE jobs.id > :after {whose} ORDER BY jobs.id LIMIT :limit""",
}
_SHOWN = (
    JobRow.id, JobRow.campaign_id, JobRow.number, JobRow.kind, JobRow.needs, JobRow.status, JobRow.attempt,
    JobRow.max_attempts, JobRow.lease_worker, JobRow.last_error, JobRow.created_at, JobRow.finished_at,
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class JobView:
    """A job as it stands."""

    id: int
    campaign: str
    number: int
    kind: str
    needs: str
    status: JobStatus
    attempt: int
    max_attempts: int
    worker: str | None
    last_error: str | None
    created_at: datetime
    finished_at: datetime | None


def list_jobs(
    connection: Connection,
    *,
    statuses: Sequence[JobStatus] = (),
    campaign: str | None = None,
    after: int = 0,
    limit: int = 100,
) -> list[JobView]:
    """Return jobs, ascending by id.

    Those that are not done are found by what is not done; all that ever were would take longer and longer.
    """
    query = select(*_SHOWN).order_by(JobRow.id).limit(limit)
    if statuses and OPEN.issuperset(statuses):
        found = (_open_ids(connection, status, campaign, after, limit) for status in dict.fromkeys(statuses))
        query = query.where(JobRow.id.in_(sorted(itertools.chain.from_iterable(found))[:limit]))
    else:
        query = query.where(JobRow.id > after)
        if statuses:
            query = query.where(JobRow.status.in_(statuses))
        if campaign is not None:
            query = query.where(JobRow.campaign_id == campaign)
    return [
        JobView(
            id=row.id, campaign=row.campaign_id, number=row.number, kind=row.kind, needs=row.needs,
            status=JobStatus(row.status), attempt=row.attempt, max_attempts=row.max_attempts,
            worker=row.lease_worker if row.status == JobStatus.LEASED else None, last_error=row.last_error,
            created_at=row.created_at, finished_at=row.finished_at,
        )
        for row in connection.execute(query)
    ]  # fmt: skip


def _open_ids(
    connection: Connection, status: JobStatus, campaign: str | None, after: int, limit: int
) -> list[int]:
    """Return the ids of the first jobs in a state that is not done, of one campaign or of all."""
    whose = "" if campaign is None else "AND campaigns.id = :campaign"
    statement = text(_IDS[connection.dialect.name].format(status=status, whose=whose))
    given = {"after": after, "limit": limit, **({} if campaign is None else {"campaign": campaign})}
    return list(connection.execute(statement, given).scalars())


def retry(connection: Connection, job: int) -> None:
    """Put a quarantined job back into the queue, with all its attempts before it, each of them alone.

    Raises:
        NotFound: There is no such job.
        Conflict: It is not in quarantine, its campaign has ended, or its generation went on without it.
    """
    row = connection.execute(
        select(JobRow.status, JobRow.kind, JobRow.campaign_id, JobRow.number, JobRow.attempt).where(
            JobRow.id == job
        )
    ).one_or_none()
    campaign = find_campaign(connection, row.campaign_id, lock=True) if row is not None else None
    if row is None or campaign is None:
        raise NotFound(f"job {job}: no such job")
    if row.status != JobStatus.QUARANTINED:
        raise Conflict(f"job {job} is {row.status}; only a quarantined job can be retried")
    if row.kind == JobKind.EPISODE:
        _check_awaited(connection, job, campaign, row.number)
    changed = connection.execute(
        update(JobRow)
        .where(JobRow.id == job, JobRow.status == JobStatus.QUARANTINED)
        .values(
            status=JobStatus.QUEUED,
            max_attempts=row.attempt + campaign.body.execution.max_attempts,
            not_before=None,
            lease_token=None,
            finished_at=None,
        )
    )
    if changed.rowcount == 0:
        raise Conflict(f"job {job} was changed by somebody else just now; look again")
    note_change(connection, campaign.id)
    announce(connection)


def _check_awaited(connection: Connection, job: int, campaign: Campaign, number: int) -> None:
    """Raise Conflict unless a campaign still waits for a solution."""
    if campaign.status in ENDED:
        raise Conflict(f"job {job}: campaign {campaign.id} is {campaign.status}; nobody waits for it")
    verdict = connection.execute(
        select(SolutionRow.verdict).where(
            SolutionRow.campaign_id == campaign.id, SolutionRow.number == number
        )
    ).scalar_one()
    if verdict != SolutionVerdict.PENDING:
        raise Conflict(f"job {job}: the campaign went on without solution {number}, which counts as failed")

"""Jobs as those see them who look after them."""

from collections import Counter

from sqlalchemy import Connection

from brink.server.api.schemas import JobCounts
from brink.server.campaigns.store import ENDED
from brink.server.queue.job_store import count_jobs
from brink.server.queue.workers import live_capabilities
from brink.server.states import CampaignStatus, JobKind, JobStatus


def job_counts(connection: Connection, worker_seen_s: float) -> JobCounts:
    """Return how many jobs are not done, by what they have in common."""
    counts = sorted(count_jobs(connection), key=lambda one: (one.campaign, one.status, one.needs, one.kind))
    able = set().union(*live_capabilities(connection, worker_seen_s).values())
    unrunnable: Counter[str] = Counter()
    paused = set()
    for one in counts:
        handed_out = (
            one.campaign_status is CampaignStatus.RUNNING or one.kind == JobKind.TRACE
        )  # traces are made after the end, too
        if one.status is JobStatus.QUEUED and not handed_out:
            paused.add(one.campaign)
        elif one.status is JobStatus.QUEUED and one.needs not in able:
            unrunnable[one.needs] += one.jobs
    return JobCounts(
        status=[one.status for one in counts], campaign=[one.campaign for one in counts],
        kind=[one.kind for one in counts], needs=[one.needs for one in counts],
        jobs=[one.jobs for one in counts],
        campaigns={one.campaign: one.name for one in counts},
        paused=sorted(paused), ended=sorted({one.campaign for one in counts if one.campaign_status in ENDED}),
        unrunnable=dict(unrunnable),
    )  # fmt: skip

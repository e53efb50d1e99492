"""Traces that are kept, and the jobs that record them."""

from sqlalchemy import Connection, select

from brink.server.campaigns.store import Campaign
from brink.server.db.models import SolutionRow, TraceRow
from brink.server.queue import job_store
from brink.server.queue.job_store import Job
from brink.server.states import JobKind


def find_trace(connection: Connection, campaign_id: str, number: int) -> bytes | None:
    """Return the trace of a solution if it is kept."""
    query = (
        select(TraceRow.data)
        .join(SolutionRow, SolutionRow.spec_hash == TraceRow.spec_hash)
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.number == number)
    )
    return connection.execute(query).scalar_one_or_none()


def trace_key(connection: Connection, campaign_id: str, number: int) -> str | None:
    """Return the key of a solution's trace if it is kept: equal simulations share one trace."""
    query = (
        select(TraceRow.spec_hash)
        .join(SolutionRow, SolutionRow.spec_hash == TraceRow.spec_hash)
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.number == number)
    )
    return connection.execute(query).scalar_one_or_none()


def simulator_of(connection: Connection, campaign_id: str, number: int) -> str | None:
    """Return the capability that recording a solution's trace needs, or None if it was not simulated."""
    job = job_store.find_job_of(connection, campaign_id, number, JobKind.EPISODE)
    return None if job is None else job.needs


def trace_job(connection: Connection, campaign_id: str, number: int) -> Job | None:
    """Return the job that records a solution's trace, or None."""
    return job_store.find_job_of(connection, campaign_id, number, JobKind.TRACE)


def request_trace(connection: Connection, campaign: Campaign, number: int) -> bool:
    """Enqueue the trace of a solution unless it is enqueued already; return whether that is possible."""
    job_store.enqueue_traces(connection, campaign.id, [number], campaign.job_settings)
    return trace_job(connection, campaign.id, number) is not None

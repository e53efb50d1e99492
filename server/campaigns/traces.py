"""Traces that are kept, and the jobs that make them."""

from typing import Any

from sqlalchemy import Connection, Row, select

from brink.server.campaigns.step_store import enqueue_traces
from brink.server.campaigns.values import Campaign
from brink.server.db.models import JobRow, SolutionRow, TraceRow
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
    """Return by what the trace of a solution is known if it is kept: the same simulation has the same trace."""
    query = (
        select(TraceRow.spec_hash)
        .join(SolutionRow, SolutionRow.spec_hash == TraceRow.spec_hash)
        .where(SolutionRow.campaign_id == campaign_id, SolutionRow.number == number)
    )
    return connection.execute(query).scalar_one_or_none()


def simulator_of(connection: Connection, campaign_id: str, number: int) -> str | None:
    """Return what a worker must be capable of to make the trace of a solution; None if it was not simulated."""
    query = select(JobRow.needs).where(
        JobRow.campaign_id == campaign_id, JobRow.number == number, JobRow.kind == JobKind.EPISODE
    )
    return connection.execute(query).scalar_one_or_none()


def trace_job(connection: Connection, campaign_id: str, number: int) -> Row[*tuple[Any, ...]] | None:
    """Return status and last error of the job that makes a trace, if there is one."""
    query = select(JobRow.status, JobRow.last_error).where(
        JobRow.campaign_id == campaign_id, JobRow.number == number, JobRow.kind == JobKind.TRACE
    )
    return connection.execute(query).one_or_none()


def request_trace(connection: Connection, campaign: Campaign, number: int) -> bool:
    """Enqueue the trace of a solution unless it is enqueued already; return whether that is possible."""
    enqueue_traces(connection, campaign, [number])
    return trace_job(connection, campaign.id, number) is not None

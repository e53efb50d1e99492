"""Waiting for the trace of a solution: kept, or made by a worker while somebody asks.

Nobody waits, and nothing is asked for, while there is no live worker that could make it.
"""

import asyncio
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Query, Request
from fastapi.responses import JSONResponse
from sqlalchemy import Connection

from brink.server.api.context import Context, client_gone
from brink.server.api.schemas import BeingMade, ProblemDetail
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.traces import find_trace, simulator_of, trace_job
from brink.server.db.engine import read
from brink.server.errors import Conflict, NotFound, NoWorker
from brink.server.queue.job_store import Job
from brink.server.queue.workers import can_run
from brink.server.states import JobStatus
from brink.sim.errors import SimulatorError

LOOK_AGAIN_S = 0.25
NO_WORKER_RETRY_S = 5

NOT_YET: dict[int | str, dict[str, Any]] = {
    202: {"model": BeingMade, "description": "Being made; ask again after `Retry-After`."},
    503: {
        "model": ProblemDetail,
        "description": "No live worker can make it; ask again after `Retry-After`.",
    },
}
"""What a route that needs a trace answers while there is none."""

UNREADABLE = (
    SimulatorError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError, MemoryError,
)  # fmt: skip
"""What drawing a trace may raise: a worker may send anything, and that is no fault of the coordinator."""

Wait = Annotated[float, Query(ge=0, le=60, description="How long to wait for workers to make the trace.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """Where the trace of a solution stands."""

    kept: bytes | None
    needs: str | None
    job: Job | None
    away: bool
    """Nobody could make it now."""


async def trace_of(
    services: Context, campaign: Campaign, number: int, request: Request, wait_s: float
) -> bytes | None:
    """Return the trace of a solution, waiting for a worker to make it; None if it takes longer.

    Args:
        services: Of this process.
        campaign: Whose solution it is.
        number: The solution.
        request: Who asks; waiting ends when they go.
        wait_s: How long to wait.

    Raises:
        NotFound: There is no such solution, or it was not simulated.
        Conflict: Its simulator records none, or the trace cannot be made.
        NoWorker: No live worker can make it.
    """
    deadline = asyncio.get_running_loop().time() + wait_s

    def look(connection: Connection) -> _Look:
        kept = find_trace(connection, campaign.id, number)
        needs = simulator_of(connection, campaign.id, number)
        job = trace_job(connection, campaign.id, number)
        waits = kept is None and needs is not None and (job is None or job.status == JobStatus.QUEUED)
        away = waits and not can_run(connection, str(needs), services.settings.worker_seen_s)
        return _Look(kept=kept, needs=needs, job=job, away=away)

    async with client_gone(request) as gone:
        while True:
            seen = await read(services.engines, look)
            if seen.kept is not None:
                return seen.kept
            if seen.needs is None:
                raise NotFound(f"campaign {campaign.id} has no simulated solution {number}")
            if seen.away:
                raise NoWorker(
                    f"solution {number}: no live worker can run {seen.needs} to make the trace; start one, "
                    "and ask again",
                    retry_after_s=NO_WORKER_RETRY_S,
                )
            if seen.job is None:
                await services.campaigns.request_trace(campaign.id, number)
                continue
            if seen.job.status == JobStatus.DONE:
                raise Conflict(f"solution {number}: its simulator records no traces")
            if seen.job.status in (JobStatus.QUARANTINED, JobStatus.CANCELLED):
                raise Conflict(f"solution {number}: the trace cannot be made: {seen.job.last_error}")
            late = asyncio.get_running_loop().time() >= deadline
            if late or gone.is_set() or services.queue.stopping:
                return None
            await asyncio.sleep(LOOK_AGAIN_S)


def being_made() -> JSONResponse:
    """Return the answer of who would have to wait longer."""
    view = BeingMade(detail="a worker is asked to make the trace; ask again soon")
    return JSONResponse(view.model_dump(), status_code=202, headers={"Retry-After": "2"})

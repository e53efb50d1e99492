"""Routes of jobs and workers: the worker protocol, and the views for operators."""

from collections import Counter
from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response
from sqlalchemy import Connection

from brink.server.api.context import Services, client_gone
from brink.server.api.responses import NOT_MODIFIED, set_etag
from brink.server.api.schemas import MAX_NUMBER, JobCounts, JobList, JobViewModel, WorkerView
from brink.server.api.wire_routes import WireRoute
from brink.server.db.engine import read
from brink.server.errors import NotFound
from brink.server.queue.job_store import count_jobs, list_jobs
from brink.server.queue.workers import list_workers, live_capabilities
from brink.server.states import ENDED, CampaignStatus, JobKind, JobStatus
from brink.sim.catalogue import worker_for
from brink.worker.wire import (
    HeartbeatReply,
    HeartbeatRequest,
    LeaseReply,
    LeaseRequest,
    ResultsReply,
    ResultsRequest,
)

router = APIRouter(tags=["jobs"])
wire = APIRouter(tags=["jobs"], route_class=WireRoute)


@wire.post("/jobs/lease")
async def lease_jobs(message: LeaseRequest, request: Request, services: Services) -> LeaseReply:
    """Lease jobs, waiting up to `wait_s` seconds for them."""
    async with client_gone(request) as gone:
        return await services.queue.lease(message, gone)


@wire.post("/jobs/heartbeat")
async def renew_leases(message: HeartbeatRequest, request: Request, services: Services) -> HeartbeatReply:
    """Renew leases; the reply lists the jobs that the worker still holds."""
    return await services.queue.heartbeat(message)


@wire.post("/jobs/results")
async def report_results(message: ResultsRequest, request: Request, services: Services) -> ResultsReply:
    """Report results and, if requested, lease the next jobs."""
    async with client_gone(request) as gone:
        return await services.queue.results(message, gone)


@router.get("/jobs", responses=NOT_MODIFIED)
async def get_jobs(
    services: Services,
    request: Request,
    response: Response,
    status: Annotated[list[JobStatus] | None, Query(description="Only jobs in these states.")] = None,
    campaign: Annotated[str | None, Query(max_length=16, pattern="^[0-9a-z]*$")] = None,
    after: Annotated[int, Query(ge=0, le=MAX_NUMBER)] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> JobList:
    """List jobs in ascending order of id. Supports conditional requests with ETag."""
    jobs = await read(
        services.engines,
        lambda connection: list_jobs(
            connection, statuses=status or (), campaign=campaign, after=after, limit=limit
        ),
    )
    views = [JobViewModel.model_validate(job, from_attributes=True) for job in jobs]
    view = JobList(jobs=views, next=views[-1].id if len(views) == limit else None)
    set_etag(request, response, view)
    return view


@router.get("/jobs/counts", responses=NOT_MODIFIED)
async def get_job_counts(services: Services, request: Request, response: Response) -> JobCounts:
    """Count unfinished jobs by campaign and required capability. Supports conditional requests with ETag."""
    seen_s = services.settings.worker_seen_s
    view = await read(services.engines, lambda connection: job_counts(connection, seen_s))
    set_etag(request, response, view)
    return view


@router.post("/jobs/{job}/retry", status_code=204)
async def retry_job(job: Annotated[int, Path(ge=0, le=MAX_NUMBER)], services: Services) -> None:
    """Put a quarantined job back into the queue."""
    await services.campaigns.retry_job(job)


@router.get("/workers", tags=["workers"], responses=NOT_MODIFIED)
async def get_workers(services: Services, request: Request, response: Response) -> list[WorkerView]:
    """List workers, most recently seen first. Supports conditional requests with ETag."""
    seen = await read(services.engines, list_workers)
    horizon = services.settings.worker_seen_s
    views = [
        WorkerView.model_validate({**asdict(w), "live": w.seen_s_ago <= horizon and not w.gone}) for w in seen
    ]
    set_etag(request, response, views, leave_out=("seen_s_ago",))
    return views


@router.post("/workers/{worker_id}/drain", status_code=204, tags=["workers"])
async def drain_worker(
    worker_id: Annotated[str, Path(min_length=1, max_length=64)], services: Services
) -> None:
    """Have a worker finish the jobs that it holds, take no more, and exit. Needs scope admin."""
    if not await services.queue.drain(worker_id):
        raise NotFound(f"worker {worker_id}: no such worker")


def job_counts(connection: Connection, worker_seen_s: float) -> JobCounts:
    """Return the counts of unfinished jobs, and which of these jobs cannot run now."""
    counts = sorted(count_jobs(connection), key=lambda one: (one.campaign, one.status, one.needs, one.kind))
    able = set().union(*live_capabilities(connection, worker_seen_s).values())
    unrunnable: Counter[str] = Counter()
    paused = set()
    for one in counts:
        # Traces are recorded after a campaign has ended, too.
        handed_out = one.campaign_status is CampaignStatus.RUNNING or one.kind == JobKind.TRACE
        if one.status is JobStatus.QUEUED and not handed_out:
            paused.add(one.campaign)
        elif one.status is JobStatus.QUEUED and one.needs not in able:
            unrunnable[one.needs] += one.jobs
    return JobCounts(
        status=[one.status for one in counts],
        campaign=[one.campaign for one in counts],
        kind=[one.kind for one in counts],
        needs=[one.needs for one in counts],
        jobs=[one.jobs for one in counts],
        campaigns={one.campaign: one.name for one in counts},
        paused=sorted(paused),
        ended=sorted({one.campaign for one in counts if one.campaign_status in ENDED}),
        unrunnable=dict(unrunnable),
        waits_for={needs: worker_for(needs) for needs in unrunnable},
    )

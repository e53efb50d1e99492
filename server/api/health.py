"""Routes at the root: is the process alive, can it serve, what does it measure."""

import asyncio

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Gauge, generate_latest
from sqlalchemy import Connection, func, select, text

from server.api.context import Services
from server.api.problem_details import problem
from server.campaigns.service import read
from server.db.clock import database_now
from server.db.models import CampaignRow, CampaignStatus, JobRow, JobStatus
from server.db.upgrade import current_revision, head_revision
from server.errors import DatabaseError
from server.queue.workers import list_seen

router = APIRouter(tags=["operations"])
READY_S = 5.0


@router.get("/healthz", response_class=PlainTextResponse)
async def healthz() -> str:
    """Answer if the process is alive."""
    return "ok\n"


@router.get("/readyz", response_class=PlainTextResponse)
async def readyz(services: Services) -> Response:
    """Answer 200 if the database answers, takes writes, and has this version's schema; otherwise 503."""
    try:
        loop = asyncio.get_running_loop()
        revision = await loop.run_in_executor(None, current_revision, services.engines)
        writing = asyncio.wrap_future(services.queue.writer.submit(lambda c: c.execute(text("SELECT 1"))))
        await asyncio.wait_for(writing, READY_S)
        if trouble := services.queue.writer.trouble:  # a full disk still answers a question
            return problem(503, "Not ready", trouble.reason)
    except (DatabaseError, TimeoutError) as error:
        return problem(503, "Not ready", str(error) or "the database takes no writes")
    if revision != head_revision():
        return problem(503, "Not ready", f"schema {revision}, expected {head_revision()}")
    return PlainTextResponse("ready\n")


@router.get("/metrics", response_class=PlainTextResponse)
async def metrics(services: Services) -> Response:
    """Return the state of campaigns, jobs and workers, and what this process measured, for Prometheus."""
    registry = CollectorRegistry()
    jobs = Gauge(
        "brink_jobs", "Jobs that are not done, by state", ["status", "kind", "needs"], registry=registry
    )
    campaigns = Gauge("brink_campaigns", "Campaigns by state", ["status"], registry=registry)
    workers = Gauge("brink_workers_live", "Workers heard of lately", registry=registry)
    depth = Gauge(
        "brink_queue_depth",
        "Open jobs of running campaigns",
        ["campaign", "needs", "status"],
        registry=registry,
    )
    unrenewed = Gauge(
        "brink_lease_unrenewed_seconds", "Longest time since a held lease was granted or renewed",
        registry=registry,
    )  # fmt: skip
    oldest = Gauge("brink_oldest_queued_seconds", "Age of the job that waits longest", registry=registry)

    def collect(connection: Connection) -> None:
        # Those done are counted as results: all jobs that ever were would take longer and longer.
        counted = (
            select(JobRow.status, JobRow.kind, JobRow.needs, func.count())
            .where(JobRow.status.in_([status for status in JobStatus if status is not JobStatus.DONE]))
            .group_by(JobRow.status, JobRow.kind, JobRow.needs)
        )
        for status, kind, needs, count in connection.execute(counted):
            jobs.labels(status, kind, needs).set(count)
        states = select(CampaignRow.status, func.count()).group_by(CampaignRow.status)
        for status, count in connection.execute(states):
            campaigns.labels(status).set(count)
        is_open = JobRow.status.in_([JobStatus.QUEUED, JobStatus.LEASED])
        by_campaign = (
            select(JobRow.campaign_id, JobRow.needs, JobRow.status, func.count())
            .join(CampaignRow, CampaignRow.id == JobRow.campaign_id)
            .where(is_open, CampaignRow.status == CampaignStatus.RUNNING)
            .group_by(JobRow.campaign_id, JobRow.needs, JobRow.status)
        )
        for campaign, needs, status, count in connection.execute(by_campaign):
            depth.labels(campaign, needs, status).set(count)
        now = database_now(connection)
        expires = select(func.min(JobRow.lease_expires_at)).where(JobRow.status == JobStatus.LEASED)
        if (first := connection.execute(expires).scalar_one()) is not None:
            left_s = (first - now).total_seconds()
            unrenewed.set(max(0.0, services.settings.lease_s - left_s))
        waits = select(func.min(JobRow.created_at)).where(JobRow.status == JobStatus.QUEUED)
        if (since := connection.execute(waits).scalar_one()) is not None:
            oldest.set(max(0.0, (now - since).total_seconds()))
        workers.set(len(list_seen(connection, within_s=services.settings.worker_seen_s)))

    await read(services.engines, collect)
    told = generate_latest(registry) + generate_latest(services.metrics.registry)
    return Response(told, media_type=CONTENT_TYPE_LATEST)

"""Routes at the root: is the process alive, can it serve, what does it measure."""

import asyncio
import logging

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Gauge, generate_latest
from sqlalchemy import Connection, func, select, text

from brink.server.api.context import Services
from brink.server.api.problem_details import problem
from brink.server.db.engine import read
from brink.server.db.models import CampaignRow
from brink.server.db.sql import database_now
from brink.server.db.upgrade import current_revision, head_revision
from brink.server.errors import DatabaseError
from brink.server.queue.job_store import count_jobs, next_expiry
from brink.server.queue.workers import live_capabilities
from brink.server.states import CampaignStatus, JobStatus

log = logging.getLogger(__name__)
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
            log.warning("not ready: %s", trouble.reason)
            return problem(503, "Not ready", "the database took no writes lately; the log says why")
    except DatabaseError as error:  # which names it: strangers come here, too
        log.warning("not ready: %s", error)
        return problem(503, "Not ready", "the database does not answer; the log says why")
    except TimeoutError:
        return problem(503, "Not ready", "the database takes no writes")
    if revision != head_revision():
        return problem(503, "Not ready", f"schema {revision}, expected {head_revision()}")
    return PlainTextResponse("ready\n")


@router.get("/metrics", response_class=PlainTextResponse)
async def metrics(services: Services) -> Response:
    """Return the state of campaigns, jobs and workers, and what this process measured, for Prometheus."""
    registry = CollectorRegistry()
    jobs = Gauge(
        "brink_jobs",
        "Jobs that are queued, leased or in quarantine",
        ["status", "kind", "needs"],
        registry=registry,
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
        now, waits = database_now(connection), [0.0]
        for count in count_jobs(connection):
            jobs.labels(count.status, count.kind, count.needs).inc(count.jobs)
            if count.campaign_status is CampaignStatus.RUNNING and count.status is not JobStatus.QUARANTINED:
                depth.labels(count.campaign, count.needs, count.status).inc(count.jobs)
            if count.status is JobStatus.QUEUED:
                waits.append((now - count.oldest).total_seconds())
        oldest.set(max(waits))
        states = select(CampaignRow.status, func.count()).group_by(CampaignRow.status)
        for status, number in connection.execute(states):
            campaigns.labels(status).set(number)
        if (first := next_expiry(connection)) is not None:
            left_s = (first - now).total_seconds()
            unrenewed.set(max(0.0, services.settings.lease_s - left_s))
        workers.set(len(live_capabilities(connection, services.settings.worker_seen_s)))

    await read(services.engines, collect)
    told = generate_latest(registry) + generate_latest(services.metrics.registry)
    return Response(told, media_type=CONTENT_TYPE_LATEST)

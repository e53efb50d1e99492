"""Metrics of the queue, read from the database for each scrape: jobs, campaigns, workers.

Every coordinator on a database reports the same values, so several coordinators call for the maximum, not the sum.
"""

from typing import Final

from prometheus_client import CollectorRegistry, Gauge
from sqlalchemy import Connection, func, select

from brink.server.db.models import CampaignRow
from brink.server.db.sql import database_now
from brink.server.queue.job_store import JobCount, count_jobs, next_expiry
from brink.server.queue.workers import live_capabilities
from brink.server.settings import Settings
from brink.server.states import CampaignStatus, JobKind, JobStatus
from brink.sim.catalogue import WORKER_KINDS, worker_kind

_GAUGES: Final = {
    "brink_jobs": ("Jobs that are queued, leased or in quarantine", ["status", "kind", "needs"]),
    "brink_queue_depth": ("Open jobs of running campaigns", ["campaign", "needs", "status"]),
    "brink_open_jobs": (
        "Open jobs of running campaigns, and recordings, by the kind of worker that can run them",
        ["worker"],
    ),
    "brink_campaigns": ("Campaigns by state", ["status"]),
    "brink_workers_live": ("Live workers", []),
    "brink_lease_unrenewed_seconds": ("Longest time since an active lease was granted or renewed", []),
    "brink_oldest_queued_seconds": ("Age of the oldest queued job", []),
}


def queue_metrics(connection: Connection, settings: Settings) -> CollectorRegistry:
    """Return the metrics of the queue.

    Args:
        connection: Sees one snapshot.
        settings: The coordinator's settings.
    """
    registry = CollectorRegistry()
    gauges = {
        name: Gauge(name, words, labels, registry=registry) for name, (words, labels) in _GAUGES.items()
    }
    for kind in WORKER_KINDS:
        gauges["brink_open_jobs"].labels(kind)  # so that an autoscaler can tell 0 from an absent coordinator
    now, waits = database_now(connection), [0.0]
    for count in count_jobs(connection):
        _add(gauges, count)
        if count.status is JobStatus.QUEUED:
            waits.append((now - count.oldest).total_seconds())
    gauges["brink_oldest_queued_seconds"].set(max(waits))
    states = select(CampaignRow.status, func.count()).group_by(CampaignRow.status)
    for status, number in connection.execute(states):
        gauges["brink_campaigns"].labels(status).set(number)
    if (first := next_expiry(connection)) is not None:
        left_s = (first - now).total_seconds()
        gauges["brink_lease_unrenewed_seconds"].set(max(0.0, settings.lease_s - left_s))
    gauges["brink_workers_live"].set(len(live_capabilities(connection, settings.worker_seen_s)))
    return registry


def _add(gauges: dict[str, Gauge], count: JobCount) -> None:
    """Add the jobs of one campaign with the same status, kind and required capability."""
    gauges["brink_jobs"].labels(count.status, count.kind, count.needs).inc(count.jobs)
    if count.status is JobStatus.QUARANTINED:
        return
    running = count.campaign_status is CampaignStatus.RUNNING
    if running:
        gauges["brink_queue_depth"].labels(count.campaign, count.needs, count.status).inc(count.jobs)
    if running or count.kind == JobKind.TRACE:  # those of campaigns that have ended are recorded all the same
        gauges["brink_open_jobs"].labels(worker_kind(count.needs)).inc(count.jobs)

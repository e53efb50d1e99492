"""The SQL of campaigns: rows in, plain values out.

Functions that write are units for `brink.server.db.writer.Writer`; functions that read take a connection of
the reader, which sees one snapshot.
"""

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, delete, func, insert, select, update

from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.values import Campaign
from brink.server.db.clock import database_now
from brink.server.db.listing import named_row, newest_first
from brink.server.db.models import (
    EVALUATES,
    NEXT_SEQUENCE,
    CampaignRow,
    JobRow,
    RepeatsRow,
    TraceRow,
    has_open_jobs,
)
from brink.server.db.news import announce
from brink.server.states import CampaignStatus, JobStatus

ENDED = (CampaignStatus.FINISHED, CampaignStatus.CANCELLED, CampaignStatus.FAILED)


def insert_campaign(
    connection: Connection, campaign_id: str, body: CampaignBody, document_hash: str, key: str | None
) -> None:
    """Store a new campaign, running, with nothing asked yet.

    Args:
        connection: In a write transaction.
        campaign_id: Its id.
        body: With every parameter spelled out.
        document_hash: Of the body as it was submitted.
        key: Idempotency key.
    """
    connection.execute(
        insert(CampaignRow).values(
            id=campaign_id, name=body.name, document=body.model_dump(mode="json"),
            document_hash=document_hash, idempotency_key=key, status=CampaignStatus.RUNNING,
            status_reason="", seed=body.seed, priority=body.priority, budget=body.budget.simulations,
            generation=0, evaluated=0, unsafe=0, failed=0, failures_accepted=0, turn=0,
            created_at=database_now(connection), finished_at=None,
        )
    )  # fmt: skip


def find_campaign(connection: Connection, campaign_id: str, *, lock: bool = False) -> Campaign | None:
    """Return a campaign, or None; with `lock`, hold its row until the transaction ends."""
    query = select(CampaignRow.__table__).where(CampaignRow.id == campaign_id)
    if lock and connection.dialect.name != "sqlite":
        query = query.with_for_update()
    row = connection.execute(query).one_or_none()
    return None if row is None else campaign_of(row)


def find_by_key(connection: Connection, key: str) -> Campaign | None:
    """Return the campaign that was submitted with an idempotency key, or None."""
    row = connection.execute(
        select(CampaignRow.__table__).where(CampaignRow.idempotency_key == key)
    ).one_or_none()
    return None if row is None else campaign_of(row)


def named_campaign(connection: Connection, name: str) -> Campaign:
    """Return a campaign by its id, or by the beginning of its id if that is unique.

    Raises:
        NotFound: There is none, or more than one.
    """
    return campaign_of(named_row(connection, CampaignRow.__table__, name, "campaign"))


def list_campaigns(
    connection: Connection,
    *,
    limit: int,
    before: tuple[datetime, str] | None = None,
    document_hash: str | None = None,
    statuses: Sequence[CampaignStatus] = (),
) -> list[Campaign]:
    """Return campaigns, newest first."""
    query = newest_first(CampaignRow.__table__, limit=limit, before=before)
    if document_hash is not None:
        query = query.where(CampaignRow.document_hash == document_hash)
    if statuses:
        query = query.where(CampaignRow.status.in_(statuses))
    return [campaign_of(row) for row in connection.execute(query)]


def running_among(connection: Connection, campaigns: Sequence[str]) -> frozenset[str]:
    """Return which of these campaigns are running."""
    if not campaigns:
        return frozenset()
    query = select(CampaignRow.id).where(
        CampaignRow.id.in_(list(campaigns)), CampaignRow.status == CampaignStatus.RUNNING
    )
    return frozenset(connection.execute(query).scalars())


def running_idle(connection: Connection) -> list[str]:
    """Return running campaigns without an open episode: their next step is due."""
    idle = ~has_open_jobs(CampaignRow.id)
    query = select(CampaignRow.id).where(CampaignRow.status == CampaignStatus.RUNNING, idle)
    return list(connection.execute(query).scalars())


def end_running(
    connection: Connection,
    campaign_id: str,
    generation: int,
    status: CampaignStatus,
    reason: str,
    *,
    failures: int | None = None,
) -> None:
    """Change what a campaign is, unless somebody changed or advanced it meanwhile.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        generation: Where it must still stand.
        status: What it becomes.
        reason: Why.
        failures: How many failed candidates whoever resumes it accepts.
    """
    campaign = find_campaign(connection, campaign_id, lock=True)
    if (
        campaign is not None
        and campaign.status is CampaignStatus.RUNNING
        and campaign.generation == generation
    ):
        set_status(connection, campaign_id, status, reason, failures_accepted=failures)


def set_status(
    connection: Connection,
    campaign_id: str,
    status: CampaignStatus,
    reason: str,
    *,
    failures_accepted: int | None = None,
) -> None:
    """Change what a campaign is; on cancelling, its open episodes end too, but not the pictures asked for."""
    values: dict[str, Any] = {"status": status, "status_reason": reason, "sequence": NEXT_SEQUENCE}
    if status in (CampaignStatus.FINISHED, CampaignStatus.CANCELLED, CampaignStatus.FAILED):
        values["finished_at"] = database_now(connection)
    if failures_accepted is not None:
        values["failures_accepted"] = failures_accepted
    connection.execute(update(CampaignRow).where(CampaignRow.id == campaign_id).values(values))
    if status is CampaignStatus.RUNNING:
        announce(connection)
    if status is CampaignStatus.CANCELLED:
        connection.execute(
            update(JobRow)
            .where(
                JobRow.campaign_id == campaign_id,
                EVALUATES,
                JobRow.status.in_([JobStatus.QUEUED, JobStatus.LEASED]),
            )
            .values(
                status=JobStatus.CANCELLED,
                lease_token=None,
                lease_expires_at=None,
                finished_at=database_now(connection),
            )
        )


def count_quarantined(connection: Connection, campaign_id: str) -> int:
    """Return how many of a campaign's episodes are in quarantine."""
    return connection.execute(
        select(func.count()).where(
            JobRow.campaign_id == campaign_id,
            EVALUATES,
            JobRow.status == JobStatus.QUARANTINED,
        )
    ).scalar_one()


def delete_campaign(connection: Connection, campaign_id: str) -> None:
    """Delete a campaign with its repeats and all that is theirs, traces included that no other campaign has."""
    own = select(JobRow.spec_hash).where(JobRow.campaign_id == campaign_id)
    others = select(JobRow.id).where(
        JobRow.spec_hash == TraceRow.spec_hash, JobRow.campaign_id != campaign_id
    )
    again = select(RepeatsRow.campaign_id).where(RepeatsRow.of_id == campaign_id)
    for repeats in list(connection.execute(again).scalars()):
        delete_campaign(connection, repeats)
    connection.execute(delete(TraceRow).where(TraceRow.spec_hash.in_(own), ~others.exists()))
    connection.execute(delete(CampaignRow).where(CampaignRow.id == campaign_id))


def campaign_of(row: Row[*tuple[Any, ...]]) -> Campaign:
    """Return the campaign that a row of its table says."""
    return Campaign(
        id=row.id, body=CampaignBody.model_validate(row.document), document_hash=row.document_hash,
        status=CampaignStatus(row.status),
        status_reason=row.status_reason, generation=row.generation, evaluated=row.evaluated,
        unsafe=row.unsafe, failed=row.failed, measured=row.measured, failures_accepted=row.failures_accepted,
        sequence=row.sequence, created_at=row.created_at, finished_at=row.finished_at,
    )  # fmt: skip

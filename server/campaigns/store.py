"""The SQL of campaigns: rows, status, tags, retries.

Functions that write are units for `brink.server.db.writer.Writer`; functions that read take a connection of the
reader, which sees one snapshot.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, delete, insert, select, update

from brink.server.campaigns.body import CampaignBody, CampaignChange, search_text, search_words
from brink.server.db.models import NEXT_SEQUENCE, CampaignRow, CampaignTagRow, SolutionRow
from brink.server.db.sql import DocumentTable, database_now, in_list, note_change
from brink.server.errors import Conflict, NotFound
from brink.server.problems.catalogue import former_settings
from brink.server.queue import job_store
from brink.server.queue.job_store import JobSettings
from brink.server.queue.wakeups import notify_coordinators
from brink.server.states import ENDED, CampaignStatus, JobKind, JobStatus, SolutionVerdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A campaign as it is stored.

    Attributes:
        body: What was submitted, with every parameter spelled out, and with its tags and notes as they are now.
        document_hash: Hash of the body as it was submitted.
        generation: Number of completed generations.
        generation_end: First number that belongs to a later generation than the current one; None in a campaign that
            was submitted when there was one generation at a time.
        failures_accepted: Failed candidates that do not pause the campaign.
        sequence: Increases with every change, except when jobs are leased and reported within a generation.
    """

    id: str
    body: CampaignBody
    document_hash: str
    status: CampaignStatus
    status_reason: str
    generation: int
    generation_end: int | None
    evaluated: int
    unsafe: int
    failed: int
    measured: int
    failures_accepted: int
    sequence: int
    created_at: datetime
    finished_at: datetime | None

    @property
    def budget(self) -> int:
        """Maximum number of simulations."""
        return self.body.budget.simulations

    @property
    def completed(self) -> int:
        """Candidates of completed generations: evaluated, measured on a data set, or failed."""
        return self.evaluated + self.measured + self.failed

    @property
    def job_settings(self) -> JobSettings:
        """The settings of its jobs."""
        execution = self.body.execution
        return JobSettings(
            cache=execution.cache, max_attempts=execution.max_attempts, max_losses=execution.max_losses
        )


_TAGS = select(CampaignTagRow.campaign_id, CampaignTagRow.tag).where(
    in_list(CampaignTagRow.campaign_id, "campaigns")
)


def campaigns_of(connection: Connection, rows: Sequence[Row[*tuple[Any, ...]]]) -> list[Campaign]:
    """Return the campaigns stored in rows with all columns of the table."""
    tags = read_tags(connection, [row.id for row in rows])
    return [_campaign(row, tags[row.id]) for row in rows]


def read_tags(connection: Connection, campaigns: Sequence[str]) -> dict[str, list[str]]:
    """Return the tags of each of the given campaigns, in alphabetical order."""
    tags: dict[str, list[str]] = {campaign: [] for campaign in campaigns}
    if campaigns:
        for campaign, tag in connection.execute(_TAGS, {"campaigns": list(tags)}):
            tags[campaign].append(tag)
    return {campaign: sorted(found) for campaign, found in tags.items()}


def stored_body(document: Mapping[str, Any], tags: Iterable[str], notes: str) -> CampaignBody:
    """Return the body of a stored campaign.

    Every parameter is spelled out in a stored body. One that is missing was added later, and has the value that the
    campaign was run with, which need not be today's default.

    Args:
        document: What `CampaignBody.document` returned.
        tags: Its tags.
        notes: Its notes.

    Raises:
        ValidationError: The document is not that of a campaign.
    """
    body = CampaignBody.model_validate({**document, "tags": list(tags), "notes": notes})
    params = {**former_settings(body.algorithm.id), **body.algorithm.params}
    return body.model_copy(update={"algorithm": body.algorithm.model_copy(update={"params": params})})


def _campaign(row: Row[*tuple[Any, ...]], tags: list[str]) -> Campaign:
    body = stored_body(row.document, tags, row.notes)
    return Campaign(
        id=row.id,
        body=body,
        document_hash=row.document_hash,
        status=CampaignStatus(row.status),
        status_reason=row.status_reason,
        generation=row.generation,
        generation_end=row.generation_end,
        evaluated=row.evaluated,
        unsafe=row.unsafe,
        failed=row.failed,
        measured=row.measured,
        failures_accepted=row.failures_accepted,
        sequence=row.sequence,
        created_at=row.created_at,
        finished_at=row.finished_at,
    )


CAMPAIGNS = DocumentTable(
    kind="campaign", table=CampaignRow.__table__, build=campaigns_of, shown=CampaignRow.deleted_at.is_(None)
)


def labelled(tags: Sequence[str], search: str) -> list[ColumnElement[bool]]:
    """Return the condition that a campaign has all of these tags, and all of these words in its name, notes or tags.

    Args:
        tags: Tags as `check_tag` returns them.
        search: Words; case does not matter.
    """
    row = CampaignRow
    tagged = [
        row.id.in_(select(CampaignTagRow.campaign_id).where(CampaignTagRow.tag == tag))
        for tag in dict.fromkeys(tags)
    ]
    said = [row.search_text.contains(word, autoescape=True) for word in dict.fromkeys(search_words(search))]
    return [*tagged, *said]


def change_campaign(connection: Connection, campaign: Campaign, change: CampaignChange) -> bool:
    """Change the tags and notes of a campaign; return whether they differ from before.

    Args:
        connection: In a write transaction that has locked the campaign.
        campaign: The campaign as it is stored.
        change: What to change.

    Raises:
        InvalidInput: It would have too many tags.
    """
    before = campaign.body
    tags, notes = change.tags_after(before.tags), before.notes if change.notes is None else change.notes
    if (tags, notes) == (before.tags, before.notes):
        return False
    values = {"notes": notes, "search_text": search_text(before.name, notes, tags), "sequence": NEXT_SEQUENCE}
    connection.execute(update(CampaignRow).where(CampaignRow.id == campaign.id).values(values))
    connection.execute(delete(CampaignTagRow).where(CampaignTagRow.campaign_id == campaign.id))
    insert_tags(connection, campaign.id, tags)
    return True


def insert_tags(connection: Connection, campaign_id: str, tags: Sequence[str]) -> None:
    """Store tags of a campaign that has none of them."""
    if tags:
        connection.execute(insert(CampaignTagRow), [{"campaign_id": campaign_id, "tag": tag} for tag in tags])


def campaign_row(campaign_id: str, body: CampaignBody, document_hash: str) -> dict[str, Any]:
    """Return the row of a new campaign, which is running and has no solutions yet.

    Args:
        campaign_id: Its id.
        body: The body with every parameter spelled out.
        document_hash: Hash of the body as it was submitted.
    """
    return {
        "id": campaign_id,
        "name": body.name,
        "document": body.document(),
        "notes": body.notes,
        "search_text": search_text(body.name, body.notes, body.tags),
        "document_hash": document_hash,
        "status": CampaignStatus.RUNNING,
        "status_reason": "",
        "seed": body.seed,
        "priority": body.priority,
        "budget": body.budget.simulations,
        "generation": 0,
        "evaluated": 0,
        "unsafe": 0,
        "failed": 0,
        "failures_accepted": 0,
        "turn": 0,
        "finished_at": None,
    }


def insert_campaigns(
    connection: Connection, rows: Sequence[Mapping[str, Any]], key: str | None = None
) -> None:
    """Store new campaigns.

    Args:
        connection: In a write transaction.
        rows: Rows that `campaign_row` made.
        key: Idempotency key of a single campaign.
    """
    now = database_now(connection)
    connection.execute(
        insert(CampaignRow), [{**row, "idempotency_key": key, "created_at": now} for row in rows]
    )


def running(connection: Connection) -> tuple[str, ...]:
    """Return all running campaigns."""
    query = (
        select(CampaignRow.id).where(CampaignRow.status == CampaignStatus.RUNNING).order_by(CampaignRow.id)
    )
    return tuple(connection.execute(query).scalars())


def running_among(connection: Connection, campaigns: Sequence[str]) -> frozenset[str]:
    """Return which of the given campaigns are running."""
    if not campaigns:
        return frozenset()
    query = select(CampaignRow.id).where(
        CampaignRow.id.in_(list(campaigns)), CampaignRow.status == CampaignStatus.RUNNING
    )
    return frozenset(connection.execute(query).scalars())


def end_running(
    connection: Connection,
    campaign_id: str,
    generation: int,
    status: CampaignStatus,
    reason: str,
    *,
    failures: int | None = None,
) -> None:
    """Set the status of a running campaign, unless it was changed or advanced meanwhile.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        generation: The generation that the campaign must still be in.
        status: The new status.
        reason: Why the status changes.
        failures: Failed candidates that a later resume accepts.
    """
    campaign = CAMPAIGNS.find(connection, campaign_id, lock=True)
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
    """Set a campaign's status. A campaign that ends keeps no open jobs, except those that record traces.

    Args:
        connection: In a write transaction.
        campaign_id: The campaign.
        status: The new status.
        reason: Why the status changes; empty if a user asked for it.
        failures_accepted: New number of failed candidates that do not pause the campaign; None keeps the old one.
    """
    values: dict[str, Any] = {"status": status, "status_reason": reason, "sequence": NEXT_SEQUENCE}
    if status in ENDED:
        values["finished_at"] = database_now(connection)
    if failures_accepted is not None:
        values["failures_accepted"] = failures_accepted
    connection.execute(update(CampaignRow).where(CampaignRow.id == campaign_id).values(values))
    if status is CampaignStatus.RUNNING:
        notify_coordinators(connection)
    if status in ENDED:
        job_store.cancel_evaluations(connection, campaign_id)


def retry_job(connection: Connection, job_id: int) -> None:
    """Return a quarantined job to the queue with fresh attempts and losses; each attempt is leased alone.

    An evaluation is retried only while its result can still count. The lock on the campaign decides between a retry
    and a step that counts the solution as failed: whichever is written first; see `step_store.write_step`.

    Raises:
        NotFound: There is no such job.
        Conflict: The job is not in quarantine, its campaign has ended, or its generation continued without it.
    """
    job = job_store.find_job(connection, job_id)
    campaign = CAMPAIGNS.find(connection, job.campaign, lock=True) if job is not None else None
    if job is None or campaign is None:
        raise NotFound(f"job {job_id}: no such job")
    if job.status is not JobStatus.QUARANTINED:
        raise Conflict(f"job {job_id} is {job.status}; only a quarantined job can be retried")
    if job.kind != JobKind.TRACE:
        if campaign.status in ENDED:
            raise Conflict(
                f"job {job_id}: campaign {campaign.id} is {campaign.status}; nothing waits for the job"
            )
        solution = (SolutionRow.campaign_id == campaign.id, SolutionRow.number == job.number)
        if (
            connection.execute(select(SolutionRow.verdict).where(*solution)).scalar_one()
            != SolutionVerdict.PENDING
        ):
            raise Conflict(
                f"job {job_id}: the campaign continued without solution {job.number}, which counts as failed"
            )
    execution = campaign.body.execution
    if not job_store.requeue(
        connection, job_id, more_attempts=execution.max_attempts, more_losses=execution.max_losses
    ):
        raise Conflict(f"job {job_id} was just changed by another request; check it again")
    note_change(connection, campaign.id)

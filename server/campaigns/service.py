"""Serves users' requests about campaigns: submit, view, pause, resume, cancel, delete, repeat, retry.

`DocumentService` is the part that campaigns share with experiments.
"""

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from typing import Generic, Protocol, TypeVar

from sqlalchemy import ColumnElement, Connection

from brink.search.archive import Archive
from brink.server.campaigns import store, traces
from brink.server.campaigns.advance import Scheduler
from brink.server.campaigns.body import CampaignBody, CampaignChange
from brink.server.campaigns.checks import CheckThreads, Choice
from brink.server.campaigns.deletion import Eraser, TreeMember, mark_deleted, read_trees
from brink.server.campaigns.follow_ups.follow_up import PlannedFollowUp
from brink.server.campaigns.follow_ups.kinds.confirm import plan_boundary_repeats, plan_named_repeats
from brink.server.campaigns.follow_ups.store import store_follow_up
from brink.server.campaigns.plan import (
    Plan,
    PreparedCampaign,
    check_repeatable,
    prepare_campaign,
    store_campaigns,
)
from brink.server.campaigns.simulators import other_simulator
from brink.server.campaigns.store import CAMPAIGNS, Campaign
from brink.server.campaigns.warm_start import find_start
from brink.server.db.engine import Engines, read
from brink.server.db.sql import DocumentTable
from brink.server.db.writer import Writer
from brink.server.errors import Conflict
from brink.server.queue.job_store import count_unfinished, idle_campaigns
from brink.server.queue.wakeups import Wakeups
from brink.server.seeding import Access
from brink.server.states import ENDED, CampaignStatus, JobStatus

log = logging.getLogger(__name__)

_CHANGES = {
    CampaignStatus.PAUSED: "paused",
    CampaignStatus.RUNNING: "resumed",
    CampaignStatus.CANCELLED: "cancelled",
}
"""Words with which the log describes a change to a status."""


class Document(Protocol):
    """The body of a campaign or an experiment."""

    def document_hash(self) -> str: ...  # noqa: D102


class StoredDocument(Protocol):
    """A stored campaign or experiment."""

    @property
    def id(self) -> str: ...  # noqa: D102
    @property
    def document_hash(self) -> str: ...  # noqa: D102
    @property
    def status(self) -> CampaignStatus: ...  # noqa: D102


B = TypeVar("B", bound=Document)
S = TypeVar("S", bound=StoredDocument)


@dataclass(frozen=True, kw_only=True)
class DocumentService(ABC, Generic[B, S]):
    """Submits, finds and deletes campaigns or experiments.

    Attributes:
        table: Where they are stored.
        checks: Threads for checks of submissions.
        eraser: Erases what was deleted.
    """

    table: DocumentTable[S]
    engines: Engines
    writer: Writer
    eraser: Eraser
    checks: CheckThreads

    @abstractmethod
    def _choices(self, body: B) -> Collection[Choice]:
        """Return the problems and algorithms of a body."""

    @abstractmethod
    def _prepare(self, body: B) -> Sequence[PreparedCampaign]:
        """Check a body and return its campaigns."""

    @abstractmethod
    def _store(
        self, connection: Connection, body: B, campaigns: Sequence[PreparedCampaign], key: str | None
    ) -> str:
        """Store a body and its campaigns; return its id."""

    @abstractmethod
    def _start(self, stored: S, campaigns: Sequence[PreparedCampaign], idle: Sequence[str]) -> None:
        """Start campaigns that were just stored; advance those without open jobs immediately."""

    @abstractmethod
    def _roots(self, stored: S) -> Sequence[str]:
        """Return the campaigns that are deleted with a row, without their follow-ups."""

    def _delete_row(self, connection: Connection, stored: S) -> None:
        """Delete the rest of a row once its campaigns are marked as deleted."""

    async def submit(self, body: B, key: str | None = None) -> tuple[S, bool]:
        """Check a submission and store it with all of its campaigns, all or nothing.

        Args:
            body: The submission.
            key: Idempotency key; a second submission with the same key returns the first one.

        Returns:
            What was stored, and whether it is new.

        Raises:
            InvalidInput: A campaign cannot run; nothing is stored.
            Conflict: The key was used for another submission.
        """

        def known(connection: Connection) -> S | None:
            found = self.table.find_by_key(connection, key) if key is not None else None
            if found is not None and found.document_hash != body.document_hash():
                raise Conflict(f"this Idempotency-Key was used for another {self.table.kind}, {found.id}")
            return found

        if key is not None and (found := await read(self.engines, known)) is not None:
            return found, False
        campaigns = await self.checks.run(self._choices(body), partial(self._prepare, body))

        def unit(connection: Connection) -> tuple[str, Sequence[str]] | S:
            if (found := known(connection)) is not None:
                return found
            stored_id = self._store(connection, body, campaigns, key)
            return stored_id, idle_campaigns(connection, [campaign.id for campaign in campaigns])

        written = await self.writer.write(unit)
        if not isinstance(written, tuple):
            return written, False
        stored_id, idle = written
        stored = await self.get(stored_id)
        self._start(stored, campaigns, idle)
        return stored, True

    async def get(self, name: str) -> S:
        """Return a campaign or an experiment by its id or a unique prefix of the id.

        Raises:
            NotFound: No id matches, or several do.
        """
        return await read(self.engines, lambda connection: self.table.get(connection, name))

    async def list(
        self,
        *,
        limit: int,
        before: tuple[datetime, str] | None = None,
        document_hash: str | None = None,
        statuses: tuple[CampaignStatus, ...] = (),
        conditions: Sequence[ColumnElement[bool]] = (),
    ) -> list[S]:
        """Return one page of campaigns or experiments, newest first.

        Args:
            limit: Maximum length of the page.
            before: Creation time and id of the last entry of the previous page.
            document_hash: Only entries whose document has this hash.
            statuses: Only campaigns with one of these statuses; any if empty.
            conditions: Further conditions on the table.
        """
        return await read(
            self.engines,
            lambda connection: self.table.page(
                connection,
                limit=limit,
                before=before,
                document_hash=document_hash,
                statuses=statuses,
                conditions=conditions,
            ),
        )

    async def delete(self, name: str) -> None:
        """Delete a campaign or an experiment with everything that belongs to it.

        From then on, nobody finds it; its rows are erased in the background.

        Raises:
            NotFound: No id matches, or several do.
            Conflict: It has not ended, or a follow-up has not.
        """
        exact_id, kind = (await self.get(name)).id, self.table.kind

        def unit(connection: Connection) -> int:
            stored = self.table.get(connection, exact_id, lock=True)
            if stored.status not in ENDED:
                raise Conflict(f"{kind} {exact_id} is {stored.status}: cancel it before deleting it")
            deleted = mark_deleted(connection, self._roots(stored))
            self._delete_row(connection, stored)
            return len(deleted)

        campaigns = await self.writer.write(unit)
        about = {kind: exact_id, "campaigns": campaigns}
        logging.getLogger(type(self).__module__).info("%s deleted", kind, extra=about)
        self.eraser.start()

    async def doomed(self, name: str) -> Sequence[TreeMember]:
        """Return the campaigns that `delete` would delete.

        Raises:
            NotFound: No id matches, or several do.
        """
        return await read(
            self.engines,
            lambda connection: read_trees(connection, self._roots(self.table.get(connection, name))),
        )


@dataclass(frozen=True, kw_only=True)
class CampaignService(DocumentService[CampaignBody, Campaign]):
    """The campaigns of one coordinator process.

    Attributes:
        access: What campaigns may call.
    """

    table: DocumentTable[Campaign] = CAMPAIGNS
    checks: CheckThreads = field(default_factory=CheckThreads)
    scheduler: Scheduler
    wakeups: Wakeups
    access: Access

    def close(self) -> None:
        """Finish the running checks, and start no more."""
        self.checks.close()

    def _choices(self, body: CampaignBody) -> Collection[Choice]:
        return [(body.problem.id, body.algorithm.id)]

    def _prepare(self, body: CampaignBody) -> Sequence[PreparedCampaign]:
        start = None
        if body.start_from is not None:
            with self.engines.reader.connect() as connection:
                start = find_start(connection, body)
        return [prepare_campaign(body, start, self.access)]

    def _store(
        self,
        connection: Connection,
        body: CampaignBody,
        campaigns: Sequence[PreparedCampaign],
        key: str | None,
    ) -> str:
        store_campaigns(connection, campaigns, key)
        return campaigns[0].id

    def _start(self, stored: Campaign, campaigns: Sequence[PreparedCampaign], idle: Sequence[str]) -> None:
        self.start(campaigns, idle)

    def _roots(self, stored: Campaign) -> Sequence[str]:
        return [stored.id]

    def start(self, campaigns: Sequence[PreparedCampaign], idle: Sequence[str]) -> None:
        """Start campaigns that were just stored.

        Args:
            campaigns: The campaigns.
            idle: Those without open jobs: the results of their simulations are all known, or they need none.
        """
        for campaign in campaigns:
            about = {
                "problem": campaign.body.problem.id,
                "algorithm": campaign.body.algorithm.id,
                "simulations": campaign.body.budget.simulations,
            }
            log.info("campaign submitted", extra={"campaign": campaign.id, **about})
            if campaign.first is not None:
                self.scheduler.stepper.adopt(campaign.id, campaign.first[0])
            else:
                self.scheduler.stepper.start_later(campaign.id)
        self.wakeups.wake()
        storing = [one.id for one in campaigns if one.first is not None and not one.first[0].is_stored]
        self.scheduler.advance_soon([*idle, *storing])

    async def check(self, body: CampaignBody) -> None:
        """Check a campaign as on submission, without storing it.

        Raises:
            InvalidInput: With a pointer to each invalid field.
        """
        await self.checks.run(self._choices(body), partial(self._prepare, body))

    async def pause(self, name: str) -> Campaign:
        """Stop handing out a campaign's jobs. Running jobs continue, and their results are stored.

        Raises:
            NotFound: No id matches, or several do.
            Conflict: The campaign has ended.
        """
        return await self._change(name, "pause", (CampaignStatus.RUNNING,), CampaignStatus.PAUSED)

    async def resume(self, name: str) -> Campaign:
        """Continue a paused campaign without the candidates that have failed.

        Raises:
            NotFound: No id matches, or several do.
            Conflict: The campaign has ended.
        """
        campaign = await self._change(name, "resume", (CampaignStatus.PAUSED,), CampaignStatus.RUNNING)
        self.wakeups.wake()
        self.scheduler.stepper.take_over(campaign.id)
        self.scheduler.advance_soon([campaign.id])
        return campaign

    async def cancel(self, name: str) -> Campaign:
        """End a campaign, keeping its results.

        Raises:
            NotFound: No id matches, or several do.
            Conflict: The campaign has ended otherwise.
        """
        allowed = (CampaignStatus.RUNNING, CampaignStatus.PAUSED)
        campaign = await self._change(name, "cancel", allowed, CampaignStatus.CANCELLED)
        self.scheduler.stepper.forget(campaign.id)
        return campaign

    async def change(self, name: str, change: CampaignChange) -> Campaign:
        """Change the tags and notes of a campaign, whatever its status.

        Raises:
            NotFound: No id matches, or several do.
            InvalidInput: It would have too many tags.
        """
        campaign_id = (await self.get(name)).id

        def unit(connection: Connection) -> Campaign:
            current = self.table.get(connection, campaign_id, lock=True)
            if not store.change_campaign(connection, current, change):
                return current
            return self.table.get(connection, campaign_id)

        return await self.writer.write(unit)

    async def repeat(
        self,
        campaign: Campaign,
        plan: Plan,
        archive: Archive,
        *,
        repeats: int,
        t_b: float,
        d_th: float,
        numbers: Sequence[int] | None = None,
    ) -> tuple[Campaign, bool]:
        """Repeat solutions of a campaign with other seeds, in a separate campaign.

        Args:
            campaign: The campaign, which has ended.
            plan: Its plan.
            archive: Its archive.
            repeats: Simulations of each solution.
            t_b: Maximum fitness of the solutions of its distinct boundary.
            d_th: Minimum distance between two of them.
            numbers: Distinct numbers of solutions to repeat instead of the boundary.

        Returns:
            The campaign of the repeats, and whether it is new.

        Raises:
            InvalidInput: Its problem is deterministic, or a number is not one of its evaluated solutions.
            Conflict: It has not ended, has no boundary solutions, or was simulated with another simulator.
        """
        if campaign.status not in ENDED:
            why = "its boundary is not known yet" if numbers is None else "wait until it has ended"
            raise Conflict(f"campaign {campaign.id} is {campaign.status}: {why}")
        check_repeatable(plan)

        def look() -> PlannedFollowUp:
            if numbers is not None:
                return plan_named_repeats(campaign, plan, archive, repeats=repeats, numbers=numbers)
            found = plan_boundary_repeats(campaign, plan, archive, repeats=repeats, t_b=t_b, d_th=d_th)
            if found is None:
                raise Conflict(
                    f"campaign {campaign.id} has no boundary solutions at t_b {t_b:g}, d_th {d_th:g}"
                )
            return found

        return await self.follow_up(campaign, look)

    async def follow_up(
        self, campaign: Campaign, plan_it: Callable[[], PlannedFollowUp]
    ) -> tuple[Campaign, bool]:
        """Store and start a follow-up of a campaign, unless there is an identical one.

        Args:
            campaign: The campaign, which has ended.
            plan_it: Returns the follow-up; called in a thread.

        Returns:
            The campaign of the follow-up, and whether it is new.

        Raises:
            Conflict: The campaign has not ended, or was simulated with another simulator.
        """
        if campaign.status not in ENDED:
            raise Conflict(f"campaign {campaign.id} is {campaign.status}: wait until it has ended")
        other = await read(self.engines, lambda c: other_simulator(c, campaign))
        if other is not None:
            raise Conflict(f"campaign {campaign.id} cannot be repeated: {other}")
        planned = await self.checks.run(self._choices(campaign.body), plan_it)

        def unit(connection: Connection) -> tuple[Campaign, bool, Sequence[str]]:
            # Locked, so that identical follow-ups are not stored at the same time.
            self.table.get(connection, campaign.id, lock=True)
            found, new = store_follow_up(connection, planned)
            return found, new, idle_campaigns(connection, [found.id])

        found, new, idle = await self.writer.write(unit)
        if new:
            self.start([planned.campaign], idle)
        return found, new

    async def retry_job(self, job_id: int) -> None:
        """Return a quarantined job to the queue.

        Raises:
            NotFound: There is no such job.
            Conflict: The job is not in quarantine, its campaign has ended, or its generation continued without it.
        """
        await self.writer.write(lambda connection: store.retry_job(connection, job_id))
        self.wakeups.wake()  # all waiters: the first may be unable to run it

    async def request_trace(self, campaign_id: str, number: int) -> bool:
        """Have workers record the trace of a solution; return whether that is possible."""
        campaign = await self.get(campaign_id)
        possible = await self.writer.write(
            lambda connection: traces.request_trace(connection, campaign, number)
        )
        self.wakeups.wake()  # all waiters: the first may be unable to run it
        return possible

    async def _change(
        self, name: str, verb: str, allowed: tuple[CampaignStatus, ...], status: CampaignStatus
    ) -> Campaign:
        campaign_id = (await self.get(name)).id

        def unit(connection: Connection) -> tuple[Campaign, bool]:
            current = self.table.get(connection, campaign_id, lock=True)
            if current.status is status:
                return current, False
            if current.status not in allowed:
                expected = " or ".join(allowed)
                raise Conflict(
                    f"campaign {campaign_id} is {current.status}; to {verb} it, it must be {expected}"
                )
            accepted = None
            if status is CampaignStatus.RUNNING:
                quarantined = count_unfinished(connection, campaign_id).get(JobStatus.QUARANTINED, 0)
                accepted = max(current.failures_accepted, quarantined)
            store.set_status(connection, campaign_id, status, "", failures_accepted=accepted)
            return self.table.get(connection, campaign_id), True

        campaign, changed = await self.writer.write(unit)
        if changed:
            about = {"campaign": campaign.id, "generation": campaign.generation}
            log.info("campaign %s", _CHANGES[status], extra=about)
        return campaign

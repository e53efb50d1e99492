"""What users do with campaigns: submit, look, pause, resume, cancel, delete, retry."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import datetime
from typing import TypeVar

from sqlalchemy import Connection

from brink.search.archive import Archive
from brink.server.campaigns import jobs as job_store
from brink.server.campaigns import store, traces
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.repeats import (
    PlannedRepeats,
    check_no_open_repeats,
    plan_named,
    plan_repeats,
    store_repeats,
)
from brink.server.campaigns.scheduler import Scheduler
from brink.server.campaigns.store import ENDED
from brink.server.campaigns.submission import Prepared, check_repeatable, prepared, store_prepared
from brink.server.campaigns.values import Campaign
from brink.server.db.engine import Engines, read
from brink.server.db.writer import Writer
from brink.server.errors import Conflict, NotFound
from brink.server.queue.report_store import idle_campaigns
from brink.server.queue.wakeups import Wakeups
from brink.server.states import CampaignStatus

log = logging.getLogger(__name__)

T = TypeVar("T")
SLOW_AT_ONCE = 2
"""Submissions that are checked at once, and pictures that are drawn."""
DONE = {
    CampaignStatus.PAUSED: "paused",
    CampaignStatus.RUNNING: "resumed",
    CampaignStatus.CANCELLED: "cancelled",
}
"""What the log says was done to a campaign that is now in a state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignService:
    """Campaigns of one coordinator process."""

    engines: Engines
    writer: Writer
    scheduler: Scheduler
    wakeups: Wakeups
    llm_endpoints: str = ""
    checks: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(SLOW_AT_ONCE, thread_name_prefix="brink-check")
    )
    """Threads of their own: a submission may load a network, and all else must not wait for that."""

    def close(self) -> None:
        """Let the submissions that are being checked end, and take no more."""
        self.checks.shutdown(wait=True, cancel_futures=True)

    async def submit(self, body: CampaignBody, key: str | None = None) -> tuple[Campaign, bool]:
        """Store a campaign with its first generation.

        Args:
            body: What was asked for.
            key: Idempotency key: the same key again returns the campaign of the first time.

        Returns:
            The campaign, and whether it is new.

        Raises:
            InvalidInput: It cannot run; nothing is stored.
            Conflict: The key was used for another campaign.
        """
        if key is not None:
            known = await self._read(lambda connection: store.find_by_key(connection, key))
            if known is not None:
                return _same(known, body), False
        ready = await asyncio.get_running_loop().run_in_executor(
            self.checks, prepared, body, self.llm_endpoints
        )

        def unit(connection: Connection) -> tuple[Campaign, bool, Sequence[str]]:
            known = store.find_by_key(connection, key) if key is not None else None
            if known is not None:
                return _same(known, body), False, ()
            campaign = store_prepared(connection, ready, key)
            return campaign, True, idle_campaigns(connection, [ready.id])

        campaign, new, idle = await self._write(unit)
        if new:
            self.begin([ready], idle)
        return campaign, new

    def begin(self, campaigns: Sequence[Prepared], idle: Sequence[str]) -> None:
        """Set out with campaigns that were just stored.

        Args:
            campaigns: Which.
            idle: Those whose simulations are all known, or need no workers.
        """
        for one in campaigns:
            about = {
                "problem": one.body.problem.id,
                "algorithm": one.body.algorithm.id,
                "simulations": one.body.budget.simulations,
            }
            log.info("campaign submitted", extra={"campaign": one.id, **about})
            self.scheduler.stepper.adopt(one.id, one.live)
        self.wakeups.wake()
        self.scheduler.advance_soon(idle)

    async def check(self, body: CampaignBody) -> None:
        """Check that a campaign could be submitted; nothing is stored.

        Raises:
            InvalidInput: It could not; with a pointer to each wrong field.
        """
        await asyncio.get_running_loop().run_in_executor(self.checks, prepared, body, self.llm_endpoints)

    async def get(self, campaign_id: str) -> Campaign:
        """Return a campaign by its id, or by the beginning of its id if that is unique.

        Raises:
            NotFound: There is none, or more than one.
        """
        return await self._read(lambda connection: store.named_campaign(connection, campaign_id))

    async def list(
        self,
        *,
        limit: int,
        before: tuple[datetime, str] | None = None,
        document_hash: str | None = None,
        statuses: tuple[CampaignStatus, ...] = (),
    ) -> list[Campaign]:
        """Return campaigns, newest first."""
        return await self._read(
            lambda connection: store.list_campaigns(
                connection, limit=limit, before=before, document_hash=document_hash, statuses=statuses
            )
        )

    async def pause(self, campaign_id: str) -> Campaign:
        """Hand out no more of a campaign's jobs; what is running is still taken in."""
        return await self._change(campaign_id, "pause", (CampaignStatus.RUNNING,), CampaignStatus.PAUSED)

    async def resume(self, campaign_id: str) -> Campaign:
        """Go on with a paused campaign, without the candidates that failed so far."""
        campaign = await self._change(campaign_id, "resume", (CampaignStatus.PAUSED,), CampaignStatus.RUNNING)
        self.wakeups.wake()
        self.scheduler.advance_soon([campaign.id])
        return campaign

    async def cancel(self, campaign_id: str) -> Campaign:
        """End a campaign; what it found stays."""
        allowed = (CampaignStatus.RUNNING, CampaignStatus.PAUSED)
        campaign = await self._change(campaign_id, "cancel", allowed, CampaignStatus.CANCELLED)
        self.scheduler.stepper.forget(campaign.id)
        return campaign

    async def delete(self, campaign_id: str) -> None:
        """Delete a campaign that has ended, with everything that belongs to it.

        Raises:
            Conflict: It has not ended.
        """
        campaign = await self.get(campaign_id)

        def unit(connection: Connection) -> None:
            current = _found(store.find_campaign(connection, campaign.id, lock=True), campaign.id)
            if current.status not in ENDED:
                raise Conflict(f"campaign {campaign.id} is {current.status}: cancel it before deleting it")
            check_no_open_repeats(connection, campaign.id)
            store.delete_campaign(connection, campaign.id)

        await self._write(unit)
        log.info("campaign deleted", extra={"campaign": campaign.id})

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
        """Simulate solutions of a campaign again with other seeds, in a campaign of their own.

        Args:
            campaign: The campaign; it has ended.
            plan: Its plan.
            archive: What it found.
            repeats: Simulations of each solution.
            t_b: Largest fitness of the solutions, which are its distinct boundary.
            d_th: Least distance between two of them.
            numbers: Which solutions, each once, in place of the boundary.

        Returns:
            The campaign that does it, and whether it is new.

        Raises:
            InvalidInput: Its problem has no chance in it, or it has no such solution.
            Conflict: It has not ended, or has no boundary solutions.
        """
        if campaign.status not in ENDED:
            why = "its boundary is not known yet" if numbers is None else "wait until it has ended"
            raise Conflict(f"campaign {campaign.id} is {campaign.status}: {why}")
        check_repeatable(plan)

        def look() -> PlannedRepeats | None:
            if numbers is not None:
                return plan_named(campaign, plan, archive, repeats=repeats, numbers=numbers)
            return plan_repeats(campaign, plan, archive, repeats=repeats, t_b=t_b, d_th=d_th)

        planned = await asyncio.get_running_loop().run_in_executor(self.checks, look)
        if planned is None:
            raise Conflict(f"campaign {campaign.id} has no boundary solutions at t_b {t_b:g}, d_th {d_th:g}")

        def unit(connection: Connection) -> tuple[Campaign, bool, Sequence[str]]:
            _found(store.find_campaign(connection, campaign.id, lock=True), campaign.id)  # one at a time
            found, new = store_repeats(connection, planned)
            return found, new, idle_campaigns(connection, [found.id])

        found, new, idle = await self._write(unit)
        if new:
            self.begin([planned.campaign], idle)
        return found, new

    async def retry_job(self, job: int) -> None:
        """Put a quarantined job back into the queue.

        Raises:
            NotFound: There is no such job.
            Conflict: It is not in quarantine, or its generation went on without it.
        """
        await self._write(lambda connection: job_store.retry(connection, job))
        self.wakeups.wake()  # the first in line may be unable to run it

    async def request_trace(self, campaign_id: str, number: int) -> bool:
        """Have workers make the trace of a solution; return whether it can be made."""
        campaign = await self.get(campaign_id)
        possible = await self._write(lambda connection: traces.request_trace(connection, campaign, number))
        self.wakeups.wake()  # the first in line may be unable to run it
        return possible

    async def _change(
        self,
        campaign_id: str,
        verb: str,
        allowed: tuple[CampaignStatus, ...],
        status: CampaignStatus,
    ) -> Campaign:
        found = await self.get(campaign_id)

        def unit(connection: Connection) -> tuple[Campaign, bool]:
            current = _found(store.find_campaign(connection, found.id, lock=True), found.id)
            if current.status is not status:
                if current.status not in allowed:
                    expected = " or ".join(allowed)
                    raise Conflict(
                        f"campaign {found.id} is {current.status}; to {verb} it, it must be {expected}"
                    )
                accepted = None
                if status is CampaignStatus.RUNNING:
                    quarantined = store.count_quarantined(connection, found.id)
                    accepted = max(current.failures_accepted, quarantined)
                store.set_status(connection, found.id, status, "", failures_accepted=accepted)
            changed = current.status is not status
            return _found(store.find_campaign(connection, found.id), found.id), changed

        campaign, changed = await self._write(unit)
        if changed:
            log.info(
                "campaign %s",
                DONE[status],
                extra={"campaign": campaign.id, "generation": campaign.generation},
            )
        return campaign

    async def _read(self, query: Callable[[Connection], T]) -> T:
        return await read(self.engines, query)

    def _write(self, unit: Callable[[Connection], T]) -> Awaitable[T]:
        return asyncio.wrap_future(self.writer.submit(unit))


def _found(campaign: Campaign | None, campaign_id: str) -> Campaign:
    if campaign is None:
        raise NotFound(f"campaign {campaign_id!r}: no such campaign")
    return campaign


def _same(known: Campaign, body: CampaignBody) -> Campaign:
    if known.document_hash != body.document_hash():
        raise Conflict(f"this Idempotency-Key was used for another campaign, {known.id}")
    return known

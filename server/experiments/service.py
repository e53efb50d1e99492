"""What users do with experiments: submit, look, pause, resume, cancel, delete."""

import asyncio
import logging
import secrets
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TypeVar

from sqlalchemy import Connection

from brink.server.campaigns.repeats import check_no_open_repeats
from brink.server.campaigns.service import CampaignService
from brink.server.campaigns.store import ENDED
from brink.server.campaigns.submission import Prepared, prepared, store_prepared
from brink.server.campaigns.values import Campaign
from brink.server.db.engine import read
from brink.server.errors import Conflict, InvalidInput
from brink.server.experiments import store
from brink.server.experiments.body import Cell, ExperimentBody
from brink.server.experiments.values import Experiment
from brink.server.queue.report_store import idle_campaigns
from brink.server.states import CampaignStatus

log = logging.getLogger(__name__)

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentService:
    """Experiments of one coordinator process."""

    campaigns: CampaignService

    async def submit(self, body: ExperimentBody, key: str | None = None) -> tuple[Experiment, bool]:
        """Store an experiment and all of its campaigns, or nothing.

        Args:
            body: What was asked for.
            key: Idempotency key: the same key again returns the experiment of the first time.

        Returns:
            The experiment, and whether it is new.

        Raises:
            InvalidInput: One of its campaigns cannot run.
            Conflict: The key was used for another experiment.
        """
        if key is not None:
            known = await self._read(lambda connection: store.find_by_key(connection, key))
            if known is not None:
                return _same(known, body), False
        ready = await asyncio.get_running_loop().run_in_executor(
            self.campaigns.checks, _prepared, body, self.campaigns.llm_endpoints
        )
        experiment_id = secrets.token_hex(4)

        def unit(connection: Connection) -> tuple[Experiment, bool, Sequence[str]]:
            known = store.find_by_key(connection, key) if key is not None else None
            if known is not None:
                return _same(known, body), False, ()
            for _, campaign in ready:
                store_prepared(connection, campaign)
            members = [(cell, campaign.id) for cell, campaign in ready]
            store.insert_experiment(connection, experiment_id, body, members, key)
            idle = idle_campaigns(connection, [campaign for _, campaign in members])
            return store.named_experiment(connection, experiment_id), True, idle

        experiment, new, idle = await self._write(unit)
        if new:
            log.info("experiment submitted", extra={"experiment": experiment_id, "campaigns": len(ready)})
            self.campaigns.begin([campaign for _, campaign in ready], idle)
        return experiment, new

    async def get(self, experiment_id: str) -> Experiment:
        """Return an experiment by its id, or by the beginning of its id if that is unique.

        Raises:
            NotFound: There is none, or more than one.
        """
        return await self._read(lambda connection: store.named_experiment(connection, experiment_id))

    async def list(
        self,
        *,
        limit: int,
        before: tuple[datetime, str] | None = None,
        document_hash: str | None = None,
    ) -> list[Experiment]:
        """Return experiments, newest first."""
        return await self._read(
            lambda connection: store.list_experiments(
                connection, limit=limit, before=before, document_hash=document_hash
            )
        )

    async def pause(self, experiment_id: str) -> Experiment:
        """Pause those of its campaigns that are running."""
        return await self._each(experiment_id, CampaignStatus.RUNNING, self.campaigns.pause)

    async def resume(self, experiment_id: str) -> Experiment:
        """Go on with those of its campaigns that are paused."""
        return await self._each(experiment_id, CampaignStatus.PAUSED, self.campaigns.resume)

    async def cancel(self, experiment_id: str) -> Experiment:
        """End those of its campaigns that have not ended; what they found stays."""
        await self._each(experiment_id, CampaignStatus.PAUSED, self.campaigns.cancel)
        return await self._each(experiment_id, CampaignStatus.RUNNING, self.campaigns.cancel)

    async def delete(self, experiment_id: str) -> None:
        """Delete an experiment that has ended, with its campaigns and all that belongs to them.

        Raises:
            Conflict: It has not ended.
        """
        name = (await self.get(experiment_id)).id

        def unit(connection: Connection) -> None:
            experiment = store.named_experiment(connection, name)
            if experiment.status not in ENDED:
                raise Conflict(f"experiment {name} is {experiment.status}: cancel it before deleting it")
            for member in experiment.members:
                check_no_open_repeats(connection, member.campaign.id)
            store.delete_experiment(connection, experiment)

        await self._write(unit)
        log.info("experiment deleted", extra={"experiment": name})

    async def _each(
        self,
        experiment_id: str,
        status: CampaignStatus,
        change: Callable[[str], Awaitable[Campaign]],
    ) -> Experiment:
        """Change the campaigns that are in one state; those that left it meanwhile stay as they are."""
        experiment = await self.get(experiment_id)
        for member in experiment.members:
            if member.campaign.status is status:
                try:
                    await change(member.campaign.id)
                except Conflict as error:
                    log.info("%s", error, extra={"experiment": experiment.id})
        return await self.get(experiment.id)

    async def _read(self, query: Callable[[Connection], T]) -> T:
        return await read(self.campaigns.engines, query)

    def _write(self, unit: Callable[[Connection], T]) -> Awaitable[T]:
        return asyncio.wrap_future(self.campaigns.writer.submit(unit))


def _prepared(body: ExperimentBody, llm_endpoints: str) -> list[tuple[Cell, Prepared]]:
    ready = []
    for cell in body.cells():
        try:
            ready.append((cell, prepared(cell.body, llm_endpoints)))
        except InvalidInput as error:
            raise cell.in_experiment(error) from None
    return ready


def _same(known: Experiment, body: ExperimentBody) -> Experiment:
    if known.document_hash != body.document_hash():
        raise Conflict(f"this Idempotency-Key was used for another experiment, {known.id}")
    return known

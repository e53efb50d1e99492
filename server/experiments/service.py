"""Serves users' requests about experiments: submit, view, pause, resume, cancel, delete, compare."""

import asyncio
import logging
import secrets
from collections.abc import Awaitable, Callable, Collection, Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field, replace

from sqlalchemy import Connection

from brink.search.analysis.comparison import Repeat
from brink.search.analysis.scores import Scores, scored
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.checks import Choice
from brink.server.campaigns.plan import PreparedCampaign, prepare_campaign, store_campaigns
from brink.server.campaigns.service import CampaignService, DocumentService
from brink.server.campaigns.step_store import PIECE
from brink.server.campaigns.store import Campaign
from brink.server.db.sql import DocumentTable
from brink.server.errors import Conflict, InvalidInput
from brink.server.experiments import store
from brink.server.experiments.body import ExperimentBody
from brink.server.experiments.checks import check_follow_ups
from brink.server.experiments.store import EXPERIMENTS, Experiment
from brink.server.single_flight import SingleFlightCache
from brink.server.states import CampaignStatus

CACHED_SCORES = 2_000
"""Maximum number of campaigns whose scores are in memory, about 30 kB each."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ExperimentService(DocumentService[ExperimentBody, Experiment]):
    """The experiments of one coordinator process.

    Attributes:
        campaigns: Starts and controls their campaigns.
    """

    table: DocumentTable[Experiment] = EXPERIMENTS
    campaigns: CampaignService

    def _choices(self, body: ExperimentBody) -> Collection[Choice]:
        return {(problem.id, method.id) for problem in body.problems for method in body.algorithms}

    def _prepare(self, body: ExperimentBody) -> Sequence[PreparedCampaign]:
        """Check all campaigns; start the searches of the first ones, as many as one transaction may store.

        The others start with their first steps: there may be hundreds of large ones.
        """
        campaigns: list[PreparedCampaign] = []
        left = PIECE
        for cell in body.cells():
            asks = left > 0 or cell.body.seed == body.seeds[0]  # each problem and method is tried once
            try:
                campaign = prepare_campaign(cell.body, access=self.campaigns.access, asks=asks)
            except InvalidInput as error:
                raise cell.in_experiment(error) from None
            if campaign.first is not None:
                left -= sum(map(len, campaign.first[1].generations))
            campaigns.append(campaign if left >= 0 else replace(campaign, first=None))
        check_follow_ups(body)
        return campaigns

    def _store(
        self,
        connection: Connection,
        body: ExperimentBody,
        campaigns: Sequence[PreparedCampaign],
        key: str | None,
    ) -> str:
        store_campaigns(connection, campaigns)
        experiment_id = secrets.token_hex(4)
        members = [(cell, campaign.id) for cell, campaign in zip(body.cells(), campaigns, strict=True)]
        store.insert_experiment(connection, experiment_id, body, members, key)
        return experiment_id

    def _start(self, stored: Experiment, campaigns: Sequence[PreparedCampaign], idle: Sequence[str]) -> None:
        log.info("experiment submitted", extra={"experiment": stored.id, "campaigns": len(campaigns)})
        self.campaigns.start(campaigns, idle)

    def _roots(self, stored: Experiment) -> Sequence[str]:
        return [member.campaign.id for member in stored.members]

    def _delete_row(self, connection: Connection, stored: Experiment) -> None:
        store.delete_experiment(connection, stored.id)

    async def pause(self, name: str) -> Experiment:
        """Pause the running campaigns of an experiment."""
        return await self._each(name, CampaignStatus.RUNNING, self.campaigns.pause)

    async def resume(self, name: str) -> Experiment:
        """Resume the paused campaigns of an experiment."""
        return await self._each(name, CampaignStatus.PAUSED, self.campaigns.resume)

    async def cancel(self, name: str) -> Experiment:
        """Cancel the campaigns of an experiment that have not ended, keeping their results."""
        await self._each(name, CampaignStatus.PAUSED, self.campaigns.cancel)
        return await self._each(name, CampaignStatus.RUNNING, self.campaigns.cancel)

    async def _each(
        self, name: str, status: CampaignStatus, change: Callable[[str], Awaitable[Campaign]]
    ) -> Experiment:
        """Apply `change` to each campaign that has the given status; skip those that no longer have it by then."""
        experiment = await self.get(name)
        for member in experiment.members:
            if member.campaign.status is status:
                try:
                    await change(member.campaign.id)
                except Conflict as error:
                    log.info("%s", error, extra={"experiment": experiment.id})
        return await self.get(experiment.id)


@dataclass(slots=True)
class ScoreCache:
    """The scores of campaigns that have ended, each computed once.

    Attributes:
        archives: Where campaigns are read.
        threads: Where scores are computed, so that other requests do not wait.
    """

    archives: Archives
    threads: InitVar[Executor]
    _cache: SingleFlightCache[Scores] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED_SCORES, threads)

    async def repeats(self, experiment: Experiment, wait_s: float) -> tuple[list[Repeat], int]:
        """Return the scores of an experiment's finished campaigns.

        Args:
            experiment: The experiment.
            wait_s: How long to wait for scores that are being computed.

        Returns:
            The known scores in the order of the campaigns, and how many are still being computed.
        """
        finished = [m for m in experiment.members if m.campaign.status is CampaignStatus.FINISHED]
        pending = [self._start(member.campaign) for member in finished]
        if not all(one.done() for one in pending):
            await asyncio.wait(pending, timeout=wait_s)
        known = [
            Repeat(
                problem=member.problem,
                method=member.method,
                seed=member.campaign.body.seed,
                campaign=member.campaign.id,
                scores=one.result(),
            )
            for member, one in zip(finished, pending, strict=True)
            if one.done()
        ]
        return known, len(finished) - len(known)

    async def scores(self, campaign: Campaign, wait_s: float) -> Scores | None:
        """Return the scores of a campaign that has ended, or None if that takes longer than `wait_s`."""
        pending = self._start(campaign)
        if not pending.done():
            await asyncio.wait([pending], timeout=wait_s)
        return pending.result() if pending.done() else None

    def _start(self, campaign: Campaign) -> asyncio.Future[Scores]:
        return self._cache.start(campaign.id, campaign.generation, lambda: self._score(campaign))

    def _score(self, campaign: Campaign) -> Scores:
        plan, _, archive = self.archives.stored(campaign)
        simulations, seed = campaign.body.budget.simulations, campaign.body.seed
        return scored(archive, plan.problem.space, simulations=simulations, seed=seed)

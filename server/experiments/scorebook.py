"""Scores of campaigns that have finished: computed once, in threads that nobody else waits for."""

import asyncio
import logging
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field

from server.campaigns.archives import Archives
from server.campaigns.values import Campaign
from server.db.models import CampaignStatus
from server.experiments.scores import Scores, scored
from server.experiments.tables import Repeat
from server.experiments.values import Experiment

KEPT = 2_000
"""Campaigns whose scores are kept; each takes some 30 kB."""

log = logging.getLogger(__name__)


@dataclass(slots=True)
class Scorebook:
    """What campaigns reached.

    Attributes:
        archives: Where to read them.
        threads: Where to compute.
    """

    archives: Archives
    threads: Executor
    _kept: dict[str, Scores] = field(default_factory=dict)
    _scoring: dict[str, asyncio.Future[Scores]] = field(default_factory=dict)

    async def repeats(self, experiment: Experiment, wait_s: float) -> tuple[list[Repeat], int]:
        """Return what the finished campaigns of an experiment reached.

        Args:
            experiment: Which.
            wait_s: How long to wait for what is not known yet.

        Returns:
            Those that are known, by place, and how many finished campaigns are still being scored.
        """
        finished = [m for m in experiment.members if m.campaign.status is CampaignStatus.FINISHED]
        wanted = [member.campaign for member in finished if member.campaign.id not in self._kept]
        if wanted:
            await asyncio.wait([self._soon(campaign) for campaign in wanted], timeout=wait_s)
        for campaign in wanted:
            scoring = self._scoring.get(campaign.id)
            if scoring is not None and scoring.done():
                self._kept[campaign.id] = self._scoring.pop(campaign.id).result()
        known = [
            Repeat(
                problem=member.problem, method=member.method, seed=member.campaign.body.seed,
                campaign=member.campaign.id, scores=scores,
            )
            for member in finished
            if (scores := self._kept.get(member.campaign.id)) is not None
        ]  # fmt: skip
        self._forget([repeat.campaign for repeat in known])
        return known, len(finished) - len(known)

    def _soon(self, campaign: Campaign) -> asyncio.Future[Scores]:
        if campaign.id not in self._scoring:
            loop = asyncio.get_running_loop()
            self._scoring[campaign.id] = loop.run_in_executor(self.threads, self._score, campaign)
        return self._scoring[campaign.id]

    def _score(self, campaign: Campaign) -> Scores:
        plan, _, archive = self.archives.stored(campaign)
        simulations, seed = campaign.body.budget.simulations, campaign.body.seed
        return scored(archive, plan.problem.space, simulations=simulations, seed=seed)

    def _forget(self, needed: Sequence[str]) -> None:
        for campaign in list(self._kept)[: max(0, len(self._kept) - KEPT)]:
            if campaign not in needed:
                del self._kept[campaign]

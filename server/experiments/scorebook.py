"""Scores of campaigns that have ended: computed once, in threads that nobody else waits for."""

import asyncio
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field

from brink.search.analysis.comparison import Repeat
from brink.search.analysis.scores import Scores, scored
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.values import Campaign
from brink.server.experiments.values import Experiment
from brink.server.single_flight import Latest
from brink.server.states import CampaignStatus

KEPT = 2_000
"""Campaigns whose scores are kept; each takes some 30 kB."""


@dataclass(slots=True)
class Scorebook:
    """What campaigns reached.

    Attributes:
        archives: Where to read them.
        threads: Where to compute.
    """

    archives: Archives
    threads: InitVar[Executor]
    _latest: Latest[Scores] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._latest = Latest(KEPT, threads)

    async def repeats(self, experiment: Experiment, wait_s: float) -> tuple[list[Repeat], int]:
        """Return what the finished campaigns of an experiment reached.

        Args:
            experiment: Which.
            wait_s: How long to wait for what is not known yet.

        Returns:
            Those that are known, by place, and how many finished campaigns are still being scored.
        """
        finished = [m for m in experiment.members if m.campaign.status is CampaignStatus.FINISHED]
        scoring = [self._soon(member.campaign) for member in finished]
        if not all(one.done() for one in scoring):
            await asyncio.wait(scoring, timeout=wait_s)
        known = [
            Repeat(
                problem=member.problem, method=member.method, seed=member.campaign.body.seed,
                campaign=member.campaign.id, scores=one.result(),
            )
            for member, one in zip(finished, scoring, strict=True)
            if one.done()
        ]  # fmt: skip
        return known, len(finished) - len(known)

    async def scores(self, campaign: Campaign, wait_s: float) -> Scores | None:
        """Return what a campaign that has ended reached.

        Args:
            campaign: Which.
            wait_s: How long to wait for it, if it is not known yet.

        Returns:
            Its scores; None if they are still being computed.
        """
        scoring = self._soon(campaign)
        if not scoring.done():
            await asyncio.wait([scoring], timeout=wait_s)
        return scoring.result() if scoring.done() else None

    def _soon(self, campaign: Campaign) -> asyncio.Future[Scores]:
        return self._latest.soon(campaign.id, campaign.generation, lambda: self._score(campaign))

    def _score(self, campaign: Campaign) -> Scores:
        plan, _, archive = self.archives.stored(campaign)
        simulations, seed = campaign.body.budget.simulations, campaign.body.seed
        return scored(archive, plan.problem.space, simulations=simulations, seed=seed)

"""Monitors of campaigns for the API: fitted once, in threads that nobody else waits for."""

import asyncio
from collections import OrderedDict
from concurrent.futures import Executor
from dataclasses import dataclass, field

from search.monitor import Monitor
from server.campaigns.archives import Archives
from server.campaigns.values import Campaign
from server.errors import Conflict

KEPT = 8
MOST = 20_000
"""Solutions that a monitor learns from here: the latest ones, so that fitting ends."""


@dataclass(slots=True)
class Monitors:
    """The latest monitors that were asked for.

    Attributes:
        archives: Where to read campaigns.
        threads: Where to fit.
    """

    archives: Archives
    threads: Executor
    _kept: OrderedDict[tuple[str, int], asyncio.Future[Monitor]] = field(default_factory=OrderedDict)

    async def get(self, campaign: Campaign) -> Monitor:
        """Return the monitor of a campaign as it stands.

        Raises:
            Conflict: Too little has been simulated.
        """
        wanted = campaign.id, campaign.generation
        found = self._kept.get(wanted)
        if found is None or (found.done() and found.exception() is not None):
            found = asyncio.get_running_loop().run_in_executor(self.threads, self._fit, campaign)
            self._kept[wanted] = found
        self._kept.move_to_end(wanted)
        while len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return await asyncio.shield(found)  # who goes away leaves it to the others

    def _fit(self, campaign: Campaign) -> Monitor:
        plan, _, archive = self.archives.stored(campaign)
        if len(archive) < 2:
            raise Conflict(
                f"campaign {campaign.id}: a monitor needs two evaluated solutions, there are {len(archive)}"
            )
        return Monitor.fitted(
            plan.problem.space, archive.vectors[-MOST:], archive.unsafe[-MOST:],
            threshold=plan.neighbourhood.p_th, z=plan.neighbourhood.z, seed=campaign.body.seed,
        )  # fmt: skip

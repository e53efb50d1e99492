"""Monitors of campaigns for the API: fitted once, in threads that nobody else waits for."""

from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field

from brink.search.analysis.monitor import Monitor
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.values import Campaign
from brink.server.errors import Conflict
from brink.server.single_flight import Latest

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
    threads: InitVar[Executor]
    _latest: Latest[Monitor] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._latest = Latest(KEPT, threads)

    async def get(self, campaign: Campaign) -> Monitor:
        """Return the monitor of a campaign as it stands.

        Raises:
            Conflict: Too little has been simulated.
        """
        return await self._latest.get(campaign.id, campaign.generation, lambda: self._fit(campaign))

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

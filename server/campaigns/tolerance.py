"""The tolerances in a campaign's archive: its cells, their curves, and the violations without any error."""

from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

from brink.search.algorithms.tolerance import Layout, Tally, Tolerance, ToleranceConfig, tally
from brink.search.curves import Curve
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import CACHED, ReadArchive
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import Engines
from brink.server.errors import InvalidInput, NotFound
from brink.server.single_flight import SingleFlightCache

MOST_PENDING: Final = 4
"""Maximum number of archives whose tolerances are computed at a time, queued ones included; each takes a while."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignTolerance:
    """The tolerances of a campaign.

    Attributes:
        config: Settings of the search.
        layout: Its cells.
        tally: What its simulations say.
        curves: The curve of each cell.
    """

    config: ToleranceConfig
    layout: Layout
    tally: Tally
    curves: tuple[Curve, ...]


@dataclass(slots=True)
class Tolerances:
    """A cache of the tolerances of campaigns.

    Attributes:
        engines: The database.
        threads: Where tolerances are computed, so that other requests do not wait.
    """

    engines: Engines
    threads: InitVar[Executor]
    _cache: SingleFlightCache[CampaignTolerance] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED, threads, MOST_PENDING)

    async def get(self, campaign: Campaign, read: ReadArchive) -> CampaignTolerance:
        """Return the tolerances of a campaign.

        Args:
            campaign: The campaign.
            read: Its archive.

        Raises:
            InvalidInput: It does not search for tolerances.
            NotFound: The campaign was deleted meanwhile.
            Unavailable: Too many archives are being worked on.
        """
        config = read.plan.config
        if not isinstance(config, ToleranceConfig):
            raise InvalidInput.at(
                "/path/campaign_id",
                f"campaign {campaign.id}: expected a search for tolerances ({Tolerance.id}), got "
                f"{read.plan.body.algorithm.id}",
            )
        return await self._cache.get(
            campaign.id, read.generation, lambda: self._compute(campaign, read, config)
        )

    def _compute(self, campaign: Campaign, read: ReadArchive, config: ToleranceConfig) -> CampaignTolerance:
        with self.engines.reader.connect() as connection:
            seeds = view_store.read_seeds(connection, campaign.id)
        numbers = read.archive.numbers.tolist()
        if not seeds.keys() >= set(numbers):
            raise NotFound(f"campaign {campaign.id}: no such campaign")
        layout = Layout(read.plan.problem.space, config)
        counts = tally(
            layout, read.archive.vectors, numbers, read.archive.unsafe, [seeds[number] for number in numbers]
        )
        return CampaignTolerance(
            config=config,
            layout=layout,
            tally=counts,
            curves=tuple(counts.curves(layout, limit=config.limit, confidence=config.confidence)),
        )

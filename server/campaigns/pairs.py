"""The pairs across the boundary in a campaign's archive."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

import numpy as np

from brink.search.algorithms.minimise import most_trials
from brink.search.analysis.pairs import FoundPairs, Opposites, Pair, find_pairs, nearest_opposites
from brink.search.archive import Archive
from brink.search.errors import TooManyPairs
from brink.search.space import BoolArray, IntArray
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import CACHED, ReadArchive, read_activity
from brink.server.campaigns.body import DEFAULT_EPS, DEFAULT_PAIRS_D_TH
from brink.server.campaigns.follow_ups.kinds.minimise import reducible_pairs
from brink.server.campaigns.follow_ups.limits import MOST, MOST_PAIRS_FOLLOWED
from brink.server.campaigns.follow_ups.question import Reducible
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import Engines
from brink.server.errors import InvalidInput, NotFound
from brink.server.single_flight import SingleFlightCache
from brink.server.states import ENDED

MOST_PENDING: Final = 4
"""Maximum number of archives that are searched for pairs at a time, queued ones included; each takes a while."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSettings:
    """Which solutions are a pair, and which pairs are distinct.

    Attributes:
        eps: Largest distance between the sides of a pair, unless they are one step apart in a single parameter.
        d_th: Smallest distance between the midpoints of two distinct pairs.
    """

    eps: float
    d_th: float

    @classmethod
    def of(cls, plan: Plan, eps: float | None = None, d_th: float | None = None) -> "PairSettings":
        """Return the given settings; those of the campaign's search for pairs, or else defaults, where None."""
        own = plan.body.algorithm.params if plan.is_for("pairs") else {}
        return cls(
            eps=float(own.get("eps", DEFAULT_EPS)) if eps is None else eps,
            d_th=float(own.get("d_th", DEFAULT_PAIRS_D_TH)) if d_th is None else d_th,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignPairs:
    """The pairs of a campaign's archive.

    Attributes:
        settings: Which solutions are a pair, and which pairs are distinct.
        found: The pairs.
        nearest: The nearest solutions with opposite verdicts, if none are near enough for a pair.
        reducible: Of the first `MOST` pairs, those of which a difference can be reverted, and what that takes for the
            first `MOST_PAIRS_FOLLOWED`; None while the campaign has not ended.
    """

    settings: PairSettings
    found: FoundPairs
    nearest: Opposites | None
    reducible: Reducible | None


@dataclass(slots=True)
class Pairs:
    """A cache of the pairs of campaigns.

    Attributes:
        engines: The database.
        threads: Where pairs are searched for, so that other requests do not wait.
    """

    engines: Engines
    threads: InitVar[Executor]
    _cache: SingleFlightCache[CampaignPairs | TooManyPairs] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED, threads, MOST_PENDING)

    async def get(self, campaign: Campaign, read: ReadArchive, settings: PairSettings) -> CampaignPairs:
        """Return the pairs of a campaign.

        Args:
            campaign: The campaign.
            read: Its archive.
            settings: Which solutions are a pair, and which pairs are distinct.

        Raises:
            InvalidInput: There are too many pairs.
            NotFound: The campaign was deleted meanwhile.
            Unavailable: Too many archives are being searched.
        """
        key = (campaign.id, settings, campaign.status in ENDED)
        pairs = await self._cache.get(key, read.generation, lambda: self._find(campaign, read, settings))
        if isinstance(pairs, TooManyPairs):
            raise InvalidInput.at(f"/query/{pairs.setting}", f"campaign {campaign.id}: {pairs}")
        return pairs

    def _find(
        self, campaign: Campaign, read: ReadArchive, settings: PairSettings
    ) -> CampaignPairs | TooManyPairs:
        try:
            found = find_stored_pairs(self.engines, campaign.id, read.plan, read.archive, settings)
        except TooManyPairs as error:
            return error  # cached, unlike what is raised here
        nearest = (
            None
            if found.tight or found.without_part
            else nearest_opposites(read.archive, read.plan.problem.space)
        )
        # Before it has ended, nothing can be reverted, and the next generation changes the pairs.
        reducible = self._reducible(read, found.pairs[:MOST]) if campaign.status in ENDED else None
        return CampaignPairs(settings=settings, found=found, nearest=nearest, reducible=reducible)

    def _reducible(self, read: ReadArchive, pairs: Sequence[Pair]) -> Reducible:
        _, reductions = reducible_pairs(read.plan, read.archive, pairs[:MOST_PAIRS_FOLLOWED])
        return Reducible(
            pairs=find_reducible(read.plan, read.archive, pairs), most_trials=most_trials(reductions)
        )


def find_reducible(plan: Plan, archive: Archive, pairs: Sequence[Pair]) -> frozenset[tuple[int, int]]:
    """Return the pairs with a difference that can be reverted, by the numbers of their two sides."""
    open_pairs, _ = reducible_pairs(plan, archive, pairs)
    return frozenset((pair.safe.number, pair.unsafe.number) for pair in open_pairs)


def find_stored_pairs(
    engines: Engines, campaign_id: str, plan: Plan, archive: Archive, settings: PairSettings
) -> FoundPairs:
    """Find the distinct pairs of a campaign, with the episode seeds of its simulations.

    Args:
        engines: The database.
        campaign_id: Id of the campaign.
        plan: Its plan.
        archive: Its archive.
        settings: Which solutions are a pair, and which pairs are distinct.

    Raises:
        TooManyPairs: There are too many pairs.
        NotFound: The campaign was deleted after its archive had been read.
    """
    with engines.reader.connect() as connection:
        stored = view_store.read_seeds(connection, campaign_id)
    numbers = archive.numbers.tolist()
    if not stored.keys() >= set(numbers):
        raise NotFound(f"campaign {campaign_id}: no such campaign")
    seeds = np.array([stored[number] for number in numbers], np.int64)

    def had_part(places: IntArray) -> BoolArray:
        with engines.reader.connect() as connection:
            return read_activity(connection, campaign_id, plan.problem, archive, places).active

    return find_pairs(
        archive,
        plan.problem.space,
        eps=settings.eps,
        d_th=settings.d_th,
        seeds=seeds,
        had_part=had_part if plan.problem.records_activity else None,
    )

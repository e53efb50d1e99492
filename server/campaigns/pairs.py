"""The pairs across the boundary in a campaign's archive, and the results of their follow-ups.

Follow-ups are campaigns of their own (`brink.server.campaigns.repeats`).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

import numpy as np

from brink.search.algorithms.minimise import most_trials
from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of
from brink.search.analysis.pairs import FoundPairs, Opposites, Pair, find_pairs, nearest_opposites
from brink.search.archive import Archive
from brink.search.errors import TooManyPairs
from brink.search.space import BoolArray, IntArray
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import CACHED, ReadArchive, read_activity
from brink.server.campaigns.body import DEFAULT_EPS, DEFAULT_PAIRS_D_TH
from brink.server.campaigns.follow_ups import MOST_PAIRS_FOLLOWED, reducible
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.repeats import MOST, FollowUpKind, StoredRepeats
from brink.server.campaigns.store import ENDED, Campaign
from brink.server.db.engine import Engines
from brink.server.errors import InvalidInput, NotFound
from brink.server.single_flight import SingleFlightCache

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
        reducible: Of the first `MOST` pairs, those of which a difference can be reverted; None while the campaign has
            not ended.
        most_trials: Largest number of simulations that reverting the differences of the first `MOST_PAIRS_FOLLOWED`
            pairs can take; 0 while the campaign has not ended.
    """

    settings: PairSettings
    found: FoundPairs
    nearest: Opposites | None
    reducible: frozenset[tuple[int, int]] | None
    most_trials: int


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
        found = await self._cache.get(key, read.generation, lambda: self._find(campaign, read, settings))
        if isinstance(found, TooManyPairs):
            raise InvalidInput.at(f"/query/{found.setting}", f"campaign {campaign.id}: {found}")
        return found

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
        if (
            campaign.status not in ENDED
        ):  # nothing can be reverted yet, and the next generation changes the pairs
            return CampaignPairs(
                settings=settings, found=found, nearest=nearest, reducible=None, most_trials=0
            )
        pairs = found.pairs[:MOST]
        _, reductions = reducible(read.plan, read.archive, pairs[:MOST_PAIRS_FOLLOWED])
        return CampaignPairs(
            settings=settings,
            found=found,
            nearest=nearest,
            reducible=find_reducible(read.plan, read.archive, pairs),
            most_trials=most_trials(reductions),
        )


def find_reducible(plan: Plan, archive: Archive, pairs: Sequence[Pair]) -> frozenset[tuple[int, int]]:
    """Return the pairs with a difference that can be reverted, by the numbers of their two sides."""
    open_pairs, _ = reducible(plan, archive, pairs)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeated:
    """The results of repeats of the sides of pairs.

    Attributes:
        shares: How often each repeated solution was unsafe with other seeds, by number.
        under_way: Numbers of the solutions that are being simulated again.
    """

    shares: Mapping[int, Share]
    under_way: frozenset[int]

    @classmethod
    def of(cls, stored: Sequence[StoredRepeats]) -> "Repeated":
        """Return the results of a campaign's repeats, ignoring other kinds of follow-ups."""
        again = [one for one in stored if one.kind is FollowUpKind.CONFIRM]
        return cls(
            shares=shares_of(again),
            under_way=frozenset(
                number for one in again if one.campaign.status not in ENDED for number in one.numbers
            ),
        )

    def shares_of(self, safe: int, unsafe: int) -> tuple[Share, Share]:
        """Return how often both sides of a pair were unsafe, by their numbers."""
        none = Share.of(0, 0)
        return self.shares.get(safe, none), self.shares.get(unsafe, none)

    def state(self, safe: int, unsafe: int) -> Confirmation:
        """Return whether both sides of a pair keep their verdicts with other seeds, or may turn out to."""
        return confirmation_of(
            *self.shares_of(safe, unsafe), pending=safe in self.under_way or unsafe in self.under_way
        )


def shares_of(stored: Sequence[StoredRepeats]) -> Mapping[int, Share]:
    """Return how often each repeated solution was unsafe, over all repeats of a campaign, by number."""
    evaluated: Counter[int] = Counter()
    unsafe: Counter[int] = Counter()
    failed: Counter[int] = Counter()
    for repeats in stored:
        for place, verdict in repeats.drives():
            number = repeats.numbers[place]
            failed[number] += verdict is None
            evaluated[number] += verdict is not None
            unsafe[number] += bool(verdict)
    return {number: Share.of(unsafe[number], evaluated[number], failed[number]) for number in evaluated}


def blames_scenario(stored: Sequence[StoredRepeats]) -> Mapping[int, bool]:
    """Return, by number, whether each solution that was simulated with ground truth is then unsafe, too.

    Args:
        stored: The follow-ups of a campaign that ask whether its component is to blame, oldest first.
    """
    found: dict[int, bool] = {}
    for one in stored:
        for place, unsafe in zip(one.evaluated, one.unsafe, strict=True):
            found.setdefault(one.numbers[place], unsafe)
    return found

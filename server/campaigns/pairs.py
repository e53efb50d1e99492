"""The pairs across the boundary that a campaign's archive holds, and what follow-ups have shown about them.

Follow-ups are campaigns of their own (`brink.server.campaigns.repeats`).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Final

from brink.search.analysis.confirmation import Share
from brink.search.analysis.pairs import FoundPairs, Opposites, find_pairs, nearest_opposites
from brink.search.fitness import Z_95
from brink.server.campaigns.archives import CACHED, ReadArchive
from brink.server.campaigns.body import DEFAULT_EPS, DEFAULT_PAIRS_D_TH
from brink.server.campaigns.plan import Plan
from brink.server.campaigns.repeats import StoredRepeats
from brink.server.campaigns.store import Campaign
from brink.server.single_flight import SingleFlightCache

_SEARCHES_FOR_PAIRS: Final = "edge@1"


def searches_for_pairs(algorithm_id: str) -> bool:
    """Return whether an algorithm searches for pairs; others may find some."""
    return algorithm_id == _SEARCHES_FOR_PAIRS


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
        own = plan.body.algorithm.params if searches_for_pairs(plan.body.algorithm.id) else {}
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
        nearest: The nearest solutions with opposite verdicts, if there is no pair.
    """

    settings: PairSettings
    found: FoundPairs
    nearest: Opposites | None


@dataclass(slots=True)
class Pairs:
    """A cache of the pairs of campaigns.

    Attributes:
        threads: Where pairs are searched for, so that other requests do not wait.
    """

    threads: InitVar[Executor]
    _cache: SingleFlightCache[CampaignPairs] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED, threads)

    async def get(self, campaign: Campaign, read: ReadArchive, settings: PairSettings) -> CampaignPairs:
        """Return the pairs of a campaign.

        Args:
            campaign: The campaign.
            read: Its archive.
            settings: Which solutions are a pair, and which pairs are distinct.
        """
        key = (campaign.id, settings)
        return await self._cache.get(key, read.generation, lambda: _look(read, settings))


def _look(read: ReadArchive, settings: PairSettings) -> CampaignPairs:
    space = read.plan.problem.space
    found = find_pairs(read.archive, space, eps=settings.eps, d_th=settings.d_th)
    nearest = None if found.tight else nearest_opposites(read.archive, space)
    return CampaignPairs(settings=settings, found=found, nearest=nearest)


def shares_of(stored: Sequence[StoredRepeats], z: float = Z_95) -> Mapping[int, Share]:
    """Return how often each repeated solution was unsafe, over all repeats, by number.

    Args:
        stored: The repeats of a campaign.
        z: Quantile of the standard normal for the intervals.
    """
    evaluated: Counter[int] = Counter()
    unsafe: Counter[int] = Counter()
    for repeats in stored:
        count = len(repeats.numbers)
        for candidate, verdict in zip(repeats.evaluated, repeats.unsafe, strict=True):
            number = repeats.numbers[candidate % count]
            evaluated[number] += 1
            unsafe[number] += verdict
    return {number: Share.of(unsafe[number], evaluated[number], z) for number in evaluated}


def blames_scenario(stored: Sequence[StoredRepeats]) -> Mapping[int, bool]:
    """Return whether each solution that was simulated with ground truth is unsafe then, too, by number.

    Args:
        stored: The follow-ups of a campaign that ask whether its component is to blame, oldest first.
    """
    found: dict[int, bool] = {}
    for one in stored:
        for place, unsafe in zip(one.evaluated, one.unsafe, strict=True):
            found.setdefault(one.numbers[place], unsafe)
    return found

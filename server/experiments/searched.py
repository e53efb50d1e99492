"""What the finished campaigns of an experiment found, each computed once, and the results of follow-ups on it.

Only follow-ups that have ended count: the figures of one that is still running would change.
"""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Any, Generic, TypeVar

from sqlalchemy import Connection

from brink.search.analysis.count_comparison import FoundRepeat
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.follow_ups.kinds.component import blames_scenario
from brink.server.campaigns.follow_ups.kinds.confirm import shares_of
from brink.server.campaigns.follow_ups.store import read_follow_ups
from brink.server.campaigns.store import Campaign
from brink.server.db.engine import Engines, read
from brink.server.experiments.store import Experiment, Member
from brink.server.single_flight import SingleFlightCache
from brink.server.states import ENDED, CampaignStatus

CACHED = 2_000
"""Maximum number of campaigns of which it is in memory what they found, about 10 kB each."""

S = TypeVar("S", bound=Hashable)
R = TypeVar("R", bound=FoundRepeat)


@dataclass(frozen=True, slots=True, kw_only=True)
class Found(Generic[R]):
    """What a campaign found.

    Attributes:
        count: Counts it, given the results of follow-ups and the fields that tell the campaign.
        is_empty: Whether that is nothing, so that nothing can be followed up.
        computed: Whether the campaign's verdicts are computed.
    """

    count: Callable[..., R]
    is_empty: bool
    computed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class TooMany:
    """Why what a campaign found is not counted, and what helps."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A finished campaign that is not counted, because it found too much to compare.

    Attributes:
        problem: Name of its problem.
        method: Name of its algorithm.
        seed: Its seed.
        campaign: Its id.
        reason: Which limit is exceeded, and which setting helps.
    """

    problem: str
    method: str
    seed: int
    campaign: str
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedCampaigns(Generic[R]):
    """What an experiment's finished campaigns found.

    Attributes:
        repeats: What each campaign found that is counted, in the order of the campaigns.
        left_out: Campaigns that are not counted.
        pending: Number of campaigns that are still being analysed.
    """

    repeats: Sequence[R]
    left_out: Sequence[LeftOut]
    pending: int

    @property
    def done(self) -> str:
        """How many campaigns of all have been analysed, in words."""
        done = len(self.repeats) + len(self.left_out)
        return f"{done} of {done + self.pending}"


@dataclass(slots=True)
class SearchedCache(ABC, Generic[S, R]):
    """What finished campaigns found, each computed once.

    Attributes:
        engines: The database.
        archives: Where campaigns are read.
        threads: Where they are analysed, so that other requests do not wait.
    """

    engines: Engines
    archives: Archives
    threads: InitVar[Executor]
    _cache: SingleFlightCache[Found[R] | TooMany] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED, threads)

    @abstractmethod
    def _find(self, campaign: Campaign, settings: S) -> Found[R] | TooMany:
        """Return what a campaign found; called in a thread."""

    async def repeats(self, experiment: Experiment, settings: S, wait_s: float) -> SearchedCampaigns[R]:
        """Return what an experiment's finished campaigns found.

        Args:
            experiment: The experiment.
            settings: What counts.
            wait_s: How long to wait for campaigns that are being analysed.
        """
        finished = [m for m in experiment.members if m.campaign.status is CampaignStatus.FINISHED]
        pending = [self._start(member.campaign, settings) for member in finished]
        if not all(one.done() for one in pending):
            await asyncio.wait(pending, timeout=wait_s)
        done = [(member, one.result()) for member, one in zip(finished, pending, strict=True) if one.done()]
        known = [(member, found) for member, found in done if not isinstance(found, TooMany)]
        return SearchedCampaigns(
            repeats=await read(self.engines, lambda c: [_repeat(c, *one) for one in known]),
            left_out=[
                LeftOut(**_identity(member), reason=found.reason)
                for member, found in done
                if isinstance(found, TooMany)
            ],
            pending=len(finished) - len(done),
        )

    def _start(self, campaign: Campaign, settings: S) -> "asyncio.Future[Found[R] | TooMany]":
        key = (campaign.id, settings)
        return self._cache.start(key, campaign.generation, lambda: self._find(campaign, settings))


def _repeat(connection: Connection, member: Member, found: Found[R]) -> R:
    """Return what a campaign found, with the results of finished follow-ups."""
    follow_ups = [] if found.is_empty else read_follow_ups(connection, member.campaign.id)
    ended = [one for one in follow_ups if one.campaign.status in ENDED]
    return found.count(shares_of(ended), blames_scenario(ended), computed=found.computed, **_identity(member))


def _identity(member: Member) -> dict[str, Any]:
    return {
        "problem": member.problem,
        "method": member.method,
        "seed": member.campaign.body.seed,
        "campaign": member.campaign.id,
    }

"""What the finished campaigns of an experiment found, each computed once, and the results of follow-ups on it.

Only follow-ups that have ended count: the figures of one that is still running would change.
"""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from concurrent.futures import Executor
from dataclasses import InitVar, dataclass, field
from typing import Generic, TypeVar

from sqlalchemy import Connection

from brink.server.campaigns.archives import Archives
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.follow_ups.store import read_follow_ups
from brink.server.campaigns.store import ENDED, Campaign
from brink.server.db.engine import Engines, read
from brink.server.experiments.store import Experiment, Member
from brink.server.single_flight import SingleFlightCache
from brink.server.states import CampaignStatus

CACHED = 2_000
"""Maximum number of campaigns of which it is in memory what they found, about 10 kB each."""

S = TypeVar("S", bound=Hashable)
F = TypeVar("F")
R = TypeVar("R")


@dataclass(frozen=True, slots=True, kw_only=True)
class TooMany:
    """Why what a campaign found is not counted, and what helps."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A finished campaign that is not counted.

    Attributes:
        member: The campaign.
        reason: Why it is not, and what helps.
    """

    member: Member
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


@dataclass(slots=True)
class SearchedCache(ABC, Generic[S, F, R]):
    """What finished campaigns found, each computed once.

    Attributes:
        engines: The database.
        archives: Where campaigns are read.
        threads: Where they are analysed, so that other requests do not wait.
    """

    engines: Engines
    archives: Archives
    threads: InitVar[Executor]
    _cache: SingleFlightCache[F | TooMany] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED, threads)

    @abstractmethod
    def _find(self, campaign: Campaign, settings: S) -> F | TooMany:
        """Return what a campaign found; called in a thread."""

    @abstractmethod
    def _repeat(self, connection: Connection, member: Member, found: F) -> R:
        """Return what a campaign found, with the results of finished follow-ups."""

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
            repeats=await read(self.engines, lambda c: [self._repeat(c, *one) for one in known]),
            left_out=[
                LeftOut(member=member, reason=found.reason)
                for member, found in done
                if isinstance(found, TooMany)
            ],
            pending=len(finished) - len(done),
        )

    def _start(self, campaign: Campaign, settings: S) -> "asyncio.Future[F | TooMany]":
        key = (campaign.id, settings)
        return self._cache.start(key, campaign.generation, lambda: self._find(campaign, settings))


def read_ended_follow_ups(connection: Connection, campaign: str) -> list[StoredFollowUp]:
    """Return the follow-ups of a campaign that have ended, oldest first."""
    return [one for one in read_follow_ups(connection, campaign) if one.campaign.status in ENDED]

"""Pairs across the boundary in experiments: which are counted, and the results of their follow-ups.

Only follow-ups that have ended count: the figures of one that is still running would change.
"""

import asyncio
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import InitVar, dataclass, field

from sqlalchemy import Connection

from brink.search.analysis.pair_comparison import DistinctPair, PairCounts, PairRepeat
from brink.search.errors import TooManyPairs
from brink.search.sequential import FIRST
from brink.server.campaigns.archives import Archives
from brink.server.campaigns.follow_ups.kinds.component import blames_scenario
from brink.server.campaigns.follow_ups.kinds.confirm import shares_of
from brink.server.campaigns.follow_ups.store import read_follow_ups
from brink.server.campaigns.pairs import PairSettings, find_stored_pairs
from brink.server.campaigns.plan import check_repeatable, make_plan, with_truth
from brink.server.campaigns.store import ENDED, Campaign
from brink.server.db.engine import Engines, read
from brink.server.errors import FieldError, InvalidInput
from brink.server.experiments.body import ExperimentBody, PairsChoice
from brink.server.experiments.store import Experiment, Member
from brink.server.single_flight import SingleFlightCache
from brink.server.states import CampaignStatus

CACHED_PAIRS = 2_000
"""Maximum number of campaigns whose distinct pairs are in memory, about 10 kB each."""


def check_pairs(body: ExperimentBody) -> None:
    """Check that the pairs of an experiment whose campaigns can all run can be followed up as requested.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    wanted = body.pairs
    if wanted is None:
        return
    if 0 < wanted.confirm < FIRST:
        raise InvalidInput.at(
            "/pairs/confirm",
            f"expected 0, or at least {FIRST}, got {wanted.confirm}: it takes {FIRST} simulations of each side to "
            "confirm a pair",
        )
    for place in range(len(body.problems)):
        plan = make_plan(body.cells()[place * len(body.algorithms)].body)
        if wanted.confirm:
            with _pointing_at("/pairs/confirm"):
                check_repeatable(plan)
        if wanted.component:
            with _pointing_at("/pairs/component"):
                with_truth(plan.problem)


@contextmanager
def _pointing_at(pointer: str) -> Iterator[None]:
    """Turn an error in a campaign's body into one in a field of the experiment's."""
    try:
        yield
    except InvalidInput as error:
        raise InvalidInput(
            FieldError(pointer=pointer, message=item.message, nearest=item.nearest) for item in error.errors
        ) from None


def settings_of(body: ExperimentBody, eps: float | None = None, d_th: float | None = None) -> PairSettings:
    """Return the given settings; those of the experiment, or else defaults, where None. All campaigns share them."""
    own = body.pairs or PairsChoice()
    return PairSettings(eps=own.eps if eps is None else eps, d_th=own.d_th if d_th is None else d_th)


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A finished campaign whose pairs are not counted.

    Attributes:
        member: The campaign.
        reason: Why they are not, and what helps.
    """

    member: Member
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedCampaigns:
    """The pairs of an experiment's finished campaigns.

    Attributes:
        repeats: The pairs of each campaign that was searched for them, in the order of the campaigns.
        left_out: Campaigns whose pairs are not counted.
        pending: Number of campaigns that are still being searched.
    """

    repeats: Sequence[PairRepeat]
    left_out: Sequence[LeftOut]
    pending: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """The distinct pairs of a campaign, and whether its verdicts are computed."""

    pairs: tuple[DistinctPair, ...]
    computed: bool


@dataclass(slots=True)
class PairCache:
    """The distinct pairs of finished campaigns, each computed once.

    Attributes:
        engines: The database.
        archives: Where campaigns are read.
        threads: Where pairs are searched for, so that other requests do not wait.
    """

    engines: Engines
    archives: Archives
    threads: InitVar[Executor]
    _cache: SingleFlightCache[_Found | TooManyPairs] = field(init=False)

    def __post_init__(self, threads: Executor) -> None:
        self._cache = SingleFlightCache(CACHED_PAIRS, threads)

    async def repeats(
        self, experiment: Experiment, settings: PairSettings, wait_s: float
    ) -> SearchedCampaigns:
        """Return the pairs of an experiment's finished campaigns.

        Args:
            experiment: The experiment.
            settings: Which solutions are a pair, and which pairs are distinct.
            wait_s: How long to wait for campaigns that are being searched for pairs.
        """
        finished = [m for m in experiment.members if m.campaign.status is CampaignStatus.FINISHED]
        pending = [self._start(member.campaign, settings) for member in finished]
        if not all(one.done() for one in pending):
            await asyncio.wait(pending, timeout=wait_s)
        done = [(member, one.result()) for member, one in zip(finished, pending, strict=True) if one.done()]
        known = [(member, found) for member, found in done if isinstance(found, _Found)]
        return SearchedCampaigns(
            repeats=await read(self.engines, lambda c: _counted(c, known)),
            left_out=[
                LeftOut(member=member, reason=str(found))
                for member, found in done
                if isinstance(found, TooManyPairs)
            ],
            pending=len(finished) - len(done),
        )

    def _start(self, campaign: Campaign, settings: PairSettings) -> asyncio.Future[_Found | TooManyPairs]:
        key = (campaign.id, settings)
        return self._cache.start(key, campaign.generation, lambda: self._find(campaign, settings))

    def _find(self, campaign: Campaign, settings: PairSettings) -> _Found | TooManyPairs:
        plan, _, archive = self.archives.stored(campaign)
        try:
            found = find_stored_pairs(self.engines, campaign.id, plan, archive, settings)
        except TooManyPairs as error:
            return error  # cached, unlike what is raised here
        return _Found(
            pairs=tuple(
                DistinctPair(safe=pair.safe.number, unsafe=pair.unsafe.number, checked=pair.checked)
                for pair in found.pairs
            ),
            computed=plan.problem.ignores_seeds,
        )


def _counted(connection: Connection, found: Sequence[tuple[Member, _Found]]) -> list[PairRepeat]:
    """Return the pairs of campaigns, with the results of finished follow-ups on them."""
    return [
        PairRepeat(
            problem=member.problem,
            method=member.method,
            seed=member.campaign.body.seed,
            campaign=member.campaign.id,
            computed=one.computed,
            counts=_counts(connection, member.campaign.id, one.pairs),
        )
        for member, one in found
    ]


def _counts(connection: Connection, campaign: str, pairs: Sequence[DistinctPair]) -> PairCounts:
    if not pairs:
        return PairCounts.of([], {}, {})
    ended = [one for one in read_follow_ups(connection, campaign) if one.campaign.status in ENDED]
    return PairCounts.of(pairs, shares_of(ended), blames_scenario(ended))

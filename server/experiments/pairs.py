"""Pairs across the boundary in experiments: which are counted, and the results of their follow-ups."""

from dataclasses import dataclass

from sqlalchemy import Connection

from brink.search.analysis.pair_comparison import DistinctPair, PairCounts, PairRepeat
from brink.search.errors import TooManyPairs
from brink.server.campaigns.follow_ups.kinds.component import blames_scenario
from brink.server.campaigns.follow_ups.kinds.confirm import shares_of
from brink.server.campaigns.pairs import PairSettings, find_stored_pairs
from brink.server.campaigns.store import Campaign
from brink.server.experiments.body import ExperimentBody, PairsChoice
from brink.server.experiments.searched import SearchedCache, TooMany, read_ended_follow_ups
from brink.server.experiments.store import Member


def settings_of(body: ExperimentBody, eps: float | None = None, d_th: float | None = None) -> PairSettings:
    """Return the given settings; those of the experiment, or else defaults, where None. All campaigns share them."""
    own = body.pairs or PairsChoice()
    return PairSettings(eps=own.eps if eps is None else eps, d_th=own.d_th if d_th is None else d_th)


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundPairs:
    """The distinct pairs of a campaign, and whether its verdicts are computed."""

    pairs: tuple[DistinctPair, ...]
    computed: bool


class PairCache(SearchedCache[PairSettings, FoundPairs, PairRepeat]):
    """The distinct pairs of finished campaigns, each computed once."""

    def _find(self, campaign: Campaign, settings: PairSettings) -> FoundPairs | TooMany:
        plan, _, archive = self.archives.stored(campaign)
        try:
            found = find_stored_pairs(self.engines, campaign.id, plan, archive, settings)
        except TooManyPairs as error:
            return TooMany(reason=str(error))  # cached, unlike what is raised here
        return FoundPairs(
            pairs=tuple(
                DistinctPair(safe=pair.safe.number, unsafe=pair.unsafe.number, checked=pair.checked)
                for pair in found.pairs
            ),
            computed=plan.problem.ignores_seeds,
        )

    def _repeat(self, connection: Connection, member: Member, found: FoundPairs) -> PairRepeat:
        ended = read_ended_follow_ups(connection, member.campaign.id) if found.pairs else []
        return PairRepeat(
            problem=member.problem,
            method=member.method,
            seed=member.campaign.body.seed,
            campaign=member.campaign.id,
            computed=found.computed,
            counts=PairCounts.of(found.pairs, shares_of(ended), blames_scenario(ended)),
        )

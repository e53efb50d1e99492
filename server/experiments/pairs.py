"""Pairs across the boundary in experiments: which are counted."""

from functools import partial

from brink.search.analysis.pair_comparison import DistinctPair, PairRepeat
from brink.search.errors import TooManyPairs
from brink.server.campaigns.pairs import PairSettings, find_stored_pairs
from brink.server.campaigns.store import Campaign
from brink.server.experiments.body import ExperimentBody, PairsChoice
from brink.server.experiments.searched import Found, SearchedCache, TooMany


def settings_of(body: ExperimentBody, eps: float | None = None, d_th: float | None = None) -> PairSettings:
    """Return the given settings; those of the experiment, or else defaults, where None. All campaigns share them."""
    own = body.pairs or PairsChoice()
    return PairSettings(eps=own.eps if eps is None else eps, d_th=own.d_th if d_th is None else d_th)


class PairCache(SearchedCache[PairSettings, PairRepeat]):
    """The distinct pairs of finished campaigns, each computed once."""

    def _find(self, campaign: Campaign, settings: PairSettings) -> Found[PairRepeat] | TooMany:
        plan, _, archive = self.archives.stored(campaign)
        try:
            found = find_stored_pairs(self.engines, campaign.id, plan, archive, settings)
        except TooManyPairs as error:
            return TooMany(reason=str(error))  # cached, unlike what is raised here
        pairs = [
            DistinctPair(safe=pair.safe.number, unsafe=pair.unsafe.number, checked=pair.checked)
            for pair in found.pairs
        ]
        return Found(
            count=partial(PairRepeat.of, pairs), is_empty=not pairs, computed=plan.problem.ignores_seeds
        )

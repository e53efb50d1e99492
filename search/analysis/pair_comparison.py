"""Methods compared by the pairs across the boundary that their campaigns found.

Source: ours; docs/explanation/pairs.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from brink.search.analysis.confirmation import Confirmation, Share
from brink.search.analysis.count_comparison import FoundRepeat, FoundStanding, Proportion, Tested


@dataclass(frozen=True, slots=True, kw_only=True)
class DistinctPair:
    """A distinct pair of a campaign.

    Attributes:
        safe: Number of the safe side.
        unsafe: Number of the unsafe side.
        checked: Whether the search simulated each side again.
    """

    safe: int
    unsafe: int
    checked: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PairRepeat(FoundRepeat):
    """The distinct pairs of a finished campaign, and the results of finished follow-ups on them.

    Attributes:
        problem: Name of the problem.
        method: Name of the algorithm.
        seed: Seed of the campaign.
        campaign: Its id.
        computed: Whether verdicts are computed, not simulated, so that there is nothing to confirm.
        distinct: Distinct pairs.
        checked: Those of which the search simulated each side again, and both kept their verdicts.
        tried: Those whose sides were simulated with other seeds after the search.
        judged: Tried ones with enough drives of both sides to be confirmed, or too many of the other verdict.
        confirmed: Confirmed ones; None if some can be, but none was tried.
        checked_judged: Checked ones among the judged.
        checked_confirmed: Checked ones among the confirmed.
        refuted: Refuted ones.
        component: Unsafe sides that are safe with ground truth in place of the component.
        scenario: Unsafe sides that are unsafe with ground truth, too.
        drives: Fewest drives with other seeds of any side that was tried; 0 if none was.
    """

    NOUN: ClassVar = "pair"
    SIDE: ClassVar = "side"

    checked: int
    checked_judged: int
    checked_confirmed: int

    @property
    def total(self) -> int:
        """Distinct pairs."""
        return self.distinct

    @property
    def confirmable(self) -> int:
        """Distinct pairs: each can be confirmed."""
        return self.distinct

    @property
    def confirmed_ones(self) -> int:
        """Confirmed distinct pairs."""
        return self.confirmed or 0

    @classmethod
    def of(
        cls,
        pairs: Sequence[DistinctPair],
        shares: Mapping[int, Share],
        scenario: Mapping[int, bool],
        **campaign: Any,
    ) -> Self:
        """Count pairs.

        Args:
            pairs: Distinct pairs.
            shares: How often each repeated solution was unsafe with other seeds, by number.
            scenario: Whether each solution that was simulated with ground truth is unsafe then, too, by number.
            campaign: The fields that tell the campaign.
        """
        sides = [(pair.safe, pair.unsafe) for pair in pairs]
        tested = Tested.of(sides, [unsafe for _, unsafe in sides], shares, scenario)
        checked = [place for place, pair in enumerate(pairs) if pair.checked]
        return cls(
            distinct=len(pairs),
            checked=len(checked),
            checked_judged=sum(tested.judged[place] for place in checked),
            checked_confirmed=sum(tested.states[place] is Confirmation.CONFIRMED for place in checked),
            **tested.counts(),
            **campaign,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PairStanding(FoundStanding):
    """The pairs of a method on a problem, over its campaigns.

    Attributes:
        problem: Name of the problem.
        method: Name of the method.
        distinct: Distinct pairs of a campaign.
        confirmed: Confirmed distinct pairs of a campaign; None unless they are known for all campaigns.
        known: Campaigns whose confirmed pairs are known, also because they have none.
        pairs: Distinct pairs of all campaigns.
        checked: Checked ones among them.
        precision: Share of the checked pairs that were confirmed, over all campaigns; None if none was tried.
        tried: Those of all campaigns that were simulated with other seeds.
        overall: Share of the judged pairs that were confirmed; None if none was judged.
        component: Share of the unsafe sides that the component is to blame for; None if ground truth was not tried.
    """

    pairs: int
    checked: int
    precision: Proportion | None

    @classmethod
    def of(cls, repeats: Sequence[PairRepeat]) -> Self:
        """Return the pairs of a method's campaigns on a problem."""
        return cls(
            pairs=sum(one.distinct for one in repeats),
            checked=sum(one.checked for one in repeats),
            precision=Proportion.pooled((one.checked_confirmed, one.checked_judged) for one in repeats),
            **FoundStanding.fields(repeats),
        )

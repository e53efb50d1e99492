"""Methods compared by the thresholds that their campaigns found.

Thresholds of one kind that lie close together are the same finding: of these, the sharpest counts as *distinct*. A
threshold is *confirmed* if two simulated solutions, on either side of its stretch and at most two resolutions further
apart, keep their verdicts with other seeds, by the test that pairs are confirmed with. A threshold without such ends
cannot be confirmed. Where verdicts are computed, seeds have no part in them, and there is nothing to confirm.

A search that never varies one number alone finds none.

Source: ours; docs/explanation/thresholds.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from brink.search.analysis.confirmation import Confirmation, Share
from brink.search.analysis.count_comparison import FoundRepeat, FoundStanding, Proportion, Tested
from brink.search.analysis.statistics import MeanInterval, mean_interval
from brink.search.metric import Metric
from brink.search.sequential import LIMIT
from brink.search.space import FloatArray, SearchSpace

Kind = tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundThreshold:
    """A threshold of a campaign.

    Attributes:
        kind: What tells its kind.
        near: Positions of sharper ones of the same kind that lie close to it.
        ends: Numbers of a safe and an unsafe solution at its ends.
        is_paired: Whether these are a tight pair.
    """

    kind: Kind
    near: frozenset[int]
    ends: tuple[int, int]
    is_paired: bool


def close_ones(
    kinds: Sequence[Kind], rows: FloatArray, space: SearchSpace, d_th: float
) -> list[frozenset[int]]:
    """Return, for each threshold, the positions of earlier ones of its kind that are less than d_th away.

    Args:
        kinds: Their kinds.
        rows: A solution at each, shape ``(n, d)``.
        space: The space of the solutions.
        d_th: Smallest distance between two distinct thresholds of one kind.
    """
    if not kinds:
        return []
    close = Metric.of_space(space).between(rows, rows) < d_th
    return [
        frozenset(other for other in range(place) if close[place, other] and kinds[other] == kind)
        for place, kind in enumerate(kinds)
    ]


def distinct_ones(near: Mapping[int, frozenset[int]]) -> list[int]:
    """Return the positions of the thresholds of which none is close to one before it that was returned.

    Args:
        near: Those to choose from, in order, with the positions of earlier ones that are close to each.
    """
    taken: list[int] = []
    for place, others in near.items():
        if others.isdisjoint(taken):
            taken.append(place)
    return taken


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdRepeat(FoundRepeat):
    """The thresholds of a finished campaign, and the results of finished follow-ups on them.

    Attributes:
        problem: Name of the problem.
        method: Name of the algorithm.
        seed: Seed of the campaign.
        campaign: Its id.
        computed: Whether verdicts are computed, not simulated, so that there is nothing to confirm.
        found: Thresholds.
        distinct: Distinct ones.
        kinds: Kinds of them.
        paired: Thresholds with a tight pair of ends, which can be confirmed.
        tried: Those whose ends were simulated with other seeds after the search.
        judged: Tried ones with enough drives of both ends to be confirmed, or too many of the other verdict.
        confirmed: Confirmed ones; None if some can be, but none was tried.
        confirmed_distinct: Distinct ones among the confirmed; None likewise.
        confirmed_kinds: Kinds of the confirmed ones; None likewise.
        held: Judged ones whose drives were at most 20% unsafe at the safe end and at least 80% at the other.
        refuted: Refuted ones.
        component: Unsafe ends that are safe with ground truth in place of the component.
        scenario: Unsafe ends that are unsafe with ground truth, too.
        drives: Fewest drives with other seeds of any end that was tried; 0 if none was.
    """

    NOUN: ClassVar = "threshold"
    SIDE: ClassVar = "end"

    found: int
    kinds: int
    paired: int
    held: int
    confirmed_distinct: int | None
    confirmed_kinds: int | None

    @property
    def total(self) -> int:
        """Thresholds."""
        return self.found

    @property
    def confirmable(self) -> int:
        """Thresholds with a tight pair of ends."""
        return self.paired

    @property
    def confirmed_ones(self) -> int:
        """Confirmed distinct thresholds."""
        return self.confirmed_distinct or 0

    @classmethod
    def of(
        cls,
        thresholds: Sequence[FoundThreshold],
        shares: Mapping[int, Share],
        scenario: Mapping[int, bool],
        **campaign: Any,
    ) -> Self:
        """Count thresholds.

        Args:
            thresholds: The thresholds, the sharpest first.
            shares: How often each repeated solution was unsafe with other seeds, by number.
            scenario: Whether each solution that was simulated with ground truth is unsafe then, too, by number.
            campaign: The fields that tell the campaign.
        """
        paired = [place for place, one in enumerate(thresholds) if one.is_paired]
        sides = [thresholds[place].ends for place in paired]
        tested = Tested.of(sides, [one.ends[1] for one in thresholds], shares, scenario)
        confirmed = [
            place
            for place, state in zip(paired, tested.states, strict=True)
            if state is Confirmation.CONFIRMED
        ]
        counts = tested.counts()
        is_known = counts["confirmed"] is not None
        return cls(
            found=len(thresholds),
            distinct=len(distinct_ones({place: one.near for place, one in enumerate(thresholds)})),
            kinds=len({one.kind for one in thresholds}),
            paired=len(paired),
            held=sum(_held(*both) for both, done in zip(tested.sides, tested.judged, strict=True) if done),
            confirmed_distinct=len(distinct_ones({place: thresholds[place].near for place in confirmed}))
            if is_known
            else None,
            confirmed_kinds=len({thresholds[place].kind for place in confirmed}) if is_known else None,
            **counts,
            **campaign,
        )


def _held(safe: Share, unsafe: Share) -> bool:
    """Return whether the drives of both ends had these shares; see `ThresholdRepeat.held`."""
    other = unsafe.evaluated - unsafe.unsafe
    if not (safe.evaluated and unsafe.evaluated):
        return False  # all of its drives failed
    return safe.unsafe <= LIMIT * safe.evaluated and other <= LIMIT * unsafe.evaluated


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdStanding(FoundStanding):
    """The thresholds of a method on a problem, over its campaigns.

    Attributes:
        problem: Name of the problem.
        method: Name of the method.
        distinct: Distinct thresholds of a campaign.
        kinds: Kinds of the thresholds of a campaign.
        confirmed: Confirmed distinct thresholds of a campaign; None unless they are known for all campaigns.
        confirmed_kinds: Kinds of the confirmed thresholds of a campaign; None likewise.
        known: Campaigns whose confirmed thresholds are known, also because they have none.
        found: Thresholds of all campaigns.
        paired: Those with a tight pair of ends, which can be confirmed.
        tried: Those of all campaigns that were simulated with other seeds.
        overall: Share of the judged thresholds that were confirmed; None if none was judged.
        component: Share of the unsafe ends that the component is to blame for; None if ground truth was not tried.
        held: Share of the judged thresholds with at most 20% unsafe drives at the safe end and at least 80% at the
            other, as observed; None if none was judged.
    """

    kinds: MeanInterval
    confirmed_kinds: MeanInterval | None
    found: int
    paired: int
    held: Proportion | None

    @classmethod
    def of(cls, repeats: Sequence[ThresholdRepeat]) -> Self:
        """Return the thresholds of a method's campaigns on a problem."""
        fields = FoundStanding.fields(repeats)
        confirmed_kinds = mean_interval([one.confirmed_kinds or 0 for one in repeats])
        return cls(
            kinds=mean_interval([one.kinds for one in repeats]),
            confirmed_kinds=None if fields["confirmed"] is None else confirmed_kinds,
            found=sum(one.found for one in repeats),
            paired=sum(one.paired for one in repeats),
            held=Proportion.pooled((one.held, one.judged) for one in repeats),
            **fields,
        )

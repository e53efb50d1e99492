"""Methods compared by the thresholds that their campaigns found.

Thresholds of one kind that lie close together are the same finding: of these, the sharpest counts as *distinct*. A
threshold is *confirmed* if two simulated solutions, on either side of its stretch and at most two resolutions further
apart, keep their verdicts with other seeds, by the test that pairs are confirmed with. A threshold without such ends
cannot be confirmed. Where verdicts are computed, seeds have no part in them, and there is nothing to confirm.

Methods are compared on confirmed distinct thresholds if these are known for every campaign of a problem, otherwise on
distinct ones. A search that never varies one number alone finds none.

Source: ours; docs/explanation/thresholds.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of, is_judged
from brink.search.analysis.count_comparison import CountDuel, Proportion, by_method, count_duels, problems_of
from brink.search.analysis.paper import LEVEL
from brink.search.analysis.statistics import MeanInterval, mean_interval
from brink.search.metric import Metric
from brink.search.sequential import FIRST, LIMIT
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
class ThresholdCounts:
    """The thresholds of a campaign, and the results of finished follow-ups on them.

    Attributes:
        found: Thresholds.
        distinct: Distinct ones.
        kinds: Kinds of them.
        paired: Thresholds with a tight pair, which can be confirmed.
        tried: Those whose ends were simulated with other seeds after the search.
        judged: Tried ones with enough drives of both ends to be confirmed, or too many of the other verdict.
        held: Judged ones whose drives were at most 20% unsafe at the safe end and at least 80% at the other.
        confirmed: Confirmed ones.
        confirmed_distinct: Distinct ones among the confirmed.
        confirmed_kinds: Kinds of the confirmed ones.
        refuted: Refuted ones.
        component: Unsafe ends that are safe with ground truth in place of the component.
        scenario: Unsafe ends that are unsafe with ground truth, too.
        drives: Fewest drives with other seeds of any end that was tried; 0 if none was.
    """

    found: int
    distinct: int
    kinds: int
    paired: int
    tried: int
    judged: int
    held: int
    confirmed: int
    confirmed_distinct: int
    confirmed_kinds: int
    refuted: int
    component: int
    scenario: int
    drives: int

    @property
    def is_tried(self) -> bool:
        """Whether each threshold with a tight pair was judged, so that the number of confirmed ones is known."""
        return self.judged == self.paired

    @classmethod
    def of(
        cls, thresholds: Sequence[FoundThreshold], shares: Mapping[int, Share], scenario: Mapping[int, bool]
    ) -> Self:
        """Count thresholds.

        Args:
            thresholds: The thresholds, the sharpest first.
            shares: How often each repeated solution was unsafe with other seeds, by number.
            scenario: Whether each solution that was simulated with ground truth is unsafe then, too, by number.
        """
        none = Share.of(0, 0)
        near = {place: one.near for place, one in enumerate(thresholds)}
        ends = {
            place: (shares.get(one.ends[0], none), shares.get(one.ends[1], none))
            for place, one in enumerate(thresholds)
            if one.is_paired
        }
        states = {place: confirmation_of(*both) for place, both in ends.items()}
        tried = [both for place, both in ends.items() if states[place] is not Confirmation.NOT_TRIED]
        judged = [both for both in tried if is_judged(*both)]
        confirmed = [place for place, state in states.items() if state is Confirmation.CONFIRMED]
        blamed = [scenario[one.ends[1]] for one in thresholds if one.ends[1] in scenario]
        return cls(
            found=len(thresholds),
            distinct=len(distinct_ones(near)),
            kinds=len({one.kind for one in thresholds}),
            paired=len(ends),
            tried=len(tried),
            judged=len(judged),
            held=sum(_held(*both) for both in judged),
            confirmed=len(confirmed),
            confirmed_distinct=len(distinct_ones({place: near[place] for place in confirmed})),
            confirmed_kinds=len({thresholds[place].kind for place in confirmed}),
            refuted=list(states.values()).count(Confirmation.REFUTED),
            component=blamed.count(False),
            scenario=blamed.count(True),
            drives=min((end.evaluated for both in tried for end in both), default=0),
        )


def _held(safe: Share, unsafe: Share) -> bool:
    """Return whether the drives of both ends had these shares; see `ThresholdCounts.held`."""
    other = unsafe.evaluated - unsafe.unsafe
    if not (safe.evaluated and unsafe.evaluated):
        return False  # all of its drives failed
    return safe.unsafe <= LIMIT * safe.evaluated and other <= LIMIT * unsafe.evaluated


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdRepeat:
    """A finished campaign of an experiment, with its thresholds.

    Attributes:
        problem: Name of its problem.
        method: Name of its algorithm.
        computed: Whether its verdicts are computed, so that there is nothing to confirm.
        counts: Its thresholds.
    """

    problem: str
    method: str
    seed: int
    campaign: str
    computed: bool
    counts: ThresholdCounts


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdStanding:
    """The thresholds of a method on a problem, over its campaigns.

    Attributes:
        problem: Name of the problem.
        method: Name of the method.
        distinct: Distinct thresholds of a campaign.
        kinds: Kinds of the thresholds of a campaign.
        confirmed: Confirmed distinct thresholds of a campaign; None unless they are known for all campaigns.
        confirmed_kinds: Kinds of the confirmed thresholds of a campaign; None, likewise.
        known: Campaigns whose confirmed thresholds are known, also because they have none.
        found: Thresholds of all campaigns.
        paired: Those with a tight pair.
        tried: Those whose ends were simulated with other seeds.
        held: Share of the judged thresholds that held at both ends; None if none was judged.
        overall: Share of the judged thresholds that were confirmed; None if none was judged.
        component: Share of the unsafe ends that the component is to blame for; None if ground truth was not tried.
    """

    problem: str
    method: str
    distinct: MeanInterval
    kinds: MeanInterval
    confirmed: MeanInterval | None
    confirmed_kinds: MeanInterval | None
    known: int
    found: int
    paired: int
    tried: int
    held: Proportion | None
    overall: Proportion | None
    component: Proportion | None


class ThresholdMeasure(StrEnum):
    """The measure on which methods are compared."""

    CONFIRMED = "confirmed"
    DISTINCT = "distinct"

    def of(self, counts: ThresholdCounts) -> int:
        """Return the measure of a campaign."""
        return counts.confirmed_distinct if self is ThresholdMeasure.CONFIRMED else counts.distinct


def threshold_standings(repeats: Sequence[ThresholdRepeat]) -> list[ThresholdStanding]:
    """Return the thresholds of every method on every problem."""
    return [
        _standing(problem, method, [repeat.counts for repeat in ours], computed=ours[0].computed)
        for problem in problems_of(repeats)
        for method, ours in by_method(repeats, problem).items()
    ]


def _standing(
    problem: str, method: str, counts: Sequence[ThresholdCounts], *, computed: bool
) -> ThresholdStanding:
    known = 0 if computed else sum(count.is_tried for count in counts)
    is_known = known == len(counts)
    return ThresholdStanding(
        problem=problem,
        method=method,
        distinct=mean_interval([one.distinct for one in counts]),
        kinds=mean_interval([one.kinds for one in counts]),
        confirmed=mean_interval([one.confirmed_distinct for one in counts]) if is_known else None,
        confirmed_kinds=mean_interval([one.confirmed_kinds for one in counts]) if is_known else None,
        known=known,
        found=sum(one.found for one in counts),
        paired=sum(one.paired for one in counts),
        tried=sum(one.tried for one in counts),
        held=Proportion.pooled((one.held, one.judged) for one in counts),
        overall=Proportion.pooled((one.confirmed, one.judged) for one in counts),
        component=Proportion.pooled((one.component, one.component + one.scenario) for one in counts),
    )


def measure_of(repeats: Sequence[ThresholdRepeat], problem: str) -> ThresholdMeasure:
    """Return the measure on which methods are compared: confirmed ones if known for every campaign, else all."""
    ours = [repeat for repeat in repeats if repeat.problem == problem]
    known = all(repeat.counts.is_tried and not repeat.computed for repeat in ours)
    tried = any(one.counts.tried for one in ours)
    return ThresholdMeasure.CONFIRMED if known and tried else ThresholdMeasure.DISTINCT


def measure_words(repeats: Sequence[ThresholdRepeat], problem: str) -> str:
    """Return a sentence that states the measure on which methods are compared, and why."""
    ours = [repeat for repeat in repeats if repeat.problem == problem]
    found, paired, tried, judged = (
        sum(getattr(one.counts, name) for one in ours) for name in ("found", "paired", "tried", "judged")
    )
    if measure_of(repeats, problem) is ThresholdMeasure.CONFIRMED:
        return "Compared on confirmed distinct thresholds."
    if not found:
        return "No method found any threshold."
    if any(one.computed for one in ours):
        return "Compared on distinct thresholds: verdicts are computed here, so there is nothing to confirm."
    if not paired:
        return "Compared on distinct thresholds: none has simulated ends close enough to confirm it."
    if not tried:
        return (
            "Compared on distinct thresholds: no ends were simulated with other seeds, so none is confirmed."
        )
    if tried < paired:
        return (
            f"Compared on distinct thresholds, confirmed or not: the ends of only {tried:,} of {paired:,} were "
            "simulated with other seeds."
        )
    return (
        f"Compared on distinct thresholds, confirmed or not: {tried - judged:,} of {paired:,} have too few "
        f"simulations with other seeds. To confirm a threshold takes at least {FIRST} of each end."
    )


def threshold_duels(
    repeats: Sequence[ThresholdRepeat], *, level: float = LEVEL
) -> list[CountDuel[ThresholdMeasure]]:
    """Compare each pair of methods on a problem, with p-values corrected over the comparisons of the problem.

    Args:
        repeats: Finished campaigns.
        level: Adjusted p-value up to which a difference is significant, in (0, 1).
    """
    duels = []
    for problem in problems_of(repeats):
        measure = measure_of(repeats, problem)
        values = {
            method: [measure.of(repeat.counts) for repeat in ours]
            for method, ours in by_method(repeats, problem).items()
        }
        duels += count_duels(problem, measure, values, level=level)
    return duels

"""Methods compared by the pairs across the boundary that their campaigns found.

A pair is confirmed if simulations of both sides with other seeds say so (`brink.search.analysis.confirmation`); one
that they leave undecided is not. Pairs that were not simulated often enough are neither: the confirmed pairs of a
campaign are known only once all of its distinct pairs were judged. Where verdicts are computed, seeds have no part in
them, and there is nothing to confirm.

Methods are compared on confirmed distinct pairs if these are known for every campaign of a problem, otherwise on
distinct ones.

Source: ours; docs/explanation/pairs.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of, is_judged
from brink.search.analysis.count_comparison import CountDuel, Proportion, by_method, count_duels, problems_of
from brink.search.analysis.paper import LEVEL
from brink.search.analysis.statistics import MeanInterval, mean_interval
from brink.search.sequential import FIRST


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
class PairCounts:
    """The distinct pairs of a campaign, and the results of finished follow-ups on them.

    Attributes:
        distinct: Distinct pairs.
        checked: Those of which the search simulated each side again, and both kept their verdicts.
        tried: Those simulated again with other seeds after the search.
        judged: Tried ones with enough drives of both sides to be confirmed, or too many of the other verdict.
        confirmed: Those that were confirmed.
        refuted: Those that were refuted.
        checked_judged: Checked ones among the judged.
        checked_confirmed: Checked ones among the confirmed.
        component: Unsafe sides that are safe with ground truth in place of the component.
        scenario: Unsafe sides that are unsafe with ground truth, too.
        drives: Fewest drives with other seeds of any side of the tried pairs; 0 if none was tried.
    """

    distinct: int
    checked: int
    tried: int
    judged: int
    confirmed: int
    refuted: int
    checked_judged: int
    checked_confirmed: int
    component: int
    scenario: int
    drives: int

    @property
    def is_tried(self) -> bool:
        """Whether every distinct pair was judged, so that the number of confirmed pairs is known."""
        return self.judged == self.distinct

    @classmethod
    def of(
        cls, pairs: Sequence[DistinctPair], shares: Mapping[int, Share], scenario: Mapping[int, bool]
    ) -> Self:
        """Count pairs.

        Args:
            pairs: Distinct pairs.
            shares: How often each repeated solution was unsafe with other seeds, by number.
            scenario: Whether each solution that was simulated with ground truth is unsafe then, too, by number.
        """
        none = Share.of(0, 0)
        sides = [(shares.get(pair.safe, none), shares.get(pair.unsafe, none)) for pair in pairs]
        states = [confirmation_of(*both) for both in sides]
        tried = [
            both for both, state in zip(sides, states, strict=True) if state is not Confirmation.NOT_TRIED
        ]
        judged = [is_judged(*both) for both in sides]
        checked = [state for pair, state in zip(pairs, states, strict=True) if pair.checked]
        blamed = [scenario[pair.unsafe] for pair in pairs if pair.unsafe in scenario]
        return cls(
            distinct=len(pairs),
            checked=len(checked),
            tried=len(tried),
            judged=sum(judged),
            confirmed=states.count(Confirmation.CONFIRMED),
            refuted=states.count(Confirmation.REFUTED),
            checked_judged=sum(done and pair.checked for pair, done in zip(pairs, judged, strict=True)),
            checked_confirmed=checked.count(Confirmation.CONFIRMED),
            component=blamed.count(False),
            scenario=blamed.count(True),
            drives=min((side.evaluated for both in tried for side in both), default=0),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PairRepeat:
    """A finished campaign of an experiment, with its pairs.

    Attributes:
        problem: Name of its problem.
        method: Name of its algorithm.
        computed: Whether its verdicts are computed, so that there is nothing to confirm.
        counts: Its pairs.
    """

    problem: str
    method: str
    seed: int
    campaign: str
    computed: bool
    counts: PairCounts


@dataclass(frozen=True, slots=True, kw_only=True)
class PairStanding:
    """The pairs of a method on a problem, over its campaigns.

    Attributes:
        problem: Name of the problem.
        method: Name of the method.
        distinct: Distinct pairs of a campaign.
        confirmed: Confirmed distinct pairs of a campaign; None unless they are known for all campaigns.
        known: Campaigns whose confirmed pairs are known, also because they have none.
        pairs: Distinct pairs of all campaigns.
        checked: Checked ones among them.
        tried: Tried ones among them.
        precision: Share of the checked pairs that were confirmed, over all campaigns; None if none was tried.
        overall: Share of all pairs that were confirmed, checked or not; None if none was tried.
        component: Share of the unsafe sides that the component is to blame for; None if ground truth was not tried.
    """

    problem: str
    method: str
    distinct: MeanInterval
    confirmed: MeanInterval | None
    known: int
    pairs: int
    checked: int
    tried: int
    precision: Proportion | None
    overall: Proportion | None
    component: Proportion | None


class PairMeasure(StrEnum):
    """The measure on which methods are compared."""

    CONFIRMED = "confirmed"
    DISTINCT = "distinct"

    def of(self, counts: PairCounts) -> int:
        """Return the measure of a campaign."""
        return counts.confirmed if self is PairMeasure.CONFIRMED else counts.distinct


def pair_standings(repeats: Sequence[PairRepeat]) -> list[PairStanding]:
    """Return the pairs of every method on every problem."""
    return [
        _standing(problem, method, [repeat.counts for repeat in ours], computed=ours[0].computed)
        for problem in problems_of(repeats)
        for method, ours in by_method(repeats, problem).items()
    ]


def _standing(problem: str, method: str, counts: Sequence[PairCounts], *, computed: bool) -> PairStanding:
    known = 0 if computed else sum(count.is_tried for count in counts)
    return PairStanding(
        problem=problem,
        method=method,
        known=known,
        pairs=sum(repeat.distinct for repeat in counts),
        checked=sum(repeat.checked for repeat in counts),
        tried=sum(repeat.tried for repeat in counts),
        distinct=mean_interval([repeat.distinct for repeat in counts]),
        confirmed=mean_interval([repeat.confirmed for repeat in counts]) if known == len(counts) else None,
        precision=Proportion.pooled((repeat.checked_confirmed, repeat.checked_judged) for repeat in counts),
        overall=Proportion.pooled((repeat.confirmed, repeat.judged) for repeat in counts),
        component=Proportion.pooled(
            (repeat.component, repeat.component + repeat.scenario) for repeat in counts
        ),
    )


def measure_of(repeats: Sequence[PairRepeat], problem: str) -> PairMeasure:
    """Return the measure on which methods are compared: confirmed pairs if known for every campaign, else all."""
    ours = [repeat for repeat in repeats if repeat.problem == problem]
    known = all(repeat.counts.is_tried and not repeat.computed for repeat in ours)
    anything = any(one.counts.tried for one in ours)
    return PairMeasure.CONFIRMED if known and anything else PairMeasure.DISTINCT


def measure_words(repeats: Sequence[PairRepeat], problem: str) -> str:
    """Return a sentence that states the measure on which methods are compared, and why."""
    ours = [repeat for repeat in repeats if repeat.problem == problem]
    distinct, tried = sum(repeat.counts.distinct for repeat in ours), sum(one.counts.tried for one in ours)
    if measure_of(repeats, problem) is PairMeasure.CONFIRMED:
        return "Compared on confirmed distinct pairs."
    if not distinct:
        return "No method found any pair."
    if ours[0].computed:
        return "Compared on distinct pairs: verdicts are computed here, so there is nothing to confirm."
    if not tried:
        return "Compared on distinct pairs: none of them was simulated again with other seeds, so none is confirmed."
    if tried < distinct:
        return (
            f"Compared on distinct pairs, confirmed or not: only {tried:,} of {distinct:,} were simulated again "
            "with other seeds."
        )
    few = tried - sum(one.counts.judged for one in ours)
    return (
        f"Compared on distinct pairs, confirmed or not: {few:,} of {distinct:,} have too few simulations with other "
        f"seeds. To confirm a pair takes at least {FIRST} of each side."
    )


def pair_duels(repeats: Sequence[PairRepeat], *, level: float = LEVEL) -> list[CountDuel[PairMeasure]]:
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

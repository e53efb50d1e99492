"""Methods compared by what their campaigns found of one kind, such as pairs across the boundary.

A finding is confirmed if simulations of both its sides with other seeds say so
(`brink.search.analysis.confirmation`); one that they leave undecided is not. Findings that were not simulated often
enough are neither: the number of confirmed ones is known only once all that can be confirmed were judged. Where
verdicts are computed, seeds have no part in them, and there is nothing to confirm.

Methods are compared on confirmed distinct findings if these are known for every campaign of a problem, otherwise on
distinct ones: Mann-Whitney U and A12 for each two methods on a problem, with Holm's correction over the comparisons
of the problem.
"""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Self, TypeVar

from brink.search.analysis.comparison import difference, is_significant
from brink.search.analysis.confirmation import Confirmation, Share, confirmation_of, is_judged
from brink.search.analysis.paper import LEVEL
from brink.search.analysis.statistics import MeanInterval, compared, effect_size, holm, mean_interval
from brink.search.fitness import wilson_interval
from brink.search.sequential import FIRST


class CountMeasure(StrEnum):
    """The measure on which methods are compared."""

    CONFIRMED = "confirmed"
    DISTINCT = "distinct"


@dataclass(frozen=True, slots=True, kw_only=True)
class Proportion:
    """A share of pooled counts, with its Wilson interval.

    Attributes:
        count: The ones counted.
        of: All of them, at least one.
        share: The share.
        low: Lower limit of the 95% interval.
        high: Its upper limit.
    """

    count: int
    of: int
    share: float
    low: float
    high: float

    @classmethod
    def pooled(cls, counts: Iterable[tuple[int, int]]) -> "Proportion | None":
        """Return the share over pairs of counts and totals; None if there is nothing to count."""
        found = list(counts)
        count, of = sum(one for one, _ in found), sum(total for _, total in found)
        if not of:
            return None
        low, high = wilson_interval(count, of)
        return cls(count=count, of=of, share=count / of, low=float(low), high=float(high))


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundRepeat(ABC):
    """What a finished campaign of an experiment found of one kind, and the results of finished follow-ups on it.

    Kinds document the attributes, because the API shows their docstrings.
    """

    NOUN: ClassVar[str]
    """What is found, in the singular."""
    SIDE: ClassVar[str]
    """What each of its two simulated solutions is called."""

    problem: str
    method: str
    seed: int
    campaign: str
    computed: bool
    distinct: int
    tried: int
    judged: int
    confirmed: int | None
    refuted: int
    component: int
    scenario: int
    drives: int

    @property
    @abstractmethod
    def total(self) -> int:
        """All findings."""

    @property
    @abstractmethod
    def confirmable(self) -> int:
        """Findings that follow-ups can confirm."""

    @property
    @abstractmethod
    def confirmed_ones(self) -> int:
        """Confirmed distinct findings."""

    @property
    def is_tried(self) -> bool:
        """Whether all that can be confirmed were judged, so that the number of confirmed ones is known."""
        return self.judged == self.confirmable

    def counted(self, measure: CountMeasure) -> int:
        """Return the measure of the campaign."""
        return self.confirmed_ones if measure is CountMeasure.CONFIRMED else self.distinct


@dataclass(frozen=True, slots=True, kw_only=True)
class Tested:
    """The results of follow-ups on findings.

    Attributes:
        sides: How often the safe and the unsafe side of each that can be confirmed was unsafe with other seeds.
        states: Which of them are confirmed.
        judged: Which of them were judged.
        scenario: Whether each unsafe side that was simulated with ground truth is unsafe then, too.
    """

    sides: Sequence[tuple[Share, Share]]
    states: Sequence[Confirmation]
    judged: Sequence[bool]
    scenario: Sequence[bool]

    @classmethod
    def of(
        cls,
        confirmable: Iterable[tuple[int, int]],
        unsafe: Iterable[int],
        shares: Mapping[int, Share],
        scenario: Mapping[int, bool],
    ) -> Self:
        """Look up the results of follow-ups.

        Args:
            confirmable: Numbers of the safe and the unsafe side of each finding that can be confirmed.
            unsafe: Numbers of all unsafe sides.
            shares: How often each repeated solution was unsafe with other seeds, by number.
            scenario: Whether each solution that was simulated with ground truth is unsafe then, too, by number.
        """
        none = Share.of(0, 0)
        sides = [(shares.get(safe, none), shares.get(other, none)) for safe, other in confirmable]
        return cls(
            sides=sides,
            states=[confirmation_of(*both) for both in sides],
            judged=[is_judged(*both) for both in sides],
            scenario=[scenario[number] for number in unsafe if number in scenario],
        )

    def counts(self) -> dict[str, Any]:
        """Return the fields of `FoundRepeat` that follow-ups decide."""
        tried = [
            both
            for both, state in zip(self.sides, self.states, strict=True)
            if state is not Confirmation.NOT_TRIED
        ]
        confirmed = list(self.states).count(Confirmation.CONFIRMED)
        return {
            "tried": len(tried),
            "judged": sum(self.judged),
            "confirmed": confirmed if tried or not self.sides else None,
            "refuted": list(self.states).count(Confirmation.REFUTED),
            "component": list(self.scenario).count(False),
            "scenario": list(self.scenario).count(True),
            "drives": min((side.evaluated for both in tried for side in both), default=0),
        }


R = TypeVar("R", bound=FoundRepeat)


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundStanding:
    """What a method found of one kind on a problem, over its campaigns.

    Kinds document the attributes, because the API shows their docstrings.
    """

    problem: str
    method: str
    distinct: MeanInterval
    confirmed: MeanInterval | None
    known: int
    tried: int
    overall: Proportion | None
    component: Proportion | None

    @staticmethod
    def fields(repeats: Sequence[FoundRepeat]) -> dict[str, Any]:
        """Return the fields of the campaigns of a method on a problem."""
        known = 0 if repeats[0].computed else sum(one.is_tried for one in repeats)
        confirmed = mean_interval([one.confirmed_ones for one in repeats])
        return {
            "problem": repeats[0].problem,
            "method": repeats[0].method,
            "distinct": mean_interval([one.distinct for one in repeats]),
            "confirmed": confirmed if known == len(repeats) else None,
            "known": known,
            "tried": sum(one.tried for one in repeats),
            "overall": Proportion.pooled((one.confirmed or 0, one.judged) for one in repeats),
            "component": Proportion.pooled((one.component, one.component + one.scenario) for one in repeats),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemMeasure:
    """The measure on which methods are compared on a problem.

    Attributes:
        problem: Name of the problem.
        measure: Confirmed ones if known for every campaign, otherwise all.
        says: The measure, and why, in a sentence.
    """

    problem: str
    measure: CountMeasure
    says: str

    @classmethod
    def of(cls, repeats: Sequence[FoundRepeat]) -> Self:
        """Return the measure of the campaigns on a problem."""
        known = all(one.is_tried and not one.computed for one in repeats)
        confirmed = known and any(one.tried for one in repeats)
        measure = CountMeasure.CONFIRMED if confirmed else CountMeasure.DISTINCT
        return cls(problem=repeats[0].problem, measure=measure, says=_measure_words(repeats, measure))


def _measure_words(repeats: Sequence[FoundRepeat], measure: CountMeasure) -> str:
    noun, side = repeats[0].NOUN, repeats[0].SIDE
    total, confirmable, tried, judged = (
        sum(getattr(one, name) for one in repeats) for name in ("total", "confirmable", "tried", "judged")
    )
    if measure is CountMeasure.CONFIRMED:
        return f"Compared on confirmed distinct {noun}s."
    if not total:
        return f"No method found any {noun}."
    if any(one.computed for one in repeats):
        return f"Compared on distinct {noun}s: verdicts are computed here, so there is nothing to confirm."
    if not confirmable:
        return f"Compared on distinct {noun}s: none has simulated {side}s close enough to confirm it."
    if not tried:
        return (
            f"Compared on distinct {noun}s: none of them was simulated again with other seeds, so none is "
            "confirmed."
        )
    if tried < confirmable:
        return (
            f"Compared on distinct {noun}s, confirmed or not: only {tried:,} of {confirmable:,} were simulated again "
            "with other seeds."
        )
    return (
        f"Compared on distinct {noun}s, confirmed or not: {tried - judged:,} of {confirmable:,} have too few "
        f"simulations with other seeds. To confirm a {noun} takes at least {FIRST} of each {side}."
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CountDuel:
    """Two methods compared on a problem.

    Attributes:
        problem: Name of the problem.
        first: The method whose larger values give an A12 above one half.
        second: The other method.
        measure: What they are compared on.
        first_mean: Mean of the first method.
        second_mean: Mean of the second method.
        u: Mann-Whitney U of the first method.
        p: Its two-sided p-value; None if all values are equal, and nothing is tested.
        p_holm: The p-value, corrected for all comparisons of the problem.
        a12: Probability that a value of the first method exceeds one of the second.
        effect: The effect size in words, such as ``medium``.
        differs: Whether the difference is significant after correction.
        says: The conclusion, worded as the end of a sentence about the figures.
    """

    problem: str
    first: str
    second: str
    measure: CountMeasure
    first_mean: float
    second_mean: float
    u: float
    p: float | None
    p_holm: float | None
    a12: float
    effect: str
    differs: bool
    says: str


def by_problem(repeats: Collection[R]) -> dict[str, list[R]]:
    """Return the campaigns by problem, in the order of the experiment."""
    grouped: dict[str, list[R]] = {}
    for repeat in repeats:
        grouped.setdefault(repeat.problem, []).append(repeat)
    return grouped


def by_method(repeats: Collection[R]) -> dict[str, list[R]]:
    """Return campaigns by method, in the order of the experiment."""
    grouped: dict[str, list[R]] = {}
    for repeat in repeats:
        grouped.setdefault(repeat.method, []).append(repeat)
    return grouped


def count_duels(repeats: Collection[FoundRepeat], *, level: float = LEVEL) -> list[CountDuel]:
    """Compare each two methods on a problem, with p-values corrected over the comparisons of the problem.

    Args:
        repeats: Finished campaigns.
        level: Adjusted p-value up to which a difference is significant, in (0, 1).
    """
    return [duel for ours in by_problem(repeats).values() for duel in _problem_duels(ours, level)]


def _problem_duels(repeats: Sequence[FoundRepeat], level: float) -> list[CountDuel]:
    measure = ProblemMeasure.of(repeats).measure
    values = {
        method: [float(one.counted(measure)) for one in ours] for method, ours in by_method(repeats).items()
    }
    pairs = list(itertools.combinations(values, 2))
    results = [compared(values[first], values[second]) for first, second in pairs]
    adjusted = holm([result.p_value for result in results])
    return [
        CountDuel(
            problem=repeats[0].problem,
            first=first,
            second=second,
            measure=measure,
            first_mean=mean_interval(values[first]).mean,
            second_mean=mean_interval(values[second]).mean,
            u=result.u,
            p=result.p_value,
            p_holm=p_holm,
            a12=result.a12,
            effect=effect_size(result.a12),
            differs=is_significant(p_holm, level),
            says=difference(result, p_holm, first, second, level),
        )
        for (first, second), result, p_holm in zip(pairs, results, adjusted, strict=True)
    ]

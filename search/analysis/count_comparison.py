"""Methods compared by a number that each of their campaigns found, such as its confirmed pairs.

Mann-Whitney U and A12 for each two methods on a problem, with Holm's correction over the comparisons of the problem.
"""

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, Protocol, TypeVar

from brink.search.analysis.comparison import difference, is_significant
from brink.search.analysis.paper import LEVEL
from brink.search.analysis.statistics import Comparison, compared, effect_size, holm, mean_interval
from brink.search.fitness import wilson_interval


class MethodRepeat(Protocol):
    """A finished campaign of an experiment."""

    @property
    def problem(self) -> str:
        """Name of its problem."""
        ...

    @property
    def method(self) -> str:
        """Name of its algorithm."""
        ...


R = TypeVar("R", bound=MethodRepeat)
M = TypeVar("M", bound=StrEnum)


@dataclass(frozen=True, slots=True, kw_only=True)
class Proportion:
    """A share of pooled counts, with its Wilson interval.

    Attributes:
        count: The ones counted.
        of: All of them, at least one.
        low: Lower limit of the 95% interval.
        high: Its upper limit.
    """

    count: int
    of: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """The share."""
        return self.count / self.of

    @classmethod
    def pooled(cls, counts: Iterable[tuple[int, int]]) -> "Proportion | None":
        """Return the share over pairs of counts and totals; None if there is nothing to count."""
        found = list(counts)
        count, of = sum(one for one, _ in found), sum(total for _, total in found)
        if not of:
            return None
        low, high = wilson_interval(count, of)
        return cls(count=count, of=of, low=float(low), high=float(high))


@dataclass(frozen=True, slots=True, kw_only=True)
class CountDuel(Generic[M]):
    """Two methods compared on a problem.

    Attributes:
        problem: Name of the problem.
        first: The method whose larger values give an A12 above one half.
        second: The other method.
        measure: What they are compared on.
        first_mean: Mean of the first method.
        second_mean: Mean of the second method.
        result: U, p-value and A12.
        adjusted: The p-value, corrected for all comparisons of the problem; None if all values are equal.
        level: Adjusted p-value up to which the difference is significant, in (0, 1).
    """

    problem: str
    first: str
    second: str
    measure: M
    first_mean: float
    second_mean: float
    result: Comparison
    adjusted: float | None
    level: float = LEVEL

    @property
    def differs(self) -> bool:
        """Whether the difference is significant after correction."""
        return is_significant(self.adjusted, self.level)

    @property
    def size(self) -> str:
        """The effect size in words, such as ``medium``."""
        return effect_size(self.result.a12)

    @property
    def says(self) -> str:
        """The conclusion, worded as the end of a sentence about the figures."""
        return difference(self.result, self.adjusted, self.first, self.second, self.level)


def by_method(repeats: Sequence[R], problem: str) -> dict[str, list[R]]:
    """Return the campaigns on a problem by method, in the order of the experiment."""
    grouped: dict[str, list[R]] = {}
    for repeat in repeats:
        if repeat.problem == problem:
            grouped.setdefault(repeat.method, []).append(repeat)
    return grouped


def problems_of(repeats: Collection[MethodRepeat]) -> list[str]:
    """Return the names of the problems, in the order of the experiment."""
    return list(dict.fromkeys(repeat.problem for repeat in repeats))


def count_duels(
    problem: str, measure: M, values: Mapping[str, Sequence[float]], *, level: float
) -> list[CountDuel[M]]:
    """Compare each two methods on a problem, with p-values corrected over these comparisons.

    Args:
        problem: Name of the problem.
        measure: What they are compared on.
        values: The measure of each campaign, by method.
        level: Adjusted p-value up to which a difference is significant, in (0, 1).
    """
    pairs = list(itertools.combinations(values, 2))
    results = [compared(values[first], values[second]) for first, second in pairs]
    adjusted = holm([result.p_value for result in results])
    return [
        CountDuel(
            problem=problem,
            first=first,
            second=second,
            measure=measure,
            first_mean=mean_interval(values[first]).mean,
            second_mean=mean_interval(values[second]).mean,
            result=result,
            adjusted=p_value,
            level=level,
        )
        for (first, second), result, p_value in zip(pairs, results, adjusted, strict=True)
    ]

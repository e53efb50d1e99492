"""Comparisons in tables and in words: campaigns with their controls, and methods over repeated campaigns.

A control has verdicts that ignore the behaviour (`brink.search.analysis.scores`), so its figures are due to scenarios
and chance. A control that reads low proves nothing, regardless of the test, and a p-value that does not survive its
correction shows no difference.

Source: Sharifi et al. 2023, Tables 1 and 2, and the differences at shares of the budget that answer its second
research question. The paper tests at a level of .01, without correction, and has N/A where a method found nothing
(`Duel.paper_p`). Beyond the paper: strict DBS, controls, and Holm's correction over all comparisons of one table,
which are those of one problem and one measure in which values differ at all.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.analysis.paper import (
    D_THS,
    LEVEL,
    PAPER_D_THS,
    PAPER_FRACTIONS,
    PAPER_LEVEL,
    PAPER_T_BS,
    Measure,
)
from brink.search.analysis.scores import ENOUGH_REPEATS, Figures, Scores, scored
from brink.search.analysis.statistics import (
    Comparison,
    MeanInterval,
    compared,
    effect_size,
    holm,
    mean_interval,
)
from brink.search.archive import Archive
from brink.search.space import FloatArray, SearchSpace

SPREADS: Final = 2.0
"""A campaign shows an effect of behaviour if it exceeds its control by this many standard deviations of the draws."""
CALIBRATION: Final = 0.15
"""Share by which a control can read low although behaviour has no effect (docs/explanation/mlcshe-results.md)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedCampaign:
    """A campaign to compare.

    Attributes:
        id: Its id.
        label: Its name in the table.
        space: Its search space.
        archive: All its evaluated solutions.
        simulations: Its budget.
        seed: Its seed, which determines its controls.
    """

    id: str
    label: str
    space: SearchSpace
    archive: Archive
    simulations: int
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Row:
    """One row of a comparison: a campaign or its control, at the whole budget.

    Attributes:
        label: Name of the row.
        campaign: Id of the campaign.
        unsafe_share: Unsafe share of the archive.
        dbs: DBS, shape ``(len(PAPER_T_BS), len(D_THS))``; means for a control.
        strict: Strict DBS, same shape.
        strict_spread: Standard deviation of strict DBS over the draws of a control, same shape; 0 for a campaign.
        repeats: Mean number of evaluated behaviours per scenario for a control; None for a campaign.
        beyond: Solutions of the campaign beyond its budget, which are not counted here.
    """

    label: str
    campaign: str
    unsafe_share: float
    dbs: FloatArray
    strict: FloatArray
    strict_spread: FloatArray
    repeats: float | None
    beyond: int = 0

    @property
    def reads_low(self) -> bool:
        """Whether this is a control with too few behaviours per scenario, and so with too low figures."""
        return self.repeats is not None and self.repeats < ENOUGH_REPEATS


def compare(campaigns: Sequence[ComparedCampaign], *, control: bool = True) -> list[Row]:
    """Return a row for each campaign within its budget, then one for its control if its space has a scenario."""
    rows = []
    for campaign in campaigns:
        scores = scored(
            campaign.archive,
            campaign.space,
            simulations=campaign.simulations,
            seed=campaign.seed,
            fractions=(1.0,),
            control=control,
        )
        rows += rows_of(scores, campaign=campaign.id, label=campaign.label)
    return rows


def rows_of(scores: Scores, *, campaign: str, label: str) -> list[Row]:
    """Return the row of a campaign, followed by that of its control if it has one.

    Args:
        scores: The campaign's scores.
        campaign: Its id.
        label: Its name in the table.
    """
    figures = scores.figures
    own = Row(
        label=label,
        campaign=campaign,
        unsafe_share=scores.unsafe / scores.evaluated if scores.evaluated else 0.0,
        dbs=figures.dbs[-1],
        strict=figures.strict[-1],
        strict_spread=np.zeros_like(figures.strict[-1]),
        repeats=None,
        beyond=scores.beyond,
    )
    if (blind := scores.control) is None:
        return [own]
    control = Row(
        label=f"{label}, control",
        campaign=campaign,
        unsafe_share=blind.unsafe_share,
        dbs=blind.figures.dbs[-1],
        strict=blind.figures.strict[-1],
        strict_spread=blind.spread,
        repeats=blind.repeats,
        beyond=scores.beyond,
    )
    return [own, control]


def control_summaries(rows: Sequence[Row], t_b: float, d_th: float) -> list[str]:
    """Return a sentence about each campaign that has a control.

    Args:
        rows: The result of `compare`.
        t_b: One of the paper's thresholds.
        d_th: One of `D_THS`.
    """
    place = PAPER_T_BS.index(t_b), D_THS.index(d_th)
    return [
        f"{row.label}: {control_summary(row, control, place)}"
        for row, control in itertools.pairwise(rows)
        if row.repeats is None and control.repeats is not None
    ]


def control_summary(row: Row, control: Row, place: tuple[int, int]) -> str:
    """Return a sentence on what a campaign shows compared with its control.

    Args:
        row: Row of the campaign.
        control: Row of its control.
        place: Positions of t_b in `PAPER_T_BS` and of d_th in `D_THS`.
    """
    found, blind = float(row.strict[place]), float(control.strict[place])
    without = f", without the {row.beyond:,} solutions beyond it" if row.beyond else ""
    facts = (
        f"strict DBS {found:g} within the budget{without}; {blind:.3g} for verdicts that ignore the component's "
        "behaviour"
    )
    if control.reads_low:
        return f"{facts}; with {control.repeats:.1f} behaviours per scenario the control reads low and proves nothing"
    if not found:
        return f"{facts}: nothing to attribute to the component"
    beyond = found - blind
    if beyond > max(SPREADS * float(control.strict_spread[place]), CALIBRATION * blind):
        return f"{facts}: the component's behaviour accounts for about {beyond:.0f} of {found:g}"
    return f"{facts}: no more than scenarios and chance explain, so this does not show that the component matters"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Repeat:
    """A finished campaign of an experiment, with its scores."""

    problem: str
    method: str
    seed: int
    campaign: str
    scores: Scores


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A method, or its control, on one problem: a row of the tables."""

    problem: str
    method: str
    control: bool

    @property
    def label(self) -> str:
        """Name of the row in tables."""
        return f"{self.method}, control" if self.control else self.method


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """An entry of Table 1: mean and interval of one `Line` for one pair of thresholds."""

    line: Line
    measure: Measure
    t_b: float
    d_th: float
    value: MeanInterval


@dataclass(frozen=True, slots=True, kw_only=True)
class Duel:
    """An entry of Table 2: one `Line` compared with another for one pair of thresholds.

    Attributes:
        first: The line whose larger values give an A12 above one half.
        second: The other line.
        measure: The measure compared.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two distinct solutions.
        result: U, p-value and A12.
        adjusted: The p-value, corrected for all comparisons of the table; None if all values are equal.
        found_nothing: Whether one of the lines, or both, found nothing in all its campaigns.
        level: Adjusted p-value up to which the difference is significant, in (0, 1).
    """

    first: Line
    second: Line
    measure: Measure
    t_b: float
    d_th: float
    result: Comparison
    adjusted: float | None
    found_nothing: bool
    level: float = LEVEL

    @property
    def differs(self) -> bool:
        """Whether the difference is significant after correction."""
        return is_significant(self.adjusted, self.level)

    @property
    def paper_p(self) -> float | None:
        """The p-value of the paper's tables: not corrected, and None (N/A) where a method found nothing."""
        return None if self.found_nothing else self.result.p_value

    @property
    def size(self) -> str:
        """The effect size in words, such as ``medium``."""
        return effect_size(self.result.a12)


def lines_of(repeats: Sequence[Repeat]) -> dict[Line, list[tuple[int, Figures]]]:
    """Return the seeds and figures of each row of the tables: all methods, then all controls."""
    lines: dict[Line, list[tuple[int, Figures]]] = {}
    for repeat in repeats:
        line = Line(problem=repeat.problem, method=repeat.method, control=False)
        lines.setdefault(line, []).append((repeat.seed, repeat.scores.figures))
    for repeat in repeats:
        if repeat.scores.control is not None:
            line = Line(problem=repeat.problem, method=repeat.method, control=True)
            lines.setdefault(line, []).append((repeat.seed, repeat.scores.control.figures))
    return lines


def standings(repeats: Sequence[Repeat]) -> list[Standing]:
    """Return Table 1: means and 95% confidence intervals for every `Line`, measure, t_b and `D_THS`."""
    return [
        Standing(
            line=line,
            measure=measure,
            t_b=t_b,
            d_th=d_th,
            value=mean_interval(values_of(campaigns, measure, t_b, d_th)),
        )
        for line, campaigns in lines_of(repeats).items()
        for measure in Measure
        for t_b in PAPER_T_BS
        for d_th in D_THS
    ]


def is_significant(p_value: float | None, level: float) -> bool:
    """Return whether a p-value is at most the level; None, where nothing was tested, is not."""
    return p_value is not None and p_value <= level


def duels(repeats: Sequence[Repeat], *, level: float = LEVEL) -> list[Duel]:
    """Return Table 2: every pair of methods on a problem, and every method against its control.

    Args:
        repeats: Finished campaigns.
        level: Adjusted p-value up to which a difference is significant, in (0, 1).
    """
    lines = lines_of(repeats)
    played: list[Duel] = []
    for problem in dict.fromkeys(line.problem for line in lines):
        for measure in Measure:
            pairs = list(_pairs(lines, problem))
            played += compared_lines(lines, pairs, measure, t_bs=PAPER_T_BS, d_ths=PAPER_D_THS, level=level)
    return played


def _pairs(lines: Mapping[Line, object], problem: str) -> Iterator[tuple[Line, Line]]:
    methods = [line for line in lines if line.problem == problem and not line.control]
    yield from itertools.combinations(methods, 2)
    for line in methods:
        control = Line(problem=problem, method=line.method, control=True)
        if control in lines:
            yield line, control


def compared_lines(
    lines: Mapping[Line, Sequence[tuple[int, Figures]]],
    pairs: Sequence[tuple[Line, Line]],
    measure: Measure,
    *,
    t_bs: Sequence[float],
    d_ths: Sequence[float],
    level: float = LEVEL,
) -> list[Duel]:
    """Return a table of comparisons, whose p-values are corrected together: each pair at each t_b and d_th.

    Args:
        lines: Seeds and figures of each line, as `lines_of` returns them.
        pairs: Lines to compare.
        measure: The measure to compare.
        t_bs: Some of `PAPER_T_BS`.
        d_ths: Some of `D_THS`.
        level: Adjusted p-value up to which a difference is significant, in (0, 1).
    """
    places = list(itertools.product(pairs, t_bs, d_ths))
    values = [[values_of(lines[line], measure, t_b, d_th) for line in pair] for pair, t_b, d_th in places]
    results = [compared(first, second) for first, second in values]
    adjusted = holm([result.p_value for result in results])
    return [
        Duel(
            first=first,
            second=second,
            measure=measure,
            t_b=t_b,
            d_th=d_th,
            result=result,
            adjusted=p_value,
            found_nothing=not all(map(any, found)),
            level=level,
        )
        for ((first, second), t_b, d_th), found, result, p_value in zip(
            places, values, results, adjusted, strict=True
        )
    ]


def values_of(
    campaigns: Sequence[tuple[int, Figures]], measure: Measure, t_b: float, d_th: float, share: int = -1
) -> list[float]:
    """Return the value of each campaign of a line.

    Args:
        campaigns: Seeds and figures of the campaigns.
        measure: The measure.
        t_b: One of `PAPER_T_BS`.
        d_th: One of `D_THS`.
        share: Position of the share of the budget in `PAPER_FRACTIONS`; by default, the whole budget.
    """
    i, j = PAPER_T_BS.index(t_b), D_THS.index(d_th)
    return [float(measure.of(figures)[share, i, j]) for _, figures in campaigns]


@dataclass(frozen=True, slots=True, kw_only=True)
class Lead:
    """How much more one method has found than another after each tenth of the budget.

    Attributes:
        first: The method whose larger values give positive differences.
        second: The other method.
        measure: The measure compared.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two distinct solutions.
        differences: Mean of the first minus mean of the second, one for each of `PAPER_FRACTIONS`.
        p_values: p-values at these shares, not corrected; None where all values are equal.
        found_nothing: Whether neither method found anything in any campaign, up to the whole budget.
    """

    first: str
    second: str
    measure: Measure
    t_b: float
    d_th: float
    differences: tuple[float, ...]
    p_values: tuple[float | None, ...]
    found_nothing: bool

    def significant(self, level: float = PAPER_LEVEL) -> list[bool]:
        """Return at which shares of the budget the difference is significant, without correction."""
        return [is_significant(p_value, level) for p_value in self.p_values]


def leads(repeats: Sequence[Repeat], problem: str, measure: Measure, d_th: float) -> list[Lead]:
    """Return the differences between each pair of methods on a problem, for each t_b.

    Args:
        repeats: Finished campaigns.
        problem: Name of the problem.
        measure: DBS or strict DBS.
        d_th: One of `D_THS`.
    """
    lines = {
        line: campaigns
        for line, campaigns in lines_of(repeats).items()
        if line.problem == problem and not line.control
    }
    return [
        _lead(
            (first, second),
            measure,
            (t_b, d_th),
            [
                (
                    values_of(lines[first], measure, t_b, d_th, k),
                    values_of(lines[second], measure, t_b, d_th, k),
                )
                for k in range(len(PAPER_FRACTIONS))
            ],
        )
        for first, second in itertools.combinations(lines, 2)
        for t_b in PAPER_T_BS
    ]


def _lead(
    pair: tuple[Line, Line],
    measure: Measure,
    thresholds: tuple[float, float],
    values: Sequence[tuple[list[float], list[float]]],
) -> Lead:
    """Return a lead, given the values of the campaigns of both methods at each share of the budget."""
    return Lead(
        first=pair[0].method,
        second=pair[1].method,
        measure=measure,
        t_b=thresholds[0],
        d_th=thresholds[1],
        differences=tuple(float(np.mean(first) - np.mean(second)) for first, second in values),
        p_values=tuple(compared(first, second).p_value for first, second in values),
        found_nothing=not any(any(one) for both in values for one in both),
    )


def lead_words(lead: Lead, level: float = PAPER_LEVEL) -> str:
    """Return how a difference develops with the budget, worded as the end of a sentence about its two methods.

    Args:
        lead: The differences.
        level: p-value up to which a difference is significant, without correction.
    """
    if lead.found_nothing:
        return "neither finds anything at any share of the budget"
    largest = int(np.argmax(np.abs(lead.differences)))
    words = (
        f"{signed(lead.differences[0])} at 10% of the budget, {signed(lead.differences[-1])} at 100%, "
        f"furthest apart at {PAPER_FRACTIONS[largest]:.0%} ({signed(lead.differences[largest])})"
    )
    return f"{words}; {_significance_words(lead.significant(level), level)}"


def signed(difference: float) -> str:
    """Return a difference of means as text: with one decimal and its sign, and none for zero."""
    return "0.0" if round(difference, 1) == 0 else f"{difference:+.1f}"


def _significance_words(significant: Sequence[bool], level: float) -> str:
    tested = f"significant at {level:g}, without correction,"
    if not any(significant):
        return f"not {tested} at any tenth"
    start = significant.index(True)
    if all(significant[start:]):
        if start == len(significant) - 1:
            return f"{tested} at the whole budget only"
        return f"{tested} from {PAPER_FRACTIONS[start]:.0%} on"
    shares = [f"{share:.0%}" for share, at in zip(PAPER_FRACTIONS, significant, strict=True) if at]
    return f"{tested} at {', '.join(shares)} only"


def conclusion(duel: Duel, first: float, second: float, low: Collection[str]) -> str:
    """Return the conclusion from a comparison, worded as the end of a sentence about its figures.

    Args:
        duel: The comparison.
        first: Mean of the first line.
        second: Mean of the second line.
        low: Methods of this problem whose control reads low.
    """
    significant, uncorrected = duel.differs, is_significant(duel.result.p_value, duel.level)
    if duel.second.control:
        if duel.result.p_value is None:
            return "all values are equal: nothing to attribute to the component"
        if duel.first.method in low:
            return "the control reads low here, so this proves nothing"
        if significant and first > second:
            return f"more than scenarios and chance explain: behaviour accounts for {first - second:.1f}"
        if uncorrected and first > second:
            return f"perhaps more than scenarios and chance explain: {_CHANCE}"
        return "no more than scenarios and chance explain, as far as these repeats show"
    return difference(duel.result, duel.adjusted, duel.first.method, duel.second.method, duel.level)


_CHANCE: Final = "significant by itself, but among so many comparisons it may be chance"


def difference(
    result: Comparison, adjusted: float | None, first: str, second: str, level: float = LEVEL
) -> str:
    """Return the conclusion from a comparison of two methods, worded as the end of a sentence about its figures.

    Args:
        result: U, p-value and A12.
        adjusted: The p-value, corrected for all comparisons of the table; None if all values are equal.
        first: The method whose larger values give an A12 above one half.
        second: The other method.
        level: p-value up to which a difference is significant, in (0, 1).
    """
    if adjusted is None:
        return "all values are equal, so there is nothing to test"
    more = f"{first if result.a12 > 0.5 else second} finds more"
    if is_significant(adjusted, level):
        return more
    if is_significant(result.p_value, level):
        return _CHANCE
    if result.a12 in (0.0, 1.0):
        return f"{more} in every repeat, but these are too few for the test"
    return "these repeats show no difference"


def with_low_controls(repeats: Sequence[Repeat], problem: str | None = None) -> list[str]:
    """Return the methods whose control reads low for any seed, on the given problem or, if it is None, on any."""
    return sorted(
        {
            repeat.method
            for repeat in repeats
            if repeat.scores.control and repeat.scores.control.reads_low and problem in (None, repeat.problem)
        }
    )

"""The thresholds in the report of an experiment: conclusions, tables, methods.

"Not tried" is never written as a number: thresholds not simulated again are neither confirmed nor refuted.
"""

from collections.abc import Iterator, Sequence
from typing import Final

from brink.report.experiment_counts import DASH, duel_words, duels_table, share_cell
from brink.report.text import interval_text, table_row
from brink.search.analysis.paper import LEVEL
from brink.search.analysis.statistics import MeanInterval
from brink.search.analysis.threshold_comparison import (
    ThresholdMeasure,
    ThresholdRepeat,
    ThresholdStanding,
    measure_words,
    threshold_duels,
    threshold_standings,
)
from brink.search.sequential import FIRST, LIMIT

COLUMNS: Final = (
    "distinct thresholds",
    "kinds",
    "confirmed distinct thresholds",
    "confirmed kinds",
    "held at both ends",
    "confirmed of those simulated again",
    "unsafe ends that are the component's",
)
"""Columns of the table of methods."""
_MEASURED: Final = {
    ThresholdMeasure.CONFIRMED: "confirmed distinct thresholds",
    ThresholdMeasure.DISTINCT: "distinct thresholds",
}


def distance_words(d_th: float) -> str:
    """Describe which thresholds are counted."""
    return (
        "A threshold is where, along one number with all else held, the probability of a violation passes from at "
        f"most {LIMIT:.0%} to at least {1 - LIMIT:.0%}; of one kind, those at least {d_th:g} apart are distinct."
    )


def standing_cells(one: ThresholdStanding, *, computed: bool) -> list[str]:
    """Return the cells of a method below `COLUMNS`.

    Args:
        one: The method.
        computed: Whether verdicts are computed, so that there is nothing to confirm.
    """
    counts = [interval_text(one.distinct), interval_text(one.kinds)]
    if computed:
        return [*counts, *[DASH] * 5]
    untested = "none can be confirmed" if one.found else "no threshold"
    return [
        *counts,
        _confirmed(one.confirmed, one),
        _confirmed(one.confirmed_kinds, one),
        share_cell(one.held, one.paired, untested, tried=one.tried),
        share_cell(one.overall, one.paired, untested, tried=one.tried),
        share_cell(one.component, one.found, "no threshold"),
    ]


def _confirmed(value: MeanInterval | None, one: ThresholdStanding) -> str:
    if value is not None:
        return interval_text(value)
    return f"known for {one.known} of {one.distinct.repeats} campaigns" if one.tried else "not tried"


def threshold_sentences(
    repeats: Sequence[ThresholdRepeat], problem: str, *, level: float = LEVEL
) -> Iterator[str]:
    """Yield the conclusions for a problem, as list items.

    Args:
        repeats: Finished campaigns.
        problem: Name of the problem.
        level: Corrected p-value up to which a difference is significant.
    """
    yield f"{measure_words(repeats, problem)}\n"
    for duel in threshold_duels(repeats, level=level):
        if duel.problem == problem:
            yield f"- {duel_words(duel, _MEASURED[duel.measure])}"


def threshold_section(
    repeats: Sequence[ThresholdRepeat],
    problem: str,
    *,
    d_th: float,
    heading: str,
    picture: str | None,
    level: float = LEVEL,
) -> list[str]:
    """Return the paragraphs of the report about the thresholds on a problem.

    Args:
        repeats: Finished campaigns, of which at least one is on the problem.
        problem: Name of the problem.
        d_th: Smallest distance between two distinct thresholds of one kind.
        heading: What follows the words of a heading, such as the name of the problem.
        picture: File name of the figure, if it was drawn.
        level: Corrected p-value up to which a difference is significant.
    """
    ours = [one for one in repeats if one.problem == problem]
    parts = [f"## Thresholds{heading}", distance_words(d_th)]
    parts.append("\n".join(threshold_sentences(repeats, problem, level=level)))
    if picture is not None:
        parts.append(f"![Distinct and confirmed thresholds by method]({picture})")
    rows = [table_row(["method", *COLUMNS]), table_row(["---"] * (1 + len(COLUMNS)))]
    rows += [
        table_row([f"**{one.method}**", *standing_cells(one, computed=ours[0].computed)])
        for one in threshold_standings(ours)
    ]
    legend = (
        "*Means over the campaigns of a method with 95% intervals; shares over the thresholds of all its campaigns "
        "with Wilson intervals, which take thresholds as independent.*"
    )
    parts += ["### Means and shares of thresholds", "\n".join(rows), legend]
    if duels := threshold_duels(ours, level=level):
        parts += ["### Comparisons of thresholds", duels_table(duels, _MEASURED[duels[0].measure])]
    return [*parts, "### Thresholds of each campaign", _campaigns(ours)]


def _campaigns(repeats: Sequence[ThresholdRepeat]) -> str:
    found = ("found", "distinct", "kinds")
    tested = ("tried", "held", "confirmed", "confirmed distinct", "confirmed kinds", "refuted")
    names = ["campaign", "method", "seed", *found, "tight pair", *tested, "component's", "scenario's"]
    rows = [table_row(names), table_row(["---"] * len(names))]
    for one in repeats:
        counts = one.counts
        none = DASH if one.computed or not counts.found else "not tried"
        figures = [getattr(counts, name.replace(" ", "_")) if counts.tried else none for name in tested]
        figures += [
            number if counts.component + counts.scenario else none
            for number in (counts.component, counts.scenario)
        ]
        shown = [*(getattr(counts, name) for name in found), counts.paired, *figures]
        rows.append(table_row([f"`{one.campaign}`", one.method, str(one.seed), *map(str, shown)]))
    return "\n".join(rows)


def threshold_methods(repeats: Sequence[ThresholdRepeat]) -> Iterator[str]:
    """Yield how thresholds are counted, as list items."""
    yield (
        "**Thresholds** are those of all simulations of a campaign that vary one number alone, estimated in the same "
        "way for every method. A search that never varies one number alone finds none, however many unsafe solutions "
        "it finds. **Kinds** are told apart by the number and its error, the target, the road, and how the unsafe "
        "end fails. **Distinct**: of another kind than all sharper thresholds of the campaign, or far from them."
    )
    if all(one.computed for one in repeats):
        return
    yield (
        "**Tight pair**: simulated solutions below the 20% and above the 80% point, at most the stretch and two "
        "resolutions apart; without one, a threshold is not confirmed. **Tried**: these were simulated again after "
        "the search, with other seeds. **Held**: their drives were at most 20% and at least 80% unsafe, an "
        f"observation. **Confirmed**: the sequential test with {FIRST} or more drives of each end says so, with an "
        "error rate of 5%; few drives confirm only ends that are far beyond 20 and 80%."
    )
    yield (
        "**Comparisons of thresholds**: Mann-Whitney U, two-sided, over the campaigns of two methods, with Holm's "
        "correction over the methods of a problem; Vargha and Delaney's A12."
    )

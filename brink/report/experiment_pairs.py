"""The pairs across the boundary in the report of an experiment: conclusions, tables, methods.

"Not tried" is never written as a number: pairs that were not simulated again are neither confirmed nor not.
"""

from collections.abc import Iterator, Sequence
from typing import Final

from brink.report.experiment_counts import DASH, duel_words, duels_table, share_cell
from brink.report.text import interval_text, table_row
from brink.search.analysis.pair_comparison import (
    PairMeasure,
    PairRepeat,
    PairStanding,
    measure_words,
    pair_duels,
    pair_standings,
)
from brink.search.analysis.paper import LEVEL
from brink.search.sequential import ERROR, FIRST, FURTHER, LIMIT
from brink.server.api.experiment_counts import LeftOutView

COLUMNS: Final = (
    "distinct pairs",
    "confirmed distinct pairs",
    "checked pairs confirmed",
    "all pairs confirmed",
    "unsafe sides that are the component's",
)
"""Columns of the table of methods."""
_MEASURED: Final = {PairMeasure.CONFIRMED: "confirmed distinct pairs", PairMeasure.DISTINCT: "distinct pairs"}


def settings_words(eps: float, d_th: float) -> str:
    """Describe which pairs are counted."""
    return (
        f"A pair is a safe and an unsafe solution at most {eps:g} apart, or one step in a single parameter; pairs at "
        f"least {d_th:g} apart are distinct."
    )


def standing_cells(one: PairStanding, *, computed: bool) -> list[str]:
    """Return the cells of a method below `COLUMNS`.

    Args:
        one: The method.
        computed: Whether verdicts are computed, so that there is nothing to confirm.
    """
    if one.confirmed is not None:
        confirmed = interval_text(one.confirmed)
    elif computed:
        confirmed = DASH
    else:
        confirmed = f"known for {one.known} of {one.distinct.repeats} campaigns" if one.tried else "not tried"
    unchecked = "none checked" if one.pairs else "no pair"
    return [
        interval_text(one.distinct),
        confirmed,
        DASH if computed else share_cell(one.precision, one.checked, unchecked, tried=one.tried),
        DASH if computed else share_cell(one.overall, one.pairs, "no pair", tried=one.tried),
        DASH if computed else share_cell(one.component, one.pairs, "no pair"),
    ]


def pair_sentences(repeats: Sequence[PairRepeat], problem: str, *, level: float = LEVEL) -> Iterator[str]:
    """Yield the conclusions for a problem, as list items.

    Args:
        repeats: Finished campaigns.
        problem: Name of the problem.
        level: Corrected p-value up to which a difference is significant.
    """
    yield f"{measure_words(repeats, problem)}\n"
    for duel in pair_duels(repeats, level=level):
        if duel.problem == problem:
            yield f"- {duel_words(duel, _MEASURED[duel.measure])}"


def left_out_sentences(left_out: Sequence[LeftOutView], problem: str | None = None) -> Iterator[str]:
    """Yield list items that name the campaigns left out for having too many pairs, with advice.

    Args:
        left_out: Campaigns that are left out.
        problem: Name of the problem; None for all.
    """
    ours = [one for one in left_out if problem in (None, one.problem)]
    if ours:
        yield "Left out everywhere here, as they have too many pairs:\n"
    for one in ours:
        yield f"- campaign `{one.campaign}` (**{one.method}**, seed {one.seed}): {one.reason}"


def pair_section(
    repeats: Sequence[PairRepeat],
    problem: str,
    *,
    eps: float,
    d_th: float,
    heading: str,
    picture: str | None,
    left_out: Sequence[LeftOutView] = (),
    level: float = LEVEL,
) -> list[str]:
    """Return the paragraphs of the report about the pairs on a problem.

    Args:
        repeats: Finished campaigns.
        problem: Name of the problem.
        eps: Largest distance between the sides of a pair.
        d_th: Smallest distance between two distinct pairs.
        heading: What follows the words of a heading, such as the name of the problem.
        picture: File name of the figure, if it was drawn.
        left_out: Campaigns that are left out, as they have too many pairs.
        level: Corrected p-value up to which a difference is significant.
    """
    ours = [one for one in repeats if one.problem == problem]
    parts = [f"## Pairs across the boundary{heading}", settings_words(eps, d_th)]
    if omitted := "\n".join(left_out_sentences(left_out, problem)):
        parts.append(omitted)
    if not ours:
        return parts
    parts.append("\n".join(pair_sentences(repeats, problem, level=level)))
    if picture is not None:
        parts.append(f"![Distinct and confirmed pairs by method]({picture})")
    computed = ours[0].computed
    rows = [table_row(["method", *COLUMNS]), table_row(["---"] * (1 + len(COLUMNS)))]
    rows += [
        table_row([f"**{one.method}**", *standing_cells(one, computed=computed)])
        for one in pair_standings(ours)
    ]
    legend = (
        "*Means over the campaigns of a method with 95% intervals; shares over the pairs of all its campaigns with "
        "Wilson intervals, which take pairs as independent.*"
    )
    parts += ["### Means and shares", "\n".join(rows), legend]
    if duels := pair_duels(ours, level=level):
        parts += ["### Comparisons of pairs", duels_table(duels, _MEASURED[duels[0].measure])]
    return [*parts, "### Pairs of each campaign", _campaigns(ours)]


def _campaigns(repeats: Sequence[PairRepeat]) -> str:
    names = [
        "campaign",
        "method",
        "seed",
        "distinct",
        "checked",
        "tried",
        "confirmed",
        "refuted",
        "checked and tried",
        "checked and confirmed",
        "component's",
        "scenario's",
    ]
    rows = [table_row(names), table_row(["---"] * len(names))]
    for one in repeats:
        counts = one.counts
        blamed = counts.component + counts.scenario
        none = DASH if one.computed or not counts.distinct else "not tried"
        figures = [
            counts.tried or none,
            counts.confirmed if counts.tried else none,
            counts.refuted if counts.tried else none,
            counts.checked_judged if counts.tried else none,
            counts.checked_confirmed if counts.tried else none,
            counts.component if blamed else none,
            counts.scenario if blamed else none,
        ]
        rows.append(
            table_row(
                [
                    f"`{one.campaign}`",
                    one.method,
                    str(one.seed),
                    str(counts.distinct),
                    DASH if one.computed else str(counts.checked),
                    *map(str, figures),
                ]
            )
        )
    return "\n".join(rows)


def pair_methods(repeats: Sequence[PairRepeat]) -> Iterator[str]:
    """Yield how pairs are counted, as list items."""
    yield (
        "**Pairs** are those of all simulations of a campaign, including extra ones to complete the last generation. "
        "All campaigns are searched for pairs in the same way. **Checked**: the search itself simulated each side "
        "again, and both kept their verdicts."
    )
    if all(one.computed for one in repeats):
        return
    yield (
        "**Tried**: simulated again after the search, with other seeds; drives of the search do not count. "
        f"**Confirmed**: the safe side is unsafe with a probability of at most {LIMIT:.0%}, and the unsafe side with "
        f"one of at least {1 - LIMIT:.0%}. It takes {FIRST} drives of a side, and {FURTHER} more for each with the "
        "other verdict. **Refuted**: a side is beyond its limit. Either claim is wrong with a probability of at most "
        f"{ERROR:.0%}. A pair that is neither is undecided; it counts as not confirmed once each side had {FIRST} "
        "drives."
    )
    yield (
        "**The component's**: with ground truth in its place, the episode of the unsafe side is safe. **The "
        "scenario's**: it is unsafe even then."
    )
    yield (
        "**Comparisons of pairs**: Mann-Whitney U, two-sided, over the campaigns of two methods, with Holm's "
        "correction over the methods of a problem; Vargha and Delaney's A12."
    )

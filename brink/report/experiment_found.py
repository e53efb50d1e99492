"""What an experiment found, pairs and thresholds, in its report: conclusions, tables, methods.

"Not tried" is never written as a number: what was not simulated again is neither confirmed nor refuted.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from brink.report.text import interval_text, p_text, table_row
from brink.search.analysis.count_comparison import (
    CountDuel,
    CountMeasure,
    FoundRepeat,
    FoundStanding,
    Proportion,
)
from brink.search.analysis.statistics import MeanInterval
from brink.search.sequential import ERROR, FIRST, FURTHER, LIMIT
from brink.server.experiments.searched import LeftOut
from brink.server.findings.experiments import ExperimentPairs, ExperimentThresholds

DASH: Final = "–"
Found = ExperimentPairs | ExperimentThresholds


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundWords:
    """How one kind of finding is reported.

    Attributes:
        name: Its section of the experiment.
        noun: What is found, in the singular.
        title: Heading of its section.
        settings: Returns which are counted, in a sentence.
        columns: Columns of the table of methods: heading, cell, and whether it needs simulated verdicts.
        counted: Fields of a campaign, in its table.
        checked: Those that need simulated verdicts.
        tested: Those that need follow-ups.
        methods: How they are counted, as list items.
        tested_methods: How they are tested, as list items.
    """

    name: str
    noun: str
    title: str
    settings: Callable[[Any], str]
    columns: Sequence[tuple[str, Callable[[Any], str], bool]]
    counted: Sequence[str]
    checked: Sequence[str] = ()
    tested: Sequence[str]
    methods: Sequence[str]
    tested_methods: Sequence[str]

    @property
    def headings(self) -> list[str]:
        """Headings of the table of methods."""
        return [heading for heading, _, _ in self.columns]

    def cells(self, found: Found, problem: str) -> Iterator[tuple[str, list[str]]]:
        """Yield each method on a problem, with its cells below `headings`."""
        computed = any(one.computed for one in found.repeats if one.problem == problem)
        for one in found.standings:
            if one.problem == problem:
                yield (
                    one.method,
                    [DASH if computed and simulated else cell(one) for _, cell, simulated in self.columns],
                )

    def measured(self, measure: CountMeasure) -> str:
        """Return what methods are compared on, in the plural."""
        return f"{'confirmed ' if measure is CountMeasure.CONFIRMED else ''}distinct {self.noun}s"

    def sentences(self, found: Found, problem: str) -> Iterator[str]:
        """Yield the conclusions for a problem, as list items."""
        yield from (f"{one.says}\n" for one in found.problems if one.problem == problem)
        for duel in found.duels:
            if duel.problem == problem:
                yield f"- {_duel_words(duel, self.measured(duel.measure))}"

    def section(self, found: Found, problem: str, *, heading: str, picture: str | None) -> list[str]:
        """Return the paragraphs of the report about a problem.

        Args:
            found: What the experiment found.
            problem: Name of the problem.
            heading: What follows the words of a heading, such as the name of the problem.
            picture: File name of the figure, if it was drawn.
        """
        ours = [one for one in found.repeats if one.problem == problem]
        parts = [f"## {self.title}{heading}", self.settings(found)]
        if omitted := "\n".join(left_out_sentences(found.left_out, self.name, problem)):
            parts.append(omitted)
        if not ours:
            return parts
        parts.append("\n".join(self.sentences(found, problem)))
        if picture is not None:
            parts.append(f"![Distinct and confirmed {self.name} by method]({picture})")
        rows = [[f"**{method}**", *cells] for method, cells in self.cells(found, problem)]
        legend = (
            f"*Means over the campaigns of a method with 95% intervals; shares over the {self.name} of all its "
            f"campaigns with Wilson intervals, which take {self.name} as independent.*"
        )
        parts += [f"### Means and shares of {self.name}", _table(["method", *self.headings], rows), legend]
        if duels := [one for one in found.duels if one.problem == problem]:
            measured = self.measured(duels[0].measure)
            parts += [f"### Comparisons of {self.name}", _duels_table(duels, measured, found.alpha)]
        return [*parts, f"### {self.name.capitalize()} of each campaign", self._campaigns(ours)]

    def _campaigns(self, repeats: Sequence[FoundRepeat]) -> str:
        fields = [*self.counted, *self.checked, *self.tested]
        names = ["campaign", "method", "seed", *fields, "component's", "scenario's"]
        return _table(names, [self._campaign(one) for one in repeats])

    def _campaign(self, one: FoundRepeat) -> list[str]:
        none = DASH if one.computed or not one.total else "not tried"
        numbers = [
            *_numbers(one, self.counted),
            *_numbers(one, self.checked, DASH if one.computed else None),
            *_numbers(one, self.tested, None if one.tried else none),
            *_numbers(one, ("component", "scenario"), None if one.component + one.scenario else none),
        ]
        return [f"`{one.campaign}`", one.method, str(one.seed), *numbers]

    def method_items(self, found: Found) -> Iterator[str]:
        """Yield how they are counted and tested, as list items."""
        yield from self.methods
        if all(one.computed for one in found.repeats):
            return
        yield from self.tested_methods
        yield (
            f"**Comparisons of {self.name}**: Mann-Whitney U, two-sided, over the campaigns of two methods, with "
            "Holm's correction over the methods of a problem; Vargha and Delaney's A12."
        )


def left_out_sentences(left_out: Sequence[LeftOut], name: str, problem: str | None = None) -> Iterator[str]:
    """Yield list items that name the campaigns left out for having found too many, with advice.

    Args:
        left_out: Campaigns that are left out.
        name: What they found, in the plural.
        problem: Name of the problem; None for all.
    """
    ours = [one for one in left_out if problem in (None, one.problem)]
    if ours:
        yield f"Left out everywhere here, as they have too many {name}:\n"
    for one in ours:
        yield f"- campaign `{one.campaign}` (**{one.method}**, seed {one.seed}): {one.reason}"


def _table(names: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(table_row(cells) for cells in (names, ["---"] * len(names), *rows))


def _numbers(one: FoundRepeat, fields: Sequence[str], none: str | None = None) -> list[str]:
    """Return fields of a campaign as text, or `none` for each, if given."""
    return [str(getattr(one, name.replace(" ", "_"))) if none is None else none for name in fields]


def _share(value: Proportion | None, total: int, none: str, *, tried: int = 0) -> str:
    """Return a share with its interval, or why there is none.

    Args:
        value: The share.
        total: What it is a share of; 0 if there is nothing.
        none: What is said if there is nothing.
        tried: How many were simulated with other seeds.
    """
    if value is not None:
        return f"{value.share:.0%} [{value.low:.0%}, {value.high:.0%}], {value.count:,} of {value.of:,}"
    if not total:
        return none
    return "too few drives" if tried else "not tried"


def _confirmed(value: MeanInterval | None, one: FoundStanding) -> str:
    if value is not None:
        return interval_text(value)
    return f"known for {one.known} of {one.distinct.repeats} campaigns" if one.tried else "not tried"


def _duel_words(duel: CountDuel, measured: str) -> str:
    figures = f"{duel.first_mean:.1f} {measured} against {duel.second_mean:.1f}"
    if duel.p is not None:
        figures += (
            f", A12 {duel.a12:.2f} ({duel.effect}), p {p_text(duel.p)}, corrected {p_text(duel.p_holm)}"
        )
    return f"**{duel.first}** and **{duel.second}**: {figures}; {duel.says}."


def _duels_table(duels: Sequence[CountDuel], measured: str, level: float) -> str:
    rows = [
        [
            f"{one.first} : {one.second}",
            f"{one.first_mean:.1f} : {one.second_mean:.1f}",
            f"{one.u:g}",
            p_text(one.p),
            f"**{p_text(one.p_holm)}**" if one.differs else p_text(one.p_holm),
            f"{one.a12:.2f} {one.effect}",
            one.says,
        ]
        for one in duels
    ]
    legend = (
        "*A12: probability that the first exceeds the second. Corrected: Holm's correction over the comparisons of "
        f"this table whose values differ. Bold: p at most {level:g}.*"
    )
    return f"{_table(['methods', measured, 'U', 'p', 'corrected p', 'A12', 'conclusion'], rows)}\n\n{legend}"


def _untested(one: Any) -> str:
    return "none can be confirmed" if one.found else "no threshold"


PAIRS: Final = FoundWords(
    name="pairs",
    noun="pair",
    title="Pairs across the boundary",
    settings=lambda found: (
        f"A pair is a safe and an unsafe solution at most {found.eps:g} apart, or one step in a single parameter; "
        f"pairs at least {found.d_th:g} apart are distinct."
    ),
    columns=(
        ("distinct pairs", lambda one: interval_text(one.distinct), False),
        ("confirmed distinct pairs", lambda one: _confirmed(one.confirmed, one), True),
        (
            "checked pairs confirmed",
            lambda one: _share(
                one.precision, one.checked, "none checked" if one.pairs else "no pair", tried=one.tried
            ),
            True,
        ),
        ("all pairs confirmed", lambda one: _share(one.overall, one.pairs, "no pair", tried=one.tried), True),
        (
            "unsafe sides that are the component's",
            lambda one: _share(one.component, one.pairs, "no pair"),
            True,
        ),
    ),
    counted=("distinct",),
    checked=("checked",),
    tested=("tried", "confirmed", "refuted", "checked judged", "checked confirmed"),
    methods=(
        (
            "**Pairs** are those of all simulations of a campaign, including extra ones to complete the last "
            "generation. All campaigns are searched for pairs in the same way. **Checked**: the search itself "
            "simulated each side again, and both kept their verdicts."
        ),
    ),
    tested_methods=(
        (
            "**Tried**: simulated again after the search, with other seeds; drives of the search do not count. "
            f"**Confirmed**: the safe side is unsafe with a probability of at most {LIMIT:.0%}, and the unsafe side "
            f"with one of at least {1 - LIMIT:.0%}. It takes {FIRST} drives of a side, and {FURTHER} more for each "
            "with the other verdict. **Refuted**: a side is beyond its limit. Either claim is wrong with a "
            f"probability of at most {ERROR:.0%}. A pair that is neither is undecided; it counts as not confirmed "
            f"once each side had {FIRST} drives."
        ),
        (
            "**The component's**: with ground truth in its place, the episode of the unsafe side is safe. **The "
            "scenario's**: it is unsafe even then."
        ),
    ),
)
THRESHOLDS: Final = FoundWords(
    name="thresholds",
    noun="threshold",
    title="Thresholds",
    settings=lambda found: (
        "A threshold is where, along one number with all else held, the probability of a violation passes from at "
        f"most {LIMIT:.0%} to at least {1 - LIMIT:.0%}; of one kind, those at least {found.d_th:g} apart are "
        "distinct."
    ),
    columns=(
        ("distinct thresholds", lambda one: interval_text(one.distinct), False),
        ("kinds", lambda one: interval_text(one.kinds), False),
        ("confirmed distinct thresholds", lambda one: _confirmed(one.confirmed, one), True),
        ("confirmed kinds", lambda one: _confirmed(one.confirmed_kinds, one), True),
        (
            "held at both ends",
            lambda one: _share(one.held, one.paired, _untested(one), tried=one.tried),
            True,
        ),
        (
            "confirmed of those simulated again",
            lambda one: _share(one.overall, one.paired, _untested(one), tried=one.tried),
            True,
        ),
        (
            "unsafe ends that are the component's",
            lambda one: _share(one.component, one.found, "no threshold"),
            True,
        ),
    ),
    counted=("found", "distinct", "kinds", "paired"),
    tested=("tried", "held", "confirmed", "confirmed distinct", "confirmed kinds", "refuted"),
    methods=(
        (
            "**Thresholds** are those of all simulations of a campaign that vary one number alone, estimated in the "
            "same way for every method. A search that never varies one number alone finds none, however many unsafe "
            "solutions it finds. **Kinds** are told apart by the number and its error, the target, the road, and "
            "how the unsafe end fails. **Distinct**: of another kind than all sharper thresholds of the campaign, "
            "or far from them."
        ),
    ),
    tested_methods=(
        (
            "**Paired**: with a tight pair of ends, simulated solutions below the 20% and above the 80% point, at "
            "most the stretch and two resolutions apart; without one, a threshold is not confirmed. **Tried**: "
            "these were simulated again after the search, with other seeds. **Held**: their drives were at most 20% "
            f"and at least 80% unsafe, an observation. **Confirmed**: the sequential test with {FIRST} or more "
            "drives of each end says so, with an error rate of 5%; few drives confirm only ends that are far beyond "
            "20 and 80%."
        ),
    ),
)

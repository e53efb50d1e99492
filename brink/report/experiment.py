"""The report of an experiment: setup, conclusions in words, tables, figures, and methods.

It is written as Markdown with separate image files; the HTML page is rendered from it, with embedded images.
"""

import base64
import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from html import escape
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

from brink import __version__
from brink.report.experiment_found import Found, FoundWords
from brink.report.text import interval_text, p_text, table_row
from brink.search.analysis.comparison import (
    Duel,
    Lead,
    Line,
    Repeat,
    Standing,
    conclusion,
    duels,
    is_significant,
    lead_words,
    leads,
    signed,
    standings,
    with_low_controls,
)
from brink.search.analysis.paper import (
    D_THS,
    LEVEL,
    PAPER_D_THS,
    PAPER_FRACTIONS,
    PAPER_LEVEL,
    PAPER_T_BS,
    Measure,
)
from brink.search.analysis.scores import DRAWS, ENOUGH_REPEATS
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.experiments.body import ExperimentBody
from brink.server.problems.catalogue import ODD

NAMES = {Measure.DBS: "DBS", Measure.STRICT: "strict DBS"}
STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.55 system-ui, sans-serif; max-width: 76rem; margin: 2rem auto; padding: 0 1.2rem;
  color: #1f252b; background: #fff; }
h1, h2, h3 { line-height: 1.25; margin: 2.2em 0 .6em; } h1 { margin-top: 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .78rem; display: block;
  overflow-x: auto; }
th, td { padding: .3rem .55rem; text-align: right; border-bottom: 1px solid #d0d5d9; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } img { max-width: 100%; height: auto; }
code { font-size: .92em; } em { color: #68727b; font-style: normal; }
@media (prefers-color-scheme: dark) { body { color: #e6e9ec; background: #14181c; } th, td { border-color: #3a424a; }
  em { color: #9aa5ae; } img { background: #fff; border-radius: 6px; padding: 4px; } }
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportedFound:
    """What an experiment found of one kind.

    Attributes:
        words: How it is reported.
        found: What it found.
        pictures: File name of the figure of each problem.
    """

    words: FoundWords
    found: Found
    pictures: Mapping[str, str]


def markdown_report(
    body: ExperimentBody,
    repeats: Sequence[Repeat],
    pictures: Mapping[tuple[str, Measure, str], str],
    *,
    experiment: str,
    created_at: datetime,
    elapsed_s: float,
    found: Sequence[ReportedFound] = (),
    level: float = LEVEL,
) -> str:
    """Return the report as Markdown: thresholds and pairs first where the experiment asks for them, then DBS.

    Args:
        body: Body of the experiment.
        repeats: Its finished campaigns, at least one.
        pictures: File names of the figures, by problem, measure and kind.
        experiment: Id of the experiment.
        created_at: Time of submission.
        elapsed_s: Duration of the experiment.
        found: What the experiment asks for besides.
        level: Corrected p-value up to which a difference is significant.
    """
    parts = [f"# {body.name}", _facts(body, repeats, experiment, created_at, elapsed_s)]
    found_standings, found_duels = standings(repeats), duels(repeats, level=level)
    for problem in dict.fromkeys(repeat.problem for repeat in repeats):
        heading = f": {problem}" if len(body.problems) > 1 else ""
        for one in found:
            picture = one.pictures.get(problem)
            parts += one.words.section(one.found, problem, heading=heading, picture=picture)
        parts += [
            f"## {'Boundary solutions, as the paper counts them' if found else 'Conclusions'}{heading}",
            "\n".join(sentences(repeats, found_standings, found_duels, problem)),
        ]
        for measure in Measure:
            name = NAMES[measure]
            parts += [f"## {name[0].upper()}{name[1:]}{heading}"]
            for (of, drawn, kind), file in pictures.items():
                if (of, drawn) == (problem, measure):
                    parts.append(f"![{name} {_figure_words(kind)}]({file})")
            parts += ["### Means and 95% intervals", _standings_table(found_standings, problem, measure)]
            ours = [one for one in found_duels if (one.first.problem, one.measure) == (problem, measure)]
            parts += ["### Comparisons", _duels_table(ours)]
            if measure is Measure.DBS and (paper_table := _paper_table(ours)):
                parts += ["### Comparisons as in the paper", paper_table]
            if found_leads := leads(repeats, problem, measure, DEFAULT_D_TH):
                parts += ["### Differences by share of the budget", _leads_table(found_leads)]
    parts += ["## Campaigns", _campaigns(repeats), "## Methods", _method(repeats, found)]
    return "\n\n".join(parts) + "\n"


def html_report(markdown: str, title: str, folder: Path) -> str:
    """Render a report as one HTML page with embedded images.

    Args:
        markdown: A report from `markdown_report`.
        title: Title of the page.
        folder: Folder with the images.
    """
    tokens = (reader := MarkdownIt("commonmark", {"html": False}).enable("table")).parse(markdown)
    for token in tokens:
        for child in token.children or ():
            if child.type == "image":
                picture = (folder / str(child.attrs["src"])).read_bytes()
                child.attrs["src"] = f"data:image/png;base64,{base64.b64encode(picture).decode('ascii')}"
    content = reader.renderer.render(tokens, reader.options, {})
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{escape(title)}</title>\n'
        f"<style>{STYLE}</style>\n</head>\n<body>\n{content}</body>\n</html>\n"
    )


def sentences(
    repeats: Sequence[Repeat], found: Sequence[Standing], compared: Sequence[Duel], problem: str
) -> Iterator[str]:
    """Yield the conclusions for a problem at the default thresholds, as list items.

    Args:
        repeats: Finished campaigns.
        found: The means of all methods.
        compared: The comparisons of all pairs.
        problem: Name of the problem.
    """
    yield f"At t_b {DEFAULT_T_B:g} and d_th {DEFAULT_D_TH:g}:\n"
    means = {(one.line, one.measure): one.value for one in found if (one.t_b, one.d_th) == _DEFAULTS}
    for duel in compared:
        if (duel.t_b, duel.d_th) != _DEFAULTS or duel.first.problem != problem:
            continue
        first, second = (means[line, duel.measure].mean for line in (duel.first, duel.second))
        yield f"- {_comparison_text(duel, first, second, with_low_controls(repeats, problem))}"
    for measure in Measure:
        for lead in leads(repeats, problem, measure, DEFAULT_D_TH):
            if lead.t_b == DEFAULT_T_B:
                yield f"- {_lead_text(lead)}"


_DEFAULTS = (DEFAULT_T_B, DEFAULT_D_TH)


def _comparison_text(duel: Duel, first: float, second: float, low: Collection[str]) -> str:
    figures = f"{NAMES[duel.measure]} {first:.1f} against {second:.1f}"
    if duel.result.p_value is not None:
        figures += (
            f", A12 {duel.result.a12:.2f} ({duel.size}), p {p_text(duel.result.p_value)}, "
            f"corrected {p_text(duel.adjusted)}"
        )
    other = "compared with its control" if duel.second.control else f"and **{duel.second.method}**"
    return f"**{duel.first.method}** {other}: {figures}; {conclusion(duel, first, second, low)}."


def _figure_words(kind: str) -> str:
    """Return the axis against which a figure shows a measure, such as ``by share of the budget at d_th 0.2``."""
    d_th = kind.removeprefix("by-budget-")
    return "by d_th" if d_th == kind else f"by share of the budget at d_th {d_th}"


def _lead_text(lead: Lead) -> str:
    """Return how far one method is ahead of another over the budget, in words."""
    return (
        f"**{lead.first}** minus **{lead.second}** over the budget: {NAMES[lead.measure]} {lead_words(lead)}."
    )


def _facts(
    body: ExperimentBody, repeats: Sequence[Repeat], experiment: str, created_at: datetime, elapsed_s: float
) -> str:
    total = body.campaigns
    finished = "" if len(repeats) == total else f"; **{len(repeats)} of {total} campaigns have finished**"
    hours, minutes = divmod(round(elapsed_s / 60), 60)
    rows = [
        f"- Experiment `{experiment}`, submitted {created_at:%Y-%m-%d %H:%M} UTC, {hours} h {minutes:02} min"
        f"{finished}.",
        f"- Methods: {', '.join(f'{one.label} (`{one.id}`)' for one in body.algorithms)}.",
        f"- Problems: {', '.join(f'{one.label} (`{one.id}`{_odd(one.params)})' for one in body.problems)}.",
        f"- {len(body.seeds)} seeds ({_seed_list(body.seeds)}), {body.budget.simulations:,} simulations each: "
        f"{total * body.budget.simulations:,} in all.",
        f"- Brink {__version__}.",
    ]
    return "\n".join(rows)


def _odd(params: Mapping[str, Any]) -> str:
    """Return the operational design domain among a problem's parameters in words; empty for none."""
    limits = "; ".join(f"`{name}: {json.dumps(limit)}`" for name, limit in params.get(ODD, {}).items())
    return f", within the ODD {limits}" if limits else ""


def _seed_list(seeds: Sequence[int]) -> str:
    in_a_row = len(seeds) > 2 and list(seeds) == list(range(seeds[0], seeds[0] + len(seeds)))
    return f"{seeds[0]} to {seeds[-1]}" if in_a_row else ", ".join(str(seed) for seed in seeds)


def _standings_table(found: Sequence[Standing], problem: str, measure: Measure) -> str:
    ours = [one for one in found if one.line.problem == problem and one.measure is measure]
    rows = [table_row(["d_th", "method", *(f"t_b {t_b:g}" for t_b in PAPER_T_BS)]), table_row(["---"] * 8)]
    by_place = {(one.line, one.t_b, one.d_th): one.value for one in ours}
    lines = list(dict.fromkeys(one.line for one in ours))
    for d_th in D_THS:
        for line in lines:
            values = [interval_text(by_place[line, t_b, d_th]) for t_b in PAPER_T_BS]
            rows.append(table_row([f"{d_th:g}", _name(line), *values]))
    return "\n".join(rows)


def _duels_table(found: Sequence[Duel]) -> str:
    if not found:
        return "Nothing to compare."
    legend = (
        "*Each cell: A12 (probability that the first exceeds the second), effect size, p of Mann-Whitney U with "
        "Holm's correction over all comparisons of this table whose values differ. Equal: all values are, so there "
        f"is nothing to test. Bold: p at most {found[0].level:g}.*"
    )
    return f"{_table_of(found, _duel_cell)}\n\n{legend}"


def _paper_table(found: Sequence[Duel]) -> str | None:
    """Return the comparisons of methods as the paper tests them, or None if there is only one method."""
    methods = [duel for duel in found if not duel.second.control]
    if not methods:
        return None
    legend = (
        "*Each cell: A12, effect size, p of Mann-Whitney U without correction. N/A: at least one of the two found "
        f"nothing in all its campaigns. Bold: p at most {PAPER_LEVEL:g}.*"
    )
    return f"{_table_of(methods, _paper_cell)}\n\n{legend}"


def _table_of(found: Sequence[Duel], cell: Callable[[Duel], str]) -> str:
    """Return comparisons as a table: a row for each d_th and pair, a column for each t_b."""
    rows = [table_row(["d_th", "methods", *(f"t_b {t_b:g}" for t_b in PAPER_T_BS)]), table_row(["---"] * 8)]
    by_place = {(one.first, one.second, one.t_b, one.d_th): one for one in found}
    for d_th in PAPER_D_THS:
        for first, second in dict.fromkeys((one.first, one.second) for one in found):
            cells = [cell(by_place[first, second, t_b, d_th]) for t_b in PAPER_T_BS]
            against = "its control" if second.control else second.method
            rows.append(table_row([f"{d_th:g}", f"{first.method} : {against}", *cells]))
    return "\n".join(rows)


def _duel_cell(duel: Duel) -> str:
    if duel.adjusted is None:
        return "equal"
    words = f"{duel.result.a12:.2f} {duel.size}, p {p_text(duel.adjusted)}"
    return f"**{words}**" if duel.differs else words


def _paper_cell(duel: Duel) -> str:
    if duel.found_nothing:
        return "N/A"
    if duel.paper_p is None:
        return "equal"
    words = f"{duel.result.a12:.2f} {duel.size}, p {p_text(duel.paper_p)}"
    return f"**{words}**" if is_significant(duel.paper_p, PAPER_LEVEL) else words


def _leads_table(found: Sequence[Lead]) -> str:
    """Return the differences between methods after each tenth of the budget, as a table."""
    names = ["methods", "t_b", *(f"{share:.0%}" for share in PAPER_FRACTIONS)]
    rows = [table_row(names), table_row(["---"] * len(names))]
    for lead in found:
        cells = [
            "–" if lead.found_nothing else f"**{signed(value)}**" if significant else signed(value)
            for value, significant in zip(lead.differences, lead.significant(), strict=True)
        ]
        rows.append(table_row([f"{lead.first} − {lead.second}", f"{lead.t_b:g}", *cells]))
    legend = (
        f"*Mean of the first minus mean of the second at d_th {found[0].d_th:g}, scored with what was known at that "
        f"share of the budget. Bold: p at most {PAPER_LEVEL:g}, without correction, as the paper tests. –: neither "
        "found anything.*"
    )
    return "\n".join(rows) + f"\n\n{legend}"


def _campaigns(repeats: Sequence[Repeat]) -> str:
    rows = [
        table_row(
            ["campaign", "method", "problem", "seed", "evaluated", "unsafe", "behaviours per scenario"]
        ),
        table_row(["---"] * 7),
    ]
    for one in repeats:
        control = one.scores.control
        behaviours = "–" if control is None else f"{control.repeats:.1f}"
        share = one.scores.unsafe / one.scores.evaluated if one.scores.evaluated else 0.0
        rows.append(
            table_row(
                [
                    f"`{one.campaign}`",
                    one.method,
                    one.problem,
                    str(one.seed),
                    f"{one.scores.evaluated:,}",
                    f"{share:.0%}",
                    behaviours,
                ]
            )
        )
    return "\n".join(rows)


def _method(repeats: Sequence[Repeat], found: Sequence[ReportedFound]) -> str:
    low = with_low_controls(repeats)
    items = [
        *(item for one in found for item in one.words.method_items(one.found)),
        "**DBS**: solutions whose fitness is at most t_b, selected greedily, best first, each at least d_th from all "
        "those selected before. Extra simulations to complete the last generation are not counted.",
        "**Strict DBS** counts only those whose interval contains p_th and whose neighbours have both verdicts. "
        "From t_b = 1/9 (at p_th = .1), plain DBS also counts neighbourhoods without any unsafe solution.",
        "**Controls** keep the simulated solutions and redraw each verdict with the unsafe probability of its "
        f"scenario alone: means of {DRAWS} draws per campaign. The rest of a "
        "method's result is due to behaviour.",
        "**Tests**: Mann-Whitney U, two-sided, with Holm's correction over all comparisons of a table; Vargha and "
        "Delaney's A12, called small from .56, medium from .64, large from .71, and likewise below one half. The "
        f"paper tests at {PAPER_LEVEL:g} without correction: among so many comparisons, some are significant by "
        "chance.",
        "Intervals are Student's t intervals over the seeds.",
    ]
    if low:
        items.append(
            f"The control of {', '.join(low)} **reads low**, with fewer than {ENOUGH_REPEATS:g} behaviours "
            "per scenario: results beyond it prove nothing."
        )
    return "\n".join(f"- {item}" for item in items)


def _name(line: Line) -> str:
    return f"*{line.label}*" if line.control else f"**{line.method}**"

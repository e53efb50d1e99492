"""Whether a detector meets a requirement, as CSV, Markdown, sentences and a page."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from brink import __version__
from brink.report.episode_strips import Strip
from brink.report.page import page_template
from brink.report.text import markdown_text, table_row
from brink.server.csv_text import csv_text
from brink.server.findings.tolerances.views import DetectorCell, DetectorView
from brink.server.findings.words import as_sentence
from brink.server.states import CheckResult

TICKS: Final = (0.0, 0.25, 1.0)
"""Shares of drives that a bar's axis names, besides the limit."""
COLUMNS: Final = (
    "result",
    "error",
    "condition",
    "drives",
    "median",
    "95% within",
    "violate",
    "interval",
    "worst drives",
)
NUMBERS: Final = ("drives", "median", "95% within", "violate")
"""Columns aligned to the right."""


@dataclass(frozen=True, slots=True)
class Bar:
    """An interval of a share of drives, on a scale that separates small shares.

    Attributes:
        low: Where it begins, as a share of the scale.
        value: Where the estimate lies.
        high: Where it ends.
    """

    low: float
    value: float
    high: float


def place_of(share: float) -> float:
    """Return the position of a share of drives on the scale of bars, in [0, 1]: proportional to its square root."""
    return math.sqrt(min(max(share, 0.0), 1.0))


def bar_of(cell: DetectorCell) -> Bar | None:
    """Return the bar of a cell; None without data."""
    if cell.share is None or cell.low is None or cell.high is None:
        return None
    return Bar(place_of(cell.low), place_of(cell.share), place_of(cell.high))


def evidence(view: DetectorView) -> list[DetectorCell]:
    """Return the cells with evidence."""
    return [cell for cell in view.cells if cell.result is not CheckResult.NO_DATA]


def tally(view: DetectorView) -> dict[str, int]:
    """Return in how many cells the requirement is not met, unknown, and met."""
    results = [cell.result for cell in view.cells]
    not_met, met = results.count(CheckResult.NOT_MET), results.count(CheckResult.MET)
    return {"not met": not_met, "unknown": len(results) - not_met - met, "met": met}


def row_of(cell: DetectorCell) -> tuple[str, ...]:
    """Return the row of a cell, for `COLUMNS`. Magnitudes that may be larger are marked with ``≥``."""
    share, interval = "–", ""
    if cell.share is not None and cell.low is not None and cell.high is not None:
        share, interval = f"{cell.share:.1%}", f"[{cell.low:.1%}, {cell.high:.1%}]"
    return (
        cell.result.value,
        cell.error,
        cell.condition,
        f"{cell.drives:,}",
        _magnitude(cell, cell.typical),
        _magnitude(cell, cell.grossest),
        share,
        interval,
        ", ".join(cell.worst[:3]),
    )


def _magnitude(cell: DetectorCell, magnitude: float | None) -> str:
    if magnitude is None:
        return "–"
    mark = "≥ " if cell.at_least else ""
    return f"{mark}{magnitude:.0f}%" if cell.unit == "%" else f"{mark}{magnitude:.1f} {cell.unit}".rstrip()


def _violations(view: DetectorView) -> Iterator[str]:
    """Yield how often the detector's own drives violated, by condition, where that is known."""
    for one in view.conditions:
        if one.violations is not None and one.drives:
            yield f"{as_sentence(one.condition)}: {one.violations} of {one.drives} drives with this detector violate."


def detector_csv(view: DetectorView) -> str:
    """Return a row for each cell, those without data last."""
    names = list(view.cells[0].choices) if view.cells else []
    rows: list[Sequence[object]] = [
        (
            *(name.rpartition(".")[2] for name in names),
            "error",
            "condition",
            "result",
            "drives",
            "at_least",
            "unit",
            "median",
            "within_95",
            "beyond",
            "share",
            "low",
            "high",
            "limit",
            "confidence",
            "needed",
            "worst",
            "sentence",
        )
    ]
    rows += [
        (
            *(cell.choices[name] for name in names),
            cell.error,
            cell.condition,
            cell.result.value,
            cell.drives,
            cell.at_least,
            cell.unit,
            *map(_digits, (cell.typical, cell.grossest)),
            cell.beyond,
            *map(_digits, (cell.share, cell.low, cell.high)),
            view.limit,
            view.confidence,
            cell.needed,
            " ".join(cell.worst),
            cell.sentence,
        )
        for cell in view.cells
    ]
    return csv_text(rows)


def _digits(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def detector_markdown(view: DetectorView, about: Sequence[str], picture: str | None = None) -> str:
    """Return whether a detector meets a requirement as Markdown.

    Args:
        view: The check.
        about: What was read, and what counts in it, in sentences.
        picture: File name of the picture, to show it.
    """
    lines = [
        f"# {markdown_text(view.detector)}: does it meet the requirement?",
        "",
        f"**{view.note}.**",
        "",
        view.meaning,
        "",
    ]
    if picture is not None:
        lines += [f"![Shares of drives that violate, with intervals, against the limit]({picture})", ""]
    if view.next:
        lines += ["## What to record next", "", *(f"- {markdown_text(words)}." for words in view.next), ""]
    lines += ["## Results", "", table_row(COLUMNS), table_row(["---"] * len(COLUMNS))]
    lines += [table_row(row_of(cell)) for cell in evidence(view)]
    lines += ["", *small_print(view)]
    if about:
        lines += ["", "## What was measured", "", *(f"- {markdown_text(words)}" for words in about)]
    return "\n".join(lines) + "\n"


def small_print(view: DetectorView) -> list[str]:
    """Return the fine print: what no drive shows, how often the detector's own drives violated, and the marks."""
    found = list(filter(None, (view.no_data, *_violations(view))))
    if any(cell.at_least for cell in view.cells):
        found.append(AT_LEAST)
    return found


AT_LEAST: Final = (
    "≥: at least; in some drives the recording cut the error off, or the road user was never reported."
)


def detector_page(view: DetectorView, about: Sequence[str], strips: Sequence[Strip] = ()) -> str:
    """Return whether a detector meets a requirement as an HTML page without external resources.

    Args:
        view: The check.
        about: What was read, and what counts in it, in sentences.
        strips: The worst episodes.
    """
    return page_template("detector.html").render(
        view=view,
        about=about,
        strips=strips,
        version=__version__,
        tally=tally(view),
        small_print=small_print(view),
        rows=[(cell, row_of(cell), bar_of(cell)) for cell in evidence(view)],
        limit=place_of(view.limit),
        headline=f"{view.detector}: does it meet the requirement?",
        ticks=[(place_of(share), f"{share:.0%}") for share in TICKS],
    )

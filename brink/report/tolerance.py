"""The requirement that follows from tolerances, as a document in Markdown."""

from typing import Final

from brink.report.text import table_row
from brink.server.api.tolerance import CellView, Finding, ToleranceView


def requirement_document(view: ToleranceView, picture: str | None = None) -> str:
    """Return the requirement of a campaign as Markdown.

    Args:
        view: The tolerances of the campaign.
        picture: File name of the curves, to show them.
    """
    lines = [
        f"# Requirement on the component: {view.name}",
        "",
        f"Campaign {view.campaign}: {view.note}. A drive counts if it violates with the error and not without it, "
        "under the same seed.",
        "",
    ]
    if picture is not None:
        lines += [
            f"![Share of drives that violate because of the error, against how gross it is]({picture})",
            "",
        ]
    for title, finding in _SECTIONS.items():
        cells = [cell for cell in view.cells if cell.tolerated.finding is finding]
        if cells:
            lines += [f"## {title}", "", *(f"- {cell.sentence}" for cell in cells), ""]
    falls = [cell for cell in view.cells if cell.fall is not None]
    if falls:
        lines += ["## Where more error is safer", ""]
        lines += [
            f"- {', '.join([*cell.choices.values(), cell.condition])}: {cell.fall.words}."
            for cell in falls
            if cell.fall is not None
        ]
        lines.append("")
    lines += ["## Without any error", "", table_row(["condition", "cells", "drives", "violate", "interval"])]
    lines.append(table_row(["---"] * 5))
    for one in view.baseline:
        only = " or ".join(" ".join(choices.values()) for choices in one.choices if choices) or "all"
        share = one.share
        violating = f"{share.unsafe / share.evaluated:.1%}" if share.evaluated else "–"
        interval = f"{share.low:.1%} to {share.high:.1%}"
        lines.append(table_row([one.condition, only, str(share.evaluated), violating, interval]))
    lines += [
        "",
        f"Intervals of tolerated magnitudes cover {view.confidence:.0%}, those of this table 95%.",
        f"{view.audited} drives that hold with the grossest error were simulated with milder ones; {view.leaks} of "
        "them violated.",
        "",
        "Each sentence is about one error at a time, in the scenarios of the campaign, with its driving system.",
    ]
    return "\n".join(lines) + "\n"


_SECTIONS = {
    "Tolerated up to a magnitude": Finding.LIMIT,
    "Tolerated however gross": Finding.THROUGHOUT,
    "Undecided": Finding.UNDECIDED,
}


def tolerated_words(cell: CellView) -> tuple[str, str]:
    """Return the tolerated magnitude of a cell and its interval."""
    found = cell.tolerated
    ends = sorted(
        (found.low, found.high), key=lambda one: (one.severity is None, _shown(one.magnitude, one.severity))
    )
    if cell.unit and cell.curve.magnitude and cell.curve.magnitude[0] > cell.curve.magnitude[-1]:
        ends = [found.high, found.low]
    interval = ", ".join(_amount(one.magnitude, one.severity) for one in ends)
    if found.finding is Finding.THROUGHOUT:
        return "any", ""
    value = _amount(found.value.magnitude, found.value.severity)
    unit = cell.unit if cell.unit == "%" else f" {cell.unit}".rstrip()
    return (value if value == _BEYOND else f"{value}{unit}"), f"[{interval}]"


_BEYOND: Final = "beyond"


def _shown(magnitude: float | None, severity: float | None) -> float:
    if magnitude is not None:
        return magnitude
    return severity if severity is not None else 0.0


def _amount(magnitude: float | None, severity: float | None) -> str:
    if severity is None:
        return _BEYOND
    value = _shown(magnitude, severity)
    return f"{value:.0f}" if value >= 20 else f"{value:.1f}" if magnitude is not None else f"{value:.2f}"

"""The requirement that follows from tolerances, as a document in Markdown."""

from typing import Final

from brink.report.text import table_row
from brink.server.findings.tolerances.views import CellView, ToleranceView, Tolerated


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
        view.caveat,
        "",
        *(_SCREENING if any(cell.screened for cell in view.cells) else ()),
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
            f"- {cell.error}, {cell.condition}: {cell.fall.words}." for cell in falls if cell.fall is not None
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
    ]
    return "\n".join(lines) + "\n"


_SCREENING: Final = (
    "A drive is vulnerable if the grossest error concerning the same road users makes it violate. Milder errors were "
    "simulated in these drives alone.",
    "",
)
_SECTIONS: Final = {
    "Tolerated up to a limit": Tolerated.LIMIT,
    "No limit found": Tolerated.THROUGHOUT,
    "Undecided": Tolerated.UNDECIDED,
}
KEY: Final = (
    "screened: drives simulated with the grossest error concerning the same road users; vulnerable: those that it "
    "makes violate; drives: those simulated with this error, of the vulnerable ones if there was screening; caused: "
    "those that violate because of it"
)
"""What the numbers of drives in a table of cells mean."""


def tolerated_words(cell: CellView) -> tuple[str, str]:
    """Return the tolerated magnitude of a cell and its interval."""
    found = cell.tolerated
    ends = sorted(
        (found.low, found.high), key=lambda one: (one.severity is None, _shown(one.magnitude, one.severity))
    )
    if cell.unit and cell.curve.magnitude and cell.curve.magnitude[0] > cell.curve.magnitude[-1]:
        ends = [found.high, found.low]
    interval = ", ".join(_amount(one.magnitude, one.severity) for one in ends)
    unit = cell.unit if cell.unit == "%" else f" {cell.unit}".rstrip()
    if not cell.basis:
        return "unknown", ""
    if found.finding is Tolerated.THROUGHOUT:
        grossest = None if cell.curve.magnitude is None else cell.curve.magnitude[-1]
        return f"no limit to {_amount(grossest, cell.curve.severity[-1])}{unit}", ""
    value = _amount(found.value.magnitude, found.value.severity)
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

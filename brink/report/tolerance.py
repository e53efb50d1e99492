"""The requirement that follows from tolerances, as a document in Markdown."""

from typing import Final

from brink.report.text import table_row
from brink.server.findings.tolerances.views import ToleranceView, Tolerated


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
            f"![Share of drives that violate because of the error, against its severity]({picture})",
            "",
        ]
    for title, finding in _SECTIONS.items():
        cells = [cell for cell in view.cells if cell.tolerated.finding is finding]
        if cells:
            lines += [f"## {title}", "", *(f"- {cell.sentence}" for cell in cells), ""]
    falls = [cell for cell in view.cells if cell.fall is not None]
    if falls:
        lines += ["## Where a larger error is safer", ""]
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
        f"{view.audited} drives that hold with the most severe error were simulated with milder ones; "
        f"{view.leaks} of "
        "them violated.",
    ]
    return "\n".join(lines) + "\n"


_SCREENING: Final = (
    "A drive is vulnerable if the most severe error concerning the same road users makes it violate. Milder "
    "errors were simulated only in these drives.",
    "",
)
_SECTIONS: Final = {
    "Tolerated up to a limit": Tolerated.LIMIT,
    "No limit found": Tolerated.THROUGHOUT,
    "Undecided": Tolerated.UNDECIDED,
}

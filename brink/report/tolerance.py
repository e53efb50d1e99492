"""The requirement that follows from tolerances, as a document in Markdown."""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

from brink.report.text import table_row
from brink.server.errors import InvalidInput
from brink.server.findings.table import Column, Table
from brink.server.findings.tolerances.views import CellView, ToleranceView, Tolerated
from brink.server.findings.words import counted


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


def tolerances_beside(views: Mapping[str, ToleranceView]) -> tuple[Table, str]:
    """Return the tolerances of several campaigns side by side, and a sentence on where they differ.

    Args:
        views: At least two, by what stands above their columns. The first decides which cells there are.

    Raises:
        InvalidInput: They do not answer the same question, or have no cell in common.
    """
    first, *others = views.values()
    for one in others:
        for what in ("requirements", "limit", "confidence"):
            if getattr(one, what) != getattr(first, what):
                raise InvalidInput.at(
                    "--beside",
                    f"campaign {one.campaign}: expected the same {what} as campaign {first.campaign}, "
                    f"{getattr(first, what)}; got {getattr(one, what)}",
                )
    known = [{_key(cell): cell for cell in one.cells} for one in views.values()]
    shared = [key for key in known[0] if all(key in cells for cells in known)]
    if not shared:
        raise InvalidInput.at(
            "--beside", "these campaigns have no type of error, target and condition in common"
        )
    rows = [[cells[key] for cells in known] for key in shared]
    measured = [row for row in rows if all(cell.basis for cell in row)]
    apart = sum(_are_apart(row) for row in measured)
    table = Table(
        name="beside",
        title="Tolerated magnitude of each error",
        columns=[
            Column(name="error", title="error"),
            Column(name="condition", title="condition"),
            *(Column(name=name, title=f"{name}, {first.confidence:.0%} interval") for name in views),
        ],
        rows=[[row[0].error, row[0].condition, *(cell.tolerated_words for cell in row)] for row in rows],
    )
    return table, (
        f"In {apart:,} of {counted(len(measured), 'cell')} that all of them measured, the {first.confidence:.0%} "
        "intervals of at least two do not overlap"
    )


def _key(cell: CellView) -> tuple[str, tuple[tuple[str, str], ...]]:
    return cell.condition, tuple(sorted(cell.choices.items()))


def _are_apart(row: Sequence[CellView]) -> bool:
    """Return whether the intervals of two cells do not overlap; an end beyond the scale is infinite."""
    ends = [
        [
            math.inf if end.severity is None else end.severity
            for end in (one.tolerated.low, one.tolerated.high)
        ]
        for one in row
    ]
    return any(max(a[0], b[0]) > min(a[1], b[1]) for a, b in combinations(ends, 2))


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

"""Numbers and tables as text, for reports."""

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from brink.worker.printable import printable

if TYPE_CHECKING:
    from brink.search.analysis.statistics import MeanInterval

_TAG: Final = re.compile("<(?=[A-Za-z/!?])")


def interval_text(value: "MeanInterval") -> str:
    """Return the mean of a count with its interval, such as ``3.2 [0.0, 6.9]``; counts are not negative."""
    if value.low is None or value.high is None:
        return f"{value.mean:.1f}"
    return f"{value.mean:.1f} [{max(0.0, value.low):.1f}, {value.high:.1f}]"


def p_text(value: float | None) -> str:
    """Return a p-value as text; None, where all values are equal and nothing is tested, as ``equal``."""
    if value is None:
        return "equal"
    return "< .001" if value < 0.001 else f"{value:.3f}"


def table_row(cells: Sequence[str]) -> str:
    """Return a row of a Markdown table."""
    return f"| {' | '.join(markdown_text(cell).replace('|', '/') for cell in cells)} |"


def markdown_text(text: str) -> str:
    """Return untrusted text escaped so that no Markdown reader takes it for HTML, without control characters."""
    return _TAG.sub(r"\\<", printable(text).replace("\n", " "))

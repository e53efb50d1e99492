"""The one place that writes CSV: spreadsheets execute cells that look like formulas, and cells hold untrusted text.

Names, plug-ins' choices, and what workers report as features and provenance can be any text. A cell of text that
begins with one of `FORMULA_STARTS` gets an apostrophe in front, which spreadsheets read as "this is text". Numbers
stay as they are, also where they are given as text.
"""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from typing import Final

from brink.worker.printable import printable

FORMULA_STARTS: Final = ("=", "+", "-", "@", "\t", "\n", "＝", "＋", "－", "＠")
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?%?|[+-](inf|nan)")


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Return rows, including the header, as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([as_text(cell) for cell in row] for row in rows)
    return text.getvalue()


def as_text(cell: object) -> object:
    """Return a cell that no spreadsheet interprets as a formula."""
    if cell is None or isinstance(cell, bool | int | float):
        return cell
    # The csv module would not quote a return.
    words = printable(str(cell).replace("\r\n", "\n").replace("\r", "\n"))
    is_formula = words.startswith(FORMULA_STARTS) and not _NUMBER.fullmatch(words)
    return f"'{words}" if is_formula else words

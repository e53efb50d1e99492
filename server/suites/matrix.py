"""The matrix of a suite: drives by versions, what turned unsafe on top."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from brink.search.analysis.suite import SuiteVerdict
from brink.server.suites.results import CaseResult, SuiteResults

MARKS: Final = {
    SuiteVerdict.BROKEN: "✗",
    SuiteVerdict.NOT_REPRODUCED: "≠",
    SuiteVerdict.CANNOT_RUN: "!",
    SuiteVerdict.UNCLEAR: "?",
    SuiteVerdict.OPEN: "…",
    SuiteVerdict.FIXED: "✓",
    SuiteVerdict.STILL_UNSAFE: "✗",
    SuiteVerdict.STILL_SAFE: "✓",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MatrixRow:
    """A drive in several versions.

    Attributes:
        name: The drive.
        words: The drive in words.
        cells: Its result in each version; None where the version's run does not have it.
        turned_unsafe: Whether it is unsafe in the newest version with a clear result, and was safe in an earlier one.
    """

    name: str
    words: str
    cells: tuple[CaseResult | None, ...]
    turned_unsafe: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Matrix:
    """Drives by versions.

    Attributes:
        versions: Labels of the runs, the newest first.
        times: When each ended.
        rows: What turned unsafe is on top, then what the newest run found not as expected.
    """

    versions: tuple[str, ...]
    times: tuple[str, ...]
    rows: tuple[MatrixRow, ...]

    @property
    def words(self) -> str:
        """The matrix in a sentence."""
        worse = sum(row.turned_unsafe for row in self.rows)
        drives = f"{len(self.rows):,} drive{'s' if len(self.rows) != 1 else ''}"
        versions = f"{len(self.versions)} version{'s' if len(self.versions) != 1 else ''}"
        return f"{drives} in {versions}: {worse} turned unsafe"


def matrix_of(runs: Sequence[SuiteResults]) -> Matrix:
    """Return the matrix of runs of one suite, in any order."""
    ordered = sorted(runs, key=lambda run: run.at, reverse=True)
    by_name = [{case.name: case for case in run.cases} for run in ordered]
    names = list(dict.fromkeys(name for run in by_name for name in run))
    rows = []
    for name in names:
        cells = tuple(run.get(name) for run in by_name)
        words = next((cell.words for cell in cells if cell is not None and cell.words), "")
        rows.append(MatrixRow(name=name, words=words, cells=cells, turned_unsafe=_turned_unsafe(cells)))
    order = list(SuiteVerdict)

    def attention(row: MatrixRow) -> tuple[bool, bool, int]:
        newest = row.cells[0]
        return (
            not row.turned_unsafe,
            newest is None or newest.passed,
            len(order) if newest is None else order.index(newest.verdict),
        )

    return Matrix(
        versions=tuple(run.label for run in ordered),
        times=tuple(run.at for run in ordered),
        rows=tuple(sorted(rows, key=attention)),
    )


def _turned_unsafe(cells: Sequence[CaseResult | None]) -> bool:
    clear = [
        cell.decision.value
        for cell in cells
        if cell is not None and cell.decision.value in ("safe", "unsafe")
    ]
    return clear[:1] == ["unsafe"] and "safe" in clear


def mark_of(cell: CaseResult | None) -> str:
    """Return the mark of a result; a point if a run does not have the drive."""
    return "·" if cell is None else MARKS[cell.verdict]


def state_of(cell: CaseResult | None) -> str:
    """Return how a result is coloured: ``safe``, ``unsafe``, ``other`` or ``none``."""
    if cell is None:
        return "none"
    return cell.decision.value if cell.decision.value in ("safe", "unsafe") else "other"

"""The drives of a suite with their verdicts, as a table."""

from collections.abc import Sequence
from enum import Enum
from typing import Final

from brink.server.findings.table import Column, Format, Table
from brink.server.suites.results import CaseResult

COLUMNS: Final = [
    Column(name="name", title="drive"),
    Column(name="verdict", title="verdict", format=Format.STATE),
    Column(name="passed", title="as expected", format=Format.FLAG),
    Column(name="expect", title="expected", format=Format.STATE),
    Column(name="simulated", title="unsafe"),
    Column(name="unsafe", title="violated", format=Format.COUNT, detail=True),
    Column(name="evaluated", title="simulations", format=Format.COUNT, detail=True),
    Column(name="failed", title="failed", format=Format.COUNT, detail=True),
    Column(name="reason", title="why"),
    Column(name="solution", title="example", format=Format.SOLUTION, optional=True),
]


def cases_table(cases: Sequence[CaseResult], rows: int | None = None) -> Table:
    """Return drives with their verdicts as a table.

    Args:
        cases: The drives.
        rows: Most rows; None for all.
    """
    shown = cases[:rows]
    values = [[getattr(case, column.name) for column in COLUMNS] for case in shown]
    return Table(
        name="suite",
        title="The drives of the suite",
        columns=COLUMNS,
        rows=[[value.value if isinstance(value, Enum) else value for value in row] for row in values],
        left_out=len(cases) - len(shown),
    )

"""Tolerances of several campaigns side by side."""

from typing import Any

import pytest

from brink.report.tolerance import tolerances_beside
from brink.server.errors import InvalidInput
from brink.server.findings.tolerances.views import Amount, CellView, ToleranceView, ToleratedView


def made(model: Any, **fields: Any) -> Any:
    """Return a view with these fields alone."""
    return model.model_construct(**fields)


def cell(condition: str, low: float | None, high: float | None, basis: str = "9 drives") -> Any:
    ends = {
        name: Amount(severity=end, magnitude=end)
        for name, end in (("value", low), ("low", low), ("high", high))
    }
    return made(
        CellView,
        choices={"type": "miss"},
        condition=condition,
        error="not reporting the lead",
        basis=basis,
        tolerated=made(ToleratedView, **ends),
        tolerated_words=f"{low} to {high}",
    )


def tolerances(*cells: Any, limit: float = 0.05) -> Any:
    return made(
        ToleranceView,
        campaign="c",
        requirements=["front-gap@1"],
        limit=limit,
        confidence=0.9,
        cells=list(cells),
    )


def test_tolerances_stand_side_by_side_and_intervals_that_do_not_overlap_are_counted() -> None:
    own = tolerances(
        cell("day", 0.1, 0.3), cell("wet", 0.1, 0.3), cell("night", 0.1, None), cell("fog", 0.1, 0.2)
    )
    other = tolerances(
        cell("night", None, None),
        cell("wet", 0.2, 0.4),
        cell("day", 0.4, 0.6),
        cell("fog", 0.9, 0.9, basis=""),
    )
    table, words = tolerances_beside({"modular@1": own, "idm:Idm": other})
    assert [column.title for column in table.columns[2:]] == [
        "modular@1, 90% interval",
        "idm:Idm, 90% interval",
    ]
    assert [row[1:] for row in table.rows] == [
        ["day", "0.1 to 0.3", "0.4 to 0.6"],
        ["wet", "0.1 to 0.3", "0.2 to 0.4"],
        ["night", "0.1 to None", "None to None"],
        ["fog", "0.1 to 0.2", "0.9 to 0.9"],
    ]
    assert (
        words == "In 1 of 3 cells that all of them measured, the 90% intervals of at least two do not overlap"
    )


def test_tolerances_of_other_questions_are_refused() -> None:
    own = tolerances(cell("day", 0.1, 0.3))
    with pytest.raises(InvalidInput, match=r"expected the same limit as campaign c, 0.05; got 0.1"):
        tolerances_beside({"a": own, "b": tolerances(cell("day", 0.1, 0.3), limit=0.1)})
    with pytest.raises(InvalidInput, match="no type of error, target and condition in common"):
        tolerances_beside({"a": own, "b": tolerances(cell("night", 0.1, 0.3))})

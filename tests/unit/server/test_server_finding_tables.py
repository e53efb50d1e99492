"""Tables of findings as texts, and where reports name kinds of findings."""

from pathlib import Path

import pytest

import brink.report
from brink.server.findings.kind import all_kinds
from brink.server.findings.table import Column, Format, Table, share_text

REPORT = Path(brink.report.__path__[0])


def test_what_stands_below_a_value_is_a_line_of_its_cell_and_details_are_left_out() -> None:
    table = Table(
        name="pairs",
        title="Pairs",
        columns=[
            Column(name="change", title="change"),
            Column(name="moved", title="how far", below=True),
            Column(name="distance", title="distance", format=Format.NUMBER, detail=True),
            Column(name="state", title="state", format=Format.STATE),
        ],
        rows=[["later", "by 9%", 0.1, "confirmed"], ["earlier", "", 0.2, None]],
    )
    assert [column.name for column in table.shown] == ["change", "state"]
    assert table.texts() == [["later\nby 9%", "confirmed"], ["earlier", ""]]
    assert table.records()[0] == {"change": "later", "moved": "by 9%", "distance": 0.1, "state": "confirmed"}
    assert table.types()["state"] is str


@pytest.mark.parametrize(("share", "text"), [(0.0, "0%"), (1.0, "100%"), (0.333, "33%"), (0.001, "0.10%")])
def test_a_share_in_a_table_is_never_rounded_to_none_or_all(share: float, text: str) -> None:
    assert share_text(share) == text


def test_the_report_of_a_campaign_names_kinds_only_where_their_pictures_are() -> None:
    kinds = [f'"{kind.id}"' for kind in all_kinds()]
    files = [*REPORT.glob("campaign*.py"), REPORT / "tables.py", REPORT / "kind_pictures.py"]
    named = {file.name for file in files if any(kind in file.read_text() for kind in kinds)}
    assert named == {"kind_pictures.py"}

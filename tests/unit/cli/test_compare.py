"""`brink compare`: a table for each chosen distance, and all distances as JSON."""

import io

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.cli.compare import print_rows, rows_json
from brink.search.analysis.comparison import Row
from brink.search.analysis.paper import D_THS, PAPER_T_BS
from brink.server.errors import InvalidInput

SHAPE = (len(PAPER_T_BS), len(D_THS))
ROW = Row(
    label="night",
    campaign="3f2a",
    unsafe_share=0.2,
    dbs=np.arange(30.0).reshape(SHAPE),
    strict=np.zeros(SHAPE),
    strict_spread=np.zeros(SHAPE),
    repeats=None,
)


@pytest.mark.parametrize(("chosen", "titles"), [(None, ["0.1", "0.2", "0.3"]), ([0.5], ["0.5"])])
def test_there_is_a_table_for_each_distance(chosen: list[float] | None, titles: list[str]) -> None:
    out = io.StringIO()
    print_rows(Console(file=out, width=160), [ROW], *([chosen] if chosen else []))
    text = out.getvalue()
    assert [line.split(":")[0].strip() for line in text.splitlines() if "DBS (strict DBS)" in line] == [
        f"d_th {title}" for title in titles
    ]
    if chosen:
        [row] = [line for line in text.splitlines() if line.lstrip().startswith("night")]
        assert row.split()[2::2] == ["4", "9", "14", "19", "24", "29"], "the last of the five columns"


def test_json_has_all_distances() -> None:
    [row] = rows_json([ROW])
    at = {(cell["t_b"], cell["d_th"]): cell["dbs"] for cell in row["grid"]}
    assert len(at) == 30
    assert (at[0.01, 0.1], at[0.01, 0.5], at[0.2, 0.5]) == (0.0, 4.0, 29.0)


def test_other_distances_are_rejected() -> None:
    said = CliRunner().invoke(app, ["compare", "3f2a", "--d-th", "0.25"])
    assert isinstance(said.exception, InvalidInput)
    assert "expected one of 0.1, 0.2, 0.3, 0.4, 0.5, got 0.25" in str(said.exception)

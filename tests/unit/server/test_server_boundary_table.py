"""Boundary solutions as tables."""

import csv
import io
import json
from typing import Any

import pyarrow.parquet as pq
import pytest

from brink.search.parameters import Categorical, Integer, Real
from brink.search.space import Component, SearchSpace
from brink.server.campaigns.body import parse_body
from brink.server.findings.boundary.table import boundary_columns, boundary_rows
from brink.server.findings.boundary.views import Boundary
from brink.server.findings.table import table_bytes
from brink.server.states import SolutionVerdict
from brink.server.views import ActivityView, SolutionView

COLUMNS = {"number": int, "fitness": float, "strict": bool, "scenario.weather": str}
BODY = parse_body(
    {
        "name": "x",
        "problem": {"id": "urban-injected@1"},
        "algorithm": {"id": "ga@1"},
        "budget": {"simulations": 9},
        "seed": 4,
    }
)


def solution(number: int, **changes: Any) -> SolutionView:
    known: dict[str, Any] = {
        "number": number,
        "generation": 2,
        "verdict": SolutionVerdict.SAFE,
        "robustness": 0.5,
        "objectives": None,
        "failure": None,
        "origin": None,
        "fitness": 0.05,
        "neighbours": 40,
        "unsafe_neighbours": 4,
        "interval": (0.04, 0.23),
        "seed": 2**52 + 1,
        "attempts": 1,
        "losses": 0,
        "words": 'fog, "late", 3 s',
        "outcome": "front gap held",
        "parameters": {"scenario": {"weather": "fog", "lanes": 2}, "behaviour": {"late_s": 3.25}},
        "verdicts": {"front-gap@1": {"robustness": 0.5, "unit": "m", "violated_at_s": None}},
        "features": {"ended": "goal", "where": [1, 2]},
        "provenance": {"brink": "1.0.0", "cpu_s": 0.2},
        **changes,
    }
    return SolutionView(**known)


def boundary(*solutions: SolutionView) -> Boundary:
    return Boundary(
        t_b=0.1,
        d_th=0.2,
        dbs=len(solutions),
        strict_dbs=1,
        note="",
        grid=[],
        solutions=list(solutions),
        strict=[7],
    )


def rows() -> list[dict[str, Any]]:
    other = solution(9, verdicts=None, features={"ended": 3}, provenance=None, interval=None)
    return [dict(row) for row in boundary_rows(boundary(solution(7), other), "c0ffee", BODY)]


def test_a_row_contains_everything_known_about_a_solution() -> None:
    first, second = rows()
    assert list(first) == list(second)
    wanted = {
        "number": 7,
        "verdict": "safe",
        "interval_low": 0.04,
        "interval_high": 0.23,
        "strict": True,
        "seed": 2**52 + 1,
        "scenario.weather": "fog",
        "behaviour.late_s": 3.25,
        "campaign": "c0ffee",
        "problem": "urban-injected@1",
        "algorithm": "ga@1",
        "campaign_seed": 4,
        "generation": 2,
        "robustness.front-gap@1": 0.5,
        "feature.ended": "goal",
        "feature.where": "[1, 2]",
        "version.brink": "1.0.0",
    }
    assert {name: first[name] for name in wanted} == wanted
    assert "version.cpu_s" not in first
    assert (second["strict"], second["interval_low"], second["robustness.front-gap@1"]) == (False, None, None)


def test_parameters_are_as_the_episode_had_them() -> None:
    activity = ActivityView(
        inactive=["scenario.lanes"],
        idle=["behaviour"],
        effective={"scenario": {"weather": "fog", "lanes": 0}, "behaviour": {"late_s": 2.0}},
    )
    unknown, known = boundary_rows(boundary(solution(7), solution(8, activity=activity)), "c0ffee", BODY)
    names = ("scenario.weather", "scenario.lanes", "behaviour.late_s", "idle")
    assert [unknown[name] for name in names] == ["fog", 2, 3.25, ""]
    assert [known[name] for name in names] == ["fog", None, 2.0, "behaviour"]


def test_all_formats_have_the_same_content() -> None:
    given = rows()
    as_csv = list(csv.DictReader(io.StringIO(table_bytes(given, "csv", COLUMNS).decode())))
    as_lines = [json.loads(line) for line in table_bytes(given, "jsonl", COLUMNS).splitlines()]
    as_parquet = pq.read_table(io.BytesIO(table_bytes(given, "parquet", COLUMNS))).to_pylist()
    assert as_lines == given
    assert [list(row) for row in as_csv] == [list(row) for row in given]
    for row, text in zip(given, as_csv, strict=True):
        assert text == {name: "" if value is None else str(value) for name, value in row.items()}
    for row, read in zip(given, as_parquet, strict=True):
        # Columns of data frames have one type: a column with text and numbers becomes text.
        assert read == {**row, "feature.ended": str(row["feature.ended"])}


@pytest.mark.parametrize("form", ["csv", "jsonl", "parquet"])
def test_a_boundary_without_solutions_is_an_empty_table(form: str) -> None:
    written = table_bytes(boundary_rows(boundary(), "c0ffee", BODY), form, COLUMNS)
    if form == "csv":
        assert written.decode() == ",".join(COLUMNS) + "\n"
    elif form == "jsonl":
        assert written == b""
    else:
        table = pq.read_table(io.BytesIO(written))
        assert (table.num_rows, table.column_names) == (0, list(COLUMNS))
        assert str(table.schema.field("fitness").type) == "double"


def test_rows_begin_with_the_columns_that_every_table_has() -> None:
    space = SearchSpace(
        (
            Component("scenario", (Categorical("weather", ("clear", "fog")), Integer("lanes", 1, 4))),
            Component("behaviour", (Real("late_s", 0.0, 5.0),)),
        )
    )
    columns = boundary_columns(space)
    first, _ = rows()
    assert list(first)[: len(columns)] == list(columns)
    assert {name: type(first[name]) for name in columns} == columns

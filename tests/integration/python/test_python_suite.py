"""Suites from Python: a file, a run on this machine, the verdicts."""

from pathlib import Path

import pytest

import brink
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan
from brink.server.suites.campaigns import system_of
from brink.server.suites.file import Drive, Entry, NewEntry, write_suite

MTQ = {
    "name": "mtq",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 40},
}


def test_a_suite_runs_from_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    campaign = brink.Campaign(problem="mtq@1", algorithm="random@1", simulations=40)
    found = brink.run(campaign, progress=False).to_pandas()
    entries = []
    for side, row in (("unsafe", found[found.unsafe].iloc[0]), ("safe", found[~found.unsafe].iloc[0])):
        values = {name: float(row[name]) for name in ("x.x", "y.y")}
        drive = Drive.model_validate({"expect": side, "values": values})
        entry = Entry.model_validate({"name": side, "system": "mtq", "seed": 1, side: drive})
        entries.append(NewEntry(entry=entry, units={}))
    write_suite(tmp_path / "hazards.yaml", {"mtq": system_of(make_plan(parse_body(MTQ)))}, entries)
    suite = brink.Suite("hazards.yaml")
    assert list(suite.to_pandas()["found"]) == ["unsafe", "safe"]
    results = suite.run(workers=1, progress=False)
    assert [case.verdict.value for case in results.cases] == ["still unsafe", "still safe"]
    assert [case.evaluated for case in results.cases] == [1, 1], "computed: every seed gives the same verdict"
    assert results.passed

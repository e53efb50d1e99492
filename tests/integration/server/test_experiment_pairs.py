"""Pairs across the boundary in experiments: counted for every campaign, followed up, compared."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from support.api import FakeWorker, eventually, expect
from support.databases import sqlite_then_postgres
from support.urban_pairs import ICY_SAFE, ICY_UNSAFE, SAFE, UNSAFE, judged
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.report.experiment_found import PAIRS as WORDS
from brink.server.findings.experiments import ExperimentPairs
from brink.server.problems.urban_injected import SIMULATOR

API = "/api/v1/experiments"
FINDS = {"id": "repeat@1", "params": {"solutions": [SAFE, UNSAFE, ICY_SAFE, ICY_UNSAFE]}}
FINDS_NOTHING = {"id": "repeat@1", "params": {"solutions": [SAFE, ICY_SAFE, SAFE, ICY_SAFE]}}
PAIRS = {"d_th": 0.01, "confirm": 30, "component": True}


def experiment(**changes: Any) -> dict[str, Any]:
    """Return an experiment of two methods, of which one finds two pairs and the other none."""
    return {
        "name": "pairs",
        "problems": [{"name": "gap", "id": "urban-injected@1"}],
        "algorithms": [{"name": "finds", **FINDS}, {"name": "other", **FINDS_NOTHING}],
        "seeds": {"first": 1, "count": 4},
        "budget": {"simulations": 4},
        **changes,
    }


def work(client: httpx.Client) -> None:
    """Work until there are no jobs left."""
    worker = FakeWorker(client, capabilities=(SIMULATOR,), judge=judged)

    def idle() -> bool:
        while jobs := worker.lease(64, 0.2):
            worker.report(jobs)
        running = expect(client.get("/api/v1/campaigns", params={"status": "running"}))["campaigns"]
        return not running

    eventually(idle, "all campaigns end")


def finished(client: httpx.Client, **changes: Any) -> str:
    name = str(expect(client.post(API, json=experiment(**changes)), 201)["id"])
    work(client)
    return name


def pairs_of(client: httpx.Client, name: str, **params: Any) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{name}/pairs", params={"wait_s": 30, **params}))
    return found


def results_of(client: httpx.Client, name: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{name}/results", params={"wait_s": 30}))
    return found


def follow_up(client: httpx.Client, pairs: dict[str, Any], **wanted: Any) -> None:
    settings = {"eps": pairs["eps"], "d_th": pairs["d_th"]}
    for repeat in pairs["repeats"]:
        if repeat["distinct"]:
            path = f"/api/v1/campaigns/{repeat['campaign']}/pairs/follow-ups"
            expect(client.post(path, json={**wanted, **settings}), 201)


@sqlite_then_postgres
def test_pairs_are_counted_and_compared_once_they_are_tried(client: httpx.Client) -> None:
    name = finished(client, pairs=PAIRS)
    before = results_of(client, name)["pairs"]
    assert (before["eps"], before["d_th"], before["counted"]) == (0.02, 0.01, 8)
    [finds, other] = before["standings"]
    assert (finds["distinct"]["mean"], other["distinct"]["mean"]) == (2, 0)
    assert (finds["confirmed"], finds["overall"], finds["component"]) == (None, None, None), "not tried"
    assert other["confirmed"]["mean"] == 0, "a method without pairs has none to confirm"
    assert {r["confirmed"] for r in before["repeats"] if r["method"] == "finds"} == {None}
    [duel] = before["duels"]
    assert duel["measure"] == "distinct"
    assert "none of them was simulated again" in before["problems"][0]["says"]

    follow_up(client, before, kind="confirm", repeats=30)
    follow_up(client, before, kind="component")
    progress = expect(client.get(f"{API}/{name}/follow-ups"))
    assert (progress["status"], progress["campaigns"], progress["budget"]) == ("running", 8, 4 * (120 + 2))
    running = pairs_of(client, name)
    assert {repeat["tried"] for repeat in running["repeats"]} == {0}, "only what has ended counts"
    work(client)
    progress = expect(client.get(f"{API}/{name}/follow-ups"))
    assert (progress["status"], progress["finished"], progress["simulations"]) == (
        "finished",
        8,
        4 * (60 + 2),
    )
    after = results_of(client, name)["pairs"]
    assert after == pairs_of(client, name)
    [finds, other] = after["standings"]
    assert (finds["confirmed"]["mean"], finds["confirmed"]["low"], other["confirmed"]["mean"]) == (2, 2, 0)
    assert (finds["overall"]["count"], finds["overall"]["of"]) == (8, 8)
    assert finds["precision"] is None, "the search checked none of them"
    assert (finds["component"]["count"], finds["component"]["of"]) == (4, 8), "half are the scenario's"
    [duel] = after["duels"]
    assert (duel["measure"], duel["first_mean"], duel["second_mean"], duel["u"]) == ("confirmed", 2, 0, 16)
    assert duel["p_holm"] == duel["p"] < 0.05
    assert duel["says"] == "finds finds more"
    assert after["problems"][0]["says"] == "Compared on confirmed distinct pairs."
    first = after["repeats"][0]
    assert {key: first[key] for key in ("distinct", "checked", "tried", "judged", "confirmed", "drives")} == {
        "distinct": 2,
        "checked": 0,
        "tried": 2,
        "judged": 2,
        "confirmed": 2,
        "drives": 15,
    }
    one = expect(client.get(f"/api/v1/campaigns/{first['campaign']}/pairs", params={"d_th": 0.01}))
    assert (one["distinct"], one["confirmed"], one["component"], one["scenario"]) == (2, 2, 1, 1)


def test_experiments_without_the_section_compute_no_pairs_unless_asked(client: httpx.Client) -> None:
    name = finished(client, seeds=[1])
    assert results_of(client, name)["pairs"] is None
    assert [r["distinct"] for r in pairs_of(client, name)["repeats"]] == [1, 0], "at the default d_th"
    assert [r["distinct"] for r in pairs_of(client, name, d_th=0.01)["repeats"]] == [2, 0]
    assert expect(client.get(f"{API}/{name}/follow-ups"))["campaigns"] == 0


@pytest.mark.long("runs experiments")
def test_a_campaign_with_too_many_pairs_is_left_out_and_named(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("brink.search.analysis.pairs.MOST_DISTINCT", 1)
    name = finished(client, seeds=[1, 2], pairs=PAIRS)
    results = results_of(client, name)
    assert results["scored"] == 4, "the boundary solutions are there"
    pairs = results["pairs"]
    assert (pairs["counted"], [one["method"] for one in pairs["repeats"]]) == (2, ["other", "other"])
    assert [(one["method"], one["seed"]) for one in pairs["left_out"]] == [("finds", 1), ("finds", 2)]
    told = "more than 1 distinct pairs at d_th 0.01: choose a larger d_th or a smaller eps"
    assert {one["reason"] for one in pairs["left_out"]} == {told}
    monkeypatch.setattr("brink.search.analysis.pairs.MOST_DISTINCT", 5_000)
    assert len(pairs_of(client, name)["left_out"]) == 2, "they are not searched again on every request"
    assert pairs_of(client, name, d_th=0.011)["left_out"] == []
    found = ExperimentPairs.model_validate({**pairs, "repeats": []})
    section = WORDS.section(found, "gap", heading="", picture=None)
    assert f"(**finds**, seed 2): {told}" in section[-1]


@pytest.mark.parametrize(
    ("problem", "pairs", "pointer"),
    [
        ("urban-injected@1", {"confirm": 14}, "/pairs/confirm"),
        ("mtq@1", {"confirm": 30}, "/pairs/confirm"),
        ("mtq@1", {"component": True}, "/pairs/component"),
    ],
)
def test_follow_ups_that_tell_nothing_are_refused_at_submission(
    client: httpx.Client, problem: str, pairs: dict[str, Any], pointer: str
) -> None:
    body = experiment(problems=[{"id": problem}], algorithms=[{"id": "random@1"}], pairs=pairs)
    [error] = expect(client.post(API, json=body), 422)["errors"]
    assert error["pointer"] == pointer
    assert expect(client.get(API))["experiments"] == []


@pytest.mark.long("runs experiments")
def test_the_command_follows_up_all_campaigns_and_the_report_begins_with_pairs(
    listening_client: httpx.Client, tmp_path: Path
) -> None:
    server = ["--server", str(listening_client.base_url)]
    file = tmp_path / "experiment.yaml"
    file.write_text(yaml.safe_dump(experiment(pairs=PAIRS)))

    def said(*arguments: str, status: int = 0) -> str:
        result = CliRunner(env={"COLUMNS": "300"}).invoke(app, ["experiment", *arguments, *server])
        assert result.exit_code == status, f"{result.output} {result.exception}"
        return " ".join(result.output.split())

    name = json.loads(said("submit", str(file), "--json"))["id"]
    work(listening_client)
    before = said("pairs", name)
    assert "not tried" in before
    assert "0 confirmed" not in before
    asked = said("pairs", name, "--confirm", "30", "--component")
    assert "8 campaigns simulate them, at most 488 simulations" in asked
    work(listening_client)
    after = said("pairs", name, "--confirm", "30", "--component")
    assert "simulate them" not in after, "nothing is asked twice"
    assert "finds and other: 2.0 confirmed distinct pairs against 0.0, A12 1.00 (large)" in after
    assert "50% [22%, 78%], 4 of 8" in after
    report = said("report", name, "--out", str(tmp_path))
    assert report.index("confirmed distinct pairs") < report.index("strict DBS")
    folder = tmp_path / f"pairs-{name}"
    text = (folder / "report.md").read_text()
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings[:2] == ["## Pairs across the boundary", "## Boundary solutions, as the paper counts them"]
    assert "![Distinct and confirmed pairs by method](figures/pairs.png)" in text
    assert (folder / "figures" / "pairs.png").stat().st_size > 10_000
    assert json.loads((folder / "results.json").read_text())["pairs"]["counted"] == 8

"""Experiments over the API: all of their campaigns or none, and what they found."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from support.api import FakeWorker, await_erasure, ball, eventually, expect, row_counts
from support.databases import sqlite_then_postgres
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search.analysis.paper import PAPER_FRACTIONS
from brink.server.db.engine import Engines

API = "/api/v1/experiments"


def experiment(**changes: Any) -> dict[str, Any]:
    """Return a small experiment on the ball: two methods, three seeds."""
    ga = ball()["algorithm"]
    return {
        "name": "small",
        "problems": [{"name": "ball", "id": "ball@1"}],
        "algorithms": [
            {"name": "GA", **ga},
            {"name": "RS", "id": "random@1", "params": {"generation_size": 20}},
        ],
        "seeds": {"first": 1, "count": 3},
        "budget": {"simulations": 60},
        **changes,
    }


def submit(client: httpx.Client, **changes: Any) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.post(API, json=experiment(**changes)), 201)
    return found


def work_through(client: httpx.Client, name: str) -> None:
    worker = FakeWorker(client)

    def done() -> bool:
        while jobs := worker.lease():
            worker.report(jobs)
        return bool(expect(client.get(f"{API}/{name}"))["status"] != "running")

    eventually(done, "the experiment ends")


@sqlite_then_postgres
def test_progress_counts_what_is_done_of_the_generations_under_way(client: httpx.Client) -> None:
    found = submit(client, seeds=[1])
    path = f"{API}/{found['id']}/progress"
    assert expect(client.get(path))["simulations"] == 0
    worker = FakeWorker(client)
    worker.report(worker.lease(max_jobs=8))
    progress = expect(client.get(path))
    assert (progress["simulations"], progress["queued"]) == (8, 2 * 2 * 20 - 8)
    assert progress["rate_per_s"] > 0
    assert progress["remaining_s"] > 0
    work_through(client, found["id"])
    assert (
        expect(client.get(path))["simulations"] == expect(client.get(f"{API}/{found['id']}"))["simulations"]
    )


def test_an_experiment_is_submitted_with_all_of_its_campaigns(client: httpx.Client, engines: Engines) -> None:
    answer = client.post(API, json=experiment())
    found = expect(answer, 201)
    assert answer.headers["Location"] == f"{API}/{found['id']}"
    assert (found["status"], found["campaigns"], found["budget"]) == ("running", 6, 360)
    assert [(m["method"], m["seed"]) for m in found["members"]] == [
        (method, seed) for seed in (1, 2, 3) for method in ("GA", "RS")
    ]
    assert row_counts(engines)["campaigns"] == 6
    named = expect(client.get(f"{API}/{found['id'][:4]}"))
    assert named["members"] == found["members"]
    campaign = expect(client.get(f"/api/v1/campaigns/{found['members'][3]['campaign']}"))
    assert campaign["name"] == "small: RS, seed 2"


@pytest.mark.parametrize(
    ("changes", "pointer"),
    [
        (
            {"problems": [{"id": "ball@1"}, {"name": "far", "id": "ball@1", "params": {"limit": 99}}]},
            "/problems/1/params/limit",
        ),
        ({"problems": [{"id": "bal@1"}]}, "/problems/0/id"),
        ({"algorithms": [{"id": "ga@1"}, {"id": "gaa@1"}]}, "/algorithms/1/id"),
        ({"algorithms": [{"id": "ga@1"}, {"id": "ga\x14"}]}, "/algorithms/1/id"),
        ({"name": "n" * 120, "algorithms": [{"id": "ga@1"}, {"id": "a" * 100}]}, "/algorithms/1/id"),
        ({"algorithms": [{"id": "ga@1", "params": {"radius": -1}}]}, "/algorithms/0/params/radius"),
    ],
)
def test_nothing_is_stored_of_an_experiment_that_cannot_run(
    client: httpx.Client, engines: Engines, changes: dict[str, Any], pointer: str
) -> None:
    document = expect(client.post(API, json=experiment(**changes)), 422)
    assert [error["pointer"] for error in document["errors"]] == [pointer]
    counts = row_counts(engines)
    assert (counts["experiments"], counts["campaigns"], counts["jobs"]) == (0, 0, 0)


@sqlite_then_postgres
def test_the_same_key_again_submits_nothing_new(client: httpx.Client, engines: Engines) -> None:
    headers = {"Idempotency-Key": "key-1"}
    first = expect(client.post(API, json=experiment(), headers=headers), 201)
    again = expect(client.post(API, json=experiment(), headers=headers), 200)
    assert (again["id"], row_counts(engines)["campaigns"]) == (first["id"], 6)
    other = expect(client.post(API, json=experiment(name="other"), headers=headers), 409)
    assert first["id"] in other["detail"]


def test_an_experiment_runs_to_its_end_and_says_what_it_found(client: httpx.Client) -> None:
    found = submit(client)
    before = expect(client.get(f"{API}/{found['id']}/results"))
    assert (before["scored"], before["standings"], before["repeats"]) == (0, [], [])
    work_through(client, found["id"])
    progress = expect(client.get(f"{API}/{found['id']}/progress"))
    assert (progress["status"], progress["finished"], progress["queued"]) == ("finished", 6, 0)
    assert progress["simulations"] >= 360
    assert progress["remaining_s"] is None
    results = expect(client.get(f"{API}/{found['id']}/results", params={"wait_s": 30}))
    assert results["scored"] == 6
    assert [(r["method"], r["seed"]) for r in results["repeats"]] == [
        (method, seed) for seed in (1, 2, 3) for method in ("GA", "RS")
    ]
    for repeat in results["repeats"]:
        path = f"/api/v1/campaigns/{repeat['campaign']}/boundary"
        grid = expect(client.get(path))["grid"]
        assert len(repeat["dbs"]) == len(PAPER_FRACTIONS)
        if expect(client.get(f"/api/v1/campaigns/{repeat['campaign']}"))["simulations"] == 60:
            assert [cell["dbs"] for cell in grid] == [figure for row in repeat["dbs"][-1] for figure in row]
            assert [cell["strict_dbs"] for cell in grid] == [f for row in repeat["strict"][-1] for f in row]
        assert repeat["control"] is None, "the ball has no component called scenario"
    assert {(d["first"], d["second"]) for d in results["duels"]} == {("GA", "RS")}
    mean = next(s for s in results["standings"] if s["method"] == "GA" and s["measure"] == "dbs")
    assert mean["repeats"] == 3


@sqlite_then_postgres
def test_experiment_is_paused_resumed_cancelled_and_deleted(client: httpx.Client, engines: Engines) -> None:
    name = submit(client)["id"]
    assert expect(client.post(f"{API}/{name}/pause"))["status"] == "paused"
    assert FakeWorker(client).lease() == []
    assert expect(client.post(f"{API}/{name}/resume"))["status"] == "running"
    assert FakeWorker(client).lease()
    assert "cancel it" in expect(client.delete(f"{API}/{name}"), 409)["detail"]
    assert expect(client.post(f"{API}/{name}/cancel"))["status"] == "cancelled"
    assert client.delete(f"{API}/{name}").status_code == 204
    expect(client.get(f"{API}/{name}"), 404)
    await_erasure(engines)
    counts = row_counts(engines)
    assert (counts["experiments"], counts["experiment_campaigns"], counts["campaigns"], counts["jobs"]) == (
        0,
        0,
        0,
        0,
    )


def test_a_campaign_of_an_experiment_may_be_deleted_by_itself(client: httpx.Client) -> None:
    found = submit(client)
    gone = found["members"][0]["campaign"]
    expect(client.post(f"/api/v1/campaigns/{gone}/cancel"))
    assert client.delete(f"/api/v1/campaigns/{gone}").status_code == 204
    left = expect(client.get(f"{API}/{found['id']}"))
    assert (left["deleted"], len(left["members"])) == (1, 5)


@sqlite_then_postgres
def test_experiments_are_listed_newest_first_and_page_by_page(client: httpx.Client) -> None:
    names = [submit(client, name=f"n{place}", seeds=[1])["id"] for place in range(3)]
    page = expect(client.get(API, params={"limit": 2}))
    assert [one["id"] for one in page["experiments"]] == [names[2], names[1]]
    rest = expect(client.get(API, params={"limit": 2, "cursor": page["next"]}))
    assert ([one["id"] for one in rest["experiments"]], rest["next"]) == ([names[0]], None)
    expect(client.get(API, params={"cursor": "nonsense"}), 422)


@pytest.mark.long("runs an experiment")
def test_the_command_line_does_all_of_it(listening_client: httpx.Client, tmp_path: Path) -> None:
    file, server = tmp_path / "experiment.yaml", ["--server", str(listening_client.base_url)]
    file.write_text(yaml.safe_dump(experiment(seeds=[1, 2])))

    def said(*arguments: str, status: int = 0) -> str:
        result = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["experiment", *arguments, *server])
        assert result.exit_code == status, f"{result.output} {result.exception}"
        return f"{result.output} {result.exception or ''}"

    name = json.loads(said("submit", str(file), "--json"))["id"]
    assert name in said("list")
    assert "is paused" in said("pause", name)
    assert "is running" in said("resume", name)
    assert "no campaign has finished yet" in said("report", name, "--out", str(tmp_path), status=1)
    assert "cancel it" in said("delete", name, "--yes", status=1)
    work_through(listening_client, name)
    status = said("status", name)
    assert "finished, 261 of 240 simulations" in status, "generations end whole"
    assert status.count("GA") == 2
    report = said("report", name, "--out", str(tmp_path))
    assert "strict DBS" in report
    folder = tmp_path / f"small-{name}"
    assert {path.name for path in folder.iterdir()} == {"report.html", "report.md", "results.json", "figures"}
    assert "GA, ball, seed" not in (folder / "report.md").read_text()
    assert "is deleted" in said("delete", name, "--yes")
    assert "no experiments yet" in said("list")

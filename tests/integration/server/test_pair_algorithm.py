"""An algorithm of pairs in one file of the tests gets them everywhere, like the built-in one."""

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, finish, listening_coordinator
from support.bisection import Bisection
from support.databases import Databases
from support.problems import small_problems
from typer.testing import CliRunner

import brink
from brink.cli.commands import app
from brink.server.problems.catalogue import ALGORITHMS
from brink.sim import catalogue

API = "/api/v1/campaigns"
TOY = {"id": Bisection.id, "params": {"eps": 0.04}}


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    with module_databases.database() as url, small_problems(), pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue._registered, ALGORITHMS, {Bisection.id: Bisection})
        with listening_coordinator(url) as opened:
            yield opened


@pytest.fixture(scope="module")
def campaign(client: httpx.Client) -> str:
    return finish(client, ball(simulations=60, algorithm=TOY))


@pytest.fixture(scope="module")
def pairs(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(client.get(f"{API}/{campaign}/pairs"))
    return found


def terminal(client: httpx.Client, *words: str) -> str:
    ran = CliRunner().invoke(app, [*words, "--server", str(client.base_url)])
    assert ran.exit_code == 0, ran.output
    return " ".join(str(ran.stdout).split())


def test_its_pairs_are_what_the_campaign_is_for(
    client: httpx.Client, campaign: str, pairs: dict[str, Any]
) -> None:
    assert expect(client.get(f"{API}/{campaign}"))["finds"] == ["pairs"]
    assert (pairs["searched"], pairs["eps"], pairs["d_th"]) == (True, 0.04, 0.2), (
        "its own eps, the usual d_th"
    )
    assert pairs["distinct"] >= 2
    assert all(one["same_seed"] and one["distance"] <= 0.04 for one in pairs["pairs"])
    offers = {one["kind"]: (one["simulations"], one["reason"]) for one in pairs["offers"]}
    assert offers["confirm"] == (2 * pairs["distinct"], "")
    found = expect(client.get(f"{API}/{campaign}/findings"))
    assert (found["findings"][0]["kind"], found["findings"][0]["role"]) == ("pairs", "sought")
    assert found["words"].startswith(f"{pairs['distinct']} distinct pairs")
    assert len(found["findings"][0]["rings"]) == pairs["distinct"]
    text = client.get(f"{API}/{campaign}/findings/pairs", params={"format": "csv"}).text
    assert len(list(csv.DictReader(io.StringIO(text)))) == pairs["distinct"]


def test_the_boundary_is_counted_only_after_its_last_generation(client: httpx.Client, campaign: str) -> None:
    generations = expect(client.get(f"{API}/{campaign}/progress", params={"since": 0}))["generations"]
    counts = [(one["dbs"], one["strict_dbs"], one["best_fitness"]) for one in generations]
    assert len(counts) > 2
    assert counts[:-1] == [(None, None, None)] * (len(counts) - 1)
    course = expect(client.get(f"{API}/{campaign}/course"))
    assert counts[-1] == (course["dbs"][-1], course["strict_dbs"][-1], None)
    page = expect(client.get(f"{API}/{campaign}/solutions"))
    assert {one["fitness"] for one in page["solutions"]} == {None}


def test_its_pairs_can_be_confirmed(client: httpx.Client) -> None:
    campaign = finish(client, ball(simulations=60, seed=2, algorithm=TOY))
    expect(client.post(f"{API}/{campaign}/pairs/follow-ups", json={"kind": "confirm"}), 201)
    FakeWorker(client).work(expect(client.get(f"{API}/{campaign}/pairs"))["follow_ups"][0]["campaign"])
    found = expect(client.get(f"{API}/{campaign}/pairs"))
    assert found["confirmed"] == found["distinct"] >= 2


def test_terminal_and_files_show_its_pairs(
    client: httpx.Client, campaign: str, pairs: dict[str, Any], tmp_path: Path
) -> None:
    count = f"{pairs['distinct']} distinct pairs"
    assert count in terminal(client, "findings", campaign)
    assert count in terminal(client, "pairs", campaign)
    assert "brink findings" in terminal(client, "status", campaign)
    terminal(client, "pairs", campaign, "--out", str(tmp_path / "pairs.csv"))
    assert len((tmp_path / "pairs.csv").read_text().splitlines()) == pairs["distinct"] + 1


def test_data_frames_have_its_pairs(client: httpx.Client, campaign: str, pairs: dict[str, Any]) -> None:
    result = brink.connect(str(client.base_url)).campaign(campaign).result()
    assert len(result.findings("pairs")) == len(result.pairs()) == pairs["distinct"]


@pytest.mark.long("writes a whole report; that of a toy kind is written in every run")
def test_its_report_has_its_pairs(
    client: httpx.Client, campaign: str, pairs: dict[str, Any], tmp_path: Path
) -> None:
    result = brink.connect(str(client.base_url)).campaign(campaign).result()
    page = result.report(tmp_path / "report.html", pairs=0).read_text()
    assert f"{pairs['distinct']} distinct pairs" in page


def test_brink_run_reports_its_pairs_first(client: httpx.Client, sqlite_file: Path, tmp_path: Path) -> None:
    body = {
        "name": "disc",
        "problem": {"id": "mtq@1"},
        "algorithm": {"id": Bisection.id, "params": {"draws": 80, "eps": 0.04}},
        "budget": {"simulations": 120},
    }
    (tmp_path / "disc.json").write_text(json.dumps(body))
    database = f"sqlite:///{tmp_path}/runs.db"
    Path(tmp_path / "runs.db").write_bytes(sqlite_file.read_bytes())
    command = [
        "run",
        f"{tmp_path}/disc.json",
        "--database",
        database,
        "--out",
        str(tmp_path),
        "--no-pictures",
    ]
    ran = CliRunner().invoke(app, command)
    assert ran.exit_code == 0, ran.output
    lines = [line.strip() for line in ran.stdout.splitlines()]
    assert any("across the boundary" in line for line in lines), ran.stdout
    assert "pairs.csv" in lines
    assert not any("boundary solution" in line for line in lines)

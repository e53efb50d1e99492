"""Thresholds in experiments: counted for every campaign, followed up, compared, reported."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from support.api import FakeWorker, eventually, expect, listening_coordinator
from support.databases import Databases
from support.missed import PROBLEM, SECONDS, SIMULATOR, judge, missing
from support.sweep import Sweep
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.problems.catalogue import ALGORITHMS
from brink.sim import catalogue

API = "/api/v1/experiments"
LINES = [*missing("clear", SECONDS), *missing("hard_rain", SECONDS)]
SCATTERED = [*missing("clear", [0.1, 7.9]), *missing("hard_rain", [0.1, 7.9])]
SEEDS = 4


@pytest.fixture(scope="module")
def client(module_databases: Databases) -> Iterator[httpx.Client]:
    with module_databases.database() as url, pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue._registered, ALGORITHMS, {Sweep.id: Sweep})
        with listening_coordinator(url) as opened:
            yield opened


def experiment(**wanted: Any) -> dict[str, Any]:
    """Return an experiment of two methods, of which one varies a number on two lines, and the other none."""
    return {
        "name": "turns",
        "problems": [{"name": "errors", **PROBLEM}],
        "algorithms": [
            {"name": "along", "id": Sweep.id, "params": {"rows": LINES}},
            {"name": "scattered", "id": Sweep.id, "params": {"rows": SCATTERED}},
        ],
        "seeds": {"first": 1, "count": SEEDS},
        "budget": {"simulations": len(LINES)},
        "thresholds": wanted,
    }


def work(client: httpx.Client) -> None:
    """Work until there are no jobs left."""
    worker = FakeWorker(client, capabilities=(SIMULATOR,), judge=judge)

    def idle() -> bool:
        while jobs := worker.lease(64, 0.2):
            worker.report(jobs)
        running = expect(client.get("/api/v1/campaigns", params={"status": "running"}))["campaigns"]
        return not running

    eventually(idle, "all campaigns end")


@pytest.mark.long("runs an experiment and draws its report")
def test_thresholds_are_counted_followed_up_and_compared(client: httpx.Client, tmp_path: Path) -> None:
    file = tmp_path / "experiment.yaml"
    file.write_text(yaml.safe_dump(experiment(confirm=30, component=True)))

    def said(*arguments: str) -> str:
        command = ["experiment", *arguments, "--server", str(client.base_url)]
        result = CliRunner(env={"COLUMNS": "400"}).invoke(app, command)
        assert result.exit_code == 0, f"{result.output} {result.exception}"
        return " ".join(result.output.split())

    def found(**params: float) -> dict[str, Any]:
        read: dict[str, Any] = expect(client.get(f"{API}/{name}/thresholds", params={"wait_s": 30, **params}))
        return read

    name = json.loads(said("submit", str(file), "--json"))["id"]
    work(client)
    before = found()
    [along, scattered] = before["standings"]
    assert (along["found"], along["distinct"]["mean"], along["kinds"]["mean"]) == (2 * SEEDS, 1, 1)
    assert (along["confirmed"], along["held"], along["component"]) == (None, None, None), "not tried"
    assert (scattered["found"], scattered["confirmed"]["mean"]) == (0, 0), "no threshold, none to confirm"
    assert {one["confirmed"] for one in before["repeats"] if one["method"] == "along"} == {None}
    assert "none of them was simulated again with other seeds" in before["problems"][0]["says"]
    assert [one["distinct"]["mean"] for one in found(d_th=0.001)["standings"]] == [2, 0], (
        "two kinds of weather, and therefore two places"
    )
    assert "not tried" in said("thresholds", name)

    asked = said("thresholds", name, "--confirm", "30", "--component")
    assert f"{2 * SEEDS} campaigns simulate them" in asked
    work(client)
    after = said("thresholds", name, "--confirm", "30", "--component")
    assert "simulate them" not in after, "nothing is asked twice"
    assert "along and scattered: 1.0 confirmed distinct thresholds against 0.0, A12 1.00 (large)" in after
    assert "along finds more" in after
    results = expect(client.get(f"{API}/{name}/results", params={"wait_s": 30}))
    assert results["thresholds"] == found()
    [along, _] = results["thresholds"]["standings"]
    confirmed = along["confirmed"]["mean"], along["confirmed_kinds"]["mean"], along["overall"]["count"]
    assert confirmed == (1, 1, 2 * SEEDS), "both thresholds, which are of one kind and close together"
    assert (along["component"]["count"], along["component"]["of"]) == (SEEDS, 2 * SEEDS), (
        "rain: the scenario's"
    )
    [duel] = results["thresholds"]["duels"]
    assert (duel["measure"], duel["u"], duel["differs"]) == ("confirmed", SEEDS * SEEDS, True)

    said("report", name, "--out", str(tmp_path))
    folder = tmp_path / f"turns-{name}"
    text = (folder / "report.md").read_text()
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings[:2] == ["## Thresholds", "## Boundary solutions, as the paper counts them"]
    assert "Compared on confirmed distinct thresholds." in text
    assert "![Distinct and confirmed thresholds by method](figures/thresholds.png)" in text
    assert (folder / "figures" / "thresholds.png").stat().st_size > 10_000

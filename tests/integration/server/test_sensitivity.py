"""Sensitivity at the command line: one archive scored otherwise, and searches with other settings."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from PIL import Image
from support.api import FakeWorker, ball, expect, submit
from support.databases import Databases
from typer.testing import CliRunner

from brink.cli.commands import app

MTQ: dict[str, Any] = {
    "name": "known", "problem": {"id": "mtq@1"}, "algorithm": {"id": "mlcshe@1", "params": {"archive_size": 3}},
    "budget": {"simulations": 120}, "seed": 7,
}  # fmt: skip


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_an_archive_is_scored_otherwise(client: httpx.Client, tmp_path: Path) -> None:
    campaign = submit(client, ball(simulations=80))
    assert FakeWorker(client).work(campaign)["status"] == "finished"
    picture = tmp_path / "sensitivity.png"
    command = ["sensitivity", "rescore", campaign, "--server", str(client.base_url), "--radius", "0.1,0.3"]
    said = CliRunner().invoke(app, [*command, "--p-th", "0.5", "--json", "--picture", str(picture)])
    assert said.exit_code == 0, said.output
    found = json.loads(said.output)
    assert [one["radius"] for one in found["by_radius"]] == [0.1, 0.2, 0.3], (
        "the campaign's own is there, too"
    )
    assert [one["p_th"] for one in found["by_p_th"]] == [0.1, 0.5]
    boundary = expect(client.get(f"/api/v1/campaigns/{campaign}/boundary"))
    own = found["by_radius"][1]
    assert (own["dbs"], own["strict_dbs"]) == (boundary["dbs"], boundary["strict_dbs"])
    assert found["by_p_th"][0] == own
    with Image.open(picture) as drawn:
        assert drawn.width == 1600
    people = CliRunner().invoke(app, command)
    assert "this campaign" in people.output


@pytest.mark.parametrize("databases", ["sqlite"], indirect=True)
def test_searches_with_other_settings_are_an_experiment(databases: Databases, tmp_path: Path) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(yaml.safe_dump(MTQ))
    out = tmp_path / "out"
    with databases.database() as url:
        command = ["sensitivity", "rerun", str(file), "--parameter", "population_size", "--values", "5,10"]
        said = CliRunner().invoke(
            app, [*command, "--seeds", "2", "--workers", "1", "--database", url, "--out", str(out)]
        )
        assert said.exit_code == 0, said.output
    written = yaml.safe_load((out / "known--population_size.yaml").read_text())
    assert [one["params"] for one in written["algorithms"]] == [
        {"archive_size": 3, "population_size": size} for size in (5, 10)
    ]
    assert written["seeds"] == [7, 8]
    [folder] = [path for path in out.iterdir() if path.is_dir()]
    found = json.loads((folder / "sensitivity.json").read_text())
    assert list(found) == ["5", "10"]
    assert all(len(one["dbs"]) == len(one["strict"]) == 2 for one in found.values())
    assert (folder / "report.html").stat().st_size > 10_000
    with Image.open(folder / "sensitivity.png") as drawn:
        assert drawn.width == 1600


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--parameter", "population_size", "--values", "5,many"], "population_size"),
        (["--parameter", "popluation_size", "--values", "5"], "popluation_size"),
        (["--parameter", "population_size", "--values", "5,5"], "more than once"),
        (["--parameter", "population_size", "--values", "5", "--t-b", "0.12"], "--t-b"),
    ],
)
def test_what_cannot_be_varied_is_pointed_at(tmp_path: Path, arguments: list[str], expected: str) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(yaml.safe_dump(MTQ))
    database = ["--database", f"sqlite:///{tmp_path / 'x.db'}", "--out", str(tmp_path / "out")]
    said = CliRunner().invoke(app, ["sensitivity", "rerun", str(file), *arguments, *database])
    assert said.exit_code != 0
    assert expected in str(said.exception)

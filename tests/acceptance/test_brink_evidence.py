"""`brink run` with repeats, `brink repeats`, `brink evidence`: does a boundary hold up, and can others use it?"""

import csv
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image
from support.databases import Databases
from support.processes import brink

# About four drives in ten are unsafe; with neighbourhoods that hold everything all of them lie on that boundary.
BODY: dict[str, Any] = {
    "name": "half",
    "problem": {"id": "urban-injected@1"},
    "algorithm": {"id": "random@1", "params": {"radius": 1.0, "p_th": 0.39, "z": 0.2}},
    "budget": {"simulations": 60},
    "seed": 3,
    "repeats": 2,
}


@pytest.mark.long("runs campaigns of real simulations")
def test_a_boundary_is_repeated_and_handed_on(databases: Databases, tmp_path: Path) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(yaml.safe_dump(BODY))
    with databases.database(migrated=False) as url:
        options = ["--database", url]
        ran = brink("run", str(file), *options, "--no-pictures", "--json", cwd=tmp_path)
        assert ran.returncode == 0, ran.stderr
        summary = json.loads(ran.stdout)
        campaign = summary["campaign"]
        repeats = summary["repeats"]
        assert repeats["status"] == "finished"
        assert {one["evaluated"] for one in repeats["solutions"]} == {2}

        wide = ["--t-b", "0.3", "--d-th", "0.45"]
        again = brink("repeats", campaign, *options, *wide, "--repeats", "3", "--json", cwd=tmp_path)
        assert again.returncode == 0, again.stderr
        view = json.loads(again.stdout)
        assert view["status"] == "finished"
        assert {one["evaluated"] for one in view["solutions"]} == {3}
        shown = brink("repeats", campaign, *options, *wide, "--repeats", "3", cwd=tmp_path)
        assert view["words"] in " ".join(shown.stdout.split())

        out = tmp_path / "evidence"
        written = brink(
            "evidence", campaign, *options, *wide, "--out", str(out), "--replays", "2", cwd=tmp_path
        )
        assert written.returncode == 0, written.stderr
    with (out / "boundary.csv").open(newline="") as text:
        rows = list(csv.DictReader(text))
    assert [int(row["number"]) for row in rows] == [one["number"] for one in view["solutions"]]
    assert len(rows) >= 2
    replayed = [row for row in rows if row["replay"]]
    assert len(replayed) == 2
    for row in replayed:
        with Image.open(out / row["replay"]) as drawn:
            assert min(drawn.size) > 300
        with (out / "episodes" / f"{row['number']}-boxes.csv").open(newline="") as text:
            boxes = list(csv.DictReader(text))
        for which in ("seen", "said"):
            assert sum(box["which"] == which for box in boxes) == int(row[f"component.{which}"])
        said = int(row["component.said"])
        assert int(row["component.matched"]) + int(row["component.invented"]) == said
    assert len((out / "boundary.jsonl").read_text().splitlines()) == len(rows)
    assert (out / "boundary.parquet").stat().st_size > 0
    readme = (out / "README.md").read_text()
    assert "## The unsafe region" in readme
    assert json.loads((out / "rules.json").read_text())

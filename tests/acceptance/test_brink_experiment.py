"""`brink experiment run`: killed in the middle, and continued to the same report with thresholds and follow-ups."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.api import ball
from support.databases import Databases
from support.processes import BRINK, TOY, Program, brink
from typer.testing import CliRunner

from brink.cli.commands import app

EXPERIMENT = {
    "name": "two methods",
    "problems": [{"name": "ball", "id": "ball@1", "params": {"slow_s": 0.02}}],
    "algorithms": [{"name": "GA", **ball()["algorithm"]}, {"name": "edge", "id": "edge@2"}],
    "seeds": [1],
    "budget": {"simulations": 90},
    "thresholds": {"confirm": 15},
}


def written(folder: Path) -> str:
    file = folder / "experiment.yaml"
    file.write_text(yaml.safe_dump(EXPERIMENT))
    return str(file)


def found(folder: Path) -> tuple[dict[str, Any], str]:
    """Return the results and the report of an experiment, without ids, moments and how long it took."""
    results = json.loads((folder / "results.json").read_text())
    ids = [results["id"], *(repeat["campaign"] for repeat in results["repeats"])]
    report = re.sub(r"(- Experiment `\w+`), submitted .*", r"\1", (folder / "report.md").read_text())
    names = {name: f"id {place}" for place, name in enumerate(ids)}
    anonymous = re.sub("|".join(names), lambda match: names[match[0]], f"{json.dumps(results)}\0{report}")
    written_results, _, report = anonymous.partition("\0")
    return {**json.loads(written_results), "created_at": ""}, report


@pytest.mark.long("runs an experiment twice")
def test_killed_experiment_resumes(databases: Databases, tmp_path: Path, small_problems: None) -> None:
    file = written(tmp_path)
    with databases.database() as url:
        command = ["experiment", "run", file, "--database", url, "--workers", "2"]
        with Program([BRINK, "-v", *command], cwd=tmp_path, env=TOY) as running:
            running.await_line(r"generation told .*generation=2\b")
            running.process.kill()
            running.wait()
        refused = brink(*command, cwd=tmp_path, env=TOY)
        assert refused.returncode == 1
        assert "continue it with --resume" in refused.stderr
        resumed = brink(*command, "--resume", "--json", cwd=tmp_path, env=TOY)
        assert resumed.returncode == 0, resumed.stderr
        assert re.search(r"continuing at [\d,]+ of 180 simulations", resumed.stderr)
        assert "no earlier" not in resumed.stderr
        name = json.loads(resumed.stdout)["id"]
        assert f", then open http://127.0.0.1:8700/#/experiments/{name}\n" in resumed.stderr
        folder = tmp_path / "brink-results" / f"two-methods-{name}"
        # Of either measure, a curve over the budget for each of three distances, and one over the distances; and
        # the thresholds of both methods.
        pictures = len(list(folder.glob("figures/*.png")))
        assert (folder / "report.html").read_text().count("data:image/png;base64,") == pictures == 9
        results, report = found(folder)
    assert results["scored"] == 2
    thresholds = {one["method"]: one for one in results["thresholds"]["standings"]}
    assert thresholds["edge"]["distinct"]["mean"] >= 1
    assert thresholds["edge"]["confirmed"]["mean"] >= 1, "the ends were simulated again, with other seeds"
    assert thresholds["GA"]["confirmed"]["mean"] == 0, "a method without thresholds has none to confirm"
    assert "**GA** and **edge**" in report
    with databases.database("undisturbed") as url:
        whole = brink(
            "experiment", "run", file, "--database", url, "--workers", "1", "--json", cwd=tmp_path, env=TOY
        )
        assert whole.returncode == 0, whole.stderr
        other = tmp_path / "brink-results" / f"two-methods-{json.loads(whole.stdout)['id']}"
    assert found(other) == (results, report)


def test_a_file_without_an_experiment_creates_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("BRINK_DATABASE", raising=False)
    file = tmp_path / "wrong.yaml"
    file.write_text(
        yaml.safe_dump({**EXPERIMENT, "problems": [{"id": "mtq@1"}], "algorithms": [{"id": "gaa@1"}]})
    )
    said = CliRunner().invoke(app, ["experiment", "run", str(file)])
    assert said.exit_code == 1
    assert "wrong.yaml: line 2: algorithms[0].id: unknown" in str(said.exception)
    assert "did you mean 'ga@1'" in str(said.exception)
    assert not list(tmp_path.glob("*.db"))

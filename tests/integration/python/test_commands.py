"""Campaigns that run programs, with real workers."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

import brink
from brink.cli import experiment_run
from brink.cli.local import RunOptions
from brink.server.campaigns.body import read_campaign_file
from brink.server.campaigns.plan import make_checked_plan
from brink.server.experiments.body import read_experiment_file
from brink.server.problems.command import Command
from brink.sim.errors import DefinitionError
from brink.sim.programs.installed import COMMANDS_VARIABLE, OWN_FOLDER

EXAMPLES = Path(__file__).parents[3] / "examples" / "command"


def run(folder: Path, name: str, simulations: int, **changed: Any) -> brink.Result:
    """Run an example in a copy of its folder, at random."""
    path = folder / "files"
    shutil.copytree(EXAMPLES, path, dirs_exist_ok=True)
    if name == "platoon":
        source, program = path / "platoon.cpp", path / "platoon"
        subprocess.run(["c++", "-O1", "-std=c++17", "-o", program, source], check=True, timeout=300)
    document = yaml.safe_load((path / f"{name}.yaml").read_text())
    document |= {"algorithm": {"id": "random@1"}, "budget": {"simulations": simulations}}
    (path / "campaign.yaml").write_text(yaml.safe_dump(document))
    return brink.run(path / "campaign.yaml", progress=False, **changed)


def test_a_program_is_searched_with_a_campaign_file_whatever_the_number_of_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = (
        run(tmp_path, "cut-in", 24, workers=workers, database=f"{workers}.db") for workers in (1, 2)
    )
    assert (first.evaluated, first.failed) == (24, 0)
    assert 0 < first.unsafe < 24
    assert first.digest == second.digest


@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler")
def test_a_program_in_another_language_takes_the_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = run(tmp_path, "platoon", 16)
    assert (result.evaluated, result.failed) == (16, 0)
    before = read_campaign_file(tmp_path / "files" / "campaign.yaml").document_hash()
    with (tmp_path / "files" / "platoon").open("ab") as program:
        program.write(b"rebuilt")
    assert read_campaign_file(tmp_path / "files" / "campaign.yaml").document_hash() != before


def test_a_program_that_gives_other_results_for_the_same_seed_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    script = "import os\nopen('log.csv', 'w').write(f'time,x\\n0,{os.urandom(4)[0] - 128.5}\\n')"
    (tmp_path / "run.py").write_text(script)
    params = {
        "command": ["python3", "run.py", "{x}"],
        "copies": ["run.py"],
        "space": {"scenario": {"x": {"min": 0, "max": 1}}},
        "signals": {"file": "log.csv"},
        "requirements": {"positive": {"signal": "x", "above": 0}},
    }
    campaign = brink.Campaign(problem="command@1", algorithm="random@1", simulations=8, problem_params=params)
    assert "python3 is not deterministic" in brink.run(campaign, progress=False).finding


def test_where_no_program_may_run_that_is_said_instead_of_waiting_for_a_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(COMMANDS_VARIABLE, "")
    with pytest.raises(DefinitionError, match="BRINK_COMMANDS is empty; unset it, or name a folder"):
        run(tmp_path, "cut-in", 24)


def test_an_experiment_allows_the_workers_of_this_machine_to_run_its_programs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(experiment_run, "run_to_end", lambda *given: None)  # reports take much longer
    shutil.copytree(EXAMPLES, tmp_path, dirs_exist_ok=True)
    study = {
        "name": "study",
        "problems": [yaml.safe_load(Path("cut-in.yaml").read_text())["problem"]],
        "algorithms": [{"id": "random@1"}],
        "seeds": [1],
        "budget": {"simulations": 12},
    }
    file = Path("study.yaml")
    file.write_text(yaml.safe_dump(study))
    body = read_experiment_file(file)
    options = RunOptions(
        file=file, workers=1, out=tmp_path, resume=False, new=False, json=False, database=None, port=None
    )
    assert experiment_run.run_experiment(body, options) is None
    problem = make_checked_plan(body.cells()[0].body).problem
    assert isinstance(problem, Command)
    assert (OWN_FOLDER / f"{problem.needs.removesuffix('@1')}.json").is_file()

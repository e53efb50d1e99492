"""What `brink run` suggests next works, and it writes no file that says nothing."""

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search import surrogate

pytestmark = pytest.mark.long("runs campaigns")

TRAFFIC = {
    "name": "n",
    "problem": {"id": "npc-actions@1", "params": {"participants": 2}},
    "algorithm": {"id": "nsga2@1", "params": {"population_size": 20}},
    "budget": {"simulations": 20},
    "seed": 1,
}


@pytest.fixture
def database(sqlite_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(surrogate, "TREES", 6)
    return f"sqlite:///{shutil.copyfile(sqlite_file, tmp_path / 'runs.db')}"


def run(database: str, body: dict[str, Any], *options: str) -> str:
    file = Path("n.json")
    file.write_text(json.dumps(body))
    ran = CliRunner().invoke(app, ["run", str(file), "--database", database, "--workers", "1", *options])
    assert ran.exit_code == 0, ran.output
    return ran.stdout


def suggested(shown: str) -> list[str]:
    """Return the commands that a run suggests, without the program's name."""
    _, _, after = shown.partition("\nnext:\n")
    lines = after.partition("\n\n")[0].splitlines()
    return [
        re.split(r" {2,}", line.strip())[0].removeprefix("brink ")
        for line in lines
        if " brink " in f" {line}"
    ]


@pytest.mark.parametrize(
    ("algorithm", "simulations", "expected"),
    [
        ({"id": "edge@1", "params": {"eps": 0.01}}, 120, []),
        ({"id": "edge@1"}, 60, ["pairs"]),
        ({"id": "random@1"}, 100, ["results"]),
        ({"id": "mlcshe@1"}, 120, ["results"]),
    ],
    ids=["pairs", "no pair", "random", "boundary"],
)
def test_every_suggestion_works(
    database: str, algorithm: dict[str, Any], simulations: int, expected: list[str]
) -> None:
    budget = {"simulations": simulations}
    body = {"name": "n", "problem": {"id": "mtq@1"}, "algorithm": algorithm, "budget": budget, "seed": 1}
    commands = suggested(run(database, body))
    assert {command.split()[0] for command in commands} >= set(expected)
    for command in commands:
        assert not re.match("replay|evidence|repeats", command), "nothing was simulated"
        assert "--film" not in command
        followed = CliRunner().invoke(app, shlex.split(command))
        assert followed.exit_code == 0, (command, followed.output)


def test_a_search_for_violations_writes_no_empty_boundary(database: str) -> None:
    shown = run(database, TRAFFIC, "--no-pictures")
    [folder] = Path("brink-results").glob("n-*")
    names = {path.name for path in folder.iterdir()}
    assert {"violations.csv", "violations.json", "archive.npz"} <= names
    assert not [name for name in (*names, *shown.split()) if name.startswith("boundary.")]
    commands = suggested(shown)
    assert "violations" in {command.split()[0] for command in commands}
    for command in commands:
        if not command.startswith("replay"):
            followed = CliRunner().invoke(app, shlex.split(command))
            assert followed.exit_code == 0, (command, followed.output)

"""The check of driving systems catches those that are not the same again, and says what is wrong with the others."""

import json
import os
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.sim.programs.installed import COMMANDS_VARIABLE
from brink.sim.testing import ContractBroken
from brink.worker.driving_check import check_driving_system, drive_streets

EXAMPLES = Path(__file__).resolve().parents[3] / "examples" / "driving"
BROKEN = """
import os, random
from brink.sim.driving_systems import Decision

class Own:
    needs = "boxes"
    def __init__(self, start): pass
    def step(self, observation): return Decision()

class Remembers(Own):
    drives = 0
    def __init__(self, start): Remembers.drives += 1
    def step(self, observation):
        return Decision(accel_mps2=-1.0) if self.drives > 3 else Decision()

class Gambles(Own):
    def step(self, observation): return Decision(accel_mps2=random.random())

class Differs(Own):
    def step(self, observation): return Decision(accel_mps2=os.getpid() / 1e6)

class Answers(Own):
    def step(self, observation): return (0.0, 0.1)

class Hangs(Own):
    def step(self, observation):
        while observation.time_s > 0.5: pass
        return Decision()

class Mirrored(Own):
    def step(self, observation): return Decision(accel_mps2=0.5, steer_rad=0.1)

class Stands(Own):
    def step(self, observation): return Decision(accel_mps2=-1)
"""


@pytest.fixture(name="broken")
def _broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    file = tmp_path / "broken_systems.py"
    file.write_text(BROKEN)
    paths = [str(tmp_path), str(EXAMPLES), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    return file


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        (
            "Remembers",
            "driven again after other streets, 2 of 2 drives are not the same: in street 1, the ego moves",
        ),
        (
            "Gambles",
            "driven again at once, 1 of 1 drives are not the same: in street 2, the ego moves otherwise",
        ),
        ("Differs", "^driven in another process, 1 of 1 drives are not the same: in street 2, the ego moves"),
    ],
)
def test_system_whose_drives_are_not_the_same_again_is_caught(broken: Path, name: str, fault: str) -> None:
    with pytest.raises(ContractBroken, match=fault):
        check_driving_system(f"broken_systems:{name}", plugins=["broken_systems"], streets=2)


def test_wrong_decisions_and_hangs_are_told_in_words(broken: Path) -> None:
    wrong = drive_streets("broken_systems:Answers", plugins=["broken_systems"], streets=2)
    (fault,) = wrong.faults
    assert fault == (
        "driving system broken_systems:Answers, step 0 (0.00 s): expected a brink.sim.driving_systems.Decision, got "
        "(0.0, 0.1)"
    )
    assert [one.failed for one in wrong.drives] == [fault, fault]
    hangs = drive_streets("broken_systems:Hangs", plugins=["broken_systems"], timeout_s=2.0)
    (fault,) = hangs.faults
    assert fault.startswith("no verdict after 2 s of wall-clock time; killed")
    assert "broken_systems.py" in fault
    assert len(hangs.drives) == 1


def test_how_it_drives_badly_is_told_without_a_fault(broken: Path) -> None:
    mirrored = drive_streets("broken_systems:Mirrored", plugins=["broken_systems"], streets=1)
    assert mirrored.faults == []
    assert any(one.startswith("in 1 of 1 streets it leaves its lane, after") for one in mirrored.remarks)
    stands = drive_streets("broken_systems:Stands", plugins=["broken_systems"], streets=1)
    assert stands.remarks == ["in 1 of 1 streets it stands for more than 12 s of 20 s"]


def test_module_that_fails_when_it_is_imported_is_a_fault(broken: Path) -> None:
    broken.write_text("from brink.sim.driving_systems import Decisions")
    (fault,) = drive_streets("broken_systems:Own", plugins=["broken_systems"], streets=1).faults
    assert "plug-in module 'broken_systems'" in fault
    assert "cannot import name 'Decisions'" in fault


def test_idm_keeps_the_contract_on_the_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.environ.get("PYTHONPATH", ""))
    monkeypatch.setattr("brink.cli.driving.STREETS", 2)
    said = CliRunner().invoke(app, ["driving", "check", str(EXAMPLES / "idm.py"), "--json"])
    assert said.exit_code == 0, said.output
    found = json.loads(said.output)
    assert found["faults"] == []
    assert [one["violated_s"] for one in found["drives"]] == [{}, {}]


def test_program_of_its_own_is_checked_by_its_definition(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(COMMANDS_VARIABLE, str(tmp_path))
    monkeypatch.setattr("brink.cli.driving.STREETS", 2)
    said = CliRunner().invoke(app, ["driving", "check", str(EXAMPLES / "aeb_process.yaml")])
    assert said.exit_code == 0, said.output
    assert re.search(r"command:aeb_process@[0-9a-f]{16} keeps its contract in these streets", said.output)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("missing.yaml", "missing.yaml: cannot be read as YAML"),
        ("nobody@1", "expected a Python or YAML file, or one of modular@1"),
        ("missing.py", "missing.py: no such file"),
        (
            "{broken}",
            "has Own, Remembers, Gambles, Differs, Answers, Hangs, Mirrored, Stands: name the class",
        ),
        ("{empty}", "has no class with a method step"),
        ("{text}", "not a Python file"),
    ],
)
def test_file_without_one_driving_system_is_refused(broken: Path, given: str, message: str) -> None:
    (broken.parent / "empty.py").write_text("")
    (broken.parent / "text.py").write_text("This is no Python.")
    named = {name: str(broken.parent / f"{name}.py") for name in ("empty", "text")}
    said = CliRunner().invoke(app, ["driving", "check", given.format(broken=broken, **named)])
    assert said.exit_code != 0
    assert message in str(said.exception)

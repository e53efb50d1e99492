"""`brink try`: one episode of a command, or of an FMU."""

import re
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml
from support import fmus
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.errors import InvalidInput
from brink.sim.programs.installed import COMMANDS_VARIABLE

FILE = Path(__file__).parents[3] / "examples" / "command" / "cut-in.yaml"


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def tried(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["try", *arguments])
    raised = done.exception if isinstance(done.exception, InvalidInput) else ""
    return done.exit_code, " ".join(f"{done.output}{raised}".split())


def test_an_episode_shows_its_command_folder_signals_and_verdicts(in_folder: Path) -> None:
    status, text = tried(str(FILE), "--set", "delay=1.8", "--set", "scenario.gap=15", "--set", "road=wet")
    assert status == 0
    assert "cut_in.py 1.8" in text
    assert re.search("program: [0-9a-f]{64} ", text)
    assert "ego_speed=22.5, gap=15, road=wet, delay=1.8" in text
    assert "keep-gap: violated at 1.82 s, robustness -1.149 m" in text
    assert "gave the same signals" in text
    assert (in_folder / "brink-try" / "log.csv").is_file()
    assert (in_folder / "brink-try.png").stat().st_size > 10_000
    assert "keep-gap: held" in tried(str(FILE), "--set", "delay=0")[1]


def test_a_failure_is_shown_with_what_the_program_printed(in_folder: Path) -> None:
    broken = FILE.read_text().replace("settings.json: settings.json", "other.json: settings.json")
    for name in ("cut_in.py", "settings.json"):
        (in_folder / name).write_text((FILE.parent / name).read_text())
    (in_folder / "broken.yaml").write_text(broken)
    status, text = tried("broken.yaml")
    assert status == 1
    assert "exited with status 1" in text
    assert "No such file or directory: 'settings.json'" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--set", "delays=1"), "no parameter is called 'delays'"),
        (("--set", "delay=9"), "delay: expected a number in"),
        (("--set", "road=ice"), "ice"),
        (("--folder", "."), "has files that brink try did not write"),
    ],
)
def test_wrong_arguments_are_refused(in_folder: Path, arguments: tuple[str, ...], words: str) -> None:
    (in_folder / "mine.txt").touch()
    assert words in tried(str(FILE), *arguments)[1]
    assert (in_folder / "mine.txt").exists()


@pytest.mark.long("starts simulation processes")
@pytest.mark.skipif(find_spec("fmpy") is None or not fmus.can_build(), reason="no FMPy, or no C compiler")
def test_an_fmu_is_tried_in_a_process_of_its_own(in_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(COMMANDS_VARIABLE, "")
    fmus.build(in_folder, 3)
    params = {
        "fmu": "model3.fmu",
        "space": {"scenario": {"rate": {}, "fault": {}}},
        "requirements": {"high": {"signal": "y", "above": -1.5, "unit": "m"}},
    }
    campaign = {
        "name": "fmu",
        "problem": {"id": "fmu@1", "params": params},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": 8},
    }
    (in_folder / "fmu.yaml").write_text(yaml.safe_dump(campaign))
    status, text = tried("fmu.yaml", "--set", "rate=-2", "--set", "fault=0")
    assert status == 0
    assert "11 samples from 0 to 1 s" in text
    assert "high: violated at 0.80 s, robustness -0.5 m" in text
    assert "gave the same signals" in text
    assert (in_folder / "brink-try.png").stat().st_size > 10_000
    status, text = tried("fmu.yaml", "--set", "fault=2")
    assert (status, "SIGABRT" in text) == (1, True)

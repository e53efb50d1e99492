"""The table of the README: each command, as printed, in a fresh folder with nothing but the examples."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROW = re.compile(
    r"^\| ([^|]+) \| [^|]+ \| `\.venv/bin/brink ([^`]+)` \| \[[^]]+\]\([^)]+\) \|$", re.MULTILINE
)
SAYS = {
    "a detector's file": r"[01] of 1 drives? held the front gap and had no collision",
    "a recording": r"Read 6 drives, 906 images, 3,704 true boxes, 4,086 detections",
    "a planner": r"idm:Idm keeps its contract in these streets",
    "a simulator": r"4 thresholds of 3 kinds",
    "scenario files": r"ego_speed +15 to 35",
    "last release's hazards": r"6 drives: 3 still unsafe, 3 still safe",
    "a safety case": r"% \[.+\] of simulated drives violated the front gap or had a collision",
}
"""What each command prints, by what one has."""
README = (ROOT / "README.md").read_text(encoding="utf-8")
ROWS = dict(ROW.findall(README))


def test_the_table_has_a_row_for_each_kind_of_user() -> None:
    assert list(ROWS) == list(SAYS)


@pytest.mark.long("runs campaigns")
@pytest.mark.parametrize("have", SAYS)
def test_the_command_of_a_row_works_on_a_fresh_clone(have: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples", ignore=shutil.ignore_patterns("__pycache__"))
    brink = [sys.executable, "-c", "from brink.cli.main import main; main()"]
    run = subprocess.run(
        [*brink, *shlex.split(ROWS[have])],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert re.search(SAYS[have], run.stdout), run.stdout

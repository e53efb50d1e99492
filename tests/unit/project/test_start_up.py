"""Commands that only talk to a server start fast: they do not load what they do not need."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.marks import mostly_long

HEAVY = {"numpy", "scipy", "sqlalchemy", "fastapi", "uvicorn", "matplotlib", "PIL", "pandas"}
CLOSED = "http://127.0.0.1:9"
"""No coordinator listens on the discard port."""
RUN_AND_LIST = """
import sys
from brink.cli.main import main
sys.argv = ["brink", *sys.argv[1:]]
try:
    main()
except SystemExit as end:
    print("exit", end.code)
print("loaded", *sys.modules)
"""

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "quickstart.yaml"
SUBMITTED = (["submit", str(EXAMPLE), "--server", CLOSED], 1)


@pytest.mark.parametrize(
    ("arguments", "status"),
    mostly_long(
        [
            (["--version"], 0),
            (["--help"], 0),
            (["worker", "--help"], 0),
            (["status", "--server", CLOSED], 1),
            (["status", "3f2a", "--server", CLOSED], 1),
            (["results", "3f2a", "--server", CLOSED], 1),
            (["pause", "3f2a", "--server", CLOSED], 1),
            (["experiment", "status", "3f2a", "--server", CLOSED], 1),
            SUBMITTED,
        ],
        [(["experiment", "status", "3f2a", "--server", CLOSED], 1), SUBMITTED],
        "starts many processes",
    ),
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_a_client_command_loads_neither_the_search_nor_the_server(arguments: list[str], status: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", RUN_AND_LIST, *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={name: value for name, value in os.environ.items() if not name.startswith("BRINK_")},
    )
    assert f"exit {status}" in done.stdout, done.stderr
    loaded = set(done.stdout.split("loaded ")[-1].split())
    assert HEAVY & loaded == set()

"""Commands start fast: `--help`, and those that only talk to a server, do not load what they do not need."""

import json
import os
import subprocess
import sys
from pathlib import Path

CLOSED = "http://127.0.0.1:9"
"""No coordinator listens on the discard port."""
LOAD = """
import contextlib, io, json, sys
from brink.cli.commands import SECTIONS, load
from brink.cli.main import main

HEAVY = {"numpy", "scipy", "pandas", "matplotlib", "PIL", "jinja2", "sqlalchemy", "alembic", "fastapi", "uvicorn"}

def called(*arguments):
    sys.argv = ["brink", *arguments]
    before = HEAVY & sys.modules.keys()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        main()
    print(json.dumps([" ".join(arguments), sorted(HEAVY & sys.modules.keys() - before)]))

"""
HELP = """
called("--version")
called("--help")
for section in SECTIONS.values():
    for name, (target, _) in section.items():
        called(name, "--help")
        for below in getattr(load(name, target), "commands", ()):
            called(name, below, "--help")
"""
TALK = """
for line in sys.stdin.read().splitlines():
    called(*line.split(), "--server", SERVER)
"""
EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "quickstart.yaml"
TALKING = [
    "status",
    "status 3f2a",
    "results 3f2a",
    "findings 3f2a",
    "thresholds 3f2a",
    "pairs 3f2a",
    "rate 3f2a",
    "tolerance 3f2a",
    "violations 3f2a",
    "combinations 3f2a",
    "repeats 3f2a",
    "tag 3f2a night",
    "note 3f2a night",
    "pause 3f2a",
    "resume 3f2a",
    "cancel 3f2a",
    "retry 3f2a",
    "delete 3f2a --yes",
    "experiment list",
    "experiment status 3f2a",
    f"submit {EXAMPLE}",
]


def loaded(program: str, given: str = "") -> dict[str, list[str]]:
    """Return the heavy libraries that each command was the first to load, in one process."""
    done = subprocess.run(
        [sys.executable, "-c", LOAD + program],
        input=given,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={name: value for name, value in os.environ.items() if not name.startswith("BRINK_")},
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(line) for line in done.stdout.splitlines())


def test_help_loads_neither_numerical_libraries_nor_the_server() -> None:
    found = loaded(HELP)
    assert len(found) > 60
    assert {command: heavy for command, heavy in found.items() if heavy} == {}


def test_a_client_command_loads_neither_numerical_libraries_nor_the_server() -> None:
    found = loaded(f"SERVER = {CLOSED!r}\n{TALK}", "\n".join(TALKING))
    assert len(found) == len(TALKING)
    assert {command: heavy for command, heavy in found.items() if heavy} == {}

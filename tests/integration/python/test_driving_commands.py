"""Campaigns whose driving system is a program: from a file alone, by any number of workers, through kills."""

import contextlib
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest
from support.running import assert_gone, parent_of, running

import brink
from brink.server.errors import InvalidInput
from brink.sim.programs.installed import COMMANDS_VARIABLE

CHILD = Path(__file__).resolve().parents[2] / "support" / "driving_child.py"
CAMPAIGN = {
    "name": "planner",
    "problem": {"id": "urban-errors@1", "params": {"driving": "command:planner.yaml", "duration_s": 5.0}},
    "algorithm": {"id": "random@1", "params": {"generation_size": 6}},
    "budget": {"simulations": 12},
    "seed": 3,
}


@pytest.fixture
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(COMMANDS_VARIABLE, raising=False)
    Path("campaign.yaml").write_text(json.dumps(CAMPAIGN))


def kill(mark: str, generations: int, stopped: threading.Event) -> None:
    """Kill the first process with a mark that is found, or an ancestor of it."""
    while not stopped.is_set():
        with contextlib.suppress(OSError):
            for pid in running(mark):
                for _ in range(generations):
                    pid = parent_of(pid)
                os.kill(pid, signal.SIGKILL)
                return
        time.sleep(0.01)


@pytest.mark.usefixtures("_here")
def test_a_program_drives_from_the_campaign_file_alone_through_kills(tmp_path: Path) -> None:
    mark = str(tmp_path / "mark")
    Path("planner.yaml").write_text(json.dumps({"command": [sys.executable, str(CHILD), "", mark]}))
    calm = brink.run("campaign.yaml", workers=1, database="calm.db", progress=False)
    assert (calm.evaluated, calm.failed) == (12, 0)
    stopped = threading.Event()
    # The program, and the worker, which is three generations above: supervisor, simulation process, worker.
    killers = [threading.Thread(target=kill, args=(mark, ancestors, stopped)) for ancestors in (0, 3)]
    for killer in killers:
        killer.start()
    try:
        killed = brink.run("campaign.yaml", workers=2, database="killed.db", progress=False)
        assert not any(killer.is_alive() for killer in killers)
    finally:
        stopped.set()
    assert (killed.evaluated, killed.failed) == (12, 0)
    assert killed.digest == calm.digest
    assert_gone(mark)


@pytest.mark.usefixtures("_here")
@pytest.mark.parametrize(
    ("definition", "message"),
    [
        (None, "planner.yaml: cannot be read as YAML: .*No such file"),
        ({"command": ["./missing"]}, "missing: no program that can be executed, relative to its folder"),
        ({"command": ["./campaign.yaml"]}, "campaign.yaml: no program that can be executed"),
    ],
)
def test_a_program_that_cannot_run_here_is_an_error_at_submission(
    definition: dict[str, list[str]] | None, message: str
) -> None:
    if definition is not None:
        Path("planner.yaml").write_text(json.dumps(definition))
    with pytest.raises(InvalidInput, match=f"problem.params.driving: .*{message}"):
        brink.run("campaign.yaml", progress=False)

"""Campaigns whose driving system is a program: from a file alone, by any number of workers, through kills."""

import contextlib
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from support.running import assert_gone, parent_of, running

import brink
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import make_plan
from brink.server.errors import InvalidInput
from brink.server.suites.campaigns import prepare_runs
from brink.server.suites.file import Drive, Entry, SuiteFile, System
from brink.sim.driving_systems.command import is_id
from brink.sim.programs.installed import COMMANDS_VARIABLE

CHILD = Path(__file__).resolve().parents[2] / "support" / "driving_child.py"
CAMPAIGN = {
    "name": "planner",
    "problem": {"id": "urban-errors@1", "params": {"driving": "command:planner.yaml", "duration_s": 5.0}},
    "algorithm": {"id": "random@1", "params": {"generation_size": 6}},
    "budget": {"simulations": 12},
    "seed": 3,
}

OWN = {**CAMPAIGN, "problem": {"id": "urban-errors@1", "params": {"duration_s": 5.0}}}


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


@pytest.mark.usefixtures("_here")
def test_a_suite_names_a_program_by_its_file() -> None:
    space = make_plan(CampaignBody.model_validate(OWN)).problem.space
    decoded = space.decode(space.sample(np.random.default_rng(3)))
    values = {f"{part}.{name}": value for part, given in decoded.items() for name, value in given.items()}
    system = System(problem="urban-errors@1", params={"duration_s": 5.0}, simulator="brink-drive-errors@2")
    drive = Drive(expect="safe", found="2026-11-29", values=values)
    entry = Entry(name="one", system="urban-errors", seed=1, safe=drive)
    suite = SuiteFile(suite=1, systems={"urban-errors": system}, entries=[entry])
    changes = {"driving": "command:planner.yaml"}
    with pytest.raises(InvalidInput, match=r"--set driving: .*planner.yaml: cannot be read"):
        prepare_runs(suite, changes, name="suite")
    Path("planner.yaml").write_text(json.dumps({"command": [sys.executable, str(CHILD), "", "mark"]}))
    (run,) = prepare_runs(suite, changes, name="suite")
    assert run.refused == ()
    assert run.body is not None
    assert is_id(run.body.problem.params["driving"])

"""The commands in deploy/ci are run, on a suite whose drives are computed."""

import subprocess
from pathlib import Path
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from support.processes import BRINK, PATIENCE_S, ROOT, environment

from brink.search.algorithm import Scored
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan
from brink.server.problems.base import InProcessProblem
from brink.server.suites.campaigns import system_of
from brink.server.suites.file import Drive, Entry, NewEntry, write_suite

CI = ROOT / "deploy" / "ci"
MTQ = {
    "name": "mtq",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 1},
}


def scripts(document: Any) -> list[str]:
    """Return the shell commands in a CI file of GitHub or GitLab that call brink."""
    if "jobs" in document:
        found = [step.get("run", "") for step in document["jobs"]["suite"]["steps"]]
    else:
        found = document["hazards"]["script"]
    return [script for script in found if script.startswith("brink ")]


def write_hazard(folder: Path, *, expect: str) -> None:
    """Write a suite of one unsafe drive."""
    plan = make_plan(parse_body(MTQ))
    problem = plan.problem
    assert isinstance(problem, InProcessProblem)
    steps = np.linspace(0.0, 1.0, 21)
    rows = (
        problem.space.encode({"x": {"x": x}, "y": {"y": y}}) for x in steps.tolist() for y in steps.tolist()
    )
    unsafe = next(row for row in rows if cast(Scored, problem.evaluate(row)).unsafe)
    values = {"x.x": float(unsafe[0][0]), "y.y": float(unsafe[1][0])}
    entry = Entry(
        name="hazard", system="mtq", seed=1, unsafe=Drive.model_validate({"expect": expect, "values": values})
    )
    write_suite(folder / "hazards.yaml", {"mtq": system_of(plan)}, [NewEntry(entry=entry, units={})])


@pytest.mark.long("starts a coordinator and workers")
@pytest.mark.parametrize(("name", "expect", "code"), [("github.yml", "safe", 1), ("gitlab.yml", "unsafe", 0)])
def test_the_command_runs_and_fails_the_build_if_a_drive_is_broken(
    tmp_path: Path, name: str, expect: str, code: int
) -> None:
    (script,) = scripts(yaml.safe_load((CI / name).read_text()))
    write_hazard(tmp_path, expect=expect)
    ended = subprocess.run(
        ["sh", "-e", "-c", script.replace("brink ", f"{BRINK} ", 1)],
        cwd=tmp_path,
        env=environment({"GITHUB_SHA": "abc", "CI_COMMIT_SHORT_SHA": "abc"}),
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
        check=False,
    )
    assert ended.returncode == code, ended.stderr
    (case,) = ElementTree.parse(tmp_path / "hazards.xml").getroot().iter("testcase")
    assert (case.find("failure") is not None) == bool(code)
    assert (tmp_path / "hazards.md").read_text().startswith("### hazards: ")

"""SUMO's command line: the verdicts of the example of `command@1` are those of `sumo@1` on the same files.

The program is a stand-in with the same options, on top of libsumo: SUMO's programs are not installed with the tests.
"""

import os
import sys
from pathlib import Path

import pytest

from brink.server.campaigns.body import read_campaign_file
from brink.server.campaigns.plan import make_checked_plan
from brink.server.problems.command import Command
from brink.sim.adapters.command.simulator import CommandSimulator
from brink.sim.adapters.sumo.own_files import OwnFiles
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeSpec, Verdict
from brink.sim.perception_errors import MODE

pytestmark = pytest.mark.long("needs SUMO")

FILE = Path(__file__).parents[4] / "examples" / "command" / "sumo" / "braking.yaml"
PROGRAM = f"""#!{sys.executable}
import sys, libsumo
if sys.argv[1:] == ["--version"]:
    sys.exit(0)
libsumo.start(["sumo", *sys.argv[1:]])
while libsumo.simulation.getTime() < libsumo.simulation.getEndTime():
    libsumo.simulationStep()
libsumo.close()
"""


@pytest.fixture
def problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    program = tmp_path / "bin" / "sumo"
    program.parent.mkdir()
    program.write_text(PROGRAM)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    problem = make_checked_plan(read_campaign_file(FILE)).problem
    assert isinstance(problem, Command)
    return problem


def as_library(folder: Path, seed: int) -> Verdict:
    """Return the verdict of `sumo@1` on the network and the demand that the command read."""
    files = OwnFiles.read(str(folder / "road.net.xml"), str(folder / "traffic.rou.xml"), "ego")
    spec = EpisodeSpec(
        simulator="sumo@1",
        scenario={
            "files": files.to_json(),
            "demand": 1.0,
            "automated": 0.0,
            "surface": "dry",
            "incident": "none",
        },
        behaviour={"mode": MODE, "error": None},
        requirements=("front-gap@1",),
        seed=seed,
        duration_s=60.0,
        options={"headway_s": 1.0},
    )
    return make_simulator("sumo@1").run(spec).verdicts["front-gap@1"]


def test_the_verdicts_are_those_of_sumo_as_a_library(problem: Command, tmp_path: Path) -> None:
    simulator = CommandSimulator(problem.definition, problem.params.program)
    drives = ((17.8, 1.73, 3.98, 1.7, 0.712), (30.13, 2.92, 1.95, 2.0, -0.1), (23.74, 0.86, 3.76, 2.2, -1.5))
    for seed, (*scenario, look_s, robustness_m) in enumerate(drives):
        values = dict(zip(("speed", "headway", "braking"), scenario, strict=True))
        candidate = problem.space.encode({"scenario": values, "behaviour": {"look": look_s}})
        folder = tmp_path / str(seed)
        folder.mkdir()
        verdict = simulator.attempt(problem.episode(candidate, seed), folder).verdicts["keep-gap"]
        assert verdict.robustness == pytest.approx(robustness_m, abs=0.2)
        assert as_library(folder, seed).robustness == pytest.approx(verdict.robustness, abs=1e-5)

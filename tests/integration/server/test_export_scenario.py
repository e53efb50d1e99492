"""`brink export scenario` through a coordinator: real drives, written as scenarios."""

import json
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.api import FakeWorker, ball, coordinator, expect, finish, submit
from support.drives import simulate
from support.logical_scenarios import CASES, deterministic, steps
from support.problems import small_problems
from support.standards import ScenarioReader, schema_errors
from typer.testing import CliRunner, Result

from brink.cli.commands import app
from brink.extras import install_command
from brink.scenarios.exportable import NotExportable
from brink.scenarios.logical.declarations import declarations_of
from brink.scenarios.logical.document import parse_document, read_document
from brink.scenarios.logical.space import logical_scenario
from brink.scenarios.logical.template import template_of
from brink.server.errors import InvalidInput
from brink.sim.adapters.command.definition import Definition
from brink.sim.episode import EpisodeSpec
from brink.sim.trace import Trace
from brink.sim.urban.simulator import BrinkDrive
from brink.worker.wire import Completed, LeasedJob, WireVerdict

pytestmark = pytest.mark.long("simulates drives; the conversion has unit tests")

CAMPAIGN: dict[str, Any] = {
    "name": "drives",
    "problem": {"id": "urban-injected@1", "params": {"requirement": "front-gap@1"}},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 6},
    "seed": 4,
}
SOLUTION = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """A campaign of real drives that has ended.

    Attributes:
        database: Where it is stored.
        campaign: Its id.
        solution: The solution to export, from the API.
    """

    database: str
    campaign: str
    solution: dict[str, Any]


@pytest.fixture(scope="module")
def driven(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Driven:
    url = copied(sqlite_file, tmp_path_factory.mktemp("driven"))
    with coordinator(url) as client:
        campaign = submit(client, CAMPAIGN)
        worker = FakeWorker(client, capabilities=("brink-drive@3",), judge=simulate)
        assert worker.work(campaign)["status"] == "finished"
        solution = expect(client.get(f"/api/v1/campaigns/{campaign}/solutions/{SOLUTION}"))
    return Driven(database=url, campaign=campaign, solution=solution)


def copied(sqlite_file: Path, folder: Path) -> str:
    """Return the URL of a new database."""
    return f"sqlite:///{shutil.copyfile(sqlite_file, folder / 'drives.db')}"


def export(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["export", *arguments], catch_exceptions=False)


def test_a_stored_drive_is_exported_as_it_was(driven: Driven, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "scenario"
    told = export(
        "scenario",
        driven.campaign[:6],
        str(SOLUTION),
        "--database",
        driven.database,
        "--out",
        str(out),
        "--json",
    )
    assert told.exit_code == 0, told.output
    assert {Path(file) for file in json.loads(told.stdout)} == set(out.iterdir())
    assert schema_errors(out / "scenario.xosc", "OpenSCENARIO_1_2.xsd") == []
    assert schema_errors(out / "road.xodr", "opendrive_17_core.xsd") == []
    spec = EpisodeSpec.from_json(driven.solution["spec"])
    trace = BrinkDrive().run(spec, record=True).trace
    assert trace is not None
    ego = Trace.from_bytes(trace).ego
    bodies = ScenarioReader(ET.parse(out / "scenario.xosc").getroot()).bodies("ego")
    assert np.hypot(*(bodies[0] - ego[0, :2])) < 0.01
    assert np.hypot(*(bodies[-1] - ego[-1, :2])) < 0.01
    verdicts = json.loads((out / "verdicts.json").read_text())
    assert verdicts["campaign"] == driven.campaign
    assert verdicts["words"] == driven.solution["words"]
    for name, one in verdicts["requirements"].items():
        stored = driven.solution["verdicts"][name]
        assert one["violated_at_s"] == stored["violated_at_s"]
        assert one["robustness"] == pytest.approx(stored["robustness"], abs=1e-4)
        assert one["decides_the_verdict"] == (name == "front-gap@1")
    assert driven.campaign in (out / "README.txt").read_text()


def braked(job: LeasedJob) -> Completed:
    """Return the outcome of a command that brakes from v behind a gap."""
    values = EpisodeSpec.from_json(job.spec).scenario["scenario"]
    assert isinstance(values, dict)
    margin_m = float(str(values["gap"])) - float(str(values["v"])) ** 2 / 20.0
    verdict = WireVerdict(robustness=margin_m, unit="m", violated_at_s=1.0 if margin_m < 0 else None)
    return Completed(verdicts={"apart": verdict}, objectives={}, features={}, provenance={})


def test_both_sides_of_a_pair_of_a_command_are_written_with_their_values(
    sqlite_file: Path, tmp_path: Path
) -> None:
    case = CASES["value-sets"]
    varied = deterministic(steps("v", 10, 35, 0.1), steps("gap", 5, 60, 0.1))
    logical = logical_scenario(
        parse_document(Path("scenario.xosc"), case.scenario.encode()),
        parse_document(Path("variation.xosc"), varied.encode()),
    )
    params = {
        "command": ["sim", "scenario.xosc"],
        "files": {"scenario.xosc": {"content": template_of(logical).content.decode()}},
        "space": {"scenario": {axis.name: axis.declared for axis in logical.axes}},
        "signals": {"file": "log.csv"},
        "requirements": {"apart": {"signal": "gap_m", "above": 0.0, "unit": "m"}},
        "program": "0",
    }
    url = copied(sqlite_file, tmp_path)
    with coordinator(url) as client:
        campaign = submit(
            client,
            {
                "name": "braking",
                "problem": {"id": "command@1", "params": params},
                "algorithm": {"id": "edge@2"},
                "budget": {"simulations": 120},
            },
        )
        worker = FakeWorker(client, capabilities=(Definition.of(params).simulator_id("0"),), judge=braked)
        assert worker.work(campaign)["status"] == "finished"
    out = tmp_path / "pair"
    for _ in range(2):  # an export may be replaced
        told = export("scenario", campaign, "--pair", "1", "--database", url, "--out", str(out))
        assert told.exit_code == 0, told.output
    safe, unsafe = sorted(one for one in out.iterdir() if one.is_dir())
    assert (safe.name.partition("-")[0], unsafe.name.partition("-")[0]) == ("safe", "unsafe")
    values = []
    for side in (safe, unsafe):
        declared = declarations_of(read_document(side / "scenario.xosc"))
        assert schema_errors(side / "scenario.xosc", "OpenSCENARIO_1_3_1.xsd") == []
        values.append([float(declared[name].value) for name in ("v", "gap")])
    assert values[0][1] > values[0][0] ** 2 / 20.0 - 0.01
    assert values[1][1] < values[1][0] ** 2 / 20.0
    assert schema_errors(out / "value-sets.xosc", "OpenSCENARIO_1_1.xsd") == []
    with pytest.raises(InvalidInput, match="expected numbers of solutions, or --pair"):
        export("scenario", campaign, "--database", url, "--out", str(out))


def test_a_problem_without_roads_is_refused_with_those_that_have_some(
    sqlite_file: Path, tmp_path: Path
) -> None:
    url = copied(sqlite_file, tmp_path)
    with small_problems():
        with coordinator(url) as client:
            campaign = finish(client, ball())
        with pytest.raises(NotExportable, match=r"no roads that can be exported.*urban-injected@1"):
            export("scenario", campaign, "1", "--database", url, "--out", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_files_of_others_are_not_replaced(driven: Driven, tmp_path: Path) -> None:
    (tmp_path / "README.txt").write_text("my notes")
    with pytest.raises(InvalidInput, match="expected a new or empty folder"):
        export("scenario", driven.campaign, "1", "--database", driven.database, "--out", str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["README.txt"]


WITHOUT = """
import importlib.util, sys
module, *words = sys.argv[1:]
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == module:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Missing())
real = importlib.util.find_spec
importlib.util.find_spec = lambda name: None if name == module else real(name)
from brink.cli.main import main
end = words.index(";")
for sys.argv in (["brink", *words[:end]], ["brink", *words[end + 1 :]]):
    try:
        main()
    except SystemExit as ended:
        print("status", ended.code or 0)
"""
"""Runs two commands without a module, in a process of their own: elsewhere, the modules are loaded already."""


@pytest.mark.parametrize("module", ["scenariogeneration", "cv2"])
def test_a_missing_extra_is_named(driven: Driven, tmp_path: Path, module: str) -> None:
    file, folder = tmp_path / "campaign.brink", tmp_path / "scenario"
    where = ["--database", driven.database, "--out"]
    whole = ["export", driven.campaign, *where, str(file)]
    scenario = ["export", "scenario", driven.campaign, "1", *where, str(folder)]
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT, module, *whole, ";", *scenario],
        capture_output=True,
        text=True,
        check=True,
    )
    assert [line for line in ended.stdout.splitlines() if line.startswith("status")] == [
        "status 0",
        "status 1",
    ]
    assert file.exists()
    assert not folder.exists()
    assert f"needs {module}, which is not installed: {install_command('exchange')}" in ended.stderr

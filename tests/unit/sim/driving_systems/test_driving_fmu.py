"""An FMU drives: built here from C, run as a program, and refused with reasons where it does not fit."""

import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from support import fmus

from brink.sim.driving_systems.command import Definition, end_processes, install
from brink.sim.driving_systems.fmu import Fmu, Variables
from brink.sim.driving_systems.option import DrivingOption
from brink.sim.episode import EpisodeSpec
from brink.sim.fmi import FmuError, FmuFailed
from brink.sim.programs.installed import COMMANDS_VARIABLE
from brink.sim.urban.options import DriveOptions
from brink.sim.urban.simulator import BrinkDrive

EXAMPLE = Path(__file__).resolve().parents[4] / "examples" / "driving" / "fmu"
INPUTS = {"gap_m": 20.0, "relative_speed_mps": -1.0, "ego_speed_mps": 8.0, "set_speed_mps": 10.0}

pytest.importorskip("fmpy")
if not fmus.can_build():
    pytest.skip("no C compiler", allow_module_level=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the example's FMU, built, and its variables."""
    folder = tmp_path_factory.mktemp("fmu")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", folder / "acc.so", EXAMPLE / "acc.c"], check=True)
    with zipfile.ZipFile(folder / "acc.fmu", "w") as archive:
        archive.write(EXAMPLE / "modelDescription.xml", "modelDescription.xml")
        archive.write(folder / "acc.so", "binaries/linux64/acc.so")
    shutil.copy(EXAMPLE / "acc-variables.yaml", folder)
    return folder


def test_fmu_answers_and_begins_each_drive_anew(folder: Path, tmp_path: Path) -> None:
    fmu = Fmu(folder / "acc.fmu", Variables.of(folder / "acc-variables.yaml"), tmp_path / "unpacked")
    for _ in range(2):
        fmu.start()
        near = {**INPUTS, "gap_m": 5.0}
        assert fmu.step(INPUTS, 0.05) == pytest.approx(0.8 * 2.0)
        assert fmu.step(near, 0.05) == pytest.approx(0.4 * (5.0 - 3.0 - 1.2 * 8.0) - 1.2)


@pytest.mark.parametrize("version", fmus.VERSIONS)
def test_fmu_of_each_version_keeps_its_state_in_a_drive(tmp_path: Path, version: int) -> None:
    variables = Variables(
        inputs={"ego_speed_mps": "load.offset"},
        output=("accel_mps2", "y"),
        parameters={"rate": -2, "mode": "fast"},
    )
    fmu = Fmu(fmus.build(tmp_path, version), variables, tmp_path / "unpacked")
    for _ in range(2):
        fmu.start()
        answers = [fmu.step({**INPUTS, "ego_speed_mps": speed_mps}, 0.05) for speed_mps in (8.0, 9.0)]
        assert answers == pytest.approx([20 + 8 - 0.1, 20 + 9 - 0.2])


def test_what_the_fmu_logs_last_stands_in_the_error(tmp_path: Path) -> None:
    variables = Variables(
        inputs={"ego_speed_mps": "load.offset"}, output=("accel_mps2", "y"), parameters={"fault": 4}
    )
    fmu = Fmu(fmus.build(tmp_path, 2), variables, tmp_path / "unpacked")
    fmu.start()
    for _ in range(5):
        fmu.step(INPUTS, 0.1)
    with pytest.raises(
        FmuFailed, match=r"fmi2DoStep failed .* in the step from 0.5 s\nthe solver failed at 0.5"
    ):
        fmu.step(INPUTS, 0.1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inputs": {"gap_m": "distance"}}, "no variable 'distance'.*it has gap, dv"),
        ({"inputs": {"gap": "gap"}}, "inputs: expected some of gap_m, relative_speed_mps"),
        ({"output": {}}, "output: expected one of accel_mps2, brake_mps2"),
        ({"outputs": {}}, "expected inputs, output"),
    ],
)
def test_variables_that_do_not_fit_are_named(
    folder: Path, tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    import yaml

    said = yaml.safe_load((folder / "acc-variables.yaml").read_text()) | changes
    (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(said))
    with pytest.raises(FmuError, match=message):
        Fmu(folder / "acc.fmu", Variables.of(tmp_path / "wrong.yaml"), tmp_path / "unpacked")


def test_fmu_brakes_and_accelerates_in_a_drive(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(COMMANDS_VARIABLE, str(tmp_path))
    (folder / "acc.yaml").write_text(
        f"command: [{sys.executable}, -m, brink.sim.driving_systems.fmu, acc.fmu, acc-variables.yaml]\n"
        "start_timeout_s: 300\nstep_timeout_s: 60\n"
    )
    install(Definition.of(folder / "acc.yaml"))
    option = DrivingOption(system=Definition.of(folder / "acc.yaml").id())
    spec = EpisodeSpec(
        simulator="brink-drive@3",
        scenario={
            "time_of_day": "noon",
            "weather": "clear",
            "pedestrians": 0,
            "road_curve": "straight",
            "road_id": 0,
            "road_length": 0,
            "driving_task": "follow_road",
        },
        behaviour={"mode": "oracle"},
        requirements=("no-collision@1",),
        seed=2,
        duration_s=4.0,
        options={**DriveOptions().to_json(), **option.to_options()},
    )
    try:
        first, again = (BrinkDrive().run(spec, record=True) for _ in range(2))
    finally:
        end_processes()
    assert first.trace == again.trace
    own = BrinkDrive().run(replace(spec, options=DriveOptions().to_json()))
    assert first.features["way_m"] != own.features["way_m"]

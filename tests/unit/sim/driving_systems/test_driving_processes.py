"""Driving systems in processes of their own: the same drives as in this one, and faults that end only the child."""

import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path

import pytest
from support.running import assert_gone, new_mark, running

from brink.sim import catalogue
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.sim.driving_systems import EgoState, LightReading, LightState, Observation, Start
from brink.sim.driving_systems.command import Definition, end_processes, install, process_of
from brink.sim.driving_systems.option import DrivingOption
from brink.sim.driving_systems.protocol import step_message
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.errors import DefinitionError, InvalidEpisode, SimulationCrashed, SimulatorError
from brink.sim.programs.installed import COMMANDS_VARIABLE
from brink.sim.urban.options import DriveOptions
from brink.sim.urban.simulator import BrinkDrive
from brink.worker.child import SimulatorHost
from brink.worker.process import EpisodeProcess
from brink.worker.wire import Completed, JobFailed

ROOT = Path(__file__).resolve().parents[4]
EXAMPLES = ROOT / "examples" / "driving"
CHILD = ROOT / "tests" / "support" / "driving_child.py"
_numbers = itertools.count()


@pytest.fixture(autouse=True)
def _allowed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    monkeypatch.setenv(COMMANDS_VARIABLE, str(tmp_path / "commands"))
    yield
    end_processes()


def definition(tmp_path: Path, fault: str = "", argument: str = "", **fields: float) -> str:
    """Install the test's child with a fault and return its id."""
    file = tmp_path / str(next(_numbers)) / "child.yaml"
    file.parent.mkdir()
    command: Json = [sys.executable, str(CHILD), fault, argument]
    file.write_text(json.dumps({"command": command, **fields}))
    install(Definition.of(file))
    return Definition.of(file).id()


def drive(system: str, duration_s: float = 0.5, **settings: Json) -> EpisodeSpec:
    return EpisodeSpec(
        simulator="brink-drive@3",
        scenario={
            "time_of_day": "noon",
            "weather": "clear",
            "pedestrians": 18,
            "road_curve": "left",
            "road_id": 0,
            "road_length": 0,
            "driving_task": "follow_road",
        },
        behaviour={"mode": "oracle"},
        requirements=("no-collision@1",),
        seed=2,
        duration_s=duration_s,
        options={**DriveOptions().to_json(), **DrivingOption(system=system, settings=settings).to_options()},
    )


FAULTS = [
    (
        "dies",
        {},
        SimulationCrashed,
        "step 5 (0.25 s): the program exited with status 3\nit printed:\nout of ideas",
    ),
    ("crashes", {}, SimulationCrashed, "step 5 (0.25 s): the program was killed by SIGSEGV"),
    ("closes", {}, SimulationCrashed, "step 5 (0.25 s): the program closed its socket; killed"),
    (
        "hangs",
        {"step_timeout_s": 0.5},
        SimulationCrashed,
        "step 5 (0.25 s): no answer within 0.5 s (step_timeout_s); killed",
    ),
    (
        "silent",
        {"start_timeout_s": 0.2},
        SimulationCrashed,
        "it cannot be made: no answer within 0.2 s (start_timeout_s); killed",
    ),
    ("nan", {}, InvalidEpisode, "accel_mps2: a finite float or int, or None; got nan"),
    ("wrong type", {}, InvalidEpisode, "accel_mps2: a finite float or int, or None; got 'fast'"),
    (
        "unknown field",
        {},
        InvalidEpisode,
        "expected an object with accel_mps2, emergency, mode, objects, pedal,",
    ),
    ("no object", {}, InvalidEpisode, "decision: expected an object with"),
    ("no json", {}, InvalidEpisode, "expected a line of JSON, {\"decision\": …}; got 'accelerate!'"),
    ("other message", {}, InvalidEpisode, 'expected a line of JSON, {"decision": …}; got \'{"hello":{}}\''),
    ("reports", {}, InvalidEpisode, "step 5 (0.25 s): it reports an error: lost the map"),
    (
        "wrong point",
        {},
        InvalidEpisode,
        "trajectory[0]: expected time_s, x_m, y_m, yaw_rad, speed_mps, accel_mps2",
    ),
    ("wrong object", {}, InvalidEpisode, "with label vehicle or person; got {'label': 'cow'}"),
    ("twice", {}, InvalidEpisode, "step 6 (0.30 s): expected one answer to each message; got also"),
    ("endless", {}, InvalidEpisode, "expected at most 4,194,304 bytes in a line"),
    ("chatty", {}, InvalidEpisode, "expected a line of JSON, {\"hello\": …}; got 'Hello, Brink!'"),
]


@pytest.mark.parametrize(("fault", "fields", "error", "message"), FAULTS, ids=[one[0] for one in FAULTS])
def test_fault_of_a_program_fails_its_drive_alone_and_says_what_was_wrong(
    tmp_path: Path, fault: str, fields: dict[str, float], error: type[SimulatorError], message: str
) -> None:
    system = definition(tmp_path, fault, "", **fields)
    with pytest.raises(error) as raised:
        BrinkDrive().run(drive(system))
    assert str(raised.value).startswith(f"driving system {system}, ")
    assert message in str(raised.value)
    if fault not in ("silent", "chatty"):
        # The next drive has a new process, so nothing of the last one reaches it.
        BrinkDrive().run(drive(system, duration_s=0.2))


@pytest.mark.parametrize(
    ("hello", "message"),
    [
        (
            {"protocol": "brink-driving/9"},
            "hello: expected protocol 'brink-driving/1', got 'brink-driving/9'",
        ),
        ({"needs": "lidar"}, "hello: expected needs to be one of boxes, objects; got 'lidar'"),
        ({"version": None}, "hello: expected version in 1 to 80 printable characters, got None"),
        ({"name": "a\nb"}, "hello: expected name in 1 to 80 printable characters"),
    ],
)
def test_another_protocol_fails_for_good(tmp_path: Path, hello: dict[str, Json], message: str) -> None:
    spec = drive(definition(tmp_path, "hello", json.dumps(hello)))
    failure = SimulatorHost().run(spec.to_json(), record=False)
    assert failure["reason"] == "invalid"
    assert message in str(failure["message"])


def test_a_program_that_prints_and_answers_in_time_drives_as_the_decisions_say(tmp_path: Path) -> None:
    own = BrinkDrive().run(drive("modular@1", duration_s=1.5), record=True)
    for fault, argument in (("prints", ""), ("late", "0.1")):
        system = definition(tmp_path, fault, argument)
        for _ in range(2):
            result = BrinkDrive().run(drive(system, duration_s=1.5), record=True)
            assert (result.verdicts, result.features) == (own.verdicts, own.features)
        assert (result.provenance["driving"], result.provenance["driving_name"]) == (system, "child")
        assert result.provenance["driving_version"] == "2.1"
        end_processes()


def test_start_and_step_have_all_fields(tmp_path: Path) -> None:
    BrinkDrive().run(drive(definition(tmp_path, "start", str(tmp_path / "start")), 0.1, headway_s=1.5))
    (start,) = json.loads((tmp_path / "start.json").read_text()).values()
    assert start.keys() == {field.name for field in fields(Start)}
    assert start["settings"] == {"headway_s": 1.5}
    assert start["route"].keys() == {
        *("start_pose", "pieces", "length_m", "lane_width_m", "speed_limit_mps"),
        *("stop_line_stations_m", "oncoming", "crossings"),
    }
    assert start["route"]["oncoming"][0][0] == -20.0
    ego = EgoState(*map(float, range(7)))
    light = LightReading(LightState.RED, 30.25)
    seen = Observation(time_s=0.1 + 0.2, ego=ego, boxes=(), light=light, objects=None)
    (step,) = json.loads(step_message(seen)).values()
    assert step.keys() == {field.name for field in fields(Observation)}
    assert (step["time_s"], step["light"]) == (0.1 + 0.2, {"state": "red", "stop_line_station_m": 30.25})
    assert step["ego"] == ego._asdict()


def test_nothing_that_a_driving_system_started_stays(tmp_path: Path) -> None:
    mark = new_mark()
    with pytest.raises(SimulationCrashed):
        BrinkDrive().run(drive(definition(tmp_path, "forks", mark)))
    assert not running(mark)


@pytest.mark.parametrize("whom", ["child", "simulation process"])
def test_a_killed_drive_is_tried_again_with_the_same_result_and_nothing_stays(
    tmp_path: Path, whom: str
) -> None:
    mark = str(tmp_path / "once")
    pid_file = tmp_path / "once.pid"
    system = definition(tmp_path, "hangs once", mark, step_timeout_s=60)
    spec = drive(system).to_json()
    with_processes = EpisodeProcess()
    outcomes: list[Completed | JobFailed] = []
    try:
        thread = threading.Thread(
            target=lambda: outcomes.append(with_processes.run(spec, record=True, timeout_s=60))
        )
        thread.start()
        deadline_s = time.monotonic() + 30
        while not pid_file.exists():
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        pid = int(pid_file.read_text()) if whom == "child" else with_processes.pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        thread.join(30)
        (failed,) = outcomes
        assert isinstance(failed, JobFailed)
        assert failed.reason == "crashed"
        assert "SIGKILL" in failed.message
        again = with_processes.run(spec, record=True, timeout_s=60)
    finally:
        with_processes.close()
    assert isinstance(again, Completed)
    own = BrinkDrive().run(drive("modular@1"))
    assert again.features == own.features
    assert_gone(mark)


def test_only_what_is_installed_with_this_content_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "planner.py").write_text("raise SystemExit(1)")
    file = tmp_path / "planner.yaml"
    file.write_text(json.dumps({"command": [sys.executable, "planner.py"]}))
    system = Definition.of(file).id()
    missing = SimulatorHost().run(drive(system).to_json(), record=False)
    assert missing["reason"] == "error"  # another worker may have it
    assert f"{system} is not installed on this worker" in str(missing["message"])
    install(Definition.of(file))
    (tmp_path / "planner.py").write_text("raise SystemExit(2)")
    other = Definition.of(file).id()
    assert other != system
    edited = SimulatorHost().run(drive(system).to_json(), record=False)
    assert f"found {other}" in str(edited["message"])
    monkeypatch.setenv(COMMANDS_VARIABLE, "")
    none = SimulatorHost().run(drive(system).to_json(), record=False)
    assert "no folder of programs (brink worker --commands FOLDER)" in str(none["message"])


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("[planner]", "expected command and perhaps files, environment, step_timeout_s, start_timeout_s"),
        ("command: planner", "command: expected texts"),
        ("command: []", "expected a program in command"),
        ("command: [no-such-program]", "no-such-program: no program that can be executed, on PATH"),
        (
            "command: [./planner.yaml]",
            "./planner.yaml: no program that can be executed, relative to its folder",
        ),
        ("command: [sh]\nfiles: [weights]", "weights: cannot be read: No such file"),
        ("command: [sh]\nfiles: [7]", "files: expected texts (numbers in quotes)"),
        ("command: [sh]\nenvironment: {A: 1}", "environment: expected texts"),
        ("command: [sh]\nstep_timeout_s: 0", "step_timeout_s: expected seconds in (0, 3600], got 0"),
        ("command: [sh]\nneeds: boxes", "expected command and perhaps"),
        ("command: [sh", "cannot be read as YAML"),
    ],
)
def test_a_definition_that_cannot_run_here_is_refused(tmp_path: Path, document: str, message: str) -> None:
    file = tmp_path / "planner.yaml"
    file.write_text(document)
    with pytest.raises(DefinitionError) as raised:
        Definition.of(file).id()
    assert message in str(raised.value)


def test_command_environment_and_all_files_are_part_of_the_id(tmp_path: Path) -> None:
    (tmp_path / "maps" / "north").mkdir(parents=True)
    file, script, layer = tmp_path / "a.yaml", tmp_path / "a.sh", tmp_path / "maps" / "north" / "1"
    changes: list[Callable[[], object]] = [
        lambda: script.write_text("exit 0"),
        lambda: layer.write_text("road"),
        lambda: layer.rename(layer.with_name("2")),
        lambda: file.write_text("command: [sh, a.sh, --fast]\nfiles: [maps]"),
        lambda: file.write_text("command: [sh, a.sh, --fast]\nfiles: [maps]\nenvironment: {A: '1'}"),
    ]
    script.write_text("")
    layer.write_text("")
    file.write_text("command: [sh, a.sh]\nfiles: [maps]")
    ids = [Definition.of(file).id()]
    for change in changes:
        change()
        ids.append(Definition.of(file).id())
    assert len(set(ids)) == len(ids)
    file.write_text("command: [sh, a.sh, --fast]\nfiles: [maps]\nenvironment: {A: '1'}\nstep_timeout_s: 9")
    assert Definition.of(file).id() == ids[-1]


def test_the_least_recently_used_programs_end(tmp_path: Path) -> None:
    marks = [new_mark() for _ in range(5)]
    systems = [definition(tmp_path, "", mark) for mark in marks]
    for system in systems:
        BrinkDrive().run(drive(system, 0.1))
    assert [bool(running(mark)) for mark in marks] == [False, True, True, True, True]
    assert process_of(systems[-1]).hello is not None


@pytest.fixture
def _plugins(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setenv(PLUGINS_VARIABLE, "idm,aeb")
    catalogue.import_plugin_modules.cache_clear()
    yield
    catalogue.import_plugin_modules.cache_clear()


def without_make() -> dict[str, str]:
    """Return the environment without what a make that runs these tests tells those that it starts."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}


@pytest.mark.usefixtures("_plugins")
@pytest.mark.parametrize("example", ["C++", "Python"])
def test_examples_drive_as_their_twins_in_python_do(tmp_path: Path, example: str) -> None:
    if example == "C++":
        if shutil.which("cmake") is None or shutil.which("c++") is None:
            pytest.skip("no compiler")
        shutil.copytree(EXAMPLES / "cpp", tmp_path / "cpp", ignore=shutil.ignore_patterns("build"))
        for command in (["cmake", "-B", "build"], ["cmake", "--build", "build"]):
            done = subprocess.run(
                command, cwd=tmp_path / "cpp", env=without_make(), capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr
            assert "warning" not in done.stderr
        file, twin = tmp_path / "cpp" / "idm.yaml", "idm:Idm"
    else:
        file, twin = EXAMPLES / "aeb_process.yaml", "aeb:EmergencyBrake"
    install(Definition.of(file))
    for seed in (1, 2):
        here, there = (
            BrinkDrive().run(replace(drive(system, 12.0), seed=seed))
            for system in (twin, Definition.of(file).id())
        )
        assert (here.verdicts, here.features, here.objectives) == (
            there.verdicts,
            there.features,
            there.objectives,
        )

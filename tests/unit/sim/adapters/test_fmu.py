"""FMUs as plants, built here from C for FMI 2 and 3: what they answer, what is refused, what becomes of faults."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import fmus

from brink.search.errors import ConfigError
from brink.server.problems.fmu import Fmu, FmuParams
from brink.sim.adapters.fmu import installed
from brink.sim.adapters.fmu.campaign import read_files
from brink.sim.catalogue import SIMULATORS, make_simulator
from brink.sim.episode import EpisodeResult, EpisodeSpec
from brink.sim.errors import DefinitionError, InvalidEpisode, SimulationCrashed
from brink.sim.programs.installed import COMMANDS_VARIABLE
from brink.sim.testing import check_simulator
from brink.sim.trace import Trace
from brink.worker.process import EpisodeProcess
from brink.worker.wire import Completed, JobFailed

pytest.importorskip("fmpy")
if not fmus.can_build():
    pytest.skip("no C compiler", allow_module_level=True)

PARAMS: dict[str, Any] = {
    "fmu": "model2.fmu",
    "space": {
        "scenario": {
            "rate": {},
            "offset": {"variable": "load.offset", "min": -2, "max": 2},
            "flag": {},
            "mode": {},
        }
    },
    "seed_variable": "seed",
    "signals": {"columns": {"twice": "2 * y", "seconds": "time"}},
    "requirements": {"high": {"signal": "twice", "above": 0, "unit": "m"}},
}
VALUES = {"rate": 2.0, "offset": -1.5, "flag": "false", "mode": "slow"}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both FMUs."""
    folder = tmp_path_factory.mktemp("fmus")
    for version in fmus.VERSIONS:
        fmus.build(folder, version)
    return folder


@pytest.fixture
def commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of what may run here; what is registered meanwhile is forgotten."""
    from brink.sim import catalogue

    monkeypatch.setenv(COMMANDS_VARIABLE, str(tmp_path / "commands"))
    monkeypatch.setitem(catalogue._registered, SIMULATORS, dict(catalogue._registered.get(SIMULATORS, {})))
    return tmp_path / "commands"


def problem_of(folder: Path, version: int = 2, **changed: Any) -> Fmu:
    return Fmu(FmuParams(**read_files({**PARAMS, "fmu": f"model{version}.fmu", **changed}, folder)))


def spec_of(problem: Fmu, **values: Any) -> EpisodeSpec:
    return problem.episode(problem.space.encode({"scenario": {**VALUES, **values}}), 7)


def run(problem: Fmu, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
    problem.install()
    assert installed.register_fmus() == {}
    return make_simulator(problem.needs).run(spec, record=record)


@pytest.mark.parametrize("version", fmus.VERSIONS)
def test_known_answer(built: Path, commands: Path, version: int) -> None:
    problem = problem_of(built, version)
    found = run(problem, spec_of(problem)).verdicts["high"]
    assert (found.robustness, found.unit, found.violated_at_s) == (-3.0, "m", 0.0)
    spec = spec_of(problem, rate=-4.0, flag="true", mode="fast")
    found = run(problem, spec).verdicts["high"]
    assert found.robustness == pytest.approx(2 * (-4 * 1.0 - 1.5 + 20 + 1))
    assert found.violated_at_s is None
    trace = Trace.from_bytes(run(problem, spec, record=True).trace or b"")
    assert trace.signals["seconds"] == pytest.approx(np.arange(11) * 0.1)
    assert trace.signals["twice"] == pytest.approx(2 * (19.5 - 4 * np.arange(11) * 0.1))


@pytest.mark.parametrize("version", fmus.VERSIONS)
def test_passes_the_contract_of_simulators(built: Path, commands: Path, version: int) -> None:
    problem = problem_of(built, version)
    problem.install()
    installed.register_fmus()
    rng = np.random.default_rng(3)
    specs = [problem.episode(problem.space.sample(rng), seed) for seed in range(3)]
    options = dict(specs[0].options)
    check_simulator(
        lambda: make_simulator(problem.needs),
        specs,
        invalid=[
            replace(specs[0], scenario={"scenario": {"no_such_variable": 1.0}}),
            replace(specs[0], scenario={"scenario": {"mode": "medium"}}),
            replace(specs[0], scenario={"scenario": {"y": 1.0}}),
            replace(specs[0], requirements=("other",)),
            replace(specs[0], options={**options, "step_s": 0.3}),
            replace(specs[0], options={**options, "signals": {"file": "log.csv"}}),
            replace(specs[0], options={**options, "command": ["rm"]}),
        ],
    )


@pytest.mark.parametrize("version", fmus.VERSIONS)
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (1, "expected numbers, but twice is nan at 0.6 s"),
        (4, r"DoStep failed with status 3.*\n.*failed at 0.5"),
    ],
)
def test_a_fault_gives_no_verdict(
    built: Path, commands: Path, version: int, fault: int, message: str
) -> None:
    problem = problem_of(built, version, start_values={"fault": fault})
    with pytest.raises(SimulationCrashed, match=message):
        run(problem, spec_of(problem))


@pytest.mark.parametrize(("version", "ended_s"), [(2, 0.5), (3, 0.6)])
def test_an_fmu_that_asks_to_end_is_judged_until_then(
    built: Path, commands: Path, version: int, ended_s: float
) -> None:
    problem = problem_of(built, version, start_values={"fault": 5})
    result = run(problem, spec_of(problem, rate=-1.0, offset=2.0))
    assert result.provenance["simulated_s"] == pytest.approx(ended_s)
    assert result.verdicts["high"].robustness == pytest.approx(2 * (2.0 - ended_s))


@pytest.mark.long("starts the simulation process three times")
def test_a_crash_and_a_hang_cost_their_episode_alone(built: Path, commands: Path) -> None:
    problems = {
        (version, fault): problem_of(built, version, start_values={"fault": fault})
        for version, fault in ((2, 0), (2, 2), (3, 3), (3, 0))
    }
    for problem in problems.values():
        problem.install()
    process = EpisodeProcess(start_timeout_s=120.0)
    try:
        process.start()

        def outcome(version: int, fault: int, timeout_s: float = 60.0) -> Completed | JobFailed:
            spec = spec_of(problems[version, fault])
            return process.run(spec.to_json(), record=False, timeout_s=timeout_s)

        assert isinstance(outcome(2, 0), Completed)
        crashed = outcome(2, 2)
        assert isinstance(crashed, JobFailed)
        assert (crashed.reason, "SIGABRT" in crashed.message) == ("crashed", True)
        hung = outcome(3, 3, timeout_s=2.0)
        assert isinstance(hung, JobFailed)
        assert hung.reason == "timeout"
        assert isinstance(outcome(3, 0), Completed)
    finally:
        process.close()


@pytest.mark.parametrize(
    ("changed", "field", "message"),
    [
        ({"fmu": "none.fmu"}, "fmu", "cannot be read: No such file"),
        (
            {"space": {"scenario": {"rat": {}}}},
            "space",
            "no variable 'rat'.*did you mean 'rate'.*it has x, rate",
        ),
        ({"space": {"scenario": {"y": {"min": 0, "max": 1}}}}, "space", "'y' is computed .output."),
        ({"space": {"scenario": {"file": {}}}}, "space", "expected a scalar number; 'file' is a String"),
        ({"space": {"scenario": {"load.offset": {}}}}, "space", "expected min, since model2.fmu states none"),
        ({"space": {"scenario": {"rate": {"max": 9}}}}, "space", "which ends at 4; got 9"),
        ({"space": {"scenario": {"mode": {"values": ["idle"]}}}}, "space", "one of slow, fast; got 'idle'"),
        (
            {"space": {"scenario": {"flag": {"min": 0}}}},
            "space",
            "expected values, some of false, true; got min",
        ),
        (
            {"space": {"scenario": {"fault": {"max": 2.5}}}},
            "space",
            "whole numbers for Integer; got 2.5 as max",
        ),
        ({"start_values": {"rate": "fast"}}, "start_values", "rate: expected a finite number, got 'fast'"),
        ({"seed_variable": "mode"}, "seed_variable", "mode: expected one of slow, fast; got 0"),
        ({"requirements": {"a": {"signal": "z", "above": 0}}}, "requirements", "no variable 'z'"),
        ({"signals": {"columns": {"twice": "2 * y", "a": "z + 1"}}}, "signals", "no variable 'z'"),
    ],
)
def test_what_does_not_fit_the_fmu_is_refused_before_submission(
    built: Path, changed: dict[str, Any], field: str, message: str
) -> None:
    with pytest.raises(DefinitionError, match=message) as caught:
        read_files({**PARAMS, **changed}, built)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"start_values": {"load.offset": 1}},
            "load.offset: expected a variable that the space does not set",
        ),
        ({"seed_variable": "rate"}, "seed_variable: rate: expected a variable that the space does not set"),
        ({"stop_s": 1.05}, "stop_s: expected a stop time that is a multiple of the step"),
        (
            {"space": {"a": {"rate": {}, "r": {"variable": "rate"}}}},
            "r: expected each parameter and each variable once",
        ),
        (
            {"requirements": {"late": {"stl": "always[5:6] y > 1", "unit": "m"}}},
            "late: looks 5 s ahead, but episodes end after 1 s",
        ),
    ],
)
def test_what_contradicts_itself_is_refused(built: Path, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        problem_of(built, **changed)


@pytest.mark.parametrize(
    ("version", "platform", "old", "new", "message"),
    [
        (2, "win64", "", "", "expected a build for linux64; it has win64"),
        (3, "linux64", "", "", "expected a build for x86_64-linux; it has linux64"),
        (
            2,
            "",
            "CoSimulation",
            "ModelExchange",
            "expected co-simulation .* it is for model exchange by FMI 2.0",
        ),
        (3, "", "CoSimulation", "ScheduledExecution", "it is for scheduled execution by FMI 3.0"),
        (2, "", '<ScalarVariable name="x"', "<ScalarVariable", "invalid modelDescription.xml"),
        (2, "", "<fmiModelDescription", "<", "modelDescription.xml cannot be read"),
    ],
)
def test_another_kind_of_fmu_is_refused_with_what_was_expected(
    built: Path, tmp_path: Path, version: int, platform: str, old: str, new: str, message: str
) -> None:
    description = fmus.description_of(version).replace(old, new) if old else ""
    path = tmp_path / f"model{version}.fmu"
    fmus.pack(path, built / f"model{version}.so", version, platform=platform, description=description)
    with pytest.raises(DefinitionError, match=message):
        problem_of(tmp_path, version)
    (tmp_path / "none.fmu").write_text("no archive")
    with pytest.raises(DefinitionError, match="expected an FMU, which is a ZIP archive"):
        read_files({**PARAMS, "fmu": "none.fmu"}, tmp_path)


def test_only_what_is_installed_runs(built: Path, commands: Path, tmp_path: Path) -> None:
    problem = problem_of(built)
    assert installed.register_fmus() == {}
    with pytest.raises(InvalidEpisode, match=f"unknown id '{problem.needs}'"):
        make_simulator(problem.needs)
    problem.install()
    problem.install()
    (path,) = commands.iterdir()
    assert re.fullmatch(r"model2@[0-9a-f]{16}\.fmu", path.name)
    installed.register_fmus()
    with path.open("ab") as file:
        file.write(b"changed")
    with pytest.raises(SimulationCrashed, match="has changed since this worker started"):
        make_simulator(problem.needs)
    installed.install(problem.params.fmu)
    make_simulator(problem.needs)
    fmus.pack(commands / "other.fmu", built / "model2.so", 2, platform="win64")
    (reason,) = installed.register_fmus().values()
    assert reason == "expected a build for linux64 or x86_64-linux; it has win64"


def test_an_fmu_that_changed_after_it_was_read_is_not_installed(
    built: Path, commands: Path, tmp_path: Path
) -> None:
    path = tmp_path / "model2.fmu"
    path.write_bytes((built / "model2.fmu").read_bytes())
    problem = problem_of(tmp_path)
    path.write_bytes((built / "model3.fmu").read_bytes())
    with pytest.raises(DefinitionError, match="has changed since it was read"):
        problem.install()
    assert list(commands.iterdir()) == []


def test_a_campaign_that_names_a_path_instead_of_a_digest_is_refused() -> None:
    ((field, message),) = Fmu(FmuParams(fmu="model2.fmu")).wrong_inputs()
    assert (field, "expected NAME@DIGEST" in message) == ("fmu", True)

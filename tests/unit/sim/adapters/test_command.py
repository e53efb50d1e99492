"""Programs as simulators: what runs, what may not, and what becomes of failures."""

import json
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from brink.pictures.story import story_of
from brink.search.errors import SpaceError
from brink.server.problems.command import declared_space
from brink.sim.adapters.command import simulator as module
from brink.sim.adapters.command.definition import Definition, with_contents
from brink.sim.adapters.command.signals import SignalError, SignalSource
from brink.sim.adapters.command.simulator import CommandSimulator
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import DefinitionError, InvalidEpisode, SimulationCrashed
from brink.sim.trace import Trace

LOG = "import sys\nopen('log.csv', 'w').write('time,x\\n0,1\\n1,' + sys.argv[1] + '\\n')\n"
SPACE = {"scenario": {"x": {"min": -5, "max": 5}}}


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield the folder of all working folders, which are empty afterwards."""
    monkeypatch.setattr(module.tempfile, "gettempdir", lambda: str(tmp_path))  # type: ignore[attr-defined]
    folder = tmp_path / f"brink-commands-{os.getuid()}"
    yield folder
    assert not [one for one in folder.glob("*/*") if one.parent.name.isdigit()]


def definition_of(script: str = LOG, **changed: Any) -> Definition:
    params: dict[str, Any] = {
        "command": [sys.executable, "run.py", "{x}"],
        "copies": {"run.py": "run.py"},
        "space": SPACE,
        **changed,
    }
    folder = Path(module.tempfile.gettempdir())  # type: ignore[attr-defined]
    (folder / "run.py").write_text(script)
    return Definition.of(with_contents(params, folder))


def spec_of(
    simulator: CommandSimulator, scenario: dict[str, Any], timeout_s: float = 60.0, **signals: Any
) -> EpisodeSpec:
    return EpisodeSpec(
        simulator=simulator.id,
        scenario={"scenario": scenario},
        behaviour={},
        requirements=("high",),
        seed=7,
        duration_s=timeout_s,
        options={
            "signals": {"file": "log.csv", "columns": {"twice": "2 * x"}, **signals},
            "requirements": {"high": {"signal": "twice", "above": -1.5, "unit": "m"}},
        },
    )


def run(definition: Definition, x: object = 3.5, *, timeout_s: float = 60.0, **values: Any) -> EpisodeResult:
    simulator = CommandSimulator(definition, "0")
    return simulator.run(spec_of(simulator, {"x": x, **values}, timeout_s))


def test_the_verdict_is_the_smallest_margin_with_the_time_of_the_first_violation() -> None:
    held, violated = run(definition_of()).verdicts["high"], run(definition_of(), -1.25).verdicts["high"]
    assert (held.robustness, held.unit, held.violated_at_s) == (3.5, "m", None)
    assert (violated.robustness, violated.violated_at_s) == (-1.0, 1.0)


def test_a_formula_over_several_signals_gives_the_verdict() -> None:
    def verdict(x: float, stl: str) -> tuple[float, str, float | None]:
        simulator = CommandSimulator(definition_of(), "0")
        spec = spec_of(simulator, {"x": x})
        stated: Json = {"high": {"stl": stl, "unit": "m"}}
        options = {**spec.options, "requirements": stated}
        result = simulator.run(replace(spec, options=options), record=True)
        found = result.verdicts["high"]
        assert result.trace is not None
        assert story_of(Trace.from_bytes(result.trace)).formula == stl
        return found.robustness, found.unit, found.violated_at_s

    stl = "always (twice > 4 or eventually[0:1] x > 3)"
    assert verdict(3.5, stl) == (0.5, "m", None)
    assert verdict(1.5, stl) == (-1.5, "m", 1.0)
    with pytest.raises(SimulationCrashed, match="ended, but 'x / x > 1': not a number 1 s after"):
        verdict(0.0, "always x / x > 1")
    with pytest.raises(InvalidEpisode, match=r"options: .*character 8: expected"):
        verdict(1.0, "always >")


def test_seeds_fit_in_a_signed_integer_of_32_bits(tmp_path: Path) -> None:
    definition = definition_of(command=[sys.executable, "run.py", "{x}", "{seed}"])
    simulator = CommandSimulator(definition, "0")
    for seed, given in ((7, 7), (2**31 - 1, 2**31 - 1), (2**52 + 5, 5)):
        folder = tmp_path / str(seed)
        folder.mkdir()
        done = simulator.attempt(replace(spec_of(simulator, {"x": 0.0}), seed=seed), folder)
        assert done.command[-1] == str(given)


def test_placeholders_are_filled_and_escaped_by_the_ending_of_the_file() -> None:
    hostile = "\"'<&>$(id);{x}"
    definition = Definition.of(
        {
            "command": ["echo", "--mode={mode}", "{seed}", "{{seed}", "${x}"],
            "files": {
                "a.xosc": {"content": '<a b="{mode}" c="${$x * 2}"/>'},
                "a.json": {"content": '{"a": {"mode": "{mode}", "x": {x}}}'},
                "a.txt": {"content": "{out} {number}"},
            },
            "space": {"scenario": {"x": {"min": 0, "max": 1}, "mode": {"values": [hostile, "b"]}}},
        }
    )
    texts = definition.texts({"x": 0.5, "mode": hostile}) | {"seed": "7", "out": "/work", "number": "3"}
    files = dict(definition.files(texts))
    assert files["a.xosc"].decode() == '<a b="&quot;&#x27;&lt;&amp;&gt;$(id);{x}" c="${$x * 2}"/>'
    assert json.loads(files["a.json"]) == {"a": {"mode": hostile, "x": 0.5}}
    assert files["a.txt"] == b"/work 3"
    assert definition.arguments(texts)[1:] == (f"--mode={hostile}", "7", "{seed}", "0.5")


def test_a_text_stands_in_place_of_a_parameter_that_is_absent() -> None:
    depth = {"min": 0, "max": 3, "when": {"kind": "cut-in"}, "absent": "none"}
    space = {"kind": {"values": ["cut-in", "brake"]}, "depth": depth}
    stated: dict[str, Any] = {"command": ["echo", "{kind}", "{depth}"], "space": {"scenario": space}}
    definition = Definition.of(stated)
    assert definition.arguments(definition.texts({"kind": "brake"}))[1:] == ("brake", "none")
    assert definition.arguments(definition.texts({"kind": "cut-in", "depth": 1.5}))[1:] == ("cut-in", "1.5")
    with pytest.raises(DefinitionError, match="'kind' differs"):
        definition.texts({"depth": 1.5})
    assert Definition.of(definition.document()).simulator_id("0") == definition.simulator_id("0")
    del depth["when"]
    with pytest.raises(SpaceError, match="absent needs when"):
        declared_space(stated["space"], definition)
    depth["when"] = {"kind": "cut-in"}
    component = declared_space(stated["space"], definition).components[0]
    assert component.by_name["depth"].when == (("kind", ("cut-in",)),)


def test_a_choice_decides_the_text_of_further_placeholders() -> None:
    """Values that belong together, such as a speed and a radius, vary as one."""
    gives = {"speed": [10, 20.5], "radius": ["9", "11.75"]}
    space = {"scenario": {"turn": {"values": ["slow", "fast"], "gives": gives}}}
    stated: dict[str, Any] = {"command": ["echo", "{speed}", "{radius}"], "space": space}
    definition = Definition.of(stated)
    for choice, words in (("slow", ("10", "9")), ("fast", ("20.5", "11.75"))):
        assert definition.arguments(definition.texts({"turn": choice}))[1:] == words
    again = Definition.of(definition.document())
    assert again == definition
    gives["speed"] = [10, 25]
    assert Definition.of(stated).simulator_id("0") != definition.simulator_id("0")
    assert [one.name for one in declared_space(space, definition).components[0].parameters] == ["turn"]


@pytest.mark.parametrize(
    ("changed", "field", "words"),
    [
        ({"command": ["sim", "{y}"]}, "command", "no parameter is called 'y'"),
        ({"command": ["sim"]}, "space", "placeholder {x}"),
        ({"command": ["{x}", "{x}"]}, "command", "a program without placeholders"),
        ({"command": "sim {x}; rm -rf /"}, "command", "a list"),
        ({"command": ["sim\0", "{x}"]}, "command", "a list"),
        ({"files": {"../../.bashrc": {"content": "{x}"}}}, "files", "inside the working folder"),
        ({"files": {"/etc/passwd": {"content": "{x}"}}}, "files", "inside the working folder"),
        ({"files": {"a": {"content": "{x}"}, "a/b": {"content": ""}}}, "files", "a file, and a folder"),
        ({"files": {"a": "/etc/passwd"}}, "files", "expected {content: …}"),
        ({"copies": {"a": {"base64": "%%"}}}, "copies", "base64"),
        ({"copies": {"a": {"base64": "A" * 4 * 200_000}}}, "files", "bytes together"),
        ({"environment": {"A=B": "c"}}, "environment", "by the name of a variable"),
        ({"success": [0, 300]}, "success", "0 to 255"),
        ({"space": {"a": {"x": {}}, "b": {"x": {}}}}, "space", "names that differ"),
        ({"space": {"a": {"seed": {}}}}, "space", "names that differ"),
        ({"space": {"a": {"x": {"min": 0, "max": 1, "when": {"y": "b"}}}}}, "space", "beside when, absent"),
        ({"space": {"a": {"x": {"values": ["a\nb"]}}}}, "space", "control characters"),
        (
            {"space": {"a": {"x": {"values": ["a"], "gives": {"y": ["1", "2"]}}}}},
            "space",
            "a list of 1 values",
        ),
        (
            {"space": {"a": {"x": {"min": 0, "max": 1, "gives": {"y": ["1"]}}}}},
            "space",
            "beside values, gives",
        ),
        (
            {"space": {"a": {"x": {"values": ["a"], "gives": {"seed": ["1"]}}}}},
            "space",
            "has a value already",
        ),
        ({"space": {"a": {"x": {"values": ["a"], "gives": {"y": ["1"]}}}}}, "space", "placeholder {y}"),
    ],
)
def test_hostile_definitions_are_refused(changed: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(DefinitionError, match=words.replace("{", r"\{").replace("(", r"\(")) as error:
        Definition.of({"command": ["sim", "{x}"], "space": SPACE, **changed})
    assert error.value.field == field


@pytest.mark.parametrize(
    "value", ["$(touch hacked)", "--help", [1], {"a": 1}, None, True, float("nan"), float("inf")]
)
def test_only_numbers_and_choices_of_the_definition_reach_the_program(value: object) -> None:
    definition = definition_of(
        command=[sys.executable, "run.py", "{x}", "{mode}"],
        space={"scenario": {"x": {}, "mode": {"values": ["a", "b"]}}},
    )
    assert run(definition, 1, mode="a").verdicts
    wrong: list[dict[str, Any]] = [
        {"x": value, "mode": "a"},
        {"x": 1, "mode": value},
        {"x": 1, "mode": "a", "more": 1},
    ]
    for values in wrong:
        with pytest.raises(InvalidEpisode, match="expected"):
            run(definition, **values)


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({}, True),
        ({"space": {"scenario": {"x": {"min": 0, "max": 1}}}}, True),
        ({"command": [sys.executable, "run.py", "{x}", "-v"]}, False),
        ({"environment": {"A": "1"}}, False),
        ({"success": [0, 3]}, False),
        ({"files": {"a": {"content": "b"}}}, False),
        ({"space": {"scenario": {"x": {"values": ["1"]}}}}, False),
    ],
)
def test_the_id_covers_what_decides_what_is_executed(change: dict[str, Any], same: bool) -> None:
    first, second = definition_of(), definition_of(**change)
    assert (first.simulator_id("0") == second.simulator_id("0")) is same
    assert first.simulator_id("0") != first.simulator_id("1")
    assert first.simulator_id("0") != definition_of(LOG + "#").simulator_id("0")


def test_the_program_is_identified_by_its_content_or_by_what_it_says(tmp_path: Path) -> None:
    program = tmp_path / "sim"

    def digest(text: str, **more: Any) -> str:
        program.write_text(f"#!/bin/sh\n{text}\n")
        program.chmod(0o755)
        return definition_of(command=[str(program), "{x}"], **more).program(tmp_path)

    assert digest("echo 1") == digest("echo 1") != digest("echo 1 # edited")
    version = {"version": [str(program), "--version"]}
    assert digest("echo 1", **version) == digest("echo 1 # edited", **version) != digest("echo 2", **version)
    with pytest.raises(DefinitionError, match="exited with status 3: broken"):
        digest("echo broken; exit 3", **version)
    with pytest.raises(DefinitionError, match="no program 'no-such-program' here"):
        definition_of(command=["no-such-program", "{x}"]).program(tmp_path)


FAILURES = {
    "exit status": ("print('no licence'); sys.exit(3)", r"exited with status 3.*\nno licence"),
    "killed": ("os.abort()", "was killed by SIGABRT"),
    "no log": ("open('other.txt', 'w')", "no log log.csv was written; the folder has other.txt, run.py"),
    "empty log": ("open('log.csv', 'w')", "log.csv is empty"),
    "no samples": ("log('')", "has no samples"),
    "binary log": ("open('log.csv', 'wb').write(bytes(range(256)))", "UTF-8"),
    "other columns": ("open('log.csv', 'w').write('time,y\\n0,1')", "no column 'x'; it has time, y"),
    "not a number": ("log('0,nan')", "twice is nan at 0 s"),
    "a word": ("log('0,far')", "expected a number, got 'far'"),
    "time runs back": ("log('1,1\\n0,1')", "expected increasing times"),
    "a link out": ("os.symlink('/etc/hostname', 'log.csv')", "not a link out of it"),
    "a pipe": ("os.mkfifo('log.csv')", "cannot be read"),
    "a large log": ("log('1,1\\n' * 40_000_000)", "killed by SIGXFSZ|exited|cannot be read"),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_failed_program_gives_no_verdict_and_its_folder_is_kept(failure: str, own_folder: Path) -> None:
    code, words = FAILURES[failure]
    script = f"import os, sys\ndef log(rows): open('log.csv', 'w').write('time,x\\n' + rows)\n{code}"
    with pytest.raises(SimulationCrashed, match=f"(?s){words}"):
        run(definition_of(script))
    (kept,) = own_folder.glob("failed-*")
    assert (kept / "run.py").read_text() == script


def test_few_folders_of_failed_episodes_are_kept(own_folder: Path) -> None:
    for _ in range(module.KEPT_FAILURES + 2):
        with pytest.raises(SimulationCrashed):
            run(definition_of("raise SystemExit(1)"))
    assert len(list(own_folder.glob("failed-*"))) == module.KEPT_FAILURES


def test_a_program_that_prints_and_writes_without_end_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        SimulationCrashed, match=r"did not end in 1 s and was killed\n(?s:.*)abc[abc]*\nits folder"
    ):
        run(definition_of("while True: print('abc' * 10_000)"), timeout_s=1.0)
    monkeypatch.setattr(module, "MAX_FOLDER_BYTES", 1_000_000)
    script = "import itertools\nfor n in itertools.count(): open(str(n), 'w').write('x' * 50_000)"
    with pytest.raises(SimulationCrashed, match="wrote more than 1,000,000 bytes"):
        run(definition_of(script))


def test_children_of_the_program_end_with_it(own_folder: Path) -> None:
    script = """
import os, sys, time
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        while True:
            open('/proc/self/comm', 'w').write('brink-stays')
            time.sleep(0.05)
    os._exit(0)
time.sleep(0.3)
"""
    assert run(definition_of(script + LOG)).verdicts
    with pytest.raises(SimulationCrashed, match="did not end in 1 s"):
        run(definition_of(script + "time.sleep(60)"), timeout_s=1.0)
    names = [name for one in Path("/proc").glob("[0-9]*/comm") if (name := _read(one)) == "brink-stays"]
    assert names == []


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def test_the_environment_is_as_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BRINK_TOKEN", "secret")
    names = {"PATH", "LANG", "HOME", "TMPDIR", "MAP", "LC_CTYPE"}
    script = f"import os\nassert set(os.environ) <= {names}, os.environ\nassert os.environ['MAP'] == 'town'\n"
    assert run(definition_of(script + LOG, environment={"MAP": "town"}))


def test_what_a_killed_worker_left_is_removed_by_the_next_episode(own_folder: Path) -> None:
    own_folder.mkdir()
    (own_folder / "0").mkdir()
    (own_folder / "0" / "log.csv").write_text("time,x\n0,-100\n")
    with pytest.raises(SimulationCrashed, match="no log"):
        run(definition_of("pass"))


LOGS = {
    "a.csv": 'Version 1\ntime ; "my gap [m]" ; hit\n0;1.5;false\n0.5;2;TRUE\n',
    "a.jsonl": '{"time": 0, "my gap [m]": 1.5, "hit": false}\n{"time": 0.5, "my gap [m]": 2, "hit": true}\n',
    "a.json": '{"time": [1e9, 1000000000.5], "my gap [m]": [1.5, 2], "hit": [0, 1]}',
}


@pytest.mark.parametrize("name", LOGS)
def test_logs_are_read_in_all_formats(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(LOGS[name])
    source = SignalSource.of({"file": name, "columns": {"free_m": "`my gap [m]` - 1"}})
    time_s, signals = source.read(tmp_path, ["free_m", "hit"])
    assert time_s.tolist() == [0, 0.5]
    assert {key: values.tolist() for key, values in signals.items()} == {"free_m": [0.5, 1.0], "hit": [0, 1]}


@pytest.mark.parametrize(
    "document",
    [
        None,
        {},
        {"file": "../log.csv"},
        {"file": "/etc/passwd.csv"},
        {"file": "log.mat"},
        {"file": "log.csv", "columns": {"a": "__import__('os').system('id')"}},
        {"file": "log.csv", "columns": {"a": "b > 1"}},
        {"file": "log.csv", "shell": "id"},
    ],
)
def test_wrong_signals_are_refused(document: object) -> None:
    with pytest.raises(SignalError, match=r"expected|allowed"):
        SignalSource.of(document)


def test_a_recorded_episode_has_its_signals_and_a_drive_from_above() -> None:
    script = """
with open("log.csv", "w") as log:
    log.write("time,x,y\\n" + "".join(f"{n / 100},{500_000 + n},{n}\\n" for n in range(7000)))
"""
    simulator = CommandSimulator(definition_of(script), "0")
    positions = {"ego": ["x", "y"], "lead": ["ahead", "y"]}
    columns = {"twice": "2 * x - 1e6", "ahead": "x + 20"}
    recorded = simulator.run(spec_of(simulator, {"x": 1}, columns=columns, positions=positions), record=True)
    assert recorded.trace is not None
    trace = Trace.from_bytes(recorded.trace)
    assert trace.signals["twice"][:3].tolist() == [0, 6, 12]  # every third sample
    assert trace.time_s.shape == trace.signals["twice"].shape == trace.robustness["high"].shape
    x_m, y_m, yaw_rad, speed_mps, _ = trace.ego[1]
    assert (x_m, y_m) == (3, 3)  # from where the ego was at first
    assert (yaw_rad, speed_mps) == pytest.approx((math.pi / 4, math.hypot(100, 100)), rel=1e-3)
    assert trace.actors[0].motion[1].tolist()[:2] == [23, 3]

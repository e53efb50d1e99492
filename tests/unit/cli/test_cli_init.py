"""`brink init`: campaign files from options, from questions and from OpenSCENARIO files."""

import json
import sys
from pathlib import Path

import pytest
from support.logical_scenarios import (
    CASES,
    Case,
    N,
    V,
    declared,
    deterministic,
    likely,
    stochastic,
    value_set,
)
from typer.testing import CliRunner

from brink.cli import init as module
from brink.cli.commands import app
from brink.server.campaigns.body import read_campaign_file
from brink.server.campaigns.plan import make_checked_plan
from brink.server.errors import InvalidInput

SIMULATOR = """
import re
text = open('scenario.xosc').read()
values = [float(one) for one in re.findall(r'parameterType="(?:double|int)" value="([-0-9.e]+)"', text)]
open('log.csv', 'w').write(f'time,gap_m\\n0,{values[0]}\\n1,{values[0] - 12}\\n')
"""
SCENARIO = Case(declarations=(V, N, declared("car", "string", "van")), space={}).scenario


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "roads").mkdir()
    (tmp_path / "roads" / "a.xodr").write_text("<OpenDRIVE/>")
    road = '<RoadNetwork><LogicFile filepath="roads/a.xodr"/></RoadNetwork>'
    (tmp_path / "scenario.xosc").write_text(SCENARIO.replace("<RoadNetwork/>", road))
    (tmp_path / "sim.py").write_text(SIMULATOR)
    return tmp_path


def brink(*arguments: str, answers: str = "") -> tuple[int, str]:
    done = CliRunner().invoke(app, arguments, input=answers)
    if done.exception is not None and not isinstance(done.exception, InvalidInput | SystemExit):
        raise done.exception
    raised = done.exception if isinstance(done.exception, InvalidInput) else ""
    return done.exit_code, " ".join(f"{done.output}{raised}".split())


def test_a_scenario_becomes_a_campaign_that_can_be_tried_as_it_is(folder: Path) -> None:
    status, text = brink(
        "init", "--from", "scenario.xosc", "--range", "v=10:35", "--range", "car=van,bus", "--keep", "n",
        *("--command", f"{sys.executable} sim.py {{seed}}", "--requirement", "gap_m > 5", "--unit", "m"),
            *("--out", "cut-in.yaml"),
    )  # fmt: skip
    assert (status, "10 to 35" in text, "brink try cut-in.yaml" in text) == (0, True, True)
    campaign = (folder / "cut-in.yaml").read_text()
    assert "copies: {sim.py: sim.py, a.xodr: roads/a.xodr}" in campaign
    assert "requirements:\n      safe: {stl: always (gap_m > 5), unit: m}" in campaign
    assert 'filepath="a.xodr"' in (folder / "cut-in-template.xosc").read_text()
    make_checked_plan(read_campaign_file(folder / "cut-in.yaml"))
    for value, verdict in (("20", "held"), ("12", "violated at 1.00 s")):
        status, text = brink("try", "cut-in.yaml", "--set", f"v={value}")
        assert (status, f"safe: {verdict}" in text) == (0, True)
    before = campaign
    assert "cut-in.yaml exists" in brink("init", "--from", "scenario.xosc", "--out", "cut-in.yaml")[1]
    assert (folder / "cut-in.yaml").read_text() == before
    again = ("--from", "cut-in-template.xosc", "--out", "cut-in.yaml", "--force")
    assert "cut-in-template.xosc is read: name another file" in brink("init", *again)[1]


def test_a_distribution_file_alone_names_its_scenario(folder: Path) -> None:
    (folder / "variation.xosc").write_text(CASES["mixed"].distribution or "")
    (folder / "scenario.xosc").write_text(CASES["mixed"].scenario)
    status, text = brink("init", "--from", "variation.xosc", "--out", "mixed.yaml", "--json")
    assert status == 0
    document = json.loads(text)
    laws = {one["name"]: one["distribution"] for one in document["parameters"]}
    assert laws == CASES["mixed"].laws
    assert document["constraints"] == list(CASES["mixed"].constraints)
    assert set(document["edit"]) == {"command", "requirements"}
    assert "budget: {simulations: 100}" in (folder / "mixed.yaml").read_text()
    (folder / "scenario.xosc").unlink()
    status, text = brink("init", "--from", "variation.xosc", "--out", "other.yaml")
    assert (status, "line 5: ScenarioFile: its scenario scenario.xosc is not there" in text) == (1, True)
    assert not (folder / "other.yaml").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--from", "scenario.xosc"), "--out: expected the name"),
        (("--from", "scenario.xosc", "--out", "a.txt"), "ends in .yaml or .yml"),
        (("--from", "scenario.xosc", "--out", "a.yaml"), "ParameterDeclaration car: no range"),
        (("--from", "scenario.xosc", "--range", "w=1:2", "--out", "a.yaml"), "no parameter is called 'w'"),
        (("--from", "scenario.xosc", "--range", "v=2:1", "--out", "a.yaml"), "v: expected LOW:HIGH"),
        (("--from", "scenario.xosc", "--range", "n=0.5,2", "--out", "a.yaml"), "of the type int"),
        (("--from", "nothing.xosc", "--out", "a.yaml"), "cannot be read: No such file"),
        (("--command", "sim {x}", "--out", "a.yaml"), "expected at least one parameter"),
        (("--command", "sim {y}", "--range", "x=1:2", "--out", "a.yaml"), "no parameter is called 'y'"),
        (("--command", "sim '{x}", "--range", "x=1:2", "--out", "a.yaml"), "No closing quotation"),
        (("--range", "x=1:2", "--out", "a.yaml"), "expected --command"),
        (("--command", "sim {x}", "--range", "x=1:2", "--requirement", "(", "--out", "a.yaml"), "requirements"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused_and_nothing_is_written(
    folder: Path, arguments: tuple[str, ...], words: str
) -> None:
    before = sorted(folder.iterdir())
    status, text = brink("init", *arguments)
    assert status
    assert words in text
    assert sorted(folder.iterdir()) == before


def test_a_terminal_is_asked_for_what_is_missing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_is_terminal", lambda: True)
    answers = [
        "scenario.xosc",
        "asked.yaml",
        "10:35:5",
        "",
        "van,bus",
        f"{sys.executable} sim.py",
        "gap_m > 5",
    ]
    status, text = brink("init", answers="\n".join(answers) + "\n")
    assert (status, "n (int)" in text) == (0, True)
    body = make_checked_plan(read_campaign_file(folder / "asked.yaml")).body
    assert body.problem.params["space"]["scenario"] == {
        "v": {"min": 10.0, "max": 35.0, "step": 5.0},
        "car": {"values": ["van", "bus"]},
    }
    answers = [
        "",
        "plain.yaml",
        f"{sys.executable} sim.py {{gap}} {{road}}",
        "gap=5:60",
        "road=dry,wet",
        "",
        "",
    ]
    assert brink("init", answers="\n".join(answers) + "\n")[0] == 0
    body = make_checked_plan(read_campaign_file(folder / "plain.yaml")).body
    assert body.problem.params["space"]["scenario"] == {
        "gap": {"min": 5, "max": 60},
        "road": {"values": ["dry", "wet"]},
    }


def test_a_cut_distribution_says_how_much_of_it_is_left(folder: Path) -> None:
    normal = likely("v", '<NormalDistribution expectedValue="20" variance="9"/>')
    (folder / "variation.xosc").write_text(stochastic(normal))
    given = ("--from", "scenario.xosc", "--distribution", "variation.xosc", "--range", "v=20:35")
    assert "v: 20 to 35 has 50.0% of the probability" in brink("init", *given, "--out", "a.yaml")[1]
    (folder / "variation.xosc").write_text(deterministic(value_set("v", "1")))
    assert "each has a single value" in brink("init", *given[:4], "--out", "b.yaml")[1]

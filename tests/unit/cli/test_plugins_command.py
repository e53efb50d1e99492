"""`brink plugins` lists plug-ins and checks them: a broken one of each kind is found."""

import json
import re
from dataclasses import replace
from typing import Any

import pytest
from support.problems import REQUIREMENT, SIMULATOR, Ball, Line
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search.algorithm import Scored
from brink.search.algorithms.random_search import RandomSearch
from brink.server.problems.catalogue import ALGORITHMS, PROBLEMS
from brink.sim import catalogue
from brink.sim.catalogue import REQUIREMENTS, SIMULATORS, register
from brink.sim.episode import EpisodeResult, EpisodeSpec, Verdict
from brink.sim.requirements import FrontGap


class Simulator:
    """A sound simulator of the ball."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        spec.check_for(SIMULATOR, longest_s=1.0)
        x, y = float(str(spec.scenario["x"])), float(str(spec.behaviour["y"]))
        margin = self.margin(x * x + y * y)
        verdict = Verdict(robustness=margin, unit="m", violated_at_s=None)
        return EpisodeResult(
            verdicts={REQUIREMENT: verdict}, objectives={"distance": margin}, features={}, provenance={}
        )

    def margin(self, square: float) -> float:
        return square - 1.0


class Forgetful(Simulator):
    """Its results depend on what ran before."""

    runs = 0

    def margin(self, square: float) -> float:
        self.runs += 1
        return square + self.runs


class Fickle(Line):
    """Its verdicts differ from call to call."""

    id = "fickle@1"
    calls = 0

    def evaluate(self, vectors: Any) -> Scored:
        Fickle.calls += 1
        evaluation = super().evaluate(vectors)
        assert isinstance(evaluation, Scored)
        return replace(evaluation, robustness=float(Fickle.calls))


class Endless(FrontGap):
    """Its horizon is not finite."""

    horizon = float("inf")


class Stuck(RandomSearch):
    """It never finishes asking."""

    id = "stuck@1"

    def ask(self, state: Any) -> Any:
        asked, candidates = super().ask(state)
        return asked, candidates[1:]


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Registers plug-ins for one test alone."""
    monkeypatch.setattr(catalogue, "_registered", {})
    register(PROBLEMS, Ball.id, Ball)


def checked(*ids: str, status: int) -> dict[str, str]:
    """Check plug-ins; return what is said of each."""
    answer = CliRunner().invoke(app, ["plugins", "check", *ids, "--json"])
    assert answer.exit_code == status, answer.output
    return {one["id"]: one["words"] for one in json.loads(answer.stdout)}


@pytest.mark.usefixtures("registered")
def test_sound_plugins_pass() -> None:
    register(SIMULATORS, SIMULATOR, Simulator)
    register(PROBLEMS, Line.id, Line)
    words = checked(status=0)
    assert set(words) == {Ball.id, SIMULATOR, Line.id}
    assert words[Ball.id] == "passed, with its simulator"


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize(
    ("group", "plugin_id", "factory", "checked_id", "clause"),
    [
        (SIMULATORS, SIMULATOR, Forgetful, Ball.id, "equal results of equal specifications"),
        (PROBLEMS, Fickle.id, Fickle, Fickle.id, "the same evaluation again"),
        (REQUIREMENTS, "endless@1", Endless, "endless@1", "the horizon is finite"),
        (ALGORITHMS, Stuck.id, Stuck, Stuck.id, "ContractBroken"),
    ],
)
def test_a_broken_plugin_is_found(
    group: str, plugin_id: str, factory: type, checked_id: str, clause: str
) -> None:
    register(group, plugin_id, factory)
    assert clause in checked(checked_id, status=1)[checked_id]


@pytest.mark.usefixtures("registered")
def test_a_problem_without_its_simulator_is_told() -> None:
    assert "unknown id 'faulty@1'" in checked(Ball.id, status=1)[Ball.id]


@pytest.mark.usefixtures("registered")
def test_plugins_are_listed_with_their_source() -> None:
    answer = CliRunner().invoke(app, ["plugins", "list", "--json"])
    found = {one["id"]: one["source"] for one in json.loads(answer.stdout)}
    assert found["edge@1"] is None
    assert len(found[Ball.id]) == 64
    assert "ball@1" in CliRunner().invoke(app, ["plugins", "list"]).stdout


def test_an_unknown_plugin_is_wrong_usage() -> None:
    assert CliRunner().invoke(app, ["plugins", "check", "no-such@1"]).exit_code == 2
    assert CliRunner().invoke(app, ["plugins", "show", "no-such@1"]).exit_code == 2
    assert "did you mean 'edge@2'?" in CliRunner().invoke(app, ["plugins", "show", "edge@3"]).output


@pytest.mark.parametrize("plugin_id", ["tolerance@1", "urban-errors@1", "gymnasium@1"])
def test_every_parameter_is_shown_with_its_meaning(plugin_id: str) -> None:
    """The documentation leaves these lists to the command."""
    described = json.loads(CliRunner().invoke(app, ["plugins", "show", plugin_id, "--json"]).stdout)
    lines = CliRunner().invoke(app, ["plugins", "show", plugin_id]).stdout.splitlines()
    shown = {words[0]: len(words) for line in lines if (words := line.split())}
    for name, parameter in described["params"]["properties"].items():
        assert parameter["description"]
        assert shown[name] >= 3
    for component in (described.get("space") or {"components": []})["components"]:
        assert {f"{component['name']}.{one['name']}" for one in component["parameters"]} <= set(shown)


def test_ranges_defaults_and_resolutions_are_shown() -> None:
    output = CliRunner().invoke(app, ["plugins", "show", "rate@1"]).stdout
    assert re.search(r"first +0\.2 +above 0 to 1 +Share of the budget", output)
    output = CliRunner().invoke(app, ["plugins", "show", "gymnasium@1"]).stdout
    assert re.search(r"behaviour\.perturbation_1\.from_step +0 to 499 +steps +1\b", output)


def test_a_recording_as_a_default_is_cut() -> None:
    shown = CliRunner().invoke(app, ["plugins", "show", "commonroad@1"]).stdout
    assert 1 <= len(re.findall(r"[A-Za-z0-9+/]{40,}", shown)) <= 2

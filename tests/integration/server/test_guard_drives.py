"""`brink guard drive`: drives without and with a guard, on the command line, with what it writes."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from support.guards import stump_guard
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.guard.loop import drive_with_guard, thresholds_around
from brink.guard.sight import Reported
from brink.server.problems.catalogue import make_problem
from brink.sim.guard.option import GuardOption

SMALL = ["--drives", "4", "--seeds", "2", "--processes", "1", "--threshold", "0.4", "--threshold", "0.6"]


def called(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["guard", "drive", *arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


def refused(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["guard", "drive", *arguments])
    assert done.exit_code != 0
    return done.output + str(done.exception)


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("guard") / "drives"
    return json.loads(called("range-ttc@1", *SMALL, "--out", str(out), "--pictures", "1", "--json")), out


def test_the_same_drives_run_without_and_with_the_guard(driven: tuple[dict[str, Any], Path]) -> None:
    document, out = driven

    assert document["drives"] == 8
    assert len(document["seeds"]) == 2
    assert document["guard"]["fallback"] == "safe-stop@1"
    assert [one["threshold"] for one in document["conditions"]] == [0.4, 0.6]
    for condition in document["conditions"]:
        worth = condition["worth"]
        assert worth["violations_with"] == worth["violations_without"] - worth["prevented"] + worth["caused"]
        counted = condition["by_requirement"]["front-gap@1"]
        assert counted == {"without": worth["violations_without"], "with": worth["violations_with"]}
        reports = condition["violations_by_report"]
        assert sum(row["violations"] for row in reports) == worth["violations_without"]
        assert sum(row["prevented"] for row in reports) == worth["prevented"]
    assert json.loads((out / "drives.json").read_text(encoding="utf-8")) == document


def test_it_draws_the_trade_off_and_a_prevented_violation(driven: tuple[dict[str, Any], Path]) -> None:
    document, out = driven

    assert any(condition["worth"]["prevented"] for condition in document["conditions"])
    for name in ("trade-off.png", "prevented-1.png"):
        with Image.open(out / name) as picture:
            assert picture.width >= 1600


def test_it_prints_a_line_for_each_threshold_and_what_was_reported() -> None:
    text = called("ttc@1", *SMALL)

    assert "8 drives of 2 seeds" in text
    assert all(f"{threshold} " in text for threshold in ("0.400", "0.600"))
    assert "reported in the 3 s before" in text


def test_a_fallback_that_does_nothing_prevents_and_causes_nothing() -> None:
    problem = make_problem("urban-injected@1", {})
    option = GuardOption.of("range-ttc@1", fallback="none@1")

    loop = drive_with_guard(problem, option, [0.5], drives=4, seeds=[3])

    worth = loop.worth(loop.conditions[0])
    assert (worth.prevented, worth.caused) == (0, 0)
    assert worth.distance_lost.value == 0.0
    assert [one.way_m for one in loop.without] == [one.way_m for one in loop.conditions[0].outcomes]
    assert any(one.alarms_s for one in loop.conditions[0].outcomes)


def test_two_processes_give_what_one_gives() -> None:
    problem, option = make_problem("urban-injected@1", {}), GuardOption.of("ttc@1")

    alone, shared = (
        drive_with_guard(problem, option, [0.5], drives=5, seeds=[4], processes=processes)
        for processes in (1, 2)
    )

    assert list(alone.without) == list(shared.without)
    assert list(alone.conditions[0].outcomes) == list(shared.conditions[0].outcomes)
    assert list(alone.sights) == list(shared.sights)


def test_a_violation_by_a_detector_that_reports_nothing_is_one_of_nothing_reported() -> None:
    problem, option = make_problem("urban-injected@1", {}), GuardOption.of("ttc@1", fallback="none@1")
    loop = drive_with_guard(problem, option, [0.5], drives=30, seeds=[5])

    silent = [
        sight
        for spec, sight in zip(loop.specs, loop.sights, strict=True)
        if sight is not None and not spec.behaviour["trajectories"]
    ]
    assert silent
    assert {sight.reported for sight in silent} <= {Reported.NOTHING, Reported.NO_ROAD_USER}
    assert not any(sight.ever for sight in silent)
    assert any(sight.in_range for sight in silent)


def test_scenarios_that_a_guard_has_met_are_told_apart(tmp_path: Path) -> None:
    file = fitted(tmp_path, drives=1500, seed=1)

    text = called(
        str(file), "--drives", "8", "--seeds", "1", "--processes", "1", "--threshold", "0.9", "--json"
    )

    (condition,) = json.loads(text)["conditions"]
    parts = condition["parts"]
    assert set(parts) == {"scenario seen, behaviour unseen", "scenario and behaviour unseen"}
    assert sum(one["drives"] for one in parts.values()) == 8
    assert sum(one["prevented"] for one in parts.values()) == condition["worth"]["prevented"]


def test_a_guard_is_not_driven_on_what_it_was_fitted_to(tmp_path: Path) -> None:
    file = fitted(tmp_path, drives=10, seed=7)

    said = refused(str(file), "--drives", "1", "--seeds", "3", "--first-seed", "5")

    assert "was fitted to random drives of seed 7" in said


def fitted(folder: Path, *, drives: int, seed: int) -> Path:
    """Write a guard that says it was fitted to random drives."""
    model = stump_guard()
    about = {**model.about, "campaigns": [], "random": {"drives": drives, "seed": seed}}
    file = folder / "guard.json"
    file.write_text(replace(model, about=about).to_json(), encoding="utf-8")
    return file


def test_thresholds_lie_around_a_guards_own() -> None:
    around = thresholds_around(0.2)

    assert around == tuple(sorted(around))
    assert around[2] == pytest.approx(0.2)
    assert around[0] / (1 - around[0]) == pytest.approx(0.25 / 4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.json"], "nowhere.json"),
        (["ttc@1", "--fallback", "safe-stop@9"], "did you mean 'safe-stop@1'"),
        (["ttc@1", "--setting", "decel_mps2"], "expected NAME=VALUE"),
        (["ttc@1", "--setting", "decel_mps2=99"], "decel_mps2"),
        (["ttc@1", "--problem", "aeb-crossing@1"], "a guard watches urban drives"),
    ],
)
def test_what_cannot_be_driven_is_refused_before_anything_runs(arguments: list[str], message: str) -> None:
    assert message in refused(*arguments, "--drives", "1", "--seeds", "1")

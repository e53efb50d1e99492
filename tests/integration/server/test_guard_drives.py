"""`brink guard drive`: drives without and with a guard, on the command line, with what it writes."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.guards import drive_with, stump_guard
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.cli.guard_drive import _choice
from brink.cli.options import named_values, read_odd
from brink.guard import loop as loop_module
from brink.guard.drives import check_problem, random_specs
from brink.guard.loop import Condition, GuardedLoop, Outcome, drive_with_guard, run_drive
from brink.guard.seen import SeenDrives
from brink.server.problems.catalogue import make_problem
from brink.sim.episode import EpisodeSpec
from brink.sim.guard.option import GuardOption

pytestmark = pytest.mark.long("simulates drives; guards have unit tests")

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
        assert worth["prevented_entirely"] <= worth["prevented"]
    assert json.loads((out / "drives.json").read_text(encoding="utf-8")) == document


def test_a_fallback_that_does_nothing_prevents_and_causes_nothing() -> None:
    problem = make_problem("urban-injected@1", {})
    option = GuardOption.of("range-ttc@1", fallback="none@1")

    loop = drive_with_guard(problem, option, [0.5], drives=4, seeds=[3])

    worth = loop.worth(loop.conditions[0])
    assert (worth.prevented, worth.caused) == (0, 0)
    assert worth.distance_lost.value == 0.0
    assert [one.way_m for one in loop.without] == [one.way_m for one in loop.conditions[0].outcomes]
    assert any(one.alarms_s for one in loop.conditions[0].outcomes)


def test_the_same_solution_with_another_seed_is_not_fresh_unless_nothing_is_reported() -> None:
    problem = check_problem(make_problem("urban-injected@1", {}))
    learned = random_specs(problem, 100, 1)
    seen = seen_in(learned)
    silent = sum(not spec.behaviour["trajectories"] for spec in learned)

    assert seen.repeats(learned) == 100
    assert seen.repeats([replace(spec, seed=spec.seed + 1) for spec in learned]) == 100 - silent < 100
    assert seen.repeats(random_specs(problem, 100, 2)) == 0


def seen_in(specs: Sequence[EpisodeSpec]) -> SeenDrives:
    return SeenDrives.of(drive_with([0.0], spec=spec) for spec in specs)


def test_a_guard_drives_its_own_problem_unless_another_one_is_named() -> None:
    own: dict[str, Any] = {
        "id": "urban-errors@1",
        "params": {"duration_s": 12.0, "odd": {"scenario.weather": "clear"}},
    }
    model = replace(stump_guard(), about={"problem": own})

    def chosen(*given: str, problem: str | None = None, odd: Sequence[str] = ()) -> dict[str, Any]:
        params = named_values("--param", given, "x=1") | ({"odd": read_odd(odd)} if odd else {})
        return _choice(model, problem, params, ()).model_dump()

    requirement = {"requirement": ["front-gap@1"]}
    assert chosen() == {"id": "urban-errors@1", "params": {**own["params"], **requirement}}
    assert chosen("duration_s=20")["params"]["duration_s"] == 20
    assert chosen(odd=["scenario.road_id=1"])["params"]["odd"] == {
        "scenario.weather": "clear",
        "scenario.road_id": 1,
    }
    assert chosen(problem="urban-injected@1") == {"id": "urban-injected@1", "params": requirement}
    unfitted = _choice(None, None, {}, ()).model_dump()
    assert unfitted == {"id": "urban-injected@1", "params": {}}


def test_a_guard_is_not_driven_on_what_it_was_fitted_to(tmp_path: Path) -> None:
    file = tmp_path / "guard.json"
    about = {**stump_guard().about, "random": {"drives": 10, "seed": 7}}
    replace(stump_guard(), about=about).save(file)
    said = refused(str(file), "--drives", "1", "--seeds", "3", "--first-seed", "5")
    assert "was fitted to random drives of seed 7" in said

    problem = check_problem(make_problem("urban-injected@1", {}))
    about = {**stump_guard().about, "seen": seen_in(random_specs(problem, 4, 7)).to_json()}
    replace(stump_guard(), about=about).save(file)
    said = refused(str(file), "--drives", "4", "--seeds", "3", "--first-seed", "5")
    assert "was fitted to 4 of the 4 solutions of seed 7" in said


def test_drives_without_an_alarm_do_not_run_again_and_give_the_same_results(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = make_problem("urban-injected@1", {"duration_s": 12.0})
    option = GuardOption.of("range-ttc@1")
    ran: list[EpisodeSpec] = []

    def counted(spec: EpisodeSpec) -> Outcome:
        ran.append(spec)
        return run_drive(spec)

    monkeypatch.setattr(loop_module, "run_drive", counted)
    skipping = drive_with_guard(problem, option, [0.3, 0.6, 0.9], drives=5, seeds=[11])
    fewer = len(ran)
    monkeypatch.setattr(loop_module, "_may_differ", lambda *_: True)
    every = drive_with_guard(problem, option, [0.3, 0.6, 0.9], drives=5, seeds=[11])

    assert fewer < len(ran) - fewer == 4 * 5
    for skipped, run in zip(skipping.conditions, every.conditions, strict=True):
        assert list(skipped.outcomes) == list(run.outcomes)


def made_up(falls: Sequence[Sequence[int]], lost: Sequence[float]) -> GuardedLoop:
    """Return a loop of four seeds with five drives each, four of which violate the requirement.

    Args:
        falls: For each condition, the number of violations that it prevents in the drives of each seed.
        lost: For each condition, the share of distance lost in safe drives.
    """
    (spec,) = random_specs(check_problem(make_problem("urban-injected@1", {})), 1, 1)
    unsafe, safe = {"front-gap@1": 1.0}, dict[str, float]()
    without = [
        Outcome(violated_at_s=unsafe if i < 4 else safe, way_m=100.0, time_s=10.0)
        for _ in range(4)
        for i in range(5)
    ]
    conditions = [
        Condition(
            threshold=0.1 * (1 + place),
            option=GuardOption.of("ttc@1"),
            outcomes=[
                Outcome(
                    violated_at_s=unsafe if prevented <= i < 4 else safe,
                    way_m=300.0 if i < 4 else 100.0 * (1.0 - share),
                    time_s=10.0,
                )
                for prevented in each
                for i in range(5)
            ],
        )
        for place, (each, share) in enumerate(zip(falls, lost, strict=True))
    ]
    return GuardedLoop(
        requirements=("front-gap@1",),
        specs=[spec] * 20,
        seed=[s for s in range(4) for _ in range(5)],
        without=without,
        sights=[None] * 20,
        conditions=conditions,
    )


def test_a_threshold_is_chosen_on_half_of_the_seeds_and_reported_on_the_others() -> None:
    loop = made_up([(4, 4, 1, 1), (3, 3, 3, 3)], [0.0, 0.0])

    best, counts = loop.shown()

    assert best is loop.recommended() is loop.conditions[0], "it looks best on the first half"
    assert counts.tolist() == [False] * 10 + [True] * 10
    assert loop.worth(best, counts).reduction.value == pytest.approx(0.25), "and is not on the other"


def test_the_loss_limit_is_about_drives_that_are_safe_without_the_guard() -> None:
    """Prevented collisions let the car drive on, so the distance of all drives grows under both conditions."""
    loop = made_up([(4, 4, 4, 4), (2, 2, 2, 2)], [0.2, 0.04])

    assert (loop.worth(loop.conditions[0]).distance_lost.value or 0.0) < 0.0
    assert loop.recommended() is loop.conditions[1]
    assert loop.recommended(0.5) is loop.conditions[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.json"], "nowhere.json"),
        (["ttc@1", "--fallback", "safe-stop@9"], "did you mean 'safe-stop@1'"),
        (["ttc@1", "--setting", "decel_mps2"], "expected NAME=VALUE"),
        (["ttc@1", "--setting", "decel_mps2=99"], "decel_mps2"),
        (["ttc@1", "--problem", "aeb-crossing@1"], "a guard watches urban drives"),
        (["ttc@1", "--param", "trajectories"], "expected NAME=VALUE"),
        (["ttc@1", "--out", __file__], "expected a folder"),
    ],
)
def test_what_cannot_be_driven_is_refused_before_anything_runs(arguments: list[str], message: str) -> None:
    assert message in refused(*arguments, "--drives", "1", "--seeds", "1")

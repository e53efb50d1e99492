"""The parameter `odd` of every problem: what it limits, how it is stored, and how wrong ones are refused."""

from typing import Any

import numpy as np
import pytest
from support.api import ball

from brink.cli.options import read_odd
from brink.search.odd import odd_of
from brink.search.parameters import Categorical
from brink.server.campaigns.body import CampaignBody, parse_body
from brink.server.campaigns.plan import make_plan
from brink.server.campaigns.store import stored_body
from brink.server.errors import InvalidInput
from brink.server.problems.base import SimulatedProblem
from brink.server.problems.catalogue import make_problem

WEATHER = {"scenario.weather": ["clear", "hard_rain"]}
URBAN = {
    "name": "x",
    "problem": {"id": "urban-injected@1", "params": {"odd": WEATHER}},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 20},
}


def error_of(problem: str, odd: object) -> tuple[str, str]:
    with pytest.raises(InvalidInput) as refused:
        make_problem(problem, {"odd": odd})
    (error,) = refused.value.errors
    return error.pointer, error.message


@pytest.mark.parametrize(
    ("problem", "odd"),
    [
        ("urban-injected@1", {"scenario.pedestrians": 0, "behaviour.trajectory_*.label": ["null", "person"]}),
        ("urban-camera@1", WEATHER),
        ("urban-errors@1", {**WEATHER, "behaviour.error_*.severity": {"max": 0.5}}),
        ("npc-actions@1", {"participants.p*.kind": ["none", "car"]}),
        ("mtq@1", {"x.x": {"min": 0.2, "max": 0.4}}),
    ],
)
def test_every_problem_takes_an_odd(problem: str, odd: dict[str, Any]) -> None:
    names = make_problem(problem, {}).space.column_names()
    odd = {name if "*" in name or name in names else names[0]: limit for name, limit in odd.items()}
    if problem == "npc-actions@1":
        odd = {name.replace("participants", names[0].partition(".")[0]): one for name, one in odd.items()}
    made, rng = make_problem(problem, {"odd": odd}), np.random.default_rng(1)
    assert odd_of(made.space)
    for _ in range(20):
        made.space.check(made.space.sample(rng))


def within(problem: str, odd: dict[str, Any]) -> CampaignBody:
    return parse_body({**URBAN, "problem": {"id": problem, "params": {"odd": odd}}})


def test_a_plan_spells_the_odd_out_and_keeps_it_for_stored_campaigns() -> None:
    plan = make_plan(within("urban-injected@1", {"*.trajectory_*.label": ["null", "person"]}))
    stored = plan.body.problem.params["odd"]
    assert stored == {f"behaviour.trajectory_{n}.label": ["null", "person"] for n in (1, 2)}
    again = make_plan(stored_body(plan.body.document(), (), ""))
    assert odd_of(again.problem.space) == stored


def test_without_an_odd_nothing_about_a_campaign_changes() -> None:
    weather = make_problem("urban-injected@1", {}).space.components[0].by_name["weather"]
    assert isinstance(weather, Categorical)
    bodies = [
        parse_body({**URBAN, "problem": {"id": "urban-injected@1"}}),
        within("urban-injected@1", {}),
        within("urban-injected@1", {"scenario.weather": list(weather.choices)}),
    ]
    documents = [make_plan(body).body.document() for body in bodies]
    assert "odd" not in documents[0]["problem"]["params"]
    assert documents[0] == documents[1] == documents[2]


def test_ground_truth_in_place_of_the_component_keeps_the_odd() -> None:
    plan = make_plan(parse_body({**URBAN, "ground_truth": True}))
    assert odd_of(plan.problem.space) == WEATHER
    assert isinstance(plan.problem, SimulatedProblem)
    assert plan.problem.with_truth() is None


def test_wrong_limits_are_refused_where_they_stand() -> None:
    pointer, message = error_of("urban-injected@1", {"scenario.wether": "clear"})
    assert pointer == "/problem/params/odd/scenario.wether"
    assert "did you mean 'scenario.weather'?" in message
    assert "known: scenario.weather" in message or "known: " in message
    pointer, message = error_of(
        "urban-injected@1", {"behaviour.trajectory_1.x_min_0_px": {"min": 500, "max": 900}}
    )
    assert pointer == "/problem/params/odd/behaviour.trajectory_1.x_min_0_px"
    assert "expected a number in [0, 800], got 900.0" in message
    pointer, message = error_of("urban-injected@1", {"behaviour.trajectory_1.x_max_0_px": {"max": 20}})
    assert (pointer, "can be 50 above" in message) == ("/problem/params/odd", True)
    pointer, message = error_of("urban-injected@1", ["clear"])
    assert (pointer, "expected limits by parameter" in message) == ("/problem/params/odd", True)


def test_the_option_of_commands_reads_the_forms_of_campaign_files() -> None:
    given = ["scenario.weather=[clear, hard_rain]", "a.speed={min: 5, max: 12}", "a.x=3", "a.label=rain"]
    assert read_odd(given) == {
        "scenario.weather": ["clear", "hard_rain"],
        "a.speed": {"min": 5, "max": 12},
        "a.x": 3,
        "a.label": "rain",
    }
    assert read_odd(None) == {}
    for wrong in (["a.x"], ["=3"], ["a.x="], ["a.x=1", "a.x=2"], ["a.x={"]):
        with pytest.raises(InvalidInput):
            read_odd(wrong)


def test_limits_of_the_command_line_replace_those_of_the_file() -> None:
    body = parse_body(URBAN).within_odd({"scenario.weather": "clear", "scenario.pedestrians": 0})
    assert body.problem.params["odd"] == {"scenario.weather": "clear", "scenario.pedestrians": 0}
    assert parse_body(URBAN).within_odd({}) == parse_body(URBAN)


def test_a_later_field_does_not_change_the_hashes_of_older_submissions() -> None:
    body = parse_body(ball(start_from={"campaign": "ab12"}))
    assert "outside_odd" not in body.document()["start_from"]


def test_every_problem_takes_constraints_beside_an_odd() -> None:
    written = "crossing_m > 50 - 20 * arrival_s or weather == 'clear'"
    params = {"constraints": [written], "odd": {"scenario.crossing_m": {"max": 60}}}
    problem = make_problem("aeb-crossing@1", params)
    assert problem.space.constraints == [written]
    for seed in range(20):
        drive = problem.space.decode(problem.space.sample(np.random.default_rng(seed)))["scenario"]
        far = float(drive["crossing_m"]) > 50 - 20 * float(drive["arrival_s"])
        assert float(drive["crossing_m"]) <= 60
        assert far or drive["weather"] == "clear"


@pytest.mark.parametrize(
    ("constraints", "words"),
    [
        ("gap > 1", "expected a list of at most 50 conditions"),
        (["crossing > 1"], "did you mean 'crossing_m'"),
    ],
)
def test_a_wrong_constraint_is_refused_with_its_place(constraints: object, words: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        make_problem("aeb-crossing@1", {"constraints": constraints})
    (error,) = refused.value.errors
    assert error.pointer == "/problem/params/constraints"
    assert words in error.message

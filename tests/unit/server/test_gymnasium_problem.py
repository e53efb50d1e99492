"""The problem of Gymnasium environments: spaces from environments, episodes, activity and words."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from brink.search.archive import Archive, Neighbourhood
from brink.search.conclusions import Outcome
from brink.search.space import Categorical
from brink.server.campaigns.body import CampaignBody, parse_body
from brink.server.campaigns.plan import make_checked_plan, make_plan
from brink.server.campaigns.thresholds import find_thresholds
from brink.server.errors import InvalidInput
from brink.server.findings.thresholds.analysis import _sides
from brink.server.findings.thresholds.words import Amounts
from brink.server.problems import gymnasium_env
from brink.server.problems.base import NO_PART, SimulatedSolution, describe_candidate
from brink.server.problems.catalogue import check_extra, make_problem
from brink.server.problems.error_slots import NO_ERROR
from brink.server.problems.gymnasium_env import GymnasiumParams, GymnasiumProblem
from brink.sim.adapters.gymnasium_env.specification import (
    POLICIES,
    GymnasiumEpisode,
    Perturbation,
    PerturbationType,
)
from brink.sim.catalogue import PLUGINS_VARIABLE, make_simulator

ROOT = Path(__file__).resolve().parents[3]
CART_POLE = GymnasiumProblem(
    GymnasiumParams(perturbations=2, reset={"low": [-0.1, 0.0], "high": [0.0, 0.1]}, reset_seeds=50)
)
UPRIGHT: dict[str, Any] = {
    "upright": {"stl": "always[0:2] (abs(pole_angle) < 0.05 or reward == 0)", "unit": "rad"}
}
BIAS: dict[str, Any] = {
    "type": "bias",
    "dimension": "pole angle",
    "magnitude": 0.25,
    "from_step": 20,
    "steps": 100,
}
NONE: dict[str, Any] = {**BIAS, "type": NO_ERROR, "magnitude": 0.0, "from_step": 0, "steps": 0}
SCENARIO: dict[str, Any] = {"reset.low": -0.05, "reset.high": 0.05, "reset_seed": 3}


def candidate(*perturbations: dict[str, Any], **scenario: Any) -> tuple[Any, ...]:
    values = {
        f"perturbation_{number}.{name}": value
        for number, one in enumerate([*perturbations, NONE, NONE][:2], start=1)
        for name, value in one.items()
    }
    return CART_POLE.space.encode({"scenario": {**SCENARIO, **scenario}, "behaviour": values})


def change(safe: Any, unsafe: Any) -> str:
    names = CART_POLE.space.column_names()
    rows = [CART_POLE.space.join(one) for one in (safe, unsafe)]
    changed = [name for name, one, other in zip(names, *rows, strict=True) if one != other]
    return CART_POLE.words_of_change(
        SimulatedSolution(vectors=safe), SimulatedSolution(vectors=unsafe), changed
    )


def perturbation_of(problem: GymnasiumProblem, vectors: Any) -> Perturbation:
    """Return the only perturbation of a candidate."""
    (one,) = GymnasiumEpisode.from_spec(problem.episode(vectors, 1)).perturbations
    return one


@given(st.integers(0, 2**32 - 1))
def test_every_candidate_becomes_an_episode_that_the_simulator_accepts(seed: int) -> None:
    vectors = CART_POLE.space.sample(np.random.default_rng(seed))
    spec = CART_POLE.episode(vectors, seed)
    episode = GymnasiumEpisode.from_spec(spec)
    assert (episode.steps, episode.survive_steps, episode.reset_seed is None) == (500, 200, False)
    values = CART_POLE.space.decode(vectors)["behaviour"]
    kinds = [values[f"perturbation_{number}.type"] for number in (1, 2)]
    assert [one.type.value for one in episode.perturbations] == [kind for kind in kinds if kind != NO_ERROR]
    for one in episode.perturbations:
        assert f"{CART_POLE.params.observed[one.dimension][0]} " in CART_POLE.words(vectors)


def test_magnitudes_are_in_the_unit_of_the_observation() -> None:
    assert perturbation_of(CART_POLE, candidate(BIAS)) == Perturbation(
        type=PerturbationType.BIAS, dimension=2, magnitude=0.05, from_step=20, steps=100
    )
    assert perturbation_of(CART_POLE, candidate({**BIAS, "type": "gain"})).magnitude == 0.25
    assert perturbation_of(CART_POLE, candidate({**BIAS, "type": "freeze"})).magnitude == 0.0


def test_the_space_comes_from_the_environment() -> None:
    problem = GymnasiumProblem(
        GymnasiumParams(environment="Pendulum-v1", policy="my_policies:drive", make={"g": [8.0, 12.0]})
    )
    scenario, behaviour = problem.space.components
    assert [parameter.name for parameter in scenario.parameters] == ["make.g"]
    dimension = behaviour.parameters[1]
    assert isinstance(dimension, Categorical)
    assert dimension.choices == ("observation 0", "observation 1", "observation 2")
    assert [scale for _, scale in problem.params.observed] == [1.0, 1.0, 8.0]
    spec = problem.episode(problem.space.sample(np.random.default_rng(1)), 1)
    assert 8.0 <= spec.scenario["make"]["g"] <= 12.0  # type: ignore[index, call-overload, operator]
    assert spec.scenario["reset_seed"] is None


def test_the_default_problem_can_be_listed_without_gymnasium(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gymnasium_env, "find_spec", lambda module: None)
    assert isinstance(make_problem("gymnasium@1", {}), GymnasiumProblem)
    with pytest.raises(InvalidInput) as refused:
        make_problem("gymnasium@1", {"environment": "Pendulum-v1"})
    (error,) = refused.value.errors
    assert error.pointer == "/problem/params/environment"
    assert "Pendulum-v1 needs the gymnasium extra, which is not installed: " in error.message
    monkeypatch.setattr("brink.server.problems.catalogue.find_spec", lambda module: None)
    with pytest.raises(InvalidInput, match="gymnasium"):
        check_extra(CART_POLE)


@pytest.mark.parametrize(
    ("params", "field", "expected"),
    [
        ({"environment": "CartPole-v9"}, "environment", "VersionNotFound"),
        ({"environment": "FrozenLake-v1"}, "environment", "expected observations in a Box"),
        ({"survive_steps": 600}, "survive_steps", "expected at most steps (500), got 600"),
        ({"requirement": UPRIGHT, "margin": "a:b"}, "requirement", "expected none, because margin is given"),
        (
            {"requirement": {"upright": {"stl": "pole_angel < 1", "unit": "rad"}}},
            "requirement",
            "upright: no signal 'pole_angel' is recorded (did you mean 'pole_angle'?)",
        ),
        ({"types": ["bias", "drift"]}, "types", "expected some of bias, gain, noise, freeze, dropout"),
        ({"types": []}, "types", "expected some of"),
        ({"names": ["a"]}, "names", "expected 4, one for each number of the observation, got 1"),
        ({"scales": [1.0, 1.0, 0.0, 1.0]}, "scales", "expected numbers above 0"),
        ({"dimensions": [4]}, "dimensions", "expected different indices from 0 to 3"),
        ({"dimensions": [1, 1]}, "dimensions", "expected different indices from 0 to 3"),
        ({"make": {"g": [2.0, 1.0]}}, "make", "expected a least and a greater value of 'g'"),
        ({"names": ["a", "a", "b", "c"]}, "names", "expected different names"),
    ],
)
def test_wrong_parameters_are_refused(params: dict[str, Any], field: str, expected: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        make_problem("gymnasium@1", params)
    (error,) = refused.value.errors
    assert error.pointer == f"/problem/params/{field}"
    assert expected in error.message


def test_with_truth_nothing_is_perturbed() -> None:
    truth = CART_POLE.with_truth()
    assert truth is not None
    assert truth.episode(candidate(BIAS), 1).behaviour == {"perturbations": []}
    assert truth.words(candidate(BIAS)).endswith("; not perturbed")
    assert truth.with_truth() is None
    assert truth.activity(candidate(BIAS), {"perturbed_steps": []}) is None


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ({}, {"magnitude": 0.5}, "pole angle biased by +0.1 instead of +0.05"),
        ({}, {"from_step": 30}, "pole angle biased by +0.05, from step 30 instead of 20"),
        (
            {},
            {"steps": 10, "magnitude": -0.5},
            "pole angle biased by -0.1 instead of +0.05, for 10 steps instead of 100",
        ),
        (
            {"type": "gain"},
            {"type": "gain", "magnitude": -0.5},
            "pole angle changed by -50% instead of +25% of its value",
        ),
        (
            {},
            {"type": "freeze"},
            "pole angle frozen from step 20 on for 100 steps "
            "(in the safe episode, pole angle biased by +0.05 from step 20 on for 100 steps)",
        ),
    ],
)
def test_a_change_has_words(old: dict[str, Any], new: dict[str, Any], expected: str) -> None:
    assert change(candidate({**BIAS, **old}), candidate({**BIAS, **new})) == expected


def test_only_perturbations_that_had_an_effect_are_active() -> None:
    freeze = {**BIAS, "type": "freeze"}
    found = CART_POLE.activity(candidate(freeze, BIAS), {"perturbed_steps": [[20, 30], None]})
    assert found is not None
    names = CART_POLE.space.column_names()
    active = {name.partition(".")[2] for name, on in zip(names, found.active, strict=True) if on}
    assert active == {
        *SCENARIO,
        *(f"perturbation_1.{name}" for name in ("type", "dimension", "from_step", "steps")),
    }
    idle = CART_POLE.activity(candidate(BIAS), {"perturbed_steps": [None]})
    assert idle is not None
    assert describe_candidate(CART_POLE, candidate(BIAS), idle).endswith(f"; not perturbed; {NO_PART}")
    assert CART_POLE.activity(candidate(BIAS), {}) is None


@pytest.mark.parametrize(
    ("field", "given", "message"),
    [
        ("policy", "os:system", "expected MODULE:FUNCTION with a module that --plugin"),
        ("policy", "balance_cart_pole", "expected MODULE:FUNCTION with a module that --plugin"),
        ("policy", "", "expected MODULE:FUNCTION with a module that --plugin"),
        ("policy", f"{POLICIES}:nobody", "has no function 'nobody'"),
        ("policy", f"{POLICIES}:_CART_POLE_GAINS", "has no function '_CART_POLE_GAINS'"),
        ("policy", f"{POLICIES}:dataclass", "expected a function that .* defines, or lists in __all__"),
        ("margin", "os:system", "expected MODULE:FUNCTION with a module that --plugin"),
    ],
)
def test_functions_that_no_worker_would_call_are_refused_at_submission(
    field: str, given: str, message: str
) -> None:
    campaign: dict[str, Any] = {
        "name": "poles",
        "problem": {"id": "gymnasium@1", "params": {field: given}},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": 3},
    }
    with pytest.raises(InvalidInput, match=message) as caught:
        make_checked_plan(parse_body(campaign))
    assert [one.pointer for one in caught.value.errors] == [f"/problem/params/{field}"]


def test_the_policy_in_the_documentation_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "how-to" / "use-other-simulators.md").read_text()
    (module,) = re.findall(r"```python\n(# my_policies.py.*?)```", text, re.DOTALL)
    (campaign,) = re.findall(r"```yaml\n(# mountain_car.yaml.*?)```", text, re.DOTALL)
    (tmp_path / "my_policies.py").write_text(module)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(PLUGINS_VARIABLE, "my_policies")
    problem = make_problem("gymnasium@1", yaml.safe_load(campaign)["problem"]["params"])
    assert isinstance(problem, GymnasiumProblem)
    truth = problem.with_truth()
    assert truth is not None
    spec = truth.episode(problem.space.sample(np.random.default_rng(1)), 1)
    verdict = make_simulator("gymnasium@1").run(spec).verdicts["margin@1"]
    assert verdict.robustness >= 0


def test_short_episodes_need_no_word_about_how_long_they_must_survive() -> None:
    episodes = [
        GymnasiumEpisode.from_spec(one.episode(one.space.sample(np.random.default_rng(0)), 1))
        for one in (GymnasiumProblem(GymnasiumParams(steps=steps)) for steps in (50, 500))
    ]
    assert [episode.survive_steps for episode in episodes] == [50, 200]


def test_a_formula_over_the_true_observation_gives_the_verdict() -> None:
    problem = make_problem("gymnasium@1", {"requirement": UPRIGHT, "steps": 150})
    assert isinstance(problem, GymnasiumProblem)
    assert problem.requirements == ("upright",)
    simulator, verdicts = make_simulator("gymnasium@1"), []
    for bias in (0.5, 0.0):
        values = {f"perturbation_1.{name}": value for name, value in {**BIAS, "magnitude": bias}.items()}
        vectors = problem.space.encode({"behaviour": values})
        verdicts.append(simulator.run(problem.episode(vectors, 3)).verdicts["upright"])
    pushed, steady = verdicts
    assert (pushed.violated, steady.violated, pushed.unit) == (True, False, "rad")
    assert pushed.violated_at_s is not None
    assert 20 * 0.02 < pushed.violated_at_s <= 2.0


def test_a_threshold_between_two_numbers_of_steps_names_different_ones() -> None:
    body = {"name": "g", "problem": {"id": "gymnasium@1"}, "algorithm": {"id": "random@1"}, "seed": 1}
    plan = make_plan(CampaignBody.model_validate(body | {"budget": {"simulations": 48}}))
    space = plan.problem.space
    row = space.join(space.sample(np.random.default_rng(1))).copy()
    names = list(space.column_names())
    row[names.index("behaviour.perturbation_1.type")] = 1.0
    row[names.index("behaviour.perturbation_1.from_step")] = 20.0
    column = names.index("behaviour.perturbation_1.steps")
    rows = np.tile(row, (48, 1))
    rows[:, column] = np.tile([2, 3, 4, 5, 6, 7, 8, 9], 6)
    unsafe = (rows[:, column] > 4) | ((rows[:, column] == 4) & (np.arange(48) % 16 < 8))
    archive = Archive.empty(space, Neighbourhood()).grown(
        list(range(48)), rows, unsafe.tolist(), np.where(unsafe, -1.0, 1.0).tolist()
    )
    (one,) = find_thresholds(archive, plan, np.ones(48, np.bool_), 1, ended=True).of(Outcome.THRESHOLD)
    assert round(one.start) == round(one.end) == 4
    sides = _sides(plan.problem, one, Amounts.of(plan.problem, column, row, one.resolution))
    assert sides[0] <= one.start < one.end <= sides[1]
    assert all(side.is_integer() for side in sides)

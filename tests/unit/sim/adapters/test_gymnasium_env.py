"""The simulator of Gymnasium environments: what the policy observes is perturbed, the environment is not."""

import math
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from numpy.typing import NDArray

from brink.sim import catalogue
from brink.sim.adapters.gymnasium_env.policies import CART_POLE_ANGLE_RAD, Episode
from brink.sim.adapters.gymnasium_env.simulator import GymnasiumSimulator
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode, SimulationCrashed

HERE = __name__
POLICIES = "brink.sim.adapters.gymnasium_env.policies"
SEEN: list[Episode] = []
GAIN = np.array([-1.0, -0.4])


class Integrator(gymnasium.Env[NDArray[np.float64], NDArray[np.float64]]):
    """A point that a policy pushes about; its noise comes from the global generators, as in careless environments."""

    observation_space = spaces.Box(-10.0, 10.0, (2,), np.float64)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float64)

    def __init__(self, mass: float = 1.0) -> None:
        self.mass = mass
        self.state = np.zeros(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        super().reset(seed=seed)
        self.state = np.array([self.np_random.uniform(1.0, 2.0), (options or {}).get("speed", 0.0)])
        return self.state.copy(), {}

    def step(
        self, action: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        noise = random.gauss(0.0, 0.001) + float(np.random.normal(0.0, 0.001))  # noqa: NPY002
        self.state = self.state + 0.1 * np.array([self.state[1], float(action[0]) / self.mass + noise])
        return self.state.copy(), -abs(float(self.state[0])), abs(float(self.state[0])) > 5.0, False, {}


class WithoutNumbers(Integrator):
    observation_space = spaces.Discrete(4)  # type: ignore[assignment]


gymnasium.register("BrinkIntegrator-v0", entry_point=f"{HERE}:Integrator")
gymnasium.register("BrinkWithoutNumbers-v0", entry_point=f"{HERE}:WithoutNumbers")


def drive(observation: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([min(max(float(GAIN @ observation), -1.0), 1.0)])


class Counting:
    """A policy with a state of its own."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        self.calls += 1
        return np.array([0.01 * self.calls])


def distance_margin(episode: Episode) -> float:
    SEEN.append(episode)
    return float(3.0 - np.abs(episode.states[:, 0]).max())


def no_margin(episode: Episode) -> float:
    return math.nan


@pytest.fixture(autouse=True)
def _as_plugin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv(PLUGINS_VARIABLE, HERE)
    catalogue.import_plugin_modules.cache_clear()
    SEEN.clear()
    yield
    catalogue.import_plugin_modules.cache_clear()


@pytest.fixture
def simulator() -> GymnasiumSimulator:
    return GymnasiumSimulator()


def perturbation(**changes: Json) -> dict[str, Json]:
    return {"type": "bias", "dimension": 0, "magnitude": 0.5, "from_step": 10, "steps": 5, **changes}


def cart_pole(*perturbations: dict[str, Json], seed: int = 1, **options: Json) -> EpisodeSpec:
    return EpisodeSpec(
        simulator="gymnasium@1",
        scenario={"environment": "CartPole-v1", "make": {}, "reset": {}, "reset_seed": None},
        behaviour={"perturbations": list(perturbations)},
        requirements=("survival@1",),
        seed=seed,
        duration_s=6.0,
        options={
            "policy": f"{POLICIES}:balance_cart_pole",
            "margin": None,
            "unit": "s",
            "survive_steps": 200,
            "step_s": 0.02,
            **options,
        },
    )


def integrator(*perturbations: dict[str, Json], seed: int = 1, **scenario: Json) -> EpisodeSpec:
    options: dict[str, Json] = {
        "policy": f"{HERE}:drive",
        "margin": f"{HERE}:distance_margin",
        "survive_steps": 1,
    }
    spec = cart_pole(*perturbations, seed=seed, **options)
    environment: dict[str, Json] = {
        **spec.scenario,
        "environment": "BrinkIntegrator-v0",
        "reset_seed": 7,
        **scenario,
    }
    return replace(spec, scenario=environment, requirements=("margin@1",), duration_s=1.0)


def test_the_default_policy_balances_the_pole(simulator: GymnasiumSimulator) -> None:
    for seed in range(5):
        result = simulator.run(cart_pole(seed=seed))
        verdict = result.verdicts["survival@1"]
        assert (result.features["steps"], result.features["terminated"]) == (300, False)
        assert verdict.robustness == pytest.approx(2.0)
        assert (verdict.unit, verdict.violated_at_s) == ("s", None)


def test_the_time_survived_is_graded(simulator: GymnasiumSimulator) -> None:
    found = []
    for from_step in (20, 120, 180, 250):
        blind = perturbation(type="dropout", dimension=3, from_step=from_step, steps=300)
        result = simulator.run(cart_pole(blind))
        verdict = result.verdicts["survival@1"]
        steps = result.features["steps"]
        assert isinstance(steps, int)
        assert verdict.robustness == pytest.approx((steps - 200) * 0.02)
        assert (verdict.violated_at_s is not None) == (verdict.robustness < 0) == (steps < 200)
        found.append(verdict.robustness)
    assert found == sorted(found)
    assert found[0] < 0 < found[-1]


def test_a_margin_of_ones_own_is_the_robustness(simulator: GymnasiumSimulator) -> None:
    spec = replace(cart_pole(margin=f"{POLICIES}:pole_angle_margin", unit="rad"), requirements=("margin@1",))
    verdict = simulator.run(spec).verdicts["margin@1"]
    assert verdict.unit == "rad"
    assert 0.0 < verdict.robustness < CART_POLE_ANGLE_RAD


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"type": "bias"}, lambda state, _: state + 0.5),
        ({"type": "gain"}, lambda state, _: state * 1.5),
        ({"type": "dropout"}, lambda state, _: np.zeros_like(state)),
        ({"type": "freeze"}, lambda state, before: np.full_like(state, before)),
    ],
)
def test_a_perturbation_changes_one_number_in_its_window_and_not_the_environment(
    simulator: GymnasiumSimulator, changes: dict[str, Json], expected: Any
) -> None:
    result = simulator.run(integrator(perturbation(**changes)))
    episode = SEEN[-1]
    assert result.features["perturbed_steps"] == [[10, 14]]
    window = slice(10, 15)
    wanted = episode.states.copy()
    wanted[window, 0] = expected(episode.states[window, 0], episode.states[9, 0])
    assert np.array_equal(episode.observations, wanted)
    assert len(episode.states) == len(episode.actions) + 1 == len(episode.rewards) + 1 == 51
    for observation, action in zip(episode.observations, episode.actions, strict=False):
        assert np.array_equal(action, drive(observation))
    simulator.run(integrator())
    truth = SEEN[-1]
    assert np.array_equal(truth.observations, truth.states)
    # The policy reacts to the perturbed observation in step 10, so that the states differ from step 11 on.
    assert np.array_equal(truth.states[:11], episode.states[:11])
    assert not np.array_equal(truth.states[11:], episode.states[11:])


def test_noise_comes_from_the_seed_of_the_episode(simulator: GymnasiumSimulator) -> None:
    noise = perturbation(type="noise", magnitude=0.3, from_step=0, steps=51)
    shifts = []
    for seed in (1, 1, 2):
        simulator.run(integrator(noise, seed=seed))
        shifts.append(SEEN[-1].observations[:, 0] - SEEN[-1].states[:, 0])
    assert np.array_equal(shifts[0], shifts[1])
    assert not np.array_equal(shifts[0], shifts[2])
    assert 0.15 < shifts[0].std() < 0.45
    later = perturbation(type="noise", magnitude=0.3, from_step=20, steps=50)
    simulator.run(integrator(later))
    assert np.allclose((SEEN[-1].observations[:, 0] - SEEN[-1].states[:, 0])[20:], shifts[0][20:])


def test_perturbations_apply_in_order(simulator: GymnasiumSimulator) -> None:
    simulator.run(integrator(perturbation(), perturbation(type="gain", magnitude=1.0)))
    episode = SEEN[-1]
    assert episode.observations[12, 0] == (episode.states[12, 0] + 0.5) * 2.0


def test_arguments_and_reset_options_reach_the_environment(simulator: GymnasiumSimulator) -> None:
    simulator.run(integrator(make={"mass": 100.0}, reset={"speed": 0.25}))
    heavy = SEEN[-1].states
    assert heavy[0, 1] == 0.25
    assert heavy[-1, 1] == pytest.approx(0.25, abs=0.08)


def test_the_reset_seed_decides_the_start_and_else_the_episode_does(simulator: GymnasiumSimulator) -> None:
    starts = []
    for reset_seed, seed in ((7, 1), (7, 2), (8, 1), (None, 1), (None, 1), (None, 2)):
        simulator.run(integrator(reset_seed=reset_seed, seed=seed))
        starts.append(float(SEEN[-1].states[0, 0]))
    assert starts[0] == starts[1] != starts[2]
    assert starts[3] == starts[4] != starts[5]


def test_each_episode_has_a_policy_of_its_own(simulator: GymnasiumSimulator) -> None:
    spec = integrator()
    stateful = replace(spec, options={**spec.options, "policy": f"{HERE}:Counting"})
    results = [simulator.run(stateful).verdicts for _ in range(2)]
    assert results[0] == results[1]
    assert [float(action[0]) for action in SEEN[-1].actions[:2]] == [0.01, 0.02]


def test_global_generators_are_seeded_and_restored(simulator: GymnasiumSimulator) -> None:
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    wanted = random.Random(1).random()
    first = simulator.run(integrator()).features
    assert random.random() == wanted
    assert simulator.run(integrator()).features == first
    assert simulator.run(integrator(seed=2)).features != first


CASES: list[tuple[dict[str, Any], str]] = [
    ({"scenario": {"environment": "CartPole-v9"}}, "scenario.environment: CartPole-v9: VersionNotFound"),
    ({"scenario": {"environment": "os:path"}}, "expected the id of a registered environment, got 'os:path'"),
    (
        {"scenario": {"environment": "BrinkWithoutNumbers-v0"}},
        r"expected observations in a Box, got Discrete\(4\)",
    ),
    ({"scenario": {"make": {"wheels": 3}}}, "scenario.environment: CartPole-v1: TypeError"),
    ({"scenario": {"reset": {"low": 1.0, "high": 0.0}}}, "scenario.reset: ValueError"),
    ({"scenario": {"reset_seed": -1}}, "scenario.reset_seed: expected an integer in \\[0, "),
    ({"scenario": {"wind": 1}}, "scenario: unknown field 'wind'"),
    (
        {"options": {"policy": "os:abort"}},
        "options.policy: expected MODULE:FUNCTION with a module that --plugin",
    ),
    ({"options": {"policy": f"{HERE}:_as_plugin"}}, "has no function '_as_plugin'"),
    ({"options": {"policy": f"{HERE}:nobody"}}, "has no function 'nobody'"),
    ({"options": {"policy": f"{HERE}:replace"}}, "'replace' is from elsewhere"),
    ({"options": {"survive_steps": 301}}, "options.survive_steps: expected an integer in \\[1, 300\\]"),
    ({"options": {"step_s": 0.0}}, "options.step_s: expected a time above 0"),
    ({"options": {"margin": f"{HERE}:distance_margin"}}, "requirements: expected margin@1 alone"),
    ({"duration_s": 1e5}, "duration_s: expected 1 to 100000 steps"),
    ({"requirements": ("no-collision@1",)}, "requirements: expected survival@1 alone"),
    (
        {"behaviour": {"perturbations": [perturbation(dimension=4)]}},
        "dimension: expected a number below 4, got 4",
    ),
    ({"behaviour": {"perturbations": [perturbation(type="biass")]}}, "did you mean 'bias'"),
    (
        {"behaviour": {"perturbations": [perturbation(from_step=-1)]}},
        "from_step: expected an integer in \\[0, ",
    ),
    (
        {"behaviour": {"perturbations": [perturbation(magnitude="much")]}},
        "expected a finite number, got 'much'",
    ),
    ({"behaviour": {"perturbations": [{}] * 9}}, "expected a list of at most 8"),
    ({"simulator": "gymnasium@2"}, "simulator: expected gymnasium@1"),
]


@pytest.mark.parametrize(("changes", "expected"), CASES)
def test_invalid_specs_are_refused(
    simulator: GymnasiumSimulator, changes: dict[str, Any], expected: str
) -> None:
    spec = cart_pole()
    merged: dict[str, Any] = {
        name: {**getattr(spec, name), **value} if isinstance(value, dict) and name != "behaviour" else value
        for name, value in changes.items()
    }
    with pytest.raises(InvalidEpisode, match=expected):
        simulator.run(replace(spec, **merged))


def test_a_margin_that_is_no_number_is_a_crash(simulator: GymnasiumSimulator) -> None:
    spec = integrator()
    with pytest.raises(SimulationCrashed, match="expected a finite margin, got nan"):
        simulator.run(replace(spec, options={**spec.options, "margin": f"{HERE}:no_margin"}))

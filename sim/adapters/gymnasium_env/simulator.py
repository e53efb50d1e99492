"""The simulator `gymnasium@1`: runs a policy in a Gymnasium environment, with perturbed observations.

The environment receives the actions and stays true: only what the policy observes is perturbed. Policies and margins
are named ``module:function``, where the module is a plug-in (``--plugin``) or Brink's own; see `policies`.

References:
    Towers et al. 2024, Gymnasium, https://arxiv.org/abs/2407.17032.
"""

import contextlib
import inspect
import math
import random
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brink.formula import FormulaError
from brink.sim.adapters.gymnasium_env.policies import Episode
from brink.sim.adapters.gymnasium_env.specification import (
    EXTRA,
    MARGIN,
    MAX_DIMENSIONS,
    OWN_MODULES,
    PERTURBED,
    SIMULATOR_ID,
    SURVIVAL,
    GymnasiumEpisode,
    Perturbation,
    PerturbationType,
)
from brink.sim.catalogue import load_function
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, Verdict
from brink.sim.errors import ExtraMissing, InvalidEpisode, SimulationCrashed
from brink.sim.provenance import provenance, versions_with
from brink.sim.world.streams import Stream, generator

if find_spec("gymnasium") is None:
    raise ExtraMissing(f"{SIMULATOR_ID} needs Gymnasium: install the extra {EXTRA}")

MAX_DURATION_S: Final = 1e6
_SEEDS: Final = 2**31


class GymnasiumSimulator:
    """Runs Gymnasium episodes. Stateless between episodes, unless an environment or policy keeps state globally."""

    id: ClassVar[str] = SIMULATOR_ID

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode, without a trace: environments in general have no top-down view.

        Args:
            spec: The specification.
            record: Without effect.

        Raises:
            InvalidEpisode: The specification can never run.
            SimulationCrashed: The margin is not a number.
        """
        cpu_s = time.process_time()
        spec.check_for(self.id, MAX_DURATION_S)
        wanted = GymnasiumEpisode.from_spec(spec)
        policy, margin = _loaded(wanted)
        with _seeded(spec.seed), _environment(wanted) as environment:
            episode, perturbed = _run(environment, policy, wanted, spec.seed)
        verdicts = _verdicts_of_formulas(episode, wanted) if wanted.formulas else {}
        if not verdicts:
            verdicts = {SURVIVAL if margin is None else MARGIN: _verdict(episode, wanted, margin)}
        steps = len(episode.actions)
        return EpisodeResult(
            verdicts=verdicts,
            objectives={f"{name}:robustness": verdict.robustness for name, verdict in verdicts.items()},
            features={
                "steps": steps,
                "terminated": episode.terminated,
                "reward": float(episode.rewards.sum()),
                PERTURBED: perturbed,
            },
            provenance=provenance(
                self.id, cpu_s, versions_with("gymnasium"), simulated_s=steps * wanted.step_s
            ),
        )


def _loaded(wanted: GymnasiumEpisode) -> tuple[Callable[[Any], Any], Callable[[Episode], float] | None]:
    """Return the policy (a new instance if it is a class) and the margin."""
    policy = load_function("options.policy", wanted.policy, OWN_MODULES)
    made: Callable[[Any], Any] = policy() if inspect.isclass(policy) else policy  # type: ignore[assignment]
    margin = None if wanted.margin is None else load_function("options.margin", wanted.margin, OWN_MODULES)
    return made, margin


@contextlib.contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Seed the global generators, for environments and policies that use them, and restore them afterwards."""
    states = random.getstate(), np.random.get_state()  # noqa: NPY002
    start = int(generator(seed, Stream.START, 1).integers(_SEEDS))
    random.seed(start)
    np.random.seed(start)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002


@contextlib.contextmanager
def _environment(wanted: GymnasiumEpisode) -> Iterator[Any]:
    """Make the environment of an episode, and close it afterwards.

    Raises:
        InvalidEpisode: It is unknown, its arguments are wrong, or its observations are not numbers.
    """
    environment = make_environment(wanted.environment, wanted.make, max_episode_steps=wanted.steps)
    try:
        observed_dimensions(environment)
        yield environment
    finally:
        environment.close()


def make_environment(name: str, arguments: Any, **settings: Any) -> Any:
    """Return a new environment.

    Args:
        name: Id of a registered environment; a plug-in registers those of its own when it is imported.
        arguments: Its arguments.
        settings: Settings of `gymnasium.make`.

    Raises:
        InvalidEpisode: It is unknown, or its arguments are wrong.
    """
    import gymnasium

    if ":" in name:
        raise InvalidEpisode(
            f"scenario.environment: expected the id of a registered environment, got {name!r}"
        )
    try:
        return gymnasium.make(name, disable_env_checker=True, **settings, **arguments)
    except (gymnasium.error.Error, TypeError, ImportError) as error:
        raise InvalidEpisode(f"scenario.environment: {name}: {type(error).__name__}: {error}") from error


def observed_dimensions(environment: Any) -> int:
    """Return the number of values in an environment's observation.

    Raises:
        InvalidEpisode: Its observations are not arrays of numbers, or they are too large.
    """
    import gymnasium

    space = environment.observation_space
    if not isinstance(space, gymnasium.spaces.Box):
        raise InvalidEpisode(
            f"scenario.environment: expected observations in a Box, got {space}; "
            "register a wrapped environment, such as with FlattenObservation"
        )
    count = int(np.prod(space.shape))
    if not 1 <= count <= MAX_DIMENSIONS:
        raise InvalidEpisode(
            f"scenario.environment: expected observations of 1 to {MAX_DIMENSIONS} numbers, got {count}"
        )
    return count


def _run(
    environment: Any, policy: Callable[[Any], Any], wanted: GymnasiumEpisode, seed: int
) -> tuple[Episode, list[Json]]:
    """Run an episode, and return it with the steps at which each perturbation had an effect."""
    reset_seed = wanted.reset_seed
    if reset_seed is None:
        reset_seed = int(generator(seed, Stream.START).integers(_SEEDS))
    try:
        state, _ = environment.reset(seed=reset_seed, options=dict(wanted.reset) or None)
    except (ValueError, TypeError, AssertionError) as error:
        raise InvalidEpisode(f"scenario.reset: {type(error).__name__}: {error}") from error
    environment.action_space.seed(reset_seed)
    sensor = _Sensor(wanted.perturbations, environment.observation_space, seed)
    states = [_flat(state)]
    observations = [sensor.observe(states[0])]
    actions: list[Any] = []
    rewards: list[float] = []
    terminated = truncated = False
    while not (terminated or truncated) and len(actions) < wanted.steps:
        action = policy(sensor.shaped(observations[-1]))
        state, reward, terminated, truncated, _ = environment.step(action)
        actions.append(action)
        rewards.append(float(reward))
        states.append(_flat(state))
        observations.append(sensor.observe(states[-1]))
    episode = Episode(
        states=np.array(states),
        observations=np.array(observations),
        actions=tuple(actions),
        rewards=np.array(rewards),
        terminated=bool(terminated),
    )
    return episode, sensor.steps


def _flat(observation: Any) -> NDArray[np.float64]:
    return np.asarray(observation, np.float64).ravel()


class _Sensor:
    """Perturbs observations, one after the other.

    Args:
        perturbations: The perturbations.
        space: Space of the environment's observations.
        seed: The episode's seed.
    """

    def __init__(self, perturbations: Sequence[Perturbation], space: Any, seed: int) -> None:
        size = int(np.prod(space.shape))
        for index, one in enumerate(perturbations):
            if one.dimension >= size:
                raise InvalidEpisode(
                    f"behaviour.perturbations[{index}].dimension: expected a number below {size}, got {one.dimension}"
                )
        self._perturbations = perturbations
        self._space = space
        self._rngs = [generator(seed, Stream.DRIVING_SYSTEM, index) for index in range(len(perturbations))]
        self._step = 0
        self._last: NDArray[np.float64] | None = None
        self._changed: list[tuple[int, int] | None] = [None] * len(perturbations)

    @property
    def steps(self) -> list[Json]:
        """First and last step at which each perturbation changed the observation; None if it never did."""
        return [None if steps is None else [*steps] for steps in self._changed]

    def observe(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next observation as the policy receives it, flattened."""
        found = state.copy()
        for index, one in enumerate(self._perturbations):
            draw = float(self._rngs[index].normal())  # at every step, so that windows do not shift draws
            if not one.from_step <= self._step < one.from_step + one.steps:
                continue
            before = float(found[one.dimension])
            found[one.dimension] = self._perturbed(one, before, draw)
            if found[one.dimension] != before:
                first = self._changed[index]
                self._changed[index] = (self._step if first is None else first[0], self._step)
        self._step += 1
        self._last = found
        return found

    def _perturbed(self, one: Perturbation, value: float, draw: float) -> float:
        match one.type:
            case PerturbationType.BIAS:
                return value + one.magnitude
            case PerturbationType.GAIN:
                return value * (1.0 + one.magnitude)
            case PerturbationType.NOISE:
                return value + one.magnitude * draw
            case PerturbationType.FREEZE:
                return value if self._last is None else float(self._last[one.dimension])
            case PerturbationType.DROPOUT:
                return 0.0

    def shaped(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return an observation in the environment's own shape and dtype."""
        shaped: NDArray[Any] = observation.astype(self._space.dtype).reshape(self._space.shape)
        return shaped


def _verdict(
    episode: Episode, wanted: GymnasiumEpisode, margin: Callable[[Episode], float] | None
) -> Verdict:
    """Return the verdict: the time survived beyond what is required, or the user's margin.

    Raises:
        SimulationCrashed: The margin is not a number.
    """
    ended_s = len(episode.actions) * wanted.step_s
    if margin is None:
        # An episode that reached the limit on its steps may have survived longer: the margin is at least this.
        robustness, unit = (len(episode.actions) - wanted.survive_steps) * wanted.step_s, "s"
    else:
        robustness, unit = float(margin(episode)), wanted.unit
        if not math.isfinite(robustness):
            raise SimulationCrashed(f"{wanted.margin}: expected a finite margin, got {robustness}")
    if not episode.terminated and margin is None:
        robustness = max(robustness, 0.0)
    return Verdict(robustness=robustness, unit=unit, violated_at_s=ended_s if robustness < 0 else None)


def _verdicts_of_formulas(episode: Episode, wanted: GymnasiumEpisode) -> dict[str, Verdict]:
    """Return the verdicts of the formulas over the true observations, with a sample at the reset and each step.

    Raises:
        InvalidEpisode: The observation has another number of values than there are names.
        SimulationCrashed: A formula has no value.
    """
    series = [
        *episode.states.T,
        np.concatenate([[0.0], episode.rewards]),
        np.append(np.zeros(len(episode.actions)), episode.terminated),
    ]
    if len(series) != len(wanted.signals):
        raise InvalidEpisode(f"options.signals: expected {len(series)} names, got {len(wanted.signals)}")
    signals: dict[str, ArrayLike] = dict(zip(wanted.signals, series, strict=True))
    times_s = wanted.step_s * np.arange(len(episode.states))
    try:
        return {name: formula.verdict(times_s, signals) for name, formula in wanted.formulas.items()}
    except FormulaError as error:
        raise SimulationCrashed(str(error)) from error

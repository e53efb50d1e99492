"""The problem `gymnasium@1`: a policy in any Gymnasium environment, on observations that are perturbed.

The scenario is made of ranges of the environment's arguments and reset options, and of the seed of the reset; the
behaviour is a number of perturbations of single numbers of the observation. Source: ours.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, ClassVar, Final

import numpy as np

from brink.extras import install_command
from brink.search.errors import ConfigError
from brink.search.parameters import Parameter, Value
from brink.search.settings import check_settings, setting
from brink.search.space import Categorical, Component, Dormant, Integer, Real, SearchSpace
from brink.server.problems.base import BEHAVIOUR, Activity, SimulatedSolution, Vectors
from brink.server.problems.changes import different
from brink.server.problems.perception_errors import HasTrueVariant
from brink.server.problems.requirements import JudgedByRequirements
from brink.sim.adapters.gymnasium_env.specification import (
    EXTRA,
    MARGIN,
    MAX_PERTURBATIONS,
    MAX_STEPS,
    OWN_MODULES,
    PERTURBED,
    POLICIES,
    SIMULATOR_ID,
    SURVIVAL,
    WITHOUT_MAGNITUDE,
    Perturbation,
    PerturbationType,
)
from brink.sim.catalogue import load_function
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.urban.behaviour import steps_from_json

NO_PERTURBATION: Final = "none"
TYPES: Final = tuple(kind.value for kind in PerturbationType)
CART_POLE: Final = "CartPole-v1"
_SCENARIO: Final = "scenario"
_RESET_SEED: Final = "reset_seed"
_FIELDS: Final = ("type", "dimension", "magnitude", "from_step", "steps")
_NUMBERS: Final = ("magnitude", "from_step", "steps")
_GREATEST_BOUND: Final = 1e3
"""A greater bound of an observation says nothing about how large it usually is."""
_KNOWN: Final[Mapping[str, tuple[tuple[str, float], ...]]] = {
    CART_POLE: (
        ("cart position", 1.0),
        ("cart velocity", 1.0),
        ("pole angle", 0.2),
        ("pole angular velocity", 1.0),
    )
}
"""What observations mean, and how large they usually are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GymnasiumParams:
    """Parameters of the problem."""

    environment: str = setting(CART_POLE, help="Id of a registered environment.")
    policy: str = setting(
        f"{POLICIES}:balance_cart_pole",
        help="MODULE:FUNCTION that maps an observation to an action, in a plug-in module.",
    )
    margin: str = setting(
        "", help="MODULE:FUNCTION that maps an episode to its robustness; empty for the time survived."
    )
    unit: str = setting("1", help="Unit of the margin.")
    survive_steps: int = setting(
        200, ge=1, le=MAX_STEPS, help="Steps before which an episode must not terminate."
    )
    steps: int = setting(500, ge=1, le=MAX_STEPS, help="Maximum number of steps of an episode.")
    step_s: float = setting(0.02, gt=0.0, le=60.0, unit="s", help="Simulated time of a step.")
    perturbations: int = setting(1, ge=1, le=MAX_PERTURBATIONS, help="Most perturbations in an episode.")
    types: list[str] = field(
        default_factory=lambda: list(TYPES),
        metadata={"help": "Allowed perturbations: bias, gain, noise, freeze, dropout."},
    )
    dimensions: list[int] = field(
        default_factory=list,
        metadata={"help": "Indices of the numbers that may be perturbed; empty for all."},
    )
    names: list[str] = field(
        default_factory=list, metadata={"help": "What the numbers of the observation are called, in order."}
    )
    scales: list[float] = field(
        default_factory=list,
        metadata={
            "help": "Greatest bias of each number, and standard deviation of its noise; by default half of its "
            "range, or 1."
        },
    )
    arguments: dict[str, Any] = field(
        default_factory=dict, metadata={"help": "Fixed arguments of the environment."}
    )
    make: dict[str, list[float]] = field(
        default_factory=dict,
        metadata={"help": "Arguments of the environment to search, with the least and greatest value."},
    )
    reset: dict[str, list[float]] = field(
        default_factory=dict,
        metadata={"help": "Options of the reset to search, with the least and greatest value."},
    )
    reset_seeds: int = setting(
        0,
        ge=0,
        le=2**31 - 1,
        help="Number of reset seeds to search; 0 draws them from the seed of each simulation.",
    )
    timeout_s: float = setting(60.0, gt=0.0, le=3600.0, unit="s", help="Wall-clock limit of an episode.")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.survive_steps > self.steps:
            raise ConfigError(
                "survive_steps", f"expected at most steps ({self.steps}), got {self.survive_steps}"
            )
        if not self.types or len(set(self.types)) < len(self.types) or not set(self.types) <= set(TYPES):
            raise ConfigError("types", f"expected some of {', '.join(TYPES)}, each once; got {self.types!r}")
        for name in ("make", "reset"):
            for key, bounds in getattr(self, name).items():
                if not key.isidentifier():
                    raise ConfigError(name, f"expected names of arguments, got {key!r}")
                if len(bounds) != 2 or not bounds[0] < bounds[1]:
                    raise ConfigError(
                        name, f"expected a least and a greater value of {key!r}, got {bounds!r}"
                    )
        count = len(self.observed)
        for name, given in (("names", self.names), ("scales", self.scales)):
            if given and len(given) != count:
                raise ConfigError(
                    name, f"expected {count}, one for each number of the observation, got {len(given)}"
                )
        if len(set(self.names)) < len(self.names) or "" in self.names:
            raise ConfigError("names", f"expected different names, got {self.names!r}")
        if len(set(self.dimensions)) < len(self.dimensions) or not set(self.dimensions) <= set(range(count)):
            raise ConfigError(
                "dimensions", f"expected different indices from 0 to {count - 1}, got {self.dimensions!r}"
            )
        if any(scale <= 0 for scale in self.scales):
            raise ConfigError("scales", f"expected numbers above 0, got {self.scales!r}")

    @property
    def observed(self) -> tuple[tuple[str, float], ...]:
        """Name and scale of each number of the observation.

        Raises:
            ConfigError: The environment is unknown or unsuitable, or Gymnasium is not installed.
        """
        default = _KNOWN.get(self.environment)
        if default is None:
            default = _observed(self.environment, {**self.arguments, **_middles(self.make)})
        names = self.names if len(self.names) == len(default) else [name for name, _ in default]
        scales = self.scales if len(self.scales) == len(default) else [scale for _, scale in default]
        return tuple(zip(names, scales, strict=True))


def _middles(ranges: Mapping[str, list[float]]) -> dict[str, float]:
    return {name: (low + high) / 2 for name, (low, high) in ranges.items()}


def _observed(name: str, arguments: Mapping[str, Any]) -> tuple[tuple[str, float], ...]:
    """Return name and scale of each number of an environment's observation, from its bounds."""
    if find_spec("gymnasium") is None:
        raise ConfigError(
            "environment", f"{name} needs the {EXTRA} extra, which is not installed: {install_command(EXTRA)}"
        )
    from brink.sim.adapters.gymnasium_env.simulator import make_environment, observed_dimensions

    try:
        environment = make_environment(name, arguments)
        try:
            count = observed_dimensions(environment)
            low, high = (
                np.broadcast_to(np.ravel(np.asarray(bound, np.float64)), (count,))
                for bound in (environment.observation_space.low, environment.observation_space.high)
            )
        finally:
            environment.close()
    except InvalidEpisode as error:
        raise ConfigError("environment", str(error).removeprefix("scenario.environment: ")) from None
    halves = (high - low) / 2
    return tuple(
        (f"observation {index}", float(half) if 0 < half <= _GREATEST_BOUND else 1.0)
        for index, half in enumerate(halves.tolist())
    )


def scenario_component(params: GymnasiumParams) -> Component | None:
    """Return the parameters of the environment and its reset; None if none is searched."""
    parameters: list[Parameter] = [
        Real(name=f"{kind}.{name}", low=low, high=high, unit="")
        for kind, ranges in (("make", params.make), ("reset", params.reset))
        for name, (low, high) in ranges.items()
    ]
    if params.reset_seeds > 1:
        parameters.append(Integer(name=_RESET_SEED, low=0, high=params.reset_seeds - 1, unit=""))
    return Component(name=_SCENARIO, parameters=tuple(parameters)) if parameters else None


def behaviour_component(params: GymnasiumParams) -> Component:
    """Return the parameters of the perturbations."""
    names = [name for name, _ in params.observed]
    shown = [names[index] for index in params.dimensions or range(len(names))]
    parameters: list[Parameter] = []
    constraints = []
    for prefix in _prefixes(params.perturbations):
        parameters += [
            Categorical(name=prefix + "type", choices=(NO_PERTURBATION, *params.types)),
            Categorical(name=prefix + "dimension", choices=tuple(shown)),
            Real(name=prefix + "magnitude", low=-1.0, high=1.0, unit=""),
            Integer(name=prefix + "from_step", low=0, high=params.steps - 1, unit="steps"),
            Integer(name=prefix + "steps", low=0, high=params.steps, unit="steps"),
        ]
        members = tuple(prefix + name for name in _NUMBERS)
        constraints.append(Dormant(label=prefix + "type", null_choice=NO_PERTURBATION, members=members))
    parts = tuple(tuple(prefix + name for name in _FIELDS) for prefix in _prefixes(params.perturbations))
    return Component(
        name=BEHAVIOUR,
        parameters=tuple(parameters),
        constraints=tuple(constraints),
        interchangeable=parts if len(parts) > 1 else (),
    )


def _prefixes(count: int) -> list[str]:
    return [f"perturbation_{index}." for index in range(1, count + 1)]


class GymnasiumProblem(HasTrueVariant, JudgedByRequirements):
    """A policy in a Gymnasium environment, on perturbed observations."""

    id: ClassVar[str] = "gymnasium@1"
    summary: ClassVar[str] = "A policy in any Gymnasium environment, on perturbed observations."
    params_type: ClassVar[type[Any]] = GymnasiumParams
    extra: ClassVar[str] = EXTRA
    modules: ClassVar[tuple[str, ...]] = ("gymnasium",)

    def __init__(self, params: GymnasiumParams) -> None:
        self.params = params
        scenario, behaviour = scenario_component(params), behaviour_component(params)
        self.space = SearchSpace((behaviour,) if scenario is None else (scenario, behaviour))
        self.algorithm_defaults: Mapping[str, Any] = {}
        self.requirements = (MARGIN if params.margin else SURVIVAL,)
        self.needs = SIMULATOR_ID
        self.timeout_s = params.timeout_s
        self._observed = params.observed
        self._index = {name: index for index, (name, _) in enumerate(self._observed)}
        self._prefixes = _prefixes(params.perturbations)

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return what is wrong with the names of the policy and the margin; workers check them again."""
        wrong = []
        for name in ("policy", "margin"):
            if not (given := getattr(self.params, name)) and name == "margin":
                continue
            try:
                load_function(name, given, OWN_MODULES)
            except InvalidEpisode as error:
                wrong.append((name, str(error).removeprefix(f"{name}: ")))
        return wrong

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and the perturbations in it."""
        params, decoded = self.params, self.space.decode(tuple(vectors))
        scenario = decoded.get(_SCENARIO, {})
        reset_seed = scenario.get(_RESET_SEED, 0 if params.reset_seeds == 1 else None)
        perturbations: list[Json] = [one.to_json() for one in self._perturbations(decoded[BEHAVIOUR])]
        return EpisodeSpec(
            simulator=SIMULATOR_ID,
            scenario={
                "environment": params.environment,
                "make": {**params.arguments, **_part(scenario, "make.")},
                "reset": _part(scenario, "reset."),
                "reset_seed": reset_seed,
            },
            behaviour={"perturbations": perturbations},
            requirements=self.requirements,
            seed=seed,
            duration_s=params.steps * params.step_s,
            options={
                "policy": params.policy,
                "margin": params.margin or None,
                "unit": params.unit,
                "survive_steps": params.survive_steps,
                "step_s": params.step_s,
            },
        )

    def _perturbations(self, values: Mapping[str, Value]) -> tuple[Perturbation, ...]:
        if self.is_true:
            return ()
        found = (self._perturbation(values, prefix) for prefix in self._prefixes)
        return tuple(one for one in found if one is not None)

    def _perturbation(self, values: Mapping[str, Value], prefix: str) -> Perturbation | None:
        """Return a perturbation of a decoded behaviour; None if it is none."""
        if values[prefix + "type"] == NO_PERTURBATION:
            return None
        kind = PerturbationType(str(values[prefix + "type"]))
        dimension = self._index[str(values[prefix + "dimension"])]
        magnitude = float(values[prefix + "magnitude"])
        if kind in (PerturbationType.BIAS, PerturbationType.NOISE):
            magnitude *= self._observed[dimension][1]
        return Perturbation(
            type=kind,
            dimension=dimension,
            magnitude=0.0 if kind in WITHOUT_MAGNITUDE else magnitude,
            from_step=int(values[prefix + "from_step"]),
            steps=int(values[prefix + "steps"]),
        )

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        scenario = [f"{_plain(name)} {_value(value)}" for name, value in decoded.get(_SCENARIO, {}).items()]
        perturbations = [self._words(one) for one in self._perturbations(decoded[BEHAVIOUR])]
        described = ", ".join([self.params.environment, *scenario])
        return f"{described}; {' and '.join(perturbations) or 'not perturbed'}"

    def _words(self, one: Perturbation) -> str:
        return one.words(self._observed[one.dimension][0])

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe what is different in the unsafe one of two candidates."""
        old, new = (self.space.decode(tuple(one.vectors)) for one in (safe, unsafe))
        parts = [
            f"{_plain(name)} {_instead(value, new[_SCENARIO][name])}"
            for name, value in old.get(_SCENARIO, {}).items()
            if f"{_SCENARIO}.{name}" in changed
        ]
        for prefix in self._prefixes:
            whole = f"{BEHAVIOUR}.{prefix}"
            if any(name.startswith(whole) for name in changed):
                before = self._perturbation(old[BEHAVIOUR], prefix)
                after = self._perturbation(new[BEHAVIOUR], prefix)
                parts.append(self._change(before, after))
        return "; ".join(filter(None, parts))

    def _change(self, old: Perturbation | None, new: Perturbation | None) -> str:
        """Describe how a perturbation differs, such as ``pole angle biased by +0.051 instead of +0.048``."""
        if new is None:
            return f"without {self._words(old)}" if old is not None else ""
        if old is None:
            return self._words(new)
        if (old.type, old.dimension) != (new.type, new.dimension):
            return f"{self._words(new)} (in the safe episode, {self._words(old)})"
        parts = []
        if old.magnitude != new.magnitude:
            before, after = different(old.shown, new.shown)
            parts.append(f"{_signed(after)}{new.unit} instead of {_signed(before)}{new.unit}")
        words = [
            new.kind_words(
                self._observed[new.dimension][0], parts[0] if parts else f"{new.shown:+.3g}{new.unit}"
            )
        ]
        if old.from_step != new.from_step:
            words.append(f"from step {new.from_step} instead of {old.from_step}")
        if old.steps != new.steps:
            words.append(f"for {new.steps} steps instead of {old.steps}")
        return ", ".join(words) if parts or len(words) > 1 else ""

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which parameters had a part in an episode: those of perturbations that changed an observation."""
        steps = steps_from_json(features.get(PERTURBED))
        behaviour = self.space.components[-1]
        values = behaviour.decode(vectors[-1])
        present = [prefix for prefix in self._prefixes if values[prefix + "type"] != NO_PERTURBATION]
        if self.is_true or steps is None or len(steps) != len(present):
            return None
        acted = {prefix for prefix, at in zip(present, steps, strict=True) if at is not None}
        place = {parameter.name: column for column, parameter in enumerate(behaviour.parameters)}
        active = np.ones(len(vectors[-1]), dtype=np.bool_)
        effective = np.array(vectors[-1], dtype=np.float64)
        for prefix in self._prefixes:
            columns = [place[prefix + name] for name in _FIELDS]
            if prefix not in acted:
                # The type stays active where there is no perturbation: another type would have been one.
                active[columns if prefix in present else columns[1:]] = False
                effective[columns[0]] = 0.0
                effective[columns[2:]] = 0.0
            elif str(values[prefix + "type"]) in WITHOUT_MAGNITUDE:
                active[place[prefix + "magnitude"]] = False
        before = [np.ones(len(one), dtype=np.bool_) for one in vectors[:-1]]
        return Activity(
            active=np.concatenate([*before, active]),
            effective=np.concatenate([*vectors[:-1], effective]),
            idle=() if acted else (BEHAVIOUR,),
        )


def _part(values: Mapping[str, Value], prefix: str) -> dict[str, Json]:
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}


def _plain(name: str) -> str:
    return name.partition(".")[2].replace("_", " ") or name.replace("_", " ")


def _value(value: Value) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _signed(number: str) -> str:
    return number if number.startswith("-") else f"+{number}"


def _instead(old: Value, new: Value) -> str:
    before, after = different(old, new)
    return f"{after} instead of {before}"

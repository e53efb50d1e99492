"""The problem `gymnasium@1`: a policy in any Gymnasium environment, with perturbed observations.

The scenario is made of ranges of the environment's arguments and reset options, and of the seed of the reset; the
behaviour is a number of perturbations of single numbers of the observation. Source: ours.
"""

import re
from collections.abc import Collection, Mapping, Set
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, ClassVar, Final

import numpy as np

from brink.extras import install_command
from brink.search.errors import ConfigError
from brink.search.parameters import Parameter, Value
from brink.search.settings import check_settings, setting
from brink.search.space import Categorical, Component, Integer, Real, SearchSpace
from brink.server.problems.base import BEHAVIOUR, SeverityScale, Vectors
from brink.server.problems.changes import different, instead
from brink.server.problems.error_slots import (
    NO_ERROR,
    SCENARIO,
    ErrorSlots,
    Slot,
    Values,
    prefixes,
    slots_component,
)
from brink.server.problems.requirements import check_formulas
from brink.sim.adapters.gymnasium_env.specification import (
    EXTRA,
    EXTRA_SIGNALS,
    MARGIN,
    MAX_PERTURBATIONS,
    MAX_STEPS,
    OWN_MODULES,
    PERTURBED,
    POLICIES,
    SIGNALS,
    SIMULATOR_ID,
    SURVIVAL,
    WITHOUT_MAGNITUDE,
    Perturbation,
    PerturbationType,
)
from brink.sim.catalogue import load_function
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode

TYPES: Final = tuple(kind.value for kind in PerturbationType)
CART_POLE: Final = "CartPole-v1"
SURVIVED_STEPS: Final = 200
_RESET_SEED: Final = "reset_seed"
_GREATEST_BOUND: Final = 1e3
"""A larger bound of an observation does not indicate its usual size."""
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
    requirement: dict[str, Any] = field(
        default_factory=dict,
        metadata={
            "help": "Requirements of your own as formulas, {NAME: {stl: FORMULA, unit: UNIT}}, instead of the time "
            "survived; the signals are the numbers of the true observation, reward and terminated."
        },
    )
    survive_steps: int = setting(
        0,
        ge=0,
        le=MAX_STEPS,
        help=f"Steps before which an episode must not terminate; 0 for {SURVIVED_STEPS}, or all if there are fewer.",
    )
    steps: int = setting(500, ge=1, le=MAX_STEPS, help="Maximum number of steps of an episode.")
    step_s: float = setting(0.02, gt=0.0, le=60.0, unit="s", help="Simulated time of a step.")
    perturbations: int = setting(
        1, ge=1, le=MAX_PERTURBATIONS, help="Maximum number of perturbations in an episode."
    )
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
        if self.requirement and self.margin:
            raise ConfigError("requirement", "expected none, because margin is given")
        check_formulas(self.requirement, self.signals, self.steps * self.step_s)
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
    def survived_steps(self) -> int:
        """Steps before which an episode must not terminate."""
        return self.survive_steps or min(SURVIVED_STEPS, self.steps)

    @property
    def signals(self) -> list[str]:
        """Names in formulas of the numbers of the observation, and of all else that is recorded."""
        return [*(re.sub(r"\W+", "_", name) for name, _ in self.observed), *EXTRA_SIGNALS]

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
        parameters.append(
            Integer(name=_RESET_SEED, low=0, high=params.reset_seeds - 1, unit="", resolution=1)
        )
    return Component(name=SCENARIO, parameters=tuple(parameters)) if parameters else None


def behaviour_component(params: GymnasiumParams) -> Component:
    """Return the parameters of the perturbations."""
    names = [name for name, _ in params.observed]
    shown = [names[index] for index in params.dimensions or range(len(names))]
    return slots_component(
        [
            (
                Categorical(name=prefix + "type", choices=(NO_ERROR, *params.types)),
                Categorical(name=prefix + "dimension", choices=tuple(shown)),
                Real(name=prefix + "magnitude", low=-1.0, high=1.0, unit=""),
                Integer(name=prefix + "from_step", low=0, high=params.steps - 1, unit="steps", resolution=1),
                Integer(name=prefix + "steps", low=0, high=params.steps, unit="steps", resolution=1),
            )
            for prefix in prefixes("perturbation", params.perturbations)
        ]
    )


class GymnasiumProblem(ErrorSlots[Perturbation]):
    """A policy in a Gymnasium environment, with perturbed observations."""

    id: ClassVar[str] = "gymnasium@1"
    summary: ClassVar[str] = "A policy in any Gymnasium environment, with perturbed observations."
    params_type: ClassVar[type[Any]] = GymnasiumParams
    extra = EXTRA
    modules = ("gymnasium",)
    acted_feature = PERTURBED
    identity = ("type", "dimension")
    lacking = "without {}"
    episode_word = "episode"

    def __init__(self, params: GymnasiumParams) -> None:
        self.params = params
        scenario, behaviour = scenario_component(params), behaviour_component(params)
        self.space = SearchSpace((behaviour,) if scenario is None else (scenario, behaviour))
        self.requirements = tuple(params.requirement) or (MARGIN if params.margin else SURVIVAL,)
        self.formulas = params.requirement
        self.needs = SIMULATOR_ID
        self.timeout_s = params.timeout_s
        self._observed = params.observed
        self._index = {name: index for index, (name, _) in enumerate(self._observed)}

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return errors in the names of the policy and the margin; workers check them again."""
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
        scenario = decoded.get(SCENARIO, {})
        reset_seed = scenario.get(_RESET_SEED, 0 if params.reset_seeds == 1 else None)
        perturbations: list[Json] = [error.to_json() for error in self.errors(decoded[BEHAVIOUR])]
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
            formulas=self.formulas,
            seed=seed,
            duration_s=params.steps * params.step_s,
            options={
                "policy": params.policy,
                "margin": params.margin or None,
                "unit": params.unit,
                "survive_steps": params.survived_steps,
                "step_s": params.step_s,
                **({SIGNALS: list(params.signals)} if self.formulas else {}),
            },
        )

    def error(self, behaviour: Values, slot: Slot) -> Perturbation:
        """Return the perturbation of a decoded behaviour in a slot that has one."""
        values = {name.removeprefix(slot.prefix): behaviour[name] for name in slot.names}
        kind = PerturbationType(str(values["type"]))
        dimension = self._index[str(values["dimension"])]
        magnitude = float(values["magnitude"])
        if kind in (PerturbationType.BIAS, PerturbationType.NOISE):
            magnitude *= self._observed[dimension][1]
        return Perturbation(
            type=kind,
            dimension=dimension,
            magnitude=0.0 if kind in WITHOUT_MAGNITUDE else magnitude,
            from_step=int(values["from_step"]),
            steps=int(values["steps"]),
        )

    def unused(self, error: Perturbation) -> Collection[str]:
        """Return the parameters that a perturbation of this type does not have."""
        return ("magnitude",) if error.type in WITHOUT_MAGNITUDE else ()

    def scale_of(self, name: str, values: Mapping[str, Values]) -> SeverityScale | None:
        """Return the scale of a number of steps, which says what the steps are; None for other numbers."""
        meanings = {
            "from_step": "first step of the perturbation",
            "steps": "how many steps the perturbation lasts",
        }
        meaning = meanings.get(name.rpartition(".")[2])
        return None if meaning is None else SeverityScale(unit="steps", none=0.0, most=1.0, meaning=meaning)

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        scenario = [f"{_plain(name)} {_value(value)}" for name, value in decoded.get(SCENARIO, {}).items()]
        described = ", ".join([self.params.environment, *scenario])
        return f"{described}; {self.words_of_errors(decoded[BEHAVIOUR]) or 'not perturbed'}"

    def words_of_error(self, error: Perturbation) -> str:
        """Describe a perturbation."""
        return error.words(self._observed[error.dimension][0])

    def scenario_changes(self, old: Values, new: Values, changed: Collection[str]) -> list[str]:
        """Describe the differences of the unsafe scenario from the safe one, one part for each parameter."""
        return [
            f"{_plain(name)} {instead(value, new[name])}"
            for name, value in old.items()
            if f"{SCENARIO}.{name}" in changed
        ]

    def words_of_changed_error(self, old: Perturbation, new: Perturbation, changed: Set[str]) -> str:
        """Describe how a perturbation differs, such as ``pole angle biased by +0.051 instead of +0.048``."""
        parts = []
        if old.from_step != new.from_step:
            parts.append(f"from step {new.from_step} instead of {old.from_step}")
        if old.steps != new.steps:
            parts.append(f"for {new.steps} steps instead of {old.steps}")
        much = f"{new.shown:+.3g}{new.unit}"
        if old.magnitude != new.magnitude:
            before, after = different(old.shown, new.shown)
            much = f"{_signed(after)}{new.unit} instead of {_signed(before)}{new.unit}"
        elif not parts:
            return ""
        return ", ".join([new.kind_words(self._observed[new.dimension][0], much), *parts])


def _part(values: Mapping[str, Value], prefix: str) -> dict[str, Json]:
    return {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}


def _plain(name: str) -> str:
    return name.partition(".")[2].replace("_", " ") or name.replace("_", " ")


def _value(value: Value) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _signed(number: str) -> str:
    return number if number.startswith("-") else f"+{number}"

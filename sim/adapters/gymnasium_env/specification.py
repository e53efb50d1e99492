"""What determines a Gymnasium episode: the environment, the policy, and how observations are perturbed.

This module does not import Gymnasium, so that a coordinator can build a search space without it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

from brink.formula import FormulaError
from brink.sim.episode import EpisodeSpec, Json, JsonObject, check_fields, parse_choice, parse_integer
from brink.sim.errors import InvalidEpisode
from brink.sim.formula_requirement import StatedFormula, stated_formulas

SIMULATOR_ID: Final = "gymnasium@1"
EXTRA: Final = "gymnasium"
MAX_STEPS: Final = 100_000
MAX_PERTURBATIONS: Final = 8
"""Maximum number of perturbations in an episode."""
MAX_DIMENSIONS: Final = 1024
POLICIES: Final = "brink.sim.adapters.gymnasium_env.policies"
OWN_MODULES: Final = (POLICIES,)
"""Modules of Brink whose functions may be named, beside those of plug-ins."""
SURVIVAL: Final = "survival@1"
"""The requirement that an episode does not terminate before a number of steps."""
MARGIN: Final = "margin@1"
"""The requirement that a quantity of the user's own, computed from the whole episode, is not negative."""
PERTURBED: Final = "perturbed_steps"
"""Name of the feature with the first and last step at which each perturbation changed the observation, or null."""

SIGNALS: Final = "signals"
"""Name of the option with the names of the numbers of the observation in formulas, and `EXTRA_SIGNALS`."""
EXTRA_SIGNALS: Final = ("reward", "terminated")
"""Signals of formulas that are no part of the observation."""

_OPTIONS: Final = ("policy", "margin", "unit", "survive_steps", "step_s")
_SCENARIO: Final = ("environment", "make", "reset", "reset_seed")


class PerturbationType(StrEnum):
    """How one number of the observation is perturbed.

    Constants are added (``bias``), factors applied (``gain``), random numbers added (``noise``), the last value kept
    (``freeze``), or zero reported (``dropout``).
    """

    BIAS = "bias"
    GAIN = "gain"
    NOISE = "noise"
    FREEZE = "freeze"
    DROPOUT = "dropout"


WITHOUT_MAGNITUDE: Final = frozenset({PerturbationType.FREEZE, PerturbationType.DROPOUT})


@dataclass(frozen=True, slots=True, kw_only=True)
class Perturbation:
    """A perturbation of one number of the observation.

    Attributes:
        type: How.
        dimension: Index of the number in the flattened observation.
        magnitude: The bias, the factor minus one, or the standard deviation of the noise; 0 for the other types.
        from_step: First step whose observation is perturbed; the observation of the reset is step 0.
        steps: Number of perturbed observations.
    """

    type: PerturbationType
    dimension: int
    magnitude: float
    from_step: int
    steps: int

    def to_json(self) -> JsonObject:
        """Return the perturbation as a JSON object."""
        return {
            "type": self.type.value,
            "dimension": self.dimension,
            "magnitude": self.magnitude,
            "from_step": self.from_step,
            "steps": self.steps,
        }

    @classmethod
    def from_json(cls, where: str, document: Json) -> Self:
        """Parse a perturbation.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        if not isinstance(document, Mapping):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        check_fields(where, document, ("type", "dimension", "magnitude", "from_step", "steps"))
        magnitude = document["magnitude"]
        if not _is_number(magnitude):
            raise InvalidEpisode(f"{where}.magnitude: expected a finite number, got {magnitude!r}")
        return cls(
            type=parse_choice(f"{where}.type", document["type"], PerturbationType),
            dimension=parse_integer(f"{where}.dimension", document["dimension"], 0, MAX_DIMENSIONS - 1),
            magnitude=float(magnitude),  # type: ignore[arg-type]
            from_step=parse_integer(f"{where}.from_step", document["from_step"], 0, MAX_STEPS),
            steps=parse_integer(f"{where}.steps", document["steps"], 0, MAX_STEPS),
        )

    def words(self, name: str) -> str:
        """Return the perturbation in words, such as ``pole angle biased by +0.05 from step 20 on for 100 steps``."""
        return f"{self.kind_words(name, f'{self.shown:+.3g}{self.unit}')} {self.window_words}"

    @property
    def shown(self) -> float:
        """The magnitude as displayed: gains in percent."""
        return 100.0 * self.magnitude if self.type is PerturbationType.GAIN else self.magnitude

    @property
    def unit(self) -> str:
        """The unit of `shown`; empty if it is the observation's own, which is unknown."""
        return "%" if self.type is PerturbationType.GAIN else ""

    def kind_words(self, name: str, magnitude: str) -> str:
        """Describe how a value is perturbed, without the time window.

        Args:
            name: What people call the number.
            magnitude: The magnitude in words, with its sign.
        """
        match self.type:
            case PerturbationType.BIAS:
                return f"{name} biased by {magnitude}"
            case PerturbationType.GAIN:
                return f"{name} changed by {magnitude} of its value"
            case PerturbationType.NOISE:
                return f"{name} with noise of {magnitude.lstrip('+-')}"
            case PerturbationType.FREEZE:
                return f"{name} frozen"
            case PerturbationType.DROPOUT:
                return f"{name} reported as 0"

    @property
    def window_words(self) -> str:
        """The time window in words."""
        return f"from step {self.from_step} on for {self.steps} steps"


@dataclass(frozen=True, slots=True, kw_only=True)
class GymnasiumEpisode:
    """An episode as its specification describes it.

    Attributes:
        environment: Id of a registered environment, such as ``CartPole-v1``.
        make: Arguments of the environment.
        reset: Options of its reset.
        reset_seed: Seed of its reset; None for one that is drawn from the episode's seed.
        perturbations: How observations are perturbed, in the order in which they are applied.
        policy: Name of the policy; see `brink.sim.adapters.gymnasium_env.simulator`.
        margin: Name of the function whose value is the robustness; None for the number of steps survived.
        unit: Unit of that value.
        survive_steps: Steps that an episode must not terminate before.
        steps: Maximum number of steps.
        step_s: Simulated time of a step.
        signals: Names of the numbers of the observation in formulas, and `EXTRA_SIGNALS`.
        formulas: Requirements over these, instead of the time survived or the margin.
    """

    environment: str
    make: Mapping[str, Json]
    reset: Mapping[str, Json]
    reset_seed: int | None
    perturbations: tuple[Perturbation, ...]
    policy: str
    margin: str | None
    unit: str
    survive_steps: int
    steps: int
    step_s: float
    signals: tuple[str, ...]
    formulas: Mapping[str, StatedFormula]

    @classmethod
    def from_spec(cls, spec: EpisodeSpec) -> Self:
        """Parse a specification.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        scenario, options = spec.scenario, spec.options
        check_fields("scenario", scenario, _SCENARIO)
        check_fields("options", options, (*_OPTIONS, SIGNALS) if spec.formulas else _OPTIONS)
        check_fields("behaviour", spec.behaviour, ("perturbations",))
        margin, unit, step_s = options["margin"], options["unit"], options["step_s"]
        if margin is not None:
            margin = _text("options.margin", margin)
        if not _is_number(step_s) or step_s <= 0:  # type: ignore[operator]
            raise InvalidEpisode(f"options.step_s: expected a time above 0, got {step_s!r}")
        steps = round(spec.duration_s / float(step_s))  # type: ignore[arg-type]
        if not 1 <= steps <= MAX_STEPS:
            raise InvalidEpisode(f"duration_s: expected 1 to {MAX_STEPS} steps of {step_s} s, got {steps}")
        expected = tuple(spec.formulas) or (SURVIVAL if margin is None else MARGIN,)
        if spec.requirements != expected:
            raise InvalidEpisode(
                f"requirements: expected {', '.join(expected)} alone, got {list(spec.requirements)!r}"
            )
        signals = options.get(SIGNALS, [])
        if not isinstance(signals, list) or len(signals) > MAX_DIMENSIONS + len(EXTRA_SIGNALS):
            raise InvalidEpisode(f"options.signals: expected a list of names, got {signals!r:.80}")
        names = tuple(_text("options.signals", name) for name in signals)
        try:
            formulas = stated_formulas(spec.formulas, names)
        except FormulaError as error:
            raise InvalidEpisode(f"formulas: {error}") from error
        seed = scenario["reset_seed"]
        return cls(
            environment=_text("scenario.environment", scenario["environment"]),
            make=_object("scenario.make", scenario["make"]),
            reset=_object("scenario.reset", scenario["reset"]),
            reset_seed=None if seed is None else parse_integer("scenario.reset_seed", seed, 0, 2**31 - 1),
            perturbations=_perturbations(spec.behaviour["perturbations"]),
            policy=_text("options.policy", options["policy"]),
            margin=margin,
            unit=_text("options.unit", unit),
            survive_steps=parse_integer("options.survive_steps", options["survive_steps"], 1, steps),
            steps=steps,
            step_s=float(step_s),  # type: ignore[arg-type]
            signals=names,
            formulas=formulas,
        )


def _perturbations(document: Json) -> tuple[Perturbation, ...]:
    if not isinstance(document, list) or len(document) > MAX_PERTURBATIONS:
        raise InvalidEpisode(
            f"behaviour.perturbations: expected a list of at most {MAX_PERTURBATIONS}, got {document!r:.80}"
        )
    return tuple(
        Perturbation.from_json(f"behaviour.perturbations[{index}]", one) for index, one in enumerate(document)
    )


def _is_number(value: Json) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _text(where: str, value: Json) -> str:
    if not isinstance(value, str) or not value:
        raise InvalidEpisode(f"{where}: expected a name, got {value!r}")
    return value


def _object(where: str, value: Json) -> Mapping[str, Json]:
    if not isinstance(value, dict):
        raise InvalidEpisode(f"{where}: expected an object, got {value!r:.80}")
    return value

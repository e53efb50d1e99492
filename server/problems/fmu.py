"""The problem `fmu@1`: a whole plant as an FMU, whose parameters and start values are searched.

The campaign file names the FMU by its path. What is executed must be installed on workers: the campaign names it by
the digest of its file, and contributes numbers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

from brink.search.errors import ConfigError, SpaceError
from brink.search.settings import check_settings, setting
from brink.search.shorthand import space_of
from brink.search.space import SearchSpace
from brink.server.problems.command import checked_requirements
from brink.server.problems.plain_values import PlainValues
from brink.sim.adapters.command.definition import choice_text
from brink.sim.adapters.command.signals import SignalError, Signals
from brink.sim.adapters.fmu.installed import install, is_reference, simulator_id
from brink.sim.adapters.fmu.simulator import step_count
from brink.sim.fmi import FmuError
from brink.sim.formula_requirement import StatedFormula

_VARIABLE: Final = "variable"
_EXAMPLE: Final[Mapping[str, Any]] = {
    "space": {"scenario": {"gap": {"min": 5.0, "max": 60.0, "unit": "m", "resolution": 0.1}}},
    "requirements": {"keep-gap": {"signal": "gap", "above": 0.0, "unit": "m"}},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class FmuParams:
    """Parameters of the problem. The defaults only show their form."""

    fmu: str = setting(
        "", help="Path of the FMU; brink run and brink submit replace it by its name and digest."
    )
    space: dict[str, Any] = field(
        default_factory=lambda: _EXAMPLE["space"],
        metadata={
            "help": "Search space: by component and variable, {min, max, unit, step, log} or {values}; in a campaign "
            "file, the FMU's own where it states them."
        },
    )
    start_values: dict[str, Any] = field(
        default_factory=dict, metadata={"help": "Values of further parameters and inputs of the FMU."}
    )
    seed_variable: str = setting("", help="Whole-number variable that gets the seed of the episode, if any.")
    step_s: float = setting(0.01, help="Communication step; by default the FMU's own.", gt=0.0, unit="s")
    stop_s: float = setting(10.0, help="Simulated time; by default the FMU's own.", gt=0.0, unit="s")
    signals: dict[str, Any] = field(
        default_factory=dict, metadata={"help": "Signals besides the FMU's variables: {columns, positions}."}
    )
    requirements: dict[str, Any] = field(
        default_factory=lambda: _EXAMPLE["requirements"],
        metadata={
            "help": "Requirements by name, {signal, above or below, unit} or a formula {stl, unit}; all must hold."
        },
    )
    timeout_s: float = setting(60.0, help="Wall-clock limit of an episode.", gt=0.0, le=86_400.0, unit="s")

    def __post_init__(self) -> None:
        check_settings(self)
        space, renamed = declared_space(self.space)
        searched = {
            renamed.get(parameter.name, parameter.name)
            for component in space.components
            for parameter in component.parameters
        }
        for variable in (*self.start_values, self.seed_variable):
            if variable in searched:
                where = "seed_variable" if variable == self.seed_variable else "start_values"
                raise ConfigError(
                    where, f"{variable}: expected a variable that the space does not set as well"
                )
        try:
            Signals.of(self.signals)
        except SignalError as error:
            raise ConfigError("signals", str(error)) from None
        try:
            step_count(self.stop_s, self.step_s)
        except FmuError as error:
            raise ConfigError("stop_s", str(error)) from None
        for name, requirement in checked_requirements(self.requirements).items():
            if isinstance(requirement, StatedFormula) and requirement.formula.begins_s > self.stop_s:
                raise ConfigError(
                    "requirements",
                    f"{name}: looks {requirement.formula.begins_s:g} s ahead, but episodes end after "
                    f"{self.stop_s:g} s",
                )


def declared_space(declared: Mapping[str, Any]) -> tuple[SearchSpace, dict[str, str]]:
    """Return the search space that a campaign declares, and the variables of parameters with another name.

    Args:
        declared: By component and name, ``{min, max, unit, step, log, resolution, when, variable}`` or ``{values}``.

    Raises:
        ConfigError: It is malformed, or two parameters set the same variable.
    """
    variables: dict[str, str] = {}
    parts: dict[str, dict[str, Any]] = {}
    for component, part in declared.items():
        if not isinstance(part, Mapping) or not all(isinstance(one, Mapping) for one in part.values()):
            raise ConfigError(
                "space",
                f"{component}: expected parameters such as gap: {{min: 5, max: 60}}, got {part!r:.80}",
            )
        for name, one in part.items():
            variable = one.get(_VARIABLE, name)
            if not isinstance(variable, str) or not variable:
                raise ConfigError("space", f"{name}: variable: expected a name, got {variable!r:.80}")
            if name in variables or variable in variables.values():
                raise ConfigError(
                    "space", f"{name}: expected each parameter and each variable once, in all components"
                )
            variables[name] = variable
        parts[component] = {name: _plain(one) for name, one in part.items()}
    try:
        space = space_of(parts)
    except SpaceError as error:
        raise ConfigError("space", str(error)) from None
    return space, {name: variable for name, variable in variables.items() if name != variable}


def _plain(declared: Mapping[str, Any]) -> dict[str, Any]:
    plain = {key: value for key, value in declared.items() if key != _VARIABLE}
    if isinstance(values := plain.get("values"), list):
        plain["values"] = [choice_text(value) for value in values]
    return plain


class Fmu(PlainValues):
    """A plant as an FMU, whose variables over time are its signals."""

    id: ClassVar[str] = "fmu@1"
    summary: ClassVar[str] = (
        "Any plant that is an FMU for co-simulation: its parameters, its outputs over time."
    )
    params_type: ClassVar[type[Any]] = FmuParams

    extra = "fmu"
    modules = ("fmpy",)
    records_signals = True

    def __init__(self, params: FmuParams) -> None:
        self.params = params
        self.space, variables = declared_space(params.space)
        self.requirements = tuple(params.requirements)
        self.needs = simulator_id(params.fmu)
        self.timeout_s = params.timeout_s
        self.duration_s = params.stop_s
        self.options = {
            "variables": dict(variables),
            "start_values": params.start_values,
            "seed_variable": params.seed_variable,
            "step_s": params.step_s,
            "signals": params.signals,
            "requirements": params.requirements,
        }
        self.records_traces = bool(params.signals.get("positions"))
        self.ignores_seeds = not params.seed_variable

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return an error if the FMU is not named by its digest, as no worker then has it."""
        if is_reference(self.params.fmu):
            return []
        return [
            (
                "fmu",
                "expected NAME@DIGEST, which brink run and brink submit make of the path in a campaign file; got "
                f"{self.params.fmu!r:.80}",
            )
        ]

    def install(self) -> None:
        """Allow the workers of this machine to run the FMU, if its file was read here."""
        install(self.params.fmu)

"""The problem `command@1`: any program that reads parameters from files or arguments and logs signals.

The campaign file states everything: the command, the files that it reads, the search space, the signals in its log
and the requirements on them. What is executed is a definition (`brink.sim.adapters.command.definition`) that workers
must have: the campaign names it by its digest and contributes values.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, Final

from brink.search.errors import ConfigError, SpaceError
from brink.search.settings import check_settings, setting
from brink.search.shorthand import space_of
from brink.search.space import SearchSpace
from brink.server.problems.plain_values import PlainValues
from brink.sim.adapters.command.definition import Definition
from brink.sim.adapters.command.requirement import Requirement, RequirementError, requirement_of
from brink.sim.adapters.command.signals import SignalError, SignalSource
from brink.sim.adapters.command.simulator import install
from brink.sim.errors import DefinitionError

MAX_REQUIREMENTS: Final = 16
_GRACE_S: Final = 10.0
"""How much longer than its time limit an episode may take, for files and signals."""
_EXAMPLE: Final[Mapping[str, Any]] = {
    "command": ["true", "--x", "{x}"],
    "space": {"scenario": {"x": {"min": 0.0, "max": 1.0, "resolution": 0.01}}},
    "signals": {"file": "log.csv"},
    "requirements": {"positive": {"signal": "x", "above": 0.0}},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandParams:
    """Parameters of the problem. The defaults only show their form."""

    command: list[Any] = field(
        default_factory=lambda: _EXAMPLE["command"],
        metadata={"help": "Program and arguments, with placeholders such as {gap}; no shell reads them."},
    )
    files: dict[str, Any] = field(
        default_factory=dict,
        metadata={"help": "Files with placeholders: a path for each name in the working folder."},
    )
    copies: dict[str, Any] = field(
        default_factory=dict, metadata={"help": "Files that are copied unchanged, named in the same way."}
    )
    environment: dict[str, Any] = field(
        default_factory=dict, metadata={"help": "Environment variables, besides PATH and a home."}
    )
    version: list[Any] = field(
        default_factory=list,
        metadata={"help": "Command whose output identifies the program; else its content does."},
    )
    program: str = setting("", help="Digest of the program; brink run and brink submit fill it in.")
    success: list[int] = field(
        default_factory=lambda: [0], metadata={"help": "Exit statuses of an episode with a verdict."}
    )
    space: dict[str, Any] = field(
        default_factory=lambda: _EXAMPLE["space"],
        metadata={
            "help": "Search space: by component and name, {min, max, unit, step, log} or {values, gives}."
        },
    )
    signals: dict[str, Any] = field(
        default_factory=lambda: _EXAMPLE["signals"],
        metadata={"help": "Log that the program writes: {file, time, columns}."},
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
        with _config_errors():
            definition = Definition.of(asdict(self))
            declared_space(self.space, definition)
            SignalSource.of(self.signals)
        checked_requirements(self.requirements)


def checked_requirements(stated: Mapping[str, Any]) -> dict[str, Requirement]:
    """Return the requirements that a campaign states, by name.

    Raises:
        ConfigError: There are none or too many, or one is malformed.
    """
    if not 1 <= len(stated) <= MAX_REQUIREMENTS:
        raise ConfigError("requirements", f"expected 1 to {MAX_REQUIREMENTS} by name, got {len(stated)}")
    made = {}
    for name, one in stated.items():
        try:
            made[name] = requirement_of(one)
        except RequirementError as error:
            raise ConfigError("requirements", f"{name}: {error}") from None
    return made


@contextmanager
def _config_errors() -> Iterator[None]:
    try:
        yield
    except DefinitionError as error:
        raise ConfigError(error.field, str(error)) from None
    except SpaceError as error:
        raise ConfigError("space", str(error)) from None
    except SignalError as error:
        raise ConfigError("signals", str(error)) from None


def declared_space(declared: Mapping[str, Any], definition: Definition) -> SearchSpace:
    """Return the search space that a campaign file declares.

    Args:
        declared: By component and name, ``{min, max, unit, step, log, resolution}`` or ``{values}``, to which
            ``gives`` may add placeholders, and ``{when, absent}`` if it may be absent.
        definition: The definition, which has the choices as text.

    Raises:
        SpaceError: It is malformed.
    """
    for name, part in declared.items():
        if not isinstance(part, Mapping) or not all(isinstance(one, Mapping) for one in part.values()):
            raise SpaceError(
                f"{name}: expected parameters such as gap: {{min: 5, max: 60}}, got {part!r:.80}"
            )
        for key, one in part.items():
            if "absent" in one and "when" not in one:
                raise SpaceError(f"{key}: absent needs when, which says with what choices it is present")
    return space_of(
        {
            name: {
                key: {name: one[name] for name in one if name not in ("absent", "gives")}
                | ({} if (choices := definition.choices[key]) is None else {"values": list(choices)})
                for key, one in part.items()
            }
            for name, part in declared.items()
        }
    )


class Command(PlainValues):
    """A program that simulates an episode, logs signals and ends."""

    id: ClassVar[str] = "command@1"
    summary: ClassVar[str] = (
        "Any simulator that is a program: files and a command with placeholders, signals from its log."
    )
    params_type: ClassVar[type[Any]] = CommandParams

    records_signals = True

    def __init__(self, params: CommandParams) -> None:
        self.params = params
        self.definition = Definition.of(asdict(params))
        self.space = declared_space(params.space, self.definition)
        self.requirements = tuple(params.requirements)
        self.needs = self.definition.simulator_id(params.program)
        self.timeout_s = params.timeout_s + _GRACE_S
        self.duration_s = params.timeout_s
        self.options = {"signals": params.signals, "requirements": params.requirements}
        self.records_traces = bool(params.signals.get("positions"))
        self.ignores_seeds = not self.definition.takes_seed

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return an error if the program is not identified, as no worker then has it."""
        if self.params.program:
            return []
        return [("program", "expected the digest of the program, which brink run and brink submit fill in")]

    def install(self) -> None:
        """Allow the workers of this machine to run the command."""
        install(self.definition, self.params.program)

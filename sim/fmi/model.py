"""What an FMU says of itself: its kind, the platforms that it is built for, and its variables."""

import math
import platform
import sys
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from brink.extras import install_command
from brink.sim.episode import nearest

BOOLEAN: Final = "Boolean"
ENUMERATION: Final = "Enumeration"
_REALS: Final = ("Real", "Float64", "Float32")
_NOT_NUMBERS: Final = ("String", "Binary", "Clock")
_TRUTH: Final[Mapping[str, int]] = MappingProxyType({"false": 0, "true": 1})
_SYSTEMS: Final = {
    "linux": ("linux64", "linux"),
    "darwin": ("darwin64", "darwin"),
    "win32": ("win64", "windows"),
}
_MOST_NAMES: Final = 12


class FmuError(Exception):
    """An FMU is not what it should be, or lacks a variable; the message says what was expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A scalar variable of an FMU.

    Attributes:
        name: Its name.
        reference: Its value reference.
        kind: Its type in FMI, such as ``Real`` or ``Int32``.
        causality: ``parameter``, ``input``, ``output``, ``local``, ``calculatedParameter`` or ``independent``.
        can_be_set: Whether it takes a value before the simulation begins.
        unit: Its unit; empty if it states none.
        least: Its minimum; None if it states none.
        greatest: Its maximum; None if it states none.
        choices: Numbers by the names of the choices, for an enumeration or a truth value; otherwise empty.
    """

    name: str
    reference: int
    kind: str
    causality: str
    can_be_set: bool
    unit: str = ""
    least: float | None = None
    greatest: float | None = None
    choices: Mapping[str, int] = field(default_factory=dict)

    @property
    def is_real(self) -> bool:
        """Whether its values are real numbers."""
        return self.kind in _REALS

    def number(self, value: object) -> float | int:
        """Return a value as the FMU takes it.

        Args:
            value: A number, or the name of a choice; a truth value may be a bool.

        Raises:
            FmuError: It is neither.
        """
        if self.choices:
            name = str(value).lower() if isinstance(value, bool) else value
            if name not in self.choices:
                raise FmuError(f"{self.name}: expected one of {', '.join(self.choices)}; got {value!r:.80}")
            return self.choices[str(name)]
        number = math.nan
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            with suppress(ValueError, OverflowError):
                number = float(value)
        if not math.isfinite(number) or not (self.is_real or number.is_integer()):
            expected = "a finite number" if self.is_real else "a whole number"
            raise FmuError(f"{self.name}: expected {expected}, got {value!r:.80}")
        return number if self.is_real else int(number)


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """A co-simulation FMU.

    Attributes:
        path: The file.
        version: Major version of FMI: 2 or 3.
        identifier: Name of its library.
        token: Its GUID or instantiation token.
        is_single: Whether a process may instantiate it only once.
        variables: Its scalar variables that are numbers, truth values or enumerations, by name.
        others: Why other variables cannot be used, by name.
        step_s: Step of its default experiment; None if it states none.
        stop_s: Stop time of its default experiment; None if it states none.
    """

    path: Path
    version: int
    identifier: str
    token: str
    is_single: bool
    variables: Mapping[str, Variable]
    others: Mapping[str, str]
    step_s: float | None
    stop_s: float | None

    def variable(self, name: str) -> Variable:
        """Return a variable.

        Raises:
            FmuError: There is none of this name, or its values are no numbers.
        """
        if name in self.variables:
            return self.variables[name]
        if name in self.others:
            raise FmuError(f"{self.path.name}: expected a scalar number; {name!r} is {self.others[name]}")
        known = tuple(self.variables)
        raise FmuError(
            f"{self.path.name} has no variable {name!r}{nearest(name, known)}; it has {_listed(known)}"
        )

    def settable(self, name: str) -> Variable:
        """Return a variable that takes a value before the simulation begins.

        Raises:
            FmuError: There is none of this name, or it takes none.
        """
        variable = self.variable(name)
        if not variable.can_be_set:
            able = [one.name for one in self.variables.values() if one.can_be_set]
            raise FmuError(
                f"{self.path.name}: expected a parameter, an input or a variable with a start value; {name!r} is "
                f"computed ({variable.causality}); there are {_listed(able)}"
            )
        return variable


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    return (", ".join(names[:_MOST_NAMES]) or "none") + (f" and {more:,} more" if more > 0 else "")


def builds_for_here() -> tuple[str, ...]:
    """Return the names of the folders with builds for this machine: by FMI 2, and by FMI 3."""
    of_fmi2, system = _SYSTEMS.get(sys.platform, (sys.platform, sys.platform))
    machine = platform.machine().lower()
    architecture = {"arm64": "aarch64", "amd64": "x86_64"}.get(machine, machine)
    return of_fmi2, f"{architecture}-{system}"


def builds_in(path: Path) -> tuple[str, ...]:
    """Return the platforms that an FMU is built for, by the names of their folders.

    Raises:
        FmuError: It cannot be read, or is no archive.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name.split("/") for name in archive.namelist()]
    except OSError as error:
        raise FmuError(f"{path} cannot be read: {error.strerror}") from None
    except zipfile.BadZipFile:
        raise FmuError(f"{path}: expected an FMU, which is a ZIP archive") from None
    return tuple(
        sorted({parts[1] for parts in names if parts[0] == "binaries" and len(parts) > 2 and parts[2]})
    )


def read_model(path: Path) -> Model:
    """Read what an FMU says of itself; none of its code runs.

    Raises:
        FmuError: It is no co-simulation FMU of FMI 2 or 3 with a build for this machine, or FMPy is not installed.
    """
    builds = builds_in(path)
    description = _description(path)
    version = str(description.fmiVersion)
    if description.coSimulation is None or version.partition(".")[0] not in ("2", "3"):
        kinds = {
            "co-simulation": description.coSimulation,
            "model exchange": description.modelExchange,
            "scheduled execution": description.scheduledExecution,
        }
        has = " and ".join(kind for kind, stated in kinds.items() if stated is not None)
        raise FmuError(f"{path.name}: expected co-simulation by FMI 2 or 3; it is for {has} by FMI {version}")
    major = int(version[0])
    here = builds_for_here()[major - 2]
    if here not in builds:
        raise FmuError(f"{path.name}: expected a build for {here}; it has {', '.join(builds) or 'none'}")
    variables, others = {}, {}
    for one in description.modelVariables:
        if one.type in _NOT_NUMBERS or one.dimensions:
            others[one.name] = "an array" if one.dimensions else f"a {one.type}"
        else:
            variables[one.name] = _variable(one)
    experiment = description.defaultExperiment
    return Model(
        path=path,
        version=major,
        identifier=description.coSimulation.modelIdentifier,
        token=description.guid,
        is_single=_is_true(description.coSimulation.canBeInstantiatedOnlyOncePerProcess),
        variables=variables,
        others=others,
        step_s=None if experiment is None else _positive(experiment.stepSize),
        stop_s=None if experiment is None else _positive(experiment.stopTime),
    )


def _description(path: Path) -> Any:
    """Return the model description as FMPy reads it."""
    try:
        from fmpy.model_description import ValidationError, read_model_description
    except ImportError:
        raise FmuError(f"an FMU needs FMPy: {install_command('fmu')}") from None
    try:
        return read_model_description(str(path))
    except ValidationError as error:
        raise FmuError(
            f"{path.name}: invalid modelDescription.xml: {'; '.join(error.problems)[:800]}"
        ) from None
    except KeyError as error:
        raise FmuError(f"{path.name}: expected an FMU: {error.args[0]}") from None
    except Exception as error:  # noqa: BLE001  (FMPy and lxml raise many types for files that are none)
        raise FmuError(f"{path.name}: modelDescription.xml cannot be read: {error}") from None


def _variable(stated: Any) -> Variable:
    declared = stated.declaredType
    return Variable(
        name=stated.name,
        reference=stated.valueReference,
        kind=stated.type,
        causality=stated.causality,
        can_be_set=stated.causality in ("parameter", "input")
        or (
            stated.causality in ("output", "local")
            and stated.variability != "constant"
            and stated.initial in ("exact", "approx")
        ),
        unit=stated.unit or (declared and declared.unit) or "",
        least=_finite(stated.min or (declared and declared.min)),
        greatest=_finite(stated.max or (declared and declared.max)),
        choices=_TRUTH
        if stated.type == BOOLEAN
        else {item.name: int(item.value) for item in declared.items}
        if stated.type == ENUMERATION and declared
        else {},
    )


def _is_true(stated: object) -> bool:
    return stated is True or stated in ("true", "1")


def _finite(text: object) -> float | None:
    try:
        number = float(str(text))
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _positive(text: object) -> float | None:
    number = _finite(text)
    return number if number is not None and number > 0 else None

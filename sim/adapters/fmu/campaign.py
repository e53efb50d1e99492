"""What a campaign file leaves to its FMU: ranges and units of parameters, step and stop time.

The FMU is read where the campaign file is, so that a variable that is missing, or a wrong kind of FMU, is an error
before the campaign is submitted. Nothing of the FMU runs.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from brink.sim.adapters.command.definition import choice_text
from brink.sim.adapters.command.requirement import RequirementError, requirement_of
from brink.sim.adapters.command.signals import SignalError, Signals, needed_columns
from brink.sim.adapters.fmu.installed import is_reference, reference_of
from brink.sim.adapters.fmu.simulator import TIME
from brink.sim.errors import DefinitionError
from brink.sim.fmi import FmuError, Model, Variable, read_model

_NUMBERS: Final = ("min", "max", "step", "log", "resolution")


def read_files(params: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the parameters in a campaign file with the reference of the FMU, and what it states itself.

    Args:
        params: The parameters.
        folder: Folder of the campaign file.

    Raises:
        DefinitionError: The FMU cannot be read or is of another kind, or lacks a variable.
    """
    read, given = dict(params), params.get("fmu")
    if not isinstance(given, str) or not given or is_reference(given):
        return read
    try:
        model = read_model(folder / given)
    except FmuError as error:
        raise DefinitionError("fmu", str(error)) from None
    read["fmu"] = reference_of(folder / given)
    if isinstance(space := params.get("space"), Mapping):
        read["space"] = {
            component: {name: _completed(model, str(name), stated) for name, stated in part.items()}
            if isinstance(part, Mapping)
            else part
            for component, part in space.items()
        }
    _check_start_values(model, params)
    for field, stated_s in (("step_s", model.step_s), ("stop_s", model.stop_s)):
        if params.get(field) is None:
            if stated_s is None:
                raise DefinitionError(field, f"expected a time in s, since {model.path.name} states none")
            read[field] = stated_s
    for field, name in _needed(params):
        try:
            if name != TIME:
                model.variable(name)
        except FmuError as error:
            raise DefinitionError(field, str(error)) from None
    return read


def _completed(model: Model, name: str, stated: object) -> object:
    """Return a parameter with range or choices, and unit; what is malformed stays as it is."""
    if not isinstance(stated, Mapping | None):
        return stated
    given = dict(stated or {})
    try:
        variable = model.settable(str(given.get("variable", name)))
    except FmuError as error:
        raise DefinitionError("space", str(error)) from None
    if isinstance(values := given.get("values"), list):
        _check_values(variable, values)
        return given | {"values": [choice_text(value) for value in values]}
    if variable.choices:
        if wrong := [key for key in _NUMBERS if key in given]:
            raise DefinitionError(
                "space", f"{name}: expected values, some of {', '.join(variable.choices)}; got {wrong[0]}"
            )
        return given | {"values": list(variable.choices)}
    return _with_range(model, name, variable, given)


def _with_range(model: Model, name: str, variable: Variable, given: dict[str, Any]) -> dict[str, Any]:
    for key, stated in (("min", variable.least), ("max", variable.greatest)):
        if key not in given and stated is None:
            raise DefinitionError(
                "space", f"{name}: expected {key}, since {model.path.name} states none for {variable.name}"
            )
        number = given.setdefault(key, stated)
        if not isinstance(number, int | float) or isinstance(number, bool):
            return given
        if stated is not None and (number < stated if key == "min" else number > stated):
            raise DefinitionError(
                "space",
                f"{name}: expected {key} within the range of {variable.name} in {model.path.name}, which ends at "
                f"{stated:g}; got {number:g}",
            )
    if not variable.is_real:
        for key in ("min", "max", "step"):
            number = given.setdefault(key, 1)
            if not isinstance(number, int | float) or not float(number).is_integer():
                raise DefinitionError(
                    "space", f"{name}: expected whole numbers for {variable.kind}; got {number!r} as {key}"
                )
            given[key] = int(number)
    return given | ({"unit": variable.unit} if variable.unit and "unit" not in given else {})


def _check_values(variable: Variable, values: list[object]) -> None:
    try:
        for value in values:
            variable.number(value)
    except FmuError as error:
        raise DefinitionError("space", str(error)) from None


def _check_start_values(model: Model, params: Mapping[str, Any]) -> None:
    start_values, seed_variable = params.get("start_values"), params.get("seed_variable")
    try:
        for name, value in start_values.items() if isinstance(start_values, Mapping) else ():
            model.settable(str(name)).number(value)
    except FmuError as error:
        raise DefinitionError("start_values", str(error)) from None
    try:
        if isinstance(seed_variable, str) and seed_variable:
            model.settable(seed_variable).number(0)
    except FmuError as error:
        raise DefinitionError("seed_variable", str(error)) from None


def _needed(params: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the variables that verdicts and positions need, each with its field; none if these are malformed."""
    try:
        source = Signals.of(params.get("signals", {}))
        requirements = [requirement_of(one) for one in params["requirements"].values()]
    except (SignalError, RequirementError, LookupError, AttributeError, TypeError):
        return
    for field, names in (
        ("requirements", [name for one in requirements for name in one.signals]),
        ("signals", source.named),
    ):
        for name in needed_columns(source.formulas(names)):
            yield field, name

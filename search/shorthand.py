"""Search spaces as plain values: ``{"speed": (5.0, 30.0, "m/s"), "lanes": range(2, 5), "road": ["dry", "wet"]}``.

A pair is the range of a real number, and a third value its unit or its step; a fourth one is its resolution, the
largest difference that people would call the same. A `range`, or three whole numbers, are an integer's, a list of
texts a choice. A mapping names all of this, as in a campaign file: ``{"min": 1e-6, "max": 1, "log": True}``,
``{"values": ["dry", "wet"]}``. A space of several components has one mapping of parameters for each. `space_from`
reads what `SearchSpace.describe` returns.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

from brink.search.errors import SpaceError
from brink.search.parameters import Categorical, Integer, Parameter, Real, ResolutionByChoice, When
from brink.search.space import Component, SearchSpace

DeclaredSpace: TypeAlias = "SearchSpace | Sequence[Parameter] | Mapping[str, Any]"
"""How a space is written; a mapping as this module describes, since a type cannot say that."""

ONLY_COMPONENT: Final = "parameters"
"""Name of the component of a space that is written without components."""
_EXPECTED: Final = (
    "expected a range such as (0.0, 1.0), (5.0, 30.0, 'm/s'), (0, 10, 0.1) in steps or (5.0, 30.0, 'm/s', 0.1) with "
    "a resolution, whole numbers such as range(0, 5), choices such as ['dry', 'wet'], or a mapping such as "
    "{'min': 1e-6, 'max': 1, 'log': True}"
)
_NAMED: Final = frozenset({"min", "max", "step", "log", "unit", "resolution", "title", "when"})
"""What the mapping of a number may name."""


def space_of(declared: DeclaredSpace, constraints: Sequence[str] = ()) -> SearchSpace:
    """Return the search space that plain values describe.

    Args:
        declared: Parameters by name, or such mappings by component, or a list of parameters, or a space.
        constraints: Conditions that every solution meets; see `SearchSpace.constrained`.

    Raises:
        SpaceError: A parameter is not written as expected, its range is empty, or a constraint is not a condition on
            the parameters that some solutions meet.
    """
    space = _unconstrained(declared)
    return space.constrained(constraints) if constraints else space


def _unconstrained(declared: DeclaredSpace) -> SearchSpace:
    if isinstance(declared, SearchSpace):
        return declared
    if isinstance(declared, Mapping):
        if not declared:
            raise SpaceError("expected at least one parameter, got none")
        parts = [isinstance(value, Mapping) and not _is_parameter(value) for value in declared.values()]
        if all(parts):
            return SearchSpace(tuple(_component(name, part) for name, part in declared.items()))
        if any(parts):
            raise SpaceError("expected parameters by name, or by component and name; got both")
        return SearchSpace((_component(ONLY_COMPONENT, declared),))
    parameters = tuple(declared)
    if not parameters or not all(isinstance(parameter, Parameter) for parameter in parameters):
        raise SpaceError(f"expected a mapping of names to ranges or choices, got {declared!r}")
    return SearchSpace((Component(ONLY_COMPONENT, parameters),))


def _component(name: str, declared: Mapping[str, Any]) -> Component:
    if not declared:
        raise SpaceError(f"{name}: expected at least one parameter, got none")
    return Component(name, tuple(_parameter(key, value) for key, value in declared.items()))


def _is_parameter(declared: Mapping[str, Any]) -> bool:
    """Return whether a mapping names the properties of a parameter, and not the parameters of a component."""
    low, values = declared.get("min", declared.get("max")), declared.get("values")
    return isinstance(low, int | float) or isinstance(values, list)


def _parameter(name: str, declared: Any) -> Parameter:
    match declared:
        case Mapping():
            return _named_parameter(name, declared)
        case Real() | Integer() | Categorical():
            if declared.name != name:
                raise SpaceError(
                    f"{name}: expected a parameter of the same name, got one named {declared.name!r}"
                )
            return declared
        case range():
            if declared.step < 1 or len(declared) < 2:
                raise SpaceError(
                    f"{name}: expected a range of at least two ascending numbers, got {declared}"
                )
            return Integer(name, declared[0], declared[-1], step=declared.step)
        case str():
            raise SpaceError(f"{name}: {_EXPECTED}; got {declared!r}")
        case [low, high] if _are_numbers(low, high):
            return Real(name, float(low), float(high))
        case [low, high, step] if _are_numbers(low, high, step):
            return _number(name, low, high, step=step)
        case [low, high, str(unit)] if _are_numbers(low, high):
            return Real(name, float(low), float(high), unit)
        case [low, high, str(unit), resolution] if _are_numbers(low, high, resolution):
            return Real(name, float(low), float(high), unit, resolution=float(resolution))
        case [*choices] if choices and all(isinstance(choice, str) for choice in choices):
            return Categorical(name, tuple(choices))
    raise SpaceError(f"{name}: {_EXPECTED}; got {declared!r}")


def _named_parameter(name: str, declared: Mapping[str, Any]) -> Parameter:
    """Return the parameter whose properties a mapping names."""
    when = _when(name, declared.get("when"))
    if set(declared) <= {"values", "when"} and isinstance(values := declared.get("values"), list):
        return Categorical(name, tuple(map(str, values)), when=when)
    unknown = sorted(map(str, set(declared) - _NAMED))
    if unknown or not {"min", "max"} <= set(declared):
        known = ", ".join(sorted(_NAMED))
        raise SpaceError(
            f"{name}: expected values, or min and max and any of {known}; got {dict(declared)!r}"
        )
    low, high = declared["min"], declared["max"]
    given = {key: value for key, value in declared.items() if key not in ("min", "max") and value is not None}
    numbers = [low, high, *(given[key] for key in ("step", "resolution") if key in given)]
    if not _are_numbers(*numbers) or not isinstance(given.get("log", False), bool):
        raise SpaceError(
            f"{name}: expected numbers as min, max, step and resolution, and true or false as log, "
            f"got {dict(declared)!r}"
        )
    if not all(isinstance(given.get(key, ""), str) for key in ("unit", "title")):
        raise SpaceError(f"{name}: expected unit and title as texts, got {dict(declared)!r}")
    return _number(name, low, high, **given | {"when": when})


def _when(name: str, declared: object) -> When:
    """Return the choices with which a parameter is present: ``{"type": "cut-in"}``, or several in a list."""
    if declared is None:
        return ()
    if not isinstance(declared, Mapping) or not declared:
        raise SpaceError(
            f"{name}: expected when as a parameter with its choices, such as {{'type': 'cut-in'}}"
        )
    pairs = ((str(label), one if isinstance(one, list | tuple) else [one]) for label, one in declared.items())
    return tuple((label, tuple(map(str, choices))) for label, choices in pairs)


def _number(name: str, low: float, high: float, **given: Any) -> Real | Integer:
    """Return a real number, or an integer if its ends and its step are whole numbers."""
    whole = all(isinstance(one, int) for one in (low, high, given.get("step")))
    return (
        Integer(name, int(low), int(high), **given) if whole else Real(name, float(low), float(high), **given)
    )


def _are_numbers(*values: object) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def space_from(description: Mapping[str, Any]) -> SearchSpace:
    """Return the search space that `SearchSpace.describe` described.

    Args:
        description: Its JSON object.

    Raises:
        SpaceError: It is not one, or a component has constraints of its own, which are not read.
    """
    try:
        space = SearchSpace(tuple(_described(component) for component in description["components"]))
        return space.constrained(constraints) if (constraints := description.get("constraints")) else space
    except (LookupError, TypeError, AttributeError) as error:
        raise SpaceError(
            f"expected a description of a search space: {type(error).__name__}: {error}"
        ) from None


def _described(component: Mapping[str, Any]) -> Component:
    if component.get("constraints"):
        raise SpaceError(f"{component['name']}: expected a component without constraints")
    return Component(component["name"], tuple(map(_described_parameter, component["parameters"])))


def _described_parameter(described: Mapping[str, Any]) -> Parameter:
    name = described["name"]
    parameter: Parameter
    when = _when(name, described.get("when"))
    match described["type"]:
        case "real":
            parameter = Real(
                name,
                float(described["low"]),
                float(described["high"]),
                described.get("unit", ""),
                step=described.get("step"),
                log=described.get("log", False),
                resolution=_described_resolution(described),
                when=when,
            )
        case "integer":
            parameter = Integer(
                name,
                described["low"],
                described["high"],
                described.get("unit", ""),
                step=described.get("step"),
                resolution=_described_resolution(described),
                when=when,
            )
        case "categorical":
            parameter = Categorical(name, tuple(described["choices"]), when=when)
        case other:
            raise SpaceError(f"{name}: expected the type real, integer or categorical, got {other!r}")
    return parameter.limited(described["odd"]) if "odd" in described else parameter


def _described_resolution(described: Mapping[str, Any]) -> float | ResolutionByChoice | None:
    resolution = described.get("resolution")
    if isinstance(resolution, Mapping):
        return ResolutionByChoice(str(resolution["label"]), dict(resolution["by_choice"]))
    return None if resolution is None else float(resolution)


def flat_values(values: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return decoded values by name alone where that is unambiguous, otherwise by component.name.

    Args:
        values: By component, then by name, as `SearchSpace.decode` returns them.
    """
    names = [name for part in values.values() for name in part]
    unique = len(set(names)) == len(names)
    return {
        name if unique else f"{component}.{name}": value
        for component, part in values.items()
        for name, value in part.items()
    }

"""The operational design domain (ODD): the values to which a search limits the parameters of its space.

It is written as a mapping of parameters to limits: ``{"scenario.weather": ["clear", "rain"], "scenario.speed":
{"min": 5, "max": 12}, "behaviour.x": 3}``. A name may contain ``*``, which stands for any characters, so that
``behaviour.trajectory_*.label`` limits all trajectories.

The limits are part of the parameters of a `SearchSpace` (`Number.bounds`, `Categorical.allowed`), so that whatever
draws, repairs or checks solutions respects them. Rows and their encoding are the same with and without an ODD, and so
are distances: they are normalised by the whole ranges (see docs/adr/0057-the-odd-and-distances.md).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Final

from brink.search.errors import OddError, SpaceError
from brink.search.parameters import Categorical, Limit, Number, Parameter, did_you_mean, parameter_title
from brink.search.space import SearchSpace

_NUMBER: Final = re.compile(r"[ _]?[0-9]+")
_MOST_NAMED: Final = 30
"""Maximum number of parameters that a message names."""


def limited(space: SearchSpace, odd: Mapping[str, object]) -> SearchSpace:
    """Return a space within an ODD; the space itself if nothing is limited.

    Args:
        space: The space; limits that it has already are replaced if they are named again.
        odd: Limits by component.parameter: one value, a list of choices, or an object with ``min``, ``max`` or both.

    Raises:
        OddError: A parameter is unknown or limited twice, a limit is invalid, no solution is within all limits, or
            there is only one.
    """
    if not odd:
        return space
    limits: dict[str, tuple[str, object]] = {}
    for given, limit in odd.items():
        try:
            names = matching_names(space, given)
        except SpaceError as error:
            raise OddError(str(given), str(error)) from None
        for name in names:
            if name in limits:
                raise OddError(
                    given, f"{name} is limited twice, by {limits[name][0]} too: expected one limit"
                )
            limits[name] = given, limit
    components = []
    for component in space.components:
        own = {
            name: limits[full] for name in component.by_name if (full := f"{component.name}.{name}") in limits
        }
        for name, (given, limit) in own.items():
            try:
                component.by_name[name].limited(limit)
            except SpaceError as error:
                raise OddError(given, f"{component.name}.{error}") from None
        try:
            components.append(component.limited({name: limit for name, (_, limit) in own.items()}))
        except SpaceError as error:
            raise OddError(None, str(error)) from None
    try:
        within = replace(space, components=tuple(components))
    except SpaceError as error:
        raise OddError(None, str(error)) from None
    if within.size <= 1:
        raise OddError(
            None, "fixes every parameter: expected at least two different solutions within the ODD"
        )
    return within


def matching_names(space: SearchSpace, given: object) -> list[str]:
    """Return the full names of the parameters that a name stands for, in which ``*`` stands for any characters.

    Raises:
        SpaceError: There are none.
    """
    names = space.column_names()
    if not isinstance(given, str):
        raise SpaceError(f"expected the name of a parameter, got {given!r}")
    matching = [name for name in names if fnmatchcase(name, given)] if "*" in given else [given]
    if not matching or matching[0] not in names:
        close = did_you_mean(given, names)
        close = "" if close.startswith("; known") else close
        known = ", ".join(names[:_MOST_NAMED]) + (
            f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        )
        raise SpaceError(f"unknown parameter {given!r}{close}; known: {known}")
    return matching


def odd_of(space: SearchSpace) -> dict[str, Limit]:
    """Return the ODD of a space, in the form that `limited` takes, with full names; empty if nothing is limited."""
    return {
        f"{component.name}.{parameter.name}": parameter.odd
        for component in space.components
        for parameter in component.parameters
        if parameter.odd is not None
    }


def odd_words(space: SearchSpace) -> str:
    """Return the ODD of a space in words, such as ``scenario: weather is clear or rain``; empty for none.

    Parameters whose names differ in their numbers alone share a clause if all of them have the same limit.
    """
    numbered: dict[str, list[tuple[str, Parameter]]] = {}
    for component in space.components:
        for parameter in component.parameters:
            pattern = _NUMBER.sub("", f"{component.name}.{parameter.name}")
            numbered.setdefault(pattern, []).append((parameter_title(component.name, parameter), parameter))
    clauses = []
    for members in numbered.values():
        title, first = members[0]
        if len(members) > 1 and all(one.odd == first.odd for _, one in members):
            members = [(f"{_NUMBER.sub('', title)} (each)", first)]
        clauses += [f"{title} is {limit_words(one)}" for title, one in members if one.odd is not None]
    return "; ".join(clauses)


def odd_sentence(space: SearchSpace) -> str:
    """Return sentences that state the ODD and the constraints to which results apply; empty without any."""
    words, constraints = odd_words(space), "; ".join(space.constraints)
    told = f"All of this is within the ODD: {words}. Nothing outside it was simulated." if words else ""
    more = f"Only solutions that meet the constraints were simulated: {constraints}." if constraints else ""
    return " ".join(filter(None, (told, more)))


def with_odd(words: str, space: SearchSpace) -> str:
    """Return sentences about results in a space, followed by the ODD to which they apply, if there is one."""
    return " ".join(filter(None, (words, odd_sentence(space))))


def is_within(parameter: Parameter, value: object) -> bool:
    """Return whether a human-readable value of a parameter is within the ODD."""
    try:
        parameter.encode(value)
    except SpaceError:
        return False
    return True


def limit_words(parameter: Parameter) -> str:
    """Return the values of a parameter within the ODD, such as ``5 to 12 m/s`` or ``clear or rain``."""
    if isinstance(parameter, Categorical):
        allowed = parameter.choices if parameter.allowed is None else parameter.allowed
        return _listed([choice.replace("_", " ") for choice in allowed], "or")
    return _number_words(parameter)


def _number_words(parameter: Number) -> str:
    least, most = parameter.ends
    numbers = f"{least:g}" if least == most else f"{least:g} to {most:g}"
    return f"{numbers} {parameter.unit}".rstrip()


def _listed(words: Sequence[str], last: str) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"

"""Constraints inside a component: which values go together, and how a vector that breaks them is mended.

`Extent` and `Duration` each own two numbers, bounds included; no number has two owners, so that mending one
constraint never breaks another. `Dormant` puts a block of numbers to sleep (stored as 0) while its label is the
null choice; the constraints of sleeping numbers rest with them.

Source of `Extent`: Sharifi et al. 2023, case-study encoding (repair of a bounding box, axis by axis).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from brink.search.errors import SpaceError
from brink.search.parameters import Categorical, Integer, Number, Parameter, Real, nearest

Values = dict[str, float]


class Constraint(Protocol):
    """What a component asks of a constraint between numbers."""

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that it owns."""
        ...

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint cannot be kept with these parameters."""
        ...

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Mend the owned values in place, their ranges included; values that comply stay as they are."""
        ...

    def problem(self, values: Values, parameters: Mapping[str, Parameter]) -> str | None:
        """Return what is wrong with the values, or None."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""
        ...


def _number(parameters: Mapping[str, Parameter], name: str, kind: str) -> Number:
    parameter = parameters.get(name)
    if parameter is None:
        raise SpaceError(f"{kind}: unknown parameter {name!r}{nearest(name, parameters)}")
    if not isinstance(parameter, Real | Integer):
        raise SpaceError(f"{kind}: expected {name} to be a number, got a categorical parameter")
    return parameter


def _fit_pair(
    parameters: Mapping[str, Parameter], kind: str, names: tuple[str, str], minimum: float, size: float
) -> None:
    if names[0] == names[1]:
        raise SpaceError(f"{kind}: expected two parameters, got {names[0]!r} twice")
    numbers = [_number(parameters, name, kind) for name in names]
    if type(numbers[0]) is not type(numbers[1]):
        raise SpaceError(f"{kind}: expected {names[0]} and {names[1]} both real or both integer")
    for name, number in zip(names, numbers, strict=True):
        if number.low != 0 or number.high != size:
            raise SpaceError(
                f"{kind}: expected {name} in [0, {size:g}], got [{number.low:g}, {number.high:g}]"
            )
    if not 0 < _apart(minimum, names, parameters) <= size:
        raise SpaceError(f"{kind}: expected a minimum in (0, {size:g}], got {minimum!r}")


def _apart(minimum: float, names: tuple[str, str], parameters: Mapping[str, Parameter]) -> float:
    """Return the distance that two numbers must keep: a whole one if they are whole."""
    return float(math.ceil(minimum)) if isinstance(parameters[names[0]], Integer) else minimum


def _are_apart(low: float, high: float, minimum: float) -> bool:
    # Repair sets one side to the other plus or minus the minimum; which of these hold exactly is a matter of
    # rounding, so each counts.
    return high - low >= minimum or high >= low + minimum or low <= high - minimum


def _stretched(low: float, high: float, minimum: float, size: float) -> tuple[float, float]:
    """Return the pair with at least the minimum between, growing upwards if that fits, else downwards."""
    if _are_apart(low, high, minimum):
        return low, high
    if low + minimum <= size:
        return low, low + minimum
    if high - minimum >= 0:
        return high - minimum, high
    return 0.0, minimum


def _pair_problem(
    names: tuple[str, str],
    values: Values,
    parameters: Mapping[str, Parameter],
    minimum: float,
) -> str | None:
    low, high = (values[name] for name in names)
    apart = _apart(minimum, names, parameters)
    if _are_apart(low, high, apart):
        return None
    return f"expected {names[1]} at least {apart:g} above {names[0]}, got {low!r} and {high!r}"


@dataclass(frozen=True, slots=True)
class Extent:
    """One axis of a box: ``high`` at least ``minimum`` above ``low``, both in [0, size].

    Attributes:
        low: Name of the parameter of the lower side, with range [0, size].
        high: Name of the parameter of the upper side, with the same range.
        minimum: Smallest extent, in (0, size].
        size: Size of the frame on this axis.
    """

    low: str
    high: str
    minimum: float
    size: float

    @property
    def names(self) -> tuple[str, str]:
        """The parameters that it owns."""
        return self.low, self.high

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint cannot be kept with these parameters."""
        _fit_pair(parameters, "Extent", self.names, self.minimum, self.size)

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Mend the sides in place, in the order that the paper's encoding fixes."""
        low, high = values[self.low], values[self.high]
        minimum = _apart(self.minimum, self.names, parameters)
        if high < low:
            high = low + minimum
        low, high = max(low, 0.0), min(high, float(self.size))
        values[self.low], values[self.high] = _stretched(low, high, minimum, float(self.size))

    def problem(self, values: Values, parameters: Mapping[str, Parameter]) -> str | None:
        """Return what is wrong with the sides, or None."""
        return _pair_problem(self.names, values, parameters, self.minimum)

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""
        return {
            "type": "extent",
            "low": self.low,
            "high": self.high,
            "minimum": self.minimum,
            "size": self.size,
        }


@dataclass(frozen=True, slots=True)
class Duration:
    """A span of time: ``end`` at least ``minimum`` after ``start``, both in [0, horizon].

    Times in the wrong order are swapped before anything else, so that a span keeps its place.

    Attributes:
        start: Name of the parameter of the start, with range [0, horizon].
        end: Name of the parameter of the end, with the same range.
        minimum: Shortest duration, in (0, horizon]; rounded up where times are integers.
        horizon: Latest time.
    """

    start: str
    end: str
    minimum: float
    horizon: float

    @property
    def names(self) -> tuple[str, str]:
        """The parameters that it owns."""
        return self.start, self.end

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint cannot be kept with these parameters."""
        _fit_pair(parameters, "Duration", self.names, self.minimum, self.horizon)

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Mend the times in place: in order, inside the horizon, then the minimum apart."""
        horizon = float(self.horizon)
        start, end = sorted(min(max(values[name], 0.0), horizon) for name in self.names)
        minimum = _apart(self.minimum, self.names, parameters)
        values[self.start], values[self.end] = _stretched(start, end, minimum, horizon)

    def problem(self, values: Values, parameters: Mapping[str, Parameter]) -> str | None:
        """Return what is wrong with the times, or None."""
        return _pair_problem(self.names, values, parameters, self.minimum)

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""
        return {
            "type": "duration",
            "start": self.start,
            "end": self.end,
            "minimum": self.minimum,
            "horizon": self.horizon,
        }


@dataclass(frozen=True, slots=True)
class Dormant:
    """A block of numbers that sleeps, stored as 0, while its label is the null choice.

    When the label comes back to life the numbers are drawn afresh: sleeping zeros carry nothing worth keeping.

    Attributes:
        label: Name of the categorical parameter that decides.
        null_choice: The choice with which the block sleeps.
        members: Names of the block's numbers; 0 lies in the range of each.
    """

    label: str
    null_choice: str
    members: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint cannot be kept with these parameters."""
        label = parameters.get(self.label)
        if not isinstance(label, Categorical):
            raise SpaceError(f"Dormant: expected {self.label!r} to name a categorical parameter")
        if self.null_choice not in label.choices:
            known = nearest(self.null_choice, label.choices)
            raise SpaceError(f"Dormant: {self.label} has no choice {self.null_choice!r}{known}")
        if not self.members or len(set(self.members)) < len(self.members):
            raise SpaceError(f"Dormant: expected different members, got {self.members!r}")
        for name in self.members:
            number = _number(parameters, name, "Dormant")
            if not number.low <= 0 <= number.high:
                raise SpaceError(
                    f"Dormant: expected 0 in the range of {name}, got [{number.low:g}, {number.high:g}]"
                )

    def asleep(self, values: Mapping[str, float], parameters: Mapping[str, Parameter]) -> bool:
        """Return whether the block sleeps."""
        label = parameters[self.label]
        return label.decode(values[self.label]) == self.null_choice

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""
        return {
            "type": "dormant",
            "label": self.label,
            "null_choice": self.null_choice,
            "members": list(self.members),
        }

"""Parameters of a search space and the constraints between them.

A parameter's value in a vector is one float64: the number itself, its natural logarithm on a log scale, or the index
of the choice. So whatever measures, moves or halves vectors respects the scale. NaN stands for "no value yet"; repair
draws a fresh one.

A constraint ties several parameters together, checks them, and repairs vectors that violate it. Each number belongs
to at most one constraint, so repairing one constraint never violates another. `Dormant` is the exception: it switches
a block of numbers off while its label has the null choice, and the constraints of those numbers with it.

Sources: boxes and time spans, Sharifi et al. 2023, section 5.1. The smallest box, the shortest span, the order of the
repair and the null choice are not in the paper but in the authors' code.
"""

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from decimal import Decimal
from typing import Any, ClassVar, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from brink.search.errors import SpaceError

Value: TypeAlias = float | int | str
"""A parameter's value as people read and write it."""

Values: TypeAlias = dict[str, float]
"""Stored values of a component's parameters, by name."""

When: TypeAlias = tuple[tuple[str, tuple[str, ...]], ...]
"""Categorical parameters of the same component, each with those of its choices with which a parameter is present."""

ABSENT = "absent"
"""What people read in place of the value of an absent parameter."""

Limit: TypeAlias = float | int | str | list[str] | dict[str, float]
"""What an operational design domain limits a parameter to: one value, some choices, or ``{"min": …, "max": …}``."""

_OF_ODD = " (the ODD)"

DEFAULT_SIGMA_SHARE = 0.1
"""Default standard deviation of a Gaussian mutation, as a share of the parameter's range."""

DEFAULT_RESOLUTION_SHARE = 0.01
"""Resolution of a number whose problem states none, as a share of its range; at least 1 for an integer."""

_ROUNDING = 1e-9
"""How far a given value may lie beside a step, as a share of it."""
_LOG_DIGITS = 11
"""Significant digits of values on a log scale."""
_LARGEST_LOGARITHM = math.log(1.7e308)

MAX_CHOICES = 2**15 - 1
MAX_INTEGER = 2**53
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the closest known word, or a list of all known words."""
    names = list(known)
    close = difflib.get_close_matches(str(word), names, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(names) or 'none'}"


def name_in_words(name: str) -> str:
    """Return a parameter's full name in words: ``behaviour: error 1 type`` for ``behaviour.error_1.type``."""
    return name.replace(".", ": ", 1).replace(".", " ").replace("_", " ")


def check_name(what: str, name: object) -> None:
    """Check that a name can be used in paths, column names and messages.

    Raises:
        SpaceError: It has other characters, or does not begin with a letter.
    """
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise SpaceError(
            f"{what}: expected a name of letters, digits, '_', '-' and '.', starting with a letter, got {name!r}"
        )


def _described_when(when: When) -> dict[str, Any]:
    return {"when": {label: list(choices) for label, choices in when}} if when else {}


def _decimals(*numbers: float) -> int:
    """Return the decimal places in which all of the numbers are written."""
    exponents = [Decimal(repr(float(number))).as_tuple().exponent for number in numbers]
    return max(0, *(-exponent for exponent in exponents if isinstance(exponent, int)))


def _of_logarithm(value: float) -> float:
    """Return the number with a natural logarithm, in as many digits as survive the way there and back."""
    return float(f"{math.exp(min(value, _LARGEST_LOGARITHM)):.{_LOG_DIGITS}g}")


def _of_odd(bounds: tuple[float, float] | None) -> str:
    return "" if bounds is None else _OF_ODD


@dataclass(frozen=True, slots=True)
class ResolutionByChoice:
    """The resolution of a number whose meaning depends on a choice, such as a severity on the type of the error.

    Attributes:
        label: Name of the categorical parameter of the same component.
        by_choice: Resolution by its choices, each > 0; a choice without one has the default.
    """

    label: str
    by_choice: Mapping[str, float]

    def __post_init__(self) -> None:
        for choice, resolution in self.by_choice.items():
            _check_resolution(f"{self.label}={choice}", resolution)

    def describe(self) -> dict[str, Any]:
        """Return the resolution as a JSON object."""
        return {"label": self.label, "by_choice": dict(self.by_choice)}


def _check_resolution(name: str, resolution: float) -> None:
    if not (math.isfinite(resolution) and resolution > 0):
        raise SpaceError(f"{name}: expected a resolution > 0, got {resolution!r}")


@dataclass(frozen=True, slots=True)
class Number:
    """A number in [low, high]: the common base of `Real` and `Integer`.

    Attributes:
        name: Unique in its component.
        low: Smallest value.
        high: Largest value, > low.
        unit: ``px``, ``m/s``, …; empty for a dimensionless number.
        sigma: Standard deviation of the Gaussian mutation as stored, before rounding; by default a tenth of the
            range.
        when: The choices of other parameters with which the number is present; see `When`. Otherwise it is `absent`.
        step: The values are `low` and those whole numbers of steps above it, up to `high`, which is one of them; None
            for every value in between.
        log: Whether the scale is logarithmic: equal factors count the same, and vectors hold natural logarithms.
        title: Display name; empty for the full name in words.
        bounds: Smallest and largest value within an operational design domain (ODD); both are the same for a fixed
            number. None without an ODD. Distances and pictures keep the whole range.
        resolution: Largest difference that people would call the same, such as 0.1 s, in the number's own unit, or
            one for each choice of another parameter; on a log scale a factor, such as 1.05. None if unstated, see
            `resolution_at`.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    sigma: float | None = None
    when: When = field(default=(), kw_only=True)
    step: float | None = field(default=None, kw_only=True)
    log: bool = field(default=False, kw_only=True)
    title: str = field(default="", compare=False, repr=False, kw_only=True)
    bounds: tuple[float, float] | None = field(default=None, repr=False, kw_only=True)
    resolution: float | ResolutionByChoice | None = field(
        default=None, compare=False, repr=False, kw_only=True
    )
    _type: ClassVar[str]
    _least_sigma: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        check_name("parameter", self.name)
        low, high = self.low, self.high
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise SpaceError(f"{self.name}: expected finite low < high, got {low!r} and {high!r}")
        if not math.isfinite(high - low):
            raise SpaceError(
                f"{self.name}: expected a range whose width a float can hold, got {low!r} to {high!r}"
            )
        if self.sigma is not None and not (math.isfinite(self.sigma) and self.sigma > 0):
            raise SpaceError(f"{self.name}: expected sigma > 0, got {self.sigma!r}")
        if self.bounds is not None and not low <= self.bounds[0] <= self.bounds[1] <= high:
            raise SpaceError(f"{self.name}: expected bounds in [{low:g}, {high:g}], got {self.bounds!r}")
        self._check_scale()
        if isinstance(self.resolution, int | float):
            _check_resolution(self.name, self.resolution)

    def _check_scale(self) -> None:
        if self.step is not None:
            if self.log:
                raise SpaceError(f"{self.name}: expected a step or a log scale, got both")
            if not (math.isfinite(self.step) and 0 < self.step <= self.high - self.low):
                raise SpaceError(f"{self.name}: expected a step > 0 within the range, got {self.step!r}")
            steps = round((self.high - self.low) / self.step)
            if steps > MAX_INTEGER or self.on_step(steps) != self.high:
                low, high = self.on_step(steps - 1), self.on_step(steps)
                raise SpaceError(
                    f"{self.name}: expected a whole number of steps of {self.step:g} from {self.low:g} to the "
                    f"largest value, such as {low:g} or {high:g}, got {self.high:g}"
                )
        elif self.log and (self.low <= 0 or isinstance(self, Integer)):
            raise SpaceError(
                f"{self.name}: expected a real number > 0 for a log scale, got {self._type} from {self.low!r}"
            )
        if self.log and isinstance(self.resolution, int | float) and not self.resolution > 1:
            raise SpaceError(
                f"{self.name}: expected a factor > 1 as resolution on a log scale, got {self.resolution!r}"
            )

    @property
    def absent(self) -> float:
        """What is stored for an absent number: a value one range below the smallest one."""
        return self.stored(self.low) - self.range

    def on_step(self, steps: int) -> float:
        """Return the number that many steps above `low`, with as many decimal places as these two have."""
        assert self.step is not None
        return round(self.low + steps * self.step, _decimals(self.low, self.step))

    def stored(self, value: float) -> float:
        """Return the form of a number in vectors, on the nearest step or with the digits that a log scale keeps."""
        return self.rounded(math.log(value) if self.log else value)

    def shown(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the numbers that stored values stand for, in their unit; any shape."""
        return np.vectorize(_of_logarithm, otypes=[np.float64])(values) if self.log else values

    @property
    def spacing(self) -> float:
        """Distance between neighbouring values; 0 if there are values between any two."""
        return 0.0 if self.step is None else self.step

    def stated_resolution(self, choice: str | None) -> float | None:
        """Return the stated resolution; None if there is none.

        Args:
            choice: The choice of the parameter that a `ResolutionByChoice` names; None if there is none.
        """
        if isinstance(self.resolution, ResolutionByChoice):
            return None if choice is None else self.resolution.by_choice.get(choice)
        return self.resolution

    def resolution_at(self, choice: str | None) -> float:
        """Return the stated resolution as stored, by default 1% of the range; at least a step, 1 for an integer.

        Args:
            choice: As for `stated_resolution`.
        """
        stated = self.stated_resolution(choice)
        if stated is None:
            return max(DEFAULT_RESOLUTION_SHARE * self.range, self.spacing)
        return max(math.log(stated) if self.log else stated, self.spacing)

    @property
    def range(self) -> float:
        """Width of the whole range as stored, by which distances are normalised, whatever the ODD."""
        if self.log:
            return self.stored(self.high) - self.stored(self.low)
        return float(self.high - self.low)

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest number within the ODD, in its unit."""
        return (self.low, self.high) if self.bounds is None else self.bounds

    @property
    def least(self) -> float:
        """Smallest stored value within the ODD."""
        if self.log:
            return self.stored(self.ends[0])
        return self.low if self.bounds is None else self.bounds[0]

    @property
    def most(self) -> float:
        """Largest stored value within the ODD."""
        if self.log:
            return self.stored(self.ends[1])
        return self.high if self.bounds is None else self.bounds[1]

    @property
    def mutation_sigma(self) -> float:
        """Standard deviation of the Gaussian mutation; an ODD reduces it in proportion, to 0 for a fixed number."""
        sigma = DEFAULT_SIGMA_SHARE * self.range if self.sigma is None else self.sigma
        if self.step is not None:  # rounding would undo most of the steps of a smaller one
            sigma = max(sigma, 0.5 * self.step)
        if self.bounds is None:
            return sigma
        share = (self.most - self.least) / self.range
        return (
            max(share * sigma, min(max(self._least_sigma, 0.5 * (self.step or 0.0)), sigma)) if share else 0.0
        )

    def _nearest_step(self, value: float) -> float:
        assert self.step is not None
        steps = (min(max(value, self.low), self.high) - self.low) / self.step
        return float(self.on_step(round(steps)))

    def _drawn_step(self, rng: np.random.Generator) -> float:
        assert self.step is not None
        first, last = (round((end - self.low) / self.step) for end in self.ends)
        return float(self.on_step(int(rng.integers(first, last, endpoint=True))))

    @property
    def _in_steps(self) -> str:
        return "" if self.step is None else f" in steps of {self.step:g}"

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a value, each of them as likely; on a log scale, each factor."""
        raise NotImplementedError

    def rounded(self, value: float) -> float:
        """Return the nearest number of the parameter's kind, ignoring its range."""
        raise NotImplementedError

    def clipped(self, value: float) -> float:
        """Return the valid value nearest to a number."""
        return self.rounded(float(min(max(value, self.least), self.most)))

    def problem(self, value: float) -> str | None:
        """Return what is wrong with a stored value, or None."""
        raise NotImplementedError

    def decode(self, value: float) -> Value:
        """Return the human-readable form of a stored value."""
        raise NotImplementedError

    def encode(self, value: object) -> float:
        """Return the stored form of a human-readable value.

        Raises:
            SpaceError: It is not a valid number of this parameter.
        """
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise SpaceError(f"{self.name}: expected a number, got {value!r}")
        try:
            number = float(value)
        except OverflowError:
            raise SpaceError(f"{self.name}: expected a number that a float can hold") from None
        if self.log and number > 0:
            number = self.stored(number)
        elif self.log:
            number = -math.inf
        elif self.step is not None and abs(number - self.rounded(number)) <= _ROUNDING * self.step:
            number = self.rounded(number)
        if problem := self.problem(number):
            raise SpaceError(f"{self.name}: {problem}")
        return number

    @property
    def odd(self) -> Limit | None:
        """What an ODD limits the number to: a value, or ``{"min": …, "max": …}``; None for no limit."""
        if self.bounds is None:
            return None
        least, most = self.bounds
        return least if least == most else {"min": least, "max": most}

    def unlimited(self) -> Self:
        """Return the parameter without an ODD."""
        return self if self.bounds is None else replace(self, bounds=None)

    def _checked(self, value: object) -> float:
        """Return a human-readable value as a number in its unit; see `encode`."""
        return min(max(float(self.decode(self.encode(value))), self.low), self.high)

    def limited(self, limit: object) -> Self:
        """Return the parameter within an ODD.

        Args:
            limit: A number, or an object with ``min``, ``max`` or both.

        Raises:
            SpaceError: It is neither, or not in the range.
        """
        whole = self.unlimited()
        if isinstance(limit, Mapping):
            unknown = [key for key in limit if key not in ("min", "max")]
            if unknown or not limit:
                raise SpaceError(f"{self.name}: expected min, max or both, got {unknown or dict(limit)!r}")
            least = whole._checked(limit["min"]) if "min" in limit else whole.low
            most = whole._checked(limit["max"]) if "max" in limit else whole.high
            if least > most:
                raise SpaceError(f"{self.name}: expected min <= max, got {least:g} and {most:g}")
        elif isinstance(limit, list | tuple | str):
            raise SpaceError(f"{self.name}: expected a number or {{min: …, max: …}}, got {limit!r}")
        else:
            least = most = whole._checked(limit)
        everything = (least, most) == (whole.low, whole.high)
        return whole if everything else replace(whole, bounds=(least, most))

    def describe(self) -> dict[str, Any]:
        """Return name, type, range and unit as a JSON object, and an ODD and a resolution if there are any."""
        about = {"name": self.name, "type": self._type, "low": self.low, "high": self.high, "unit": self.unit}
        about |= _described_when(self.when)
        if self.step is not None:
            about |= {"step": self.step}
        if self.log:
            about |= {"log": True}
        if self.bounds is not None:
            about |= {"odd": self.odd}
        match self.resolution:
            case None:
                return about
            case ResolutionByChoice():
                return about | {"resolution": self.resolution.describe()}
        return about | {"resolution": self.resolution}


@dataclass(frozen=True, slots=True)
class Real(Number):
    """A real number in [low, high]."""

    _type: ClassVar[str] = "real"

    def __post_init__(self) -> None:
        Number.__post_init__(self)
        object.__setattr__(self, "low", float(self.low))
        object.__setattr__(self, "high", float(self.high))
        if self.step is not None:
            object.__setattr__(self, "step", float(self.step))
        if self.bounds is not None:
            object.__setattr__(self, "bounds", (float(self.bounds[0]), float(self.bounds[1])))

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a uniform value."""
        if self.step is not None:
            return self._drawn_step(rng)
        return self.rounded(min(float(rng.uniform(self.least, self.most)), self.most))

    def rounded(self, value: float) -> float:
        """Return the nearest number on a step, or that a log scale keeps; other numbers are unchanged."""
        if math.isnan(value) or not (self.log or self.step):
            return value
        return math.log(_of_logarithm(value)) if self.log else self._nearest_step(value)

    def problem(self, value: float) -> str | None:
        """Return what is wrong with a stored value, or None."""
        if self.least <= value <= self.most and value == self.rounded(value):
            return None
        least, most = self.ends
        got = _of_logarithm(value) if self.log else value
        return (
            f"expected a number in [{least:g}, {most:g}]{self._in_steps}{_of_odd(self.bounds)}, got {got!r}"
        )

    def decode(self, value: float) -> Value:
        """Return the human-readable form of a stored value."""
        if self.when and value == self.absent:
            return ABSENT
        return _of_logarithm(value) if self.log else float(value)


@dataclass(frozen=True, slots=True)
class Integer(Number):
    """An integer in [low, high], both ends included."""

    low: int
    high: int
    _type: ClassVar[str] = "integer"
    _least_sigma: ClassVar[float] = 0.5  # rounding would undo most of the steps of a smaller one

    def __post_init__(self) -> None:
        check_name("parameter", self.name)
        for bound in (self.low, self.high):
            if isinstance(bound, bool) or not isinstance(bound, int) or abs(bound) > MAX_INTEGER:
                raise SpaceError(f"{self.name}: expected integer bounds within ±2**53, got {bound!r}")
        if self.step is not None and not (isinstance(self.step, int) and not isinstance(self.step, bool)):
            raise SpaceError(f"{self.name}: expected a whole number as step, got {self.step!r}")
        if self.step == 1:
            object.__setattr__(self, "step", None)
        Number.__post_init__(self)
        if self.bounds is not None:
            object.__setattr__(self, "bounds", (int(self.bounds[0]), int(self.bounds[1])))

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a uniform value."""
        if self.step is not None:
            return self._drawn_step(rng)
        return float(rng.integers(int(self.least), int(self.most), endpoint=True))

    def rounded(self, value: float) -> float:
        """Return the nearest integer on a step, as a float."""
        if self.step is not None and not math.isnan(value):
            return self._nearest_step(value)
        return float(np.rint(value))

    @property
    def spacing(self) -> float:
        """Distance between neighbouring values."""
        return float(self.step or 1)

    def problem(self, value: float) -> str | None:
        """Return what is wrong with a stored value, or None."""
        if self.least <= value <= self.most and value == self.rounded(value):
            return None
        in_range = f"[{self.least}, {self.most}]{self._in_steps}{_of_odd(self.bounds)}"
        return f"expected a whole number in {in_range}, got {value!r}"

    def decode(self, value: float) -> Value:
        """Return the human-readable form of a stored value."""
        return ABSENT if self.when and value == self.absent else int(value)


@dataclass(frozen=True, slots=True)
class Categorical:
    """One of several named choices, stored as the index of the choice.

    Attributes:
        name: Unique in its component.
        choices: One or more, all different.
        when: The choices of other parameters with which it is present; see `When`. Otherwise it is `absent`.
        title: Display name; empty for the full name in words.
        allowed: The choices within an operational design domain (ODD), in their order; None without an ODD. Stored
            indices count all choices.
        tells_kinds: Whether findings with different choices are of different kinds, such as the shape of the road.
            The choices in a block that may be dormant, such as the type of an error, always tell them.
    """

    name: str
    choices: tuple[str, ...]
    when: When = field(default=(), kw_only=True)
    title: str = field(default="", compare=False, repr=False, kw_only=True)
    allowed: tuple[str, ...] | None = field(default=None, repr=False, kw_only=True)
    tells_kinds: bool = field(default=False, compare=False, repr=False, kw_only=True)
    codes: tuple[int, ...] = field(init=False, repr=False, compare=False)
    absent: ClassVar[float] = -1.0

    def __post_init__(self) -> None:
        check_name("parameter", self.name)
        object.__setattr__(self, "choices", tuple(self.choices))
        if not 1 <= len(self.choices) <= MAX_CHOICES or not all(isinstance(c, str) for c in self.choices):
            raise SpaceError(f"{self.name}: expected 1 to {MAX_CHOICES} named choices, got {self.choices!r}")
        if len(set(self.choices)) < len(self.choices):
            raise SpaceError(f"{self.name}: expected distinct choices, got {self.choices!r}")
        allowed = self.choices if self.allowed is None else self.allowed
        codes = tuple(code for code, choice in enumerate(self.choices) if choice in allowed)
        if not codes or len(codes) < len(allowed):
            raise SpaceError(f"{self.name}: expected some of {', '.join(self.choices)}, got {allowed!r}")
        object.__setattr__(self, "codes", codes)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw the index of a choice, uniformly."""
        drawn = int(rng.integers(len(self.codes)))
        return float(self.codes[drawn])

    def clipped(self, value: float) -> float:
        """Return the valid index nearest to a number; of two equally near ones, the smaller."""
        nearest = float(np.rint(min(max(value, 0.0), len(self.choices) - 1.0)))
        if self.allowed is None or int(nearest) in self.codes:
            return nearest
        return float(min(self.codes, key=lambda code: abs(code - nearest)))

    def problem(self, value: float) -> str | None:
        """Return what is wrong with a stored value, or None."""
        if 0 <= value < len(self.choices) and value == math.floor(value):
            if self.allowed is None or int(value) in self.codes:
                return None
            return f"expected {', '.join(self.allowed)}{_OF_ODD}, got {self.choices[int(value)]!r}"
        return f"expected the index of one of {len(self.choices)} choices, got {value!r}"

    def decode(self, value: float) -> Value:
        """Return the choice that a stored value stands for."""
        return ABSENT if value == self.absent else self.choices[int(value)]

    def encode(self, value: object) -> float:
        """Return the stored form of a choice.

        Raises:
            SpaceError: There is no such choice.
        """
        known = self.choices if self.allowed is None else self.allowed
        if value not in known:
            expected = ", ".join(known[:12]) + (", …" if len(known) > 12 else "")
            of_odd = "" if self.allowed is None else _OF_ODD
            raise SpaceError(
                f"{self.name}: expected one of {expected}{of_odd}, got {value!r}{did_you_mean(value, known)}"
            )
        return float(self.choices.index(str(value)))

    @property
    def odd(self) -> Limit | None:
        """What an ODD limits the parameter to: a choice, or a list of choices; None for no limit."""
        if self.allowed is None:
            return None
        return self.allowed[0] if len(self.allowed) == 1 else list(self.allowed)

    def unlimited(self) -> Self:
        """Return the parameter without an ODD."""
        return self if self.allowed is None else replace(self, allowed=None)

    def limited(self, limit: object) -> Self:
        """Return the parameter within an ODD.

        Args:
            limit: A choice, or a list of choices; a number stands for the choice with its digits.

        Raises:
            SpaceError: It is neither, a choice is unknown, or there are none.
        """
        whole = self.unlimited()
        wanted = limit if isinstance(limit, list | tuple) else [limit]
        if isinstance(limit, Mapping) or not wanted:
            raise SpaceError(f"{self.name}: expected some of {', '.join(whole.choices)}, got {limit!r}")
        is_number = [isinstance(value, int) and not isinstance(value, bool) for value in wanted]
        names = [str(value) if number else value for value, number in zip(wanted, is_number, strict=True)]
        codes = sorted({int(whole.encode(name)) for name in names})
        if len(codes) == len(whole.choices):
            return whole
        return replace(whole, allowed=tuple(whole.choices[code] for code in codes))

    def describe(self) -> dict[str, Any]:
        """Return name, type and choices as a JSON object, and ``odd`` if there is a limit."""
        about = {"name": self.name, "type": "categorical", "choices": list(self.choices)}
        about |= _described_when(self.when)
        return about if self.allowed is None else about | {"odd": self.odd}


Parameter: TypeAlias = Real | Integer | Categorical


def parameter_title(component: str, parameter: Parameter) -> str:
    """Return a parameter's display name: its title, or else its full name in words."""
    return parameter.title or name_in_words(f"{component}.{parameter.name}")


class Constraint(Protocol):
    """A constraint on the parameters that it owns."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that the constraint owns."""

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint does not fit the component's parameters."""

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Repair the owned values in place, ranges included; leave valid values unchanged."""

    def problem(self, values: Values, parameters: Mapping[str, Parameter]) -> str | None:
        """Return what is wrong with the values, or None."""

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""


@runtime_checkable
class RespectsLimits(Protocol):
    """A constraint whose repair stays within the limits that an ODD sets to parameters that it owns.

    Its `fit` refuses limits that no values can meet. A constraint without this method has no limited parameters.
    """

    def unlimited_names(self) -> tuple[str, ...]:
        """Return the names of the parameters that it owns and that cannot be limited."""

    def checks_limits(self) -> bool:
        """Return whether its `problem` checks the limits, because they do not apply to every valid value."""


def _number(parameters: Mapping[str, Parameter], name: str, kind: str) -> Number:
    parameter = parameters.get(name)
    if parameter is None:
        raise SpaceError(f"{kind}: unknown parameter {name!r}{did_you_mean(name, parameters)}")
    if not isinstance(parameter, Number):
        raise SpaceError(f"{kind}: expected {name} to be a number, got a categorical parameter")
    return parameter


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two numbers in [0, size]; the second exceeds the first by at least a minimum."""

    @property
    def names(self) -> tuple[str, str]:
        """Names of the parameters that the constraint owns."""
        raise NotImplementedError

    @property
    def _bounds(self) -> tuple[float, float]:
        """The minimum difference, and the upper bound of both numbers."""
        raise NotImplementedError

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint does not fit the component's parameters."""
        kind, names, (minimum, size) = type(self).__name__, self.names, self._bounds
        if names[0] == names[1]:
            raise SpaceError(f"{kind}: expected two different parameters, got {names[0]!r} twice")
        numbers = [_number(parameters, name, kind) for name in names]
        if type(numbers[0]) is not type(numbers[1]):
            raise SpaceError(f"{kind}: expected {names[0]} and {names[1]} both real or both integer")
        for name, number in zip(names, numbers, strict=True):
            if number.low != 0 or number.high != size:
                raise SpaceError(
                    f"{kind}: expected {name} in [0, {size:g}], got [{number.low:g}, {number.high:g}]"
                )
        gap = self._gap(parameters)
        if not 0 < gap <= size:
            raise SpaceError(f"{kind}: expected a minimum in (0, {size:g}], got {minimum!r}")
        low, high = numbers
        if not _are_apart(low.least, high.most, gap):
            raise SpaceError(
                f"expected an ODD in which {high.name} can be {gap:g} above {low.name}, got {low.name} >= "
                f"{low.least:g} and {high.name} <= {high.most:g}"
            )

    def unlimited_names(self) -> tuple[str, ...]:
        """Return no names: an ODD may limit both numbers."""
        return ()

    def checks_limits(self) -> bool:
        """Return False: the parameters check their own limits."""
        return False

    def _limit(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Move a pair that is apart and in [0, size] into the ODD, in place; a valid pair stays."""
        low, high = (_number(parameters, name, type(self).__name__) for name in self.names)
        if low.bounds is None and high.bounds is None:
            return
        gap = self._gap(parameters)
        lower, upper = low.clipped(values[low.name]), high.clipped(values[high.name])
        if not _are_apart(lower, upper, gap):
            if lower + gap <= high.most:
                upper = lower + gap
            else:
                lower, upper = max(float(low.least), min(lower, high.most - gap)), float(high.most)
        values[low.name], values[high.name] = lower, upper

    def problem(self, values: Values, parameters: Mapping[str, Parameter]) -> str | None:
        """Return what is wrong with the values, or None."""
        low, high = (values[name] for name in self.names)
        gap = self._gap(parameters)
        if _are_apart(low, high, gap):
            return None
        return f"expected {self.names[1]} at least {gap:g} above {self.names[0]}, got {low!r} and {high!r}"

    def describe(self) -> dict[str, Any]:
        """Return the constraint as a JSON object."""
        return {"type": type(self).__name__.lower(), **asdict(self)}

    def _gap(self, parameters: Mapping[str, Parameter]) -> float:
        """Return the minimum, rounded up for integers."""
        minimum, _ = self._bounds
        return float(math.ceil(minimum)) if isinstance(parameters[self.names[0]], Integer) else minimum


def _are_apart(low: float, high: float, gap: float) -> bool:
    # Repair sets one number to the other plus or minus the gap. Rounding decides which of these three hold exactly.
    return high - low >= gap or high >= low + gap or low <= high - gap


def _stretched(low: float, high: float, gap: float, size: float) -> tuple[float, float]:
    """Return the pair at least `gap` apart: with the upper number raised if that fits, else the lower one lowered."""
    if _are_apart(low, high, gap):
        return low, high
    if low + gap <= size:
        return low, low + gap
    if high - gap >= 0:
        return high - gap, high
    return 0.0, gap


@dataclass(frozen=True, slots=True)
class Extent(_Pair):
    """One axis of a box: ``high`` at least ``minimum`` above ``low``, both in [0, size].

    Attributes:
        low: Name of the parameter of the lower side, with range [0, size].
        high: Name of the parameter of the upper side, with the same range.
        minimum: Smallest extent, in (0, size].
        size: Size of the frame along this axis.
    """

    low: str
    high: str
    minimum: float
    size: float

    @property
    def names(self) -> tuple[str, str]:
        """Names of the parameters that the constraint owns."""
        return self.low, self.high

    @property
    def _bounds(self) -> tuple[float, float]:
        return self.minimum, float(self.size)

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Repair the sides in place: order them, clip them to the frame, then stretch the extent."""
        low, high = values[self.low], values[self.high]
        gap, size = self._gap(parameters), float(self.size)
        if high < low:
            high = low + gap
        values[self.low], values[self.high] = _stretched(max(low, 0.0), min(high, size), gap, size)
        self._limit(values, parameters)


@dataclass(frozen=True, slots=True)
class Duration(_Pair):
    """A time span: ``end`` at least ``minimum`` after ``start``, both in [0, horizon].

    Repair first swaps times that are in the wrong order, so the span stays in place.

    Attributes:
        start: Name of the parameter of the start, with range [0, horizon].
        end: Name of the parameter of the end, with the same range.
        minimum: Shortest duration, in (0, horizon]; rounded up for integer times.
        horizon: Latest time.
    """

    start: str
    end: str
    minimum: float
    horizon: float

    @property
    def names(self) -> tuple[str, str]:
        """Names of the parameters that the constraint owns."""
        return self.start, self.end

    @property
    def _bounds(self) -> tuple[float, float]:
        return self.minimum, float(self.horizon)

    def repair(self, values: Values, parameters: Mapping[str, Parameter]) -> None:
        """Repair the times in place: sort them, clip them to the horizon, then stretch the span."""
        horizon = float(self.horizon)
        start, end = sorted(min(max(values[name], 0.0), horizon) for name in self.names)
        values[self.start], values[self.end] = _stretched(start, end, self._gap(parameters), horizon)
        self._limit(values, parameters)


@dataclass(frozen=True, slots=True)
class Dormant:
    """A block of numbers that is dormant, stored as 0, while its label has the null choice.

    When the label changes to another choice, the numbers are drawn afresh.

    Attributes:
        label: Name of the categorical parameter that switches the block.
        null_choice: The choice that makes the block dormant.
        members: Names of the block's numbers; the range of each includes 0.
    """

    label: str
    null_choice: str
    members: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))

    def fit(self, parameters: Mapping[str, Parameter]) -> None:
        """Raise SpaceError if the constraint does not fit the component's parameters."""
        label = parameters.get(self.label)
        if not isinstance(label, Categorical):
            raise SpaceError(f"Dormant: expected the label {self.label!r} to be a categorical parameter")
        if self.null_choice not in label.choices:
            known = did_you_mean(self.null_choice, label.choices)
            raise SpaceError(f"Dormant: {self.label} has no choice {self.null_choice!r}{known}")
        if not self.members or len(set(self.members)) < len(self.members):
            raise SpaceError(f"Dormant: expected distinct members, got {self.members!r}")
        for name in self.members:
            number = _number(parameters, name, "Dormant")
            if not number.low <= 0 <= number.high:
                raise SpaceError(
                    f"Dormant: expected 0 in the range of {name}, got [{number.low:g}, {number.high:g}]"
                )

    def is_dormant(self, values: Mapping[str, float], parameters: Mapping[str, Parameter]) -> bool:
        """Return whether the block is dormant."""
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

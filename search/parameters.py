"""Parameters of a search space: real, integer and categorical, each with its range and unit.

A parameter's value in a vector is one float64: the number itself, or the index of the choice. NaN stands for
"no value yet": whatever repairs a vector draws a fresh one in its place.
"""

import difflib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from brink.search.errors import SpaceError

Value: TypeAlias = float | int | str

DEFAULT_SIGMA_SHARE = 0.1
"""Standard deviation of a Gaussian mutation, as a share of the parameter's range, unless one is given."""

MAX_CHOICES = 2**15 - 1
MAX_INTEGER = 2**53
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")


def nearest(word: object, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the known word closest to this one, or the list of all known words."""
    names = list(known)
    close = difflib.get_close_matches(str(word), names, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(names) or 'none'}"


def check_name(what: str, name: object) -> None:
    """Raise SpaceError unless a name is a word that reads well in paths, columns and messages."""
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise SpaceError(
            f"{what}: expected a name of letters, digits, '_', '-' and '.', first a letter, got {name!r}"
        )


def _check_range(name: str, low: float, high: float, sigma: float | None) -> None:
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise SpaceError(f"{name}: expected finite low < high, got {low!r} and {high!r}")
    if not math.isfinite(high - low):
        raise SpaceError(f"{name}: expected a range that a float can hold, got {low!r} to {high!r}")
    if sigma is not None and not (math.isfinite(sigma) and sigma > 0):
        raise SpaceError(f"{name}: expected sigma > 0, got {sigma!r}")


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise SpaceError(f"{name}: expected a number, got {value!r}")
    try:
        return float(value)
    except OverflowError:
        raise SpaceError(f"{name}: expected a number that a float can hold") from None


@dataclass(frozen=True, slots=True)
class Real:
    """A real number in [low, high].

    Attributes:
        name: Unique in its component.
        low: Smallest value.
        high: Largest value, > low.
        unit: ``px``, ``m/s``, …; empty for a pure number.
        sigma: Standard deviation of its Gaussian mutation; a tenth of the range unless given.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    sigma: float | None = None

    def __post_init__(self) -> None:
        check_name("parameter", self.name)
        _check_range(self.name, self.low, self.high, self.sigma)
        object.__setattr__(self, "low", float(self.low))
        object.__setattr__(self, "high", float(self.high))

    @property
    def range(self) -> float:
        """Width of the range; distances are measured in it."""
        return float(self.high - self.low)

    @property
    def mutation_sigma(self) -> float:
        """Standard deviation of the Gaussian mutation, > 0."""
        return DEFAULT_SIGMA_SHARE * self.range if self.sigma is None else self.sigma

    def draw(self, rng: np.random.Generator) -> float:
        """Return a uniform value."""
        return min(float(rng.uniform(self.low, self.high)), self.high)

    def clipped(self, value: float) -> float:
        """Return the admissible value nearest to a number."""
        return float(min(max(value, self.low), self.high))

    def rounded(self, value: float) -> float:
        """Return the number as it may be stored, whatever the range: for a real, itself."""
        return value

    def problem(self, value: float) -> str | None:
        """Return what is wrong with a stored value, or None."""
        if self.low <= value <= self.high:
            return None
        return f"expected a number in [{self.low:g}, {self.high:g}], got {value!r}"

    def decode(self, value: float) -> Value:
        """Return the value that people read for a stored one."""
        return float(value)

    def encode(self, value: object) -> float:
        """Return the stored value for one that people write.

        Raises:
            SpaceError: It is not a number in the range.
        """
        number = _number(self.name, value)
        if problem := self.problem(number):
            raise SpaceError(f"{self.name}: {problem}")
        return number

    def describe(self) -> dict[str, Any]:
        """Return name, type, range and unit as a JSON object."""
        return {"name": self.name, "type": "real", "low": self.low, "high": self.high, "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Integer:
    """A whole number in [low, high], both included.

    Attributes:
        name: Unique in its component.
        low: Smallest value.
        high: Largest value, > low.
        unit: ``step``, …; empty for a pure number.
        sigma: Standard deviation of its Gaussian mutation, before rounding; a tenth of the range unless given.
    """

    name: str
    low: int
    high: int
    unit: str = ""
    sigma: float | None = None

    def __post_init__(self) -> None:
        check_name("parameter", self.name)
        for bound in (self.low, self.high):
            if isinstance(bound, bool) or not isinstance(bound, int) or abs(bound) > MAX_INTEGER:
                raise SpaceError(f"{self.name}: expected whole bounds within ±2**53, got {bound!r}")
        _check_range(self.name, self.low, self.high, self.sigma)

    @property
    def range(self) -> float:
        """Width of the range; distances are measured in it."""
        return float(self.high - self.low)

    @property
    def mutation_sigma(self) -> float:
        """Standard deviation of the Gaussian mutation, > 0."""
        return DEFAULT_SIGMA_SHARE * self.range if self.sigma is None else self.sigma

    def draw(self, rng: np.random.Generator) -> float:
        """Return a uniform value."""
        return float(rng.integers(self.low, self.high, endpoint=True))

    def clipped(self, value: float) -> float:
        """Return the admissible value nearest to a number."""
        return self.rounded(float(min(max(value, self.low), self.high)))

    def rounded(self, value: float) -> float:
        """Return the number as it may be stored, whatever the range: the nearest whole one."""
        return float(np.rint(value))

    def problem(self, value: float) -> str | None:
        """Return what is wrong with a stored value, or None."""
        if self.low <= value <= self.high and value == math.floor(value):
            return None
        return f"expected a whole number in [{self.low}, {self.high}], got {value!r}"

    def decode(self, value: float) -> Value:
        """Return the value that people read for a stored one."""
        return int(value)

    def encode(self, value: object) -> float:
        """Return the stored value for one that people write.

        Raises:
            SpaceError: It is not a whole number in the range.
        """
        number = _number(self.name, value)
        if problem := self.problem(number):
            raise SpaceError(f"{self.name}: {problem}")
        return number

    def describe(self) -> dict[str, Any]:
        """Return name, type, range and unit as a JSON object."""
        return {"name": self.name, "type": "integer", "low": self.low, "high": self.high, "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Categorical:
    """One of several named choices, stored as the index of the choice.

    Attributes:
        name: Unique in its component.
        choices: At least one, all different.
    """

    name: str
    choices: tuple[str, ...]

    def __post_init__(self) -> None:
        check_name("parameter", self.name)
        object.__setattr__(self, "choices", tuple(self.choices))
        if not 1 <= len(self.choices) <= MAX_CHOICES or not all(isinstance(c, str) for c in self.choices):
            raise SpaceError(f"{self.name}: expected 1 to {MAX_CHOICES} named choices, got {self.choices!r}")
        if len(set(self.choices)) < len(self.choices):
            raise SpaceError(f"{self.name}: expected different choices, got {self.choices!r}")

    def draw(self, rng: np.random.Generator) -> float:
        """Return the index of a uniform choice."""
        return float(rng.integers(len(self.choices)))

    def clipped(self, value: float) -> float:
        """Return the index nearest to a number."""
        return float(np.rint(min(max(value, 0.0), len(self.choices) - 1.0)))

    def problem(self, value: float) -> str | None:
        """Return what is wrong with a stored value, or None."""
        if 0 <= value < len(self.choices) and value == math.floor(value):
            return None
        return f"expected the index of one of {len(self.choices)} choices, got {value!r}"

    def decode(self, value: float) -> Value:
        """Return the choice of a stored value."""
        return self.choices[int(value)]

    def encode(self, value: object) -> float:
        """Return the stored value of a choice.

        Raises:
            SpaceError: There is no such choice.
        """
        if value not in self.choices:
            expected = ", ".join(self.choices[:12]) + (", …" if len(self.choices) > 12 else "")
            raise SpaceError(
                f"{self.name}: expected one of {expected}, got {value!r}{nearest(value, self.choices)}"
            )
        return float(self.choices.index(str(value)))

    def describe(self) -> dict[str, Any]:
        """Return name, type and choices as a JSON object."""
        return {"name": self.name, "type": "categorical", "choices": list(self.choices)}


Number: TypeAlias = Real | Integer
Parameter: TypeAlias = Real | Integer | Categorical

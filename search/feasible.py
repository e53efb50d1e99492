"""The solutions that meet the constraints which a user wrote as formulas, such as ``gap > 2 * speed / 3.6``.

A formula may cut any region out of a space. Draws are repeated until one meets all formulas, so that they stay
uniform among those that do. A repair moves a solution towards one of some known feasible solutions, no further than
it must; it draws nothing, and leaves a feasible solution unchanged. A formula does not apply to a solution in which
one of its parameters is absent.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.formula import Formula, FormulaError
from brink.search.errors import SpaceError
from brink.search.parameters import Categorical, Parameter, Value, did_you_mean

_ANCHORS: Final = 32
_MOST_DRAWS: Final = 20_000
"""Draws that find the anchors. A feasible share of one in a thousand gives twenty of them."""
_REDRAWN: Final = 1_000
"""Draws of a sample; after that, the last one is repaired."""
_NEAREST: Final = 3
_HALVINGS: Final = 12


def parsed(text: object, parameters: Mapping[str, Parameter]) -> Formula:
    """Return a constraint.

    Args:
        text: A condition.
        parameters: The parameters that it may name, by every name that they have.

    Raises:
        SpaceError: It is not a condition on these parameters.
    """
    try:
        formula = Formula(text)  # type: ignore[arg-type]
    except FormulaError as error:
        raise SpaceError(f"constraint {error}") from None
    if not formula.is_condition:
        raise SpaceError(
            f"constraint {text!r}: expected a comparison, such as 'gap > 2 * speed', got a number"
        )
    for name in formula.names:
        if name not in parameters:
            raise SpaceError(
                f"constraint {text!r}: unknown parameter {name!r}{did_you_mean(name, parameters)}"
            )
        parameter = parameters[name]
        if name not in formula.texts:
            if isinstance(parameter, Categorical) and not all(map(_is_number, parameter.choices)):
                raise SpaceError(
                    f"constraint {text!r}: {name} is one of {', '.join(parameter.choices)}; compare it with one of "
                    f"these, such as {name} == {parameter.choices[0]!r}"
                )
            continue
        choices = parameter.choices if isinstance(parameter, Categorical) else ()
        for choice in sorted(formula.texts[name] - set(choices)):
            raise SpaceError(
                f"constraint {text!r}: {name} is never {choice!r}{did_you_mean(choice, choices)}"
            )
    return formula


def _is_number(choice: str) -> bool:
    try:
        float(choice)
    except ValueError:
        return False
    return True


def violated(formulas: Iterable[Formula], values: Mapping[str, Value]) -> Formula | None:
    """Return the first formula that values do not meet, or None; one with a name that is missing does not apply."""
    for formula in formulas:
        if values.keys() >= set(formula.names) and not formula.evaluate(values):
            return formula
    return None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Feasible:
    """The feasible solutions of a space or of one of its components.

    Attributes:
        formulas: The constraints, at least one.
        ranges: Range of each number, 1 for a category, shape ``(d,)``.
        categorical: Which parameters are categorical, shape ``(d,)``.
        draw: Draws a row that is valid but for the formulas.
        settle: Returns the nearest such row, without drawing anything that matters.
        values: Returns the values of such a row by all their names, without those of absent parameters.
        anchors: Some feasible rows, shape ``(n, d)``, n >= 1.
    """

    formulas: tuple[Formula, ...]
    ranges: NDArray[np.float64]
    categorical: NDArray[np.bool_]
    draw: Callable[[np.random.Generator], NDArray[np.float64]]
    settle: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    values: Callable[[NDArray[np.float64]], Mapping[str, Value]]
    anchors: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        rng = np.random.Generator(np.random.PCG64(0))
        found: list[NDArray[np.float64]] = []
        for _ in range(_MOST_DRAWS):
            if self.holds(row := self.draw(rng)):
                found.append(row)
            if len(found) == _ANCHORS:
                break
        if not found:
            texts = "; ".join(formula.text for formula in self.formulas)
            raise SpaceError(
                f"constraints: expected at least one solution in {_MOST_DRAWS:,} to meet {texts}; none of that many "
                "random ones did. Check the units, or make the ranges smaller"
            )
        object.__setattr__(self, "anchors", np.array(found))

    def holds(self, row: NDArray[np.float64]) -> bool:
        """Return whether a row that is otherwise valid meets all formulas."""
        return violated(self.formulas, self.values(row)) is None

    def sample(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw a feasible row."""
        for _ in range(_REDRAWN):
            if self.holds(row := self.draw(rng)):
                return row
        return self.repaired(row)

    def repaired(self, row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a feasible row close to one that is otherwise valid; the row itself if it is feasible."""
        if self.holds(row):
            return row
        order = np.argsort(self._distances(self.anchors, row), kind="stable")[:_NEAREST]
        found = np.array([self._towards(row, anchor) for anchor in self.anchors[order]])
        nearest = np.array(found[int(np.argmin(self._distances(found, row)))])
        nearest.flags.writeable = False
        return nearest

    def _distances(self, rows: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        apart = np.abs(rows - row) / self.ranges
        distances: NDArray[np.float64] = np.where(self.categorical, apart > 0, apart).sum(axis=1)
        return distances

    def _towards(self, row: NDArray[np.float64], anchor: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the first feasible row that halving finds on the way to an anchor, with own categories if it can."""
        end = self.settle(np.where(self.categorical, row, anchor))
        if not self.holds(end):
            end, row = anchor, self.settle(np.where(self.categorical, anchor, row))
            if self.holds(row):
                return row
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            between = self.settle(row + middle * (end - row))
            if self.holds(between):
                high, best = middle, between
            else:
                low = middle
        return best if high < 1.0 else end


def by_every_name(parts: Sequence[tuple[str, Sequence[Parameter]]]) -> dict[str, Parameter]:
    """Return parameters by their full names, and by their own names where these are unambiguous.

    Args:
        parts: The name of each component, and its parameters.
    """
    full = {f"{component}.{one.name}": one for component, own in parts for one in own}
    names = [one.name for one in full.values()]
    return full | {one.name: one for one in full.values() if names.count(one.name) == 1}

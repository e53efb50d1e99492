"""The change between two solutions, in values and in words, and how far each parameter moved."""

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Final

from brink.search.features import Unit
from brink.search.parameters import Categorical, Parameter, Value
from brink.server.problems.base import Problem, SimulatedSolution

NOTHING_ACTIVE: Final = "the two differ in no parameter that was active in either drive"
_MOST_DIGITS: Final = 9
_NEXT_STEP: Final = ", then "
"""Between the steps of a chain of perturbations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A parameter in which two solutions differ, or two that a constraint ties together.

    Attributes:
        names: Names as component.parameter, of those that differ.
        units: Unit of each; empty for none.
        safe: Value of each in the safe solution, as it was chosen.
        unsafe: The same in the unsafe solution.
        active: Whether it was active in either episode; None if that was not recorded.
        moved: How far it moved as a share of its range, in (0, 1], the larger of the two; None for a category.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    safe: tuple[Value, ...]
    unsafe: tuple[Value, ...]
    active: bool | None
    moved: float | None

    @property
    def words(self) -> str:
        """The change in words, such as ``scenario.gap 12.3 m -> 12.5 m``."""
        return ", ".join(
            f"{name} {_values(safe, unsafe, unit)}"
            for name, unit, safe, unsafe in zip(self.names, self.units, self.safe, self.unsafe, strict=True)
        )


def changes_between(
    problem: Problem, safe: SimulatedSolution, unsafe: SimulatedSolution, units: Sequence[Unit]
) -> tuple[Change, ...]:
    """Return the differences between two solutions.

    Args:
        problem: Their problem.
        safe: One solution.
        unsafe: The other one.
        units: Columns in which they differ; see `brink.search.pairs.Steps.differing`.
    """
    space = problem.space
    parameters = space.parameters
    names = space.column_names()
    rows = [space.join(tuple(side.vectors)) for side in (safe, unsafe)]
    known = safe.activity is not None and unsafe.activity is not None
    changes = []
    for unit in units:
        columns = [column for column in unit if rows[0][column] != rows[1][column]]
        active = None
        if known:
            active = any(
                bool(one.activity.active[column])
                for one in (safe, unsafe)
                for column in columns
                if one.activity is not None
            )
        changes.append(
            Change(
                names=tuple(names[column] for column in columns),
                units=tuple(
                    "" if isinstance(one, Categorical) else one.unit
                    for one in map(parameters.__getitem__, columns)
                ),
                safe=tuple(parameters[column].decode(float(rows[0][column])) for column in columns),
                unsafe=tuple(parameters[column].decode(float(rows[1][column])) for column in columns),
                active=active,
                moved=_moved(
                    [(parameters[column], float(rows[0][column] - rows[1][column])) for column in columns]
                ),
            )
        )
    return tuple(changes)


def _moved(differences: Sequence[tuple[Parameter, float]]) -> float | None:
    """Return the largest move of numbers as a share of their ranges; None for a category."""
    shares = [
        abs(difference) / parameter.range
        for parameter, difference in differences
        if not isinstance(parameter, Categorical)
    ]
    return max(shares, default=None)


def moved_words(changes: Sequence[Change]) -> str:
    """Return how far the active parameters moved, as shares of their ranges.

    Returns:
        Such as ``1 number moves by 24% of its range; 1 category changes``. Empty if nothing was active.
    """
    shown = [change for change in changes if change.active is not False]
    moved = [change for change in shown if change.moved is not None]
    categories = sum(len(change.names) for change in shown if change.moved is None)
    numbers = sum(len(change.names) for change in moved)
    words = []
    if numbers:
        most = share_words(max(change.moved or 0.0 for change in moved))
        words.append(
            f"1 number moves by {most} of its range"
            if numbers == 1
            else f"{numbers} numbers move by up to {most} of their ranges"
        )
    if categories:
        words.append("1 category changes" if categories == 1 else f"{categories} categories change")
    return "; ".join(words)


def share_words(share: float) -> str:
    """Return a share in [0, 1] in percent, with one decimal place below 1%."""
    if 0 < share < 0.0005:
        return "less than 0.1%"
    return f"{share:.1%}" if share < 0.01 else f"{share:.0%}"


def change_words(
    problem: Problem, safe: SimulatedSolution, unsafe: SimulatedSolution, changes: Sequence[Change]
) -> str:
    """Return the change between two solutions in the problem's own words, or else its values.

    Only parameters that were active in either episode are described.

    Args:
        problem: Their problem.
        safe: The safe solution.
        unsafe: The unsafe solution.
        changes: Their differences.
    """
    shown = [change for change in changes if change.active is not False]
    if not shown:
        return NOTHING_ACTIVE
    changed = [name for change in shown for name in change.names]
    return problem.words_of_change(safe, unsafe, changed) or ", ".join(change.words for change in shown)


def common_words(safe: str, unsafe: str) -> str:
    """Return what two descriptions share: clauses, such as the scenario, and steps of a chain of perturbations."""
    common: list[str] = []
    for one, other in zip(safe.split("; "), unsafe.split("; "), strict=False):
        steps, other_steps = one.split(_NEXT_STEP), other.split(_NEXT_STEP)
        blocks = SequenceMatcher(None, steps, other_steps, autojunk=False).get_matching_blocks()
        shared = [step for block in blocks for step in steps[block.a : block.a + block.size]]
        common += [_NEXT_STEP.join(shared)] if shared else []
    return "; ".join(common)


def _values(safe: Value, unsafe: Value, unit: str) -> str:
    old, new = different(safe, unsafe)
    suffix = f" {unit}" if unit else ""
    return f"{old}{suffix} -> {new}{suffix}"


def instead(old: Value, new: Value, unit: str = "") -> str:
    """Return the phrase for a changed value, such as ``1.5 s instead of 1.3 s``."""
    before, after = different(old, new)
    suffix = unit if unit in ("", "%") else f" {unit}"
    return f"{after}{suffix} instead of {before}{suffix}"


def different(first: Value, second: Value) -> tuple[str, str]:
    """Return two values with enough digits to tell them apart."""
    if not isinstance(first, float) or not isinstance(second, float):
        return str(first), str(second)
    whole = len(f"{max(abs(first), abs(second)):.0f}")
    for digits in range(max(3, whole), _MOST_DIGITS):
        shown = f"{first:.{digits}g}", f"{second:.{digits}g}"
        if shown[0] != shown[1]:
            return shown
    return repr(first), repr(second)

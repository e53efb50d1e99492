"""The line along which a unit moves from a safe to an unsafe value while everything else is held."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from brink.search.errors import SpaceError
from brink.search.features import Unit
from brink.search.space import FloatArray, SearchSpace, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A line in a space. Places on it are shares of its length, 0 at its safe and 1 at its unsafe end.

    Attributes:
        space: The space.
        unit: Columns of the unit, all of them numbers.
        start: Solution at the safe end, shape ``(d,)``.
        end: Solution at the unsafe end, which differs in the unit alone, shape ``(d,)``.
        resolution: Resolution of the unit; for several numbers, of the first that anybody would notice.
        range: Range of the unit; for several numbers, of the one whose range is used up first.
        stated: Whether the problem states the resolution.
    """

    space: SearchSpace
    unit: Unit
    start: FloatArray
    end: FloatArray
    resolution: float = field(init=False)
    range: float = field(init=False)
    stated: bool = field(init=False)

    def __post_init__(self) -> None:
        moved = np.abs(self.end - self.start)
        columns = [column for column in self.unit if moved[column] > 0.0]
        if not columns or set(np.flatnonzero(moved)) - set(columns) or self.space.categorical[columns].any():
            raise SpaceError(
                f"expected two solutions that differ in the numbers {self.unit} and nothing else, got differences "
                f"in {np.flatnonzero(moved).tolist()}"
            )
        resolutions, stated = self.space.resolutions(self.end, columns)
        shares = resolutions / moved[columns]
        object.__setattr__(self, "resolution", float(shares.min()))
        object.__setattr__(self, "stated", bool(stated[int(np.argmin(shares))]))
        object.__setattr__(self, "range", float((self.space.ranges[columns] / moved[columns]).min()))

    def at(self, place: float) -> FloatArray | None:
        """Return the valid solution nearest to a place; None if the constraints move more than the unit."""
        columns = list(self.unit)
        row = np.array(self.start)
        row[columns] += place * (self.end[columns] - self.start[columns])
        return valid_change(self.space, self.end, row, self.unit)

    def place_of(self, row: FloatArray) -> float:
        """Return the place of a solution on the line."""
        columns = list(self.unit)
        along = (self.end[columns] - self.start[columns]) / self.space.ranges[columns]
        moved = (row[columns] - self.start[columns]) / self.space.ranges[columns]
        return float(moved @ along / (along @ along))

    def until(self, end: FloatArray) -> Self:
        """Return the line that goes on to another unsafe end."""
        return type(self)(self.space, self.unit, self.start, end)


def valid_change(space: SearchSpace, held: FloatArray, row: FloatArray, unit: Unit) -> FloatArray | None:
    """Return the nearest valid solution to a row, if it differs from a valid one in a unit alone; otherwise None.

    It is also None if constraints move the unit by more than its resolution.

    Args:
        space: The space.
        held: A valid solution, shape ``(d,)``.
        row: The same with other values of the unit, shape ``(d,)``.
        unit: Columns of the unit.
    """
    # Nothing is missing, so repair draws at most the numbers of a block that it reactivates, which are then others.
    columns, repaired = list(unit), space.repaired_parts(row, unit, np.random.Generator(np.random.PCG64(0)))
    others = np.ones(space.dimension, np.bool_)
    others[columns] = False
    if not np.array_equal(repaired[others], held[others]):
        return None
    # Rounding moves a number by less than its resolution; more means that it was drawn or stretched.
    is_near = np.abs(repaired - row)[columns] <= space.resolutions(held, columns)[0]
    return frozen_array(repaired) if (is_near | space.categorical[columns]).all() else None

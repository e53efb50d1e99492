"""The ends of thresholds: simulated solutions on both sides, those in between, and what the ends tell of a kind."""

import json
import math
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from sqlalchemy import Row

from brink.search.archive import Archive
from brink.search.parameters import Number
from brink.search.space import FloatArray, IntArray
from brink.server.campaigns.outcomes import SolutionOutcome, outcome_of
from brink.server.campaigns.thresholds import Threshold
from brink.server.problems.base import Problem
from brink.server.states import SolutionVerdict

_ROUNDING: Final = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ends:
    """Simulated solutions on both sides of a threshold, by number.

    Attributes:
        safe: The safe one furthest from the 20% point, on its safe side, by at most a resolution. If there is none,
            the nearest one on that side; else the one furthest from the unsafe side.
        unsafe: The unsafe one, likewise, on the unsafe side of the 80% point.
        values: Values of the two.
        are_beyond: Whether both lie on these sides.
        are_tight: Whether they are at most the stretch and two resolutions apart.
    """

    safe: int
    unsafe: int
    values: tuple[float, float]
    are_beyond: bool
    are_tight: bool

    @property
    def width(self) -> float:
        """Distance of the two values."""
        return abs(self.values[1] - self.values[0])

    @classmethod
    def of(cls, archive: Archive, one: Threshold) -> Self:
        """Choose the solutions at both ends of a threshold."""
        line, sign = one.line, 1.0 if one.line.rises else -1.0
        along = sign * line.values
        reach = np.inf if one.safe_again is None else sign * one.safe_again
        safe = np.flatnonzero(~line.unsafe & (along < reach))
        unsafe = np.flatnonzero(line.unsafe & (along < reach))
        before = safe[along[safe] <= sign * one.start] if math.isfinite(one.start) else safe[:0]
        after = unsafe[along[unsafe] >= sign * one.end] if math.isfinite(one.end) else unsafe[:0]
        # Where chance has no part, the two points are simulated solutions.
        more = 0.0 if one.end_interval == (one.start, one.end) else one.resolution
        low = _end(-along, before, more - sign * one.start) if before.size else safe[np.argmin(along[safe])]
        high = _end(along, after, more + sign * one.end) if after.size else unsafe[np.argmax(along[unsafe])]
        numbers = archive.numbers[line.places[[low, high]]].tolist()
        values = float(line.values[low]), float(line.values[high])
        return cls(
            safe=numbers[0],
            unsafe=numbers[1],
            values=values,
            are_beyond=bool(before.size and after.size),
            are_tight=abs(values[1] - values[0]) <= one.stretch + 2 * one.resolution + _ROUNDING,
        )


def _end(outwards: FloatArray, beyond: IntArray, furthest: float) -> int:
    """Return the position of the end of a tight pair: the furthest one up to a limit, else the nearest one.

    At the 20% point itself, a drive would be unsafe too often in half of the cases, so a resolution more is taken.

    Args:
        outwards: How far out each solution of the line is, shape ``(n,)``.
        beyond: Positions of those that may be the end, at least one.
        furthest: The limit.
    """
    within = beyond[outwards[beyond] <= furthest]
    return int(within[np.argmax(outwards[within])] if within.size else beyond[np.argmin(outwards[beyond])])


def row_at(problem: Problem, archive: Archive, one: Threshold, value: float) -> FloatArray:
    """Return the solution at a value of a line, which need not have been simulated, shape ``(d,)``."""
    line, space = one.line, problem.space
    first, last = (archive.vectors[int(line.places[at])] for at in (0, -1))
    share = (value - line.values[0]) / (line.values[-1] - line.values[0])
    row = np.array(first)
    for column in line.unit:
        row[column] = first[column] + share * (last[column] - first[column])
        if isinstance(number := space.parameters[column], Number):
            row[column] = number.rounded(float(row[column]))
    return row


def kind_of(problem: Problem, archive: Archive, one: Threshold, fails: str) -> tuple[str, ...]:
    """Return what tells the kind of a threshold: its number and error, target, road, and how it fails.

    Args:
        problem: The problem.
        archive: The simulated solutions.
        one: The threshold.
        fails: How its unsafe end fails, in words without moments.
    """
    space, row = problem.space, archive.vectors[int(one.line.places[-1])]
    name = space.column_names()[one.line.leading]
    return (*problem.traits(name, space.decode(space.split(row))), fails)


def read_outcome(problem: Problem, row: Row[Any]) -> SolutionOutcome:
    """Return the outcome of a stored solution (`brink.server.campaigns.view_store.read_solutions`)."""
    result = json.loads(row.result) if row.result else None
    safe = row.verdict == SolutionVerdict.SAFE
    return outcome_of(problem, result, safe=safe, robustness=row.robustness)

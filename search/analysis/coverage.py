"""Which solutions are unlike anything simulated, so that no model of the verdict can be trusted there.

A solution is unlike the simulated ones in four cases: it is outside the operational design domain (ODD) of the
simulations; it has a category that was never simulated; one of its numbers is more than a tenth of the range away
from every simulated value; or its nearest simulated solution is farther away than that of 99% of the simulated
solutions themselves, each compared with all others. Distances are those of `brink.search.metric`, the smallest over
all equivalent orders.

That the test passes does not mean that a prediction is right: it means that the model was fitted to such solutions.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from brink.search.metric import Metric, Points
from brink.search.odd import limit_words
from brink.search.space import Categorical, FloatArray, IntArray, Parameter, SearchSpace

QUANTILE: Final = 0.99
MAX_SAMPLED: Final = 1_000
"""Maximum number of simulated solutions, evenly spaced, whose nearest others determine the limit."""
MAX_GAP: Final = 0.1
"""Largest distance of a number to a simulated value, as a share of its range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Unseen:
    """A category, or an open interval of numbers, without a simulated solution near it.

    Attributes:
        column: Column of the parameter.
        low: Lower end.
        high: Upper end; both ends lie outside.
        reason: What is wrong with a solution in it.
    """

    column: int
    low: float
    high: float
    reason: str


def _unseen(column: int, name: str, parameter: Parameter, values: FloatArray) -> Iterator[_Unseen]:
    """Yield the parts of a parameter's values that have no simulated value near them.

    Args:
        column: Column of the parameter.
        name: Its full name.
        parameter: The parameter.
        values: Simulated values, ascending and different, at least one.
    """
    if isinstance(parameter, Categorical):
        for code, choice in enumerate(parameter.choices):
            if code not in values:
                reason = f"{name} {choice} was never simulated"
                if code not in parameter.codes:
                    reason = f"{name} {choice} is outside the ODD ({limit_words(parameter)})"
                yield _Unseen(column=column, low=code - 0.5, high=code + 0.5, reason=reason)
        return
    if parameter.bounds is not None:
        # The zeros of dormant blocks are simulated values that may be outside.
        below, above = values[values < parameter.least], values[values > parameter.most]
        for ends in ([-np.inf, *below, parameter.least], [parameter.most, *above, np.inf]):
            for low, high in itertools.pairwise(ends):
                reason = f"{name} is outside the ODD ({limit_words(parameter)})"
                yield _Unseen(column=column, low=float(low), high=float(high), reason=reason)
    gap = MAX_GAP * parameter.range
    lows, highs = np.append(-np.inf, values + gap), np.append(values - gap, np.inf)
    for place in np.flatnonzero(lows < highs):
        low, high = float(lows[place]), float(highs[place])
        closest = values[max(place - 1, 0) : place + 1]
        near = [f"{value:g}" for value in parameter.shown(closest).tolist()]
        if low < parameter.most and high > parameter.least:
            reason = f"{name} is far from every simulated value, the closest being {' and '.join(near)}"
            yield _Unseen(column=column, low=low, high=high, reason=reason)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coverage:
    """The simulated solutions, and how close together they lie.

    Attributes:
        space: Space of the solutions.
        limit: Largest distance to the nearest simulated solution at which a solution counts as like them, >= 0.
    """

    space: SearchSpace
    limit: float
    _metric: Metric
    _points: Points
    _unseen: tuple["_Unseen", ...]

    @classmethod
    def of(cls, space: SearchSpace, vectors: FloatArray, orders: IntArray) -> Self:
        """Return the coverage of simulated solutions.

        Args:
            space: Their space.
            vectors: The solutions, shape ``(n, d)``, n >= 1.
            orders: Equivalent orders of the columns, the given order first, shape ``(orders, d)``.
        """
        metric = Metric.of_space(space)
        rows = np.unique(vectors, axis=0)
        known = np.concatenate([rows[:, order] for order in orders])
        points = metric.points(known)
        owner = np.tile(np.arange(len(rows)), len(orders))
        sampled = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MAX_SAMPLED)).astype(np.int64))
        limit = 0.0
        if len(rows) > 1:
            nearest = _nearest(metric, metric.points(rows[sampled]), points, sampled, owner)
            limit = float(np.quantile(nearest, QUANTILE))
        parameters = space.parameters
        unseen = tuple(
            part
            for column, (name, parameter) in enumerate(zip(space.column_names(), parameters, strict=True))
            for part in _unseen(column, name, parameter, np.unique(known[:, column]))
        )
        return cls(space=space, limit=limit, _metric=metric, _points=points, _unseen=unseen)

    def nearest(self, rows: FloatArray) -> FloatArray:
        """Return the distance to the nearest simulated solution, shape ``(m,)``, for rows of shape ``(m, d)``."""
        return _nearest(self._metric, self._metric.points(rows), self._points)

    def reasons(self, rows: FloatArray, nearest: FloatArray) -> tuple[str, ...]:
        """Return in words how each solution differs from anything simulated; empty if it does not.

        Args:
            rows: Complete solutions, shape ``(m, d)``.
            nearest: Their distances to the nearest simulated solutions, shape ``(m,)``.
        """
        reasons: list[list[str]] = [[] for _ in range(len(rows))]
        for part in self._unseen:
            values = rows[:, part.column]
            for place in np.flatnonzero((values > part.low) & (values < part.high)):
                reasons[place].append(part.reason)
        for place in np.flatnonzero(nearest > self.limit):
            reasons[place].append(
                f"the nearest simulated solution is {nearest[place]:.3g} away, "
                f"but {QUANTILE:.0%} of the simulated ones have another within {self.limit:.3g}"
            )
        return tuple("; ".join(reason) for reason in reasons)


def _nearest(
    metric: Metric, rows: Points, others: Points, who: IntArray | None = None, owner: IntArray | None = None
) -> FloatArray:
    """Return the distance of each row to the nearest other one, shape ``(m,)``.

    Args:
        metric: The distance.
        rows: The rows, m of them.
        others: Those that they are compared with, n of them.
        who: Number of the solution in each row, shape ``(m,)``; None if none of them is among the others.
        owner: Number of the solution in each of the others, shape ``(n,)``; a row is not compared with itself.
    """
    nearest = np.full(len(rows), np.inf)
    for part, columns, block in metric.blocks(rows, others):
        if who is not None and owner is not None:
            block[who[part, None] == owner[None, columns]] = np.inf
        nearest[part] = np.minimum(nearest[part], block.min(axis=1))
    return nearest

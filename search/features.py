"""Features of complete solutions, on which models of the verdict are fitted.

They are the numbers in units of their ranges, one column for each category, and the middle and length of each two
numbers that a constraint ties together, such as the left and right edge of a box or the start and end of a time span.

Parts of a component that can be swapped without changing what a solution means, such as two injected trajectories,
give every solution several equivalent orders. A model that is fitted to all of them does not have to learn the
symmetry from the simulations, and its predictions may be averaged over them.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.search.errors import SpaceError
from brink.search.space import (
    Categorical,
    Component,
    Duration,
    Extent,
    FloatArray,
    IntArray,
    SearchSpace,
    frozen_array,
)

Unit: TypeAlias = tuple[int, ...]
"""Columns of a row that belong together: one parameter, or two numbers that a constraint ties together."""

FeatureArray: TypeAlias = NDArray[np.float32]

MAX_PERMUTED = 3
"""Largest number of interchangeable parts presented in all their orders; more are only rotated."""


def units_of(space: SearchSpace) -> tuple[Unit, ...]:
    """Return the units of a space, in the order of their first columns; each column belongs to exactly one."""
    partner: dict[int, int] = {}
    for component, part in zip(space.components, space.slices, strict=True):
        column = _columns(component, part.start)
        for rule in component.constraints:
            if isinstance(rule, Extent | Duration):
                low, high = (column[name] for name in rule.names)
                partner[low], partner[high] = high, low
    units = {tuple(sorted({column, partner.get(column, column)})) for column in range(space.dimension)}
    return tuple(sorted(units))


def equivalent_orders(space: SearchSpace) -> IntArray:
    """Return the orders of a row's columns that do not change its meaning, the given order first.

    Returns:
        Positions of the columns, shape ``(orders, d)``: ``rows[:, order]`` is equivalent to ``rows``.
    """
    choices = [
        list(_component_orders(component, part.start))
        for component, part in zip(space.components, space.slices, strict=True)
    ]
    orders = [np.concatenate(parts) for parts in itertools.product(*choices)]
    return frozen_array(np.array(orders), np.int64)


def _component_orders(component: Component, start: int) -> Iterator[IntArray]:
    """Yield the equivalent orders of a component's columns, the given order first."""
    same = np.arange(start, start + component.dimension)
    parts = component.interchangeable
    if not parts:
        yield same
        return
    column = _columns(component, start)
    count = len(parts)
    places: Iterator[tuple[int, ...]]
    if count <= MAX_PERMUTED:
        places = itertools.permutations(range(count))
    else:
        places = (tuple((place + shift) % count for place in range(count)) for shift in range(count))
    for order in places:
        swapped = same.copy()
        for target, source in zip(parts, (parts[place] for place in order), strict=True):
            for here, there in zip(target, source, strict=True):
                swapped[column[here] - start] = column[there]
        yield swapped


def _columns(component: Component, start: int) -> dict[str, int]:
    return {parameter.name: start + place for place, parameter in enumerate(component.parameters)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Features:
    """Turns complete solutions into features.

    Attributes:
        space: Space of the solutions; its constraints are not needed.
        ties: Columns of numbers that a constraint ties together.
        orders: Equivalent orders of the columns, the given order first, shape ``(orders, d)``.
    """

    space: SearchSpace
    ties: tuple[tuple[int, int], ...]
    orders: IntArray
    _numeric: IntArray
    _categories: IntArray
    _codes: IntArray

    @classmethod
    def of_space(cls, space: SearchSpace) -> Self:
        """Return the features of a space, with its constraints and interchangeable parts."""
        ties = tuple((unit[0], unit[1]) for unit in units_of(space) if len(unit) == 2)
        return cls.of(space, ties, equivalent_orders(space).tolist())

    @classmethod
    def of(cls, space: SearchSpace, ties: Sequence[Sequence[int]], orders: Sequence[Sequence[int]]) -> Self:
        """Return features with the given ties and orders, such as those stored in a file.

        Raises:
            SpaceError: A tie is not two numeric columns, or an order is not a permutation of the columns that puts
                parameters of the same kind and range in each place.
        """
        pairs = []
        for tie in ties:
            columns = [int(column) for column in tie]
            numeric = all(0 <= c < space.dimension and not space.categorical[c] for c in columns)
            if len(set(columns)) != 2 or not numeric:
                raise SpaceError(f"expected two different columns of numbers, got {list(tie)!r}")
            pairs.append((columns[0], columns[1]))
        array = np.array(orders)
        straight = np.arange(space.dimension)
        parameters = [
            parameter.describe() | {"name": "", "resolution": None} for parameter in space.parameters
        ]
        if (
            array.shape != (len(orders), space.dimension)
            or not np.issubdtype(array.dtype, np.integer)
            or not (np.sort(array, axis=1) == straight).all()
            or not (array[0] == straight).all()
            or any([parameters[c] for c in order] != parameters for order in array.tolist())
        ):
            raise SpaceError(
                f"expected orders of {space.dimension} columns, the given order first, that swap parameters of the "
                f"same kind only, got {str(orders)[:200]}"
            )
        choices = [
            (column, code)
            for column, parameter in enumerate(space.parameters)
            if isinstance(parameter, Categorical)
            for code in range(len(parameter.choices))
        ]
        return cls(
            space=space,
            ties=tuple(pairs),
            orders=frozen_array(array, np.int64),
            _numeric=frozen_array(np.flatnonzero(~space.categorical), np.int64),
            _categories=frozen_array([column for column, _ in choices], np.int64),
            _codes=frozen_array([code for _, code in choices], np.int64),
        )

    @property
    def is_symmetric(self) -> bool:
        """Whether solutions have more than one equivalent order."""
        return len(self.orders) > 1

    def names(self) -> tuple[str, ...]:
        """Return a name for each feature."""
        columns, parameters = self.space.column_names(), self.space.parameters
        named = [columns[c] for c in self._numeric]
        for column, code in zip(self._categories.tolist(), self._codes.tolist(), strict=True):
            named.append(f"{columns[column]}={parameters[column].decode(code)}")
        pairs = [f"{columns[low]}..{columns[high]}" for low, high in self.ties]
        return (*named, *(f"middle of {pair}" for pair in pairs), *(f"length of {pair}" for pair in pairs))

    def of_rows(self, rows: FloatArray, order: int = 0) -> FeatureArray:
        """Return the features of complete solutions, shape ``(n, features)``.

        Args:
            rows: Complete solutions, shape ``(n, d)``.
            order: Which of the equivalent orders to present them in.

        Raises:
            SpaceError: The shape is wrong.
        """
        rows = np.asarray(rows, np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.space.dimension:
            raise SpaceError(f"expected rows of {self.space.dimension} numbers, got shape {rows.shape}")
        if order:
            rows = rows[:, self.orders[order]]
        numbers = rows / self.space.ranges
        low, high = (numbers[:, [tie[side] for tie in self.ties]] for side in (0, 1))
        return np.concatenate(
            [
                numbers[:, self._numeric],
                rows[:, self._categories] == self._codes,
                0.5 * (low + high),
                high - low,
            ],
            axis=1,
            dtype=np.float32,
        )

    def in_every_order(self, rows: FloatArray) -> FeatureArray:
        """Return the features in all equivalent orders, shape ``(orders, n, features)``."""
        return np.stack([self.of_rows(rows, order) for order in range(len(self.orders))])

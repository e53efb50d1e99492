"""The cells of a search for tolerances, their drives, and how rows of the space belong to them."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final, TypeAlias

import numpy as np

from brink.search.algorithms.tolerance.names import Names
from brink.search.algorithms.tolerance.settings import ToleranceConfig
from brink.search.curves import LEVELS
from brink.search.errors import ConfigError
from brink.search.odd import is_within
from brink.search.parameters import Categorical, Value
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace
from brink.search.streams import Stream, generator

MOST_CELLS: Final = 500


class Draw(IntEnum):
    """What is drawn, as the first index of the stream; the curves have 1 and 5."""

    CHOICE = 0
    DRIVE = 2


Choices: TypeAlias = Mapping[int, tuple[float, ...]]
"""The values that some columns of a row may have."""

DriveKey: TypeAlias = tuple[int, bytes]
"""Identifies a drive, whatever the error in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A combination of choices under a condition.

    Attributes:
        choices: The choices, in the order of the setting ``cells``.
        condition: Name of the condition.
        population: Number of its population: the drives from which its drives are drawn.
        group: Number of the group of cells whose drives are screened together; None if they are not screened.
    """

    choices: tuple[str, ...]
    condition: str
    population: int
    group: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Cells whose drives are screened with the same most severe error.

    Attributes:
        choices: The choices of the grossest error.
        condition: Name of the condition.
        population: Number of the population.
    """

    choices: tuple[str, ...]
    condition: str
    population: int


class Layout:
    """The cells of a search, and how rows of the space belong to them.

    Args:
        space: The search space.
        config: Settings.

    Raises:
        ConfigError: A setting does not fit the space or the others.

    Attributes:
        names: Columns of the cells' choices.
        cells: All cells; those of a condition follow each other.
        groups: Groups of cells whose drives are screened together.
        populations: The values that the columns of each population's drives are limited to.
        conditions: Names of the conditions, in their order.
        audits: Whether drives that are assumed to hold are audited.
    """

    def __init__(self, space: SearchSpace, config: ToleranceConfig) -> None:
        self._space = space
        self._config = config
        self._named = Names(space)
        self._parameters, self._columns = self._named.parameters, self._named.columns
        self.severity = self._named.column("severity", config.severity)
        severity = self._parameters[self.severity]
        if isinstance(severity, Categorical) or (severity.least, severity.most) != (0.0, 1.0):
            raise ConfigError(
                "severity", f"expected a number from 0 to 1, got {self._columns[self.severity]}"
            )
        self.audits = config.audit > 0.0
        self._component = _component_of(space, self.severity)
        chosen = {
            self._named.column("cells", name): (name, tuple(choices))
            for name, choices in config.cells.items()
        }
        self.names = tuple(self._columns[column] for column in chosen)
        self._cell_columns = tuple(chosen)
        for column, (name, choices) in chosen.items():
            self._named.codes("cells", column, name, choices)
        self._fixed = {
            column: value
            for column, value in (
                (self._named.column("fixed", name), self._named.value("fixed", name, value))
                for name, value in config.fixed.items()
            )
            if column not in chosen
        }
        self._truth = {
            self._named.column("truth", name): self._named.value("truth", name, value)
            for name, value in config.truth.items()
        }
        self.conditions, limits = self._conditions()
        cells, self.populations = self._populated(limits, [choices for _, choices in chosen.values()])
        self.cells, self.groups = self._grouped(cells)
        if len(self.cells) > MOST_CELLS:
            raise ConfigError("cells", f"expected at most {MOST_CELLS} cells, got {len(self.cells)}")
        self._codes_of_cells = [self._codes_of(cell) for cell in self.cells]
        self._codes_of_groups = [self._codes_of(group) for group in self.groups]
        self._limits = limits

    def _conditions(self) -> tuple[tuple[str, ...], list[Choices]]:
        """Return the names of the conditions, and the columns that each limits."""
        names: list[str] = []
        limits: list[Choices] = []
        if not self._config.conditions:
            raise ConfigError("conditions", "expected one condition or more, got none")
        for number, condition in enumerate(self._config.conditions, 1):
            limit: dict[int, tuple[float, ...]] = {}
            words = []
            for name, choices in condition.items():
                if name == "name":
                    continue
                column = self._named.column("conditions", name)
                if column in self._cell_columns or column == self.severity:
                    raise ConfigError("conditions", f"{name} is not a condition: it distinguishes the cells")
                given = [choices] if isinstance(choices, str) else choices
                limit[column] = self._named.codes("conditions", column, name, given)
                words.append(" or ".join(given))
            label = condition.get("name", ", ".join(words) or "all drives")
            if not isinstance(label, str) or not label or label in names:
                raise ConfigError(
                    "conditions", f"condition {number}: expected a name of its own, got {label!r}"
                )
            for other, earlier in zip(names, limits, strict=True):
                common = earlier.keys() & limit.keys()
                if all(set(earlier[column]) & set(limit[column]) for column in common):
                    raise ConfigError(
                        "conditions",
                        f"{other} and {label} overlap: expected conditions without a common drive",
                    )
            names.append(label)
            limits.append(limit)
        return tuple(names), limits

    def _populated(
        self, limits: Sequence[Choices], choices: Sequence[Sequence[str]]
    ) -> tuple[tuple[Cell, ...], tuple[Choices, ...]]:
        """Return all cells, and the values that the drives of each population are limited to."""
        populations: list[Choices] = []
        cells = []
        needs = {self._choice(choice): limit for choice, limit in self._config.needs.items()}
        for condition, limit in zip(self.conditions, limits, strict=True):
            for combination in itertools.product(*choices):
                needed: dict[int, tuple[float, ...]] = dict(limit)
                for column, choice in zip(self._cell_columns, combination, strict=True):
                    for name, allowed in needs.get((column, choice), {}).items():
                        self._narrow(needed, name, allowed, f"{choice} under {condition}")
                if needed not in populations:
                    populations.append(needed)
                cells.append(
                    Cell(choices=combination, condition=condition, population=populations.index(needed))
                )
        return tuple(cells), tuple(populations)

    def _choice(self, text: str) -> tuple[int, str]:
        name, _, choice = text.partition("=")
        self._named.value("needs", name, choice)
        return self._named.column("needs", name), choice

    def _narrow(
        self, needed: dict[int, tuple[float, ...]], name: str, allowed: Sequence[str], what: str
    ) -> None:
        column = self._named.column("needs", name)
        codes = self._named.codes("needs", column, name, allowed)
        left = tuple(code for code in needed.get(column, codes) if code in codes)
        if not left:
            parameter = self._parameters[column]
            given = ", ".join(str(parameter.decode(code)) for code in needed[column])
            raise ConfigError(
                "conditions",
                f"{what}: expected {self._columns[column]} to allow {' or '.join(allowed)}, got {given}",
            )
        needed[column] = left

    def _grouped(self, cells: Sequence[Cell]) -> tuple[tuple[Cell, ...], tuple[Group, ...]]:
        """Return the cells with their groups, and the groups."""
        config = self._config
        if not config.grossest or config.design != "adaptive":
            return tuple(cells), ()
        grossest = {}
        for name, choice in config.grossest.items():
            self._named.value("grossest", name, choice)
            grossest[self._named.column("grossest", name)] = choice
        covered = {
            self._named.column("covers", name): {
                *choices,
                grossest.get(self._named.column("covers", name), ""),
            }
            for name, choices in config.covers.items()
        }
        for name, choices in config.covers.items():
            self._named.codes("covers", self._named.column("covers", name), name, choices)
        if grossest.keys() != covered.keys():
            raise ConfigError("covers", f"expected the same parameters as in grossest, got {config.covers!r}")
        groups: list[Group] = []
        grouped = []
        for cell in cells:
            columns = dict(zip(self._cell_columns, cell.choices, strict=True))
            if any(columns.get(column) not in choices for column, choices in covered.items()):
                grouped.append(cell)
                continue
            group = Group(
                choices=tuple({**columns, **grossest}.values()),
                condition=cell.condition,
                population=cell.population,
            )
            if group not in groups:
                if any(
                    (other.choices, other.condition) == (group.choices, group.condition) for other in groups
                ):
                    raise ConfigError(
                        "needs",
                        f"expected cells that are screened with {', '.join(group.choices)} to need the same",
                    )
                groups.append(group)
            grouped.append(replace(cell, group=groups.index(group)))
        return tuple(grouped), tuple(groups)

    def _codes_of(self, cell: Cell | Group) -> tuple[tuple[float, ...], int]:
        return self._choice_codes(cell.choices), self.conditions.index(cell.condition)

    def _choice_codes(self, choices: Sequence[str]) -> tuple[float, ...]:
        return tuple(
            self._named.value("cells", name, choice) for name, choice in zip(self.names, choices, strict=True)
        )

    def is_grossest(self, cell: Cell) -> bool:
        """Return whether a cell's error is the one with which its drives are screened."""
        return cell.group is not None and cell.choices == self.groups[cell.group].choices

    def row(
        self, seed: int, population: int, drive: int, choices: Sequence[str] | None, level: int
    ) -> FloatArray:
        """Return a drive as a row of the space.

        Args:
            seed: Seed of the search.
            population: The population that it belongs to.
            drive: Number of the drive.
            choices: Those of its cell or group; None without an error.
            level: Level of severity.
        """
        shares = generator(seed, Stream.TOLERANCE, Draw.DRIVE, drive).random(self._space.dimension)
        row = np.empty(self._space.dimension)
        for column, parameter in enumerate(self._parameters):
            codes = self.populations[population].get(column)
            if codes is not None:
                row[column] = codes[int(shares[column] * len(codes))]
            elif isinstance(parameter, Categorical):
                row[column] = parameter.codes[int(shares[column] * len(parameter.codes))]
            else:
                row[column] = parameter.rounded(
                    parameter.least + shares[column] * (parameter.most - parameter.least)
                )
        for column, value in self._fixed.items():
            row[column] = value
        row[self.severity] = level / LEVELS
        if choices is None:
            for column, value in self._truth.items():
                row[column] = value
        else:
            row[list(self._cell_columns)] = self._choice_codes(choices)
        repaired = self._space.repair(self._space.split(row), np.random.Generator(np.random.PCG64(0)))
        return self._space.join(repaired)

    def population_of(self, number: int) -> int | None:
        """Return the population that a first drive without an error belongs to; None for any other candidate."""
        population = number // self._config.without_error
        return population if population < len(self.populations) else None

    def condition_of(self, values: Mapping[str, Value]) -> str | None:
        """Return the condition of a drive in any space with the same parameters; None if it has none.

        A drive outside the ODD of this search has none.

        Args:
            values: Decoded values by component.parameter.
        """
        for column, parameter in zip(self._columns, self._parameters, strict=True):
            if parameter.odd is not None and column in values and not is_within(parameter, values[column]):
                return None
        for name, limit in zip(self.conditions, self._limits, strict=True):
            allowed = {
                self._columns[column]: {self._parameters[column].decode(code) for code in codes}
                for column, codes in limit.items()
            }
            if all(values.get(column) in choices for column, choices in allowed.items()):
                return name
        return None

    def cells_of(self, rows: FloatArray) -> IntArray:
        """Return the index of each row's cell, shape ``(n,)``; -1 for a drive without an error or without a cell."""
        return self._places(rows, self._codes_of_cells)

    def groups_of(self, rows: FloatArray) -> IntArray:
        """Return the group that each row screens a drive of, shape ``(n,)``; -1 for none."""
        groups = self._places(rows, self._codes_of_groups)
        return np.where(rows[:, self.severity] == 1.0, groups, -1)

    def _places(self, rows: FloatArray, codes_of: Sequence[tuple[tuple[float, ...], int]]) -> IntArray:
        places = np.full(len(rows), -1, np.int64)
        is_true = self.without_error(rows)
        for place, (codes, condition) in enumerate(codes_of):
            is_here = ~is_true
            for column, code in zip(self._cell_columns, codes, strict=True):
                is_here &= rows[:, column] == code
            for column, allowed in self._limits[condition].items():
                is_here &= np.isin(rows[:, column], allowed)
            places[is_here] = place
        return places

    def without_error(self, rows: FloatArray) -> BoolArray:
        """Return which rows are drives without an error, shape ``(n,)``."""
        is_true = np.full(len(rows), bool(self._truth))
        for column, value in self._truth.items():
            is_true &= rows[:, column] == value
        return is_true

    def levels_of(self, rows: FloatArray) -> IntArray:
        """Return the level of severity of each row, shape ``(n,)``."""
        return np.rint(rows[:, self.severity] * LEVELS).astype(np.int64)

    def drive_keys(self, rows: FloatArray, seeds: Sequence[int]) -> list[DriveKey]:
        """Return a key of each row's drive, which does not depend on the error in it.

        Args:
            rows: Shape ``(n, d)``.
            seeds: For each row, its episode seed or anything else that is the same exactly for the same seed.
        """
        rest = np.delete(rows, self._component, axis=1)
        return [(seed, row.tobytes()) for seed, row in zip(seeds, rest, strict=True)]


def _component_of(space: SearchSpace, column: int) -> slice:
    """Return the columns of the component that a column belongs to."""
    start = 0
    for component in space.components:
        if column < start + component.dimension:
            return slice(start, start + component.dimension)
        start += component.dimension
    raise IndexError(column)

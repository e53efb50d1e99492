"""`tolerance@1`: how gross an error may be before it makes a given share of drives violate.

The search space has a parameter for the *severity* of an error, and others, such as its type and target, whose
choices are the *cells*. In each cell and under each *condition* the search estimates a curve, the share of violations
that the error causes, and the severity at which it reaches a limit (`brink.search.curves`).

All cells share one list of drives: drive number i has the same scenario, onset and episode seed in all of them, apart
from what a cell or condition prescribes. The first drives are simulated without any error as well, and so is every
later drive that violates with one: only a violation that goes away with the error was caused by it.

Drives are screened with the grossest error, where there is one, and milder errors are simulated in vulnerable drives
alone (`brink.search.curves`). Within a cell every drive is simulated once, at one severity: another drive tells more
about the share than the same drive at another severity.

Simulations go to the cells whose intervals they are expected to narrow most for what they cost, screening included,
and there to the severities that tell most about where the limit is reached.

Source: ours; see docs/explanation/tolerance.md.
"""

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import BoundaryConfig, Ledger, LedgerAlgorithm, LedgerState
from brink.search.curves import (
    BEYOND,
    LEVELS,
    Counts,
    Curve,
    Screening,
    curves_of,
    library,
    quantiles_of_sorted,
    scaled,
    severity_at,
    weights,
)
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, SpaceError, UnsupportedSpace
from brink.search.odd import is_within
from brink.search.parameters import Categorical, Value, did_you_mean
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace
from brink.search.streams import Stream, generator

MOST_CELLS: Final = 500
FIRST_SCREENED: Final = 40
"""Drives of each group that are screened first."""
MOST_TRIES: Final = 3
"""Simulations of a drive without an error, if they fail."""
FIRST_DRIVES: Final = 8
"""Drives of a cell that a budget must allow."""
_CURVES: Final = 20_000
"""Curves of the library that the search uses."""
_NARROW: Final = 1e-3
"""Width of an interval below which a narrower one is no better."""
_QUANTILES: Final = np.array([0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95])
"""Where the shares of vulnerable and of leaking drives are looked up; the middle one is the median."""
_SHUFFLED: Final = np.array([4, 1, 6, 3, 0, 5, 2])
"""Order of the quantiles of the leaking share, nearly uncorrelated with that of the vulnerable share."""
_CHOICE, _DRIVE = 0, 2
# What is drawn, as the first index of the stream; the curves have 1 and 5.

Choices: TypeAlias = Mapping[int, tuple[float, ...]]
"""The values that some columns of a row may have."""
DriveKey: TypeAlias = tuple[int, bytes]
"""Identifies a drive, whatever the error in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ToleranceConfig(BoundaryConfig):
    """Settings of the search for tolerances."""

    cells: dict[str, list[str]] = field(
        default_factory=dict,
        metadata={
            "help": "Parameters, such as type and target, and those of their choices to study in combination."
        },
    )
    conditions: list[dict[str, str | list[str]]] = field(
        default_factory=lambda: [{}],
        metadata={
            "help": "Conditions to tell apart: for each, a name and the choices that parameters are limited to, such "
            "as {name: by night, time_of_day: night}. No two conditions may have a drive in common."
        },
    )
    limit: float = setting(
        0.05,
        help="Share of drives with a violation that the error causes: the highest that is tolerated.",
        gt=0,
        lt=1,
    )
    confidence: float = setting(0.9, help="Probability that an interval covers the truth.", gt=0, lt=1)
    width: float = setting(
        0.0,
        help="The search ends when every interval of the tolerated severity is narrower than this.",
        ge=0,
        le=1,
    )
    without_error: int = setting(
        40,
        help="Drives without an error that each condition begins with, for each kind of scenario that cells need.",
        ge=1,
        le=100_000,
    )
    grossest: dict[str, str] = field(
        default_factory=dict,
        metadata={
            "help": "The choice that, at severity 1, stands for the grossest error: drives that hold with it are "
            "taken to hold with the errors that it covers."
        },
    )
    covers: dict[str, list[str]] = field(
        default_factory=dict, metadata={"help": "Choices that stand for errors that the grossest one covers."}
    )
    audit: float = setting(
        0.25,
        help="Share of the simulations of covered errors in drives that are taken to hold. With 0, that they hold is "
        "not checked, and the intervals take it on trust.",
        ge=0,
        le=0.5,
    )
    explore: float = setting(
        0.05,
        help="Share of the simulations at any severity, rather than where the limit may be reached.",
        ge=0,
        le=1,
    )
    design: str = setting(
        "adaptive",
        help="Where to simulate: adaptive; uniform for equally many drives at equally spaced severities, a baseline "
        "to compare with; or random for equally many at severities drawn by chance, to check a requirement.",
        choices=("adaptive", "uniform", "random"),
    )
    levels: int = setting(8, help="Severities of the uniform design; a divisor of 32.", ge=1, le=32)
    severity: str = setting("severity", help="The parameter that says how gross the error is, from 0 to 1.")
    fixed: dict[str, str | float] = field(
        default_factory=dict,
        metadata={"help": "Values of other parameters; those that are not given are drawn for every drive."},
    )
    truth: dict[str, str] = field(
        default_factory=dict, metadata={"help": "Choices that stand for no error at all."}
    )
    needs: dict[str, dict[str, list[str]]] = field(
        default_factory=dict,
        metadata={
            "help": "What the scenario must have for a choice to mean anything, such as {target=pedestrian: "
            "{pedestrians: ['18']}}."
        },
    )
    generation_size: int = setting(60, help="Candidates per generation.", ge=1, le=10_000)
    in_flight: int = setting(
        3,
        help="Generations in flight at a time. More keep more workers busy; fewer let every choice know more.",
        ge=1,
        le=1000,
    )


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
    """Cells whose drives are screened with the same grossest error.

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
        audits: Whether drives that are taken to hold are audited.
    """

    def __init__(self, space: SearchSpace, config: ToleranceConfig) -> None:
        self._space = space
        self._config = config
        columns = space.column_names()
        self._parameters = [p for component in space.components for p in component.parameters]
        self._columns = columns
        self.severity = self._column("severity", config.severity)
        severity = self._parameters[self.severity]
        if isinstance(severity, Categorical) or (severity.least, severity.most) != (0.0, 1.0):
            raise ConfigError("severity", f"expected a number from 0 to 1, got {columns[self.severity]}")
        self.audits = config.audit > 0.0
        self._component = _component_of(space, self.severity)
        chosen = {
            self._column("cells", name): (name, tuple(choices)) for name, choices in config.cells.items()
        }
        self.names = tuple(columns[column] for column in chosen)
        self._cell_columns = tuple(chosen)
        for column, (name, choices) in chosen.items():
            self._codes("cells", column, name, choices)
        self._fixed = {
            column: value
            for column, value in (
                (self._column("fixed", name), self._value("fixed", name, value))
                for name, value in config.fixed.items()
            )
            if column not in chosen
        }
        self._truth = {
            self._column("truth", name): self._value("truth", name, value)
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

    def _column(self, setting_name: str, name: str) -> int:
        """Return the column of a parameter, given its name or the last parts of it."""
        found = [
            place
            for place, column in enumerate(self._columns)
            if column == name or column.endswith("." + name)
        ]
        exact = [place for place in found if self._columns[place] == name]
        found = exact or found
        if len(found) == 1:
            return found[0]
        if not found:
            short = {column.split(".", 1)[-1] for column in self._columns}
            raise ConfigError(
                setting_name, f"unknown parameter {name!r}{did_you_mean(name, [*self._columns, *short])}"
            )
        meant = ", ".join(self._columns[place] for place in found)
        raise ConfigError(setting_name, f"{name!r} may be any of {meant}: expected one of these")

    def _value(self, setting_name: str, name: str, value: str | float) -> float:
        parameter = self._parameters[self._column(setting_name, name)]
        try:
            return parameter.encode(value)
        except SpaceError as error:
            raise ConfigError(setting_name, str(error)) from None

    def _codes(self, setting_name: str, column: int, name: str, choices: Sequence[str]) -> tuple[float, ...]:
        if not isinstance(self._parameters[column], Categorical):
            raise ConfigError(setting_name, f"expected a parameter with choices, got {name}")
        if not choices or len(set(choices)) < len(choices):
            raise ConfigError(setting_name, f"{name}: expected one or more distinct choices, got {choices!r}")
        return tuple(self._value(setting_name, name, choice) for choice in choices)

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
                column = self._column("conditions", name)
                if column in self._cell_columns or column == self.severity:
                    raise ConfigError("conditions", f"{name} is not a condition: it distinguishes the cells")
                given = [choices] if isinstance(choices, str) else choices
                limit[column] = self._codes("conditions", column, name, given)
                words.append(" or ".join(given))
            label = condition.get("name", ", ".join(words) or "all drives")
            if not isinstance(label, str) or not label or label in names:
                raise ConfigError(
                    "conditions", f"condition {number}: expected a name of its own, got {label!r}"
                )
            for other, known in zip(names, limits, strict=True):
                common = known.keys() & limit.keys()
                if all(set(known[column]) & set(limit[column]) for column in common):
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
        self._value("needs", name, choice)
        return self._column("needs", name), choice

    def _narrow(
        self, needed: dict[int, tuple[float, ...]], name: str, allowed: Sequence[str], what: str
    ) -> None:
        column = self._column("needs", name)
        codes = self._codes("needs", column, name, allowed)
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
            self._value("grossest", name, choice)
            grossest[self._column("grossest", name)] = choice
        covered = {
            self._column("covers", name): {*choices, grossest.get(self._column("covers", name), "")}
            for name, choices in config.covers.items()
        }
        for name, choices in config.covers.items():
            self._codes("covers", self._column("covers", name), name, choices)
        if grossest.keys() != covered.keys():
            raise ConfigError("covers", f"expected the same parameters as in grossest, got {config.covers!r}")
        groups: list[Group] = []
        found = []
        for cell in cells:
            columns = dict(zip(self._cell_columns, cell.choices, strict=True))
            if any(columns.get(column) not in choices for column, choices in covered.items()):
                found.append(cell)
                continue
            group = Group(
                choices=tuple({**columns, **grossest}.values()),
                condition=cell.condition,
                population=cell.population,
            )
            if group not in groups:
                if any((one.choices, one.condition) == (group.choices, group.condition) for one in groups):
                    raise ConfigError(
                        "needs",
                        f"expected cells that are screened with {', '.join(group.choices)} to need the same",
                    )
                groups.append(group)
            found.append(replace(cell, group=groups.index(group)))
        return tuple(found), tuple(groups)

    def _codes_of(self, one: Cell | Group) -> tuple[tuple[float, ...], int]:
        return self._choice_codes(one.choices), self.conditions.index(one.condition)

    def _choice_codes(self, choices: Sequence[str]) -> tuple[float, ...]:
        return tuple(
            self._value("cells", name, choice) for name, choice in zip(self.names, choices, strict=True)
        )

    def is_grossest(self, cell: Cell) -> bool:
        """Return whether a cell is that of the error with which its drives are screened."""
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
        shares = generator(seed, Stream.TOLERANCE, _DRIVE, drive).random(self._space.dimension)
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
        """Return the place of each row's cell, shape ``(n,)``; -1 for a drive without an error or of no cell."""
        return self._found(rows, self._codes_of_cells)

    def groups_of(self, rows: FloatArray) -> IntArray:
        """Return the group that each row screens a drive of, shape ``(n,)``; -1 for none."""
        found = self._found(rows, self._codes_of_groups)
        return np.where(rows[:, self.severity] == 1.0, found, -1)

    def _found(self, rows: FloatArray, codes_of: Sequence[tuple[tuple[float, ...], int]]) -> IntArray:
        found = np.full(len(rows), -1, np.int64)
        is_true = self.without_error(rows)
        for place, (codes, condition) in enumerate(codes_of):
            is_here = ~is_true
            for column, code in zip(self._cell_columns, codes, strict=True):
                is_here &= rows[:, column] == code
            for column, allowed in self._limits[condition].items():
                is_here &= np.isin(rows[:, column], allowed)
            found[is_here] = place
        return found

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tally:
    """What the simulations of a search say.

    Attributes:
        counts: Drives with an error and violations caused by it, by cell and level; of screened cells, those of
            vulnerable drives.
        screenings: The screening of each group.
        vulnerable: The vulnerable drives of each group, by `Layout.drive_keys`, in the order of their simulation.
        immune: The drives of each group that held with the grossest error, in the same form.
        baseline: Of the first drives of each population, those that violate without an error, and all.
        open_numbers: Numbers of the violations of which it is not known yet whether the error caused them.
        caused: Cell, level and number of the violations that the error is known to have caused, by severity.
    """

    counts: Counts
    screenings: tuple[Screening, ...]
    vulnerable: tuple[tuple[DriveKey, ...], ...]
    immune: tuple[tuple[DriveKey, ...], ...]
    baseline: tuple[tuple[int, int], ...]
    open_numbers: tuple[int, ...]
    caused: tuple[tuple[int, int, int], ...]

    def curves(self, layout: Layout, *, limit: float, confidence: float) -> list[Curve]:
        """Return the curve of each cell.

        Args:
            layout: The cells.
            limit: Share of caused violations whose severity is wanted.
            confidence: Probability that an interval covers the truth.
        """
        screenings = [None if cell.group is None else self.screenings[cell.group] for cell in layout.cells]
        grossest = [layout.is_grossest(cell) for cell in layout.cells]
        return curves_of(self.counts, screenings, grossest, limit=limit, confidence=confidence)


def tally(
    layout: Layout, rows: FloatArray, numbers: Sequence[int], unsafe: BoolArray, seeds: Sequence[int]
) -> Tally:
    """Count the drives of a search.

    Violations of which it is not known yet whether the error caused them count as caused, but a drive is only
    simulated as a vulnerable one once that is known.

    Args:
        layout: The cells.
        rows: Simulated solutions, shape ``(n, d)``, in the order of their numbers.
        numbers: Their numbers.
        unsafe: Their verdicts, shape ``(n,)``.
        seeds: For each, its episode seed or anything else that is the same exactly for the same seed.
    """
    cells, levels, groups = layout.cells_of(rows), layout.levels_of(rows), layout.groups_of(rows)
    keys = layout.drive_keys(rows, seeds)
    baseline = [(0, 0) for _ in layout.populations]
    without: dict[DriveKey, bool] = {}
    for place in np.flatnonzero(layout.without_error(rows)).tolist():
        without[keys[place]] = bool(unsafe[place])
        population = layout.population_of(numbers[place])
        if population is not None:
            violating, drives = baseline[population]
            baseline[population] = violating + int(unsafe[place]), drives + 1
    open_numbers: list[int] = []
    vulnerable: list[dict[DriveKey, int]] = [{} for _ in layout.groups]
    immune: list[dict[DriveKey, None]] = [{} for _ in layout.groups]
    screened, unexplained = [0 for _ in layout.groups], [0 for _ in layout.groups]
    caused: list[tuple[int, int, int]] = []
    for place in np.flatnonzero(groups >= 0).tolist():
        group, key = int(groups[place]), keys[place]
        truth = without.get(key)
        screened[group] += 1
        if not unsafe[place]:
            immune[group][key] = None
        elif truth is None:
            open_numbers.append(numbers[place])
            unexplained[group] += 1
        elif not truth:
            vulnerable[group][key] = numbers[place]
    counts = Counts.empty(len(layout.cells))
    audited = Counts.empty(len(layout.groups))
    for place in np.flatnonzero((cells >= 0) & (groups < 0)).tolist():
        cell, level, key, verdict = int(cells[place]), int(levels[place]), keys[place], bool(unsafe[place])
        own = layout.cells[cell].group
        truth = without.get(key)
        if verdict and truth is None:
            open_numbers.append(numbers[place])
        if own is None or key in vulnerable[own]:
            counts.drives[cell, level - 1] += 1
            counts.caused[cell, level - 1] += int(verdict and not truth)
            if verdict and truth is False:
                caused.append((cell, level, numbers[place]))
        elif key in immune[own]:
            audited.drives[own, level - 1] += 1
            audited.caused[own, level - 1] += int(verdict and not truth)
    for place, one in enumerate(layout.cells):
        if one.group is not None and layout.is_grossest(one):
            caused += [(place, LEVELS, number) for number in vulnerable[one.group].values()]
    return Tally(
        counts=counts,
        screenings=tuple(
            Screening(
                vulnerable=len(vulnerable[group]) + unexplained[group],
                screened=screened[group],
                audits=audited.drives[group] if layout.audits else None,
                leaks=audited.caused[group] if layout.audits else None,
            )
            for group in range(len(layout.groups))
        ),
        vulnerable=tuple(tuple(found) for found in vulnerable),
        immune=tuple(tuple(found) for found in immune),
        baseline=tuple(baseline),
        open_numbers=tuple(sorted(open_numbers)),
        caused=tuple(sorted(caused, key=lambda one: (one[1], one[2]))),
    )


class Purpose(IntEnum):
    """Why a candidate is simulated. The numbers are stored."""

    TRUTH = 0
    """Without an error; of a population."""
    SCREENING = 1
    """With the grossest error; of a group."""
    ERROR = 2
    """Of a cell."""
    AUDIT = 3
    """Of a cell, in a drive that is taken to hold."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToleranceState(LedgerState):
    """State of the search.

    Attributes:
        config: Settings.
        jobs: Purpose, population, group or cell, and drive of each candidate, by its number, shape ``(n, 3)``.
        roots: Number of the candidate whose episode seed a drive has, by the number of the drive.
    """

    config: ToleranceConfig
    jobs: IntArray
    roots: tuple[int, ...]

    @property
    def drives(self) -> list[int]:
        """The drive of each candidate, by its number."""
        found: list[int] = self.jobs[:, 2].tolist()
        return found


class Tolerance(LedgerAlgorithm[ToleranceConfig, ToleranceState]):
    """The search for tolerances."""

    id = "tolerance@1"
    summary = "Tolerances: how gross an error may be before it makes a given share of drives violate."
    config_type = ToleranceConfig

    def _min_budget(self, space: SearchSpace, config: ToleranceConfig) -> int:
        names = space.column_names()
        if not any(name == config.severity or name.endswith("." + config.severity) for name in names):
            raise UnsupportedSpace(
                f"tolerance@1 needs a parameter for the severity of an error; {config.severity} is none of "
                f"{', '.join(names)}"
            )
        layout = Layout(space, config)
        if LEVELS % config.levels:
            raise ConfigError("levels", f"expected a divisor of {LEVELS}, got {config.levels}")
        first = {"adaptive": FIRST_DRIVES, "uniform": config.levels, "random": 1}[config.design]
        return (
            len(layout.populations) * config.without_error
            + len(layout.groups) * FIRST_SCREENED
            + len(layout.cells) * first
        )

    def _first_state(self, ledger: Ledger, config: ToleranceConfig) -> ToleranceState:
        state = ToleranceState(config=config, ledger=ledger, jobs=np.empty((0, 3), np.int64), roots=())
        return _planned(state, Layout(ledger.space, config))

    def tell(self, state: ToleranceState, evaluations: Mapping[int, Evaluation]) -> ToleranceState:
        """Return the state after the pending generation was evaluated."""
        state = replace(state, ledger=state.ledger.tell(evaluations))
        return _planned(state, Layout(state.ledger.space, state.config))

    def _refilled(self, state: ToleranceState) -> ToleranceState:
        return _planned(state, Layout(state.ledger.space, state.config))

    def _content(self, state: ToleranceState) -> tuple[dict[str, Any], dict[str, Any]]:
        return {}, {"jobs": state.jobs, "roots": np.array(state.roots, np.int64)}

    def _restored(self, ledger: Ledger, config: ToleranceConfig, document: Document) -> ToleranceState:
        jobs, roots = (document.arrays.get(name) for name in ("jobs", "roots"))
        if jobs is None or jobs.dtype != np.int64 or jobs.ndim != 2 or jobs.shape[1] != 3:
            raise DocumentError(f"jobs: expected rows of 3 whole numbers, got {jobs!r:.80}")
        if roots is None or roots.dtype != np.int64 or roots.ndim != 1:
            raise DocumentError(f"roots: expected whole numbers, got {roots!r:.80}")
        return ToleranceState(config=config, ledger=ledger, jobs=jobs, roots=tuple(roots.tolist()))


class _Plan:
    """A generation that is being planned."""

    def __init__(self, state: ToleranceState, layout: Layout, room: int) -> None:
        self._layout = layout
        self._seed = state.ledger.seed
        self._known_jobs = state.jobs
        self._new_jobs: list[tuple[int, int, int]] = []
        self.room = room
        self.roots = list(state.roots)
        self.rows: list[FloatArray] = []
        self.seeds: list[int | None] = []
        errors = state.jobs[state.jobs[:, 0] >= Purpose.ERROR]
        self.planned = np.bincount(errors[:, 1], minlength=len(layout.cells))
        screens = state.jobs[state.jobs[:, 0] == Purpose.SCREENING]
        self.screened = np.bincount(screens[:, 1], minlength=len(layout.groups))

    @property
    def jobs(self) -> IntArray:
        """The jobs of all candidates, with those that were planned."""
        return np.concatenate([self._known_jobs, np.array(self._new_jobs, np.int64).reshape(-1, 3)])

    def _add(
        self,
        purpose: Purpose,
        of: int,
        population: int,
        drive: int,
        choices: Sequence[str] | None,
        level: int,
    ) -> None:
        number = len(self._known_jobs) + len(self._new_jobs)
        known = drive < len(self.roots)
        if not known:
            self.roots.append(number)
        self.rows.append(self._layout.row(self._seed, population, drive, choices, level))
        self.seeds.append(self.roots[drive] if known else None)
        self._new_jobs.append((int(purpose), of, drive))
        self.room -= 1

    def add_truth(self, population: int, drive: int) -> None:
        """Plan a drive without an error."""
        self._add(Purpose.TRUTH, population, population, drive, None, 0)

    def add_screening(self, group: int) -> None:
        """Plan the next drive of a group with the grossest error."""
        found, drive = self._layout.groups[group], int(self.screened[group])
        self.screened[group] += 1
        self._add(Purpose.SCREENING, group, found.population, drive, found.choices, LEVELS)

    def add_error(self, cell: int, level: int, drive: int | None = None, *, audit: bool = False) -> None:
        """Plan a drive of a cell, by default the next one."""
        found = self._layout.cells[cell]
        number = int(self.planned[cell]) if drive is None else drive
        self.planned[cell] += 1
        purpose = Purpose.AUDIT if audit else Purpose.ERROR
        self._add(purpose, cell, found.population, number, found.choices, level)


def _planned(state: ToleranceState, layout: Layout) -> ToleranceState:
    """Return the state with the next generation queued, as budget, room in flight and results allow."""
    ledger, config = state.ledger, state.config
    if ledger.queue:
        return state
    room = int(min(config.generation_size, ledger.left)) if len(ledger.flight) < config.in_flight else 0
    if room <= 0:
        return state
    plan = _Plan(state, layout, room)
    begun, first = len(state.jobs), len(layout.populations) * config.without_error
    for number in range(begun, min(first, begun + room)):
        plan.add_truth(number // config.without_error, number % config.without_error)
    for group in range(len(layout.groups)):
        while plan.room and plan.screened[group] < FIRST_SCREENED:
            plan.add_screening(group)
    if plan.room:
        rng = generator(ledger.seed, Stream.TOLERANCE, _CHOICE, ledger.planned_generation)
        results = _Results(state, layout)
        results.plan_truth(plan)
        if config.design == "uniform":
            _plan_uniform(plan, config)
        elif config.design == "random":
            _plan_random(plan, rng)
        elif not results.is_done():
            results.plan_adaptively(plan, rng)
    if not plan.rows:
        return state
    return replace(
        state, ledger=ledger.plan(plan.rows, seed_numbers=plan.seeds), jobs=plan.jobs, roots=tuple(plan.roots)
    )


def _plan_uniform(plan: _Plan, config: ToleranceConfig) -> None:
    """Plan equally many drives at equally spaced severities in every cell."""
    step = LEVELS // config.levels
    while plan.room:
        cell = int(np.argmin(plan.planned))
        plan.add_error(cell, step * (1 + int(plan.planned[cell]) % config.levels))


def _plan_random(plan: _Plan, rng: np.random.Generator) -> None:
    """Plan equally many drives at random severities in every cell."""
    while plan.room:
        plan.add_error(int(np.argmin(plan.planned)), int(rng.integers(1, LEVELS, endpoint=True)))


class _Results:
    """What a search knows when it plans a generation."""

    def __init__(self, state: ToleranceState, layout: Layout) -> None:
        self._state = state
        self._layout = layout
        archive = state.ledger.archive
        drives = state.drives
        self._tally = tally(
            layout,
            archive.vectors,
            archive.numbers.tolist(),
            archive.unsafe,
            [drives[number] for number in archive.numbers.tolist()],
        )

    def plan_truth(self, plan: _Plan) -> None:
        """Plan the drives without an error that tell whether it caused a violation."""
        state, layout, jobs = self._state, self._layout, self._state.jobs
        tried = Counter(map(tuple, jobs[jobs[:, 0] == Purpose.TRUTH][:, 1:].tolist()))
        flying = [c.number for generation in state.ledger.flight for c in generation]
        alive = jobs[[*state.ledger.archive.numbers.tolist(), *flying]]
        known = set(map(tuple, alive[alive[:, 0] == Purpose.TRUTH][:, 1:].tolist()))
        known |= {drive for drive, count in tried.items() if count >= MOST_TRIES}
        for number in self._tally.open_numbers:
            if not plan.room:
                return
            purpose, of, drive = jobs[number].tolist()
            owner = layout.groups[of] if purpose == Purpose.SCREENING else layout.cells[of]
            if (owner.population, drive) not in known:
                known.add((owner.population, drive))
                plan.add_truth(owner.population, drive)
        # What is left must suffice to tell the cause of the violations that are still to come.
        archive = state.ledger.archive
        share = (float(archive.unsafe.sum()) + 1.0) / (len(archive) + 10.0)
        spare = state.ledger.left - len(plan.rows) - math.ceil(share * (len(flying) + plan.room))
        if flying or plan.rows:
            plan.room = min(plan.room, max(int(spare), 0))

    def is_done(self) -> bool:
        """Return whether all intervals are as narrow as wanted."""
        config = self._state.config
        if not config.width or not (self._estimates.widths < config.width).all():
            return False
        curves = self._tally.curves(self._layout, limit=config.limit, confidence=config.confidence)
        return all(curve.tolerated.width < config.width for curve in curves)

    @cached_property
    def _estimates(self) -> "_Estimates":
        """How well the tolerated severity of each cell is known, and what a drive would tell."""
        layout, config = self._layout, self._state.config
        tail = 0.5 * (1.0 - config.confidence)
        widths, gains = np.empty(len(layout.cells)), np.empty((len(layout.cells), LEVELS))
        kinds = {(cell.group, layout.is_grossest(cell)) for cell in layout.cells}
        for group, is_grossest in sorted(kinds, key=str):
            curves = scaled(library(_CURVES)) if is_grossest else library(_CURVES)
            places = [
                place
                for place, cell in enumerate(layout.cells)
                if (cell.group, layout.is_grossest(cell)) == (group, is_grossest)
            ]
            counts = self._tally.counts
            likely = weights(Counts(drives=counts.drives[places], caused=counts.caused[places]), curves)
            severity, middle = self._severities(group, curves)
            order = np.argsort(severity.ravel(), kind="stable")
            for place, chances in zip(places, likely, strict=True):
                pooled = np.tile(chances, len(severity))[order]
                low, high = quantiles_of_sorted(severity.ravel()[order], pooled, (tail, 1.0 - tail))
                widths[place] = high - low
            shares = curves[:, 1:].astype(np.float64)
            mean, unsafe = likely @ middle, np.clip(likely @ shares, 1e-9, 1.0 - 1e-9)
            common = (likely * middle) @ shares - mean[:, None] * unsafe
            gains[places] = np.maximum(common**2 / (unsafe * (1.0 - unsafe)), 1e-15)
        return _Estimates(widths, gains)

    def _severities(self, group: int | None, curves: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
        """Return where curves of vulnerable drives reach the limit among all drives.

        Args:
            group: The group that they are screened in; None if they are those of all drives.
            curves: The curves, shape ``(n, LEVELS + 1)``.

        Returns:
            The severities for several shares of vulnerable and of leaking drives, shape ``(m, n)``; and those for the
            most likely shares, shape ``(n,)``.
        """
        limit = self._state.config.limit
        if group is None:
            found = np.minimum(severity_at(curves, limit), BEYOND)
            return found[None], found
        screening = self._tally.screenings[group]
        vulnerable = screening.vulnerable_share(_QUANTILES)
        leak = screening.leak(_QUANTILES[_SHUFFLED])
        return (
            np.stack([self._reached(curves, *shares) for shares in zip(vulnerable, leak, strict=True)]),
            self._reached(curves, vulnerable[len(_QUANTILES) // 2], screening.likeliest_leak),
        )

    def _reached(self, curves: NDArray[np.floating], vulnerable: float, leak: float) -> FloatArray:
        shares = Screening.all_drives(curves, np.array([vulnerable]), np.array([leak]))
        return np.minimum(severity_at(shares, self._state.config.limit), BEYOND)

    def _vulnerable(self, group: int) -> float:
        """Return the estimated share of vulnerable drives of a group."""
        found = self._tally.screenings[group]
        return (found.vulnerable + 0.5) / (found.screened + 1.0)

    def plan_adaptively(self, plan: _Plan, rng: np.random.Generator) -> None:
        """Plan drives where they narrow the intervals of tolerated severities most for what they cost."""
        config, layout = self._state.config, self._layout
        if not plan.room:
            return
        groups = [-1 if cell.group is None else cell.group for cell in layout.cells]
        unused = [_Unused(self._state, layout, self._tally, cell) for cell in range(len(groups))]
        cost = np.array([1.0 if group < 0 else 2.0 + 1.0 / self._vulnerable(group) for group in groups])
        drives = plan.planned.astype(np.float64)
        while plan.room:
            free = np.array(
                [group < 0 or bool(one.vulnerable) for group, one in zip(groups, unused, strict=True)]
            )
            # An interval narrows with the root of the number of drives.
            worth = np.maximum(self._estimates.widths, _NARROW) / (drives + 1.0)
            cell = int(np.argmax(worth / np.where(free, 1.0, cost)))
            level = int(rng.integers(1, LEVELS, endpoint=True))
            if rng.random() >= config.explore:
                chances = self._estimates.gains[cell] ** 2
                level = 1 + int(rng.choice(LEVELS, p=chances / chances.sum()))
            if groups[cell] < 0:
                plan.add_error(cell, level)
                drives[cell] += 1.0
                continue
            if layout.is_grossest(layout.cells[cell]):
                level = min(level, LEVELS - 1)  # the last level is that of the screening
            if unused[cell].immune and rng.random() < config.audit:
                plan.add_error(cell, level, unused[cell].immune.pop(), audit=True)
            elif free[cell]:
                plan.add_error(cell, level, unused[cell].vulnerable.pop())
                drives[cell] += 1.0
            else:
                plan.add_screening(groups[cell])
                drives[cell] += self._vulnerable(groups[cell])


class _Estimates(NamedTuple):
    """What is known of the tolerated severities.

    Attributes:
        widths: Widths of the intervals, shape ``(cells,)``.
        gains: By how much a drive at each level is expected to reduce the variance, shape ``(cells, LEVELS)``.
    """

    widths: FloatArray
    gains: FloatArray


class _Unused:
    """The screened drives that a cell has not used yet.

    Attributes:
        vulnerable: Vulnerable ones, the latest first.
        immune: Those that hold with the grossest error, the latest first.
    """

    def __init__(self, state: ToleranceState, layout: Layout, known: Tally, cell: int) -> None:
        group, jobs = layout.cells[cell].group, state.jobs
        self.vulnerable: list[int] = []
        self.immune: list[int] = []
        if group is not None:
            mine = jobs[(jobs[:, 0] >= Purpose.ERROR) & (jobs[:, 1] == cell)]
            used = set(mine[:, 2].tolist())
            self.vulnerable = [drive for drive, _ in known.vulnerable[group] if drive not in used][::-1]
            self.immune = [drive for drive, _ in known.immune[group] if drive not in used][::-1]

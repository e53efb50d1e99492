"""`tolerance@1`: how gross an error may be before a given share of drives is violated because of it.

The search space has a parameter for the *severity* of an error, and others, such as its type and target, whose
choices are the *cells*. In each cell and under each *condition* the search estimates a curve, the share of violations
that the error causes, and the severity at which it reaches a limit (`brink.search.curves`).

All cells share one list of drives: drive number i has the same scenario, onset and episode seed in all of them, apart
from what a cell or condition prescribes. Within a cell every drive is simulated once, at one severity: another drive
tells more about the share than the same drive at another severity. The first drives are simulated without any error
as well, and so is every later drive that violates with one: only a violation that goes away with the error was caused
by it.

Simulations go to the cells whose intervals they are expected to narrow most, and there to the severities at which the
limit may be reached.

Source: ours; see docs/explanation/tolerance.md.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from brink.search.algorithm import Evaluation
from brink.search.algorithms.ledger import BoundaryConfig, Ledger, LedgerAlgorithm, LedgerState
from brink.search.archive import Archive
from brink.search.curves import LEVELS, Counts, library, quantiles_of_sorted, reached, weights
from brink.search.document import Document
from brink.search.errors import ConfigError, DocumentError, SpaceError, UnsupportedSpace
from brink.search.parameters import Categorical, Value, did_you_mean
from brink.search.settings import setting
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace
from brink.search.streams import Stream, generator

FIRST_LEVELS: Final = (8, 16, 24, 32)
"""Levels of severity at which every cell is simulated first."""
FIRST_DRIVES: Final = 2
"""Drives at each of these levels."""
MOST_CELLS: Final = 2_000
_CURVES: Final = 20_000
"""Curves of the library that the search makes do with."""
_BEYOND: Final = 1.1
"""Stands for a severity beyond the scale in the width of an interval, so that "never" is told from "at its end"."""
_NARROW: Final = 1e-3
"""Width of an interval below which a narrower one is no better."""
# What is drawn, as the first index of the stream; the library has 1.
_CHOICE, _DRIVE = 0, 2

Choices = Mapping[int, tuple[float, ...]]
"""The values that some columns of a row may have."""


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
        60, help="Drives without an error that each condition begins with.", ge=1, le=100_000
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
        conditions: Names of the conditions, in their order.
    """

    def __init__(self, space: SearchSpace, config: ToleranceConfig) -> None:
        self._space = space
        self._config = config
        columns = space.column_names()
        self._parameters = [p for component in space.components for p in component.parameters]
        self._columns = columns
        self.severity = self._column("severity", config.severity)
        severity = self._parameters[self.severity]
        if isinstance(severity, Categorical) or (severity.low, severity.high) != (0.0, 1.0):
            raise ConfigError("severity", f"expected a number from 0 to 1, got {columns[self.severity]}")
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
        self.cells, self.populations = self._populated(limits, [choices for _, choices in chosen.values()])
        if len(self.cells) > MOST_CELLS:
            raise ConfigError("cells", f"expected at most {MOST_CELLS} cells, got {len(self.cells)}")
        self._codes_of_cells = [
            (self._cell_codes(cell), self.conditions.index(cell.condition)) for cell in self.cells
        ]
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

    def _cell_codes(self, cell: Cell) -> tuple[float, ...]:
        return tuple(
            self._value("cells", name, choice) for name, choice in zip(self.names, cell.choices, strict=True)
        )

    def row(self, seed: int, population: int, drive: int, cell: Cell | None, level: int) -> FloatArray:
        """Return a drive as a row of the space.

        Args:
            seed: Seed of the search.
            population: The population that it belongs to.
            drive: Number of the drive.
            cell: The cell; None without an error.
            level: Level of severity.
        """
        shares = generator(seed, Stream.TOLERANCE, _DRIVE, drive).random(self._space.dimension)
        row = np.empty(self._space.dimension)
        for column, parameter in enumerate(self._parameters):
            codes = self.populations[population].get(column)
            if codes is not None:
                row[column] = codes[int(shares[column] * len(codes))]
            elif isinstance(parameter, Categorical):
                row[column] = int(shares[column] * len(parameter.choices))
            else:
                row[column] = parameter.rounded(
                    parameter.low + shares[column] * (parameter.high - parameter.low)
                )
        for column, value in self._fixed.items():
            row[column] = value
        row[self.severity] = level / LEVELS
        if cell is None:
            for column, value in self._truth.items():
                row[column] = value
        else:
            row[list(self._cell_columns)] = self._cell_codes(cell)
        repaired = self._space.repair(self._space.split(row), np.random.Generator(np.random.PCG64(0)))
        return self._space.join(repaired)

    def population_of(self, number: int) -> int | None:
        """Return the population that a first drive without an error belongs to; None for any other candidate."""
        population = number // self._config.without_error
        return population if population < len(self.populations) else None

    def condition_of(self, values: Mapping[str, Value]) -> str | None:
        """Return the condition of a drive in any space with the same parameters; None if it has none.

        Args:
            values: Decoded values by component.parameter.
        """
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
        found = np.full(len(rows), -1, np.int64)
        is_true = np.ones(len(rows), np.bool_)
        for column, value in self._truth.items():
            is_true &= rows[:, column] == value
        for place, (codes, condition) in enumerate(self._codes_of_cells):
            is_here = ~is_true
            for column, code in zip(self._cell_columns, codes, strict=True):
                is_here &= rows[:, column] == code
            for column, allowed in self._limits[condition].items():
                is_here &= np.isin(rows[:, column], allowed)
            found[is_here] = place
        return found

    def levels_of(self, rows: FloatArray) -> IntArray:
        """Return the level of severity of each row, shape ``(n,)``."""
        return np.rint(rows[:, self.severity] * LEVELS).astype(np.int64)

    def drive_key(self, row: FloatArray, seed: int) -> tuple[int, bytes]:
        """Return what a drive with an error and the same drive without it have in common."""
        return seed, np.delete(row, self._component).tobytes()


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
        counts: Drives with an error and violations caused by it, by cell and level.
        violations: All violations of drives with an error by cell, caused or not, shape ``(cells,)``.
        baseline: Of the first drives of each population, those that violate without an error, and all.
        open_numbers: Numbers of the violations of which it is not known yet whether the error caused them.
        caused: Cell, level and number of the violations that the error is known to have caused, by severity.
    """

    counts: Counts
    violations: IntArray
    baseline: tuple[tuple[int, int], ...]
    open_numbers: tuple[int, ...]
    caused: tuple[tuple[int, int, int], ...]


def tally(
    layout: Layout, rows: FloatArray, numbers: Sequence[int], unsafe: BoolArray, seeds: Sequence[int]
) -> Tally:
    """Count the drives of a search.

    Violations of which it is not known yet whether the error caused them count as drives and as caused.

    Args:
        layout: The cells.
        rows: Simulated solutions, shape ``(n, d)``.
        numbers: Their numbers.
        unsafe: Their verdicts, shape ``(n,)``.
        seeds: For each, its episode seed or anything else that is the same exactly for the same seed.
    """
    counts = Counts.empty(len(layout.cells))
    violations = np.zeros(len(layout.cells), np.int64)
    baseline = [(0, 0) for _ in layout.populations]
    cells, levels = layout.cells_of(rows), layout.levels_of(rows)
    without: dict[tuple[int, bytes], bool] = {}
    for place in np.flatnonzero(cells < 0).tolist():
        population = layout.population_of(numbers[place])
        if population is not None:
            violating, drives = baseline[population]
            baseline[population] = violating + int(unsafe[place]), drives + 1
        without[layout.drive_key(rows[place], seeds[place])] = bool(unsafe[place])
    has_error = cells >= 0
    np.add.at(counts.drives, (cells[has_error], levels[has_error] - 1), 1)
    open_numbers: list[int] = []
    caused: list[tuple[int, int, int]] = []
    for place in np.flatnonzero(has_error & unsafe).tolist():
        cell = int(cells[place])
        violations[cell] += 1
        truth = without.get(layout.drive_key(rows[place], seeds[place]))
        if truth is None:
            open_numbers.append(numbers[place])
        elif not truth:
            caused.append((cell, int(levels[place]), numbers[place]))
        if not truth:
            counts.caused[cell, levels[place] - 1] += 1
    return Tally(
        counts=counts,
        violations=violations,
        baseline=tuple(baseline),
        open_numbers=tuple(open_numbers),
        caused=tuple(sorted(caused, key=lambda one: (one[1], one[2]))),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToleranceState(LedgerState):
    """State of the search.

    Attributes:
        config: Settings.
        planned: Drives of each cell that were planned so far, failed ones included, shape ``(cells,)``.
        roots: Number of the candidate whose episode seed a drive has, by the number of the drive.
        drives: The drive of each candidate, by its number.
    """

    config: ToleranceConfig
    planned: IntArray
    roots: tuple[int, ...]
    drives: tuple[int, ...]


class Tolerance(LedgerAlgorithm[ToleranceConfig, ToleranceState]):
    """The search for tolerances."""

    id = "tolerance@1"
    summary = (
        "Tolerances: how gross an error may be before a given share of drives is violated because of it."
    )
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
        first = {"adaptive": len(FIRST_LEVELS) * FIRST_DRIVES, "uniform": config.levels, "random": 1}[
            config.design
        ]
        return len(layout.populations) * config.without_error + len(layout.cells) * first

    def _first_state(self, ledger: Ledger, config: ToleranceConfig) -> ToleranceState:
        layout = Layout(ledger.space, config)
        state = ToleranceState(
            config=config, ledger=ledger, planned=np.zeros(len(layout.cells), np.int64), roots=(), drives=()
        )
        return _planned(state, layout)

    def tell(self, state: ToleranceState, evaluations: Mapping[int, Evaluation]) -> ToleranceState:
        """Return the state after the pending generation was evaluated."""
        state = replace(state, ledger=state.ledger.tell(evaluations))
        return _planned(state, Layout(state.ledger.space, state.config))

    def _refilled(self, state: ToleranceState) -> ToleranceState:
        return _planned(state, Layout(state.ledger.space, state.config))

    def _content(self, state: ToleranceState) -> tuple[dict[str, Any], dict[str, Any]]:
        return {}, {
            "planned": state.planned,
            "roots": np.array(state.roots, np.int64),
            "drives": np.array(state.drives, np.int64),
        }

    def _restored(self, ledger: Ledger, config: ToleranceConfig, document: Document) -> ToleranceState:
        found = {}
        for name in ("planned", "roots", "drives"):
            array = document.arrays.get(name)
            if array is None or array.ndim != 1 or array.dtype != np.int64:
                raise DocumentError(f"{name}: expected whole numbers, got {array!r:.80}")
            found[name] = array
        return ToleranceState(
            config=config,
            ledger=ledger,
            planned=found["planned"],
            roots=tuple(found["roots"].tolist()),
            drives=tuple(found["drives"].tolist()),
        )


class _Plan:
    """A generation that is being planned."""

    def __init__(self, state: ToleranceState, layout: Layout, room: int) -> None:
        self._layout = layout
        self._seed = state.ledger.seed
        self._next = len(state.drives)
        self.room = room
        self.planned = state.planned.copy()
        self.roots = list(state.roots)
        self.drives = list(state.drives)
        self.rows: list[FloatArray] = []
        self.seeds: list[int | None] = []

    def add(self, population: int, drive: int, cell: int | None, level: int) -> None:
        """Plan a drive; its number is the next one."""
        known = drive < len(self.roots)
        if not known:
            self.roots.append(self._next)
        found = None if cell is None else self._layout.cells[cell]
        self.rows.append(self._layout.row(self._seed, population, drive, found, level))
        self.seeds.append(self.roots[drive] if known else None)
        self.drives.append(drive)
        self._next += 1
        self.room -= 1

    def add_to(self, cell: int, level: int) -> None:
        """Plan the next drive of a cell."""
        drive = int(self.planned[cell])
        self.planned[cell] += 1
        # A cell that is ahead of all others uses new drives one by one, so a drive is never skipped.
        self.add(self._layout.cells[cell].population, drive, cell, level)


def _planned(state: ToleranceState, layout: Layout) -> ToleranceState:
    """Return the state with the next generation queued, as budget, room in flight and results allow."""
    ledger, config = state.ledger, state.config
    if ledger.queue:
        return state
    room = int(min(config.generation_size, ledger.left)) if len(ledger.flight) < config.in_flight else 0
    if room <= 0:
        return state
    plan = _Plan(state, layout, room)
    begun = len(state.drives)
    first = len(layout.populations) * config.without_error
    for number in range(begun, min(first, begun + room)):
        plan.add(number // config.without_error, number % config.without_error, None, 0)
    if plan.room and begun + len(plan.rows) >= first:
        results = _Results(state, layout)
        results.plan_truth(plan)
        if config.design == "uniform":
            _plan_uniform(plan, config)
        elif config.design == "random":
            _plan_random(plan, generator(ledger.seed, Stream.TOLERANCE, _CHOICE, ledger.planned_generation))
        elif not results.is_done():
            _plan_first(plan)
            results.plan_adaptively(plan)
        elif not plan.rows and not ledger.flight:
            return state
    return replace(
        state,
        ledger=ledger.plan(plan.rows, seed_numbers=plan.seeds),
        planned=plan.planned,
        roots=tuple(plan.roots),
        drives=tuple(plan.drives),
    )


def _plan_uniform(plan: _Plan, config: ToleranceConfig) -> None:
    """Plan equally many drives at equally spaced severities in every cell."""
    step = LEVELS // config.levels
    while plan.room:
        cell = int(np.argmin(plan.planned))
        plan.add_to(cell, step * (1 + int(plan.planned[cell]) % config.levels))


def _plan_random(plan: _Plan, rng: np.random.Generator) -> None:
    """Plan equally many drives at random severities in every cell."""
    while plan.room:
        plan.add_to(int(np.argmin(plan.planned)), int(rng.integers(1, LEVELS, endpoint=True)))


def _plan_first(plan: _Plan) -> None:
    """Plan the first drives of every cell."""
    most = len(FIRST_LEVELS) * FIRST_DRIVES
    while plan.room and (cell := int(np.argmin(plan.planned))) is not None and plan.planned[cell] < most:
        plan.add_to(cell, FIRST_LEVELS[int(plan.planned[cell]) % len(FIRST_LEVELS)])


class _Results:
    """What a search knows when it plans a generation."""

    def __init__(self, state: ToleranceState, layout: Layout) -> None:
        self._state = state
        self._layout = layout
        archive = state.ledger.archive
        self._tally = tally(
            layout, archive.vectors, archive.numbers.tolist(), archive.unsafe, _drives_of(state, archive)
        )

    def plan_truth(self, plan: _Plan) -> None:
        """Plan the drives without an error that tell whether it caused a violation."""
        state, layout, space = self._state, self._layout, self._state.ledger.space
        flying = [c for generation in state.ledger.flight for c in generation]
        rows = np.reshape([space.join(c.vectors) for c in flying], (len(flying), space.dimension))
        without = np.flatnonzero(layout.cells_of(rows) < 0).tolist()
        known = {layout.drive_key(rows[place], state.drives[flying[place].number]) for place in without}
        archive = state.ledger.archive
        places = {number: place for place, number in enumerate(archive.numbers.tolist())}
        cells = layout.cells_of(archive.vectors)
        for number in self._tally.open_numbers:
            if not plan.room:
                return
            place, drive = places[number], state.drives[number]
            key = layout.drive_key(archive.vectors[place], drive)
            if key not in known:
                known.add(key)
                plan.add(layout.cells[cells[place]].population, drive, None, 0)
        # What is left must suffice to tell the cause of the violations that are still to come.
        drives = int(self._tally.counts.drives.sum())
        share = (int(self._tally.violations.sum()) + 1) / (drives + 10)
        coming = len(flying) - len(without) + plan.room
        spare = state.ledger.left - len(plan.rows) - math.ceil(share * coming)
        if flying or plan.rows:
            plan.room = min(plan.room, max(int(spare), 0))

    def is_done(self) -> bool:
        """Return whether all intervals are as narrow as wanted."""
        wanted = self._state.config.width
        if not wanted or self._tally.counts.drives.sum(axis=1).min() == 0:
            return False
        return bool((self._widths < wanted).all())

    @cached_property
    def _severity(self) -> FloatArray:
        """The severity at which each curve of the library reaches the limit, `_BEYOND` where it never does."""
        return np.minimum(reached(_CURVES, self._state.config.limit), _BEYOND)

    @cached_property
    def _likely(self) -> FloatArray:
        """The posterior probability of each curve of the library, shape ``(cells, _CURVES)``."""
        return weights(self._tally.counts, library(_CURVES))

    @cached_property
    def _widths(self) -> FloatArray:
        """The widths of the intervals of the tolerated severities, shape ``(cells,)``."""
        tail = 0.5 * (1.0 - self._state.config.confidence)
        order = np.argsort(self._severity, kind="stable")
        ends = [
            quantiles_of_sorted(self._severity[order], likely[order], (tail, 1.0 - tail))
            for likely in self._likely
        ]
        return np.array([high - low for low, high in ends])

    def plan_adaptively(self, plan: _Plan) -> None:
        """Plan drives where the intervals of tolerated severities are wide, at severities that these may have."""
        if not plan.room:
            return
        state = self._state
        level = np.clip(np.rint(self._severity * LEVELS), 1, LEVELS).astype(np.int64)
        rng = generator(state.ledger.seed, Stream.TOLERANCE, _CHOICE, state.ledger.planned_generation)
        while plan.room:
            # Drives narrow an interval with the root of their number, so this many more of them narrow it most.
            cell = int(np.argmax(np.maximum(self._widths, _NARROW) / (plan.planned + 1.0)))
            if rng.random() < state.config.explore:
                plan.add_to(cell, int(rng.integers(1, LEVELS, endpoint=True)))
                continue
            chances = np.bincount(level, weights=self._likely[cell], minlength=LEVELS + 1)
            plan.add_to(cell, int(rng.choice(LEVELS + 1, p=chances / chances.sum())))


def _drives_of(state: ToleranceState, archive: Archive) -> list[int]:
    return [state.drives[number] for number in archive.numbers.tolist()]

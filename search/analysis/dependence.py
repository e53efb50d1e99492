"""How verdicts, and the axes of a map, depend on individual parameters.

A search does not sample evenly: the unsafe share by parameter value shows where unsafe solutions were found, not how
likely they are. The shares have no intervals and no test of significance, which would need independent solutions: a
search breeds its solutions from each other, and relatives share both values and verdicts. What a test would call
significant where no parameter has an effect: `python -m benchmarks coverage --only dependence` (ADR 66).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from brink.search.archive import Archive
from brink.search.parameters import parameter_title
from brink.search.space import (
    BoolArray,
    Categorical,
    Component,
    Dormant,
    FloatArray,
    IntArray,
    Integer,
    Parameter,
    SearchSpace,
)

FEWEST_IN_BIN: Final = 15
MAX_BINS: Final = 8
FEW_INTEGERS: Final = 9
"""Integers with at most this many values are shown value by value."""
LEAST_EXPLAINED: Final = 0.25
"""Smallest share of the variance along an axis that the named parameter must explain."""
LEAST_ACTIVE: Final = 0.8
"""Smallest share of solutions in which a number must be active to explain an axis."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterColumn:
    """The values of one parameter in an archive.

    Attributes:
        component: Name of its component.
        parameter: The parameter.
        values: Stored values, numbers or indices of choices, shape ``(n,)``.
        active: Where the value was active in the episode, shape ``(n,)``; numbers of a dormant block are stored as 0.
    """

    component: str
    parameter: Parameter
    values: FloatArray
    active: BoolArray

    @property
    def name(self) -> str:
        """``component.parameter``."""
        return f"{self.component}.{self.parameter.name}"

    @property
    def title(self) -> str:
        """The display name."""
        return parameter_title(self.component, self.parameter)


def parameter_columns(
    space: SearchSpace, vectors: FloatArray, recorded: BoolArray | None = None
) -> list[ParameterColumn]:
    """Return the columns of all parameters, in the order of the genome.

    Values are those that were chosen, not those that a drive cut off: how long a drive lasts is part of its outcome.

    Args:
        space: The search space.
        vectors: Complete solutions as rows, shape ``(n, d)``.
        recorded: Which entries were active in their episodes, shape ``(n, d)``; without it, all but those of dormant
            blocks.
    """
    columns: list[ParameterColumn] = []
    for component, part in zip(space.components, space.slices, strict=True):
        rows = vectors[:, part]
        active = _active(component, rows)
        if recorded is not None:
            active &= recorded[:, part]
        columns += [
            ParameterColumn(
                component=component.name,
                parameter=parameter,
                values=rows[:, index]
                if isinstance(parameter, Categorical)
                else parameter.shown(rows[:, index]),
                active=active[:, index],
            )
            for index, parameter in enumerate(component.parameters)
        ]
    return columns


def _active(component: Component, rows: FloatArray) -> BoolArray:
    """Return which entries of a component's rows are active, shape ``(n, d)``."""
    absent = [parameter.absent if parameter.when else np.nan for parameter in component.parameters]
    active: BoolArray = rows != absent
    place = {parameter.name: index for index, parameter in enumerate(component.parameters)}
    for block in component.constraints:
        if not isinstance(block, Dormant):
            continue
        label = component.by_name[block.label]
        if isinstance(label, Categorical):
            dormant = rows[:, place[block.label]] == label.choices.index(block.null_choice)
            for member in block.members:
                active[dormant, place[member]] = False
    return active


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dependence:
    """The unsafe share by the values of one parameter, and how strong the dependence is.

    Attributes:
        column: The parameter.
        places: Position of each of g groups on the axis: index of the choice or value, or median of the bin.
        labels: Names of the groups; empty for a numeric scale.
        counts: Solutions in each group, shape ``(g,)``.
        unsafe: Unsafe solutions in each group, shape ``(g,)``.
        strength: Cramér's V between group and verdict, in [0, 1]; 0 with a single group or verdict.
    """

    column: ParameterColumn
    places: FloatArray
    labels: tuple[str, ...]
    counts: IntArray
    unsafe: IntArray
    strength: float


def dependences(space: SearchSpace, archive: Archive, recorded: BoolArray | None = None) -> list[Dependence]:
    """Return the dependence of the verdict on each parameter where it is active, strongest first.

    Args:
        space: The search space.
        archive: The evaluated solutions.
        recorded: Which parameters were active in each episode, as in `parameter_columns`.
    """
    columns = parameter_columns(space, archive.vectors, recorded)
    by_column = [_dependence(column, archive.unsafe) for column in columns]
    return sorted(by_column, key=lambda dependence: -dependence.strength)


def _dependence(column: ParameterColumn, verdicts: BoolArray) -> Dependence:
    values, unsafe = column.values[column.active], verdicts[column.active]
    places, labels, group = _grouped(column, values)
    counts = np.bincount(group, minlength=places.size).astype(np.int64)
    bad = np.bincount(group[unsafe], minlength=places.size).astype(np.int64)
    return Dependence(
        column=column,
        places=places,
        labels=labels,
        counts=counts,
        unsafe=bad,
        strength=_strength(counts, bad),
    )


def _grouped(
    column: ParameterColumn, values: FloatArray
) -> tuple[FloatArray, tuple[str, ...], NDArray[np.intp]]:
    """Return positions and labels of the groups, and the group of each value."""
    parameter = column.parameter
    if isinstance(parameter, Categorical):
        codes = np.array(parameter.codes, dtype=np.float64)
        labels = tuple(parameter.choices[code].replace("_", " ") for code in parameter.codes)
        return codes, labels, np.searchsorted(codes, values)
    if isinstance(parameter, Integer) and parameter.most - parameter.least < FEW_INTEGERS:
        step = int(parameter.spacing)
        whole = np.arange(parameter.least, parameter.most + 1, step)
        return (
            whole.astype(np.float64),
            tuple(map(str, whole.tolist())),
            ((values - parameter.least) / step).astype(np.intp),
        )
    if values.size == 0:
        return np.empty(0), (), np.empty(0, np.intp)
    bins = int(np.clip(values.size // FEWEST_IN_BIN, 1, MAX_BINS))
    edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1)))
    group = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(edges.size - 2, 0))
    filled, group = np.unique(group, return_inverse=True)
    places = np.array([np.median(values[group == index]) for index in range(filled.size)])
    return places, (), group.reshape(-1)


def _strength(counts: IntArray, unsafe: IntArray) -> float:
    """Return Cramér's V between group and verdict."""
    filled = counts > 0
    table = np.stack([unsafe[filled], (counts - unsafe)[filled]]).astype(np.float64)
    if table.shape[1] < 2 or (table.sum(axis=1) == 0).any():
        return 0.0
    expected = table.sum(axis=1, keepdims=True) * table.sum(axis=0) / table.sum()
    return float(np.sqrt(((table - expected) ** 2 / expected).sum() / table.sum()))


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisMeaning:
    """The parameter that explains most of an axis of a map.

    Attributes:
        title: Title of the parameter.
        explained: Share of the variance along the axis, in (0, 1].
    """

    title: str
    explained: float

    @property
    def text(self) -> str:
        """The meaning in words, such as ``mostly scenario: weather (explains 81% of this axis)``."""
        how = "mostly" if self.explained >= 0.5 else "partly"
        return f"{how} {self.title} (explains {self.explained:.0%} of this axis)"


def axis_meanings(
    space: SearchSpace, vectors: FloatArray, points: FloatArray
) -> tuple[AxisMeaning | None, AxisMeaning | None]:
    """Return, for each axis of a map, the parameter that explains most of it; None if none explains a quarter.

    The explained share is the correlation ratio for a category, and the squared correlation for a number.

    Args:
        space: The search space.
        vectors: Complete solutions as rows, shape ``(n, d)``.
        points: Their points on the map, shape ``(n, 2)``.
    """
    columns = parameter_columns(space, vectors)
    meanings: list[AxisMeaning | None] = []
    for axis in (0, 1):
        scored = [AxisMeaning(title=c.title, explained=_explained(c, points[:, axis])) for c in columns]
        best = max(scored, key=lambda meaning: meaning.explained, default=None)
        meanings.append(best if best is not None and best.explained >= LEAST_EXPLAINED else None)
    return meanings[0], meanings[1]


def _explained(column: ParameterColumn, place: FloatArray) -> float:
    if column.active.mean() < LEAST_ACTIVE or not column.active.any():
        return 0.0
    values, place = column.values[column.active], place[column.active]
    total = float(((place - place.mean()) ** 2).sum())
    if total <= 0 or np.ptp(values) == 0:
        return 0.0
    if isinstance(column.parameter, Categorical):
        means = np.zeros(len(place))
        for value in np.unique(values):
            means[values == value] = place[values == value].mean()
        return min(1.0, float(((means - place.mean()) ** 2).sum()) / total)
    return float(np.corrcoef(values, place)[0, 1] ** 2)

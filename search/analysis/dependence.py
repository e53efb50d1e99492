"""How the verdict depends on each parameter: the unsafe share over its values, and whether that is more than chance.

A search does not sample evenly: this shows where unsafe solutions were found, not how likely they are.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy  # its statistics take half a second to load: at the first use
from numpy.typing import NDArray

from brink.search.analysis.parameters import ParameterColumn, parameter_columns
from brink.search.archive import Archive
from brink.search.component import BoolArray, FloatArray
from brink.search.fitness import IntArray
from brink.search.space import Categorical, Integer, SearchSpace

FEWEST_IN_BIN: Final = 15
MOST_BINS: Final = 8
FEW_INTEGERS: Final = 9
"""Integers with at most this many values are shown value by value."""
DETECTABLE: Final = 0.05
"""Probability, over all parameters together, that one without effect stands out."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dependence:
    """The unsafe share over the values of one parameter.

    Attributes:
        column: The parameter.
        places: Where each group lies on the axis: index of the choice or value, or the median of the bin.
        labels: Names of the groups; empty if the axis is a scale.
        counts: Solutions in each group.
        unsafe: Unsafe ones among them.
        strength: Cramér's V between group and verdict, in [0, 1].
        p_value: Of the chi-squared test that the verdict does not depend on the group; 1 if there is one group.
    """

    column: ParameterColumn
    places: FloatArray
    labels: tuple[str, ...]
    counts: IntArray
    unsafe: IntArray
    strength: float
    p_value: float

    def detectable(self, parameters: int) -> bool:
        """Return whether it stands out among so many parameters by more than chance."""
        return self.p_value < DETECTABLE / parameters


def dependences(space: SearchSpace, archive: Archive) -> list[Dependence]:
    """Return how the verdict depends on each parameter, strongest first, those without two groups last."""
    found = [_dependence(column, archive.unsafe) for column in parameter_columns(space, archive.vectors)]
    return sorted(found, key=lambda dependence: -dependence.strength)


def _dependence(column: ParameterColumn, verdicts: BoolArray) -> Dependence:
    values, unsafe = column.values[column.awake], verdicts[column.awake]
    places, labels, group = _grouped(column, values)
    counts = np.bincount(group, minlength=places.size).astype(np.int64)
    bad = np.bincount(group[unsafe], minlength=places.size).astype(np.int64)
    strength, p_value = _association(counts, bad)
    return Dependence(
        column=column,
        places=places,
        labels=labels,
        counts=counts,
        unsafe=bad,
        strength=strength,
        p_value=p_value,
    )


def _grouped(
    column: ParameterColumn, values: FloatArray
) -> tuple[FloatArray, tuple[str, ...], NDArray[np.intp]]:
    """Return the groups' places and labels, and each value's group."""
    parameter = column.parameter
    if isinstance(parameter, Categorical):
        labels = tuple(choice.replace("_", " ") for choice in parameter.choices)
        return np.arange(len(labels), dtype=np.float64), labels, values.astype(np.intp)
    if isinstance(parameter, Integer) and parameter.range < FEW_INTEGERS:
        whole = np.arange(parameter.low, parameter.high + 1)
        return (
            whole.astype(np.float64),
            tuple(map(str, whole.tolist())),
            (values - parameter.low).astype(np.intp),
        )
    if values.size == 0:
        return np.empty(0), (), np.empty(0, np.intp)
    bins = int(np.clip(values.size // FEWEST_IN_BIN, 1, MOST_BINS))
    edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1)))
    group = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(edges.size - 2, 0))
    kept, group = np.unique(group, return_inverse=True)
    places = np.array([np.median(values[group == index]) for index in range(kept.size)])
    return places, (), group.reshape(-1)


def _association(counts: IntArray, unsafe: IntArray) -> tuple[float, float]:
    """Return Cramér's V and the p-value of groups by verdict; (0, 1) if either has one value only."""
    filled = counts > 0
    table = np.stack([unsafe[filled], (counts - unsafe)[filled]])
    if table.shape[1] < 2 or (table.sum(axis=1) == 0).any():
        return 0.0, 1.0
    result = scipy.stats.chi2_contingency(table, correction=False)
    return float(np.sqrt(result.statistic / table.sum())), float(result.pvalue)

"""What the axes of a map mean: the parameter that best explains where solutions lie along each of them."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from brink.search.analysis.parameters import ParameterColumn, parameter_columns
from brink.search.component import FloatArray
from brink.search.space import Categorical, SearchSpace

TELLING: Final = 0.25
"""Least share of the variance along an axis that a parameter must explain to be named."""
FEWEST_AWAKE: Final = 0.8
"""Least share of solutions in which a number must be awake to explain an axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisMeaning:
    """The parameter behind an axis.

    Attributes:
        name: ``component.parameter``.
        explained: Share of the variance along the axis, in (0, 1].
    """

    name: str
    explained: float

    @property
    def text(self) -> str:
        """In words, such as ``mostly scenario.weather (explains 81% of this axis)``."""
        how = "mostly" if self.explained >= 0.5 else "partly"
        return f"{how} {self.name} (explains {self.explained:.0%} of this axis)"


def axis_meanings(
    space: SearchSpace, vectors: FloatArray, points: FloatArray
) -> tuple[AxisMeaning | None, AxisMeaning | None]:
    """Return for each axis of a map the parameter that explains most of it, or None if none explains a quarter.

    A category explains the variance between its groups (correlation ratio), a number the squared correlation.

    Args:
        space: Where the solutions come from.
        vectors: Complete solutions as rows, shape ``(n, d)``.
        points: The map, shape ``(n, 2)``.
    """
    columns = parameter_columns(space, vectors)
    found: list[AxisMeaning | None] = []
    for axis in (0, 1):
        scored = [AxisMeaning(name=c.name, explained=_explained(c, points[:, axis])) for c in columns]
        best = max(scored, key=lambda meaning: meaning.explained, default=None)
        found.append(best if best is not None and best.explained >= TELLING else None)
    return found[0], found[1]


def _explained(column: ParameterColumn, place: FloatArray) -> float:
    if column.awake.mean() < FEWEST_AWAKE or not column.awake.any():
        return 0.0
    values, place = column.values[column.awake], place[column.awake]
    total = float(((place - place.mean()) ** 2).sum())
    if total <= 0 or np.ptp(values) == 0:
        return 0.0
    if isinstance(column.parameter, Categorical):
        means = np.zeros(len(place))
        for value in np.unique(values):
            means[values == value] = place[values == value].mean()
        return min(1.0, float(((means - place.mean()) ** 2).sum()) / total)
    return float(np.corrcoef(values, place)[0, 1] ** 2)

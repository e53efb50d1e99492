"""The values of each parameter over an archive, and in which solutions they mean anything."""

from dataclasses import dataclass

import numpy as np

from brink.search.component import BoolArray, FloatArray
from brink.search.space import Categorical, Component, Dormant, Parameter, SearchSpace


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterColumn:
    """One parameter over an archive.

    Attributes:
        component: Name of its component.
        parameter: The parameter.
        values: Stored values, shape ``(n,)``: numbers, or indices of choices.
        awake: Where the value means something, shape ``(n,)``; the numbers of a sleeping block are stored as 0.
    """

    component: str
    parameter: Parameter
    values: FloatArray
    awake: BoolArray

    @property
    def name(self) -> str:
        """``component.parameter``."""
        return f"{self.component}.{self.parameter.name}"


def parameter_columns(space: SearchSpace, vectors: FloatArray) -> list[ParameterColumn]:
    """Return all parameters in the order of the genome.

    Args:
        space: Where the solutions come from.
        vectors: Complete solutions as rows, shape ``(n, d)``.
    """
    columns: list[ParameterColumn] = []
    for component, part in zip(space.components, space.slices, strict=True):
        rows = vectors[:, part]
        awake = _awake(component, rows)
        columns += [
            ParameterColumn(
                component=component.name, parameter=parameter, values=rows[:, index], awake=awake[:, index]
            )
            for index, parameter in enumerate(component.parameters)
        ]
    return columns


def _awake(component: Component, rows: FloatArray) -> BoolArray:
    """Return which entries of a component's rows are awake, shape ``(n, d)``."""
    awake = np.ones(rows.shape, dtype=np.bool_)
    place = {parameter.name: index for index, parameter in enumerate(component.parameters)}
    for block in component.constraints:
        if not isinstance(block, Dormant):
            continue
        label = component.by_name[block.label]
        if isinstance(label, Categorical):
            asleep = rows[:, place[block.label]] == label.choices.index(block.null_choice)
            for member in block.members:
                awake[asleep, place[member]] = False
    return awake

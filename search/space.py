"""The search space: named components whose vectors together make a complete solution.

A complete solution is a tuple of vectors, one a component, or the same numbers in one row; `SearchSpace.join` and
`SearchSpace.split` turn one into the other. Everything here is immutable.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from brink.search.component import BoolArray, Component, FloatArray, frozen_array
from brink.search.constraints import Constraint, Dormant, Duration, Extent
from brink.search.errors import SpaceError
from brink.search.parameters import Categorical, Integer, Parameter, Real, Value, nearest

__all__ = [
    "Categorical",
    "Component",
    "Constraint",
    "Dormant",
    "Duration",
    "Extent",
    "Integer",
    "Parameter",
    "Real",
    "SearchSpace",
]


@dataclass(frozen=True, slots=True)
class SearchSpace:
    """A typed genome.

    Attributes:
        components: In the order of a solution's vectors; names differ.
        dimension: Number of all parameters.
        categorical: Which parameters are categorical, shape ``(dimension,)``.
        ranges: Range of each number, 1 for a category, shape ``(dimension,)``.
        slices: Where each component lies in a row.
    """

    components: tuple[Component, ...]
    dimension: int = field(init=False, compare=False)
    categorical: BoolArray = field(init=False, repr=False, compare=False)
    ranges: FloatArray = field(init=False, repr=False, compare=False)
    slices: tuple[slice, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "components", tuple(self.components))
        names = [component.name for component in self.components]
        if not names or len(set(names)) < len(names):
            raise SpaceError(f"expected at least one component, with different names; got {names}")
        parameters = [p for component in self.components for p in component.parameters]
        ends = np.cumsum([component.dimension for component in self.components]).tolist()
        starts = [0, *ends[:-1]]
        categorical = [isinstance(p, Categorical) for p in parameters]
        ranges = [1.0 if isinstance(p, Categorical) else p.range for p in parameters]
        object.__setattr__(self, "dimension", len(parameters))
        object.__setattr__(self, "categorical", frozen_array(categorical, np.bool_))
        object.__setattr__(self, "ranges", frozen_array(ranges))
        object.__setattr__(self, "slices", tuple(slice(a, b) for a, b in zip(starts, ends, strict=True)))

    @property
    def size(self) -> float:
        """Number of different solutions before constraints; infinite as soon as one parameter is real."""
        return float(np.prod([component.size for component in self.components]))

    def column_names(self) -> tuple[str, ...]:
        """Return ``component.parameter`` for each entry of a row."""
        return tuple(f"{c.name}.{p.name}" for c in self.components for p in c.parameters)

    def index(self, component: str) -> int:
        """Return the position of a component.

        Raises:
            SpaceError: There is no such component.
        """
        names = [part.name for part in self.components]
        if component not in names:
            raise SpaceError(f"{component}: unknown component{nearest(component, names)}")
        return names.index(component)

    def sample(self, rng: np.random.Generator) -> tuple[FloatArray, ...]:
        """Return a random complete solution that complies with all constraints."""
        return tuple(component.sample(rng) for component in self.components)

    def sample_component(self, index: int, rng: np.random.Generator) -> FloatArray:
        """Return a random vector of one component that complies with its constraints."""
        return self.components[index].sample(rng)

    def repair(self, vectors: Sequence[FloatArray], rng: np.random.Generator) -> tuple[FloatArray, ...]:
        """Return the nearest complete solution that complies; the given one is not touched.

        Raises:
            SpaceError: A vector is missing or has the wrong shape.
        """
        return tuple(c.repair(v, rng) for c, v in zip(self.components, self._counted(vectors), strict=True))

    def repair_component(self, index: int, vector: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the nearest vector of one component that complies; the given one is not touched.

        Raises:
            SpaceError: The vector has the wrong shape.
        """
        return self.components[index].repair(vector, rng)

    def check(self, vectors: Sequence[FloatArray]) -> None:
        """Check a complete solution.

        Raises:
            SpaceError: It does not comply; names the first parameter that is wrong.
        """
        for component, vector in zip(self.components, self._counted(vectors), strict=True):
            for problem in component.problems(vector):
                raise SpaceError(problem)

    def _counted(self, vectors: Sequence[FloatArray]) -> Sequence[FloatArray]:
        if len(vectors) != len(self.components):
            names = ", ".join(component.name for component in self.components)
            raise SpaceError(f"expected {len(self.components)} vectors ({names}), got {len(vectors)}")
        return vectors

    def join(self, vectors: Sequence[FloatArray]) -> FloatArray:
        """Return a complete solution as one row, shape ``(dimension,)``.

        Raises:
            SpaceError: A vector is missing or has the wrong shape.
        """
        row = np.concatenate([np.asarray(v, dtype=np.float64) for v in self._counted(vectors)])
        if row.shape != (self.dimension,):
            raise SpaceError(f"expected {self.dimension} numbers, got {row.size}")
        return frozen_array(row)

    def split(self, row: FloatArray) -> tuple[FloatArray, ...]:
        """Return the vectors of a row, read-only.

        Raises:
            SpaceError: The row has the wrong shape.
        """
        if row.shape != (self.dimension,):
            raise SpaceError(f"expected a row of {self.dimension} numbers, got shape {row.shape}")
        return tuple(frozen_array(row[part]) for part in self.slices)

    def decode(self, vectors: Sequence[FloatArray]) -> dict[str, dict[str, Value]]:
        """Return the values that people read, ready for JSON: ``{component: {parameter: value}}``."""
        parts = zip(self.components, self._counted(vectors), strict=True)
        return {component.name: component.decode(vector) for component, vector in parts}

    def encode(self, values: Mapping[str, Mapping[str, object]]) -> tuple[FloatArray, ...]:
        """Return the vectors of ``{component: {parameter: value}}``.

        Raises:
            SpaceError: A value is missing, unknown, out of range, or breaks a constraint; names the parameter.
        """
        for name, content in values.items():
            self.index(name)
            if not isinstance(content, Mapping):
                raise SpaceError(f"{name}: expected its parameters by name, got {content!r}")
        missing = [component.name for component in self.components if component.name not in values]
        if missing:
            raise SpaceError(f"{missing[0]}: missing component")
        return tuple(component.encode(values[component.name]) for component in self.components)

    def describe(self) -> dict[str, Any]:
        """Return the whole space as a JSON object."""
        return {"components": [component.describe() for component in self.components]}

"""One named part of a complete solution: parameters and the constraints between them.

Two promises hold of every component: whatever comes out of `Component.repair` passes `Component.problems`, and
repair leaves a vector that passes as it is.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.search.constraints import Constraint, Dormant, Values
from brink.search.errors import SpaceError
from brink.search.parameters import Categorical, Integer, Number, Parameter, Real, Value, check_name, nearest

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]


def frozen_array(values: Any, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only array with the same entries; one that is read-only already is not copied."""
    array = np.asarray(values, dtype=dtype)
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True)
class Component:
    """A named part of the genome.

    Attributes:
        name: Unique in its space, such as ``scenario``.
        parameters: In the order of the vector; names differ.
        constraints: In the order in which repair applies them, but for dormancy, which always comes first: the
            constraints of sleeping numbers rest, those of woken ones mend the fresh draws.
        by_name: The parameters by name.
    """

    name: str
    parameters: tuple[Parameter, ...]
    constraints: tuple[Constraint | Dormant, ...] = ()
    by_name: Mapping[str, Parameter] = field(init=False, repr=False, compare=False)
    _blocks: tuple[Dormant, ...] = field(init=False, repr=False, compare=False)
    _rules: tuple[Constraint, ...] = field(init=False, repr=False, compare=False)
    _free: tuple[Number, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_name("component", self.name)
        object.__setattr__(self, "parameters", tuple(self.parameters))
        object.__setattr__(self, "constraints", tuple(self.constraints))
        names = [parameter.name for parameter in self.parameters]
        if not names:
            raise SpaceError(f"component {self.name}: expected at least one parameter")
        if len(set(names)) < len(names):
            raise SpaceError(
                f"component {self.name}: expected different parameter names, got {', '.join(names)}"
            )
        blocks = tuple(c for c in self.constraints if isinstance(c, Dormant))
        rules = tuple(c for c in self.constraints if not isinstance(c, Dormant))
        object.__setattr__(self, "by_name", {p.name: p for p in self.parameters})
        self._fit(blocks, rules)
        owned = {name for rule in rules for name in rule.names}
        free = tuple(p for p in self.parameters if isinstance(p, Real | Integer) and p.name not in owned)
        object.__setattr__(self, "_blocks", blocks)
        object.__setattr__(self, "_rules", rules)
        object.__setattr__(self, "_free", free)

    def _fit(self, blocks: tuple[Dormant, ...], rules: tuple[Constraint, ...]) -> None:
        everything: tuple[Constraint | Dormant, ...] = (*blocks, *rules)
        for constraint in everything:
            try:
                constraint.fit(self.by_name)
            except SpaceError as error:
                raise SpaceError(f"component {self.name}: {error}") from None
        for what, owners in (
            ("constraint", [name for rule in rules for name in rule.names]),
            ("dormant block", [name for block in blocks for name in block.members]),
        ):
            twice = sorted({name for name in owners if owners.count(name) > 1})
            if twice:
                raise SpaceError(f"component {self.name}: {twice[0]} belongs to more than one {what}")

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def size(self) -> float:
        """Number of different vectors before constraints; infinite as soon as one parameter is real."""
        size = 1.0
        for parameter in self.parameters:
            match parameter:
                case Real():
                    return float("inf")
                case Integer():
                    size *= parameter.high - parameter.low + 1
                case Categorical():
                    size *= len(parameter.choices)
        return size

    def sample(self, rng: np.random.Generator) -> FloatArray:
        """Return a random vector that complies: uniform draws, mended by the constraints."""
        return self.repair(np.full(self.dimension, np.nan), rng)

    def _asleep(self, values: Values) -> set[str]:
        return {
            name for block in self._blocks if block.asleep(values, self.by_name) for name in block.members
        }

    def _wake(self, values: Values, asleep: set[str], rng: np.random.Generator) -> None:
        """Give every awake number without a value a fresh one."""
        fresh = {name for name, value in values.items() if math.isnan(value) and name not in asleep}
        for block in self._blocks:
            awake = block.members[0] not in asleep
            if awake and all(values[name] == 0 for name in block.members):
                fresh.update(block.members)
        for parameter in self.parameters:
            if parameter.name in fresh:
                values[parameter.name] = parameter.draw(rng)
        for block in self._blocks:
            # All zeros would read as asleep; only blocks of few whole numbers can draw them.
            while fresh.issuperset(block.members) and all(values[name] == 0 for name in block.members):
                for name in block.members:
                    values[name] = self.by_name[name].draw(rng)

    def repair(self, vector: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the nearest vector that complies, read-only; the given one is not touched.

        In this order: labels to a choice, numbers without owner into their ranges, blocks put to sleep (0) or
        woken, then the other constraints as listed. NaN stands for "draw afresh".

        Args:
            vector: Shape ``(dimension,)``, any numbers, infinities and NaN included.
            rng: For fresh numbers; not drawn from if none is needed.

        Raises:
            SpaceError: The vector has the wrong shape.
        """
        vector = self._shaped(vector)
        values = {
            parameter.name: float(value) for parameter, value in zip(self.parameters, vector, strict=True)
        }
        for parameter in self.parameters:
            if isinstance(parameter, Categorical):
                value = values[parameter.name]
                values[parameter.name] = (
                    parameter.draw(rng) if math.isnan(value) else parameter.clipped(value)
                )
            elif isinstance(parameter, Integer):
                values[parameter.name] = parameter.rounded(values[parameter.name])
        for number in self._free:
            if not math.isnan(values[number.name]):
                values[number.name] = number.clipped(values[number.name])
        asleep = self._asleep(values)
        values.update(dict.fromkeys(asleep, 0.0))
        self._wake(values, asleep, rng)
        for rule in self._rules:
            if asleep.isdisjoint(rule.names):
                rule.repair(values, self.by_name)
        # Adding 0.0 turns -0.0 into 0.0: equal solutions must have equal bytes.
        return frozen_array(np.fromiter(values.values(), np.float64, self.dimension) + 0.0)

    def _shaped(self, vector: FloatArray) -> FloatArray:
        array = np.asarray(vector, dtype=np.float64)
        if array.shape != (self.dimension,):
            raise SpaceError(
                f"{self.name}: expected a vector of {self.dimension} numbers, got shape {array.shape}"
            )
        return array

    def problems(self, vector: FloatArray) -> Iterator[str]:
        """Yield what is wrong with a vector, each with the parameter's path; nothing if it complies."""
        stored = self._shaped(vector).tolist()
        values = {parameter.name: value for parameter, value in zip(self.parameters, stored, strict=True)}
        broken = False
        for parameter in self.parameters:
            if isinstance(parameter, Categorical) and (problem := parameter.problem(values[parameter.name])):
                yield f"{self.name}.{parameter.name}: {problem}"
                broken = True
        if broken:
            return
        asleep = self._asleep(values)
        for parameter in self.parameters:
            value = values[parameter.name]
            if parameter.name in asleep:
                problem = None if value == 0 else f"expected 0 while its block sleeps, got {value!r}"
            else:
                problem = parameter.problem(value)
            if problem:
                yield f"{self.name}.{parameter.name}: {problem}"
                broken = True
        if broken:
            return
        for block in self._blocks:
            if block.members[0] not in asleep and all(values[name] == 0 for name in block.members):
                yield f"{self.name}.{block.label}: expected numbers for a block that is awake, got only zeros"
        for rule in self._rules:
            if asleep.isdisjoint(rule.names) and (problem := rule.problem(values, self.by_name)):
                yield f"{self.name}.{rule.names[0]}: {problem}"

    def unset_dormant(self, vector: FloatArray) -> FloatArray:
        """Return a copy in which sleeping numbers are NaN: variation then has nothing to mix or to shift."""
        copy = np.array(self._shaped(vector))
        values = {
            parameter.name: float(value) for parameter, value in zip(self.parameters, copy, strict=True)
        }
        asleep = self._asleep(values)
        copy[[parameter.name in asleep for parameter in self.parameters]] = np.nan
        return copy

    def decode(self, vector: FloatArray) -> dict[str, Value]:
        """Return the values that people read, by parameter."""
        stored = self._shaped(vector).tolist()
        return {p.name: p.decode(value) for p, value in zip(self.parameters, stored, strict=True)}

    def encode(self, values: Mapping[str, object]) -> FloatArray:
        """Return the vector of the values that people write.

        Raises:
            SpaceError: A parameter is missing, unknown, out of range, or breaks a constraint.
        """
        for name in values:
            if name not in self.by_name:
                raise SpaceError(f"{self.name}.{name}: unknown parameter{nearest(name, self.by_name)}")
        vector = np.zeros(self.dimension)
        for position, parameter in enumerate(self.parameters):
            if parameter.name not in values:
                raise SpaceError(f"{self.name}.{parameter.name}: missing; expected {parameter.describe()}")
            vector[position] = self._encode(parameter, values)
        for problem in self.problems(vector):
            raise SpaceError(problem)
        return frozen_array(vector + 0.0)

    def _encode(self, parameter: Parameter, values: Mapping[str, object]) -> float:
        value = values[parameter.name]
        resting = any(
            parameter.name in block.members and values.get(block.label) == block.null_choice
            for block in self._blocks
        )
        if resting and not isinstance(value, bool | str) and value == 0:
            return 0.0
        try:
            return parameter.encode(value)
        except SpaceError as error:
            raise SpaceError(f"{self.name}.{error}") from None

    def describe(self) -> dict[str, Any]:
        """Return the component as a JSON object."""
        return {
            "name": self.name,
            "parameters": [parameter.describe() for parameter in self.parameters],
            "constraints": [constraint.describe() for constraint in self.constraints],
        }

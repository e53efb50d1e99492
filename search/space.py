"""The search space: named components whose vectors together make up a complete solution.

A complete solution is a tuple of vectors, one for each component, or the same numbers concatenated into one row.
`SearchSpace.join` and `SearchSpace.split` convert between the two. Everything here is immutable.

Two invariants hold for every component: what `Component.repair` returns passes `Component.problems`, and repair
leaves a valid vector unchanged.
"""

import math
from bisect import bisect_right
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.formula import Formula
from brink.search.errors import SpaceError
from brink.search.feasible import Feasible, by_every_name, parsed, violated
from brink.search.parameters import (
    Categorical,
    Constraint,
    Dormant,
    Duration,
    Extent,
    Integer,
    Number,
    Parameter,
    Real,
    ResolutionByChoice,
    RespectsLimits,
    Value,
    Values,
    check_name,
    did_you_mean,
    parameter_title,
)

__all__ = [
    "BoolArray",
    "Categorical",
    "Component",
    "Constraint",
    "Dormant",
    "Duration",
    "Extent",
    "FloatArray",
    "IntArray",
    "Integer",
    "Parameter",
    "Real",
    "SearchSpace",
    "frozen_array",
]

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]


def frozen_array(values: Any, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only array of the same entries; an array that is already read-only is not copied."""
    array = np.asarray(values, dtype=dtype)
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True)
class Component:
    """A named part of a search space, such as the scenario or the behaviour.

    Attributes:
        name: Unique in its space, such as ``scenario``.
        parameters: In the order of the vector, with unique names.
        constraints: In the order in which repair applies them, except that `Dormant` always comes first: the
            constraints of dormant numbers do not apply, and those of reactivated numbers repair the fresh draws.
        formulas: Conditions on the parameters; see `SearchSpace.constrained`.
        interchangeable: Parts that can be swapped without changing what a vector means, such as two injected
            trajectories: for each, the names of its parameters, in the same order. Empty, or at least two parts.
        by_name: The parameters by name.
    """

    name: str
    parameters: tuple[Parameter, ...]
    constraints: tuple[Constraint | Dormant, ...] = ()
    interchangeable: tuple[tuple[str, ...], ...] = ()
    formulas: tuple[Formula, ...] = ()
    by_name: Mapping[str, Parameter] = field(init=False, repr=False, compare=False)
    _blocks: tuple[Dormant, ...] = field(init=False, repr=False, compare=False)
    _rules: tuple[Constraint, ...] = field(init=False, repr=False, compare=False)
    _free: tuple[Number, ...] = field(init=False, repr=False, compare=False)
    _checked: tuple[Parameter, ...] = field(init=False, repr=False, compare=False)
    _feasible: Feasible | None = field(init=False, repr=False, compare=False, default=None)
    _when: Mapping[str, tuple[tuple[str, frozenset[float]], ...]] = field(
        init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        check_name("component", self.name)
        object.__setattr__(self, "parameters", tuple(self.parameters))
        object.__setattr__(self, "constraints", tuple(self.constraints))
        object.__setattr__(self, "interchangeable", tuple(tuple(part) for part in self.interchangeable))
        names = [parameter.name for parameter in self.parameters]
        if not names:
            raise SpaceError(f"component {self.name}: expected at least one parameter")
        if len(set(names)) < len(names):
            raise SpaceError(
                f"component {self.name}: expected distinct parameter names, got {', '.join(names)}"
            )
        blocks = tuple(c for c in self.constraints if isinstance(c, Dormant))
        rules = tuple(c for c in self.constraints if not isinstance(c, Dormant))
        object.__setattr__(self, "by_name", {p.name: p for p in self.parameters})
        object.__setattr__(self, "_when", {p.name: self._checked_when(p) for p in self.parameters if p.when})
        self._check_constraints(blocks, rules)
        self._check_interchangeable()
        self._check_resolutions()
        owned = {name for rule in rules for name in rule.names}
        free = tuple(p for p in self.parameters if isinstance(p, Number) and p.name not in owned)
        object.__setattr__(self, "_blocks", blocks)
        object.__setattr__(self, "_rules", rules)
        object.__setattr__(self, "_free", free)
        object.__setattr__(self, "_checked", self._check_limits(blocks, rules))
        if self.formulas:
            object.__setattr__(self, "_feasible", self._find_feasible())

    def _checked_when(self, parameter: Parameter) -> tuple[tuple[str, frozenset[float]], ...]:
        """Return the labels on which the presence of a parameter depends, with the codes of their choices."""
        earlier = self.parameters[: self.parameters.index(parameter)]
        labels = {one.name: one for one in earlier if isinstance(one, Categorical)}
        checked = []
        for name, choices in parameter.when:
            where = f"component {self.name}: {parameter.name} is present when {name}"
            if name not in labels:
                raise SpaceError(
                    f"{where}: expected a categorical parameter of the component that comes before it"
                    f"{did_you_mean(name, labels)}"
                )
            known = labels[name].choices
            for choice in choices:
                if choice not in known:
                    raise SpaceError(f"{where} is {choice!r}: no such choice{did_you_mean(choice, known)}")
            checked.append((name, frozenset(float(known.index(choice)) for choice in choices)))
        return tuple(checked)

    def _is_absent(self, name: str, values: Values, absent: Collection[str]) -> bool:
        """Return whether a parameter is absent, given which earlier ones are."""
        return any(label in absent or values[label] not in codes for label, codes in self._when[name])

    def _absent(self, values: Values) -> set[str]:
        absent: set[str] = set()
        for name in self._when:
            if self._is_absent(name, values, absent):
                absent.add(name)
        return absent

    def _find_feasible(self) -> Feasible:
        nothing = np.full(self.dimension, np.nan)
        return Feasible(
            formulas=self.formulas,
            ranges=np.array([1.0 if isinstance(p, Categorical) else p.range for p in self.parameters]),
            categorical=np.array([isinstance(p, Categorical) for p in self.parameters]),
            draw=lambda rng: self._settled(nothing, rng),
            settle=lambda row: self._settled(row, np.random.Generator(np.random.PCG64(0))),
            values=self.active_values,
        )

    def _check_constraints(self, blocks: tuple[Dormant, ...], rules: tuple[Constraint, ...]) -> None:
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
            for name in owners:
                if self.by_name[name].when:
                    raise SpaceError(
                        f"component {self.name}: {name} belongs to a {what}, so it is always present"
                    )
                if isinstance(number := self.by_name[name], Number) and (number.step or number.log):
                    raise SpaceError(
                        f"component {self.name}: {name} belongs to a {what}, so it can have neither steps nor a log "
                        "scale"
                    )

    def _check_limits(
        self, blocks: tuple[Dormant, ...], rules: tuple[Constraint, ...]
    ) -> tuple[Parameter, ...]:
        """Return the parameters by which single values are checked, after checking that limits can be met.

        They are those of the component, without the limits that a constraint checks itself.
        """
        checked = dict(self.by_name)
        for rule in rules:
            kept = rule.unlimited_names() if isinstance(rule, RespectsLimits) else rule.names
            for name in kept:
                if self.by_name[name].odd is not None:
                    raise SpaceError(
                        f"component {self.name}: {name} cannot be limited: its possible values depend on others"
                    )
            if isinstance(rule, RespectsLimits) and rule.checks_limits():
                checked |= {name: self.by_name[name].unlimited() for name in rule.names}
        for block in blocks:
            label, numbers = self.by_name[block.label], [self.by_name[name] for name in block.members]
            if label.odd != block.null_choice and all(number.odd == 0 for number in numbers):
                raise SpaceError(
                    f"component {self.name}: expected a number other than 0 for {', '.join(block.members)}; "
                    f"to have none of them, fix {block.label} to {block.null_choice}"
                )
        return tuple(checked.values())

    def _check_interchangeable(self) -> None:
        parts = self.interchangeable
        if not parts:
            return
        where = f"component {self.name}: interchangeable"
        if len(parts) < 2 or len({len(part) for part in parts}) > 1 or not parts[0]:
            raise SpaceError(f"{where}: expected two or more parts of the same length, got {parts!r}")
        names = [name for part in parts for name in part]
        for name in names:
            if name not in self.by_name:
                raise SpaceError(f"{where}: unknown parameter {name!r}{did_you_mean(name, self.by_name)}")
        if len(set(names)) < len(names):
            raise SpaceError(f"{where}: expected each parameter once, got {', '.join(names)}")
        for same in zip(*parts, strict=True):
            first, *others = (replace(self.by_name[name], name="same") for name in same)
            if any(other != first for other in others):
                raise SpaceError(
                    f"{where}: expected {', '.join(same)} to have the same type, range and choices"
                )

    def _check_resolutions(self) -> None:
        for parameter in self.parameters:
            if isinstance(parameter, Categorical) or not isinstance(parameter.resolution, ResolutionByChoice):
                continue
            label = self.by_name.get(parameter.resolution.label)
            if not isinstance(label, Categorical):
                raise SpaceError(
                    f"component {self.name}: expected the resolution of {parameter.name} to depend on a categorical "
                    f"parameter of the component, got {parameter.resolution.label!r}"
                )
            for choice in parameter.resolution.by_choice:
                if choice not in label.choices:
                    known = did_you_mean(choice, label.choices)
                    raise SpaceError(
                        f"component {self.name}: the resolution of {parameter.name} names an unknown choice "
                        f"{choice!r} of {label.name}{known}"
                    )

    def resolution(self, place: int, vector: FloatArray) -> tuple[float, bool]:
        """Return the resolution of a number of a valid vector, 1 for a category, and whether it is stated."""
        parameter = self.parameters[place]
        if isinstance(parameter, Categorical):
            return 1.0, True
        choice = None
        if isinstance(parameter.resolution, ResolutionByChoice):
            label = self.by_name[parameter.resolution.label]
            choice = str(label.decode(float(vector[self.parameters.index(label)])))
        return parameter.resolution_at(choice), parameter.stated_resolution(choice) is not None

    def limited(self, limits: Mapping[str, object]) -> Self:
        """Return the component within an operational design domain.

        Parts that are limited differently are no longer interchangeable; of several groups of equal parts, the
        largest stays so.

        Args:
            limits: Limits of some parameters by name, in the forms that `Number.limited` and `Categorical.limited`
                take; the others stay as they are.

        Raises:
            SpaceError: A name is unknown, or a limit cannot be met.
        """
        for name in limits:
            if name not in self.by_name:
                raise SpaceError(f"{self.name}.{name}: unknown parameter{did_you_mean(name, self.by_name)}")
        parameters = {
            name: parameter.limited(limits[name]) if name in limits else parameter
            for name, parameter in self.by_name.items()
        }
        alike: dict[tuple[Parameter, ...], list[tuple[str, ...]]] = {}
        for part in self.interchangeable:
            numbered = enumerate(parameters[name] for name in part)
            key = tuple(replace(parameter, name=f"p{place}") for place, parameter in numbered)
            alike.setdefault(key, []).append(part)
        largest = max(alike.values(), key=len, default=[])
        return replace(
            self,
            parameters=tuple(parameters.values()),
            interchangeable=tuple(largest) if len(largest) > 1 else (),
        )

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def size(self) -> float:
        """Number of different vectors ignoring constraints; infinite with a real parameter."""
        size = 1.0
        for parameter in self.parameters:
            match parameter:
                case Real(step=None):
                    if parameter.least < parameter.most:
                        return float("inf")
                case Real() | Integer():
                    size *= round((parameter.most - parameter.least) / parameter.spacing) + 1
                case Categorical():
                    size *= len(parameter.codes)
        return size

    def sample(self, rng: np.random.Generator) -> FloatArray:
        """Draw a random valid vector: uniform values, repaired by the constraints."""
        if self._feasible is not None:
            return self._feasible.sample(rng)
        return self.repair(np.full(self.dimension, np.nan), rng)

    def repair(self, vector: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the nearest valid vector, read-only; the argument is not modified.

        The steps, in order: round labels to a choice; clip numbers without a constraint to their ranges; set dormant
        blocks to 0 and draw reactivated ones; apply the other constraints as listed; move a vector that does not meet
        the formulas until it does. NaN means "draw afresh".

        Args:
            vector: Any numbers, infinities and NaN included, shape ``(dimension,)``.
            rng: Draws fresh numbers; not used if none are needed.

        Raises:
            SpaceError: The vector has the wrong shape.
        """
        settled = self._settled(vector, rng)
        return settled if self._feasible is None else self._feasible.repaired(settled)

    def _settled(self, vector: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the nearest vector that is valid but for the formulas."""
        values = self._values(vector)
        absent: set[str] = set()
        for parameter in self.parameters:
            if parameter.when:
                if self._is_absent(parameter.name, values, absent):
                    absent.add(parameter.name)
                    values[parameter.name] = parameter.absent
                    continue
                if values[parameter.name] == parameter.absent:
                    values[parameter.name] = math.nan
            if isinstance(parameter, Categorical):
                value = values[parameter.name]
                values[parameter.name] = (
                    parameter.draw(rng) if math.isnan(value) else parameter.clipped(value)
                )
            elif isinstance(parameter, Integer):
                values[parameter.name] = parameter.rounded(values[parameter.name])
        for number in self._free:
            if not math.isnan(values[number.name]) and number.name not in absent:
                values[number.name] = number.clipped(values[number.name])
        dormant = self._dormant(values)
        values.update(dict.fromkeys(dormant, 0.0))
        self._draw_missing(values, dormant, rng)
        for rule in self._rules:
            if dormant.isdisjoint(rule.names):
                rule.repair(values, self.by_name)
        # Adding 0.0 turns -0.0 into 0.0: equal solutions must have equal bytes.
        return frozen_array(np.fromiter(values.values(), np.float64, self.dimension) + 0.0)

    def _values(self, vector: FloatArray) -> Values:
        array = np.asarray(vector, dtype=np.float64)
        if array.shape != (self.dimension,):
            raise SpaceError(
                f"{self.name}: expected a vector of {self.dimension} numbers, got shape {array.shape}"
            )
        return {p.name: value for p, value in zip(self.parameters, array.tolist(), strict=True)}

    def dormant(self, vector: FloatArray) -> BoolArray:
        """Return which parameters of a valid vector are dormant or absent, shape ``(dimension,)``."""
        values = self._values(vector)
        names = self._dormant(values) | self._absent(values)
        return np.array([parameter.name in names for parameter in self.parameters], np.bool_)

    def _dormant(self, values: Values) -> set[str]:
        return {
            name for block in self._blocks if block.is_dormant(values, self.by_name) for name in block.members
        }

    def _draw_missing(self, values: Values, dormant: set[str], rng: np.random.Generator) -> None:
        """Draw every number that is missing or whose block was just reactivated, in place."""
        fresh = {name for name, value in values.items() if math.isnan(value) and name not in dormant}
        for block in self._blocks:
            active = block.members[0] not in dormant
            if active and all(values[name] == 0 for name in block.members):
                fresh.update(block.members)
        for parameter in self.parameters:
            if parameter.name in fresh:
                values[parameter.name] = parameter.draw(rng)
        for block in self._blocks:
            # All zeros would read as dormant; only blocks of a few integers can draw them.
            while fresh.issuperset(block.members) and all(values[name] == 0 for name in block.members):
                for name in block.members:
                    values[name] = self.by_name[name].draw(rng)

    @property
    def is_independent(self) -> bool:
        """Whether uniform values of all parameters are a uniform draw, once what is dormant is set to 0."""
        plain = all(
            isinstance(one, Categorical) or not (one.step or one.log) for one in self.parameters
        ) and not any(one.when for one in self.parameters)
        whole = any(
            isinstance(self.by_name[name], Integer) for block in self._blocks for name in block.members
        )
        return plain and not self._rules and not self.formulas and not whole

    def set_dormant(self, vectors: FloatArray) -> None:
        """Set what is dormant to 0, in place, in vectors of shape ``(n, dimension)``."""
        place = {parameter.name: column for column, parameter in enumerate(self.parameters)}
        for block in self._blocks:
            label = self.by_name[block.label]
            dormant = vectors[:, place[block.label]] == label.encode(block.null_choice)
            for name in block.members:
                vectors[dormant, place[name]] = 0.0

    def sample_with(self, values: Mapping[str, float], rng: np.random.Generator) -> FloatArray:
        """Draw a vector in which some parameters have stored values, if they are present, and the others are uniform.

        It is valid but for the formulas, if the values are and no constraint other than `Dormant` limits them.
        """
        given = [values.get(parameter.name, math.nan) for parameter in self.parameters]
        return self._settled(np.array(given), rng)

    def problems(self, vector: FloatArray) -> Iterator[str]:
        """Yield what is wrong with a vector, each problem with the path of its parameter; nothing if it is valid.

        Raises:
            SpaceError: The vector has the wrong shape.
        """
        values = self._values(vector)
        absent = self._absent(values)
        labels = [p for p in self.parameters if isinstance(p, Categorical) and p.name not in absent]
        violations = [(p.name, problem) for p in labels if (problem := p.problem(values[p.name]))]
        if not violations:
            violations = list(self._value_problems(values)) or list(self._constraint_problems(values))
        for name, problem in violations:
            yield f"{self.name}.{name}: {problem}"
        if not violations and (formula := violated(self.formulas, self.active_values(vector))):
            yield f"{self.name}: expected values that meet the constraint {formula.text}"

    def _value_problems(self, values: Values) -> Iterator[tuple[str, str]]:
        dormant, absent = self._dormant(values), self._absent(values)
        for parameter in self._checked:
            value = values[parameter.name]
            if parameter.name in absent:
                problem = None if value == parameter.absent else f"expected no value{self._unless(parameter)}"
            elif parameter.name in dormant:
                problem = None if value == 0 else f"expected 0 while its block is dormant, got {value!r}"
            else:
                problem = parameter.problem(value)
            if problem:
                yield parameter.name, problem

    def _constraint_problems(self, values: Values) -> Iterator[tuple[str, str]]:
        dormant = self._dormant(values)
        for block in self._blocks:
            if block.members[0] not in dormant and all(values[name] == 0 for name in block.members):
                yield block.label, "expected numbers for an active block, got only zeros"
        for rule in self._rules:
            if dormant.isdisjoint(rule.names) and (problem := rule.problem(values, self.by_name)):
                yield rule.names[0], problem

    def active_values(self, vector: FloatArray) -> dict[str, Value]:
        """Return the values of a valid vector as people read them, by own and by full name; only active ones."""
        values = self._values(vector)
        dormant = self._dormant(values) | self._absent(values)
        active = {p.name: p.decode(values[p.name]) for p in self.parameters if p.name not in dormant}
        return active | {f"{self.name}.{name}": value for name, value in active.items()}

    def unset_dormant(self, vector: FloatArray) -> FloatArray:
        """Return a copy with NaN for what is dormant or absent, so that variation neither mixes nor shifts it.

        Raises:
            SpaceError: The vector has the wrong shape.
        """
        values = self._values(vector)
        values.update(dict.fromkeys(self._dormant(values) | self._absent(values), math.nan))
        return np.fromiter(values.values(), np.float64, self.dimension)

    def decode(self, vector: FloatArray) -> dict[str, Value]:
        """Return the human-readable values, by parameter; absent ones are left out.

        Raises:
            SpaceError: The vector has the wrong shape.
        """
        values = self._values(vector)
        absent = self._absent(values)
        return {p.name: p.decode(values[p.name]) for p in self.parameters if p.name not in absent}

    def encode(self, values: Mapping[str, object]) -> FloatArray:
        """Return the vector that encodes human-readable values.

        Raises:
            SpaceError: A parameter is missing, unknown, absent with these values, out of range, or violates a
                constraint.
        """
        for name in values:
            if name not in self.by_name:
                raise SpaceError(f"{self.name}.{name}: unknown parameter{did_you_mean(name, self.by_name)}")
        vector = np.zeros(self.dimension)
        stored: Values = {}
        absent: set[str] = set()
        for position, parameter in enumerate(self.parameters):
            given = values.get(parameter.name)
            if parameter.when and self._is_absent(parameter.name, stored, absent):
                if given is not None:
                    unless = self._unless(parameter)
                    raise SpaceError(
                        f"{self.name}.{parameter.name}: expected no value{unless}, got {given!r}"
                    )
                absent.add(parameter.name)
                vector[position] = parameter.absent
                continue
            if parameter.name not in values:
                raise SpaceError(f"{self.name}.{parameter.name}: missing; expected {parameter.describe()}")
            vector[position] = stored[parameter.name] = self._encode(parameter, values)
        for problem in self.problems(vector):
            raise SpaceError(problem)
        return frozen_array(vector + 0.0)

    def _unless(self, parameter: Parameter) -> str:
        conditions = [f"{label} is {' or '.join(choices)}" for label, choices in parameter.when]
        return f" unless {' and '.join(conditions)}"

    def _encode(self, parameter: Parameter, values: Mapping[str, object]) -> float:
        value = values[parameter.name]
        dormant = any(
            parameter.name in block.members and values.get(block.label) == block.null_choice
            for block in self._blocks
        )
        if dormant and not isinstance(value, bool | str) and value == 0:
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


class OperationalDistribution(Protocol):
    """How often solutions occur in operation (`brink.search.distribution`)."""

    def sample(self, space: "SearchSpace", rng: np.random.Generator) -> tuple[FloatArray, ...]:
        """Draw a valid complete solution of a space."""

    def describe(self) -> dict[str, Any]:
        """Return the distribution as it is declared."""

    def words(self, space: "SearchSpace") -> str:
        """Return the distribution in words."""


@dataclass(frozen=True, slots=True)
class SearchSpace:
    """A search space of named components with typed parameters.

    Attributes:
        components: In the order of a solution's vectors, with unique names.
        formulas: Conditions on parameters of more than one component; see `constrained`.
        distribution: How often solutions occur in operation; None if all are equally likely. Searches ignore it.
        dimension: Number of all parameters.
        categorical: Which parameters are categorical, shape ``(dimension,)``.
        ranges: Whole range of each number, whatever the ODD, 1 for a category, shape ``(dimension,)``.
        slices: Position of each component in a row.
    """

    components: tuple[Component, ...]
    formulas: tuple[Formula, ...] = ()
    distribution: OperationalDistribution | None = field(default=None, repr=False, compare=False)
    dimension: int = field(init=False, compare=False)
    categorical: BoolArray = field(init=False, repr=False, compare=False)
    ranges: FloatArray = field(init=False, repr=False, compare=False)
    slices: tuple[slice, ...] = field(init=False, repr=False, compare=False)
    _constraints: tuple[Formula, ...] = field(init=False, repr=False, compare=False)
    _feasible: Feasible | None = field(init=False, repr=False, compare=False, default=None)

    def __post_init__(self) -> None:
        object.__setattr__(self, "components", tuple(self.components))
        own = [formula for component in self.components for formula in component.formulas]
        object.__setattr__(self, "_constraints", (*own, *self.formulas))
        names = [component.name for component in self.components]
        if not names or len(set(names)) < len(names):
            raise SpaceError(f"expected at least one component, with distinct names; got {names}")
        parameters = self.parameters
        ends = np.cumsum([component.dimension for component in self.components]).tolist()
        starts = [0, *ends[:-1]]
        categorical = [isinstance(p, Categorical) for p in parameters]
        ranges = [1.0 if isinstance(p, Categorical) else p.range for p in parameters]
        object.__setattr__(self, "dimension", len(parameters))
        object.__setattr__(self, "categorical", frozen_array(categorical, np.bool_))
        object.__setattr__(self, "ranges", frozen_array(ranges))
        object.__setattr__(self, "slices", tuple(slice(a, b) for a, b in zip(starts, ends, strict=True)))
        if self.formulas:
            object.__setattr__(self, "_feasible", self._find_feasible())

    def _find_feasible(self) -> Feasible:
        def settle(row: FloatArray) -> FloatArray:
            rng = np.random.Generator(np.random.PCG64(0))
            return self.join(
                [c.repair(v, rng) for c, v in zip(self.components, self.split(row), strict=True)]
            )

        return Feasible(
            formulas=self.formulas,
            ranges=self.ranges,
            categorical=self.categorical,
            draw=lambda rng: self.join([component.sample(rng) for component in self.components]),
            settle=settle,
            values=self._active_values,
        )

    def _active_values(self, row: FloatArray) -> dict[str, Value]:
        values: dict[str, Value] = {}
        for component, vector in zip(self.components, self.split(row), strict=True):
            values |= component.active_values(vector)
        return values

    def constrained(self, texts: Sequence[str]) -> "SearchSpace":
        """Return the space without the solutions that violate further constraints.

        Args:
            texts: Conditions on the values as people read them (`brink.formula`), such as ``gap > 2 * speed / 3.6``
                or ``weather == 'dry' or scenario.speed < 20``. One does not apply where a parameter in it is absent.

        Raises:
            SpaceError: One is not a condition on parameters of the space, or no solution meets them all.
        """
        own: dict[str, tuple[Formula, ...]] = {one.name: one.formulas for one in self.components}
        across = self.formulas
        known = by_every_name([(one.name, one.parameters) for one in self.components])
        for text in texts:
            formula = parsed(text, known)
            parameters = [known[name] for name in formula.names]
            homes = [
                one.name for one in self.components if any(p is q for p in parameters for q in one.parameters)
            ]
            if len(homes) == 1:
                own[homes[0]] += (formula,)
            else:
                across += (formula,)
        components = [replace(one, formulas=own[one.name]) for one in self.components]
        return SearchSpace(tuple(components), across)

    @property
    def constraints(self) -> list[str]:
        """The constraints that were written as formulas."""
        return [formula.text for formula in self._constraints]

    def allows(self, row: FloatArray) -> bool:
        """Return whether a row that is otherwise valid meets all constraints that were written as formulas."""
        return not self._constraints or violated(self._constraints, self._active_values(row)) is None

    @property
    def size(self) -> float:
        """Number of different solutions ignoring constraints; infinite with a real parameter."""
        return float(np.prod([component.size for component in self.components]))

    @property
    def absent(self) -> FloatArray:
        """What is stored where a parameter is absent, NaN if it is always present, shape ``(dimension,)``."""
        return np.array([parameter.absent if parameter.when else np.nan for parameter in self.parameters])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameter of each entry of a row."""
        return tuple(parameter for component in self.components for parameter in component.parameters)

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
            raise SpaceError(f"{component}: unknown component{did_you_mean(component, names)}")
        return names.index(component)

    def sample(self, rng: np.random.Generator) -> tuple[FloatArray, ...]:
        """Draw a random valid complete solution."""
        if self._feasible is not None:
            return self.split(self._feasible.sample(rng))
        return tuple(component.sample(rng) for component in self.components)

    def draw(self, rng: np.random.Generator) -> tuple[FloatArray, ...]:
        """Draw a valid complete solution as it occurs in operation: by the distribution, or uniformly without one."""
        return self.sample(rng) if self.distribution is None else self.distribution.sample(self, rng)

    def draw_rows(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw rows as `draw` does, shape ``(count, dimension)``; much faster where parameters are independent.

        Args:
            count: Number of rows.
            rng: Source of the draws; they are not those of `draw`.
        """
        if (
            self.distribution is not None
            or not all(one.is_independent for one in self.components)
            or self.formulas
        ):
            drawn = [self.join(self.draw(rng)) for _ in range(count)]
            return np.array(drawn).reshape(count, self.dimension)
        rows = self.draw_unrepaired(count, rng)
        for column, parameter in enumerate(self.parameters):
            if isinstance(parameter, Integer):
                rows[:, column] = rng.integers(
                    int(parameter.least), int(parameter.most), size=count, endpoint=True
                )
        for component, part in zip(self.components, self.slices, strict=True):
            component.set_dormant(rows[:, part])
        return rows

    def draw_unrepaired(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw rows of uniform values, shape ``(count, dimension)``; constraints are ignored.

        Args:
            count: Number of rows.
            rng: Source of the draws.
        """
        parameters = self.parameters
        low = np.array([0.0 if isinstance(p, Categorical) else p.least for p in parameters])
        width = np.array([1.0 if isinstance(p, Categorical) else float(p.most - p.least) for p in parameters])
        choices = np.array([len(p.codes) if isinstance(p, Categorical) else 1 for p in parameters])
        drawn = rng.random((count, self.dimension))
        rows: FloatArray = np.where(self.categorical, np.floor(drawn * choices), low + drawn * width)
        for column, parameter in enumerate(parameters):
            if isinstance(parameter, Categorical) and parameter.allowed is not None:
                rows[:, column] = np.array(parameter.codes)[rows[:, column].astype(np.intp)]
        return rows

    def dormant(self, row: FloatArray) -> BoolArray:
        """Return which parameters of a valid row are dormant or absent, shape ``(dimension,)``."""
        vectors = self.split(row)
        return np.concatenate([c.dormant(v) for c, v in zip(self.components, vectors, strict=True)])

    def resolutions(
        self, row: FloatArray, columns: Sequence[int] | None = None
    ) -> tuple[FloatArray, BoolArray]:
        """Return the resolution of numbers of a valid row, and whether the problem states it.

        A resolution is the largest difference that people would call the same. Without one stated, it is 1% of the
        range, and at least 1 for an integer.

        Args:
            row: The row, shape ``(dimension,)``.
            columns: Columns of the numbers, k of them; by default all.

        Returns:
            Resolutions in the numbers' own units, 1 and stated for a category, both of shape ``(k,)``.
        """
        found = []
        for column in range(self.dimension) if columns is None else columns:
            place = bisect_right([part.start for part in self.slices], column) - 1
            part = self.slices[place]
            found.append(self.components[place].resolution(column - part.start, row[part]))
        return np.array([value for value, _ in found]), np.array([stated for _, stated in found], np.bool_)

    def sample_component(self, index: int, rng: np.random.Generator) -> FloatArray:
        """Draw a random valid vector of one component."""
        return self.components[index].sample(rng)

    def repair(self, vectors: Sequence[FloatArray], rng: np.random.Generator) -> tuple[FloatArray, ...]:
        """Return the nearest valid complete solution; the argument is not modified.

        Raises:
            SpaceError: A vector is missing or has the wrong shape.
        """
        parts = tuple(c.repair(v, rng) for c, v in zip(self.components, self._counted(vectors), strict=True))
        return parts if self._feasible is None else self.split(self._feasible.repaired(self.join(parts)))

    def repair_component(self, index: int, vector: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the nearest valid vector of one component; the argument is not modified.

        Args:
            index: Position of the component.
            vector: Any numbers, infinities and NaN included, shape ``(component.dimension,)``.
            rng: Draws fresh numbers; not used if none are needed.

        Raises:
            SpaceError: The vector has the wrong shape.
        """
        return self.components[index].repair(vector, rng)

    def repaired_parts(self, row: FloatArray, columns: Iterable[int], rng: np.random.Generator) -> FloatArray:
        """Return the nearest valid row to one that was changed in some columns and was valid before.

        Args:
            row: The changed row, shape ``(d,)``; it is not modified.
            columns: The columns that may have changed.
            rng: Draws fresh numbers; not used if none are needed.
        """
        repaired, changed = np.array(row), set(columns)
        for component, part in zip(self.components, self.slices, strict=True):
            if not changed.isdisjoint(range(part.start, part.stop)):
                repaired[part] = component.repair(row[part], rng)
        return repaired if self._feasible is None else self._feasible.repaired(repaired)

    def check(self, vectors: Sequence[FloatArray]) -> None:
        """Check that a complete solution is valid.

        Raises:
            SpaceError: The solution is invalid; the message names the first invalid parameter.
        """
        for component, vector in zip(self.components, self._counted(vectors), strict=True):
            for problem in component.problems(vector):
                raise SpaceError(problem)
        if self.formulas and (formula := violated(self.formulas, self._active_values(self.join(vectors)))):
            raise SpaceError(f"expected values that meet the constraint {formula.text}")

    def _counted(self, vectors: Sequence[FloatArray]) -> Sequence[FloatArray]:
        if len(vectors) != len(self.components):
            names = ", ".join(component.name for component in self.components)
            raise SpaceError(f"expected {len(self.components)} vectors ({names}), got {len(vectors)}")
        return vectors

    def titles(self) -> dict[str, str]:
        """Return the title of each parameter by its full name, in the order of the genome."""
        return {
            f"{component.name}.{parameter.name}": parameter_title(component.name, parameter)
            for component in self.components
            for parameter in component.parameters
        }

    def contains(self, vectors: Sequence[FloatArray]) -> bool:
        """Return whether a complete solution is valid.

        Raises:
            SpaceError: A vector is missing or has the wrong shape.
        """
        parts = zip(self.components, self._counted(vectors), strict=True)
        if any(True for component, vector in parts for _ in component.problems(vector)):
            return False
        return not self.formulas or self.allows(self.join(vectors))

    def unlimited(self) -> "SearchSpace":
        """Return the space without its ODD and its constraints.

        Interchangeable parts that the ODD told apart stay told apart.
        """
        if not self._constraints and all(parameter.odd is None for parameter in self.parameters):
            return self
        return SearchSpace(
            tuple(
                replace(
                    component, parameters=tuple(one.unlimited() for one in component.parameters), formulas=()
                )
                for component in self.components
            )
        )

    def join(self, vectors: Sequence[FloatArray]) -> FloatArray:
        """Return a complete solution as one row, shape ``(dimension,)``, read-only.

        Raises:
            SpaceError: A vector is missing or has the wrong shape.
        """
        row = np.concatenate([np.asarray(v, dtype=np.float64) for v in self._counted(vectors)])
        if row.shape != (self.dimension,):
            raise SpaceError(f"expected {self.dimension} numbers, got {row.size}")
        return frozen_array(row)

    def split(self, row: FloatArray) -> tuple[FloatArray, ...]:
        """Return the vectors of a row of shape ``(dimension,)``, read-only.

        Raises:
            SpaceError: The row has the wrong shape.
        """
        if row.shape != (self.dimension,):
            raise SpaceError(f"expected a row of {self.dimension} numbers, got shape {row.shape}")
        return tuple(frozen_array(row[part]) for part in self.slices)

    def decode(self, vectors: Sequence[FloatArray]) -> dict[str, dict[str, Value]]:
        """Return the human-readable values, ready for JSON: ``{component: {parameter: value}}``.

        Raises:
            SpaceError: A vector is missing or has the wrong shape.
        """
        parts = zip(self.components, self._counted(vectors), strict=True)
        return {component.name: component.decode(vector) for component, vector in parts}

    def encode(self, values: Mapping[str, Mapping[str, object]]) -> tuple[FloatArray, ...]:
        """Return the vectors that encode ``{component: {parameter: value}}``.

        Raises:
            SpaceError: A value is missing, unknown, out of range, or violates a constraint; names the parameter.
        """
        for name, content in values.items():
            self.index(name)
            if not isinstance(content, Mapping):
                raise SpaceError(f"{name}: expected an object of its parameters by name, got {content!r}")
        missing = [component.name for component in self.components if component.name not in values]
        if missing:
            raise SpaceError(f"{missing[0]}: missing component")
        vectors = tuple(component.encode(values[component.name]) for component in self.components)
        if self.formulas:
            self.check(vectors)
        return vectors

    def describe(self) -> dict[str, Any]:
        """Return the whole space as a JSON object."""
        about: dict[str, Any] = {"components": [component.describe() for component in self.components]}
        return about | {"constraints": self.constraints} if self.constraints else about

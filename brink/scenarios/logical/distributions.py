"""What a ``ParameterValueDistribution`` of OpenSCENARIO says of each parameter.

Deterministic distributions list values; stochastic ones say how likely they are. Expected value and variance of a
log-normal distribution are those of the value itself, not of its logarithm: that is what their names say, as the
standard defines them no further.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from brink.scenarios.logical.declarations import NUMBERS, WHOLE, Declaration, literal, number
from brink.scenarios.logical.document import Document, Element
from brink.sim.episode import nearest

MAX_VALUES: Final = 10_000
USER_DEFINED: Final = "UserDefinedDistribution"


@dataclass(frozen=True, slots=True, kw_only=True)
class Variation:
    """How a parameter varies.

    Attributes:
        kind: ``set`` or ``steps`` (deterministic), or ``weights``, ``uniform``, ``normal``, ``lognormal``,
            ``poisson`` or ``histogram`` (stochastic), or ``unreadable``.
        element: Where that is stated.
        values: The values of ``set`` and ``weights``, as they are written.
        numbers: Numbers of the kind: ``step``; ``weights`` of the values; ``mean`` and ``sd`` of ``normal`` and of
            ``lognormal`` (of the value, not its logarithm), ``mean`` of ``poisson``; ``edges`` and ``weights`` of the
            bins of a ``histogram``, of which there is one weight less.
        low: Lower end of the range; None without one.
        high: Upper end of the range; None without one.
        why: Why it is unreadable.
    """

    kind: str
    element: Element
    values: tuple[str, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    low: float | None = None
    high: float | None = None
    why: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueSets:
    """Values of several parameters that belong together.

    Attributes:
        rows: The values of each set, by parameter.
        element: Where they are stated.
    """

    rows: tuple[Mapping[str, str], ...]
    element: Element


@dataclass(frozen=True, slots=True, kw_only=True)
class Distributions:
    """What a distribution file says.

    Attributes:
        scenario: Path of its scenario, as it is written.
        element: Where that is written.
        variations: By parameter.
        sets: Values that belong together.
        runs: Number of test runs that it asks for; None if it is deterministic.
        random_seed: Its seed; None without one.
    """

    scenario: str
    element: Element
    variations: Mapping[str, Variation]
    sets: tuple[ValueSets, ...]
    runs: int | None
    random_seed: str | None


def scenario_of(document: Document) -> tuple[str, Element]:
    """Return the path of the scenario that a distribution file varies, and where it is written.

    Raises:
        InvalidInput: The document is no distribution file.
    """
    file = document.child(document.child(document.root, "ParameterValueDistribution"), "ScenarioFile")
    return document.attribute(file, "filepath"), file


def distributions_of(document: Document, declared: Mapping[str, Declaration]) -> Distributions:
    """Read a distribution file.

    Args:
        document: The file.
        declared: The parameters of its scenario.

    Raises:
        InvalidInput: It is malformed, or varies a parameter that is not declared, or one twice.
    """
    scenario, file = scenario_of(document)
    top = document.child(document.root, "ParameterValueDistribution")
    reader = _Reader(document, declared)
    runs = seed = None
    if (group := top.first("Deterministic")) is not None:
        for element in group.children:
            reader.deterministic(element)
    elif (group := top.first("Stochastic")) is not None:
        runs = int(number(document, group, "unsignedInt", document.attribute(group, "numberOfTestRuns")))
        seed = group.attributes.get("randomSeed")
        for element in group.children:
            reader.stochastic(element)
    else:
        raise document.error(top, "expected an element Deterministic or Stochastic")
    return Distributions(
        scenario=scenario,
        element=file,
        variations=reader.variations,
        sets=tuple(reader.sets),
        runs=runs,
        random_seed=seed,
    )


class _Reader:
    def __init__(self, document: Document, declared: Mapping[str, Declaration]) -> None:
        self._document = document
        self._declared = declared
        self._taken: dict[str, Element] = {}
        self.variations: dict[str, Variation] = {}
        self.sets: list[ValueSets] = []

    def deterministic(self, element: Element) -> None:
        """Read an element of a deterministic distribution."""
        match element.tag:
            case "DeterministicSingleParameterDistribution":
                declaration = self._take(element, "parameterName")
                self.variations[declaration.name] = self._single(element, declaration)
            case "DeterministicMultiParameterDistribution":
                self._value_sets(self._document.child(element, "ValueSetDistribution"))
            case _:
                raise self._document.error(element, "expected a distribution of one or of several parameters")

    def stochastic(self, element: Element) -> None:
        """Read an element of a stochastic distribution."""
        if element.tag != "StochasticDistribution":
            raise self._document.error(element, "expected elements StochasticDistribution")
        declaration = self._take(element, "parameterName")
        (only,) = element.children if len(element.children) == 1 else [None]
        read = None if only is None else _STOCHASTIC.get(only.tag)
        if only is None or read is None:
            raise self._document.error(element, f"expected one of {', '.join(_STOCHASTIC)}")
        if only.tag not in ("ProbabilityDistributionSet", USER_DEFINED) and declaration.type not in NUMBERS:
            raise self._document.error(only, f"expected a number, {declaration.name} is a {declaration.type}")
        self.variations[declaration.name] = read(self, only, declaration)

    def _take(self, element: Element, attribute: str) -> Declaration:
        name = self._document.attribute(element, attribute)
        if name not in self._declared:
            hint = nearest(name, tuple(self._declared))
            raise self._document.error(
                element, f"the scenario has no ParameterDeclaration of that name{hint}, got {name!r:.80}"
            )
        if name in self._taken:
            line = self._taken[name].line
            raise self._document.error(
                element, f"expected each parameter once; line {line} varies it as well"
            )
        self._taken[name] = element
        return self._declared[name]

    def _single(self, element: Element, declaration: Declaration) -> Variation:
        (only,) = element.children if len(element.children) == 1 else [None]
        match None if only is None else only.tag:
            case "DistributionSet" if only is not None:
                values = [
                    self._literal(one, declaration, self._document.attribute(one, "value"))
                    for one in only.all("Element")
                ]
                return self._set("set", only, values)
            case "DistributionRange" if only is not None:
                if declaration.type not in NUMBERS:
                    raise self._document.error(
                        only, f"expected a number, {declaration.name} is a {declaration.type}"
                    )
                low, high = self._range(only, declaration.type)
                step = number(
                    self._document, only, declaration.type, self._document.attribute(only, "stepWidth")
                )
                if step <= 0:
                    raise self._document.error(only, f"expected a stepWidth above 0, got {step:g}")
                return Variation(kind="steps", element=only, numbers={"step": step}, low=low, high=high)
            case tag if tag == USER_DEFINED and only is not None:
                return self._user_defined(only, declaration)
        raise self._document.error(
            element, f"expected one of DistributionSet, DistributionRange, {USER_DEFINED}"
        )

    def _set(
        self, kind: str, element: Element, values: list[str], weights: list[float] | None = None
    ) -> Variation:
        if not 1 <= len(values) <= MAX_VALUES or len(set(values)) < len(values):
            raise self._document.error(
                element, f"expected 1 to {MAX_VALUES:,} elements Element, each with another value"
            )
        numbers = {} if weights is None else {"weights": weights}
        return Variation(kind=kind, element=element, values=tuple(values), numbers=numbers)

    def _value_sets(self, element: Element) -> None:
        rows: list[dict[str, str]] = []
        sets = element.all("ParameterValueSet")
        if not 1 <= len(sets) <= MAX_VALUES:
            raise self._document.error(element, f"expected 1 to {MAX_VALUES:,} elements ParameterValueSet")
        first: dict[str, Declaration] = {}
        for one in sets:
            row: dict[str, str] = {}
            for assignment in one.all("ParameterAssignment"):
                name = self._document.attribute(assignment, "parameterRef")
                declaration = first.get(name) or self._take(assignment, "parameterRef")
                first[name] = declaration
                if name in row:
                    raise self._document.error(assignment, "expected each parameter once in a set")
                row[name] = self._literal(
                    assignment, declaration, self._document.attribute(assignment, "value")
                )
            if not row:
                raise self._document.error(one, "expected at least one ParameterAssignment")
            rows.append(row)
        for name, declaration in first.items():
            if any(name not in row for row in rows) and declaration.is_derived:
                raise self._document.error(
                    element, f"expected {name} in every set, as its declared value is an expression"
                )
        self.sets.append(
            ValueSets(
                rows=tuple(
                    {name: row.get(name, one.value.strip()) for name, one in first.items()} for row in rows
                ),
                element=element,
            )
        )

    def _literal(self, element: Element, declaration: Declaration, text: str) -> str:
        return literal(self._document, element, declaration.type, text)

    def _number(self, element: Element, attribute: str) -> float:
        return number(self._document, element, "double", self._document.attribute(element, attribute))

    def _range(self, element: Element, kind: str) -> tuple[float, float]:
        limits = self._document.child(element, "Range")
        low, high = (
            number(self._document, limits, kind, self._document.attribute(limits, one))
            for one in ("lowerLimit", "upperLimit")
        )
        if low > high:
            raise self._document.error(
                limits, f"expected a lowerLimit up to the upperLimit, got {low:g}, {high:g}"
            )
        return low, high

    def _limits(self, element: Element, declaration: Declaration) -> tuple[float, float] | tuple[None, None]:
        """Return the ends of an optional range; those of whole numbers are whole."""
        if not element.all("Range"):
            return None, None
        low, high = self._range(element, "double")
        if declaration.type in WHOLE:
            low, high = math.ceil(low), math.floor(high)
        if low >= high:
            raise self._document.error(
                element, f"expected a range of several values, got {low:g} to {high:g}"
            )
        return low, high

    def _weights(self, element: Element, declaration: Declaration) -> Variation:
        ones = element.all("Element")
        values = [self._literal(one, declaration, self._document.attribute(one, "value")) for one in ones]
        return self._set("weights", element, values, self._all_weights(element, ones))

    def _all_weights(self, element: Element, ones: list[Element]) -> list[float]:
        weights = [self._number(one, "weight") for one in ones]
        if not weights or min(weights) < 0 or not 0 < sum(weights) < math.inf:
            raise self._document.error(element, "expected weights of at least 0, one of them above")
        return weights

    def _uniform(self, element: Element, declaration: Declaration) -> Variation:
        self._document.child(element, "Range")
        low, high = self._limits(element, declaration)
        return Variation(kind="uniform", element=element, low=low, high=high)

    def _normal(self, element: Element, declaration: Declaration) -> Variation:
        mean, variance = self._number(element, "expectedValue"), self._number(element, "variance")
        if variance <= 0:
            raise self._document.error(element, f"expected a variance above 0, got {variance:g}")
        kind = "normal" if element.tag == "NormalDistribution" else "lognormal"
        low, high = self._limits(element, declaration)
        if kind == "lognormal" and (mean <= 0 or (low or 0.0) < 0):
            raise self._document.error(element, "expected an expectedValue above 0 and a range of at least 0")
        numbers = {"mean": mean, "sd": math.sqrt(variance)}
        return Variation(kind=kind, element=element, numbers=numbers, low=low, high=high)

    def _poisson(self, element: Element, declaration: Declaration) -> Variation:
        mean = self._number(element, "expectedValue")
        low, high = self._limits(element, declaration)
        if mean <= 0 or (low or 0.0) < 0:
            raise self._document.error(element, "expected an expectedValue above 0 and a range of at least 0")
        if any(one != int(one) for one in (low or 0.0, high or 0.0)):
            raise self._document.error(element, "expected a range between whole numbers")
        return Variation(kind="poisson", element=element, numbers={"mean": mean}, low=low, high=high)

    def _histogram(self, element: Element, declaration: Declaration) -> Variation:
        bins = element.all("Bin")
        weights = self._all_weights(element, bins)
        edges: list[float] = []
        filled: list[float] = []
        for (low, high), weight, one in sorted(
            zip((self._range(one, "double") for one in bins), weights, bins, strict=True),
            key=lambda entry: entry[0],
        ):
            if low >= high or (edges and low < edges[-1]):
                raise self._document.error(one, "expected bins that are not empty and do not overlap")
            if edges and low > edges[-1]:  # nothing lies between these bins
                edges.append(low)
                filled.append(0.0)
            edges += [high] if edges else [low, high]
            filled.append(weight)
        return Variation(
            kind="histogram",
            element=element,
            numbers={"edges": edges, "weights": filled},
            low=math.ceil(edges[0]) if declaration.type in WHOLE else edges[0],
            high=math.floor(edges[-1]) if declaration.type in WHOLE else edges[-1],
        )

    def _user_defined(self, element: Element, declaration: Declaration) -> Variation:
        kind = self._document.attribute(element, "type")
        why = f"{USER_DEFINED} of the type {kind!r:.80} in line {element.line} has a meaning of its own"
        return Variation(kind="unreadable", element=element, why=why)


_STOCHASTIC: Final = {
    "ProbabilityDistributionSet": _Reader._weights,
    "NormalDistribution": _Reader._normal,
    "LogNormalDistribution": _Reader._normal,
    "UniformDistribution": _Reader._uniform,
    "PoissonDistribution": _Reader._poisson,
    "Histogram": _Reader._histogram,
    USER_DEFINED: _Reader._user_defined,
}

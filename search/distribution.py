"""The operational distribution: how often the solutions of a space occur in operation.

It is written as a mapping of parameters to how their values are distributed, beside the ODD::

    scenario.speed:   {normal: {mean: 12, deviation: 3}}
    scenario.gap:     {lognormal: {median: 20, sigma: 0.5}}      # sigma: standard deviation of the logarithm
    scenario.density: {beta: {a: 2, b: 5}}                       # over the range of the parameter
    scenario.delay:   {exponential: {mean: 0.4}}                 # from the lower end of the range
    scenario.slope:   {histogram: {edges: [-6, -2, 2, 6], weights: [1, 6, 1]}}
    scenario.time:    {weights: {day: 8, night: 2}}
    scenario.weather: {depends_on: scenario.time, weights: {day: {dry: 9, rain: 1}, night: {dry: 7, rain: 3}}}
    rows:             {columns: [scenario.limit, scenario.lanes], values: [[8.3, 1], [13.9, 2]]}

A name may contain ``*``, as in an ODD. A parameter that is not named is distributed as a search draws it: uniformly,
on a log scale by factors. Numbers are cut to their range within the ODD, and steps and integers take the nearest
value. ``rows`` are observations, of which whole ones are drawn, so that dependence between columns survives; in a
campaign file, ``from: drives.csv`` stands for them.

Parameters are independent but for ``rows`` and ``depends_on``. Solutions that violate a constraint written as a
formula are drawn again: the distribution is that of solutions that meet all of them. What is dormant or absent with
the drawn categories takes no value.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.special import betainc, betaincinv, ndtr, ndtri

from brink.search.errors import DistributionError, SpaceError
from brink.search.odd import matching_names
from brink.search.parameters import Categorical, Dormant, Number, Parameter, did_you_mean
from brink.search.space import FloatArray, SearchSpace, frozen_array

ROWS: Final = "rows"
FROM: Final = "from"
"""In a campaign file: a CSV file, whose content becomes `ROWS`."""
DEPENDS_ON: Final = "depends_on"
MOST_ROWS: Final = 20_000
"""Maximum number of observations."""
_REDRAWN: Final = 1_000
"""Draws of a solution that meets all constraints."""
_LEAST_MASS: Final = 1e-9
"""Smallest probability of a number's range, before the distribution is cut to it."""


class _Marginal(ABC):
    """How the values of one parameter are distributed."""

    depends_on: str | None = None

    @abstractmethod
    def draw(self, label: float, rng: np.random.Generator) -> float:
        """Draw a stored value, given that of the category on which it depends; NaN without one."""

    @abstractmethod
    def words(self) -> str:
        """Describe the distribution in a few words."""


class _Continuous(_Marginal):
    """A continuous distribution cut to the range of a number.

    Args:
        parameter: The number.
        cumulative: Cumulative distribution function of values in the number's unit.
        inverse: Its inverse.
        words: The distribution in words.
    """

    def __init__(
        self,
        parameter: Number,
        cumulative: Callable[[float], float],
        inverse: Callable[[float], float],
        words: str,
    ) -> None:
        least, most = parameter.ends
        half = 0.5 * parameter.spacing
        self._parameter, self._inverse, self._words = parameter, inverse, words
        self._ends = least, most
        self._between = float(cumulative(least - half)), float(cumulative(most + half))
        if least < most and not self._between[1] - self._between[0] >= _LEAST_MASS:
            raise SpaceError(
                f"expected a distribution with values from {least:g} to {most:g}; {words} has practically none there"
            )

    def draw(self, label: float, rng: np.random.Generator) -> float:
        low, high = self._between
        value = float(self._inverse(low + (high - low) * rng.random()))
        least, most = self._ends
        return self._parameter.clipped(self._parameter.stored(min(max(value, least), most)))

    def words(self) -> str:
        return self._words


class _Weights(_Marginal):
    """Weights of the choices of a category, possibly given another one.

    Args:
        parameter: The category.
        weights: Weights of its choices, by choice; or by choice of `label`, and then by choice.
        label: The category on which it depends, with its full name; None for none.
    """

    def __init__(
        self, parameter: Categorical, weights: object, label: tuple[str, Categorical] | None
    ) -> None:
        self.depends_on = None if label is None else label[0]
        self._parameter = parameter
        self._by_code: dict[float, tuple[FloatArray, FloatArray]] = {}
        if label is None:
            self._only = _chances(parameter, weights)
        else:
            given = _mapping(weights, f"weights for each choice of {label[0]}")
            known = label[1]
            expected = [known.choices[code] for code in known.codes]
            for choice in given:
                if choice not in known.choices:
                    raise SpaceError(f"{label[0]} is never {choice!r}{did_you_mean(choice, known.choices)}")
            if missing := [choice for choice in expected if choice not in given]:
                raise SpaceError(f"expected weights for each choice of {label[0]}; missing {missing[0]}")
            self._by_code = {known.encode(choice): _chances(parameter, given[choice]) for choice in expected}
        self._words = _weights_words(weights, self.depends_on)

    def draw(self, label: float, rng: np.random.Generator) -> float:
        if self.depends_on is not None and label not in self._by_code:  # absent in an observation
            return self._parameter.draw(rng)
        codes, chances = self._only if self.depends_on is None else self._by_code[label]
        return float(codes[int(rng.choice(len(codes), p=chances))])

    def words(self) -> str:
        return self._words


def _weights_words(weights: object, depends_on: str | None) -> str:
    if depends_on is not None:
        return f"weights given {depends_on}"
    assert isinstance(weights, Mapping)
    total = sum(map(float, weights.values()))
    return ", ".join(f"{choice} {float(weight) / total:.3g}" for choice, weight in weights.items())


def _chances(parameter: Categorical, weights: object) -> tuple[FloatArray, FloatArray]:
    """Return the codes of the choices with a positive weight, and their probabilities."""
    given = _mapping(weights, "weights by choice")
    allowed = {parameter.choices[code] for code in parameter.codes}
    for choice in given:
        if choice not in parameter.choices:
            raise SpaceError(f"unknown choice {choice!r}{did_you_mean(choice, parameter.choices)}")
    numbers = {choice: _number(weight, f"weight of {choice}") for choice, weight in given.items()}
    if min(numbers.values(), default=0.0) < 0:
        raise SpaceError(f"expected weights >= 0, got {dict(given)!r}")
    kept = {choice: weight for choice, weight in numbers.items() if weight > 0 and choice in allowed}
    if not kept:
        raise SpaceError(f"expected a positive weight of at least one of {', '.join(sorted(allowed))}")
    total = np.array(list(kept.values()))
    return np.array([parameter.encode(choice) for choice in kept]), total / total.sum()


def _mapping(value: object, what: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping) or not value:
        raise SpaceError(f"expected {what}, got {value!r:.80}")
    return value


def _number(value: object, what: str, *, above: float | None = None) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not math.isfinite(number := float(value)) or (above is not None and number <= above):  # type: ignore[arg-type]
        wanted = "a number" if above is None else f"a number > {above:g}"
        raise SpaceError(f"{what}: expected {wanted}, got {value!r:.40}")
    return number


def _named_numbers(kind: str, given: object, **above: float | None) -> list[float]:
    """Return the numbers of a distribution, in the order of the names that it has, each with its lower bound."""
    expected = ", ".join(above)
    if not isinstance(given, Mapping) or set(given) != set(above):
        raise SpaceError(f"{kind}: expected {expected}, got {given!r:.80}")
    return [_number(given[name], f"{kind}: {name}", above=bound) for name, bound in above.items()]


def _normal(parameter: Number, given: object) -> _Continuous:
    mean, deviation = _named_numbers("normal", given, mean=None, deviation=0.0)
    return _Continuous(
        parameter,
        lambda x: float(ndtr((x - mean) / deviation)),
        lambda u: mean + deviation * float(ndtri(u)),
        f"normal with mean {mean:g} and deviation {deviation:g}",
    )


def _lognormal(parameter: Number, given: object) -> _Continuous:
    median, sigma = _named_numbers("lognormal", given, median=0.0, sigma=0.0)
    return _Continuous(
        parameter,
        lambda x: float(ndtr(math.log(x / median) / sigma)) if x > 0 else 0.0,
        lambda u: median * math.exp(sigma * float(ndtri(u))),
        f"lognormal with median {median:g} and sigma {sigma:g}",
    )


def _beta(parameter: Number, given: object) -> _Continuous:
    a, b = _named_numbers("beta", given, a=0.0, b=0.0)
    low, width = float(parameter.low), float(parameter.high - parameter.low)
    return _Continuous(
        parameter,
        lambda x: float(betainc(a, b, min(max((x - low) / width, 0.0), 1.0))),
        lambda u: low + width * float(betaincinv(a, b, u)),
        f"beta with a {a:g} and b {b:g}",
    )


def _exponential(parameter: Number, given: object) -> _Continuous:
    (mean,) = _named_numbers("exponential", given, mean=0.0)
    start = float(parameter.ends[0])
    return _Continuous(
        parameter,
        lambda x: -math.expm1(-max(x - start, 0.0) / mean),
        lambda u: start - mean * math.log1p(-u),
        f"exponential with mean {mean:g}",
    )


def _histogram(parameter: Number, given: object) -> _Continuous:
    if not isinstance(given, Mapping) or set(given) != {"edges", "weights"}:
        raise SpaceError(f"histogram: expected edges and weights, got {given!r:.80}")
    for name in ("edges", "weights"):
        if not isinstance(given[name], list | tuple):
            raise SpaceError(f"histogram: {name}: expected a list of numbers, got {given[name]!r:.80}")
    edges = np.array([_number(edge, "histogram: edges") for edge in given["edges"]])
    weights = np.array([_number(weight, "histogram: weights") for weight in given["weights"]])
    if len(edges) != len(weights) + 1 or len(weights) < 1 or not (np.diff(edges) > 0).all():
        raise SpaceError("histogram: expected ascending edges, one more than weights")
    if not (weights >= 0).all() or not weights.sum() > 0:
        raise SpaceError("histogram: expected weights >= 0, one of them positive")
    below = np.concatenate([[0.0], np.cumsum(weights)]) / weights.sum()
    rising = np.concatenate([[True], weights > 0])  # where the inverse is unique
    return _Continuous(
        parameter,
        lambda x: float(np.interp(x, edges, below)),
        lambda u: float(_inverse_of_steps(u, edges, below, rising)),
        f"histogram of {len(weights)} bins from {edges[0]:g} to {edges[-1]:g}",
    )


def _inverse_of_steps(u: float, edges: FloatArray, below: FloatArray, rising: Any) -> float:
    """Return the value with a share of `u` below it; never one within a bin of weight 0."""
    upper = int(np.searchsorted(below, u, side="left"))
    upper = min(max(upper, 1), len(edges) - 1)
    while not rising[upper] and upper < len(edges) - 1:
        upper += 1
    low, high = below[upper - 1], below[upper]
    share = (u - low) / (high - low) if high > low else 0.0
    return float(edges[upper - 1] + min(max(share, 0.0), 1.0) * (edges[upper] - edges[upper - 1]))


_CONTINUOUS: Final[Mapping[str, Callable[[Number, object], _Continuous]]] = {
    "normal": _normal,
    "lognormal": _lognormal,
    "beta": _beta,
    "exponential": _exponential,
    "histogram": _histogram,
}
NUMBERS: Final[Mapping[str, tuple[str, ...]]] = {
    "normal": ("mean", "deviation"),
    "lognormal": ("median", "sigma"),
    "beta": ("a", "b"),
    "exponential": ("mean",),
}
"""The kinds of distributions that a few numbers describe, with the names of these."""
KINDS: Final = ("uniform", *_CONTINUOUS, "weights")


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Observations of some parameters, of which whole ones are drawn.

    Attributes:
        names: Full names of the parameters.
        stored: Their stored values, NaN for a parameter that is absent, shape ``(n, k)``.
    """

    names: tuple[str, ...]
    stored: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Distribution:
    """An operational distribution.

    Attributes:
        declared: The distribution as it is written.
    """

    declared: Mapping[str, Any]
    _marginals: Mapping[str, _Marginal]
    _labels: Mapping[str, Categorical]
    _rows: _Rows | None

    def sample(self, space: SearchSpace, rng: np.random.Generator) -> tuple[FloatArray, ...]:
        """Draw a valid complete solution.

        Raises:
            SpaceError: None of many draws met the constraints.
        """
        for _ in range(_REDRAWN):
            values = self._draw(rng)
            vectors = tuple(
                component.sample_with(
                    {
                        name: values[full]
                        for name in component.by_name
                        if (full := f"{component.name}.{name}") in values
                    },
                    rng,
                )
                for component in space.components
            )
            if space.allows(space.join(vectors)):
                return vectors
        raise SpaceError(
            f"distribution: expected solutions that meet the constraints; none of {_REDRAWN:,} draws does"
        )

    def _draw(self, rng: np.random.Generator) -> dict[str, float]:
        values: dict[str, float] = {}
        if self._rows is not None:
            row = self._rows.stored[int(rng.integers(len(self._rows.stored)))]
            values |= dict(zip(self._rows.names, row.tolist(), strict=True))
        for name, marginal in self._marginals.items():
            label = math.nan
            if (other := marginal.depends_on) is not None:
                if other not in values:
                    values[other] = self._labels[other].draw(rng)
                label = values[other]
            values[name] = marginal.draw(label, rng)
        return values

    def describe(self) -> dict[str, Any]:
        """Return the distribution as it is written."""
        return dict(self.declared)

    def words(self, space: SearchSpace) -> str:
        """Return the distribution in words, one clause for each parameter that is not uniform."""
        titles = space.titles()
        clauses = [f"{titles[name]}: {marginal.words()}" for name, marginal in self._marginals.items()]
        if self._rows is not None:
            columns = ", ".join(titles[name] for name in self._rows.names)
            clauses.insert(0, f"{columns}: {len(self._rows.stored):,} observations")
        return "; ".join(clauses)


def distributed(space: SearchSpace, declared: Mapping[str, object]) -> SearchSpace:
    """Return a space with an operational distribution; the space itself if nothing is declared.

    Args:
        space: The space, within its ODD and constraints.
        declared: How parameters are distributed, as the module describes.

    Raises:
        DistributionError: A parameter is unknown or named twice, or its distribution does not fit its values.
    """
    if not declared:
        return space
    parameters = dict(zip(space.column_names(), space.parameters, strict=True))
    marginals: dict[str, _Marginal] = {}
    given_by: dict[str, str] = {}
    rows = None
    for given, one in declared.items():
        if given == FROM:
            raise DistributionError(
                FROM,
                "expected a campaign file, which reads the CSV file; elsewhere, give its content as rows",
            )
        try:
            rows = _rows(space, one) if given == ROWS else rows
            names = matching_names(space, given) if given != ROWS or rows is None else list(rows.names)
            for name in names:
                _check_free(space, name, given_by)
                given_by[name] = given
                if given != ROWS and one != "uniform":
                    marginals[name] = _marginal(name, parameters, one)
        except SpaceError as error:
            raise DistributionError(str(given), str(error)) from None
    labels = {name: one for name, one in parameters.items() if isinstance(one, Categorical)}
    distribution = Distribution(declared, _ordered(marginals), labels, rows)
    return _with(space, distribution)


def _with(space: SearchSpace, distribution: Distribution) -> SearchSpace:
    within = SearchSpace(space.components, space.formulas, distribution)
    try:
        distribution.sample(within, np.random.Generator(np.random.PCG64(0)))
    except SpaceError as error:
        raise DistributionError(None, str(error).removeprefix("distribution: ")) from None
    return within


def _check_free(space: SearchSpace, name: str, given_by: Mapping[str, str]) -> None:
    """Check that neither another entry nor a constraint other than `Dormant` decides the values of a parameter."""
    if name in given_by:
        raise SpaceError(f"{name} is named twice, by {given_by[name]} too")
    component = space.components[space.index(name.partition(".")[0])]
    own = name.partition(".")[2]
    for rule in component.constraints:
        if not isinstance(rule, Dormant) and own in rule.names:
            raise SpaceError(
                f"{name} cannot have a distribution of its own: its values depend on those of other parameters"
            )


def _marginal(name: str, parameters: Mapping[str, Parameter], declared: object) -> _Marginal:
    parameter = parameters[name]
    if not isinstance(declared, Mapping):
        raise SpaceError(f"expected one of {', '.join(KINDS)}, got {declared!r:.80}")
    kinds = [key for key in declared if key != DEPENDS_ON]
    if len(kinds) != 1 or kinds[0] not in KINDS[1:]:
        raise SpaceError(
            f"expected one of {', '.join(KINDS)}, got {', '.join(map(str, kinds)) or 'none'}"
            f"{did_you_mean(kinds[0], KINDS) if kinds else ''}"
        )
    kind = kinds[0]
    if isinstance(parameter, Categorical):
        if kind != "weights":
            raise SpaceError(f"expected weights of choices for a category, got {kind}")
        return _Weights(parameter, declared[kind], _label(name, parameters, declared))
    if kind == "weights":
        raise SpaceError("expected a distribution of numbers, such as a histogram, got weights of choices")
    if DEPENDS_ON in declared:
        raise SpaceError("expected depends_on only with the weights of a category")
    return _CONTINUOUS[kind](parameter, declared[kind])


def _label(
    name: str, parameters: Mapping[str, Parameter], declared: Mapping[str, object]
) -> tuple[str, Categorical] | None:
    if DEPENDS_ON not in declared:
        return None
    other = declared[DEPENDS_ON]
    label = parameters.get(str(other))
    if not isinstance(label, Categorical) or other == name:
        categories = [one for one, parameter in parameters.items() if isinstance(parameter, Categorical)]
        raise SpaceError(
            f"depends_on: expected another category, got {other!r}{did_you_mean(other, categories)}"
        )
    return str(other), label


def _ordered(marginals: Mapping[str, _Marginal]) -> dict[str, _Marginal]:
    """Return marginals so that each comes after the one on which it depends.

    Raises:
        DistributionError: They depend on each other in a circle.
    """
    ordered: dict[str, _Marginal] = {}
    left = dict(marginals)
    while left:
        ready = [name for name, one in left.items() if one.depends_on not in left]
        if not ready:
            raise DistributionError(
                None, f"expected weights without a circle of depends_on, got {', '.join(left)}"
            )
        ordered |= {name: left.pop(name) for name in ready}
    return ordered


def _rows(space: SearchSpace, declared: object) -> _Rows:
    """Return observations.

    Raises:
        SpaceError: A column is unknown, or a value is not valid.
    """
    if not isinstance(declared, Mapping) or set(declared) != {"columns", "values"}:
        raise SpaceError(f"expected columns and values, got {declared!r:.80}")
    columns, values = declared["columns"], declared["values"]
    known = dict(zip(space.column_names(), space.parameters, strict=True))
    if not isinstance(columns, list | tuple) or not columns or len(set(map(str, columns))) < len(columns):
        raise SpaceError(f"columns: expected different names of parameters, got {columns!r:.80}")
    for column in columns:
        if column not in known:
            raise SpaceError(f"columns: unknown parameter {column!r}{did_you_mean(column, known)}")
    if not isinstance(values, list | tuple) or not 1 <= len(values) <= MOST_ROWS:
        raise SpaceError(f"values: expected 1 to {MOST_ROWS:,} rows, got {values!r:.80}")
    stored = np.empty((len(values), len(columns)))
    for number, row in enumerate(values):
        if not isinstance(row, list | tuple) or len(row) != len(columns):
            raise SpaceError(f"row {number + 1}: expected {len(columns)} values, got {row!r:.80}")
        for place, (column, value) in enumerate(zip(columns, row, strict=True)):
            try:
                stored[number, place] = _stored(known[column], value)
            except SpaceError as error:
                raise SpaceError(f"row {number + 1}, {column}: {error}") from None
    return _Rows(tuple(columns), frozen_array(stored))


def _stored(parameter: Parameter, value: object) -> float:
    """Return an observed value as stored; NaN for none of a parameter that may be absent."""
    if value is None and parameter.when:
        return math.nan
    if isinstance(parameter, Categorical):
        return parameter.encode(f"{value:g}" if isinstance(value, int | float) else value)
    number = _number(value, parameter.name)
    least, most = parameter.ends
    if not least <= number <= most:
        raise SpaceError(f"expected a number from {least:g} to {most:g}, got {number:g}")
    return parameter.clipped(parameter.stored(number))


def rows_of_table(columns: Sequence[str], lines: Sequence[Sequence[str]]) -> dict[str, Any]:
    """Return the content of a CSV file as ``rows``: numbers where a text is one, None where it is empty."""
    return {"columns": list(columns), "values": [[_value(text) for text in line] for line in lines]}


def _value(text: str) -> str | float | None:
    text = text.strip()
    if not text:
        return None
    try:
        number = float(text)
    except ValueError:
        return text
    return number if math.isfinite(number) else text


def distribution_words(space: SearchSpace) -> str:
    """Return the operational distribution of a space in words; that it is uniform if none was declared."""
    if space.distribution is None:
        return "all values equally likely"
    words = space.distribution.words(space)
    return f"{words}; all other values equally likely" if words else "all values equally likely"

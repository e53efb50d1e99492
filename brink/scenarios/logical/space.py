"""Makes a search space of a scenario's parameters: axes with ranges and laws, and constraints between them."""

import itertools
import keyword
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Any, Final

import numpy as np

from brink.formula import FUNCTIONS, MOST_CHARACTERS, Formula
from brink.scenarios.logical.declarations import (
    NUMBERS,
    OPERATORS,
    WHOLE,
    Declaration,
    declarations_of,
    literal,
    number,
)
from brink.scenarios.logical.distributions import MAX_VALUES, Distributions, Variation, distributions_of
from brink.scenarios.logical.document import Document, Element
from brink.scenarios.logical.expressions import ExpressionError, is_reference, number_formula
from brink.scenarios.logical.laws import Law, law_of, law_of_weights, share_inside, usual_range
from brink.server.errors import FieldError, InvalidInput
from brink.sim.adapters.command.definition import ALWAYS
from brink.sim.episode import nearest

MAX_COMBINATIONS: Final = 500


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """A parameter of the search space.

    Attributes:
        name: Its name in the search space.
        placeholders: The parameters of the scenario that it sets, each with the placeholder of its value.
        declared: The parameter as a campaign file declares it.
        law: How likely its values are; None if nothing is said of that.
        about: What it is, in words.
        rows: For each choice of a category, the value of each parameter of the scenario; empty for a number.
    """

    name: str
    placeholders: Mapping[str, str]
    declared: Mapping[str, Any]
    law: Law | None = None
    about: str = ""
    rows: tuple[Mapping[str, str], ...] = ()

    def kept(self, places: Sequence[int]) -> "Axis":
        """Return the axis with some of its choices."""
        declared: dict[str, Any] = {
            **self.declared,
            "values": [self.declared["values"][one] for one in places],
        }
        if "gives" in declared:
            declared["gives"] = {
                key: [texts[one] for one in places] for key, texts in declared["gives"].items()
            }
        law = self.law
        if law is not None:
            law = law_of_weights({one: law["weights"][one] for one in declared["values"]})
        return replace(self, declared=declared, law=law, rows=tuple(self.rows[one] for one in places))


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """What is said of parameters besides the files.

    Attributes:
        ranges: By parameter, ``LOW:HIGH``, ``LOW:HIGH:STEP`` or ``VALUE,VALUE``.
        keep: Parameters that keep their declared value.
        keep_others: Whether all without a range do.
    """

    ranges: Mapping[str, str] = field(default_factory=dict)
    keep: frozenset[str] = frozenset()
    keep_others: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LogicalScenario:
    """A scenario with its search space.

    Attributes:
        document: The scenario.
        axes: The parameters of the search space.
        constraints: Conditions on them.
        fixed: Values that parameters of the scenario have in all episodes, other than the declared ones.
        notes: What a reader should know.
        distributions: What the distribution file says; None without one.
    """

    document: Document
    axes: tuple[Axis, ...]
    constraints: tuple[str, ...]
    fixed: Mapping[str, str]
    notes: tuple[str, ...]
    distributions: Distributions | None


class MissingRanges(InvalidInput):
    """Parameters have no range; `missing` has each with a range that suggests itself, or an empty text."""

    def __init__(self, errors: list[FieldError], missing: list[tuple[Declaration, str]]) -> None:
        super().__init__(errors)
        self.missing = missing


def logical_scenario(
    document: Document, distribution: Document | None = None, wishes: Wishes | None = None
) -> LogicalScenario:
    """Return a scenario with the search space of its parameters.

    A distribution file says which parameters vary; all others keep their declared values. Without one, parameters
    vary within their constraints.

    Args:
        document: The scenario.
        distribution: A distribution file for it.
        wishes: What else is said of its parameters.

    Raises:
        MissingRanges: Parameters have no range.
        InvalidInput: A file is malformed, an element cannot be expressed, or nothing varies.
    """
    if document.root.first("ParameterDeclarations") is None and document.root.first("Storyboard") is None:
        found = [one.tag for one in document.root.children if one.tag != "FileHeader"]
        raise document.error(
            document.root, f"expected a scenario with a Storyboard, got {', '.join(found)[:80]}"
        )
    return _Builder(document, distribution, wishes or Wishes()).build()


class _Builder:
    def __init__(self, document: Document, distribution: Document | None, wishes: Wishes) -> None:
        self._document = document
        self._declared = declarations_of(document)
        self._distributions = None
        if distribution is not None:
            self._distributions = distributions_of(distribution, self._declared)
        self._stated = distribution or document
        self._wishes = wishes
        self._axes: dict[str, Axis] = {}
        self._fixed: dict[str, str] = {}
        self._notes: list[str] = []
        self._missing: list[tuple[Declaration, str, str]] = []
        self._taken: set[str] = set()

    def build(self) -> LogicalScenario:
        """Return the scenario with its search space."""
        self._check_wishes()
        rows = {} if self._distributions is None else self._value_sets()
        for declaration in self._declared.values():
            if declaration.name not in rows:
                self._vary(declaration)
        if self._missing:
            raise self._ranges_missing()
        for name, value in rows.items():
            if value is not None:
                self._fixed[name] = value
        for declaration in self._declared.values():
            self._filter(declaration)
        constraints = dict.fromkeys(
            one for declaration in self._declared.values() for one in self._constraints(declaration)
        )
        if not self._axes:
            raise self._nothing_varies()
        return LogicalScenario(
            document=self._document,
            axes=tuple(self._axes.values()),
            constraints=tuple(constraints),
            fixed={
                name: value
                for name, value in self._fixed.items()
                if value != self._declared[name].value.strip()
            },
            notes=tuple(self._notes),
            distributions=self._distributions,
        )

    def _nothing_varies(self) -> InvalidInput:
        known = {} if self._distributions is None else self._distributions.variations
        numbers = [one.name for one in self._declared.values() if one.type in NUMBERS]
        named = next((name for name in numbers if name in known), next(iter(numbers), "speed"))
        root = self._stated.root
        return self._stated.error(
            root.first("ParameterValueDistribution") or root.first("ParameterDeclarations") or root,
            "expected parameters that vary, but each has a single value: give one a range, such as "
            f"--range {named}=LOW:HIGH",
        )

    def _check_wishes(self) -> None:
        sets = () if self._distributions is None else self._distributions.sets
        tied = {name for one in sets for name in one.rows[0]}
        for option, names in (("--range", self._wishes.ranges), ("--keep", self._wishes.keep)):
            for name in names:
                if name not in self._declared:
                    known = tuple(self._declared)
                    raise InvalidInput.at(
                        option,
                        f"no parameter is called {name!r:.80}{nearest(name, known)}; expected one of "
                        f"{', '.join(known)[:400]}",
                    )
                if name in tied:
                    raise InvalidInput.at(option, f"{name} varies together with others, in value sets")

    def _value_sets(self) -> dict[str, str | None]:
        """Make an axis of each list of value sets; return their parameters, with a value where it never varies."""
        assert self._distributions is not None
        found: dict[str, str | None] = {}
        for place, one in enumerate(self._distributions.sets, start=1):
            varying = [name for name in one.rows[0] if len({row[name] for row in one.rows}) > 1]
            found |= {name: None if name in varying else value for name, value in one.rows[0].items()}
            if not varying:
                continue
            rows = list({tuple(row[name] for name in varying): row for row in one.rows}.values())
            placeholders = {name: self._space_name(name) for name in varying}
            axis = self._space_name("values" if len(self._distributions.sets) == 1 else f"values_{place}")
            self._axes[axis] = Axis(
                name=axis,
                placeholders=placeholders,
                declared={
                    "values": [str(number) for number in range(1, len(rows) + 1)],
                    "gives": {placeholders[name]: [row[name] for row in rows] for name in varying},
                },
                about=f"{len(rows)} ParameterValueSets, line {one.element.line}",
                rows=tuple({name: row[name] for name in varying} for row in rows),
            )
        return found

    def _space_name(self, name: str) -> str:
        """Return a name for the search space that no other parameter has and that formulas can have."""
        free = name.lstrip("_") or "parameter"
        while free in self._taken or free in ALWAYS or keyword.iskeyword(free) or free in FUNCTIONS:
            free += "_"
        self._taken.add(free)
        return free

    def _vary(self, declaration: Declaration) -> None:
        """Make an axis of a parameter, fix its value, or note that its range is missing."""
        name = declaration.name
        given = self._wishes.ranges.get(name)
        variation = None if self._distributions is None else self._distributions.variations.get(name)
        if name in self._wishes.keep:
            return
        if variation is not None and variation.kind not in ("set", "steps", "unreadable"):
            self._stochastic(declaration, variation, given)
        elif given is not None:
            self._of_variation(declaration, _wished(declaration, given, self._document), "given")
        elif variation is not None and variation.kind == "unreadable":
            self._lacks(declaration, variation.why, "")
        elif variation is not None:
            about = f"{variation.element.tag}, line {variation.element.line}"
            self._of_variation(declaration, variation, about)
        elif self._distributions is None and not declaration.is_derived:
            self._of_constraints(declaration)

    def _lacks(self, declaration: Declaration, why: str, suggested: str) -> None:
        if not self._wishes.keep_others:
            self._missing.append((declaration, why, suggested))
        elif self._distributions is not None:
            self._notes.append(f"{declaration.name} keeps its value: {why}")

    def _ranges_missing(self) -> MissingRanges:
        errors = []
        for declaration, why, suggested in self._missing:
            kept = (
                "the value that its expression gives" if declaration.is_derived else declaration.value.strip()
            )
            values = "VALUE,VALUE" if declaration.type not in NUMBERS else suggested or "LOW:HIGH"
            errors.append(
                self._document.field_error(
                    declaration.element,
                    f"{why}: give --range {declaration.name}={values}, or --keep {declaration.name} to leave it at "
                    f"{kept!r:.60}",
                )
            )
        if len(errors) > 1:
            errors.append(
                FieldError(pointer="", message="--keep-others leaves all these parameters at their values")
            )
        return MissingRanges(
            errors, [(declaration, suggested) for declaration, _, suggested in self._missing]
        )

    def _of_constraints(self, declaration: Declaration) -> None:
        """Vary a parameter within its constraints."""
        if declaration.type == "boolean" and not declaration.groups:
            self._category(declaration, ("false", "true"), "both values")
            return
        values, low, high = _bounds(self._document, declaration)
        lines = f"ConstraintGroup, line {declaration.groups[0][0][2].line}" if declaration.groups else ""
        if values:
            variation = Variation(kind="set", element=declaration.element, values=values)
            self._of_variation(declaration, variation, lines)
        elif math.isfinite(low) and math.isfinite(high) and low <= high:
            self._number(declaration, low, high, None, lines)
        else:
            ends = [text for text in (_end("from", low), _end("to", high)) if text]
            why = "no range" + (f", only {' '.join(ends)}" if ends else "")
            low_text, high_text = ("" if math.isinf(one) else f"{one:g}" for one in (low, high))
            self._lacks(declaration, why, f"{low_text or 'LOW'}:{high_text or 'HIGH'}" if ends else "")

    def _of_variation(self, declaration: Declaration, variation: Variation, about: str) -> None:
        if variation.kind == "set":
            spaced = _evenly_spaced(declaration, variation.values)
            if spaced is not None:
                self._number(declaration, *spaced, about)
            else:
                self._category(declaration, variation.values, about)
            return
        assert variation.low is not None
        assert variation.high is not None
        self._number(declaration, variation.low, variation.high, variation.numbers.get("step"), about)

    def _category(
        self, declaration: Declaration, values: Sequence[str], about: str, law: Law | None = None
    ) -> None:
        if len(values) == 1:
            self._fixed[declaration.name] = values[0]
            return
        name = self._space_name(declaration.name)
        self._axes[name] = Axis(
            name=name,
            placeholders={declaration.name: name},
            declared={"values": list(values)},
            law=law,
            about=f"{declaration.type}: {about}",
            rows=tuple({declaration.name: value} for value in values),
        )

    def _number(
        self,
        declaration: Declaration,
        low: float,
        high: float,
        step: float | None,
        about: str,
        law: Law | None = None,
    ) -> None:
        whole = declaration.type in WHOLE
        if step is not None or whole:
            step = step or 1
            steps = math.floor((high - low) / step + 1e-9)
            last = float(Decimal(repr(low)) + steps * Decimal(repr(step)))
            if last != high:
                self._notes.append(
                    f"{declaration.name}: steps of {step:g} from {low:g} end at {last:g}, not {high:g}"
                )
            high = last
        if low == high:
            self._fixed[declaration.name] = f"{int(low)}" if whole else repr(float(low))
            return
        kind = int if whole else float
        declared: dict[str, Any] = {"min": kind(low), "max": kind(high)}
        name = self._space_name(declaration.name)
        self._axes[name] = Axis(
            name=name,
            placeholders={declaration.name: name},
            declared=declared | ({} if step is None else {"step": kind(step)}),
            law=law,
            about=f"{declaration.type}: {about}",
        )

    def _stochastic(self, declaration: Declaration, variation: Variation, given: str | None) -> None:
        about = f"{variation.element.tag}, line {variation.element.line}"
        if variation.kind == "weights":
            weights = dict(zip(variation.values, variation.numbers["weights"], strict=True))
            if given is not None:
                raise InvalidInput.at("--range", f"{declaration.name}: {about} states its values")
            likely = {value: weight for value, weight in weights.items() if weight > 0}
            self._category(declaration, tuple(likely), about, law_of_weights(likely))
            return
        low, high, step = variation.low, variation.high, None
        if given is not None:
            wished = _wished(declaration, given, self._document)
            if wished.kind == "set" or wished.low is None or wished.high is None:
                raise InvalidInput.at("--range", f"{declaration.name}: expected LOW:HIGH, to cut {about}")
            low, high, step = wished.low, wished.high, wished.numbers.get("step")
        if low is None or high is None:
            ends = usual_range(variation)
            ends = (math.floor(ends[0]), math.ceil(ends[1])) if declaration.type in WHOLE else ends
            suggested = f"{ends[0]:.4g}:{ends[1]:.4g}"
            self._lacks(declaration, f"{about} has no Range", suggested)
            return
        if variation.kind == "poisson" and step is None:
            step = 1
        inside = share_inside(variation, low, high)
        if inside <= 0:
            raise self._stated.error(
                variation.element, f"expected a range with values, got {low:g} to {high:g}"
            )
        if inside < 0.995:
            self._notes.append(
                f"{declaration.name}: {low:g} to {high:g} has {inside:.1%} of the probability of {about}"
            )
        self._number(declaration, low, high, step, about, law_of(variation, low, high))

    def _filter(self, declaration: Declaration) -> None:
        """Remove the choices of a category with which a parameter always violates its constraints."""
        axes, cases = self._cases(declaration)
        if len(axes) != 1:
            return
        places = [place for place, (_, condition) in enumerate(cases) if condition is not False]
        axis = axes[0]
        if len(places) == len(cases):
            return
        line = declaration.groups[0][0][2].line
        if not places:
            raise self._document.error(declaration.element, f"no value meets its constraints in line {line}")
        dropped = [axis.declared["values"][one] for one in range(len(cases)) if one not in places]
        self._notes.append(f"{axis.name}: {', '.join(dropped)} left out by the constraint in line {line}")
        kept = axis.kept(places)
        if len(places) > 1:
            self._axes[axis.name] = kept
        else:
            del self._axes[axis.name]
            self._fixed |= kept.rows[0]

    def _constraints(self, declaration: Declaration) -> Iterator[str]:
        """Yield the constraints of a parameter, as conditions on the search space."""
        if not declaration.groups:
            return
        axes, cases = self._cases(declaration)
        line = declaration.groups[0][0][2].line
        if len(declaration.groups) > 1 and not axes and cases[0][1] is True:
            self._notes.append(
                f"{declaration.name}: its {len(declaration.groups)} ConstraintGroups from line {line} on are "
                "alternatives, which together exclude nothing in its range"
            )
        conditions = [condition for _, condition in cases]
        if not axes and conditions[0] is False:
            if not self._moving(declaration) and declaration.name not in self._fixed:
                self._notes.append(f"{declaration.name}: its value violates its constraint in line {line}")
                return
            raise self._document.error(
                declaration.element, f"no value in its range meets its constraint in line {line}"
            )
        if len(set(conditions)) == 1:
            cases = [((), conditions[0])]
        for guards, condition in cases:
            if condition is True:
                continue
            unless = " or ".join(guards)
            text = (
                str(condition) if not unless else unless if condition is False else f"{unless} or {condition}"
            )
            if len(text) > MOST_CHARACTERS:
                raise self._document.error(
                    declaration.element,
                    f"expected constraints of at most {MOST_CHARACTERS} characters as formulas",
                )
            yield text

    def _cases(self, declaration: Declaration) -> tuple[list[Axis], list[tuple[tuple[str, ...], str | bool]]]:
        """Return the condition of a parameter for each combination of the categories that decide about it.

        Returns:
            The categories; and for each combination what holds otherwise (``a != 'x'``), with the condition: a
            formula, or whether it holds everywhere or nowhere.
        """
        if not declaration.groups:
            return [], [((), True)]
        names = self._involved(declaration)
        axes = [axis for axis in self._axes.values() if axis.rows and not names.isdisjoint(axis.placeholders)]
        if math.prod(len(axis.rows) for axis in axes) > MAX_COMBINATIONS:
            raise self._document.error(
                declaration.groups[0][0][2],
                f"expected constraints on at most {MAX_COMBINATIONS} combinations of values of "
                f"{', '.join(axis.name for axis in axes)}",
            )
        cases = []
        for places in itertools.product(*(range(len(axis.rows)) for axis in axes)):
            chosen: dict[str, str] = {}
            for axis, place in zip(axes, places, strict=True):
                chosen |= axis.rows[place]
            guards = tuple(
                f"{axis.name} != {axis.declared['values'][place]!r}"
                for axis, place in zip(axes, places, strict=True)
            )
            cases.append((guards, self._condition(declaration, chosen)))
        return axes, cases

    def _involved(self, declaration: Declaration) -> set[str]:
        """Return the names of all parameters on which a parameter and its constraints depend."""
        found: set[str] = set()

        def visit(text: str) -> str:
            number_formula(text, note)
            return "0.0"

        def note(name: str) -> str:
            if name not in found:
                found.add(name)
                known = self._declared.get(name)
                if known is not None and known.type in NUMBERS and self._is_computed(known):
                    visit(known.value)
            return "0.0"

        note(declaration.name)
        for group in declaration.groups:
            for _, text, element in group:
                if is_reference(text):
                    try:
                        visit(text)
                    except ExpressionError as error:
                        raise self._document.error(element, str(error)) from None
        return found

    def _is_computed(self, declaration: Declaration) -> bool:
        set_by_axis = any(declaration.name in axis.placeholders for axis in self._axes.values())
        return declaration.is_derived and not set_by_axis and declaration.name not in self._fixed

    def _moving(self, declaration: Declaration) -> bool:
        return any(
            not self._involved(declaration).isdisjoint(axis.placeholders) for axis in self._axes.values()
        )

    def _condition(self, declaration: Declaration, chosen: Mapping[str, str]) -> str | bool:
        """Return the condition of a parameter, given the values that categories set."""
        alternatives = []
        for group in declaration.groups:
            parts: list[str] = []
            for rule, text, element in group:
                part = self._comparison(declaration, rule, text, element, chosen)
                if part is False:
                    break
                if part is not True:
                    parts.append(part)
            else:
                if not parts:
                    return True
                alternatives.append(parts)
        decided = [self._decided(" and ".join(parts)) for parts in alternatives]
        if True in decided:
            return True
        left = [one for one in decided if one is not False]
        if len(left) < 2:
            return left[0] if left else False
        return self._decided(" or ".join(f"({one})" for one in left))

    def _comparison(
        self, declaration: Declaration, rule: str, text: str, element: Element, chosen: Mapping[str, str]
    ) -> str | bool:
        if declaration.type not in NUMBERS:
            return self._same_text(declaration, rule, text, element, chosen)
        try:
            left = self._formula_of(declaration.name, chosen, ())
            right = number_formula(text, lambda name: self._formula_of(name, chosen, (declaration.name,)))
        except ExpressionError as error:
            raise self._document.error(element, str(error)) from None
        comparison = f"{left} {OPERATORS[rule]} {right}"
        formula = Formula(comparison)
        return comparison if formula.names else bool(formula.evaluate({}))

    def _same_text(
        self, declaration: Declaration, rule: str, text: str, element: Element, chosen: Mapping[str, str]
    ) -> bool:
        if rule not in ("equalTo", "notEqualTo") or is_reference(text):
            raise self._document.error(
                element, f"expected a {declaration.type} equalTo or notEqualTo a literal value"
            )
        expected = literal(self._document, element, declaration.type, text)
        value = chosen.get(declaration.name, self._fixed.get(declaration.name, declaration.value))
        if is_reference(value):
            raise self._document.error(
                element, f"expected a literal value of {declaration.name}, got {value!r:.80}"
            )
        value = literal(self._document, element, declaration.type, value)
        return (value == expected) is (rule == "equalTo")

    def _formula_of(self, name: str, chosen: Mapping[str, str], above: tuple[str, ...]) -> str:
        """Return the formula of a parameter's value: a name of the search space, a number, or an expression."""
        if name not in self._declared:
            raise ExpressionError(
                f"no parameter is called {name!r:.80}{nearest(name, tuple(self._declared))}"
            )
        declaration = self._declared[name]
        if declaration.type not in NUMBERS:
            raise ExpressionError(f"expected numbers, but {name} is a {declaration.type}")
        if name in above:
            raise ExpressionError(f"expected values that do not depend on themselves, as {name} does")
        for axis in self._axes.values():
            if name in axis.placeholders and not axis.rows:
                return axis.name
        value = chosen.get(name, self._fixed.get(name, declaration.value))
        return number_formula(value, lambda other: self._formula_of(other, chosen, (*above, name)))

    def _decided(self, condition: str) -> str | bool:
        """Return whether a condition on one number holds everywhere or nowhere in its range; else the condition."""
        formula = Formula(condition)
        if len(formula.names) != 1 or (points := self._points(formula)) is None:
            return condition
        holds = np.broadcast_to(formula.evaluate({formula.names[0]: points}), points.shape)
        return True if holds.all() else condition if holds.any() else False

    def _points(self, formula: Formula) -> np.ndarray[Any, np.dtype[np.float64]] | None:
        """Return values of a number at which a condition shows all that it does; None if that is unknown."""
        declared = self._axes[formula.names[0]].declared
        low, high, step = (float(declared.get(key, 0.0)) for key in ("min", "max", "step"))
        if step and (high - low) / step <= MAX_VALUES:
            return np.linspace(low, high, round((high - low) / step) + 1)
        edges = _thresholds(formula)
        if edges is None:
            return None
        inner = np.array(sorted({low, high, *(edge for edge in edges if low < edge < high)}))
        return np.concatenate([inner, (inner[1:] + inner[:-1]) / 2])


def _thresholds(formula: Formula) -> list[float] | None:
    """Return the numbers with which a condition compares its only name; None if it has other terms."""
    (name,) = formula.names
    edges = []
    for part in formula.text.replace("(", " ").replace(")", " ").replace(" and ", " or ").split(" or "):
        words = part.split()
        try:
            left, _, right = words
            edges.append(float(right))
        except ValueError:
            return None
        if left != name:
            return None
    return edges


def _end(word: str, value: float) -> str:
    return "" if math.isinf(value) else f"{word} {value:g}"


def _bounds(document: Document, declaration: Declaration) -> tuple[tuple[str, ...], float, float]:
    """Return the values that the constraints of a parameter list, or the ends that all its alternatives leave."""
    values: list[str] = []
    ends: list[tuple[float, float]] = []
    for group in declaration.groups:
        low, high = -math.inf, math.inf
        equal: str | None = None
        for rule, text, element in group:
            if is_reference(text):
                continue
            if rule == "equalTo":
                equal = literal(document, element, declaration.type, text)
            if declaration.type not in NUMBERS or rule == "notEqualTo":
                continue
            limit = number(document, element, "double", text.strip())
            whole = declaration.type in WHOLE
            if rule in ("greaterThan", "greaterOrEqual"):
                if whole:
                    limit = math.floor(limit) + 1 if rule == "greaterThan" else math.ceil(limit)
                low = max(low, limit)
            elif rule in ("lessThan", "lessOrEqual"):
                if whole:
                    limit = math.ceil(limit) - 1 if rule == "lessThan" else math.floor(limit)
                high = min(high, limit)
        if equal is not None:
            values.append(equal)
        ends.append((low, high))
    if declaration.groups and len(values) == len(declaration.groups):
        return tuple(dict.fromkeys(values)), -math.inf, math.inf
    return (
        (),
        min((low for low, _ in ends), default=-math.inf),
        max((high for _, high in ends), default=math.inf),
    )


def _evenly_spaced(declaration: Declaration, values: Sequence[str]) -> tuple[float, float, float] | None:
    """Return the smallest value, the largest and the step of at least three numbers; None if there are other gaps."""
    if declaration.type not in NUMBERS or len(values) < 3:
        return None
    numbers = sorted(Decimal(value) for value in values)
    steps = {second - first for first, second in itertools.pairwise(numbers)}
    if len(steps) != 1 or 0 in steps:
        return None
    return float(numbers[0]), float(numbers[-1]), float(steps.pop())


def _wished(declaration: Declaration, text: str, document: Document) -> Variation:
    """Return what an option says of a parameter: ``LOW:HIGH``, ``LOW:HIGH:STEP`` or ``VALUE,VALUE``.

    Raises:
        InvalidInput: It is none of these, or its values are not of the parameter's type.
    """
    name, kind = declaration.name, declaration.type
    expected = (
        f"{name}: expected LOW:HIGH, LOW:HIGH:STEP or VALUE,VALUE of the type {kind}, got {text!r:.80}"
        if kind in NUMBERS
        else f"{name}: expected VALUE,VALUE of the type {kind}, got {text!r:.80}"
    )
    parts = text.split(":") if kind in NUMBERS and ":" in text else []
    try:
        if parts:
            low, high, *steps = (number(document, declaration.element, kind, one.strip()) for one in parts)
            if low < high and len(steps) < 2 and all(0 < one <= high - low for one in steps):
                numbers = {"step": steps[0]} if steps else {}
                return Variation(
                    kind="steps", element=declaration.element, numbers=numbers, low=low, high=high
                )
        else:
            values = [literal(document, declaration.element, kind, one.strip()) for one in text.split(",")]
            if len(set(values)) == len(values):
                return Variation(kind="set", element=declaration.element, values=tuple(values))
    except InvalidInput:
        pass
    except ValueError:
        pass
    raise InvalidInput.at("--range", expected)

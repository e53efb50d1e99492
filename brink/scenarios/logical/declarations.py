"""The parameters that an OpenSCENARIO file declares: types, values and constraints."""

import math
import re
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from brink.scenarios.logical.document import Document, Element
from brink.scenarios.logical.expressions import is_reference
from brink.sim.episode import nearest

WHOLE: Final = {
    "integer": (-(2**31), 2**31 - 1),
    "int": (-(2**31), 2**31 - 1),
    "unsignedInt": (0, 2**32 - 1),
    "unsignedShort": (0, 2**16 - 1),
}
"""Smallest and largest value of each type of whole numbers."""
NUMBERS: Final = (*WHOLE, "double")
TYPES: Final = (*NUMBERS, "boolean", "string", "dateTime")
OPERATORS: Final = {
    "equalTo": "==",
    "notEqualTo": "!=",
    "greaterThan": ">",
    "greaterOrEqual": ">=",
    "lessThan": "<",
    "lessOrEqual": "<=",
}
"""Rules of constraints, and the comparisons of formulas that they are."""
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TRUTH: Final = {"true": "true", "1": "true", "false": "false", "0": "false"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Declaration:
    """A declared parameter.

    Attributes:
        name: Its name.
        type: Its type, one of `TYPES`.
        value: Its value as it is written: a literal, or an expression that refers to other parameters.
        groups: Its groups of constraints, each a list of rule and value with its element. It must meet all of one
            group.
        element: Where it is declared.
    """

    name: str
    type: str
    value: str
    groups: tuple[tuple[tuple[str, str, Element], ...], ...]
    element: Element

    @property
    def is_derived(self) -> bool:
        """Whether its value follows from those of other parameters."""
        return is_reference(self.value)


def declarations_of(document: Document) -> dict[str, Declaration]:
    """Return the parameters of a scenario, by name, in the order of the file.

    Parameters of a story, a manoeuvre or a catalogue are not the scenario's: nothing outside sets them.

    Raises:
        InvalidInput: A declaration is malformed, or a name is declared twice.
    """
    group = document.root.first("ParameterDeclarations")
    declared: dict[str, Declaration] = {}
    for element in [] if group is None else group.all("ParameterDeclaration"):
        name = document.attribute(element, "name")
        kind = document.attribute(element, "parameterType")
        if not _NAME.fullmatch(name):
            raise document.error(element, f"expected a name of letters, digits and _, got {name!r:.80}")
        if name in declared:
            first = declared[name].element.line
            raise document.error(element, f"expected each name once; line {first} declares it as well")
        if kind not in TYPES:
            raise document.error(
                element,
                f"expected a parameterType of {', '.join(TYPES)}; got {kind!r:.40}{nearest(kind, TYPES)}",
            )
        value = document.attribute(element, "value")
        declaration = Declaration(
            name=name,
            type=kind,
            value=value,
            groups=tuple(_group(document, one) for one in element.all("ConstraintGroup")),
            element=element,
        )
        if not declaration.is_derived:
            literal(document, element, kind, value)
        declared[name] = declaration
    return declared


def _group(document: Document, group: Element) -> tuple[tuple[str, str, Element], ...]:
    constraints = []
    for element in group.all("ValueConstraint"):
        rule = document.attribute(element, "rule")
        if rule not in OPERATORS:
            raise document.error(element, f"expected a rule of {', '.join(OPERATORS)}; got {rule!r:.40}")
        constraints.append((rule, document.attribute(element, "value"), element))
    if not constraints:
        raise document.error(group, "expected at least one ValueConstraint")
    return tuple(constraints)


def literal(document: Document, element: Element, kind: str, text: str) -> str:
    """Return a literal value of a type, without spaces around it.

    Args:
        document: The file.
        element: The element with the value.
        kind: The type, one of `TYPES`.
        text: The value.

    Raises:
        InvalidInput: It is no value of the type.
    """
    stripped = text.strip()
    if kind == "string":
        if not text.isprintable():
            raise document.error(element, f"expected a string without control characters, got {text!r:.80}")
        return text
    if kind == "boolean" and stripped in _TRUTH:
        return _TRUTH[stripped]
    if kind in NUMBERS:
        number(document, element, kind, stripped)
        return stripped
    if kind == "dateTime":
        try:
            datetime.fromisoformat(stripped)
        except ValueError:
            pass
        else:
            return stripped
    raise document.error(element, f"expected a value of the type {kind}, got {text!r:.80}")


def number(document: Document, element: Element, kind: str, text: str) -> float:
    """Return a finite number of a type, an int for whole numbers.

    Raises:
        InvalidInput: It is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        raise document.error(element, f"expected a finite number, got {text!r:.80}")
    if kind in WHOLE:
        low, high = WHOLE[kind]
        if value != int(value) or not low <= value <= high:
            raise document.error(element, f"expected a whole number of the type {kind}, got {text!r:.80}")
        return int(value)
    return value

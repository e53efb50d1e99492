"""Formulas that users write, such as ``gap > 2 * speed / 3.6``: arithmetic and comparisons, never executed as code.

A formula is either a number (``rel_dist - 4.5``) or a condition (``gap > 1.5 and not braking > 0``). It consists of
numbers, names, ``+ - * / % **``, comparisons (chained ones too), ``and``, ``or``, ``not``, parentheses and the
functions in `FUNCTIONS`. A name may have dots (``scenario.speed``); any other name stands between backticks. A name
may be compared with a text: ``weather == "wet"``. Python's parser reads the formula; whatever else it contains is
refused.

Values are floats, or arrays of one shape: constraints of search spaces, columns of logs and predicates of
requirements are all evaluated here, so every layer may import this module.
"""

import ast
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Input: TypeAlias = "float | str | NDArray[Any]"
Step: TypeAlias = tuple[Literal["value", "name", "call"], Any]
"""A constant, the value of a name, or an `_Operation` on what the steps before it left."""

FUNCTIONS: Final[Mapping[str, np.ufunc]] = {
    **{
        name: getattr(np, name)
        for name in ("sqrt", "exp", "log", "log10", "sin", "cos", "tan", "hypot", "floor")
    },
    **{"abs": np.abs, "atan2": np.arctan2, "min": np.minimum, "max": np.maximum},
}
"""Functions by name; ``min`` and ``max`` take two or more arguments."""

MOST_CHARACTERS: Final = 1_000
_MOST_LEVELS: Final = 100
_QUOTED: Final = re.compile(r"`([^`]+)`")


class FormulaError(ValueError):
    """A formula is not one, or a value that it needs is missing; the message quotes the formula."""


@dataclass(frozen=True, slots=True)
class _Operation:
    """A step of a formula: what it computes, and what its margin is computed by."""

    arity: int
    value: Callable[..., Any]
    margin: Callable[..., Any]


_ARITHMETIC: Final[Mapping[type[ast.AST], np.ufunc]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Mod: np.mod,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
}
_COMPARISONS: Final[Mapping[type[ast.AST], _Operation]] = {
    ast.Gt: _Operation(2, operator.gt, np.subtract),
    ast.GtE: _Operation(2, operator.ge, np.subtract),
    ast.Lt: _Operation(2, operator.lt, lambda a, b: b - a),
    ast.LtE: _Operation(2, operator.le, lambda a, b: b - a),
    ast.Eq: _Operation(2, operator.eq, lambda a, b: -np.abs(a - b)),
    ast.NotEq: _Operation(2, operator.ne, lambda a, b: np.abs(a - b)),
}
_SAME_TEXT: Final[Mapping[type[ast.AST], _Operation]] = {
    ast.Eq: _Operation(2, operator.eq, lambda a, b: np.where(np.equal(a, b), np.inf, -np.inf)[()]),
    ast.NotEq: _Operation(2, operator.ne, lambda a, b: np.where(np.equal(a, b), -np.inf, np.inf)[()]),
}
_AND: Final = _Operation(2, np.logical_and, np.minimum)
_OR: Final = _Operation(2, np.logical_or, np.maximum)
_NOT: Final = _Operation(1, np.logical_not, np.negative)


@dataclass(frozen=True, slots=True)
class Formula:
    """A parsed formula. Two formulas are equal if their texts are.

    Attributes:
        text: As it was written.
        is_condition: Whether it holds or not; otherwise it is a number.
        names: The names in it, in the order of their first appearance.
        texts: The texts with which names are compared, by name.
    """

    text: str
    is_condition: bool = field(init=False, compare=False)
    names: tuple[str, ...] = field(init=False, compare=False)
    texts: Mapping[str, frozenset[str]] = field(init=False, compare=False, repr=False)
    _steps: tuple[Step, ...] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        parser = _Parser(self.text)
        object.__setattr__(self, "is_condition", parser.is_condition)
        object.__setattr__(self, "_steps", tuple(parser.steps))
        names = dict.fromkeys(str(content) for kind, content in parser.steps if kind == "name")
        object.__setattr__(self, "names", tuple(names))
        object.__setattr__(self, "texts", {name: frozenset(texts) for name, texts in parser.texts.items()})

    def evaluate(self, values: Mapping[str, Input]) -> Any:
        """Return the number, or whether the condition holds: a scalar, or an array of the values' shape.

        Like arithmetic on arrays, this divides by zero without an error; NaN is neither above nor below anything.

        Args:
            values: Numbers, texts or arrays of them by name.

        Raises:
            FormulaError: A value is missing, or is a text where a number is expected.
        """
        return self._run(values, lambda operation: operation.value)

    def margin(self, values: Mapping[str, Input]) -> Any:
        """Return by how much a condition holds; negative if it does not hold.

        The margin of a comparison is the difference of its sides; that of ``and`` is the smaller, that of ``or`` the
        larger of both margins (the quantitative semantics of signal temporal logic). A text is equal or different by
        infinity. At 0, `evaluate` decides.

        Args:
            values: As for `evaluate`.

        Raises:
            FormulaError: As for `evaluate`.
        """
        return self._run(values, lambda operation: operation.margin)

    def _run(self, values: Mapping[str, Input], which: Callable[[_Operation], Callable[..., Any]]) -> Any:
        stack: list[Any] = []
        with np.errstate(all="ignore"):
            for kind, content in self._steps:
                if kind == "call":
                    arguments = stack[len(stack) - content.arity :]
                    del stack[len(stack) - content.arity :]
                    stack.append(which(content)(*arguments))
                else:
                    stack.append(self._looked_up(content, values) if kind == "name" else content)
        return stack.pop()

    def _looked_up(self, name: str, values: Mapping[str, Input]) -> Any:
        if name not in values:
            raise FormulaError(f"{self.text!r}: no value for {name!r}")
        if name in self.texts:
            return values[name]
        try:
            return np.asarray(values[name], np.float64)[()]
        except ValueError:
            raise FormulaError(
                f"{self.text!r}: expected a number for {name!r}, got {values[name]!r}"
            ) from None


class _Parser:
    """Turns the text of a formula into steps in postfix order, which take no recursion to evaluate."""

    def __init__(self, text: object) -> None:
        if not isinstance(text, str) or not text.strip():
            raise FormulaError(f"expected a formula such as 'gap > 2 * speed', got {text!r}")
        if len(text) > MOST_CHARACTERS:
            raise FormulaError(f"expected a formula of at most {MOST_CHARACTERS} characters, got {len(text)}")
        self.text = text
        self.steps: list[Step] = []
        self.texts: dict[str, set[str]] = {}
        self._quoted: dict[str, str] = {}
        self._source = _QUOTED.sub(self._placeholder, text.strip())
        try:
            tree = ast.parse(self._source, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            reason = error.msg if isinstance(error, SyntaxError) else type(error).__name__
            raise self._refusal(f"cannot be read ({reason})") from None
        self.is_condition = self._add(tree, 0)

    def _placeholder(self, match: re.Match[str]) -> str:
        name = f"_quoted_{len(self._quoted)}_"
        self._quoted[name] = match[1]
        return name

    def _written(self, node: ast.expr) -> str:
        # Not ast.unparse: it recurses, and what is refused may be nested deeply.
        source = ast.get_source_segment(self._source, node) or ""
        return re.sub(r"_quoted_\d+_", lambda match: f"`{self._quoted.get(match[0], match[0])}`", source)

    def _refusal(self, what: str) -> FormulaError:
        return FormulaError(
            f"{self.text!r}: {what}; a formula has numbers, names, + - * / % **, comparisons, and, or, not, "
            f"and the functions {', '.join(sorted(FUNCTIONS))}"
        )

    def _add(self, node: ast.expr, level: int) -> bool:
        """Add the steps of an expression; return whether it is a condition."""
        if level > _MOST_LEVELS:
            raise self._refusal(f"has more than {_MOST_LEVELS} operations within each other")
        match node:
            case ast.Constant(value=bool()):
                raise self._refusal(f"{node.value!r} is not a number")
            case ast.Constant(value=int() | float() as number):
                self.steps.append(("value", self._float(number)))
            case ast.Name() | ast.Attribute():
                self.steps.append(("name", self._name(node)))
            case ast.BinOp() if type(node.op) in _ARITHMETIC:
                self._call(_ARITHMETIC[type(node.op)], [node.left, node.right], level)
            case ast.UnaryOp() if type(node.op) in _ARITHMETIC:
                self._call(_ARITHMETIC[type(node.op)], [node.operand], level)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
                self._function(name, arguments, level)
            case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                self._condition(node, level)
                return True
            case _:
                raise self._refusal(f"{self._written(node)} is not allowed")
        return False

    def _float(self, number: float) -> np.float64:
        try:
            return np.float64(number)
        except OverflowError:
            raise self._refusal("has a number that a float cannot hold") from None

    def _name(self, node: ast.expr) -> str:
        dotted, inner = [], node
        while isinstance(inner, ast.Attribute):
            dotted.append(inner.attr)
            inner = inner.value
        if not isinstance(inner, ast.Name):
            raise self._refusal(f"{self._written(node)} is not a name")
        return ".".join([self._quoted.get(inner.id, inner.id), *reversed(dotted)])

    def _numbers(self, operands: list[ast.expr], level: int) -> None:
        for operand in operands:
            if self._add(operand, level + 1):
                raise self._refusal(f"expected a number, got the condition {self._written(operand)}")

    def _call(self, ufunc: np.ufunc, operands: list[ast.expr], level: int) -> None:
        self._numbers(operands, level)
        self.steps.append(("call", _Operation(len(operands), ufunc, ufunc)))

    def _function(self, name: str, arguments: list[ast.expr], level: int) -> None:
        ufunc, count = FUNCTIONS[name], len(arguments)
        if count != ufunc.nin and not (name in ("min", "max") and count > 2):
            raise self._refusal(f"{name} takes {ufunc.nin} arguments, got {count}")
        self._call(ufunc, arguments[: ufunc.nin], level)
        for argument in arguments[ufunc.nin :]:
            self._numbers([argument], level)
            self.steps.append(("call", _Operation(2, ufunc, ufunc)))

    def _condition(self, node: ast.Compare | ast.BoolOp | ast.UnaryOp, level: int) -> None:
        if isinstance(node, ast.Compare):
            self._compare(node, level)
            return
        parts = [node.operand] if isinstance(node, ast.UnaryOp) else node.values
        for place, part in enumerate(parts):
            if not self._add(part, level + 1):
                raise self._refusal(
                    f"expected a comparison beside and, or, not, got the number {self._written(part)}"
                )
            if place:
                assert isinstance(node, ast.BoolOp)
                self.steps.append(("call", _AND if isinstance(node.op, ast.And) else _OR))
        if isinstance(node, ast.UnaryOp):
            self.steps.append(("call", _NOT))

    def _compare(self, node: ast.Compare, level: int) -> None:
        sides = [node.left, *node.comparators]
        for place, kind in enumerate(map(type, node.ops)):
            pair = sides[place : place + 2]
            if any(isinstance(side, ast.Constant) and isinstance(side.value, str) for side in pair):
                self._compare_text(kind, pair)
            elif kind in _COMPARISONS:
                self._numbers(pair, level)
                self.steps.append(("call", _COMPARISONS[kind]))
            else:
                raise self._refusal(f"{self._written(node)} is not allowed")
            if place:
                self.steps.append(("call", _AND))

    def _compare_text(self, kind: type[ast.AST], pair: list[ast.expr]) -> None:
        if kind not in _SAME_TEXT:
            raise self._refusal("texts can only be compared by == and !=")
        texts = [
            side.value for side in pair if isinstance(side, ast.Constant) and isinstance(side.value, str)
        ]
        for side in pair:
            if isinstance(side, ast.Constant) and isinstance(side.value, str):
                self.steps.append(("value", side.value))
            else:
                self.steps.append(("name", name := self._name(side)))
                self.texts.setdefault(name, set()).update(texts)
        self.steps.append(("call", _SAME_TEXT[kind]))

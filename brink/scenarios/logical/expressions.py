"""Translates expressions of OpenSCENARIO, such as ``${($speed - 5) / 3.6}``, into formulas of `brink.formula`."""

import ast
import re
from collections.abc import Callable
from typing import Final

_EXPRESSION: Final = re.compile(r"\$\{(.*)\}", re.DOTALL)
_REFERENCE: Final = re.compile(r"\$([A-Za-z_][A-Za-z0-9_]*)")
_PREFIX: Final = "parameter_"
_SAME: Final = frozenset({"floor", "sqrt", "sin", "cos", "tan", "abs", "max", "min"})
_OPERATORS: Final = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod)
_MAX_CHARACTERS: Final = 1_000


class ExpressionError(ValueError):
    """An expression has no formula; the message quotes it."""


def is_reference(text: str) -> bool:
    """Return whether a value refers to parameters or is an expression, rather than a literal."""
    return "$" in text


def number_formula(text: str, value_of: Callable[[str], str]) -> str:
    """Return the formula of a number.

    Args:
        text: A number, a reference such as ``$speed``, or an expression such as ``${-$speed / 3.6}``.
        value_of: Returns the formula of a parameter's value.

    Raises:
        ExpressionError: It is none of these, or has an operator that formulas lack.
    """
    inner = match[1] if (match := _EXPRESSION.fullmatch(text.strip())) else text.strip()
    try:
        if len(inner) > _MAX_CHARACTERS:
            raise ExpressionError(f"expected an expression of at most {_MAX_CHARACTERS} characters")
        tree = ast.parse(_REFERENCE.sub(rf"{_PREFIX}\1", inner), mode="eval").body
        return ast.unparse(_Translator(text, value_of).visit(tree))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, ExpressionError):
            raise
        raise ExpressionError(f"expected a number, a parameter or an expression, got {text!r:.80}") from None


class _Translator(ast.NodeTransformer):
    def __init__(self, text: str, value_of: Callable[[str], str]) -> None:
        self._text = text
        self._value_of = value_of

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Refuse whatever has no method of its own."""
        raise ExpressionError(
            f"expected numbers, parameters, + - * / %, and round, floor, ceil, sqrt, pow, sin, cos, tan, atan, abs, "
            f"max or min, got {self._text!r:.80}"
        )

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        """Return a number as it is."""
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            self.generic_visit(node)
        return ast.Constant(float(node.value))  # type: ignore[arg-type]

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Return the formula of a parameter's value."""
        if not node.id.startswith(_PREFIX):
            self.generic_visit(node)
        return ast.parse(self._value_of(node.id.removeprefix(_PREFIX)), mode="eval").body

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """Return a number with a sign."""
        if not isinstance(node.op, ast.USub | ast.UAdd):
            self.generic_visit(node)
        return ast.UnaryOp(node.op, self.visit(node.operand))

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Return an arithmetic operation."""
        if not isinstance(node.op, _OPERATORS):
            self.generic_visit(node)
        return ast.BinOp(self.visit(node.left), node.op, self.visit(node.right))

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Return a function, or the operations that compute it."""
        name = node.func.id if isinstance(node.func, ast.Name) and not node.keywords else ""
        arguments = [self.visit(one) for one in node.args]
        match name, arguments:
            case "pow", [base, exponent]:
                return ast.BinOp(base, ast.Pow(), exponent)
            case "ceil", [one]:
                return ast.UnaryOp(ast.USub(), _call("floor", ast.UnaryOp(ast.USub(), one)))
            case "round", [one]:
                return _call("floor", ast.BinOp(one, ast.Add(), ast.Constant(0.5)))
            case "atan", [one]:
                return _call("atan2", one, ast.Constant(1.0))
        if name not in _SAME:
            self.generic_visit(node)
        return _call(name, *arguments)


def _call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name), list(arguments), [])

"""Writes docs/reference/python.md from the docstrings of everything that ``brink`` and ``brink.guard`` offer.

Run as ``make reference``.
"""

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any, Final

from griffe import Docstring, DocstringSectionKind

import brink
import brink.guard
from brink.python.client import Submitted
from brink.python.function import search
from brink.python.picture import Picture

PAGE: Final = Path(__file__).parents[2] / "docs" / "reference" / "python.md"
GROUPS: Final = {
    "Running campaigns": ["run", "connect", "Campaign"],
    "Results": ["Result", "Picture"],
    "Suites": ["Suite"],
    "A coordinator's campaigns": ["Client", "Submitted"],
    "Functions and loops of your own": ["search", "Study", "Trial", "Real", "Integer", "Categorical"],
    "Guards": [
        "guard.random_specs",
        "guard.solution_specs",
        "guard.record",
        "guard.evaluate",
        "guard.Drive",
        "guard.GuardEvaluation",
        "guard.GuardedLoop",
        "guard.fit",
        "guard.drive_with_guard",
    ],
    "Asynchronous counterparts": ["run_async", "search_async", "connect_async", "AsyncClient", "AsyncResult"],
}
"""Names by heading, in the order of the page; the last group is a list."""
_NOT_EXPORTED: Final[dict[str, type]] = {"Picture": Picture, "Submitted": Submitted}
"""Classes of what functions return, which users do not import."""
_RETURNED: Final = frozenset({"Client", "Submitted", "Result", "Picture", "Trial"})
"""Classes that users do not construct, so that their signature does not matter."""
_VALUES: Final = frozenset({"Trial", "Real", "Integer", "Categorical"})
"""Classes of which users need the fields alone."""
_OBVIOUS: Final = frozenset({"problem", "algorithm", "simulations", "name", "workers", "progress", "drives"})
"""Arguments whose names say enough."""
_EXPLAINED: Final = frozenset({"check_pairs", "plot", "tell", "guard.fit", "guard.drive_with_guard"})
"""Methods whose arguments are described, and what of guards is more than a line."""
_INTRODUCTION: Final = """# Python

`make reference` writes this page from the docstrings. `help(brink.run)` and the like show them in full, with all
arguments, errors and examples; arguments that explain themselves, or mean the same as above, are left out here. [Use
Brink from Python](../how-to/use-brink-from-python.md) shows how the parts go together.

`import brink` imports nothing else until a name is first used. Guards need `import brink.guard`. All errors are
subclasses of `brink.server.errors.ServerError`, `brink.search.errors.SearchError` or, for guards,
`brink.sim.errors.SimulatorError`.
"""
_LISTS: Final = (DocstringSectionKind.parameters, DocstringSectionKind.attributes)


def page() -> str:
    """Return the content of the page."""
    *groups, last = GROUPS.items()
    parts = [_INTRODUCTION]
    described: set[str] = set()
    for heading, names in groups:
        parts.append(f"## {heading}\n")
        parts += [_entry(name, described) for name in names]
    heading, names = last
    parts.append(f"## {heading}\n")
    parts += [f"- `brink.{name}`: {_summary(_object(name))}" for name in names]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(parts)).rstrip() + "\n"


def _object(name: str) -> Any:
    if name in _NOT_EXPORTED:
        return _NOT_EXPORTED[name]
    if name == "search":  # `brink.search` is the package, which can be called like the function
        return search
    if name.startswith("guard."):
        return getattr(brink.guard, name.removeprefix("guard."))
    return getattr(brink, name)


def _entry(name: str, described: set[str]) -> str:
    """Return the section of a function or a class; arguments that are in `described` are left out."""
    of = _object(name)
    if name.startswith("guard.") and name not in _EXPLAINED:
        shown = f"brink.{name}" if isinstance(of, type) else _signature(of, f"brink.{name}")
        return f"- `{shown}`: {_summary(of)}"
    shown = name if name in _NOT_EXPORTED else f"brink.{name}"
    parts = [f"\n### `{shown}`\n"]  # a list may precede it
    if name not in _RETURNED:
        parts.append(f"```python\n{_signature(of, shown)}\n```\n")
    parts.append(_opening(of) + "\n")
    rows = _described(of)
    if name not in _RETURNED:
        obvious = tuple(f"- `{argument}`:" for argument in _OBVIOUS)
        rows = [row for row in rows if row not in described and not row.startswith(obvious)]
        described.update(rows)
    if isinstance(of, type) and name not in _VALUES:
        rows += [row for base in _bases(of) for row in _described(base)]
        rows += [f"- `.{member}`: {_summary(value)}" for member, value in _members(of, property)]
        rows += [row for member, value in _members(of, Callable) for row in _method(member, value)]
    if rows:
        parts.append("\n".join(rows) + "\n")
    return "\n".join(parts)


def _bases(of: type) -> list[type]:
    """Return the base classes from this package, the most general first."""
    return [base for base in reversed(of.__mro__[1:]) if base.__module__.startswith("brink.")]


def _members(of: type, kind: Any) -> Iterator[tuple[str, Any]]:
    """Yield the public members of one kind, those of base classes first."""
    for base in [*_bases(of), of]:
        for name, member in vars(base).items():
            value = getattr(base, name) if isinstance(member, classmethod | staticmethod) else member
            if not name.startswith("_") and isinstance(value, kind):
                yield name, value


def _method(name: str, method: Any) -> Iterator[str]:
    yield f"- `.{_signature(method, name)}`: {_summary(method)}{_returns(method)}"
    if name in _EXPLAINED:
        yield from (f"  {row}" for row in _described(method))


def _signature(of: Any, name: str) -> str:
    shown = []
    parameters = [one for one in inspect.signature(of).parameters.values() if one.name not in ("self", "cls")]
    for parameter in parameters:
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in shown:
            shown.append("*")
        shown.append(parameter.name + _default(of, parameter))
    return f"{name}({', '.join(shown)})"


def _default(of: Any, parameter: inspect.Parameter) -> str:
    if parameter.default is parameter.empty:
        return ""
    if dataclasses.is_dataclass(of):
        factory = of.__dataclass_fields__[parameter.name].default_factory
        if factory is not dataclasses.MISSING:
            return f"={factory()!r}"
    if isinstance(parameter.default, Enum):
        return f"={parameter.default.value!r}"
    return f"={parameter.default!r}"


def _sections(of: Any) -> Iterator[tuple[DocstringSectionKind, Any]]:
    for section in Docstring(inspect.getdoc(of) or "").parse("google", warnings=False):
        yield section.kind, section.value


def _opening(of: Any) -> str:
    """Return the docstring up to its first section."""
    return next(str(text) for kind, text in _sections(of) if kind is DocstringSectionKind.text)


def _summary(of: Any) -> str:
    return _one_line(_opening(of).split("\n\n")[0])


def _described(of: Any) -> list[str]:
    """Return a row for each argument or attribute that a docstring describes."""
    values = [value for kind, value in _sections(of) if kind in _LISTS]
    return [f"- `{one.name}`: {_one_line(one.description)}" for value in values for one in value]


def _returns(of: Any) -> str:
    """Return what a docstring says of the result; empty if it says nothing."""
    values = [value for kind, value in _sections(of) if kind is DocstringSectionKind.returns]
    lines = [one.description for value in values for one in value]  # the parser takes each line for a value
    return f" Returns: {_one_line(' '.join(lines))}" if lines else ""


def _one_line(text: str) -> str:
    return " ".join(text.split())


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

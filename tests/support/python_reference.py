"""Writes docs/reference/python.md from the docstrings of everything that ``brink`` and ``brink.guard`` offer.

Run as ``make reference``.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Final

from griffe import Attribute, Class, Docstring, DocstringSectionKind, Function, Module, Object, load

from brink.server.campaigns import body

_PACKAGE: Final = Path(__file__).parents[2] / "brink"
PAGE: Final = Path(__file__).parents[2] / "docs" / "reference" / "python.md"
GROUPS: Final = {
    "Running campaigns": ["run", "connect", "Campaign"],
    "Results": ["Result", "Picture"],
    "A coordinator's campaigns": ["Client", "Submitted"],
    "Functions and loops of your own": ["search", "Study", "Trial", "Real", "Integer", "Categorical"],
    "Asynchronous twins": [
        "run_async",
        "search_async",
        "connect_async",
        "AsyncClient",
        "AsyncSubmitted",
        "AsyncResult",
    ],
    "Guards": [
        "guard.random_specs",
        "guard.solution_specs",
        "guard.record",
        "guard.fit",
        "guard.evaluate",
        "guard.drive_with_guard",
        "guard.Drive",
        "guard.GuardEvaluation",
        "guard.GuardedLoop",
    ],
}
"""Names by heading, in the order of the page."""
_HOMES: Final = {
    "run": "python/local",
    "run_async": "python/local",
    "connect": "python/client",
    "connect_async": "python/client",
    "Client": "python/client",
    "AsyncClient": "python/client",
    "Submitted": "python/client",
    "AsyncSubmitted": "python/client",
    "Campaign": "python/campaign",
    "Result": "python/result",
    "AsyncResult": "python/result",
    "Picture": "python/picture",
    "search": "python/function",
    "search_async": "python/function",
    "Study": "python/study",
    "Trial": "python/study",
    "guard.random_specs": "guard/drives",
    "guard.solution_specs": "guard/drives",
    "guard.record": "guard/drives",
    "guard.fit": "guard/fitting",
    "guard.evaluate": "guard/evaluation",
    "guard.drive_with_guard": "guard/loop",
    "guard.Drive": "guard/drives",
    "guard.GuardEvaluation": "guard/evaluation",
    "guard.GuardedLoop": "guard/loop",
}
_BRIEF: Final = frozenset({"AsyncClient", "AsyncSubmitted", "AsyncResult"})
"""Classes whose methods are those of another class."""
_NOT_EXPORTED: Final = frozenset({"Picture", "Submitted", "AsyncSubmitted"})
"""Classes of what functions return, which users do not import."""
_INTRODUCTION: Final = """# Python

This page is written from the docstrings: `make reference` writes it again. [Use Brink from
Python](../how-to/use-brink-from-python.md) shows how the parts go together.

`import brink` imports nothing else until a name is first used; guards need `import brink.guard`. Errors are
subclasses of `brink.server.errors.ServerError`, `brink.search.errors.SearchError` or, for guards,
`brink.sim.errors.SimulatorError`, and their messages say what was expected.
"""


def page() -> str:
    """Return the content of the page."""
    parts = [_INTRODUCTION]
    for heading, names in GROUPS.items():
        parts.append(f"## {heading}\n")
        for name in names:
            home = _module(_HOMES.get(name, "search/parameters"))
            shown = name if name in _NOT_EXPORTED else f"brink.{name}"
            parts.append(_entry(home[name.removeprefix("guard.")], shown))
    return "\n".join(parts).rstrip() + "\n"


@cache
def _module(path: str) -> Module:
    """Return a module of the package, without loading any other."""
    folder, name = path.split("/")
    found = load(name, search_paths=[_PACKAGE / folder], docstring_parser="google", resolve_aliases=False)
    assert isinstance(found, Module)
    return found


def _entry(of: Object, name: str) -> str:
    if isinstance(of, Class):
        return _class(of, name)
    assert isinstance(of, Function)
    return f"### `{name}`\n\n```python\n{_signature(of, name)}\n```\n\n{_words(of.docstring)}"


def _class(of: Class, name: str) -> str:
    parts = [f"### `{name}`\n"]
    init = of.members.get("__init__")
    if isinstance(init, Function) and not of.name.endswith(("Client", "Submitted", "Result")):
        parts.append(f"```python\n{_signature(init, name)}\n```\n")
    parts.append(_words(of.docstring))
    base = _base(of)
    members = [*(base.members.values() if base is not None else ()), *of.members.values()]
    if base is not None and base.docstring is not None:
        parts += [
            f"- `.{attribute.name}`: {attribute.description}"
            for section in base.docstring.parsed
            if section.kind is DocstringSectionKind.attributes
            for attribute in section.value
        ]
    public = [member for member in members if not member.name.startswith("_")]
    parts += [
        f"- `.{member.name}`: {_first(member.docstring)}"
        for member in public
        if isinstance(member, Attribute) and "property" in member.labels
    ]
    parts += [_method(member, brief=of.name in _BRIEF) for member in public if isinstance(member, Function)]
    return "\n".join(parts) + "\n"


def _base(of: Class) -> Class | None:
    """Return the base class whose members a class is shown with; None if there is no such class."""
    if not isinstance(of.parent, Module) or "CampaignResult" not in map(str, of.bases):
        return None
    found = of.parent["CampaignResult"]
    assert isinstance(found, Class)
    return found


def _method(of: Function, *, brief: bool) -> str:
    if brief:
        return f"- `await .{of.name}(…)`: {_first(of.docstring)}"
    return f"\n#### `.{_signature(of, of.name)}`\n\n{_words(of.docstring)}"


def _signature(of: Function, name: str) -> str:
    shown = []
    star = False
    for parameter in of.parameters:
        if parameter.name in ("self", "cls"):
            continue
        if parameter.kind is not None and parameter.kind.name == "keyword_only" and not star:
            shown.append("*")
            star = True
        default = "" if parameter.default is None else f"={_value(str(parameter.default), of)}"
        shown.append(f"{parameter.name}{default}")
    return f"{name}({', '.join(shown)})"


def _value(default: str, of: Function) -> str:
    """Return a default value as people read it, where it is a constant or a factory."""
    if default.endswith("()") and default != "()":
        return {"dict()": "{}"}[default]
    if not default.isupper():
        return default
    path = Path(str(of.filepath)).relative_to(_PACKAGE).with_suffix("")
    home = import_module(".".join(("brink", *path.parts)))
    return str(getattr(home, default, getattr(body, default, default)))


def _first(docstring: Docstring | None) -> str:
    assert docstring is not None
    return docstring.value.strip().splitlines()[0]


def _words(docstring: Docstring | None) -> str:
    """Return a docstring as Markdown."""
    assert docstring is not None
    lines = []
    for section in docstring.parse("google"):
        match section.kind:
            case DocstringSectionKind.text:
                lines.append(f"{section.value}\n")
            case DocstringSectionKind.parameters | DocstringSectionKind.attributes:
                rows = [f"- `{one.name}`: {_one_line(one.description)}" for one in section.value]
                lines.append("\n".join(rows) + "\n")
            case DocstringSectionKind.raises:
                rows = [f"- `{one.annotation}`: {_one_line(one.description)}" for one in section.value]
                lines.append("Raises:\n\n" + "\n".join(rows) + "\n")
            case DocstringSectionKind.returns:
                lines.append(
                    "Returns: " + " ".join(_one_line(one.description) for one in section.value) + "\n"
                )
            case DocstringSectionKind.examples:
                code = "\n".join(text for _, text in section.value)
                lines.append("```python\n" + code + "\n```\n")
            case _:
                lines.append(_example(section.value.contents))
    return "\n".join(lines)


def _example(text: str) -> str:
    return "```python\n" + text + "\n```\n"


def _one_line(text: str) -> str:
    return " ".join(text.split())


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

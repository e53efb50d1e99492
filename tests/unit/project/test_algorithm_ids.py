"""No code asks which algorithm a campaign used: what a search finds, its algorithm declares."""

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("brink", "search", "server", "worker")
ROOT = Path(__file__).parents[3]


def test_nothing_compares_or_lists_ids_of_algorithms_or_asks_what_a_search_looks_for() -> None:
    ids = _algorithm_ids()
    assert ids["Edge.id"] == "edge@1"
    guilty = []
    for file in _sources():
        text = file.read_text()
        if "looks_for_" in text or "searches_for_" in text:
            guilty.append(f"{file}: asks what a search looks for")
        for node in ast.walk(ast.parse(text)):
            listed = [
                one
                for one in _listed(node)
                if (isinstance(one, ast.Constant) and one.value in ids.values()) or ast.unparse(one) in ids
            ]
            guilty += [f"{file}:{one.lineno}: lists {ast.unparse(one)}" for one in listed]
            if isinstance(node, ast.Compare):
                for part in ast.walk(node):
                    constant = isinstance(part, ast.Constant) and part.value in ids.values()
                    if constant or ast.unparse(part) in ids:
                        guilty.append(f"{file}:{node.lineno}: compares {ast.unparse(part)}")
    assert guilty == []


def _listed(node: ast.AST) -> list[ast.expr]:
    """Return the members of a list, and the keys of a dictionary."""
    if isinstance(node, ast.List | ast.Tuple | ast.Set):
        return node.elts
    return [key for key in node.keys if key is not None] if isinstance(node, ast.Dict) else []


def _algorithm_ids() -> dict[str, str]:
    """Return the ids of the algorithms by the expressions that give them, such as ``Edge.id``."""
    return {
        f"{kind.name}.id": ast.literal_eval(line.value)
        for file in (ROOT / "search" / "algorithms").rglob("*.py")
        for kind in ast.walk(ast.parse(file.read_text()))
        if isinstance(kind, ast.ClassDef)
        for line in kind.body
        if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "id"
    }


def _sources() -> Iterator[Path]:
    for package in PACKAGES:
        for file in (ROOT / package).rglob("*.py"):
            linked = any(parent.is_symlink() for parent in file.parents if ROOT in parent.parents)
            if not linked and (ROOT / "search" / "algorithms") not in file.parents:
                yield file

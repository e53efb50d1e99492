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
            listed = [one for one in _listed(node) if _names_algorithm(one, ids)]
            guilty += [f"{file}:{one.lineno}: lists {ast.unparse(one)}" for one in listed]
            if isinstance(node, ast.Compare):
                guilty += [
                    f"{file}:{node.lineno}: compares {ast.unparse(part)}"
                    for part in ast.walk(node)
                    if _names_algorithm(part, ids)
                ]
    assert guilty == []


def test_results_and_their_sentences_name_no_algorithm_and_no_type_of_the_search_for_pairs() -> None:
    ids = _algorithm_ids().values()
    guilty = []
    for file in _sources():
        tree = ast.parse(file.read_text())
        if "algorithms.edge" in "".join(_imported(tree)):
            guilty.append(f"{file}: imports the search for pairs")
        if {"findings", "campaigns"} & set(file.relative_to(ROOT).parts):
            guilty += [
                f"{file}:{node.lineno}: {node.value}"
                for node in ast.walk(tree)
                if isinstance(node, ast.Constant) and isinstance(node.value, str)
                if any(one in node.value for one in ids) and id(node) not in _docstrings(tree)
            ]
    assert guilty == []


def _names_algorithm(node: ast.AST, ids: dict[str, str]) -> bool:
    """Return whether an expression is the id of an algorithm, or an attribute that holds one."""
    if isinstance(node, ast.Constant):
        return node.value in ids.values()
    return isinstance(node, ast.Attribute) and node.attr == "id" and ast.unparse(node) in ids


def _imported(tree: ast.AST) -> Iterator[str]:
    """Yield the names of the modules that a module imports from."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield f"{node.module} "
        elif isinstance(node, ast.Import):
            yield from (f"{one.name} " for one in node.names)


def _docstrings(tree: ast.AST) -> set[int]:
    """Return the identities of the strings that stand alone, as documentation does."""
    return {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}


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

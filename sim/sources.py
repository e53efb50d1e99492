"""The identity of a plug-in's code: the digest of its source.

The id of a plug-in has a version, but authors edit a plug-in without raising it. Results are shared, and campaigns
continued, only among equal ids with equal sources. Brink's own plug-ins have none: their ids alone identify them.

The source of a module is the top-level module or package that it belongs to, and whatever these import from the same
folder, unless that is where packages are installed. An installed distribution lists the digests of its files, data
files among them, which is what counts then.
"""

import hashlib
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import Distribution
from importlib.util import find_spec
from modulefinder import ModuleFinder
from pathlib import Path
from types import CodeType
from typing import Final

OWN: Final = "brink"
_SUFFIXES: Final = (".py", ".pyd", ".so")


def is_own(module: str) -> bool:
    """Return whether a module is part of Brink."""
    return module.partition(".")[0] == OWN


@cache
def module_digest(module: str) -> str:
    """Return `source_digest` as of the first call for a module; call it as soon as a plug-in is imported."""
    return source_digest(module)


def source_digest(module: str) -> str:
    """Return the SHA-256 of a module's source.

    Args:
        module: Name of the module, such as ``my_package.simulator``.

    Returns:
        The digest; that of no file if the module has none, for example in an interactive session.
    """
    return _digest(
        {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in source_files(module).items()}
    )


def modules_digest(modules: Iterable[str]) -> str | None:
    """Return the SHA-256 of the source of several modules; None if all are Brink's or Python's own."""
    foreign = (name for name in modules if not is_own(name))
    others = sorted(name for name in foreign if name.partition(".")[0] not in sys.stdlib_module_names)
    digests = {name: module_digest(name) for name in others}
    return _digest(digests) if len(digests) > 1 else next(iter(digests.values()), None)


def distribution_digest(distribution: Distribution, module: str) -> str:
    """Return the SHA-256 of a module's source in an installed distribution.

    Args:
        distribution: The distribution. If it is installed for editing, it does not list the module's files.
        module: Name of the module.
    """
    top = module.partition(".")[0]
    recorded = {
        file.as_posix(): file.hash.value
        for file in distribution.files or ()
        if file.hash is not None and file.parts[0] in (top, f"{top}.py")
    }
    if not recorded:
        return module_digest(module)
    return _digest({f"{distribution.name} {distribution.version}": "", **recorded})


def _digest(digests: Mapping[str, str]) -> str:
    lines = [f"{name} {digest}\n" for name, digest in sorted(digests.items())]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def source_files(module: str) -> dict[str, Path]:
    """Return the files of a module's source, by their paths below the folder that contains it.

    Args:
        module: Name of the module.
    """
    top = module.partition(".")[0]
    beside, files = _place(top)
    if beside is None:
        return {}
    found: dict[str, Path] = {}
    waiting = list(files)
    installed = any(beside.glob("*.dist-info"))
    while waiting:
        file = waiting.pop()
        name = file.relative_to(beside).as_posix() if file.is_relative_to(beside) else file.as_posix()
        if name in found:
            continue
        found[name] = file
        if file.suffix == ".py" and not installed:
            for imported in _imports(file):
                waiting += _files_of(beside, imported)
    return found


def _place(top: str) -> tuple[Path | None, list[Path]]:
    """Return the folder that contains a top-level module or package, and its files."""
    if top == "__main__":
        file = getattr(sys.modules[top], "__file__", None)
        return (None, []) if file is None else (Path(file).resolve().parent, [Path(file).resolve()])
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return None, []
    if spec is None:
        return None, []
    if spec.submodule_search_locations:
        folders = [Path(folder).resolve() for folder in spec.submodule_search_locations]
        return folders[0].parent, [file for folder in folders for file in _files_below(folder)]
    if spec.origin is None or not Path(spec.origin).is_file():  # built in
        return None, []
    return Path(spec.origin).resolve().parent, [Path(spec.origin).resolve()]


def _files_of(beside: Path, top: str) -> list[Path]:
    """Return the files of a module or package in a folder; none if it is elsewhere."""
    if (beside / top / "__init__.py").is_file():
        return _files_below(beside / top)
    return [beside / f"{top}.py"] if (beside / f"{top}.py").is_file() else []


def _files_below(folder: Path) -> list[Path]:
    return sorted(file for file in folder.rglob("*") if file.suffix in _SUFFIXES and file.is_file())


def _imports(file: Path) -> Iterator[str]:
    """Yield the top-level names that a file imports, except Brink's.

    They are read from its byte code. A syntax tree would do as well, but CPython 3.11 counts the depth of trees for
    all threads together, and raises SystemError if another thread builds one, as the printing of a traceback does.
    """
    try:
        waiting = [compile(file.read_bytes(), str(file), "exec", dont_inherit=True)]
    except (SyntaxError, ValueError):
        return
    finder = ModuleFinder()
    while waiting:
        code = waiting.pop()
        waiting += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
        for kind, what in finder.scan_opcodes(code):
            if kind == "absolute_import" and not is_own(what[1]):
                yield str(what[1]).partition(".")[0]

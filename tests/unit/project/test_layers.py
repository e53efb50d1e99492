"""The layer check rejects what it should: in a copy of the project, every layer imports the one above it."""

import itertools
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
LINT = "import sys; from importlinter.cli import lint_imports_command; sys.exit(lint_imports_command())"


def upward_imports() -> Iterator[tuple[str, str]]:
    """Yield pairs of importer and imported: each layer and the next above it, and siblings that must not meet."""
    for contract in CONTRACTS:
        if contract["type"] != "layers":
            continue
        container = contract["containers"][0]
        layers = [
            [f"{container}.{name.strip()}" for name in layer.split("|")] for layer in contract["layers"]
        ]
        for above, below in itertools.pairwise(layers):
            yield from itertools.product(below, above)
        for siblings in layers:
            yield from itertools.permutations(siblings, 2)


def some_file(folder: Path, module: str) -> tuple[str, Path]:
    """Return a module of a package that is not its `__init__`, or the module itself, and its file."""
    place = folder.joinpath(*module.split("."))
    if not place.is_dir():
        return module, place.with_suffix(".py")
    file = min(file for file in place.glob("*.py") if file.name != "__init__.py")
    return f"{module}.{file.stem}", file


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", LINT, "--no-cache"], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("layers")
    shutil.copytree(ROOT / "brink", folder / "brink", ignore=shutil.ignore_patterns("__pycache__", "static"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def test_every_import_against_the_layers_is_reported(copied: Path) -> None:
    expected = []
    for importer, imported in upward_imports():
        upper, _ = some_file(copied, imported)
        module, file = some_file(copied, importer)
        with file.open("a") as text:
            text.write(f"\nimport {upper}  # against the layers\n")
        expected.append(f"{module} -> {upper}")

    result = lint(copied)

    assert result.returncode == 1
    reported = set(re.findall(r"(brink[\w.]+ -> brink[\w.]+)\s+\(l\.", result.stdout))
    assert [pair for pair in expected if pair not in reported] == []


def test_an_import_circle_between_two_files_is_reported(tmp_path: Path) -> None:
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copytree(
        ROOT / "brink", tmp_path / "brink", ignore=shutil.ignore_patterns("__pycache__", "static")
    )
    for name, other in (("first", "second"), ("second", "first")):
        (tmp_path / "brink" / "search" / f"{name}.py").write_text(f"import brink.search.{other}\n")

    result = lint(tmp_path)

    assert result.returncode == 1
    assert "No cycles are allowed in brink.search." in result.stdout

"""What a wheel and an editable install put into site-packages."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Build a wheel and return the paths in it."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    (wheel,) = folder.glob("*.whl")
    return set(zipfile.ZipFile(wheel).namelist())


def test_a_wheel_holds_the_package_and_its_metadata_and_nothing_else(names: set[str]) -> None:
    assert {name.split("/")[0] for name in names} == {"brink", "brink_boundary-1.0.0.dist-info"}
    modules = {name for name in names if name.endswith(".py")}
    assert modules == {
        file.relative_to(ROOT).as_posix()
        for folder in (ROOT / "brink", *(ROOT / "brink").glob("*/"))
        for file in folder.rglob("*.py")
    }


def test_a_wheel_holds_the_page_the_templates_the_weights_and_the_type_marker(names: set[str]) -> None:
    tracked = subprocess.run(
        ["git", "ls-files", "brink/report/templates", "server/dashboard/static", "sim/perception/weights"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.splitlines()
    assert tracked
    assert {f"brink/{name.removeprefix('brink/')}" for name in tracked} | {"brink/py.typed"} <= names


def test_importing_brink_loads_no_heavy_module() -> None:
    heavy = ["numpy", "scipy", "pydantic", "httpx", "fastapi", "uvicorn", "sqlalchemy", "typer"]
    code = f"import sys, brink; print(brink.__version__); print(*({heavy} & sys.modules.keys()))"
    code = code.replace(str(heavy), str(set(heavy)))

    printed = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout

    assert printed.splitlines() == ["1.0.0", ""]


@pytest.mark.parametrize("name", ["examples", "migrations", "search", "server", "sim", "worker"])
def test_every_top_level_folder_is_part_of_the_package(name: str) -> None:
    link = ROOT / "brink" / name

    assert link.is_symlink()
    assert link.resolve() == ROOT / name

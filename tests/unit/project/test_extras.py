"""What simulators need which extra, the command that installs it, and what does without the large extras."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from brink import extras
from brink.extras import MODULES, install_command
from brink.sim.catalogue import EXTRAS

ROOT = Path(__file__).parents[3]
WITHOUT = """
import importlib.util, sys
absent = set(sys.argv[1].split(","))
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name in absent else found(name, *more)
sys.modules.update(dict.fromkeys(absent))
from brink.worker.child import import_simulators
hello = import_simulators()
print(sorted(hello.lacking.items()), hello.left_out, {"scipy"} & set(sys.modules))
"""

LARGE = ("torch", "onnx", "ray", "libsumo")
"""What the extras torch, ray and sumo install, which only `make test-all` needs."""
IMPORT_ALL = """
import importlib, pkgutil, sys
absent = sys.argv[1].split(",")
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in absent:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Missing())
import brink
for module in pkgutil.walk_packages(brink.__path__, "brink."):
    if module.name.startswith("brink.migrations") or module.name.endswith("__main__"):
        continue  # run when they are imported
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        if str(error.name).split(".")[0] in absent:
            print(module.name)
"""


@pytest.mark.long("shows itself in the other tests where these extras are not installed")
def test_a_large_extra_is_needed_by_nothing_but_what_it_is_for() -> None:
    command = [sys.executable, "-c", IMPORT_ALL, ",".join(LARGE)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=240)
    failed = {name for name in done.stdout.split() if not name.startswith("brink.sim.adapters.sumo.")}
    assert failed == {"brink.worker.ray_pool"}


def test_tests_outside_files_for_torch_import_no_large_extra_when_they_are_collected() -> None:
    imports = re.compile(rf"^(?:import|from) (?:{'|'.join(LARGE)})\b", re.MULTILINE)
    files = {file for file in (ROOT / "tests").rglob("*.py") if not file.name.endswith("_torch.py")}
    assert len(files) > 100
    assert [file for file in files if imports.search(file.read_text(encoding="utf-8"))] == []


def test_exactly_the_simulators_of_the_missing_extras_cannot_run_and_the_others_load_no_scipy() -> None:
    absent = ",".join(module for modules in MODULES.values() for module in modules)
    command = [sys.executable, "-c", WITHOUT, absent]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip().splitlines()[-1] == f"{sorted(EXTRAS.items())} {{}} set()"


def test_the_extras_of_simulators_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {*EXTRAS.values()} == {*MODULES} <= {*project["optional-dependencies"]}


def test_the_command_uses_the_interpreter_and_the_checkout(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "executable", str(ROOT / ".venv" / "bin" / "python"))
    monkeypatch.chdir(ROOT)
    within = ".venv/bin/python -m pip install -c constraints.txt -e '.[sumo,vision]'"
    assert install_command("sumo", "vision") == within
    monkeypatch.chdir(tmp_path)
    assert install_command("sumo") == (
        f"{ROOT}/.venv/bin/python -m pip install -c {ROOT}/constraints.txt -e '{ROOT}[sumo]'"
    )
    monkeypatch.setattr(extras, "__file__", str(tmp_path / "site-packages" / "brink" / "extras.py"))
    assert install_command("sumo") == f"{ROOT}/.venv/bin/python -m pip install 'brink-boundary[sumo]'"

"""The cost of driving systems in processes of their own: all ways drive, and shares are of the twin in process."""

import shutil
import sys
from importlib.util import find_spec

import pytest

from benchmarks.driving import _Cost, _rows, measure_driving
from benchmarks.measurement import silent
from brink.sim import catalogue
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.sim.driving_systems.option import DRIVING_SYSTEMS
from brink.sim.programs.installed import COMMANDS_VARIABLE

NAMES = (
    "bare loop",
    "IDM, Python in process",
    "IDM, C++ process",
    "AEB, Python in process",
    "AEB, Python process",
    "ACC, Python in process",
    "ACC, FMU",
)


def test_shares_are_of_the_same_system_in_process() -> None:
    costs = {
        name: _Cost(steps=100.0, wall_s=wall_s, cpu_s=1.0)
        for name, wall_s in zip(NAMES, (1, 2, 3, 2, 5, 2, 4), strict=True)
    }
    *_, cpp, python, fmu = _rows(costs)
    assert [cpp.value, python.value, fmu.value] == pytest.approx([2 / 3, 0.4, 0.5])
    assert [cpp.met, python.met, fmu.met] == [True, None, None]


@pytest.mark.long("builds a program in C++, and drives with seven systems")
@pytest.mark.skipif(shutil.which("cmake") is None, reason="there is no cmake")
@pytest.mark.skipif(find_spec("fmpy") is None, reason="FMPy is not installed")
def test_all_ways_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (PLUGINS_VARIABLE, COMMANDS_VARIABLE):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(sys, "path", list(sys.path))
    catalogue.import_plugin_modules.cache_clear()
    rows = measure_driving(drives=1, seed=0, progress=silent)
    assert [row.what for row in rows[: len(NAMES)]] == [f"{name}: steps a second" for name in NAMES]
    assert all(row.value > 0 for row in rows)
    catalogue._registered.pop(DRIVING_SYSTEMS, None)
    catalogue.import_plugin_modules.cache_clear()

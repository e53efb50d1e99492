"""The cost of a driving system in a process of its own: control steps a second, beside the same one in process.

The examples in `examples/driving` are pairs: the same driving system in Python and in C++, another one in Python as a
class and as a process, and a controller as an FMU, whose twin in Python is here. Each drive is driven by all of them
in turn, so that whatever else the machine does hits all.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from benchmarks.measurement import Progress, Row, at_least, counted, untargeted
from benchmarks.urban import draw_candidate, spec_of
from brink.sim.catalogue import PLUGINS_VARIABLE, make_simulator, register
from brink.sim.driving.interface import CONTROL_STEP_S
from brink.sim.driving_systems import Decision, Observation, Start
from brink.sim.driving_systems.command import Definition, end_processes, install
from brink.sim.driving_systems.fmu import FREE_GAP_M, MARGIN_M
from brink.sim.driving_systems.option import DRIVING_SYSTEMS, DrivingOption
from brink.sim.programs.installed import COMMANDS_VARIABLE

EXAMPLES: Final = Path(__file__).resolve().parents[1] / "examples" / "driving"
LEAST_SHARE: Final = 0.6
_BARE: Final = "bare@1"
_ACC: Final = "acc@1"


class _Bare:
    """Rolls on: what a drive costs without a driving system."""

    needs: ClassVar = "boxes"

    def __init__(self, start: Start) -> None:
        self._decision = Decision(accel_mps2=0.0, steer_rad=0.0)

    def step(self, observation: Observation) -> Decision:
        return self._decision


class _Acc:
    """The controller of `examples/driving/fmu`."""

    needs: ClassVar = "objects"

    def __init__(self, start: Start) -> None:
        self._car, self._limit_mps = start.car, start.route.speed_limit_mps
        self._ahead = (FREE_GAP_M, 0.0)

    def step(self, observation: Observation) -> Decision:
        speed_mps, car = observation.ego.speed_mps, self._car
        if observation.objects is not None:
            gaps = [
                (one.x_m - 0.5 * (one.length_m + car.length_m), one.vx_mps - speed_mps)
                for one in observation.objects
                if one.x_m > 0 and abs(one.y_m) < 0.5 * (one.width_m + car.width_m) + MARGIN_M
            ]
            self._ahead = min(gaps, default=(FREE_GAP_M, 0.0))
        gap_m, relative_mps = self._ahead
        follow = 0.4 * (gap_m - 3.0 - 1.2 * speed_mps) + 1.2 * relative_mps
        return Decision(accel_mps2=max(-8.0, min(0.8 * (self._limit_mps - speed_mps), follow, 2.0)))


@dataclass(slots=True)
class _Cost:
    steps: float = 0.0
    wall_s: float = 0.0
    cpu_s: float = 0.0

    @property
    def rate(self) -> float:
        return self.steps / self.wall_s


@contextmanager
def _systems() -> Iterator[dict[str, str]]:
    """Yield the ids of the driving systems by name, with the one in C++ built."""
    os.environ[PLUGINS_VARIABLE] = "idm,aeb"
    sys.path.insert(0, str(EXAMPLES))
    register(DRIVING_SYSTEMS, _BARE, _Bare)
    register(DRIVING_SYSTEMS, _ACC, _Acc)
    with tempfile.TemporaryDirectory(prefix="brink-") as folder:
        os.environ[COMMANDS_VARIABLE] = folder
        cpp = Path(shutil.copytree(EXAMPLES / "cpp", Path(folder) / "cpp"))
        for command in (["cmake", "-B", "build"], ["cmake", "--build", "build"]):
            subprocess.run(command, cwd=cpp, check=True, stdout=subprocess.DEVNULL)
        fmu = Path(shutil.copytree(EXAMPLES / "fmu", Path(folder) / "fmu"))
        _build_fmu(fmu)
        files = (cpp / "idm.yaml", EXAMPLES / "aeb_process.yaml", fmu / "acc.yaml")
        programs = [Definition.of(file) for file in files]
        for program in programs:
            install(program)
        yield {
            "bare loop": _BARE,
            "IDM, Python in process": "idm:Idm",
            "IDM, C++ process": programs[0].id(),
            "AEB, Python in process": "aeb:EmergencyBrake",
            "AEB, Python process": programs[1].id(),
            "ACC, Python in process": _ACC,
            "ACC, FMU": programs[2].id(),
        }
        end_processes()


def _build_fmu(folder: Path) -> None:
    library = folder / "acc.so"
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", library, folder / "acc.c"], check=True)
    with zipfile.ZipFile(folder / "acc.fmu", "w") as archive:
        archive.write(folder / "modelDescription.xml", "modelDescription.xml")
        archive.write(library, "binaries/linux64/acc.so")
    # `python3` of the example may be another one, without Brink.
    (folder / "acc.yaml").write_text(
        f"command: [{sys.executable}, -m, brink.sim.driving_systems.fmu, acc.fmu, acc-variables.yaml]\n"
    )


def measure_driving(*, drives: int, seed: int, progress: Progress) -> list[Row]:
    """Return control steps a second by each way, and the shares that remain in processes of their own.

    Args:
        drives: Number of drives by each.
        seed: Seed of the drives, which are random candidates of `urban-injected@1` with perfect perception.
        progress: Progress callback.

    Raises:
        OSError: There is no cmake or no C compiler.
        subprocess.CalledProcessError: There is no compiler.
    """
    rng = np.random.default_rng(seed)
    with _systems() as systems:
        costs = {name: _Cost() for name in systems}
        for number in counted(progress, "drives", drives + 1):
            spec = spec_of(draw_candidate(rng), number, oracle=True)
            for name, system in systems.items():
                simulator = make_simulator(spec.simulator)
                options = {**spec.options, **DrivingOption(system=system).to_options()}
                began_s, began_cpu_s = time.perf_counter(), time.process_time()
                result = simulator.run(replace(spec, options=options))
                if number > 0:  # in the first drive, programs start
                    simulated_s = result.provenance["simulated_s"]
                    assert isinstance(simulated_s, float)
                    costs[name].steps += simulated_s / CONTROL_STEP_S
                    costs[name].wall_s += time.perf_counter() - began_s
                    costs[name].cpu_s += time.process_time() - began_cpu_s
    return list(_rows(costs))


def _rows(costs: dict[str, _Cost]) -> Iterator[Row]:
    for name, cost in costs.items():
        note = f"{1e6 * cost.cpu_s / cost.steps:.0f} µs of CPU time a step here, without the program's own"
        yield untargeted(f"{name}: steps a second", cost.rate, note)
    for twin, name, least in (
        ("IDM, Python in process", "IDM, C++ process", LEAST_SHARE),
        ("AEB, Python in process", "AEB, Python process", None),
        ("ACC, Python in process", "ACC, FMU", None),
    ):
        yield at_least(f"{name}, share of the rate in process", costs[name].rate / costs[twin].rate, least)

"""A cheap simulator, ``faulty@1``, that fails in real ways when its scenario says so.

Import it through ``BRINK_PLUGINS=faulty_simulator`` with this folder on ``PYTHONPATH``, or as
``tests.plugins.faulty_simulator`` from the repository root.

Without a fault, the robustness of every requirement is the distance of the episode from the origin minus ``limit``.
The distance is computed from all numbers in scenario and behaviour, so the unsafe region is a ball; the objective
``distance`` is the distance itself. The provenance gives the process id, the monotonic times at which the run began
and ended, and how long the process had waited for a processor by then.

Optional scenario fields, none of which enters the distance:

    fault           the fault to cause, ``none`` by default:
        none            no fault
        segfault        read address 0: SIGSEGV kills the process
        hang            sleep in C for an hour while holding the interpreter lock
        out-of-memory   allocate memory until an allocation fails: MemoryError under a memory limit
        exit            end the process with status 3, silently
        error           raise a RuntimeError
        crashed         raise SimulationCrashed
        invalid         raise InvalidEpisode
        nan             return a verdict of NaN
        print           write noise to both standard streams, below Python too, then return a verdict
        slow            keep the processor busy for ``slow_s``, then return a verdict
        wait            sleep for ``slow_s``, or until the file ``until`` exists, then return a verdict
    once            path of a file: the fault happens only if the file does not exist, and creates it first,
                    so that the next attempt succeeds
    slow_s          duration of ``slow`` and ``wait`` in seconds, 0.1 by default
    until           path of a file that ends ``wait``
    limit           radius of the unsafe ball, 1.0 by default

With ``record`` the result carries a small trace, which `brink.sim.trace` cannot read.
"""

import ctypes
import math
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from brink.sim.catalogue import SIMULATORS, register
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, Verdict
from brink.sim.errors import InvalidEpisode, SimulationCrashed

SIMULATOR_ID = "faulty@1"
_SETTINGS = ("fault", "once", "slow_s", "until", "limit")
_BLOCK_BYTES = 64 * 1024 * 1024
_MAX_BLOCKS = 1024


class FaultySimulator:
    """Returns the distance from the origin, or fails as the scenario says."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode."""
        fault = str(spec.scenario.get("fault", "none"))
        if fault != "none" and _is_due(spec.scenario.get("once")):
            cause(fault, _number(spec.scenario, "slow_s", 0.1), spec.scenario.get("until"))
        distance = _distance(spec)
        robustness = math.nan if fault == "nan" else distance - _number(spec.scenario, "limit", 1.0)
        violated_at_s = 0.0 if robustness < 0 else None
        return EpisodeResult(
            verdicts={
                name: Verdict(robustness=robustness, unit="m", violated_at_s=violated_at_s)
                for name in spec.requirements
            },
            objectives={"distance": distance},
            features={},
            provenance={"pid": os.getpid()},
            trace=b"trace of " + spec.digest().encode() if record else None,
        )


def cause(fault: str, slow_s: float, until: Json) -> None:
    """Cause a fault; return if it lets the episode end with a verdict.

    Args:
        fault: Name of the fault.
        slow_s: Duration of ``slow`` and ``wait`` in seconds.
        until: Path of a file that ends ``wait``, or None.
    """
    match fault:
        case "segfault":
            ctypes.string_at(0)
        case "hang":
            # Unlike CDLL, PyDLL keeps the interpreter lock, so no Python code can run.
            ctypes.PyDLL(None).sleep(3600)
        case "out-of-memory":
            _take_memory()
        case "exit":
            os._exit(3)
        case "error":
            raise RuntimeError("the physics came apart")
        case "crashed":
            raise SimulationCrashed("the engine gave up")
        case "invalid":
            raise InvalidEpisode("scenario: there is no such road")
        case "print":
            _make_noise()
        case "slow":
            end_s = time.monotonic() + slow_s
            while time.monotonic() < end_s:
                math.sqrt(2.0)
        case "wait" if isinstance(until, str):
            while not Path(until).exists():
                time.sleep(0.005)
        case "wait":
            time.sleep(slow_s)
        case "nan":
            return
        case _:
            raise InvalidEpisode(
                f"scenario.fault: unknown fault {fault!r}; see tests/plugins/faulty_simulator.py"
            )


def _take_memory() -> None:
    # The system zeroes `bytes` only when they are touched, so a missing limit does not harm the machine.
    blocks = [bytes(_BLOCK_BYTES) for _ in range(_MAX_BLOCKS)]
    raise RuntimeError(
        f"{len(blocks)} blocks of {_BLOCK_BYTES} bytes were allocated: is there no memory limit?"
    )


def _make_noise() -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.write("noise " * 50_000 + "\n")
        stream.flush()
    os.write(1, b"\x00\x00\x00\x05hello" * 1000)
    os.write(2, b"\xff\xfe raw bytes\n")


def _is_due(once: Json) -> bool:
    if not isinstance(once, str):
        return True
    try:
        os.close(os.open(once, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
    except FileExistsError:
        return False
    return True


def _number(values: Mapping[str, Json], name: str, default: float) -> float:
    value = values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InvalidEpisode(f"scenario.{name}: expected a number, got {value!r}")
    return float(value)


def _distance(spec: EpisodeSpec) -> float:
    numbers = [
        float(value)
        for values in (spec.scenario, spec.behaviour)
        for name, value in sorted(values.items())
        if name not in _SETTINGS and isinstance(value, int | float) and not isinstance(value, bool)
    ]
    return math.hypot(*numbers)


register(SIMULATORS, SIMULATOR_ID, FaultySimulator)

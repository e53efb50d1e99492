"""A cheap simulator, ``faulty@1``, that breaks down in real ways when its scenario says so.

Import it through ``BRINK_PLUGINS=faulty_simulator`` with this folder on ``PYTHONPATH``, or as
``tests.plugins.faulty_simulator`` from the repository root.

Without a fault it returns, for each requirement, a robustness that depends on nothing but the numbers of scenario
and behaviour (Booleans and everything else are skipped): their distance from the origin minus ``limit``. So the
unsafe region is a ball; the objective ``distance`` is the distance itself. The provenance tells the process id,
the monotonic times at which the run began and ended, and how long the process had waited for a processor by then.

Scenario fields that are read, all optional; none of the numbers among them enters the distance:

    fault           what goes wrong, ``none`` if absent:
        none            nothing
        segfault        reads address 0: the process is killed by SIGSEGV
        hang            sleeps in C with the interpreter lock held, for an hour
        out-of-memory   takes memory until it is refused: MemoryError under a memory limit
        exit            ends the process with status 3, without a word
        error           raises a RuntimeError
        crashed         raises SimulationCrashed
        invalid         raises InvalidEpisode
        nan             returns a verdict that is not a number
        print           writes noise to both standard streams, below Python too, then returns a verdict
        slow            works on the processor for ``slow_s``, then returns a verdict
        wait            sleeps for ``slow_s``, then returns a verdict
    once            path of a file: the fault happens only if the file cannot be found, and creates it first,
                    so that the next attempt gets through
    slow_s          for ``slow`` and ``wait``, default 0.1
    limit           radius of the unsafe ball, default 1.0

With ``record`` the result carries a small trace (not one that `brink.sim.trace` can read).
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
_SETTINGS = ("fault", "once", "slow_s", "limit")
_BLOCK_BYTES = 64 * 1024 * 1024
_MOST_BLOCKS = 1024


class FaultySimulator:
    """Returns a distance from the origin, or breaks down as it is told."""

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode."""
        began_s, began_queued_s = time.monotonic(), _queued_s()
        fault = str(spec.scenario.get("fault", "none"))
        if fault != "none" and _wanted(spec.scenario.get("once")):
            break_down(fault, _number(spec.scenario, "slow_s", 0.1))
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
            provenance={
                "pid": os.getpid(),
                "began_s": began_s,
                "began_queued_s": began_queued_s,
                "ended_queued_s": _queued_s(),
                "ended_s": time.monotonic(),
            },
            trace=b"trace of " + spec.digest().encode() if record else None,
        )


def break_down(fault: str, slow_s: float) -> None:
    """Do what a fault says; return if it lets the episode end with a verdict."""
    match fault:
        case "segfault":
            ctypes.string_at(0)
        case "hang":
            # PyDLL, unlike CDLL, keeps the interpreter lock: no Python code can run meanwhile.
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
        case "wait":
            time.sleep(slow_s)
        case "nan":
            return
        case _:
            raise InvalidEpisode(
                f"scenario.fault: unknown fault {fault!r}; see tests/plugins/faulty_simulator.py"
            )


def _take_memory() -> None:
    # `bytes` of a size is zeroed by the system when touched, so that a missing limit does not hurt the machine.
    blocks = [bytes(_BLOCK_BYTES) for _ in range(_MOST_BLOCKS)]
    raise RuntimeError(
        f"{len(blocks)} blocks of {_BLOCK_BYTES} bytes were not refused: is there no memory limit?"
    )


def _make_noise() -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.write("noise " * 50_000 + "\n")
        stream.flush()
    os.write(1, b"\x00\x00\x00\x05hello" * 1000)
    os.write(2, b"\xff\xfe raw bytes\n")


def _queued_s() -> float:
    """Return how long this thread has been ready to run while others had the processor; 0 where that is unknown."""
    try:
        return int(Path("/proc/thread-self/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0


def _wanted(once: Json) -> bool:
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

"""The simulation process: runs one episode after another, so that a crash in the physics ends only this process.

Run as ``python -m brink.worker.child`` with three pipes: requests in, replies out, and a lifeline that ends this
process with its parent. Standard output and error belong to the simulators. `brink.worker.child_protocol` defines
the messages.
"""

import argparse
import faulthandler
import fcntl
import gc
import json
import logging
import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

from brink.sim.adapters.command.simulator import register_commands
from brink.sim.adapters.fmu.installed import register_fmus
from brink.sim.catalogue import (
    EXTRAS,
    SIMULATORS,
    Simulator,
    load_plugin,
    make_simulator,
    other_source,
    simulator_ids,
)
from brink.sim.episode import EpisodeSpec, JsonObject
from brink.sim.errors import ExtraMissing, InvalidEpisode, SimulationCrashed
from brink.worker.child_protocol import (
    EpisodeReply,
    Hello,
    RunEpisode,
    completed_document,
    failed_document,
    read_frame,
    write_all,
)
from brink.worker.errors import BrokenFrame, UnserializableResult

MEBIBYTE = 1024 * 1024

log = logging.getLogger(__name__)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run episodes until the parent closes the request pipe."""
    parser = argparse.ArgumentParser(prog="python -m brink.worker.child", description="Started by a worker.")
    parser.add_argument("--requests", type=int, required=True, help="file descriptor to read")
    parser.add_argument("--replies", type=int, required=True, help="file descriptor to write")
    parser.add_argument(
        "--lifeline", type=int, required=True, help="file descriptor that the parent keeps open"
    )
    parser.add_argument("--memory-mib", type=int, default=0, help="memory that episodes may add; 0: no limit")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    # A program that a simulator starts must not keep the pipes open after this process has died.
    for fd in (options.requests, options.replies, options.lifeline):
        os.set_inheritable(fd, False)
    handle_signals()
    exit_with_parent(options.lifeline)
    hello = import_simulators()
    limit_memory(options.memory_mib)
    write_all(options.replies, hello.to_frame())
    serve(options.requests, options.replies)
    return 0


def handle_signals() -> None:
    """Ignore the signals that terminals and service managers send to process groups; the parent ends this process.

    SIGUSR1 prints the Python stack, even while C code runs, to show where an episode hangs.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    faulthandler.enable(all_threads=False)
    faulthandler.register(signal.SIGUSR1, all_threads=False, chain=False)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def exit_with_parent(lifeline: int) -> None:
    """End this process when its parent ends, even while C code holds the interpreter lock.

    The kernel sends SIGIO, whose default action ends the process, when the write end of the lifeline closes. This
    needs no thread. Linux's parent-death signal would also fire when only the thread that started this process ends.

    Args:
        lifeline: Read end of a pipe. The parent holds the only write end and never writes.
    """
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGIO])
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    already_closed, _, _ = select.select([lifeline], [], [], 0)
    if already_closed:
        os._exit(0)


def limit_memory(growth_mib: int) -> None:
    """Limit how much private memory this process may add from now on; beyond it, allocations raise MemoryError.

    The limit is RLIMIT_DATA: RLIMIT_AS would also count memory that is only mapped, such as libraries and devices.

    Args:
        growth_mib: Limit in MiB; 0 sets none.
    """
    if growth_mib == 0:
        return
    baseline_bytes = _private_bytes()
    if baseline_bytes is None:
        log.warning("no memory limit: this system does not report how much memory a process uses")
        return
    limit_bytes = baseline_bytes + growth_mib * MEBIBYTE
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY:
        limit_bytes = min(limit_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, hard))


def _private_bytes() -> int | None:
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return None
    for line in status.splitlines():
        if line.startswith("VmData:"):
            return int(line.split()[1]) * 1024
    return None


def import_simulators() -> Hello:
    """Import every registered simulator and return which of them can be used."""
    simulators: list[str] = []
    lacking: dict[str, str] = {}
    left_out = register_commands() | register_fmus()
    for simulator_id in simulator_ids():
        try:
            load_plugin(SIMULATORS, simulator_id)
        except ExtraMissing as error:
            if simulator_id in EXTRAS:
                lacking[simulator_id] = EXTRAS[simulator_id]
            else:
                left_out[simulator_id] = str(error)
        except Exception as error:  # noqa: BLE001  (a plug-in may raise anything; the reason goes to the parent)
            left_out[simulator_id] = _one_line(error)
        else:
            simulators.append(simulator_id)
    return Hello(simulators=tuple(simulators), lacking=lacking, left_out=left_out)


def serve(requests: int, replies: int) -> None:
    """Answer every request in order until the pipe ends."""
    host = SimulatorHost()
    while (frame := read_frame(requests)) is not None:
        request = RunEpisode(**json.loads(frame))
        began_s = time.perf_counter()
        outcome = host.run(request.spec, record=request.record)
        wall_s = time.perf_counter() - began_s
        write_all(replies, _reply_frame(request.ticket, wall_s, outcome))


class SimulatorHost:
    """Keeps simulators between episodes and turns every result or exception of an episode into an outcome."""

    def __init__(self) -> None:
        self._simulators: dict[str, Simulator] = {}

    def run(self, document: JsonObject, *, record: bool) -> JsonObject:
        """Run one episode and return its outcome as JSON; never raise.

        Args:
            document: An `EpisodeSpec` as JSON.
            record: Whether the result must carry the trace.
        """
        spec: EpisodeSpec | None = None
        try:
            spec = EpisodeSpec.from_json(document)
            if (why := other_source(spec.sources)) is not None:
                return failed_document("error", why)
            simulator = self._simulators.get(spec.simulator)
            if simulator is None:
                simulator = self._simulators[spec.simulator] = make_simulator(spec.simulator)
            return completed_document(simulator.run(spec, record=record))
        except InvalidEpisode as error:
            return failed_document("invalid", str(error))
        except SimulationCrashed as error:
            failure = failed_document("crashed", str(error), _stack(error))
        except UnserializableResult as error:
            failure = failed_document("error", f"the result cannot be sent: {error}")
        except MemoryError as error:
            failure = failed_document("out-of-memory", _one_line(error))
        # SystemExit too: a simulator that calls `sys.exit` must not end the process.
        except (Exception, SystemExit) as error:  # noqa: BLE001  (foreign code; reported with its stack)
            failure = failed_document("error", _one_line(error), _stack(error))
        if spec is not None:
            # After an unexpected error the simulator's state cannot be trusted: the next episode gets a new one.
            self._simulators.pop(spec.simulator, None)
            gc.collect()
        return failure


def _reply_frame(ticket: int, wall_s: float, outcome: JsonObject) -> bytes:
    try:
        return EpisodeReply(ticket=ticket, wall_s=wall_s, outcome=outcome).to_frame()
    # Too long for a frame, or a value that is not JSON in a field that was not checked.
    except (BrokenFrame, TypeError, ValueError) as error:
        failure = failed_document("error", f"the result cannot be sent: {error}")
        return EpisodeReply(ticket=ticket, wall_s=wall_s, outcome=failure).to_frame()


def _one_line(error: BaseException) -> str:
    """Return an exception's type and message on one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _stack(error: BaseException) -> str:
    return "".join(traceback.format_tb(error.__traceback__))


if __name__ == "__main__":
    sys.exit(main())

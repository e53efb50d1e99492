"""The simulation process: runs episodes one after the other, so that a crash of the physics kills only itself.

Run as ``python -m brink.worker.child`` with three pipes: requests in, replies out, and a lifeline that ends this
process with its parent. Standard output and error belong to the simulators; nothing here is spoken over them. The
messages are those of `brink.worker.child_wire`.
"""

import argparse
import gc
import json
import logging
import os
import sys
import time
import traceback
from collections.abc import Sequence
from typing import Any

from brink.sim.catalogue import SIMULATORS, Simulator, load_plugin, make_simulator, simulator_ids
from brink.sim.episode import EpisodeSpec, Json, JsonObject
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.worker.child_guards import die_with_parent, leave_signals_to_the_parent, limit_memory
from brink.worker.errors import BrokenFrame, UnsendableResult
from brink.worker.frames import encode_document, read_frame, write_all
from brink.worker.outcome_document import completed, failed

log = logging.getLogger(__name__)


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve episodes until the parent closes the request pipe."""
    parser = argparse.ArgumentParser(prog="python -m brink.worker.child", description="Started by a worker.")
    parser.add_argument("--requests", type=int, required=True, help="file descriptor to read")
    parser.add_argument("--replies", type=int, required=True, help="file descriptor to write")
    parser.add_argument("--lifeline", type=int, required=True, help="file descriptor that the parent holds")
    parser.add_argument("--memory-mib", type=int, default=0, help="memory that may be added; 0: no limit")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    # A program that a simulator starts must not keep the pipes open after this process has died.
    for fd in (options.requests, options.replies, options.lifeline):
        os.set_inheritable(fd, False)
    leave_signals_to_the_parent()
    die_with_parent(options.lifeline)
    hello = probe()
    unlimited = limit_memory(options.memory_mib)
    if unlimited is not None:
        log.warning("no memory limit: %s", unlimited)
    write_all(options.replies, encode_document(hello))
    serve(options.requests, options.replies)
    return 0


def probe() -> JsonObject:
    """Import every registered simulator; return a `Hello` that says which of them can be made here."""
    simulators: list[Json] = []
    left_out: JsonObject = {}
    for simulator_id in simulator_ids():
        try:
            load_plugin(SIMULATORS, simulator_id)
        except Exception as error:  # noqa: BLE001  (importing foreign code may raise anything; told to the parent)
            left_out[simulator_id] = one_line(error)
        else:
            simulators.append(simulator_id)
    return {"simulators": simulators, "left_out": left_out}


def serve(requests: int, replies: int) -> None:
    """Answer every request in order until the pipe ends."""
    host = SimulatorHost()
    while (frame := read_frame(requests)) is not None:
        request = json.loads(frame)
        began_s = time.perf_counter()
        outcome = host.run(request["spec"], record=request["record"])
        wall_s = time.perf_counter() - began_s
        write_all(replies, _reply_frame(request["ticket"], wall_s, outcome))


class SimulatorHost:
    """Keeps the simulators that were made, and turns whatever a run does into an outcome."""

    def __init__(self) -> None:
        self._simulators: dict[str, Simulator] = {}

    def run(self, document: JsonObject, *, record: bool) -> JsonObject:
        """Run the episode that an `EpisodeSpec` as JSON asks for; return its outcome as JSON, never raising."""
        spec: EpisodeSpec | None = None
        try:
            spec = EpisodeSpec.from_json(document)
            simulator = self._simulators.get(spec.simulator)
            if simulator is None:
                simulator = self._simulators[spec.simulator] = make_simulator(spec.simulator)
            return completed(simulator.run(spec, record=record))
        except InvalidEpisode as error:
            return failed("invalid", str(error))
        except SimulationCrashed as error:
            failure = failed("crashed", str(error), _stack(error))
        except UnsendableResult as error:
            failure = failed("error", f"the result cannot be sent: {error}")
        except MemoryError as error:
            failure = failed("out-of-memory", one_line(error))
        # SystemExit too: a simulator that calls `sys.exit` must not take the process with it.
        except (Exception, SystemExit) as error:  # noqa: BLE001  (foreign code; reported with its stack)
            failure = failed("error", one_line(error), _stack(error))
        if spec is not None:
            # After anything unforeseen its state cannot be trusted: the next episode gets a new one.
            self._simulators.pop(spec.simulator, None)
            gc.collect()
        return failure


def one_line(error: BaseException) -> str:
    """Return an exception's type and message on one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _stack(error: BaseException) -> str:
    return "".join(traceback.format_tb(error.__traceback__))


def _reply_frame(ticket: int, wall_s: float, outcome: JsonObject) -> bytes:
    reply: dict[str, Any] = {"ticket": ticket, "wall_s": wall_s, "outcome": outcome}
    try:
        return encode_document(reply)
    # What no pipe carries: too long, or not even JSON in a field that the bounds do not look into.
    except (BrokenFrame, TypeError, ValueError) as error:
        return encode_document(reply | {"outcome": failed("error", f"the result cannot be sent: {error}")})


if __name__ == "__main__":
    sys.exit(main())

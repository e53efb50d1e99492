"""Runs a worker as a program: its arguments, its signals, its end with its parent."""

import argparse
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from brink.worker.client import CoordinatorClient
from brink.worker.errors import SettingsError
from brink.worker.log import (
    FORMAT_VARIABLE,
    LEVEL_VARIABLE,
    LogFormat,
    LogLevel,
    configure_logging,
    environment_format,
    environment_level,
)
from brink.worker.loop import Worker
from brink.worker.settings import TOKEN_VARIABLE, WorkerSettings, new_worker_id

log = logging.getLogger(__name__)


def run_worker(settings: WorkerSettings) -> int:
    """Work until told to stop; return the exit status.

    SIGTERM or SIGINT lets the running episode end and gives the rest back; a second one ends the program at once.
    """
    with CoordinatorClient(settings.server, token=settings.token) as client:
        worker = Worker(client, settings)
        with stopped_by_signals(worker.stop):
            if settings.exit_with_parent:
                threading.Thread(target=_stop_at_end_of_stdin, args=(worker,), daemon=True).start()
            return worker.run()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m brink.worker``."""
    options = _parser().parse_args(arguments)
    try:
        settings = WorkerSettings(
            server=options.server,
            worker_id=options.id or new_worker_id(),
            token=os.environ.get(TOKEN_VARIABLE) or None,
            max_jobs=options.max_jobs,
            prefetch_s=options.prefetch,
            wait_s=options.wait,
            memory_mib=options.memory,
            grace_s=options.grace,
            exit_when_idle_s=options.exit_when_idle,
            plugins=tuple(options.plugin),
            exit_with_parent=options.exit_with_parent,
        )
        level = LogLevel(options.log_level) if options.log_level else environment_level()
        log_format = LogFormat(options.log_format) if options.log_format else environment_format()
    except SettingsError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    configure_logging(level, log_format, worker=settings.worker_id)
    return run_worker(settings)


@contextmanager
def stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` at the first SIGTERM or SIGINT, end the program at the second; only in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked = False

    def handle(number: int, _frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            os._exit(128 + number)
        asked = True
        stop()

    before = {number: signal.signal(number, handle) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stop_at_end_of_stdin(worker: Worker) -> None:
    try:
        while os.read(sys.__stdin__.fileno() if sys.__stdin__ else 0, 4096):
            pass
    except OSError as error:
        log.warning("standard input cannot be read: %s", error)
    # Whoever started this worker is gone, most likely with the coordinator: nobody waits for an episode.
    worker.stop(grace_s=0.0)


def _parser() -> argparse.ArgumentParser:
    defaults = WorkerSettings(server="http://127.0.0.1:8700", worker_id="default")
    parser = argparse.ArgumentParser(
        prog="python -m brink.worker",
        description="Leases jobs from a coordinator, simulates them, reports. The environment variable "
        f"{TOKEN_VARIABLE} holds the bearer token where one is needed.",
        epilog="example: python -m brink.worker --server http://127.0.0.1:8700",
    )
    add = parser.add_argument
    add("--server", required=True, metavar="URL", help="base URL of the coordinator")
    add("--id", metavar="NAME", help="unique name (default: host, process id and random digits)")
    add(
        "--max-jobs", type=int, default=defaults.max_jobs, metavar="N", help="most jobs to hold (%(default)s)"
    )
    add(
        "--prefetch",
        type=float,
        default=defaults.prefetch_s,
        metavar="S",
        help="work to hold (%(default)s s)",
    )
    add(
        "--wait", type=float, default=defaults.wait_s, metavar="S", help="long-poll when idle (%(default)s s)"
    )
    add(
        "--memory",
        type=int,
        default=defaults.memory_mib,
        metavar="MIB",
        help="memory that an episode may take (%(default)s MiB; 0: no limit)",
    )
    add(
        "--grace",
        type=float,
        default=defaults.grace_s,
        metavar="S",
        help="time for the running episode after SIGTERM (%(default)s s)",
    )
    add("--exit-when-idle", type=float, metavar="S", help="leave after this time without a job")
    add(
        "--plugin",
        action="append",
        default=[],
        metavar="MODULE",
        help="import for its simulators; repeatable",
    )
    add("--exit-with-parent", action="store_true", help="leave when standard input ends")
    add(
        "--log-level",
        choices=[*LogLevel],
        help=f"least severe lines of the log ({LEVEL_VARIABLE}, else info)",
    )
    add("--log-format", choices=[*LogFormat], help=f"of the log ({FORMAT_VARIABLE}, else text)")
    return parser

"""The worker as a program: command-line arguments, signals, and exit with the parent process."""

import argparse
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
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
    """Work until stopped, and return the exit status.

    On SIGTERM or SIGINT the worker finishes the running episode and releases its other jobs. A second signal ends the
    program at once.
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
            alive_file=options.alive_file,
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
    """Call `stop` on the first SIGTERM or SIGINT, and exit on the second; no effect outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    stopping = False

    def handle(number: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        if stopping:
            os._exit(128 + number)
        stopping = True
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
    # The parent is gone, most likely with the coordinator: nobody waits for the running episode.
    worker.stop(grace_s=0.0)


def _parser() -> argparse.ArgumentParser:
    defaults = WorkerSettings(server="http://127.0.0.1:8700", worker_id="default")
    parser = argparse.ArgumentParser(
        prog="python -m brink.worker",
        description="Leases jobs from a coordinator, simulates them, and reports the outcomes. "
        f"The environment variable {TOKEN_VARIABLE} holds the bearer token, if one is required.",
        epilog="example: python -m brink.worker --server http://127.0.0.1:8700",
    )
    add = parser.add_argument

    def add_number(name: str, default: float, metavar: str, text: str) -> None:
        add(name, type=type(default), default=default, metavar=metavar, help=f"{text} (default: {default})")

    add("--server", required=True, metavar="URL", help="base URL of the coordinator")
    add("--id", metavar="NAME", help="unique name (default: host, process id and random digits)")
    add_number("--max-jobs", defaults.max_jobs, "N", "maximum number of jobs to hold")
    add_number("--prefetch", defaults.prefetch_s, "S", "work to hold, in seconds of simulation")
    add_number("--wait", defaults.wait_s, "S", "seconds to wait for a job when idle")
    add_number("--memory", defaults.memory_mib, "MIB", "memory that an episode may take in MiB; 0: no limit")
    add_number(
        "--grace", defaults.grace_s, "S", "seconds that the running episode may continue after SIGTERM"
    )
    add("--exit-when-idle", type=float, metavar="S", help="exit after this many seconds without a job")
    add("--plugin", action="append", default=[], metavar="MODULE", help="module with simulators; repeatable")
    add("--alive-file", type=Path, metavar="FILE", help="touch this file every few seconds while all is well")
    add("--exit-with-parent", action="store_true", help="exit when standard input ends")
    level_help = f"minimum severity of log lines (default: {LEVEL_VARIABLE}, else info)"
    add("--log-level", choices=[*LogLevel], help=level_help)
    add("--log-format", choices=[*LogFormat], help=f"log format (default: {FORMAT_VARIABLE}, else text)")
    return parser

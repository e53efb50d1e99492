"""Ends the processes that a measurement starts when the measurement itself ends, even if it is killed.

Each process is tied to a pipe whose only write end this process holds. The kernel closes it when this process ends,
however that happens, and sends a signal to the other one, which needs neither a thread nor the program's help.
"""

import fcntl
import os
import signal
import subprocess
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def start_tied(command: Sequence[str | Path], **options: Any) -> subprocess.Popen[bytes]:
    """Start a program that is killed when this process ends.

    Args:
        command: Command line.
        options: Further arguments of `subprocess.Popen`, without ``pass_fds``.
    """
    read_end, write_end = os.pipe()
    try:
        try:
            process = subprocess.Popen(command, pass_fds=(read_end,), **options)
        except BaseException:
            os.close(write_end)
            raise
        weakref.finalize(process, os.close, write_end)
        if hasattr(fcntl, "F_SETSIG"):  # Linux; SIGKILL also ends a process that is stopped
            fcntl.fcntl(read_end, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(read_end, fcntl.F_SETOWN, process.pid)
        fcntl.fcntl(read_end, fcntl.F_SETFL, fcntl.fcntl(read_end, fcntl.F_GETFL) | os.O_ASYNC)
    finally:
        os.close(read_end)
    return process

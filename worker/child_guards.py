"""What keeps a simulation process in its bounds: its signals, its memory, and its end with its parent's."""

import faulthandler
import fcntl
import os
import resource
import select
import signal
from pathlib import Path

MEBIBYTE = 1024 * 1024


def leave_signals_to_the_parent() -> None:
    """Ignore what a terminal or a service manager sends to a whole group: the parent decides when to end.

    SIGUSR1 prints the Python stack, also while C code runs, so that a hang can be reported with its place.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    faulthandler.enable(all_threads=False)
    faulthandler.register(signal.SIGUSR1, all_threads=False, chain=False)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def die_with_parent(lifeline: int) -> None:
    """End this process when the parent ends, even while it is stuck in C code that holds the interpreter lock.

    Args:
        lifeline: Read end of a pipe whose only write end the parent has and never uses. The kernel sends SIGIO,
            whose default action ends the process, when that end closes. No thread is needed, and unlike
            Linux's parent-death signal it does not fire when merely the thread ends that started the process.
    """
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGIO])
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    already_closed, _, _ = select.select([lifeline], [], [], 0)
    if already_closed:
        os._exit(0)


def limit_memory(growth_mib: int) -> str | None:
    """Let this process's private memory grow by so much from here on; more raises MemoryError.

    RLIMIT_DATA, since RLIMIT_AS also counts what is only mapped: libraries, reserved arenas, devices.

    Args:
        growth_mib: How much may be added, in MiB; 0 sets no limit.

    Returns:
        Why no limit could be set, or None.
    """
    if growth_mib == 0:
        return None
    baseline_bytes = _private_bytes()
    if baseline_bytes is None:
        return "this system does not tell how much memory a process has"
    limit_bytes = baseline_bytes + growth_mib * MEBIBYTE
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY:
        limit_bytes = min(limit_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, hard))
    return None


def _private_bytes() -> int | None:
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return None
    for line in status.splitlines():
        if line.startswith("VmData:"):
            return int(line.split()[1]) * 1024
    return None

"""Which processes run on this machine, told by an argument that only they have."""

import os
import time
from pathlib import Path

PATIENCE_S = 30.0


def new_mark() -> str:
    """Return a number of seconds that no other process sleeps."""
    return f"{1000 + os.getpid()}.{time.monotonic_ns()}"


def running(mark: str) -> dict[int, str]:
    """Return the process ids and command lines of the processes with an argument."""
    found = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            try:
                line = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            if mark in line:
                found[int(folder.name)] = " ".join(line)
    return found


def parent_of(pid: int) -> int:
    """Return the process id of a process's parent."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def assert_gone(mark: str) -> None:
    """Wait until no process has an argument."""
    deadline_s = time.monotonic() + PATIENCE_S
    while found := running(mark):
        assert time.monotonic() < deadline_s, found
        time.sleep(0.01)

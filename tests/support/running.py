"""Which processes run on this machine, told by an argument that only they have."""

import os
import time
from pathlib import Path

PATIENCE_S = 30.0


def new_mark() -> str:
    """Return a number of seconds that no other process sleeps."""
    return f"{1000 + os.getpid()}.{time.monotonic_ns()}"


def running(mark: str) -> list[str]:
    """Return the command lines of the processes with an argument."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            try:
                line = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            if mark in line:
                found.append(" ".join(line))
    return found


def assert_gone(mark: str) -> None:
    """Wait until no process has an argument."""
    deadline_s = time.monotonic() + PATIENCE_S
    while found := running(mark):
        assert time.monotonic() < deadline_s, found
        time.sleep(0.01)

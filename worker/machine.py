"""Where a process id means something: this boot of this kernel, seen from this PID namespace.

A host's name says neither. Containers and clones of virtual machines share names, and in each of them the same number
is another process, or none.
"""

import functools
import os
from pathlib import Path

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_PID_NAMESPACE = "/proc/self/ns/pid"


@functools.cache
def machine_name() -> str:
    """Return a name that two processes share only if they see each other's process ids; "" where none can be had."""
    try:
        return f"{_BOOT_ID.read_text().strip()} {os.readlink(_PID_NAMESPACE)}"
    except OSError:
        return ""

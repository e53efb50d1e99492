"""Where tests put their files: in memory, where there is room.

SQLite waits for the disk at every commit, and nothing of a test has to survive a power cut.
"""

import os
import shutil
import tempfile
from pathlib import Path

MEMORY = Path("/dev/shm")
ENOUGH_BYTES = 4 * 2**30
"""A run leaves a few hundred MB behind it, and Postgres as much."""


def use_memory() -> None:
    """Put temporary files of this process, and of those that it starts, into memory, unless somebody says where."""
    if "TMPDIR" in os.environ or not roomy(MEMORY):
        return
    os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY)


def roomy(folder: Path) -> bool:
    """Return whether there is a lot of room in a folder, and programs can be run from there."""
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        return False
    return (
        min(shutil.disk_usage(folder).free, _memory_bytes() // 3) > ENOUGH_BYTES
        and not os.statvfs(folder).f_flag & os.ST_NOEXEC
    )


def _memory_bytes() -> int:
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")

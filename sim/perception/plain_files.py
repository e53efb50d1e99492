"""Files that users name: read only if they are plain files on a disk, of which reading comes to an end."""

import stat
from pathlib import Path
from typing import Final

MOST_BYTES: Final = 2 * 1024**3
_OF_THE_SYSTEM: Final = ("/proc", "/sys")


def not_plain(file: Path) -> str | None:
    """Return why a file is not to be read, or None if it may be."""
    try:
        real = file.resolve()
        found = real.stat()
    except (
        OSError,
        ValueError,
        RuntimeError,
    ) as error:  # not there, too long a name, a NUL in it, a ring of links
        return "no such file" if isinstance(error, FileNotFoundError) else f"no file: {_reason(error)}"
    if stat.S_ISDIR(found.st_mode):
        return "expected a file, got a folder"
    if not stat.S_ISREG(found.st_mode) or any(real.is_relative_to(folder) for folder in _OF_THE_SYSTEM):
        return "expected a file on a disk"
    if found.st_size > MOST_BYTES:
        return f"expected at most {MOST_BYTES} bytes, got {found.st_size}"
    return None


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)

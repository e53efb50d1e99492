"""Reads files that users name: only regular files, and at most a limited number of bytes.

Opening a pipe that nobody writes to waits for ever, a device has no end, and a file can grow after its size was
looked at. So a file is opened without waiting, its kind is that of what was opened, and at most the limit is read.
"""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def open_file(path: str | Path) -> BinaryIO:
    """Open a regular file for reading, without ever blocking.

    Raises:
        OSError: There is no such file, it cannot be read, or it is no regular file.
        ValueError: The path contains a NUL character.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "expected a regular file", str(path))
    return open(descriptor, "rb")


def read_file(path: str | Path, most_bytes: int) -> bytes:
    """Return the content of a regular file.

    Args:
        path: The file.
        most_bytes: Maximum size.

    Raises:
        OSError: It cannot be read, is not a regular file, or is larger.
        ValueError: The path contains a NUL character.
    """
    with open_file(path) as file:
        is_larger = os.fstat(file.fileno()).st_size > most_bytes
        content = b"" if is_larger else file.read(most_bytes + 1)  # it may grow
    if is_larger or len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"larger than {most_bytes} bytes", str(path))
    return content


def read_text(path: str | Path, most_bytes: int) -> str:
    """Return the content of a regular file in UTF-8, as `read_file` does.

    Raises:
        OSError: It cannot be read, is not a regular file, or is larger.
        UnicodeDecodeError: It is not UTF-8.
    """
    return read_file(path, most_bytes).decode("utf-8")

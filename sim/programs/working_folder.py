"""Empty folders for programs and models of users: of this user alone, and emptied at the latest by the next one."""

import contextlib
import fcntl
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from brink.sim.errors import SimulationCrashed

_MAX_RUNNING: Final = 10_000


def _own_folder() -> Path:
    """Return the folder of all working folders, which belongs to this user alone."""
    folder = Path(tempfile.gettempdir()) / f"brink-commands-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if status.st_uid != os.getuid() or folder.is_symlink():
        raise SimulationCrashed(f"{folder} belongs to somebody else: set TMPDIR to a folder of your own")
    return folder


@contextlib.contextmanager
def working_folder() -> Iterator[tuple[Path, int]]:
    """Yield an empty folder, and a number that no other episode running on this machine has.

    The folder belongs to the number, so what an episode left that was killed is removed by the next one.
    """
    own = _own_folder()
    for number in range(_MAX_RUNNING):
        lock = os.open(own / f"{number}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        folder = own / str(number)
        try:
            _empty(folder)
            yield folder, number
        finally:
            if folder.exists():  # otherwise it is kept
                _empty(folder)
            os.close(lock)
        return
    raise SimulationCrashed(f"expected fewer than {_MAX_RUNNING:,} episodes at once in {own}")


def _empty(folder: Path) -> None:
    """Empty a folder, or make it. It stays, as removing a folder may take longer than all the rest."""
    try:
        if not stat.S_ISDIR(folder.lstat().st_mode):
            folder.unlink()
        folder.mkdir(exist_ok=True)
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path)
                else:
                    os.unlink(entry.path)
    except OSError:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()

"""Which FMUs may run on this machine: those that somebody put into a folder of it.

An FMU is native code, so the rule of all programs holds (`brink.sim.programs.installed`): a campaign names an FMU by
the digest of its file and contributes numbers, and a worker runs only what is in its folder.
"""

import hashlib
import logging
import os
import re
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from brink.extras import install_command
from brink.sim.adapters.fmu.simulator import FmuSimulator
from brink.sim.catalogue import SIMULATORS, register
from brink.sim.episode import FMU_PREFIX
from brink.sim.errors import DefinitionError
from brink.sim.fmi import FmuError, builds_for_here, builds_in
from brink.sim.programs.installed import commands_folder, own_folder

SUFFIX: Final = ".fmu"
_DIGITS: Final = 16
_ID: Final = re.compile(rf"[A-Za-z0-9_.-]{{1,80}}@[0-9a-f]{{{_DIGITS}}}")
_OTHER: Final = re.compile(r"[^A-Za-z0-9_.-]")

log = logging.getLogger(__name__)

_read: dict[str, Path] = {}
"""The files that this process has read, by reference."""


def reference_of(path: Path) -> str:
    """Return how campaigns name an FMU: by its file's name without the ending, and its digest.

    Raises:
        DefinitionError: It cannot be read.
    """
    try:
        reference = f"{_OTHER.sub('_', path.stem)[:80]}@{_digest(path)}"
    except OSError as error:
        raise DefinitionError("fmu", f"{path} cannot be read: {error.strerror}") from None
    _read[reference] = path.absolute()
    return reference


def is_reference(fmu: str) -> bool:
    """Return whether a text names an FMU by its digest."""
    return _ID.fullmatch(fmu) is not None


def simulator_id(reference: str) -> str:
    """Return the id of the simulator that steps an FMU."""
    return f"{FMU_PREFIX}{reference.rpartition('@')[2]}@1"


def install(reference: str) -> None:
    """Allow the workers of this machine to run an FMU whose file this process has read: copy it into their folder.

    Raises:
        DefinitionError: No programs may run here, or the file has changed since.
    """
    if reference not in _read:
        return
    path = own_folder() / f"{reference}{SUFFIX}"
    if path.exists() and simulator_id(f"@{_digest(path)}") == simulator_id(reference):
        return
    partial = path.with_suffix(f".{os.getpid()}")
    try:
        shutil.copyfile(_read[reference], partial)
        if _digest(partial) != reference.rpartition("@")[2]:
            raise DefinitionError("fmu", f"{_read[reference]} has changed since it was read: run this again")
        partial.replace(path)
    except OSError as error:
        raise DefinitionError("fmu", f"{error.filename}: {error.strerror}") from None
    finally:
        partial.unlink(missing_ok=True)


def register_fmus() -> dict[str, str]:
    """Register a simulator for each FMU that may run on this machine.

    Returns:
        Why FMUs cannot run, by file.
    """
    left_out = {}
    folder = commands_folder()
    for path in sorted(folder.glob(f"*{SUFFIX}")) if folder is not None else ():
        try:
            builds, digest = builds_in(path), _digest(path)
        except (FmuError, OSError) as error:
            left_out[str(path)] = str(error)
            continue
        if not set(builds) & set(builds_for_here()):
            expected = " or ".join(builds_for_here())
            left_out[str(path)] = f"expected a build for {expected}; it has {', '.join(builds) or 'none'}"
        elif find_spec("fmpy") is None:
            left_out[str(path)] = f"an FMU needs FMPy: {install_command('fmu')}"
        else:
            _register(path.absolute(), digest)
    return left_out


def _register(path: Path, digest: str) -> None:
    simulator = simulator_id(f"@{digest}")
    register(
        SIMULATORS, simulator, lambda: FmuSimulator(path, simulator, lambda copy: _digest(copy) == digest)
    )
    log.info("may run %s", path.name, extra={"simulator": simulator})


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:_DIGITS]

"""The optional extras of this distribution: whether one is installed, and the command that installs it.

Standard library only, so that every package may import it.
"""

import os
import shlex
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Final

MODULES: Final[Mapping[str, tuple[str, ...]]] = {
    "vision": ("cv2", "onnxruntime"),
    "gymnasium": ("gymnasium",),
    "highway": ("highway_env",),
    "sumo": ("libsumo",),
}
"""What must be importable for each extra that simulators need."""


def has_extra(extra: str) -> bool:
    """Return whether this interpreter can import what an extra of `MODULES` installs."""
    return all(find_spec(module) is not None for module in MODULES[extra])


def install_command(*extras: str) -> str:
    """Return the command that adds extras to the installation that is running."""
    names = ",".join(extras)
    checkout = Path(__file__).resolve().parents[1]
    if (checkout / "constraints.txt").is_file() and (checkout / "pyproject.toml").is_file():
        constraints, package = _shown(checkout / "constraints.txt"), f"{_shown(checkout)}[{names}]"
        return f"{_interpreter()} -m pip install -c {shlex.quote(constraints)} -e '{package}'"
    return f"{_interpreter()} -m pip install 'brink-boundary[{names}]'"


def _interpreter() -> str:
    return shlex.quote(_shown(Path(sys.executable))) if sys.executable else "python"


def _shown(path: Path) -> str:
    """Return a path, relative if it is inside the current folder."""
    try:
        here = Path.cwd()
    except FileNotFoundError:
        return str(path)
    # Not resolved: the interpreter of a virtual environment is a symbolic link.
    return os.path.relpath(path, here) if path.is_relative_to(here) else str(path)

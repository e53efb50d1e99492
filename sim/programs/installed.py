"""Which programs may run on this machine: those whose definitions somebody put into a folder of it.

Whoever may submit a campaign must not thereby run programs. So a campaign names a definition by its digest, and
workers look for it in this folder.
"""

import os
from pathlib import Path
from typing import Final

from brink.sim.errors import DefinitionError

COMMANDS_VARIABLE: Final = "BRINK_COMMANDS"
"""Environment variable with the folder of the definitions that workers on this machine may run; empty: none."""
OWN_FOLDER: Final = Path("brink-commands")
"""That folder without the variable: where `brink run` puts the definitions that it runs."""


def commands_folder() -> Path | None:
    """Return the folder of the definitions that may run on this machine; None if there is none."""
    named = os.environ.get(COMMANDS_VARIABLE)
    folder = OWN_FOLDER if named is None else Path(named)
    return folder if named != "" and folder.is_dir() else None


def own_folder() -> Path:
    """Return the folder of the definitions that workers of this command may run; make it if need be.

    Raises:
        DefinitionError: The variable is empty, so the workers would wait for ever.
    """
    named = os.environ.get(COMMANDS_VARIABLE)
    if named == "":
        raise DefinitionError(
            "problem", f"no programs may run here: {COMMANDS_VARIABLE} is empty; unset it, or name a folder"
        )
    folder = OWN_FOLDER if named is None else Path(named)
    folder.mkdir(parents=True, exist_ok=True)
    return folder

"""Which drives can be exported, and how. This module has no heavy imports, and needs no extra."""

from enum import StrEnum
from typing import Final

from brink.sim.errors import InvalidEpisode

MODULES: Final = ("scenariogeneration", "cv2")
"""Modules of the extra `exchange`, without which nothing can be exported."""
URBAN_SIMULATORS: Final = ("brink-drive@3", "brink-drive-errors@2", "brink-drive-camera@3")
ENCOUNTER_SIMULATORS: Final = ("brink-encounter@2", "brink-encounter-camera@3")
STREET_SIMULATORS: Final = ("brink-aeb@2", "brink-aeb@3")
EXPORTABLE: Final = (*URBAN_SIMULATORS, *ENCOUNTER_SIMULATORS, *STREET_SIMULATORS)
"""Simulators whose worlds have roads that can be exported."""
SCENARIO_FILE: Final = "scenario.xosc"
EXPORTED: Final = (SCENARIO_FILE, "verdicts.json", "value-sets.xosc")
"""Files by which a folder is known as an earlier export."""
PROBLEMS: Final = ("urban-injected@1", "urban-errors@1", "urban-camera@1", "npc-actions@1", "aeb-crossing@1")
"""Problems that use them."""


class NotExportable(InvalidEpisode):
    """The world of a drive has no roads that can be exported."""


class EgoControl(StrEnum):
    """What moves the ego in an exported scenario."""

    RECORDED = "recorded"
    """Its recorded trajectory."""
    CONTROLLED = "controlled"
    """A controller of the simulator that runs the scenario."""


def check_exportable(simulator: str | None) -> None:
    """Check that the drives of a simulator can be exported.

    Args:
        simulator: Id of the simulator; None if the solution was not simulated.

    Raises:
        NotExportable: They cannot.
    """
    if simulator not in EXPORTABLE:
        drive = "a solution that was not simulated" if simulator is None else f"a drive of {simulator}"
        raise NotExportable(
            f"{drive} has no roads that can be exported; expected a drive of {', '.join(PROBLEMS)}, or of another "
            f"problem that uses {', '.join(EXPORTABLE)}"
        )

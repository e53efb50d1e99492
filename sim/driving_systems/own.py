"""Brink's own driving system, `modular@1`, behind the interface for all of them."""

from typing import ClassVar, Final

from brink.sim.driving.interface import Observation
from brink.sim.driving_systems.interface import Decision, Needs, Start
from brink.sim.errors import InvalidEpisode

LEAVES_ALL: Final = Decision()


class OwnSystem:
    """Leaves everything out of its decisions, so that the seam fills in what Brink's own driving system decides.

    Args:
        start: The start of the drive, without settings.

    Raises:
        InvalidEpisode: There are settings.
    """

    needs: ClassVar[Needs] = "boxes"

    def __init__(self, start: Start) -> None:
        if start.settings:
            raise InvalidEpisode(
                f"driving_settings: Brink's own driving system has none, got {start.settings}"
            )

    def step(self, observation: Observation) -> Decision:
        """Decide what the ego does until the next control step."""
        return LEAVES_ALL

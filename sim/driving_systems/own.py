"""Brink's own driving system, `modular@1`, behind the interface for all of them."""

from typing import ClassVar

from brink.sim.driving.interface import Observation, PerceivedObstacle
from brink.sim.driving.system import ModularDriving
from brink.sim.driving_systems.interface import Decision, Needs, Start
from brink.sim.errors import InvalidEpisode


class OwnSystem:
    """Implements `brink.sim.driving_systems.DrivingSystem` with `ModularDriving`.

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
        self._driving = ModularDriving(start.route, camera=start.camera)

    def step(self, observation: Observation) -> Decision:
        """Decide what the ego does until the next control step."""
        driving = self._driving
        command = driving.step(observation)
        mode, target_speed_mps, target_offset_m = driving.plan
        return Decision(
            accel_mps2=command.accel_mps2,
            steer_rad=command.steer_rad,
            mode=mode,
            target_speed_mps=target_speed_mps,
            target_offset_m=target_offset_m,
        )

    @property
    def believed_objects(self) -> tuple[PerceivedObstacle, ...]:
        """The confirmed tracks, in the world."""
        return self._driving.obstacles

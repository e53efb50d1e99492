"""An emergency brake alone: Brink's own system steers and drives, and this one brakes when a crash is near.

brink --plugin aeb run aeb.yaml
"""

from typing import ClassVar

from brink.sim.driving_systems import Decision, Observation, Start


class EmergencyBrake:
    """Brakes hard if an object straight ahead would be reached within a second and a half."""

    needs: ClassVar = "objects"

    def __init__(self, start: Start) -> None:
        self.bumper_m, self.reach_m = start.car.length_m / 2, start.car.width_m / 2 + 0.2
        self.within_s = float(str(start.settings.get("within_s", 1.5)))
        self.until_s = 0.0

    def step(self, observation: Observation) -> Decision:
        for one in observation.objects or ():
            gap_m = one.x_m - one.length_m / 2 - self.bumper_m
            closing_mps = observation.ego.speed_mps - one.vx_mps
            is_ahead = gap_m > 0 and abs(one.y_m) < self.reach_m + one.width_m / 2
            if is_ahead and gap_m < self.within_s * closing_mps:
                self.until_s = observation.time_s + 0.5
        if observation.time_s < self.until_s:
            return Decision(accel_mps2=-8.0, emergency=True, mode="emergency brake")
        return Decision()

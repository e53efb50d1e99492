"""Owns traffic lights: fixed cycles with a phase, two groups that are never green together."""

from dataclasses import dataclass

from sim.driving.interface import LightState

GREEN_S = 9.0
AMBER_S = 2.5
ALL_RED_S = 2.0
CYCLE_S = 2.0 * (GREEN_S + AMBER_S + ALL_RED_S)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalPlan:
    """The lights of one junction.

    Attributes:
        phase_s: Where in its cycle the main road's group is at time 0; green begins at phase 0.
    """

    phase_s: float

    def main_at(self, time_s: float) -> LightState:
        """Return what drivers on the main road see."""
        return _state((time_s + self.phase_s) % CYCLE_S)

    def side_at(self, time_s: float) -> LightState:
        """Return what drivers on the side streets see."""
        return _state((time_s + self.phase_s + 0.5 * CYCLE_S) % CYCLE_S)

    def main_red_for_s(self, time_s: float) -> float:
        """Return for how long the main road stays red, 0 if it is not red; people cross it then."""
        in_cycle = (time_s + self.phase_s) % CYCLE_S
        return CYCLE_S - in_cycle if in_cycle >= GREEN_S + AMBER_S else 0.0


def _state(in_cycle_s: float) -> LightState:
    if in_cycle_s < GREEN_S:
        return LightState.GREEN
    return LightState.AMBER if in_cycle_s < GREEN_S + AMBER_S else LightState.RED

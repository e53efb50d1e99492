"""Owns traffic lights: fixed cycles with a phase, two groups that are never green together."""

from dataclasses import dataclass

from brink.sim.driving.interface import LightState

MAIN_GREEN_S = 12.0
SIDE_GREEN_S = 7.0
AMBER_S = 2.5
ALL_RED_S = 2.0
CYCLE_S = MAIN_GREEN_S + SIDE_GREEN_S + 2.0 * (AMBER_S + ALL_RED_S)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalPlan:
    """The lights of one junction.

    Attributes:
        phase_s: Where in its cycle the junction is at time 0; the main road's green begins at 0.
    """

    phase_s: float

    def main_at(self, time_s: float) -> LightState:
        """Return what drivers on the main road see."""
        return _state((time_s + self.phase_s) % CYCLE_S, MAIN_GREEN_S)

    def side_at(self, time_s: float) -> LightState:
        """Return what drivers on the side streets see."""
        begins_s = MAIN_GREEN_S + AMBER_S + ALL_RED_S
        return _state((time_s + self.phase_s - begins_s) % CYCLE_S, SIDE_GREEN_S)

    def main_red_for_s(self, time_s: float) -> float:
        """Return for how long the main road stays red, 0 if it is not red; people cross it then."""
        in_cycle_s = (time_s + self.phase_s) % CYCLE_S
        return CYCLE_S - in_cycle_s if in_cycle_s >= MAIN_GREEN_S + AMBER_S else 0.0


def _state(in_cycle_s: float, green_s: float) -> LightState:
    if in_cycle_s < green_s:
        return LightState.GREEN
    return LightState.AMBER if in_cycle_s < green_s + AMBER_S else LightState.RED

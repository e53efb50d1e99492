"""`red-light`: the ego's front bumper does not pass a stop line while its light is red.

Passing at amber is allowed, and so is going on at red what was entered before.
"""

from brink.sim.driving.interface import LightState
from brink.sim.requirements.margin import Margin
from brink.sim.requirements.requirement import WorldSample

_LEAST_M = 1e-6


class RedLight(Margin):
    """Robustness in metres: before a red light the distance to the line; past one entered at red, minus the overrun.

    It is the horizon where no light is red. The overrun counts for as long as the light is red, so that stopping just
    past the line is a small violation and driving through a large one.
    """

    unit = "m"
    horizon = 10.0

    def __init__(self) -> None:
        super().__init__()
        self._was_before = False
        self._entered_at_red = False

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the distance to a red light's line, negative past it."""
        gap_m = sample.stop_line_gap_m
        if gap_m is None:
            self._was_before = self._entered_at_red = False
            return self.horizon
        is_red = sample.light is LightState.RED
        if gap_m >= 0.0:
            self._was_before, self._entered_at_red = True, False
            return gap_m if is_red else self.horizon
        if self._was_before:
            self._entered_at_red = is_red
            self._was_before = False
        if not (self._entered_at_red and is_red):
            self._entered_at_red = False
            return self.horizon
        return min(gap_m, -_LEAST_M)

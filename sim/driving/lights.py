"""Red and amber lights: a comfortable stop before the line, and the choice in the dilemma zone.

At amber the ego goes on if it could only stop by braking hard, at red only if it could not stop before the line at
all; the choice for a line is kept until it is green, so that it does not waver. The light detector may miss a frame
or mistake one: a light that is no longer reported is believed for a while, and a change once it was reported for
`confirm_s`.
"""

from brink.sim.driving.gap import NO_LIMIT_MPS2, stop_accel
from brink.sim.driving.interface import LightReading, LightState
from brink.sim.driving.settings import LightSettings


class LightKeeper:
    """Remembers the last reading, and for which line it chose to go on."""

    __slots__ = ("_goes_on_at_m", "_other_since_s", "_reading", "_seen_s", "_settings", "_stopping")

    def __init__(self, settings: LightSettings) -> None:
        self._settings = settings
        self._reading: LightReading | None = None
        self._seen_s = 0.0
        self._other_since_s: float | None = None
        self._goes_on_at_m: float | None = None
        self._stopping = False

    def accel(self, time_s: float, reading: LightReading | None, front_m: float, speed_mps: float) -> float:
        """Return the highest acceleration in m/s^2 that the light allows.

        Args:
            time_s: Now.
            reading: What the light detector reports.
            front_m: Station of the ego's front bumper.
            speed_mps: The ego's speed.
        """
        settings = self._settings
        believed = self._believed(time_s, reading)
        if believed is None:
            self._stopping = False
            return NO_LIMIT_MPS2
        state, line_m = believed
        to_line_m = line_m - front_m
        if state is LightState.GREEN:
            self._stopping = False
            self._goes_on_at_m = None
            return NO_LIMIT_MPS2
        if to_line_m < 0.0:
            self._stopping = False
            return NO_LIMIT_MPS2
        if self._goes_on_at_m == line_m and speed_mps > 1.0:
            return NO_LIMIT_MPS2
        if not self._stopping:
            needed = speed_mps * speed_mps / (2.0 * max(to_line_m, 0.01))
            is_amber = state is LightState.AMBER
            if needed > (settings.amber_go_above_mps2 if is_amber else settings.red_go_above_mps2):
                self._goes_on_at_m = line_m
                return NO_LIMIT_MPS2
            self._stopping = True
        return stop_accel(
            settings.decel_mps2, settings.approach_gain_per_s, speed_mps, to_line_m - settings.stop_margin_m
        )

    def _believed(self, time_s: float, reading: LightReading | None) -> LightReading | None:
        settings, before = self._settings, self._reading
        if reading is None:
            if before is not None and time_s - self._seen_s > settings.memory_s:
                self._reading = None
            return self._reading
        self._seen_s = time_s
        is_other = (
            before is not None
            and before.state is not reading.state
            and before.stop_line_station_m == reading.stop_line_station_m
        )
        if not is_other:
            self._other_since_s = None
            self._reading = reading
        elif self._other_since_s is None:
            self._other_since_s = time_s
        elif time_s - self._other_since_s >= settings.confirm_s:
            self._other_since_s = None
            self._reading = reading
        return self._reading

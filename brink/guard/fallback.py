"""Fallbacks: how the car reacts while its guard asks for it.

A fallback sits on both sides of the driving system. Before it, it may remove boxes from the observation; after it, it
may change the command. It never steers, and it never accelerates harder than the driving system does. Three of them:

- `slow-down@1` caps the speed.
- `safe-stop@1` brakes firmly, to a stop if the alarm lasts that long.
- `ignore-boxes@1` hides boxes from the driving system that cannot be real.

`none@1` does nothing: the guard watches, and its alarms are recorded.

An intervention begins with an alarm. So that it does not chatter, it lasts for `least_s` at least and ends when
there has been no alarm for `clear_s`. An alarm that does not end would keep the car standing in the road, which is
dangerous as well: after `longest_s` an intervention ends all the same, and none begins for `rest_s`. Afterwards the
acceleration rises at `jerk_mps3` at most, since the driving system, which does not know of the intervention, asks
for all of it at once.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Final

from brink.guard.box_filter import BoxFilter, BoxFilterSettings
from brink.sim.driving.interface import CONTROL_STEP_S, Command, Observation
from brink.sim.guard.interface import GuardReading
from brink.sim.guard.setting import NoSettings, ranged

STANDS_BELOW_MPS: Final = 0.3
_HOLD_MPS2: Final = -2.0
"""Holds a stationary car on the steepest slope of the roads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InterventionSettings:
    """When interventions begin and end.

    Attributes:
        least_s: Shortest intervention.
        clear_s: An intervention ends when there has been no alarm for this long.
        longest_s: An intervention ends after this long at the latest...
        rest_s: ...and then none begins for this long.
    """

    least_s: float = ranged(1.0, low=0.0, high=30.0, unit="s")
    clear_s: float = ranged(0.5, low=0.0, high=30.0, unit="s")
    longest_s: float = ranged(30.0, low=0.5, high=600.0, unit="s")
    rest_s: float = ranged(2.0, low=0.0, high=60.0, unit="s")


class Intervention:
    """Turns alarms into interventions that do not chatter.

    Args:
        settings: When they begin and end.

    Attributes:
        active: Whether there is an intervention now.
    """

    __slots__ = ("_alarm_s", "_began_s", "_rests_until_s", "_settings", "active")

    def __init__(self, settings: InterventionSettings) -> None:
        self._settings = settings
        self.active = False
        self._began_s = 0.0
        self._alarm_s = -math.inf
        self._rests_until_s = -math.inf

    def step(self, time_s: float, alarm: bool) -> bool:
        """Return whether there is an intervention at a control step.

        Args:
            time_s: Simulated time, increasing.
            alarm: Whether the guard raises an alarm.
        """
        settings = self._settings
        if alarm:
            self._alarm_s = time_s
        if not self.active:
            if alarm and time_s >= self._rests_until_s:
                self.active, self._began_s = True, time_s
            return self.active
        lasts_s = time_s - self._began_s
        if lasts_s >= settings.longest_s:
            self.active = False
            self._rests_until_s = time_s + settings.rest_s
        elif lasts_s >= settings.least_s and not alarm and time_s - self._alarm_s >= settings.clear_s:
            self.active = False
        return self.active


class _LimitsAcceleration(ABC):
    """Base class of fallbacks that limit the acceleration.

    Args:
        settings: When interventions begin and end.
        jerk_mps3: How fast the acceleration rises afterwards.
    """

    waits_for_alarm: ClassVar[bool] = True

    def __init__(self, settings: InterventionSettings, jerk_mps3: float) -> None:
        self._intervention = Intervention(settings)
        self._rise_mps2 = jerk_mps3 * CONTROL_STEP_S
        self._accel_mps2 = math.inf

    @property
    def active(self) -> bool:
        """Whether it intervened in the last control step."""
        return self._intervention.active

    def perceive(self, observation: Observation, reading: GuardReading) -> Observation:
        """Return the observation unchanged."""
        return observation

    def step(self, observation: Observation, command: Command, reading: GuardReading) -> Command:
        """Return the command with an acceleration that the fallback allows."""
        accel_mps2 = command.accel_mps2
        if self._intervention.step(observation.time_s, reading.alarm):
            accel_mps2 = min(accel_mps2, self._limit_mps2(observation.ego.speed_mps))
        elif accel_mps2 > self._accel_mps2:
            accel_mps2 = min(accel_mps2, max(self._accel_mps2, 0.0) + self._rise_mps2)
        changed = accel_mps2 < command.accel_mps2
        self._accel_mps2 = accel_mps2 if changed else math.inf
        return command._replace(accel_mps2=accel_mps2) if changed else command

    @abstractmethod
    def _limit_mps2(self, speed_mps: float) -> float:
        """Return the highest acceleration during an intervention."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowDownSettings(InterventionSettings):
    """Settings of `slow-down@1`.

    Attributes:
        speed_mps: The car drives no faster than this.
        decel_mps2: Deceleration to that speed.
        jerk_mps3: How fast the acceleration rises afterwards.
    """

    speed_mps: float = ranged(3.0, low=0.5, high=20.0, unit="m/s")
    decel_mps2: float = ranged(3.0, low=0.5, high=8.0, unit="m/s²")
    jerk_mps3: float = ranged(3.0, low=0.5, high=100.0, unit="m/s³")
    longest_s: float = ranged(600.0, low=0.5, high=600.0, unit="s")


class SlowDown(_LimitsAcceleration):
    """`slow-down@1`: caps the speed. A slow car blocks nobody, so alarms may last.

    Args:
        settings: Its settings.
    """

    settings_type: ClassVar[type[SlowDownSettings]] = SlowDownSettings
    _GAIN_PER_S: ClassVar[float] = 2.0

    def __init__(self, settings: SlowDownSettings) -> None:
        super().__init__(settings, settings.jerk_mps3)
        self._settings = settings

    def _limit_mps2(self, speed_mps: float) -> float:
        settings = self._settings
        return max(self._GAIN_PER_S * (settings.speed_mps - speed_mps), -settings.decel_mps2)


@dataclass(frozen=True, slots=True, kw_only=True)
class SafeStopSettings(InterventionSettings):
    """Settings of `safe-stop@1`.

    Attributes:
        decel_mps2: Deceleration; 2 is comfortable, 4 firm, and a wet road allows no more than about 6.
        jerk_mps3: How fast the acceleration rises afterwards.
    """

    decel_mps2: float = ranged(4.0, low=0.5, high=8.0, unit="m/s²")
    jerk_mps3: float = ranged(3.0, low=0.5, high=100.0, unit="m/s³")


class SafeStop(_LimitsAcceleration):
    """`safe-stop@1`: brakes, to a stop if the alarm lasts that long, and continues when it is over.

    Args:
        settings: Its settings.
    """

    settings_type: ClassVar[type[SafeStopSettings]] = SafeStopSettings

    def __init__(self, settings: SafeStopSettings) -> None:
        super().__init__(settings, settings.jerk_mps3)
        self._settings = settings

    def _limit_mps2(self, speed_mps: float) -> float:
        return _HOLD_MPS2 if speed_mps < STANDS_BELOW_MPS else -self._settings.decel_mps2


@dataclass(frozen=True, kw_only=True)
class IgnoreBoxesSettings(InterventionSettings, BoxFilterSettings):
    """Settings of `ignore-boxes@1`."""

    longest_s: float = ranged(600.0, low=0.5, high=600.0, unit="s")


class IgnoreBoxes:
    """`ignore-boxes@1`: hides implausible boxes from the driving system; see `BoxFilter`.

    It prevents violations that ghosts cause, such as swerving around nothing, and none by what is not reported. A
    real road user who is detected late looks like one who appears from nothing, so it may do harm.

    Args:
        settings: Its settings.
    """

    settings_type: ClassVar[type[IgnoreBoxesSettings]] = IgnoreBoxesSettings
    waits_for_alarm: ClassVar[bool] = True

    def __init__(self, settings: IgnoreBoxesSettings) -> None:
        self._intervention = Intervention(settings)
        self._filter = BoxFilter(settings)

    @property
    def active(self) -> bool:
        """Whether it intervened in the last control step."""
        return self._intervention.active

    def perceive(self, observation: Observation, reading: GuardReading) -> Observation:
        """Return the observation without implausible boxes, during an intervention."""
        active = self._intervention.step(observation.time_s, reading.alarm)
        if observation.boxes is None:
            return observation
        plausible = self._filter.plausible(observation.time_s, observation.ego, observation.boxes)
        return replace(observation, boxes=plausible) if active else observation

    def step(self, observation: Observation, command: Command, reading: GuardReading) -> Command:
        """Return the command unchanged."""
        return command


class NoFallback:
    """`none@1`: does nothing."""

    settings_type: ClassVar[type[NoSettings]] = NoSettings
    waits_for_alarm: ClassVar[bool] = True
    active: Final = False

    def __init__(self, settings: NoSettings) -> None:
        pass

    def perceive(self, observation: Observation, reading: GuardReading) -> Observation:
        """Return the observation unchanged."""
        return observation

    def step(self, observation: Observation, command: Command, reading: GuardReading) -> Command:
        """Return the command unchanged."""
        return command

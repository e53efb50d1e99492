"""A driving system with a guard beside it and a fallback around it, itself a driving system.

    boxes -> fallback -> driving system -> fallback -> command
               ^                      |       ^
               +------- guard <-------+-------+

The guard receives what was reported and what the driving system commands, not what the fallback makes of them:
otherwise an alarm would end as soon as the fallback acts. A fallback that hides boxes still changes the commands. The
fallback before the driving system knows the guard's reading of the step before.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from brink.sim.driving.interface import (
    CONTROL_STEP_S,
    Command,
    Driving,
    Observation,
    PerceivedObstacle,
    PlanState,
)
from brink.sim.episode import Json
from brink.sim.guard.interface import Fallback, Guard, GuardReading, RangeScan


class Guarded:
    """Implements `brink.sim.driving.interface.Driving`. Create a new one for each drive.

    Args:
        system: The driving system.
        guard: The guard.
        fallback: The fallback.
        fallback_id: Its id, for traces.
        scan: Returns the range sensor's scan at a simulated time, called at each perception step; None without a
            sensor.

    Attributes:
        fallback_id: Id of the fallback.
        account: What the guard and the fallback have done so far.
    """

    def __init__(
        self,
        system: Driving,
        guard: Guard,
        fallback: Fallback,
        *,
        fallback_id: str,
        scan: Callable[[float], RangeScan] | None = None,
    ) -> None:
        self._system = system
        self._guard = guard
        self._fallback = fallback
        self._scan = scan
        self.fallback_id = fallback_id
        self._reading = GuardReading(probabilities=(0.0,) * len(guard.horizons_s), alarm=False)
        self.account = GuardAccount()

    def step(self, observation: Observation) -> Command:
        """Run one control step and return the command that the car executes."""
        fallback = self._fallback
        command = self._system.step(fallback.perceive(observation, self._reading))
        scan = None
        if self._scan is not None and observation.boxes is not None:
            scan = self._scan(observation.time_s)
        self._reading = reading = self._guard.step(observation, command, self._system.plan, scan)
        executed = fallback.step(observation, command, reading)
        self.account.note(observation.time_s, alarm=reading.alarm, intervenes=fallback.active)
        self.account.peak = getattr(self._guard, "peak", None)
        return executed

    @property
    def plan(self) -> PlanState:
        """The driving system's own decision in the last step."""
        return self._system.plan

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """The obstacles that the driving system treated as real in the last step."""
        return self._system.obstacles

    @property
    def reading(self) -> GuardReading:
        """The guard's reading of the last step."""
        return self._reading

    @property
    def horizons_s(self) -> tuple[float, ...]:
        """The guard's horizons."""
        return self._guard.horizons_s

    @property
    def intervenes(self) -> bool:
        """Whether the fallback intervened in the last step."""
        return self._fallback.active


@dataclass(slots=True)
class GuardAccount:
    """What a guard and a fallback did in a drive.

    Attributes:
        alarms_s: When each alarm began.
        alarm_steps: Control steps with an alarm.
        interventions_s: When each intervention began.
        intervention_steps: Control steps with an intervention.
        peak: The highest threshold that would have raised an alarm; None if the guard does not say.
    """

    alarms_s: list[float] = field(default_factory=list)
    alarm_steps: int = 0
    interventions_s: list[float] = field(default_factory=list)
    intervention_steps: int = 0
    peak: float | None = None
    _alarm: bool = False
    _intervenes: bool = False

    def note(self, time_s: float, *, alarm: bool, intervenes: bool) -> None:
        """Record a control step."""
        if alarm:
            self.alarm_steps += 1
            if not self._alarm:
                self.alarms_s.append(time_s)
        if intervenes:
            self.intervention_steps += 1
            if not self._intervenes:
                self.interventions_s.append(time_s)
        self._alarm, self._intervenes = alarm, intervenes

    def features(self) -> dict[str, Json]:
        """Return the account as features of an episode."""
        return {
            "guard:alarms_s": list(self.alarms_s),
            "guard:alarm_s": self.alarm_steps * CONTROL_STEP_S,
            "guard:interventions_s": list(self.interventions_s),
            "guard:intervention_s": self.intervention_steps * CONTROL_STEP_S,
            **({} if self.peak is None else {"guard:peak": self.peak}),
        }

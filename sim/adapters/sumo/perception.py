"""The perception of automated vehicles in SUMO: how an error acts on what their drivers perceive.

SUMO's driver state keeps one number for each vehicle, the error state. Its product with a coefficient and with the
distance of what is ahead is added to that distance, or to the speed of the vehicle ahead. An error is therefore a few
options for all vehicles, and a change of the state of the affected ones when it begins and ends.

The distance that counts is the gap without the 2.5 m that vehicles keep when they stand. Within these, a vehicle
ahead is therefore perceived whatever the error, as by a sensor for parking.
"""

import math
from collections.abc import Mapping
from typing import Final

from brink.sim.adapters.sumo.library import SUMO_STEP_S, Library
from brink.sim.adapters.sumo.specification import RANGE_M, Affected, ErrorType, PerceptionError

NOT_PERCEIVED: Final = 1000.0
"""Error state with which a thing ahead seems so far away that it has no effect."""
_STATE: Final = "device.driverstate."
_ATTENTIVE: Final = 1.0
"""Awareness with which SUMO has no error."""
_INATTENTIVE: Final = 0.5
_CORRELATION_S: Final = 5.0
"""Time over which noise is correlated: what is seen too far away stays so for a while."""
_FOREVER_S: Final = 1e12
ALL_CHECKS: Final = 31
"""SUMO's speed mode, a sum of checks."""
_STOPS_AT_RED: Final = 16
_STOPPING: Final = "ryu"
"""States of traffic lights before which vehicles stop, as SUMO's letters."""


def driver_state_options(error: PerceptionError | None) -> list[str]:
    """Return the SUMO options that produce an error in vehicles with a driver state."""
    kind = None if error is None else error.type
    scale_s = _CORRELATION_S if kind is ErrorType.NOISE else _FOREVER_S
    sigma = error.magnitude if error is not None and kind is ErrorType.NOISE else 0.0
    options = {
        "initialAwareness": _ATTENTIVE,
        "minAwareness": 0.1,
        "errorTimeScaleCoefficient": scale_s / _INATTENTIVE,
        "errorNoiseIntensityCoefficient": sigma / (1.0 - _INATTENTIVE),
        "headwayErrorCoefficient": 0.0 if kind is ErrorType.TOO_FAST else 1.0,
        "speedDifferenceErrorCoefficient": 1.0 if kind is ErrorType.TOO_FAST else 0.0,
        # Every change is perceived at once: how late things are perceived is an error of its own.
        "headwayChangePerceptionThreshold": 0.0,
        "speedDifferenceChangePerceptionThreshold": 0.0,
    }
    return [word for name, value in options.items() for word in (f"--{_STATE}{name}", repr(value))]


class Perception:
    """Makes the vehicles that an error affects perceive with it while it lasts.

    Args:
        sumo: The simulation.
        error: The error; None for the truth.
        ego: Id of the ego.

    Attributes:
        acted_at_s: When the error first acted on a vehicle; None if it never did.
    """

    def __init__(self, sumo: Library, error: PerceptionError | None, ego: str) -> None:
        self._sumo = sumo
        self._error = error
        self._ego = ego
        self._affected: dict[str, None] = {}
        self._wrong: dict[str, None] = {}
        self._runs_red: dict[str, str | None] = {}
        self.acted_at_s: float | None = None

    def enter(self, vehicle: str) -> None:
        """Register a vehicle that has entered the network."""
        error = self._error
        if error is None:
            return
        is_automated = vehicle == self._ego or (
            error.affected is Affected.FLEET
            and self._sumo.vehicle.getParameter(vehicle, "has.driverstate.device") == "true"
        )
        if is_automated:
            self._affected[vehicle] = None

    def leave(self, vehicle: str) -> None:
        """Forget a vehicle that has left the network."""
        self._affected.pop(vehicle, None)
        self._wrong.pop(vehicle, None)
        self._runs_red.pop(vehicle, None)

    def update(self, time_s: float) -> None:
        """Start, continue or end the error, before the simulation step that starts at a time."""
        error = self._error
        if error is None:
            return
        # Half a step, because times are sums of steps.
        lasts = error.onset_s - SUMO_STEP_S / 2 <= time_s < error.onset_s + error.duration_s - SUMO_STEP_S / 2
        for vehicle in self._affected if lasts else ():
            if vehicle not in self._wrong:
                self._begin(vehicle, error)
                self._wrong[vehicle] = None
                self._runs_red[vehicle] = None
                if self.acted_at_s is None:
                    self.acted_at_s = time_s
            if error.type is ErrorType.SHORT_RANGE:
                far = self._nearest_ahead_m(vehicle) > error.magnitude
                self._set(vehicle, "errorState", NOT_PERCEIVED if far else 0.0)
        for vehicle in list(self._wrong) if not lasts else ():
            self._end(vehicle, error)
            del self._wrong[vehicle]
        for vehicle in self._runs_red:
            self._let_pass(vehicle)

    def gap_state(self) -> float:
        """Return the relative error in the ego's perceived distance to something ahead; positive if too far."""
        error = self._error
        if error is None or self._ego not in self._wrong or error.type in _RIGHT_DISTANCE:
            return 0.0
        return float(self._sumo.vehicle.getParameter(self._ego, f"{_STATE}errorState"))

    def _begin(self, vehicle: str, error: PerceptionError) -> None:
        if error.type is ErrorType.LATE:
            self._set(vehicle, "originalReactionTime", _in_steps_s(error.magnitude))
            return
        self._set(vehicle, "maximalReactionTime", SUMO_STEP_S)
        self._set(vehicle, "awareness", _INATTENTIVE)
        state = _STATES.get(error.type, 0.0) * error.magnitude
        self._set(vehicle, "errorState", NOT_PERCEIVED if error.type is ErrorType.MISS else state)

    def _end(self, vehicle: str, error: PerceptionError) -> None:
        if error.type is ErrorType.LATE:
            self._set(vehicle, "originalReactionTime", SUMO_STEP_S)
        else:
            self._set(vehicle, "awareness", _ATTENTIVE)

    def _let_pass(self, vehicle: str) -> None:
        """Let a vehicle run a red light in front of which it can no longer stop.

        SUMO would stop it at the line within one step, however fast it is. This can only concern vehicles whose
        perception is or was wrong.
        """
        own, passing = self._sumo.vehicle, self._runs_red[vehicle]
        lights = own.getNextTLS(vehicle)
        name, _, distance_m, state = lights[0] if lights else ("", 0, math.inf, "")
        if passing is not None:
            if name != passing:
                own.setSpeedMode(vehicle, ALL_CHECKS)
                self._runs_red[vehicle] = None
        elif state == "r":
            stops_within_m = own.getSpeed(vehicle) ** 2 / (2.0 * own.getEmergencyDecel(vehicle))
            if stops_within_m > distance_m:
                own.setSpeedMode(vehicle, ALL_CHECKS - _STOPS_AT_RED)
                self._runs_red[vehicle] = name

    def _nearest_ahead_m(self, vehicle: str) -> float:
        """Return the distance of the nearest vehicle or red light ahead; 0 without any."""
        own = self._sumo.vehicle
        lead = own.getLeader(vehicle, RANGE_M)
        lights = own.getNextTLS(vehicle)
        nearest_m = lead[1] + own.getMinGap(vehicle) if lead else math.inf
        if lights and lights[0][3] in _STOPPING:
            nearest_m = min(nearest_m, lights[0][2])
        return 0.0 if math.isinf(nearest_m) else float(nearest_m)

    def _set(self, vehicle: str, name: str, value: float) -> None:
        self._sumo.vehicle.setParameter(vehicle, f"{_STATE}{name}", repr(value))


_STATES: Final[Mapping[ErrorType, float]] = {
    ErrorType.TOO_FAR: 1.0,
    ErrorType.TOO_NEAR: -1.0,
    # Metres per second for each 10 m of distance; SUMO wants them for each metre.
    ErrorType.TOO_FAST: 0.1,
}
"""The error state of an error of magnitude 1."""
_RIGHT_DISTANCE: Final = (ErrorType.TOO_FAST, ErrorType.LATE)


def _in_steps_s(time_s: float) -> float:
    """Round a duration to a whole number of steps, at least one."""
    return round(max(1, round(time_s / SUMO_STEP_S)) * SUMO_STEP_S, 6)

"""`ttc@1` and `range-ttc@1`: thresholds on the time to collision, with which every fitted guard is compared.

They learn nothing. The probability of a violation within h seconds is h / (h + t), where t is the shortest time to
collision in the ego's path: 1 on contact, and 0.5 at t = h. `ttc@1` takes it from the reported boxes. `range-ttc@1`
takes it from the range sensor, and to a distance of two metres instead of contact: nearer than that, a car that goes
on would soon be nearer than the front gap allows.

Alarms are confirmed and held like those of a fitted guard, but end when the probability falls below the threshold,
not below half of it. So a fitted guard has fewer and longer alarms in the same number of drives.
"""

from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from brink.guard.features import FEATURES, MAX_TTC_S, TTC, FeatureExtractor, FeatureVector
from brink.guard.model import AlarmRule
from brink.guard.monitor import Alarm
from brink.guard.range_features import MIN_CLOSING_MPS, RANGE_FEATURES
from brink.sim.driving.interface import Command, Observation, PlanState, Route
from brink.sim.guard.interface import GuardReading, KnownConditions, RangeScan

HORIZONS_S: Final = (1.0, 2.0, 3.0)
DECIDING: Final = 1
"""Index of the horizon whose probability decides about the alarm."""
KEPT_M: Final = 2.0
_PATH, _CLOSING = (
    len(FEATURES) + RANGE_FEATURES.index(name) for name in ("range_path_m", "range_path_closing_mps")
)


def box_times_s(features: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the time to collision on reported boxes, at most `MAX_TTC_S`, shape ``(n,)``.

    Args:
        features: Feature vectors, shape ``(n, features)``.
    """
    times_s: NDArray[np.float64] = np.clip(features[:, TTC].astype(np.float64), 0.0, MAX_TTC_S)
    return times_s


def range_times_s(features: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the time until the range sensor measures `KEPT_M` in the path, at most `MAX_TTC_S`, shape ``(n,)``.

    Args:
        features: Feature vectors of a car with a range sensor, shape ``(n, features)``.
    """
    room_m, closing_mps = (features[:, place].astype(np.float64) for place in (_PATH, _CLOSING))
    room_m = np.maximum(room_m - KEPT_M, 0.0)
    times_s = np.full(room_m.size, MAX_TTC_S)
    np.divide(room_m, closing_mps, out=times_s, where=closing_mps > MIN_CLOSING_MPS)
    times_s[room_m <= 0.0] = 0.0
    return np.asarray(np.minimum(times_s, MAX_TTC_S), np.float64)


class TimeToCollision:
    """`ttc@1`: by the reported boxes. Create a new one for each drive.

    Args:
        route: The route of the drive.
        conditions: What the car knows about the time of day and the weather.
        threshold: The alarm is raised from this probability of a violation within two seconds on; by default 0.5,
            which is a time to collision of two seconds.
    """

    needs_scan: ClassVar[bool] = False
    own_threshold: ClassVar[float] = 0.5

    def __init__(self, route: Route, conditions: KnownConditions, threshold: float | None = None) -> None:
        self._extractor = FeatureExtractor(route, conditions, ranges=self.needs_scan)
        threshold = self.own_threshold if threshold is None else threshold
        self._alarm = Alarm(AlarmRule(horizon_s=HORIZONS_S[DECIDING], threshold=threshold, release=threshold))
        self._reading = GuardReading(probabilities=(0.0,) * len(HORIZONS_S), alarm=False)

    @property
    def peak(self) -> float:
        """The highest threshold that would have raised an alarm so far; 0 if none would have."""
        return self._alarm.peak

    @property
    def horizons_s(self) -> tuple[float, ...]:
        """The horizons of the probabilities in seconds, ascending."""
        return HORIZONS_S

    def step(
        self,
        observation: Observation,
        command: Command,
        plan: PlanState | None = None,
        scan: RangeScan | None = None,
    ) -> GuardReading:
        """Process one control step and return the current reading, which changes at perception steps."""
        if observation.boxes is not None:
            time_s = self._time_s(self._extractor.step(observation, command, plan, scan))
            probabilities = tuple(
                0.0 if time_s >= MAX_TTC_S else horizon_s / (horizon_s + time_s) for horizon_s in HORIZONS_S
            )
            self._reading = GuardReading(
                probabilities=probabilities, alarm=self._alarm.step(probabilities[DECIDING])
            )
        return self._reading

    def _time_s(self, features: FeatureVector) -> float:
        """Return the time to collision, `MAX_TTC_S` if there is none."""
        return float(box_times_s(features[None])[0])


class RangeTimeToCollision(TimeToCollision):
    """`range-ttc@1`: by the range sensor. Create a new one for each drive."""

    needs_scan: ClassVar[bool] = True

    def _time_s(self, features: FeatureVector) -> float:
        return float(range_times_s(features[None])[0])

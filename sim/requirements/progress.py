"""`progress`: the ego is not stuck, and does not stand where that is dangerous.

A standstill with a cause (a red light, a vehicle or person close ahead, the goal) is no lack of progress. Standing
without one is allowed for ten seconds in its lane, and for four in the oncoming lane, in a junction or on a crossing.
"""

from collections.abc import Mapping

from brink.sim.episode import Json
from brink.sim.requirements.margin import Margin
from brink.sim.requirements.requirement import WorldSample

STUCK_S = 10.0
DANGEROUS_S = 4.0
STANDS_BELOW_MPS = 0.3


class Progress(Margin):
    """Robustness: how much longer the ego may stand as it does, in seconds."""

    unit = "s"
    horizon = 30.0

    def __init__(
        self,
        stuck_s: float = STUCK_S,
        dangerous_s: float = DANGEROUS_S,
        stands_below_mps: float = STANDS_BELOW_MPS,
    ) -> None:
        super().__init__()
        self._stuck_s = stuck_s
        self._dangerous_s = dangerous_s
        self._stands_below_mps = stands_below_mps
        self._idle_s = 0.0
        self._danger_s = 0.0
        self._longest_idle_s = 0.0
        self._longest_danger_s = 0.0
        self._time_s: float | None = None

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the time left until a standstill without cause is too long; all of it while the ego moves."""
        elapsed_s = 0.0 if self._time_s is None else sample.time_s - self._time_s
        self._time_s = sample.time_s
        stands = abs(sample.speed_mps) < self._stands_below_mps
        if not stands or sample.may_wait or sample.goal_reached:
            self._idle_s = self._danger_s = 0.0
        else:
            self._idle_s += elapsed_s
            self._danger_s = self._danger_s + elapsed_s if sample.in_conflict_area else 0.0
            self._longest_idle_s = max(self._longest_idle_s, self._idle_s)
            self._longest_danger_s = max(self._longest_danger_s, self._danger_s)
        left_s = self._stuck_s - self._idle_s
        return min(left_s, self._dangerous_s - self._danger_s) if sample.in_conflict_area else left_s

    def features(self) -> Mapping[str, Json]:
        """Return the longest standstills without a cause, in seconds."""
        return {
            "longest_idle_s": self._longest_idle_s,
            "longest_dangerous_stop_s": self._longest_danger_s,
        }

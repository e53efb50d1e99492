"""`front-gap`: at least 1.5 m, bumper to bumper, to the nearest vehicle ahead in the ego's corridor.

Source: the requirement of the case study of Sharifi et al. 2023, section V; here by exact clearance.
"""

from collections.abc import Mapping

from brink.sim.episode import Json
from brink.sim.requirements.margin import Margin
from brink.sim.requirements.requirement import WorldSample

REQUIRED_GAP_M = 1.5


class FrontGap(Margin):
    """Robustness: the gap less what is required, in metres."""

    unit = "m"
    horizon = 50.0

    def __init__(self, required_gap_m: float = REQUIRED_GAP_M) -> None:
        super().__init__()
        self._required_gap_m = required_gap_m
        self._smallest_gap_m: float | None = None

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the gap less what is required; the horizon if nobody is ahead."""
        gap_m = sample.front_gap_m
        if gap_m is None:
            return self.horizon
        if self._smallest_gap_m is None or gap_m < self._smallest_gap_m:
            self._smallest_gap_m = gap_m
        return gap_m - self._required_gap_m

    def features(self) -> Mapping[str, Json]:
        """Return the smallest gap in metres, None if nobody ever was ahead."""
        return {"smallest_front_gap_m": self._smallest_gap_m}

"""`no-dangerous-stop`: emergency braking never brings the ego to a stand without a reason on the road."""

from collections.abc import Mapping

from brink.sim.episode import Json
from brink.sim.requirements.margin import Margin
from brink.sim.requirements.requirement import WorldSample

STANDS_BELOW_MPS = 0.5


class NoDangerousStop(Margin):
    """Robustness: by how much the ego is still faster than standing, in m/s, while it brakes for nothing.

    The horizon where it does not brake, or where somebody was in the warning region or on a course into it since the
    braking began. Source: Ferreira et al. 2022, who describe dangerous stops and do not compute them.
    """

    unit = "m/s"
    horizon = 8.0

    def __init__(self) -> None:
        super().__init__()
        self._stops = 0
        self._stands = False

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the speed above standing while braking for nothing, else the horizon."""
        if not sample.brakes_for_nothing:
            self._stands = False
            return self.horizon
        margin_mps = sample.speed_mps - STANDS_BELOW_MPS
        if margin_mps < 0.0 and not self._stands:
            self._stops += 1
            self._stands = True
        return margin_mps

    def features(self) -> Mapping[str, Json]:
        """Return how many dangerous stops there were."""
        return {"dangerous_stops": self._stops}

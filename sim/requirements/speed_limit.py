"""`speed-limit`: the ego is not faster than allowed, but for the tolerance of its speedometer."""

from brink.sim.requirements.margin import Margin
from brink.sim.requirements.requirement import WorldSample

TOLERANCE_MPS = 0.5


class SpeedLimit(Margin):
    """Robustness: how much faster the ego might be, in m/s."""

    unit = "m/s"
    horizon = 50.0

    def __init__(self, tolerance_mps: float = TOLERANCE_MPS) -> None:
        super().__init__()
        self._tolerance_mps = tolerance_mps

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the limit plus tolerance less the speed."""
        return sample.speed_limit_mps + self._tolerance_mps - abs(sample.speed_mps)

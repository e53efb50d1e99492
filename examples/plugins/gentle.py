"""A requirement as a plug-in: the ego brakes with at most 3 m/s². Run it with

cd examples/plugins && brink --plugin gentle run gentle.yaml
"""

from brink.sim.catalogue import REQUIREMENTS, register
from brink.sim.requirements import Margin

COMFORTABLE_MPS2 = 3.0


class Gentle(Margin):
    """Robustness: margin to the limit in m/s², from the speeds of two control steps."""

    unit = "m/s²"
    horizon = 10.0

    def __init__(self):
        super().__init__()
        self._before = None

    def robustness_at(self, sample):
        before, self._before = self._before, sample
        if before is None:
            return self.horizon
        braking = (before.speed_mps - sample.speed_mps) / (sample.time_s - before.time_s)
        return COMFORTABLE_MPS2 - braking


register(REQUIREMENTS, "gentle@1", Gentle)

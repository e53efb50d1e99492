"""A requirement with another threshold as a plug-in: at least 3 m to the vehicle ahead instead of 1.5 m. Run it with

cd examples/plugins && brink --plugin wide_gap run wide_gap.yaml
"""

from brink.sim.catalogue import REQUIREMENTS, register
from brink.sim.requirements import FrontGap


class WideGap(FrontGap):
    """The ego keeps at least 3 m to the nearest vehicle ahead."""

    def __init__(self):
        super().__init__(required_gap_m=3.0)


register(REQUIREMENTS, "front-gap-3-m@1", WideGap)

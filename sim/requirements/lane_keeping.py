"""`lane-keeping`: the ego's body stays inside its lane, but for the width of a marking."""

import math

from brink.sim.requirements.margin import Margin
from brink.sim.requirements.requirement import WorldSample

TOLERANCE_M = 0.2


class LaneKeeping(Margin):
    """Robustness: the distance in metres of the body's outermost corner from the lane's edge, plus the tolerance."""

    unit = "m"
    horizon = 5.0

    def __init__(self, tolerance_m: float = TOLERANCE_M) -> None:
        super().__init__()
        self._tolerance_m = tolerance_m

    def robustness_at(self, sample: WorldSample) -> float:
        """Return how far the body is inside its lane; negative outside."""
        error = sample.heading_error_rad
        reach_m = 0.5 * (
            sample.ego_width_m * abs(math.cos(error)) + sample.ego_length_m * abs(math.sin(error))
        )
        to_left = sample.lane_left_m - sample.offset_m - reach_m
        to_right = sample.offset_m - reach_m - sample.lane_right_m
        return min(to_left, to_right) + self._tolerance_m

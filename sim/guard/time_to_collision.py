"""`ttc@1`: the guard that every other one is compared with, a threshold on the time to collision on reported boxes.

It learns nothing. The probability of a violation within h seconds is h / (h + t), where t is the shortest time to
collision: 1 on contact, and 0.5 at t = h. A box counts while it lies in the strip that the ego's body sweeps
straight ahead. Its speed follows from how its distance changes, together with the ego's own speed; a box that has
just appeared is taken to stand. Distances come from the ground plane.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, Command, Observation, PlanState, Route
from brink.sim.driving.obstacles import depth_m, overlap
from brink.sim.driving.settings import LocalisationSettings, VehicleShape
from brink.sim.guard.interface import GuardReading, RangeScan

HORIZONS_S: Final = (1.0, 2.0, 3.0)
DEFAULT_THRESHOLD: Final = 0.5
ASIDE_M: Final = 0.3
"""Free space beside the ego's body within which a box counts."""
SMOOTHING: Final = 0.4
"""Weight of a new measurement of a box's speed."""
_NO_TIME_S: Final = 1e-3
_SAME_OVERLAP: Final = 0.3
_LEAST_CLOSING_MPS: Final = 0.1


@dataclass(slots=True)
class _Obstacle:
    """A box that is followed from one perception step to the next."""

    box: Box
    gap_m: float
    along_mps: float


class TimeToCollision:
    """`ttc@1`. Create a new one for each drive.

    Args:
        route: The route of the drive.
        threshold: The alarm is raised from this probability of a violation within two seconds on.
    """

    def __init__(self, route: Route, threshold: float | None = None) -> None:
        self._threshold = DEFAULT_THRESHOLD if threshold is None else threshold
        self._camera = Camera()
        self._shape = VehicleShape()
        self._placing = LocalisationSettings()
        self._obstacles: list[_Obstacle] = []
        self._time_s: float | None = None
        self._reading = GuardReading(probabilities=(0.0,) * len(HORIZONS_S), alarm=False)

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
        """Process one control step and return the current reading."""
        if observation.boxes is None:
            return self._reading
        speed_mps = observation.ego.speed_mps
        self._follow(observation.time_s, observation.boxes, speed_mps)
        times_s = [self._time_to(one, speed_mps) for one in self._obstacles if self._in_way(one)]
        time_s = min(times_s, default=math.inf)
        probabilities = tuple(horizon_s / (horizon_s + time_s) for horizon_s in HORIZONS_S)
        self._reading = GuardReading(probabilities, probabilities[1] >= self._threshold)
        return self._reading

    def _follow(self, time_s: float, boxes: Sequence[Box], speed_mps: float) -> None:
        """Take in the boxes of a perception step."""
        elapsed_s = None if self._time_s is None else max(time_s - self._time_s, _NO_TIME_S)
        self._time_s = time_s
        before, self._obstacles = self._obstacles, []
        for box in boxes:
            depth = depth_m(box, self._camera, self._placing)
            if depth is None:
                continue
            gap_m = depth + self._camera.forward_m - 0.5 * self._shape.length_m
            known = max(before, key=lambda one: overlap(one.box, box), default=None)
            along_mps = 0.0
            if known is not None and elapsed_s is not None and overlap(known.box, box) >= _SAME_OVERLAP:
                weight = SMOOTHING
                moves_mps = speed_mps + (gap_m - known.gap_m) / elapsed_s
                along_mps = known.along_mps + weight * (moves_mps - known.along_mps)
            self._obstacles.append(_Obstacle(box, gap_m, along_mps))

    def _in_way(self, obstacle: _Obstacle) -> bool:
        """Return whether an obstacle lies in the strip that the ego's body sweeps straight ahead."""
        camera, box = self._camera, obstacle.box
        depth = obstacle.gap_m - camera.forward_m + 0.5 * self._shape.length_m
        reach_m = 0.5 * self._shape.width_m + ASIDE_M
        left_m, right_m = camera.left_m(box.x_min_px, depth), camera.left_m(box.x_max_px, depth)
        return right_m < reach_m and left_m > -reach_m

    def _time_to(self, obstacle: _Obstacle, speed_mps: float) -> float:
        """Return the time until the ego reaches an obstacle; infinity if it does not."""
        closing_mps = speed_mps - obstacle.along_mps
        if closing_mps < _LEAST_CLOSING_MPS:
            return math.inf
        return max(obstacle.gap_m, 0.0) / closing_mps

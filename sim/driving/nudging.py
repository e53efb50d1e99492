"""Nudging: moving over within the lane around what stands at its edge, and telling it from what blocks the lane.

An obstacle that reaches into the strip the ego needs is passed on its free side if the lane has room for the ego's
body there; otherwise it blocks the lane. So a box's left and right edges decide, through the lateral extent, between
no reaction, a nudge of just the needed size, and a stop. What blocked once must leave more room before it is passed,
and an offset is kept until what caused it is passed, or for a moment after it has disappeared.
"""

from collections.abc import Sequence

from brink.sim.driving.interface import ObstacleLabel
from brink.sim.driving.prediction import RoadObstacle
from brink.sim.driving.settings import NudgeSettings

_FLOWS_ABOVE_MPS = 1.0
_CROSSES_ABOVE_MPS = 0.3
_LEAST_OFFSET_M = 0.05
_REMEMBERED_S = 4.0


class Nudging:
    """Decides at perception steps on the offset within the lane."""

    __slots__ = (
        "_blocking",
        "_cause_far_m",
        "_cause_near_m",
        "_half_width_m",
        "_limit_m",
        "_person_margin_m",
        "_seen_s",
        "_settings",
        "offset_m",
    )

    def __init__(
        self, settings: NudgeSettings, *, lane_width_m: float, width_m: float, person_margin_m: float
    ) -> None:
        self._settings = settings
        self._half_width_m = 0.5 * width_m
        self._limit_m = max(0.5 * (lane_width_m - width_m) - settings.edge_margin_m, 0.0)
        self._person_margin_m = person_margin_m
        self._blocking: frozenset[int] = frozenset()
        self._seen_s = 0.0
        self._cause_near_m = 0.0
        self._cause_far_m = 0.0
        self.offset_m = 0.0
        """The wanted offset of the ego's centre."""

    def update(
        self,
        time_s: float,
        obstacles: Sequence[RoadObstacle],
        *,
        front_m: float,
        rear_m: float,
        range_m: float,
    ) -> None:
        """Take the obstacles of a perception step.

        Args:
            time_s: Now.
            obstacles: Everybody.
            front_m: Station of the ego's front bumper.
            rear_m: Station of its rear bumper.
            range_m: What is farther ahead is not looked at.
        """
        settings = self._settings
        lowest, highest = -self._limit_m, self._limit_m
        wanted_low, wanted_high = -self._limit_m, self._limit_m
        blocking = []
        causes: list[RoadObstacle] = []
        for obstacle in sorted(obstacles, key=_by_distance) if len(obstacles) > 1 else obstacles:
            if obstacle.near_m > front_m + range_m or obstacle.far_m < rear_m:
                continue
            side = self._side(obstacle)
            if side is None:
                continue
            pass_left, offset_m = side
            more = settings.stay_margin_m if obstacle.track in self._blocking else 0.0
            if pass_left:
                if offset_m + more > highest:
                    blocking.append(obstacle.track)
                    continue
                lowest = max(lowest, offset_m)
            else:
                if offset_m - more < lowest:
                    blocking.append(obstacle.track)
                    continue
                highest = min(highest, offset_m)
            if obstacle.near_m < front_m + settings.look_ahead_m:
                wanted_low, wanted_high = lowest, highest
                causes.append(obstacle)
        self._blocking = frozenset(blocking)
        self._settle(time_s, min(max(0.0, wanted_low), wanted_high), causes, front_m, rear_m)

    def _side(self, obstacle: RoadObstacle) -> tuple[bool, float] | None:
        """Return whether to pass on the left, and the offset that takes; None if it is not in the way at all."""
        is_person = obstacle.label is ObstacleLabel.PERSON
        clearance = self._person_margin_m + 0.05 if is_person else self._settings.clearance_m
        needed = self._half_width_m + clearance
        if not obstacle.overlaps(-needed, needed):
            return None
        if is_person:
            # Who walks across is a matter of giving way.
            if abs(obstacle.across_mps) > _CROSSES_ABOVE_MPS:
                return None
        elif obstacle.along_mps > _FLOWS_ABOVE_MPS:
            # What drives ahead is followed, not squeezed past.
            return True, self._limit_m + 1.0
        if obstacle.left_m + obstacle.right_m <= 0.0:
            return True, obstacle.left_m + needed
        return False, obstacle.right_m - needed

    def _settle(
        self, time_s: float, wanted_m: float, causes: Sequence[RoadObstacle], front_m: float, rear_m: float
    ) -> None:
        if abs(wanted_m) >= _LEAST_OFFSET_M:
            self._seen_s = time_s
            self._cause_near_m = min(cause.near_m for cause in causes)
            self._cause_far_m = max(cause.far_m for cause in causes)
            self.offset_m = wanted_m
            return
        if self.offset_m == 0.0:
            return
        since_s = time_s - self._seen_s
        # What is alongside is out of sight of the camera, and still there.
        is_alongside = front_m > self._cause_near_m - 2.0 and rear_m < self._cause_far_m
        if since_s > (_REMEMBERED_S if is_alongside else self._settings.hold_s):
            self.offset_m = 0.0


def _by_distance(obstacle: RoadObstacle) -> tuple[float, int]:
    return obstacle.near_m, obstacle.track

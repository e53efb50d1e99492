"""Lateral decisions: nudging within the lane, and overtaking through the oncoming lane.

**Nudging.** An obstacle that reaches into the strip the ego needs is passed on its free side if the lane has room for
the ego's body there; otherwise it blocks the lane. So a box's left and right edges decide, through the lateral
extent, between no reaction, a nudge of just the required size, and a stop. An obstacle that once blocked the lane
must leave more room before it is passed. The offset is kept until its cause has been passed, or for a moment after it
disappears.

**Overtaking** starts when a vehicle that blocks the lane has stood for `standing_s`, the ego is close behind it, the
map has an oncoming lane all the way, no stop line is near (the vehicle may be queueing), no person is about to be in
the way, and no vehicle in the oncoming lane would be met before the ego is back. The obstacle is remembered while the
ego is beside it, out of the camera's view. Before the ego is beside it, the ego gives up and falls back if another
road user gets in the way or the obstacle moves off, and simply returns if the obstacle has disappeared.
"""

from collections.abc import Sequence

from brink.sim.driving.interface import ObstacleLabel, Route
from brink.sim.driving.obstacles import RoadObstacle, by_distance
from brink.sim.driving.settings import NudgeSettings, OvertakeSettings

_FLOWS_ABOVE_MPS = 1.0
_CROSSES_ABOVE_MPS = 0.3
_LEAST_OFFSET_M = 0.05
_REMEMBERED_S = 4.0


class Nudging:
    """Chooses the offset within the lane at each perception step.

    Args:
        settings: Clearances and times.
        lane_width_m: Width of the ego's lane.
        width_m: Width of the ego's body.
        person_margin_m: Free space to keep to a person.
    """

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
        """Target offset of the ego's centre."""

    def update(
        self,
        time_s: float,
        obstacles: Sequence[RoadObstacle],
        *,
        front_m: float,
        rear_m: float,
        range_m: float,
    ) -> None:
        """Process the obstacles of a perception step.

        Args:
            time_s: Current time.
            obstacles: All obstacles.
            front_m: Station of the ego's front bumper.
            rear_m: Station of the ego's rear bumper.
            range_m: Obstacles farther ahead are ignored.
        """
        settings = self._settings
        lowest, highest = -self._limit_m, self._limit_m
        wanted_low, wanted_high = -self._limit_m, self._limit_m
        blocking = []
        causes: list[RoadObstacle] = []
        for obstacle in sorted(obstacles, key=by_distance) if len(obstacles) > 1 else obstacles:
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
        """Return whether to pass on the left, and the offset needed; None if the obstacle is not in the way."""
        is_person = obstacle.label is ObstacleLabel.PERSON
        clearance = self._person_margin_m + 0.05 if is_person else self._settings.clearance_m
        needed = self._half_width_m + clearance
        if not obstacle.overlaps(-needed, needed):
            return None
        if is_person:
            # People who walk across are handled by giving way.
            if abs(obstacle.across_mps) > _CROSSES_ABOVE_MPS:
                return None
        elif obstacle.along_mps > _FLOWS_ABOVE_MPS:
            # Moving vehicles are followed, not passed within the lane.
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
        # An obstacle alongside is out of the camera's view but still there.
        is_alongside = front_m > self._cause_near_m - 2.0 and rear_m < self._cause_far_m
        if since_s > (_REMEMBERED_S if is_alongside else self._settings.hold_s):
            self.offset_m = 0.0


_OBSTACLE_MOVES_ABOVE_MPS = 1.5
_BESIDE_M = 1.0
_ROOM_TO_RETURN_M = 12.0
_NEVER_S = -1e9


class Overtaking:
    """Decides at each perception step whether and how to overtake.

    Args:
        route: Provides oncoming lanes and stop lines.
        settings: Conditions and distances.
        width_m: Width of the ego's body.
    """

    __slots__ = (
        "_extra_m",
        "_gave_up_s",
        "_half_width_m",
        "_left_m",
        "_near_m",
        "_route",
        "_settings",
        "_started_s",
        "_track",
        "_until_m",
        "offset_m",
    )

    def __init__(self, route: Route, settings: OvertakeSettings, *, width_m: float) -> None:
        self._route = route
        self._settings = settings
        self._half_width_m = 0.5 * width_m
        self._track: int | None = None
        self._near_m = 0.0
        self._left_m = 0.0
        self._extra_m = 0.0
        self._until_m = 0.0
        self._started_s = 0.0
        self._gave_up_s = _NEVER_S
        self.offset_m = 0.0
        """Target offset of the ego's centre while overtaking."""

    @property
    def track(self) -> int | None:
        """Number of the track that is being overtaken, or None."""
        return self._track

    def clearance_m(self, offset_m: float) -> float:
        """Return the lateral clearance between the obstacle and an ego at the given offset."""
        return offset_m - self._half_width_m - self._left_m

    def gap_m(self, front_m: float) -> float:
        """Return the distance to the obstacle's near end, negative once the ego is beside it."""
        return self._near_m - front_m

    def update(
        self,
        time_s: float,
        obstacles: Sequence[RoadObstacle],
        blocker: RoadObstacle | None,
        *,
        front_m: float,
        rear_m: float,
    ) -> None:
        """Process the obstacles of a perception step.

        Args:
            time_s: Current time.
            obstacles: All obstacles.
            blocker: The nearest obstacle that blocks the ego's lane.
            front_m: Station of the ego's front bumper.
            rear_m: Station of the ego's rear bumper.
        """
        if self._track is not None:
            self._go_on(time_s, obstacles, front_m, rear_m)
        elif blocker is not None and self._may_start(time_s, obstacles, blocker, front_m):
            self._track = blocker.track
            self._started_s = time_s
            # From close behind, the ego must swing out wider to clear the obstacle.
            short_m = self._settings.easy_gap_m - (blocker.near_m - front_m)
            self._extra_m = self._settings.swing_share * max(short_m, 0.0)
            self._aim_at(blocker)

    def _aim_at(self, obstacle: RoadObstacle) -> None:
        settings = self._settings
        self._near_m = obstacle.near_m
        self._left_m = obstacle.left_m
        self._until_m = obstacle.far_m + settings.return_gap_m
        wanted_m = obstacle.left_m + self._half_width_m + settings.clearance_m + self._extra_m
        self.offset_m = min(max(wanted_m, 0.0), self._highest_m())

    def _highest_m(self) -> float:
        return self._route.lane_width_m + self._settings.clearance_m

    def _has_room(self, obstacle: RoadObstacle) -> bool:
        beside_m = obstacle.left_m + self._half_width_m + self._settings.min_clearance_m
        return beside_m <= self._highest_m()

    def _may_start(
        self, time_s: float, obstacles: Sequence[RoadObstacle], blocker: RoadObstacle, front_m: float
    ) -> bool:
        settings = self._settings
        gap_m = blocker.near_m - front_m
        if (
            blocker.label is not ObstacleLabel.VEHICLE
            or blocker.standing_s < settings.standing_s
            or not settings.min_gap_m <= gap_m <= settings.max_gap_m
            or time_s - self._gave_up_s < settings.rest_s
            or not self._has_room(blocker)
        ):
            return False
        end_m = blocker.far_m + settings.margin_m
        route = self._route
        if any(front_m < line_m < end_m + settings.light_margin_m for line_m in route.stop_line_stations_m):
            return False
        steps = 4
        if not all(
            route.oncoming_lane_at(front_m + (end_m - front_m) * step / steps) for step in range(steps + 1)
        ):
            return False
        return not self._something_comes(obstacles, blocker, front_m, end_m)

    def _something_comes(
        self, obstacles: Sequence[RoadObstacle], passed: RoadObstacle, front_m: float, end_m: float
    ) -> bool:
        settings = self._settings
        offset_m = min(passed.left_m + self._half_width_m + settings.clearance_m, self._highest_m())
        right_m = passed.left_m + 0.1
        left_m = offset_m + self._half_width_m + settings.min_clearance_m
        takes_s = (end_m - front_m) / settings.speed_mps + settings.pull_out_s
        for obstacle in obstacles:
            if obstacle.track == passed.track or obstacle.far_m < front_m:
                continue
            if obstacle.label is ObstacleLabel.PERSON:
                window = obstacle.time_in(-left_m, left_m)
                if window is not None and obstacle.near_m < end_m:
                    return True
                continue
            if not obstacle.overlaps(right_m, left_m):
                continue
            if obstacle.standing_s > 0.0 or obstacle.along_mps >= 0.0:
                if obstacle.near_m < end_m:
                    return True
                continue
            comes_mps = max(-obstacle.along_mps, settings.oncoming_mps)
            if obstacle.near_m < end_m + comes_mps * takes_s:
                return True
        return False

    def _go_on(self, time_s: float, obstacles: Sequence[RoadObstacle], front_m: float, rear_m: float) -> None:
        settings = self._settings
        if rear_m > self._until_m:
            self._track = None
            return
        is_beside = front_m > self._near_m - _BESIDE_M
        if time_s - self._started_s > settings.give_up_s:
            self._give_up(time_s)
            return
        if is_beside:
            self._pass_next(obstacles)
            return
        obstacle = next((item for item in obstacles if item.track == self._track), None)
        if obstacle is None:
            if self._near_m - front_m > settings.blind_gap_m:
                # It should be in view but is not: there is nothing left to overtake.
                self._track = None
            return
        end_m = obstacle.far_m + settings.margin_m
        if (
            obstacle.along_mps > _OBSTACLE_MOVES_ABOVE_MPS
            or not self._has_room(obstacle)
            or self._something_comes(obstacles, obstacle, front_m, end_m)
        ):
            self._give_up(time_s)
            return
        self._aim_at(obstacle)

    def _pass_next(self, obstacles: Sequence[RoadObstacle]) -> None:
        """Stay in the oncoming lane to pass the next stationary vehicle if there is no room to return before it."""
        for obstacle in obstacles:
            if (
                obstacle.label is ObstacleLabel.VEHICLE
                and obstacle.standing_s > 0.0
                and self._until_m < obstacle.near_m < self._until_m + _ROOM_TO_RETURN_M
                and obstacle.overlaps(-self._half_width_m, self._half_width_m)
                and obstacle.left_m < self.offset_m - self._half_width_m
            ):
                self._until_m = obstacle.far_m + self._settings.return_gap_m

    def _give_up(self, time_s: float) -> None:
        self._track = None
        self._gave_up_s = time_s

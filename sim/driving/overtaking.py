"""Overtaking: passing through the oncoming lane what is believed to stand in the own one.

Starts when a vehicle that blocks the lane has stood for `standing_s`, the ego is close behind it, the map has an
oncoming lane for the whole way, no stop line is near (it may be a queue), nobody is on foot about, and nothing is
perceived in the oncoming lane that would be met before the ego is back. The obstacle is remembered while the ego is
beside it, where the camera cannot see it. Gives up (and falls back behind the obstacle) if something comes or the
obstacle moves off before the ego is beside it, and simply returns if the obstacle has vanished.
"""

from collections.abc import Sequence

from brink.sim.driving.interface import ObstacleLabel, Route
from brink.sim.driving.prediction import RoadObstacle
from brink.sim.driving.settings import OvertakeSettings

_OBSTACLE_MOVES_ABOVE_MPS = 1.5
_BESIDE_M = 1.0
_ROOM_TO_RETURN_M = 12.0
_NEVER_S = -1e9


class Overtaking:
    """Decides at perception steps whether to overtake, and where."""

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
        """The wanted offset of the ego's centre while overtaking."""

    @property
    def track(self) -> int | None:
        """The track that is being overtaken, or None."""
        return self._track

    def clearance_m(self, offset_m: float) -> float:
        """Return the free space between the ego at an offset and the obstacle beside it."""
        return offset_m - self._half_width_m - self._left_m

    def gap_m(self, front_m: float) -> float:
        """Return the way to the obstacle's near end, negative once the ego is beside it."""
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
        """Take the obstacles of a perception step.

        Args:
            time_s: Now.
            obstacles: Everybody.
            blocker: The nearest obstacle that blocks the ego's lane.
            front_m: Station of the ego's front bumper.
            rear_m: Station of its rear bumper.
        """
        if self._track is not None:
            self._go_on(time_s, obstacles, front_m, rear_m)
        elif blocker is not None and self._may_start(time_s, obstacles, blocker, front_m):
            self._track = blocker.track
            self._started_s = time_s
            # From close behind, the ego must swing out wider or it comes round too late.
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
                # It should be in view and is not: there is nothing to overtake any more.
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
        """Stay out past what stands in the own lane so close behind that there is no room to return."""
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

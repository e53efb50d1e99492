"""The planner: from obstacles on the route to a path offset and bounds on speed and acceleration.

Lateral decisions (nudge, overtake, give way) are made at perception steps. Speed is planned at every control step,
with obstacles extrapolated at constant velocity in between. Each longitudinal law (road, gap, give way, light)
returns the highest acceleration it allows, and the lowest of these applies. The planner knows obstacles through
perception alone and treats all of them as real.

Effects of a perceived obstacle: its label decides between stopping for it (person) and following, nudging around or
overtaking it (vehicle); its lateral extent between the middle of the lane, its edge, and outside; its distance and
velocity between following, comfortable and emergency braking; how long it has stood, whether it is overtaken; once it
disappears, the road is free after the track has been dropped.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from brink.sim.driving.interface import EgoState, LightReading, ObstacleLabel, PlanMode, Route
from brink.sim.driving.lateral import Nudging, Overtaking
from brink.sim.driving.longitudinal import (
    NO_LIMIT_MPS2,
    GiveWay,
    SpeedProfile,
    TrafficLightLaw,
    follow_accel,
    stop_accel,
)
from brink.sim.driving.obstacles import RoadObstacle, by_distance
from brink.sim.driving.settings import PlanningSettings, VehicleShape

_TURNS_WHEELS_BELOW_MPS = 0.3
_BLOCKS_WITHIN_M = 0.1
_BESIDE_M = 0.5
_SHOWN_MODE_BELOW_MPS2 = 0.5


class Plan(NamedTuple):
    """The planner's output, which the controller follows.

    Attributes:
        mode: What the planner is doing.
        cruise_mps: Speed to reach.
        accel_limit_mps2: Highest acceleration allowed.
        path_offset_m: Offset at which the ego should be now.
        target_offset_m: Offset that the path leads to.
    """

    mode: PlanMode
    cruise_mps: float
    accel_limit_mps2: float
    path_offset_m: float
    target_offset_m: float


class Planner(Protocol):
    """Plans from perceived obstacles."""

    def perceive(self, time_s: float, ego: EgoState, obstacles: Sequence[RoadObstacle]) -> None:
        """Process the obstacles of a perception step; called before `plan` of the same control step.

        Args:
            time_s: Current time.
            ego: State of the ego.
            obstacles: All obstacles.
        """

    def plan(self, time_s: float, ego: EgoState, light: LightReading | None) -> Plan:
        """Plan one control step.

        Args:
            time_s: Current time.
            ego: State of the ego.
            light: Next traffic light, or None.
        """


class RoutePlanner:
    """Follows the route and reacts to perceived obstacles.

    Args:
        route: Route to follow.
        shape: Dimensions of the ego.
        settings: Constants of all behaviours.
    """

    __slots__ = (
        "_blockers",
        "_give_way",
        "_half_length_m",
        "_half_width_m",
        "_lights",
        "_moving_over",
        "_nudging",
        "_offset_m",
        "_overtaking",
        "_perceived_s",
        "_profile",
        "_settings",
        "_slow_mps",
        "_target_m",
        "_time_s",
    )

    def __init__(self, route: Route, shape: VehicleShape, settings: PlanningSettings) -> None:
        self._settings = settings
        self._half_length_m = 0.5 * shape.length_m
        self._half_width_m = 0.5 * shape.width_m
        self._profile = SpeedProfile(route, settings.speed)
        self._lights = TrafficLightLaw(settings.light)
        self._give_way = GiveWay(
            settings.give_way, route.crossings, length_m=shape.length_m, width_m=shape.width_m
        )
        self._nudging = Nudging(
            settings.nudge,
            lane_width_m=route.lane_width_m,
            width_m=shape.width_m,
            person_margin_m=settings.give_way.person_margin_m,
        )
        self._overtaking = Overtaking(route, settings.overtake, width_m=shape.width_m)
        self._blockers: list[RoadObstacle] = []
        self._moving_over: list[tuple[RoadObstacle, float]] = []
        self._perceived_s = 0.0
        self._time_s: float | None = None
        self._slow_mps = NO_LIMIT_MPS2
        self._offset_m = 0.0
        self._target_m = 0.0

    def perceive(self, time_s: float, ego: EgoState, obstacles: Sequence[RoadObstacle]) -> None:
        """Process the obstacles of a perception step; called before `plan` of the same control step.

        Args:
            time_s: Current time.
            ego: State of the ego.
            obstacles: All obstacles.
        """
        settings = self._settings
        front_m, rear_m = ego.station_m + self._half_length_m, ego.station_m - self._half_length_m
        self._perceived_s = time_s
        self._nudging.update(
            time_s, obstacles, front_m=front_m, rear_m=rear_m, range_m=settings.follow.range_m
        )
        overtaking = self._overtaking
        blocker = None
        if obstacles and overtaking.track is None:
            blockers = self._in_way(obstacles, front_m, self._nudging.offset_m, None)
            blocker = min(blockers, key=by_distance, default=None)
        overtaking.update(time_s, obstacles, blocker, front_m=front_m, rear_m=rear_m)
        passed = overtaking.track
        self._target_m = self._nudging.offset_m if passed is None else overtaking.offset_m
        self._blockers = self._in_way(obstacles, front_m, self._target_m, passed) if obstacles else []
        self._moving_over = self._still_beside(obstacles, ego, front_m, passed) if obstacles else []
        low_m, high_m = min(ego.offset_m, self._target_m), max(ego.offset_m, self._target_m)
        self._give_way.update(
            time_s, obstacles, front_m=front_m, speed_mps=ego.speed_mps, right_m=low_m, left_m=high_m
        )
        self._slow_mps = self._careful_mps(obstacles, front_m, passed)

    def _in_way(
        self, obstacles: Sequence[RoadObstacle], front_m: float, offset_m: float, passed: int | None
    ) -> list[RoadObstacle]:
        """Return the vehicles that the ego would run into at an offset; persons are handled by giving way."""
        reach_m = self._half_width_m + _BLOCKS_WITHIN_M
        right_m, left_m = offset_m - reach_m, offset_m + reach_m
        last_m = front_m + self._settings.follow.range_m
        return [
            obstacle
            for obstacle in obstacles
            if obstacle.left_m > right_m
            and obstacle.right_m < left_m
            and obstacle.near_m < last_m
            and obstacle.near_m > front_m - _BESIDE_M
            and obstacle.track != passed
            and obstacle.label is not ObstacleLabel.PERSON
        ]

    def _still_beside(
        self, obstacles: Sequence[RoadObstacle], ego: EgoState, front_m: float, passed: int | None
    ) -> list[tuple[RoadObstacle, float]]:
        """Return the obstacles that the ego must move over for, each with the lateral distance still to move."""
        ways = []
        reach_m = self._half_width_m + _BLOCKS_WITHIN_M
        last_m = front_m + self._settings.nudge.look_ahead_m
        for obstacle in obstacles:
            if not front_m - 1.0 < obstacle.near_m < last_m or obstacle.track == passed:
                continue
            to_right, to_left = obstacle.left_m + reach_m, obstacle.right_m - reach_m
            if to_left < ego.offset_m < to_right and not to_left < self._target_m < to_right:
                wanted_m = to_right if self._target_m >= to_right else to_left
                ways.append((obstacle, abs(wanted_m - ego.offset_m)))
        return ways

    def _careful_mps(self, obstacles: Sequence[RoadObstacle], front_m: float, passed: int | None) -> float:
        settings = self._settings
        slow_mps = settings.give_way.pass_person_mps if self._give_way.slow else NO_LIMIT_MPS2
        if passed is not None:
            return min(slow_mps, settings.overtake.speed_mps)
        reach_m = self._half_width_m + settings.nudge.tight_clearance_m
        for obstacle in obstacles:
            is_near = front_m - 1.0 < obstacle.near_m < front_m + 12.0
            if is_near and obstacle.overlaps(self._target_m - reach_m, self._target_m + reach_m):
                return min(slow_mps, settings.nudge.pass_speed_mps)
        return slow_mps

    def plan(self, time_s: float, ego: EgoState, light: LightReading | None) -> Plan:
        """Plan one control step.

        Args:
            time_s: Current time.
            ego: State of the ego.
            light: Next traffic light, or None.
        """
        front_m = ego.station_m + self._half_length_m
        speed_mps = max(ego.speed_mps, 0.0)
        self._move_offset(time_s, ego)
        cruise_mps = self._profile.speed_at(ego.station_m)
        if self._slow_mps < cruise_mps:
            cruise_mps = self._slow_mps
        mode, limit = PlanMode.CRUISE, self._lights.accel(time_s, light, front_m, speed_mps)
        if limit < _SHOWN_MODE_BELOW_MPS2:
            mode = PlanMode.STOP
        if self._give_way.stops_m:
            accel = self._yield_accel(front_m, speed_mps)
            if accel < limit:
                limit = accel
                if accel < _SHOWN_MODE_BELOW_MPS2:
                    mode = PlanMode.YIELD
        if self._blockers:
            accel = self._follow_accel(time_s - self._perceived_s, front_m, speed_mps)
            if accel < limit:
                limit = accel
                if accel < _SHOWN_MODE_BELOW_MPS2:
                    mode = PlanMode.FOLLOW
        if self._moving_over:
            cruise_mps, limit = self._move_over_first(front_m, speed_mps, cruise_mps, limit)
        if self._overtaking.track is not None:
            mode = PlanMode.OVERTAKE
            cruise_mps, limit = self._pull_out(ego, front_m, speed_mps, cruise_mps, limit)
        elif mode is PlanMode.CRUISE and self._target_m != 0.0:
            mode = PlanMode.NUDGE
        return Plan(mode, cruise_mps, limit, self._offset_m, self._target_m)

    def _move_offset(self, time_s: float, ego: EgoState) -> None:
        """Move the path offset towards its target at a bounded rate; a step change would be a swerve."""
        elapsed_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        difference = self._target_m - self._offset_m
        if difference == 0.0:
            return
        settings = self._settings
        is_far_out = self._overtaking.track is not None or abs(self._offset_m) > 1.0
        step = elapsed_s * (settings.overtake.rate_mps if is_far_out else settings.nudge.rate_mps)
        self._offset_m += min(max(difference, -step), step)

    def _yield_accel(self, front_m: float, speed_mps: float) -> float:
        settings = self._settings.give_way
        distance_m = min(self._give_way.stops_m) - front_m
        accel = stop_accel(settings.decel_mps2, settings.approach_gain_per_s, speed_mps, distance_m)
        return max(accel, -self._settings.follow.max_decel_mps2)

    def _follow_accel(self, age_s: float, front_m: float, speed_mps: float) -> float:
        settings = self._settings.follow
        lowest = NO_LIMIT_MPS2
        for obstacle in self._blockers:
            gap_m = obstacle.near_m + obstacle.along_mps * age_s - front_m
            accel = follow_accel(settings, speed_mps, gap_m, obstacle.along_mps)
            if accel < lowest:
                lowest = accel
        return lowest

    def _move_over_first(
        self, front_m: float, speed_mps: float, cruise_mps: float, limit: float
    ) -> tuple[float, float]:
        """Limit the speed towards an obstacle so that the ego can move over before reaching it."""
        settings = self._settings.nudge
        for obstacle, sideways_m in self._moving_over:
            gap_m = obstacle.near_m - front_m
            if gap_m < settings.stop_gap_m:
                limit = min(limit, follow_accel(self._settings.follow, speed_mps, gap_m, obstacle.along_mps))
                continue
            takes_s = sideways_m / settings.rate_mps + 0.5
            allowed_mps = max(gap_m / takes_s, settings.creep_mps)
            if allowed_mps < cruise_mps:
                cruise_mps = allowed_mps
            if allowed_mps < speed_mps:
                limit = min(limit, 2.0 * (allowed_mps - speed_mps))
        return cruise_mps, limit

    def _pull_out(
        self, ego: EgoState, front_m: float, speed_mps: float, cruise_mps: float, limit: float
    ) -> tuple[float, float]:
        """Creep until the ego has cleared the obstacle sideways, and stop rather than touch it."""
        overtaking, settings = self._overtaking, self._settings.overtake
        if overtaking.clearance_m(ego.offset_m) >= settings.min_clearance_m:
            return cruise_mps, limit
        gap_m = overtaking.gap_m(front_m)
        if gap_m < -1.0:
            return cruise_mps, limit
        if speed_mps < _TURNS_WHEELS_BELOW_MPS and self._target_m - self._offset_m > 0.1:
            # From a standstill, turn the wheels before moving off: there is no room to spare.
            return cruise_mps, min(limit, -1.0)
        allowed_mps = max(settings.creep_mps, gap_m / 3.0)
        if overtaking.clearance_m(ego.offset_m) < 0.0 and gap_m < 1.0:
            limit = min(limit, stop_accel(self._settings.follow.decel_mps2, 2.0, speed_mps, gap_m - 0.5))
        if allowed_mps < speed_mps:
            limit = min(limit, 2.0 * (allowed_mps - speed_mps))
        return min(cruise_mps, allowed_mps), limit

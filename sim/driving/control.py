"""The controller: pure pursuit for steering, a PID for speed."""

import math
from typing import Protocol

from brink.sim.driving.interface import Command, EgoState, Route
from brink.sim.driving.planning import Plan
from brink.sim.driving.settings import ControlSettings, VehicleShape


class Controller(Protocol):
    """Turns a plan into steering and acceleration commands."""

    def control(self, ego: EgoState, plan: Plan) -> Command:
        """Return the command for the next control step."""


class PursuitController:
    """Steers the rear axle towards a point on the path ahead, and controls speed within the plan's limit.

    Args:
        route: Route to follow.
        shape: Dimensions of the ego.
        settings: Gains and limits.
    """

    __slots__ = (
        "_accel",
        "_axle_m",
        "_integral",
        "_max_steer",
        "_route",
        "_settings",
        "_steer",
        "_wheelbase_m",
    )

    def __init__(self, route: Route, shape: VehicleShape, settings: ControlSettings) -> None:
        self._route = route
        self._settings = settings
        self._wheelbase_m = shape.wheelbase_m
        self._axle_m = 0.5 * shape.wheelbase_m
        self._max_steer = shape.max_steer_rad
        self._steer = 0.0
        self._accel = 0.0
        self._integral = 0.0

    def control(self, ego: EgoState, plan: Plan) -> Command:
        """Return the command for the next control step; finite, and within the steering and acceleration limits."""
        return Command(self._speed(ego, plan), self._steering(ego, plan))

    def _steering(self, ego: EgoState, plan: Plan) -> float:
        """Return the steering angle of the arc from the rear axle through a point on the path (Coulter 1992)."""
        settings = self._settings
        ahead = settings.look_ahead_s * ego.speed_mps
        if ahead < settings.min_look_ahead_m:
            ahead = settings.min_look_ahead_m
        elif ahead > settings.max_look_ahead_m:
            ahead = settings.max_look_ahead_m
        goal_x, goal_y, _ = self._route.pose_at(ego.station_m - self._axle_m + ahead, plan.path_offset_m)
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        dx = goal_x - ego.x_m + self._axle_m * cos_yaw
        dy = goal_y - ego.y_m + self._axle_m * sin_yaw
        forward, left = dx * cos_yaw + dy * sin_yaw, dy * cos_yaw - dx * sin_yaw
        squared = forward * forward + left * left
        limit = self._max_steer
        if forward <= 0.0:
            wanted = limit if left > 0.0 else -limit
        else:
            wanted = math.atan(2.0 * self._wheelbase_m * left / squared)
        step = settings.steer_rate_radps * settings.period_s
        wanted = min(max(wanted, -limit), limit)
        self._steer = min(max(wanted, self._steer - step), self._steer + step)
        return self._steer

    def _speed(self, ego: EgoState, plan: Plan) -> float:
        settings = self._settings
        speed = ego.speed_mps
        error = plan.cruise_mps - speed
        accel = (
            settings.speed_gain_per_s * error + self._integral - settings.speed_derivative * ego.accel_mps2
        )
        bounded = min(max(accel, -settings.decel_mps2), settings.accel_mps2)
        limit = plan.accel_limit_mps2
        # The integral compensates for grade and drag: it changes only near the target, while the PID alone decides.
        if bounded == accel and bounded <= limit and -1.0 < error < 1.0:
            share = self._integral + settings.speed_integral_per_s2 * error * settings.period_s
            most = settings.integral_limit_mps2
            self._integral = min(max(share, -most), most)
        if limit < bounded:
            bounded = limit
            if limit < 0.0 and speed < settings.hold_below_mps:
                bounded = min(bounded, -settings.hold_decel_mps2)
        highest = max(self._accel, 0.0) + settings.jerk_mps3 * settings.period_s
        self._accel = min(bounded, highest)
        return self._accel

"""From trajectories and pedals to commands.

The tracker follows a trajectory by its times. Acceleration is that of the trajectory when the command takes effect,
corrected by the errors of speed and of place along the path. Steering is pure pursuit (Coulter, "Implementation of
the pure pursuit path tracking algorithm", CMU-RI-TR-92-01) of the path of the rear axle: a car turns about its rear
axle, so a path of the body's centre taken for one of the axle would cut bends.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from brink.sim.driving.interface import CONTROL_STEP_S, EgoState
from brink.sim.driving_systems.interface import CarLimits, TrajectoryPoint

SPEED_GAIN_PER_S: Final = 1.5
PLACE_GAIN_PER_S2: Final = 0.6
LOOK_AHEAD_S: Final = 0.6
MIN_LOOK_AHEAD_M: Final = 3.0
MAX_LOOK_AHEAD_M: Final = 9.0
BEND_M: Final = 2.0
STANDS_MPS: Final = 0.2
HOLDS_MPS2: Final = -2.0
"""Holds a car that should stand on the steepest slope of the roads."""


def pedal_accel(pedal: float, car: CarLimits) -> float:
    """Return the acceleration that a pedal position in [-1, 1] demands."""
    return pedal * (car.engine_mps2 if pedal > 0.0 else car.brake_mps2)


def wheel_steer(wheel: float, car: CarLimits) -> float:
    """Return the angle of the road wheels that a position of the steering wheel in [-1, 1] demands."""
    return wheel * car.steer_limit_rad


def state_at(trajectory: Sequence[TrajectoryPoint], time_s: float) -> TrajectoryPoint:
    """Return a trajectory at a time, interpolated; before its beginning the first point, after its end the last."""
    after = bisect_right(trajectory, time_s, key=lambda point: point.time_s)
    if after == 0:
        return trajectory[0]
    if after == len(trajectory):
        return trajectory[-1]
    old, new = trajectory[after - 1], trajectory[after]
    share = (time_s - old.time_s) / (new.time_s - old.time_s)
    turn = (new.yaw_rad - old.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
    return TrajectoryPoint(
        time_s=time_s,
        x_m=old.x_m + share * (new.x_m - old.x_m),
        y_m=old.y_m + share * (new.y_m - old.y_m),
        yaw_rad=old.yaw_rad + share * turn,
        speed_mps=old.speed_mps + share * (new.speed_mps - old.speed_mps),
        accel_mps2=old.accel_mps2 + share * (new.accel_mps2 - old.accel_mps2),
    )


def tracking_command(
    trajectory: Sequence[TrajectoryPoint], time_s: float, ego: EgoState, car: CarLimits
) -> tuple[float, float]:
    """Return the acceleration and the angle of the road wheels that keep the ego on a trajectory.

    Args:
        trajectory: At least two points, in order of time.
        time_s: Current time.
        ego: Current state of the ego.
        car: The ego's body and limits.
    """
    return _accel(trajectory, time_s, ego, car), _steer(trajectory, ego, car)


def _accel(trajectory: Sequence[TrajectoryPoint], time_s: float, ego: EgoState, car: CarLimits) -> float:
    now = state_at(trajectory, time_s)
    soon = state_at(trajectory, time_s + car.delay_s + 0.5 * CONTROL_STEP_S)
    if soon.speed_mps < STANDS_MPS and ego.speed_mps < STANDS_MPS and soon.accel_mps2 <= 0.0:
        return HOLDS_MPS2
    behind_m = (now.x_m - ego.x_m) * math.cos(now.yaw_rad) + (now.y_m - ego.y_m) * math.sin(now.yaw_rad)
    return (
        soon.accel_mps2
        + SPEED_GAIN_PER_S * (now.speed_mps - ego.speed_mps)
        + PLACE_GAIN_PER_S2 * min(max(behind_m, -3.0), 3.0)
    )


def _steer(trajectory: Sequence[TrajectoryPoint], ego: EgoState, car: CarLimits) -> float:
    axle_m = 0.5 * car.wheelbase_m
    cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
    path = [
        (point.x_m - axle_m * math.cos(point.yaw_rad), point.y_m - axle_m * math.sin(point.yaw_rad))
        for point in trajectory
    ]
    own = (ego.x_m - axle_m * cos_yaw, ego.y_m - axle_m * sin_yaw)
    ahead_m = min(max(LOOK_AHEAD_S * ego.speed_mps, MIN_LOOK_AHEAD_M), MAX_LOOK_AHEAD_M)
    goal_x, goal_y = _point_ahead(path, [point.yaw_rad for point in trajectory], own, ahead_m)
    dx, dy = goal_x - own[0], goal_y - own[1]
    forward, left = dx * cos_yaw + dy * sin_yaw, dy * cos_yaw - dx * sin_yaw
    if forward <= 0.0:
        return math.copysign(car.steer_limit_rad, left)
    wanted = math.atan(2.0 * car.wheelbase_m * left / (forward * forward + left * left))
    return min(max(wanted, -car.steer_limit_rad), car.steer_limit_rad)


def _point_ahead(
    path: Sequence[tuple[float, float]], yaws_rad: Sequence[float], own: tuple[float, float], ahead_m: float
) -> tuple[float, float]:
    """Return the point of a path at a distance beyond the point nearest to the car.

    The path is extended with its last curvature: a trajectory may end because the car stops in a bend.
    """
    nearest_m2, from_m, along_m = math.inf, 0.0, 0.0
    lengths = []
    for (ax, ay), (bx, by) in pairwise(path):
        dx, dy = bx - ax, by - ay
        length_m = math.hypot(dx, dy)
        lengths.append(length_m)
        share = 0.0
        if length_m > 0.0:
            share = min(max(((own[0] - ax) * dx + (own[1] - ay) * dy) / (length_m * length_m), 0.0), 1.0)
        distance_m2 = (ax + share * dx - own[0]) ** 2 + (ay + share * dy - own[1]) ** 2
        if distance_m2 < nearest_m2:
            nearest_m2, from_m = distance_m2, along_m + share * length_m
        along_m += length_m
    left_m = from_m + ahead_m
    for ((ax, ay), (bx, by)), length_m in zip(pairwise(path), lengths, strict=True):
        if left_m <= length_m:
            share = left_m / length_m
            return ax + share * (bx - ax), ay + share * (by - ay)
        left_m -= length_m
    end_x, end_y = path[-1]
    chord_rad = yaws_rad[-1] + 0.5 * left_m * _last_curvature(lengths, yaws_rad)
    return end_x + left_m * math.cos(chord_rad), end_y + left_m * math.sin(chord_rad)


def _last_curvature(lengths_m: Sequence[float], yaws_rad: Sequence[float]) -> float:
    """Return the curvature of the last `BEND_M` of a path in 1/m; 0 if the path is too short to tell."""
    long_m, first = 0.0, len(lengths_m)
    while first and long_m < BEND_M:
        first -= 1
        long_m += lengths_m[first]
    turn_rad = (yaws_rad[-1] - yaws_rad[first] + math.pi) % (2.0 * math.pi) - math.pi
    return turn_rad / long_m if long_m > 0.25 * BEND_M else 0.0

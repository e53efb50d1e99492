"""The ego's motion: a single-track model with friction circle, load transfer, grade, brake and engine limits.

Integrated at 100 Hz in plain floats. The reference point is the centre of the car, halfway between the axles. Each
axle transmits at most friction times its load; cornering reduces what is left for braking. Beyond the grip of an axle
the car understeers and brakes less, so it never exceeds what physics allows.
"""

import math
from dataclasses import dataclass
from typing import Protocol

PHYSICS_STEP_S = 0.01
GRAVITY_MPS2 = 9.81


@dataclass(frozen=True, slots=True, kw_only=True)
class CarModel:
    """Parameters of a mid-size car.

    Attributes:
        length_m: Length of the body.
        width_m: Width of the body.
        height_m: Height of the body.
        wheelbase_m: Distance between the axles.
        gravity_height_m: Height of the centre of gravity.
        mass_kg: Mass with driver.
        power_w: Engine power at the wheels.
        engine_mps2: Largest acceleration in any gear.
        brake_mps2: Largest deceleration of the brakes on perfect grip.
        engine_lag_s: Time constant of the engine.
        brake_lag_s: Time constant of the brakes.
        steer_limit_rad: Largest angle of the road wheels to either side.
        steer_rate_radps: Largest rate of the road wheels' angle.
        drag_1pm: Deceleration by air drag, divided by speed squared.
        rolling_mps2: Deceleration by rolling resistance.
    """

    length_m: float = 4.5
    width_m: float = 1.8
    height_m: float = 1.5
    wheelbase_m: float = 2.7
    gravity_height_m: float = 0.55
    mass_kg: float = 1500.0
    power_w: float = 80_000.0
    engine_mps2: float = 3.5
    brake_mps2: float = 12.0
    engine_lag_s: float = 0.15
    brake_lag_s: float = 0.04
    steer_limit_rad: float = 0.6
    steer_rate_radps: float = 1.2
    drag_1pm: float = 0.0003
    rolling_mps2: float = 0.12


EGO_CAR = CarModel()


class EgoMotion(Protocol):
    """The interface that every motion model of the ego implements."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    accel_mps2: float
    steer_rad: float
    yaw_rate_radps: float
    length_m: float
    width_m: float
    model: CarModel

    def set_grade(self, grade: float) -> None:
        """Set the local slope of the road: rise over run along the heading, positive uphill."""
        ...

    def drive(self, accel_mps2: float, steer_rad: float, steps: int) -> None:
        """Drive for `steps` steps of 10 ms with a constant command, limited to what the car can do.

        Args:
            accel_mps2: Desired acceleration; negative brakes.
            steer_rad: Desired angle of the road wheels.
            steps: Number of steps.
        """
        ...


class MakeEgo(Protocol):
    """Creates an ego at a pose."""

    def __call__(self, pose: tuple[float, float, float], speed_mps: float, *, friction: float) -> EgoMotion:
        """Return a new ego."""
        ...


class EgoCar:
    """The ego as a single-track model. Mutable: create a new one for each episode.

    Args:
        pose: x_m, y_m and yaw_rad at the start.
        speed_mps: Speed at the start.
        friction: Friction coefficient of the road.
        model: Parameters of the car.

    Attributes:
        x_m: Centre of the car.
        y_m: Centre of the car.
        yaw_rad: Heading.
        speed_mps: Speed along the heading, >= 0.
        accel_mps2: Acceleration along the heading in the last step.
        steer_rad: Angle of the road wheels.
        yaw_rate_radps: Yaw rate.
    """

    __slots__ = (
        "_drive_mps2",
        "_friction",
        "_grade_mps2",
        "accel_mps2",
        "length_m",
        "model",
        "speed_mps",
        "steer_rad",
        "width_m",
        "x_m",
        "y_m",
        "yaw_rad",
        "yaw_rate_radps",
    )

    def __init__(
        self,
        pose: tuple[float, float, float],
        speed_mps: float,
        *,
        friction: float,
        model: CarModel = EGO_CAR,
    ) -> None:
        self.model = model
        self.length_m = model.length_m
        self.width_m = model.width_m
        self.x_m, self.y_m, self.yaw_rad = pose
        self.speed_mps = speed_mps
        self.accel_mps2 = 0.0
        self.steer_rad = 0.0
        self.yaw_rate_radps = 0.0
        self._drive_mps2 = 0.0
        self._grade_mps2 = 0.0
        self._friction = friction

    def set_grade(self, grade: float) -> None:
        """Set the local slope of the road: rise over run along the heading, positive uphill."""
        self._grade_mps2 = GRAVITY_MPS2 * grade

    def drive(self, accel_mps2: float, steer_rad: float, steps: int) -> None:
        """Drive for `steps` steps of 10 ms with a constant command, limited to what the car can do.

        Args:
            accel_mps2: Desired acceleration; negative brakes.
            steer_rad: Desired angle of the road wheels.
            steps: Number of steps.
        """
        m = self.model
        sqrt, cos, sin, tan = math.sqrt, math.cos, math.sin, math.tan
        x, y, yaw, v = self.x_m, self.y_m, self.yaw_rad, self.speed_mps
        drive, accel, steer, yaw_rate = self._drive_mps2, self.accel_mps2, self.steer_rad, self.yaw_rate_radps
        steer_goal = min(max(steer_rad, -m.steer_limit_rad), m.steer_limit_rad)
        turn_most = m.steer_rate_radps * PHYSICS_STEP_S
        half_load = 0.5 * GRAVITY_MPS2
        transfer = m.gravity_height_m / m.wheelbase_m
        friction, brakes = self._friction, -m.brake_mps2
        slow_mps = m.power_w / (m.mass_kg * m.engine_mps2)
        for _ in range(steps):
            # Comparisons instead of min and max: this loop runs 3,000 times per episode.
            turn = steer_goal - steer
            steer += turn if -turn_most < turn < turn_most else (turn_most if turn > 0.0 else -turn_most)
            top = m.engine_mps2
            if v > slow_mps:
                top = m.power_w / (m.mass_kg * v)
            goal = top if accel_mps2 > top else brakes if accel_mps2 < brakes else accel_mps2
            drive += (goal - drive) * PHYSICS_STEP_S / (m.brake_lag_s if goal < drive else m.engine_lag_s)
            # Per unit of mass, an axle's grip is friction times its share of gravity.
            shift = transfer * accel
            grip_front = friction * (half_load - shift)
            grip_rear = friction * (half_load + shift)
            wanted_rate = v * tan(steer) / m.wheelbase_m
            side = wanted_rate * v
            most_side = 2.0 * (grip_front if grip_front < grip_rear else grip_rear)
            if side > most_side:
                side = most_side
            elif side < -most_side:
                side = -most_side
            quarter = 0.25 * side * side
            front_squared = grip_front * grip_front - quarter
            rear_squared = grip_rear * grip_rear - quarter
            left_front = sqrt(front_squared) if front_squared > 0.0 else 0.0
            left_rear = sqrt(rear_squared) if rear_squared > 0.0 else 0.0
            # The brakes act on both axles, each limited before it locks; the engine drives the front axle.
            force = (drive if drive < left_front else left_front) - m.rolling_mps2
            if force < -(left_front + left_rear):
                force = -(left_front + left_rear)
            accel = force - self._grade_mps2 - m.drag_1pm * v * v
            if v <= 0.0 and accel < 0.0:
                accel = 0.0
            faster = v + accel * PHYSICS_STEP_S
            if faster < 0.0:
                accel, faster = -v / PHYSICS_STEP_S, 0.0
            middle = 0.5 * (v + faster)
            yaw_rate = side / v if v > 0.1 else wanted_rate
            # Without slip, the centre of the wheelbase moves at an angle to the heading.
            course = yaw + 0.5 * yaw_rate * PHYSICS_STEP_S
            if v > 0.1:
                course += 0.5 * m.wheelbase_m * yaw_rate / v
            x += middle * cos(course) * PHYSICS_STEP_S
            y += middle * sin(course) * PHYSICS_STEP_S
            yaw += yaw_rate * PHYSICS_STEP_S
            v = faster
        self.x_m, self.y_m, self.yaw_rad, self.speed_mps = x, y, yaw, v
        self._drive_mps2, self.accel_mps2, self.steer_rad, self.yaw_rate_radps = drive, accel, steer, yaw_rate

"""The ego's motion: a kinematic bicycle model with friction limits, load transfer, grade, brake and engine limits.

Both wheels of an axle are one, and tyres do not slip sideways: the wheels move where they point. Grip enters only
as a limit: each axle transmits at most friction times its load, and cornering reduces what is left for braking.
Beyond that limit the car understeers and brakes less; it never oversteers or spins. Integrated at 100 Hz in plain
floats. The reference point is the centre of the car, halfway between the axles. Slopes and air drag act on the
body, not through the tyres, so a car that brakes uphill slows down by more than friction times gravity.

Commands take effect with the delay, the rate and the lag of a passenger car. From the command, full braking on a
dry road builds up to three quarters in 0.36 s; Directive 71/320/EEC allows passenger cars no more than that, and UN
Regulation No. 13-H 0.6 s from the moment at which the pedal moves. An electric power steering turns the steering
wheel by up to about 500 degrees per second, which is 0.6 rad/s at the road wheels.

The body pitches under acceleration. Load moves between the axles by mass times acceleration times height over
wheelbase (Gillespie, Fundamentals of Vehicle Dynamics, chapters 1 and 7); springs that let each end of the body
bounce at 1.3 Hz then give 0.0045 rad for each m/s^2, of which suspensions with anti-dive and anti-squat geometry
leave about 70%: 1.8 degrees at 1 g.
"""

import math
from collections import deque
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
        delay_s: Time from a command to its first effect, a multiple of `PHYSICS_STEP_S`.
        engine_lag_s: Time constant of the engine.
        brake_lag_s: Time constant of the brakes.
        brake_rate_mps3: Fastest change of the braking.
        steer_limit_rad: Largest angle of the road wheels to either side.
        steer_rate_radps: Largest rate of the road wheels' angle.
        drag_1pm: Deceleration by air drag, divided by speed squared.
        rolling_mps2: Deceleration by rolling resistance.
        pitch_rad_per_mps2: Pitch of the body, for each m/s^2 of acceleration.
        pitch_hz: Natural frequency of the pitch.
        pitch_damping: Its damping ratio.
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
    delay_s: float = 0.05
    engine_lag_s: float = 0.3
    brake_lag_s: float = 0.1
    brake_rate_mps3: float = 22.0
    steer_limit_rad: float = 0.6
    steer_rate_radps: float = 0.6
    drag_1pm: float = 0.0003
    rolling_mps2: float = 0.12
    pitch_rad_per_mps2: float = 0.0032
    pitch_hz: float = 1.3
    pitch_damping: float = 0.4


EGO_CAR = CarModel()
PROMPT_CAR = CarModel(
    delay_s=0.0, engine_lag_s=0.15, brake_lag_s=0.04, brake_rate_mps3=1_000.0, steer_rate_radps=1.2
)
"""A car that obeys at once, for drivers whose own reactions already include those of the car."""


class DelayLine:
    """Delays commands; before the first one takes effect, the car coasts straight on.

    Args:
        delay_s: The delay, a multiple of `PHYSICS_STEP_S`.
    """

    __slots__ = ("_commands",)

    def __init__(self, delay_s: float) -> None:
        steps = round(delay_s / PHYSICS_STEP_S)
        self._commands = deque([(0.0, 0.0, steps)] if steps else [])

    def pass_on(self, accel_mps2: float, steer_rad: float, steps: int) -> list[tuple[float, float, int]]:
        """Take a command for some steps and return what takes effect in these steps: acceleration, angle, steps."""
        commands = self._commands
        commands.append((accel_mps2, steer_rad, steps))
        due = []
        while steps > 0:
            accel_mps2, steer_rad, lasts = commands.popleft()
            if lasts > steps:
                commands.appendleft((accel_mps2, steer_rad, lasts - steps))
                lasts = steps
            due.append((accel_mps2, steer_rad, lasts))
            steps -= lasts
        return due


class BodyPitch:
    """The pitch of a car's body, a damped oscillator.

    Args:
        model: The car.
    """

    __slots__ = ("_damping", "_gain", "_omega", "_pitch_rad", "_rate_radps")

    def __init__(self, model: CarModel) -> None:
        self._gain = model.pitch_rad_per_mps2
        self._omega = 2.0 * math.pi * model.pitch_hz
        self._damping = 2.0 * model.pitch_damping * self._omega
        self._pitch_rad = 0.0
        self._rate_radps = 0.0

    def after(self, accel_mps2: float, lasts_s: float) -> float:
        """Return the pitch after an acceleration that lasts for less than a tenth of a second."""
        pull = self._omega * self._omega * (self._gain * accel_mps2 - self._pitch_rad)
        self._rate_radps += lasts_s * (pull - self._damping * self._rate_radps)
        self._pitch_rad += lasts_s * self._rate_radps
        return self._pitch_rad


class EgoMotion(Protocol):
    """The interface that every motion model of the ego implements."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    accel_mps2: float
    steer_rad: float
    yaw_rate_radps: float
    pitch_rad: float
    length_m: float
    width_m: float
    model: CarModel

    def set_grade(self, grade: float) -> None:
        """Set the local slope of the road: rise over run along the heading, positive uphill."""

    def drive(self, accel_mps2: float, steer_rad: float, steps: int) -> None:
        """Drive for `steps` steps of 10 ms with a constant command, limited to what the car can do.

        Args:
            accel_mps2: Desired acceleration; negative brakes.
            steer_rad: Desired angle of the road wheels.
            steps: Number of steps.
        """


class MakeEgo(Protocol):
    """Creates an ego at a pose."""

    def __call__(self, pose: tuple[float, float, float], speed_mps: float, *, friction: float) -> EgoMotion:
        """Return a new ego."""


class EgoCar:
    """The ego as a kinematic bicycle model with friction limits. Mutable: create a new one for each episode.

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
        pitch_rad: Pitch of the body, negative if the nose is down.
    """

    __slots__ = (
        "_commands",
        "_drive_mps2",
        "_friction",
        "_grade_mps2",
        "_pitch",
        "accel_mps2",
        "length_m",
        "model",
        "pitch_rad",
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
        self.pitch_rad = 0.0
        self._pitch = BodyPitch(model)
        self._commands = DelayLine(model.delay_s)
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
        for due_mps2, due_rad, lasts in self._commands.pass_on(accel_mps2, steer_rad, steps):
            self._drive(due_mps2, due_rad, lasts)
        self.pitch_rad = self._pitch.after(self.accel_mps2, steps * PHYSICS_STEP_S)

    def _drive(self, accel_mps2: float, steer_rad: float, steps: int) -> None:
        """Drive with a command that takes effect now."""
        m = self.model
        engine_mps2, wheelbase_m = m.engine_mps2, m.wheelbase_m
        brake_lag_s, engine_lag_s = m.brake_lag_s, m.engine_lag_s
        sqrt, cos, sin, tan = math.sqrt, math.cos, math.sin, math.tan
        x, y, yaw, v = self.x_m, self.y_m, self.yaw_rad, self.speed_mps
        drive, accel, steer, yaw_rate = self._drive_mps2, self.accel_mps2, self.steer_rad, self.yaw_rate_radps
        steer_goal = min(max(steer_rad, -m.steer_limit_rad), m.steer_limit_rad)
        turn_most = m.steer_rate_radps * PHYSICS_STEP_S
        half_load = 0.5 * GRAVITY_MPS2
        transfer = m.gravity_height_m / wheelbase_m
        friction, brakes = self._friction, -m.brake_mps2
        most_braking = -m.brake_rate_mps3 * PHYSICS_STEP_S
        slow_mps = m.power_w / (m.mass_kg * engine_mps2)
        for _ in range(steps):
            # Comparisons instead of min and max: this loop runs 3,000 times per episode.
            turn = steer_goal - steer
            steer += turn if -turn_most < turn < turn_most else (turn_most if turn > 0.0 else -turn_most)
            top = engine_mps2
            if v > slow_mps:
                top = m.power_w / (m.mass_kg * v)
            goal = top if accel_mps2 > top else brakes if accel_mps2 < brakes else accel_mps2
            if goal < drive:
                change = (goal - drive) * PHYSICS_STEP_S / brake_lag_s
                drive += change if change > most_braking else most_braking
            else:
                lag_s = brake_lag_s if drive < 0.0 else engine_lag_s
                drive += (goal - drive) * PHYSICS_STEP_S / lag_s
            # Per unit of mass, an axle's grip is friction times its share of gravity.
            shift = transfer * accel
            grip_front = friction * (half_load - shift)
            grip_rear = friction * (half_load + shift)
            wanted_rate = v * tan(steer) / wheelbase_m
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
                course += 0.5 * wheelbase_m * yaw_rate / v
            x += middle * cos(course) * PHYSICS_STEP_S
            y += middle * sin(course) * PHYSICS_STEP_S
            yaw += yaw_rate * PHYSICS_STEP_S
            v = faster
        self.x_m, self.y_m, self.yaw_rad, self.speed_mps = x, y, yaw, v
        self._drive_mps2, self.accel_mps2, self.steer_rad, self.yaw_rate_radps = drive, accel, steer, yaw_rate

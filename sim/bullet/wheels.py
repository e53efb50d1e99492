"""The ego of `fidelity: wheels`: a chassis on four sphere wheels, driven and braked by the physics engine.

The car is described in URDF, which is generated here. Spheres touch the ground in one point, so grip is Coulomb
friction at four loaded contacts, and load transfer, friction circle and locking follow from the contacts instead of
formulas. All damping is set to zero: the engine's default for multibodies distorts braking by a factor of 1.4 to 2.5.
Nothing but the ground touches the wheels; clearances to others are measured with boxes, as for the single-track
model.
"""

import atexit
import math
import shutil
import tempfile
from functools import cache
from pathlib import Path

import pybullet

from brink.sim.bullet.engine import Engine, wheels_engine
from brink.sim.world.ego import EGO_CAR, GRAVITY_MPS2, PHYSICS_STEP_S, BodyPitch, CarModel, DelayLine

WHEEL_RADIUS_M = 0.32
WHEEL_KG = 25.0
KNUCKLE_KG = 2.0
TRACK_M = 1.55
SOLVER_ITERATIONS = 12
FAST_RADPS = 1_000.0
"""Wheels turn towards this speed when the car accelerates, so that the torque decides and not the speed."""
STEER_TORQUE_NM = 20_000.0
HOLD_BELOW_MPS = 0.03
ABS_SHARE = 1.0
"""Brakes use up to this share of each wheel's grip, so that the car can still be steered."""

_FRONT, _REAR = ("front_left", "front_right"), ("rear_left", "rear_right")


class WheeledCar:
    """The ego on wheels, in place of `brink.sim.world.ego.EgoCar`. Create a new one for each episode.

    Args:
        engine: The engine of the episode. The car has one of its own, in which nothing else moves.
        pose: x_m, y_m and yaw_rad at the start.
        speed_mps: Speed at the start.
        friction: Friction coefficient of the road.
        model: Parameters of the car, the same as for the single-track model.
    """

    def __init__(
        self,
        engine: Engine,
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
        own = wheels_engine()
        own.reset()
        self._client = own.client
        self._friction = friction
        self.pitch_rad = 0.0
        self._pitch = BodyPitch(model)
        self._commands = DelayLine(model.delay_s)
        self._drive_mps2 = 0.0
        self._steps = 0
        self._grade = 0.0
        self._make_ground()
        self._car = self._make_car(pose, speed_mps)
        names = {
            pybullet.getJointInfo(self._car, joint, physicsClientId=self._client)[1].decode(): joint
            for joint in range(pybullet.getNumJoints(self._car, physicsClientId=self._client))
        }
        self._steering = [names[f"steer_{name}"] for name in _FRONT]
        self._front = [names[f"spin_{name}"] for name in _FRONT]
        self._rear = [names[f"spin_{name}"] for name in _REAR]
        self._prepare(friction, speed_mps)

    def _make_ground(self) -> None:
        pybullet.setPhysicsEngineParameter(
            numSolverIterations=SOLVER_ITERATIONS, physicsClientId=self._client
        )
        pybullet.setGravity(0.0, 0.0, -GRAVITY_MPS2, physicsClientId=self._client)
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        ground = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
        # Bullet multiplies the friction of both bodies: the ground has 1, the wheels have that of the road.
        pybullet.changeDynamics(
            ground, -1, lateralFriction=1.0, rollingFriction=0.0, physicsClientId=self._client
        )

    def _make_car(self, pose: tuple[float, float, float], speed_mps: float) -> int:
        x_m, y_m, yaw_rad = pose
        car = int(
            pybullet.loadURDF(
                str(_urdf_file(self.model)),
                basePosition=(x_m, y_m, self.model.gravity_height_m),
                baseOrientation=(0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad)),
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=self._client,
            )
        )
        pybullet.resetBaseVelocity(
            car,
            linearVelocity=(speed_mps * math.cos(yaw_rad), speed_mps * math.sin(yaw_rad), 0.0),
            angularVelocity=(0.0, 0.0, 0.0),
            physicsClientId=self._client,
        )
        return car

    def _prepare(self, friction: float, speed_mps: float) -> None:
        client = self._client
        for link in range(-1, pybullet.getNumJoints(self._car, physicsClientId=client)):
            pybullet.changeDynamics(
                self._car,
                link,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                lateralFriction=friction,
                rollingFriction=0.0,
                spinningFriction=0.0,
                restitution=0.0,
                physicsClientId=client,
            )
        for joint in (*self._front, *self._rear):
            pybullet.resetJointState(
                self._car, joint, 0.0, speed_mps / WHEEL_RADIUS_M, physicsClientId=client
            )
        self._turn((0.0,) * 4, (0.0,) * 4)

    def set_grade(self, grade: float) -> None:
        """Set the local slope of the road: rise over run along the heading, positive uphill."""
        self._grade = grade

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
        m, client = self.model, self._client
        # Slope and resistance act on the mass of the car, so they are modelled as part of gravity.
        along = GRAVITY_MPS2 * self._grade
        if self.speed_mps > 0.1:
            along += m.rolling_mps2 + m.drag_1pm * self.speed_mps * self.speed_mps
        pybullet.setGravity(
            -along * math.cos(self.yaw_rad),
            -along * math.sin(self.yaw_rad),
            -GRAVITY_MPS2,
            physicsClientId=client,
        )
        steer_goal = min(max(steer_rad, -m.steer_limit_rad), m.steer_limit_rad)
        most = m.steer_rate_radps * PHYSICS_STEP_S * steps
        self.steer_rad += min(max(steer_goal - self.steer_rad, -most), most)
        if steps != self._steps:
            # One call makes all steps: a call costs more than a step.
            self._steps = steps
            pybullet.setPhysicsEngineParameter(
                fixedTimeStep=steps * PHYSICS_STEP_S, numSubSteps=steps, physicsClientId=client
            )
        self._actuate(self._mean_drive_mps2(accel_mps2, steps))
        before = self.speed_mps
        if before < HOLD_BELOW_MPS and self._drive_mps2 < 0.0:
            # The brakes hold the car; the contacts of the engine would let it creep.
            self.speed_mps = self.accel_mps2 = self.yaw_rate_radps = 0.0
            return
        pybullet.stepSimulation(physicsClientId=client)
        self._read(before, steps * PHYSICS_STEP_S)

    def _mean_drive_mps2(self, accel_mps2: float, steps: int) -> float:
        """Return the mean of what engine and brakes give over some steps, with their lags and rates."""
        m, total = self.model, 0.0
        top = min(m.engine_mps2, m.power_w / (m.mass_kg * max(self.speed_mps, 1.0)))
        goal = min(max(accel_mps2, -m.brake_mps2), top)
        for _ in range(steps):
            drive = self._drive_mps2
            if goal < drive:
                change = max(
                    (goal - drive) * PHYSICS_STEP_S / m.brake_lag_s, -m.brake_rate_mps3 * PHYSICS_STEP_S
                )
            else:
                change = (goal - drive) * PHYSICS_STEP_S / (m.brake_lag_s if drive < 0.0 else m.engine_lag_s)
            self._drive_mps2 = drive + change
            total += self._drive_mps2
        return total / steps

    def _actuate(self, drive_mps2: float) -> None:
        client, m = self._client, self.model
        pybullet.setJointMotorControlArray(
            self._car,
            self._steering,
            pybullet.POSITION_CONTROL,
            targetPositions=(self.steer_rad, self.steer_rad),
            forces=(STEER_TORQUE_NM, STEER_TORQUE_NM),
            physicsClientId=client,
        )
        force_n = drive_mps2 * m.mass_kg
        if (force_n >= 0.0 and self.speed_mps >= HOLD_BELOW_MPS) or drive_mps2 > HOLD_BELOW_MPS:
            torque = 0.5 * force_n * WHEEL_RADIUS_M
            self._turn((FAST_RADPS, FAST_RADPS, 0.0, 0.0), (torque, torque, 0.0, 0.0))
            return
        half_load_n = 0.25 * m.mass_kg * GRAVITY_MPS2
        shift_n = 0.5 * m.gravity_height_m / m.wheelbase_m * m.mass_kg * self.accel_mps2
        front_n = ABS_SHARE * self._friction * (half_load_n - shift_n)
        rear_n = ABS_SHARE * self._friction * (half_load_n + shift_n)
        wanted_n = -force_n
        share = min(wanted_n / max(2.0 * (front_n + rear_n), 1.0), 1.0)
        if self.speed_mps < HOLD_BELOW_MPS:
            share = 1.0
        front, rear = share * front_n * WHEEL_RADIUS_M, share * rear_n * WHEEL_RADIUS_M
        self._turn((0.0,) * 4, (front, front, rear, rear))

    def _turn(self, speeds_radps: tuple[float, ...], torques_nm: tuple[float, ...]) -> None:
        """Turn the wheels towards speeds with at most these torques. The engine keeps this for all steps of a call.

        It turns a torque into an impulse for the time of the whole call, and applies that in each step.
        """
        pybullet.setJointMotorControlArray(
            self._car,
            (*self._front, *self._rear),
            pybullet.VELOCITY_CONTROL,
            targetVelocities=speeds_radps,
            forces=[torque_nm / max(self._steps, 1) for torque_nm in torques_nm],
            physicsClientId=self._client,
        )

    def _read(self, speed_before_mps: float, lasted_s: float) -> None:
        client = self._client
        (x_m, y_m, _), turn = pybullet.getBasePositionAndOrientation(self._car, physicsClientId=client)
        (vx, vy, _), (_, _, yaw_rate) = pybullet.getBaseVelocity(self._car, physicsClientId=client)
        qx, qy, qz, qw = turn
        heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        # Yaw continues beyond half a turn, as in the single-track model.
        self.yaw_rad += (heading - self.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
        self.x_m, self.y_m, self.yaw_rate_radps = x_m, y_m, yaw_rate
        self.speed_mps = max(vx * math.cos(self.yaw_rad) + vy * math.sin(self.yaw_rad), 0.0)
        self.accel_mps2 = (self.speed_mps - speed_before_mps) / lasted_s


@cache
def _urdf_file(model: CarModel) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="brink-car-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = folder / "car.urdf"
    path.write_text(car_urdf(model))
    return path


def car_urdf(model: CarModel) -> str:
    """Return the URDF of the car: a chassis without a collision shape, steered knuckles, and sphere wheels."""
    chassis_kg = model.mass_kg - 4.0 * WHEEL_KG - 2.0 * KNUCKLE_KG
    inertia = (
        chassis_kg / 12.0 * (model.width_m**2 + 1.2**2),
        chassis_kg / 12.0 * (model.length_m**2 + 1.2**2) * 0.8,
        chassis_kg / 12.0 * (model.length_m**2 + model.width_m**2) * 0.8,
    )
    parts = ['<robot name="car">', _link("chassis", chassis_kg, inertia)]
    drop_m = WHEEL_RADIUS_M - model.gravity_height_m
    for name in (*_FRONT, *_REAR):
        x_m = (0.5 if name in _FRONT else -0.5) * model.wheelbase_m
        y_m = (0.5 if name.endswith("left") else -0.5) * TRACK_M
        where = f"{x_m} {y_m} {drop_m}"
        mount = "chassis"
        if name in _FRONT:
            mount, limit = f"knuckle_{name}", model.steer_limit_rad
            parts.append(_link(mount, KNUCKLE_KG, (0.05, 0.05, 0.05)))
            parts.append(
                f'<joint name="steer_{name}" type="revolute"><parent link="chassis"/><child link="{mount}"/>'
                f'<origin xyz="{where}"/><axis xyz="0 0 1"/>'
                f'<limit lower="{-limit}" upper="{limit}" effort="1e6" velocity="1e3"/></joint>'
            )
            where = "0 0 0"
        spin = 0.4 * WHEEL_KG * WHEEL_RADIUS_M**2
        parts.append(_link(f"wheel_{name}", WHEEL_KG, (spin, spin, spin), sphere_m=WHEEL_RADIUS_M))
        parts.append(
            f'<joint name="spin_{name}" type="continuous"><parent link="{mount}"/>'
            f'<child link="wheel_{name}"/><origin xyz="{where}"/><axis xyz="0 1 0"/></joint>'
        )
    return "\n".join((*parts, "</robot>", ""))


def _link(name: str, mass_kg: float, inertia: tuple[float, float, float], *, sphere_m: float = 0.0) -> str:
    ixx, iyy, izz = inertia
    shape = f'<collision><geometry><sphere radius="{sphere_m}"/></geometry></collision>' if sphere_m else ""
    return (
        f'<link name="{name}"><inertial><mass value="{mass_kg}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>'
    )

"""The ego of `fidelity: wheels`: a chassis on four sphere wheels, driven and braked by the physics engine.

The car is described in URDF, which is generated here. Spheres touch the ground in one point, so grip is Coulomb
friction at four loaded contacts, and load transfer and friction circle follow from the contacts instead of formulas.
Anti-lock brakes and traction control limit the slip of each wheel; without them, a wheel with little load spins or
locks, and its axle loses its grip for cornering. All damping is set to zero: the engine's default for multibodies
distorts braking by a factor of 1.4 to 2.5. Nothing but the ground touches the wheels; clearances to others are
measured with boxes, as for the bicycle model.
"""

import atexit
import math
import shutil
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pybullet

from brink.sim.bullet.engine import Engine, wheels_engine
from brink.sim.world.ego import EGO_CAR, GRAVITY_MPS2, PHYSICS_STEP_S, BodyPitch, CarModel, DelayLine

WHEEL_RADIUS_M = 0.32
WHEEL_KG = 25.0
KNUCKLE_KG = 2.0
TRACK_M = 1.55
SOLVER_ITERATIONS = 30
SUBSTEP_S = 0.025
"""Longest step of the engine. Steps of 10 ms with 12 iterations cost twice as much and are no closer to friction."""
SLIP_MPS = 0.3
"""Anti-lock brakes and traction control let no wheel slip by more than this."""
STEER_TORQUE_NM = 20_000.0
HOLD_BELOW_MPS = 0.03

_FRONT, _REAR = ("front_left", "front_right"), ("rear_left", "rear_right")
_POSITION_GAINS = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
_VELOCITY_GAINS = (1.0,) * 6


class WheeledCar:
    """The ego on wheels, in place of `brink.sim.world.ego.EgoCar`. Create a new one for each episode.

    Args:
        engine: The engine of the episode. The car has one of its own, in which nothing else moves.
        pose: x_m, y_m and yaw_rad at the start.
        speed_mps: Speed at the start.
        friction: Friction coefficient of the road.
        model: Parameters of the car, the same as for the bicycle model.
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
        self._aside_mps = 0.0
        self._steps = 0
        self._substeps = 1
        self._grade = 0.0
        self._make_ground()
        self._car = self._make_car(pose, speed_mps)
        names = {
            pybullet.getJointInfo(self._car, joint, physicsClientId=self._client)[1].decode(): joint
            for joint in range(pybullet.getNumJoints(self._car, physicsClientId=self._client))
        }
        self._wheels = [names[f"spin_{name}"] for name in (*_FRONT, *_REAR)]
        self._joints = [*(names[f"steer_{name}"] for name in _FRONT), *self._wheels]
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
        for joint in self._wheels:
            pybullet.resetJointState(
                self._car, joint, 0.0, speed_mps / WHEEL_RADIUS_M, physicsClientId=client
            )
        self._turn((0.0,) * 4, 0.0, 0.0)

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
        steer_goal = min(max(steer_rad, -m.steer_limit_rad), m.steer_limit_rad)
        most = m.steer_rate_radps * PHYSICS_STEP_S * steps
        self.steer_rad += min(max(steer_goal - self.steer_rad, -most), most)
        # Slope and drag act on the mass of the car, so they are modelled as part of gravity.
        along_mps2 = GRAVITY_MPS2 * self._grade + m.drag_1pm * self.speed_mps * self.speed_mps
        drive_mps2 = self._mean_drive_mps2(accel_mps2, steps) - m.rolling_mps2
        before = self.speed_mps
        if before < HOLD_BELOW_MPS and drive_mps2 <= along_mps2:
            # As in the bicycle model, the car never rolls backwards; the contacts of the engine would let it creep.
            self.speed_mps = self.accel_mps2 = self.yaw_rate_radps = self._aside_mps = 0.0
            return
        pybullet.setGravity(
            -along_mps2 * math.cos(self.yaw_rad),
            -along_mps2 * math.sin(self.yaw_rad),
            -GRAVITY_MPS2,
            physicsClientId=client,
        )
        if steps != self._steps:
            # One call makes all steps.
            self._steps = steps
            self._substeps = math.ceil(steps * PHYSICS_STEP_S / SUBSTEP_S - 1e-6)
            pybullet.setPhysicsEngineParameter(
                fixedTimeStep=steps * PHYSICS_STEP_S, numSubSteps=self._substeps, physicsClientId=client
            )
        self._actuate(drive_mps2)
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
        """Steer, and drive or brake the wheels, none of which slips by more than `SLIP_MPS`."""
        m = self.model
        force_nm = abs(drive_mps2) * m.mass_kg * WHEEL_RADIUS_M
        lasts_s = self._steps * PHYSICS_STEP_S
        if drive_mps2 >= 0.0:
            slip_mps = drive_mps2 * lasts_s + SLIP_MPS
            wheels_radps = [(rolls_mps + slip_mps) / WHEEL_RADIUS_M for rolls_mps in self._rolling_mps()]
            self._turn(wheels_radps, 0.5 * force_nm, 0.0)
            return
        slip_mps = max(drive_mps2, -self._friction * GRAVITY_MPS2) * lasts_s - SLIP_MPS
        wheels_radps = [max(rolls_mps + slip_mps, 0.0) / WHEEL_RADIUS_M for rolls_mps in self._rolling_mps()]
        # The brakes act on each axle by its load.
        rear = 0.5 + m.gravity_height_m / m.wheelbase_m * self.accel_mps2 / GRAVITY_MPS2
        self._turn(wheels_radps, 0.5 * (1.0 - rear) * force_nm, 0.5 * rear * force_nm)

    def _rolling_mps(self) -> tuple[float, float, float, float]:
        """Return the speed at which each wheel would roll without slip."""
        across_mps = 0.5 * TRACK_M * self.yaw_rate_radps
        front_mps = self._aside_mps + 0.5 * self.model.wheelbase_m * self.yaw_rate_radps
        cos_steer, sin_steer = math.cos(self.steer_rad), math.sin(self.steer_rad)
        left_mps, right_mps = self.speed_mps - across_mps, self.speed_mps + across_mps
        aside_mps = front_mps * sin_steer
        return left_mps * cos_steer + aside_mps, right_mps * cos_steer + aside_mps, left_mps, right_mps

    def _turn(self, wheels_radps: Sequence[float], front_nm: float, rear_nm: float) -> None:
        """Steer, and turn the wheels towards speeds with at most these torques.

        The engine keeps this for all steps of a call. It turns a torque into an impulse for the time of the whole
        call, and applies that in each step.
        """
        front_nm, rear_nm = front_nm / self._substeps, rear_nm / self._substeps
        steer_rad = self.steer_rad
        # Position gains of 0 make the wheels follow speeds alone; 1 turns the knuckles within a step.
        pybullet.setJointMotorControlArray(
            self._car,
            self._joints,
            pybullet.POSITION_CONTROL,
            targetPositions=(steer_rad, steer_rad, 0.0, 0.0, 0.0, 0.0),
            targetVelocities=(0.0, 0.0, *wheels_radps),
            forces=(STEER_TORQUE_NM, STEER_TORQUE_NM, front_nm, front_nm, rear_nm, rear_nm),
            positionGains=_POSITION_GAINS,
            velocityGains=_VELOCITY_GAINS,
            physicsClientId=self._client,
        )

    def _read(self, speed_before_mps: float, lasted_s: float) -> None:
        client = self._client
        (x_m, y_m, _), turn = pybullet.getBasePositionAndOrientation(self._car, physicsClientId=client)
        (vx, vy, _), (_, _, yaw_rate) = pybullet.getBaseVelocity(self._car, physicsClientId=client)
        qx, qy, qz, qw = turn
        heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        # Yaw continues beyond half a turn, as in the bicycle model.
        self.yaw_rad += (heading - self.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
        self.x_m, self.y_m, self.yaw_rate_radps = x_m, y_m, yaw_rate
        cos_yaw, sin_yaw = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        self.speed_mps = max(vx * cos_yaw + vy * sin_yaw, 0.0)
        self._aside_mps = vy * cos_yaw - vx * sin_yaw
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

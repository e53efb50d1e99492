"""No road user moves faster than it can: over whole episodes of random candidates."""

import math
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest
from support.marks import mostly_long

from brink.server.problems.catalogue import make_problem
from brink.server.problems.urban_injected import UrbanInjected
from brink.sim.bullet.engine import process_engine
from brink.sim.bullet.wheels import WheeledCar
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import CONTROL_STEP_S, Driving
from brink.sim.driving.system import ModularDriving
from brink.sim.episode import JsonObject
from brink.sim.requirements import WorldSample
from brink.sim.urban.behaviour import DetectorBehaviour
from brink.sim.urban.episode_loop import run_loop
from brink.sim.urban.facts import Facts
from brink.sim.urban.options import BICYCLE, WHEELS
from brink.sim.world.ego import EGO_CAR, GRAVITY_MPS2, EgoCar, MakeEgo
from brink.sim.world.pedestrians import HURRY_SHARE, WALK_ACCEL_MPS2, WALKER_STEP_S
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.world import RoadUser, UrbanWorld, make_world

FASTER_TO_CROSS = 1.1
"""People cross the road a tenth faster than they walk, and hurry out of a vehicle's way at `HURRY_SHARE` of that."""
ROUNDING_M, ROUNDING = 1e-3, 1e-6
GRIP_TOLERANCE = 2e-3
"""Of accelerations that are means over steps of 0.05 s."""
SLIDING_TOLERANCE = 0.02
"""On wheels, the yaw rate also contains the car's own rotation, so yaw rate times speed is not only acceleration."""
OFF_BEND_M = 3e-3
"""Between two looks people walk straight on, even in a bend, and are then placed on it again."""
SCENARIO: JsonObject = {
    "time_of_day": "noon",
    "weather": "clear",
    "pedestrians": 18,
    "road_curve": "straight",
    "road_id": 0,
    "road_length": 2,
    "driving_task": "follow_road",
}


@dataclass
class Motion:
    """Compares each step of every road user with what it can do."""

    world: UrbanWorld
    poses: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    jumps: list[tuple[str, float, float]] = field(default_factory=list)
    skids: list[tuple[str, float, float]] = field(default_factory=list)
    jerks: list[tuple[str, float, float]] = field(default_factory=list)
    ego_mps: float = 0.0
    ego_pose: tuple[float, float] = (0.0, 0.0)
    ego_grade: float = 0.0
    grip_tolerance: float = GRIP_TOLERANCE
    ego_steer_rad: float = 0.0

    def __post_init__(self) -> None:
        self.ego_grade = self.world.grade_at(0.0)
        self._remember()

    def _remember(self) -> None:
        users: tuple[RoadUser, ...] = (*self.world.vehicles, *self.world.walkers)
        for user in users:
            self.poses[user.name] = (user.x_m, user.y_m, user.yaw_rad, user.speed_mps)
        ego = self.world.ego
        self.ego_pose, self.ego_mps, self.ego_steer_rad = (ego.x_m, ego.y_m), ego.speed_mps, ego.steer_rad

    def see(self, sample: WorldSample, driving: Driving) -> None:
        """Compare the last step."""
        for walker in self.world.walkers:
            before_mps = self.poses[walker.name][3]
            moved_m = self._moved(walker)
            # Within a step, people move at the speed that they have after it.
            limit_m = walker.speed_mps * WALKER_STEP_S
            if moved_m > limit_m + OFF_BEND_M:
                self.jumps.append((walker.name, sample.time_s, moved_m - limit_m))
            most_mps = walker.walking_mps * FASTER_TO_CROSS * HURRY_SHARE
            changed_mps = abs(walker.speed_mps - before_mps)
            if (
                changed_mps > WALK_ACCEL_MPS2 * WALKER_STEP_S + ROUNDING
                or walker.speed_mps > most_mps + ROUNDING
            ):
                self.jerks.append((walker.name, sample.time_s, walker.speed_mps - before_mps))
        grip_mps2 = self.world.weather.friction * GRAVITY_MPS2
        for vehicle in self.world.vehicles:
            _, _, yaw_rad, before_mps = self.poses[vehicle.name]
            moved_m = self._moved(vehicle)
            limit_m = max(before_mps, vehicle.speed_mps) * CONTROL_STEP_S
            if moved_m > limit_m + ROUNDING_M:
                self.jumps.append((vehicle.name, sample.time_s, moved_m - limit_m))
            turned_rad = abs(math.remainder(vehicle.yaw_rad - yaw_rad, math.tau))
            lateral_mps2 = turned_rad / CONTROL_STEP_S * moved_m / CONTROL_STEP_S
            braking_mps2 = (before_mps - vehicle.speed_mps) / CONTROL_STEP_S
            if max(lateral_mps2, braking_mps2) > grip_mps2:
                self.skids.append((vehicle.name, sample.time_s, max(lateral_mps2, braking_mps2)))
        self._see_ego(sample, grip_mps2)
        self._remember()

    def _see_ego(self, sample: WorldSample, grip_mps2: float) -> None:
        """Compare the ego's last step: its tyres transmit what friction allows; slope and drag act on its body."""
        ego = self.world.ego
        moved_m = math.dist((ego.x_m, ego.y_m), self.ego_pose)
        mean_mps = 0.5 * (self.ego_mps + ego.speed_mps)
        # In a bend, the centre moves across the heading as well.
        across = 0.5 * math.tan(max(abs(ego.steer_rad), abs(self.ego_steer_rad)))
        limit_m = max(self.ego_mps, ego.speed_mps) * CONTROL_STEP_S * math.hypot(1.0, across)
        if moved_m > limit_m + ROUNDING_M:
            self.jumps.append(("ego", sample.time_s, moved_m - limit_m))
        on_body_mps2 = GRAVITY_MPS2 * self.ego_grade + EGO_CAR.drag_1pm * mean_mps**2
        along_mps2 = (ego.speed_mps - self.ego_mps) / CONTROL_STEP_S + on_body_mps2 if ego.speed_mps else 0.0
        tyres_mps2 = math.hypot(along_mps2, ego.yaw_rate_radps * mean_mps)
        if tyres_mps2 > grip_mps2 * (1.0 + self.grip_tolerance):
            self.skids.append(("ego", sample.time_s, tyres_mps2))
        self.ego_grade = self.world.grade_at(sample.station_m)
        if abs(ego.steer_rad - self.ego_steer_rad) > EGO_CAR.steer_rate_radps * CONTROL_STEP_S + ROUNDING:
            self.jerks.append(("ego", sample.time_s, ego.steer_rad - self.ego_steer_rad))

    def _moved(self, user: RoadUser) -> float:
        x_m, y_m, _, _ = self.poses[user.name]
        return math.hypot(user.x_m - x_m, user.y_m - y_m)

    def violated(self, requirement: str) -> None:
        """Ignore violations."""


def watch(number: int, fidelity: str) -> Motion:
    """Watch the episode of a random candidate."""
    problem = make_problem("urban-injected@1", {})
    assert isinstance(problem, UrbanInjected)
    spec = problem.episode(problem.space.sample(np.random.default_rng([20, number])), number)
    engine = process_engine()
    engine.reset()
    make_ego: MakeEgo = partial(WheeledCar, engine) if fidelity == WHEELS else EgoCar
    world = make_world(UrbanScenario.from_json(spec.scenario), number, make_ego)
    motion = Motion(world, grip_tolerance=SLIDING_TOLERANCE if fidelity == WHEELS else GRIP_TOLERANCE)
    camera = Camera()
    run_loop(
        world,
        ModularDriving(world.route, camera=camera),
        DetectorBehaviour.from_json(spec.behaviour),
        {},
        engine=engine,
        camera=camera,
        seed=number,
        duration_s=spec.duration_s,
        recorder=None,
        witness=motion,
        to_the_end=True,
    )
    return motion


# Before brink-drive@3, people jumped to the kerb in most of these episodes, and the lead vehicle skidded in 0, 72
# and 154.
@pytest.mark.parametrize(
    "number", mostly_long([*range(24), 72, 154], [0, 2, 9, 72, 154], "further random candidates")
)
def test_road_users_move_as_fast_as_they_can_at_most(number: int) -> None:
    motion = watch(number, BICYCLE)
    assert (motion.jumps, motion.skids, motion.jerks) == ([], [], [])


# The car on wheels once rolled backwards in 14 and 15.
@pytest.mark.parametrize("number", mostly_long([*range(6), 14, 15], [2, 14], "further random candidates"))
def test_an_ego_on_wheels_moves_as_friction_allows(number: int) -> None:
    motion = watch(number, WHEELS)
    assert (motion.jumps, motion.skids, motion.jerks) == ([], [], [])


def test_a_jump_a_skid_and_a_jerk_are_noticed() -> None:
    motion = Motion(make_world(UrbanScenario.from_json(SCENARIO), 1))
    driving = ModularDriving(motion.world.route, camera=Camera())
    engine = process_engine()
    engine.reset()
    sample = Facts(motion.world, engine).measure(0.0)
    motion.see(sample, driving)
    assert (motion.jumps, motion.skids, motion.jerks) == ([], [], [])
    lead, oncoming = motion.world.vehicles[:2]
    jumping, jerking = motion.world.walkers[:2]
    ego = motion.world.ego
    jumping.x_m += 0.3
    jerking.speed_mps -= 1.01 * WALK_ACCEL_MPS2 * WALKER_STEP_S
    lead.x_m += 0.95 * lead.speed_mps * CONTROL_STEP_S
    lead.yaw_rad += 0.1
    oncoming.speed_mps -= 1.01 * 0.9 * GRAVITY_MPS2 * CONTROL_STEP_S
    ego.x_m += 1.1 * ego.speed_mps * CONTROL_STEP_S
    ego.steer_rad += 1.01 * EGO_CAR.steer_rate_radps * CONTROL_STEP_S
    ego.speed_mps -= 1.01 * (0.9 * GRAVITY_MPS2 + EGO_CAR.drag_1pm * ego.speed_mps**2) * CONTROL_STEP_S
    motion.see(sample, driving)
    assert [name for name, _, _ in motion.jumps] == [jumping.name, "ego"]
    assert [name for name, _, _ in motion.skids] == ["lead", oncoming.name, "ego"]
    assert [name for name, _, _ in motion.jerks] == [jerking.name, "ego"]

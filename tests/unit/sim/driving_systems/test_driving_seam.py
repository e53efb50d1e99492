"""The seam between drives and driving systems: nothing changes for Brink's own, and wrong decisions never pass."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, ClassVar, Literal

import numpy as np
import pytest

from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams
from brink.sim import catalogue
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import CONTROL_STEP_S, Box, Command, ObstacleLabel, PlanMode
from brink.sim.driving.system import ModularDriving
from brink.sim.driving_systems import (
    Decision,
    EgoState,
    Observation,
    PerceivedObstacle,
    SeenObject,
    Start,
    TrajectoryPoint,
)
from brink.sim.driving_systems.motion import tracking_command
from brink.sim.driving_systems.option import DRIVING_SYSTEMS, DrivingOption
from brink.sim.driving_systems.seam import SystemUnderTest, object_tracking, seen_objects
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.episode import EpisodeSpec, JsonObject
from brink.sim.errors import DrivingSystemFailed, InvalidEpisode
from brink.sim.trace import Trace
from brink.sim.urban.simulator import BrinkDrive
from brink.sim.world.ego import EGO_CAR, EgoCar
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import LaneRoute

SCENARIO: JsonObject = {
    "time_of_day": "noon",
    "weather": "wet",
    "pedestrians": 18,
    "road_curve": "left",
    "road_id": 0,
    "road_length": 0,
    "driving_task": "follow_road",
}
SPEC = EpisodeSpec(
    simulator="brink-drive@3",
    scenario=SCENARIO,
    behaviour={"mode": "oracle"},
    requirements=("front-gap@1", "no-collision@1", "lane-keeping@1"),
    seed=12,
    duration_s=12.0,
)
ROUTE = LaneRoute(
    line=ReferenceLine(0.0, 0.0, 0.0, (Piece(40.0), Piece(30.0, 1 / 40.0), Piece(80.0))),
    lane_width_m=3.5,
    speed_limit_mps=14.0,
)
CAR = Box(ObstacleLabel.VEHICLE, 370.0, 430.0, 290.0, 340.0)


class Fixed:
    """Returns the same decision in each step."""

    needs: ClassVar[Literal["boxes", "objects"]] = "boxes"
    decision: Any = Decision()

    def __init__(self, start: Start) -> None:
        self.start = start

    def step(self, observation: Observation) -> Any:
        return self.decision


def answering(answer: Any, need: str = "boxes") -> Callable[[Start], Any]:
    return type("Answering", (Fixed,), {"decision": answer, "needs": need})


def drives(make: Callable[[Start], Any], route: LaneRoute = ROUTE) -> SystemUnderTest:
    """Return a system in a drive, through the option that makes it."""
    catalogue.register(DRIVING_SYSTEMS, "tested@1", make)
    return DrivingOption(system="tested@1").start(route, EGO_CAR, Camera(), 3)


@pytest.fixture(autouse=True)
def _forgets() -> Iterator[None]:
    yield
    catalogue._registered.pop(DRIVING_SYSTEMS, None)


def observed(step: int, *boxes: Box, speed_mps: float = 8.0, seen_s: float | None = None) -> Observation:
    x_m = 8.0 * CONTROL_STEP_S * step
    ego = EgoState(
        x_m=x_m, y_m=0.1, yaw_rad=0.02, speed_mps=speed_mps, accel_mps2=0.0, station_m=x_m, offset_m=0.1
    )
    return Observation(
        time_s=CONTROL_STEP_S * step, ego=ego, boxes=None if step % 2 else boxes, light=None, seen_s=seen_s
    )


def with_system(spec: EpisodeSpec, make: Callable[[Start], Any]) -> EpisodeSpec:
    catalogue.register(DRIVING_SYSTEMS, "tested@1", make)
    return replace(spec, options={"driving": {"system": "tested@1"}})


class OwnThenNothing(Fixed):
    """Decides as Brink's own system does, and after `LEAVES_AT_S` leaves everything to it."""

    LEAVES_AT_S: ClassVar = 4.0

    def __init__(self, start: Start) -> None:
        self.own = ModularDriving(start.route)

    def step(self, observation: Observation) -> Decision:
        command = self.own.step(observation)
        if observation.time_s >= self.LEAVES_AT_S:
            return Decision()
        plan = self.own.plan
        return Decision(
            accel_mps2=command.accel_mps2,
            steer_rad=command.steer_rad,
            mode=plan.mode,
            target_speed_mps=plan.target_speed_mps,
            target_offset_m=plan.target_offset_m,
            objects=self.own.obstacles,
        )


@pytest.mark.parametrize("make", [Fixed, answering(Decision(), "objects"), OwnThenNothing])
def test_what_a_decision_leaves_out_is_what_brinks_own_system_would_have_done(
    make: Callable[[Start], Any],
) -> None:
    simulator = BrinkDrive()
    own, other = (simulator.run(spec, record=True) for spec in (SPEC, with_system(SPEC, make)))
    assert other.verdicts == own.verdicts
    assert other.features == own.features
    assert own.trace is not None
    assert other.trace is not None
    seen, driven = Trace.from_bytes(own.trace), Trace.from_bytes(other.trace)
    np.testing.assert_array_equal(driven.ego, seen.ego)
    assert driven.plan_mode == seen.plan_mode
    assert set(driven.plan_mode) > {"cruise"}
    np.testing.assert_array_equal(driven.target_speed_mps, seen.target_speed_mps)
    assert other.provenance["driving"] == "tested@1"
    assert "driving" not in own.provenance


def test_half_a_decision_is_filled_in() -> None:
    own, brakes, steers = ModularDriving(ROUTE), drives(answering(Decision(accel_mps2=-3))), None
    steers = drives(answering(Decision(wheel=-0.5, pedal=None)))
    for step in range(6):
        command = own.step(observed(step, CAR))
        braking, steering = brakes.step(observed(step, CAR)), steers.step(observed(step, CAR))
        assert braking == Command(-3.0, command.steer_rad)
        assert steering == Command(command.accel_mps2, -0.5 * EGO_CAR.steer_limit_rad)


@pytest.mark.parametrize(
    ("pedal", "accel_mps2"), [(1.0, 3.5), (0.5, 1.75), (0.0, 0.0), (-0.25, -3.0), (-1, -12.0)]
)
def test_pedals_are_shares_of_the_limits_of_engine_and_brakes(pedal: float, accel_mps2: float) -> None:
    command = drives(answering(Decision(pedal=pedal, wheel=1.0))).step(observed(0))
    assert command == Command(accel_mps2, EGO_CAR.steer_limit_rad)


def points(*times_s: float, **wrong: Any) -> tuple[TrajectoryPoint, ...]:
    made = [TrajectoryPoint(time_s, 8.0 * time_s, 0.0, 0.0, 8.0, 0.0) for time_s in times_s]
    return (*made[:-1], made[-1]._replace(**wrong))


WRONG = [
    (None, "a brink.sim.driving_systems.Decision, got None"),
    ((0.0, 0.1), r"a brink.sim.driving_systems.Decision, got \(0.0, 0.1\)"),
    (Command(0.0, 0.0), "a brink.sim.driving_systems.Decision, got Command"),
    (Decision(accel_mps2=math.nan, steer_rad=0.0), "accel_mps2: a finite float or int, or None; got nan"),
    (Decision(accel_mps2=0.0, steer_rad=math.inf), "steer_rad: a finite float or int, or None; got inf"),
    (Decision(accel_mps2=np.float64(1.0), steer_rad=0.0), r"accel_mps2: .* \(float64; float\(...\) makes one\)"),
    (Decision(accel_mps2=True, steer_rad=0.0), "accel_mps2: a finite float or int, or None; got True"),
    (Decision(accel_mps2="1", steer_rad=0.0), "accel_mps2: .* got '1'"),  # type: ignore[arg-type]
    (Decision(pedal=1.5), r"pedal: a float or int in \[-1, 1\], or None; got 1.5"),
    (Decision(pedal=0.5, accel_mps2=0.0), "a pedal or an acceleration, a wheel or a steering angle; got both"),
    (Decision(trajectory=points(0.0, 1.0), steer_rad=0.0), "either a trajectory or a command, got both"),
    (Decision(trajectory=()), r"trajectory: a list or tuple of 2 to 1000 points; got \(\)"),
    (Decision(trajectory=np.zeros((4, 6))), "trajectory: a list or tuple of 2 to 1000 points"),  # type: ignore[arg-type]
    (Decision(trajectory=[(0.0,) * 6] * 2), r"trajectory\[0\]: a TrajectoryPoint, got"),  # type: ignore[list-item]
    (Decision(trajectory=points(0.0, 0.0)), "trajectory: points in ascending order of time_s, each once"),
    (Decision(trajectory=points(0.0, 1.0, x_m=math.nan)), r"trajectory\[1\].x_m: a finite float"),
    (Decision(trajectory=points(0.0, 1.0, speed_mps=-1.0)), r"trajectory\[1\].speed_mps: .*, speeds >= 0"),
    (Decision(trajectory=points(0.0, 0.02)), "a trajectory from 0.00 s .* to 0.05 s or later; got 0.00 to 0.02"),
    (Decision(trajectory=points(0.3, 1.0)), "a trajectory from 0.00 s or earlier to .*; got 0.30 to 1.00"),
    (Decision(mode="x" * 41), "mode: up to 40 printable characters"),
    (Decision(mode="\ud800"), "mode: up to 40 printable characters"),
    (Decision(emergency=1), "emergency: True or False, got 1"),  # type: ignore[arg-type]
    (Decision(target_speed_mps=math.inf), "target_speed_mps: a finite float or int, or None; got inf"),
    (Decision(objects=({},)), "objects: each a SeenObject or PerceivedObstacle, got"),  # type: ignore[arg-type]
]  # fmt: skip


@pytest.mark.parametrize(("decision", "expected"), WRONG)
def test_decision_that_is_none_fails_with_what_was_expected(decision: Any, expected: str) -> None:
    system = drives(answering(decision))
    with pytest.raises(
        DrivingSystemFailed, match=rf"^driving system tested@1, step 0 \(0.00 s\): expected .*{expected}"
    ):
        system.step(observed(0))


def test_error_in_the_fifth_step_is_reported_with_its_last_lines() -> None:
    class Divides(Fixed):
        steps = 0

        def step(self, observation: Observation) -> Decision:
            self.steps += 1
            return Decision(accel_mps2=1 / (5 - self.steps))

    with pytest.raises(DrivingSystemFailed) as caught:
        BrinkDrive().run(with_system(SPEC, Divides))
    first, *lines = str(caught.value).splitlines()
    assert first == "driving system tested@1, step 4 (0.20 s): ZeroDivisionError: division by zero"
    assert any("return Decision(accel_mps2=1 / (5 - self.steps))" in line for line in lines)


def test_system_that_cannot_be_made_or_needs_something_unknown_fails() -> None:
    def refuses(start: Start) -> Any:
        raise KeyError("settings")

    with pytest.raises(DrivingSystemFailed, match="driving system tested@1, it cannot be made: KeyError"):
        drives(refuses)
    with pytest.raises(DrivingSystemFailed, match="an attribute needs, one of boxes, objects; got 'lidar'"):
        drives(answering(Decision(), "lidar"))


def test_out_of_memory_is_not_the_driving_systems_fault() -> None:
    class Hungry(Fixed):
        def step(self, observation: Observation) -> Decision:
            raise MemoryError

    with pytest.raises(MemoryError):
        drives(Hungry).step(observed(0))


@pytest.mark.parametrize(
    ("driving", "message"),
    [
        (
            {"system": "nobody@1"},
            "expected one of modular@1, MODULE:CLASS, command:FILE.yaml; got 'nobody@1'",
        ),
        (
            {"system": "os:system"},
            "expected MODULE:FUNCTION with a module that --plugin or BRINK_PLUGINS names",
        ),
        ({"settings": {}}, "expected an object with system, settings"),
        ({"system": "modular@1", "seed": 1}, "expected an object with system, settings"),
        ({"system": "modular@1", "settings": {"speed": 9}}, "Brink's own driving system has none"),
        (["modular@1"], "expected an object with system, settings"),
    ],
)
def test_specification_of_an_unknown_system_is_invalid(driving: Any, message: str) -> None:
    with pytest.raises(InvalidEpisode, match=message):
        BrinkDrive().run(replace(SPEC, options={"driving": driving}))


def test_objects_are_brinks_tracks_moved_on_to_the_present() -> None:
    received: list[Observation] = []

    class Looks(Fixed):
        needs = "objects"

        def step(self, observation: Observation) -> Decision:
            received.append(observation)
            return Decision(accel_mps2=0.0, steer_rad=0.0)

    system, own = drives(Looks), ModularDriving(ROUTE)
    for step in range(9):
        given = observed(
            step, CAR._replace(y_max_px=340.0 + step), seen_s=max(CONTROL_STEP_S * (step - 2), 0.0)
        )
        system.step(given)
        own.step(given)
    assert all(one.boxes is None for one in received)
    assert [one.objects is None for one in received] == [False, True] * 4 + [False]
    (track,), (obstacle,), ego = own.obstacles, system.obstacles, received[-1].ego
    assert track.vx_mps != 0.0
    age_s = 2 * CONTROL_STEP_S
    assert obstacle.x_m == pytest.approx(track.x_m + age_s * track.vx_mps)
    assert obstacle.y_m == pytest.approx(track.y_m + age_s * track.vy_mps)
    assert (obstacle.vx_mps, obstacle.vy_mps) == pytest.approx((track.vx_mps, track.vy_mps))
    assert received[-1].objects is not None
    (one,) = received[-1].objects
    assert math.hypot(one.x_m, one.y_m) == pytest.approx(
        math.hypot(obstacle.x_m - ego.x_m, obstacle.y_m - ego.y_m)
    )
    assert (one.id, one.label, one.existence) == (track.track, ObstacleLabel.VEHICLE, 1.0)
    assert track.vx_mps < -1.0  # it comes the other way
    assert one.yaw_rad == pytest.approx(math.pi - ego.yaw_rad)


def test_existence_falls_while_an_object_is_not_reported() -> None:
    start = drives(Fixed)._start
    tracking = object_tracking(start)
    shares = []
    for step in (0, 2, 4, 6, 8):
        given = observed(step, *((CAR,) if step < 4 else ()))
        tracks = tracking.update(given)
        assert tracks is not None
        shares.append([one.existence for one in seen_objects(tracks, given, start)])
    assert shares == [[], [1.0], [pytest.approx(0.8)], [pytest.approx(0.6)], [pytest.approx(0.4)]]


def test_objects_that_it_believes_in_are_traced_in_world_coordinates() -> None:
    ahead = SeenObject(7, ObstacleLabel.PERSON, 0.5, 10.0, 2.0, 0.0, 1.0, 0.0, 0.5, 0.5)
    there = PerceivedObstacle(8, ObstacleLabel.VEHICLE, 50.0, 1.0, 3.0, 0.0, 4.5, 1.8)
    system = drives(answering(Decision(objects=[ahead, there])))
    system.step(observed(4))
    first, second = system.obstacles
    ego = observed(4).ego
    assert first.track == 7
    assert first.x_m == pytest.approx(ego.x_m + 10.0 * math.cos(0.02) - 2.0 * math.sin(0.02))
    assert first.y_m == pytest.approx(ego.y_m + 10.0 * math.sin(0.02) + 2.0 * math.cos(0.02))
    assert second is there


def test_property_with_objects_is_read_in_recorded_drives_alone() -> None:
    class Believes(Fixed):
        reads = 0

        @property
        def believed_objects(self) -> Any:
            type(self).reads += 1
            return [PerceivedObstacle(8, ObstacleLabel.VEHICLE, 50.0, 1.0, 3.0, 0.0, 4.5, 1.8)]

    simulator, spec = BrinkDrive(), replace(with_system(SPEC, Believes), duration_s=1.0)
    plain = simulator.run(spec)
    assert Believes.reads == 0
    recorded = simulator.run(spec, record=True)
    assert recorded.trace is not None
    assert Trace.from_bytes(recorded.trace).perceived.rows[:, 2].tolist() == [50.0] * Believes.reads
    assert recorded.verdicts == plain.verdicts
    Believes.believed_objects = {}  # type: ignore[method-assign,assignment]
    with pytest.raises(DrivingSystemFailed, match=r"objects: a list or tuple of at most 1000; got \{\}"):
        simulator.run(spec, record=True)


def test_guards_understand_brinks_plan_modes_and_free_words_stay_words() -> None:
    known = drives(answering(Decision(accel_mps2=0.0, steer_rad=0.0, mode="stop")))
    free = drives(answering(Decision(accel_mps2=0.0, steer_rad=0.0, mode="creep to the line")))
    for system in (known, free):
        system.step(observed(0, speed_mps=5.0))
    assert known.plan.mode is PlanMode.STOP
    assert free.plan.mode == "creep to the line"
    assert not any(free.plan.mode is mode for mode in PlanMode)
    assert (free.plan.target_speed_mps, free.plan.target_offset_m) == (5.0, 0.1)


class Tracks(Fixed):
    """Follows the lane by a trajectory that is planned once: at 8 m/s, then it slows down and stops."""

    def __init__(self, start: Start) -> None:
        self.trajectory = tuple(lane_profile(start))

    def step(self, observation: Observation) -> Decision:
        return Decision(trajectory=self.trajectory)


def lane_profile(start: Start) -> Iterator[TrajectoryPoint]:
    """Yield 8 m/s for 8 s, then 2 m/s² of braking, and a stand until 20 s: along the lane, by the rear axle."""
    axle_m, station_m, speed_mps = 0.5 * start.car.wheelbase_m, 10.0, 8.0
    for step in range(201):
        accel_mps2 = -2.0 if step >= 80 and speed_mps > 0.0 else 0.0
        x_m, y_m, yaw_rad = start.route.pose_at(station_m - axle_m)
        centre = x_m + axle_m * math.cos(yaw_rad), y_m + axle_m * math.sin(yaw_rad)
        yield TrajectoryPoint(0.1 * step, *centre, yaw_rad, speed_mps, accel_mps2)
        faster_mps = max(speed_mps + 0.1 * accel_mps2, 0.0)
        station_m += 0.05 * (speed_mps + faster_mps)
        speed_mps = faster_mps


def test_a_trajectory_is_tracked_through_a_bend_and_to_a_stand() -> None:
    system, ego = drives(Tracks), EgoCar(ROUTE.pose_at(10.0, 0.3), 6.0, friction=0.9)
    errors_m: list[float] = []
    station_m = 10.0
    trajectory: Sequence[TrajectoryPoint] = tuple(lane_profile(system._start))
    for step in range(390):
        station_m, offset_m = ROUTE.project(ego.x_m, ego.y_m, station_m)
        state = EgoState(ego.x_m, ego.y_m, ego.yaw_rad, ego.speed_mps, ego.accel_mps2, station_m, offset_m)
        command = system.step(Observation(time_s=0.05 * step, ego=state, boxes=None, light=None))
        if step % 2 == 0:
            meant = trajectory[step // 2]
            errors_m.append(math.hypot(meant.x_m - ego.x_m, meant.y_m - ego.y_m))
        ego.drive(command.accel_mps2, command.steer_rad, 5)
    assert max(errors_m[60:]) < 0.6  # along the way, most of it while it begins to brake
    assert errors_m[-1] < 0.3
    assert ego.speed_mps < 0.05
    assert all(new.time_s > old.time_s for old, new in pairwise(trajectory))


def test_trajectory_that_ends_in_a_bend_is_steered_along_the_bend() -> None:
    radius_m, car = 12.0, drives(Tracks)._start.car
    axle_m = 0.5 * car.wheelbase_m

    def centre(ahead_m: float) -> tuple[float, float, float]:
        yaw = ahead_m / radius_m
        return (
            radius_m * math.sin(yaw) + axle_m * math.cos(yaw),
            radius_m * (1.0 - math.cos(yaw)) + axle_m * math.sin(yaw),
            yaw,
        )

    stop = [TrajectoryPoint(0.5 * step, *centre(min(0.5 * step, 1.5)), 1.0, 0.0) for step in range(8)]
    ego = EgoState(*centre(0.0), 1.0, 0.0, 0.0, 0.0)
    _, steer_rad = tracking_command(stop, 0.0, ego, car)
    assert steer_rad == pytest.approx(math.atan(car.wheelbase_m / radius_m), rel=0.02)


def test_episodes_of_brinks_own_system_are_the_ones_that_they_were() -> None:
    for make in (UrbanInjectedParams, NpcActionsParams):
        assert (make().driving, make().driving_settings) == ("modular@1", {})
    problem, traffic = UrbanInjected(UrbanInjectedParams()), NpcActions(NpcActionsParams())
    rng = np.random.default_rng(1)
    for one in (problem, traffic):
        spec = one.episode(tuple(part.sample(rng) for part in one.space.components), 5)
        assert "driving" not in spec.options


def test_an_encounter_is_driven_by_the_system_and_compared_with_reference_drivers() -> None:
    class Straight(Fixed):
        decision = Decision(accel_mps2=1.0, steer_rad=0.3)

    catalogue.register(DRIVING_SYSTEMS, "tested@1", Straight)
    traffic = NpcActions(NpcActionsParams(driving="tested@1", duration_s=6.0))
    assert traffic.wrong_inputs() == []
    vectors = tuple(part.sample(np.random.default_rng(1)) for part in traffic.space.components)
    result = BrinkEncounter().run(traffic.episode(vectors, 5))
    assert result.verdicts["lane-keeping@1"].violated
    assert result.provenance["driving"] == "tested@1"
    reference = result.features["reference"]
    assert isinstance(reference, dict)
    assert "lane-keeping@1" not in reference["careful"]["violated_at_s"]  # type: ignore[operator,index,call-overload]

"""The options of urban drives: perception latency, the camera's pitch, the least visible share."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from brink.guard.recorder import observe_drive
from brink.sim.bullet.engine import process_engine
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import (
    CONTROL_STEP_S,
    LATENCY_S,
    PERCEPTION_STEP_S,
    Box,
    Command,
    Observation,
    ObstacleLabel,
    PerceivedObstacle,
    PlanMode,
    PlanState,
)
from brink.sim.episode import EpisodeSpec, Json, JsonObject
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import FloatArray, Trace
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour
from brink.sim.urban.episode_loop import Detects, run_loop
from brink.sim.urban.options import DriveOptions
from brink.sim.urban.simulator import BrinkDrive
from brink.sim.world.ego import EGO_CAR
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.world import UrbanWorld, make_world

CAMERA = Camera()
SCENARIO: JsonObject = {
    "time_of_day": "noon",
    "weather": "clear",
    "pedestrians": 0,
    "road_curve": "straight",
    "road_id": 0,
    "road_length": 1,
    "driving_task": "follow_road",
}
BLIND = EpisodeSpec(
    simulator="brink-drive@3",
    scenario=SCENARIO,
    behaviour={"mode": "injected", "trajectories": []},
    requirements=("front-gap@1",),
    seed=4,
    duration_s=8.0,
)
APPEARS_STEP = 20
GHOST: JsonObject = {
    "label": "vehicle",
    "t0_step": float(APPEARS_STEP),
    "t1_step": 60.0,
    **{
        f"{side}_{end}_px": pixels
        for end in (0, 1)
        for side, pixels in (("x_min", 350.0), ("x_max", 450.0), ("y_min", 280.0), ("y_max", 360.0))
    },
}


PLAN = PlanState(mode=PlanMode.CRUISE, target_speed_mps=0.0, target_offset_m=0.0)


def with_options(spec: EpisodeSpec, **options: Json) -> EpisodeSpec:
    return replace(spec, options={**options})


@dataclass
class Probe:
    """A driving system that holds its speed until it receives a box, and then brakes with `brakes_mps2`."""

    brakes_mps2: float = 0.0
    received: list[Observation] = field(default_factory=list)
    obstacles: tuple[PerceivedObstacle, ...] = ()
    plan: PlanState = PLAN
    _brakes: bool = False

    def step(self, observation: Observation) -> Command:
        self.received.append(observation)
        self._brakes = self._brakes or bool(observation.boxes)
        speed_mps = observation.ego.speed_mps
        holds_mps2 = EGO_CAR.rolling_mps2 + EGO_CAR.drag_1pm * speed_mps * speed_mps
        return Command(accel_mps2=-self.brakes_mps2 if self._brakes else holds_mps2, steer_rad=0.0)


def empty_road() -> UrbanWorld:
    """Return a world in which the ego is alone."""
    process_engine().reset()
    world = make_world(UrbanScenario.from_json(SCENARIO), 4)
    return replace(world, vehicles=(), movers=(world.ego,))


def drive_with(
    probe: Probe,
    detects: Detects,
    *,
    latency_s: float,
    duration_s: float = 3.0,
    world: UrbanWorld | None = None,
) -> None:
    """Drive on an empty road with a detector."""
    run_loop(
        empty_road() if world is None else world,
        probe,
        DetectorBehaviour(mode=BehaviourMode.ORACLE),
        {},
        engine=process_engine(),
        camera=CAMERA,
        seed=4,
        duration_s=duration_s,
        recorder=None,
        detects=detects,
        latency_s=latency_s,
        to_the_end=True,
    )


def stamped(time_s: float) -> tuple[Box, ...]:
    """Return a box that tells the time of its image."""
    return (Box(ObstacleLabel.VEHICLE, time_s, 450.0, 280.0, 360.0),)


@pytest.mark.parametrize(
    ("latency_s", "steps"), [(0.0, 0), (0.05, 1), (LATENCY_S, 2), (0.24, 5), (0.35, 7), (1.0, 20)]
)
def test_boxes_arrive_after_the_latency_in_order_and_none_is_lost(latency_s: float, steps: int) -> None:
    probe = Probe()
    drive_with(probe, stamped, latency_s=latency_s)
    arrivals = [(number, one) for number, one in enumerate(probe.received) if one.boxes is not None]
    assert [number for number, _ in arrivals] == list(range(steps, len(probe.received), 2))
    for image, (number, one) in enumerate(arrivals):
        assert one.boxes is not None
        assert one.boxes[0].x_min_px == one.seen_s == pytest.approx(image * PERCEPTION_STEP_S)
        assert number * CONTROL_STEP_S - one.seen_s == pytest.approx(steps * CONTROL_STEP_S)
    assert all(one.seen_s is None for one in probe.received if one.boxes is None)


def first_reaction_s(latency_s: float) -> float:
    """Return when the driving system first commands something else because of a ghost."""
    ghost = replace(BLIND, behaviour={"mode": "injected", "trajectories": [GHOST]})
    haunted, alone = (
        observe_drive(with_options(spec, latency_s=latency_s)).moments for spec in (ghost, BLIND)
    )
    return next(
        one.observation.time_s
        for one, other in zip(haunted, alone, strict=False)
        if one.command != other.command
    )


@pytest.mark.parametrize("latency_s", [0.05, LATENCY_S, 0.3, 0.6])
def test_the_car_reacts_to_what_appears_no_earlier_than_after_the_latency(latency_s: float) -> None:
    at_once_s = first_reaction_s(0.0)
    assert APPEARS_STEP * PERCEPTION_STEP_S <= at_once_s < (APPEARS_STEP + 3) * PERCEPTION_STEP_S
    assert first_reaction_s(latency_s) == pytest.approx(at_once_s + latency_s)


@pytest.mark.parametrize("latency_s", [0.0, LATENCY_S, 0.5])
@pytest.mark.parametrize("braking_mps2", [3.0, 6.0])
def test_the_stopping_distance_is_that_of_latency_delay_build_up_and_braking(
    latency_s: float, braking_mps2: float
) -> None:
    world = empty_road()
    ego = world.ego
    images: list[tuple[float, float]] = []

    def detects(time_s: float) -> tuple[Box, ...]:
        if time_s < 1.0 - 1e-6:
            return ()
        images.append((ego.x_m, ego.speed_mps))
        return stamped(time_s)

    drive_with(Probe(brakes_mps2=braking_mps2), detects, latency_s=latency_s, duration_s=8.0, world=world)
    assert ego.speed_mps == 0.0
    x_m, speed_mps = images[0]
    # The rate limits the braking until it is within rate times lag of what is wanted; then the lag does.
    rest_mps2 = min(EGO_CAR.brake_rate_mps3 * EGO_CAR.brake_lag_s, braking_mps2)
    ramp_s = (braking_mps2 - rest_mps2) / EGO_CAR.brake_rate_mps3
    lost_s = (
        ramp_s * (1.0 - 0.5 * (braking_mps2 - rest_mps2) / braking_mps2)
        + rest_mps2 / braking_mps2 * EGO_CAR.brake_lag_s
    )
    total_mps2 = braking_mps2 + EGO_CAR.rolling_mps2
    expected_m = speed_mps * (latency_s + EGO_CAR.delay_s + lost_s) + speed_mps**2 / (2.0 * total_mps2)
    assert ego.x_m - x_m == pytest.approx(expected_m, rel=0.02)


def boxes_of(trace: Trace, step: int) -> FloatArray:
    return trace.seen_boxes.at(step)


def test_without_pitch_the_camera_stays_level_and_with_it_boxes_are_tilted() -> None:
    pitching, level = (
        Trace.from_bytes(BrinkDrive().run(with_options(BLIND, pitch=pitch), record=True).trace or b"")
        for pitch in (True, False)
    )
    # Whoever does not look is not misled: both cars drive the same way.
    assert np.array_equal(pitching.ego, level.ego)
    assert pitching.pitch_rad is not None
    assert level.pitch_rad is not None
    assert not level.pitch_rad.any()
    assert np.abs(pitching.pitch_rad).max() > math.radians(0.2)
    shifts = []
    for step in range(len(level.time_s) - 1):
        pitch_rad = float(pitching.pitch_rad[step])
        boxes = [Box(ObstacleLabel.VEHICLE, *row[1:]) for row in boxes_of(level, step).tolist()]
        tilted = np.array([box[1:] for box in CAMERA.all_tilted(boxes, pitch_rad)], np.float64)
        seen = boxes_of(pitching, step)[:, 1:]
        assert seen.shape == tilted.reshape(-1, 4).shape
        assert seen == pytest.approx(tilted.reshape(-1, 4), abs=0.02)
        shifts += [abs(float(row[3]) - box.y_max_px) for row, box in zip(seen, boxes, strict=True)]
    assert max(shifts) > 1.0


def test_more_road_users_are_seen_if_a_smaller_share_suffices() -> None:
    crowded = replace(BLIND, scenario={**SCENARIO, "pedestrians": 18, "road_curve": "crossroad"})
    counts = []
    for least in (0.0, 0.25, 1.0):
        result = BrinkDrive().run(with_options(crowded, least_visible=least), record=True)
        trace = Trace.from_bytes(result.trace or b"")
        counts.append(len(trace.seen_boxes.rows))
    assert counts[0] > counts[1] > counts[2] > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"latency": 0.1}, r"options: unknown field 'latency'.*latency_s"),
        ({"latency_s": -0.1}, r"options\.latency_s: expected a number in \[0, 1\]"),
        ({"latency_s": 1.5}, r"options\.latency_s: expected a number in \[0, 1\]"),
        ({"pitch": 1}, r"options\.pitch: expected true or false, got 1"),
        ({"least_visible": 2.0}, r"options\.least_visible: expected a number in \[0, 1\]"),
        ({"fidelity": "train"}, r"options\.fidelity: expected one of bicycle, wheels; got 'train'"),
    ],
)
def test_an_invalid_option_is_refused(options: JsonObject, message: str) -> None:
    with pytest.raises(InvalidEpisode, match=message):
        BrinkDrive().run(with_options(BLIND, **options))


def test_options_survive_a_round_trip_and_have_the_defaults_of_the_world() -> None:
    given = DriveOptions(fidelity="wheels", latency_s=0.3, pitch=False, least_visible=0.5)
    assert DriveOptions.from_json(given.to_json()) == given
    assert DriveOptions.from_json({}) == DriveOptions(latency_s=0.1, pitch=True, least_visible=0.25)

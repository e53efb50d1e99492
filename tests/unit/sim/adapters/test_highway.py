"""The simulator of highway-env: perception errors change what the ego perceives, and never the world."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.marks import mostly_long

from brink.pictures.frame import FramePainter
from brink.pictures.story import scenario_words
from brink.sim.adapters.highway.perception import NearbyVehicle, Perception
from brink.sim.adapters.highway.simulator import HighwayEnvSimulator
from brink.sim.adapters.highway.specification import (
    MAGNITUDES,
    RANGE_M,
    STEPS_PER_S,
    ErrorType,
    Goal,
    HighwayScenario,
    PerceptionError,
    RoadKind,
    Target,
    errors_from_json,
    words_of_errors,
)
from brink.sim.adapters.recording import Perceived, Pose
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import Trace

SCENARIO: dict[str, Json] = {
    "road": "highway",
    "goal": "straight",
    "lanes": 3,
    "density": 1.5,
    "traffic_speed": 0.6,
    "ego_speed": 0.9,
    "target_speed": 1.1,
}
EGO = Pose(x_m=10.0, y_m=0.0, yaw_rad=0.0, speed_mps=20.0)


def spec(*errors: dict[str, Json], seed: int = 3, duration_s: float = 8.0, **scenario: Json) -> EpisodeSpec:
    return EpisodeSpec(
        simulator="highway-env@1",
        scenario={**SCENARIO, **scenario},
        behaviour={"mode": "errors", "errors": list(errors)},
        requirements=("no-collision@1", "front-gap@1"),
        seed=seed,
        duration_s=duration_s,
    )


def miss(target: str = "all", onset_s: float = 1.0, magnitude: float = 5.0) -> dict[str, Json]:
    return {"type": "miss", "target": target, "magnitude": magnitude, "onset_s": onset_s}


@pytest.fixture(scope="module")
def simulator() -> HighwayEnvSimulator:
    return HighwayEnvSimulator()


@pytest.fixture(scope="module")
def truth(simulator: HighwayEnvSimulator) -> EpisodeResult:
    """A recorded episode without errors."""
    return simulator.run(spec(), record=True)


def trace_of(simulator: HighwayEnvSimulator, wanted: EpisodeSpec) -> Trace:
    document = simulator.run(wanted, record=True).trace
    assert document is not None
    return Trace.from_bytes(document)


@pytest.mark.parametrize(("road", "goal"), list(itertools.product(RoadKind, Goal)))
def test_every_scenario_runs_and_its_replay_can_be_drawn(
    simulator: HighwayEnvSimulator, road: RoadKind, goal: Goal
) -> None:
    wanted = spec(road=road.value, goal=goal.value, duration_s=3.0)
    result = simulator.run(wanted, record=True)
    assert result.features["error_steps"] == []
    assert float(result.features["way_m"]) > 5.0  # type: ignore[arg-type]
    assert result.trace is not None
    trace = Trace.from_bytes(result.trace)
    assert len(trace.actors) > 0
    assert {surface.kind for surface in trace.scene} >= {"road", "marking"}
    # The ego begins on its route, and the route goes its way.
    assert float(np.hypot(*(trace.route[0] - trace.ego[0, :2]))) < 0.1
    step = trace.route[1] - trace.route[0]
    assert math.cos(math.atan2(step[1], step[0]) - trace.ego[0, 2]) > 0.99
    assert scenario_words(trace) == f"{HighwayScenario.from_json(wanted.scenario).words}; no error"
    FramePainter(trace, size=(640, 360)).frame(len(trace.time_s) // 2)


def test_the_ego_follows_its_route(simulator: HighwayEnvSimulator) -> None:
    for goal, turn in (("left", math.pi / 2), ("straight", 0.0), ("right", -math.pi / 2)):
        trace = trace_of(
            simulator, spec(road="intersection", goal=goal, density=0.5, duration_s=20.0, seed=2)
        )
        turned = float(trace.ego[-1, 2] - trace.ego[0, 2])
        assert math.cos(turned - turn) > 0.95, goal


@pytest.mark.parametrize("seeds", mostly_long([range(1), range(1, 3)], [range(1)], "more drives of the same"))
def test_with_a_perfect_perception_the_ego_rarely_violates_anything(
    simulator: HighwayEnvSimulator, seeds: range
) -> None:
    unsafe = 0
    for road, seed in itertools.product(RoadKind, seeds):
        result = simulator.run(spec(road=road.value, seed=seed, duration_s=10.0))
        unsafe += any(verdict.violated for verdict in result.verdicts.values())
    assert unsafe == 0


def test_an_ego_that_perceives_nobody_hits_somebody(simulator: HighwayEnvSimulator) -> None:
    result = simulator.run(spec(miss(onset_s=0.0, magnitude=12.0), duration_s=12.0, lanes=2), record=True)
    verdict = result.verdicts["no-collision@1"]
    assert result.features["ended"] == "collision"
    assert verdict.violated_at_s == result.features["ended_at_s"]
    assert verdict.robustness < -0.05
    assert result.features["no-collision@1:collision_kind"] == "vehicle"
    assert result.trace is not None
    trace = Trace.from_bytes(result.trace)
    hit = next(event for event in trace.events if event.kind == "collision")
    assert str(result.features["collided_with"]) in hit.text
    error = next(event for event in trace.events if event.kind == "error")
    assert error.text == "no vehicle is perceived for 12.0 s from 0.0 s on"
    assert error.time_s == 0.0


def test_without_errors_the_ego_perceives_the_truth(simulator: HighwayEnvSimulator) -> None:
    trace = trace_of(simulator, spec(density=2.0))
    for sample in range(len(trace.time_s)):
        poses = np.array([actor.motion[sample] for actor in trace.actors])
        near = np.hypot(*(poses[:, :2] - trace.ego[sample, :2]).T) <= RANGE_M
        perceived = trace.perceived.at(sample)
        assert sorted(map(tuple, perceived[:, 2:4].tolist())) == sorted(map(tuple, poses[near, :2].tolist()))
    assert len(trace.seen_boxes.rows) > 0
    assert np.array_equal(trace.seen_boxes.rows, trace.given_boxes.rows)


def test_an_error_changes_the_perception_and_not_the_world(simulator: HighwayEnvSimulator) -> None:
    onset_s = 2.0
    truth = trace_of(simulator, spec())
    missed = trace_of(simulator, spec(miss("ahead", onset_s, 1.5)))
    opens = round(onset_s * STEPS_PER_S)
    for sample in range(opens):
        assert np.array_equal(truth.perceived.at(sample), missed.perceived.at(sample))
    assert len(missed.perceived.at(opens)) == len(truth.perceived.at(opens)) - 1
    # Until the ego reacts, the others are where they are without the error.
    for one, other in zip(truth.actors, missed.actors, strict=True):
        assert np.array_equal(one.motion[: opens + 1], other.motion[: opens + 1])
    # One vehicle is missing, and the boxes of the camera say so.
    assert len(missed.given_boxes.at(opens)) == len(missed.seen_boxes.at(opens)) - 1
    assert np.array_equal(truth.seen_boxes.at(opens), missed.seen_boxes.at(opens))


def test_an_error_that_the_ego_never_meets_changes_nothing(
    simulator: HighwayEnvSimulator, truth: EpisodeResult
) -> None:
    far: dict[str, Json] = {"type": "short_range", "target": "all", "magnitude": RANGE_M}
    for error in (far, miss("crossing"), miss(magnitude=0.0)):
        result = simulator.run(spec(error))
        assert result.verdicts == truth.verdicts
        assert (result.features["error_steps"], result.features["severity"]) == ([None], 0.0)


def test_the_world_of_an_episode_does_not_depend_on_other_roads(
    simulator: HighwayEnvSimulator, truth: EpisodeResult
) -> None:
    # highway-env's intersection changes parameters of its vehicle models for the whole process.
    simulator.run(spec(road="intersection", duration_s=2.0))
    assert simulator.run(spec(), record=True).trace == truth.trace


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"scenario": {**SCENARIO, "road": "motorway"}}, "scenario.road: expected one of highway, merge"),
        ({"scenario": {**SCENARIO, "lanes": 2.5}}, "scenario.lanes: expected an integer in \\[2, 4\\]"),
        ({"scenario": {**SCENARIO, "density": 9.0}}, "scenario.density: expected a number in \\[0.5, 2.5\\]"),
        ({"scenario": {**SCENARIO, "fog": 1}}, "scenario: unknown field 'fog'"),
        ({"behaviour": {"mode": "oracle", "errors": []}}, "behaviour.mode: expected errors, got 'oracle'"),
        ({"behaviour": {"mode": "errors", "errors": [{}] * 9}}, "a list of at most 8"),
        ({"behaviour": {"mode": "errors", "errors": [{"type": "mis"}]}}, "did you mean 'miss'"),
        (
            {"behaviour": {"mode": "errors", "errors": [{**miss(), "duration_s": 1}]}},
            "unknown field 'duration_s'",
        ),
        ({"behaviour": {"mode": "errors", "errors": [miss(onset_s=99.0)]}}, r"onset_s: expected .* in .0, 8"),
        ({"behaviour": {"mode": "errors", "errors": [miss(target="lead")]}}, "target: expected one of ahead"),
        ({"options": {"fidelity": "wheels"}}, "options: expected none, got 'fidelity'"),
        ({"duration_s": 1e3}, "duration_s: expected at most 120 seconds"),
        ({"simulator": "highway-env@2"}, "simulator: expected highway-env@1"),
        ({"requirements": ("gap@1",)}, "requirements: unknown id 'gap@1'"),
    ],
)
def test_invalid_specs_are_refused(
    simulator: HighwayEnvSimulator, changes: dict[str, Any], expected: str
) -> None:
    with pytest.raises(InvalidEpisode, match=expected):
        simulator.run(replace(spec(), **changes))


def body(
    number: int, x_m: float, y_m: float = 0.0, *, yaw_rad: float = 0.0, speed_mps: float = 20.0
) -> NearbyVehicle:
    """Return a vehicle on a straight road with lanes 4 m wide; the ego is in the middle one."""
    lane = -round(y_m / 4.0)
    return NearbyVehicle(
        number=number,
        pose=Pose(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, speed_mps=speed_mps),
        along_m=x_m - EGO.x_m,
        lane=lane if abs(lane) <= 1 else None,
    )


AHEAD, FARTHER, LEFT, RIGHT = body(1, 40.0), body(2, 70.0), body(3, 30.0, 4.0), body(4, 5.0, -4.0)
CROSSING = body(5, 50.0, 8.0, yaw_rad=-math.pi / 2)
BEHIND, AWAY = body(6, -20.0), body(7, 150.0)
EVERYBODY = (AHEAD, FARTHER, LEFT, RIGHT, CROSSING, BEHIND, AWAY)
IN_RANGE = {1, 2, 3, 4, 5, 6}


def perceived(error: PerceptionError, seconds: float = 3.0, seed: int = 1) -> list[list[Perceived]]:
    """Return what is perceived at each step while nobody moves."""
    perception = Perception([error], seed)
    return [
        perception.perceive(step, step / STEPS_PER_S, EGO, EVERYBODY)
        for step in range(round(seconds * STEPS_PER_S))
    ]


@pytest.mark.parametrize(
    ("target", "hidden"),
    [
        (Target.AHEAD, {1}),
        (Target.LEFT, {3}),
        (Target.RIGHT, {4}),
        (Target.CROSSING, {5}),
        (Target.ALL, IN_RANGE),
    ],
)
def test_a_miss_hides_its_target_in_its_window(target: Target, hidden: set[int]) -> None:
    error = PerceptionError(type=ErrorType.MISS, target=target, magnitude=1.0, onset_s=1.0, duration_s=1.0)
    steps = [{one.track for one in step} for step in perceived(error)]
    assert steps[:10] == [IN_RANGE] * 10
    assert steps[10:20] == [IN_RANGE - hidden] * 10
    assert steps[20:] == [IN_RANGE] * 10


def test_a_window_waits_for_a_target() -> None:
    error = PerceptionError(
        type=ErrorType.MISS, target=Target.AHEAD, magnitude=1.0, onset_s=0.0, duration_s=1.0
    )
    perception = Perception([error], 1)
    found = [
        bool(perception.perceive(step, step / STEPS_PER_S, EGO, [AHEAD] if step >= 15 else []))
        for step in range(40)
    ]
    assert found == [False] * 25 + [True] * 15
    assert perception.steps == [(15, 24)]


def test_a_vehicle_is_first_perceived_late_unless_it_was_known_from_the_start() -> None:
    error = PerceptionError(type=ErrorType.LATE, target=Target.ALL, magnitude=1.0)
    perception = Perception([error], 1)
    found = [
        {one.track for one in perception.perceive(step, step / STEPS_PER_S, EGO, [AHEAD, *new])}
        for step, new in enumerate([[], *([FARTHER] for _ in range(14))])
    ]
    assert found == [{1}] * 11 + [{1, 2}] * 4
    assert perception.steps == [(1, 10)]


def test_a_short_range_hides_distant_targets() -> None:
    error = PerceptionError(type=ErrorType.SHORT_RANGE, target=Target.AHEAD, magnitude=35.0)
    assert {one.track for one in perceived(error)[0]} == IN_RANGE - {2}


def test_a_target_is_perceived_too_far_away_and_too_fast() -> None:
    far = PerceptionError(type=ErrorType.TOO_FAR, target=Target.AHEAD, magnitude=0.5, duration_s=9.0)
    assert [one.pose.x_m for one in perceived(far)[0] if one.track == 1] == [55.0]
    fast = PerceptionError(type=ErrorType.TOO_FAST, target=Target.AHEAD, magnitude=5.0, duration_s=9.0)
    assert [one.pose.speed_mps for one in perceived(fast)[0] if one.track in (1, 2)] == [25.0, 20.0]


def test_noise_has_its_standard_deviation_and_comes_from_the_seed_of_its_vehicle() -> None:
    noise = PerceptionError(type=ErrorType.POSITION_NOISE, target=Target.ALL, magnitude=2.0, duration_s=99.0)
    steps = perceived(noise, seconds=60.0)
    shifts = np.array([one.pose.x_m - AHEAD.pose.x_m for step in steps for one in step if one.track == 1])
    assert 1.7 < shifts.std() < 2.3
    assert abs(shifts.mean()) < 0.4
    alone = Perception([noise], 1).perceive(0, 0.0, EGO, [AHEAD])
    assert alone[0] == next(one for one in steps[0] if one.track == 1)
    assert perceived(noise, seed=2)[0] != steps[0]


def test_a_ghost_appears_where_and_when_it_should() -> None:
    ghost = PerceptionError(
        type=ErrorType.GHOST, target=Target.LEFT, magnitude=1.0, onset_s=0.5, duration_s=1.0, distance_m=25.0
    )
    steps = [[one for one in step if one.track not in IN_RANGE] for step in perceived(ghost)]
    assert [len(step) for step in steps] == [0] * 5 + [1] * 10 + [0] * 15
    pose = steps[5][0].pose
    assert (pose.x_m, pose.y_m, pose.speed_mps) == (35.0, 4.0, 0.0)


@pytest.mark.parametrize("kind", ErrorType)
def test_an_error_survives_json_and_has_words(kind: ErrorType) -> None:
    scale = MAGNITUDES[kind]
    document: dict[str, Json] = {"type": kind.value, "target": "left", "magnitude": scale.at(0.25)}
    document |= {"onset_s": 1.5} if scale.has_window else {}
    document |= {"duration_s": 2.0} if scale.has_duration else {}
    document |= {"distance_m": 30.0} if kind is ErrorType.GHOST else {}
    errors = errors_from_json({"mode": "errors", "errors": [document]}, 20.0)
    assert errors[0].to_json() == document
    assert errors[0].severity == pytest.approx(0.25)
    words = words_of_errors(errors)
    assert scale.words(scale.at(0.25)) in words
    assert "lane to the left" in words

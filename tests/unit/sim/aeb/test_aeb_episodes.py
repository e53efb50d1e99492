"""Emergency-braking episodes: safe baseline, hazards, reproducibility, invalid input."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from aeb_episodes import spec
from support.marks import mostly_long

from brink.sim.aeb.braking import CRUISE_MPS, LEAST_FRICTION
from brink.sim.aeb.simulator import BrinkAeb
from brink.sim.aeb.specification import ARRIVAL_S, TIMES, WEATHERS, AebScenario
from brink.sim.aeb.street import LANE_Y_M, make_street_world
from brink.sim.catalogue import make_simulator
from brink.sim.driving.interface import LATENCY_S
from brink.sim.episode import EpisodeResult, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import Trace
from brink.sim.world.weather import conditions

FEW, MORE = range(3), range(3, 20)
SEEDS = mostly_long([FEW, MORE], [FEW], "drives many episodes")
SIMULATOR = BrinkAeb()


def stops(result: EpisodeResult) -> Json:
    return result.features["no-dangerous-stop@1:dangerous_stops"]


@pytest.mark.parametrize(
    ("latency_s", "seeds"),
    mostly_long(
        [
            (LATENCY_S, range(20)),
            (LATENCY_S, range(20, 200)),
            (0.05, range(200, 250)),
            (0.0, range(250, 300)),
        ],
        [(LATENCY_S, range(20))],
        "drives hundreds of episodes",
    ),
)
def test_with_ground_truth_there_is_no_collision_and_no_dangerous_stop(
    latency_s: float, seeds: range
) -> None:
    for seed in seeds:
        result = SIMULATOR.run(spec(seed, latency_s=latency_s))
        assert result.features["collision"] is None, seed
        assert stops(result) == 0, seed
        assert result.features["ended"] == "goal"
        braked_s, stopped_s = result.features["braked_at_s"], result.features["stopped_at_s"]
        assert isinstance(braked_s, float)
        assert isinstance(stopped_s, float)
        assert braked_s < stopped_s
        assert all(not verdict.violated for verdict in result.verdicts.values())


@pytest.mark.parametrize("occluder", mostly_long(["van", "car"], ["van"], "drives more episodes"))
def test_the_latest_pedestrian_on_the_most_slippery_road_is_avoided_in_any_phase_of_the_images(
    occluder: str,
) -> None:
    base = spec(1)
    for phase in range(8):
        changes: dict[str, Json] = {
            "weather": "soft_rain",
            "occluder": occluder,
            "arrival_s": ARRIVAL_S[1],
            "crossing_m": 50.0 + 0.05 * phase,
        }
        result = SIMULATOR.run(replace(base, scenario={**base.scenario, **changes}))
        assert result.features["collision"] is None, phase


def test_the_brake_is_designed_for_the_most_slippery_road_of_the_scenarios() -> None:
    assert min(conditions(time, weather).friction for time in TIMES for weather in WEATHERS) == LEAST_FRICTION


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize(
    "off", mostly_long([{"mode": "blind"}, {"braking": False}], [{"mode": "blind"}], "drives many episodes")
)
def test_without_braking_the_pedestrian_is_always_hit(off: dict[str, Any], seeds: range) -> None:
    for seed in seeds:
        result = SIMULATOR.run(spec(seed, **off))
        assert result.features["collided_with"] == "pedestrian", seed
        assert result.verdicts["no-collision@1"].violated
        assert result.features["impact_speed_mps"] == pytest.approx((CRUISE_MPS**2 + 2.0**2) ** 0.5, rel=0.03)


@pytest.mark.parametrize("obstacle", mostly_long(["novelty", "anomaly"], ["anomaly"], "drives many episodes"))
@pytest.mark.parametrize("seeds", mostly_long([range(2), range(2, 5)], [range(2)], "drives many episodes"))
def test_an_unusual_body_is_hit_if_it_is_not_seen(obstacle: str, seeds: range) -> None:
    for seed in seeds:
        assert (
            SIMULATOR.run(spec(seed, mode="blind", obstacle=obstacle)).features["collided_with"] == obstacle
        )
        assert SIMULATOR.run(spec(seed, obstacle=obstacle)).features["collision"] is None


def ghost(from_step: int, to_step: int, x_px: float = 400.0) -> dict[str, Json]:
    """Return the injected box of a person who does not exist, in perception steps of 0.1 s."""
    box: dict[str, Json] = {"label": "person", "t0_step": from_step, "t1_step": to_step}
    for end in "01":
        box |= {f"x_min_{end}_px": x_px - 40.0, f"x_max_{end}_px": x_px + 40.0}
        box |= {f"y_min_{end}_px": 300.0, f"y_max_{end}_px": 480.0}
    return box


def haunted(*ghosts: dict[str, Json], duration_s: float = 15.0, **options: Any) -> EpisodeResult:
    """Return an episode in which the brake receives nothing but ghosts; the pedestrian is 65 m ahead."""
    base = spec(3, **options)
    scenario: dict[str, Json] = {**base.scenario, "weather": "clear", "crossing_m": 65.0, "arrival_s": 0.0}
    behaviour: dict[str, Json] = {"mode": "injected", "trajectories": list(ghosts)}
    return SIMULATOR.run(replace(base, scenario=scenario, behaviour=behaviour, duration_s=duration_s))


def test_a_stop_for_a_ghost_is_dangerous() -> None:
    result = haunted(ghost(10, 25), duration_s=5.0)
    assert stops(result) == 1
    assert result.verdicts["no-dangerous-stop@1"].violated


def test_a_ghost_that_vanishes_before_the_car_stops_is_not_dangerous() -> None:
    result = haunted(ghost(10, 11), duration_s=5.0)
    assert stops(result) == 0
    assert not result.verdicts["no-dangerous-stop@1"].violated
    # Confirmed by a second frame, 0.1 s after the image.
    assert result.features["braked_at_s"] == pytest.approx(1.15)


def test_a_stop_for_a_ghost_beside_a_real_pedestrian_is_not_dangerous() -> None:
    result = haunted(ghost(72, 95))
    assert result.features["stopped_at_s"] is not None
    assert stops(result) == 0


def test_detections_arrive_after_the_latency_that_the_options_say() -> None:
    at_s = [
        haunted(ghost(10, 20), duration_s=2.0, latency_s=latency_s).features["braked_at_s"]
        for latency_s in (0.0, 0.3)
    ]
    assert at_s == pytest.approx([1.05, 1.35])


def test_the_camera_pitches_with_the_braking_car_unless_told_otherwise() -> None:
    seen = []
    for pitch in (True, False):
        result = SIMULATOR.run(spec(2, pitch=pitch), record=True)
        assert result.trace is not None
        seen.append(Trace.from_bytes(result.trace).seen_boxes.rows)
    pitched, level = seen
    assert not np.array_equal(pitched, level)


def test_a_person_starts_and_stops_walking_like_one() -> None:
    base = spec(5)
    world = make_street_world(AebScenario.from_json(base.scenario), 5)
    before = {actor.name: actor.speed_mps for actor in world.walkers}
    for step in range(300):
        world.advance(step)
        for actor in world.walkers:
            assert abs(actor.speed_mps - before[actor.name]) <= 2.5 * 0.05 + 1e-9
            before[actor.name] = actor.speed_mps


def test_the_pedestrian_is_in_mid_lane_when_the_scenario_says() -> None:
    scenario = replace(AebScenario.from_json(spec(5).scenario), crossing_m=52.0, arrival_s=-0.1)
    world = make_street_world(scenario, 5)
    steps = round((52.0 / CRUISE_MPS - 0.1) / 0.05)
    for step in range(steps):
        world.advance(step)
    assert world.walkers[0].y_m == pytest.approx(LANE_Y_M, abs=0.12)


def test_a_version_that_is_no_longer_run_says_so() -> None:
    with pytest.raises(InvalidEpisode, match=r"no longer runs brink-aeb@2, it has brink-aeb@3"):
        make_simulator("brink-aeb@2")
    with pytest.raises(InvalidEpisode, match="unknown id 'brink-aeb@9'"):
        make_simulator("brink-aeb@9")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenario": {"weather": "hard_rain"}}, "scenario.weather: expected one of clear, cloudy"),
        ({"scenario": {"crossing_m": 3.0}}, r"scenario.crossing_m: expected a number in \[45, 65\]"),
        ({"scenario": {"ocluder": "car"}}, "unknown field 'ocluder' \\(did you mean 'occluder'"),
        ({"behaviour": {"mode": "oracel"}}, "behaviour.mode: expected one of"),
        ({"behaviour": {"boxes": 1}}, "behaviour: unknown field 'boxes'"),
        ({"options": {"braking": 1}}, "options.braking: expected true or false"),
        ({"options": {"person_frames": 4}}, r"options.person_frames: expected .* in \[1, 3\]"),
        ({"options": {"width_px": 8}}, r"options.width_px: expected a number in \[64, 4096\]"),
        ({"options": {"heigth_px": 360}}, "did you mean 'height_px'"),
        ({"simulator": "brink-drive@3"}, "simulator: expected brink-aeb@3, got"),
        ({"duration_s": 600.0}, "duration_s: expected at most 60"),
    ],
)
def test_an_invalid_specification_is_refused(changes: dict[str, Any], message: str) -> None:
    good = spec(1)
    merged: dict[str, Any] = {
        name: {**getattr(good, name), **value} if isinstance(value, dict) else value
        for name, value in changes.items()
    }
    with pytest.raises(InvalidEpisode, match=message):
        SIMULATOR.run(replace(good, **merged))


def test_the_brake_gets_only_the_injected_boxes() -> None:
    nothing = haunted()
    assert nothing.features["collided_with"] == "pedestrian"
    result, paper = haunted(ghost(10, 30)), haunted(ghost(10, 30), person_frames=1)
    assert (result.features["braked_at_s"], paper.features["braked_at_s"]) == pytest.approx((1.15, 1.1))
    assert haunted(ghost(10, 30, x_px=40.0), duration_s=5.0).features["braked_at_s"] is None
    with pytest.raises(InvalidEpisode, match="t1_step"):
        haunted(ghost(10, 5))

"""Emergency-braking episodes: safe baseline, hazards, reproducibility, invalid input."""

from dataclasses import replace
from typing import Any

import pytest
from aeb_episodes import spec
from support.marks import mostly_long

from brink.sim.aeb.braking import Detection, EmergencyBrake
from brink.sim.aeb.episode import Episode, WorldMonitor
from brink.sim.aeb.sight import FrameObservation, OracleSight
from brink.sim.aeb.simulator import BrinkAeb
from brink.sim.aeb.specification import AebScenario
from brink.sim.aeb.street import CRUISE_MPS, LANE_Y_M, Street, make_street
from brink.sim.bullet.engine import process_engine
from brink.sim.catalogue import make_requirements
from brink.sim.episode import EpisodeResult, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.world.ego import EgoCar

FEW, MORE = range(3), range(3, 20)
SEEDS = mostly_long([FEW, MORE], [FEW], "drives many episodes")
SIMULATOR = BrinkAeb()


def stops(result: EpisodeResult) -> Json:
    return result.features["no-dangerous-stop@1:dangerous_stops"]


@pytest.mark.parametrize("seeds", SEEDS)
def test_with_ground_truth_there_is_no_collision_and_no_dangerous_stop(seeds: range) -> None:
    for seed in seeds:
        result = SIMULATOR.run(spec(seed))
        assert result.features["collision"] is None, seed
        assert stops(result) == 0, seed
        assert result.features["ended"] == "past"
        braked_s, stopped_s = result.features["braked_at_s"], result.features["stopped_at_s"]
        assert isinstance(braked_s, float)
        assert isinstance(stopped_s, float)
        assert braked_s < stopped_s
        assert all(not verdict.violated for verdict in result.verdicts.values())


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


class Ghost:
    """Ground truth plus, for a while, a person who does not exist."""

    def __init__(self, from_s: float, to_s: float) -> None:
        self.truth = OracleSight(640, 360)
        self.span_s = from_s, to_s

    def observe(self, frame: int, time_s: float, street: Street, ego: EgoCar) -> FrameObservation:
        """Observe a frame."""
        truth = self.truth.observe(frame, time_s, street, ego).truth
        ghost = (Detection("person", 300.0, 150.0, 340.0, 300.0),)
        return FrameObservation(truth, truth + (ghost if self.span_s[0] <= time_s < self.span_s[1] else ()))


def played(seed: int, ghost: Ghost) -> tuple[Episode, dict[str, Json]]:
    episode_spec = spec(seed)
    scenario = replace(AebScenario.from_json(episode_spec.scenario), crossing_m=65.0)
    engine = process_engine()
    engine.reset()
    street = make_street(scenario, seed)
    ego = EgoCar((0.0, LANE_Y_M, 0.0), CRUISE_MPS, friction=0.9)
    requirements = make_requirements(episode_spec.requirements)
    episode = Episode(
        street=street,
        ego=ego,
        monitor=WorldMonitor(street, ego, engine),
        sight=ghost,
        brake=EmergencyBrake.for_picture(640, 360),
        requirements=requirements,
        line_m=scenario.crossing_m,
    )
    episode.run(15.0)
    features = {key: value for r in requirements.values() for key, value in r.features().items()}
    features["violated"] = requirements["no-dangerous-stop@1"].verdict().violated
    return episode, features


def test_a_stop_for_a_ghost_is_dangerous() -> None:
    _, features = played(3, Ghost(1.0, 2.5))
    assert (features["dangerous_stops"], features["violated"]) == (1, True)


def test_a_ghost_that_vanishes_before_the_car_stops_is_not_dangerous() -> None:
    episode, features = played(3, Ghost(1.0, 1.1))
    assert (features["dangerous_stops"], features["violated"]) == (0, False)
    assert episode.outcome.braked_at_s == 1.05  # confirmed by a second frame


def test_a_stop_for_a_ghost_beside_a_real_pedestrian_is_not_dangerous() -> None:
    _, features = played(3, Ghost(7.0, 9.5))
    assert features["dangerous_stops"] == 0


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
        ({"simulator": "brink-drive@2"}, "simulator: expected brink-aeb@2, got"),
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
    ghost: dict[str, Json] = {
        "label": "person",
        "t0_step": 10,
        "t1_step": 30,
        "x_min_0_px": 360,
        "x_max_0_px": 440,
        "y_min_0_px": 300,
        "y_max_0_px": 480,
        "x_min_1_px": 360,
        "x_max_1_px": 440,
        "y_min_1_px": 300,
        "y_max_1_px": 480,
    }
    nothing = SIMULATOR.run(replace(spec(2), behaviour={"mode": "injected", "trajectories": []}))
    assert nothing.features["collided_with"] == "pedestrian"
    reported = replace(spec(2), duration_s=5.0, behaviour={"mode": "injected", "trajectories": [ghost]})
    result = SIMULATOR.run(reported)
    assert result.features["braked_at_s"] == pytest.approx(1.05)  # confirmed by a second frame
    paper = SIMULATOR.run(replace(reported, options={"person_frames": 1}))
    assert paper.features["braked_at_s"] == pytest.approx(1.0)
    assert result.verdicts["no-dangerous-stop@1"].violated
    aside = {**ghost, "x_min_0_px": 0, "x_max_0_px": 60, "x_min_1_px": 0, "x_max_1_px": 60}
    reported = replace(reported, behaviour={"mode": "injected", "trajectories": [aside]})
    assert SIMULATOR.run(reported).features["braked_at_s"] is None
    with pytest.raises(InvalidEpisode, match="t1_step"):
        SIMULATOR.run(
            replace(reported, behaviour={"mode": "injected", "trajectories": [{**ghost, "t1_step": 5}]})
        )

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest

from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams
from brink.sim.bullet.engine import process_engine
from brink.sim.catalogue import requirement_ids
from brink.sim.driving.camera import LEAST_VISIBLE
from brink.sim.episode import EpisodeResult, EpisodeSpec, JsonObject
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.trace import Trace
from brink.sim.urban.simulator import BrinkDrive

SCENARIO: JsonObject = {
    "time_of_day": "night",
    "weather": "medium_rain",
    "pedestrians": 18,
    "road_curve": "crossroad",
    "road_id": 1,
    "road_length": 1,
    "driving_task": "second_exit",
}
ORACLE = EpisodeSpec(
    simulator="brink-drive@3",
    scenario=SCENARIO,
    behaviour={"mode": "oracle"},
    requirements=requirement_ids(),
    seed=12,
    duration_s=12.0,
)
BLIND = replace(ORACLE, behaviour={"mode": "injected", "trajectories": []}, duration_s=30.0)


@pytest.fixture(name="simulator", scope="module")
def _simulator() -> BrinkDrive:
    return BrinkDrive()


def fingerprint(result: EpisodeResult) -> str:
    parts = (
        sorted((name, repr(verdict)) for name, verdict in result.verdicts.items()),
        sorted((name, repr(value)) for name, value in result.features.items()),
    )
    return hashlib.sha256(repr(parts).encode() + (result.trace or b"")).hexdigest()


@pytest.fixture(name="printed", scope="module")
def _printed(simulator: BrinkDrive) -> str:
    """The fingerprint of an episode of `ORACLE`."""
    return fingerprint(simulator.run(ORACLE, record=True))


def test_every_requirement_has_a_finite_verdict(simulator: BrinkDrive) -> None:
    result = simulator.run(ORACLE)
    assert tuple(result.verdicts) == ORACLE.requirements
    assert all(np.isfinite(verdict.robustness) for verdict in result.verdicts.values())
    assert set(result.objectives) == {f"{name}:robustness" for name in ORACLE.requirements}
    assert result.trace is None
    assert result.provenance["simulator"] == "brink-drive@3"
    assert result.provenance["instruction_set"]


def test_an_episode_is_bit_identical_regardless_of_earlier_episodes(
    simulator: BrinkDrive, printed: str
) -> None:
    simulator.run(BLIND)
    simulator.run(replace(BLIND, seed=99, scenario={**SCENARIO, "pedestrians": 0}))
    assert fingerprint(simulator.run(ORACLE, record=True)) == printed
    assert fingerprint(BrinkDrive().run(ORACLE, record=True)) == printed


def test_pedestrians_do_not_affect_the_random_draws_of_others(simulator: BrinkDrive) -> None:
    crowd = simulator.run(replace(BLIND, duration_s=1.0), record=True)
    empty = simulator.run(
        replace(BLIND, duration_s=1.0, scenario={**SCENARIO, "pedestrians": 0}), record=True
    )
    assert crowd.trace is not None
    assert empty.trace is not None
    with_people, without = Trace.from_bytes(crowd.trace), Trace.from_bytes(empty.trace)
    assert np.array_equal(with_people.ego, without.ego)
    for one, other in zip(without.actors, with_people.actors, strict=False):
        assert one.name == other.name
        assert np.array_equal(one.motion, other.motion)


def test_a_trace_is_complete_and_consistent_with_the_verdicts(simulator: BrinkDrive) -> None:
    result = simulator.run(ORACLE, record=True)
    assert result.trace is not None
    trace = Trace.from_bytes(result.trace)
    count = len(trace.time_s)
    assert count == 121 or result.features["ended"] != "time"  # 120 perception steps and the end
    assert np.allclose(np.diff(trace.time_s), 0.1, atol=1e-5)
    assert trace.ego.shape == (count, 5)
    assert all(actor.motion.shape == (count, 4) for actor in trace.actors)
    assert sum(actor.kind == "pedestrian" for actor in trace.actors) == 18
    for ragged in (trace.seen_boxes, trace.given_boxes, trace.perceived):
        assert len(ragged.first) == count + 1
    assert np.array_equal(trace.seen_boxes.rows, trace.given_boxes.rows)
    assert trace.pitch_rad is not None
    assert trace.pitch_rad.shape == (count,)
    assert float(trace.pitch_rad.min()) < -0.003
    shares = np.array([actor.visible for actor in trace.actors])
    assert shares.shape == (len(trace.actors), count)
    known = np.isfinite(shares)
    assert ((shares[known] >= 0.0) & (shares[known] <= 1.0)).all()
    # The last sample shows the moment after the last image.
    told = (shares >= LEAST_VISIBLE).sum(axis=0)[:-1]
    assert told.tolist() == np.diff(trace.seen_boxes.first)[:-1].tolist()
    assert set(trace.lights) <= {"green", "amber", "red", ""}
    assert "red" in trace.lights
    for name, verdict in result.verdicts.items():
        series = trace.robustness[name]
        assert series.shape == (count,)
        assert float(series.min()) == pytest.approx(verdict.robustness, abs=1e-4)


def random_spec(seed: int, requirement: str) -> EpisodeSpec:
    problem = UrbanInjected(UrbanInjectedParams(requirement=requirement))
    spec = problem.episode(problem.space.sample(np.random.default_rng(seed)), seed)
    return replace(spec, requirements=(requirement,))


def test_the_last_sample_of_a_collision_shows_the_contact(simulator: BrinkDrive) -> None:
    collisions = 0
    for seed in range(60):
        spec = random_spec(seed, "no-collision@1")
        if simulator.run(spec).features["ended"] != "collision":
            continue
        result = simulator.run(spec, record=True)
        assert result.trace is not None
        trace = Trace.from_bytes(result.trace)
        (hit,) = [event for event in trace.events if event.kind == "collision"]
        assert trace.time_s[-1] == pytest.approx(hit.time_s, abs=1e-4)
        assert np.isfinite(trace.robustness["no-collision@1"]).all()
        named = [actor for actor in trace.actors if f" {actor.name} " in hit.text]
        for actor in named:
            away_m = math.dist(actor.motion[-1][:2], trace.ego[-1][:2])
            assert away_m <= 0.5 * (math.hypot(*trace.ego_size_m) + math.hypot(actor.length_m, actor.width_m))
        collisions += bool(named)
        if collisions == 2:
            return
    pytest.fail("too few collisions with other road users")


def test_injected_boxes_reach_the_driving_system_and_true_boxes_are_recorded(simulator: BrinkDrive) -> None:
    ghost: JsonObject = {"label": "person", "t0_step": 5.0, "t1_step": 40.0}
    for end in (0, 1):
        ghost |= {f"x_min_{end}_px": 380.0, f"x_max_{end}_px": 430.0}
        ghost |= {f"y_min_{end}_px": 250.0, f"y_max_{end}_px": 400.0}
    spec = replace(BLIND, behaviour={"mode": "injected", "trajectories": [ghost]}, duration_s=6.0)
    result = simulator.run(spec, record=True)
    assert result.trace is not None
    trace = Trace.from_bytes(result.trace)
    given = [len(trace.given_boxes.at(sample)) for sample in range(len(trace.time_s))]
    assert given == [int(5 <= step <= 40) for step in range(len(given))]
    assert len(trace.seen_boxes.at(0)) >= 1
    assert trace.ego[25:40, 3].max() < 3.0  # it stops for the ghost of a person


def test_an_ego_without_detections_drives_into_slow_traffic(simulator: BrinkDrive) -> None:
    scenario: JsonObject = {
        **SCENARIO,
        "weather": "hard_rain",
        "road_length": 2,
        "driving_task": "follow_road",
    }
    result = simulator.run(replace(BLIND, scenario=scenario))
    verdict = result.verdicts["front-gap@1"]
    assert verdict.violated
    assert verdict.violated_at_s is not None
    assert result.features["ended"] == "collision"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"options": {"fidelty": "bicycle"}}, "did you mean 'fidelity'"),
        ({"options": {"fidelity": "tricycle"}}, "expected one of bicycle, wheels"),
        ({"requirements": ("front-gap",)}, "did you mean 'front-gap@2'"),
        ({"requirements": ("front-gap@1", "front-gap@1")}, "twice"),
        ({"duration_s": 1e6}, "expected at most"),
        ({"simulator": "other@1"}, "simulator: expected brink-drive@3, got"),
        ({"scenario": {}}, "scenario.time_of_day: missing"),
        ({"behaviour": {"mode": "injected"}}, "behaviour.trajectories: missing"),
    ],
)
def test_invalid_specs_are_rejected(simulator: BrinkDrive, changes: dict[str, object], expected: str) -> None:
    with pytest.raises(InvalidEpisode, match=expected):
        simulator.run(replace(ORACLE, **changes))  # type: ignore[arg-type]


def test_a_broken_engine_is_a_crash_and_does_not_affect_the_next_episode(
    simulator: BrinkDrive, printed: str
) -> None:
    process_engine().close()
    with pytest.raises(SimulationCrashed, match="physics engine"):
        simulator.run(ORACLE)
    assert fingerprint(simulator.run(ORACLE, record=True)) == printed

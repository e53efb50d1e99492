"""The range sensor and the recorder: exact geometry, determinism, and that watching changes nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest

from brink.guard.features import ALL_FEATURES
from brink.guard.recorder import observe_drive, record_drive
from brink.search.streams import Stream, episode_seed, generator
from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams
from brink.sim.driving.interface import CONTROL_STEP_S, LATENCY_S
from brink.sim.episode import EpisodeSpec
from brink.sim.errors import InvalidEpisode
from brink.sim.guard.interface import SECTORS, KnownConditions
from brink.sim.urban.range_sensor import RangeSensor, scan_number, sector_distances
from brink.sim.urban.simulator import BrinkDrive
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.world import make_world


def spec(number: int = 0) -> EpisodeSpec:
    problem = UrbanInjected(UrbanInjectedParams(duration_s=8.0))
    vectors = problem.space.sample(generator(5, Stream.START, number))
    return problem.episode(vectors, episode_seed(5, number))


def rear(ahead_m: float, left_m: float, right_m: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([[ahead_m, left_m]]), np.array([[ahead_m, right_m]])


def test_a_wall_is_nearest_where_each_sector_meets_it() -> None:
    found = sector_distances(*rear(10.0, 20.0, -20.0))
    edge = [10.0 / math.cos(math.radians(angle)) for angle in (12.0, 4.0, 0.0, 4.0, 12.0)]
    assert found == pytest.approx(edge)


def test_what_is_in_one_sector_is_not_in_others() -> None:
    assert sector_distances(*rear(30.0, 0.9, -0.9)) == pytest.approx(
        [math.inf, math.inf, 30.0, math.inf, math.inf]
    )
    assert sector_distances(*rear(10.0, 4.0, 3.0))[0] == pytest.approx(math.hypot(10.0, 3.0))
    assert np.isinf(sector_distances(*rear(-10.0, 5.0, -5.0))).all(), "behind"
    assert np.isinf(sector_distances(np.zeros((0, 2)), np.zeros((0, 2)))).all()


def test_distances_are_those_of_the_nearest_sampled_points() -> None:
    rng = np.random.default_rng(2)
    starts, ends = rng.uniform(-20, 60, (40, 2)), rng.uniform(-20, 60, (40, 2))
    shares = np.linspace(0.0, 1.0, 4001)[:, None, None]
    points = (starts + shares * (ends - starts)).reshape(-1, 2)
    angles, distances = np.degrees(np.arctan2(points[:, 1], points[:, 0])), np.hypot(*points.T)
    found = sector_distances(starts, ends)
    for sector, (left, right) in enumerate([(30, 12), (12, 4), (4, -4), (-4, -12), (-12, -30)]):
        inside = (angles <= left) & (angles >= right)
        assert found[sector] == pytest.approx(distances[inside].min(), abs=0.05)


@pytest.fixture(scope="module")
def sensors() -> list[RangeSensor]:
    scenario = UrbanScenario.from_json(spec().scenario)
    return [
        RangeSensor(make_world(scenario, seed), KnownConditions(rain=rain), seed=seed, perception_steps=2000)
        for seed, rain in ((1, 0.0), (1, 0.0), (2, 0.0), (1, 1.0))
    ]


def test_scans_follow_from_the_seed_and_drop_out_more_often_in_rain(sensors: list[RangeSensor]) -> None:
    scans = [np.array([one.scan(step).distances_m for step in range(2000)]) for one in sensors]
    assert np.array_equal(scans[0], scans[1], equal_nan=True)
    assert not np.array_equal(scans[0], scans[2], equal_nan=True)
    lost = [float(np.isnan(one).mean()) for one in scans]
    assert lost[0] == pytest.approx(0.05, abs=0.01)
    assert lost[3] == pytest.approx(0.15, abs=0.01)
    assert scans[0].shape == (2000, SECTORS)


def test_noise_is_unbiased_and_grows_with_distance(sensors: list[RangeSensor]) -> None:
    exact = sensors[0].true_distances()
    scans = np.array([sensors[0].scan(step).distances_m for step in range(2000)])
    near = np.isfinite(exact)
    assert near.any()
    assert np.nanmean(scans[:, near], axis=0) == pytest.approx(exact[near], abs=0.05)
    assert np.nanstd(scans[:, near], axis=0) == pytest.approx(0.15 + 0.015 * exact[near], rel=0.1)


def test_watching_changes_nothing_and_features_are_reproducible() -> None:
    plain, recorded, again = BrinkDrive().run(spec()), record_drive(spec()), record_drive(spec())
    assert recorded.verdicts == plain.verdicts
    assert recorded.ended_at_s == plain.features["ended_at_s"]
    assert recorded.begins_s == LATENCY_S
    steps = round((recorded.ended_at_s - LATENCY_S) / 0.1 + 0.49)
    assert recorded.features.shape == (steps, len(ALL_FEATURES))
    assert np.isfinite(recorded.features).all()
    assert (recorded.features == again.features).all()


@pytest.mark.parametrize("latency_steps", [0, 1, 2, 5])
def test_a_guard_receives_boxes_and_scans_when_the_boxes_of_an_image_arrive(latency_steps: int) -> None:
    latency_s = latency_steps * CONTROL_STEP_S
    delayed = replace(spec(), options={**spec().options, "latency_s": latency_s})
    moments = observe_drive(delayed).moments
    for number, moment in enumerate(moments):
        arrives = number >= latency_steps and (number - latency_steps) % 2 == 0
        assert (moment.observation.boxes is not None) == (moment.scan is not None) == arrives
        if arrives:
            assert moment.observation.seen_s == pytest.approx(moment.observation.time_s - latency_s)
    assert moments[-1].observation.time_s == pytest.approx(0.05 * (len(moments) - 1))


@pytest.mark.parametrize("latency_steps", range(6))
def test_each_scan_has_noise_of_its_own_whatever_the_latency(latency_steps: int) -> None:
    last = round(8.0 / CONTROL_STEP_S)
    numbers = [scan_number(step * CONTROL_STEP_S) for step in range(latency_steps, last, 2)]
    assert numbers == list(range(latency_steps // 2, latency_steps // 2 + len(numbers)))
    assert numbers[-1] < 80


def test_other_simulators_are_refused() -> None:
    other = EpisodeSpec.from_json({**spec().to_json(), "simulator": "brink-aeb@3"})
    with pytest.raises(InvalidEpisode, match=r"brink-drive@3.*got 'brink-aeb@3'"):
        record_drive(other)

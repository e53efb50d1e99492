import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from brink.search.archive import Archive, Neighbourhood
from brink.search.metric import Metric
from brink.search.testing import example_spaces, stored_and_restored

ORACLE = json.loads((Path(__file__).parents[2] / "data" / "mlcshe_oracle.json").read_text())["archive_of_60"]
SPACE = example_spaces()["mixed"]
NEAR = Neighbourhood(radius=0.3, p_th=0.1)


def oracle_metric() -> Metric:
    return Metric(ORACLE["numeric_ranges"], np.isin(np.arange(29), ORACLE["categorical_indices"]))


def solutions(count: int, seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    rng = np.random.default_rng(seed)
    rows = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(count)]).reshape(count, SPACE.dimension)
    return rows, rng.random(count) < 0.4


def grown_in_steps(rows: NDArray[np.float64], unsafe: NDArray[np.bool_], cuts: list[int]) -> list[Archive]:
    archives = [Archive.empty(SPACE, NEAR)]
    for a, b in pairwise([0, *cuts, len(rows)]):
        archives.append(archives[-1].grown(np.arange(a, b), rows[a:b], unsafe[a:b], np.zeros(b - a)))
    return archives


def test_known_answers_of_the_replication_code() -> None:
    near = Neighbourhood(radius=ORACLE["delta"], p_th=ORACLE["p_th"], z=ORACLE["z"])
    archive = Archive.empty(oracle_metric(), near).grown(
        np.arange(60), np.array(ORACLE["vectors"], np.float64), ORACLE["unsafe"], np.zeros(60)
    )
    assert archive.neighbours.tolist() == ORACLE["n_neighbours"]
    assert archive.fitness.tolist() == pytest.approx(ORACLE["fitness"], rel=0, abs=1e-9)


@given(cuts=st.lists(st.integers(0, 90), max_size=6).map(sorted), seed=st.integers(0, 5))
@settings(max_examples=30, deadline=None)
def test_growing_step_by_step_equals_growing_at_once(cuts: list[int], seed: int) -> None:
    rows, unsafe = solutions(90, seed)
    steps = grown_in_steps(rows, unsafe, cuts)
    once = grown_in_steps(rows, unsafe, [])[-1]
    for name in ("numbers", "vectors", "unsafe", "neighbours", "unsafe_neighbours", "interval", "fitness"):
        assert np.array_equal(getattr(steps[-1], name), getattr(once, name)), name
    distance = Metric.of_space(SPACE).between(rows, rows)
    assert np.array_equal(once.neighbours, (distance <= NEAR.radius).sum(axis=1))
    assert np.array_equal(once.unsafe_neighbours, (distance <= NEAR.radius)[:, unsafe].sum(axis=1))


def test_rows_of_all_growths_make_up_the_matrix() -> None:
    rows, unsafe = solutions(50)
    distance = Metric.of_space(SPACE).between(rows, rows)
    for archive in grown_in_steps(rows, unsafe, [0, 20, 20, 45])[1:]:
        assert archive.latest_rows is not None
        count = len(archive)
        block = distance[count - len(archive.latest_rows) : count, :count].astype(np.float32)
        assert np.array_equal(archive.latest_rows, block)


def test_growing_leaves_the_old_archive_as_it_was() -> None:
    rows, unsafe = solutions(40)
    old, new = grown_in_steps(rows, unsafe, [30])[1:]
    assert (len(old), len(new)) == (30, 40)
    assert np.array_equal(old.neighbours, grown_in_steps(rows[:30], unsafe[:30], [])[-1].neighbours)
    assert np.any(new.neighbours[:30] > old.neighbours)


def test_arrays_are_read_only_and_not_those_of_the_caller() -> None:
    rows, unsafe = solutions(10)
    archive = grown_in_steps(rows, unsafe, [])[-1]
    for name in (
        "numbers",
        "vectors",
        "unsafe",
        "robustness",
        "neighbours",
        "fitness",
        "interval",
        "latest_rows",
    ):
        with pytest.raises(ValueError, match="read-only"):
            getattr(archive, name)[0] = 1
    before = archive.vectors.copy()
    rows[:] = 0
    assert np.array_equal(archive.vectors, before)


def test_restored_archive_grows_like_the_stored_one() -> None:
    rows, unsafe = solutions(60)
    archive = grown_in_steps(rows[:40], unsafe[:40], [25])[-1]
    restored = stored_and_restored(archive)
    assert restored.latest_rows is None
    further = (np.arange(40, 60), rows[40:], unsafe[40:], np.zeros(20))
    first, second = archive.grown(*further), restored.grown(*further)
    assert np.array_equal(first.fitness, second.fitness)
    assert np.array_equal(first.interval, second.interval)
    assert np.array_equal(first.neighbours, second.neighbours)


def test_a_distance_of_exactly_the_radius_is_near() -> None:
    metric = Metric(np.ones(10), np.ones(10, bool))
    rows = np.array([[0.0] * 10, [1.0] * 3 + [0.0] * 7, [1.0] * 4 + [0.0] * 6])
    archive = Archive.empty(metric, NEAR).grown([0, 1, 2], rows, [False, True, False], np.zeros(3))
    assert archive.neighbours.tolist() == [2, 3, 2]
    assert archive.unsafe_neighbours.tolist() == [1, 1, 1]


def test_what_was_known_at_first_is_scored_without_what_came_later() -> None:
    rows, unsafe = solutions(60)
    steps = grown_in_steps(rows, unsafe, [25])
    assert np.array_equal(steps[-1].first(25).fitness, steps[1].fitness)


def test_other_verdicts_change_counts_of_unsafe_alone() -> None:
    rows, unsafe = solutions(60)
    archive = grown_in_steps(rows, unsafe, [])[-1]
    flipped = archive.judged(~unsafe, np.ones(60))
    assert np.array_equal(flipped.neighbours, archive.neighbours)
    assert np.array_equal(flipped.unsafe_neighbours, archive.neighbours - archive.unsafe_neighbours)


def test_distances_are_those_of_the_metric() -> None:
    rows, unsafe = solutions(20)
    archive = grown_in_steps(rows, unsafe, [])[-1]
    expected = Metric.of_space(SPACE).between(rows[[3, 1]], rows[[0, 5, 19]])
    assert np.array_equal(archive.distances([3, 1], [0, 5, 19]), expected)


def test_empty_archive_has_no_solutions() -> None:
    archive = Archive.empty(SPACE, NEAR)
    assert len(archive) == 0
    assert archive.vectors.shape == (0, SPACE.dimension)
    assert archive.fitness.shape == (0,)
    assert archive.latest_rows is None


def test_a_number_is_never_added_twice() -> None:
    rows, unsafe = solutions(3)
    archive = grown_in_steps(rows, unsafe, [])[-1]
    with pytest.raises(ValueError, match="each candidate once"):
        archive.grown([2], rows[:1], [False], [0.0])
    with pytest.raises(ValueError, match="each candidate once"):
        archive.grown([7, 7], rows[:2], [False, True], [0.0, 0.0])


def test_shapes_that_do_not_belong_together_are_refused() -> None:
    rows, unsafe = solutions(3)
    with pytest.raises(ValueError, match="one number, verdict and robustness a row"):
        Archive.empty(SPACE, NEAR).grown([0, 1], rows, unsafe, np.zeros(3))
    archive = grown_in_steps(rows, unsafe, [])[-1]
    with pytest.raises(ValueError, match="robustness: expected shape"):
        Archive.restore(
            SPACE,
            NEAR,
            numbers=archive.numbers,
            vectors=archive.vectors,
            unsafe=archive.unsafe,
            robustness=[0.0],
            neighbours=archive.neighbours,
            unsafe_neighbours=archive.unsafe_neighbours,
        )


@pytest.mark.parametrize(
    ("radius", "p_th", "z", "name"),
    [(-0.1, 0.1, 1.96, "radius"), (0.3, 1.0, 1.96, "p_th"), (0.3, 0.1, 0.0, "z")],
)
def test_neighbourhood_out_of_range_is_refused(radius: float, p_th: float, z: float, name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        Neighbourhood(radius=radius, p_th=p_th, z=z)

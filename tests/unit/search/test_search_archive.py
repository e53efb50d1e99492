"""Archives: distances, neighbour counts, boundary fitness and digests."""

import hashlib
import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from brink.search.archive import Archive, Neighbourhood, archive_digest
from brink.search.errors import SpaceError
from brink.search.fitness import boundary_fitness, wilson_interval
from brink.search.metric import BLOCK_COLUMNS, BLOCK_ROWS, Metric
from brink.search.space import Categorical, Component, Integer, Real, SearchSpace
from brink.search.testing import example_spaces, stored_and_restored

ORACLE = json.loads((Path(__file__).parents[2] / "data" / "mlcshe_oracle.json").read_text())
RANGES = np.array(ORACLE["distance_config"]["numeric_ranges"], np.float64)
CATEGORICAL = np.isin(np.arange(29), ORACLE["distance_config"]["categorical_indices"])


def flat(solution: list[list[float]]) -> NDArray[np.float64]:
    scenario, (first, second) = solution[0], solution[1]
    return np.array([[*scenario, *first, *second]], np.float64)  # type: ignore[misc]


def random_rows(count: int, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.where(CATEGORICAL, rng.integers(0, 3, (count, 29)), rng.random((count, 29)) * RANGES)


def naive(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    numeric = np.mean(np.abs(x - y)[~CATEGORICAL] / RANGES[~CATEGORICAL])
    return float(0.5 * (numeric + np.mean((x != y)[CATEGORICAL])))


@pytest.mark.parametrize("row", ORACLE["distance"])
def test_distances_match_the_replication_code(row: dict[str, list[list[float]]]) -> None:
    x, y = flat(row["x"]), flat(row["y"])
    whole = Metric(RANGES, CATEGORICAL)
    scenario = Metric(RANGES[:7], CATEGORICAL[:7])
    behaviour = Metric(RANGES[7:], CATEGORICAL[7:])
    got = [
        whole.between(x, y)[0, 0],
        scenario.between(x[:, :7], y[:, :7])[0, 0],
        behaviour.between(x[:, 7:], y[:, 7:])[0, 0],
    ]
    assert got == pytest.approx([row["d"], row["d_scenario"], row["d_behaviour"]], rel=0, abs=1e-9)


def test_distance_depends_on_the_pair_alone() -> None:
    metric = Metric(RANGES, CATEGORICAL)
    a, b = random_rows(BLOCK_ROWS + 7, 1), random_rows(BLOCK_COLUMNS + 13, 2)
    together = metric.between(a, b)
    assert np.array_equal(together, metric.between(b, a).T)
    for i, j in [(0, 0), (BLOCK_ROWS, 3), (5, BLOCK_COLUMNS), (BLOCK_ROWS + 6, BLOCK_COLUMNS + 12)]:
        assert together[i, j] == metric.between(a[i : i + 1], b[j : j + 1])[0, 0]
        assert together[i, j] == metric.between(a[i : i + 3], b[max(0, j - 2) : j + 1])[0, -1]
        assert together[i, j] == pytest.approx(naive(a[i], b[j]), abs=1e-14)


@pytest.mark.parametrize("numeric", [1, 2, 3, 4, 5, 8, 20, 31])
def test_numbers_are_summed_in_order_bit_for_bit(numeric: int) -> None:
    rng = np.random.default_rng(numeric)
    metric = Metric(rng.random(numeric) + 0.5, np.zeros(numeric, bool))
    for count in range(1, 10):
        a, b = rng.random((count, numeric)), rng.random((11 - count, numeric))
        scaled_a, scaled_b = a / metric.ranges, b / metric.ranges
        expected = np.zeros((len(a), len(b)))
        for i, j in np.ndindex(expected.shape):
            total = 0.0
            for x, y in zip(scaled_a[i].tolist(), scaled_b[j].tolist(), strict=True):
                total += abs(x - y)
            expected[i, j] = total / numeric
        assert np.array_equal(metric.between(a, b), expected)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_distance_is_a_metric(seed: int) -> None:
    distance = Metric(RANGES, CATEGORICAL).between(random_rows(6, seed), random_rows(6, seed))
    assert np.array_equal(np.diag(distance), np.zeros(6))
    assert np.all((distance >= 0) & (distance <= 1))
    assert np.all(distance[:, None, :] <= distance[:, :, None] + distance[None, :, :] + 1e-12)


def test_distance_without_numbers_or_categories_is_the_other_term_alone() -> None:
    a, b = np.array([[0.0, 4.0]]), np.array([[1.0, 2.0]])
    assert Metric([2.0, 4.0], [False, False]).between(a, b)[0, 0] == 0.5
    assert Metric([1.0, 1.0], [True, True]).between(a, b)[0, 0] == 1.0
    # 3 of 10 categories must be within a radius of 0.3.
    ten = Metric(np.ones(10), np.ones(10, bool))
    assert ten.between(np.zeros((1, 10)), np.array([[1.0] * 3 + [0.0] * 7]))[0, 0] <= 0.3


def test_many_categories_do_not_overflow_the_counter() -> None:
    metric = Metric(np.ones(300), np.ones(300, bool))
    assert metric.between(np.zeros((1, 300)), np.ones((1, 300)))[0, 0] == 1.0


def test_metric_of_a_space_uses_its_ranges_and_categories() -> None:
    space = SearchSpace(
        (
            Component("scenario", (Categorical("road", ("a", "b")), Integer("cars", 0, 4))),
            Component("behaviour", (Real("lag", -1.0, 1.0, "s"),)),
        )
    )
    rows = np.array([[0.0, 0.0, -1.0], [1.0, 2.0, 1.0]])
    whole = Metric.of_space(space).between(rows, rows)[0, 1]
    assert whole == pytest.approx(0.5 * ((2 / 4 + 2 / 2) / 2 + 1.0))
    assert Metric.of_component(space, 0).between(rows[:, :2], rows[:, :2])[0, 1] == pytest.approx(0.75)
    assert Metric.of_component(space, 1).between(rows[:, 2:], rows[:, 2:])[0, 1] == 1.0


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (np.zeros((2, 5)), "rows of 2 numbers"),
        (np.array([[0.5, 0.0]]), "whole numbers"),
        (np.array([[np.nan, 0.0]]), "whole numbers"),
        (np.array([[1e6, 0.0]]), "whole numbers"),
    ],
)
def test_rows_that_do_not_fit_the_metric_are_rejected(rows: NDArray[np.float64], message: str) -> None:
    with pytest.raises(SpaceError, match=message):
        Metric([1.0, 1.0], [True, False]).points(rows)


def test_empty_ranges_are_rejected() -> None:
    with pytest.raises(SpaceError, match="ranges > 0"):
        Metric([0.0], [False])
    with pytest.raises(SpaceError, match="one range and one flag"):
        Metric([1.0, 2.0], [False])


@pytest.mark.parametrize("row", ORACLE["wilson_fitness"])
def test_intervals_and_fitness_match_the_replication_code(row: dict[str, float]) -> None:
    unsafe, evaluated = np.array([int(row["n_unsafe"])]), np.array([int(row["n_evaluated"])])
    lower, upper = wilson_interval(unsafe, evaluated, row["z"])
    fitness = boundary_fitness(unsafe, evaluated, row["p_th"], row["z"])
    assert [lower[0], upper[0], fitness[0]] == pytest.approx(
        [row["LL"], row["UL"], row["fitness"]], rel=0, abs=1e-9
    )


@pytest.mark.parametrize(
    ("t_b", "fewest"), [(0.20, 10), (0.15, 13), (0.10, 35), (0.05, 165), (0.03, 475), (0.01, 4275)]
)
def test_fitness_needs_a_minimum_number_of_solutions(t_b: float, fewest: int) -> None:
    def best(evaluated: int) -> float:
        # The best number of unsafe solutions is about a tenth; search up to a third.
        unsafe = np.arange(evaluated // 3 + 1)
        return float(boundary_fitness(unsafe, np.full(unsafe.size, evaluated), 0.1).min())

    assert next(n for n in range(1, 5_000) if best(n) <= t_b) == fewest


def test_limits_of_unanimous_neighbourhoods_are_exact() -> None:
    sizes = np.arange(1, 5_000)
    lower, _ = wilson_interval(np.zeros_like(sizes), sizes)
    _, upper = wilson_interval(sizes, sizes)
    assert np.all(lower == 0.0)
    assert np.all(upper == 1.0)


def test_large_all_safe_neighbourhoods_tie() -> None:
    # From 35 all-safe solutions on, the interval ends below p_th, and its other end, 0, is the one further away.
    sizes = np.arange(35, 5_000)
    assert np.unique(boundary_fitness(np.zeros_like(sizes), sizes, 0.1)).tolist() == [0.1 / 0.9]


@given(
    counts=st.lists(st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))),
    p_th=st.floats(0.01, 0.99),
    z=st.floats(0.1, 5),
)
@settings(deadline=None)
def test_interval_contains_the_share_and_fitness_is_bounded(
    counts: list[tuple[int, int]], p_th: float, z: float
) -> None:
    unsafe = np.array([k for k, _ in counts], np.int64)
    evaluated = np.array([n for _, n in counts], np.int64)
    lower, upper = wilson_interval(unsafe, evaluated, z)
    assert np.all((lower <= unsafe / evaluated + 1e-12) & (unsafe / evaluated <= upper + 1e-12))
    assert np.all((lower >= 0) & (upper <= 1))
    fitness = boundary_fitness(unsafe, evaluated, p_th, z)
    assert fitness.shape == (len(counts),)
    assert np.all((fitness >= 0) & (fitness <= 1 + 1e-12))


@pytest.mark.parametrize(("unsafe", "evaluated"), [(-1, 3), (4, 3), (0, 0)])
def test_impossible_counts_are_rejected(unsafe: int, evaluated: int) -> None:
    with pytest.raises(ValueError, match="unsafe <= evaluated"):
        wilson_interval(np.array([unsafe]), np.array([evaluated]))


def test_fractional_counts_are_rejected() -> None:
    with pytest.raises(ValueError, match="integer counts"):
        wilson_interval(np.array([0.5]), np.array([3]))


@pytest.mark.parametrize("p_th", [0.0, 1.0, -0.1, math.nan])
def test_threshold_outside_the_open_unit_interval_is_rejected(p_th: float) -> None:
    with pytest.raises(ValueError, match="p_th"):
        boundary_fitness(np.array([1]), np.array([3]), p_th)


@pytest.mark.parametrize("z", [0.0, -1.0, math.inf])
def test_quantile_that_is_not_positive_is_rejected(z: float) -> None:
    with pytest.raises(ValueError, match="z: expected"):
        wilson_interval(np.array([1]), np.array([3]), z)


ORACLE_60 = ORACLE["archive_of_60"]
SPACE = example_spaces()["mixed"]
NEAR = Neighbourhood(radius=0.3, p_th=0.1)


def oracle_metric() -> Metric:
    return Metric(ORACLE_60["numeric_ranges"], np.isin(np.arange(29), ORACLE_60["categorical_indices"]))


def solutions(count: int, seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    rng = np.random.default_rng(seed)
    rows = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(count)]).reshape(count, SPACE.dimension)
    return rows, rng.random(count) < 0.4


def grown_in_steps(
    rows: NDArray[np.float64], unsafe: NDArray[np.bool_], cuts: list[int], *, counted: bool = False
) -> list[Archive]:
    """Return an archive after each step; neighbours are counted after each if `counted`, or when asked for."""
    archives = [Archive.empty(SPACE, NEAR)]
    for a, b in pairwise([0, *cuts, len(rows)]):
        archives.append(archives[-1].grown(np.arange(a, b), rows[a:b], unsafe[a:b], np.zeros(b - a)))
        assert not counted or archives[-1].neighbours.size == b
    return archives


def test_neighbour_counts_and_fitness_match_the_replication_code() -> None:
    near = Neighbourhood(radius=ORACLE_60["delta"], p_th=ORACLE_60["p_th"], z=ORACLE_60["z"])
    archive = Archive.empty(oracle_metric(), near).grown(
        np.arange(60), np.array(ORACLE_60["vectors"], np.float64), ORACLE_60["unsafe"], np.zeros(60)
    )
    assert archive.neighbours.tolist() == ORACLE_60["n_neighbours"]
    assert archive.fitness.tolist() == pytest.approx(ORACLE_60["fitness"], rel=0, abs=1e-9)


@given(
    cuts=st.lists(st.integers(0, 90), max_size=6).map(sorted), seed=st.integers(0, 5), counted=st.booleans()
)
@settings(max_examples=30, deadline=None)
def test_growing_in_steps_equals_growing_at_once(cuts: list[int], seed: int, counted: bool) -> None:
    rows, unsafe = solutions(90, seed)
    steps = grown_in_steps(rows, unsafe, cuts, counted=counted)
    once = grown_in_steps(rows, unsafe, [])[-1]
    for name in ("numbers", "vectors", "unsafe", "neighbours", "unsafe_neighbours", "interval", "fitness"):
        assert np.array_equal(getattr(steps[-1], name), getattr(once, name)), name
    distance = Metric.of_space(SPACE).between(rows, rows)
    assert np.array_equal(once.neighbours, (distance <= NEAR.radius).sum(axis=1))
    assert np.array_equal(once.unsafe_neighbours, (distance <= NEAR.radius)[:, unsafe].sum(axis=1))


def test_latest_rows_of_all_steps_make_up_the_distance_matrix() -> None:
    rows, unsafe = solutions(50)
    distance = Metric.of_space(SPACE).between(rows, rows)
    for archive in grown_in_steps(rows, unsafe, [20, 45], counted=True)[1:]:
        assert archive.counts.latest_rows is not None
        count = len(archive)
        block = distance[count - len(archive.counts.latest_rows) : count, :count].astype(np.float32)
        assert np.array_equal(archive.counts.latest_rows, block)


def test_neighbours_are_not_counted_before_they_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, unsafe = solutions(1_100)
    whole = grown_in_steps(rows, unsafe, [])[-1]
    with monkeypatch.context() as patch:
        patch.delattr(Metric, "blocks")
        before, archive = grown_in_steps(rows, unsafe, [30])[1:]
        assert not archive.is_counted
        assert archive.first(10).numbers.tolist() == list(range(10))
    assert archive.counts.latest_rows is None, "they would be those of all solutions"
    assert np.array_equal(archive.neighbours, whole.neighbours)
    assert np.array_equal(archive.unsafe_neighbours, whole.unsafe_neighbours)
    assert (archive.is_counted, before.is_counted) == (True, False)


def test_growing_leaves_the_old_archive_unchanged() -> None:
    rows, unsafe = solutions(40)
    old, new = grown_in_steps(rows, unsafe, [30])[1:]
    assert (len(old), len(new)) == (30, 40)
    assert np.array_equal(old.neighbours, grown_in_steps(rows[:30], unsafe[:30], [])[-1].neighbours)
    assert np.any(new.neighbours[:30] > old.neighbours)


def test_arrays_are_read_only_copies() -> None:
    rows, unsafe = solutions(10)
    archive = grown_in_steps(rows, unsafe, [])[-1]
    for name in ("numbers", "vectors", "unsafe", "robustness", "neighbours", "fitness", "interval"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(archive, name)[0] = 1
    latest = archive.counts.latest_rows
    assert latest is not None
    assert not latest.flags.writeable
    before = archive.vectors.copy()
    rows[:] = 0
    assert np.array_equal(archive.vectors, before)


def test_restored_archive_grows_like_the_stored_one() -> None:
    rows, unsafe = solutions(60)
    archive = grown_in_steps(rows[:40], unsafe[:40], [25])[-1]
    restored = stored_and_restored(archive)
    assert restored.counts.latest_rows is None
    further = (np.arange(40, 60), rows[40:], unsafe[40:], np.zeros(20))
    first, second = archive.grown(*further), restored.grown(*further)
    assert np.array_equal(first.fitness, second.fitness)
    assert np.array_equal(first.interval, second.interval)
    assert np.array_equal(first.neighbours, second.neighbours)


def test_a_distance_equal_to_the_radius_counts_as_near() -> None:
    metric = Metric(np.ones(10), np.ones(10, bool))
    rows = np.array([[0.0] * 10, [1.0] * 3 + [0.0] * 7, [1.0] * 4 + [0.0] * 6])
    archive = Archive.empty(metric, NEAR).grown([0, 1, 2], rows, [False, True, False], np.zeros(3))
    assert archive.neighbours.tolist() == [2, 3, 2]
    assert archive.unsafe_neighbours.tolist() == [1, 1, 1]


def test_other_verdicts_change_only_the_unsafe_counts() -> None:
    rows, unsafe = solutions(60)
    archive = grown_in_steps(rows, unsafe, [])[-1]
    flipped = archive.with_verdicts(~unsafe, np.ones(60))
    assert np.array_equal(flipped.neighbours, archive.neighbours)
    assert np.array_equal(flipped.unsafe_neighbours, archive.neighbours - archive.unsafe_neighbours)


def test_repeated_numbers_are_rejected() -> None:
    rows, unsafe = solutions(3)
    archive = grown_in_steps(rows, unsafe, [])[-1]
    with pytest.raises(ValueError, match="each candidate once"):
        archive.grown([2], rows[:1], [False], [0.0])
    with pytest.raises(ValueError, match="each candidate once"):
        archive.grown([7, 7], rows[:2], [False, True], [0.0, 0.0])


def test_mismatched_shapes_are_rejected() -> None:
    rows, unsafe = solutions(3)
    with pytest.raises(ValueError, match="one number, verdict and robustness per row"):
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
def test_neighbourhood_out_of_range_is_rejected(radius: float, p_th: float, z: float, name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        Neighbourhood(radius=radius, p_th=p_th, z=z)


def line_archive(rows: list[float], unsafe: list[bool], radius: float = 0.3) -> Archive:
    metric = Metric([1.0], [False])
    return Archive.empty(metric, Neighbourhood(radius=radius, p_th=0.1)).grown(
        np.arange(len(rows)), np.array(rows)[:, None], unsafe, np.zeros(len(rows))
    )


def test_digest_hashes_the_documented_layout() -> None:
    archive = line_archive([0.25, 0.5], [True, False])
    content = b"brink-archive-1\n"
    content += (2).to_bytes(8, "little") + (1).to_bytes(8, "little")
    content += (0).to_bytes(8, "little") + (1).to_bytes(8, "little")
    content += np.array([0.25, 0.5], "<f8").tobytes() + b"\x01\x00" + archive.fitness.astype("<f8").tobytes()
    assert archive_digest(archive) == hashlib.sha256(content).hexdigest()


def test_any_difference_changes_the_digest() -> None:
    digests = {
        archive_digest(line_archive([0.25, 0.5], [True, False])),
        archive_digest(line_archive([0.25, 0.5], [False, False])),
        archive_digest(line_archive([0.25, np.nextafter(0.5, 1)], [True, False])),
        archive_digest(line_archive([0.25, 0.5], [True, False], radius=0.1)),
        archive_digest(line_archive([0.5, 0.25], [False, True])),
        archive_digest(line_archive([], [])),
    }
    assert len(digests) == 6


def test_all_safe_neighbourhood_approaches_one_ninth() -> None:
    fitness = boundary_fitness(np.array([0]), np.array([10**7]), 0.1)
    assert fitness[0] == pytest.approx(1 / 9, abs=1e-6)


def test_first_solutions_are_scored_without_later_ones() -> None:
    rows, unsafe = solutions(60)
    steps = grown_in_steps(rows, unsafe, [25])
    assert np.array_equal(steps[-1].first(25).fitness, steps[1].fitness)

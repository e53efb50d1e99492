import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from brink.search.errors import SpaceError
from brink.search.metric import BLOCK_COLUMNS, BLOCK_ROWS, Metric
from brink.search.space import Categorical, Component, Integer, Real, SearchSpace

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
def test_known_answers_of_the_replication_code(row: dict[str, list[list[float]]]) -> None:
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


def test_value_of_a_pair_depends_on_nothing_but_the_pair() -> None:
    metric = Metric(RANGES, CATEGORICAL)
    a, b = random_rows(BLOCK_ROWS + 7, 1), random_rows(BLOCK_COLUMNS + 13, 2)
    together = metric.between(a, b)
    assert np.array_equal(together, metric.between(b, a).T)
    for i, j in [(0, 0), (BLOCK_ROWS, 3), (5, BLOCK_COLUMNS), (BLOCK_ROWS + 6, BLOCK_COLUMNS + 12)]:
        assert together[i, j] == metric.between(a[i : i + 1], b[j : j + 1])[0, 0]
        assert together[i, j] == metric.between(a[i : i + 3], b[max(0, j - 2) : j + 1])[0, -1]
        assert together[i, j] == pytest.approx(naive(a[i], b[j]), abs=1e-14)


@pytest.mark.parametrize("numeric", [1, 2, 3, 4, 5, 8, 20, 31])
def test_numbers_are_summed_one_after_the_other_bit_for_bit(numeric: int) -> None:
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


def test_only_numbers_or_only_categories_take_that_term_alone() -> None:
    a, b = np.array([[0.0, 4.0]]), np.array([[1.0, 2.0]])
    assert Metric([2.0, 4.0], [False, False]).between(a, b)[0, 0] == 0.5
    assert Metric([1.0, 1.0], [True, True]).between(a, b)[0, 0] == 1.0
    # A share of categories must compare as the fraction people write: 3 of 10 is within a radius of 0.3.
    ten = Metric(np.ones(10), np.ones(10, bool))
    assert ten.between(np.zeros((1, 10)), np.array([[1.0] * 3 + [0.0] * 7]))[0, 0] <= 0.3


def test_many_categories_do_not_overflow_their_counter() -> None:
    metric = Metric(np.ones(300), np.ones(300, bool))
    assert metric.between(np.zeros((1, 300)), np.ones((1, 300)))[0, 0] == 1.0


def test_ranges_and_marks_come_from_the_space() -> None:
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


def test_no_rows_have_no_distances() -> None:
    metric = Metric(RANGES, CATEGORICAL)
    assert metric.between(random_rows(0, 1), random_rows(3, 1)).shape == (0, 3)
    assert metric.between(random_rows(3, 1), random_rows(0, 1)).shape == (3, 0)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (np.zeros((2, 5)), "rows of 2 numbers"),
        (np.array([[0.5, 0.0]]), "whole numbers"),
        (np.array([[np.nan, 0.0]]), "whole numbers"),
        (np.array([[1e6, 0.0]]), "whole numbers"),
    ],
)
def test_rows_that_do_not_fit_are_refused(rows: NDArray[np.float64], message: str) -> None:
    with pytest.raises(SpaceError, match=message):
        Metric([1.0, 1.0], [True, False]).points(rows)


def test_ranges_without_width_are_refused() -> None:
    with pytest.raises(SpaceError, match="ranges > 0"):
        Metric([0.0], [False])
    with pytest.raises(SpaceError, match="one range and one mark"):
        Metric([1.0, 2.0], [False])

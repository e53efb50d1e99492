import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.search.fitness import boundary_fitness, wilson_interval

ORACLE = json.loads((Path(__file__).parents[2] / "data" / "mlcshe_oracle.json").read_text())


@pytest.mark.parametrize("row", ORACLE["wilson_fitness"])
def test_known_answers_of_the_replication_code(row: dict[str, float]) -> None:
    unsafe, evaluated = np.array([int(row["n_unsafe"])]), np.array([int(row["n_evaluated"])])
    lower, upper = wilson_interval(unsafe, evaluated, row["z"])
    fitness = boundary_fitness(unsafe, evaluated, row["p_th"], row["z"])
    assert [lower[0], upper[0], fitness[0]] == pytest.approx(
        [row["LL"], row["UL"], row["fitness"]], rel=0, abs=1e-9
    )


@pytest.mark.parametrize(
    ("t_b", "fewest"), [(0.20, 10), (0.15, 13), (0.10, 35), (0.05, 165), (0.03, 475), (0.01, 4275)]
)
def test_neighbourhood_needs_so_many_solutions_to_reach_a_fitness(t_b: float, fewest: int) -> None:
    def best(evaluated: int) -> float:
        # The best count of unsafe ones lies near a tenth; up to a third is searched.
        unsafe = np.arange(evaluated // 3 + 1)
        return float(boundary_fitness(unsafe, np.full(unsafe.size, evaluated), 0.1).min())

    assert next(n for n in range(1, 5_000) if best(n) <= t_b) == fewest


def test_all_safe_neighbourhood_approaches_one_ninth() -> None:
    fitness = boundary_fitness(np.array([0]), np.array([10**7]), 0.1)
    assert fitness[0] == pytest.approx(1 / 9, abs=1e-6)


@given(
    counts=st.lists(st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))),
    p_th=st.floats(0.01, 0.99),
    z=st.floats(0.1, 5),
)
@settings(deadline=None)
def test_interval_holds_the_proportion_and_fitness_lies_in_the_unit_interval(
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
def test_impossible_counts_are_refused(unsafe: int, evaluated: int) -> None:
    with pytest.raises(ValueError, match="unsafe <= evaluated"):
        wilson_interval(np.array([unsafe]), np.array([evaluated]))


def test_fractional_counts_are_refused() -> None:
    with pytest.raises(ValueError, match="whole counts"):
        wilson_interval(np.array([0.5]), np.array([3]))


@pytest.mark.parametrize("p_th", [0.0, 1.0, -0.1, math.nan])
def test_threshold_outside_the_open_unit_interval_is_refused(p_th: float) -> None:
    with pytest.raises(ValueError, match="p_th"):
        boundary_fitness(np.array([1]), np.array([3]), p_th)


@pytest.mark.parametrize("z", [0.0, -1.0, math.inf])
def test_quantile_that_is_not_positive_is_refused(z: float) -> None:
    with pytest.raises(ValueError, match="z: expected"):
        wilson_interval(np.array([1]), np.array([3]), z)

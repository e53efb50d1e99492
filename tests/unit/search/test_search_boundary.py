import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from brink.search.archive import Archive, Neighbourhood
from brink.search.boundary import (
    PAPER_D_THS,
    PAPER_FRACTIONS,
    PAPER_T_BS,
    dbs,
    dbs_by_budget,
    dbs_grid,
    distinct_boundary,
    has_evidence,
    strict_dbs,
)
from brink.search.metric import Metric
from brink.search.testing import example_spaces

ORACLE = json.loads((Path(__file__).parents[2] / "data" / "mlcshe_oracle.json").read_text())["archive_of_60"]
SPACE = example_spaces()["mixed"]


def oracle_archive() -> Archive:
    metric = Metric(ORACLE["numeric_ranges"], np.isin(np.arange(29), ORACLE["categorical_indices"]))
    near = Neighbourhood(radius=ORACLE["delta"], p_th=ORACLE["p_th"], z=ORACLE["z"])
    vectors = np.array(ORACLE["vectors"], np.float64)
    return Archive.empty(metric, near).grown(np.arange(60), vectors, ORACLE["unsafe"], np.zeros(60))


def random_archive(count: int = 400, missing: tuple[int, ...] = ()) -> Archive:
    """An archive of random solutions, unsafe on one side; `missing` numbers failed."""
    rng = np.random.default_rng(3)
    rows = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(count)])
    unsafe = rows[:, 0] + rng.random(count) < 0.9
    kept = np.setdiff1d(np.arange(count), missing)
    near = Neighbourhood(radius=0.3, p_th=0.1)
    return Archive.empty(SPACE, near).grown(kept, rows[kept], unsafe[kept], np.zeros(kept.size))


def naive_boundary(archive: Archive, t_b: float, d_th: float) -> list[int]:
    taken: list[int] = []
    order = sorted(range(len(archive)), key=lambda i: (archive.fitness[i], archive.numbers[i]))
    for i in order:
        if archive.fitness[i] <= t_b and all(archive.distances([i], [j])[0, 0] >= d_th for j in taken):
            taken.append(i)
    return taken


@pytest.mark.parametrize(("name", "expected"), ORACLE["dbs"].items())
def test_known_answers_of_the_replication_code(name: str, expected: int) -> None:
    t_b, d_th = (float(part.split("=")[1]) for part in name.split(","))
    assert dbs(oracle_archive(), t_b, d_th) == expected


@pytest.mark.parametrize(("t_b", "d_th"), [(0.15, 0.1), (0.3, 0.2), (1.0, 0.3), (1.0, 0.0)])
def test_boundary_is_taken_greedily_by_fitness_then_number(t_b: float, d_th: float) -> None:
    archive = random_archive(90)
    assert distinct_boundary(archive, t_b, d_th).tolist() == naive_boundary(archive, t_b, d_th)


def test_grid_holds_the_figures_of_every_pair_of_thresholds() -> None:
    archive = random_archive()
    grid = dbs_grid(archive)
    assert grid.dbs.shape == grid.strict.shape == (len(PAPER_T_BS), len(PAPER_D_THS))
    for i, t_b in enumerate(PAPER_T_BS):
        for j, d_th in enumerate(PAPER_D_THS):
            assert grid.dbs[i, j] == dbs(archive, t_b, d_th)
            assert grid.strict[i, j] == strict_dbs(archive, t_b, d_th)
    assert grid.dbs.max() > 0
    assert grid.strict.max() > 0


def test_safe_surroundings_count_as_boundary_but_not_as_evidence() -> None:
    metric = Metric([1.0], [False])
    near = Neighbourhood(radius=1.0, p_th=0.1)
    safe = Archive.empty(metric, near).grown(
        np.arange(60), np.zeros((60, 1)), np.zeros(60, bool), np.ones(60)
    )
    assert dbs(safe, 0.15, 0.1) == 1
    assert strict_dbs(safe, 0.15, 0.1) == 0
    # The interval of 60 safe solutions ends below p_th; that of 20 contains it, yet knows no unsafe neighbour.
    few = safe.first(20)
    assert few.interval[0, 0] <= 0.1 <= few.interval[0, 1]
    assert not has_evidence(few).any()
    mixed = safe.judged(np.arange(60) < 6, np.ones(60))
    assert has_evidence(mixed).all()
    assert strict_dbs(mixed, 0.15, 0.1) == 1


def test_figures_over_the_budget_use_only_what_was_known_then() -> None:
    archive = random_archive(300, missing=(0, 17, 29, 30, 299))
    points = list(dbs_by_budget(archive, 300))
    assert [point.fraction for point in points] == pytest.approx(PAPER_FRACTIONS)
    looked_ahead = 0
    for point in points:
        known = archive.numbers < point.simulations
        naive = Archive.empty(SPACE, archive.neighbourhood).grown(
            archive.numbers[known], archive.vectors[known], archive.unsafe[known], archive.robustness[known]
        )
        assert point.evaluated == np.count_nonzero(known)
        assert np.array_equal(point.grid.dbs, dbs_grid(naive).dbs)
        assert np.array_equal(point.grid.strict, dbs_grid(naive).strict)
        ahead: NDArray[np.bool_] = archive.fitness[known] <= 0.15
        looked_ahead += int(ahead.sum()) != int((naive.fitness <= 0.15).sum())
    assert [point.simulations for point in points] == [30 * i for i in range(1, 11)]
    assert [point.evaluated for point in points[:2]] == [27, 56]
    # Final fitness would have given other figures: the difference that the test is about is there.
    assert looked_ahead > 0


def test_solutions_beyond_the_budget_are_not_counted() -> None:
    points = list(dbs_by_budget(random_archive(300, missing=(3,)), 200, (0.5, 1.0)))
    assert [(point.simulations, point.evaluated) for point in points] == [(100, 99), (200, 199)]


@pytest.mark.parametrize("fractions", [(0.0, 1.0), (0.5, 0.5), (0.9, 0.1), (1.1,)])
def test_fractions_that_do_not_ascend_in_the_unit_interval_are_refused(fractions: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="fractions"):
        next(dbs_by_budget(random_archive(20), 20, fractions))


def test_nothing_evaluated_has_no_boundary() -> None:
    empty = Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1))
    assert distinct_boundary(empty, 1.0, 0.1).size == 0
    assert dbs_grid(empty).dbs.sum() == 0

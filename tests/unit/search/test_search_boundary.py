"""The boundary of an archive: DBS, its dependence on the settings, and behaviour-blind controls."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from brink.search.analysis import boundary
from brink.search.analysis.boundary import (
    dbs,
    dbs_by_budget,
    dbs_grid,
    distinct_boundary,
    has_evidence,
    rescored,
    strict_dbs,
)
from brink.search.analysis.paper import PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.search.analysis.scores import ScenarioRisk, blind_archive
from brink.search.archive import Archive, Neighbourhood
from brink.search.errors import BoundaryTooLarge
from brink.search.metric import Metric
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.search.testing import example_spaces

ORACLE = json.loads((Path(__file__).parents[2] / "data" / "mlcshe_oracle.json").read_text())["archive_of_60"]
SPACE = example_spaces()["mixed"]


def oracle_archive() -> Archive:
    metric = Metric(ORACLE["numeric_ranges"], np.isin(np.arange(29), ORACLE["categorical_indices"]))
    near = Neighbourhood(radius=ORACLE["delta"], p_th=ORACLE["p_th"], z=ORACLE["z"])
    vectors = np.array(ORACLE["vectors"], np.float64)
    return Archive.empty(metric, near).grown(np.arange(60), vectors, ORACLE["unsafe"], np.zeros(60))


def random_archive(count: int = 400, missing: tuple[int, ...] = ()) -> Archive:
    """Return an archive of random solutions, unsafe on one side; the `missing` numbers failed."""
    rng = np.random.default_rng(3)
    rows = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(count)])
    unsafe = rows[:, 0] + rng.random(count) < 0.9
    numbers = np.setdiff1d(np.arange(count), missing)
    near = Neighbourhood(radius=0.3, p_th=0.1)
    return Archive.empty(SPACE, near).grown(numbers, rows[numbers], unsafe[numbers], np.zeros(numbers.size))


def noisy_archive(radius: float = 0.3, p_th: float = 0.1) -> Archive:
    rng = np.random.default_rng(4)
    rows = np.array([SPACE.join(SPACE.sample(rng)) for _ in range(300)])
    unsafe = rng.random(300) < np.where(rows[:, -1] > np.median(rows[:, -1]), 0.3, 0.02)
    return Archive.empty(SPACE, Neighbourhood(radius=radius, p_th=p_th, z=1.96)).grown(
        np.arange(300), rows, unsafe, np.where(unsafe, -1.0, 1.0)
    )


def naive_boundary(archive: Archive, t_b: float, d_th: float) -> list[int]:
    taken: list[int] = []
    order = sorted(range(len(archive)), key=lambda i: (archive.fitness[i], archive.numbers[i]))
    for i in order:
        if archive.fitness[i] <= t_b and all(archive.distances([i], [j])[0, 0] >= d_th for j in taken):
            taken.append(i)
    return taken


@pytest.mark.parametrize(("name", "expected"), ORACLE["dbs"].items())
def test_dbs_matches_the_replication_code(name: str, expected: int) -> None:
    t_b, d_th = (float(part.split("=")[1]) for part in name.split(","))
    assert dbs(oracle_archive(), t_b, d_th) == expected


@pytest.mark.parametrize(("t_b", "d_th"), [(0.15, 0.1), (0.3, 0.2), (1.0, 0.3), (1.0, 0.0)])
def test_boundary_is_taken_greedily_by_fitness_then_number(t_b: float, d_th: float) -> None:
    archive = random_archive(90)
    assert distinct_boundary(archive, t_b, d_th).tolist() == naive_boundary(archive, t_b, d_th)


@pytest.mark.parametrize("block", [1, 7, 1_000])
def test_boundary_does_not_depend_on_how_many_solutions_are_looked_at_together(
    block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(boundary, "_BLOCK", block)
    archive = random_archive(90)
    for t_b, d_th in ((0.15, 0.1), (1.0, 0.3), (1.0, 0.05)):
        assert distinct_boundary(archive, t_b, d_th).tolist() == naive_boundary(archive, t_b, d_th)


def test_a_boundary_that_takes_too_many_distances_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(boundary, "_BLOCK", 10)
    archive = random_archive(90)
    most = 90 * 90 // 2 * (SPACE.dimension + 8)
    assert distinct_boundary(archive, 1.0, 0.01, most_cost=most).size > 80
    with pytest.raises(BoundaryTooLarge, match=r"90 solutions .* choose a larger d_th or a smaller t_b"):
        distinct_boundary(archive, 1.0, 0.01, most_cost=most // 2)
    assert distinct_boundary(archive, 1.0, 0.0, most_cost=0).size == 90, "nothing is compared"


def test_a_grid_leaves_out_distances_that_take_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(boundary, "_BLOCK", 10)
    archive = random_archive()
    whole, part = (
        dbs_grid(archive, d_ths=(0.01, 0.3)),
        dbs_grid(archive, d_ths=(0.01, 0.3), most_cost=2_000 * (SPACE.dimension + 8)),
    )
    assert (whole.d_ths, part.d_ths) == ((0.01, 0.3), (0.3,))
    assert part.dbs.tolist() == whole.dbs[:, 1:].tolist()
    assert part.strict.tolist() == whole.strict[:, 1:].tolist()
    assert dbs_grid(archive, d_ths=(0.01,), most_cost=0).dbs.shape == (len(PAPER_T_BS), 0)


def test_grid_equals_the_single_figures() -> None:
    archive = random_archive()
    grid = dbs_grid(archive)
    assert grid.dbs.shape == grid.strict.shape == (len(PAPER_T_BS), len(PAPER_D_THS))
    for i, t_b in enumerate(PAPER_T_BS):
        for j, d_th in enumerate(PAPER_D_THS):
            assert grid.dbs[i, j] == dbs(archive, t_b, d_th)
            assert grid.strict[i, j] == strict_dbs(archive, t_b, d_th)
    assert grid.dbs.max() > 0
    assert grid.strict.max() > 0


def test_safe_neighbourhoods_count_for_dbs_but_not_for_strict_dbs() -> None:
    metric = Metric([1.0], [False])
    near = Neighbourhood(radius=1.0, p_th=0.1)
    safe = Archive.empty(metric, near).grown(
        np.arange(60), np.zeros((60, 1)), np.zeros(60, bool), np.ones(60)
    )
    assert dbs(safe, 0.15, 0.1) == 1
    assert strict_dbs(safe, 0.15, 0.1) == 0
    # The interval of 60 safe solutions ends below p_th; that of 20 contains it, but without an unsafe neighbour.
    few = safe.first(20)
    assert few.interval[0, 0] <= 0.1 <= few.interval[0, 1]
    assert not has_evidence(few).any()
    mixed = safe.with_verdicts(np.arange(60) < 6, np.ones(60))
    assert has_evidence(mixed).all()
    assert strict_dbs(mixed, 0.15, 0.1) == 1


def test_strict_boundary_is_a_part_of_the_boundary() -> None:
    # Three places on a line. The one in the middle lies within d_th of the two others and has the best fitness, but
    # no evidence; among the solutions with evidence alone, two would be distinct.
    metric, near = Metric([1.0], [False]), Neighbourhood(radius=0.0, p_th=0.1)
    places, counts = [0.35, 0.5, 0.65], [(7, 50), (0, 40), (7, 50)]
    rows = np.concatenate([np.full((n, 1), x) for x, (_, n) in zip(places, counts, strict=True)])
    unsafe = np.concatenate([np.arange(n) < k for k, n in counts])
    archive = Archive.empty(metric, near).grown(np.arange(len(rows)), rows, unsafe, np.zeros(len(rows)))
    assert archive.fitness[50] < archive.fitness[0] < 0.2
    assert has_evidence(archive)[[0, 50, 90]].tolist() == [True, False, True]
    assert (dbs(archive, 0.2, 0.2), strict_dbs(archive, 0.2, 0.2)) == (1, 0)


@pytest.mark.parametrize("make", [random_archive, noisy_archive])
def test_strict_dbs_never_exceeds_dbs(make: Callable[[], Archive]) -> None:
    archive = make()
    grid = dbs_grid(archive, np.linspace(0.02, 1, 25).tolist(), np.linspace(0, 0.6, 13).tolist())
    assert (grid.strict <= grid.dbs).all()
    for t_b, d_th in ((0.2, 0.3), (0.5, 0.2), (1.0, 0.05)):
        distinct = distinct_boundary(archive, t_b, d_th).tolist()
        strict = distinct_boundary(archive, t_b, d_th, strict=True).tolist()
        assert strict == [place for place in distinct if has_evidence(archive)[place]]


def test_figures_over_the_budget_use_only_earlier_solutions() -> None:
    archive = random_archive(300, missing=(0, 17, 29, 30, 299))
    points = list(dbs_by_budget(archive, 300))
    assert [point.fraction for point in points] == pytest.approx(PAPER_FRACTIONS)
    differing = 0
    for point in points:
        known = archive.numbers < point.simulations
        naive = Archive.empty(SPACE, archive.neighbourhood).grown(
            archive.numbers[known], archive.vectors[known], archive.unsafe[known], archive.robustness[known]
        )
        assert point.evaluated == np.count_nonzero(known)
        assert np.array_equal(point.grid.dbs, dbs_grid(naive).dbs)
        assert np.array_equal(point.grid.strict, dbs_grid(naive).strict)
        ahead: NDArray[np.bool_] = archive.fitness[known] <= 0.15
        differing += int(ahead.sum()) != int((naive.fitness <= 0.15).sum())
    assert [point.simulations for point in points] == [30 * i for i in range(1, 11)]
    assert [point.evaluated for point in points[:2]] == [27, 56]
    # The final fitness would give other figures, so the test can fail.
    assert differing > 0


@pytest.mark.parametrize("count", [0, 1, 149, 150, 290, 300, 400])
def test_first_solutions_have_the_figures_they_had_then(count: int) -> None:
    archive = random_archive(300)
    known = archive.numbers < count
    then = Archive.empty(SPACE, archive.neighbourhood).grown(
        archive.numbers[known], archive.vectors[known], archive.unsafe[known], archive.robustness[known]
    )
    first = archive.first(count)
    for name in ("numbers", "vectors", "unsafe", "robustness", "neighbours", "unsafe_neighbours", "fitness"):
        np.testing.assert_array_equal(getattr(first, name), getattr(then, name))


@pytest.mark.parametrize("fractions", [(0.0, 1.0), (0.5, 0.5), (0.9, 0.1), (1.1,)])
def test_fractions_that_do_not_ascend_in_the_unit_interval_are_rejected(fractions: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="fractions"):
        next(dbs_by_budget(random_archive(20), 20, fractions))


@pytest.mark.parametrize(("radius", "p_th"), [(0.3, 0.25), (0.45, 0.1), (0.2, 0.3), (0.3, 0.1)])
def test_rescored_archive_equals_one_built_with_those_settings(radius: float, p_th: float) -> None:
    found, expected = rescored(noisy_archive(), radius=radius, p_th=p_th), noisy_archive(radius, p_th)
    assert found.neighbourhood == expected.neighbourhood
    for name in ("numbers", "unsafe", "neighbours", "unsafe_neighbours", "interval", "fitness"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_settings_out_of_range_are_rejected() -> None:
    for wrong in ({"radius": -0.1}, {"p_th": 1.0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            rescored(noisy_archive(), **wrong)


BLIND_SPACE = SearchSpace(
    (
        Component("scenario", tuple(Categorical(f"s{i}", ("0", "1", "2")) for i in range(4))),
        Component("behaviour", (Real("x", 0.0, 1.0), Real("y", 0.0, 1.0))),
    )
)
RNG = np.random.default_rng(0)
ROWS = np.array([BLIND_SPACE.join(BLIND_SPACE.sample(RNG)) for _ in range(1500)])


def blind_space_archive(unsafe: NDArray[np.bool_], rows: NDArray[np.float64] = ROWS) -> Archive:
    near = Neighbourhood(radius=0.3, p_th=0.1)
    return Archive.empty(BLIND_SPACE, near).grown(
        np.arange(len(rows)), rows, unsafe, np.where(unsafe, -1.0, 1.0), keep_rows=False
    )


def test_estimate_is_shrunk_towards_similar_scenarios() -> None:
    rows = np.array([[0, 0, 0, 0, 0.5, 0.5], [0, 0, 0, 1, 0.5, 0.5], [2, 2, 2, 2, 0.5, 0.5]], np.float64)
    archive = blind_space_archive(np.array([False, True, True]), rows)
    loose = ScenarioRisk.fitted(archive, BLIND_SPACE, shrinkage=1e-9).probability(rows[:, :4])
    assert loose == pytest.approx([0.0, 1.0, 1.0], abs=1e-6)
    risk = ScenarioRisk.fitted(archive, BLIND_SPACE, bandwidth=0.5)
    near, far, mean = np.exp(-0.25 / 0.5), np.exp(-1.0 / 0.5), 2 / 3
    others = (near * 1 + far * 1 + mean) / (near + far + 1)
    assert risk.probability(rows[:1, :4])[0] == pytest.approx((0 + 4 * others) / (1 + 4))
    # A new scenario has the weighted mean of all others.
    unknown = risk.probability(np.array([[0.0, 0.0, 0.0, 2.0]]))
    far = np.exp(-0.75 / 0.5)
    assert unknown[0] == pytest.approx((near * 0 + near * 1 + far * 1 + mean) / (2 * near + far + 1))


def test_redrawn_verdicts_ignore_the_behaviour() -> None:
    unsafe = ROWS[:, 4] + ROWS[:, 5] < 0.8
    archive = blind_space_archive(unsafe)
    risk = ScenarioRisk.fitted(archive, BLIND_SPACE)
    share = [blind_archive(archive, risk, seed=1, draw=draw).unsafe for draw in range(8)]
    low, high = ROWS[:, 4] + ROWS[:, 5] < 0.8, ROWS[:, 4] + ROWS[:, 5] >= 0.8
    assert archive.unsafe[low].mean() - archive.unsafe[high].mean() == 1.0
    # The rest is the share of its own verdict that a rarely evaluated scenario keeps.
    assert np.mean([s[low].mean() - s[high].mean() for s in share]) < 0.12
    assert np.mean(share) == pytest.approx(unsafe.mean(), abs=0.02)


def test_equal_seeds_and_draws_give_equal_controls() -> None:
    archive = blind_space_archive(np.random.default_rng(2).random(len(ROWS)) < 0.4)
    risk = ScenarioRisk.fitted(archive, BLIND_SPACE)
    first, again, other = (blind_archive(archive, risk, seed=1, draw=draw) for draw in (0, 0, 1))
    assert np.array_equal(first.unsafe, again.unsafe)
    assert not np.array_equal(first.unsafe, other.unsafe)
    assert np.array_equal(first.unsafe, first.robustness < 0)
    assert np.array_equal(first.vectors, archive.vectors)


def test_empty_archive_has_no_risk() -> None:
    empty = Archive.empty(BLIND_SPACE, Neighbourhood(radius=0.3, p_th=0.1))
    with pytest.raises(ValueError, match="at least one"):
        ScenarioRisk.fitted(empty, BLIND_SPACE)
    with pytest.raises(ValueError, match="shrinkage > 0"):
        ScenarioRisk.fitted(blind_space_archive(ROWS[:, 4] < 0.5), BLIND_SPACE, shrinkage=0.0)


def by_scenario(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the true risk of the synthetic landscape, a function of the scenario."""
    risk: NDArray[np.float64] = 0.1 + 0.2 * rows[:, 0] + 0.15 * (rows[:, 1] == 2)
    return risk


def test_scenario_risk_is_estimated_from_the_archive() -> None:
    truth = by_scenario(ROWS)
    archive = blind_space_archive(np.random.default_rng(1).random(len(ROWS)) < truth)
    risk = ScenarioRisk.fitted(archive, BLIND_SPACE)
    estimate = risk.probability(ROWS[:, :4])
    assert np.corrcoef(estimate, truth)[0, 1] > 0.85
    assert np.abs(estimate - truth).mean() < 0.08
    assert estimate.mean() == pytest.approx(archive.unsafe.mean(), abs=0.01)


def test_solutions_beyond_the_budget_are_not_counted() -> None:
    points = list(dbs_by_budget(random_archive(300, missing=(3,)), 200, (0.5, 1.0)))
    assert [(point.simulations, point.evaluated) for point in points] == [(100, 99), (200, 199)]


def test_empty_archive_has_no_boundary() -> None:
    empty = Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1))
    assert distinct_boundary(empty, 1.0, 0.1).size == 0
    assert dbs_grid(empty).dbs.sum() == 0

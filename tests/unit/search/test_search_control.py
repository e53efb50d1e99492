import numpy as np
import pytest
from numpy.typing import NDArray

from brink.search.archive import Archive, Neighbourhood
from brink.search.control import ScenarioRisk, blind_archive
from brink.search.space import Categorical, Component, Real, SearchSpace

SPACE = SearchSpace(
    (
        Component("scenario", tuple(Categorical(f"s{i}", ("0", "1", "2")) for i in range(4))),
        Component("behaviour", (Real("x", 0.0, 1.0), Real("y", 0.0, 1.0))),
    )
)
RNG = np.random.default_rng(0)
ROWS = np.array([SPACE.join(SPACE.sample(RNG)) for _ in range(1500)])


def archive_of(unsafe: NDArray[np.bool_], rows: NDArray[np.float64] = ROWS) -> Archive:
    near = Neighbourhood(radius=0.3, p_th=0.1)
    return Archive.empty(SPACE, near).grown(
        np.arange(len(rows)), rows, unsafe, np.where(unsafe, -1.0, 1.0), keep_rows=False
    )


def by_scenario(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """The true risk of the made-up landscape: a function of the scenario."""
    risk: NDArray[np.float64] = 0.1 + 0.2 * rows[:, 0] + 0.15 * (rows[:, 1] == 2)
    return risk


def test_risk_that_comes_from_the_scenario_is_found_again() -> None:
    truth = by_scenario(ROWS)
    archive = archive_of(np.random.default_rng(1).random(len(ROWS)) < truth)
    risk = ScenarioRisk.fitted(archive, SPACE)
    estimate = risk.probability(ROWS[:, :4])
    assert np.corrcoef(estimate, truth)[0, 1] > 0.85
    assert np.abs(estimate - truth).mean() < 0.08
    assert estimate.mean() == pytest.approx(archive.unsafe.mean(), abs=0.01)


def test_estimate_is_pulled_towards_similar_scenarios() -> None:
    rows = np.array([[0, 0, 0, 0, 0.5, 0.5], [0, 0, 0, 1, 0.5, 0.5], [2, 2, 2, 2, 0.5, 0.5]], np.float64)
    archive = archive_of(np.array([False, True, True]), rows)
    loose = ScenarioRisk.fitted(archive, SPACE, shrinkage=1e-9).probability(rows[:, :4])
    assert loose == pytest.approx([0.0, 1.0, 1.0], abs=1e-6)
    risk = ScenarioRisk.fitted(archive, SPACE, bandwidth=0.5)
    near, far, mean = np.exp(-0.25 / 0.5), np.exp(-1.0 / 0.5), 2 / 3
    others = (near * 1 + far * 1 + mean) / (near + far + 1)
    assert risk.probability(rows[:1, :4])[0] == pytest.approx((0 + 4 * others) / (1 + 4))
    # A scenario that nobody evaluated has the mean of all others, the near ones above all.
    unknown = risk.probability(np.array([[0.0, 0.0, 0.0, 2.0]]))
    far = np.exp(-0.75 / 0.5)
    assert unknown[0] == pytest.approx((near * 0 + near * 1 + far * 1 + mean) / (2 * near + far + 1))


def test_verdicts_are_blind_to_behaviour() -> None:
    unsafe = ROWS[:, 4] + ROWS[:, 5] < 0.8
    archive = archive_of(unsafe)
    risk = ScenarioRisk.fitted(archive, SPACE)
    share = [blind_archive(archive, risk, seed=1, draw=draw).unsafe for draw in range(8)]
    low, high = ROWS[:, 4] + ROWS[:, 5] < 0.8, ROWS[:, 4] + ROWS[:, 5] >= 0.8
    assert archive.unsafe[low].mean() - archive.unsafe[high].mean() == 1.0
    # What is left is the part of its own verdict that a rarely evaluated scenario keeps.
    assert np.mean([s[low].mean() - s[high].mean() for s in share]) < 0.12
    assert np.mean(share) == pytest.approx(unsafe.mean(), abs=0.02)


def test_control_of_a_landscape_without_behaviour_looks_like_it() -> None:
    archive = archive_of(np.random.default_rng(2).random(len(ROWS)) < by_scenario(ROWS))
    risk = ScenarioRisk.fitted(archive, SPACE)
    shares = archive.unsafe_neighbours / archive.neighbours
    for draw in range(3):
        blind = blind_archive(archive, risk, seed=1, draw=draw)
        assert np.array_equal(blind.neighbours, archive.neighbours)
        assert np.corrcoef(blind.unsafe_neighbours / blind.neighbours, shares)[0, 1] > 0.8


def test_equal_seeds_and_draws_give_equal_controls() -> None:
    archive = archive_of(np.random.default_rng(2).random(len(ROWS)) < 0.4)
    risk = ScenarioRisk.fitted(archive, SPACE)
    first, again, other = (blind_archive(archive, risk, seed=1, draw=draw) for draw in (0, 0, 1))
    assert np.array_equal(first.unsafe, again.unsafe)
    assert not np.array_equal(first.unsafe, other.unsafe)
    assert np.array_equal(first.unsafe, first.robustness < 0)
    assert np.array_equal(first.vectors, archive.vectors)


def test_repeats_are_evaluations_a_scenario() -> None:
    risk = ScenarioRisk.fitted(archive_of(ROWS[:, 4] < 0.5), SPACE)
    different = len(np.unique(ROWS[:, SPACE.slices[0]], axis=0))
    assert risk.repeats == pytest.approx(len(ROWS) / different)


def test_nothing_evaluated_has_no_risk() -> None:
    empty = Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1))
    with pytest.raises(ValueError, match="at least one"):
        ScenarioRisk.fitted(empty, SPACE)
    with pytest.raises(ValueError, match="shrinkage > 0"):
        ScenarioRisk.fitted(archive_of(ROWS[:, 4] < 0.5), SPACE, shrinkage=0.0)

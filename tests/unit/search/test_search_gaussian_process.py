"""Regression with a Gaussian process: agreement with scikit-learn, and what solutions in flight change."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from brink.search.errors import ConfigError
from brink.search.gaussian_process import MOST_SOLUTIONS, Covariance, check_few, embedded, posterior
from brink.search.space import Categorical, Component, FloatArray, Real, SearchSpace

ROUGH = Covariance(twice_nu=1, length=0.4, deviation=1.5, noise=0.1)
SMOOTH = Covariance(twice_nu=5, length=0.4, deviation=1.5, noise=0.1)
NOWHERE = np.empty((0, 3))


def points(count: int, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).random((count, 3))


def wave(at: FloatArray) -> FloatArray:
    return np.sin(5 * at[:, 0]) + at[:, 1] - at[:, 2] ** 2


@pytest.mark.parametrize("covariance", [ROUGH, SMOOTH], ids=["rough", "smooth"])
def test_the_posterior_is_that_of_scikit_learn(covariance: Covariance) -> None:
    known, wanted = points(40), points(25, seed=1)
    kernel = ConstantKernel(covariance.deviation**2) * Matern(covariance.length, nu=covariance.twice_nu / 2)
    other = GaussianProcessRegressor(kernel, alpha=covariance.noise**2, optimizer=None)
    mean, deviation = other.fit(known, wave(known)).predict(wanted, return_std=True)
    mine = posterior(covariance, known, wave(known), NOWHERE, wanted)
    assert mine.mean == pytest.approx(mean, abs=1e-7)
    assert mine.deviation == pytest.approx(deviation, abs=1e-7)


def test_nothing_known_is_the_prior() -> None:
    mine = posterior(ROUGH, NOWHERE, np.empty(0), NOWHERE, points(5))
    assert mine.mean.tolist() == [0.0] * 5
    assert mine.deviation == pytest.approx(np.full(5, 1.5))


def test_solutions_in_flight_reduce_the_variance_and_leave_the_mean() -> None:
    known, waiting, wanted = points(30), points(4, seed=2), points(20, seed=3)
    before = posterior(SMOOTH, known, wave(known), NOWHERE, wanted)
    after = posterior(SMOOTH, known, wave(known), waiting, wanted)
    assert after.mean == pytest.approx(before.mean, abs=1e-9)
    assert (after.variance < before.variance).all()


@pytest.mark.parametrize("covariance", [ROUGH, SMOOTH], ids=["rough", "smooth"])
def test_choosing_points_one_by_one_is_the_same_as_having_them_in_flight(covariance: Covariance) -> None:
    known, wanted = points(30), points(20, seed=3)
    mine = posterior(covariance, known, wave(known), points(2, seed=4), wanted)
    for place in (7, 2, 11):
        mine.choose(place)
    waiting = np.concatenate([points(2, seed=4), wanted[[7, 2, 11]]])
    assert mine.variance == pytest.approx(
        posterior(covariance, known, wave(known), waiting, wanted).variance, abs=1e-7
    )


def test_the_covariance_of_a_drawn_function_is_found_again() -> None:
    true = Covariance(twice_nu=5, length=0.3, deviation=20.0, noise=0.2)
    at = points(250)
    drawn = np.random.default_rng(5).multivariate_normal(np.zeros(250), true.between(at, at))
    found = Covariance.fitted(at, drawn, twice_nu=5)
    assert found.length in (0.2, 0.3, 0.45)
    assert 10 < found.deviation < 40
    assert found.noise < 2


def test_a_category_is_as_far_away_as_the_other_end_of_a_range() -> None:
    space = SearchSpace(
        (Component("a", (Real("x", -5.0, 15.0), Categorical("c", ("p", "q", "r")), Real("y", 0.0, 1.0))),)
    )
    at = embedded(space, np.array([[-5.0, 0, 0.5], [15.0, 0, 0.5], [-5.0, 2, 0.5], [15.0, 1, 1.0]]))
    squares = 3 * np.square(at[1:] - at[0]).sum(axis=1)
    assert squares == pytest.approx([1.0, 1.0, 2.25])


def test_too_large_budgets_are_refused() -> None:
    check_few("bsv@1", MOST_SOLUTIONS)
    with pytest.raises(
        ConfigError, match=r"budget: expected at most 5,000 simulations, as bsv@1 uses an exact"
    ):
        check_few("bsv@1", MOST_SOLUTIONS + 1)

"""Tempered sequential Monte Carlo: draws follow a posterior that is known."""

import numpy as np
import pytest
from scipy import stats

from brink.search.space import FloatArray, IntArray
from brink.search.tempering import effective_size, posterior_draws, resampled


def test_effective_size_of_equal_weights_is_their_number_and_of_one_weight_is_one() -> None:
    assert effective_size(np.zeros(50)) == pytest.approx(50.0)
    assert effective_size(np.array([0.0, -1_000.0, -1_000.0])) == pytest.approx(1.0)


def test_resampled_places_stand_for_the_weights() -> None:
    places = resampled(np.log([0.5, 0.25, 0.25]), 400)
    assert np.bincount(places).tolist() == [200, 100, 100]


def test_draws_follow_a_posterior_that_few_draws_of_the_prior_fit() -> None:
    """600 of 20,000 in the first column; of the second and third only the sum is known; nothing of the fourth."""
    prior = np.random.default_rng(1).random((20_000, 4))

    def log_likelihood(points: FloatArray) -> FloatArray:
        share = np.clip(points[:, 0], 1e-9, 1.0 - 1e-9)
        total = points[:, 1] + points[:, 2]
        return np.asarray(
            600 * np.log(share) + 19_400 * np.log1p(-share) - 0.5 * ((total - 1.0) / 0.005) ** 2
        )

    def drawn(places: IntArray) -> FloatArray:
        return prior[places]

    likely = log_likelihood(prior)
    assert effective_size(likely) < 20
    points = posterior_draws(drawn, likely, log_likelihood, 2_000, np.random.default_rng(2))
    at = [0.05, 0.25, 0.5, 0.75, 0.95]
    spread = stats.beta.std(601, 19_401)
    assert np.quantile(points[:, 0], at) == pytest.approx(stats.beta.ppf(at, 601, 19_401), abs=0.15 * spread)
    assert (points[:, 1] + points[:, 2]).std() == pytest.approx(0.005, rel=0.15)
    assert np.quantile(points[:, 1], at) == pytest.approx(at, abs=0.04)
    assert np.quantile(points[:, 3], at) == pytest.approx(at, abs=0.04)
    assert points.min() >= 0.0
    assert points.max() <= 1.0

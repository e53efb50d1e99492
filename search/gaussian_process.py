"""Exact regression with a Gaussian process, for a few thousand solutions of any space.

Numbers are divided by their ranges and categories become one of several indicators, so that two categories are as far
apart as the two ends of a range. Needs NumPy and SciPy alone. Its cost grows with the cube of the number of solutions
(0.1 s for 1,300, 4 s for 5,000).

Source: Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006: algorithm 2.1, and the Matérn
covariances (4.14). Conditioning on solutions that are still being simulated: Desautels, Krause and Burdick 2014.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np

from brink.search.errors import ConfigError
from brink.search.space import Categorical, FloatArray, SearchSpace

MOST_SOLUTIONS: Final = 5_000
"""Solutions up to which a search may use a Gaussian process."""
_FITTED: Final = 300
"""Solutions, the first ones, from which the covariance is estimated."""
_LENGTHS: Final = (0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.5)
_NOISES: Final = (1e-6, 1e-3, 1e-2, 1e-1)
"""Variances of the noise, as shares of that of the function."""
_JITTER: Final = 1e-10
"""Smallest share of noise, without which rounding could make a covariance singular."""


def check_few(algorithm: str, budget: int) -> None:
    """Check that a Gaussian process can learn from as many solutions as a budget allows.

    Args:
        algorithm: Id of the algorithm.
        budget: Number of simulations.

    Raises:
        ConfigError: There are too many.
    """
    if budget > MOST_SOLUTIONS:
        raise ConfigError(
            "budget",
            f"expected at most {MOST_SOLUTIONS:,} simulations, as {algorithm} uses an exact Gaussian process; got "
            f"{budget:,}",
        )


def embedded(space: SearchSpace, rows: FloatArray) -> FloatArray:
    """Return complete solutions as points whose distance is the root mean square over the parameters.

    A number adds its difference in units of its range, a category 1 if it differs.

    Args:
        space: Space of the solutions.
        rows: Complete solutions, shape ``(n, d)``.

    Returns:
        Points, shape ``(n, numbers + choices)``.
    """
    columns = [rows[:, ~space.categorical] / space.ranges[~space.categorical]]
    for column, parameter in enumerate(space.parameters):
        if isinstance(parameter, Categorical):
            codes = np.arange(len(parameter.choices))
            columns.append((rows[:, column, None] == codes) / math.sqrt(2))
    points: FloatArray = np.concatenate(columns, axis=1) / math.sqrt(space.dimension)
    return points


@dataclass(frozen=True, slots=True, kw_only=True)
class Covariance:
    """A stationary Matérn covariance.

    Attributes:
        twice_nu: 1 for rough functions (nu = 1/2), 5 for smooth ones (nu = 5/2).
        length: Length scale.
        deviation: Standard deviation of the function.
        noise: Standard deviation of the noise.
    """

    twice_nu: int
    length: float
    deviation: float
    noise: float

    def correlation(self, points: FloatArray, others: FloatArray) -> FloatArray:
        """Return the correlations of points of shapes ``(m, k)`` and ``(n, k)``, shape ``(m, n)``."""
        from scipy.spatial.distance import cdist  # slow to import

        scaled: FloatArray = cdist(points, others)
        scaled *= math.sqrt(self.twice_nu) / self.length
        decay = np.exp(-scaled)
        if self.twice_nu == 5:
            decay *= 1 + scaled * (1 + scaled / 3)
        return decay

    def between(self, points: FloatArray, others: FloatArray) -> FloatArray:
        """Return the covariances of the function at points of shapes ``(m, k)`` and ``(n, k)``, shape ``(m, n)``."""
        covariances = self.correlation(points, others)
        covariances *= self.deviation**2
        return covariances

    @classmethod
    def fitted(cls, points: FloatArray, values: FloatArray, *, twice_nu: int) -> Self:
        """Return the covariance of greatest marginal likelihood on a grid of lengths and shares of noise.

        Args:
            points: Shape ``(n, k)``; the first 300 are used.
            values: Values of a function with mean 0, not all 0, shape ``(n,)``.
            twice_nu: Roughness of the function.
        """
        points, values = points[:_FITTED], values[:_FITTED]
        best, most = cls(twice_nu=twice_nu, length=_LENGTHS[0], deviation=1.0, noise=0.1), -math.inf
        for length in _LENGTHS:
            shape = cls(twice_nu=twice_nu, length=length, deviation=1.0, noise=0.0)
            correlation = shape.correlation(points, points)
            for noise in _NOISES:
                factor = _factor(correlation.copy(), noise)
                variance = float(np.square(_solved(factor, values)).mean())
                likelihood = -0.5 * len(values) * math.log(variance) - float(np.log(np.diag(factor)).sum())
                if likelihood > most:
                    deviation = math.sqrt(variance)
                    best = replace(shape, deviation=deviation, noise=deviation * math.sqrt(noise))
                    most = likelihood
        return best


@dataclass(slots=True, kw_only=True)
class Posterior:
    """What is known of a function at some points, while further ones are chosen among them.

    Attributes:
        mean: Expected values, shape ``(n,)``.
        variance: Variances, those still to be reduced by what is being simulated included, shape ``(n,)``.
    """

    mean: FloatArray
    variance: FloatArray
    _covariance: Covariance
    _points: FloatArray
    _explained: FloatArray
    _chosen: list[FloatArray] = field(default_factory=list)

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations, shape ``(n,)``."""
        return np.sqrt(self.variance)

    def choose(self, place: int) -> None:
        """Reduce the variances as if the function were known at a point; the expected values stay the same."""
        here = self._points[place : place + 1]
        shared = self._covariance.between(here, self._points)[0]
        shared -= self._explained[:, place] @ self._explained
        for earlier in self._chosen:
            shared -= earlier[place] * earlier
        part = shared / math.sqrt(max(shared[place], 0.0) + self._covariance.noise**2 + _JITTER)
        self._chosen.append(part)
        self.variance = np.maximum(self.variance - part * part, 0.0)


def posterior(
    covariance: Covariance, known: FloatArray, values: FloatArray, waiting: FloatArray, points: FloatArray
) -> Posterior:
    """Return what is known of a function with mean 0 at some points.

    Args:
        covariance: Covariance of the function.
        known: Where its values are known, with noise, shape ``(k, c)``.
        values: The values, shape ``(k,)``.
        waiting: Where its values will be known soon: they reduce the variance, not the mean, shape ``(w, c)``.
        points: Where to look, shape ``(n, c)``.
    """
    everything = np.concatenate([known, waiting])
    variance = np.full(len(points), covariance.deviation**2)
    if not len(everything):
        explained = np.zeros((0, len(points)))
        mean = np.zeros(len(points))
    else:
        factor = _factor(covariance.between(everything, everything), covariance.noise**2)
        explained = _solved(factor, covariance.between(everything, points))
        first = len(known)
        mean = explained[:first].T @ _solved(factor[:first, :first], values)
        variance = np.maximum(variance - np.square(explained).sum(axis=0), 0.0)
    return Posterior(
        mean=mean, variance=variance, _covariance=covariance, _points=points, _explained=explained
    )


def _factor(covariance: FloatArray, noise: float) -> FloatArray:
    """Return the lower Cholesky factor of a covariance with noise on its diagonal; overwrites the covariance."""
    from scipy.linalg import cholesky  # slow to import

    covariance.flat[:: len(covariance) + 1] += noise + _JITTER * float(covariance[0, 0])
    factor: FloatArray = cholesky(covariance.T, lower=True, overwrite_a=True, check_finite=False)
    return factor


def _solved(factor: FloatArray, values: FloatArray) -> FloatArray:
    from scipy.linalg import solve_triangular  # slow to import

    solution: FloatArray = solve_triangular(factor, values, lower=True, check_finite=False)
    return solution

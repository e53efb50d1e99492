"""Unsafe probability from the simulated solutions around a solution: kernel regression with a weight per parameter.

Every evaluated solution has a weight that falls with its distance, exp(-sum of w_j d_j) over the parameters j. d_j is
the difference of two numbers as a share of their range, or 1 for different categories; w_j >= 0 is the weight of the
parameter. The weights are chosen to minimise the mean log loss when each solution is predicted from those unlike it
(`brink.search.analysis.folds`); most become 0. With n the sum of weights and k that of the unsafe solutions, the
unsafe probability is (k + m) / (n + 1); the overall unsafe share m has the weight of one evaluation. The interval is
Wilson's for k of n: where few solutions were simulated, n is small and the interval wide.

Source: Wilson 1927; kernel regression (Nadaraya 1964, Watson 1964).
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brink.search.analysis.folds import kinds_of_solutions
from brink.search.deadline import check_time
from brink.search.space import BoolArray, FloatArray, SearchSpace, frozen_array

LEVELS: Final = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Weights tried for each parameter."""
_START: Final = LEVELS.index(1.0)
MAX_PREDICTED: Final = 1_000
"""Maximum number of solutions, drawn at random, whose predictions determine the weights."""
MAX_LEARNED: Final = 3_000
"""Maximum number of solutions, drawn at random, that predict those; a fitted model uses all solutions."""
MAX_SWEEPS: Final = 4
BLOCK_PAIRS: Final = 1 << 20
"""Maximum number of pairs of solutions compared at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Neighbours:
    """Simulated solutions and parameter weights.

    Attributes:
        space: Space of the complete solutions, without constraints.
        weights: Weight of each parameter, >= 0, shape ``(d,)``.
        vectors: Simulated solutions, shape ``(n, d)``.
        unsafe: Their verdicts, shape ``(n,)``.
    """

    space: SearchSpace
    weights: FloatArray
    vectors: FloatArray
    unsafe: BoolArray
    _scales: FloatArray
    _numbers: FloatArray

    @classmethod
    def of(cls, space: SearchSpace, weights: ArrayLike, vectors: FloatArray, unsafe: BoolArray) -> Self:
        """Return a model with the given weights.

        Args:
            space: Space of the complete solutions.
            weights: Weight of each parameter, >= 0, shape ``(d,)``.
            vectors: Simulated solutions, shape ``(n, d)``, n >= 1.
            unsafe: Their verdicts, shape ``(n,)``.

        Raises:
            ValueError: A weight is negative or missing.
        """
        given = frozen_array(weights)
        if given.shape != (space.dimension,) or not (np.isfinite(given).all() and (given >= 0).all()):
            raise ValueError(f"expected {space.dimension} weights >= 0, got {given.tolist()}")
        scales = np.where(space.categorical, 0.0, given / space.ranges)
        return cls(
            space=space,
            weights=given,
            vectors=vectors,
            unsafe=unsafe,
            _scales=frozen_array(scales),
            _numbers=frozen_array(_scaled(vectors, scales)),
        )

    @classmethod
    def fitted(
        cls, space: SearchSpace, vectors: FloatArray, unsafe: BoolArray, rng: np.random.Generator
    ) -> Self:
        """Return the model with the weights that predict the simulated solutions best.

        Args:
            space: Space of the complete solutions.
            vectors: Simulated solutions, shape ``(n, d)``, n >= 2.
            unsafe: Their verdicts, shape ``(n,)``.
            rng: Draws the solutions that the weights are chosen with, if there are many.
        """
        return cls.of(space, _best_weights(space, vectors, unsafe, rng), vectors, unsafe)

    def estimate(self, rows: FloatArray, z: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return unsafe probabilities, lower and upper limits, and the total weights, each of shape ``(m,)``.

        Args:
            rows: Complete solutions, shape ``(m, d)``.
            z: Quantile of the standard normal for the interval, > 0.
        """
        n, k = np.zeros(len(rows)), np.zeros(len(rows))
        step = max(1, BLOCK_PAIRS // len(self.vectors))
        for first in range(0, len(rows), step):
            check_time()
            part = slice(first, first + step)
            kernel = self._kernel(rows[part])
            n[part] = kernel.sum(axis=1)
            k[part] = kernel @ self.unsafe
        probability = (k + float(self.unsafe.mean())) / (n + 1.0)
        # Wilson's interval for fractional counts; without any evaluation it is [0, 1].
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(n > 0, k / n, 0.5)
            g = z**2 / n
            centre = np.where(n > 0, (share + g / 2) / (1 + g), 0.5)
            half = np.where(n > 0, z / (1 + g) * np.sqrt(share * (1 - share) / n + g / (4 * n)), 0.5)
        # Tiny counts overflow g; their interval is [0, 1] as well.
        finite = np.isfinite(centre) & np.isfinite(half)
        low = np.where(finite, np.clip(centre - half, 0.0, 1.0), 0.0)
        high = np.where(finite, np.clip(centre + half, 0.0, 1.0), 1.0)
        return probability, low, high, n

    def _kernel(self, rows: FloatArray) -> FloatArray:
        """Return the weight of each evaluated solution for each row, shape ``(m, n)``."""
        from scipy.spatial.distance import cdist  # slow to import

        exponent = cdist(_scaled(rows, self._scales), self._numbers, "cityblock")
        for column in np.flatnonzero(self.space.categorical & (self.weights > 0)):
            exponent += self.weights[column] * (rows[:, column, None] != self.vectors[None, :, column])
        kernel: FloatArray = np.exp(-exponent)
        return kernel


def _scaled(rows: FloatArray, scales: FloatArray) -> FloatArray:
    """Return the numbers with a positive weight, scaled so that their differences sum to the exponent."""
    used = scales > 0
    return np.ascontiguousarray(rows[:, used] * scales[used]) if used.any() else np.zeros((len(rows), 1))


def _best_weights(
    space: SearchSpace, vectors: FloatArray, unsafe: BoolArray, rng: np.random.Generator
) -> FloatArray:
    """Return the weights with the smallest mean log loss when each solution is predicted from those unlike it.

    Coordinate descent: one parameter after the other until nothing changes. On ties the smallest weight wins, so
    that parameters without an effect are left out.
    """
    learned = np.sort(rng.permutation(len(vectors))[:MAX_LEARNED])
    rows, truth = vectors[learned], unsafe[learned]
    predicted = np.sort(rng.permutation(len(rows))[:MAX_PREDICTED])
    alike = np.zeros((predicted.size, len(rows)), np.bool_)
    for kind in kinds_of_solutions(space, rows, rng):
        alike |= kind[predicted, None] == kind[None, :]
    counts, share = truth.astype(np.float32), float(unsafe.mean())

    def difference(column: int) -> NDArray[np.float32]:
        apart = np.abs(rows[predicted, column, None] - rows[None, :, column])
        apart = apart != 0 if space.categorical[column] else apart / space.ranges[column]
        shares: NDArray[np.float32] = apart.astype(np.float32)
        return shares

    def loss(exponent: NDArray[np.float32]) -> float:
        check_time()
        kernel = np.exp(-exponent)
        kernel[alike] = 0.0
        risk = (kernel @ counts + share) / (kernel.sum(axis=1) + 1.0)
        risk = np.clip(risk.astype(np.float64), 1e-6, 1 - 1e-6)
        return -float(np.mean(np.where(truth[predicted], np.log(risk), np.log1p(-risk))))

    levels = np.full(space.dimension, _START)
    exponent = np.zeros((predicted.size, len(rows)), np.float32)
    for column in range(space.dimension):
        exponent += np.float32(LEVELS[_START]) * difference(column)
    for _ in range(MAX_SWEEPS):
        before = levels.copy()
        for column in range(space.dimension):
            apart = difference(column)
            others = exponent - np.float32(LEVELS[levels[column]]) * apart
            losses = [loss(others + np.float32(level) * apart) for level in LEVELS]
            levels[column] = int(np.argmin(losses))
            exponent = others + np.float32(LEVELS[levels[column]]) * apart
        if (levels == before).all():
            break
    weights: FloatArray = np.array(LEVELS)[levels]
    return weights

"""Finding unsafe solutions where they are rare: a surrogate of the robustness proposes where it may be lowest.

The surrogate is a forest of extremely randomised trees on the ranks of robustness, so that the scale of robustness
does not matter. While nothing is unsafe, the lowest ranks are the level that the next proposals begin from, as in
subset simulation; once something is, they begin from all unsafe solutions. Of the proposals, drawn at random and by
changing parts of those solutions, those are chosen whose lower confidence bound is lowest, far from each other and
from what is unsafe already.

Sources: Geurts, Ernst and Wehenkel 2006 (trees); Au and Beck 2001 (subset simulation); Srinivas et al. 2010
(confidence bounds). Needs scikit-learn, as `brink.search.surrogate` does.
"""

from functools import cached_property
from typing import Any, Final

import numpy as np

from brink.search.features import Features
from brink.search.metric import Metric
from brink.search.space import BoolArray, FloatArray, SearchSpace
from brink.search.surrogate import grown_trees

TREES: Final = 40
LEAF: Final = 2
"""Minimum number of solutions in a leaf."""
FEATURES: Final = "sqrt"
"""How many features each split chooses among: the square root of their number. Robustness depends on few of many, and
trees that differ more rank it better; with all features, trees also take almost three times as long to grow."""
POOL: Final = 300
"""Proposals from which those of a generation are chosen, at least."""
LEVEL: Final = 0.1
"""Share of the solutions, those with the lowest robustness, that proposals begin from while nothing is unsafe."""
LEAST_PARENTS: Final = 5
CONFIDENCE: Final = 1.0
"""Standard deviations between the mean and the lower bound."""
_BEST: Final = 0.2
"""Share of the pool from which solutions far from each other are chosen."""
_STEP: Final = 0.1
"""Standard deviation of a shifted number, as a share of its range."""
_REDRAWN: Final = (0.1, 0.5)
"""Smallest and largest share of the numbers and categories that a proposal draws again."""


class RobustnessSurrogate:
    """Estimates the rank of the robustness of a solution: below 0 if it is probably unsafe.

    Args:
        space: Space of the solutions.
        rows: Simulated solutions, shape ``(n, d)``.
        robustness: Their distances to violation, shape ``(n,)``.
        unsafe: Which count as unsafe, shape ``(n,)``.
        seed: Seed of the trees, below 2**32.

    Attributes:
        size: Number of solutions that it has learnt from.
    """

    def __init__(
        self, space: SearchSpace, rows: FloatArray, robustness: FloatArray, unsafe: BoolArray, *, seed: int
    ) -> None:
        self.size = len(rows)
        self._features = Features.of_space(space)
        self._rows, self._margins, self._seed = rows, margins(robustness, unsafe), seed

    @cached_property
    def _trees(self) -> list[Any]:
        """The trees of scikit-learn, which grow when they are first asked."""
        # scikit-learn takes a second to load, and is needed by few searches.
        from sklearn.tree import ExtraTreeRegressor

        orders = self._features.in_every_order(self._rows)
        grown = grown_trees(
            lambda state: ExtraTreeRegressor(
                min_samples_leaf=LEAF, max_features=FEATURES, random_state=state
            ),
            orders.reshape(-1, orders.shape[-1]),
            np.tile(self._margins, len(orders)),
            count=TREES,
            seed=self._seed,
        )
        # Without the checks around each call, which take longer than most predictions.
        return [tree.tree_ for tree in grown]

    def predict(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the means and standard deviations over the trees, both of shape ``(n,)``.

        Args:
            rows: Solutions, shape ``(n, d)``.
        """
        features = self._features.of_rows(rows)
        trees = np.array([tree.predict(features)[:, 0] for tree in self._trees])
        return trees.mean(axis=0), trees.std(axis=0)


def margins(robustness: FloatArray, unsafe: BoolArray) -> FloatArray:
    """Return the ranks of robustness, in (-1, 0) for unsafe and (0, 1) for other solutions, shape ``(n,)``.

    Args:
        robustness: Distances to violation, shape ``(n,)``.
        unsafe: Which solutions count as unsafe, shape ``(n,)``.
    """
    values = np.empty(len(robustness))
    for verdict, low in ((True, -1.0), (False, 0.0)):
        mine = np.flatnonzero(unsafe == verdict)
        order = np.argsort(np.argsort(robustness[mine], kind="stable"), kind="stable")
        values[mine] = low + (order + 0.5) / max(len(mine), 1)
    return values


def proposed_rows(
    space: SearchSpace,
    surrogate: RobustnessSurrogate,
    rows: FloatArray,
    robustness: FloatArray,
    unsafe: BoolArray,
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Return solutions that may be unsafe, far from each other and from unsafe ones, shape ``(at most count, d)``.

    Args:
        space: The space.
        surrogate: Estimates their robustness.
        rows: Simulated solutions, shape ``(n, d)``.
        robustness: Their distances to violation, shape ``(n,)``.
        unsafe: Which count as unsafe, shape ``(n,)``.
        count: Number of proposals.
        rng: Source of all randomness.
    """
    # They are judged before constraints repair them, which takes longer than to judge them.
    pool = _pool(space, parents(robustness, unsafe, rows), max(POOL, 8 * count), rng)
    mean, deviation = surrogate.predict(pool)
    best = np.argsort(mean - CONFIDENCE * deviation, kind="stable")
    best = best[: max(count, min(3 * count, round(_BEST * len(pool))))]
    chosen = [0]
    metric = Metric.of_space(space)
    candidates = np.array([space.join(space.repair(space.split(pool[place]), rng)) for place in best])
    apart = metric.between(candidates, np.concatenate([rows[unsafe], candidates[:1]])).min(axis=1)
    while len(chosen) < min(count, len(candidates)):
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, metric.between(candidates, candidates[chosen[-1:]])[:, 0])
    return np.asarray(candidates[chosen])


def parents(robustness: FloatArray, unsafe: BoolArray, rows: FloatArray) -> FloatArray:
    """Return the solutions that proposals begin from: unsafe ones, or the lowest level, shape ``(p, d)``.

    Args:
        robustness: Distances to violation, shape ``(n,)``.
        unsafe: Which solutions count as unsafe, shape ``(n,)``.
        rows: The solutions, shape ``(n, d)``.
    """
    least = max(LEAST_PARENTS, round(LEVEL * len(rows)))
    order = np.argsort(margins(robustness, unsafe), kind="stable")
    return np.asarray(rows[order[: max(int(unsafe.sum()), least)]])


def _pool(space: SearchSpace, parents: FloatArray, size: int, rng: np.random.Generator) -> FloatArray:
    """Return proposals before repair: a quarter drawn at random, the others near a parent.

    Of these, one half has some columns drawn again, the other all numbers shifted, but for dormant ones, which are 0.
    """
    drawn = space.draw_unrepaired(size, rng)
    changed = size * 3 // 4
    kept = parents[rng.integers(len(parents), size=changed)]
    share = rng.uniform(*_REDRAWN, (changed, 1))
    redrawn = np.where(rng.random(kept.shape) < share, drawn[:changed], kept)
    steps = _STEP * rng.standard_normal(kept.shape) * np.where(space.categorical, 0.0, space.ranges)
    is_step = rng.random((changed, 1)) < 0.5
    drawn[:changed] = np.where(is_step, kept + np.where(kept == 0.0, 0.0, steps), redrawn)
    return drawn

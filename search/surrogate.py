"""A fast estimate of the probability that a solution is unsafe: extremely randomised trees.

Needs scikit-learn, which the extra ``analysis`` installs. The monitor's trees, in
`brink.search.analysis.boosted_trees`, are more accurate and calibrated, but take many times as long to fit.

Source: Geurts, Ernst and Wehenkel 2006.
"""

import importlib.util
from typing import Final

import numpy as np

from brink.search.features import Features
from brink.search.space import BoolArray, FloatArray, SearchSpace

EXTRA: Final = "analysis"
"""The extra that installs scikit-learn."""
TREES: Final = 60
LEAF: Final = 2
"""Minimum number of solutions in a leaf."""


def is_available() -> bool:
    """Return whether scikit-learn is installed."""
    return importlib.util.find_spec("sklearn") is not None


class Surrogate:
    """Estimates the probability that a solution is unsafe.

    Args:
        space: Space of the solutions.
        rows: Simulated solutions, shape ``(n, d)``.
        unsafe: Their verdicts, both kinds present, shape ``(n,)``.
        seed: Seed of the trees, below 2**32.

    Attributes:
        size: Number of solutions that it has learnt from.
    """

    def __init__(self, space: SearchSpace, rows: FloatArray, unsafe: BoolArray, *, seed: int) -> None:
        # scikit-learn takes a second to load, and is needed by this search only.
        from sklearn.ensemble import ExtraTreesClassifier

        self.size = len(rows)
        self._features = Features.of_space(space)
        orders = self._features.in_every_order(rows)
        x, y = orders.reshape(-1, orders.shape[-1]), np.tile(unsafe, len(orders))
        self._trees = ExtraTreesClassifier(TREES, min_samples_leaf=LEAF, random_state=seed, n_jobs=1)
        self._trees.fit(x, y)

    def unsafe(self, rows: FloatArray) -> FloatArray:
        """Return the probabilities of rows of shape ``(n, d)``, shape ``(n,)``, judged in their given order."""
        if not len(rows):
            return np.empty(0)
        features = self._features.of_rows(rows)
        # One tree after another takes half the time of the forest's own loop, which prepares for threads.
        trees = self._trees.estimators_
        total = np.zeros(len(rows))
        for tree in trees:
            total += tree.predict_proba(features, check_input=False)[:, 1]
        return total / len(trees)

"""A fast estimate of the probability that a solution is unsafe: extremely randomised trees.

Needs scikit-learn, which the extra ``analysis`` installs. The monitor's trees, in
`brink.search.analysis.boosted_trees`, are more accurate and calibrated, but take many times as long to fit.

Source: Geurts, Ernst and Wehenkel 2006.
"""

import importlib.util
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np

from brink.search.features import FeatureArray, Features
from brink.search.space import BoolArray, FloatArray, SearchSpace

EXTRA: Final = "analysis"
"""The extra that installs scikit-learn."""
TREES: Final = 60
LEAF: Final = 2
"""Minimum number of solutions in a leaf."""


def is_available() -> bool:
    """Return whether scikit-learn is installed."""
    return importlib.util.find_spec("sklearn") is not None


def learning_size(solutions: int, one_in: int) -> int:
    """Return how many solutions a model has learnt from that learns anew whenever there are so many more.

    Args:
        solutions: Number of solutions so far.
        one_in: One more for each of so many solutions, and at least one.
    """
    size = 1
    while (larger := size + max(1, size // one_in)) <= solutions:
        size = larger
    return size


def grown_trees(make: Callable[[int], Any], x: FeatureArray, y: Any, *, count: int, seed: int) -> list[Any]:
    """Return the trees that scikit-learn's forest grows from the same seed, without what it does around each of them.

    Copying a tree with its settings, and checking both, takes longer than to grow it from a few hundred solutions.

    Args:
        make: Returns a tree of scikit-learn with a given `random_state`.
        x: Features, shape ``(n, f)``.
        y: What to predict, shape ``(n,)``.
        count: Number of trees.
        seed: Seed of the trees, below 2**32.
    """
    from sklearn import config_context

    states = np.random.RandomState(seed).randint(np.iinfo(np.int32).max, size=count)
    values = np.asarray(y, np.float64)[:, None]
    with config_context(skip_parameter_validation=True):
        return [make(int(state)).fit(x, values, check_input=False) for state in states]


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
        # scikit-learn takes a second to load, and is needed by few searches.
        from sklearn.tree import ExtraTreeClassifier

        self.size = len(rows)
        self._features = Features.of_space(space)
        orders = self._features.in_every_order(rows)
        x, y = orders.reshape(-1, orders.shape[-1]), np.tile(unsafe, len(orders))
        self._trees = grown_trees(
            lambda state: ExtraTreeClassifier(min_samples_leaf=LEAF, random_state=state),
            x,
            y,
            count=TREES,
            seed=seed,
        )

    def unsafe(self, rows: FloatArray) -> FloatArray:
        """Return the probabilities of rows of shape ``(n, d)``, shape ``(n,)``, judged in their given order."""
        total = np.zeros(len(rows))
        for probabilities in self._by_tree(rows):
            total += probabilities
        return total / len(self._trees)

    def unsafe_and_deviation(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the probabilities of rows of shape ``(n, d)``, and their standard deviations over the trees.

        Returns:
            Both of shape ``(n,)``; the probabilities are those of `unsafe`.
        """
        if not len(rows):
            return np.empty(0), np.empty(0)
        by_tree = np.array(list(self._by_tree(rows)))
        return by_tree.mean(axis=0), by_tree.std(axis=0)

    def _by_tree(self, rows: FloatArray) -> Iterator[FloatArray]:
        """Yield the probabilities that each tree gives; none without rows."""
        if not len(rows):
            return
        features = self._features.of_rows(rows)
        # One tree after another takes half the time of a forest's loop, which prepares for threads.
        for tree in self._trees:
            yield tree.predict_proba(features, check_input=False)[:, 1]

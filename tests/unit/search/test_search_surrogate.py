"""Models of the verdict and of robustness that searches fit as they go."""

import numpy as np
import pytest
from sklearn.ensemble import ExtraTreesClassifier, ExtraTreesRegressor
from sklearn.tree import ExtraTreeClassifier, ExtraTreeRegressor

from brink.search.exploration import RobustnessSurrogate
from brink.search.space import Component, FloatArray, Real, SearchSpace
from brink.search.surrogate import grown_trees


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1])
def test_trees_are_those_of_a_forest_with_the_same_seed(seed: int) -> None:
    rng = np.random.default_rng(1)
    x, unsafe, robustness = rng.random((80, 9)).astype(np.float32), rng.random(80) < 0.3, rng.random(80)
    ours = grown_trees(
        lambda state: ExtraTreeClassifier(min_samples_leaf=2, random_state=state),
        x,
        unsafe,
        count=5,
        seed=seed,
    )
    theirs = ExtraTreesClassifier(5, min_samples_leaf=2, random_state=seed).fit(x, unsafe)
    for one, other in zip(ours, theirs.estimators_, strict=True):
        assert (one.predict_proba(x) == other.predict_proba(x)).all()
    ours = grown_trees(
        lambda state: ExtraTreeRegressor(max_features="sqrt", random_state=state),
        x,
        robustness,
        count=5,
        seed=seed,
    )
    theirs = ExtraTreesRegressor(5, max_features="sqrt", random_state=seed).fit(x, robustness)
    for one, other in zip(ours, theirs.estimators_, strict=True):
        assert (one.predict(x) == other.predict(x)).all()


def test_robustness_that_depends_on_few_of_many_numbers_is_ranked() -> None:
    space = SearchSpace((Component("a", tuple(Real(f"x{place}", 0.0, 1.0) for place in range(40))),))
    rng = np.random.default_rng(2)
    rows, fresh = rng.random((300, 40)), rng.random((300, 40))

    def robustness(some: FloatArray) -> FloatArray:
        return np.asarray(some[:, 3] + some[:, 11] - 0.4)

    fitted = RobustnessSurrogate(space, rows, robustness(rows), robustness(rows) < 0, seed=1)
    mean, deviation = fitted.predict(fresh)
    unsafe = robustness(fresh) < 0
    assert (mean[unsafe][:, None] < mean[~unsafe]).mean() > 0.85
    assert (deviation > 0).all()

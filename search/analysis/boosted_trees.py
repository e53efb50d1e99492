"""Unsafe probability from gradient-boosted trees, calibrated on drives that each tree did not see.

A model is scikit-learn's histogram gradient boosting on `brink.search.features`, fitted to every solution in all its
equivalent orders; its score is the mean over the orders, in log odds. One model is fitted to all simulated solutions,
and gives the score of a new one. Ten more are fitted without one tenth each. `brink.search.analysis.folds` divides
the solutions so that no model scores a solution that is nearly one of its own.

Every simulated solution has a score by a model that saw nothing like it. These out-of-fold scores and the verdicts
calibrate the probability: a logistic regression on the score (Platt). Both are scores of single models, so that what
is calibrated is what is used: the mean of several models varies less, and needs another slope. The limits of the
interval are those of the score plus and minus z standard errors. The error covers two uncertainties: how much the
score would change with other simulations (the delete-a-group jackknife) and the error of the calibration. Both take
solutions that are alike as dependent.

Only fitting needs scikit-learn (extra `analysis`). The trees are kept as arrays (`brink.forest`), and NumPy alone
evaluates them.

Source: Friedman 2001 (gradient boosting); Platt 1999 (calibration, with his smoothed targets); Efron and Stein 1981,
Shao and Wu 1989 (the jackknife).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Final, Self

import numpy as np

from brink.extras import install_command
from brink.forest import Forest
from brink.search.analysis.choices import LEAST_OF_A_VERDICT
from brink.search.analysis.folds import Division, connected, divisions, kinds_of_solutions
from brink.search.analysis.intervals import clustered
from brink.search.deadline import check_time
from brink.search.errors import MissingExtra
from brink.search.features import FeatureArray, Features
from brink.search.space import BoolArray, FloatArray, IntArray, frozen_array

FOLDS: Final = (10, 5, 3)
"""Candidate numbers of folds; the first feasible one is used."""
TREES: Final = 100
"""Number of trees of each model."""
SHRINKAGE: Final = 5.0
"""L2 penalty on the values of leaves; chosen by cross-validation, with which calibration has a slope near 1."""
_TOLERANCE: Final = 1e-6
_CHECKED: Final = 200
"""Number of solutions on which the exported trees are compared with scikit-learn's."""


def is_installed() -> bool:
    """Return whether scikit-learn, which fitting needs, is installed."""
    return find_spec("sklearn") is not None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoostedTrees:
    """Trees and the calibration of their scores.

    Attributes:
        features: Turns solutions into features.
        forest: The trees of the models without some of the solutions, then those of the model of all of them.
        calibration: Intercept and slope that turn a score into calibrated log odds, shape ``(2,)``.
        covariance: Covariance of intercept and slope, shape ``(2, 2)``.
        inflation: Variance of the score as a multiple of that of the models without some of the solutions.
    """

    features: Features
    forest: Forest
    calibration: FloatArray
    covariance: FloatArray
    inflation: float

    @classmethod
    def fitted(
        cls, features: Features, vectors: FloatArray, unsafe: BoolArray, rng: np.random.Generator
    ) -> Self:
        """Return trees fitted to simulated solutions.

        Args:
            features: Features of the solutions' space.
            vectors: Simulated solutions, shape ``(n, d)``.
            unsafe: Their verdicts, shape ``(n,)``.
            rng: Divides the solutions into folds.

        Raises:
            MissingExtra: scikit-learn is not installed.
            OutOfTime: The `time_limit` around it is up.
            ValueError: There are too few solutions of a verdict, or too few different solutions.
        """
        if not is_installed():
            raise MissingExtra(
                f"fitting trees needs scikit-learn, which is not installed: {install_command('analysis')}"
            )
        fewest = int(min(unsafe.sum(), (~unsafe).sum()))
        if fewest < LEAST_OF_A_VERDICT:
            raise ValueError(
                f"expected at least {LEAST_OF_A_VERDICT} safe and {LEAST_OF_A_VERDICT} unsafe solutions for trees, "
                f"got {int((~unsafe).sum())} and {int(unsafe.sum())}"
            )
        kinds = kinds_of_solutions(features.space, vectors, rng)
        parts = divisions(kinds, unsafe, rng, FOLDS)
        if not parts:
            raise ValueError(
                f"expected at least {FOLDS[-1]} solutions unlike each other, with both verdicts outside every fold; "
                f"got {np.unique(connected(kinds)).size} unlike each other"
            )
        forest, unseen = _grown(features.in_every_order(vectors), unsafe, parts)
        calibration = calibrated(unseen, unsafe)
        left_out = 1.0 - float(np.mean([part.fitted.mean() for part in parts]))
        return cls(
            features=features,
            forest=forest,
            calibration=calibration,
            covariance=_covariance(calibration, unseen, unsafe, kinds),
            inflation=(1.0 - left_out) / left_out,
        )

    @classmethod
    def of(cls, features: Features, document: Mapping[str, Any]) -> Self:
        """Return the trees of a document written by `to_document`.

        Args:
            features: The features that the trees were fitted to.
            document: The document.

        Raises:
            KeyError: Something is missing.
            TypeError: Something has another type.
            ValueError: A shape or a value is wrong.
        """
        calibration = frozen_array(document["calibration"])
        covariance = frozen_array(document["covariance"])
        if calibration.shape != (2,) or covariance.shape != (2, 2) or not (covariance == covariance.T).all():
            raise ValueError(
                "expected intercept and slope with a symmetric covariance, "
                f"got {calibration.tolist()} and {covariance.tolist()}"
            )
        finite = np.isfinite(calibration).all() and np.isfinite(covariance).all()
        if not finite or calibration[1] < 0 or (np.linalg.eigvalsh(covariance) < -_TOLERANCE).any():
            raise ValueError(
                f"expected a slope >= 0 and a covariance, got {calibration.tolist()}, {covariance.tolist()}"
            )
        inflation = float(document["inflation"])
        forest = Forest.of(document["forest"], len(features.names()))
        if not (0 < inflation < np.inf and forest.offsets.size > 1):
            raise ValueError(
                f"expected several models and an inflation > 0, got {forest.offsets.size}, {inflation}"
            )
        return cls(
            features=features,
            forest=forest,
            calibration=calibration,
            covariance=covariance,
            inflation=inflation,
        )

    def to_document(self) -> dict[str, Any]:
        """Return the model as a JSON object."""
        return {
            "calibration": self.calibration.tolist(),
            "covariance": self.covariance.tolist(),
            "forest": self.forest.to_document(),
            "inflation": self.inflation,
        }

    def estimate(self, rows: FloatArray, z: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return unsafe probabilities and the lower and upper limits of their intervals, each of shape ``(m,)``.

        Args:
            rows: Complete solutions, shape ``(m, d)``.
            z: Quantile of the standard normal for the interval, > 0.
        """
        shown = self.features.in_every_order(rows)
        orders, count, width = shown.shape
        scores = self.forest.scores(shown.reshape(-1, width)).reshape(orders, count, -1).mean(axis=0)
        score, of_score = scores[:, -1], self.inflation * scores[:, :-1].var(axis=1)
        terms = np.stack([np.ones_like(score), score])
        of_calibration = np.einsum("im,ij,jm->m", terms, self.covariance, terms)
        error = np.sqrt(self.calibration[1] ** 2 * of_score + np.maximum(of_calibration, 0.0))
        middle = self.calibration @ terms
        return _expit(middle), _expit(middle - z * error), _expit(middle + z * error)


def _expit(log_odds: FloatArray) -> FloatArray:
    from scipy.special import expit  # slow to import

    probability: FloatArray = expit(log_odds)
    return probability


def _grown(shown: FeatureArray, unsafe: BoolArray, parts: Sequence[Division]) -> tuple[Forest, FloatArray]:
    """Fit a model to each part, and one to everything.

    Args:
        shown: Features in every order, shape ``(orders, n, features)``.
        unsafe: Verdicts, shape ``(n,)``.
        parts: Divisions, which together score each solution once.

    Returns:
        The trees, those of everything last, and the score of each solution by the model that did not see it, shape
        ``(n,)``.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier  # optional, and slow to import
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    every = np.ones(len(unsafe), np.bool_)
    models, unseen = [], np.empty(len(unsafe))
    # More threads cost more than they save at this size, and much more on a busy machine.
    with threadpool_limits(limits=1):
        for part in (*parts, Division(fitted=every, scored=~every)):
            check_time()
            model = HistGradientBoostingClassifier(
                max_iter=TREES, l2_regularization=SHRINKAGE, early_stopping=False, random_state=0
            )
            model.fit(np.concatenate(shown[:, part.fitted]), np.tile(unsafe[part.fitted], len(shown)))
            models.append(model)
            if part.scored.any():
                unseen[part.scored] = np.mean(
                    [model.decision_function(rows) for rows in shown[:, part.scored]], axis=0
                )
        checked = shown[0, :_CHECKED]
        expected = np.stack([model.decision_function(checked) for model in models], axis=1)
    forest = forest_of(models, shown.shape[2])
    if not np.allclose(forest.scores(checked), expected, atol=_TOLERANCE):
        raise RuntimeError("this version of scikit-learn stores its trees in a way that Brink cannot read")
    return forest, unseen


def forest_of(models: Sequence[Any], features: int) -> Forest:
    """Return the trees of scikit-learn's models as arrays."""
    # scikit-learn has no public access to these trees; _grown compares what is read here with its own predictions.
    right, feature, value, roots, owners = [], [], [], [], []
    total = 0
    for owner, model in enumerate(models):
        for (tree,) in model._predictors:
            nodes = tree.nodes
            leaf = nodes["is_leaf"].astype(bool)
            if not (nodes["left"][~leaf] == np.flatnonzero(~leaf) + 1).all():
                raise RuntimeError(
                    "this version of scikit-learn orders its trees in a way that Brink cannot read"
                )
            right.append(np.where(leaf, 0, nodes["right"].astype(np.int64) + total))
            feature.append(np.where(leaf, 0, nodes["feature_idx"].astype(np.int64)))
            value.append(np.where(leaf, nodes["value"], nodes["num_threshold"]))
            roots.append(total)
            owners.append(owner)
            total += len(nodes)
    document = {
        "right": np.concatenate(right),
        "feature": np.concatenate(feature),
        "value": np.concatenate(value),
        "roots": roots,
        "owners": owners,
        "offsets": [float(model._baseline_prediction.ravel()[0]) for model in models],
    }
    return Forest.of(document, features)


def calibrated(score: FloatArray, unsafe: BoolArray) -> FloatArray:
    """Return intercept and slope of the log odds of being unsafe, shape ``(2,)``.

    Args:
        score: Out-of-fold scores, shape ``(n,)``.
        unsafe: Verdicts, shape ``(n,)``, both kinds present.
    """
    from scipy.optimize import minimize  # slow to import

    target, terms = _targets(unsafe), np.stack([np.ones_like(score), score])

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        log_odds = w @ terms
        gradient: FloatArray = terms @ (_expit(log_odds) - target)
        return float(np.sum(np.logaddexp(0.0, log_odds) - target * log_odds)), gradient

    # A negative slope would mean that the trees are worse than guessing; then only the intercept is kept.
    fit = minimize(loss, np.array([0.0, 1.0]), jac=True, bounds=[(None, None), (0.0, None)])
    return frozen_array(fit.x)


def _targets(unsafe: BoolArray) -> FloatArray:
    """Return Platt's targets: with them, estimates are finite even if the scores separate the verdicts."""
    hazards, harmless = int(unsafe.sum()), int((~unsafe).sum())
    return np.where(unsafe, (hazards + 1) / (hazards + 2), 1 / (harmless + 2))


def _covariance(
    calibration: FloatArray, score: FloatArray, unsafe: BoolArray, kinds: Sequence[IntArray]
) -> FloatArray:
    """Return the covariance of intercept and slope, shape ``(2, 2)``, where solutions of a kind are dependent.

    It is at least that of independent solutions.
    """
    terms = np.stack([np.ones_like(score), score])
    risk = _expit(calibration @ terms)
    independent = np.linalg.pinv((terms * (risk * (1 - risk))) @ terms.T)
    dependent = independent @ clustered((terms * (_targets(unsafe) - risk)).T, kinds) @ independent
    more = max(1.0, float(np.trace(dependent) / np.trace(independent)))
    return frozen_array(0.5 * more * (independent + independent.T))

"""Unsafe probability from gradient-boosted trees, calibrated on drives that each tree did not see.

The simulated solutions are divided into ten folds, and ten models are fitted, each without one fold. A model is
scikit-learn's histogram gradient boosting on `brink.search.features`, fitted to every solution in all its equivalent
orders; its score is the mean over the orders, in log odds. The score of a new solution is the mean of the ten.

Every simulated solution has a score by the one model that did not see it. These out-of-fold scores and the verdicts
calibrate the probability: a logistic regression on the score (Platt). The limits of the interval are those of the
score plus and minus z standard errors. The error covers two uncertainties: how much the score would change with
other simulations (the delete-a-group jackknife over the ten models) and the error of the calibration.

Only fitting needs scikit-learn (extra `analysis`). The trees are kept as arrays (`brink.forest`), and NumPy alone
evaluates them.

Source: Friedman 2001 (gradient boosting); Platt 1999 (calibration, with his smoothed targets); Efron and Stein 1981
(the jackknife).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Final, Self

import numpy as np

from brink.extras import install_command
from brink.forest import Forest
from brink.search.errors import MissingExtra
from brink.search.features import FeatureArray, Features
from brink.search.space import BoolArray, FloatArray, IntArray, frozen_array

FOLDS: Final = 10
TREES: Final = 100
"""Number of trees of each model."""
SHRINKAGE: Final = 5.0
"""L2 penalty on the values of leaves; chosen by cross-validation, with which calibration has a slope near 1."""
LEAST_OF_A_VERDICT: Final = 10
"""Fewest solutions of each verdict to which trees are fitted."""
_TOLERANCE: Final = 1e-6


def is_installed() -> bool:
    """Return whether scikit-learn, which fitting needs, is installed."""
    return find_spec("sklearn") is not None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoostedTrees:
    """Trees and the calibration of their scores.

    Attributes:
        features: Turns solutions into features.
        forest: The trees of all models.
        calibration: Intercept and slope that turn a score into calibrated log odds, shape ``(2,)``.
        covariance: Covariance of intercept and slope, shape ``(2, 2)``.
    """

    features: Features
    forest: Forest
    calibration: FloatArray
    covariance: FloatArray

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
        shown = features.in_every_order(vectors)
        folds = _folds(vectors, unsafe, rng)
        forest, unseen = _grown(shown, unsafe, folds)
        calibration, covariance = calibrated(unseen, unsafe)
        return cls(features=features, forest=forest, calibration=calibration, covariance=covariance)

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
        return cls(
            features=features, forest=Forest.of(document["forest"], len(features.names())),
            calibration=calibration, covariance=covariance,
        )  # fmt: skip

    def to_document(self) -> dict[str, Any]:
        """Return the model as a JSON object."""
        return {
            "calibration": self.calibration.tolist(), "covariance": self.covariance.tolist(),
            "forest": self.forest.to_document(),
        }  # fmt: skip

    def estimate(self, rows: FloatArray, z: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return unsafe probabilities and the lower and upper limits of their intervals, each of shape ``(m,)``.

        Args:
            rows: Complete solutions, shape ``(m, d)``.
            z: Quantile of the standard normal for the interval, > 0.
        """
        shown = self.features.in_every_order(rows)
        orders, count, width = shown.shape
        scores = self.forest.scores(shown.reshape(-1, width)).reshape(orders, count, -1).mean(axis=0)
        score = scores.mean(axis=1)
        models = scores.shape[1]
        of_score = (models - 1) / models * ((scores - score[:, None]) ** 2).sum(axis=1)
        terms = np.stack([np.ones_like(score), score])
        of_calibration = np.einsum("im,ij,jm->m", terms, self.covariance, terms)
        error = np.sqrt(self.calibration[1] ** 2 * of_score + np.maximum(of_calibration, 0.0))
        middle = self.calibration @ terms
        return _expit(middle), _expit(middle - z * error), _expit(middle + z * error)


def _expit(log_odds: FloatArray) -> FloatArray:
    from scipy.special import expit  # slow to import

    probability: FloatArray = expit(log_odds)
    return probability


def _folds(vectors: FloatArray, unsafe: BoolArray, rng: np.random.Generator) -> IntArray:
    """Return the fold of each solution, shape ``(n,)``: identical ones share a fold, verdicts are spread evenly.

    Raises:
        ValueError: Some verdict does not occur outside every fold.
    """
    which = np.unique(vectors, axis=0, return_inverse=True)[1].ravel()
    share = np.bincount(which, unsafe) / np.bincount(which)
    # Sorted by unsafe share, ties at random, each ten in a row go to the ten folds in random order.
    order = np.lexsort((rng.random(share.size), share))
    fold = np.empty(share.size, np.int64)
    for first in range(0, share.size, FOLDS):
        part = order[first : first + FOLDS]
        fold[part] = rng.permutation(FOLDS)[: part.size]
    folds: IntArray = fold[which]
    for one in range(FOLDS):
        others = unsafe[folds != one]
        if others.all() or not others.any() or not (folds == one).any():
            raise ValueError(
                f"expected at least {FOLDS} different solutions, with both verdicts outside every fold; "
                f"got {share.size} different solutions"
            )
    return folds


def _grown(shown: FeatureArray, unsafe: BoolArray, folds: IntArray) -> tuple[Forest, FloatArray]:
    """Fit one model without each fold.

    Args:
        shown: Features in every order, shape ``(orders, n, features)``.
        unsafe: Verdicts, shape ``(n,)``.
        folds: Fold of each solution, shape ``(n,)``.

    Returns:
        The trees, and the score of each solution by the model that did not see it, shape ``(n,)``.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier  # optional, and slow to import
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    models, expected = [], np.empty(len(unsafe))
    # More threads cost more than they save at this size, and much more on a busy machine.
    with threadpool_limits(limits=1):
        for fold in range(FOLDS):
            kept = folds != fold
            model = HistGradientBoostingClassifier(
                max_iter=TREES, l2_regularization=SHRINKAGE, early_stopping=False, random_state=0
            )
            model.fit(np.concatenate(shown[:, kept]), np.tile(unsafe[kept], len(shown)))
            models.append(model)
            left_out = shown[:, ~kept]
            expected[~kept] = np.mean([model.decision_function(part) for part in left_out], axis=0)
    forest = forest_of(models, shown.shape[2])
    unseen = np.mean([forest.scores(part)[np.arange(len(unsafe)), folds] for part in shown], axis=0)
    if not np.allclose(unseen, expected, atol=_TOLERANCE):
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
        "right": np.concatenate(right), "feature": np.concatenate(feature), "value": np.concatenate(value),
        "roots": roots, "owners": owners,
        "offsets": [float(model._baseline_prediction.ravel()[0]) for model in models],
    }  # fmt: skip
    return Forest.of(document, features)


def calibrated(score: FloatArray, unsafe: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return intercept and slope of the log odds of being unsafe, and their covariance.

    Args:
        score: Out-of-fold scores, shape ``(n,)``.
        unsafe: Verdicts, shape ``(n,)``, both kinds present.
    """
    from scipy.optimize import minimize  # slow to import

    hazards, harmless = int(unsafe.sum()), int((~unsafe).sum())
    # Platt's targets: finite estimates even if the scores separate the verdicts.
    target = np.where(unsafe, (hazards + 1) / (hazards + 2), 1 / (harmless + 2))
    terms = np.stack([np.ones_like(score), score])

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        log_odds = w @ terms
        gradient: FloatArray = terms @ (_expit(log_odds) - target)
        return float(np.sum(np.logaddexp(0.0, log_odds) - target * log_odds)), gradient

    # A negative slope would mean that the trees are worse than guessing; then only the intercept is kept.
    found = minimize(loss, np.array([0.0, 1.0]), jac=True, bounds=[(None, None), (0.0, None)])
    calibration: FloatArray = found.x
    risk = _expit(calibration @ terms)
    covariance = np.linalg.pinv((terms * (risk * (1 - risk))) @ terms.T)
    return frozen_array(calibration), frozen_array(0.5 * (covariance + covariance.T))

"""Trees of a guard: for each horizon, the probability that a violation happens within it.

The training data are the feature vectors of drives at their perception steps, up to the first violation. A step is
positive for a horizon if the violation follows within it. Negative steps far from a violation are thinned, and those
that are kept count for those left out.

Everything is divided by group of drives, never by step: neighbouring steps of a drive are almost equal, and so are
drives of the same scenario in the campaign of a search. Out-of-fold scores, by models that saw no drive of the same
group, calibrate the probabilities and choose the threshold of the alarm. The model itself is fitted to all drives.

Only fitting needs scikit-learn (extra `analysis`); the result is a `brink.forest.Forest`.

Source: Friedman 2001 (gradient boosting), Platt 1999 (calibration).
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.extras import install_command
from brink.forest import Forest
from brink.search.analysis.boosted_trees import calibrated, forest_of, is_installed
from brink.search.errors import MissingExtra
from brink.search.space import BoolArray, FloatArray, IntArray

FOLDS: Final = 3
TREES: Final = 60
"""Number of trees for each horizon."""
LEAVES: Final = 8
"""Small trees: those with 15 leaves were not more accurate, and worse calibrated on drives that they did not see."""
LEARNING_RATE: Final = 0.1
BINS: Final = 127
SHRINKAGE: Final = 5.0
LEAST_STEPS_OF_A_LEAF: Final = 100
THIN: Final = 5
"""Of the negative steps far from a violation, every fifth one is kept."""
NEAR_S: Final = 1.0
"""Steps this much earlier than the longest horizon are not thinned."""
LEAST_VIOLATIONS: Final = 10
"""Fewest drives with a violation, and without one, to which a guard is fitted."""
_TOLERANCE: Final = 1e-6

HalfArray: TypeAlias = NDArray[np.float16]
SingleArray: TypeAlias = NDArray[np.float32]
OnProgress: TypeAlias = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveSeries:
    """The feature vectors of one drive until its first violation.

    Attributes:
        features: Feature vectors, shape ``(steps, features)``.
        until_s: Time from each step to the violation; infinite if there is none. Shape ``(steps,)``.
        group: Drives of the same group are never divided.
    """

    features: HalfArray
    until_s: FloatArray
    group: Hashable

    @property
    def violated(self) -> bool:
        """Whether the drive ends in a violation."""
        return bool(np.isfinite(self.until_s).any())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedHorizons:
    """Trees for each horizon, and their calibration.

    Attributes:
        forest: The trees; one model for each horizon.
        calibration: Intercept and slope that turn a score into calibrated log odds, shape ``(horizons, 2)``.
        unseen: For each drive, out-of-fold scores in log odds, shape ``(steps, horizons)``.
    """

    forest: Forest
    calibration: FloatArray
    unseen: tuple[FloatArray, ...]


def fit_horizons(
    drives: Sequence[DriveSeries],
    horizons_s: Sequence[float],
    rng: np.random.Generator,
    on_progress: OnProgress | None = None,
) -> FittedHorizons:
    """Fit trees for each horizon.

    Args:
        drives: The drives.
        horizons_s: Horizons in seconds, ascending.
        rng: Divides the groups into folds.
        on_progress: Called with the number of fitted models and their total.

    Raises:
        MissingExtra: scikit-learn is not installed.
        ValueError: There are too few drives with or without a violation, or too few groups.
    """
    if not is_installed():
        raise MissingExtra(
            f"fitting a guard needs scikit-learn, which is not installed: {install_command('analysis')}"
        )
    folds = _folds(drives, rng)
    steps = _Steps.of(drives, folds, max(horizons_s))
    models: list[Any] = []
    unseen = [np.zeros((len(one.until_s), len(horizons_s))) for one in drives]
    done, total = 0, len(horizons_s) * (FOLDS + 1)
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    with threadpool_limits(limits=1):
        for place, horizon_s in enumerate(horizons_s):
            for fold in range(FOLDS + 1):  # the last one is the model of all drives
                model = steps.fitted(steps.fold != fold, horizon_s)
                _score(model, drives, np.flatnonzero(folds == fold), unseen, place)
                done += 1
                if on_progress is not None:
                    on_progress(done, total)
            models.append(model)
    forest = forest_of(models, steps.features.shape[1])
    _check_forest(forest, models, steps.features[:200])
    return FittedHorizons(
        forest=forest,
        calibration=np.array([
            calibrated(np.concatenate([one[:, place] for one in unseen]), _labels(drives, horizon_s))[0]
            for place, horizon_s in enumerate(horizons_s)
        ]),
        unseen=tuple(unseen),
    )  # fmt: skip


def _score(
    model: Any, drives: Sequence[DriveSeries], which: IntArray, unseen: Sequence[FloatArray], place: int
) -> None:
    """Write the scores of some drives by a model into a column of `unseen`."""
    if not which.size:
        return
    rows = np.concatenate([drives[one].features for one in which.tolist()]).astype(np.float32)
    ends = np.cumsum([len(unseen[one]) for one in which.tolist()])[:-1]
    for one, scores in zip(which.tolist(), np.split(model.decision_function(rows), ends), strict=True):
        unseen[one][:, place] = scores


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Steps:
    """The steps of all drives, thinned.

    Attributes:
        features: Feature vectors, shape ``(n, features)``.
        until_s: Time to the violation, shape ``(n,)``.
        weight: Number of steps that each stands for, shape ``(n,)``.
        fold: Fold of its drive, shape ``(n,)``.
    """

    features: SingleArray
    until_s: FloatArray
    weight: FloatArray
    fold: IntArray

    @classmethod
    def of(cls, drives: Sequence[DriveSeries], folds: IntArray, longest_s: float) -> "_Steps":
        features: list[SingleArray] = []
        until_s, weight, fold = [], [], []
        for drive, which in zip(drives, folds.tolist(), strict=True):
            near = drive.until_s <= longest_s + NEAR_S
            # The phase differs from drive to drive, so that no moment is left out in all of them.
            kept = near | (np.arange(near.size) % THIN == len(features) % THIN)
            features.append(drive.features[kept].astype(np.float32))
            until_s.append(drive.until_s[kept])
            weight.append(np.where(near[kept], 1.0, float(THIN)))
            fold.append(np.full(int(kept.sum()), which, np.int64))
        return cls(
            features=np.concatenate(features), until_s=np.concatenate(until_s), weight=np.concatenate(weight),
            fold=np.concatenate(fold),
        )  # fmt: skip

    def fitted(self, kept: BoolArray, horizon_s: float) -> Any:
        """Return scikit-learn's model of one horizon, fitted to some of the steps."""
        from sklearn.ensemble import HistGradientBoostingClassifier  # optional, and slow to import

        model = HistGradientBoostingClassifier(
            max_iter=TREES, max_leaf_nodes=LEAVES, learning_rate=LEARNING_RATE, l2_regularization=SHRINKAGE,
            min_samples_leaf=LEAST_STEPS_OF_A_LEAF, max_bins=BINS, early_stopping=False, random_state=0,
        )  # fmt: skip
        model.fit(self.features[kept], self.until_s[kept] <= horizon_s, sample_weight=self.weight[kept])
        return model


def _labels(drives: Sequence[DriveSeries], horizon_s: float) -> BoolArray:
    labels: BoolArray = np.concatenate([one.until_s <= horizon_s for one in drives])
    return labels


def _folds(drives: Sequence[DriveSeries], rng: np.random.Generator) -> IntArray:
    """Return the fold of each drive, shape ``(n,)``: a group is in one fold, violations are spread evenly.

    Raises:
        ValueError: There are too few drives with or without a violation, or too few groups.
    """
    violated = np.array([one.violated for one in drives], np.bool_)
    fewest = int(min(violated.sum(), (~violated).sum()))
    if fewest < LEAST_VIOLATIONS:
        raise ValueError(
            f"expected at least {LEAST_VIOLATIONS} drives with and without a violation, "
            f"got {int(violated.sum())} and {int((~violated).sum())}"
        )
    groups: dict[Hashable, list[int]] = {}
    for place, drive in enumerate(drives):
        groups.setdefault(drive.group, []).append(place)
    members = list(groups.values())
    shares = np.array([violated[one].mean() for one in members])
    order = np.lexsort((rng.random(len(members)), shares))
    folds = np.empty(len(drives), np.int64)
    for first in range(0, len(order), FOLDS):
        part = order[first : first + FOLDS]
        for group, fold in zip(part.tolist(), rng.permutation(FOLDS).tolist(), strict=False):
            folds[members[group]] = fold
    for fold in range(FOLDS):
        others = violated[folds != fold]
        if others.all() or not others.any() or not (folds == fold).any():
            raise ValueError(
                f"expected drives of at least {FOLDS} scenarios, with and without a violation outside every fold; "
                f"got {len(members)} scenarios"
            )
    return folds


def _check_forest(forest: Forest, models: Sequence[Any], features: SingleArray) -> None:
    expected = np.stack([model.decision_function(features) for model in models], axis=1)
    if not np.allclose(forest.scores(features), expected, atol=_TOLERANCE):
        raise RuntimeError("this version of scikit-learn stores its trees in a way that Brink cannot read")

"""Trees of a guard: for each horizon, the probability that a violation happens within it.

The training data are the feature vectors of drives at their perception steps, up to the first violation. A step is
positive for a horizon if the violation follows within it. Negative steps far from a violation are thinned, and those
that are kept count for those left out.

Drives are divided, never steps: neighbouring steps of a drive are almost equal, and so are drives of the same
scenario or behaviour in the campaign of a search. `brink.search.analysis.folds` divides them into three folds, or in
a campaign of MLCSHE into nine combinations. Out-of-fold scores, by models that saw neither the scenario nor the
behaviour of a drive, calibrate the probabilities and choose the threshold of the alarm. The model itself is fitted to
all drives.

Only fitting needs scikit-learn (extra `analysis`); the result is a `brink.forest.Forest`.

Source: Friedman 2001 (gradient boosting), Platt 1999 (calibration).
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.extras import install_command
from brink.forest import Forest
from brink.search.analysis.boosted_trees import calibrated, forest_of, is_installed
from brink.search.analysis.folds import Division, divisions, numbered
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
"""Minimum number of drives with a violation, and without one, to which a guard is fitted."""
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
        scenario: Its scenario.
        behaviour: Its behaviour; None if it reports nothing, which no other drive shares.
    """

    features: HalfArray
    until_s: FloatArray
    scenario: Hashable
    behaviour: Hashable | None

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
        rng: Divides the drives.
        on_progress: Called with the number of fitted models and their total.

    Raises:
        MissingExtra: scikit-learn is not installed.
        ValueError: There are too few drives with or without a violation, or too few scenarios and behaviours.
    """
    if not is_installed():
        raise MissingExtra(
            f"fitting a guard needs scikit-learn, which is not installed: {install_command('analysis')}"
        )
    divisions = _divisions(drives, rng)
    steps = _Steps.of(drives, max(horizons_s))
    models: list[Any] = []
    unseen = [np.zeros((len(drive.until_s), len(horizons_s))) for drive in drives]
    done, total = 0, len(horizons_s) * len(divisions)
    import sklearn.ensemble  # noqa: F401  (loads OpenMP: the limit below finds only libraries that are loaded)
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    # More threads cost more than they save at this size, and much more on a busy machine.
    with threadpool_limits(limits=1):
        for place, horizon_s in enumerate(horizons_s):
            for division in divisions:  # the last one is the model of all drives
                model = steps.fitted(division.fitted[steps.drive], horizon_s)
                _score(model, steps.bins, drives, np.flatnonzero(division.scored), unseen, place)
                done += 1
                if on_progress is not None:
                    on_progress(done, total)
            models.append(model)
    forest = steps.bins.unbinned(forest_of(models, len(steps.bins.edges)))
    _check_forest(forest, models, steps)
    return FittedHorizons(
        forest=forest,
        calibration=np.array(
            [
                calibrated(np.concatenate([row[:, place] for row in unseen]), _labels(drives, horizon_s))
                for place, horizon_s in enumerate(horizons_s)
            ]
        ),
        unseen=tuple(unseen),
    )


def _score(
    model: Any,
    bins: "_Bins",
    drives: Sequence[DriveSeries],
    which: IntArray,
    unseen: Sequence[FloatArray],
    place: int,
) -> None:
    """Write the scores of some drives by a model into a column of `unseen`."""
    if not which.size:
        return
    rows = bins.indices(np.concatenate([drives[drive].features for drive in which.tolist()]))
    ends = np.cumsum([len(unseen[drive]) for drive in which.tolist()])[:-1]
    for drive, scores in zip(which.tolist(), np.split(model.decision_function(rows), ends), strict=True):
        unseen[drive][:, place] = scores


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Bins:
    """The bins of each feature, into which values are sorted once for all models.

    scikit-learn finds the same edges, weighted percentiles, but one at a time and again for each model, which takes
    most of its time. Models are fitted to the numbers of the bins, and their thresholds turned into edges afterwards.

    Attributes:
        edges: For each feature, the upper edge of every bin but the last, ascending.
    """

    edges: tuple[FloatArray, ...]

    @classmethod
    def of(cls, features: SingleArray, weight: FloatArray) -> "_Bins":
        columns = features.astype(np.float64).T
        return cls(edges=tuple(_edges(column, weight) for column in columns))

    def indices(self, features: HalfArray | SingleArray) -> SingleArray:
        """Return the bin of each value, of the same shape."""
        bins = np.empty(features.shape, np.float32)
        for place, edges in enumerate(self.edges):
            bins[:, place] = np.searchsorted(edges, features[:, place].astype(np.float64), side="left")
        return bins

    def unbinned(self, forest: Forest) -> Forest:
        """Return trees that were fitted to bins as trees that compare features."""
        value, inner = forest.value.copy(), forest.right > 0
        value[inner] = [
            self.edges[feature][int(threshold)]
            for feature, threshold in zip(forest.feature[inner].tolist(), value[inner].tolist(), strict=True)
        ]
        return replace(forest, value=value)


def _edges(values: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the edges between the bins of one feature: weighted percentiles, averaged at steps, each once."""
    distinct = np.unique(values)
    if distinct.size <= BINS:
        return np.asarray(0.5 * (distinct[:-1] + distinct[1:]), np.float64)
    order = np.argsort(values, kind="stable")
    ordered, below = values[order], np.cumsum(weight[order])
    wanted = np.linspace(0.0, 1.0, BINS + 1)[1:-1] * below[-1]
    place = np.minimum(np.searchsorted(below, wanted, side="left"), ordered.size - 1)
    following = np.where(below[place] == wanted, np.minimum(place + 1, ordered.size - 1), place)
    return np.unique(0.5 * (ordered[place] + ordered[following]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Steps:
    """The steps of all drives, thinned.

    Attributes:
        bins: Bins of the features.
        binned: Bin of each value of the feature vectors, shape ``(n, features)``.
        features: Feature vectors, shape ``(n, features)``.
        until_s: Time to the violation, shape ``(n,)``.
        weight: Number of steps that each stands for, shape ``(n,)``.
        drive: Place of its drive, shape ``(n,)``.
    """

    bins: _Bins
    binned: SingleArray
    features: SingleArray
    until_s: FloatArray
    weight: FloatArray
    drive: IntArray

    @classmethod
    def of(cls, drives: Sequence[DriveSeries], longest_s: float) -> "_Steps":
        features: list[SingleArray] = []
        until_s, weight, places = [], [], []
        for place, drive in enumerate(drives):
            near = drive.until_s <= longest_s + NEAR_S
            # The phase differs from drive to drive, so that no moment is left out in all of them.
            kept = near | (np.arange(near.size) % THIN == len(features) % THIN)
            features.append(drive.features[kept].astype(np.float32))
            until_s.append(drive.until_s[kept])
            weight.append(np.where(near[kept], 1.0, float(THIN)))
            places.append(np.full(int(kept.sum()), place, np.int64))
        rows, weights = np.concatenate(features), np.concatenate(weight)
        bins = _Bins.of(rows, weights)
        return cls(
            bins=bins,
            binned=bins.indices(rows),
            features=rows,
            until_s=np.concatenate(until_s),
            weight=weights,
            drive=np.concatenate(places),
        )

    def fitted(self, kept: BoolArray, horizon_s: float) -> Any:
        """Return scikit-learn's model of one horizon, fitted to some of the steps."""
        from sklearn.ensemble import HistGradientBoostingClassifier  # optional, and slow to import

        model = HistGradientBoostingClassifier(
            max_iter=TREES,
            max_leaf_nodes=LEAVES,
            learning_rate=LEARNING_RATE,
            l2_regularization=SHRINKAGE,
            min_samples_leaf=LEAST_STEPS_OF_A_LEAF,
            max_bins=BINS,
            early_stopping=False,
            random_state=0,
        )
        model.fit(self.binned[kept], self.until_s[kept] <= horizon_s, sample_weight=self.weight[kept])
        return model


def _labels(drives: Sequence[DriveSeries], horizon_s: float) -> BoolArray:
    labels: BoolArray = np.concatenate([drive.until_s <= horizon_s for drive in drives])
    return labels


def _divisions(drives: Sequence[DriveSeries], rng: np.random.Generator) -> list[Division]:
    """Return the drives of each model: of those that score every drive once, and last of the model of all drives.

    Raises:
        ValueError: There are too few drives with or without a violation, or too few scenarios and behaviours.
    """
    violated = np.array([drive.violated for drive in drives], np.bool_)
    fewest = int(min(violated.sum(), (~violated).sum()))
    if fewest < LEAST_VIOLATIONS:
        raise ValueError(
            f"expected at least {LEAST_VIOLATIONS} drives with and without a violation, "
            f"got {int(violated.sum())} and {int((~violated).sum())}"
        )
    kinds = kinds_of_drives(drives)
    found = divisions(kinds, violated, rng, (FOLDS,)) if kinds else []
    if not found:
        scenarios, behaviours = (
            len({getattr(one, kind) for one in drives}) for kind in ("scenario", "behaviour")
        )
        raise ValueError(
            f"expected drives of at least {FOLDS} scenarios, with and without a violation outside every fold; "
            f"got {scenarios} scenarios and {behaviours} behaviours"
        )
    every = np.ones(len(drives), np.bool_)
    return [*found, Division(fitted=every, scored=~every)]


def kinds_of_drives(drives: Sequence[DriveSeries]) -> list[IntArray]:
    """Return labels of similar drives: the numbers of their scenarios and of their behaviours, shape ``(n,)`` each.

    Drives that report nothing have a behaviour each. An ODD may leave a single scenario or behaviour, or two: those
    are left out.
    """
    behaviours = [
        ("nothing", place) if drive.behaviour is None else ("behaviour", drive.behaviour)
        for place, drive in enumerate(drives)
    ]
    kinds = (numbered([one.scenario for one in drives]), numbered(behaviours))
    return [kind for kind in kinds if np.unique(kind).size >= FOLDS]


def _check_forest(forest: Forest, models: Sequence[Any], steps: _Steps) -> None:
    expected = np.stack([model.decision_function(steps.binned[:200]) for model in models], axis=1)
    if not np.allclose(forest.scores(steps.features[:200]), expected, atol=_TOLERANCE):
        raise RuntimeError("this version of scikit-learn stores its trees in a way that Brink cannot read")

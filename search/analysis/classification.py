"""Classification metrics of predicted probabilities: discrimination, accuracy, calibration, and the cost of alarms.

Source: Brier 1950; Hanley and McNeil 1982 (the area under the ROC curve is the A12 of the two groups' probabilities).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from brink.search.analysis.statistics import a12
from brink.search.fitness import wilson_interval
from brink.search.space import BoolArray, FloatArray

BINS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationBin:
    """Solutions with similar predicted probabilities.

    Attributes:
        solutions: Number of solutions.
        foretold: Mean predicted probability of unsafe.
        low: Mean lower limit of the predicted intervals.
        high: Mean upper limit of the predicted intervals.
        observed: Unsafe share.
        observed_low: Lower limit of the Wilson interval of the unsafe share.
        observed_high: Upper limit of the Wilson interval of the unsafe share.
    """

    solutions: int
    foretold: float
    low: float
    high: float
    observed: float
    observed_low: float
    observed_high: float

    @property
    def within(self) -> bool:
        """Whether the unsafe share lies within the predicted interval."""
        return self.low <= self.observed <= self.high


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatingPoint:
    """Error rates when every probability from a threshold on raises an alarm.

    Attributes:
        probability: The threshold.
        missed: Share of the unsafe solutions without an alarm.
        false: Share of the safe solutions with an alarm.
    """

    probability: float
    missed: float
    false: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassificationMetrics:
    """Quality of predicted probabilities.

    Attributes:
        solutions: Number of solutions.
        unsafe: Number of unsafe solutions.
        auroc: Probability that an unsafe solution was given a larger probability than a safe one; 0.5 is guessing.
        brier: Mean squared error of the probabilities; smaller is better.
        bins: Calibration, ascending by probability, with about equally many solutions in each bin.
    """

    solutions: int
    unsafe: int
    auroc: float
    brier: float
    bins: tuple[CalibrationBin, ...]


def classification_metrics(
    probability: FloatArray, unsafe: BoolArray, low: FloatArray | None = None, high: FloatArray | None = None
) -> ClassificationMetrics:
    """Compare predicted probabilities with verdicts.

    Args:
        probability: Predicted probability of unsafe, shape ``(n,)``.
        unsafe: Verdicts, shape ``(n,)``; both must occur.
        low: Lower limits of the predicted intervals, shape ``(n,)``; None for the probabilities themselves.
        high: Upper limits of the predicted intervals, shape ``(n,)``; None for the probabilities themselves.

    Raises:
        ValueError: The shapes differ, or only one verdict occurs.
    """
    if probability.shape != unsafe.shape or probability.ndim != 1:
        raise ValueError(
            f"expected a verdict for each probability, got {unsafe.shape} for {probability.shape}"
        )
    if unsafe.all() or not unsafe.any():
        raise ValueError("expected both safe and unsafe solutions")
    low = probability if low is None else low
    high = probability if high is None else high
    order = np.argsort(probability, kind="stable")
    return ClassificationMetrics(
        solutions=int(unsafe.size),
        unsafe=int(unsafe.sum()),
        auroc=a12(probability[unsafe].tolist(), probability[~unsafe].tolist()),
        brier=float(np.mean((probability - unsafe) ** 2)),
        bins=tuple(
            _bin(probability[part], unsafe[part], low[part], high[part])
            for part in np.array_split(order, min(BINS, unsafe.size))
        ),
    )


def _bin(probability: FloatArray, unsafe: BoolArray, low: FloatArray, high: FloatArray) -> CalibrationBin:
    observed_low, observed_high = wilson_interval(int(unsafe.sum()), int(unsafe.size))
    return CalibrationBin(
        solutions=int(unsafe.size), foretold=float(probability.mean()), low=float(low.mean()),
        high=float(high.mean()), observed=float(unsafe.mean()), observed_low=float(observed_low),
        observed_high=float(observed_high),
    )  # fmt: skip


def operating_points(
    probability: FloatArray, unsafe: BoolArray, at: Sequence[float] | None = None
) -> list[OperatingPoint]:
    """Return the trade-off between missed hazards and false alarms.

    Args:
        probability: Predicted probability of unsafe, shape ``(n,)``.
        unsafe: Verdicts, shape ``(n,)``; both must occur.
        at: Thresholds, in any order; None for all predicted probabilities, descending.
    """
    thresholds = np.unique(probability)[::-1].tolist() if at is None else list(at)
    hazards, harmless = np.sort(probability[unsafe]), np.sort(probability[~unsafe])
    return [
        OperatingPoint(
            probability=threshold,
            missed=float(np.searchsorted(hazards, threshold, side="left") / hazards.size),
            false=float(1 - np.searchsorted(harmless, threshold, side="left") / harmless.size),
        )
        for threshold in thresholds
    ]


def fewest_false_alarms(points: Sequence[OperatingPoint], missed: float) -> OperatingPoint:
    """Return the point with the fewest false alarms among those that miss at most a share of the hazards.

    Raises:
        ValueError: Every point misses more.
    """
    good = [point for point in points if point.missed <= missed]
    if not good:
        raise ValueError(f"no threshold misses at most {missed:g} of the hazards")
    return min(good, key=lambda point: (point.false, -point.probability))
